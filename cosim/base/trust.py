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
TRUSTED_LIST = "trusted"  # file of trusted folders' hashes
# Endings of files that are read or written but never run. They are not hashed, so that an edited scenario or a new
# flight does not need trust again.
_DATA_FILE = re.compile(
    r".*\.(arrows|bbl|bfl|bin|csv|html|jpg|json|jsonl|log|mat|mcap|md|parquet|png|svg|tlog|toml|ulg|xml)", re.IGNORECASE
)
_SKIPPED = ("__pycache__", "runs")  # folders without code to run
_SHIPPED_FOLDERS = ("aircraft", "engines", "fmus", "scenarios", "studies")  # with this package's own code
_HASH_LINE = re.compile(r"[0-9a-f]{64}(?=  )")  # line of the file of trusted folders
_CODE_ENDINGS = (".py", ".fmu")  # file endings of code
_ENGINE_FLAGS = ("--engine", "--engine=")  # options that may name a mapping file
_SEPARATORS = re.compile(r"[\s\"'\[\],=]+")  # separates names in KEY=["NAME"]


class CodeRefusedError(InputError):
    """Raised instead of running code that is not trusted, or that a command only displays."""


@dataclass(frozen=True)
class Code:
    """File or package whose code is to be run.

    ``names``: what else the user names when he means it, such as the mapping file of an FMU.  ``arguments``: of a
    program, with the leading blank.  ``top``: the folder in which Python finds it, by default the file's own.
    """

    path: Path
    names: tuple[Path | str, ...] = ()
    arguments: str = ""
    top: Path | None = None

    @property
    def folder(self) -> Path:
        """Folder that must be trusted; for a program ``bin/x`` the folder above, which has its files."""
        folder = (self.top or self.path.resolve().parent).resolve()
        has_files = folder.name == "bin" and any((folder.parent / name).is_dir() for name in ("etc", "lib", "share"))
        return folder.parent if has_files and self.top is None else folder


@dataclass(frozen=True)
class TrustDecision:
    """Code that this process may run besides stored trusted folders; workers inherit it."""

    places: frozenset[Path] = frozenset()  # folders trusted with all subfolders
    named: frozenset[Path | str] = frozenset()  # code that the user named explicitly
    accepted: frozenset[tuple[Path, Path, str]] = frozenset()  # accepted: folder, file, arguments
    hashes: frozenset[str] = frozenset()  # hashes of folders trusted or made here
    contents: frozenset[str] = frozenset()  # hashes of these folders' files
    by_program: bool = True  # whether a program named the code


_decision = TrustDecision()
_ask: Callable[[Sequence[str]], bool] | None = None  # asks on a terminal; None: cannot ask
_code_forbidden: ContextVar[bool] = ContextVar("code_forbidden", default=False)


def need_trust(code: Iterable[Code], what: str) -> None:
    """Raise CodeRefusedError for code in a folder that is not trusted; on a terminal ask the user first.

    ``what`` wants to run it, in words.  The error names folders, files and remedy; accepted folders are stored.
    """
    wanted = {(item.folder, item.path.resolve(), item.arguments): item for item in code}
    if wanted and _code_forbidden.get():
        names = "; ".join(_list_folders(wanted.values(), {}))
        raise CodeRefusedError(f"{what}: {names}: is code, and nothing is run to look at something")
    unsettled = [item for key, item in wanted.items() if key not in _decision.accepted and not _is_shipped(key[1])]
    entries = {item.folder: _hash_folder(item.folder) for item in unsettled}
    hashes = {item: _hash_code(item, entries[item.folder]) for item in unsettled}
    known = _read_stored_hashes() | _decision.hashes
    unknown = [item for item, value in hashes.items() if value not in known and not _is_trusted(item)]
    if unknown:
        folders = _list_folders(unknown, hashes)
        if not (_ask and _ask(folders)):
            how = "call cosim.trust(FOLDER)" if _decision.by_program else "add --trust"
            raise CodeRefusedError(
                f"{what}: {'; '.join(folders)}: has code that has not been run before. Check it, then "
                f"{how} to run and remember it."
            )
    _add_to_decision(accepted=wanted.keys(), contents={entry for found in entries.values() for entry in found or ()})
    _store_hashes({value: f"{item.folder}{item.arguments}" for item, value in hashes.items() if value})


