"""Limits on the metrics of every flight: one that exceeds them does not count as flown.

The outcome says how a flight ended; it is ``completed`` wherever the vehicle went meanwhile.  The limits say whether it
went where it was asked to go, and did so by means that it has.  They come from the size of the vehicle and from what
the scenario commands, so that one set of numbers serves every vehicle and every scenario; a scenario's table
``[limits]`` states others.  A flight beyond one of them is not flown as planned, and says by which figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, sqrt
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.arrays import Array
from cosim.base.constants import GRAVITY
from cosim.base.protocols import Columns
from cosim.base.signals import AXES
from cosim.results.metrics import POSITION_SETPOINT, Record, commands_position
from cosim.results.steadiness import MIN_GAIN_1_S, AxisLimitInputs, Known, axis_limits, noise_floor
from cosim.results.wording import metric

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario
    from cosim.spec.vehicle import Vehicle

# Chosen by us, in spans of the vehicle and in its Froude speed sqrt(g span), so that limits scale with the vehicle. The
# prototype's span is 0.4 m: a height error of 2 m, which no shipped disturbance causes (a tenth of the weight taken up
# at once included); a position error of 4 m, for a GNSS error of a metre and the first gust before the wind is
# estimated; a drift of 10 m, which nobody would call a hover; 4 m/s.
MAX_HEIGHT_SPANS = 5.0  # height error
MAX_POSITION_SPANS = 10.0  # error of a commanded position
MAX_DRIFT_SPANS = 25.0  # distance from the start
MAX_FROUDE_SPEEDS = 2.0  # horizontal speed
# For most of the time in the air the allocation must realise what the controllers command.
MAX_SATURATED_PERCENT = 50.0

# Percent of the steps of any second on which a command may change direction. An oscillation at half the control rate
# does so on all steps; white noise on 2/3 and its differences on 73 % (1/2 + asin(2/3) / pi), by chance 8 % more in a
# second of 250 steps.
MAX_ALTERNATING_PERCENT = 90.0

LIMITED = {  # metric by key of [limits]
    "height_error_m": "altitude.max_abs_error_m",
    "place_error_m": "position.max_abs_error_m",
    "drift_m": "position.drift_m",
    "speed_m_s": "speed.max_m_s",
    "saturated_percent": "effort.saturated_percent",
    "alternating_percent": "effort.alternating_percent",
    "throttle_activity_1_s": "effort.throttle_1_s",
    "tilt_activity_rad_s": "effort.tilt_rad_s",
    "fuel_burnt_kg": "fuel_burnt_kg",
}


SETTLING_TIME = ".settling_time_s"  # ending of settling times' names


class LimitInputs(Record):
    """Inputs of a flight's limits besides its log."""

    span_m: float
    height_law: tuple[float, float, float]  # gain 1/s; max. climb and descent m/s
    stated: dict[str, float | None]  # limit by key of [limits]; None: none
    piloted: bool  # True: an autopilot flies, no drift limit
    axes: tuple[AxisLimitInputs, ...] = ()  # roll, pitch, yaw; empty: an older run


def make_limit_inputs(scenario: Scenario, vehicle: Vehicle) -> LimitInputs:
    """Return what a scenario and a vehicle state for the limits of a flight: span, gains, noise, own limits."""
    gains = vehicle.control.altitude
    limits = scenario.limits.model_dump(exclude_none=True)
    return LimitInputs(
        span_m=vehicle.aero.span_m,
        height_law=(gains.position_1_s, gains.climb_limit_m_s, gains.descent_limit_m_s),
        stated={key: None if value is False else float(value) for key, value in limits.items()},
        piloted=scenario.requests is not None,
        axes=tuple(
            AxisLimitInputs(
                gain_1_s=gain,
                noise_rad=vehicle.sensors.attitude.noise_rad,
                rate_noise_rad_s=vehicle.sensors.gyro.noise_rad_s,
            )
            for gain in vehicle.control.attitude.gain_1_s
        ),
    )


def note_small_steps(scenario: Scenario, measure: LimitInputs) -> list[str]:
    """Return a line for each commanded step of an axis that cannot be told from the noise of the sensors."""
    floors = {
        f"{name}_deg": degrees(noise_floor(axis, scenario.step_s))
        for name, axis in zip(AXES, measure.axes, strict=False)
        if scenario.sensor_noise and axis.gain_1_s >= MIN_GAIN_1_S
    }
    return [
        f"command.{number}: the {entry.kind} of {entry.amplitude:g} deg in {entry.signal} is below the noise floor of "
        f"{floors[entry.signal]:.2g} deg"
        for number, entry in enumerate(scenario.command)
        if entry.kind in ("step", "doublet") and 0.0 < abs(entry.amplitude) < floors.get(entry.signal, 0.0)
    ]


def flight_limits(measure: LimitInputs, log: Columns, step_s: float, known: Known | None = None) -> dict[str, float]:
    """Return the most that each limited metric may be in this flight, by the metric's name.

    ``known`` keeps what flights share that begin alike and have the same commands, disturbances and wind.

    The height's error may be ``MAX_HEIGHT_SPANS`` beyond what the height law leaves by itself; drift and speed
    ``MAX_DRIFT_SPANS`` and ``MAX_FROUDE_SPEEDS`` beyond what the commanded leans explain.  There is none
    on drift where a place is commanded, none on drift and speed where a pilot flies or body rates are commanded.
    Those of the axes are :mod:`cosim.results.steadiness`'s.
    """
    # One function each, so that no columns are held while another reads its own: an hour's are 7 MB each.
    known, law = known or Known(32), measure.height_law
    lag = known.get(law, lambda: height_lag(log["altitude_setpoint_m"], log["altitude_m"], law, step_s))
    merged: dict[str, float | None] = {
        "height_error_m": MAX_HEIGHT_SPANS * measure.span_m + lag,
        "saturated_percent": MAX_SATURATED_PERCENT,
        "alternating_percent": MAX_ALTERNATING_PERCENT,
        **known.get((measure.span_m, measure.piloted), lambda: _motion_limits(measure, log, step_s)),
        **measure.stated,
    }
    named = {LIMITED[key]: value for key, value in merged.items() if value is not None and key in LIMITED}
    return named | axis_limits(measure.axes, log, step_s, measure.span_m, measure.stated, known)


