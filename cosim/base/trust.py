"""Trust in code, by its folder: what the user named, accepted or has flown before is run, and nothing else.

A scenario, a study, a campaign, a vehicle or a run names code: files of Python, FMUs, programs.  Whatever loads such a
file says so here first (:func:`need_trust`).  It is run if it is shipped, if the user named it or other code of its
folder himself (on the command line, in his program), or if its folder is as it was when he let it run: one hash over
the names and contents of its files is in the file ``trusted`` of his settings.  Of any other folder he is asked on a
terminal, and without one it is refused.

While something is only looked at (:func:`without_code`), no code is run, whoever trusts it.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import data_folder
from cosim.base.storage.user import cache_folder, settings_folder
from cosim.base.wording import printable

ENV_VAR = "HEXJET_TRUST"  # 1: like --trust for every command
REMEMBERED = "trusted"  # file of trusted folders, as sha256sum's
# Files that hexjet reads or writes but never runs are not hashed, or each edit of a scenario and each flight would ask
# again.
_DATA = re.compile(
    r".*\.(arrows|bbl|bfl|bin|csv|html|jpg|json|jsonl|log|mat|mcap|md|parquet|png|svg|tlog|toml|ulg|xml)", re.IGNORECASE
)
_LEFT_OUT = ("__pycache__", "runs")  # folders without code that could run
_SHIPPED = ("aircraft", "engines", "fmus", "scenarios", "studies")  # folders with the package's own code
_HASH = re.compile(r"[0-9a-f]{64}(?=  )")  # line of the file of trusted folders
_CODE = (".py", ".fmu")  # file endings of code
_ENGINES = ("--engine", "--engine=")  # options that may name a mapping file
_BETWEEN = re.compile(r"[\s\"'\[\],=]+")  # separates names in KEY=["NAME"]


class CodeRefusedError(InputError):
    """Code was not run, because it is not trusted or because a command only displays its name."""


@dataclass(frozen=True)
class Code:
    """A file that is to be run, or a package.

    ``names``: what else the user names when he means it, such as the mapping file of an FMU.  ``arguments``: of a
    program, with the leading blank.  ``top``: the folder in which Python finds it, by default the file's own.
    """

    path: Path
    names: tuple[Path | str, ...] = ()
    arguments: str = ""
    top: Path | None = None

    @property
    def folder(self) -> Path:
        """The folder to be trusted; for a program ``bin/x`` the folder above, where its files are."""
        folder = (self.top or self.path.resolve().parent).resolve()
        has_files = folder.name == "bin" and any((folder.parent / name).is_dir() for name in ("etc", "lib", "share"))
        return folder.parent if has_files and self.top is None else folder


@dataclass(frozen=True)
class Decision:
    """Code that may run in this process besides remembered folders; workers inherit it."""

    places: frozenset[Path] = frozenset()  # folders trusted with all subfolders
    named: frozenset[Path | str] = frozenset()  # code that the user named explicitly
    accepted: frozenset[tuple[Path, Path, str]] = frozenset()  # decisions made: folder, file, arguments
    hashes: frozenset[str] = frozenset()  # hashes of folders trusted or made here
    contents: frozenset[str] = frozenset()  # file entries of these folders
    by_program: bool = True  # whether a program named the code


_decision = Decision()
_ask: Callable[[Sequence[str]], bool] | None = None  # asks on a terminal; None: cannot ask
_code_forbidden: ContextVar[bool] = ContextVar("code_forbidden", default=False)


def need_trust(code: Iterable[Code], what: str) -> None:
    """Refuse code in a folder that is not trusted, and remember what is run; on a terminal ask the user.

    ``what`` wants to run it, in words.  Raises CodeRefusedError: one line with folders and files, and what to do.
    """
    wanted = {(item.folder, item.path.resolve(), item.arguments): item for item in code}
    if wanted and _code_forbidden.get():
        names = "; ".join(_list_folders(wanted.values(), {}))
        raise CodeRefusedError(f"{what}: {names}: is code, and nothing is run to look at something")
    unsettled = [item for key, item in wanted.items() if key not in _decision.accepted and not _is_shipped(key[1])]
    entries = {item.folder: _entries(item.folder) for item in unsettled}
    hashes = {item: _hash(item, entries[item.folder]) for item in unsettled}
    known = _read_remembered() | _decision.hashes
    unknown = [item for item, value in hashes.items() if value not in known and not _is_accepted(item)]
    if unknown:
        folders = _list_folders(unknown, hashes)
        if not (_ask and _ask(folders)):
            how = "call cosim.trust(FOLDER)" if _decision.by_program else "add --trust"
            raise CodeRefusedError(
                f"{what}: {'; '.join(folders)}: has code that has not been run before. Check it, then "
                f"{how} to run and remember it."
            )
    _add(accepted=wanted.keys(), contents={entry for found in entries.values() for entry in found or ()})
    _note({value: f"{item.folder}{item.arguments}" for item, value in hashes.items() if value})


def remember_written(folder: Path, made: Collection[Path] = ()) -> None:
    """Keep a folder's trust unchanged while this program writes into it.

    It wrote the code ``made``, and copies of code that is trusted here; a folder with any other code in it is trusted
    only if it was without them.
    """
    entries = _entries(folder.resolve()) or set()
    own = {_hash_line(path) for path in made}
    for arguments in {"", *(key[-1] for key in _decision.accepted)} if entries else ():
        was_trusted = _digest(entries - own, arguments) in _read_remembered() | _decision.hashes
        if was_trusted or entries <= own | _decision.contents:
            _note({_digest(entries, arguments): f"{folder.resolve()}{arguments}"})


def trust(*places: Path | str) -> None:
    """Trust the code in these folders in this process and, once run, permanently.

    What a program names or hands over itself needs no such word; what a file names does, unless it was flown before.

    Parameters
    ----------
    *places : Path or str
        Folders with all that is below them, now or later; a file stands for the folder that it is in.

    Raises
    ------
    InputError
        For one that is not there.
    """
    for place in places:
        if not Path(place).exists():
            raise InputError(f"trust: {place}: is not there")
    paths = [Path(place).resolve() for place in places]
    _add(places=[path if path.is_dir() else path.parent for path in paths])


def trust_named_code(choices: Iterable[Path | str | None], folder: Path) -> None:
    """Trust code named in the arguments of a call from Python; without effect within a command.

    Files are relative to ``folder``; None is no choice.  A command trusts its own arguments elsewhere.
    """
    if _decision.by_program:
        texts = [str(choice) for choice in choices if choice]
        _add(named=[name for text in texts for name in _names(text, folder, is_engine=True)])


def program_code(path: Path, arguments: str) -> Code:
    """Return a program as code, identified with its arguments, because others make it do something else."""
    return Code(path, (f"process:{path.resolve()}{arguments}",), arguments)


def _names(text: str, folder: Path, is_engine: bool) -> Iterator[Path | str]:
    """Yield the code that a text names: Python files, engines by path, programs, and possible modules.

    What is data is never taken for code, whatever else names it, but for the mapping file of an engine or a controller.
    """
    endings = (*_CODE, ".toml" if is_engine else ".fmu.toml")
    for setting in (text, text.partition("=")[2]):
        if setting.startswith("process:"):
            program, blank, arguments = setting.removeprefix("process:").partition(" ")
            yield from program_code(folder / program, blank + arguments).names
    for chunk in (text, text.partition("=")[2], *_BETWEEN.split(text)):
        for word in (chunk, chunk.rpartition(":")[0]):
            if word:
                yield (folder / word).resolve() if word.lower().endswith(endings) else word


def _named_in(arguments: Sequence[str]) -> Iterator[Path | str]:
    """Yield the code that the arguments of a command name."""
    for before, text in zip(["", *arguments], arguments, strict=False):
        is_engine = text.startswith(_ENGINES) or before in _ENGINES or arguments[0] in ("engine", "identify")
        yield from _names(text.removeprefix("--engine="), Path(), is_engine)


@contextmanager
def without_code() -> Iterator[None]:
    """Run no user code within the block, which only displays something."""
    token = _code_forbidden.set(True)
    try:
        yield
    finally:
        _code_forbidden.reset(token)


def is_code_forbidden() -> bool:
    """Return whether user code must not run, because something is only displayed."""
    return _code_forbidden.get()


@contextmanager
def command_trust_scope(ask: Callable[[Sequence[str]], bool] | None, arguments: Sequence[str]) -> Iterator[None]:
    """Trust the code named by a command's arguments; ``ask`` asks the user about other folders."""
    global _ask, _decision
    before, previous = (_ask, _decision), os.environ.get(ENV_VAR)
    _ask, _decision = ask, Decision(by_program=False)
    try:
        _add(named=_named_in(arguments))
        yield
    finally:
        _ask, _decision = before
        os.environ.pop(ENV_VAR, None)
        if previous is not None:
            os.environ[ENV_VAR] = previous


