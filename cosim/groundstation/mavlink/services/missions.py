"""The mission protocol: a mission as MAVLink items, up to the vehicle and down from it.

The vehicle is the one who asks for every item of an upload, again after a quarter of a second; a download has no state
here at all.  What was uploaded is given back as it came; a mission from elsewhere is written as items.
https://mavlink.io/en/services/mission.html

Fence and rally points travel the same way; what their items are :mod:`cosim.groundstation.mavlink.services.items` says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import nan

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.status import Status
from cosim.groundstation.mavlink.services.items import (
    ACCEPTED,
    CANCELLED,
    DENIED,
    ERROR,
    ITEM_CHECKS,
    LEFT_OUT,
    NO_POSITION,
    NO_SPACE,
    PARAM1,
    SEQUENCE,
    UNSUPPORTED,
    Item,
    ItemError,
    from_fence,
    from_rally,
    parse_item,
    to_fence,
    to_item,
    to_mission_item,
    to_rally,
)
from cosim.groundstation.mavlink.services.service import AnswerQueue, Ask, Client, Outgoing, Service, make_service_text
from cosim.groundstation.mavlink.telemetry import mission_progress, mission_state
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.dialect import mav as wire
from cosim.groundstation.mavlink.wire.peer import Peer

MISSION, ALL = wire.MAV_MISSION_TYPE_MISSION, wire.MAV_MISSION_TYPE_ALL  # MAV_MISSION_TYPE
FENCE, RALLY = wire.MAV_MISSION_TYPE_FENCE, wire.MAV_MISSION_TYPE_RALLY  # MAV_MISSION_TYPE
_MISSION_TYPES = (MISSION, FENCE, RALLY)  # supported types


_NAMES = {MISSION: "mission", FENCE: "fence", RALLY: "rally"}  # names in messages
_LEGACY_FRAMES = {  # frame of the old MISSION_ITEM
    wire.MAV_FRAME_GLOBAL_INT: wire.MAV_FRAME_GLOBAL,
    wire.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: wire.MAV_FRAME_GLOBAL_RELATIVE_ALT,
}
_CLEARING: dict[int, rq.Request] = {MISSION: rq.MissionClear(), FENCE: rq.FenceUpload(()), RALLY: rq.RallyUpload(())}


@dataclass
class _Upload:
    """Upload of a mission, fence or rally points by one client."""

    client: Client
    count: int
    last_request: float  # time of the last item request
    last_progress: float  # time of the last item
    mission_type: int = MISSION
    items: list[Item] = field(default_factory=list)
    mission: list[rq.MissionItem] = field(default_factory=list)
    waiting: bool = False  # True: the pilot's answer is pending


class MissionService(Service):
    """Mission protocol of one vehicle.

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
        items: Callable[[], tuple[rq.MissionItem, ...]],
        status: Callable[[], Status | None],
        ask: Ask,
        geodesy: Geodesy,
        repeat_s: float = 1.0,
    ) -> None:
        self.repeat_s = repeat_s
        self._items, self._status, self._geodesy = items, status, geodesy
        self._answers = AnswerQueue(ask)
        self._upload: _Upload | None = None
        # The last upload: its client, number of items, type and result.
        self._last_upload: tuple[Client, int, int, int] | None = None
        self._mission: tuple[rq.MissionItem, ...] = ()  # last upload, as the autopilot's items
        self._sent_items: list[Item] = []  # last upload, as received
        self._progress_sent: tuple[int, ...] = ()
        self._progress_at = -self.repeat_s
        self._reached = -1
        self._repeats = 0
        self._now = 0.0

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        self._now = now
        kind = message.get_type()
        if kind == "MISSION_SET_CURRENT":
            return self._request_current_item(message.seq, client)
        if kind in ("MISSION_WRITE_PARTIAL_LIST", "MISSION_REQUEST_PARTIAL_LIST"):
            return [_new_ack(client, UNSUPPORTED, message.mission_type)]
        if kind == "MISSION_ACK":
            self._cancel_upload(message, client)
            return []
        mission_type = message.mission_type
        if kind == "MISSION_CLEAR_ALL" and mission_type == ALL:
            return self._request_clearing(client, ALL)
        if mission_type not in _MISSION_TYPES:
            return [_new_ack(client, UNSUPPORTED, mission_type)]
        if kind == "MISSION_REQUEST_LIST":
            count = len(self._list_items(mission_type))
            return [wire.MAVLink_mission_count_message(client.system, client.component, count, mission_type)]
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return [self._make_item(message.seq, client, kind == "MISSION_REQUEST", mission_type)]
        if kind == "MISSION_COUNT":
            return self._begin_upload(message.count, client, mission_type)
        if kind == "MISSION_CLEAR_ALL":
            return self._request_clearing(client, mission_type)
        return self._take_item(message, client, mission_type)

    def poll(self, now: float, retry_s: float = 0.25, timeout_s: float = 5.0) -> Outgoing:
        """Return the autopilot's answers, repeated requests of items, and the mission's progress."""
        self._now = now
        out = self._answers.take_messages()
        upload = self._upload
        if upload is not None and not upload.waiting:
            if now - upload.last_progress > timeout_s:
                self._upload = None
                out.append((upload.client.peer, _new_ack(upload.client, CANCELLED, upload.mission_type)))
            elif now - upload.last_request > retry_s:
                upload.last_request = now
                out.append((upload.client.peer, self._request_next_item(upload)))
        return out + [(None, message) for message in self._report_progress(now)]

    @property
    def is_busy(self) -> bool:
        return self._upload is not None

    def forget(self, peer: Peer) -> None:
        if self._upload is not None and self._upload.client.peer == peer and not self._upload.waiting:
            self._upload = None

    def _list_items(self, mission_type: int) -> list[Item]:
        """Return the present mission, fence or rally points as MAVLink items."""
        if mission_type == MISSION:
            return self._list_mission()
        status = self._status()
        if status is None:
            return []
        if mission_type == FENCE:
            return from_fence(status.zones, self._geodesy)
        return from_rally(status.rally, self._geodesy)

    def _make_item(self, index: int, client: Client, is_legacy: bool, mission_type: int) -> Message:
        """Return the message of an item; ``is_legacy``: MISSION_ITEM, with positions in 32-bit degrees (0.5 m)."""
        items = self._list_items(mission_type)
        if not 0 <= index < len(items):
            return _new_ack(client, SEQUENCE, mission_type)
        item, status = items[index], self._status()
        current = int(mission_type == MISSION and status is not None and status.mission_current == index)
        make, frame = wire.MAVLink_mission_item_int_message, item.frame
        position: list[float] = [item.x, item.y]
        if is_legacy:
            make, frame = wire.MAVLink_mission_item_message, _LEGACY_FRAMES.get(item.frame, item.frame)
            position = [nan if value == NO_POSITION else value * 1e-7 for value in position]
        return make(
            client.system, client.component, index, frame, item.command, current, item.autocontinue,
            *item.params, *position, item.z, mission_type,
        )  # fmt: skip

    def _list_mission(self) -> list[Item]:
        """Return the autopilot's mission as MAVLink items, the uploaded ones if unchanged."""
        mission = self._items()
        if mission is self._mission or mission == self._mission:
            return self._sent_items
        self._mission, self._sent_items = mission, [to_item(item, self._geodesy) for item in mission]
        return self._sent_items

    def _begin_upload(self, count: int, client: Client, mission_type: int) -> list[Message]:
        upload = self._upload
        if upload is not None and upload.client != client:
            return [_new_ack(client, ERROR, mission_type)]  # another upload is in progress
        if upload is not None and upload.waiting:
            return []
        self._upload = None
        if count == 0:
            return self._request_clearing(client, mission_type)
        if count > rq.MAX_MISSION_ITEMS:
            lines = _warning_text(f"{_NAMES[mission_type]} refused: {count} items, {rq.MAX_MISSION_ITEMS} are allowed")
            return [_new_ack(client, NO_SPACE, mission_type), *lines]
        self._upload = _Upload(client, count, self._now, self._now, mission_type)
        return [self._request_next_item(self._upload)]

    def _take_item(self, message: Message, client: Client, mission_type: int) -> list[Message]:
        """Take an item of an upload and request the next one; unexpected items are dropped."""
        upload = self._upload
        if upload is None or upload.client != client or upload.mission_type != mission_type:
            if self._last_upload is not None and self._last_upload[:3] == (client, message.seq + 1, mission_type):
                # The station repeats its last item because the acknowledgement was lost.
                return [_new_ack(client, self._last_upload[3], mission_type)]
            return [_new_ack(client, ERROR, mission_type)]
        if upload.waiting or message.seq != len(upload.items):
            return []
        item = parse_item(message)
        try:
            if mission_type == MISSION:
                upload.mission.append(to_mission_item(item, self._geodesy, self._home_altitude()))
            else:
                ITEM_CHECKS[mission_type](item)
        except ItemError as error:
            return self._fail_upload(upload, error.code, f"{_NAMES[mission_type]} item {message.seq} refused: {error}")
        upload.items.append(item)
        upload.last_request = upload.last_progress = self._now
        if len(upload.items) < upload.count:
            return [self._request_next_item(upload)]
        try:
            request = self._make_upload_request(upload)
        except InputError as error:  # a jump to a missing item
            return self._fail_upload(upload, PARAM1, f"mission refused: {error}")
        except ItemError as error:
            return self._fail_upload(upload, error.code, f"{_NAMES[mission_type]} refused: {error}")
        upload.waiting = True
        finish = partial(self._finish_upload, upload, request)
        if not self._answers.request(request, upload.client, finish):
            return self._fail_upload(upload, ERROR, f"{_NAMES[mission_type]} refused: too many requests")
        return []

    def _make_upload_request(self, upload: _Upload) -> rq.MissionUpload | rq.FenceUpload | rq.RallyUpload:
        """Return the request to the autopilot for a complete upload.  Raises InputError, ItemError."""
        if upload.mission_type == FENCE:
            return to_fence(upload.items, self._geodesy)
        if upload.mission_type == RALLY:
            return to_rally(upload.items, self._geodesy, self._home_altitude())
        return rq.MissionUpload(tuple(upload.mission))

    def _finish_upload(self, upload: _Upload, request: rq.Request, answer: rq.Answer) -> Outgoing:
        peer = upload.client.peer
        if not answer.accepted:
            code = ERROR if answer.result is rq.Result.FAILED else DENIED
            return [(peer, message) for message in self._fail_upload(upload, code, answer.text)]
        self._upload = None
        out: Outgoing = [(peer, self._finish_upload_with_code(upload, ACCEPTED))]
        if isinstance(request, rq.MissionUpload):
            self._mission, self._sent_items = request.items, upload.items
            out += [(peer, message) for message in _warning_text(_describe_left_out(upload.items))]
        return out

    def _fail_upload(self, upload: _Upload, code: int, text: str) -> list[Message]:
        self._upload = None
        return [self._finish_upload_with_code(upload, code), *_warning_text(text)]

    def _finish_upload_with_code(self, upload: _Upload, code: int) -> Message:
        self._last_upload = (upload.client, len(upload.items), upload.mission_type, code)
        return _new_ack(upload.client, code, upload.mission_type)

    def _request_next_item(self, upload: _Upload) -> Message:
        client, at = upload.client, len(upload.items)
        return wire.MAVLink_mission_request_int_message(client.system, client.component, at, upload.mission_type)

    def _cancel_upload(self, message: Message, client: Client) -> None:
        upload = self._upload
        if upload is not None and upload.client == client and not upload.waiting and message.type != ACCEPTED:
            self._upload = None

    def _request_clearing(self, client: Client, mission_type: int) -> list[Message]:
        """Request the clearing of one mission type or of all; acknowledge once after all answers."""
        requests = list(_CLEARING.values()) if mission_type == ALL else [_CLEARING[mission_type]]
        refused: list[str] = []
        remaining = len(requests)

        def reply(answer: rq.Answer) -> Outgoing:
            nonlocal remaining
            remaining -= 1
            if not answer.accepted:
                refused.append(answer.text)
            return [] if remaining else [(client.peer, _new_ack(client, DENIED if refused else ACCEPTED, mission_type))]

        for request in requests:
            if not self._answers.request(request, client, reply):
                # Only this acknowledgement is sent, because ``remaining`` does not reach 0 then.
                return [_new_ack(client, ERROR, mission_type)]
        return []

    def _request_current_item(self, index: int, client: Client) -> list[Message]:
        def reply(answer: rq.Answer) -> Outgoing:
            if answer.accepted:
                status = self._status()
                if status is not None and status.mission_current == index:
                    self._progress_sent = ()  # report it again to the sender
                return []
            return [(client.peer, message) for message in _warning_text(answer.text)]

        try:
            self._answers.request(rq.MissionSetCurrent(index), client, reply)
        except InputError:
            return _warning_text(f"mission item {index}: there are {len(self._items())}")
        return []

    def _report_progress(self, now: float, repeats: int = 3) -> list[Message]:
        status = self._status()
        if status is None:
            return []
        out = []
        if status.mission_reached != self._reached:
            self._reached = status.mission_reached
            self._repeats = repeats if self._reached >= 0 else 0
        new = mission_state(status)
        due = now - self._progress_at >= self.repeat_s
        if new != self._progress_sent or due:
            self._progress_sent, self._progress_at = new, now
            out.append(mission_progress(status))
        if self._repeats and (self._repeats == repeats or due):
            self._repeats -= 1
            out.append(wire.MAVLink_mission_item_reached_message(self._reached))
        return out

    def _home_altitude(self) -> float:
        """Return home's height [m] above the origin, 0 before home is known."""
        status = self._status()
        return status.home.altitude if status is not None and status.home is not None else 0.0


def _new_ack(client: Client, code: int, mission_type: int = MISSION) -> Message:
    return wire.MAVLink_mission_ack_message(client.system, client.component, code, mission_type)


def _warning_text(text: str) -> list[Message]:
    return make_service_text(text, wire.MAV_SEVERITY_WARNING) if text else []


def _describe_left_out(items: list[Item]) -> str:
    """Describe the items that are skipped because they need a payload; empty if there are none."""
    names = list(dict.fromkeys(LEFT_OUT[item.command] for item in items if item.command in LEFT_OUT))
    count = sum(item.command in LEFT_OUT for item in items)
    if not count:
        return ""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"mission: {count} item{'s' if count > 1 else ''} left out, no such payload: {', '.join(names[:3])}{more}"
