"""Logs of others: each kind is read as what was written, by an independent reader or writer, and refused where it is none."""

import math
import struct
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from dataflash_writer import HEAD, describe, pack
from flights import STEP, exported, record

from cosim.base.errors import InputError
from cosim.results.export import export_log
from cosim.results.run import open_run
from hexjet_identify.logs import FlightLog, is_flight_log, read_flight_log, signals_of
from hexjet_identify.logs.flight_log import Channel, parse_sum
from hexjet_identify.logs.log_columns import ESTIMATES_NOTE, as_columns
from hexjet_identify.prediction_error.identify_log import _clock_dict
from hexjet_identify.prediction_error.stretches import Clock

pytestmark = pytest.mark.usefixtures("logs_read_here")

TIMES = np.arange(50) * 0.01
WAVE = np.sin(TIMES)
DATA = Path(__file__).parents[4] / "shared" / "data" / "flight-logs"


def dataflash(rate: float = 100.0, rows: int = 50) -> bytes:
    """An ArduPilot log with RATE and two instances of ESC."""
    made = HEAD + describe(1, "RATE", "Qffc", "TimeUS,ROut,R,RDes") + describe(2, "ESC", "QBf", "TimeUS,Instance,RPM")
    made += describe(3, "MSG", "QZ", "TimeUS,Message") + pack(3, "QZ", 5, b"ArduCopter V4.6")
    for n in range(rows):
        us = round(1e6 * n / rate)
        made += pack(1, "Qffc", us, WAVE[n % 50], 2.0 * WAVE[n % 50], 100 * n) + pack(2, "QBf", us, n % 2, 100.0 + n)
    return made


def crazyflie(version: int = 2, rows: int = 50) -> bytes:
    """Two kinds of event, one of them rare."""
    head = struct.pack("<BHH", 0xBC, version, 2)
    head += struct.pack("<H", 7) + b"rate\0" + struct.pack("<H", 2) + b"gyro.x(f)\0motor.m1(I)\0"
    head += struct.pack("<H", 9) + b"slow\0" + struct.pack("<H", 1) + b"pm.vbat(f)\0"
    body = b""
    for n in range(rows):
        stamp = struct.pack("<I", 10 * n) if version == 1 else struct.pack("<Q", 10_000 * n)
        body += struct.pack("<H", 7) + stamp + struct.pack("<fI", WAVE[n], 1000 + n)
        if n % 20 == 0:
            body += struct.pack("<H", 9) + stamp + struct.pack("<f", 3.7)
    return head + body + struct.pack("<I", crc32(head + body))


