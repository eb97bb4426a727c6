"""Limits on how an axis settles and on what it still swings by at the end, from what was commanded of it.

An axis that follows a set-point is to settle after each step and to be at rest at the end.  Both limits are left out
where the flight cannot tell: a step that ends before an axis could have settled, an axis whose rates are commanded, and
rows on which something from outside acts anew (wind, forces, loads, faults, the ground).  Wind to the end leaves a wide
limit on the swing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import hypot, radians, sqrt
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.constants import GRAVITY
from cosim.base.protocols import Columns
from cosim.base.signals import AXES
from cosim.base.storage.cache import RecentCache
from cosim.results.contacts import find_contact_rows
from cosim.results.metrics import (
    FINAL_WINDOW_S,
    MIN_STEP_RAD,
    SETTLING_BAND,
    UPSETS,
    WIND,
    Record,
    Step,
    find_steps,
    settling_time,
    wrap,
)

# An attitude law slower than a quarter of an hour is no attitude law.
MIN_GAIN_1_S = 1e-3
# Half peak-to-peak that an axis may have if the wind changes until the end. Chosen by us: gusts of shipped scenarios
# cause less than 1 deg.
MAX_SWING_IN_WIND_RAD = radians(10.0)

Known = RecentCache[Any]


class AxisLimitInputs(Record):
    """Inputs of one axis's limits besides the log."""

    gain_1_s: float  # gain of the attitude law
    noise_rad: float  # noise deviation of measured attitude
    rate_noise_rad_s: float  # noise deviation of measured rate


class Upsets:
    """Times of new external influences: wind, forces, loads, faults, ground."""

    def __init__(self, log: Columns, wind_m_s: float) -> None:
        """Read the log; ``wind_m_s`` is the change of the wind that counts."""
        acts = find_contact_rows(log)
        for name in log.columns:
            if name.startswith(UPSETS):
                changed = np.diff(log[name])
                acts[1:] |= (changed != 0.0) & np.isfinite(changed)
        self._count = np.concatenate((np.zeros(1, np.int32), np.cumsum(acts, dtype=np.int32)))
        winds = (log[name] for name in WIND if name in log.columns)
        self._wind = [wind for wind in winds if not (wind.size and np.ptp(wind) <= wind_m_s)]  # components that change
        self._wind_m_s = wind_m_s

    def has_any(self, first: int, end: int) -> bool:
        """Return whether a new disturbance acts on rows ``first`` to ``end - 1``."""
        return self.has_any_but_wind(first, end) or self.has_wind_change(first, end)

    def has_any_but_wind(self, first: int, end: int) -> bool:
        """Return whether a new disturbance other than wind acts on rows ``first`` to ``end - 1``."""
        return bool(self._count[end] > self._count[first])

    def has_wind_change(self, first: int, end: int) -> bool:
        """Return whether the wind changes on rows ``first`` to ``end - 1``."""
        return any(np.ptp(wind[first:end]) > self._wind_m_s for wind in self._wind)


def settling_limit(axis: AxisLimitInputs, time_constants: float = 10.0) -> float:
    """Return the time (s) in which a step of an axis is to settle: ``time_constants`` of the attitude law, 1/K each.

    ``time_constants``: time constants 1/K of the attitude law that a step is given to settle.  By itself the law comes
    to within 5 % in ln 20 = 3.0 of them: three times that and some, for the rate loop and the engines behind it.
    """
    return time_constants / axis.gain_1_s


def noise_floor(axis: AxisLimitInputs, step_s: float, deviations: float = 6.0) -> float:
    """Return the half peak-to-peak (rad) within a second that the noise of the sensors may cause.

    ``deviations`` of the root of the sum of the squares of the attitude's noise and of what the rate's noise moves an
    axis by: white noise of s rad/s through the attitude law's lag 1/K leaves ``s sqrt(dt / (2 K))``.  ``deviations``:
    standard deviations of the attitude's noise that a swing may have.  A second of it reaches three either way: twice
    that, because no controller holds an axis stiller than it is measured.
    """
    moved = axis.rate_noise_rad_s * sqrt(step_s / (2.0 * axis.gain_1_s))
    return max(MIN_STEP_RAD, deviations * hypot(axis.noise_rad, moved))


