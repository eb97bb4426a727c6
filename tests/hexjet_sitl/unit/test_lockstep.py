"""The lockstep with stand-ins written from the protocols: no sample lost or doubled, and every fault named.

The tables of docs/tables/autopilots.md say what is sent, in the words of the tests below.
"""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import degrees, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from autopilot_standins import ArduPilotStandIn, Px4StandIn, free_instance
from command_tools import Hexjet
from patience import PATIENCE

from cosim.base.errors import FlightError, InputError
from cosim.base.frames import from_euler
from cosim.base.geodesy import Geodesy
from cosim.groundstation.mavlink.wire.dialect import KINDS, mav
from cosim.spec.vehicle import load_vehicle
from hexjet_sitl import hil, px4
from hexjet_sitl.ardupilot import ArduPilot
from hexjet_sitl.instruments import compute_earth_field, to_body_field
from hexjet_sitl.lockstep import SensorFrame, Setup, StickPositions
from hexjet_sitl.px4 import Px4

STEP = 0.004
HEXJET = load_vehicle("hexjet")[0]
PLACE = Geodesy(22.35, 113.59, 5.0)
STICKS = StickPositions(0.5, -0.25, 0.1, 0.4, True)


def frame(k: int, **changes: Any) -> SensorFrame:
    made = SensorFrame(
        k * STEP, (0.1, -0.2, 0.3), (0.5, -0.4, -9.8), from_euler(0.1, 0.2, 0.3), (1.0, 2.0, -30.0), (0.1, 0.2, -0.3), 30.0, STICKS
    )  # fmt: skip
    return made._replace(**changes)


def fifty(ours: ArduPilot | Px4, silent: bool = False) -> None:
    """Exchange; from the 20th on, where it falls ``silent``, an answer is waited for 0.3 s only."""
    for k in range(50):
        ours.limit = 0.3 if silent and k >= 19 else PATIENCE
        ours.exchange(frame(k))


@contextmanager
def ardupilot(folder: Path, step: float = STEP, **faults: Any) -> Iterator[tuple[ArduPilot, ArduPilotStandIn]]:
    instance = free_instance(range(100, 4000), 9002, 10, socket.SOCK_DGRAM)
    ours = ArduPilot(None, folder, HEXJET, step, PLACE, Setup(instance, PATIENCE))
    theirs = ArduPilotStandIn(9002 + 10 * instance, **faults)
    try:
        ours.start()
        yield ours, theirs
    finally:
        ours.close()
        theirs.close()


@contextmanager
def px4_pair(folder: Path, **faults: Any) -> Iterator[tuple[Px4, Px4StandIn]]:
    instance = free_instance(range(1000, 40000), 4560, 1, socket.SOCK_STREAM)
    ours = Px4(None, folder, HEXJET, STEP, PLACE, Setup(instance, PATIENCE))
    theirs = Px4StandIn(4560 + instance, **faults)
    try:
        ours.start()
        yield ours, theirs
    finally:
        ours.close()
        theirs.thread.join(PATIENCE)


@pytest.mark.parametrize("steps", [2000, pytest.param(100_000, marks=pytest.mark.long)])
def test_ardupilot_loses_and_doubles_nothing(steps: int, tmp_path: Path) -> None:
    """With answers that are lost, packets that come twice and late: its clock goes through every step once, in order."""
    rng = np.random.default_rng(7)
    twice, late = (sorted(rng.choice(np.arange(2, steps - 2), 20, replace=False).tolist()) for _ in range(2))
    lose = (700, 1900)
    with ardupilot(tmp_path, lose=lose, twice=twice, late=late, waits=0.2) as (ours, theirs):
        ours.repeat_delay = 0.1
        for k in range(steps):
            answer = ours.exchange(frame(k))
        assert answer.throttle == (0.5,) * 6
        counts = ours.counts
    assert (counts.frames, counts.answers) == (steps, steps)
    assert counts.repeated >= len(twice) + len(late) + len(lose)
    assert theirs.wrong == []
    assert theirs.times == pytest.approx([k * STEP for k in range(len(theirs.times))], abs=1e-9)
    assert len(theirs.times) == steps


