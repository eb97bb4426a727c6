"""What a sampler asks for: points, each flown with every seed and never twice, and whether a vehicle breaks there.

A sampler is a generator: it yields the flights that it asks for next and is told their rows
(:func:`cosim.studies.run_sampler`).  A generator that asks something else, such as the margins of coordinates, has its
questions answered by one that does.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, TypeVar

from cosim.base.errors import FlightError
from cosim.studies import EngineDraw, Flight, Row, Study, Value

A = TypeVar("A")  # type of an answer
R = TypeVar("R")  # what a search returns
Asking = Generator[list[Flight], Iterator[Row], R]  # generator of flights, is sent rows


@dataclass(frozen=True)
class Point:
    """A controller, and the values that are written over the scenario."""

    controller: str
    values: tuple[tuple[str, Value], ...]

    @classmethod
    def of(cls, controller: str, values: Mapping[str, Value]) -> Point:
        """Return the point with a controller and values by key, equal for any order of the keys."""
        return cls(controller, tuple(sorted(values.items())))


@dataclass(frozen=True)
class PointResult:
    """Outcome of a point's flights."""

    broken: int
    flights: int
    breaks: bool
    worst: Row  # row of the first failure, or the first


def count_needed(fraction: float, flights: int) -> int:
    """Return how many of a point's flights have to break before it does."""
    return max(1, ceil(fraction * flights - 1e-9))


class Prober:
    """Flights requested by a sampler, in order; ``rows`` has the row of each point and seed.

    A point is flown with all of ``seeds``.  It breaks if at least ``fraction`` of its flights do, and one in any case:
    where the flight does not end ``completed``, or misses what the study asks for.  All but the first seed bring a draw
    of an uncertain ``engine``.
    """

    def __init__(
        self, study: Study, seeds: Sequence[int], fraction: float = 0.0, engine: EngineDraw | None = None
    ) -> None:
        self.study = study
        self.seeds = tuple(seeds)
        self.needed = count_needed(fraction, len(self.seeds))
        self.rows: dict[tuple[Point, int], Row] = {}
        self._engine = engine

    @property
    def flights(self) -> int:
        """Number of requested flights."""
        return len(self.rows)

    def fly(self, keys: Sequence[tuple[Point, int]]) -> Asking[None]:
        """Request the flights of these points and seeds that are new.

        Raises FlightError where some were not flown.
        """
        new = dict(enumerate(dict.fromkeys(key for key in keys if key not in self.rows), len(self.rows)))
        rows = yield [self.flight(*key, number) for number, key in new.items()]
        flown = {int(row["flight"] or 0): row for row in rows}
        if len(flown) < len(new):
            raise FlightError(f"{len(new) - len(flown)} flights were not flown")
        self.rows |= {key: flown[number] for number, key in new.items()}

    def evaluate(self, points: Sequence[Point]) -> Asking[list[bool]]:
        """Return whether each point breaks."""
        yield from self.fly([(point, seed) for point in points for seed in self.seeds])
        return [self.result(point).breaks for point in points]

    def result(self, point: Point) -> PointResult:
        """Return the outcome of a point that was flown."""
        rows = [self.rows[point, seed] for seed in self.seeds]
        broken = [row for row in rows if not row["success"]]
        return PointResult(len(broken), len(rows), len(broken) >= self.needed, (broken or rows)[0])

    def flight(self, point: Point, seed: int, number: int = 0) -> Flight:
        drawn = self._engine if seed != self.seeds[0] else None
        engine = {} if drawn is None else drawn.draw_by_name(str(seed))
        return Flight(number, number // len(self.seeds), point.controller, seed, engine | dict(point.values))


def answer_by(steps: Generator[A, Any, R], evaluate: Callable[[A], Asking[Any]]) -> Asking[R]:
    """Run a generator whose requests another generator answers by flights; return its result."""
    answer = None
    while True:
        try:
            asked = steps.send(answer)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        answer = yield from evaluate(asked)


def answer_all(steps: Generator[A, Any, R], answer: Callable[[A], Any]) -> R:
    """Run a generator whose requests a function answers; return its result."""
    answered = None
    while True:
        try:
            asked = steps.send(answered)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        answered = answer(asked)
