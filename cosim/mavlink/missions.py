"""The mission protocol: a mission as MAVLink items, up to the vehicle and down from it.

The vehicle is the one who asks for every item of an upload, again after a quarter of a second; a download has no state
here at all.  What was uploaded is given back as it came; a mission from elsewhere is written as items.
https://mavlink.io/en/services/mission.html

Only missions are kept.  A list of fence or rally points is answered as an empty one of its kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import degrees, isfinite, isnan, nan, pi, radians
from typing import NamedTuple

from cosim.errors import InputError
from cosim.geodesy import Geodesy
from cosim.mavlink.dialect import Message
from cosim.mavlink.dialect import mav as wire
from cosim.mavlink.service import Answers, Ask, Client, Outgoing, Peer, Service, status_text
from cosim.pilot.autopilot import Status
from cosim.pilot.modes import Mode
from cosim.pilot.requests import (
    LONGEST_MISSION,
    Answer,
    ItemKind,
    MissionClear,
    MissionItem,
    MissionSetCurrent,
    MissionUpload,
    Result,
)

ASK_AGAIN = 0.25  # s without the item that was asked for; as PX4
GIVE_UP = 5.0  # s without any progress of an upload; as PX4
TELL_AGAIN = 1.0  # s between two MISSION_CURRENT without a change
REPEATS = 3  # times that a finished item is told, because nobody acknowledges it

MISSION, ALL = wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_ALL
_OTHERS = (wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY)
ACCEPTED, ERROR = wire.MAV_MISSION_ACCEPTED, wire.MAV_MISSION_ERROR
WRONG_FRAME, UNSUPPORTED = wire.MAV_MISSION_UNSUPPORTED_FRAME, wire.MAV_MISSION_UNSUPPORTED
NO_SPACE, INVALID = wire.MAV_MISSION_NO_SPACE, wire.MAV_MISSION_INVALID
PARAM1, PARAM2 = wire.MAV_MISSION_INVALID_PARAM1, wire.MAV_MISSION_INVALID_PARAM2
PARAM4 = wire.MAV_MISSION_INVALID_PARAM4
PARAM5, PARAM6, PARAM7 = (
    wire.MAV_MISSION_INVALID_PARAM5_X,
    wire.MAV_MISSION_INVALID_PARAM6_Y,
    wire.MAV_MISSION_INVALID_PARAM7,
)
SEQUENCE, DENIED = wire.MAV_MISSION_INVALID_SEQUENCE, wire.MAV_MISSION_DENIED
CANCELLED = wire.MAV_MISSION_OPERATION_CANCELLED

WAYPOINT, LOITER_TIME = wire.MAV_CMD_NAV_WAYPOINT, wire.MAV_CMD_NAV_LOITER_TIME
RETURN, LAND, TAKEOFF = wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, wire.MAV_CMD_NAV_LAND, wire.MAV_CMD_NAV_TAKEOFF
DELAY, JUMP, SPEED = wire.MAV_CMD_NAV_DELAY, wire.MAV_CMD_DO_JUMP, wire.MAV_CMD_DO_CHANGE_SPEED

_SEA = (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_GLOBAL_INT)  # z above the sea
_HOME = (wire.MAV_FRAME_GLOBAL_RELATIVE_ALT, wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)  # z above home
_NONE = 2**31 - 1  # x or y that is not given
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5  # MISSION_STATE


class Item(NamedTuple):
    """An item as it travels: ``x``, ``y`` in 1e-7 deg, ``z`` in m."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1