def test_what_came_twice_is_answered_once(tmp_path: Path) -> None:
    """A second answer would be taken for that to the next packet."""
    with ardupilot(tmp_path, twice=range(200)) as (ours, theirs):
        for k in range(200):
            ours.exchange(frame(k))
        assert (ours.counts.answers, theirs.stale) == (200, 0)
        assert ours.counts.repeated >= 199


def test_ardupilot_is_told_what_was_measured(tmp_path: Path) -> None:
    """All numbers in its frames and units, and its pulses as throttles and tilts."""
    pulses = [1000, 1250, 1500, 1750, 2000, 2100, 1600, 1000, *[0] * 24]
    with ardupilot(tmp_path, channels=32, pulses=lambda told: pulses) as (ours, theirs):
        answer = ours.exchange(frame(0))
        told = theirs.told
    assert answer.throttle == (0.0, 0.25, 0.5, 0.75, 1.0, 1.0)
    assert HEXJET.servo is not None
    assert answer.tilt == pytest.approx((0.2 * HEXJET.servo.range_rad, -HEXJET.servo.range_rad))
    given = frame(0)
    assert told["imu"] == {"gyro": list(given.rate), "accel_body": list(given.force)}
    assert told["quaternion"] == pytest.approx(given.attitude, rel=1e-8)
    assert (told["position"], told["velocity"]) == (list(given.position), list(given.velocity))


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ({"hang": 20}, r"ardupilot did not answer within 0\.3 s"),
        ({"skip": 20}, r"ardupilot went on from frame 19 to 21: frames between were lost"),
    ],
)
def test_what_ardupilot_does_wrong_is_named(faults: dict[str, int], said: str, tmp_path: Path) -> None:
    with ardupilot(tmp_path, **faults) as (ours, _):
        with pytest.raises(FlightError, match=said):
            fifty(ours, silent="skip" not in faults)
        assert 19 <= ours.counts.answers <= 21


def test_another_rate_than_the_flights_is_refused(tmp_path: Path) -> None:
    """Once it is there: it begins at 1200 frames a second, whatever it is set to, and slides."""
    with ardupilot(tmp_path, rate=400) as (ours, theirs):
        for k in range(2399):
            ours.exchange(frame(k))
        assert theirs.slid() == 400
        with pytest.raises(FlightError, match="asks for 400 frames a second, and the flight has 250: set SIM_RATE_HZ"):
            ours.exchange(frame(2399))
    with pytest.raises(InputError, match=r"step_s = 0\.1: its clock is moved by steps below 0\.1 s"):
        ArduPilot(None, tmp_path, HEXJET, 0.1, PLACE, Setup())


def test_a_second_sender_is_left_alone_and_counted(tmp_path: Path) -> None:
    with ardupilot(tmp_path) as (ours, theirs):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for k in range(20):
                stranger.sendto(theirs._packet(k), ("127.0.0.1", theirs.port))
                stranger.sendto(b"hello", ("127.0.0.1", theirs.port))
                ours.exchange(frame(k))
        assert ours.counts.answers == 20
        assert ours.counts.foreign >= 30


def test_a_wrong_protocol_on_the_port_is_named(tmp_path: Path) -> None:
    instance = free_instance(range(100, 4000), 9002, 10, socket.SOCK_DGRAM)
    ours = ArduPilot(None, tmp_path, HEXJET, STEP, PLACE, Setup(instance))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        talking = threading.Timer(0.05, stranger.sendto, (b"\xfd\x09 MAVLink", ("127.0.0.1", 9002 + 10 * instance)))
        talking.start()
        with pytest.raises(FlightError, match=r"is no servo packet: it said b'.xfd"):
            ours.start()
        talking.join()
    ours.close()


