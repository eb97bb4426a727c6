"""A bound on how long code of somebody else may take: a call that is past it is broken off, where that can be.

A thread looks now and then; a call that takes too long is interrupted by a signal, which ends a sleep and a loop of
Python.  The signal is one for the process, so all deadlines share what answers it: one flight may be open beside
another, or left open.  Where flights are not flown by the main thread nothing can be interrupted: what took too long is
found after.
"""

from __future__ import annotations

import signal
import threading
from time import monotonic
from types import FrameType

_LOOKS = 8  # in a limit


class LateError(Exception):
    """The call was broken off."""


_OPEN: list[Deadline] = []  # those that the signal breaks off, while they have it


def _interrupt(number: int, frame: FrameType | None) -> None:
    for each in _OPEN:
        if each.late:
            raise LateError


class Deadline:
    """``limit`` s for each call; :meth:`close` of the last one gives the signal back."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._begun: float | None = None
        self._ended = threading.Event()
        self._watcher: threading.Thread | None = None

    def begin(self) -> float:
        """Start the clock of a call and return its start time [s], which :meth:`done` takes."""
        if self._watcher is None:
            self._start()
        self._begun = begun = monotonic()
        return begun

    def done(self, begun: float) -> None:
        """Stop the clock of the call that began then.  Raises LateError where it took longer than the limit."""
        self._begun = None
        if monotonic() - begun > self.limit:
            raise LateError

    def drop(self) -> None:
        """Stop the clock of a call that ended with an error."""
        self._begun = None

    def close(self) -> None:
        """Release the signal; no call follows.  May be called twice."""
        self._ended.set()
        self._begun, self._watcher = None, None
        if self in _OPEN:
            _OPEN.remove(self)
            main = threading.current_thread() is threading.main_thread()
            if main and not _OPEN and signal.getsignal(signal.SIGUSR2) is _interrupt:
                signal.signal(signal.SIGUSR2, signal.SIG_DFL)

    @property
    def late(self) -> bool:
        """Whether a running call has taken longer than the limit."""
        begun = self._begun
        return begun is not None and monotonic() - begun > self.limit

    def _start(self) -> None:
        if threading.current_thread() is threading.main_thread():
            if signal.getsignal(signal.SIGUSR2) is signal.SIG_DFL:
                signal.signal(signal.SIGUSR2, _interrupt)
            if signal.getsignal(signal.SIGUSR2) is _interrupt:
                _OPEN.append(self)
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, args=(threading.get_ident(), self._ended), daemon=True)
        self._watcher.start()

    def _watch(self, caller: int, ended: threading.Event) -> None:
        while not ended.wait(self.limit / _LOOKS):
            if self.late and self in _OPEN:
                signal.pthread_kill(caller, signal.SIGUSR2)
