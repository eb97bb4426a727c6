"""Conversion between MAVLink's mission items and what the autopilot flies: missions, fences, rally points.

https://mavlink.io/en/services/mission.html#geofence: every corner of a polygon is an item that carries the number of
corners; a circle is one item.  Heights of rally points as those of waypoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import degrees, hypot, isfinite, isnan, nan, pi, radians
from typing import NamedTuple, get_args

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.requests import ItemKind, Metres, MissionItem, ZoneKind
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire

ACCEPTED, ERROR = wire.MAV_MISSION_ACCEPTED, wire.MAV_MISSION_ERROR  # MAV_MISSION_RESULT
WRONG_FRAME, UNSUPPORTED = wire.MAV_MISSION_UNSUPPORTED_FRAME, wire.MAV_MISSION_UNSUPPORTED  # MAV_MISSION_RESULT
NO_SPACE, INVALID = wire.MAV_MISSION_NO_SPACE, wire.MAV_MISSION_INVALID  # MAV_MISSION_RESULT
PARAM1, PARAM2 = wire.MAV_MISSION_INVALID_PARAM1, wire.MAV_MISSION_INVALID_PARAM2  # MAV_MISSION_RESULT
PARAM3, PARAM4 = wire.MAV_MISSION_INVALID_PARAM3, wire.MAV_MISSION_INVALID_PARAM4  # MAV_MISSION_RESULT
PARAM5, PARAM6 = wire.MAV_MISSION_INVALID_PARAM5_X, wire.MAV_MISSION_INVALID_PARAM6_Y  # MAV_MISSION_RESULT
PARAM7_INVALID = wire.MAV_MISSION_INVALID_PARAM7  # MAV_MISSION_RESULT
SEQUENCE, DENIED = wire.MAV_MISSION_INVALID_SEQUENCE, wire.MAV_MISSION_DENIED  # MAV_MISSION_RESULT
CANCELLED = wire.MAV_MISSION_OPERATION_CANCELLED  # MAV_MISSION_RESULT

WAYPOINT, LOITER_TIME = wire.MAV_CMD_NAV_WAYPOINT, wire.MAV_CMD_NAV_LOITER_TIME  # MAV_CMD
LOITER, LOITER_TURNS = wire.MAV_CMD_NAV_LOITER_UNLIM, wire.MAV_CMD_NAV_LOITER_TURNS  # MAV_CMD
LOITER_ALTITUDE = wire.MAV_CMD_NAV_LOITER_TO_ALT  # MAV_CMD
RETURN, LAND, TAKEOFF = wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, wire.MAV_CMD_NAV_LAND, wire.MAV_CMD_NAV_TAKEOFF  # MAV_CMD
DELAY, JUMP, SPEED = wire.MAV_CMD_NAV_DELAY, wire.MAV_CMD_DO_JUMP, wire.MAV_CMD_DO_CHANGE_SPEED  # MAV_CMD

# Commands for payloads that no vehicle here has (cameras, gimbals, regions of interest, triggers), and landing marks.
# Missions skip such items.
LEFT_OUT: dict[int, str] = {
    getattr(wire, f"MAV_CMD_{name}"): name
    for name in (
        "NAV_ROI", "DO_LAND_START", "DO_SET_ROI_LOCATION", "DO_SET_ROI_WPNEXT_OFFSET", "DO_SET_ROI_NONE",
        "DO_CONTROL_VIDEO", "DO_SET_ROI", "DO_DIGICAM_CONFIGURE", "DO_DIGICAM_CONTROL", "DO_MOUNT_CONFIGURE",
        "DO_MOUNT_CONTROL", "DO_SET_CAM_TRIGG_DIST", "DO_SET_CAM_TRIGG_INTERVAL", "DO_GIMBAL_MANAGER_PITCHYAW",
        "DO_GIMBAL_MANAGER_CONFIGURE", "SET_CAMERA_MODE", "SET_CAMERA_ZOOM", "SET_CAMERA_FOCUS",
        "IMAGE_START_CAPTURE", "IMAGE_STOP_CAPTURE", "DO_TRIGGER_CONTROL", "VIDEO_START_CAPTURE",
        "VIDEO_STOP_CAPTURE", "OBLIQUE_SURVEY",
    )
    if hasattr(wire, f"MAV_CMD_{name}")
}  # fmt: skip

_SEA_FRAMES = (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_GLOBAL_INT)  # frames with z above the sea
_HOME_FRAMES = (wire.MAV_FRAME_GLOBAL_RELATIVE_ALT, wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)  # frames with z above home
MAX_DISTANCE_M: float = get_args(Metres)[1].upper  # same limit as requests to the pilot
NO_POSITION = 2**31 - 1  # x or y if none is stated


class Item(NamedTuple):
    """A MAVLink mission item: ``x``, ``y`` in 1e-7 deg, ``z`` in m."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1


