"""What a vehicle's file cannot mean, though every number in it is allowed: wrong units, and legs that do not carry it.

Asked of files as they are read, not of what is written over them: a study may go where no vehicle is.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, sqrt

from cosim.base.signals import Vector3

FARTHEST_M = 100.0  # chosen by us: no vehicle here has a part farther from its centre of gravity
# Radius of gyration over the farthest part's distance from the axis.  Bodies have 0.05 to 1; chosen by us: beyond three
# times that a unit is wrong, because a thousandfold mass, length or inertia is off by thirty at least.
GYRATION = (0.02, 3.0)


def implausible(mass: float, inertia: Vector3, places: Mapping[str, Vector3], legs: Mapping[str, Vector3]) -> str:
    """The first thing that cannot be meant: key, value and what is allowed, in one line; empty if there is none.

    ``mass`` [kg], ``inertia`` [kg m^2], and by their keys the ``places`` of all parts and those of the ``legs`` [m].
    """
    for key, place in places.items():
        if hypot(*place) > FARTHEST_M:
            return (
                f"{key} {list(place)}: {hypot(*place):g} m from the centre of gravity, and at most {FARTHEST_M:g} m is "
                "allowed; places are in m"
            )
    return _gyration(mass, inertia, list(places.values())) or _legs(legs)


def _gyration(mass: float, inertia: Vector3, places: list[Vector3]) -> str:
    low, high = GYRATION
    for n, (axis, moment) in enumerate(zip("xyz", inertia, strict=True)):
        farthest = max(hypot(*(x for other, x in enumerate(place) if other != n)) for place in places)
        radius = sqrt(moment / mass)
        if not low * farthest <= radius <= high * farthest:
            least, most = (mass * (share * farthest) ** 2 for share in GYRATION)
            return (
                f"inertia_kg_m2.{n} = {moment:g} with mass_kg = {mass:g}: a radius of gyration of {radius:.3g} m about "
                f"{axis}, where parts reach {farthest:.3g} m; {least:.2g} to {most:.2g} kg m^2 is allowed: are they in "
                "kg, m and kg m^2?"
            )
    return ""


def _legs(legs: Mapping[str, Vector3]) -> str:
    if len(legs) < 3:
        return f"contacts: {len(legs)} of kind 'leg'; a vehicle stands on three at least, around its centre of gravity"
    for key, place in legs.items():
        if place[2] <= 0.0:
            return f"{key} {list(place)}: a leg reaches below the centre of gravity; z points down and must be above 0"
    if not _around([(x, y) for x, y, _ in legs.values()]):
        at = ", ".join(f"[{x:g}, {y:g}]" for x, y, _ in legs.values())
        return f"contacts: the centre of gravity, [0, 0], is not between the legs at {at} m; they must stand around it"
    return ""


def _around(points: list[tuple[float, float]]) -> bool:
    """Whether the origin is inside the hull of points: no straight line through it has them all on one side of it."""
    for x, y in points:
        # of the lines through the origin those through a point are enough
        sides = [x * b - y * a for a, b in points]
        if min(sides) >= 0.0 or max(sides) <= 0.0:
            ahead = [x * a + y * b for (a, b), side in zip(points, sides, strict=True) if side == 0.0]
            if min(ahead) >= 0.0 or not any(sides):
                return False
    return True