def _motion_limits(measure: LimitInputs, log: Columns, step_s: float) -> dict[str, float]:
    """Return the limits of position, drift and speed by their keys."""
    span, speed = measure.span_m, MAX_FROUDE_SPEEDS * sqrt(GRAVITY * measure.span_m)
    limits: dict[str, float] = {}
    placed = commands_position(log)
    if placed:
        limits["place_error_m"] = MAX_POSITION_SPANS * span
    if not measure.piloted:
        if placed:
            limits["speed_m_s"] = speed + track_speed(log[POSITION_SETPOINT[0]], log[POSITION_SETPOINT[1]], step_s)
        else:
            roll, pitch, yaw = (log[f"{axis}_setpoint_rad"] for axis in AXES)
            start = (log["velocity_north_m_s"][:1], log["velocity_east_m_s"][:1])
            lean = lean_motion(roll, pitch, yaw, start, step_s)
            if lean is not None:
                limits |= {"drift_m": MAX_DRIFT_SPANS * span + lean[0], "speed_m_s": speed + lean[1]}
    return limits


def height_lag(setpoint: Array, altitude: Array, law: tuple[float, float, float], step_s: float) -> float:
    """Return the largest height error (m) of a vehicle that follows the height law without any error of its own.

    ``h' = clip(K (h_set - h), -descent, climb)``: a step leaves its size, a ramp its rate over K.  Where the height is
    asked for anew the law begins where the vehicle is.
    """
    finite = np.isfinite(setpoint)
    if not np.any(finite):
        return 0.0
    here = setpoint[finite]
    if np.all(here == here[0]) and np.all(finite):
        return float(abs(here[0] - altitude[0]))
    gain, up, down = law
    worst, height, is_commanded = 0.0, 0.0, False
    for level, actual in zip(setpoint.tolist(), altitude.tolist(), strict=True):
        if level != level:  # NaN: collective commanded directly
            is_commanded = False
            continue
        if not is_commanded:
            height, is_commanded = actual, True
        off = level - height
        worst = max(worst, abs(off))
        height += step_s * min(max(gain * off, -down), up)
    return worst


def lean_motion(
    roll: Array, pitch: Array, yaw: Array, velocity: tuple[Array, Array], step_s: float, block: int = 65_536
) -> tuple[float, float] | None:
    """Return distance (m) and largest speed (m/s) that commanded leans cause: in still air, without drag.

    ``a = g tan(lean)`` of thrust along the body's -z axis that holds the weight, added up from the ``velocity`` at the
    start.  None where an angle is not commanded.  ``block``: whose leans are looked at together: 0.5 MB a column.
    """
    if not roll.size or not all(np.all(np.isfinite(angle)) for angle in (roll, pitch, yaw)):
        return None
    speed, gained = np.empty(roll.size), [0.0, 0.0]
    for first in range(0, roll.size, block):
        part = slice(first, first + block)
        changes = _velocity_changes(roll[part], pitch[part], yaw[part], step_s)
        for axis, change in enumerate(changes):
            change[0] += gained[axis]
            np.cumsum(change, out=change)
            gained[axis] = float(change[-1])
        speed[part] = np.hypot(*(start + change for start, change in zip(velocity, changes, strict=True)))
    return float(np.sum(speed) * step_s), float(np.max(speed))


def _velocity_changes(roll: Array, pitch: Array, yaw: Array, step_s: float) -> tuple[Array, Array]:
    """Return the change of the velocity north and east (m/s) in every step that commanded leans cause."""
    upright = np.cos(roll) * np.cos(pitch)
    scale = np.where(upright > 0.0, -GRAVITY * step_s / np.maximum(upright, 1e-3), 0.0)
    sine, rolled = np.cos(roll) * np.sin(pitch), np.sin(roll)
    return (
        scale * (sine * np.cos(yaw) + rolled * np.sin(yaw)),
        scale * (sine * np.sin(yaw) - rolled * np.cos(yaw)),
    )


def track_speed(north: Array, east: Array, step_s: float) -> float:
    """Return the largest speed (m/s) of the commanded position."""
    speed = np.hypot(np.diff(north), np.diff(east)) / step_s
    finite = speed[np.isfinite(speed)]
    return float(np.max(finite)) if finite.size else 0.0


def find_exceeded(limits: Mapping[str, float], flat: Mapping[str, float | None]) -> list[str]:
    """Return the names of the metrics that are beyond their limit.

    What a flight has not is within, but for the settling time: it has a limit only where a step could have settled.
    """
    return [
        name
        for name, most in limits.items()
        if (name.endswith(SETTLING_TIME) if (value := flat.get(name)) is None else value > most)
    ]


def describe_exceedance(name: str, limits: Mapping[str, float], flat: Mapping[str, float | None]) -> str:
    """Describe a metric and its limit: ``drift from the start 125.7 m, limit 10 m``."""
    of, value = metric(name), flat[name]
    value_text = "none, not settled" if value is None else f"{of.factor * value:.4g} {of.unit}"
    return f"{of.label} {value_text}, limit {of.factor * limits[name]:.4g} {of.unit}"
