"""Two pipes to another process: what is asked on one is answered on the other, within a time limit.

A pipe with bare ``read`` and ``write`` is the quickest way between two processes that wait for each other: a third of
a ``multiprocessing.Connection``'s round trip, whose ``poll`` makes a selector each time.  Nothing is left over of a
process that was killed, and its end is the end of the pipe.
"""

from __future__ import annotations

import os
import select
import struct
from collections.abc import Callable
from time import monotonic
from typing import Final

from cosim.base.errors import InputError

_LENGTH_PREFIX: Final = struct.Struct("<I")  # length before each message
# Interval between calls of ``watch`` while nothing arrives.
_WATCH_INTERVAL_S: Final = 0.25


class Pipes:
    """The two pipe ends of this process, given by file descriptors that stay open until :meth:`close`.

    Where a call has a ``limit`` in s, it raises TimeoutError beyond it; None waits for ever.  EOFError says that the
    other process has closed its end, and OSError of a write that it has closed the other.

    The end that is written to no longer blocks, as a full pipe would have no limit otherwise.

    Raises InputError where the system cannot wait for a pipe with a limit, as Windows.
    """

    def __init__(self, reader: int, writer: int) -> None:
        require_poll()
        self._reader, self._writer = reader, writer
        self._open: tuple[int, ...] = (reader, writer)
        self._poll, self._writable = select.poll(), select.poll()
        self._poll.register(reader, select.POLLIN)
        self._writable.register(writer, select.POLLOUT)
        os.set_blocking(writer, False)
        self._rest = b""
        self.watch: Callable[[], None] = lambda: None  # called while waiting for an answer

    def send(self, data: bytes, limit: float | None = None) -> None:
        """Write all of ``data`` within ``limit`` s."""
        self._write_all(data, _compute_deadline(limit))

    def close(self) -> None:
        """Close both ends; may be called twice.  Only the opener of the file descriptors calls it."""
        numbers, self._open = self._open, ()
        for number in numbers:
            os.close(number)

    def receive(self, count: int, limit: float | None = None) -> bytes:
        """Read ``count`` bytes within ``limit`` s."""
        return self._read_exactly(count, _compute_deadline(limit))

    def exchange(self, data: bytes, count: int, limit: float | None = None) -> bytes:
        """Write all of ``data`` and read ``count`` bytes, both within the limit."""
        end = _compute_deadline(limit)
        self._write_all(data, end)
        return self._read_exactly(count, end)

    def receive_line(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read a line and return it without its end.  Raises ValueError above ``max_bytes`` bytes."""
        end = _compute_deadline(limit)
        while b"\n" not in self._rest:
            if len(self._rest) > max_bytes:
                raise ValueError("the line does not end")
            self._rest += self._read_available(end)
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def send_message(self, data: bytes, limit: float | None = None) -> None:
        """Write bytes that :meth:`receive_message` at the other end returns unchanged."""
        self.send(_LENGTH_PREFIX.pack(len(data)) + data, limit)

    def receive_message(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read one message from the other end.  Raises ValueError above ``max_bytes`` bytes."""
        return self._read_message(max_bytes, _compute_deadline(limit))

    def exchange_message(self, data: bytes, max_bytes: int, limit: float | None = None) -> bytes:
        """Send a message and receive the answer within one limit, as :meth:`receive_message`."""
        end = _compute_deadline(limit)
        self._write_all(_LENGTH_PREFIX.pack(len(data)) + data, end)
        return self._read_message(max_bytes, end)

    def _read_message(self, max_bytes: int, end: float | None) -> bytes:
        if not self._rest:
            self._rest = data = self._read_available(end)
            size = len(data) - _LENGTH_PREFIX.size
            if size >= 0 and _LENGTH_PREFIX.unpack_from(data)[0] == size <= max_bytes:  # often one read, one message
                self._rest = b""
                return data[_LENGTH_PREFIX.size :]
        (length,) = _LENGTH_PREFIX.unpack(self._read_exactly(_LENGTH_PREFIX.size, end))
        if length > max_bytes:
            raise ValueError(f"a message of {length} bytes: at most {max_bytes}")
        return self._read_exactly(length, end)

    def _read_exactly(self, count: int, end: float | None) -> bytes:
        """Return the next ``count`` bytes and keep the rest for the next call."""
        data = self._rest
        if count and not data:
            data = self._read_available(end)
            if len(data) == count:  # usually one read gets all bytes
                return data
        parts, size = [data], len(data)
        while size < count:
            parts.append(self._read_available(end))
            size += len(parts[-1])
        if len(parts) > 1:
            data = b"".join(parts)
        self._rest = data[count:]
        return data[:count]

    def _read_available(self, end: float | None, most: int = 65536) -> bytes:
        """Wait for the first byte, then return what is available, at most ``most`` bytes."""
        if end is not None:
            self._wait_until_ready(self._poll, end)
        data = os.read(self._reader, most)
        if not data:
            raise EOFError
        return data

    def _write_all(self, data: bytes, end: float | None) -> None:
        rest: bytes | memoryview = data
        while True:
            try:
                written = os.write(self._writer, rest)
            except BlockingIOError:
                written = 0
                self._wait_until_ready(self._writable, end)
            if written == len(rest):
                return
            rest = memoryview(rest)[written:]

    def _wait_until_ready(self, poll: select.poll, end: float | None) -> None:
        """Wait until a pipe is ready, calling ``watch`` meanwhile.  Raises TimeoutError after ``end``."""
        while True:
            left = _WATCH_INTERVAL_S if end is None else min(_WATCH_INTERVAL_S, end - monotonic())
            if poll.poll(1e3 * max(0.0, left)):
                return
            if left <= 0.0:
                raise TimeoutError
            self.watch()


def require_poll() -> None:
    """Raise InputError if the system cannot wait for a pipe with a time limit."""
    if not hasattr(select, "poll"):
        raise InputError("an exchange with another process needs pipes with poll(), which this system does not have")


def _compute_deadline(limit: float | None) -> float | None:
    return None if limit is None else monotonic() + limit
