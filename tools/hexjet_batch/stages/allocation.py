"""Allocation over a batch: collective and three torque commands to shares of thrust and tilts.

:class:`cosim.control.allocation.allocation.TiltAllocator` and ``RotorAllocator`` with every engine healthy.  Each
returns shares of thrust, a row a bank or rotor, the two tilts [rad], and what was not given of the four commands.
"""

from __future__ import annotations

from typing import Any

from cosim.control.allocation.allocation import MIN_HOVER_FRACTION
from hexjet_batch.numbers import Numbers
from hexjet_batch.stages.rotations import Vector

Allocated = tuple[Any, Any, tuple[Any, ...]]


def allocate_banks(n: Numbers, collective: Any, torque: Vector, xp: Any) -> Allocated:
    """Return what two banks give: roll before collective, pitch before yaw."""
    roll, pitch, yaw = torque
    half = 0.5 * (n.throttle_max - n.throttle_min)
    r = xp.clip(roll, -half, half)
    spread = xp.abs(r)
    c = xp.minimum(xp.maximum(collective, n.throttle_min + spread), n.throttle_max - spread)
    ratio = xp.maximum((c + n.idle) / (n.hover + n.idle), MIN_HOVER_FRACTION)
    asked_pitch, asked_yaw = n.pitch_sign * pitch / ratio, yaw / ratio
    p = xp.clip(asked_pitch, -n.range_rad, n.range_rad)
    room = n.range_rad - xp.abs(p)
    y = xp.minimum(xp.maximum(asked_yaw, -room), room)
    # Exactly 0 where everything fits: the integrals stop at any residual.
    pitch_left = xp.where(p == asked_pitch, 0.0, pitch - n.pitch_sign * p * ratio)
    yaw_left = xp.where(y == asked_yaw, 0.0, yaw - y * ratio)
    return xp.stack([c + r, c - r]), (p + y, p - y), (roll - r, pitch_left, yaw_left, collective - c)


def allocate_rotors(n: Numbers, collective: Any, torque: Vector, xp: Any) -> Allocated:
    """Return what a multirotor gives: roll and pitch before yaw, yaw before collective."""
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
    share = xp.stack([xp.clip(c + a * r + b * p + d * y, low, high) for a, b, d in n.signs])
    return share, None, (roll - r, pitch - p, yaw - y, collective - c)
