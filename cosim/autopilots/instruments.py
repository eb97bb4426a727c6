"""What estimators of others want beside gyro and accelerometer: a magnetic field in body axes.

Gyro, accelerometer, attitude, GNSS and barometer are the vehicle's, with noise, bias, filter, latency and faults.
The magnetometer has no model of its own: it gives the field of the place, turned by the attitude sensor's attitude,
whose noise is thus its noise.
"""

from __future__ import annotations

from math import cos, radians, sin

from cosim.base.frames import conjugate, rotate
from cosim.base.signals import Quaternion, Vector3

# IGRF-14, coefficients of degree 1 of 2025 (IAGA Working Group V-MOD, 2024), nT.
_G10, _G11, _H11 = -29350.0, -1410.3, 4545.5


def dipole_field(latitude_deg: float, longitude_deg: float) -> Vector3:
    """The Earth's field at the surface, north, east, down [gauss]: the inclined dipole of IGRF-14's first three terms.

    ``V = a (g10 cos(t) + (g11 cos(p) + h11 sin(p)) sin(t))`` at ``r = a``, ``t`` the colatitude, ``p`` the longitude,
    and ``B = -grad V``.  All terms above are left out: an estimator that looks the field up sees an error of the
    compass.  A measured field is stated in its place.
    """
    latitude, p = radians(latitude_deg), radians(longitude_deg)
    ct, st = sin(latitude), cos(latitude)
    plane = _G11 * cos(p) + _H11 * sin(p)
    north = -_G10 * st + plane * ct
    east = _G11 * sin(p) - _H11 * cos(p)
    down = -2.0 * (_G10 * ct + plane * st)
    return (1e-5 * north, 1e-5 * east, 1e-5 * down)


def compass(field: Vector3, attitude: Quaternion) -> Vector3:
    """The field in body axes [gauss]."""
    return rotate(conjugate(attitude), field)
