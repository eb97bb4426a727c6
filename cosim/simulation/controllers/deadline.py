"""A limit on the time of calls to user-supplied code: a call beyond it is broken off where possible.

A thread checks the time; a call that takes too long is interrupted by a signal, which ends a sleep and a loop of
Python.  A process has one such signal, so all deadlines share its handler: several flights may be open.  Outside
the main thread nothing can be interrupted: a call that took too long is found when it returns.
"""

from __future__ import annotations

import signal
import threading
from time import monotonic
from types import FrameType

_CHECKS = 8  # checks within one time limit


class LateError(Exception):
    """The call was broken off."""


_ACTIVE: list[Deadline] = []  # deadlines whose calls the signal interrupts


def _interrupt(number: int, frame: FrameType | None) -> None:
    for deadline in _ACTIVE:
        if deadline.is_late:
            raise LateError


class Deadline:
    """``limit`` s for each call; :meth:`close` of the last one gives the signal back."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._started: float | None = None
        self._ended = threading.Event()
        self._watcher: threading.Thread | None = None

    def begin(self) -> float:
        """Start the clock of a call and return its start time [s], which :meth:`end` takes."""
        if self._watcher is None:
            self._start()
        self._started = started = monotonic()
        return started

    def end(self, started: float) -> None:
        """Stop the clock of the call that began then.  Raises LateError where it took longer than the limit."""
        self._started = None
        if monotonic() - started > self.limit:
            raise LateError

    def cancel(self) -> None:
        """Stop the clock of a call that ended with an error."""
        self._started = None

    def close(self) -> None:
        """Release the signal; no call follows.  May be called twice."""
        self._ended.set()
        self._started, self._watcher = None, None
        if self in _ACTIVE:
            _ACTIVE.remove(self)
            main = threading.current_thread() is threading.main_thread()
            if main and not _ACTIVE and signal.getsignal(signal.SIGUSR2) is _interrupt:
                signal.signal(signal.SIGUSR2, signal.SIG_DFL)

    @property
    def is_late(self) -> bool:
        """Whether a running call has taken longer than the limit."""
        started = self._started
        return started is not None and monotonic() - started > self.limit

    def _start(self) -> None:
        if threading.current_thread() is threading.main_thread():
            if signal.getsignal(signal.SIGUSR2) is signal.SIG_DFL:
                signal.signal(signal.SIGUSR2, _interrupt)
            if signal.getsignal(signal.SIGUSR2) is _interrupt:
                _ACTIVE.append(self)
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, args=(threading.get_ident(), self._ended), daemon=True)
        self._watcher.start()

    def _watch(self, caller: int, ended: threading.Event) -> None:
        while not ended.wait(self.limit / _CHECKS):
            if self.is_late and self in _ACTIVE:
                signal.pthread_kill(caller, signal.SIGUSR2)
