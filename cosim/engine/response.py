"""Response of an engine to its throttle, measured by stepping it: delay, rise time, static curve.

Every function takes ``hold(throttle, steps)``, which steps the engine at a constant throttle and returns its thrusts.
Bounded in simulated time, not in wall time, so that the result is the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import fmean
from typing import NamedTuple

Hold = Callable[[float, int], Sequence[float]]

# Longest time until a thrust is constant: a real turbojet, closed, needs 95 s to REST_TOLERANCE.
MAX_SETTLING_S = 180.0
# Fraction of the thrust, or of 1 N if that is more, within which it is constant; the second is for FMUs whose solver
# has the usual tolerance.
REST_TOLERANCE = 1e-10
SOLVER_TOLERANCE = 1e-6  # for FMUs with a solver's tolerance
# Chosen by us: change of the mean between windows over the tolerance of rest, small enough to exclude a slow lag.
MAX_DRIFT = 0.1


class ResponseError(Exception):
    """Error of a measurement: the engine does not settle or does not respond."""


class RestlessError(ResponseError):
    """Error of a measurement: the engine does not settle."""


class Response(NamedTuple):
    """Response of the thrust to a throttle step between 0 and 1."""

    delay: int  # communication steps without response
    rise: float  # s, from 10 to 90 % of the change
    before: float  # N, thrust before the step
    after: float  # N, thrust after the step


class SmallStep(NamedTuple):
    """Response to a small throttle step around the middle, in communication steps."""

    delay: int  # communication steps without response
    late: float  # s, delay at low frequency

    @property
    def lag(self) -> float:
        """Lag without transport delay [steps]: 1 / (1 - a) for a single pole a, with thrust at the step's end."""
        return self.late - self.delay + 1.0


class Curve(NamedTuple):
    """Steady thrust [N] at throttles from 0 to 1."""

    throttle: tuple[float, ...]
    thrust: tuple[float, ...]


def settle(
    hold: Hold,
    throttle: float,
    window: int,
    step: float,
    ripple: float = REST_TOLERANCE,
    rest: float = 0.0,
    span: float = 0.0,
) -> float:
    """Hold a throttle until thrust was constant to ``ripple`` for ``window`` steps, and return the thrust [N].

    ``window`` must be longer than the engine's delay.  A thrust that never stands still does so by definition once it
    moves by no more than ``rest`` newtons, peak to peak, in a window, and its mean by no more than a tenth of that from
    the window before; returned is the mean then.  After ``MAX_SETTLING_S`` of simulated time it stands still too if it
    moves by no more than ``ripple`` of ``span``, the newtons between throttles 0 and 1; otherwise raises ResponseError.
    """
    before = hold(throttle, window)
    for _ in range(max(1, math.ceil(MAX_SETTLING_S / step / window))):
        thrusts = hold(throttle, window)
        if rest > 0.0:
            if max(thrusts) - min(thrusts) <= rest and abs(fmean(thrusts) - fmean(before)) <= MAX_DRIFT * rest:
                return fmean(thrusts)
        elif _is_constant([before[-1], *thrusts], ripple):
            return thrusts[-1]
        before = thrusts
    if rest == 0.0 and _is_constant(before, ripple, ripple * span):
        return before[-1]
    raise _make_restless_error(before, throttle)


def _make_restless_error(last: Sequence[float], throttle: float) -> RestlessError:
    moves = max(last) - min(last)
    return RestlessError(
        f"thrust does not settle within {MAX_SETTLING_S:g} s at throttle {throttle:g}: still moves by {moves:.2g} N; "
        f"a mapping file says what counts as still: [rest] thrust = {1.5 * moves:.2g}"
    )


def measure_step_response(
    hold: Hold,
    before: float,
    throttle: float,
    step: float,
    ripple: float = REST_TOLERANCE,
    rest: float = 0.0,
    longest_delay_s: float = 10.0,
) -> Response:
    """Step the throttle of an engine at ``before`` newtons, and record the thrust until it settles.

    With ``rest`` the delay lasts until the thrust has moved by more than that.

    Raises ResponseError if it does not answer within ``longest_delay_s`` or does not settle within ``MAX_SETTLING_S``.
    """
    thrusts: list[float] = []
    moved = None
    while moved is None:
        if len(thrusts) * step > longest_delay_s:
            raise ResponseError(
                f"thrust does not answer the throttle within {longest_delay_s:g} s; an engine that has to be started "
                "first, or held open, is told how in a mapping file: [start], [inputs]"
            )
        thrusts += hold(throttle, 64)
        moved = next((k for k, thrust in enumerate(thrusts) if not _is_constant([before, thrust], ripple, rest)), None)
    window = settling_window(moved)
    while len(thrusts) < moved + 2 * window or not _has_settled(thrusts, window, ripple, rest):
        if len(thrusts) * step > MAX_SETTLING_S + longest_delay_s:
            if rest == 0.0 and _is_constant(thrusts[-window:], ripple, ripple * abs(before - thrusts[-1])):
                break
            raise _make_restless_error(thrusts[-window:], throttle)
        thrusts += hold(throttle, window)
    after = fmean(thrusts[-window:]) if rest > 0.0 else thrusts[-1]
    if _is_constant([before, after], ripple, rest):
        raise ResponseError("thrust is the same at throttle 0 and 1")
    course = [before, *thrusts]
    rise = (find_crossing(course, 0.9, before, after) - find_crossing(course, 0.1, before, after)) * step
    return Response(moved, rise, before, after)


