"""The vehicle in the link's thread: dispatch of messages, requests to the autopilot, and telemetry.

Frames for other systems are counted and left alone: this is a vehicle and no router, so ground stations do not see each
other through it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from math import hypot
from typing import Any

from cosim.base.errors import InputError
from cosim.control.autopilot.modes import Severity
from cosim.control.autopilot.requests import Answer, Arm, LinkBack, LinkLost, Request, Result, SetMode
from cosim.groundstation.exchange import Port, Snapshot
from cosim.groundstation.mavlink.modes import from_custom
from cosim.groundstation.mavlink.services import commands, setpoints
from cosim.groundstation.mavlink.services.mav_command import (
    MAV_RESULTS,
    CommandResult,
    Context,
    MavCommand,
    Plan,
    parse_command,
)
from cosim.groundstation.mavlink.services.service import Client, Service
from cosim.groundstation.mavlink.streams import Streams
from cosim.groundstation.mavlink.telemetry import (
    current_mode,
    extended_sys_state,
    gps_global_origin,
    heartbeat,
    home_position,
    statustext,
)
from cosim.groundstation.mavlink.telemetry_state import FlightEvents, TelemetryState, VehicleConstants
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, COMPONENT_ID, Message, mav, prepare_message
from cosim.groundstation.mavlink.wire.frames import Frame
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.peer import Peer, Priority

FOLLOW_ME_REFUSED = "follow-me is not flown here: the place to follow is not used"  # reason of a refusal
# Bulk messages, which are not urgent: the client asks again for lost ones.
_BULK_MESSAGES = frozenset({"FILE_TRANSFER_PROTOCOL", "LOG_DATA", "LOG_ENTRY", "PARAM_VALUE"})
_PAGE_ID = (0, 0)  # of the local page as a station


class MavlinkVehicle:
    """Vehicle on MAVLink links, whose messages go to the first of ``services`` that handles them.

    ``on_request``: messages for REQUEST_MESSAGE beside the telemetry, made of simulation time in ms.
    ``shutdown_requests``: the requests for a reboot and for a shutdown; none: both are unsupported.
    """

    def __init__(
        self,
        constants: VehicleConstants,
        port: Port,
        link: Link,
        services: Sequence[Service] = (),
        on_request: Mapping[int, Callable[[int], Message]] | None = None,
        shutdown_requests: tuple[Any, ...] = (),
        report_interval_s: float = 5.0,
    ) -> None:
        self.report_interval_s = report_interval_s
        self.constants = constants
        self.port = port
        self.link = link
        self.services = list(services)
        self.on_request = dict(on_request or {})
        self.shutdown_requests = shutdown_requests
        # Ground stations by id, with the time each was last heard; the one silent for longest comes first.
        self.stations: dict[tuple[int, int], float] = {}
        # Number of open local pages; each counts as a ground station.
        self.page_count: Callable[[], int] = lambda: 0
        self.acknowledged = 0
        self._streams = Streams(link.now())
        self._events = FlightEvents()
        self._snapshot: Snapshot | None = None
        self._state: TelemetryState | None = None
        self._text_count = self._logged_turn = 0
        self._peers: list[Peer] = []
        self._now = link.now()
        self._is_lost = False
        self._last_report = -self.report_interval_s
        self._last_done: tuple[tuple[Any, ...], float, CommandResult] | None = None
        self._pending: set[tuple[Any, ...]] = set()
        port.wake = link.wake

    def send(self, peer: Peer | None, messages: Sequence[Message]) -> None:
        """Send messages to one station, or to all (None); telemetry never displaces them."""
        for message in messages:
            packed = self._prepare(message)
            if packed is None:
                continue
            priority = Priority.BULK if message.msgname in _BULK_MESSAGES else Priority.ANSWER
            if peer is None:
                self.link.broadcast(packed, priority)
            else:
                self.link.send(peer, packed, priority)

    def say(self, severity: int, text: str, peer: Peer | None = None) -> None:
        """Send a text message to one station, or to all (None)."""
        self._text_count += 1
        self.send(peer, statustext(severity, text, self._text_count))

    def receive(self, frame: Frame, peer: Peer, now: float) -> None:
        """Dispatch a frame to the handler or the service of its message."""
        self._now = now
        message, refused = frame.message, self.link.refused
        if frame.system == self.constants.system and frame.component == COMPONENT_ID:
            refused["own"] += 1
            return
        if frame.system == 0:
            refused["no system"] += 1
            return
        if not self._is_addressed_to_vehicle(message):
            refused["other vehicle"] += 1
            return
        client = Client(peer, frame.system, frame.component)
        handler = _HANDLERS.get(message.msgname)
        if handler is not None:
            handler(self, message, client)
            return
        for service in self.services:
            if message.msgname in service.handles:
                self.send(peer, service.handle(message, client, now))
                return

    def poll(self, now: float, service_s: float = 0.01) -> float:
        """Send due messages and poll the services; return the time of the next call."""
        self._now = now
        self.port.deliver_answers(now)
        snapshot = self.port.snapshot
        if snapshot is not None and snapshot is not self._snapshot:
            self._update_state(snapshot)
        for message in self.port.take_messages():
            self.say(int(message.severity), message.text)
        self._poll_services(now)
        self._watch_link(now)
        state = self._state
        if state is None:
            return now + 0.01
        for stream, peers in self._streams.iterate_due(now, self.link.peers):
            made = [packed for message in stream.make_messages(state) if (packed := self._prepare(message)) is not None]
            logged = stream.select(made, self._logged_turn)
            self._logged_turn += stream.in_turn
            for packed in logged:
                self.link.log_sent(packed)
            for peer in peers:
                packets = stream.select(made, peer.turn)
                peer.turn += stream.in_turn
                for index, packed in enumerate(packets):
                    # Queued heartbeats are not replaced by newer ones: each shows that the vehicle is connected.
                    if stream.name == "HEARTBEAT":
                        peer.send(packed)
                    else:
                        peer.send_telemetry(packed, index)
        busy = any(service.is_busy for service in self.services)
        return min(self._streams.next_due, now + service_s) if busy else self._streams.next_due

    def _poll_services(self, now: float) -> None:
        peers = self.link.peers
        for gone in set(self._peers).difference(peers):
            for service in self.services:
                service.forget(gone)
        self._peers = peers
        for service in self.services:
            for peer, message in service.poll(now):
                self.send(peer, (message,))

    def _is_addressed_to_vehicle(self, message: Message) -> bool:
        system = getattr(message, "target_system", 0)
        if message.msgname == "MANUAL_CONTROL":
            system = message.target
        component = getattr(message, "target_component", 0)
        return system in (0, self.constants.system) and component in (0, COMPONENT_ID)

    def _prepare(self, message: Message) -> Message | None:
        try:
            return prepare_message(message)
        except (struct.error, OverflowError, ValueError) as error:
            self.link.failures[f"{message.msgname}: {error}"[:200]] += 1
            return None

    def _update_state(self, snapshot: Snapshot) -> None:
        before = self._state
        self._snapshot = snapshot
        self._state = state = TelemetryState(self.constants, snapshot, self._events)
        self._events.update(before, state)
        if before is None:
            return
        previous, status = before.status, state.status
        if (previous.mode, previous.armed, bool(previous.failsafe)) != (
            status.mode,
            status.armed,
            bool(status.failsafe),
        ):
            self.send(None, heartbeat(state))
        if previous.mode is not status.mode:
            self.send(None, current_mode(state))
        if previous.landed is not status.landed:
            self.send(None, extended_sys_state(state))
        if previous.home != status.home:
            self.send(None, home_position(state))

    def _watch_link(self, now: float, lost_s: float = 3.5) -> None:
        """Report a lost link to the pilot after ``lost_s`` without a station (as in QGroundControl), and its return."""
        if self.page_count():
            self._note_station(_PAGE_ID)
        if not self.stations:
            return
        is_lost = now - max(self.stations.values()) > lost_s
        if is_lost == self._is_lost:
            return
        self._is_lost = is_lost

        def reply(answer: Answer) -> None:
            if not answer.accepted:
                self._is_lost = not is_lost  # try again at the next poll

        self.port.ask(LinkLost() if is_lost else LinkBack(), reply, "link")

    def _handle_heartbeat(self, message: Message, client: Client) -> None:
        if message.type == mav.MAV_TYPE_GCS:
            self._note_station((client.system, client.component))

    def _note_station(self, ids: tuple[int, int], max_stations: int = 64) -> None:
        """Record that a station is alive; of too many the one silent for longest is dropped."""
        self.stations.pop(ids, None)
        if len(self.stations) >= max_stations:
            del self.stations[next(iter(self.stations))]
        self.stations[ids] = self._now

    def _handle_command(self, message: Message, client: Client, repeat_s: float = 5.0) -> None:
        command = parse_command(message)
        state = self._state
        if state is None:
            self._acknowledge(command, client, CommandResult.TEMPORARILY_REJECTED)
            return
        key = (client.system, client.component, command)
        if key in self._pending:
            return  # its answer is still to be sent
        if self._last_done is not None and command.number in commands.ONCE_ONLY:
            done, at, result = self._last_done
            if done == key and self._now - at < repeat_s:
                self._acknowledge(command, client, result)
                return
        context = Context(self.constants, state, client.peer, self._find_message, self.shutdown_requests)
        plan = commands.plan_command(command, context)
        if plan.requests:
            self._pending.add(key)
            self._request_next(plan, 0, command, client, key)
        else:
            self._acknowledge(command, client, plan.result)
            self.send(client.peer, plan.messages)
            if plan.text:
                is_accepted = plan.result is CommandResult.ACCEPTED
                self.say(int(Severity.INFO if is_accepted else Severity.WARNING), plan.text, client.peer)

    def _find_message(self, message_id: int) -> Sequence[Message] | None:
        build = self.on_request.get(message_id)
        return None if build is None or self._state is None else [build(self._state.ms)]

    def _request_next(self, plan: Plan, index: int, command: MavCommand, client: Client, key: tuple[Any, ...]) -> None:
        """Send a command's requests in turn; acknowledge the last answer or the first refusal."""

        def reply(answer: Answer) -> None:
            if answer.accepted and index + 1 < len(plan.requests):
                self._request_next(plan, index + 1, command, client, key)
                return
            self._pending.discard(key)
            result = MAV_RESULTS[answer.result]
            self._acknowledge(command, client, result)
            if result is CommandResult.ACCEPTED:
                self._last_done = (key, self._now, result)
            # The pilot itself reports why arming is refused.
            elif answer.text and not isinstance(plan.requests[index], Arm):
                self.say(int(Severity.WARNING), answer.text, client.peer)

        self.port.ask(plan.requests[index], reply, client.label)

    def _acknowledge(self, command: MavCommand, client: Client, result: CommandResult) -> None:
        self.acknowledged += 1
        ack = mav.MAVLink_command_ack_message(command.number, int(result), 0, 0, client.system, client.component)
        self.send(client.peer, (ack,))

    def _set_mode(self, message: Message, client: Client) -> None:
        """Set a mode without acknowledgement; heartbeats show it, and a text message explains a refusal."""
        mode = from_custom(message.custom_mode, self.constants.personality) if message.base_mode & 1 else None
        if mode is None:
            self._report_unusable(f"mode {message.custom_mode} is not known here", client.peer)
            return

        def reply(answer: Answer) -> None:
            if answer.result is not Result.ACCEPTED and answer.text:
                self.say(int(Severity.WARNING), answer.text, client.peer)

        self.port.ask(SetMode(mode.value), reply, client.label)

    def _handle_setpoint(self, message: Message, client: Client) -> None:
        state = self._state
        if state is None:
            return
        try:
            self.port.ask(_SETPOINTS[message.msgname](message, state), None, client.label)
        except InputError as error:
            self._report_unusable(str(error), client.peer)

    def _report_unusable(self, text: str, peer: Peer) -> None:
        """Count a message that cannot be used, and report it at most every ``report_interval_s``."""
        self.link.refused["value"] += 1
        if self._now - self._last_report >= self.report_interval_s:
            self._last_report = self._now
            self.say(int(Severity.WARNING), text, peer)

    def _answer_ping(self, message: Message, client: Client) -> None:
        if message.target_system == 0:
            answer = mav.MAVLink_ping_message(message.time_usec, message.seq, client.system, client.component)
            self.send(client.peer, (answer,))

    def _answer_timesync(self, message: Message, client: Client) -> None:
        """Answer TIMESYNC with simulation time, which all time stamps use."""
        if message.tc1 == 0 and self._state is not None:
            now = round(self._state.time * 1e9)
            self.send(client.peer, (mav.MAVLink_timesync_message(now, message.ts1),))

    def _handle_origin(self, message: Message, client: Client) -> None:
        """Answer SET_GPS_GLOBAL_ORIGIN with the fixed origin, and report that it was not moved."""
        state = self._state
        if state is None:
            return
        self.send(client.peer, gps_global_origin(state))
        at = self.constants.geodesy
        lat, lon = message.latitude * 1e-7, message.longitude * 1e-7
        valid = abs(lat) <= 90.0 and abs(lon) <= 180.0
        if not valid or hypot(*at.to_local(lat, lon, at.ground)[:2]) > commands.MAX_ORIGIN_ERROR_M:
            self._report_unusable(commands.ORIGIN_FIXED, client.peer)

    def _refuse_follow_me(self, message: Message, client: Client) -> None:
        self._report_unusable(FOLLOW_ME_REFUSED, client.peer)


