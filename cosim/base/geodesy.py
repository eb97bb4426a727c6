"""Where a place of the flight is on the Earth, and back.

The flight counts north and east in the plane that touches the ellipsoid WGS 84 below the start, and height above the
ground along the vertical of the place itself, as JSBSim and the sensors do.  Against JSBSim's own latitude and
longitude this is right to a micrometre at 10 km (measured).  The plane is 8 m above the sea there, which is why heights
are not counted along its normal.
"""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, radians, sin, sqrt

from cosim.base.errors import InputError

SEMI_MAJOR = 6378137.0  # m, semi-major axis of WGS 84
FLATTENING = 1.0 / 298.257223563  # flattening of WGS 84
_ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)  # of WGS 84
_EQUATOR, _SOMIGLIANA = 9.7803253359, 1.931852652458e-3  # m/s^2 and 1: normal gravity of WGS 84
# Limit of iterations on the height; each gains two digits or more.
_MAX_ITERATIONS = 8


def gravity(latitude_deg: float, height: float, per_height: float = -3.086e-6) -> float:
    """Return gravity [m/s^2] at ``height`` [m] above the ellipsoid, centrifugal part included (Somigliana).

    ``per_height``: 1/s^2, of gravity above the ellipsoid: within a mm/s^2 up to 10 km.
    """
    square = sin(radians(latitude_deg)) ** 2
    return _EQUATOR * (1.0 + _SOMIGLIANA * square) / sqrt(1.0 - _ECCENTRICITY_SQUARED * square) + per_height * height


class Geodesy:
    """Conversion between latitude, longitude (deg) and metres north and east of a flight's start.

    ``ground``: height of the ground above the ellipsoid, m; there is no geoid model, so that it is also what the
    vehicle calls its height above the sea.  Raises InputError for a start at a pole or off the map.
    """

    def __init__(self, latitude_deg: float, longitude_deg: float, ground: float = 0.0) -> None:
        if not (-89.9 <= latitude_deg <= 89.9 and -180.0 <= longitude_deg <= 180.0):
            raise InputError(f"start at {latitude_deg!r}, {longitude_deg!r}: latitude to 89.9, longitude to 180 deg")
        self.latitude_deg, self.longitude_deg, self.ground = latitude_deg, longitude_deg, ground
        latitude, longitude = radians(latitude_deg), radians(longitude_deg)
        self._s, self._c = sin(latitude), cos(latitude)
        self._sl, self._cl = sin(longitude), cos(longitude)
        self._origin = _to_ecef(latitude, longitude, ground)

    def to_geodetic(self, north: float, east: float, altitude: float = 0.0) -> tuple[float, float, float]:
        """Return latitude, longitude (deg) and height above the sea (m) of a point at ``altitude`` above the ground."""
        height = self.ground + altitude
        up, latitude, longitude = altitude, 0.0, 0.0
        for _ in range(_MAX_ITERATIONS):
            # Find the point at this height on the normal of the start's tangent plane through (north, east).
            latitude, longitude, reached = _from_ecef(*self._local_to_ecef(north, east, up))
            up += height - reached
            if abs(height - reached) < 1e-7:
                break
        return degrees(latitude), degrees(longitude), height

    def to_local(self, latitude_deg: float, longitude_deg: float, height: float = 0.0) -> tuple[float, float, float]:
        """Return north, east and height above the ground (m) of a point at ``height`` above the sea."""
        place = _to_ecef(radians(latitude_deg), radians(longitude_deg), height)
        x, y, z = (a - b for a, b in zip(place, self._origin, strict=True))
        outward = self._cl * x + self._sl * y
        return self._c * z - self._s * outward, self._cl * y - self._sl * x, height - self.ground

    def _local_to_ecef(self, north: float, east: float, up: float) -> tuple[float, float, float]:
        outward = self._c * up - self._s * north
        x0, y0, z0 = self._origin
        return (
            x0 + self._cl * outward - self._sl * east,
            y0 + self._sl * outward + self._cl * east,
            z0 + self._c * north + self._s * up,
        )


def _to_ecef(latitude: float, longitude: float, height: float) -> tuple[float, float, float]:
    """Return the Earth-centred, Earth-fixed position, m, of geodetic coordinates (rad, m)."""
    s, c = sin(latitude), cos(latitude)
    normal = SEMI_MAJOR / sqrt(1.0 - _ECCENTRICITY_SQUARED * s * s)
    across = (normal + height) * c
    return across * cos(longitude), across * sin(longitude), (normal * (1.0 - _ECCENTRICITY_SQUARED) + height) * s


def _from_ecef(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return latitude, longitude (rad) and height (m) of an Earth-fixed point away from the poles' axis."""
    across = hypot(x, y)
    latitude, height = atan2(z, across * (1.0 - _ECCENTRICITY_SQUARED)), 0.0
    for _ in range(_MAX_ITERATIONS):
        s = sin(latitude)
        normal = SEMI_MAJOR / sqrt(1.0 - _ECCENTRICITY_SQUARED * s * s)
        before, latitude = latitude, atan2(z + _ECCENTRICITY_SQUARED * normal * s, across)
        if abs(latitude - before) < 1e-15:
            break
    s, c = sin(latitude), cos(latitude)
    # This form, the sum of parts along and across the normal, is well conditioned at every latitude.
    height = across * c + z * s - SEMI_MAJOR * sqrt(1.0 - _ECCENTRICITY_SQUARED * s * s)
    return latitude, atan2(y, x), height
