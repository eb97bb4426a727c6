"""A yes or no along a line: looked at from its start outwards on a grid, then bisected where it changes first.

Nothing here knows of flights.  A walk is a generator: it yields the places it asks for, and is told whether each of
them breaks.  Many walks go side by side, so that what they ask for at one time can be flown at one time.

Bisection alone would not do: stability is not monotonic.  With a delay it may be lost and come back, and what lies
between start and end would never be looked at.  And it needs no slope: of a flight that ends early there is none.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

Walk = Generator[Sequence[float], Sequence[bool], "Scan"]
Between = Callable[[float, float], float | None]
Name = TypeVar("Name", bound=Hashable)
Asked = TypeVar("Asked")
Answer = TypeVar("Answer")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Scan:
    """Result of one line search: all evaluated positions from the start, and whether each fails."""

    positions: tuple[float, ...]
    breaks: tuple[bool, ...]
    change: tuple[float, float] | None  # last like the start, first unlike it

    @property
    def start_breaks(self) -> bool:
        return self.breaks[0]

    @property
    def bands(self) -> list[tuple[float, float, bool]]:
        """Ranges of equal result: first and last position, and whether it fails."""
        bands: list[tuple[float, float, bool]] = []
        for position, broken in zip(self.positions, self.breaks, strict=True):
            if bands and bands[-1][2] == broken:
                bands[-1] = (bands[-1][0], position, broken)
            else:
                bands.append((position, position, broken))
        return bands


def scan_outward(positions: Sequence[float], between: Between, at_once: int | None = None) -> Walk:
    """Evaluate ``positions``, the start first, and bisect the first change.

    ``between(a, b)`` is the next position to evaluate between two, None where they are close enough.  ``at_once``:
    the number of positions evaluated at a time, none beyond the first change; by default all positions, which also
    finds what holds again further out.
    """
    evaluated: dict[float, bool] = {}
    rest = list(positions)
    while rest and (at_once is None or _find_first_change(evaluated) is None):
        batch, rest = rest[:at_once], rest[at_once:] if at_once else []
        evaluated.update(zip(batch, (yield batch), strict=True))
    change = _find_first_change(evaluated)
    while change is not None and (middle := between(*change)) is not None:
        (evaluated[middle],) = yield [middle]
        change = (middle, change[1]) if evaluated[middle] == evaluated[positions[0]] else (change[0], middle)
    ordered = tuple(sorted(evaluated))
    return Scan(ordered, tuple(evaluated[position] for position in ordered), change)


def _find_first_change(evaluated: Mapping[float, bool]) -> tuple[float, float] | None:
    ordered = sorted(evaluated)
    for near, far in pairwise(ordered):
        if evaluated[near] != evaluated[far]:
            return near, far
    return None


def run_together(
    generators: Mapping[Name, Generator[Asked, Answer, Result]],
) -> Generator[dict[Name, Asked], Mapping[Name, Answer], dict[Name, Result]]:
    """Run generators in parallel: yield their joint requests, and send each the answers to its own."""
    answers: Mapping[Name, Answer | None] = dict.fromkeys(generators)
    ended: dict[Name, Result] = {}
    while answers:
        waiting: dict[Name, Asked] = {}
        for name, given in answers.items():
            try:
                waiting[name] = generators[name].send(given)  # type: ignore[arg-type]  # nothing begins a generator
            except StopIteration as end:
                ended[name] = end.value
        told = (yield waiting) if waiting else {}
        answers = {name: told[name] for name in waiting}
    return {name: ended[name] for name in generators}
