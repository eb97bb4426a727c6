"""A vehicle without a flight, and a ground station that is pymavlink's own code."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from math import nan
from typing import Any

from patience import stretched

from cosim.base.geodesy import Geodesy
from cosim.base.protocols import EngineState
from cosim.base.signals import (
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    Sample,
    State,
    Unallocated,
)
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.modes import Home, LandedState, Mode
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.requests import Answer, Arm, Disarm, Request, Result, SetMode, Takeoff
from cosim.control.autopilot.status import Status
from cosim.groundstation.exchange import Exchange, FlightInfo, Port, Snapshot
from cosim.groundstation.mavlink.telemetry_state import VehicleConstants
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.simulation.pacing import PaceReport
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

GEODESY = Geodesy(22.35, 113.59, 12.0)
ABOUT = VehicleConstants(
    GEODESY, jets=6, name="hexjet", version="0.1.0", tilt_range=0.5, full_thrust=(20.0,) * 6, fuel_capacity=2.0,
    position_noise=0.4, velocity_noise=0.05, height_noise=0.1,
)  # fmt: skip
HALF = 0.5**0.5
MOST = 1000  # requests at once


def sample(k: int = 250, **changes: Any) -> Sample:
    """Half a second after something: nose east, 10 m up, climbing with 2 m/s, every number different."""
    position, velocity = (3.0, 4.0, -10.0), (1.0, 0.5, -2.0)
    attitude, rate = (HALF, 0.0, 0.0, HALF), (0.1, 0.2, 0.3)
    euler, force, wind = (0.0, 0.0, 1.5707963), (0.1, 0.2, -9.8), (4.0, 5.0, 0.0)
    state = State(position, velocity, attitude, euler, rate, force, 10.0, wind, 5.5, False, False)
    made = Sample(
        k, k * 0.004, Command((0.05, -0.04, 1.5), 10.0), state, Measured(rate, attitude, position, velocity, 10.0),
        ControlSignals((0.4, 0.5, 0.6), (0.11, 0.22, 0.33), (0.01, 0.02, 0.03), 0.45, 0.45),
        Actuation((0.1, 0.2, 0.3, 0.4, 0.5, 0.6), (0.1, -0.1), Unallocated()), (0.1, -0.1),
        EngineOutput((5.0,) * 6, tuple(1000.0 * (i + 1) for i in range(6)), (873.15,) * 6, (0.001,) * 6),
        Disturbance(), fuel=1.5,
    )  # fmt: skip
    return made._replace(**changes)


def status(**changes: Any) -> Status:
    """On the ground, ready, at home."""
    made = Status(
        k=250, mode=Mode.HOLD, armed=False, landed=LandedState.ON_GROUND, engines=EngineState.IDLE, ready=True, refusals=(),
        home=Home(0.0, 0.0, 2.0), fix=Fix((3.0, 4.0), (1.0, 0.5), (0.0, 0.0)), target=None, track=None, altitude=10.0, yaw=1.5,
        mission_count=0, mission_current=0, mission_reached=-1, mission_done=False, failsafe="", remaining=0.75,
        sticks_fresh=False, link_lost=False,
    )  # fmt: skip
    return made._replace(**changes)


# of roll, pitch and yaw: rates of the model without delay and with it, rad/s, and the delay in steps of 4 ms
PREDICTING = ((0.7, 0.5, 25.0), (0.8, 0.6, 25.0), (0.9, 0.65, nan))
FACTS = FlightInfo(1, Scenario.load("hover"), load_vehicle("hexjet")[0], (), GEODESY, Parameters([]), None, 1.0)


def snapshot(sample: Sample, status: Status, diagnostics: Any = PREDICTING, load: float = 0.25) -> Snapshot:
    """The flight where a sample says that it is."""
    pace = PaceReport(load=load)
    return Snapshot(
        0.0, FACTS, sample.k, sample.time, sample, sample.state, sample.measured, status, pace, None, (), diagnostics
    )


class Pilot:
    """Answers as it is told to, and remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[Request] = []
        self.answers: dict[type, Answer] = {}
        self.status = status()

    def handle(self, request: Request) -> Answer:
        self.asked.append(request)
        answer = self.answers.get(type(request))
        if answer is not None:
            return answer
        if isinstance(request, Arm | Disarm):
            self.status = self.status._replace(armed=isinstance(request, Arm))
        if isinstance(request, SetMode):
            self.status = self.status._replace(mode=Mode(request.mode))
        if isinstance(request, Takeoff):
            self.status = self.status._replace(mode=Mode.TAKEOFF)
        return Answer(True, Result.ACCEPTED, "")


