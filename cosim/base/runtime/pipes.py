"""Two pipes to another process: what is asked on one is answered on the other, within a time limit.

A pipe with bare ``read`` and ``write`` is the quickest way between two processes that wait for each other: a third of
a ``multiprocessing.Connection``'s round trip, whose ``poll`` makes a selector each time.
"""

from __future__ import annotations

import os
import select
import struct
from time import monotonic
from typing import Final

_LENGTH: Final = struct.Struct("<I")  # before a message
_CHUNK: Final = 65536  # bytes, read at once


class Pipes:
    """The file descriptors of the two ends that belong to this process; it does not own them.

    Where a read has a ``limit`` in s, it raises TimeoutError; None waits for ever.  EOFError says that the other
    process has closed its end, and OSError of a write that it has closed the other.
    """

    def __init__(self, reader: int, writer: int) -> None:
        self._reader, self._writer = reader, writer
        self._poll = select.poll()
        self._poll.register(reader, select.POLLIN)
        self._rest = b""

    def send(self, data: bytes) -> None:
        """Write all of ``data``."""
        count = os.write(self._writer, data)
        if count < len(data):
            view = memoryview(data)[count:]
            while view:
                view = view[os.write(self._writer, view) :]

    def receive(self, count: int, limit: float | None = None) -> bytes:
        """Read ``count`` bytes."""
        data = self._rest or self._read(limit)
        if len(data) == count:
            self._rest = b""
            return data
        if len(data) < count:
            end = None if limit is None else monotonic() + limit
            parts = [data]
            size = len(data)
            while size < count:
                parts.append(self._read(None if end is None else max(0.0, end - monotonic())))
                size += len(parts[-1])
            data = b"".join(parts)
        self._rest = data[count:]
        return data[:count]

    def receive_line(self, max_bytes: int, limit: float) -> bytes:
        """Read a line and return it without its end.  Raises ValueError where it has more than ``max_bytes`` bytes."""
        end = monotonic() + limit
        while b"\n" not in self._rest:
            if len(self._rest) > max_bytes:
                raise ValueError("the line does not end")
            self._rest += self._read(max(0.0, end - monotonic()))
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def send_message(self, data: bytes) -> None:
        """Write bytes that :meth:`receive_message` at the other end returns as they are."""
        self.send(_LENGTH.pack(len(data)) + data)

    def receive_message(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read what the other end sent as one message.  Raises ValueError above ``max_bytes`` bytes."""
        head = _LENGTH.size
        self._rest = data = self._rest or self._read(limit)
        if len(data) >= head:
            (length,) = _LENGTH.unpack_from(data)
            if len(data) == head + length and length <= max_bytes:  # as nearly always
                self._rest = b""
                return data[head:]
        (length,) = _LENGTH.unpack(self.receive(head, limit))
        if length > max_bytes:
            raise ValueError(f"a message of {length} bytes: at most {max_bytes}")
        return self.receive(length, limit) if length else b""

    def _read(self, limit: float | None) -> bytes:
        if limit is not None and not self._poll.poll(limit * 1e3):
            raise TimeoutError
        data = os.read(self._reader, _CHUNK)
        if not data:
            raise EOFError
        return data