class ItemError(Exception):
    """Raised for an item that cannot be flown; ``code`` is the MAV_MISSION_RESULT that says why."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


def to_mission_item(item: Item, geodesy: Geodesy, home_altitude: float) -> MissionItem:
    """Convert a MAVLink item to the autopilot's; ``home_altitude`` [m] above the origin.  Raises ItemError."""
    try:
        if item.command in (WAYPOINT, LOITER_TIME):
            return _to_waypoint(item, geodesy, home_altitude)
        if item.command in (LOITER, LOITER_TURNS, LOITER_ALTITUDE):
            return _to_loiter(item, geodesy, home_altitude)
        if item.command == TAKEOFF:
            altitude = to_altitude(item, geodesy, home_altitude)
            return MissionItem(ItemKind.TAKEOFF, altitude=altitude, yaw=_parse_heading(item.params[3]))
        if item.command == LAND:
            north, east = _position_or_here(item, geodesy, 0.0)
            return MissionItem(ItemKind.LAND, north, east, yaw=_parse_heading(item.params[3]))
        return _to_instruction(item.command, *item.params[:2])
    except InputError as error:  # outside the autopilot's limits
        raise ItemError(_find_code(str(error)), str(error).removeprefix("MissionItem.")) from error


def _to_instruction(command: int, p1: float, p2: float) -> MissionItem:
    """Convert a command without position from its first two parameters.  Raises ItemError."""
    if command in LEFT_OUT:
        return MissionItem(ItemKind.LEFT_OUT)
    if command == RETURN:
        return MissionItem(ItemKind.RETURN)
    if command == DELAY:
        return MissionItem(ItemKind.DELAY, hold_s=_parse_number(p1, PARAM1, "delay", 0.0))
    if command == JUMP:
        target = _parse_integer(p1, PARAM1, "item to jump to")
        repeat = -1 if p2 == -1.0 else _parse_integer(p2, PARAM2, "number of jumps", ", or -1 for ever")
        return MissionItem(ItemKind.JUMP, target=target, repeat=repeat)
    if command != SPEED:
        raise ItemError(UNSUPPORTED, f"command {command} is not known here")
    if p1 not in (0.0, 1.0):
        raise ItemError(PARAM1, "only the horizontal speed can be set")
    return MissionItem(ItemKind.SPEED, speed=_parse_number(p2, PARAM2, "speed", 0.1))


def to_item(item: MissionItem, geodesy: Geodesy) -> Item:
    """Convert an autopilot's item to MAVLink, with heights above the sea."""
    x = y = 0
    if item.north is not None and item.east is not None:
        latitude, longitude, _ = geodesy.to_geodetic(item.north, item.east, item.altitude or 0.0)
        x, y = round(1e7 * latitude), round(1e7 * longitude)
    z = 0.0 if item.altitude is None else geodesy.ground + item.altitude
    yaw = nan if item.yaw is None else degrees(item.yaw)
    global_frame, mission_frame = wire.MAV_FRAME_GLOBAL_INT, wire.MAV_FRAME_MISSION
    radius = (item.radius or 0.0) * (1.0 if item.clockwise else -1.0)
    delay = Item(mission_frame, DELAY, (item.hold_s, -1.0, -1.0, -1.0), 0, 0, 0.0)
    return {
        ItemKind.WAYPOINT: Item(global_frame, WAYPOINT, (item.hold_s, item.acceptance_m, 0.0, yaw), x, y, z),
        ItemKind.TAKEOFF: Item(global_frame, TAKEOFF, (0.0, 0.0, 0.0, yaw), NO_POSITION, NO_POSITION, z),
        ItemKind.LAND: Item(global_frame, LAND, (0.0, 0.0, 0.0, yaw), x, y, geodesy.ground),
        ItemKind.STAY: Item(global_frame, LOITER, (0.0, 0.0, 0.0, yaw), x, y, z),
        ItemKind.CIRCLE: Item(global_frame, LOITER_TURNS, (item.turns, 0.0, radius, 0.0), x, y, z),
        ItemKind.ALTITUDE: Item(global_frame, LOITER_ALTITUDE, (0.0, 0.0, 0.0, 0.0), x, y, z),
        ItemKind.SPEED: Item(mission_frame, SPEED, (1.0, item.speed or 0.0, -1.0, 0.0), 0, 0, 0.0),
        ItemKind.DELAY: delay,
        ItemKind.LEFT_OUT: delay,  # a delay of length 0
        ItemKind.JUMP: Item(mission_frame, JUMP, (float(item.target or 0), float(item.repeat), 0.0, 0.0), 0, 0, 0.0),
        ItemKind.RETURN: Item(mission_frame, RETURN, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0),
    }[item.kind]