def trust_everything() -> None:
    """Trust all code, and remember it; processes started from now on do the same."""
    os.environ[ENV_VAR] = "1"


def decision() -> Decision:
    """Return the decision of this process, to be passed to its workers."""
    return _decision


def inherit(decided: Decision) -> None:
    """Apply the decision of the parent process, and trust nothing that is named here."""
    global _decision
    _decision = replace(decided, by_program=False)


def _add(**more: Iterable[object]) -> None:
    global _decision
    _decision = replace(_decision, **{key: getattr(_decision, key) | set(values) for key, values in more.items()})


def _is_shipped(path: Path) -> bool:
    return any(path.is_relative_to(data_folder(name).resolve()) for name in _SHIPPED)


def _is_accepted(code: Code) -> bool:
    """Return whether the user named the code, or without arguments other code of its folder, or trusts its place."""
    names = {name.resolve() if isinstance(name, Path) else name for name in code.names or (code.path,)}
    named_folders = {name.parent for name in _decision.named if isinstance(name, Path)}
    return (
        os.environ.get(ENV_VAR) == "1"
        or bool(names & _decision.named)
        or (not code.arguments and code.folder in named_folders)
        or any(place in _decision.places for place in (code.folder, *code.folder.parents))
    )


def _entries(folder: Path, *, max_files: int = 50_000, max_mb: float = 256.0) -> set[str] | None:
    """Return hash and name of each relevant file below a folder; None if it cannot be read.

    None too where there are more files than ``max_files``, of all kinds, or more than ``max_mb`` (of 2**20 bytes) to
    hash: that takes half a second.

    Links are followed.  Left out are folders whose names begin with a dot, those of _LEFT_OUT, the Python that runs
    this program, and its settings and caches.
    """
    counted, seen, size = list[Path](), 0, 0
    visited = {os.path.realpath(sys.prefix)}
    with suppress(RuntimeError):  # a user without a home has no list
        visited |= {os.path.realpath(place) for place in (settings_folder(), cache_folder())}
    try:
        for current, inner, names in os.walk(folder, followlinks=True):
            if (real := os.path.realpath(current)) in visited:
                inner.clear()
                continue
            visited.add(real)
            inner[:] = [name for name in inner if name[0] != "." and name not in _LEFT_OUT]
            seen += len(names)
            files = [Path(current, name) for name in names if not _DATA.fullmatch(name)]
            counted += [path for path in files if path.is_file()]
            size += sum(path.stat().st_size for path in files if path.is_file())
            if seen > max_files or size > max_mb * 2**20:
                return None
        return set(map(_hash_line, counted))
    except (OSError, InputError):
        return None


