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

from cosim.base.storage.files import write_all

_LENGTH: Final = struct.Struct("<I")  # before a message
_CHUNK: Final = 65536  # bytes, read at once


class Pipes:
    """The two ends that belong to this process, by their file descriptors, which stay open until :meth:`close`.

    Where a read has a ``limit`` in s, it raises TimeoutError; None waits for ever.  EOFError says that the other
    process has closed its end, and OSError of a write that it has closed the other.
    """

    def __init__(self, reader: int, writer: int) -> None:
        self._reader, self._writer = reader, writer
        self._open: tuple[int, ...] = (reader, writer)
        self._poll = select.poll()
        self._poll.register(reader, select.POLLIN)
        self._rest = b""

    def send(self, data: bytes) -> None:
        """Write all of ``data``."""
        write_all(self._writer, data)

    def close(self) -> None:
        """Close both ends; may be called twice.  Only for who opened them by their numbers."""
        numbers, self._open = self._open, ()
        for number in numbers:
            os.close(number)

    def receive(self, count: int, limit: float | None = None) -> bytes:
        """Read ``count`` bytes."""
        return self._take(count, _deadline(limit))

    def receive_line(self, max_bytes: int, limit: float) -> bytes:
        """Read a line and return it without its end.  Raises ValueError where it has more than ``max_bytes`` bytes."""
        end = _deadline(limit)
        while b"\n" not in self._rest:
            if len(self._rest) > max_bytes:
                raise ValueError("the line does not end")
            self._rest += self._read(end)
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def send_message(self, data: bytes) -> None:
        """Write bytes that :meth:`receive_message` at the other end returns as they are."""
        self.send(_LENGTH.pack(len(data)) + data)

    def receive_message(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read what the other end sent as one message.  Raises ValueError above ``max_bytes`` bytes."""
        end = _deadline(limit)
        (length,) = _LENGTH.unpack(self._take(_LENGTH.size, end))
        if length > max_bytes:
            raise ValueError(f"a message of {length} bytes: at most {max_bytes}")
        return self._take(length, end)

    def _take(self, count: int, end: float | None) -> bytes:
        """Return the next ``count`` bytes; what has come beyond them stays for the next call."""
        parts, size = [self._rest], len(self._rest)
        while size < count:
            parts.append(self._read(end))
            size += len(parts[-1])
        data = b"".join(parts)
        self._rest = data[count:]
        return data[:count]

    def _read(self, end: float | None) -> bytes:
        if end is not None and not self._poll.poll(max(0.0, end - monotonic()) * 1e3):
            raise TimeoutError
        data = os.read(self._reader, _CHUNK)
        if not data:
            raise EOFError
        return data


def _deadline(limit: float | None) -> float | None:
    return None if limit is None else monotonic() + limit