_SETPOINTS: dict[str, Callable[[Message, TelemetryState], Request]] = {  # parser by message
    "MANUAL_CONTROL": lambda message, state: setpoints.parse_sticks(message),
    "SET_ATTITUDE_TARGET": lambda message, state: setpoints.parse_attitude(message),
    "SET_POSITION_TARGET_LOCAL_NED": setpoints.parse_local,
    "SET_POSITION_TARGET_GLOBAL_INT": setpoints.parse_global,
}
_HANDLERS: dict[str, Callable[[MavlinkVehicle, Message, Client], None]] = {  # by message name
    "HEARTBEAT": MavlinkVehicle._handle_heartbeat,
    "COMMAND_LONG": MavlinkVehicle._handle_command,
    "COMMAND_INT": MavlinkVehicle._handle_command,
    "SET_MODE": MavlinkVehicle._set_mode,
    **dict.fromkeys(_SETPOINTS, MavlinkVehicle._handle_setpoint),
    "PING": MavlinkVehicle._answer_ping,
    "TIMESYNC": MavlinkVehicle._answer_timesync,
    "SET_GPS_GLOBAL_ORIGIN": MavlinkVehicle._handle_origin,
    "FOLLOW_TARGET": MavlinkVehicle._refuse_follow_me,
    # Ignored, because rates are set per message.
    "REQUEST_DATA_STREAM": lambda vehicle, message, client: None,
}
assert set(_HANDLERS) <= set(BY_NAME)
