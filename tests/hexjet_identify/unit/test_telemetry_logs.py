"""Telemetry logs, .tlog: read as pymavlink reads them, whoever wrote them; damaged, cut and joined ones too."""

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as theirs

from cosim.base.errors import InputError
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, prepare_message
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from hexjet_identify.logs import FlightLog, is_flight_log, read_flight_log, signals_of, tlog
from hexjet_identify.logs.log_columns import as_columns

pytestmark = pytest.mark.usefixtures("logs_read_here")

BEGIN = 1_700_000_000.0  # s since 1970
ROWS = 100
TIMES = 0.02 * np.arange(ROWS)
WAVE = np.sin(3.0 * TIMES)


class Station:
    """What a ground station logs, written by pymavlink: each frame behind its time."""

    def __init__(self, system: int = 1, component: int = 1, version: int = 2) -> None:
        self.mav = theirs.MAVLink(None, system, component)
        self.version = version
        self.data = b""

    def log(self, at: float, message: object) -> None:
        self.data += struct.pack(">Q", round(1e6 * (BEGIN + at)))
        self.data += message.pack(self.mav, force_mavlink1=self.version == 1)  # type: ignore[attr-defined]


def flown(late: float = 0.0, version: int = 2, system: int = 1) -> bytes:
    """Attitude, servos, an ESC and a text; frames come late by turns."""
    station = Station(system, version=version)
    for n, (t, value) in enumerate(zip(TIMES.tolist(), WAVE.tolist(), strict=True)):
        taken, ms = t + late * (n % 3), round(1000 * t) + 5000
        station.log(
            taken, theirs.MAVLink_attitude_message(ms, value, 2 * value, 3 * value, 4 * value, 5 * value, 6 * value)
        )
        servos = [1000 + n, *[1500] * 7]
        station.log(taken, theirs.MAVLink_servo_output_raw_message(1000 * ms, 0, *servos, *[0] * 8))
        if version == 2:  # its number has no room in a frame of version 1
            rpm = [100 + n, 200 + n, 300, 400]
            four = ([20] * 4, [1] * 4, [2] * 4, [3] * 4, rpm, [n] * 4)
            station.log(taken, theirs.MAVLink_esc_telemetry_1_to_4_message(*four))
    station.log(TIMES[-1] + 0.1, theirs.MAVLink_statustext_message(6, b"landed"))
    return station.data


def read(tmp_path: Path, content: bytes, name: str = "flight.tlog") -> FlightLog:
    (tmp_path / name).write_bytes(content)
    return read_flight_log(tmp_path / name)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("late", [0.0, 0.3])
def test_messages_are_channels_on_the_vehicles_clock(tmp_path: Path, version: int, late: float) -> None:
    """What a message was measured at, and not when the link brought it, where it says so."""
    log = read(tmp_path, flown(late, version))
    assert is_flight_log(tmp_path / "flight.tlog")
    assert log.kind == "MAVLink telemetry log"
    assert log.remarks == ("times count from its first frame, 2023-11-14 22:13:20 UTC",)
    np.testing.assert_allclose(log.channels["ATTITUDE.pitch"].values, 2.0 * WAVE, atol=1e-6)
    np.testing.assert_allclose(log.channels["ATTITUDE.pitch"].times, TIMES, atol=2e-6)
    np.testing.assert_allclose(log.channels["SERVO_OUTPUT_RAW.servo1_raw"].times, TIMES, atol=2e-6)
    assert log.channels["ATTITUDE.rollspeed"].unit == "rad/s"
    if version == 1:
        return
    np.testing.assert_array_equal(log.channels["ESC_TELEMETRY_1_TO_4.rpm[1]"].values, 200 + np.arange(ROWS))
    taken = np.sort(log.channels["ESC_TELEMETRY_1_TO_4.rpm[1]"].times - TIMES)
    np.testing.assert_allclose(taken, np.sort(late * (np.arange(ROWS) % 3)), atol=2e-6)
    assert signals_of(log, "engine:2").output == "ESC_TELEMETRY_1_TO_4.rpm[1]"


