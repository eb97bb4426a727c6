"""A bound on how long code of somebody else may take: a call that is past it is broken off, where that can be.

A thread looks now and then; a call that takes too long is interrupted by a signal, which ends a sleep and a loop of
Python.  Where flights are not flown by the main thread nothing can be interrupted: what took too long is found after.
"""

from __future__ import annotations

import signal
import threading
from time import monotonic
from types import FrameType

_LOOKS = 8  # in a limit


class LateError(Exception):
    """The call was broken off."""


class Deadline:
    """``limit`` s for each call; :meth:`close` gives the signal back."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self._begun: float | None = None
        self._ended = threading.Event()
        self._watcher: threading.Thread | None = None
        self._before: object = None

    def begin(self) -> float:
        """A call begins; :meth:`done` is told what this gives back."""
        if self._watcher is None:
            self._start()
        self._begun = begun = monotonic()
        return begun

    def done(self, begun: float) -> None:
        """The call that began then has ended.  Raises LateError where it took longer than the limit."""
        self._begun = None
        if monotonic() - begun > self.limit:
            raise LateError

    def drop(self) -> None:
        """The call has ended with an error of its own."""
        self._begun = None

    def close(self) -> None:
        """No call follows; may be called twice."""
        self._ended.set()
        self._begun, self._watcher = None, None
        if self._before is not None:
            signal.signal(signal.SIGUSR2, self._before)  # type: ignore[arg-type]
            self._before = None

    def _start(self) -> None:
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGUSR2) is signal.SIG_DFL:
            self._before = signal.signal(signal.SIGUSR2, self._interrupt)
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, args=(threading.get_ident(), self._ended), daemon=True)
        self._watcher.start()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        begun = self._begun
        if begun is not None and monotonic() - begun > self.limit:
            raise LateError

    def _watch(self, caller: int, ended: threading.Event) -> None:
        while not ended.wait(self.limit / _LOOKS):
            begun = self._begun
            if begun is not None and monotonic() - begun > self.limit and self._before is not None:
                signal.pthread_kill(caller, signal.SIGUSR2)
