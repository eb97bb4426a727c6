"""A page of memory that two processes share, for what one of them writes while the other looks for it.

It belongs to a pair of pipes (:mod:`cosim.base.runtime.pipes`) and is never needed: who does not look at the moment is
written to by the pipe, and so is who has no page.  It has no name, and goes with the processes that have it.

Each direction has one record: how many bytes of the stream were sent up to its end, up to which byte the reader has
taken the stream and looks for more, and the bytes.  They are written before the number that announces them, and other
processors see both in this order on x86 alone: elsewhere there is no page.
"""

from __future__ import annotations

import os
import platform
from mmap import mmap
from typing import Final

CAPACITY: Final = 4032  # bytes of a record; a step of a whole controller of eight jets has a fifth of it
SPINS: Final = 40  # looks in a row: some 2 us
ENVIRONMENT: Final = "HEXJET_PAGE"  # descriptor of the page; inodes of it and of the pipes that it is for
_SENT, _LOOKS = 0, 4  # places of the two numbers among those of 64 bits, in cache lines of their own
_ASLEEP: Final = 2**64 - 1  # in place of how far the reader has come
_HEAD: Final = 64  # bytes of both numbers
_SIZE: Final = _HEAD + CAPACITY  # of a direction
_MACHINES: Final = ("x86_64", "amd64")


class Page:
    """The memory as one of both processes has it: ``side`` is 0 where it was made, 1 where it was handed to.

    Raises OSError where ``number`` is no such memory.
    """

    def __init__(self, number: int, side: int) -> None:
        self._memory = mmap(number, 2 * _SIZE)
        numbers, words = memoryview(self._memory).cast("Q"), _SIZE // 8
        self._out, self._into = numbers[side * words :], numbers[(1 - side) * words :]
        self._out_data, self._into_data = side * _SIZE + _HEAD, (1 - side) * _SIZE + _HEAD
        self._sent = self._taken = 0  # bytes of the stream, through the pipe or here
        if side == 0:
            self._out[_LOOKS] = self._into[_LOOKS] = _ASLEEP

    def put(self, data: bytes) -> bool:
        """Count bytes as sent, and write them here; False where they are to go by the pipe."""
        place, size = self._sent, len(data)
        self._sent = place + size
        if self._out[_LOOKS] != place or size > CAPACITY:
            return False
        self._memory[self._out_data : self._out_data + size] = data
        self._out[_SENT] = place + size
        return True

    def look(self) -> bool:
        """Return whether bytes have come, after looking some times; until :meth:`rest` the other may write them."""
        into, taken = self._into, self._taken
        into[_LOOKS] = taken
        spins = SPINS
        while into[_SENT] <= taken and spins:
            spins -= 1
        return spins > 0

    def rest(self) -> None:
        """Look no more.  What the other had begun to write may still come, and is found by :meth:`take`."""
        self._into[_LOOKS] = _ASLEEP

    def take(self) -> bytes:
        """Return the bytes that have come here, or none."""
        place, sent = self._taken, self._into[_SENT]
        if sent <= place:
            return b""
        self._taken = sent
        return self._memory[self._into_data : self._into_data + min(sent - place, CAPACITY)]

    def count_taken(self, size: int) -> None:
        """Count bytes as taken that came by the pipe."""
        self._taken += size


def open_page() -> int | None:
    """Return the file descriptor of a page for this process and one that it starts; None where there can be none."""
    if not hasattr(os, "memfd_create") or platform.machine().lower() not in _MACHINES:
        return None
    import fcntl

    try:
        number = os.memfd_create("exchange", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    except OSError:
        return None
    try:
        os.ftruncate(number, 2 * _SIZE)
        # a page that the other cuts short would end this process
        fcntl.fcntl(number, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    except (OSError, AttributeError):  # a Python that was built on a system without them
        os.close(number)
        return None
    return number


def describe_page(number: int, reader: int, writer: int) -> dict[str, str]:
    """Return the environment variable by which the child that has these ends of two pipes finds the page."""
    return {ENVIRONMENT: " ".join(map(str, (number, *map(_inode, (number, reader, writer)))))}


def take_page(reader: int, writer: int) -> Page | None:
    """Return the page that was handed to this process for these ends of two pipes, once; else None.

    They are compared because a process may pass its environment on to others, which have other pipes.
    """
    try:
        number, *inodes = map(int, os.environ.get(ENVIRONMENT, "").split())
        if [*map(_inode, (number, reader, writer))] != inodes:
            return None
        page = Page(number, 1)
    except (ValueError, OSError):
        return None
    del os.environ[ENVIRONMENT]
    os.close(number)
    return page


def _inode(number: int) -> int:
    return os.fstat(number).st_ino
