"""Interleaved timing: every measurement stands between two of the unit, so that a busy machine slows down both."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Action = Callable[[], object]


class Clocked(NamedTuple):
    """Seconds a step: wall time, and processor time, which excludes other processes.

    ``cpu`` is of this thread, ``process`` of all threads that the job may have.
    """

    wall: float
    cpu: float
    process: float


class Pair(NamedTuple):
    """Cost of a step in one round, and cost of the unit before and after it."""

    step: Clocked
    unit: Clocked


@dataclass(frozen=True)
class Job:
    """Something to time: ``prepare()``, not timed, returns the action, which does ``steps`` steps.

    ``substeps``: JSBSim runs a step of the flight that it is part of, and so which unit it is compared with.
    """

    name: str
    substeps: int
    steps: int
    prepare: Callable[[], Action]


@dataclass(frozen=True)
class Spread:
    """Median, quartiles and least of ``repeats`` measured values."""

    median: float
    low: float
    high: float
    least: float
    repeats: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of at least one value."""
        low, median, high = (float(v) for v in np.percentile(values, (25.0, 50.0, 75.0)))
        return cls(median, low, high, min(values), len(values))

    def times(self, factor: float) -> Spread:
        """Return the spread of the values times ``factor``, which is positive."""
        median, low, high, least = (factor * value for value in (self.median, self.low, self.high, self.least))
        return Spread(median, low, high, least, self.repeats)


@dataclass(frozen=True)
class Cost:
    """Cost of one step: microseconds, and units of the same round, in processor time and in wall time.

    ``units`` is of this thread, ``units_process`` of all threads against the unit's one.

    No ratio of the least step to the least unit: a short job finds a quiet moment sooner than a long one.
    """

    wall_us: Spread
    cpu_us: Spread
    units: Spread
    units_wall: Spread
    units_process: Spread

    @classmethod
    def of(cls, pairs: Sequence[Pair], less: int = 0) -> Cost:
        """Return the cost from its rounds, with ``less`` units taken off in each."""
        return cls(
            wall_us=Spread.of([1e6 * (step.wall - less * unit.wall) for step, unit in pairs]),
            cpu_us=Spread.of([1e6 * (step.cpu - less * unit.cpu) for step, unit in pairs]),
            units=Spread.of([step.cpu / unit.cpu - less for step, unit in pairs]),
            units_wall=Spread.of([step.wall / unit.wall - less for step, unit in pairs]),
            units_process=Spread.of([step.process / unit.process - less for step, unit in pairs]),
        )


def clock(job: Job) -> Clocked:
    """Prepare a job and time it."""
    action = job.prepare()
    gc.collect()  # outside the timed part
    wall, process, cpu = time.perf_counter(), time.process_time(), time.thread_time()
    action()
    cpu, process, wall = time.thread_time() - cpu, time.process_time() - process, time.perf_counter() - wall
    return Clocked(wall / job.steps, cpu / job.steps, process / job.steps)


def interleave(jobs: Sequence[Job], units: Mapping[int, Job], rounds: int) -> Iterator[tuple[Job, Pair]]:
    """Time every job once a round, with its unit before and after; rounds alternate in direction."""
    for number in range(rounds):
        for job in jobs if number % 2 == 0 else reversed(jobs):
            before = clock(units[job.substeps])
            step = clock(job)
            after = clock(units[job.substeps])
            wall, cpu, process = (0.5 * (a + b) for a, b in zip(before, after, strict=True))
            yield job, Pair(step, Clocked(wall, cpu, process))


def ratio(pairs: Sequence[Pair], reference: Sequence[Pair]) -> Spread:
    """Return a step's units over those of the reference, round by round."""
    return Spread.of(
        [
            (one.step.cpu / one.unit.cpu) / (other.step.cpu / other.unit.cpu)
            for one, other in zip(pairs, reference, strict=True)
        ]
    )