def parse_item(message: Message) -> Item:
    """Return the item of MISSION_ITEM_INT or of the old MISSION_ITEM, whose position is in degrees."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        x, y = _degrees_to_e7(x), _degrees_to_e7(y)
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.frame, message.command, params, x, y, message.z, message.autocontinue)


def _degrees_to_e7(value: float) -> int:
    """Convert degrees to 1e-7 deg; an invalid angle becomes NO_POSITION."""
    return round(1e7 * value) if abs(value) <= 200.0 else NO_POSITION


def _to_waypoint(item: Item, geodesy: Geodesy, home_altitude: float) -> MissionItem:
    hold, radius, _, yaw = item.params
    altitude = to_altitude(item, geodesy, home_altitude)
    north, east = to_local_position(item, geodesy, altitude)
    if item.command == LOITER_TIME:  # its parameters describe a circle
        radius = 0.0
    hold_s = _parse_number(hold, PARAM1, "time to hold", 0.0, 0.0)
    acceptance_m = _parse_number(radius, PARAM2, "radius", 0.0, 0.0)
    return MissionItem(ItemKind.WAYPOINT, north, east, altitude, _parse_heading(yaw), hold_s, acceptance_m)


def _to_loiter(item: Item, geodesy: Geodesy, home_altitude: float) -> MissionItem:
    """Convert a loiter command: stay for good, change height at one position, or circle a number of turns.

    Radii of the others, and a heading before it goes on, are for vehicles with wings.
    """
    turns, _, radius, yaw = item.params
    altitude = to_altitude(item, geodesy, home_altitude)
    if item.command == LOITER_ALTITUDE:
        north, east = _position_or_here(item, geodesy, altitude)
        return MissionItem(ItemKind.ALTITUDE, north, east, altitude)
    north, east = to_local_position(item, geodesy, altitude)
    if item.command == LOITER:
        return MissionItem(ItemKind.STAY, north, east, altitude, _parse_heading(yaw))
    return MissionItem(
        ItemKind.CIRCLE,
        north,
        east,
        altitude,
        radius=_parse_number(abs(radius), PARAM3, "radius", 1.0),
        clockwise=radius > 0.0,
        turns=_parse_number(turns, PARAM1, "number of turns", 0.01),
    )


def _position_or_here(item: Item, geodesy: Geodesy, altitude: float) -> tuple[float, float] | tuple[None, None]:
    """Return an item's position north and east [m]; None, None for the vehicle's own (missing or 0, 0)."""
    is_placed = item.x not in (0, NO_POSITION) or item.y not in (0, NO_POSITION)
    return to_local_position(item, geodesy, altitude) if is_placed else (None, None)


def to_local_position(item: Item, geodesy: Geodesy, altitude: float) -> tuple[float, float]:
    """Return an item's place north and east of the start [m].  Raises ItemError if it is unknown or too far away."""
    if not -900_000_000 <= item.x <= 900_000_000:
        raise ItemError(PARAM5, "the latitude is none")
    if not -1_800_000_000 <= item.y <= 1_800_000_000:
        raise ItemError(PARAM6, "the longitude is none")
    if item.frame not in (*_SEA_FRAMES, *_HOME_FRAMES):
        raise ItemError(WRONG_FRAME, f"frame {item.frame} is not known here")
    north, east, _ = geodesy.to_local(item.x * 1e-7, item.y * 1e-7, geodesy.ground + altitude)
    if max(abs(north), abs(east)) > MAX_DISTANCE_M:
        distance = hypot(north, east) / 1e3
        raise ItemError(PARAM5, f"{distance:,.0f} km from home, {MAX_DISTANCE_M / 1e3:g} km at most")
    return north, east


