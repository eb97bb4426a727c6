"""A vehicle that flies while a table of stations is full: real sockets, and a clock that is counted.

The link's loop runs in the test's own thread, every 20 ms of flight, so that nothing here depends on how busy the
machine is: "0.2 s" are fifty steps.
"""

from __future__ import annotations

from typing import Any

import pytest
from failsafe_flights import Flight
from mavlink_tools import Udp, command

from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.parameters import Parameters
from cosim.groundstation.exchange import Exchange, Port
from cosim.groundstation.links import make_vehicle_constants
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.transports.endpoint import parse_endpoint
from cosim.groundstation.session_flight import forward_messages, make_flight_info, make_snapshot
from cosim.simulation.pacing import PaceReport

LOOK_STEPS = 5  # of flight between two turns of the link's loop
BEAT_S, ASK_S = 1.0, 0.5  # between a station's heartbeats, and between its commands


class Asker:
    """A station that beats, commands, and counts when it is answered; ``silent`` says nothing."""

    def __init__(self, wire: Udp) -> None:
        self.wire = wire
        self.silent = False
        self.asked: list[float] = []
        self.answered: list[float] = []
        self.attitudes = 0
        self._beat = self._ask = 0.0
        wire.socket.setblocking(False)

    def turn(self, now: float) -> None:
        try:
            while True:
                self.wire.read()
        except BlockingIOError:
            pass
        for message in self.wire.got:
            self.attitudes += message.get_type() == "ATTITUDE"
            if message.get_type() == "COMMAND_ACK" and message.command == 512:
                self.answered.append(now)
        self.wire.got.clear()
        if self.silent:
            return
        if now >= self._beat:
            self._beat = now + BEAT_S
            self.wire.heartbeat()
        if now >= self._ask:
            self._ask = now + ASK_S
            self.asked.append(now)
            self.wire.send(command(512, 148.0))


class Airborne:
    """A Hex-Jet in hover with its links, stepped and looked after in one thread."""

    def __init__(self, *urls: str) -> None:
        self.flight = Flight(height=10.0)
        simulation = self.flight.simulation
        self.link = Link([parse_endpoint(url) for url in urls], clock=lambda: self.now)
        self.exchange = Exchange(lambda: self.now)
        self.info = make_flight_info(simulation, 1, Parameters([]), None, 1.0)
        self.vehicle = MavlinkVehicle(
            make_vehicle_constants(self.info, "px4"), Port(self.exchange, "mavlink"), self.link
        )
        self.link.handler = self.vehicle
        self.askers: list[Asker] = []
        self.told = 0

    @property
    def now(self) -> float:
        return self.flight.simulation.k * self.flight.simulation.dt

    def fly(self, seconds: float, until: Any = lambda: False) -> bool:
        """Steps and turns of the link's loop; did ``until`` come true?"""
        simulation, pilot, exchange = self.flight.simulation, self.flight.pilot, self.exchange
        end = self.now + seconds
        while self.now < end:
            for waiting in exchange.take_requests(100):
                waiting.answer(pilot.handle(waiting.request, simulation.k))
            sample = simulation.step()
            assert simulation.termination.check(simulation.state, 0.0) is None
            if simulation.k % LOOK_STEPS:
                continue
            self.told = forward_messages(pilot, exchange, self.told)
            exchange.publish(make_snapshot(simulation, self.info, sample, pilot.status, PaceReport(), self.now))
            for asker in self.askers:
                asker.turn(self.now)
            # as the link's own thread does
            for key, mask in self.link._selector.select(0):
                self.link._run_isolated(key.data, mask)
            self.link.poll(self.now)
            if until():
                return True
        return False

    def close(self) -> None:
        self.link.close()
        self.flight.simulation.close()


def test_a_live_station_is_heard_beside_a_full_table_of_ids_in_flight() -> None:
    """Others' ids come and go by the hundred; the vehicle returns when the last that lives is silent, and no sooner."""
    air = Airborne("udpin:127.0.0.1:0", "udpin:127.0.0.1:0")
    pilot, flood = air.flight.pilot, Udp(air.link.ports[1])
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    try:
        first = Asker(Udp(air.link.ports[0]))
        air.askers = [first]
        air.fly(1.0)
        for number in range(200):
            flood.write(beat.pack(mav.MAVLink(None, srcSystem=2 + number % 240, srcComponent=1 + number // 240)))
            air.fly(0.02)
        # all places were taken before this one came, and it is the only one that goes on
        late = Asker(Udp(air.link.ports[0], system=99))
        air.askers = [late]
        air.fly(7.0)
        assert pilot.mode is Mode.HOLD
        assert (99, 190) in air.vehicle.stations
        assert len(late.answered) >= len(late.asked) - 1
        late.silent = True
        silent = air.now
        assert air.fly(10.0, lambda: pilot.mode is not Mode.HOLD)
        assert pilot.failsafe == "no ground station"
        assert air.now - silent == pytest.approx(
            3.5 + pilot.parameters["HJ_LINK_DELAY"], abs=BEAT_S + 2 * LOOK_STEPS * air.flight.simulation.dt
        )
        first.wire.close()
        late.wire.close()
    finally:
        flood.close()
        air.close()
    assert not air.link.failures