def test_senders_and_instances_are_told_apart_where_there_are_several(tmp_path: Path) -> None:
    station = Station(255, 190)
    station.log(0.0, theirs.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    vehicle = Station()
    vehicle.log(0.1, theirs.MAVLink_heartbeat_message(2, 3, 0, 7, 0, 3))
    for n in range(20):
        vehicle.log(0.2 + n, theirs.MAVLink_rpm_message(n, -n))
        vehicle.log(0.2 + n, theirs.MAVLink_distance_sensor_message(n, 1, 100, n, 0, n % 2, 0, 0))
    log = read(tmp_path, station.data + vehicle.data)
    assert log.channels["HEARTBEAT[1/1].custom_mode"].values.tolist() == [7.0]
    assert log.channels["HEARTBEAT[255/190].type"].values.tolist() == [6.0]
    assert log.channels["RPM.rpm1"].values.tolist() == list(range(20))
    assert log.channels["DISTANCE_SENSOR[1].current_distance"].values.tolist() == list(range(1, 20, 2))


def test_a_log_of_our_own_ground_station_is_read(tmp_path: Path) -> None:
    """Messages that pymavlink does not have among them."""
    clock = iter(BEGIN + 0.02 * np.arange(1000))
    log = TelemetryLog(tmp_path / "own.tlog", clock=lambda: next(clock))
    for n in range(50):
        log.write_sent(prepare_message(BY_NAME["ATTITUDE"](20 * n, 0.1 * n, 0.0, 0.0, 0.5, 0.0, 0.0)))
        log.write_sent(
            prepare_message(BY_NAME["ESC_STATUS"](0, 20_000 * n, [n, 2 * n, 3 * n, 4 * n], [0.0] * 4, [0.0] * 4))
        )
    log.close()
    found = read_flight_log(tmp_path / "own.tlog")
    assert found.channels["ESC_STATUS.rpm[1]"].values.tolist() == [2.0 * n for n in range(50)]
    columns, _ = as_columns(found)
    np.testing.assert_allclose(columns["roll_rad"], np.angle(np.exp(0.1j * np.arange(50))), atol=1e-6)
    np.testing.assert_allclose(columns["rate_p_measured_rad_s"], 0.5, atol=1e-6)


def test_damage_costs_its_frames_and_a_cut_is_said(tmp_path: Path) -> None:
    whole = flown()
    damaged = bytearray(whole)
    damaged[2000:2200] = b"\xfd" * 200
    log = read(tmp_path, bytes(damaged))
    assert any("bytes are damaged and were passed over" in remark for remark in log.remarks)
    assert ROWS - 3 <= len(log.channels["ATTITUDE.roll"].values) < ROWS
    log = read(tmp_path, whole[: len(whole) * 7 // 10])
    assert any("the log was cut short: it ends" in remark for remark in log.remarks)
    assert len(log.channels["ATTITUDE.roll"].values) == pytest.approx(0.7 * ROWS, abs=2)


def test_a_vehicle_that_starts_again_keeps_the_times_at_which_its_frames_were_taken(tmp_path: Path) -> None:
    station = Station()
    for n in range(40):
        station.log(n, theirs.MAVLink_attitude_message(1000 * (n % 20), n, 0, 0, 0, 0, 0))
    np.testing.assert_allclose(read(tmp_path, station.data).channels["ATTITUDE.roll"].times, np.arange(40.0), atol=1e-6)


def test_frames_of_no_message_that_is_known_are_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = struct.pack(">Q", round(1e6 * BEGIN)) + bytes([0xFD, 2, 0, 0, 0, 1, 1, 0xEE, 0xEE, 0xEE, 1, 2, 3, 4])
    with pytest.raises(InputError, match="holds no frame of a message that is known"):
        read(tmp_path, 5 * frame)
    log = read(tmp_path, 5 * frame + flown())
    assert "messages of unknown numbers were left out: 15658734" in log.remarks
    monkeypatch.setattr(tlog, "DIALECTS", tlog.DIALECTS[:1])  # without that of ArduPilot's messages
    tlog._load_kinds.cache_clear()
    try:
        (tmp_path / "own.tlog").write_bytes(flown())
        log = tlog.read(tmp_path / "own.tlog")
        assert len(log.channels["ATTITUDE.roll"].values) == ROWS
        assert "messages of unknown numbers were left out: 11030" in log.remarks
    finally:
        tlog._load_kinds.cache_clear()