class ItemError(Exception):
    """An item that cannot be flown; ``code`` is the MAV_MISSION_RESULT that says why."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass
class _Upload:
    client: Client
    count: int
    asked: float  # when the present item was last asked for
    moved: float  # when anything last came
    items: list[Item] = field(default_factory=list)
    flown: list[MissionItem] = field(default_factory=list)
    waiting: bool = False  # for the pilot's answer


class MissionService(Service):
    """The mission protocol of one vehicle.

    ``items`` and ``status`` read the pilot: the mission that it has, and its state or None before its first step.
    """

    handles = frozenset(
        {
            "MISSION_REQUEST_LIST",
            "MISSION_COUNT",
            "MISSION_ITEM_INT",
            "MISSION_ITEM",
            "MISSION_REQUEST_INT",
            "MISSION_REQUEST",
            "MISSION_ACK",
            "MISSION_CLEAR_ALL",
            "MISSION_SET_CURRENT",
            "MISSION_WRITE_PARTIAL_LIST",
            "MISSION_REQUEST_PARTIAL_LIST",
        }
    )

    def __init__(
        self,
        items: Callable[[], tuple[MissionItem, ...]],
        status: Callable[[], Status | None],
        ask: Ask,
        geodesy: Geodesy,
    ) -> None:
        self._items, self._status, self._geodesy = items, status, geodesy
        self._answers = Answers(ask)
        self._upload: _Upload | None = None
        self._last: tuple[Client, int, int] | None = None  # who uploaded, how many items, with which end
        self._flown: tuple[MissionItem, ...] = ()  # what the pilot got of the last upload
        self._sent: list[Item] = []  # and what came
        self._told: tuple[int, ...] = ()
        self._told_at = -TELL_AGAIN
        self._reached = -1
        self._repeats = 0
        self._now = 0.0

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        """The answers to one message."""
        self._now = now
        kind = message.get_type()
        if kind == "MISSION_SET_CURRENT":
            return self._set_current(message.seq, client)
        if kind in ("MISSION_WRITE_PARTIAL_LIST", "MISSION_REQUEST_PARTIAL_LIST"):
            return [_ack(client, UNSUPPORTED, message.mission_type)]
        if kind == "MISSION_ACK":
            self._acknowledged(message, client)
            return []
        if message.mission_type != MISSION:
            return self._other(kind, message, client)
        if kind == "MISSION_REQUEST_LIST":
            count = len(self._items())
            return [wire.MAVLink_mission_count_message(client.system, client.component, count, MISSION)]
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return [self._give(message.seq, client, kind == "MISSION_REQUEST")]
        if kind == "MISSION_COUNT":
            return self._begin(message.count, client)
        if kind == "MISSION_CLEAR_ALL":
            return self._clear(client)
        return self._take(message, client)

    def poll(self, now: float) -> Outgoing:
        """Answers of the pilot, items asked for again, and where the mission stands."""
        self._now = now
        out = self._answers.take()
        upload = self._upload
        if upload is not None and not upload.waiting:
            if now - upload.moved > GIVE_UP:
                self._upload = None
                out.append((upload.client.peer, _ack(upload.client, CANCELLED)))
            elif now - upload.asked > ASK_AGAIN:
                upload.asked = now
                out.append((upload.client.peer, self._wanted(upload)))
        return out + [(None, message) for message in self._progress(now)]

    @property
    def busy(self) -> bool:
        return self._upload is not None

    def forget(self, peer: Peer) -> None:
        """The peer is gone: its unfinished upload too."""
        if self._upload is not None and self._upload.client.peer == peer and not self._upload.waiting:
            self._upload = None

    # ---- down

    def _give(self, index: int, client: Client, old: bool) -> Message:
        """An item; ``old``: in degrees as 32-bit floats (half a metre), as who asks so expects it."""
        items = self._as_items()
        if not 0 <= index < len(items):
            return _ack(client, SEQUENCE)
        item, status = items[index], self._status()
        current = int(status is not None and status.mission_current == index)
        if not old:
            place: tuple[float, float] = (item.x, item.y)
            make, frame = wire.MAVLink_mission_item_int_message, item.frame
        else:
            place = (nan if item.x == _NONE else item.x * 1e-7, nan if item.y == _NONE else item.y * 1e-7)
            old_frames = {
                wire.MAV_FRAME_GLOBAL_INT: wire.MAV_FRAME_GLOBAL,
                wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            }
            make, frame = wire.MAVLink_mission_item_message, old_frames.get(item.frame, item.frame)
        return make(
            client.system,
            client.component,
            index,
            frame,
            item.command,
            current,
            item.autocontinue,
            *item.params,
            *place,
            item.z,
            MISSION,
        )

    def _as_items(self) -> list[Item]:
        """The pilot's mission as items: those that came, if it is that one."""
        flown = self._items()
        if flown is self._flown or flown == self._flown:
            return self._sent
        self._flown, self._sent = flown, [to_item(item, self._geodesy) for item in flown]
        return self._sent

    # ---- up

    def _begin(self, count: int, client: Client) -> list[Message]:
        upload = self._upload
        if upload is not None and upload.client != client:
            return [_ack(client, ERROR)]  # another upload is under way
        if upload is not None and upload.waiting:
            return []
        self._upload = None
        if count == 0:
            return self._clear(client)
        if count > LONGEST_MISSION:
            return [_ack(client, NO_SPACE), *_say(f"mission refused: {count} items, {LONGEST_MISSION} are allowed")]
        self._upload = _Upload(client, count, self._now, self._now)
        return [self._wanted(self._upload)]

    def _take(self, message: Message, client: Client) -> list[Message]:
        """An item of an upload; what is not the one that was asked for is dropped and asked for again in time."""
        upload = self._upload
        if upload is None or upload.client != client:
            if self._last is not None and self._last[:2] == (client, message.seq + 1):
                return [_ack(client, self._last[2])]  # the acknowledgement was lost
            return [_ack(client, ERROR)]
        if upload.waiting or message.seq != len(upload.items):
            return []
        item = _received(message)
        try:
            upload.flown.append(to_flown(item, self._geodesy, self._home_altitude()))
        except ItemError as error:
            return self._refuse(upload, error.code, f"mission item {message.seq} refused: {error}")
        upload.items.append(item)
        upload.asked = upload.moved = self._now
        if len(upload.items) < upload.count:
            return [self._wanted(upload)]
        try:
            request = MissionUpload(tuple(upload.flown))
        except InputError as error:  # a jump to nowhere: nothing else is left to check
            return self._refuse(upload, PARAM1, f"mission refused: {error}")
        upload.waiting = True
        if not self._answers.request(request, upload.client, lambda answer: self._uploaded(upload, request, answer)):
            return self._refuse(upload, ERROR, "mission refused: too many requests")
        return []

    def _uploaded(self, upload: _Upload, request: MissionUpload, answer: Answer) -> Outgoing:
        peer = upload.client.peer
        if not answer.accepted:
            code = ERROR if answer.result is Result.FAILED else DENIED
            return [(peer, message) for message in self._refuse(upload, code, answer.text)]
        self._upload = None
        self._flown, self._sent = request.items, upload.items
        return [(peer, self._end(upload, ACCEPTED))]

    def _refuse(self, upload: _Upload, code: int, text: str) -> list[Message]:
        self._upload = None
        return [self._end(upload, code), *_say(text)]

    def _end(self, upload: _Upload, code: int) -> Message:
        self._last = (upload.client, len(upload.items), code)
        return _ack(upload.client, code)

    def _wanted(self, upload: _Upload) -> Message:
        client = upload.client
        return wire.MAVLink_mission_request_int_message(client.system, client.component, len(upload.items), MISSION)

    def _acknowledged(self, message: Message, client: Client) -> None:
        """The end of a download, of which nothing is kept, or of an upload that its sender gave up."""
        upload = self._upload
        if upload is not None and upload.client == client and not upload.waiting and message.type != ACCEPTED:
            self._upload = None

    def _other(self, kind: str, message: Message, client: Client) -> list[Message]:
        """Fence and rally points, of which there are none, and all lists at once."""
        which = message.mission_type
        if kind == "MISSION_CLEAR_ALL" and which == ALL:
            return self._clear(client, ALL)
        if which not in _OTHERS:
            return [_ack(client, UNSUPPORTED, which)]
        if kind == "MISSION_REQUEST_LIST":
            return [wire.MAVLink_mission_count_message(client.system, client.component, 0, which)]
        if kind == "MISSION_CLEAR_ALL" or (kind == "MISSION_COUNT" and message.count == 0):
            return [_ack(client, ACCEPTED, which)]
        return [_ack(client, SEQUENCE if kind.startswith("MISSION_REQUEST") else UNSUPPORTED, which)]

    # ---- the rest

    def _clear(self, client: Client, which: int = MISSION) -> list[Message]:
        def then(answer: Answer) -> Outgoing:
            return [(client.peer, _ack(client, ACCEPTED if answer.accepted else DENIED, which))]

        self._answers.request(MissionClear(), client, then)
        return []

    def _set_current(self, index: int, client: Client) -> list[Message]:
        def then(answer: Answer) -> Outgoing:
            if answer.accepted:
                status = self._status()
                if status is not None and status.mission_current == index:
                    self._told = ()  # nothing will change, and yet an answer is waited for
                return []
            return [(client.peer, message) for message in _say(answer.text)]

        try:
            self._answers.request(MissionSetCurrent(index), client, then)
        except InputError:
            return _say(f"mission item {index}: there are {len(self._items())}")
        return []

    def _progress(self, now: float) -> list[Message]:
        status = self._status()
        if status is None:
            return []
        out = []
        if status.mission_reached != self._reached:
            self._reached = status.mission_reached
            self._repeats = REPEATS if self._reached >= 0 else 0
        new = _standing(status)
        due = now - self._told_at >= TELL_AGAIN
        if new != self._told or due:
            self._told, self._told_at = new, now
            out.append(mission_current(status))
        if self._repeats and (self._repeats == REPEATS or due):
            self._repeats -= 1
            out.append(wire.MAVLink_mission_item_reached_message(self._reached))
        return out

    def _home_altitude(self) -> float:
        """Of home, as it is when the mission comes; of the ground at the start in the second before home is known."""
        status = self._status()
        return status.home.altitude if status is not None and status.home is not None else 0.0


