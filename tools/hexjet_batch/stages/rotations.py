"""Rotations over a batch: quaternions ``(w, x, y, z)``, body to NED, each component an array over the flights.

The formulas are those of :mod:`cosim.base.frames`, whose compiled functions take the floats of one flight alone.
"""

from __future__ import annotations

from typing import Any

from hexjet_batch.numbers import is_absent

# Three and four numbers, or arrays over the flights.
Vector = tuple[Any, ...]
Quaternion = tuple[Any, ...]


def from_euler(roll: Any, pitch: Any, yaw: Any, xp: Any) -> Quaternion:
    """Return the quaternion of the yaw-pitch-roll sequence [rad]."""
    cr, sr = xp.cos(0.5 * roll), xp.sin(0.5 * roll)
    cp, sp = xp.cos(0.5 * pitch), xp.sin(0.5 * pitch)
    cy, sy = xp.cos(0.5 * yaw), xp.sin(0.5 * yaw)
    cc, ss, sc, cs = cr * cp, sr * sp, sr * cp, cr * sp
    return (cc * cy + ss * sy, sc * cy - cs * sy, cs * cy + sc * sy, cc * sy - ss * cy)


def to_euler(q: Quaternion, xp: Any) -> Vector:
    """Return roll, pitch and yaw [rad]."""
    w, x, y, z = q
    return (
        xp.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        xp.asin(xp.clip(2.0 * (w * y - x * z), -1.0, 1.0)),
        xp.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product ``a b``: rotate by ``b`` first, then by ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def rotate(q: Quaternion, v: Vector) -> Vector:
    """Return a body vector in NED, for the unit quaternion of the body's attitude."""
    w, x, y, z = q
    vx, vy, vz = v
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def rotate_back(q: Quaternion, v: Vector) -> Vector:
    """Return a vector in NED in the body's axes."""
    return rotate((q[0], -q[1], -q[2], -q[3]), v)


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product ``a x b``."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def add(a: Vector, b: Vector, factor: Any = 1.0) -> Vector:
    """Return ``a + factor b``; ``b`` may be the plain zero of all flights."""
    if is_absent(*b):
        return a
    if isinstance(factor, float) and factor == 1.0:
        return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


def turn_by(half: Vector) -> Quaternion:
    """Return the quaternion of a small turn, from half its vector [rad]; its length is 1 to the sixth order."""
    x, y, z = half
    square = x * x + y * y + z * z
    sine = 1.0 - square * (1.0 / 6.0 - square / 120.0)
    return (1.0 - square * (0.5 - square / 24.0), sine * x, sine * y, sine * z)


def normalize(q: Quaternion) -> Quaternion:
    """Return a quaternion whose length is 1 but for rounding with length 1: one step of Newton's method."""
    w, x, y, z = q
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)