def _hash_line(path: Path) -> str:
    return f"{hashlib.sha256(read_file(path)).hexdigest()} {path.name}"


def _digest(entries: Collection[str], arguments: str) -> str:
    return hashlib.sha256(os.fsencode("\n".join(sorted(entries)) + f"\0{arguments}")).hexdigest()


def _hash(code: Code, entries: set[str] | None) -> str | None:
    """Return the hash of a folder and of how its code is run; None if it cannot be remembered.

    The code itself counts whatever its name is, and so do the files beside it that its arguments name.
    """
    if entries is None:
        return None
    named = [code.path, *(code.path.parent / word for word in code.arguments.split())]
    with suppress(InputError):
        return _digest(entries | {_hash_line(path) for path in named if path.is_file()}, code.arguments)
    return None


def _note(folders: dict[str, str]) -> None:
    """Store hashes with folder and arguments in the user's settings, if there are any."""
    _add(hashes=folders)
    known = _read_remembered()
    lines = [f"{value}  {_one_line(text)}\n" for value, text in folders.items() if value not in known]
    with suppress(OSError, RuntimeError):  # a user without a home has no list
        if lines:
            file_path = settings_folder() / REMEMBERED
            file_path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(file_path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            try:
                # One write is safe against concurrent processes.
                os.write(file, "".join(lines).encode(errors="replace"))
            finally:
                os.close(file)


def _read_remembered() -> frozenset[str]:
    """Return the hashes in the user's settings; a line that has none is skipped."""
    try:
        lines = (settings_folder() / REMEMBERED).read_text(encoding="utf-8", errors="replace").splitlines()
    except (OSError, RuntimeError):
        return frozenset()
    return frozenset(line[:64] for line in lines if _HASH.match(line))


def _list_folders(code: Collection[Code], hashes: Mapping[Code, str | None], max_named: int = 4) -> list[str]:
    """Return each folder with the names of its files that are to be run, in lines that no terminal obeys."""
    files: dict[Path, list[str]] = {}
    for item in code:
        files.setdefault(item.folder, []).append(f"{item.path.name}{item.arguments}")
    lines = []
    for folder, names in files.items():
        rest = len(names) - max_named
        line = f"{folder} ({', '.join(names[:max_named])}{f' and {rest} more' if rest > 0 else ''}"
        large = any(item.folder == folder and hashes.get(item, "") is None for item in code)
        lines.append(_one_line(line + ("; too large to be remembered)" if large else ")")))
    return lines


def _one_line(text: str) -> str:
    return printable(text).replace("\n", "\\n")