@pytest.mark.parametrize("steps", [1000, pytest.param(100_000, marks=pytest.mark.long)])
def test_px4_loses_and_doubles_nothing(steps: int, tmp_path: Path) -> None:
    """Its first frames are its boot; then every frame has its answer, whatever comes twice or late."""
    twice, late = range(50, steps, 97), range(60, steps, 89)
    with px4_pair(tmp_path, boot=10, twice=twice, late=late) as (ours, theirs):
        for k in range(steps):
            answer = ours.exchange(frame(k))
        counts = ours.counts
    assert answer.armed
    assert answer.throttle == (0.5,) * 6
    assert (counts.boot, counts.answers) == (10, steps - 10)
    assert counts.repeated >= len(twice) + len(late) - 2
    assert theirs.times == [4000 * k + 1 for k in range(steps)]


def test_px4_is_told_what_was_measured(tmp_path: Path) -> None:
    """As pymavlink reads it: units, rates of each sensor, sticks, fixes, engine speeds."""
    with px4_pair(tmp_path, boot=0, controls=lambda told: [0.1, 0.2, 0.3, 0.4, 0.5, 1.5, 0.5, -2.0, *[0.0] * 8]) as (
        ours,
        theirs,
    ):
        for k in range(100):
            answer = ours.exchange(frame(k, spool=(100.0,) * 6))
            if k == 0:
                sensor = theirs.told["HIL_SENSOR"]
        seen, told = theirs.seen, theirs.told
    assert HEXJET.servo is not None
    assert answer.throttle == pytest.approx((0.1, 0.2, 0.3, 0.4, 0.5, 1.0))
    assert answer.tilt == pytest.approx((0.5 * HEXJET.servo.range_rad, -HEXJET.servo.range_rad))
    assert {kind: seen[kind] for kind in ("HIL_SENSOR", "RC_CHANNELS", "HIL_GPS", "RAW_RPM")} == {
        "HIL_SENSOR": 100, "RC_CHANNELS": 20, "HIL_GPS": 4, "RAW_RPM": 120,
    }  # fmt: skip
    given = frame(0)
    assert (sensor.xgyro, sensor.ygyro, sensor.zgyro) == pytest.approx(given.rate)
    assert (sensor.xacc, sensor.yacc, sensor.zacc) == pytest.approx(given.force)
    assert (sensor.xmag, sensor.ymag, sensor.zmag) == pytest.approx(to_body_field(ours.field, given.attitude), rel=1e-6)
    assert sensor.fields_updated == 7 | 56 | 448 | 6656
    assert sensor.abs_pressure == pytest.approx(1013.25 * (1.0 - 0.0065 * 35.0 / 288.15) ** 5.2559, rel=1e-4)
    sticks, fix = told["RC_CHANNELS"], told["HIL_GPS"]
    assert (sticks.chan1_raw, sticks.chan2_raw, sticks.chan3_raw, sticks.chan5_raw) == (1750, 1375, 1400, 2000)
    yaw = (sticks.chan4_raw - 1500) / 500  # which it bends
    assert 0.4 * yaw + 0.6 * yaw**3 == pytest.approx(0.1, abs=0.0005)
    assert (fix.lat, fix.lon, fix.alt) == (pytest.approx(223500090, abs=5), pytest.approx(1135900194, abs=5), 35000)
    assert (fix.vn, fix.ve, fix.vd, fix.satellites_visible, fix.fix_type) == (10, 20, -30, 14, 3)
    assert fix.cog == round(100 * degrees(np.arctan2(0.2, 0.1)))
    assert told["RAW_RPM"].frequency == pytest.approx(100.0 * 60.0 / (2.0 * pi))


