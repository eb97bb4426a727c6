"""The magnetometer that autopilots' estimators need: the Earth's magnetic field in body axes.

Gyro, accelerometer, attitude, GNSS and barometer are the vehicle's, with noise, bias, filter, latency and faults.
The magnetometer has no model of its own: it gives the field of the place, turned by the attitude sensor's attitude,
whose noise is thus its noise.
"""

from __future__ import annotations

from math import atan2, cos, hypot, radians, sin, sqrt

from cosim.base.frames import conjugate, rotate
from cosim.base.geodesy import FLATTENING, SEMI_MAJOR
from cosim.base.signals import Quaternion, Vector3

# Coefficients of IGRF-14 for 2025 [nT] (IAGA Working Group V-MOD, 2024) by degree: g of orders from 0, h from 1.
# fmt: off
_IGRF_NT = (
    ((-29350.0, -1410.3), (4545.5,)),
    ((-2556.2, 2950.9, 1648.7), (-3133.6, -814.2)),
    ((1360.9, -2404.2, 1243.8, 453.4), (-56.9, 237.6, -549.6)),
    ((894.7, 799.6, 55.8, -281.1, 12.0), (278.6, -134.0, 212.0, -375.4)),
    ((-232.9, 369.0, 187.2, -138.7, -141.9, 20.9), (45.3, 220.0, -122.9, 42.9, 106.2)),
    ((64.3, 63.8, 76.7, -115.7, -40.9, 14.9, -60.8), (-18.4, 16.8, 48.9, -59.8, 10.9, 72.8)),
    ((79.6, -76.9, -8.8, 59.3, 15.8, 2.5, -11.2, 14.3), (-48.9, -14.4, -1.0, 23.5, -7.4, -25.1, -2.2)),
    ((23.1, 10.9, -17.5, 2.0, -21.8, 16.9, 14.9, -16.8, 1.0), (7.2, -12.6, 11.5, -9.7, 12.7, 0.7, -5.2, 3.9)),
    ((4.7, 8.0, 3.0, -0.2, -2.5, -13.1, 2.4, 8.6, -8.7, -12.8),
     (-24.8, 12.1, 8.3, -3.4, -5.3, 7.2, -0.6, 0.8, 9.8)),
    ((-1.3, -6.4, 0.2, 2.0, -1.0, -0.5, -0.9, 1.5, 0.9, -2.6, -3.9),
     (3.3, 0.1, 2.5, 5.4, -9.0, 0.4, -4.2, -3.8, 0.9, -9.0)),
    ((3.0, -1.4, -2.5, 2.4, -0.6, 0.0, -0.6, -0.1, 1.1, -1.0, -0.1, 2.6),
     (0.0, 2.8, -0.6, 0.1, 0.5, -0.3, -1.2, -1.7, -2.9, -1.8, -2.3)),
    ((-2.0, -0.1, 0.4, 1.2, -1.2, 0.6, 0.5, 0.5, -0.1, -0.5, -0.2, -1.2, -0.7),
     (-1.2, 0.6, 1.0, -1.5, 0.0, 0.6, -0.2, 0.8, 0.1, -0.9, 0.1, 0.2)),
    ((0.2, -0.9, 0.6, 0.7, -0.2, 0.5, 0.1, 0.7, 0.0, 0.3, 0.2, 0.4, -0.5, -0.4),
     (-0.9, 0.7, 1.2, -0.3, -1.3, -0.1, 0.2, -0.2, 0.5, 0.6, -0.6, -0.3, -0.5)),
)
# fmt: on


def compute_earth_field(latitude_deg: float, longitude_deg: float, degree: int = len(_IGRF_NT)) -> Vector3:
    """Return the Earth's magnetic field at the surface, north, east, down [gauss], from IGRF-14.

    ``V = a sum (a/r)^(n+1) (g cos(m p) + h sin(m p)) P_nm(cos t)``, ``t`` the geocentric colatitude, ``p`` the
    longitude, ``P`` normalised after Schmidt, and ``B = -grad V``; turned from the centre's vertical to the
    ellipsoid's.  An estimator looks the field up, and takes what is not in ours for an error of the compass.
    """
    latitude, p = radians(latitude_deg), radians(longitude_deg)
    c, s = cos(latitude), (1.0 - FLATTENING) ** 2 * sin(latitude)
    centric = atan2(s, c)
    ct, st = sin(centric), cos(centric)
    radius = 6371200.0  # m, of IGRF's expansion
    ratio = radius / (SEMI_MAJOR * hypot(c, s) / sqrt(c * c + s * sin(latitude)))
    radial = south = east = 0.0
    for m in range(degree + 1):
        # Legendre functions of this order and their derivatives in t, each degree's from the two before it.
        value, slope, older, older_slope = *_sectoral(m, ct, st), 0.0, 0.0
        for n in range(m, degree + 1):
            if n > m:
                root, before = sqrt(n * n - m * m), sqrt((n - 1) ** 2 - m * m)
                new = ((2 * n - 1) * ct * value - before * older) / root
                new_slope = ((2 * n - 1) * (ct * slope - st * value) - before * older_slope) / root
                value, slope, older, older_slope = new, new_slope, value, slope
            if n == 0:
                continue
            g, h = _IGRF_NT[n - 1][0][m], _IGRF_NT[n - 1][1][m - 1] if m else 0.0
            wave, turned = g * cos(m * p) + h * sin(m * p), m * (g * sin(m * p) - h * cos(m * p))
            size = ratio ** (n + 2)
            radial += (n + 1) * size * wave * value
            south -= size * wave * slope
            east += size * turned * value / st
    tilt = latitude - centric
    north, down = -south * cos(tilt) - radial * sin(tilt), south * sin(tilt) - radial * cos(tilt)
    return (1e-5 * north, 1e-5 * east, 1e-5 * down)


def _sectoral(order: int, ct: float, st: float) -> tuple[float, float]:
    """Return the first Legendre function of an order and its slope in t (``ct``: cos t, ``st``: sin t)."""
    factor = 1.0
    for m in range(2, order + 1):
        factor *= sqrt((2 * m - 1) / (2 * m))
    return factor * st**order, factor * order * st ** (order - 1) * ct if order else 0.0


def to_body_field(field: Vector3, attitude: Quaternion) -> Vector3:
    """Return the magnetic field in body axes from that in north, east, down [gauss]."""
    return rotate(conjugate(attitude), field)
