"""Plausibility check of a vehicle's file: implausible units, and legs that cannot carry the vehicle.

Files are checked as they are read, overrides are not: a study may vary a vehicle beyond what is plausible.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, sqrt

from cosim.base.signals import Vector3

FARTHEST_M = 100.0  # chosen by us: no vehicle here has a part farther from its centre of gravity
# Radius of gyration over the farthest part's distance from the axis.  Bodies have 0.05 to 1; chosen by us: beyond three
# times that a unit is wrong, because a thousandfold mass, length or inertia is off by thirty at least.
GYRATION = (0.02, 3.0)


def find_implausible(
    mass: float, inertia: Vector3, positions: Mapping[str, Vector3], legs: Mapping[str, Vector3]
) -> str:
    """Return the first implausible value as one line (key, value, allowed range), or an empty string if there is none.

    ``mass`` [kg], ``inertia`` [kg m^2], positions of all parts and of the ``legs`` [m, body frame] by their keys.
    """
    for key, position in positions.items():
        if hypot(*position) > FARTHEST_M:
            return (
                f"{key} {list(position)}: {hypot(*position):g} m from the centre of gravity, and at most "
                f"{FARTHEST_M:g} m is allowed; places are in m"
            )
    return _check_gyration(mass, inertia, list(positions.values())) or _check_legs(legs)


def _check_gyration(mass: float, inertia: Vector3, positions: list[Vector3]) -> str:
    low, high = GYRATION
    for n, (axis, moment) in enumerate(zip("xyz", inertia, strict=True)):
        farthest = max(hypot(*(x for other, x in enumerate(position) if other != n)) for position in positions)
        radius = sqrt(moment / mass)
        if not low * farthest <= radius <= high * farthest:
            least, most = (mass * (ratio * farthest) ** 2 for ratio in GYRATION)
            return (
                f"inertia_kg_m2.{n} = {moment:g} with mass_kg = {mass:g}: a radius of gyration of {radius:.3g} m about "
                f"{axis}, where parts reach {farthest:.3g} m; {least:.2g} to {most:.2g} kg m^2 is allowed: are they in "
                "kg, m and kg m^2?"
            )
    return ""


def _check_legs(legs: Mapping[str, Vector3]) -> str:
    if len(legs) < 3:
        return f"contacts: {len(legs)} of kind 'leg'; a vehicle stands on three at least, around its centre of gravity"
    for key, foot in legs.items():
        if foot[2] <= 0.0:
            return f"{key} {list(foot)}: a leg reaches below the centre of gravity; z points down and must be above 0"
    if not _surround_origin([(x, y) for x, y, _ in legs.values()]):
        at = ", ".join(f"[{x:g}, {y:g}]" for x, y, _ in legs.values())
        return f"contacts: the centre of gravity, [0, 0], is not between the legs at {at} m; they must stand around it"
    return ""


def _surround_origin(points: list[tuple[float, float]]) -> bool:
    """Return whether the origin is inside the convex hull: no line through it has all points on one side."""
    for x, y in points:
        # It is enough to try the lines through the origin and one of the points.
        sides = [x * b - y * a for a, b in points]
        if min(sides) >= 0.0 or max(sides) <= 0.0:
            ahead = [x * a + y * b for (a, b), side in zip(points, sides, strict=True) if side == 0.0]
            if min(ahead) >= 0.0 or not any(sides):
                return False
    return True