def to_flown(item: Item, geodesy: Geodesy, home_altitude: float) -> MissionItem:
    """What the pilot flies for an item; heights above home are taken from ``home_altitude``.  Raises ItemError."""
    command, (p1, p2, _, p4) = item.command, item.params
    try:
        if command in (WAYPOINT, LOITER_TIME):
            return _waypoint(item, geodesy, home_altitude)
        if command == TAKEOFF:
            altitude = _altitude(item, geodesy, home_altitude)
            return MissionItem(ItemKind.TAKEOFF, altitude=altitude, yaw=_yaw(p4))
        if command == LAND:
            # no place, or 0, 0: where it is
            somewhere = item.x not in (0, _NONE) or item.y not in (0, _NONE)
            north, east = _place(item, geodesy, 0.0) if somewhere else (None, None)
            return MissionItem(ItemKind.LAND, north, east, yaw=_yaw(p4))
        if command == RETURN:
            return MissionItem(ItemKind.RETURN)
        if command == DELAY:
            return MissionItem(ItemKind.DELAY, hold_s=_number(p1, PARAM1, "delay", 0.0))
        if command == JUMP:
            target = _whole(p1, PARAM1, "item to jump to")
            return MissionItem(ItemKind.JUMP, target=target, repeat=_whole(p2, PARAM2, "number of jumps"))
        if command == SPEED:
            if p1 not in (0.0, 1.0):
                raise ItemError(PARAM1, "only the horizontal speed can be set")
            return MissionItem(ItemKind.SPEED, speed=_number(p2, PARAM2, "speed", 0.1))
    except InputError as error:  # a number beyond what the pilot flies
        raise ItemError(_code_of(str(error)), str(error)) from error
    raise ItemError(UNSUPPORTED, f"command {command} is not known here")


