"""The vehicle in the link's thread: dispatch of messages, requests to the autopilot, and telemetry.

Frames for other systems are counted and left alone: this is a vehicle and no router, so ground stations do not see each
other through it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from math import hypot
from typing import Any, NamedTuple, Protocol

from cosim.base.errors import InputError
from cosim.control.autopilot.modes import Severity
from cosim.control.autopilot.requests import Answer, Arm, LinkBack, LinkLost, Request, Result, SetMode
from cosim.groundstation.exchange import Port, Snapshot
from cosim.groundstation.mavlink.about import VehicleInfo
from cosim.groundstation.mavlink.modes import from_custom
from cosim.groundstation.mavlink.services import commands, setpoints
from cosim.groundstation.mavlink.services.orders import OF_RESULT, Ack, Context, Order, Plan, order_of
from cosim.groundstation.mavlink.services.service import Client
from cosim.groundstation.mavlink.streams import Streams
from cosim.groundstation.mavlink.telemetry import (
    current_mode,
    extended_sys_state,
    gps_global_origin,
    heartbeat,
    home_position,
    statustext,
)
from cosim.groundstation.mavlink.view import Since, View
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, Message, mav, pack
from cosim.groundstation.mavlink.wire.frames import Frame
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.peer import Kind, Peer

LINK_LOST = 3.5  # s without a heartbeat of any ground station; QGroundControl gives the vehicle as long
_REPEAT = 5.0  # s: a command that is the same again within it has lost its acknowledgement
_COMPLAIN = 5.0  # s between two lines about set-points that are not understood
_GCS = 6  # MAV_TYPE
NO_FOLLOWING = "follow-me is not flown here: the place to follow is not used"
_STATIONS = 64  # of which is remembered when they were heard; chosen by us: more than anybody connects
# lists and files: long, in no hurry, and repeated where they were lost
_BULK = frozenset({"FILE_TRANSFER_PROTOCOL", "LOG_DATA", "LOG_ENTRY", "PARAM_VALUE"})
_PAGE = (0, 0)  # ids that no system has
_SERVE = 0.01  # s between two looks at a service that has much to send


class Service(Protocol):
    """A MAVLink microservice: parameters, missions, files or logs.  Called in the link's thread only.

    ``handles``: the names of the messages that are its business; ``busy``: it wants to be polled every 10 ms.
    """

    handles: frozenset[str]

    def handle(self, message: Message, client: Client, now: float) -> Sequence[Message]:
        """Return the answers to a message for this vehicle."""
        ...

    def poll(self, now: float) -> Iterable[tuple[Any, Message]]:
        """Return the messages to send unasked: to one peer, or (None) to all."""
        ...

    @property
    def busy(self) -> bool: ...

    def forget(self, peer: Any) -> None:
        """Forget a peer that is gone."""
        ...


class Sender(NamedTuple):
    """Sender of a message; several systems may be behind one peer."""

    peer: Peer
    system: int
    component: int

    @property
    def text(self) -> str:
        """Name of the sender for people to read."""
        return f"{self.peer.name} {self.system}/{self.component}"


class Vehicle:
    """A vehicle on MAVLink links.  ``services``: a message belongs to the first that handles it.

    ``on_request``: messages for REQUEST_MESSAGE beside the telemetry, made of simulation time in ms.
    ``endings``: what to ask the flight for when a reboot is wanted, and a shutdown; none: both are unsupported.
    """

    def __init__(
        self,
        about: VehicleInfo,
        port: Port,
        link: Link,
        services: Sequence[Service] = (),
        on_request: Mapping[int, Callable[[int], Message]] | None = None,
        endings: tuple[Any, ...] = (),
    ) -> None:
        self.about = about
        self.port = port
        self.link = link
        self.services = list(services)
        self.on_request = dict(on_request or {})
        self.endings = endings
        # ground stations by ids: when last heard, the one that has been silent for longest first
        self.stations: dict[tuple[int, int], float] = {}
        self.pages: Callable[[], int] = lambda: 0  # how many local pages are open: each is a ground station too
        self.acknowledged = 0
        self._streams = Streams(link.now())
        self._since = Since()
        self._seen: Snapshot | None = None
        self._view: View | None = None
        self._texts = 0
        self._peers: list[Peer] = []
        self._now = link.now()
        self._lost = False
        self._complained = -_COMPLAIN
        self._once: tuple[tuple[Any, ...], float, Ack] | None = None
        self._pending: set[tuple[Any, ...]] = set()
        port.wake = link.ring

    # --- what the services may use -------------------------------------------------------------------------------

    def send(self, peer: Peer | None, messages: Sequence[Message]) -> None:
        """Send messages to one station, or (None) to all; telemetry never displaces them."""
        for message in messages:
            packed = self._pack(message)
            if packed is None:
                continue
            kind = Kind.BULK if message.msgname in _BULK else Kind.ANSWER
            if peer is None:
                self.link.broadcast(packed, kind)
            else:
                self.link.send(peer, packed, kind)

    def say(self, severity: int, text: str, peer: Peer | None = None) -> None:
        """Send a line for the people on the ground."""
        self._texts += 1
        self.send(peer, statustext(severity, text, self._texts))

    # --- the link's thread -------------------------------------------------------------------------------------

    def receive(self, frame: Frame, peer: Peer, now: float) -> None:
        """Dispatch a frame to the handler or the service of its message."""
        self._now = now
        message, refused = frame.message, self.link.refused
        if frame.system == self.about.system and frame.component == self.about.component:
            refused["own"] += 1
            return
        if frame.system == 0:
            refused["no system"] += 1
            return
        if not self._is_for_us(message):
            refused["other vehicle"] += 1
            return
        sender = Sender(peer, frame.system, frame.component)
        handler = _RECEIVE.get(message.msgname)
        if handler is not None:
            handler(self, message, sender)
            return
        for service in self.services:
            if message.msgname in service.handles:
                self.send(peer, service.handle(message, Client(*sender), now))
                return

    def poll(self, now: float) -> float:
        """Do what is due; returns when there is something to do again."""
        self._now = now
        self.port.collect(now)
        snapshot = self.port.snapshot
        if snapshot is not None and snapshot is not self._seen:
            self._changed(snapshot)
        for message in self.port.messages():
            self.say(int(message.severity), message.text)
        self._poll_services(now)
        self._watch_link(now)
        view = self._view
        if view is None:
            return now + 0.01
        for stream, peers in self._streams.due(now, self.link.peers):
            packets: list[Message] = []
            for message in stream.build(view):
                packed = self._pack(message)
                if packed is None:
                    continue
                packets.append(packed)
                self.link.logged(packed)
            self._streams.note_size(stream, packets)
            for peer in peers:
                for place, packed in enumerate(packets):
                    if stream.name == "HEARTBEAT":  # whatever the line carries, it tells that the vehicle is there
                        peer.send(packed)
                    else:
                        peer.stream(packed, place)
        busy = any(service.busy for service in self.services)
        return min(self._streams.next, now + _SERVE) if busy else self._streams.next

    def _poll_services(self, now: float) -> None:
        peers = self.link.peers
        for gone in set(self._peers).difference(peers):
            for service in self.services:
                service.forget(gone)
        self._peers = peers
        for service in self.services:
            for peer, message in service.poll(now):
                self.send(peer, (message,))

    def _is_for_us(self, message: Message) -> bool:
        system = getattr(message, "target_system", 0)
        if message.msgname == "MANUAL_CONTROL":
            system = message.target
        component = getattr(message, "target_component", 0)
        return system in (0, self.about.system) and component in (0, self.about.component)

    def _pack(self, message: Message) -> Message | None:
        try:
            return pack(message)
        except (struct.error, OverflowError, ValueError) as error:
            self.link.failures[f"{message.msgname}: {error}"[:200]] += 1
            return None

    def _changed(self, snapshot: Snapshot) -> None:
        before = self._view
        self._seen = snapshot
        self._view = view = View(self.about, snapshot, self._since)
        self._since.look(before, view)
        if before is None:
            return
        was, status = before.status, view.status
        if (was.mode, was.armed, bool(was.failsafe)) != (status.mode, status.armed, bool(status.failsafe)):
            self.send(None, heartbeat(view))
        if was.mode is not status.mode:
            self.send(None, current_mode(view))
        if was.landed is not status.landed:
            self.send(None, extended_sys_state(view))
        if was.home != status.home:
            self.send(None, home_position(view))

    def _watch_link(self, now: float) -> None:
        """Tell the pilot when the last ground station has gone quiet, and when one is there again."""
        if self.pages():
            self._is_there(_PAGE)
        if not self.stations:
            return
        lost = now - max(self.stations.values()) > LINK_LOST
        if lost == self._lost:
            return
        self._lost = lost

        def reply(answer: Answer) -> None:
            if not answer.accepted:
                self._lost = not lost  # it is said again

        self.port.ask(LinkLost() if lost else LinkBack(), reply, "link")

    # --- messages ----------------------------------------------------------------------------------------------

    def _heartbeat(self, message: Message, sender: Sender) -> None:
        if message.type == _GCS:
            self._is_there((sender.system, sender.component))

    def _is_there(self, ids: tuple[int, int]) -> None:
        """Note that a station is alive; if there are too many, the one that was silent for longest is forgotten."""
        self.stations.pop(ids, None)
        if len(self.stations) >= _STATIONS:
            del self.stations[next(iter(self.stations))]
        self.stations[ids] = self._now

    def _radio(self, message: Message, sender: Sender) -> None:
        """Slow a line down if its radio reports that its buffer is full."""
        sender.peer.radio(message.txbuf)

    def _command(self, message: Message, sender: Sender) -> None:
        order = order_of(message)
        view = self._view
        if view is None:
            self._acknowledge(order, sender, Ack.TEMPORARILY_REJECTED)
            return
        key = (sender.system, sender.component, order._replace(confirmation=0))
        if key in self._pending:
            return  # the one answer is on its way
        if self._once is not None and order.number in commands.ONCE:
            done, when, result = self._once
            if done == key and self._now - when < _REPEAT:
                self._acknowledge(order, sender, result)
                return
        context = Context(self.about, view, sender.peer, self._requested, self.endings)
        plan = commands.plan(order, context)
        if plan.requests:
            self._pending.add(key)
            self._next(plan, 0, order, sender, key)
        else:
            self._acknowledge(order, sender, plan.result)
            self.send(sender.peer, plan.messages)
            if plan.text:
                fine = plan.result is Ack.ACCEPTED
                self.say(int(Severity.INFO if fine else Severity.WARNING), plan.text, sender.peer)

    def _requested(self, message_id: int) -> Sequence[Message] | None:
        make = self.on_request.get(message_id)
        return None if make is None or self._view is None else [make(self._view.ms)]

    def _next(self, plan: Plan, place: int, order: Order, sender: Sender, key: tuple[Any, ...]) -> None:
        """Make the requests of a command one after another; the last answer, or the first refusal, is acknowledged."""

        def reply(answer: Answer) -> None:
            if answer.accepted and place + 1 < len(plan.requests):
                self._next(plan, place + 1, order, sender, key)
                return
            self._pending.discard(key)
            result = OF_RESULT[answer.result]
            self._acknowledge(order, sender, result)
            if result is Ack.ACCEPTED:
                self._once = (key, self._now, result)
            elif answer.text and not isinstance(plan.requests[place], Arm):  # the pilot says itself why it is not armed
                self.say(int(Severity.WARNING), answer.text, sender.peer)

        self.port.ask(plan.requests[place], reply, sender.text)

    def _acknowledge(self, order: Order, sender: Sender, result: Ack) -> None:
        self.acknowledged += 1
        ack = mav.MAVLink_command_ack_message(order.number, int(result), 0, 0, sender.system, sender.component)
        self.send(sender.peer, (ack,))

    def _set_mode(self, message: Message, sender: Sender) -> None:
        """Set a mode without an acknowledgement: the heartbeat shows the mode, a text says why it was refused."""
        mode = from_custom(message.custom_mode, self.about.personality) if message.base_mode & 1 else None
        if mode is None:
            self._complain(f"mode {message.custom_mode} is not known here", sender.peer)
            return

        def reply(answer: Answer) -> None:
            if answer.result is not Result.ACCEPTED and answer.text:
                self.say(int(Severity.WARNING), answer.text, sender.peer)

        self.port.ask(SetMode(mode.value), reply, sender.text)

    def _setpoint(self, message: Message, sender: Sender) -> None:
        view = self._view
        if view is None:
            return
        try:
            self.port.ask(_pilot_request(message, view), None, sender.text)
        except InputError as error:
            self._complain(str(error), sender.peer)

    def _complain(self, text: str, peer: Peer) -> None:
        """Count and, not too often, report messages that come many times a second and are not understood."""
        self.link.refused["value"] += 1
        if self._now - self._complained >= _COMPLAIN:
            self._complained = self._now
            self.say(int(Severity.WARNING), text, peer)

    def _ping(self, message: Message, sender: Sender) -> None:
        if message.target_system == 0:
            answer = mav.MAVLink_ping_message(message.time_usec, message.seq, sender.system, sender.component)
            self.send(sender.peer, (answer,))

    def _timesync(self, message: Message, sender: Sender) -> None:
        """Answer with simulation time, which all the time stamps are in."""
        if message.tc1 == 0 and self._view is not None:
            now = round(self._view.time * 1e9)
            self.send(sender.peer, (mav.MAVLink_timesync_message(now, message.ts1),))

    def _origin(self, message: Message, sender: Sender) -> None:
        """Answer with the origin, which is fixed where the flight began, and report that it was not moved."""
        view = self._view
        if view is None:
            return
        self.send(sender.peer, gps_global_origin(view))
        at = view.about.geodesy
        lat, lon = message.latitude * 1e-7, message.longitude * 1e-7
        valid = abs(lat) <= 90.0 and abs(lon) <= 180.0
        if not valid or hypot(*at.to_local(lat, lon, at.ground)[:2]) > commands.ORIGIN_NEAR:
            self._complain(commands.ORIGIN_FIXED, sender.peer)

    def _follow(self, message: Message, sender: Sender) -> None:
        """Report that follow-me is not flown, which is the only use of a place to follow."""
        self._complain(NO_FOLLOWING, sender.peer)

    def _nothing(self, message: Message, sender: Sender) -> None:
        """Ignore a message that has no effect here, as rates are set message by message."""


def _pilot_request(message: Message, view: View) -> Request:
    name = message.msgname
    if name == "MANUAL_CONTROL":
        return setpoints.sticks(message)
    if name == "SET_ATTITUDE_TARGET":
        return setpoints.attitude(message)
    return setpoints.local(message, view) if name == "SET_POSITION_TARGET_LOCAL_NED" else setpoints.world(message, view)


_RECEIVE: dict[str, Callable[[Vehicle, Message, Sender], None]] = {
    "HEARTBEAT": Vehicle._heartbeat,
    "COMMAND_LONG": Vehicle._command,
    "COMMAND_INT": Vehicle._command,
    "SET_MODE": Vehicle._set_mode,
    "MANUAL_CONTROL": Vehicle._setpoint,
    "SET_ATTITUDE_TARGET": Vehicle._setpoint,
    "SET_POSITION_TARGET_LOCAL_NED": Vehicle._setpoint,
    "SET_POSITION_TARGET_GLOBAL_INT": Vehicle._setpoint,
    "PING": Vehicle._ping,
    "TIMESYNC": Vehicle._timesync,
    "SET_GPS_GLOBAL_ORIGIN": Vehicle._origin,
    "FOLLOW_TARGET": Vehicle._follow,
    "REQUEST_DATA_STREAM": Vehicle._nothing,
    "RADIO_STATUS": Vehicle._radio,
}
assert set(_RECEIVE) <= set(BY_NAME)
