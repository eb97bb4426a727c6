"""A recorded flight flown again: what flew explains it, and what is wrong with another is named."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from command_tools import Hexjet
from dataflash_writer import HEAD, describe, pack
from identification_record import SHARED

from cosim import Scenario, fly
from cosim.base.errors import InputError
from cosim.results.export import export_log
from cosim.results.run import open_run
from hexjet_identify.logs import Channel, FlightLog, read_flight_log
from hexjet_identify.replay import Choices, RecordedFlight, Replay, ThrottleChannels, record_flight
from hexjet_identify.replay import replay as fly_again
from hexjet_identify.replay.flown import Change, Model
from hexjet_identify.replay.measures import MIN_TIME_WITHIN, theil
from hexjet_identify.replay.recorded import is_simulated
from hexjet_identify.replay.replay import EXPLAINED, NOT_EXPLAINED, NOT_TOLD

FEW = Choices(draws=2)
DOUBLET = Scenario.load("roll-doublet").replace(duration_s=6.0, expect=[])
VEHICLE, _ = DOUBLET.resolved_vehicle()
HEAVY = {"vehicle": {"inertia_kg_m2": [1.3 * value for value in VEHICLE.inertia_kg_m2]}}
LATE = {"engine_parameters": {"delay_samples": 30}}  # 5 control steps of 4 ms more
FORMATS = {"csv": "csv", "parquet": "parquet", "ulg": "ulog", "mcap": "mcap", "mat": "mat"}  # by ending
WHOLE = (None, None)


@pytest.fixture(scope="module")
def doublet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a roll doublet."""
    folder = tmp_path_factory.mktemp("runs") / "doublet"
    fly(DOUBLET, folder)
    return folder


def recorded(path: Path, mapping: ThrottleChannels | None = None) -> RecordedFlight:
    return record_flight(read_flight_log(path), VEHICLE, DOUBLET.step_s, mapping or ThrottleChannels(), WHOLE)


def replayed(flight: RecordedFlight, scenario: Scenario = DOUBLET, choices: Choices = FEW) -> Replay:
    return fly_again("flight", scenario, flight, choices)


def check_explained(result: Replay) -> None:
    """Explained to the noise of the sensors, with nothing at fault."""
    assert result.verdict == EXPLAINED
    assert not result.fault
    roll = next(channel for channel in result.channels if channel.name == "rate_p")
    assert roll.excited
    assert roll.theil.u < 0.02
    assert roll.rms < 1.2 * roll.noise
    assert roll.bands[0].coherence > 0.99
    assert roll.within > MIN_TIME_WITHIN
    assert roll.bands[0].gain_db == pytest.approx(0.0, abs=0.1)


def test_the_vehicle_that_flew_explains_its_run(doublet: Path) -> None:
    """A roll doublet tells roll alone, and not whether engines of one bank, which have one command, are swapped."""
    result = replayed(recorded(doublet))
    check_explained(result)
    parts, hidden = result.causes.reach
    assert {"moment of inertia about x", "mass", "further delay of the engines"} <= {part.name for part in parts}
    assert "moment of inertia about z" in hidden
    assert "engines 1 and 2 swapped" not in hidden
    assert any(line.startswith("these would not: ") for line in result.evidence)


@pytest.mark.parametrize("ending", FORMATS)
def test_every_export_is_the_same_flight(doublet: Path, tmp_path: Path, ending: str) -> None:
    """To the last bit, but for a ULog, whose values have 32 bits; that one is flown again."""
    path = tmp_path / f"flight.{ending}"
    export_log(FORMATS[ending], doublet, path)
    assert is_simulated(read_flight_log(path))
    run, export = recorded(doublet), recorded(path)
    if ending == "ulg":
        check_explained(replayed(export))
        return
    for name in ("times", "throttle", "tilt", "rate", "force", "angles", "velocity", "altitude", "usable"):
        np.testing.assert_array_equal(getattr(run, name), getattr(export, name), name)


