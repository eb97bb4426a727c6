"""The controller over a batch: attitude, rates with predictor and lead, height, schedule of their gains, allocation.

The laws are those of :mod:`cosim.control`, where each is explained; here every value is an array over the flights.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.control.allocation.allocation import MIN_HOVER_FRACTION
from cosim.control.altitude import MIN_UPRIGHT
from hexjet_batch.numbers import Numbers, is_absent, limit
from hexjet_batch.stages.rotations import Quaternion, Vector


class RateState(NamedTuple):
    """Of one axis: predictor, integral, filtered slope, last prediction, last command and lead."""

    predictor: Any
    integral: Any
    slope: Any
    predicted: Any
    command: Any
    lead: tuple[Any, Any]


def update_attitude(n: Numbers, setpoint: Quaternion, measured: Quaternion, xp: Any) -> Vector:
    """Return the body rates [rad/s] that lead to an attitude: a gain times twice the vector part of the error."""
    aw, ax, ay, az = measured
    bw, bx, by, bz = setpoint
    double = xp.where(aw * bw + ax * bx + ay * by + az * bz >= 0.0, 2.0, -2.0)
    error = (
        double * (aw * bx - ax * bw - ay * bz + az * by),
        double * (aw * by + ax * bz - ay * bw - az * bx),
        double * (aw * bz - ax * by + ay * bx - az * bw),
    )
    limited = zip(n.gain_1_s, error, n.rate_limit_rad_s, strict=True)
    return tuple(limit(gain * e, -most, most, xp) for gain, e, most in limited)


def start_rate(predictor: Any, zero: Any, xp: Any) -> RateState:
    """Return the state of an axis at rest."""
    begun = None if predictor is None else predictor.start(zero, xp)
    return RateState(begun, zero, zero, zero, zero, (zero, zero))


def update_rate(
    n: Numbers, predictor: Any, s: RateState, k: Any, setpoint: Any, measured: Any, unallocated: Any, xp: Any
) -> RateState:
    """Return the state after a step; its ``command`` is the torque asked for."""
    predicting, rate = s.predictor, measured
    if predictor is not None:
        predicting, rate = predictor.update(predicting, k, measured, s.command - unallocated, xp)
    error = setpoint - rate
    integral = s.integral
    if not is_absent(n.i):
        moved = limit(integral + n.step * n.i * error, -n.integral_limit, n.integral_limit, xp)
        integral = xp.where(unallocated * error <= 0.0, moved, integral)
    command, slope = n.p * error + integral, s.slope
    if not is_absent(n.d):
        # The first step has no slope yet.
        share = n.step / (n.d_filter_s + n.step) * (k > 0)
        slope = slope + share * ((rate - s.predicted) / n.step - slope)
        command = command - n.d * slope
    lead = s.lead
    if n.lead is not None:
        command, lead = update_lead(n.lead, lead, command, unallocated)
    return RateState(predicting, integral, slope, rate, command, lead)


def update_lead(n: Vector, state: tuple[Any, Any], value: Any, unallocated: Any) -> tuple[Any, tuple[Any, Any]]:
    """Return the led command and the next state; ``n``: see :attr:`cosim.control.lead.Lead.constants`."""
    (instant, pole, rest, of_once, of_twice), (once, twice) = n, state
    once = once - rest * unallocated / instant
    led = instant * value + of_once * once + of_twice * twice
    return led, (pole * once + rest * value, pole * twice + rest * once)


def update_height(
    n: Numbers, s: tuple[Any, Any], asked: Any, measured: Any, unallocated: Any, burnt: Any, xp: Any
) -> tuple[Any, tuple[Any, Any]]:
    """Return the collective [share of thrust], integral [m/s^2] and state of the lead, None before the first."""
    integral, lead = s
    climb = limit(n.position_1_s * (asked - measured.altitude), -n.descent_limit_m_s, n.climb_limit_m_s, xp)
    error = climb + measured.velocity[2]
    moved = limit(integral + n.step * n.integral_1_s2 * error, -n.integral_limit_m_s2, n.integral_limit_m_s2, xp)
    integral = xp.where(unallocated * error <= 0.0, moved, integral)
    _, x, y, _ = measured.attitude
    upright = xp.maximum(1.0 - 2.0 * (x * x + y * y), MIN_UPRIGHT)
    thrust = (n.mass_kg - burnt) * (GRAVITY + n.velocity_1_s * error + integral) / upright
    collective = (thrust / n.jets - n.low) / n.span
    if n.lead is not None:
        if lead is None:
            lead, unallocated = (collective, collective), 0.0 * collective
        collective, lead = update_lead(n.lead, lead, collective, unallocated)
    return collective, (integral, lead)


class ScheduleNumbers(NamedTuple):
    """Gains and leads by the level of thrust: rows of ``table`` at even levels, linear in between.

    Columns: factors on the gains of roll (angle, p, i, d) and of height (position, velocity, integral), then the
    constants of the two leads.  The gains follow once the level has moved by ``resolution``.
    """

    low: float
    high: float
    filter: float
    resolution: float
    table: Any

    def at(self, level: Any, xp: Any) -> Any:
        """Return the columns at these levels, a row each."""
        table, last = xp.asarray(self.table), len(self.table) - 1
        place = (level - self.low) / (self.high - self.low) * last
        row = limit(xp.floor(place), 0, last - 1, xp).astype(np.int64)
        weight = (place - row)[:, None]
        return (table[row] + weight * (table[row + 1] - table[row])).T

    def update(self, state: tuple[Any, Any, Any], share: Any, xp: Any) -> tuple[Any, Any, Any]:
        """Return level, the level of the gains and the gains of the next step, after one of this share of thrust."""
        level, last, gains = state
        level = level + self.filter * (limit(share, self.low, self.high, xp) - level)
        moved = xp.abs(level - last) >= self.resolution
        if xp is not np:
            return level, xp.where(moved, level, last), xp.where(moved, self.at(level, xp), gains)
        flights = np.flatnonzero(moved)
        if flights.size:
            gains, last = gains.copy(), np.where(moved, level, last)
            gains[:, flights] = self.at(level[flights], np)
        return level, last, gains


def apply_schedule(gains: Any, attitude: Numbers, roll: Numbers, height: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return the numbers of the loops at the present level of the schedule."""
    angle, p, i, d, position, velocity, integral = gains[:7]
    return (
        attitude.replace(gain_1_s=(angle * attitude.gain_1_s[0], *attitude.gain_1_s[1:])),
        roll.replace(p=p * roll.p, i=i * roll.i, d=d * roll.d, lead=None if roll.lead is None else tuple(gains[7:12])),
        height.replace(
            position_1_s=position * height.position_1_s,
            velocity_1_s=velocity * height.velocity_1_s,
            integral_1_s2=integral * height.integral_1_s2,
            lead=None if height.lead is None else tuple(gains[12:]),
        ),
    )


