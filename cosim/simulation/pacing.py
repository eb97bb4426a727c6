"""Keeping a flight in step with the clock on the wall."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

# Longest stall that is caught up, chosen by us: by stepping without pause, so that flight time follows the wall
# clock; after longer ones the schedule moves. Otherwise a ground station would see the vehicle race, and sticks and
# set-points would act a fifth of a second late.
MAX_CATCH_UP_S = 0.1  # s of wall time


class PaceReport(NamedTuple):
    """Timing of a flight against the wall clock."""

    factor: float | None = None  # real-time factor; None: unlimited
    steps: int = 0
    missed: int = 0  # steps not done when the next was due
    longest_delay: float = 0.0  # s, largest delay of a step
    stalls: int = 0  # number of moves of the schedule
    postponed: float = 0.0  # wall time of all moves, s
    reached_factor: float | None = None  # over the last second, or None
    load: float | None = None  # fraction of that second spent stepping


class Pace:
    """Paces a flight by the wall clock: step ``k`` begins no sooner than ``k dt / factor`` after the start.

    ``step``: dt [s].  ``factor``: of real time; None lets every step begin at once and only measures.  A deadline is
    missed when a step is not done at the time at which the next one is due.  ``clock`` [s] and ``sleep`` are for tests.
    ``missed``: deadlines missed since the start.
    """

    def __init__(
        self,
        step: float,
        factor: float | None,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._factor = factor
        self._dt = step
        self._step = step / factor if factor else 0.0
        self._clock, self._sleep = clock, sleep
        self.start(0)

    def start(self, k: int) -> None:
        """Set the due time of step ``k`` to the present."""
        self._origin = self._clock()
        self._first = k
        self._k = k
        self.missed = self._stalls = 0
        self._worst = self._lost = 0.0
        self._window_start = (self._origin, k)
        self._slept = 0.0
        self._reached: float | None = None
        self._load: float | None = None

    def wait(self, k: int) -> None:
        """Sleep until the step after ``k`` steps is due."""
        self._k = k
        now = self._clock()
        window_start, first_k = self._window_start
        # The real-time factor is measured over a second.
        if now - window_start >= 1.0:
            self._reached = (k - first_k) * self._dt / (now - window_start)
            self._load = 1.0 - min(1.0, self._slept / (now - window_start))
            self._window_start, self._slept = (now, k), 0.0
        if not self._step:
            return
        left = self._origin + (k - self._first) * self._step - now
        if left > 0.0:
            self._sleep(left)
            self._slept += left
            return
        if left < 0.0:
            self.missed += 1
            self._worst = max(self._worst, -left)
            if left < -MAX_CATCH_UP_S:
                self._origin -= left
                self._stalls += 1
                self._lost -= left

    @property
    def report(self) -> PaceReport:
        """Timing of the flight so far."""
        steps = self._k - self._first
        return PaceReport(
            self._factor, steps, self.missed, self._worst, self._stalls, self._lost, self._reached, self._load
        )