class Bench:
    """Vehicle, exchange and pilot without sockets or threads; time goes on when it is told to."""

    def __init__(self, about: VehicleConstants = ABOUT, signing: Signing | None = None, **more: Any) -> None:
        self.time = 100.0
        self.link = Link([], signing=signing, clock=lambda: self.time)
        self.exchange = Exchange(lambda: self.time)
        self.vehicle = MavlinkVehicle(about, Port(self.exchange, "mavlink"), self.link, **more)
        self.link.handler = self.vehicle
        self.pilot = Pilot()
        self.k = 250
        self.publish()

    def publish(self, **changes: Any) -> None:
        self.exchange.publish(snapshot(sample(self.k, **changes), self.pilot.status))

    def station(self, system: int = 255, component: int = 190) -> Desk:
        return Desk(self, system, component)

    def step(self, seconds: float = 0.0, every: float = 0.02) -> None:
        """Time goes on: the pilot answers, the vehicle polls."""
        end = self.time + seconds
        while True:
            while taken := self.exchange.take_requests(MOST):
                for waiting in taken:
                    waiting.answer(self.pilot.handle(waiting.request))
                self.publish()
                self.vehicle.poll(self.time)
            self.publish()
            self.vehicle.poll(self.time)
            if self.time >= end - 1e-9:
                return
            self.time += every
            self.k += round(every / 0.004)

    def close(self) -> None:
        self.link.close()


class _Channel:
    """What the link believes to be an open endpoint with one peer."""

    def __init__(self, peer: Peer) -> None:
        self.peers = [peer]

    def poll(self, now: float) -> None:
        pass

    def close(self) -> None:
        pass


class Desk:
    """A ground station at a bench: sends messages, has what it got back as messages."""

    def __init__(self, bench: Bench, system: int, component: int) -> None:
        self.bench = bench
        self.parser = mav.MAVLink(None)
        self.parser.robust_parsing = True
        self.mav = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self.got: list[Any] = []
        self.frames: list[bytes] = []
        self.full = False  # takes nothing more
        self.peer = bench.link.new_peer(f"desk {system}", self._take, is_datagram=True)
        bench.link._channels.append(_Channel(self.peer))

    def _take(self, data: bytes) -> int:
        if self.full:
            return 0
        self.frames.append(data)
        message = self.parser.parse_char(data)
        assert message is not None
        assert message.get_type() != "BAD_DATA", message
        self.got.append(message)
        return len(data)

    def send(self, message: Any) -> None:
        raw = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.bytes(raw)

    def bytes(self, raw: bytes) -> None:
        self.bench.link.dispatch_frames(self.peer.feed(raw, self.bench.time), self.peer, self.bench.time)

    def ask(self, message: Any, seconds: float = 0.0) -> list[Any]:
        """Send, let the vehicle answer, and give what came, telemetry left out where time stands still."""
        self.got.clear()
        self.send(message)
        self.bench.step(seconds)
        return self.got

    def named(self, name: str) -> list[Any]:
        return [message for message in self.got if message.get_type() == name]


def message_of(kind: Any, payload: bytes) -> Any:
    """A message of this kind, as pymavlink reads it out of a frame with this payload."""
    body = mav.MAVLink_header(kind.id, mlen=len(payload)).pack() + payload
    crc = mav.x25crc(body[1:] + bytes((kind.crc_extra,))).crc
    return mav.MAVLink(None).decode(bytearray(body + crc.to_bytes(2, "little")))


def command(number: int, *p: float, target: int = 1, component: int = 1, confirmation: int = 0) -> Any:
    """COMMAND_LONG; what is not given is NaN."""
    values = [*p, *[nan] * (7 - len(p))]
    return mav.MAVLink_command_long_message(target, component, number, confirmation, *values)


class Udp:
    """A ground station on a real socket."""

    def __init__(
        self, to: int | None = None, system: int = 255, component: int = 190, key: bytes | None = None
    ) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.port = self.socket.getsockname()[1]
        self.to: Any = ("127.0.0.1", to) if to else None
        self.mav = mav.MAVLink(self, srcSystem=system, srcComponent=component)
        self.mav.robust_parsing = True
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.timestamp = int((time.time() - 1420070400.0) * 1e5)
        self.got: list[Any] = []

    def write(self, data: bytes) -> None:
        if self.to is not None:
            self.socket.sendto(data, self.to)

    def send(self, message: Any) -> None:
        self.mav.send(message)

    def heartbeat(self) -> None:
        self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def read(self) -> None:
        try:
            data, address = self.socket.recvfrom(2048)
        except TimeoutError:
            return
        self.to = address
        self.got += self.mav.parse_buffer(data) or []

    def wait(self, wanted: Callable[[Any], bool], seconds: float = 3.0) -> Any:
        """The first message that is wanted; None where none comes in time."""
        end = time.monotonic() + stretched(seconds)
        at = 0
        while True:
            for message in self.got[at:]:
                if wanted(message):
                    return message
            at = len(self.got)
            if time.monotonic() > end:
                return None
            self.read()

    def name(self, name: str, seconds: float = 3.0) -> Any:
        return self.wait(lambda message: message.get_type() == name, seconds)

    def close(self) -> None:
        self.socket.close()