def remember_written(folder: Path, made: Collection[Path] = ()) -> None:
    """Keep a folder trusted, or not trusted, after this program has written code into it.

    It wrote the code ``made``, and copies of code that is trusted here; a folder with any other code in it is trusted
    only if it was without them.
    """
    entries = _hash_folder(folder.resolve()) or set()
    own = {_hash_file(path) for path in made}
    for arguments in {"", *(key[-1] for key in _decision.accepted)} if entries else ():
        was_trusted = _hash_entries(entries - own, arguments) in _read_stored_hashes() | _decision.hashes
        if was_trusted or entries <= own | _decision.contents:
            _store_hashes({_hash_entries(entries, arguments): f"{folder.resolve()}{arguments}"})


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
    _add_to_decision(places=[path if path.is_dir() else path.parent for path in paths])


def trust_named_code(choices: Iterable[Path | str | None], folder: Path) -> None:
    """Trust code named in the arguments of a call from Python; without effect within a command.

    Files are relative to ``folder``; None is no choice.  A command trusts its own arguments elsewhere.
    """
    if _decision.by_program:
        texts = [str(choice) for choice in choices if choice]
        _add_to_decision(named=[name for text in texts for name in _find_code_names(text, folder, is_engine=True)])


def program_code(path: Path, arguments: str) -> Code:
    """Return a program as code that is identified by path and arguments."""
    return Code(path, (f"process:{path.resolve()}{arguments}",), arguments)


def _find_code_names(text: str, folder: Path, is_engine: bool) -> Iterator[Path | str]:
    """Yield the paths and names of code in a text: Python files, engines, programs and modules.

    What is data is never taken for code, whatever else names it, but for the mapping file of an engine or a controller.
    """
    endings = (*_CODE_ENDINGS, ".toml" if is_engine else ".fmu.toml")
    for setting in (text, text.partition("=")[2]):
        if setting.startswith("process:"):
            program, blank, arguments = setting.removeprefix("process:").partition(" ")
            yield from program_code(folder / program, blank + arguments).names
    for chunk in (text, text.partition("=")[2], *_SEPARATORS.split(text)):
        for word in (chunk, chunk.rpartition(":")[0]):
            if word:
                yield (folder / word).resolve() if word.lower().endswith(endings) else word


def _find_named_code(arguments: Sequence[str]) -> Iterator[Path | str]:
    """Yield the paths and names of code in a command's arguments."""
    for before, text in zip(["", *arguments], arguments, strict=False):
        is_engine = text.startswith(_ENGINE_FLAGS) or before in _ENGINE_FLAGS or arguments[0] in ("engine", "identify")
        yield from _find_code_names(text.removeprefix("--engine="), Path(), is_engine)


@contextmanager
def without_code() -> Iterator[None]:
    """Forbid running user code within a block that only displays something."""
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
    """Trust the code named by a command's arguments within the block; ``ask`` asks about other folders."""
    global _ask, _decision
    before, previous = (_ask, _decision), os.environ.get(ENV_VAR)
    _ask, _decision = ask, TrustDecision(by_program=False)
    try:
        _add_to_decision(named=_find_named_code(arguments))
        yield
    finally:
        _ask, _decision = before
        os.environ.pop(ENV_VAR, None)
        if previous is not None:
            os.environ[ENV_VAR] = previous


def trust_everything() -> None:
    """Trust and store all code from now on, also in processes started later."""
    os.environ[ENV_VAR] = "1"


def decision() -> TrustDecision:
    """Return the decision of this process, to be passed to its workers."""
    return _decision


def inherit(decided: TrustDecision) -> None:
    """Adopt the trust decision of the parent process."""
    global _decision
    _decision = replace(decided, by_program=False)


def _add_to_decision(**more: Iterable[object]) -> None:
    global _decision
    _decision = replace(_decision, **{key: getattr(_decision, key) | set(values) for key, values in more.items()})


def _is_shipped(path: Path) -> bool:
    return any(path.is_relative_to(data_folder(name).resolve()) for name in _SHIPPED_FOLDERS)


