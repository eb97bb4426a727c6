"""What QGroundControl does when it meets a vehicle, with its time-outs and its number of tries, also on a bad link.

The sequence and the limits are those of its sources: InitialConnectStateMachine (a limit for each step, one retry),
MavCommandQueue (3 s for an acknowledgement; three tries, and one for what makes a vehicle move), ParameterManager,
PlanManager, PX4FirmwarePlugin and FirmwarePlugin (a mode is asked for three times and must show within 1.3 s).
"""

from __future__ import annotations

import json
import lzma
import math
import random
import select
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest
from gcs_tools import LOOPBACK, Station, VehicleProcess
from patience import FLIGHT_PATIENCE, stretched

from cosim.groundstation.links import find_files
from cosim.groundstation.mavlink.services.ftp import MemoryFile
from cosim.groundstation.mavlink.services.service import crc32

RTF = 6.0
LOSS = 0.2  # of all datagrams, each way
ACK, TRIES = 3.0, 3  # s for an acknowledgement, and how often it is asked for
MODE, MODES = 1.3, 3  # s for a mode to show
PARAMETER, SINGLE = 3.0, 5  # s without news of the list; tries for one
ITEM, COUNT, PLAN = 0.25, 1.5, 5  # s for an item, s for anything else of a mission, tries
FTP, FTP_TRIES = 1.0, 6
REQUEST, REPOSITION, ARM, TAKEOFF = 512, 192, 400, 22
AUTOPILOT_VERSION, MODES_LIST, METADATA = 148, 435, 397
NAN = math.nan
# custom_mode of PX4 by the names that QGroundControl has for them
HOLD, TAKING_OFF, MISSION, RETURN, LAND, POSITION = (4, 3), (4, 2), (4, 4), (4, 5), (4, 6), (3, 0)


class LateError(AssertionError):
    """A step of the connection took longer than QGroundControl waits."""


class Relay:
    """A UDP link to ``port`` that loses a share of the datagrams, by a seeded chance, each way."""

    def __init__(self, port: int, loss: float, seed: int) -> None:
        self.loss = loss
        self.lost: Counter[str] = Counter()
        self.passed: Counter[str] = Counter()
        self._chances = {"up": random.Random(seed), "down": random.Random(seed + 1)}
        self._to = (LOOPBACK, port)
        self._inner, self._outer = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for each in (self._inner, self._outer):
            each.bind((LOOPBACK, 0))
        self.port: int = self._outer.getsockname()[1]
        self._client: Any = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._inner.close()
        self._outer.close()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._over.is_set():
            for ready in select.select([self._inner, self._outer], [], [], 0.05)[0]:
                try:
                    data, address = ready.recvfrom(2048)
                except OSError:
                    continue
                way = "up" if ready is self._outer else "down"
                if way == "up":
                    self._client = address
                if self._chances[way].random() < self.loss:
                    self.lost[way] += 1
                    continue
                self.passed[way] += 1
                if way == "up":
                    self._inner.sendto(data, self._to)
                elif self._client is not None:
                    self._outer.sendto(data, self._client)


