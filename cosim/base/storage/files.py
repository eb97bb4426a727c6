"""Files that are whole or not there, and locks that go when their process goes."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict
from errno import EINVAL
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError


@contextmanager
def replace_on_success(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside ``path`` that replaces it on success and is removed on failure.

    A device or a pipe of that name is yielded itself, and stays what it is; raises OSError where a link leads to one.
    """
    if _is_special(path):
        if path.is_symlink():
            raise OSError(EINVAL, "is a link to a device or a pipe; name an ordinary file")
        yield path
        return
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with suppress(OSError):
        temporary.unlink()  # the name may be a link to another file
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink()


def _is_special(path: Path) -> bool:
    """Return whether a path exists and is neither an ordinary file nor a folder."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def open_without_links(path: str | Path, flags: int) -> int:
    """Open a file for writing without following links, which a foreign folder may contain; an opener for ``open``."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0), 0o666)


def read_file(path: Path, max_mb: float = 256.0, first: int = -1) -> bytes:
    """Return the content of a file that may be a device or a pipe, or its ``first`` bytes.

    What lies there may be a pipe that nobody writes to or a device without an end: neither is waited for or read.
    Raises InputError with file and reason in a line for what is no regular file, or larger than ``max_mb`` (of 2**20
    bytes): scenarios, summaries, journals and engines stay below some tens.
    """
    try:
        with open(path, "rb", opener=_open_nonblocking) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"{path}: is a device or a pipe; an ordinary file is needed")
            if status.st_size > max_mb * 2**20:
                raise InputError(f"{path}: has {status.st_size / 2**20:.0f} MB; allowed: at most {max_mb:g}")
            return file.read(first)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a name may contain a NUL character
        raise InputError(f"{path}: {one_line(error)}") from error


def _open_nonblocking(path: str | Path, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_text(path: Path, encoding: str = "utf-8") -> str:
    """Return the text of a file, with its line ends as ``\\n``.  Raises InputError with file and reason in a line."""
    try:
        text = read_file(path).decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text file (byte {error.start})") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.  Raises InputError as :func:`read_file` and :func:`parse_json` do."""
    return parse_json(read_file(path), str(path))


def parse_json(text: str | bytes, where: str, finite: bool = True) -> Any:
    """Return the content of a text in JSON.

    Raises InputError, in a line with ``where``, for what is no JSON, is nested too deep and, unless ``finite`` is off,
    for NaN and infinities.
    """
    try:
        return json.loads(text, **(_FINITE_ONLY if finite else {}))
    except RecursionError as error:
        raise InputError(f"{where}: not JSON (nested too deep)") from error
    except ValueError as error:
        raise InputError(f"{where}: not JSON ({one_line(error)})") from error


def _refuse_nan(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _parse_finite(digits: str) -> float:
    number = float(digits)
    return number if isfinite(number) else _refuse_nan(digits[:40])


_FINITE_ONLY: dict[str, Any] = {"parse_constant": _refuse_nan, "parse_float": _parse_finite}  # options of json.loads


def write_all(file: int, data: bytes) -> None:
    """Write all data to a file descriptor, in parts if need be.  Raises OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(file, rest) :]


def write_whole(path: Path, content: str | bytes | Iterator[str], failure: type[Exception] | None = None) -> None:
    """Write a file completely or leave it unchanged; ``content`` may be an iterator of pieces.

    Raises OSError, or ``failure`` with file and reason in a line.

    >>> path = Path("limits.txt")
    >>> write_whole(path, b"5 deg")
    >>> read_text(path)
    '5 deg'
    """
    with map_os_errors(failure, path) if failure else nullcontext(), replace_on_success(path) as temporary:
        pieces = [content] if isinstance(content, (str, bytes)) else content
        with temporary.open("wb") as file:
            file.writelines(piece.encode() if isinstance(piece, str) else piece for piece in pieces)


def write_if_possible(path: Path, text: str) -> None:
    """Write a file and its folders, for a cache; do nothing if that is not possible."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)


@contextmanager
def map_os_errors(failure: type[Exception], path: Path | str) -> Iterator[None]:
    """Raise ``failure``, with path and reason in one line, in place of an OSError."""
    try:
        yield
    except OSError as error:
        raise failure(f"{path}: {one_line(error)}") from error


def check_results_folder(out: Path | str | None, record: str, *files: str) -> None:
    """Raise InputError if ``out`` has files that would be overwritten and were not written by an earlier call.

    An earlier call has left its ``record``, in JSON an object.  A file as ``out`` is refused too; None writes nothing.
    """
    if out is None:
        return
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder as out")
    present = [name for name in (*files, record) if os.path.lexists(folder / name)]
    if present and not holds_record(folder / record):
        raise InputError(
            f"{folder / present[0]}: is there already, and no {record} beside it says that it is of an earlier call; "
            "name another folder as out"
        )


def holds_record(path: Path) -> bool:
    """Return whether a command's record exists, the file that it writes into each results folder."""
    try:
        return isinstance(read_json(path), dict) if path.suffix == ".json" else path.is_file()
    except (OSError, InputError):
        return False


def write_files(files: Mapping[Path, str | bytes]) -> None:
    """Write several files, in folders that are made if need be.  Raises FlightError."""
    for path, content in files.items():
        with map_os_errors(FlightError, path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content, FlightError)


def to_json_record(record: Any) -> dict[str, Any]:
    """Return a dataclass as a table for JSON, with None for numbers that are not finite."""
    values = asdict(record)
    return {name: None if isinstance(x, float) and not isfinite(x) else x for name, x in values.items()}


@contextmanager
def lock_file(path: Path, busy: str) -> Iterator[None]:
    """Hold the lock of a file.  Raises InputError with ``busy`` if another process holds it."""
    try:
        file = os.open(path, os.O_RDWR)
    except OSError as error:
        raise InputError(f"{path}: {one_line(error)}") from error
    try:
        if try_lock(file) is False:
            raise InputError(busy)
        yield
    finally:
        os.close(file)


def try_lock(file: int) -> bool | None:
    """Try to lock a file until the process ends; None: the system has no locks.

    Return False if another holds it, None where there are no locks: on a file system or a machine without them.
    """
    try:
        import portalocker
    except ImportError:
        return None
    try:
        portalocker.lock(file, portalocker.LockFlags.EXCLUSIVE | portalocker.LockFlags.NON_BLOCKING)
    except portalocker.AlreadyLocked:
        return False
    except portalocker.LockException:
        return None
    return True


def one_line(error: BaseException) -> str:
    """Describe an error in one line; for a failed system call, by the system's text."""
    text = getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]
    return str(text).rpartition("Detail: [errno ")[2].rpartition("] ")[2] if "Detail: [errno " in text else str(text)
