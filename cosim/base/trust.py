"""Trust in code: what the user named, accepted or has flown before is run, and nothing else.

A scenario, a study, a campaign, a vehicle or a run names code: files of Python, FMUs, programs.  Whatever loads such a
file says so here first (:func:`need_trust`).  It is run if the user named it himself (on the command line, in his
program), if it is shipped, or if the very same bytes were run before with his consent: their SHA-256 is in the file
``trusted`` of his settings.  Of anything else he is asked on a terminal, and without one it is refused.

While something is only looked at (:func:`without_code`), no code is run, whoever trusts it.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import data_folder
from cosim.base.storage.user import settings_folder
from cosim.base.wording import printable

ENVIRONMENT = "HEXJET_TRUST"  # set to 1, it says --trust to every command and program
REMEMBERED = "trusted"  # file in the settings folder: lines as sha256sum writes them
_SHIPPED = ("aircraft", "engines", "fmus", "scenarios", "studies")
_MOST_NAMED = 4  # files in a refusal
_HASH = re.compile(r"[0-9a-f]{64}")
_CODE = (".py", ".fmu")  # endings of files that are code by their names
_ENGINES = ("--engine", "--engine=")  # behind which a mapping file is an engine
_BETWEEN = re.compile(r"[\s\"'\[\],=]+")  # names on a command line, also within KEY=["NAME"]


class CodeRefusedError(InputError):
    """Code was not run: it is not trusted, or a command only displays what names it."""


@dataclass(frozen=True)
class Code:
    """A file that is to be run: where it is, and the SHA-256 of what is run of it.

    ``named_by``: what the user names when he means it, such as the mapping file of an FMU; nothing: the file itself.
    """

    path: Path
    sha256: str
    named_by: tuple[Path | str, ...] = ()
    arguments: str = ""  # arguments of a program, with the leading blank

    def __str__(self) -> str:
        """Return the file with its arguments in one line, with nothing in it that a terminal would obey."""
        return printable(f"{self.path}{self.arguments}").replace("\n", "\\n")


@dataclass(frozen=True)
class Decision:
    """What may be run in this process beside what is remembered: handed to the processes that work for it."""

    places: frozenset[Path] = frozenset()  # files and folders with all that is below them
    named: frozenset[Path | str] = frozenset()  # files, modules, programs with their arguments, by the user
    hashes: frozenset[str] = frozenset()  # what was accepted, or is made here
    by_program: bool = True  # a program names code when it changes a scenario; a command names it in its arguments


_hashes_by_file: dict[Path, tuple[tuple[int, int], frozenset[str]]] = {}  # hash by file, with the file's size and time
_decision = Decision()
_ask: Callable[[Sequence[Code]], bool] | None = None  # on a terminal
_code_forbidden: ContextVar[bool] = ContextVar("code_forbidden", default=False)


def code_of(path: Path, *named_by: Path | str, arguments: str = "") -> Code:
    """Return a file as code; ``arguments`` are part of what is run.  Raises InputError."""
    content = read_file(path) + (b"\0" + arguments.encode() if arguments else b"")
    return Code(path, hashlib.sha256(content).hexdigest(), named_by, arguments)


def need_trust(code: Iterable[Code], what: str) -> None:
    """Refuse code that nobody trusts, and remember what is run; on a terminal the user is asked.

    ``what`` wants to run it, in words.  Raises CodeRefusedError: one line with the files, and what to do.
    """
    files = list(code)
    if not files:
        return
    if _code_forbidden.get():
        names = _list_files(files)
        raise CodeRefusedError(f"{what}: {names}: is code, and nothing is run to look at something")
    unshipped = {file.sha256: file for file in files if not _is_shipped(file.path)}
    for sha256 in unshipped.keys() & _read_remembered():
        del unshipped[sha256]
    unknown = [file for file in unshipped.values() if not _is_accepted(file)]
    if unknown and not (_ask and _ask(unknown)):
        names = _list_files(unknown)
        how = "cosim.trust" if _decision.by_program else "--trust"
        raise CodeRefusedError(
            f"{what}: {names}: is code that you have not flown before; look at it, then {how} runs it and remembers it"
        )
    remember(unshipped.values())


def trust(*places: Path | str) -> None:
    """Accept the code in these files and folders, in this process and, once it was run, from then on.

    What a program names or hands over itself needs no such word; what a file names does, unless it was flown before.

    Parameters
    ----------
    *places : Path or str
        Files, and folders with all that is below them, now or later.

    Raises
    ------
    InputError
        For one that is not there.
    """
    for place in places:
        if not Path(place).exists():
            raise InputError(f"trust: {place}: is not there")
    _add(places=frozenset(Path(place).resolve() for place in places))


def mention(choices: Iterable[Path | str | None], folder: Path) -> None:
    """Take the code in these choices, with which a program changes a scenario, as named by the user.

    Files are seen from ``folder``; None is no choice.  A command has its arguments for that, and changes scenarios by
    what files say too.
    """
    if _decision.by_program:
        texts = [str(choice) for choice in choices if choice]
        _add(named=frozenset(name for text in texts for name in (*_names(text, folder), *_mapping(text, folder))))


def process_name(path: Path, arguments: str) -> str:
    """Return the name of a program with its arguments: with others it does something else."""
    return f"process:{path.resolve()}{arguments}"


def _names(text: str, folder: Path) -> Iterator[Path | str]:
    """Yield the code that a text names: files of Python and engines by path, programs, and what may be modules.

    What is data is never taken for code, whatever else names it.
    """
    for setting in (text, text.partition("=")[2]):
        if setting.startswith("process:"):
            program, blank, arguments = setting.removeprefix("process:").partition(" ")
            yield process_name(folder / program, blank + arguments)
    for chunk in (text, text.partition("=")[2], *_BETWEEN.split(text)):
        for word in (chunk, chunk.rpartition(":")[0]):
            if word.lower().endswith(_CODE):
                yield (folder / word).resolve()
            elif word:
                yield word


def _mapping(text: str, folder: Path) -> Iterator[Path]:
    """Yield the mapping file that a text names as an engine or a controller, which names its FMU."""
    for word in (text, text.partition("=")[2]):
        if word.lower().endswith(".toml"):
            yield (folder / word).resolve()


def _named_in(arguments: Sequence[str]) -> Iterator[Path | str]:
    """Yield the code that the arguments of a command name."""
    for before, text in zip(["", *arguments], arguments, strict=False):
        yield from _names(text, Path())
        engine = text.startswith(_ENGINES) or before in _ENGINES or arguments[0] in ("fmu", "identify")
        if engine or text.lower().endswith(".fmu.toml"):
            yield from _mapping(text.removeprefix("--engine="), Path())


def remember(code: Collection[Code]) -> None:
    """Note in the user's settings that this code is run; a folder that cannot be written to forgets it.

    What was made here is noted when it is made.
    """
    new = {entry.sha256: entry for entry in code}
    if not new:
        return
    _add(hashes=frozenset(new))
    known = _read_remembered()
    lines = [
        f"{sha256}  {replace(entry, path=entry.path.resolve())}\n"
        for sha256, entry in new.items()
        if sha256 not in known
    ]
    with suppress(OSError, RuntimeError):  # a user without a home has no settings
        if lines:
            file_path = settings_folder() / REMEMBERED
            file_path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(file_path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            try:
                os.write(
                    file, "".join(lines).encode(errors="replace")
                )  # in one write, safe against concurrent processes
            finally:
                os.close(file)


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
def at_a_command(ask: Callable[[Sequence[Code]], bool] | None, arguments: Sequence[str]) -> Iterator[None]:
    """Decide anew for one command: what its arguments name is the user's, and ``ask`` asks him of the rest."""
    global _ask, _decision
    before, previous = (_ask, _decision), os.environ.get(ENVIRONMENT)
    _ask, _decision = ask, Decision(by_program=False)
    try:
        _add(named=frozenset(_named_in(arguments)))
        yield
    finally:
        _ask, _decision = before
        os.environ.pop(ENVIRONMENT, None)
        if previous is not None:
            os.environ[ENVIRONMENT] = previous


