"""The fence that a ground station draws: polygons and circles that the vehicle has to stay inside or outside of.

Inside the fence is who is inside at least one of the zones to stay in, where there are any, and outside every zone to
stay out of; on the edge is inside.  Plane geometry in north and east, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from cosim.control.autopilot.requests import FenceZone, ZoneKind

_INCLUSION_ZONES = (ZoneKind.STAY_IN_POLYGON, ZoneKind.STAY_IN_CIRCLE)  # zones that the vehicle must stay inside
_CIRCULAR_ZONES = (ZoneKind.STAY_IN_CIRCLE, ZoneKind.STAY_OUT_OF_CIRCLE)  # zones that are circles


def measure_excess(zones: Sequence[FenceZone], north: float, east: float) -> tuple[float, str]:
    """Return how far a position violates the zones of the fence [m], and a text on which; 0 and empty: it does not."""
    outside: float | None = None
    for zone in zones:
        if zone.kind in _INCLUSION_ZONES:
            distance = edge_distance(zone, north, east)
            outside = max(-distance, 0.0) if outside is None else min(outside, max(-distance, 0.0))
    worst, why = 0.0, ""
    if outside:
        worst, why = outside, f"{outside:.0f} m outside the zone to stay in"
    for number, zone in enumerate(zones):
        if zone.kind not in _INCLUSION_ZONES and (inside := edge_distance(zone, north, east)) > worst:
            worst, why = inside, f"{inside:.0f} m inside zone {number}, to stay out of"
    return worst, why


def edge_distance(zone: FenceZone, north: float, east: float) -> float:
    """Return the distance to the edge of a zone (m): positive inside, negative outside."""
    if zone.kind in _CIRCULAR_ZONES:
        (n, e) = zone.points[0]
        return zone.radius - hypot(north - n, east - e)
    inside, nearest = False, float("inf")
    (n0, e0) = zone.points[-1]
    for n1, e1 in zone.points:
        # Whether a ray to the north crosses this edge.
        if (e0 > east) != (e1 > east) and north < n0 + (east - e0) / (e1 - e0) * (n1 - n0):
            inside = not inside
        nearest = min(nearest, _distance_to_edge(north, east, n0, e0, n1, e1))
        n0, e0 = n1, e1
    return nearest if inside else -nearest


def _distance_to_edge(north: float, east: float, n0: float, e0: float, n1: float, e1: float) -> float:
    dn, de = n1 - n0, e1 - e0
    square = dn * dn + de * de
    fraction = 0.0 if square == 0.0 else min(1.0, max(0.0, ((north - n0) * dn + (east - e0) * de) / square))
    return hypot(north - n0 - fraction * dn, east - e0 - fraction * de)
