"""A file that grows by whole pieces, each handed to the system as it comes: a process that is killed loses none."""

from __future__ import annotations

import os
from pathlib import Path

from cosim.base.errors import FlightError
from cosim.base.storage.files import map_os_errors, one_line, open_without_links, write_all


class AppendedFile:
    """File to append to; ``how`` are flags of ``os.open``, ``number`` is the file descriptor.

    Raises OSError if it cannot be opened.
    """

    def __init__(self, path: Path, how: int) -> None:
        self.path = path
        self.number = open_without_links(path, how)

    def append(self, *pieces: bytes | memoryview) -> None:
        """Append all pieces, or none of them and raise FlightError."""
        size, before = sum(map(len, pieces)), os.fstat(self.number).st_size
        try:
            written = os.writev(self.number, pieces) if hasattr(os, "writev") else 0
            if written < size:
                write_all(self.number, b"".join(pieces)[written:])
        except OSError as error:
            os.ftruncate(self.number, before)  # a partial record would hide the next one
            raise FlightError(f"{self.path}: {one_line(error)}") from error

    def sync(self) -> None:
        """Write the file's data to the disk.  Raises FlightError."""
        with map_os_errors(FlightError, self.path):
            os.fsync(self.number)

    def close(self) -> None:
        """Close the file and release its lock; may be called twice."""
        if self.number >= 0:
            os.close(self.number)
            self.number = -1
