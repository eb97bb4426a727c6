"""The folder for all temporary files of a process; it goes when the process ends.

There is one for all flights of a process, because on a disk that is busy it takes milliseconds to remove a folder.  A
process that is killed leaves its folder, which the next one removes: nobody holds its lock any more.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.files import one_line, try_lock

_FOLDER_PREFIX = "hexjet-scratch-"  # of temporary folders' names
_LOCK_NAME = "lock"  # file that its process keeps locked
_folders: dict[int, Path] = {}  # by process id: a fork needs its own


def scratch() -> Path:
    """Return this process's folder for temporary files.  Raises InputError if none can be made."""
    folder = _folders.get(os.getpid())
    if folder is None or not folder.is_dir():
        try:
            folder = _folders[os.getpid()] = _make_folder()
        except OSError as error:
            raise InputError(f"temporary files: {one_line(error)}; TMPDIR can name another folder for them") from error
    return folder


@contextmanager
def temporary(prefix: str) -> Iterator[Path]:
    """Yield a new folder below :func:`scratch`, deleted after the block or with the process.

    Raises InputError where there is no place for one.

    >>> with temporary("mine-") as folder:
    ...     folder.parent == scratch()
    True
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=scratch()))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _make_folder() -> Path:
    _remove_abandoned()
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_FOLDER_PREFIX))
        file = os.open(folder / _LOCK_NAME, os.O_RDWR | os.O_CREAT, 0o600)  # locked as long as the process lives
        if try_lock(file) is not False and (folder / _LOCK_NAME).exists():
            atexit.register(_remove_folder, os.getpid(), folder)
            return folder
        os.close(file)  # another process removed the folder


def _remove_abandoned() -> None:
    """Remove the folders of processes that were killed."""
    for file in Path(tempfile.gettempdir()).glob(f"{_FOLDER_PREFIX}*/{_LOCK_NAME}"):
        with suppress(OSError):  # another user's folder
            held = os.open(file, os.O_RDWR)
            try:
                if try_lock(held):
                    shutil.rmtree(file.parent, ignore_errors=True)
            finally:
                os.close(held)


def _remove_folder(process: int, folder: Path) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
