"""Rotations and tilts.  Quaternions are ``(w, x, y, z)``, Hamilton product, body (FRD) to NED.

Scalar code on tuples: these run a few times per control step, where an array would cost more than the arithmetic.
"""

from __future__ import annotations

from math import asin, atan2, cos, sin, sqrt

from cosim.base.signals import Quaternion, Vector3

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)  # quaternion of no rotation


def from_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of the yaw-pitch-roll sequence (rad): body to NED."""
    cr, sr = cos(0.5 * roll), sin(0.5 * roll)
    cp, sp = cos(0.5 * pitch), sin(0.5 * pitch)
    cy, sy = cos(0.5 * yaw), sin(0.5 * yaw)
    cc, ss, sc, cs = cr * cp, sr * sp, sr * cp, cr * sp
    return (cc * cy + ss * sy, sc * cy - cs * sy, cs * cy + sc * sy, cc * sy - ss * cy)


def to_euler(q: Quaternion) -> Vector3:
    """Return roll, pitch, yaw (rad) of a unit quaternion; pitch in [-pi/2, pi/2], the others in [-pi, pi]."""
    w, x, y, z = q
    sine = 2.0 * (w * y - x * z)
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(max(-1.0, min(1.0, sine))),
        heading_of(q),
    )


def heading_of(q: Quaternion) -> float:
    """Return the yaw (rad) of a unit quaternion, in [-pi, pi]."""
    w, x, y, z = q
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


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


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def normalize(q: Quaternion) -> Quaternion:
    """Return ``q`` scaled to unit length.  Raises ZeroDivisionError for the zero quaternion."""
    w, x, y, z = q
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


def rotate(q: Quaternion, v: Vector3) -> Vector3:
    """Return a body vector in NED, for the unit quaternion of the body's attitude."""
    w, x, y, z = q
    vx, vy, vz = v
    # The result is v + 2 w (r x v) + 2 r x (r x v) with r = (x, y, z).
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return the cross product ``a x b``."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def upright(q: Quaternion) -> float:
    """Return the cosine of the angle between the body's z axis and straight down, for a unit quaternion."""
    _, x, y, _ = q
    return 1.0 - 2.0 * (x * x + y * y)


def jet_axis(tilt: float) -> Vector3:
    """Return the unit thrust direction, body, of a jet tilted by ``tilt`` rad from straight up (-z) to forward (+x)."""
    return (sin(tilt), 0.0, -cos(tilt))
