"""Parameters, missions and files of a real autopilot through a real socket, with frames that get lost on the way."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Iterator
from math import isnan, nan
from typing import Any

import numpy as np
import pytest
from mavlink_bench import mav
from mavlink_tools import snapshot
from patience import stretched

from cosim.base.geodesy import Geodesy
from cosim.control.autopilot.requests import ItemKind
from cosim.groundstation.exchange import Exchange, Port
from cosim.groundstation.mavlink.services.ftp import FileService, MemoryFile
from cosim.groundstation.mavlink.services.metadata import GENERAL, Metadata
from cosim.groundstation.mavlink.services.missions import MissionService
from cosim.groundstation.mavlink.services.params import ParameterService
from cosim.groundstation.mavlink.telemetry_state import VehicleConstants
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.transports.endpoint import parse_endpoint
from cosim.simulation.autopilot_setup import attach_autopilot
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

PLACE = Geodesy(22.35, 113.59)
TO = (1, 1)


class Flight:
    """A vehicle on the ground, stepped by whoever waits for something; the link has its own thread."""

    def __init__(self, loss: float, seed: int = 3) -> None:
        table: dict[str, Any] = {"name": "test", "engine": "edf-as-flown", "controller": "smith"}
        table |= {"duration_s": 400.0, "initial": {"on_ground": True}}
        self.simulation = build(Scenario.from_table(table, Scenario.load("hover").folder, "test"))
        self.pilot = pilot = attach_autopilot(self.simulation)
        for _ in range(300):  # until it knows where home is
            self.simulation.step()
        self.exchange = exchange = Exchange()
        self.link = Link([parse_endpoint("udpin:127.0.0.1:0")])
        self.metadata = Metadata(pilot.parameters, "hexjet", "0.1.0")

        def ask(*given: Any) -> None:
            self.vehicle.port.ask(*given)

        files = {path: MemoryFile(data) for path, data in self.metadata.files.items()}
        services = [
            ParameterService(pilot.parameters, ask),
            MissionService(
                lambda: pilot.mission.items, lambda: exchange.snapshot.status if exchange.snapshot else None, ask, PLACE
            ),
            FileService(lambda path: files),
        ]
        self.vehicle = MavlinkVehicle(
            VehicleConstants(PLACE, jets=6), Port(exchange, "mavlink"), self.link, services, self.metadata.on_request
        )
        self.link.start(self.vehicle)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", self.link.ports[0]))
        self.socket.settimeout(0.004)
        self.mav: Any = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.loss, self.chance = loss, random.Random(seed)

    def close(self) -> None:
        self.socket.close()
        self.link.close()
        self.simulation.close()

    def send(self, kind: str, *values: Any) -> None:
        data = getattr(mav, f"MAVLink_{kind.lower()}_message")(*values).pack(self.mav)
        if self.chance.random() >= self.loss:
            self.socket.send(data)

    def wait(self, *kinds: str, seconds: float = 0.15) -> Any:
        """Step until a message of these kinds comes."""
        end = time.monotonic() + stretched(seconds)
        while time.monotonic() < end:
            for waiting in self.exchange.take_requests(100):
                waiting.answer(self.pilot.handle(waiting.request, self.simulation.k))
            self.exchange.publish(snapshot(self.simulation.step(), self.pilot.status))
            try:
                data = self.socket.recv(2048)
            except TimeoutError:
                continue
            if self.chance.random() < self.loss:
                continue
            for message in self.mav.parse_buffer(data) or []:
                if message.get_type() in kinds:
                    return message
        return None

    def insist(self, send: tuple[Any, ...], *kinds: str) -> Any:
        for _ in range(30):
            self.send(*send)
            answer = self.wait(*kinds)
            if answer is not None:
                return answer
        raise AssertionError(f"no {kinds}")


@pytest.fixture(params=[0.0, 0.2], ids=["all frames", "a fifth lost"])
def flight(request: pytest.FixtureRequest) -> Iterator[Flight]:
    flight = Flight(request.param)
    yield flight
    assert not flight.link.failures
    flight.close()


MOSTLY_WHOLE = [pytest.param(0.0, id="all frames"), pytest.param(0.2, id="a fifth lost", marks=pytest.mark.long)]


@pytest.mark.parametrize("flight", MOSTLY_WHOLE, indirect=True)
def test_parameters(flight: Flight) -> None:
    """The list with its gaps filled, and a gain changed in the autopilot's own loop."""
    flight.insist(("PARAM_REQUEST_LIST", *TO), "PARAM_VALUE")
    found: dict[int, str] = {}
    count = len(flight.pilot.parameters.values)
    while (value := flight.wait("PARAM_VALUE")) is not None:
        assert value.param_count == count
        found[value.param_index] = value.param_id
    for index in range(count):
        while index not in found:
            value = flight.insist(("PARAM_REQUEST_READ", *TO, b"", index), "PARAM_VALUE")
            found[value.param_index] = value.param_id
    assert [found[i] for i in range(count)] == sorted(flight.pilot.parameters.values)
    while (value := flight.insist(("PARAM_SET", *TO, b"HJ_ROLL_P", 0.023, 9), "PARAM_VALUE")).param_id != "HJ_ROLL_P":
        continue
    assert value.param_value == np.float32(0.023)
    assert flight.pilot.parameters["HJ_ROLL_P"] == 0.023
    error = flight.insist(("PARAM_SET", *TO, b"HJ_ROLL_P", nan, 9), "PARAM_ERROR")
    assert error.error == 2
    assert flight.pilot.parameters["HJ_ROLL_P"] == 0.023