def axis_limits(
    axes: Sequence[AxisLimitInputs],
    log: Columns,
    step_s: float,
    span_m: float,
    chosen: Mapping[str, float | None],
    known: Known,
    wind_change: float = 0.05,
) -> dict[str, float]:
    """Return the limits of every axis by metric; ``chosen`` are those of the scenario by key, None for no limit.

    ``known``: see :func:`cosim.results.limits.flight_limits`; ``wind_change``: change of the wind, in Froude speeds
    sqrt(g span), from which on an axis counts as disturbed.  0.1 m/s on the prototype.
    """
    upsets = known.get(span_m, lambda: Upsets(log, wind_change * sqrt(GRAVITY * span_m)))
    limits: dict[str, float | None] = {}
    for axis, name in zip(axes, AXES, strict=False):
        setpoint, angle = log[f"{name}_setpoint_rad"], log[f"{name}_rad"]
        steps = known.get(name, partial(find_steps, setpoint, angle, step_s))
        if "settling_s" in chosen:
            limits[f"{name}.settling_time_s"] = chosen["settling_s"] if steps else None
        else:
            limits[f"{name}.settling_time_s"] = _judge_settling(axis, steps, wrap(setpoint - angle), upsets, step_s)
        if "oscillation_rad" in chosen:
            limits[f"{name}.oscillation_rad"] = chosen["oscillation_rad"]
        else:
            limits[f"{name}.oscillation_rad"] = _judge_oscillation(axis, steps, setpoint, upsets, step_s)
    return {name: value for name, value in limits.items() if value is not None}


def _judge_settling(
    axis: AxisLimitInputs, steps: Sequence[Step], error: Array, upsets: Upsets, step_s: float
) -> float | None:
    """Return the limit of settling time (s); None without an undisturbed step, or if disturbed steps alone are late.

    A step of which 5 % are below the noise floor is settled within that floor.
    """
    if axis.gain_1_s < MIN_GAIN_1_S:
        return None
    most = settling_limit(axis)
    least_size = noise_floor(axis, step_s) / SETTLING_BAND
    judged = [
        settling_time(error[step.first : step.end], max(abs(step.size), least_size), step_s)
        for step in steps
        if (step.end - step.first) * step_s >= most and not upsets.has_any(step.first, step.end)
    ]
    if any(time is None or time > most for time in judged):
        return most
    measured = [settling_time(error[step.first : step.end], step.size, step_s) for step in steps]
    return most if judged and all(time is not None and time <= most for time in measured) else None


def _judge_oscillation(
    axis: AxisLimitInputs, steps: Sequence[Step], setpoint: Array, upsets: Upsets, step_s: float
) -> float | None:
    """Return the limit of residual oscillation (rad); None if the end of the flight is disturbed.

    It is ``SETTLING_BAND`` of the last step, or the noise floor if that is more, or ``MAX_SWING_IN_WIND_RAD`` while the
    wind changes, and beyond it what is left of how the set-point moved since the axis had time to settle before the
    last second.
    """
    if axis.gain_1_s < MIN_GAIN_1_S:
        return None
    last = setpoint.size - round(FINAL_WINDOW_S / step_s)
    first = setpoint.size - round((settling_limit(axis) + FINAL_WINDOW_S) / step_s)
    recent = setpoint[max(first, 0) :]
    if first < 0 or not np.all(np.isfinite(recent)) or upsets.has_any_but_wind(first, setpoint.size):
        return None
    band = SETTLING_BAND * abs(steps[-1].size) if steps else 0.0
    wind = MAX_SWING_IN_WIND_RAD if upsets.has_wind_change(first, setpoint.size) else 0.0
    if steps:
        rest = _residual_of_steps([step for step in steps if step.first > first], last, settling_limit(axis) / step_s)
    else:
        rest = float(np.ptp(np.unwrap(recent)))
    return max(band, noise_floor(axis, step_s), wind) + rest


def _residual_of_steps(steps: Sequence[Step], row: int, settling_rows: float) -> float:
    """Return the attitude error [rad] still allowed at ``row`` because recent steps have not had time to settle.

    A step of size s leaves ``s SETTLING_BAND^(t / settling)`` after a time t: all of it at once, 5 % at the time in
    which it is to settle.  One after that row, in the last second, counts whole.
    """
    return float(sum(abs(step.size) * SETTLING_BAND ** (max(row - step.first, 0) / settling_rows) for step in steps))
