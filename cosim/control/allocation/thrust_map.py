"""From thrust fractions to throttles: allocation commands thrust, whatever the engine's static curve."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf
from typing import NamedTuple

from cosim.base.errors import InputError
from cosim.base.signals import PerJet

# A curve closer to its chord than this fraction of the thrust range counts as straight.
MAX_BEND = 1e-9


class StaticCurve(NamedTuple):
    """Static thrust curve of one engine from throttle 0 to 1, and its name for errors."""

    engine: str
    throttle: Sequence[float]
    thrust: Sequence[float]  # N, at each throttle

    @property
    def span(self) -> float:
        """Thrust between throttle 0 and 1, N."""
        return self.thrust[-1] - self.thrust[0]

    @property
    def is_straight(self) -> bool:
        low, span = self.thrust[0], self.span
        return all(
            abs(f - (low + u * span)) <= MAX_BEND * abs(span) for u, f in zip(self.throttle, self.thrust, strict=True)
        )


class ThrustMap:
    """Converts thrust fractions, 0 to 1, to throttles with one static curve per station.

    Controllers, allocation and identified models use thrust fractions: a fraction c asks for the thrust at rest
    ``T = T_0 + c (T_1 - T_0)`` of the ``reference`` engine at throttle 0 and 1, so that equal changes of c are equal
    changes of thrust at every station.  A station's throttle is its own measured curve inverted, linear between the
    points, held at 0 and 1 where its engine cannot give T.  With one kind of engine and a straight curve throttle = c.

    Raises InputError if a curve does not grow from point to point.
    """

    def __init__(self, reference: StaticCurve, stations: Sequence[StaticCurve]) -> None:
        inverse = {id(curve): invert(curve) for curve in (reference, *stations)}
        self.low, self.span = reference.thrust[0], reference.span
        # None: throttle equals the fraction, to the last bit.
        self.stations: list[Inverse | None] = [
            None if reference.is_straight and curve[1:] == reference[1:] else inverse[id(curve)] for curve in stations
        ]
        self.identity = not any(self.stations)
        self.inverse = inverse[id(reference)] if reference.is_straight else None  # None: thrust is linear in throttle
        # Thrust at zero throttle as a fraction of the range: thrust is then proportional to c + idle.
        self.idle = self.low / self.span if abs(self.low) > MAX_BEND * self.span else 0.0

    def fraction(self, thrust: float) -> float:
        """Return the thrust fraction that asks a station for ``thrust`` [N]."""
        return (thrust - self.low) / self.span if self.inverse is None else self.inverse.at(thrust)

    def collective(self, total: float) -> float:
        """Return the thrust fraction that asks every station for its part of ``total`` [N]."""
        return self.fraction(total / len(self.stations))

    def throttle(self, fractions: PerJet) -> PerJet:
        if self.identity:
            return fractions
        low, span, stations = self.low, self.span, self.stations
        throttles: list[float] = []
        for i, c in enumerate(fractions):
            inverse = stations[i]
            throttles.append(c if inverse is None else min(max(inverse.at(low + c * span), 0.0), 1.0))
        return tuple(throttles)


def invert(curve: StaticCurve) -> Inverse:
    """Return the map from thrust at rest [N] to throttle, linear between the points and beyond the ends.

    Raises InputError if the thrust does not grow with the throttle: nothing could then be inverted.
    """
    throttles, thrusts = curve.throttle, curve.thrust
    for (u, v), (f, g) in zip(pairwise(throttles), pairwise(thrusts), strict=True):
        if g <= f:
            does = "is the same, " if g == f else f"falls from {f:.6g} to "
            raise InputError(
                f"engine {curve.engine}: its thrust at rest must grow with the throttle, "
                f"but from throttle {u:g} to {v:g} it {does}{g:.6g} N"
            )
    slopes = [(v - u) / (b - a) for (u, v), (a, b) in zip(pairwise(throttles), pairwise(thrusts), strict=True)]
    return Inverse(throttles, thrusts, slopes)


class Inverse:
    """Straight lines between the points of a curve: throttle by thrust [N]."""

    def __init__(self, throttles: Sequence[float], thrusts: Sequence[float], slopes: Sequence[float]) -> None:
        self.throttles, self.thrusts, self.slopes = list(throttles), list(thrusts), list(slopes)
        self._select(0)

    def _select(self, line: int) -> None:
        """Select a line and its thrust range, as the next thrust is mostly on the same line."""
        thrusts, last = self.thrusts, len(self.slopes) - 1
        self._throttle, self._thrust, self._slope = self.throttles[line], thrusts[line], self.slopes[line]
        self._above = thrusts[line] if line > 0 else -inf
        self._to = thrusts[line + 1] if line < last else inf

    def at(self, thrust: float) -> float:
        """Return the throttle that gives ``thrust`` [N]."""
        if not self._above < thrust <= self._to:
            thrusts = self.thrusts
            # The bisection of bisect_left, restricted to inner points.
            i, end = 0, len(thrusts) - 2
            while i < end:
                middle = (i + end) >> 1
                if thrusts[middle + 1] < thrust:
                    i = middle + 1
                else:
                    end = middle
            self._select(i)
        return self._throttle + self._slope * (thrust - self._thrust)