@pytest.mark.parametrize("flight", MOSTLY_WHOLE, indirect=True)
def test_a_mission(flight: Flight) -> None:
    """Take-off, four corners and home, up into the autopilot and down again."""
    home = flight.pilot.home
    assert home is not None
    assert home.altitude > 0.1  # so that it makes a difference
    corners = [(30.0, 0.0), (30.0, 30.0), (0.0, 30.0), (0.0, 0.0)]
    items = [(6, 22, (0.0, 0.0, 0.0, nan), 0, 0, 10.0)]
    for north, east in corners:
        latitude, longitude, _ = PLACE.to_geodetic(north, east, 10.0)
        items.append((6, 16, (0.0, 1.0, 0.0, nan), round(1e7 * latitude), round(1e7 * longitude), 10.0))
    items.append((2, 20, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0))
    answer = flight.insist(("MISSION_COUNT", *TO, len(items), 0), "MISSION_REQUEST_INT", "MISSION_ACK")
    while answer.get_type() != "MISSION_ACK":
        frame, command, params, x, y, z = items[answer.seq]
        item = ("MISSION_ITEM_INT", *TO, answer.seq, frame, command, answer.seq == 0, 1, *params, x, y, z, 0)
        answer = flight.insist(item, "MISSION_REQUEST_INT", "MISSION_ACK")
    assert answer.type == 0
    kinds = [item.kind for item in flight.pilot.mission.items]
    assert kinds == [ItemKind.TAKEOFF, *[ItemKind.WAYPOINT] * 4, ItemKind.RETURN]
    for item, (north, east) in zip(flight.pilot.mission.items[1:5], corners, strict=True):
        assert (item.north, item.east) == pytest.approx((north, east), abs=0.012)  # 1e-7 deg
        assert item.altitude == pytest.approx(10.0 + home.altitude)
    count = flight.insist(("MISSION_REQUEST_LIST", *TO, 0), "MISSION_COUNT").count
    assert count == len(items)
    for index, (frame, command, params, x, y, z) in enumerate(items):
        while (got := flight.insist(("MISSION_REQUEST_INT", *TO, index, 0), "MISSION_ITEM_INT")).seq != index:
            continue
        assert (got.frame, got.command, got.x, got.y, got.z) == (frame, command, x, y, z)
        assert got.param2 == params[1]
        assert isnan(got.param4) == isnan(params[3])


def test_metadata(flight: Flight) -> None:
    """REQUEST_MESSAGE leads to the file, and the file is the one."""
    command = ("COMMAND_LONG", *TO, 512, 0, 397.0, nan, nan, nan, nan, nan, nan)
    message = flight.insist(command, "COMPONENT_METADATA")
    path = message.uri.removeprefix("mftp://")
    wanted = flight.metadata.files[GENERAL]

    def ask(code: int, sequence: int, data: bytes = b"", offset: int = 0, size: int = 0) -> bytes:
        head = (
            sequence.to_bytes(2, "little") + bytes([0, code, size or len(data), 0, 0, 0]) + offset.to_bytes(4, "little")
        )
        payload = list((head + data).ljust(251, b"\0"))
        while True:
            reply = bytes(flight.insist(("FILE_TRANSFER_PROTOCOL", 0, *TO, payload), "FILE_TRANSFER_PROTOCOL").payload)
            if int.from_bytes(reply[:2], "little") == sequence + 1:
                assert reply[3] == 128
                return reply[12 : 12 + reply[4]]

    assert int.from_bytes(ask(4, 0, path.encode()), "little") == len(wanted)
    got = b""
    while len(got) < len(wanted):
        got += ask(5, 2 + len(got), offset=len(got), size=239)
    assert got == wanted