def table(path: Path, **columns: np.ndarray) -> Path:
    lines = [
        ",".join(columns),
        *(",".join(f"{v!r}" for v in row) for row in zip(*(c.tolist() for c in columns.values()), strict=True)),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def doublet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A made-up flight's folder."""
    folder = record(200, tmp_path_factory.mktemp("runs") / "run").folder
    assert folder is not None
    return folder


def test_dataflash_is_read_as_the_autopilots_own_reader_does(tmp_path: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash())
    log = read_flight_log(path)
    reader = DFReader_binary(str(path))
    theirs: dict[str, list[float]] = {}
    while (message := reader.recv_match()) is not None:
        kind = message.get_type()
        for field in message.get_fieldnames():
            suffix = f"[{message.Instance}]" if kind == "ESC" else ""
            theirs.setdefault(f"{kind}{suffix}.{field}", []).append(getattr(message, field))
    for name in ("RATE.ROut", "RATE.R", "RATE.RDes", "ESC[0].RPM", "ESC[1].RPM"):
        np.testing.assert_array_equal(log.channels[name].values, theirs[name])
        stamps = theirs[name.split(".")[0] + ".TimeUS"]
        np.testing.assert_allclose(log.channels[name].times, 1e-6 * np.array(stamps), atol=1e-9)
    reader.filehandle.close()
    assert signals_of(log, "roll").command == "RATE.ROut"
    np.testing.assert_allclose(log.signal(signals_of(log, "roll").output).values, np.radians(2.0 * WAVE), rtol=1e-6)


@pytest.mark.parametrize("version", [1, 2])
def test_a_crazyflies_events_are_told_apart(tmp_path: Path, version: int) -> None:
    path = tmp_path / "log00"
    path.write_bytes(crazyflie(version))
    log = read_flight_log(path)
    assert log.kind == "Crazyflie"
    assert not log.remarks
    np.testing.assert_allclose(log.channels["rate/gyro.x"].values, WAVE, atol=1e-7)
    np.testing.assert_allclose(log.channels["rate/motor.m1"].times, TIMES, atol=1e-9)
    assert len(log.channels["slow/pm.vbat"].values) == 3


def test_a_ulog_of_ours_is_read_as_the_run(doublet: Path, tmp_path: Path) -> None:
    exported(doublet, tmp_path / "flight.ulg")
    run, ulog = read_flight_log(doublet), read_flight_log(tmp_path / "flight.ulg")
    for axis in ("roll", "pitch", "yaw"):
        ours, theirs = signals_of(run, axis), signals_of(ulog, axis)
        for name in ("command", "output", "setpoint"):
            one, other = run.signal(getattr(ours, name)), ulog.signal(getattr(theirs, name))
            np.testing.assert_allclose(other.times, one.times, atol=1e-6)
            np.testing.assert_allclose(other.values, one.values, rtol=1e-6, atol=1e-8)
    assert signals_of(ulog, "engine:2").output == "hexjet_thrust.newton[1]"
    for log in (run, ulog):  # the engine has it at the end of the step
        engine = signals_of(log, "engine:2")
        shift = log.signal(engine.output).times - log.signal(engine.command).times
        np.testing.assert_allclose(shift, STEP, atol=2e-6)


def test_a_table_says_its_time(tmp_path: Path) -> None:
    path = table(tmp_path / "flight.csv", stamp=1e6 * TIMES, u=WAVE, y=2.0 * WAVE)
    log = read_flight_log(path, "stamp", "us")
    np.testing.assert_allclose(log.signal("y - 0.5*u").times, TIMES, atol=1e-9)
    np.testing.assert_allclose(log.signal("y - 0.5*u").values, 1.5 * WAVE, atol=1e-12)
    with pytest.raises(InputError, match="no column of time"):
        read_flight_log(path)
    with pytest.raises(InputError, match="no column 'stmp' of numbers; did you mean 'stamp'"):
        read_flight_log(path, "stmp")
    with pytest.raises(InputError, match="no channel 'z'; allowed"):
        log.signal("y + z")


def test_a_csv_of_ours_has_our_stamps_and_any_other_its_own(doublet: Path, tmp_path: Path) -> None:
    """A thrust stands in the row of the step at whose end it is there; which stamps a bench's table has is its own."""
    export_log("csv", doublet, tmp_path / "flight.csv")
    ours, run = read_flight_log(tmp_path / "flight.csv"), read_flight_log(doublet)
    np.testing.assert_allclose(ours.channels["thrust_2_N"].times, run.channels["thrust_2_N"].times, atol=1e-12)
    assert ours.channels["throttle_2"].times[0] == run.channels["throttle_2"].times[0]
    assert any("taken for the end of its step, 4 ms after time_s" in remark for remark in ours.remarks)
    told = read_flight_log(tmp_path / "flight.csv", "time_s")
    assert not told.remarks
    np.testing.assert_array_equal(told.channels["thrust_2_N"].times, told.channels["throttle_2"].times)
    bench = read_flight_log(table(tmp_path / "bench.csv", t=TIMES, throttle_1=WAVE, thrust_1_N=WAVE))
    np.testing.assert_array_equal(bench.channels["thrust_1_N"].times, TIMES)


def test_a_ulog_of_ours_has_the_columns_of_its_run(doublet: Path, tmp_path: Path) -> None:
    """Every column that it has, in every step, but for what floats lose."""
    exported(doublet, tmp_path / "flight.ulg")
    assert is_flight_log(tmp_path / "flight.ulg")
    assert not is_flight_log(doublet)
    log, remarks = as_columns(read_flight_log(tmp_path / "flight.ulg"))
    rows = open_run(doublet).log
    assert len(log) == len(rows)
    assert {"roll_rad", "pitch_measured_rad", "rate_q_measured_rad_s", "rate_r_setpoint_rad_s", "north_m", "thrust_6_N",
            "throttle_1", "altitude_m"} <= set(log.columns)  # fmt: skip
    for name in log.columns:
        np.testing.assert_allclose(log[name], rows[name], rtol=1e-6, atol=2e-6, err_msg=name)
    assert remarks[0] == f"ULog: {len(log.columns) - 1} columns of a flight of ours are in it"


def test_other_logs_become_columns_as_far_as_they_go(tmp_path: Path) -> None:
    """Degrees are radians, slower channels hold their values, and times count from the first row."""
    (tmp_path / "flight.bin").write_bytes(dataflash())
    log, remarks = as_columns(read_flight_log(tmp_path / "flight.bin"))
    assert log.columns == ("time_s", "rate_p_measured_rad_s", "rate_p_setpoint_rad_s")
    np.testing.assert_allclose(log["rate_p_measured_rad_s"], np.radians(2.0 * WAVE), rtol=1e-6)
    assert not any("first row" in remark for remark in remarks)
    turned = {f"gyro.{axis}": Channel(TIMES, WAVE) for axis in "xyz"} | {
        f"motor.m{n}": Channel(TIMES, WAVE) for n in range(1, 5)
    }
    log, _ = as_columns(FlightLog(tmp_path / "x", "Crazyflie", turned))  # forward, left and up
    for rate, sign in (("p", 1.0), ("q", -1.0), ("r", -1.0)):
        np.testing.assert_allclose(log[f"rate_{rate}_measured_rad_s"], sign * np.radians(WAVE), rtol=1e-12)
    slow, fast = np.array([2.0, 3.0]), 2.0 + 0.25 * np.arange(8)
    channels = {
        "RATE.ROut": Channel(fast, fast),
        "RATE.R": Channel(fast, fast),
        "ATT.Yaw": Channel(slow + 0.25, slow + 357.0),
    }
    log, remarks = as_columns(FlightLog(tmp_path / "x", "made up", channels))
    np.testing.assert_allclose(log["time_s"], fast - 2.0)
    np.testing.assert_allclose(np.degrees(log["yaw_rad"]), [np.nan, *[-1.0] * 4, *[0.0] * 3], atol=1e-9)
    assert {"times count from its first row, 2.000 s of its clock", ESTIMATES_NOTE} <= set(remarks)
    with pytest.raises(InputError, match="no rates, attitude, position or throttles that are known"):
        as_columns(FlightLog(tmp_path / "x", "made up", {"a": Channel(fast, fast)}))


def test_what_a_log_lacks_is_named_beside_what_it_has() -> None:
    """Older PX4s log what is asked of an axis as ``actuator_controls_0``; of a log without it, its own kind is named."""
    gyro, asked = Channel(TIMES, WAVE), Channel(TIMES, WAVE)
    log = FlightLog(Path("flight.ulg"), "ULog", {"sensor_combined.gyro_rad[1]": gyro})
    with pytest.raises(InputError) as error:
        signals_of(log, "pitch")
    assert "actuator_controls_0.control[1] with sensor_combined.gyro_rad[1]" in str(error.value)
    assert "motor.m1" not in str(error.value)
    log = FlightLog(Path("flight.ulg"), "ULog", {**log.channels, "actuator_controls_0.control[1]": asked})
    assert signals_of(log, "pitch")[:2] == ("actuator_controls_0.control[1]", "sensor_combined.gyro_rad[1]")


def test_a_sum_is_read_as_written() -> None:
    assert parse_sum("- a.b[0] + 0.5*deg(c) - 2 * d") == [(-1.0, "a.b[0]"), (0.5, "deg(c)"), (-2.0, "d")]
    for text in ("", "a b", "a + + b", "3*", "a -"):
        with pytest.raises(InputError):
            parse_sum(text)


def test_degrees_and_squares_are_taken_before_they_are_added() -> None:
    log = FlightLog(Path("x"), "table", {"a": Channel(TIMES, WAVE, "m"), "b": Channel(TIMES, 2.0 * WAVE, "m")})
    squared = log.signal("square(a) - 0.5*square(b)")
    assert np.allclose(squared.values, -(WAVE**2), rtol=1e-15)
    assert squared.unit == "(m)^2"
    assert np.allclose(log.signal("deg(a)").values, np.radians(WAVE), rtol=1e-15)
    assert log.has("square(a) + deg(b)")
    assert not log.has("cube(a)")
    with pytest.raises(InputError, match="no channel 'cube"):
        log.signal("cube(a)")


def test_channels_of_two_clocks_are_not_added() -> None:
    log = FlightLog(Path("x"), "table", {"a": Channel(TIMES, WAVE), "b": Channel(TIMES + 1e-3, WAVE)})
    with pytest.raises(InputError, match="do not have the same times"):
        log.signal("a + b")


@pytest.mark.parametrize("name", ["flight.bin", "log00"])
def test_what_is_cut_short_is_read_as_far_as_it_goes(tmp_path: Path, name: str) -> None:
    content = dataflash() if name == "flight.bin" else crazyflie()
    path = tmp_path / name
    path.write_bytes(content[: len(content) * 2 // 3])
    log = read_flight_log(path)
    assert 20 <= max(len(channel.values) for channel in log.channels.values()) < 50
    assert any("cut short" in remark or "passed over" in remark for remark in log.remarks)


@pytest.mark.parametrize("cut", [0, 3, 17, 30, 95, 300])
@pytest.mark.parametrize("kind", ["bin", "cf", "ulg", "csv"])
def test_hardly_anything_is_no_log(tmp_path: Path, kind: str, cut: int) -> None:
    content = {
        "bin": dataflash(rows=0), "cf": crazyflie(rows=0), "ulg": b"ULog\x01\x12\x35\x01" + bytes(400), "csv": b"\xff\xfe" * 200,
    }[kind][:cut]  # fmt: skip
    path = tmp_path / f"flight.{kind}"
    path.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        read_flight_log(path)
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)


def test_a_topic_without_a_time_is_left_out_with_a_note(doublet: Path, tmp_path: Path) -> None:
    exported(doublet, tmp_path / "flight.ulg")
    whole = (tmp_path / "flight.ulg").read_bytes()
    (tmp_path / "flight.ulg").write_bytes(
        whole.replace(b"vehicle_rates_setpoint:uint64_t timestamp;", b"vehicle_rates_setpoint:uint64_t timestmap;")
    )
    log = read_flight_log(tmp_path / "flight.ulg")
    assert "vehicle_rates_setpoint" in log.remarks[0]
    assert not any(name.startswith("vehicle_rates_setpoint.") for name in log.channels)
    assert log.has("vehicle_angular_velocity.xyz[0]")


def test_damage_is_passed_over_and_counted(tmp_path: Path) -> None:
    content = bytearray(dataflash())
    content[1000:1040] = b"\x11" * 40
    path = tmp_path / "flight.bin"
    path.write_bytes(content)
    log = read_flight_log(path)
    assert any("bytes are damaged" in remark for remark in log.remarks)
    assert len(log.channels["RATE.R"].values) in (48, 49)


def test_the_shared_flights_are_read() -> None:
    if not DATA.is_dir():
        pytest.skip("the shared flight logs are not here")
    log = read_flight_log(DATA / "crazyflie-log10.cfusdlog")
    assert not log.remarks
    assert {len(channel.values) for channel in log.channels.values()} == {50496}
    assert abs(float(np.median(log.channels["acc.z"].values[:1000])) - 1.0) < 0.02  # at rest: 1 g, up


def test_a_clock_keeps_the_keys_that_its_readers_know() -> None:
    assert _clock_dict(Clock(0.004, math.nan, 0.25)) == {"step": 0.004, "jitter": None, "lost": 0.25}