def test_px4_hears_nothing_of_a_sensor_that_is_out(tmp_path: Path) -> None:
    """No fix and no pressure, where a frozen one would be a receiver with fourteen satellites; then they are back."""
    with px4_pair(tmp_path, boot=0) as (ours, theirs):
        for k in range(300):
            silent = ("gnss", "barometer") if 100 <= k < 200 else ()
            ours.exchange(frame(k, silent=silent))
            if k == 150:
                assert theirs.told["HIL_SENSOR"].fields_updated == 7 | 56 | 448
            if k in (99, 199):
                assert theirs.seen["HIL_GPS"] == 4
        assert theirs.seen["HIL_GPS"] == 8
        assert theirs.told["HIL_GPS"].fix_type == 3
        assert theirs.seen["HIL_SENSOR"] == 300


def px4_of(program: Path, folder: Path) -> Px4:
    instance = free_instance(range(1000, 40000), 4560, 1, socket.SOCK_STREAM)
    return Px4(program, folder, HEXJET, STEP, PLACE, Setup(instance))


def ardupilot_of(program: Path, folder: Path) -> ArduPilot:
    instance = free_instance(range(1000, 4000), 9002, 10, socket.SOCK_DGRAM)
    return ArduPilot(program, folder, HEXJET, STEP, PLACE, Setup(instance))


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ({"hang": 20}, r"px4 did not answer within 0\.3 s"),
        ({"gone": 20}, "px4 closed its connection"),
        ({"ahead": 20}, r"px4 answered for 1\.080 s, asked for 0\.080 s"),
    ],
)
def test_what_px4_does_wrong_is_named(faults: dict[str, Any], said: str, tmp_path: Path) -> None:
    with px4_pair(tmp_path, boot=2, **faults) as (ours, _), pytest.raises(FlightError, match=said):
        fifty(ours, silent="hang" in faults)


def test_one_that_never_connects_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4, "_MAX_START_S", 0.1)
    instance = free_instance(range(1000, 40000), 4560, 1, socket.SOCK_STREAM)
    ours = Px4(None, tmp_path, HEXJET, STEP, PLACE, Setup(instance))
    with pytest.raises(FlightError, match=rf"px4 did not connect to port {4560 + instance} within 0\.1 s"):
        ours.start()
    ours.close()


@pytest.mark.parametrize(("make", "title"), [(px4_of, "PX4's SITL"), (ardupilot_of, "ArduCopter's SITL")])
def test_a_program_that_is_another_is_asked_about(make: Callable[..., Any], title: str, tmp_path: Path) -> None:
    """With what it printed last; and its run has a line more where it ends by itself."""
    other = tmp_path / "other"
    other.write_text("#!/bin/sh\necho usage: other\nexit 3\n")
    other.chmod(0o755)
    ours = make(other, tmp_path / "run")
    with pytest.raises(FlightError) as refusal:
        ours.start()
    ours.close()
    said = rf"\w+ ended with status 3; is {other} {title}\?; the last that it printed: usage: other \({tmp_path}/run/\w+\.log\)"
    assert re.fullmatch(said, str(refusal.value)), refusal.value


