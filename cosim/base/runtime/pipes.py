"""Two pipes to another process: what is asked on one is answered on the other, within a time limit.

A pipe with bare ``read`` and ``write`` is the quickest way between two processes that wait for each other: a third of
a ``multiprocessing.Connection``'s round trip, whose ``poll`` makes a selector each time.  Whoever waits looks for bytes
for a moment before it sleeps, because a processor that went idle takes several times a round trip to wake up.  While it
looks the other writes to a page of shared memory, where there is one (:mod:`cosim.base.runtime.page`), which takes a
third of the pipes' round trip.  Nothing is left over of a process that was killed, and its end is the end of the pipe.
"""

from __future__ import annotations

import os
import select
import struct
from time import monotonic
from typing import Final

from cosim.base.errors import InputError
from cosim.base.runtime.page import Page, take_page

_LENGTH: Final = struct.Struct("<I")  # before a message
_CHUNK: Final = 65536  # bytes, read at once
# For how long bytes are looked for before sleeping [s]; chosen by us.
QUESTION_S: Final = 2e-4  # until the next request: some control steps
ANSWER_S: Final = 5e-5  # until the answer to one: some exchanges, of the processor time of the thread that flies
_LOOK_WAITS: Final = 256  # a look in vain for so many waits, in the long run: at most 0.8 us of a processor a wait
_MOST_CREDIT: Final = 4 * _LOOK_WAITS
_EARNED: Final = 8  # by a look in time, which saves a sleep of some 30 us
_LONGEST_PAUSE_MS: Final = 64.0  # between looks at the page of who sleeps