def to_item(item: MissionItem, geodesy: Geodesy) -> Item:
    """A mission's item as it travels, heights above the sea."""
    x = y = 0
    if item.north is not None and item.east is not None:
        latitude, longitude, _ = geodesy.to_geodetic(item.north, item.east, item.altitude or 0.0)
        x, y = round(1e7 * latitude), round(1e7 * longitude)
    z = 0.0 if item.altitude is None else geodesy.ground + item.altitude
    yaw = nan if item.yaw is None else degrees(item.yaw)
    there = wire.MAV_FRAME_GLOBAL_INT
    nowhere = wire.MAV_FRAME_MISSION
    kind = item.kind
    if kind is ItemKind.WAYPOINT:
        return Item(there, WAYPOINT, (item.hold_s, item.acceptance_m, 0.0, yaw), x, y, z)
    if kind is ItemKind.TAKEOFF:
        return Item(there, TAKEOFF, (0.0, 0.0, 0.0, yaw), _NONE, _NONE, z)
    if kind is ItemKind.LAND:
        return Item(there, LAND, (0.0, 0.0, 0.0, yaw), x, y, geodesy.ground)
    if kind is ItemKind.SPEED:
        return Item(nowhere, SPEED, (1.0, item.speed or 0.0, -1.0, 0.0), 0, 0, 0.0)
    if kind is ItemKind.DELAY:
        return Item(nowhere, DELAY, (item.hold_s, -1.0, -1.0, -1.0), 0, 0, 0.0)
    if kind is ItemKind.JUMP:
        return Item(nowhere, JUMP, (float(item.target or 0), float(item.repeat), 0.0, 0.0), 0, 0, 0.0)
    return Item(nowhere, RETURN, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0)