def to_altitude(item: Item, geodesy: Geodesy, home_altitude: float) -> float:
    """Return an item's height above the ground at the start [m].  Raises ItemError."""
    if item.frame not in (*_SEA_FRAMES, *_HOME_FRAMES):
        raise ItemError(WRONG_FRAME, f"frame {item.frame} is not known here")
    if not isfinite(item.z):
        raise ItemError(PARAM7_INVALID, "it has no height")
    height = item.z - geodesy.ground if item.frame in _SEA_FRAMES else item.z + home_altitude
    if abs(height) > MAX_DISTANCE_M:
        raise ItemError(PARAM7_INVALID, f"{height / 1e3:,.0f} km above the ground, {MAX_DISTANCE_M / 1e3:g} km at most")
    return height


def _parse_heading(angle: float) -> float | None:
    """Convert a heading in degrees to rad within -pi to pi; NaN keeps the heading.  Raises ItemError."""
    if isnan(angle):
        return None
    if abs(angle) > 360.0:
        raise ItemError(PARAM4, "the heading is beyond 360 deg")
    return (radians(angle) + pi) % (2.0 * pi) - pi


def _parse_number(value: float, code: int, what: str, low: float, missing: float | None = None) -> float:
    """Return a parameter that must be at least ``low``; NaN becomes ``missing``.  Raises ItemError."""
    if isnan(value) and missing is not None:
        return missing
    if not (isfinite(value) and value >= low):
        raise ItemError(code, f"{what} {value:g}: at least {low:g} is needed")
    return value


def _parse_integer(value: float, code: int, what: str, besides: str = "") -> int:
    if not (isfinite(value) and value >= 0.0 and value == int(value)):
        raise ItemError(code, f"{what} {value:g}: must be a whole number, 0 or more{besides}")
    return int(value)


_CODE_BY_FIELD: dict[str, int] = {  # mission result for each wrong field
    **dict.fromkeys(("hold_s", "target", "turns"), PARAM1),
    **dict.fromkeys(("acceptance_m", "speed", "repeat"), PARAM2),
    "radius": PARAM3,
    "yaw": PARAM4,
    "north": PARAM5,
    "east": PARAM6,
    "altitude": PARAM7_INVALID,
}


def _find_code(text: str) -> int:
    """Return the result code of the field that an error of ``MissionItem`` names."""
    name = text.removeprefix("MissionItem.").split(" ")[0]
    return _CODE_BY_FIELD.get(name, int(INVALID))


_POLYGON_ZONES = {  # fence commands that are vertices
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: ZoneKind.STAY_IN_POLYGON,
    wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: ZoneKind.STAY_OUT_OF_POLYGON,
}
_CIRCLE_ZONES = {  # fence commands that are circles
    wire.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: ZoneKind.STAY_IN_CIRCLE,
    wire.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: ZoneKind.STAY_OUT_OF_CIRCLE,
}
_ZONE_COMMANDS = {kind: command for command, kind in (_POLYGON_ZONES | _CIRCLE_ZONES).items()}  # inverse of both
_RALLY_COMMAND = wire.MAV_CMD_NAV_RALLY_POINT  # MAV_CMD of a rally point
# Old stations send a return point with a fence. It is ignored: this vehicle returns home or to a rally point.
_RETURN_POINT_COMMAND = wire.MAV_CMD_NAV_FENCE_RETURN_POINT