class Pipes:
    """The two ends that belong to this process, by their file descriptors, which stay open until :meth:`close`.

    Where a call has a ``limit`` in s, it raises TimeoutError beyond it; None waits for ever.  EOFError says that the
    other process has closed its end, and OSError of a write that it has closed the other.

    Bytes are looked for during ``look_s`` s before the process sleeps.

    The end that is written to no longer blocks, as a full pipe would have no limit otherwise.  Where the process may
    run on one processor alone it never looks before it sleeps.  Where all are busy with something else, looks are in
    vain, or last as long as somebody else has the processor: each wait earns a credit, one with a look in time eight
    more, a look in vain costs 256 of them, one that lasts longer up to four times as many, and without 256 a wait
    sleeps at once.

    ``page`` is the one that the process at the other end has too; where these pipes came with one, it is found.

    Raises InputError where the system cannot wait for a pipe with a limit, as Windows.
    """

    def __init__(self, reader: int, writer: int, look_s: float = QUESTION_S, page: Page | None = None) -> None:
        require_poll()
        self._reader, self._writer = reader, writer
        self._open: tuple[int, ...] = (reader, writer)
        self._poll, self._writable = select.poll(), select.poll()
        self._poll.register(reader, select.POLLIN)
        self._writable.register(writer, select.POLLOUT)
        os.set_blocking(writer, False)
        self._rest = b""
        self._look_s = look_s
        self._spins = count_processors() > 1
        self._page = (page or take_page(reader, writer)) if self._spins else None  # who never looks needs none
        self._credit = _MOST_CREDIT
        self._is_announced = False  # to the other that the page is looked at, and nothing has come since

    def send(self, data: bytes, limit: float | None = None) -> None:
        """Write all of ``data``."""
        self._send(data, _deadline(limit))

    def close(self) -> None:
        """Close both ends; may be called twice.  Only for who opened them by their numbers."""
        numbers, self._open, self._page = self._open, (), None
        for number in numbers:
            os.close(number)

    def receive(self, count: int, limit: float | None = None) -> bytes:
        """Read ``count`` bytes."""
        return self._take(count, _deadline(limit))

    def exchange(self, data: bytes, count: int, limit: float | None = None) -> bytes:
        """Write all of ``data`` and read ``count`` bytes, both within the limit."""
        end = _deadline(limit)
        self._send(data, end)
        return self._take(count, end)

    def receive_line(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read a line and return it without its end.  Raises ValueError where it has more than ``max_bytes`` bytes."""
        end = _deadline(limit)
        while b"\n" not in self._rest:
            if len(self._rest) > max_bytes:
                raise ValueError("the line does not end")
            self._rest += self._read(end)
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def send_message(self, data: bytes, limit: float | None = None) -> None:
        """Write bytes that :meth:`receive_message` at the other end returns as they are."""
        self.send(_LENGTH.pack(len(data)) + data, limit)

    def receive_message(self, max_bytes: int, limit: float | None = None) -> bytes:
        """Read what the other end sent as one message.  Raises ValueError above ``max_bytes`` bytes."""
        return self._take_message(max_bytes, _deadline(limit))

    def exchange_message(self, data: bytes, max_bytes: int, limit: float | None = None) -> bytes:
        """Write a message and read the one that answers it, both within the limit; as :meth:`receive_message`."""
        end = _deadline(limit)
        self._send(_LENGTH.pack(len(data)) + data, end)
        return self._take_message(max_bytes, end)

    def _take_message(self, max_bytes: int, end: float | None) -> bytes:
        if not self._rest:
            self._rest = data = self._read(end)
            size = len(data) - _LENGTH.size
            if size >= 0 and _LENGTH.unpack_from(data)[0] == size <= max_bytes:  # alone, as a rule
                self._rest = b""
                return data[_LENGTH.size :]
        (length,) = _LENGTH.unpack(self._take(_LENGTH.size, end))
        if length > max_bytes:
            raise ValueError(f"a message of {length} bytes: at most {max_bytes}")
        return self._take(length, end)

    def _take(self, count: int, end: float | None) -> bytes:
        """Return the next ``count`` bytes; what has come beyond them stays for the next call."""
        data = self._rest
        if count and not data:
            data = self._read(end)
            if len(data) == count:  # as a rule
                return data
        parts, size = [data], len(data)
        while size < count:
            parts.append(self._read(end))
            size += len(parts[-1])
        if len(parts) > 1:
            data = b"".join(parts)
        self._rest = data[count:]
        return data[:count]

    def _read(self, end: float | None) -> bytes:
        found, page = self._spins and self._look(end), self._page
        if page is not None and (found or self._is_announced):
            if record := page.take() or (b"" if found else self._sleep_beside(page, end)):
                self._is_announced = False
                return record
        elif not found and end is not None:
            _sleep(self._poll, end)
        data = os.read(self._reader, _CHUNK)
        if page is not None:
            record = page.take()  # was written before all that came by the pipe now
            page.count_taken(len(data))
            self._is_announced, data = False, record + data
        if not data:
            raise EOFError
        return data

    def _sleep_beside(self, page: Page, end: float | None) -> bytes:
        """Wait until something has come by the pipe, or return what the page has.  Raises TimeoutError.

        Nobody writes to the page any more, but the other may have begun to when it was still looked at.
        """
        pause_ms = 1.0
        while True:
            left_ms = pause_ms if end is None else min(pause_ms, max(0.0, end - monotonic()) * 1e3)
            if self._poll.poll(left_ms):
                return b""
            if record := page.take():
                return record
            if end is not None and monotonic() >= end:
                raise TimeoutError
            pause_ms = min(2.0 * pause_ms, _LONGEST_PAUSE_MS)

    def _look(self, end: float | None) -> bool:
        """Return whether bytes, or the end of them, have come within a moment; False at once where that is no use."""
        if self._credit < _MOST_CREDIT:
            self._credit += 1
        if self._credit < _LOOK_WAITS:
            return False
        begun = monotonic()
        stop = begun + self._look_s
        if end is not None and end < stop:
            stop = end
        poll, page = self._poll.poll, self._page
        if page is None:
            while not (found := bool(poll(0))) and monotonic() <= stop:
                pass
        else:
            self._is_announced = True
            while not (found := page.look() or bool(poll(0))) and monotonic() <= stop:
                pass
            page.rest()
        now = monotonic()
        if now > stop:  # in vain, or others had the processor meanwhile
            self._credit -= min(int(_LOOK_WAITS * (now - begun) / self._look_s), _MOST_CREDIT)
        else:
            self._credit = min(self._credit + _EARNED, _MOST_CREDIT)
        return found

    def _send(self, data: bytes, end: float | None) -> None:
        if self._page is not None and self._page.put(data):
            return
        rest: bytes | memoryview = data
        while True:
            try:
                written = os.write(self._writer, rest)
            except BlockingIOError:
                written = 0
                _sleep(self._writable, end)
            if written == len(rest):
                return
            rest = memoryview(rest)[written:]


def require_poll() -> None:
    """Raise InputError where the system cannot wait for a pipe with a time limit."""
    if not hasattr(select, "poll"):
        raise InputError("an exchange with another process needs pipes with poll(), which this system does not have")


def count_processors() -> int:
    """Return the number of processors that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _sleep(poll: select.poll, end: float | None) -> None:
    """Wait until something is there.  Raises TimeoutError."""
    if not poll.poll(None if end is None else max(0.0, end - monotonic()) * 1e3):
        raise TimeoutError


def _deadline(limit: float | None) -> float | None:
    return None if limit is None else monotonic() + limit