# Shares of thrust, a row a bank or rotor, the two tilts [rad], and what was not given of the four commands.
Allocated = tuple[Any, Any, tuple[Any, ...]]


def allocate_banks(n: Numbers, collective: Any, torque: Vector, xp: Any) -> Allocated:
    """Allocate to two banks of jets: roll before collective, pitch before yaw."""
    roll, pitch, yaw = torque
    half = 0.5 * (n.throttle_max - n.throttle_min)
    r = limit(roll, -half, half, xp)
    spread = xp.abs(r)
    c = xp.minimum(xp.maximum(collective, n.throttle_min + spread), n.throttle_max - spread)
    ratio = xp.maximum((c + n.idle) / (n.hover + n.idle), MIN_HOVER_FRACTION)
    asked_pitch, asked_yaw = n.pitch_sign * pitch / ratio, yaw / ratio
    p = limit(asked_pitch, -n.range_rad, n.range_rad, xp)
    room = n.range_rad - xp.abs(p)
    y = xp.minimum(xp.maximum(asked_yaw, -room), room)
    # Exactly 0 where everything fits: the integrals stop at any residual.
    pitch_left = xp.where(p == asked_pitch, 0.0, pitch - n.pitch_sign * p * ratio)
    yaw_left = xp.where(y == asked_yaw, 0.0, yaw - y * ratio)
    return xp.stack([c + r, c - r]), (p + y, p - y), (roll - r, pitch_left, yaw_left, collective - c)


def allocate_rotors(n: Numbers, collective: Any, torque: Vector, xp: Any) -> Allocated:
    """Allocate to a multirotor's engines: roll and pitch before yaw, yaw before collective."""
    roll, pitch, yaw = torque
    low, high = n.throttle_min, n.throttle_max
    room = 0.5 * (high - low)
    spread = xp.abs(roll) + xp.abs(pitch)
    scale = xp.where(spread > room, room / xp.maximum(spread, 1e-300), 1.0)
    r, p = roll * scale, pitch * scale
    for_yaw = room - xp.minimum(spread, room)
    y = xp.minimum(xp.maximum(yaw, -for_yaw), for_yaw)
    span = xp.abs(r) + xp.abs(p) + xp.abs(y)
    c = xp.minimum(xp.maximum(collective, low + span), high - span)
    share = xp.stack([limit(c + a * r + b * p + d * y, low, high, xp) for a, b, d in n.signs])
    return share, None, (roll - r, pitch - p, yaw - y, collective - c)