def check_fence_item(item: Item) -> None:
    """Raise ItemError for an item that is not a valid fence item."""
    if item.command not in (*_POLYGON_ZONES, *_CIRCLE_ZONES, _RETURN_POINT_COMMAND):
        raise ItemError(UNSUPPORTED, f"command {item.command} is not one of a fence")
    first = item.params[0]
    if item.command in _CIRCLE_ZONES and not (isfinite(first) and first > 0.0):
        raise ItemError(PARAM1, f"radius {first:g}: more than 0 m is needed")
    if item.command in _POLYGON_ZONES and not (isfinite(first) and first == int(first)):
        raise ItemError(PARAM1, f"{first:g} corners: a whole number is needed")


def to_fence(items: Sequence[Item], geodesy: Geodesy) -> rq.FenceUpload:
    """Convert items to a fence.  Raises ItemError if a polygon lacks corners."""
    zones: list[rq.FenceZone] = []
    corners: list[tuple[float, float]] = []
    for index, item in enumerate(items):
        if item.command == _RETURN_POINT_COMMAND:
            continue
        corner = to_local_position(item, geodesy, 0.0)
        try:
            if item.command in _CIRCLE_ZONES:
                zones.append(rq.FenceZone(_CIRCLE_ZONES[item.command], (corner,), float(item.params[0])))
                continue
            corners.append(corner)
            count = item.params[0]
            next_item = items[index + 1] if index + 1 < len(items) else None
            if len(corners) < count and (
                next_item is None or next_item.command != item.command or next_item.params[0] != count
            ):
                raise ItemError(PARAM1, f"item {index}: a polygon of {count:g} corners ends after {len(corners)}")
            if len(corners) >= count:
                zones.append(rq.FenceZone(_POLYGON_ZONES[item.command], tuple(corners)))
                corners = []
        except InputError as error:
            raise ItemError(PARAM1, f"item {index}: {error}") from error
    try:
        return rq.FenceUpload(tuple(zones))
    except InputError as error:
        raise ItemError(NO_SPACE, str(error)) from error


def from_fence(zones: Sequence[rq.FenceZone], geodesy: Geodesy) -> list[Item]:
    items = []
    for zone in zones:
        circle = zone.kind in _CIRCLE_ZONES.values()
        first = zone.radius if circle else float(len(zone.points))
        for north, east in zone.points:
            x, y = _local_to_degrees_e7(north, east, geodesy)
            items.append(Item(wire.MAV_FRAME_GLOBAL_INT, _ZONE_COMMANDS[zone.kind], (first, 0.0, 0.0, 0.0), x, y, 0.0))
    return items


def check_rally_item(item: Item) -> None:
    """Raise ItemError for an item that is not a rally point."""
    if item.command != _RALLY_COMMAND:
        raise ItemError(UNSUPPORTED, f"command {item.command} is no rally point")


def to_rally(items: Sequence[Item], geodesy: Geodesy, home_altitude: float) -> rq.RallyUpload:
    """Convert items to rally points.  Raises ItemError."""
    points = []
    for item in items:
        altitude = to_altitude(item, geodesy, home_altitude)
        north, east = to_local_position(item, geodesy, altitude)
        try:
            points.append(rq.RallyPoint(north, east, altitude))
        except InputError as error:
            raise ItemError(INVALID, str(error)) from error
    try:
        return rq.RallyUpload(tuple(points))
    except InputError as error:
        raise ItemError(NO_SPACE, str(error)) from error


def from_rally(points: Sequence[rq.RallyPoint], geodesy: Geodesy) -> list[Item]:
    """Convert rally points to mission items, with heights above the sea."""
    items = []
    for point in points:
        x, y = _local_to_degrees_e7(point.north, point.east, geodesy)
        z = geodesy.ground + point.altitude
        items.append(Item(wire.MAV_FRAME_GLOBAL_INT, _RALLY_COMMAND, (0.0, 0.0, 0.0, 0.0), x, y, z))
    return items


def _local_to_degrees_e7(north: float, east: float, geodesy: Geodesy) -> tuple[int, int]:
    latitude, longitude, _ = geodesy.to_geodetic(north, east, 0.0)
    return round(1e7 * latitude), round(1e7 * longitude)


ITEM_CHECKS: dict[int, Callable[[Item], None]] = {  # by mission type
    wire.MAV_MISSION_TYPE_FENCE: check_fence_item,
    wire.MAV_MISSION_TYPE_RALLY: check_rally_item,
}