def settling_window(delay: int) -> int:
    """Return for how many steps a thrust must be constant to count as settled, for an engine's delay in steps."""
    return 2 * delay + 50


def measure_static_curve(
    hold: Hold, window: int, step: float, ripple: float = REST_TOLERANCE, rest: float = 0.0, points: int = 21
) -> Curve:
    """Measure the steady thrust at evenly spaced throttles, from full throttle down."""
    throttles = [k / (points - 1) for k in range(points)]
    thrusts: list[float] = []
    for throttle in reversed(throttles):
        span = thrusts[0] if thrusts else 0.0  # thrust at full throttle, if measured
        thrusts.append(settle(hold, throttle, window, step, ripple, rest, abs(span)))
    return Curve(tuple(throttles), tuple(reversed(thrusts)))


def find_curve_problems(curve: Curve, ripple: float = REST_TOLERANCE, rest: float = 0.0) -> list[str]:
    """Return the problems of a static curve, measured to within ``ripple`` of its thrust or ``rest`` N."""
    throttle, thrust = curve
    tolerance = _tolerance(thrust, ripple, rest)
    problems = []
    falls = [k for k in range(1, len(thrust)) if thrust[k] < thrust[k - 1] - tolerance]
    inner = trim_flat_ends(curve, ripple, rest)
    stands = [v for v, (f, g) in zip(inner.throttle[1:], pairwise(inner.thrust), strict=True) if g <= f]
    if falls or stands:
        k = falls[0] if falls else throttle.index(stands[0])
        problems.append(
            f"its thrust does not rise with the throttle: {thrust[k - 1]:.4g} N at {throttle[k - 1]:g}, "
            f"{thrust[k]:.4g} N at {throttle[k]:g}"
        )
    if min(thrust) < -tolerance:
        k = thrust.index(min(thrust))
        problems.append(f"its thrust is negative: {thrust[k]:.4g} N at throttle {throttle[k]:g}")
    return problems


def _tolerance(thrust: Sequence[float], ripple: float, rest: float) -> float:
    """Return the difference [N] up to which two thrusts count as equal."""
    return max(rest, 10.0 * ripple * max(1.0, *map(abs, thrust)))


def trim_flat_ends(curve: Curve, ripple: float = REST_TOLERANCE, rest: float = 0.0) -> Curve:
    """Return a static curve without the flat parts at its ends: a dead band, or full thrust before full throttle.

    Beyond an end of the remaining curve the engine gives the thrust of that end.
    """
    throttle, thrust = curve
    tolerance = _tolerance(thrust, ripple, rest)
    first = max(k for k in range(len(thrust)) if all(abs(g - thrust[0]) <= tolerance for g in thrust[: k + 1]))
    last = min(k for k in range(len(thrust)) if all(abs(g - thrust[-1]) <= tolerance for g in thrust[k:]))
    if last <= first:
        return curve
    return Curve(throttle[first : last + 1], thrust[first : last + 1])


def note_flat_ends(curve: Curve, ripple: float = REST_TOLERANCE, rest: float = 0.0) -> list[str]:
    """Return notes on the flat parts at the ends of a static curve."""
    throttle, thrust = trim_flat_ends(curve, ripple, rest)
    text = "its thrust at rest is the same, {:.4g} N, from throttle {:.4g} to {:.4g}: a flight does not go {} {:.4g}"
    notes = []
    if throttle[0] > curve.throttle[0]:
        notes.append(text.format(thrust[0], curve.throttle[0], throttle[0], "below", throttle[0]))
    if throttle[-1] < curve.throttle[-1]:
        notes.append(text.format(thrust[-1], throttle[-1], curve.throttle[-1], "beyond", throttle[-1]))
    return notes


def _is_constant(thrusts: Sequence[float], ripple: float, rest: float = 0.0) -> bool:
    low, high = min(thrusts), max(thrusts)
    return high - low <= max(rest, ripple * max(1.0, abs(low), abs(high)))


def _has_settled(thrusts: Sequence[float], window: int, ripple: float, rest: float) -> bool:
    """Return whether the last window of thrusts is constant and, with ``rest``, has the mean of that before."""
    last, before = thrusts[-window:], thrusts[-2 * window : -window]
    level = rest == 0.0 or abs(fmean(last) - fmean(before)) <= MAX_DRIFT * rest
    return _is_constant(last, ripple, rest) and level


def find_crossing(course: Sequence[float], fraction: float, before: float, after: float) -> float:
    """Return the time [steps] at which a course first reaches a fraction of its change, interpolated linearly."""
    level = [(thrust - before) / (after - before) for thrust in course]
    k = next(k for k, x in enumerate(level) if x >= fraction)
    return k - (level[k] - fraction) / (level[k] - level[k - 1])