class QGroundControl(Station):
    """The parts of it that meet a vehicle."""

    haste = 1.0  # how long is waited for a frame is divided by it: harder for the vehicle, and quicker here
    presses = 1  # how often its pilot begins again what QGroundControl has given up
    _limit = math.inf  # when the present step of the connection is given up

    def wait(self, *kinds: str, seconds: float, match: Callable[[Any], bool] = lambda m: True) -> Any:
        return super().wait(*kinds, seconds=seconds / self.haste, match=match)

    def connect(self) -> dict[str, Any]:
        """Everything that is asked for before the vehicle may be flown; what was found, step by step.

        Each step has its limit and one retry; what is not found by then is left out, as QGroundControl does without it,
        unless its pilot asks for it again.
        """
        self.until("HEARTBEAT", lambda beat: beat.get_srcComponent() == 1, 3.5)  # after that it is not there
        found: dict[str, Any] = {}
        for name, limit, step in (
            ("version", 5.0, self.version),
            ("modes", 5.0, self.modes),
            ("metadata", 30.0, self.metadata),
            ("parameters", 60.0, self.parameters),
            ("mission", 30.0, self.mission),
        ):
            for _ in range(2 * self.presses):
                self._limit = time.monotonic() + stretched(limit)
                with suppress(LateError):
                    found[name] = step()
                    break
        self._limit = math.inf
        return found

    def ask(
        self, send: Callable[[], object], kind: str, seconds: float, tries: int, match: Any = lambda m: True
    ) -> Any:
        """Send until an answer comes."""
        for _ in range(tries):
            self.hurry()
            send()
            answer = self.wait(kind, seconds=seconds, match=match)
            if answer is not None:
                return answer
        raise LateError(f"no {kind} after {tries} times {seconds:g} s")

    def hurry(self) -> None:
        if time.monotonic() > self._limit:
            raise LateError("the step took too long")

    def request(self, number: int, kind: str, *more: float, match: Callable[[Any], bool] = lambda m: True) -> Any:
        """REQUEST_MESSAGE: an acknowledgement within 3 s, three tries, and the message."""
        self.take("COMMAND_ACK", kind)
        for _ in range(TRIES):
            self.hurry()
            self.long(REQUEST, float(number), *more)
            ack = self.wait("COMMAND_ACK", seconds=ACK, match=lambda m: m.command == REQUEST)
            if ack is None:
                continue
            if ack.result != 0:
                raise LateError(f"message {number} refused: {ack.result}")
            message = self.wait(kind, seconds=1.0, match=match)
            if message is not None:
                return message
        raise LateError(f"no {kind}")

    def version(self) -> Any:
        return self.request(AUTOPILOT_VERSION, "AUTOPILOT_VERSION")

    def modes(self) -> list[Any]:
        first = self.request(MODES_LIST, "AVAILABLE_MODES", 1.0, match=lambda m: m.mode_index == 1)
        return [first] + [
            self.request(MODES_LIST, "AVAILABLE_MODES", float(i), match=lambda m, i=i: m.mode_index == i)
            for i in range(2, first.number_modes + 1)
        ]

    def metadata(self) -> Any:
        """The general description, and the parameters' that it names, each with its checksum."""
        told = self.request(METADATA, "COMPONENT_METADATA")
        general = json.loads(lzma.decompress(self.download(told.uri, told.file_crc)))
        (line,) = [each for each in general["metadataTypes"] if each["type"] == 1]
        return json.loads(lzma.decompress(self.download(line["uri"], line["fileCrc"])))

    def download(self, uri: str, checksum: int) -> bytes:
        """Open over MAVLink's file transfer, read in one burst, and what is missing a part at a time."""
        path = uri.removeprefix("mftp://").encode()
        opened = self.ftp(0, 4, path, 0)
        session, size = opened[2], struct.unpack("<I", opened[12:16])[0]
        self._number += 2
        self.take("FILE_TRANSFER_PROTOCOL")
        self.send("FILE_TRANSFER_PROTOCOL", 0, 1, 1, self.packed(session, 15, b"", 0, 239))
        parts: dict[int, bytes] = {}
        while (part := self.wait("FILE_TRANSFER_PROTOCOL", seconds=FTP)) is not None:
            content = bytes(part.payload)
            parts[struct.unpack("<I", content[8:12])[0]] = content[12 : 12 + content[4]]
            if sum(map(len, parts.values())) == size:
                break
        self._number += 1000  # a burst counts its own
        at = 0
        while at < size:
            if at not in parts:
                part = self.ftp(session, 5, b"", at, 239)
                parts[at] = part[12 : 12 + part[4]]
            at += len(parts[at])
        self.ftp(session, 1, b"", 0)
        data = b"".join(parts[at] for at in sorted(parts))
        assert crc32(data) == checksum
        return data

    _number = 0

    def packed(self, session: int, code: int, data: bytes, offset: int, size: int | None = None) -> list[int]:
        length = len(data) if size is None else size
        head = struct.pack("<HBBBBBBI", self._number & 0xFFFF, session, code, length, 0, 0, 0, offset)
        return list((head + data).ljust(251, b"\0"))

    def ftp(self, session: int, code: int, data: bytes, offset: int, size: int | None = None) -> bytes:
        """One request; what is acknowledged."""
        self._number += 2
        payload = self.packed(session, code, data, offset, size)
        answer = self.ask(
            lambda: self.send("FILE_TRANSFER_PROTOCOL", 0, 1, 1, payload),
            "FILE_TRANSFER_PROTOCOL",
            FTP,
            FTP_TRIES,
            lambda m: m.payload[0] | m.payload[1] << 8 == (self._number + 1) & 0xFFFF,
        )
        found = bytes(answer.payload)
        assert found[3] == 128, found[:16]  # ACK
        return found

    def parameters(self) -> dict[str, float]:
        """The list; its gaps by index, ten at once."""
        self.take("PARAM_VALUE")
        self.send("PARAM_REQUEST_READ", 1, 1, b"_HASH_CHECK", -1)
        found: dict[int, Any] = {}

        def listen(wanted: Callable[[], bool]) -> None:
            while wanted():
                value = self.wait("PARAM_VALUE", seconds=PARAMETER)
                if value is None:
                    return
                if value.param_index < 65535:
                    found[value.param_index] = value

        listed = lambda m: m.param_index < 65535  # noqa: E731
        first = self.ask(lambda: self.send("PARAM_REQUEST_LIST", 1, 0), "PARAM_VALUE", 5.0, 4, listed)
        found[first.param_index] = first
        listen(lambda: len(found) < first.param_count)
        tries = dict.fromkeys(range(first.param_count), 0)
        while missing := [index for index in tries if index not in found][:10]:
            for index in missing:
                tries[index] += 1
                if tries[index] > SINGLE:
                    raise LateError(f"parameter {index}")
                self.send("PARAM_REQUEST_READ", 1, 1, b"", index)
            listen(lambda missing=missing: any(index not in found for index in missing))
        return {value.param_id: value.param_value for value in found.values()}

    def set_parameter(self, name: str, value: float) -> None:
        self.take("PARAM_VALUE")
        self.ask(
            lambda: self.send("PARAM_SET", 1, 1, name.encode(), value, 9),
            "PARAM_VALUE",
            PARAMETER,
            SINGLE * self.presses,
            lambda m: m.param_id == name and m.param_value == struct.unpack("<f", struct.pack("<f", value))[0],
        )

    def mission(self) -> list[Any]:
        """Down."""
        self.take("MISSION_COUNT", "MISSION_ITEM_INT")
        count = self.ask(
            lambda: self.send("MISSION_REQUEST_LIST", 1, 1, 0), "MISSION_COUNT", COUNT, PLAN * self.presses
        ).count
        found = []
        for i in range(count):
            give = lambda i=i: self.send("MISSION_REQUEST_INT", 1, 1, i, 0)  # noqa: E731
            found.append(self.ask(give, "MISSION_ITEM_INT", ITEM, 4 * PLAN * self.presses, lambda m, i=i: m.seq == i))
        self.send("MISSION_ACK", 1, 1, 0, 0)
        return found

    def upload(self, items: list[tuple[Any, ...]]) -> int:
        """Up: the vehicle asks for each; its last word."""
        self.take("MISSION_REQUEST_INT", "MISSION_ACK")
        asked = self.ask(
            lambda: self.send("MISSION_COUNT", 1, 1, len(items), 0), "MISSION_REQUEST_INT", COUNT, PLAN * self.presses
        )
        end = time.monotonic() + FLIGHT_PATIENCE
        while time.monotonic() < end:
            if asked is not None and asked.get_type() == "MISSION_ACK":
                return int(asked.type)
            if asked is None:  # it failed, and its pilot presses again
                return self.upload(items)
            self.send("MISSION_ITEM_INT", 1, 1, asked.seq, *items[asked.seq], 0)
            asked = self.wait("MISSION_REQUEST_INT", "MISSION_ACK", seconds=COUNT)
        raise LateError("no end of an upload")

    def press(self, number: int, *params: float, integer: tuple[Any, ...] = ()) -> None:
        """A command that QGroundControl sends once; here again when its acknowledgement does not come in time."""
        for _ in range(5 * self.presses):
            self.take("COMMAND_ACK")
            if integer:
                self.send("COMMAND_INT", 1, 1, 0, number, 0, 0, *integer)
            else:
                self.long(number, *params)
            ack = self.wait("COMMAND_ACK", seconds=ACK, match=lambda m: m.command == number)
            if ack is not None:
                assert ack.result == 0, (number, ack, self.texts())
                return
        raise LateError(f"no acknowledgement of {number}")

    def set_mode(self, mode: tuple[int, int]) -> None:
        """SET_MODE three times, each with 1.3 s for the heartbeat to show it."""
        number = mode[0] << 16 | mode[1] << 24
        armed = 128 if self.armed else 0
        for _ in range(MODES * self.presses):
            self.send("SET_MODE", 1, 1 | armed, number)
            end = time.monotonic() + stretched(MODE)
            while time.monotonic() < end:
                if self.mode == mode:
                    return
                time.sleep(0.02)
        raise LateError(f"mode {mode} is not shown: {self.mode}, {self.texts()}")

    def take_off(self, height: float) -> None:
        """NAV_TAKEOFF to a height above the sea while disarmed, and arming on its acknowledgement."""
        sea = self.until("GLOBAL_POSITION_INT", lambda m: True, 3.0).alt / 1000.0
        self.press(TAKEOFF, -1.0, 0.0, 0.0, NAN, NAN, NAN, sea + height)
        self.press(ARM, 1.0)

    def at(self, height: float) -> None:
        self.until("GLOBAL_POSITION_INT", lambda m: abs(m.relative_alt / 1000.0 - height) < 0.7, FLIGHT_PATIENCE)


