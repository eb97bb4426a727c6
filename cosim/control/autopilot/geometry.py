"""Plane geometry of the autopilot: vectors north and east, angles, and the lean that goes with an acceleration."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin

from cosim.base.constants import GRAVITY
from cosim.base.frames import upright
from cosim.base.signals import Quaternion

Pair = tuple[float, float]


def limit_length(north: float, east: float, limit: float) -> Pair:
    """Return a vector, shortened to the length ``limit`` if it is longer."""
    size = hypot(north, east)
    return (north, east) if size <= limit else (north * limit / size, east * limit / size)


def lean_acceleration(attitude: Quaternion, least_upright: float = 0.5) -> Pair:
    """Return the horizontal acceleration, m/s^2 NED, of thrust along the body's -z that holds the weight.

    Beyond a lean with the cosine ``least_upright`` it is no longer read off the attitude.
    """
    w, x, y, z = attitude
    scale = -2.0 * GRAVITY / max(upright(attitude), least_upright)
    return (scale * (x * z + w * y), scale * (y * z - w * x))


def lean_from_acceleration(acceleration: Pair, yaw: float) -> Pair:
    """Return roll and pitch (rad) at heading ``yaw`` whose :func:`lean_acceleration` is ``acceleration``."""
    c, s = cos(yaw), sin(yaw)
    forward = acceleration[0] * c + acceleration[1] * s
    right = acceleration[1] * c - acceleration[0] * s
    pitch = atan2(-forward, GRAVITY)
    return atan2(right * cos(pitch), GRAVITY), pitch


def wrap(angle: float) -> float:
    """Return an angle [rad] wrapped into [-pi, pi).

    >>> round(wrap(4.0), 4)
    -2.2832
    """
    return angle - 2.0 * pi * ((angle + pi) // (2.0 * pi))
