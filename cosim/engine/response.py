"""How an engine answers its throttle, measured by stepping it: delay, rise time, static curve.

Every function takes ``hold(throttle, steps)``, which steps the engine at a constant throttle and returns its thrusts.
Bounded in simulated time, not in wall time, so that the result is the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

Hold = Callable[[float, int], Sequence[float]]

CURVE_POINTS = 21
LONGEST_S = 180.0  # to settle: a real turbojet, closed, creeps for 95 s until it stands still to NO_CHANGE
LONGEST_DELAY_S = 10.0
NO_CHANGE = 1e-10  # of the thrust, or of 1 N if that is more
LITTLE_CHANGE = 1e-6  # the same, for an FMU whose own solver goes on trembling at rest: a usual tolerance of solvers


class ResponseError(Exception):
    """The engine never settles, or never answers."""


class RestlessError(ResponseError):
    """The engine never settles."""


class Response(NamedTuple):
    """A step of the throttle between 0 and 1."""

    delay: int  # communication steps in which nothing moves
    rise: float  # s, from 10 to 90 % of the change
    before: float  # N
    after: float  # N


class Curve(NamedTuple):
    """Steady thrust [N] at throttles from 0 to 1."""

    throttle: tuple[float, ...]
    thrust: tuple[float, ...]


def settle(hold: Hold, throttle: float, window: int, step: float, quiet: float = NO_CHANGE) -> float:
    """Hold a throttle until the thrust has stood still to ``quiet`` for ``window`` steps, and return it [N].

    ``window`` must be longer than the engine's delay.  Raises ResponseError after ``LONGEST_S`` of simulated time.
    """
    last = hold(throttle, window)[-1]
    for _ in range(max(1, math.ceil(LONGEST_S / step / window))):
        thrusts = hold(throttle, window)
        if _still([last, *thrusts], quiet):
            return thrusts[-1]
        last = thrusts[-1]
    raise RestlessError(f"thrust does not settle within {LONGEST_S:g} s at throttle {throttle:g}")


def step_response(hold: Hold, before: float, throttle: float, step: float, quiet: float = NO_CHANGE) -> Response:
    """Step the throttle of an engine that stands at ``before`` newtons, and follow the thrust until it has settled.

    Raises ResponseError if it does not answer within ``LONGEST_DELAY_S`` or does not settle within ``LONGEST_S``.
    """
    thrusts: list[float] = []
    moved = None
    while moved is None:
        if len(thrusts) * step > LONGEST_DELAY_S:
            raise ResponseError(f"thrust does not answer the throttle within {LONGEST_DELAY_S:g} s")
        thrusts += hold(throttle, 64)
        moved = next((k for k, thrust in enumerate(thrusts) if not _still([before, thrust], quiet)), None)
    window = window_for(moved)
    while len(thrusts) < moved + 2 * window or not _still(thrusts[-window:], quiet):
        if len(thrusts) * step > LONGEST_S + LONGEST_DELAY_S:
            raise RestlessError(f"thrust does not settle within {LONGEST_S:g} s at throttle {throttle:g}")
        thrusts += hold(throttle, window)
    after = thrusts[-1]
    if _still([before, after], quiet):
        raise ResponseError("thrust is the same at throttle 0 and 1")
    course = [before, *thrusts]
    rise = (crossing(course, 0.9, before, after) - crossing(course, 0.1, before, after)) * step
    return Response(moved, rise, before, after)


def window_for(delay: int) -> int:
    """Steps to watch before calling a thrust settled, for an engine with this delay."""
    return 2 * delay + 50


def static_curve(hold: Hold, window: int, step: float, quiet: float = NO_CHANGE) -> Curve:
    """Steady thrust at evenly spaced throttles, measured from full throttle down."""
    throttles = [k / (CURVE_POINTS - 1) for k in range(CURVE_POINTS)]
    thrusts = [settle(hold, throttle, window, step, quiet) for throttle in reversed(throttles)]
    return Curve(tuple(throttles), tuple(reversed(thrusts)))


def curve_problems(curve: Curve, quiet: float = NO_CHANGE) -> list[str]:
    """What is wrong with the static curve of an engine whose thrust stands still to ``quiet`` of itself."""
    throttle, thrust = curve
    doubt = 10.0 * quiet * max(1.0, *map(abs, thrust))  # N
    problems = []
    falls = [k for k in range(1, len(thrust)) if thrust[k] < thrust[k - 1] - doubt]
    if falls:
        k = falls[0]
        problems.append(
            f"its thrust does not rise with the throttle: {thrust[k - 1]:.4g} N at {throttle[k - 1]:g}, "
            f"{thrust[k]:.4g} N at {throttle[k]:g}"
        )
    if min(thrust) < -doubt:
        k = thrust.index(min(thrust))
        problems.append(f"its thrust is negative: {thrust[k]:.4g} N at throttle {throttle[k]:g}")
    return problems


def _still(thrusts: Sequence[float], quiet: float) -> bool:
    low, high = min(thrusts), max(thrusts)
    return high - low <= quiet * max(1.0, abs(low), abs(high))


def crossing(course: Sequence[float], share: float, before: float, after: float) -> float:
    """Where, in steps, the course first reaches a share of the change, interpolated linearly between steps."""
    level = [(thrust - before) / (after - before) for thrust in course]
    k = next(k for k, x in enumerate(level) if x >= share)
    return k - (level[k] - share) / (level[k] - level[k - 1])