@contextmanager
def station(vehicle: VehicleProcess, loss: float) -> Iterator[QGroundControl]:
    with Relay(vehicle.port, loss, seed=7) as relay, QGroundControl(relay.port) as found:
        yield found
        if loss:
            for way in ("up", "down"):
                share = relay.lost[way] / (relay.lost[way] + relay.passed[way])
                # of some hundred datagrams up and some thousand down: four standard deviations
                assert share == pytest.approx(loss, abs=0.08), way


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[VehicleProcess]:
    process = VehicleProcess(tmp_path, RTF)
    yield process
    process.kill()


def waypoint(home: Any, north: float, east: float, height: float) -> tuple[Any, ...]:
    """An item, relative to home."""
    degree = 6371000.0 * math.pi / 180.0
    longitude = home.longitude + 1e7 * east / degree / math.cos(math.radians(home.latitude * 1e-7))
    return (6, 16, 0, 1, 0.0, 1.5, 0.0, NAN, round(home.latitude + 1e7 * north / degree), round(longitude), height)


@pytest.mark.parametrize("loss", [0.0, pytest.param(LOSS, marks=pytest.mark.long)])
def test_connect_fly_and_land_as_qgroundcontrol(vehicle: VehicleProcess, loss: float) -> None:
    with station(vehicle, loss) as qgc:
        if loss:
            # of ten thousand tries with a fifth lost each way, 60 fail five times in a row, and none fifteen times
            qgc.haste, qgc.presses = 10.0, 3
        found = qgc.connect()
        if not loss:
            assert set(found) == {"version", "modes", "metadata", "parameters", "mission"}
        check_connection(found)
        # QGroundControl does not ask for it again: it comes every two seconds
        home = qgc.until("HOME_POSITION", lambda m: True, FLIGHT_PATIENCE)
        qgc.set_parameter("HJ_LINK_DELAY", 60.0)  # s of flight; heartbeats come once a second of wall time
        qgc.until("SYS_STATUS", lambda m: bool(m.onboard_control_sensors_health & 1 << 28), FLIGHT_PATIENCE)

        qgc.take_off(8.0)
        qgc.until("EXTENDED_SYS_STATE", lambda m: m.landed_state == 2, FLIGHT_PATIENCE)  # the buttons change
        qgc.until("HEARTBEAT", lambda m: qgc.mode == HOLD and qgc.armed, FLIGHT_PATIENCE)
        qgc.at(8.0)

        # a click on the map: 15 m to the north, at the height above the sea that it has
        sea = qgc.now("GLOBAL_POSITION_INT").alt / 1000.0
        x, y = waypoint(home, 15.0, 0.0, 0.0)[8:10]
        qgc.press(REPOSITION, integer=(-1.0, 1.0, 0.0, NAN, x, y, sea))
        qgc.until("GLOBAL_POSITION_INT", lambda m: abs(m.lat - x) * 1e-7 * 111194.9 < 1.0, FLIGHT_PATIENCE)
        if not loss:
            # change of height: a pause, then to home's height and more
            qgc.press(REPOSITION, -1.0, 1.0, 0.0, NAN, NAN, NAN, NAN)
            qgc.press(REPOSITION, -1.0, 1.0, 0.0, NAN, NAN, NAN, home.altitude / 1000.0 + 12.0)
            qgc.at(12.0)
            # heading
            qgc.press(REPOSITION, -1.0, 1.0, 0.0, math.radians(120.0), NAN, NAN, NAN)
            aim = math.radians(120.0)
            qgc.until("ATTITUDE", lambda m: abs(math.remainder(m.yaw - aim, math.tau)) < 0.06, FLIGHT_PATIENCE)
            qgc.press(178, 1.0, 3.0, -1.0, 0.0, NAN, NAN, NAN)  # speed

        assert qgc.upload([waypoint(home, 10.0, 0.0, 10.0), waypoint(home, 0.0, 6.0, 9.0)]) == 0
        assert [item.z for item in qgc.mission()] == [10.0, 9.0]
        qgc.set_mode(MISSION)
        qgc.until("HEARTBEAT", lambda m: qgc.mode == HOLD, FLIGHT_PATIENCE)  # at its end
        qgc.set_mode(RETURN)
        qgc.until("HEARTBEAT", lambda m: not qgc.armed, FLIGHT_PATIENCE)
        assert qgc.counts["BAD_DATA"] == 0