def _received(message: Message) -> Item:
    """An item of MISSION_ITEM_INT or of the old MISSION_ITEM, whose place is in degrees."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        x, y = _degrees(x), _degrees(y)
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.frame, message.command, params, x, y, message.z, message.autocontinue)


def _degrees(value: float) -> int:
    """Degrees to 1e-7 deg; what is no angle becomes "not given"."""
    return round(1e7 * value) if abs(value) <= 200.0 else _NONE


def _waypoint(item: Item, geodesy: Geodesy, home_altitude: float) -> MissionItem:
    hold, radius, _, yaw = item.params
    altitude = _altitude(item, geodesy, home_altitude)
    north, east = _place(item, geodesy, altitude)
    if item.command == LOITER_TIME:  # its other parameters are of circles
        radius = 0.0
    return MissionItem(
        ItemKind.WAYPOINT,
        north,
        east,
        altitude,
        _yaw(yaw),
        _number(hold, PARAM1, "time to hold", 0.0, 0.0),
        _number(radius, PARAM2, "radius", 0.0, 0.0),
    )


def _place(item: Item, geodesy: Geodesy, altitude: float) -> tuple[float, float]:
    if not -900_000_000 <= item.x <= 900_000_000:
        raise ItemError(PARAM5, "the latitude is none")
    if not -1_800_000_000 <= item.y <= 1_800_000_000:
        raise ItemError(PARAM6, "the longitude is none")
    if item.frame not in (*_SEA, *_HOME):
        raise ItemError(WRONG_FRAME, f"frame {item.frame} is not known here")
    north, east, _ = geodesy.to_local(item.x * 1e-7, item.y * 1e-7, geodesy.ground + altitude)
    return north, east


def _altitude(item: Item, geodesy: Geodesy, home_altitude: float) -> float:
    """Height above the ground at the start."""
    if item.frame not in (*_SEA, *_HOME):
        raise ItemError(WRONG_FRAME, f"frame {item.frame} is not known here")
    if not isfinite(item.z):
        raise ItemError(PARAM7, "it has no height")
    return item.z - geodesy.ground if item.frame in _SEA else item.z + home_altitude


def _yaw(angle: float) -> float | None:
    """Degrees to rad within a turn; NaN is "as it is"."""
    if isnan(angle):
        return None
    if abs(angle) > 360.0:
        raise ItemError(PARAM4, "the heading is beyond 360 deg")
    return (radians(angle) + pi) % (2.0 * pi) - pi


def _number(value: float, code: int, what: str, least: float, missing: float | None = None) -> float:
    """A parameter that must be at least ``least``; NaN is ``missing``."""
    if isnan(value) and missing is not None:
        return missing
    if not (isfinite(value) and value >= least):
        raise ItemError(code, f"{what} {value:g}: at least {least:g} is needed")
    return value


def _whole(value: float, code: int, what: str) -> int:
    if not (isfinite(value) and value >= 0.0 and value == int(value)):
        raise ItemError(code, f"{what} {value:g}: must be a whole number")
    return int(value)


_FIELDS: dict[str, int] = {
    "north": PARAM5,
    "east": PARAM6,
    "altitude": PARAM7,
    "hold_s": PARAM1,
    "acceptance_m": PARAM2,
    "speed": PARAM2,
    "target": PARAM1,
    "repeat": PARAM2,
    "yaw": PARAM4,
}


def _code_of(text: str) -> int:
    """The result for the field that an error of ``MissionItem`` names."""
    name = text.removeprefix("MissionItem.").split(" ")[0]
    return _FIELDS.get(name, int(INVALID))


def mission_current(status: Status) -> Message:
    """MISSION_CURRENT: where the mission stands."""
    return wire.MAVLink_mission_current_message(*_standing(status))


def _standing(status: Status) -> tuple[int, int, int, int]:
    """The present item, how many there are (65535: none), the state, and whether it is being flown."""
    count = status.mission_count
    return (max(0, min(status.mission_current, count - 1)), count or 65535, *_state(status))


def _state(status: Status) -> tuple[int, int]:
    """MISSION_STATE, and whether the mission is being flown (1) or not (2)."""
    flies = status.mode is Mode.MISSION and status.armed
    if not status.mission_count:
        return _NO_MISSION, 2
    if status.mission_done:
        return _COMPLETE, 1 if flies else 2
    if flies:
        return _ACTIVE, 1
    begun = status.mission_current > 0 or status.mission_reached >= 0
    return (_PAUSED if begun else _NOT_STARTED), 2


def _ack(client: Client, code: int, which: int = MISSION) -> Message:
    return wire.MAVLink_mission_ack_message(client.system, client.component, code, which)


def _say(text: str) -> list[Message]:
    return status_text(text, wire.MAV_SEVERITY_WARNING) if text else []