def _is_trusted(code: Code) -> bool:
    """Return whether the user named the code or its folder, or trusts a folder above it."""
    names = {name.resolve() if isinstance(name, Path) else name for name in code.names or (code.path,)}
    named_folders = {name.parent for name in _decision.named if isinstance(name, Path)}
    return (
        os.environ.get(ENV_VAR) == "1"
        or bool(names & _decision.named)
        or (not code.arguments and code.folder in named_folders)
        or any(place in _decision.places for place in (code.folder, *code.folder.parents))
    )


def _hash_folder(folder: Path, *, max_files: int = 50_000, max_mb: float = 256.0) -> set[str] | None:
    """Return hash and name of each file below a folder that may be code; None if it cannot be read.

    None too where there are more files than ``max_files``, of all kinds, or more than ``max_mb`` (of 2**20 bytes) to
    hash: that takes half a second.

    Links are followed.  Left out are folders whose names begin with a dot, those of _SKIPPED, the Python that runs
    this program, and its settings and caches.
    """
    counted, seen, size = list[Path](), 0, 0
    visited = {os.path.realpath(sys.prefix)}
    with suppress(RuntimeError):  # the user has no home folder
        visited |= {os.path.realpath(place) for place in (settings_folder(), cache_folder())}
    try:
        for current, inner, names in os.walk(folder, followlinks=True):
            if (real := os.path.realpath(current)) in visited:
                inner.clear()
                continue
            visited.add(real)
            inner[:] = [name for name in inner if name[0] != "." and name not in _SKIPPED]
            seen += len(names)
            files = [Path(current, name) for name in names if not _DATA_FILE.fullmatch(name)]
            counted += [path for path in files if path.is_file()]
            size += sum(path.stat().st_size for path in files if path.is_file())
            if seen > max_files or size > max_mb * 2**20:
                return None
        return set(map(_hash_file, counted))
    except (OSError, InputError):
        return None


def _hash_file(path: Path) -> str:
    return f"{hashlib.sha256(read_file(path)).hexdigest()} {path.name}"


def _hash_entries(entries: Collection[str], arguments: str) -> str:
    return hashlib.sha256(os.fsencode("\n".join(sorted(entries)) + f"\0{arguments}")).hexdigest()


def _hash_code(code: Code, entries: set[str] | None) -> str | None:
    """Return the hash of a folder's files and of a program's arguments; None if a file cannot be read.

    The code itself counts whatever its name is, and so do the files beside it that its arguments name.
    """
    if entries is None:
        return None
    named = [code.path, *(code.path.parent / word for word in code.arguments.split())]
    with suppress(InputError):
        return _hash_entries(entries | {_hash_file(path) for path in named if path.is_file()}, code.arguments)
    return None


def _store_hashes(folders: dict[str, str]) -> None:
    """Store hashes of trusted folders, each with folder and arguments, in the user's settings."""
    _add_to_decision(hashes=folders)
    known = _read_stored_hashes()
    lines = [f"{value}  {_escape_line(text)}\n" for value, text in folders.items() if value not in known]
    with suppress(OSError, RuntimeError):  # the user has no home folder
        if lines:
            file_path = settings_folder() / TRUSTED_LIST
            file_path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(file_path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            try:
                # A single write keeps lines of concurrent processes apart.
                os.write(file, "".join(lines).encode(errors="replace"))
            finally:
                os.close(file)


def _read_stored_hashes() -> frozenset[str]:
    """Return the hashes of trusted folders stored in the user's settings."""
    try:
        lines = (settings_folder() / TRUSTED_LIST).read_text(encoding="utf-8", errors="replace").splitlines()
    except (OSError, RuntimeError):
        return frozenset()
    return frozenset(line[:64] for line in lines if _HASH_LINE.match(line))


def _list_folders(code: Collection[Code], hashes: Mapping[Code, str | None], max_named: int = 4) -> list[str]:
    """Return a line for each folder with its files to be run, control characters escaped."""
    files: dict[Path, list[str]] = {}
    for item in code:
        files.setdefault(item.folder, []).append(f"{item.path.name}{item.arguments}")
    lines = []
    for folder, names in files.items():
        rest = len(names) - max_named
        line = f"{folder} ({', '.join(names[:max_named])}{f' and {rest} more' if rest > 0 else ''}"
        large = any(item.folder == folder and hashes.get(item, "") is None for item in code)
        lines.append(_escape_line(line + ("; too large to be remembered)" if large else ")")))
    return lines


def _escape_line(text: str) -> str:
    return printable(text).replace("\n", "\\n")