def dataflash(path: Path, doublet: Path) -> Path:
    """An ArduPilot's log of a run: motors in microseconds, IMU and attitude, as its messages have them."""
    log = open_run(doublet).log
    data = HEAD + describe(1, "RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6") + describe(3, "TILT", "Qff", "TimeUS,L,R")
    data += describe(2, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    rates = [np.asarray(log[f"rate_{rate}_measured_rad_s"]) for rate in "pqr"]
    forces = [np.asarray(log[f"specific_force_{axis}_measured_m_s2"]) for axis in "xyz"]
    throttles = [np.round(1000.0 + 1000.0 * np.asarray(log[f"throttle_{jet}"])).astype(int) for jet in range(1, 7)]
    tilts = [np.asarray(log[f"tilt_{bank}_command_rad"]) for bank in ("left", "right")]
    for k, time in enumerate(np.asarray(log["time_s"]).tolist()):
        us = round(1e6 * time)
        data += pack(1, "QHHHHHH", us, *(int(values[k]) for values in throttles))
        data += pack(2, "QBffffff", us, 0, *(values[k] for values in (*rates, *forces)))
        data += pack(3, "Qff", us, *(values[k] for values in tilts))
    path.write_bytes(data)
    return path


def test_an_ardupilots_log_is_flown_by_its_microseconds(doublet: Path, tmp_path: Path) -> None:
    """A thousandth of a throttle is lost, and so is the attitude."""
    log = read_flight_log(dataflash(tmp_path / "flight.bin", doublet))
    tilts = {f"tilt_{bank}_command_rad": log.channels[f"TILT.{side}"] for bank, side in (("left", "L"), ("right", "R"))}
    log = replace(log, channels={**log.channels, **tilts})
    flight = record_flight(log, VEHICLE, DOUBLET.step_s, ThrottleChannels(), WHOLE)
    np.testing.assert_allclose(flight.throttle, recorded(doublet).throttle, atol=0.0006)
    assert any("1000 is taken for throttle 0" in note for note in flight.notes)
    assert flight.has_force
    assert not flight.has_angles
    check_explained(replayed(flight))


@pytest.mark.parametrize(
    ("flown", "name", "value", "near"),
    [
        pytest.param(HEAVY, "moment of inertia about x", 1.3, 0.01, marks=pytest.mark.long),
        pytest.param(LATE, "further delay of the engines", 0.02, 0.001, marks=pytest.mark.long),
        ({"vehicle": {"sensors": {"gyro": {"latency_samples": 5}}}}, "further delay of the gyro", 0.02, 0.001),
    ],
)
def test_a_number_that_is_wrong_is_named_with_its_value(
    tmp_path: Path, flown: dict[str, object], name: str, value: float, near: float
) -> None:
    """What flew is another vehicle than the one that flies again."""
    fly(DOUBLET.replace(**flown), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"))
    assert result.verdict == NOT_EXPLAINED
    (named,) = result.causes.named
    assert named.name == name
    assert named.value == pytest.approx(value, abs=near)
    assert named.bound is not None
    assert abs(named.value - value) < named.bound < near
    assert named.removed > 0.95
    assert result.wind.reason  # what turns it otherwise is no wind


@pytest.mark.long
def test_a_servo_that_is_slower_is_named(tmp_path: Path) -> None:
    """40 ms more lag of the tilts, seen where these pitch it; the engines are as stated."""
    pitch = Scenario.load("pitch-doublet").replace(duration_s=6.0, expect=[])
    assert VEHICLE.servo is not None
    fly(pitch.replace(vehicle={"servo": {"lag_s": VEHICLE.servo.lag_s + 0.04}}), tmp_path / "run")
    (named,) = replayed(recorded(tmp_path / "run"), pitch).causes.named
    assert named.name == "further lag of the servos"
    assert named.value == pytest.approx(0.04, abs=0.003)


def test_a_centre_of_gravity_that_is_off_is_no_engine(tmp_path: Path) -> None:
    """6 mm back and 3 mm left."""
    fly(DOUBLET.replace(mismatch={"centre_m": [-0.006, -0.003, 0.0]}), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"))
    assert result.verdict == NOT_EXPLAINED
    (named,) = result.causes.named
    assert named.name == "centre of gravity"
    for part, planted in zip(named.parts, (-0.006, -0.003), strict=True):
        assert abs(part.value - planted) < part.bound < 0.0003


def test_a_mass_that_is_wrong_is_named_though_nothing_moves(tmp_path: Path) -> None:
    """Thrust over mass is told by the level of the accelerometer; without rates thrust is told from mass by nothing."""
    hover = Scenario.load("hover").replace(duration_s=4.0, expect=[])
    fly(hover.replace(vehicle={"mass_kg": 1.15 * VEHICLE.mass_kg}), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"), hover)
    assert result.verdict == NOT_EXPLAINED
    by_name = {one.name: one for one in result.causes.named}
    assert set(by_name) == {"mass", "thrust of all engines"}
    assert by_name["mass"].value == pytest.approx(1.15, abs=0.01)
    assert "the log does not tell which" in result.fault


@pytest.mark.long
def test_swapped_engines_and_a_reversed_axis_are_named(doublet: Path) -> None:
    flight, turned = recorded(doublet), np.array([-1.0, 1.0, 1.0])
    swapped = replayed(replace(flight, throttle=flight.throttle[:, [1, 0, 2, 3, 4, 5]]))
    assert swapped.verdict == NOT_EXPLAINED
    assert [one.name for one in swapped.causes.named] == ["engines 1 and 2 swapped"]
    result = replayed(replace(flight, rate=flight.rate * turned, angles=flight.angles * turned))
    assert [one.name for one in result.causes.named] == ["roll rate and roll angle reversed"]


def test_a_gyro_that_is_off_is_told_by_the_attitude(doublet: Path) -> None:
    """Its offset is noted and taken off: the model is not at fault."""
    flight = recorded(doublet)
    result = replayed(replace(flight, rate=flight.rate + np.array([0.03, 0.0, -0.02])))
    check_explained(result)
    (note,) = [note for note in result.notes if "the gyro is off" in note]
    p, r = (float(note.split(f"{name} by ")[1].split()[0].rstrip(",")) for name in "pr")
    assert p == pytest.approx(0.03, abs=0.003)
    assert r == pytest.approx(-0.02, abs=0.003)
    assert "q by" not in note


def test_loads_are_those_of_the_flight_that_is_asked_for(doublet: Path) -> None:
    model, flight = Model(DOUBLET), recorded(doublet)
    first = model.loads(flight, Change())
    other = model.loads(replace(flight, throttle=0.5 * flight.throttle), Change())
    assert np.linalg.norm(other.forces[-1]) < 0.8 * np.linalg.norm(first.forces[-1])
    assert model.loads(flight, Change()) is first


def test_an_attitude_that_is_late_is_not_the_vehicles_fault(doublet: Path) -> None:
    flight = recorded(doublet)
    result = replayed(replace(flight, angles=np.roll(flight.angles, 8, axis=0)))
    assert next(channel.within for channel in result.channels if channel.name == "roll") < MIN_TIME_WITHIN
    assert result.verdict == EXPLAINED
    assert any(line.startswith("roll: no rate is off") for line in result.evidence)


def test_a_hover_tells_nothing_and_nothing_is_named(tmp_path: Path) -> None:
    hover = Scenario.load("hover").replace(duration_s=4.0, expect=[])
    fly(hover.replace(**HEAVY), tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"), hover)
    assert result.verdict == NOT_TOLD
    assert not result.causes.named
    assert not result.fault
    assert any(line.startswith("not told") for line in result.evidence)


def test_a_wind_comes_out_of_the_drift(tmp_path: Path) -> None:
    """15 m/s to the east, where the vehicle holds its place; and the y axis is explained with it."""
    windy = Scenario.load("hover-in-wind").replace(duration_s=5.0, expect=[])
    fly(windy, tmp_path / "run")
    result = replayed(recorded(tmp_path / "run"), windy)
    north, east, _ = result.wind.velocity
    assert result.wind.deviation is not None
    assert abs(north) < 0.5  # drag goes with the square of each axis' speed: near none it tells little
    assert east == pytest.approx(15.0, abs=max(4.0 * result.wind.deviation, 0.5))
    assert next(channel.within for channel in result.channels if channel.name == "specific_force_y") > MIN_TIME_WITHIN


def test_the_command_leaves_page_json_and_csv(hexjet: Hexjet, doublet: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    data = json.loads(hexjet("replay", str(doublet), "--draws", "1", "--out", str(out), "--json").out)
    assert data == json.loads((out / "replay.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "explained"
    assert data.keys() >= SHARED
    assert data["engine"] == "edf-as-flown"
    assert data["simulated"]  # it is no recorded flight, whoever reads it later
    assert data["log_sha256"] == sha256((doublet / "flight.parquet").read_bytes()).hexdigest()
    assert not is_simulated(read_flight_log(dataflash(tmp_path / "log.bin", doublet)))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("Angular rates, measured and modelled") < page.index("<h2>Channels</h2>")
    assert "each started from the recorded state" in page
    table = pyarrow.csv.read_csv(out / "replay.csv")
    assert table.num_rows == data["windows"] * round(data["window_s"] / data["step_s"])
    inside = [
        low <= value <= high
        for value, low, high in zip(
            *(table[f"rate_p_rad_s{kind}"].to_pylist() for kind in ("", "_low", "_high")), strict=True
        )
    ]
    channel = next(channel for channel in data["channels"] if channel["name"] == "rate_p")
    assert np.mean(inside) == pytest.approx(channel["within"], abs=0.002)


def log_of(seconds: float = 4.0, rate: float = 250.0, **others: np.ndarray) -> FlightLog:
    """A log of six engines that stand at half throttle, and rates."""
    times = np.arange(round(seconds * rate)) / rate
    names = [*(f"throttle_{jet}" for jet in range(1, 7)), *(f"rate_{axis}_measured_rad_s" for axis in "pqr")]
    names += ["tilt_left_command_rad", "tilt_right_command_rad"]
    channels = {name: Channel(times, np.full(len(times), 0.5)) for name in names}
    channels |= {name: Channel(times, values) for name, values in others.items()}
    return FlightLog(Path("flight.csv"), "table", channels)


def refusal(log: FlightLog, mapping: ThrottleChannels | None = None) -> str:
    with pytest.raises(InputError) as error:
        record_flight(log, VEHICLE, DOUBLET.step_s, mapping or ThrottleChannels(), WHOLE)
    assert "\n" not in str(error.value)
    return str(error.value)


def lacking(log: FlightLog, *names: str) -> FlightLog:
    return replace(log, channels={name: channel for name, channel in log.channels.items() if name not in names})


def test_what_a_log_lacks_is_said_with_what_it_has() -> None:
    log = log_of()
    all_throttles = [f"throttle_{jet}" for jet in range(1, 7)]
    assert "commands of 5 engines, and hexjet has 6" in refusal(lacking(log, "throttle_6"))
    assert "no commands of engines" in refusal(lacking(log, *all_throttles))
    assert "no angular rates" in refusal(lacking(log, "rate_q_measured_rad_s"))
    assert "no command of the left servo" in refusal(lacking(log, "tilt_left_command_rad"))
    more = np.linspace(0.0, 1.0, 1000)
    assert "more engines (throttle_7) than the 6 of hexjet" in refusal(log_of(throttle_7=more))
    assert "has engines 1 to 6" in refusal(log, ThrottleChannels({7: "throttle_1"}))
    assert "no channel 'nothing'" in refusal(log, ThrottleChannels({1: "nothing"}))


def test_ardupilots_outputs_have_the_tilts_behind_the_engines() -> None:
    """Its seventh and eighth output move the Hex-Jet's banks; a ninth that moves is of another aircraft."""
    moved = 1500.0 + 100.0 * np.sin(np.arange(1000))
    outputs = {f"RCOU.C{n}": moved for n in range(1, 9)}
    log = lacking(log_of(**outputs), *(f"throttle_{jet}" for jet in range(1, 7)))
    record_flight(log, VEHICLE, DOUBLET.step_s, ThrottleChannels(limits=(1000.0, 2000.0)), WHOLE)
    more = lacking(log_of(**outputs, **{"RCOU.C9": moved}), *(f"throttle_{jet}" for jet in range(1, 7)))
    assert "more engines (RCOU.C9) than the 6 of hexjet" in refusal(more)


def test_px4s_own_topics_are_engines_and_banks_beside_all_its_outputs() -> None:
    """Its outputs have the servos behind the engines, and are no further engines; its servos are parts of their range."""
    log = log_of()
    theirs = {
        **{f"actuator_motors.control[{n}]": log.channels[f"throttle_{n + 1}"] for n in range(6)},
        **{f"actuator_servos.control[{n}]": Channel(log.channels["throttle_1"].times, np.linspace(0.0, n + 1.0, 1000) / 4.0)
           for n in range(2)},
        **{f"actuator_outputs.output[{n}]": Channel(log.channels["throttle_1"].times, np.linspace(0.0, 1.0, 1000))
           for n in range(8)},
    }  # fmt: skip
    rates = {name: channel for name, channel in log.channels.items() if name.startswith("rate_")}
    flight = record_flight(replace(log, channels=theirs | rates), VEHICLE, DOUBLET.step_s, ThrottleChannels(), WHOLE)
    assert np.ptp(flight.throttle) == 0.0
    assert VEHICLE.servo is not None
    share = flight.tilt[-1] / VEHICLE.servo.range_rad
    assert share == pytest.approx((0.25, 0.5), abs=0.01)


def test_logs_that_are_short_slow_or_of_another_unit_are_refused() -> None:
    assert "1 s of commands and rates; 2 s are needed" in refusal(log_of(1.004))
    assert "less than two rows" in refusal(log_of(0.004))
    assert "commands are 100 ms apart" in refusal(log_of(rate=10.0))
    counts = {f"throttle_{jet}": np.full(1000, 30000.0) for jet in range(1, 7)}
    assert "throttles up to 30000: say what 0 and 1 are" in refusal(log_of(**counts))


def autopilots(kind: str, **others: np.ndarray) -> FlightLog:
    """A log as an autopilot has it unless told otherwise: commands ten times a second, or none."""
    log = lacking(log_of(), *(f"throttle_{jet}" for jet in range(1, 7)))
    slow = np.arange(40) / 10.0
    channels = {name: Channel(slow, values) for name, values in others.items()}
    return replace(log, kind=kind, channels={**log.channels, **channels})


SLOW = {f"actuator_outputs.output[{jet}]": np.full(40, 1500.0) for jet in range(6)}


def test_commands_ten_times_a_second_are_refused_with_the_way_to_log_them_oftener() -> None:
    assert "100 ms apart; at most 30 ms tell what they did (PX4" in refusal(autopilots("ULog", **SLOW))
    outputs = {f"RCOU.C{jet}": np.full(40, 1500.0) for jet in range(1, 7)}
    assert "100 ms apart" in refusal(autopilots("ArduPilot DataFlash", **outputs))


def test_microseconds_of_a_ulog_are_throttles() -> None:
    log = autopilots("ULog")
    quick = {name: Channel(np.arange(1000) / 250.0, np.full(1000, 1500.0)) for name in SLOW}
    flight = record_flight(replace(log, channels={**log.channels, **quick}), VEHICLE, 0.004, ThrottleChannels(), WHOLE)
    np.testing.assert_allclose(flight.throttle, 0.5)
    assert any("1000 is taken for throttle 0 and 2000 for 1" in note for note in flight.notes)


def test_values_that_are_no_numbers_are_left_out_and_counted() -> None:
    rate = np.full(1000, 0.5)
    rate[100:110] = np.nan
    flight = record_flight(log_of(rate_p_measured_rad_s=rate), VEHICLE, 0.004, ThrottleChannels(), WHOLE)
    assert any("10 values are no numbers" in note for note in flight.notes)
    assert not flight.usable[100:109].any()
    assert flight.usable[:99].all()
    assert "less than two rows" in refusal(log_of(throttle_1=np.append(np.full(999, np.nan), 0.5)))


def test_theils_parts_are_those_of_the_definition() -> None:
    """Of a signal that is too large by half, and of one that is late by a quarter of its period."""
    wave = np.sin(2.0 * np.pi * np.arange(400) / 100.0)[None, :]
    larger, later = theil(wave, 1.5 * wave), theil(wave, np.roll(wave, 25, axis=1))
    assert larger.u == pytest.approx(0.5 / 2.5)
    assert larger.variance == pytest.approx(1.0)
    assert later.u == pytest.approx(np.sqrt(2.0) / 2.0)
    assert later.covariance == pytest.approx(1.0)
    shifted = theil(wave, wave + 1.0)
    assert shifted.bias == pytest.approx(1.0)