def test_a_port_of_the_sticks_that_is_taken_is_named(tmp_path: Path) -> None:
    """ArduPilot says nothing of it, and is not armed."""
    ours = ardupilot_of(Path("/bin/true"), tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as held:
        held.bind(("127.0.0.1", ours.sticks_port))
        with pytest.raises(InputError, match=rf"ardupilot: port {ours.sticks_port} is in use; .*\(instance\)"):
            ours.start()
    ours.close()


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_a_command_names_a_port_that_is_in_use(name: str, hexjet: Hexjet, tmp_path: Path) -> None:
    """All of a command but the flight; no run is left."""
    kind, port = (socket.SOCK_STREAM, 4560) if name == "px4" else (socket.SOCK_DGRAM, 9002)
    apart = 1 if name == "px4" else 10
    instance = free_instance(range(100, 250), port, apart, kind)
    with socket.socket(socket.AF_INET, kind) as held:
        held.bind(("127.0.0.1", port + apart * instance))
        out = tmp_path / "run"
        done = hexjet("sitl", name, "--aircraft", "quadrotor", "--instance", str(instance), "--out", str(out))
    assert done.status == 2
    *told, waiting, said = done.err.splitlines()
    assert all("on every network interface" in line for line in told)
    assert len(told) == (name == "ardupilot")
    assert "waiting for one at" in waiting
    assert said.startswith(f"hexjet: {name}: port {port + apart * instance} is in use")
    assert not (out / "scenario.toml").exists()


@pytest.mark.parametrize("kind", hil.FORMATS.values(), ids=lambda kind: mav.mavlink_map[kind.number].msgname)
def test_messages_are_those_of_pymavlink(kind: hil.MessageFormat) -> None:
    """Length, order and checksum byte as its generator makes them; and read back by ours."""
    theirs = KINDS[kind.number]
    assert kind.extra == theirs.crc_extra
    assert kind.payload.size == theirs.unpacker.size
    payload = bytes(range(kind.payload.size))
    values = kind.payload.unpack(payload)
    assert values == theirs.unpacker.unpack(payload)
    raw = hil.FrameWriter().pack_frame(kind, *values)
    (message,) = mav.MAVLink(None).parse_buffer(raw)
    assert message.get_msgId() == kind.number
    ((again, read),) = hil.FrameReader().feed(b"\x00noise" + raw)
    assert again is kind
    assert read == pytest.approx(values, nan_ok=True)


def test_a_stream_may_come_in_pieces_and_with_wrong_bytes() -> None:
    raw = hil.FrameWriter().pack_frame(hil.HIL_ACTUATOR_CONTROLS, 4001, 1, *[0.25] * 16, 129)
    broken = raw[:-1] + bytes((raw[-1] ^ 1,))
    reader, found = hil.FrameReader(), []
    for byte in raw + broken + raw:
        found += reader.feed(bytes((byte,)))
    assert [values[0] for _, values in found] == [4001, 4001]


# IGRF-14 as another program has it, all thirteen degrees on the ellipsoid at the beginning of 2025: north, east, down, nT
FIELDS = {
    (22.35, 113.59): (37757.5, -2094.3, 25451.5),
    (47.4, 8.5): (21534.5, 1281.9, 43234.2),
    (-35.36, 149.16): (23034.2, 5162.8, -53096.4),
    (60.0, -100.0): (9615.5, 754.9, 57378.5),
    (0.0, 0.0): (27456.6, -1926.5, -15997.4),
    (80.0, 20.0): (6146.3, 1801.8, 55228.3),
}


@pytest.mark.parametrize(("place", "nano_tesla"), FIELDS.items())
def test_the_field_is_the_earths(place: tuple[float, float], nano_tesla: tuple[float, float, float]) -> None:
    """Within a nanotesla."""
    assert compute_earth_field(*place) == pytest.approx([1e-5 * value for value in nano_tesla], abs=1e-5)


def test_its_first_terms_are_those_of_a_dipole() -> None:
    """At its pole straight down, at its own equator flat; the strengths as 2 to 1, but for the ellipsoid's few per mil."""
    g10, g11, h11 = 29350.0, 1410.3, -4545.5
    strength = 1e-5 * (g10**2 + g11**2 + h11**2) ** 0.5
    latitude = degrees(np.arcsin(1e-5 * g10 / strength))
    longitude = degrees(np.arctan2(h11, g11))
    assert compute_earth_field(latitude, longitude, 1) == pytest.approx((0.0, 0.0, 2.0 * strength), abs=0.02 * strength)
    north, east, down = compute_earth_field(latitude - 90.0, longitude, 1)
    assert (north, east, down) == pytest.approx((strength, 0.0, 0.0), abs=0.02 * strength)
