"""Fence and rally points as the items of MAVLink's mission protocol, both ways.

https://mavlink.io/en/services/mission.html#geofence: every corner of a polygon is an item that carries the number of
corners; a circle is one item.  Heights of rally points as those of waypoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.control.autopilot.requests import FenceUpload, FenceZone, RallyPoint, RallyUpload, ZoneKind
from cosim.groundstation.mavlink.services.items import (
    PARAM1,
    UNSUPPORTED,
    Item,
    ItemError,
    to_altitude,
    to_local_position,
)
from cosim.groundstation.mavlink.wire.dialect import mav as wire

_POLYGONS = {
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: ZoneKind.STAY_IN_POLYGON,
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: ZoneKind.STAY_OUT_OF_POLYGON,
}
_CIRCLES = {
    wire.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: ZoneKind.STAY_IN_CIRCLE,
    wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: ZoneKind.STAY_OUT_OF_CIRCLE,
}
_COMMANDS = {kind: command for command, kind in (_POLYGONS | _CIRCLES).items()}
_RALLY = wire.MAV_CMD_NAV_RALLY_POINT
# Old stations send a return point with a fence.  It is ignored, because this vehicle returns home or to a rally point.
_RETURN_POINT = wire.MAV_CMD_NAV_FENCE_RETURN_POINT


def check_fence_item(item: Item) -> None:
    """Refuse an item that is not one of a fence.  Raises ItemError."""
    if item.command not in (*_POLYGONS, *_CIRCLES, _RETURN_POINT):
        raise ItemError(UNSUPPORTED, f"command {item.command} is not one of a fence")
    first = item.params[0]
    if item.command in _CIRCLES and not (isfinite(first) and first > 0.0):
        raise ItemError(PARAM1, f"radius {first:g}: more than 0 m is needed")
    if item.command in _POLYGONS and not (isfinite(first) and first == int(first)):
        raise ItemError(PARAM1, f"{first:g} corners: a whole number is needed")


def to_fence(items: Sequence[Item], geodesy: Geodesy) -> FenceUpload:
    """Return the fence of these items.  Raises ItemError for corners that do not make up their polygon."""
    zones: list[FenceZone] = []
    corners: list[tuple[float, float]] = []
    for index, item in enumerate(items):
        if item.command == _RETURN_POINT:
            continue
        corner = to_local_position(item, geodesy, 0.0)
        try:
            if item.command in _CIRCLES:
                zones.append(FenceZone(_CIRCLES[item.command], (corner,), float(item.params[0])))
                continue
            corners.append(corner)
            count = item.params[0]
            next_item = items[index + 1] if index + 1 < len(items) else None
            if len(corners) < count and (
                next_item is None or next_item.command != item.command or next_item.params[0] != count
            ):
                raise ItemError(PARAM1, f"item {index}: a polygon of {count:g} corners ends after {len(corners)}")
            if len(corners) >= count:
                zones.append(FenceZone(_POLYGONS[item.command], tuple(corners)))
                corners = []
        except InputError as error:
            raise ItemError(PARAM1, f"item {index}: {error}") from error
    try:
        return FenceUpload(tuple(zones))
    except InputError as error:
        raise ItemError(int(wire.MAV_MISSION_NO_SPACE), str(error)) from error


def from_fence(zones: Sequence[FenceZone], geodesy: Geodesy) -> list[Item]:
    """Return a fence as mission items."""
    items = []
    for zone in zones:
        circle = zone.kind in _CIRCLES.values()
        first = zone.radius if circle else float(len(zone.points))
        for north, east in zone.points:
            x, y = _to_e7(north, east, geodesy)
            items.append(Item(wire.MAV_FRAME_GLOBAL_INT, _COMMANDS[zone.kind], (first, 0.0, 0.0, 0.0), x, y, 0.0))
    return items


def check_rally_item(item: Item) -> None:
    """Refuse an item that is not a rally point.  Raises ItemError."""
    if item.command != _RALLY:
        raise ItemError(UNSUPPORTED, f"command {item.command} is no rally point")


def to_rally(items: Sequence[Item], geodesy: Geodesy, home_altitude: float) -> RallyUpload:
    """Return the rally points of these items.  Raises ItemError."""
    points = []
    for item in items:
        altitude = to_altitude(item, geodesy, home_altitude)
        north, east = to_local_position(item, geodesy, altitude)
        try:
            points.append(RallyPoint(north, east, altitude))
        except InputError as error:
            raise ItemError(int(wire.MAV_MISSION_INVALID), str(error)) from error
    try:
        return RallyUpload(tuple(points))
    except InputError as error:
        raise ItemError(int(wire.MAV_MISSION_NO_SPACE), str(error)) from error


def from_rally(points: Sequence[RallyPoint], geodesy: Geodesy) -> list[Item]:
    """Return rally points as mission items, heights above the sea."""
    items = []
    for point in points:
        x, y = _to_e7(point.north, point.east, geodesy)
        z = geodesy.ground + point.altitude
        items.append(Item(wire.MAV_FRAME_GLOBAL_INT, _RALLY, (0.0, 0.0, 0.0, 0.0), x, y, z))
    return items


CHECKS: dict[int, Callable[[Item], None]] = {
    wire.MAV_MISSION_TYPE_FENCE: check_fence_item,
    wire.MAV_MISSION_TYPE_RALLY: check_rally_item,
}


def _to_e7(north: float, east: float, geodesy: Geodesy) -> tuple[int, int]:
    latitude, longitude, _ = geodesy.to_geodetic(north, east, 0.0)
    return round(1e7 * latitude), round(1e7 * longitude)