def trust_everything() -> None:
    """Run whatever is named anywhere, and remember it; so do the processes that are started from now on."""
    os.environ[ENVIRONMENT] = "1"


def decision() -> Decision:
    """Return the decision made here, for a process that works for this one."""
    return _decision


def inherit(decided: Decision) -> None:
    """Run what the process runs for which this one works, and nothing that is named here."""
    global _decision
    _decision = replace(decided, by_program=False)


def _add(
    places: frozenset[Path] = frozenset(),
    named: frozenset[Path | str] = frozenset(),
    hashes: frozenset[str] = frozenset(),
) -> None:
    global _decision
    current = _decision
    _decision = replace(
        current, places=current.places | places, named=current.named | named, hashes=current.hashes | hashes
    )


@cache
def _shipped() -> list[Path]:
    return [data_folder(name).resolve() for name in _SHIPPED]


def _is_shipped(path: Path) -> bool:
    resolved = path.resolve()
    return any(resolved.is_relative_to(folder) for folder in _shipped())


def _is_accepted(file: Code) -> bool:
    if os.environ.get(ENVIRONMENT) == "1" or file.sha256 in _decision.hashes:
        return True
    path = file.path.resolve()
    itself = (path,) if path.name.lower().endswith(_CODE) else ()
    names = {name.resolve() if isinstance(name, Path) else name for name in file.named_by or itself}
    return bool(names & _decision.named) or any(place in _decision.places for place in (path, *path.parents))


def _read_remembered() -> frozenset[str]:
    """Return the hashes in the user's settings; a line that is no hash is skipped."""
    try:
        file = settings_folder() / REMEMBERED
        status = file.stat()
        stamp = status.st_size, status.st_mtime_ns
        if _hashes_by_file.get(file, (None,))[0] != stamp:
            lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
            _hashes_by_file[file] = stamp, frozenset(line[:64] for line in lines if _HASH.match(line))
    except (OSError, RuntimeError):
        return frozenset()
    return _hashes_by_file[file][1]


def _list_files(files: Sequence[Code]) -> str:
    rest = len(files) - _MOST_NAMED
    return ", ".join(map(str, files[:_MOST_NAMED])) + (f" and {rest} more" if rest > 0 else "")
