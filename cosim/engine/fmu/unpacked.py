"""Unpacked archives: each folder has one user at a time and is reused if its files are unchanged."""

from __future__ import annotations

import hashlib
import io
import os
import shutil
import tempfile
from ctypes import CDLL
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.scratch import scratch
from cosim.engine.fmu.archive import Archive, find_library
from cosim.engine.fmu.container import DAMAGE_ERRORS, UnusableError, Zip, read_bytes, to_one_line
from cosim.engine.library import platform_folder

_free: list[UnpackedArchive] = []  # most recently freed last


class UnpackedArchive:
    """Unpacked files of an archive that this machine needs, in the folder ``path`` until :meth:`close`."""

    def __init__(self, archive: Archive, data: bytes) -> None:
        self.sha256 = archive.sha256
        self.path = Path(tempfile.mkdtemp(prefix="engine-", dir=scratch()))
        self._library = self.path / find_library(archive)
        try:
            _extract_archive(archive, data, self.path)
        except BaseException:
            self.remove()
            raise
        self._contents = hash_files(self.path)

    @property
    def is_untouched(self) -> bool:
        """Whether the files are unchanged since unpacking and their library is not loaded in this process."""
        try:
            return not _is_loaded(self._library) and hash_files(self.path) == self._contents
        except OSError:
            return False

    def close(self, max_free: int = 16) -> None:
        """Release the folder for the next user.  ``max_free``: folders that wait for their next user."""
        _free.append(self)
        while len(_free) > max_free:
            _free.pop(0).remove()

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.close()


def _extract_archive(archive: Archive, data: bytes, folder: Path) -> None:
    with Zip(io.BytesIO(data)) as fmu:
        for name in fmu.namelist():
            if name.startswith((f"binaries/{platform_folder(archive.fmi)}/", "resources/")):
                fmu.extract(name, folder)


def unpack(archive: Archive) -> UnpackedArchive:
    """Unpack an archive's files for this machine into a private folder.

    Raises InputError if the archive has changed since it was read, or there is no space for its files.
    """
    try:
        data = read_bytes(archive.path)
        if hashlib.sha256(data).hexdigest() != archive.sha256:
            raise UnusableError("was changed while it was in use")
        return _take_free_folder(archive) or UnpackedArchive(archive, data)
    except InputError:  # There is no folder to unpack into.
        raise
    except UnusableError as reason:
        raise InputError(f"{archive.path}: {reason}") from reason
    except OSError as error:  # a file could not be written
        where = error.filename or tempfile.gettempdir()
        raise InputError(f"{archive.path}: cannot be unpacked: {where}: {error.strerror or error}") from error
    except DAMAGE_ERRORS as error:
        raise InputError(f"{archive.path}: is damaged: {to_one_line(error)}") from error


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of an unpacked archive by path; folders have an empty text."""
    members = {}
    for parent, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = os.path.join(parent, name)
            members[path] = hashlib.sha256(_read_bytes(path)).hexdigest() if os.path.isfile(path) else ""
    return members


def _read_bytes(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def _take_free_folder(archive: Archive) -> UnpackedArchive | None:
    """Return a free folder of the same archive made by this process, not by the one it was forked from."""
    own = [folder for folder in _free if folder.sha256 == archive.sha256 and folder.path.parent == scratch()]
    for folder in reversed(own):
        _free.remove(folder)
        if folder.is_untouched:
            return folder
        folder.remove()
    return None


def _is_loaded(library: Path) -> bool:
    """Return whether a library is still loaded: some cannot be unloaded and would keep their memory."""
    try:
        CDLL(str(library), mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
    except OSError:
        return False
    return True