def check_connection(found: dict[str, Any]) -> None:
    """What must be there, or QGroundControl complains, shows its set-up page, or misses buttons."""
    if version := found.get("version"):
        assert version.flight_sw_version >> 8 >= 0x010401
        assert version.flight_sw_version & 0xFF != 255
        assert version.capabilities & 0x29FE == 0x29FE
    listed = found.get("modes", [])
    modes = {mode.mode_name: (mode.custom_mode >> 16 & 0xFF, mode.custom_mode >> 24) for mode in listed}
    wanted = {
        "Hold": HOLD,
        "Takeoff": TAKING_OFF,
        "Mission": MISSION,
        "Return": RETURN,
        "Land": LAND,
        "Position": POSITION,
    }
    assert not modes or {"Manual": (1, 0), **wanted}.items() <= modes.items()  # without it, it keeps a list of its own
    assert found["mission"] == []
    parameters = found["parameters"]
    if metadata := found.get("metadata"):
        assert {line["name"] for line in metadata["parameters"]} == set(parameters)

    def whole(name: str) -> int:
        return int(struct.unpack("<i", struct.pack("<f", parameters[name]))[0])

    assert whole("SYS_AUTOSTART") != 0
    assert whole("COM_RC_IN_MODE") == 1
    assert whole("CAL_GYRO0_ID") != 0
    assert whole("CAL_ACC0_ID") != 0
    assert whole("SYS_HAS_MAG") == whole("SYS_HITL") == 0
    assert not [name for name in parameters if name.startswith("BAT1_")]
    assert {"MIS_TAKEOFF_ALT", "RTL_RETURN_ALT", "MPC_XY_VEL_MAX", "MPC_LAND_SPEED"} <= set(parameters)


def test_reading_descriptions_makes_no_log() -> None:
    """A ground station reads them whenever it connects; making logs of old runs would cost the flight its deadlines."""

    class Untouched:
        def files(self) -> Any:
            raise AssertionError("the logs were asked for")

    here = MemoryFile(b"x")
    find = partial(find_files, {"etc/a.json.xz": here}, cast(Any, Untouched()))
    assert find("etc/a.json.xz")["etc/a.json.xz"] is here
    assert "@PARAM/param.pck" not in find("@PARAM/param.pck")
    with pytest.raises(AssertionError, match="asked for"):
        find("log/log_0.ulg")
