"""Faults act where they happen, exactly as stated; the monitor finds what an engine does not do, and nothing else."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from math import exp, log, sqrt
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from long_cases import long_case
from places import DESIGNS

from cosim import fly
from cosim.base.errors import InputError, Notice
from cosim.base.signals import EngineOutput, PerJet, Sample
from cosim.campaign.study.plan import flights, scenario_of
from cosim.control.allocation.engine_monitor import EngineMonitor, EngineReference
from cosim.engine import EngineBank, load_engine
from cosim.engine.rundown import ELECTRIC, MODELLED, FlameOutLaw
from cosim.engine.wrappers import EngineChain
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.simulation.engine_reference import make_engine_reference
from cosim.simulation.script.fault_schedule import NEVER
from cosim.simulation.step import Simulation
from cosim.spec.scenario import (
    DelayGrowth,
    Fault,
    FlameOut,
    Scenario,
    SensorBias,
    SlowSpool,
    StuckThrottle,
    ThrustLoss,
    scenario_names,
)
from cosim.spec.vehicle import MonitorSettings, load_vehicle
from cosim.vehicle.servo import TiltServo
from hexjet_prove.api.surveys import faults
from hexjet_prove.surveys.faults import CONFIRMATIONS_S, LOSSES, cases, plan_faults
from hexjet_prove.surveys.survey import measure_flight

STEP = 0.004
KINDS = {get_args(fault.model_fields["kind"].annotation)[0] for fault in get_args(Fault)}
HOVER = Scenario(name="short", duration_s=2.0, initial={"altitude_m": 30.0})
FAULTY = [name for name in scenario_names() if name.startswith("fault-")]
PLANNED_AROUND = ["fault-flame-out", "fault-relight", "fault-stuck-throttle", "fault-thrust-loss"]
# of the full-scale ones the wildest commands (the start from idle has a test of its own); of the others with jets, one each
OTHERS = ("full-scale-", "octojet-", "quadjet-")
QUIET = [name for name in scenario_names() if name not in FAULTY and not name.startswith(OTHERS)]
QUIET += ["full-scale-gust", "octojet-climb-and-land", "quadjet-gust"]
FIRST = (
    "climb-and-land",
    "manual",
    "roll-doublet",
    "gust",
    "full-scale-gust",
    "quadjet-gust",
    "trijet-gust",
    "jetwing-gust",
)
HEALTH = [f"health_{jet}" for jet in range(1, 7)]
LAW = FlameOutLaw(thrust_left=0.4, half_speed_s=1.2, exponent=2.5, relight_s=20 * STEP)
OUT = FlameOut(kind="flame_out", start_s=0.0, jet=[1])


class Bank:
    """Engines that give 10 N per throttle at once and say so; ``ports`` lists those that can be shut off."""

    wants_ambient = False

    def __init__(self, ports: tuple[int, ...] = ()) -> None:
        self.ports = ports
        self.given: list[PerJet] = []
        self.runs: list[tuple[int, bool]] = []

    def step(self, k: int, throttle: PerJet, ambient: Any = None) -> EngineOutput:
        self.given.append(throttle)
        thrust = tuple(10.0 * u for u in throttle)
        return EngineOutput(thrust, (100.0,) * 6, (900.0,) * 6, (1e-3,) * 6)

    def set_run(self, index: int, on: bool) -> bool:
        if index in self.ports:
            self.runs.append((index, on))
        return index in self.ports


def chain(bank: Any, *laws: FlameOutLaw) -> EngineChain:
    return EngineChain(bank, laws or [ELECTRIC] * 6, lambda jet: 0.05, STEP)


# ---- engines


@pytest.mark.parametrize(
    ("fault", "given"),
    [
        (StuckThrottle(kind="stuck_throttle", start_s=0.0, jet=[2]), [0.1] * 7),
        (StuckThrottle(kind="stuck_throttle", start_s=0.0, jet=[2], throttle=0.8), [0.8] * 7),
        # the first command until late ones arrive
        (
            DelayGrowth(kind="delay_growth", start_s=0.0, jet=[2], delay_s=3 * STEP),
            [0.1, 0.1, 0.1, 0.1, 0.11, 0.12, 0.13],
        ),
        # a first-order lag, which a ramp leaves behind by what it climbs in the lag's time
        (
            SlowSpool(kind="slow_spool", start_s=0.0, jet=[2], lag_s=0.02),
            [0.1 + 0.01 * k - 0.01 * (1.0 - exp(-0.2 * k)) / (exp(0.2) - 1.0) for k in range(7)],
        ),
    ],
    ids=["stays at its first command", "stuck where told", "late", "slow"],
)
def test_a_fault_changes_the_command_of_its_jet_alone(fault: Fault, given: list[float]) -> None:
    bank = Bank()
    engines = chain(bank)
    engines.begin_fault(fault)
    ramp = [0.1 + 0.01 * k for k in range(7)]
    for k, throttle in enumerate(ramp):
        engines.step(k, (throttle,) * 6)
    assert [each[1] for each in bank.given] == pytest.approx(given, abs=1e-12)
    assert [each[0] for each in bank.given] == ramp


def test_a_weak_engine_misses_a_share_of_its_thrust_and_the_root_of_it_in_speed() -> None:
    engines = chain(Bank())
    loss = ThrustLoss(kind="thrust_loss", start_s=0.0, jet=[4], share=0.36)
    engines.begin_fault(loss)
    output = engines.step(0, (0.5,) * 6)
    assert output.thrust == pytest.approx((5.0, 5.0, 5.0, 3.2, 5.0, 5.0))
    assert output.spool_speed[3] == pytest.approx(80.0)
    engines.end_fault(loss)
    assert engines.step(1, (0.5,) * 6).thrust == (5.0,) * 6


def test_a_fan_without_current_dies_away_along_its_lag_and_comes_back() -> None:
    bank = Bank()
    engines = chain(bank)
    engines.begin_fault(OUT)
    output = [engines.step(k, (0.5,) * 6) for k in range(10)][-1]
    left = exp(-10 * STEP / 0.05)
    assert bank.given[-1] == (0.0, 0.5, 0.5, 0.5, 0.5, 0.5)
    assert (output.thrust[0], *output.fuel_flow[:2]) == (0.0, 0.0, 1e-3)
    assert output.spool_speed[0] == pytest.approx(100.0 * sqrt(left))
    engines.end_fault(OUT)
    output = [engines.step(k, (0.5,) * 6) for k in range(10, 20)][-1]
    assert output.thrust[0] == pytest.approx(5.0 * (1.0 - left * (1.0 - left)))


def test_a_turbine_without_a_run_port_goes_out_by_its_law_and_is_lit_again() -> None:
    bank = Bank()
    engines = chain(bank, *[LAW] * 6)
    engines.begin_fault(OUT)
    for k in range(10):
        output = engines.step(k, (0.5 + 0.01 * k,) * 6)
        slowed = 1.0 / (1.0 + (k + 1) * STEP / 1.2)
        # what it gave when its fire went out, and nothing that was commanded since
        assert output.thrust[0] == pytest.approx(5.0 * 0.4 * slowed**2.5, rel=1e-12)
        assert output.spool_speed[0] == pytest.approx(100.0 * slowed, rel=1e-12)
        assert output.fuel_flow[0] == 0.0
    assert [each[0] for each in bank.given[:2]] == [0.5, 0.0]
    engines.end_fault(OUT)
    course = [engines.step(k, (0.6,) * 6).thrust[0] for k in range(10, 40)]
    # the bank's engine gives nothing at throttle 0: it comes back when the start is over, not before
    assert (bank.given[10 + 19][0], bank.given[10 + 21][0], course[-1]) == (0.0, 0.6, 6.0)
    assert course[:19] == sorted(course[:19], reverse=True)


@pytest.mark.parametrize(
    ("engine", "like", "throttle"), [("p220", "turbine-220", 0.45), ("turbojet", "turbine-20", 0.4)]
)
def test_the_law_of_a_flame_out_is_that_of_the_gas_path_of_its_class(engine: str, like: str, throttle: float) -> None:
    """The fit's error is 0.013 of the thrust before; without fire more than half of it is gone at once."""
    law = load_engine(engine, {}, STEP).flame_out
    assert law is not None
    with EngineBank(load_engine(like, {}, STEP), 1, STEP) as bank:
        hover = bank.reset(throttle)
        bank.set_run(0, False)
        rows = [bank.step(k, (throttle,)) for k in range(1000)]
    thrust = np.array([row.thrust[0] for row in rows]) / hover.thrust[0]
    speed = np.array([row.spool_speed[0] for row in rows]) / hover.spool_speed[0]
    slowed = 1.0 / (1.0 + STEP * np.arange(1, 1001) / law.half_speed_s)
    assert thrust == pytest.approx(law.thrust_left * slowed**law.exponent, abs=0.015)
    assert speed == pytest.approx(slowed, abs=0.03)
    assert thrust[0] < 0.45


def test_how_the_gas_path_goes_out_at_the_ends_of_its_range() -> None:
    """What is left at once, in per cent, and when the speed is half of what it was."""
    said = []
    for throttle in (1.0, 0.1):
        with EngineBank(load_engine("turbine-220", {}, STEP), 1, STEP) as bank:
            before = bank.reset(throttle)
            bank.set_run(0, False)
            rows = [bank.step(k, (throttle,)) for k in range(500)]
        speed = [row.spool_speed[0] / before.spool_speed[0] for row in rows]
        late = next(k for k, share in enumerate(speed) if share < 0.5)
        half = late + (speed[late - 1] - 0.5) / (speed[late - 1] - speed[late])  # row k is k + 1 steps later
        said += [100.0 * rows[0].thrust[0] / before.thrust[0], half * STEP]
    assert said == pytest.approx([37.0, 0.96, 40.0, 1.83], rel=0.02)


def test_an_engine_shut_off_goes_out_by_its_law_too_and_a_fan_at_once() -> None:
    bank = Bank()
    engines = chain(bank, LAW, ELECTRIC, *[LAW] * 4)
    engines.switch_engine(0, False)
    engines.switch_engine(1, False)
    for k in range(5):
        output = engines.step(k, (0.5,) * 6)
        assert bank.given[-1] == ((0.5 if k == 0 else 0.0), 0.0, 0.5, 0.5, 0.5, 0.5)
        slowed = 1.0 / (1.0 + (k + 1) * STEP / 1.2)
        assert output.thrust[:3] == (pytest.approx(5.0 * 0.4 * slowed**2.5), 0.0, 5.0)
        assert output.spool_speed[:3] == (pytest.approx(100.0 * slowed), 100.0, 100.0)
        assert output.fuel_flow[:3] == (0.0, 0.0, 1e-3)
    engines.switch_engine(0, True)
    engines.step(5, (0.5,) * 6)
    assert bank.given[-1][:3] == (0.5, 0.0, 0.5)


@pytest.mark.parametrize(("aircraft", "engine"), [("hexjet-p220", "p220"), ("hexjet", "turbojet")])
def test_in_flight_the_fire_takes_its_thrust_along(aircraft: str, engine: str) -> None:
    fault = {"kind": "flame_out", "start_s": 0.2, "jet": 2}
    flight = HOVER.replace(aircraft=aircraft, engine=engine, controller="baseline", duration_s=0.46, fault=[fault])
    thrust = fly(flight.replace(monitor=False)).log["thrust_2_N"]
    law = load_engine(engine, {}, STEP).flame_out
    assert law is not None
    left = 0.40 * (1.0 + STEP * np.array([1, 26, 63]) / law.half_speed_s) ** -law.exponent
    # the first step is still the engine's own
    assert thrust[[50, 75, 112]] / thrust[49] == pytest.approx(left, rel=0.005)
    assert thrust[75] < 0.34 * thrust[49]


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ("", r"fault\.0: the engine at jet 3 has no port run and states no \[flame_out\]"),
        ("[flame_out]\nthrust_left = 0.3\n", r"flame_out: .*state thrust_left, run_down_s, exponent and relight_s"),
        ("[flame_out]\nelectric = true\n", ELECTRIC),
        ("[flame_out]\nthrust_left = 0.4\nrun_down_s = 1.2\nexponent = 2.5\nrelight_s = 0.08\n", LAW),
    ],
    ids=["unknown", "half known", "electric", "law"],
)
def test_an_engine_of_which_nobody_knows_how_it_goes_out_is_refused_the_fault(
    tmp_path: Path, stated: str, expected: str | FlameOutLaw
) -> None:
    (tmp_path / "mine.toml").write_text(f'fmu = "{load_engine("edf", {}, STEP).path}"\n{stated}', encoding="utf-8")
    fault = {"kind": "flame_out", "start_s": 1.0, "jet": [3, 5]}
    flight = HOVER.replace(
        engine=str(tmp_path / "mine.toml"), controller="baseline", engine_unchecked=True, fault=[fault]
    )
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            build(flight)
    else:
        with build(flight) as simulation:
            assert simulation.stations[0].flame_out == expected


def test_an_engine_that_can_be_shut_off_is_left_to_its_own_equations() -> None:
    bank = Bank(ports=(0, 1))
    engines = chain(bank)
    engines.begin_fault(OUT)
    assert engines.step(0, (0.5,) * 6).thrust == (5.0,) * 6
    engines.end_fault(OUT)
    assert bank.runs == [(0, False), (0, True)]


LOSS = ThrustLoss(kind="thrust_loss", start_s=0.0, jet=[1], share=0.5)


@pytest.mark.parametrize(
    ("acts", "runs"),
    [
        # without fuel it is not lit again
        (["out", "switch off", "not out"], [False, False]),
        (["out", "switch off", "not out", "switch on"], [False, False, True]),
        # nor with a fault
        (["switch off", "loss", "switch on"], [False]),
        (["switch off", "loss", "switch on", "not loss", "switch on"], [False, True]),
        # out twice it is lit when both are over
        (["out", "out again", "not out"], [False, False]),
        (["out", "out again", "not out", "not out again"], [False, False, True]),
    ],
    ids=str,
)
def test_when_an_engine_that_was_off_is_lit_again(acts: list[str], runs: list[bool]) -> None:
    bank = Bank(ports=(0,))
    engines = chain(bank, *[MODELLED] * 6)
    named = {"out": OUT, "out again": OUT.model_copy(), "loss": LOSS}
    for act in acts:
        if act.startswith("switch"):
            engines.switch_engine(0, act == "switch on")
        else:
            (engines.end_fault if act.startswith("not ") else engines.begin_fault)(named[act.removeprefix("not ")])
    assert bank.runs == [(0, on) for on in runs]
    assert engines.off == (set() if runs[-1] or "switch off" not in acts else {0})


def test_a_servo_that_jams_twice_goes_on_with_the_second_jam() -> None:
    """To 4 deg for 0.2 s, to -3 deg for as long after it began before the first was over, then free again."""
    jam = {"kind": "servo_jam", "servo": "left"}
    faults = [
        {**jam, "start_s": 0.2, "duration_s": 0.2, "angle_deg": 4.0},
        {**jam, "start_s": 0.3, "duration_s": 0.3, "angle_deg": -3.0},
    ]
    tilt = np.degrees(fly(HOVER.replace(duration_s=1.0, sensor_noise=False, fault=faults)).log["tilt_left_rad"])
    assert tilt[[99, 149]] == pytest.approx([4.0, -3.0], abs=0.1)
    assert abs(tilt[249] + 3.0) > 0.1


def test_in_flight_a_flame_out_decays_exactly_along_the_lag() -> None:
    """Until the closed throttle has passed the engine's delay of 25 samples."""
    fault = {"kind": "flame_out", "start_s": 0.4, "jet": 2}
    log = fly(HOVER.replace(duration_s=0.6, sensor_noise=False, fault=[fault], monitor=False)).log
    lag = load_engine("edf-as-flown", {}, STEP).lag
    assert lag is not None
    rows = np.arange(1, 26)
    thrust = log["thrust_2_N"]
    assert thrust[99 + rows] == pytest.approx(thrust[99] * np.exp(-rows * STEP / lag), rel=1e-3)
    assert log["fault_jet_2"].tolist() == [0.0] * 100 + [1.0] * 50
    assert not log["fault_jet_1"].any()


def test_an_engine_with_a_run_port_goes_out_and_is_lit_again_by_its_own_equations() -> None:
    """It winds down long after the fuel is gone, and takes half a minute to start."""
    spec = load_engine("turbine-20", {}, STEP)
    assert spec.has_port("run")
    with EngineBank(spec, 1, STEP) as bank:
        engines = chain(bank, MODELLED)
        hover = engines.reset(0.5)
        engines.begin_fault(OUT)
        course = [engines.step(k, (0.5,)) for k in range(500)]
        assert course[50].thrust[0] < 0.25 * hover.thrust[0]
        assert 0.2 < course[499].spool_speed[0] / hover.spool_speed[0] < 0.5
        engines.end_fault(OUT)
        last = [engines.step(k, (0.5,)) for k in range(500, 12000)][-1]
    assert last.thrust[0] == pytest.approx(hover.thrust[0], rel=0.01)


# ---- servos and sensors


def test_a_jammed_servo_stays_or_runs_to_its_angle() -> None:
    settings_ = load_vehicle("hexjet")[0].servo
    assert settings_ is not None
    servo = TiltServo(settings_, STEP)
    servo.update(0.1)
    angle = servo.angle
    servo.jam(None)
    assert [servo.update(0.3) for _ in range(3)] == [angle] * 3
    servo.jam(0.2)
    free = TiltServo(settings_, STEP)
    free.reset(servo.angle)
    assert [servo.update(-0.3) for _ in range(5)] == [free.update(0.2) for _ in range(5)]


def test_a_freed_servo_goes_on_from_where_it_was_jammed() -> None:
    fault = {"kind": "servo_jam", "start_s": 0.4, "duration_s": 0.2, "servo": "right", "angle_deg": 3.0}
    tilt = fly(HOVER.replace(duration_s=0.8, fault=[fault])).log["tilt_right_rad"]
    assert tilt[149] == pytest.approx(np.radians(3.0), rel=1e-3)
    assert 0.0 < tilt[149] - tilt[150] < 10.0 * STEP + 1e-9


@pytest.fixture(scope="module")
def short_hover() -> Run:
    return fly(HOVER.replace(duration_s=0.4))


@pytest.mark.parametrize(
    ("sensor", "fault", "column", "difference"),
    [
        ("gyro", {"bias": [0.1, 0.0, 0.0]}, "rate_p_measured_rad_s", 0.1),
        ("barometer", {"bias": [0.7]}, "altitude_measured_m", 0.7),
        ("gnss", {"bias": [2.0, 0.0, 0.0]}, "north_measured_m", 2.0),
        ("gnss", {"velocity_bias": [0.0, 0.3, 0.0]}, "velocity_east_measured_m_s", 0.3),
        ("attitude", {"bias": [0.05, 0.0, 0.0]}, "roll_measured_rad", 0.05),
    ],
)
def test_a_bias_is_added_to_its_sensor_and_to_no_other(
    sensor: str, fault: dict[str, Any], column: str, difference: float, short_hover: Run
) -> None:
    """On the first sample the motion is still the same."""
    biased = {"kind": "sensor_bias", "start_s": 0.2, "sensor": sensor, **fault}
    log, plain = fly(HOVER.replace(duration_s=0.4, fault=[biased])).log, short_hover.log
    for name in filter(lambda name: "measured" in name, log.columns):
        # a rotation of the attitude turns the other angles by the product of two small ones
        wanted = pytest.approx(difference, abs=1e-4) if name == column else pytest.approx(0.0, abs=2e-5)
        assert log[name][51] - plain[name][51] == wanted, name
        assert log[name][50] == plain[name][50]


@pytest.mark.parametrize(
    ("sensor", "column", "other"),
    [
        ("gyro", "rate_q_measured_rad_s", "altitude_measured_m"),
        ("attitude", "pitch_measured_rad", "rate_q_measured_rad_s"),
        ("gnss", "velocity_down_measured_m_s", "altitude_measured_m"),
        ("barometer", "altitude_measured_m", "rate_q_measured_rad_s"),
    ],
)
def test_a_dropout_repeats_the_last_value(sensor: str, column: str, other: str) -> None:
    fault = {"kind": "sensor_dropout", "start_s": 0.2, "duration_s": 0.1, "sensor": sensor}
    log = fly(HOVER.replace(duration_s=0.4, fault=[fault])).log
    assert (log[column][50:76] == log[column][50]).all()
    assert log[column][49] != log[column][50] or sensor == "gnss"
    assert len(set(log[other][50:76])) == 26
    assert log[f"fault_{sensor}"].sum() == 25


def test_a_sensor_is_silent_as_long_as_its_samples_repeat() -> None:
    """By which an autopilot is told nothing: a step too long, and what it had said last would be a new fix."""
    fault = {"kind": "sensor_dropout", "start_s": 0.2, "duration_s": 0.1, "sensor": "gnss"}
    with build(HOVER.replace(duration_s=0.4, fault=[fault])) as simulation:
        silent = [(simulation.step(), simulation.sensors.silent)[1] for _ in range(100)]
    assert [k for k, sensors in enumerate(silent) if sensors == ("gnss",)] == list(range(50, 75))


# ---- a flight with them


def same(one: Run, other: Run, *but: str) -> bool:
    return all(np.array_equal(one.log[n], other.log[n], equal_nan=True) for n in one.log.columns if n not in but)


def test_without_a_fault_the_blocks_are_the_bare_ones_and_the_log_is_the_same() -> None:
    late = [
        {"kind": "flame_out", "start_s": 5.0, "jet": 1},
        {"kind": "sensor_dropout", "start_s": 5.0, "sensor": "gyro"},
    ]
    plain = fly(HOVER)
    assert same(plain, fly(HOVER.replace(fault=late, monitor=False)))
    assert same(plain, fly(HOVER.replace(monitor=True)))
    with build(HOVER) as simulation:
        assert simulation.cascade.monitor is None
        assert simulation.faults.next == NEVER


def test_a_flight_with_faults_by_command_is_repeated_bit_for_bit_from_what_it_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bias = SensorBias(kind="sensor_bias", start_s=0.0, sensor="gyro", bias=[0.02, 0.0, 0.0], duration_s=0.4)
    acts: dict[int, Callable[[Simulation], None]] = {
        100: lambda s: s.inject(FlameOut(kind="flame_out", start_s=9.0, jet=[2])),
        150: lambda s: s.inject(bias),
        180: lambda s: s.clear_faults(),
        200: lambda s: s.inject(DelayGrowth(kind="delay_growth", start_s=0.0, jet=[1, 3], delay_s=0.02)),
    }
    built: list[Simulation] = []

    def keep(*given: Any, **options: Any) -> Simulation:
        built.append(build(*given, **options))
        return built[0]

    def observe(sample: Sample) -> None:
        if sample.k in acts:
            acts[sample.k](built[0])

    commander = SimpleNamespace(observe=observe)
    monkeypatch.setattr("cosim.simulation.build.build", keep)
    first = fly(HOVER.replace(monitor=True), tmp_path / "first", observers=[commander], report=False)
    monkeypatch.undo()
    assert first.log["health_2"][-1] == 0.0
    assert [first.log[f"fault_{name}"].sum() for name in ("jet_2", "gyro")] == [80, 30]
    again = Scenario.load(tmp_path / "first" / "scenario.toml")
    assert [entry.start_s for entry in again.fault] == pytest.approx([101 * STEP, 151 * STEP, 201 * STEP])
    second = fly(again, tmp_path / "second", report=False)
    logs = [(tmp_path / name / "flight.parquet").read_bytes() for name in ("first", "second")]
    assert logs[0] == logs[1]
    assert second.outcome == first.outcome


def test_a_reset_forgets_what_came_by_command() -> None:
    with build(HOVER.replace(monitor=True, sensor_noise=False)) as simulation:
        first = [simulation.step() for _ in range(60)]
        simulation.reset()
        simulation.inject(FlameOut(kind="flame_out", start_s=0.0, jet=[2]))
        ill = [simulation.step() for _ in range(60)]
        assert ill[-1].health[1] == 0.0
        assert ill[-1].state != first[-1].state
        simulation.reset()
        assert simulation.scenario.fault == []
        again = [simulation.step() for _ in range(60)]
    compared = attrgetter("state", "measured", "actuation", "thrust", "faults", "health")
    assert [compared(sample) for sample in again] == [compared(sample) for sample in first]


QUADROTOR = {"aircraft": "quadrotor", "engine": "motor", "step_s": 0.0025}
JAM = {"kind": "servo_jam", "start_s": 1.0}


@pytest.mark.parametrize(
    ("fault", "changes", "message"),
    [
        ({"jet": 17}, {}, r"fault\.0\.jet.*less than or equal to 16"),
        ({"jet": [1, 1]}, {}, r"fault\.0\.jet: name a jet once"),
        ({"kind": "flameout"}, {}, r"fault\.0\.kind = 'flameout': did you mean 'flame_out'\? allowed: "),
        ({"kind": "sensor_bias", "start_s": 1.0, "sensor": "gyro", "bias": [1.0]}, {}, r"the gyro needs a list of 3"),
        ({"kind": "sensor_bias", "start_s": 1.0, "sensor": "gyro"}, {}, r"give one that is not 0"),
        (JAM | {"servo": "both"}, {}, r"fault\.0\.servo = 'both': hexjet has the servos left, right"),
        ({"start_s": 0.001}, {}, r"fault\.0\.start_s = 0\.001 s is not a whole"),
        (JAM | {"servo": "left"}, QUADROTOR, r"fault\.0\.servo: quadrotor has no tilt servos"),
        ({"jet": 5}, QUADROTOR, r"fault\.0\.jet = 5: quadrotor has jets 1 to 4"),
    ],
)
def test_wrong_faults_are_refused_in_one_line(fault: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    if "sensor" not in fault and "servo" not in fault:
        fault = {"kind": "flame_out", "start_s": 1.0, "jet": 1} | fault
    with pytest.raises(InputError, match=message) as caught:
        build(HOVER.replace(controller="baseline", fault=[fault], **changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FAULTY)
def test_a_fault_scenario_is_not_met_without_its_fault(name: str) -> None:
    run = fly(Scenario.load(name).replace(fault=[]))
    assert run.summary.complaints


@pytest.mark.parametrize("name", PLANNED_AROUND)
def test_without_planning_around_it_the_vehicle_is_lost(name: str) -> None:
    run = fly(Scenario.load(name).replace(monitor=False))
    assert run.outcome == "diverged"
    assert run.summary.complaints


# ---- the monitor


REFERENCE = EngineReference((0.0, 1.0), (0.0, 20.0), None, 0.03, 0.1, 0.03, 0.03)
SETTINGS = MonitorSettings(threshold=0.2, confirm_s=0.02, stuck_s=0.1, lag_factor=3.0, delay_spread_s=0.012)
NAN = (float("nan"),)


@pytest.fixture
def monitor() -> EngineMonitor:
    """Of one engine that hovers at 9 N and throttle 0.45."""
    monitor = EngineMonitor(SETTINGS, [REFERENCE], 9.0, (0.05, 1.0), STEP)
    monitor.reset([0.45])
    return monitor


def watch(monitor: EngineMonitor, throttle: float, thrust: float) -> bool:
    return monitor.update((throttle,), EngineOutput((thrust,), NAN, NAN, NAN))


def found(monitor: EngineMonitor, throttle: float, thrust: Callable[[int], float]) -> int:
    """The step at which an engine that gives ``thrust(k)`` is found."""
    return next(k for k in range(1, 200) if watch(monitor, throttle, thrust(k)))


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-1.0, 1.0),
    st.integers(22, 28),
    st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 60)), min_size=1, max_size=12),
)
def test_no_engine_within_the_tolerances_is_ever_suspected(
    stretch: float, delay: int, course: list[tuple[float, int]]
) -> None:
    """A lag anywhere within a factor of three and a delay within three samples, whatever is commanded."""
    lag = 0.03 * 3.0**stretch
    monitor = EngineMonitor(SETTINGS, [REFERENCE], 1e-3, (0.05, 1.0), STEP)  # no threshold to speak of
    monitor.reset([0.5])
    thrust, line = 10.0, [0.5] * delay
    for throttle, steps in course:
        for _ in range(steps):
            line.append(throttle)
            thrust += (1.0 - exp(-STEP / lag)) * (20.0 * line.pop(0) - thrust)
            assert not watch(monitor, throttle, thrust)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6])
def test_a_loss_of_thrust_is_found_in_time_and_in_size(share: float, monitor: EngineMonitor) -> None:
    # along a lag of 30 ms towards the share: outside once a fifth of hover is missing, then 5 steps
    outside = 0.03 * log(1.0 / (1.0 - 0.2 / (1.0 - share)))
    k = found(monitor, 0.45, lambda k: 9.0 * (share + (1.0 - share) * exp(-k * STEP / 0.03)))
    assert k == int(outside / STEP) + 5
    assert monitor.gains[0] == pytest.approx(share, abs=1e-9)
    assert monitor.health[0].fixed == 0.0


def test_a_sudden_fall_is_found_though_the_command_has_wavered_before() -> None:
    """A command that wavers widens what a healthy engine may give; from what it gave last it still falls no faster."""
    reference = EngineReference((0.0, 1.0), (0.0, 20.0), None, 1.0, 0.0, 0.8, 1.2)
    settings = SETTINGS.model_copy(update={"threshold": 0.1})
    ks = []
    for swing in (0.0, 0.05):
        monitor = EngineMonitor(settings, [reference], 9.0, (0.05, 1.0), STEP, sudden=True)
        monitor.reset([0.45])
        assert not any(watch(monitor, 0.45 + (swing if k % 2 else -swing), 9.0) for k in range(3000))
        # as the thrust of a rotor without fire: outside a tenth of hover when 0.9 N are gone, then 5 steps
        ks.append(found(monitor, 0.45, lambda k: 9.0 / (1.0 + k * STEP / 1.23) ** 3.2))
    # a command that stood at 8 N all the while would have brought 9 N down by 0.3 N in 0.1 s, with a third of the lag:
    # that much more has to be gone; by the interval alone it is four fifths of the 1 N that the command wavers by
    limits = (8.1, 8.1 - (1.0 - exp(-3.0 * 0.1 / 0.8)))
    assert ks == [int(1.23 * ((9.0 / limit) ** (1.0 / 3.2) - 1.0) / STEP) + 5 for limit in limits]


def test_a_weak_engine_may_get_well_and_a_lost_one_not(monitor: EngineMonitor) -> None:
    for level, gain in ((0.5, 0.5), (1.0, 1.0), (0.0, 0.0), (0.15, 0.0)):
        for _ in range(100):
            watch(monitor, 0.45, 9.0 * level)
        assert monitor.gains == pytest.approx((gain,))


def test_a_stuck_engine_is_found_when_its_command_has_moved(monitor: EngineMonitor) -> None:
    assert not any(watch(monitor, 0.45, 9.0) for _ in range(200))
    # not before the delay and the time it takes to call it stuck; the widest lag and delay on top
    assert 0.1 + 0.1 <= found(monitor, 0.65, lambda k: 9.0) * STEP <= 0.1 + 0.1 + 0.012 + 0.09
    assert monitor.health[0] == (0.0, pytest.approx(0.45), pytest.approx(0.45))


def test_an_engine_that_runs_away_is_taken_for_stuck_where_it_heads_for(monitor: EngineMonitor) -> None:
    assert found(monitor, 0.45, lambda k: 16.0 - 7.0 * exp(-k * STEP / 0.03)) * STEP <= 0.04
    assert monitor.health[0] == (0.0, pytest.approx(0.8), pytest.approx(0.8))


def test_a_speed_reading_stands_for_thrust() -> None:
    """Thrust with the square of the speed, as the reference has it at its points."""
    points = [k / 20 for k in range(21)]
    thrusts, speeds = [20.0 * u for u in points], [1000.0 * sqrt(u) for u in points]
    reference = EngineReference(points, thrusts, speeds, 0.1, 0.0, 0.1, 0.1)
    assert reference.reported_to_thrust(float("nan"), 1000.0 * sqrt(0.45)) == pytest.approx(9.0)
    assert reference.reported_to_thrust(5.0, float("nan")) == 5.0
    assert reference.reported_to_thrust(5.0, float("nan")) == 5.0


@pytest.mark.parametrize("jet", range(1, 7))
def test_a_flame_out_in_flight_is_found_within_28_ms(jet: int) -> None:
    fault = {"kind": "flame_out", "start_s": 0.4, "jet": jet}
    log = fly(HOVER.replace(duration_s=0.5, fault=[fault])).log
    health = np.array([log[name] for name in HEALTH])
    first = int(np.flatnonzero(health.min(axis=0) < 1.0)[0])
    assert 0.02 <= (first + 1 - 100) * STEP <= 0.028
    assert [row[-1] for row in health] == [0.0 if number == jet else 1.0 for number in range(1, 7)]


@pytest.mark.parametrize("name", [name if name in FIRST else long_case(name) for name in QUIET])
def test_no_false_alarm_in_any_scenario_without_a_fault(name: str) -> None:
    """Doublets, sticks, gusts in turbulence, take-off and landing, with sensor noise."""
    scenario = Scenario.load(name)
    jets = len(scenario.resolved_vehicle()[0].jets)
    log = fly(scenario.replace(monitor=True)).log
    assert all((log[f"health_{jet}"] == 1.0).all() for jet in range(1, jets + 1))


@pytest.mark.parametrize(("aircraft", "engine"), [("hexjet-p220", "p220"), long_case(("hexjet-100", "turbine-100"))])
def test_the_full_scale_threshold_is_twice_what_a_healthy_engine_comes_to(aircraft: str, engine: str) -> None:
    """Idle, take-off and landing, where an engine is furthest from a lag behind a delay; the rest is the reading's."""
    vehicle, _ = load_vehicle(aircraft)
    assert vehicle.control.monitor is not None
    half = {"control": {"monitor": {"threshold": 0.5 * vehicle.control.monitor.threshold}}}
    scenario = Scenario.load("full-scale-climb-and-land").replace(
        aircraft=aircraft, engine=engine, monitor=True, vehicle=half, expect=[]
    )
    log = fly(scenario).log
    assert all((log[health] == 1.0).all() for health in HEALTH)


@pytest.mark.parametrize("engine", ["edf", "turbojet", "turbine-20"])
def test_no_false_alarm_from_a_flight_that_swings_out_of_control(engine: str) -> None:
    """The wildest commands there are: the baseline on engines that are too slow for its gains."""
    log = fly(Scenario.load("roll-doublet").replace(engine=engine, controller="baseline", monitor=True)).log
    assert all((log[health] == 1.0).all() for health in HEALTH)


def test_the_reference_of_an_engine_is_its_own() -> None:
    spec = load_engine("turbojet", {}, STEP)
    stated = make_engine_reference(spec, STEP)
    assert stated.lag == spec.lag == stated.shortest == stated.longest
    assert stated.delay == pytest.approx(0.1)
    measured = make_engine_reference(load_engine("turbine-20", {}, STEP), STEP)
    assert measured.shortest <= measured.lag <= measured.longest
    assert measured.speed is not None
    assert list(measured.speed) == sorted(measured.speed)


def test_a_vehicle_without_a_monitor_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, folder = load_vehicle("hexjet")
    bare = vehicle.model_copy(update={"control": vehicle.control.model_copy(update={"monitor": None})})
    monkeypatch.setattr("cosim.spec.scenario.scenario.load_with_profile", lambda *_: (bare, folder))
    with pytest.raises(InputError, match=r"hexjet has no \[control\.monitor\]"):
        build(HOVER.replace(monitor=True))


# ---- the table


def test_the_table_has_every_fault_at_every_place() -> None:
    found = cases(load_vehicle("hexjet")[0])
    kinds = {case.fault["kind"] for case in found if case.fault}
    assert kinds == KINDS
    assert [case.place for case in found if case.kind == "flame-out"] == [f"jet {jet}" for jet in range(1, 7)]
    assert not [case for case in cases(load_vehicle("quadrotor")[0]) if "servo" in case.kind or case.place == "jet 5"]
    plan = plan_faults("hexjet", limits=True)  # each is a scenario
    assert len(plan.study.case) == 2 * (len(found) + len(LOSSES) + len(CONFIRMATIONS_S))


def test_a_small_table_agrees_with_its_scenarios(tmp_path: Path) -> None:
    found = faults("hexjet", "edf-as-flown", controllers=["baseline", "smith"], kinds=["none", "gyro bias"], workers=1,
                   out=tmp_path / "table")  # fmt: skip
    verdicts = {(row.kind, row.start, row.controller): row.verdict for row in found.survey.rows}
    assert verdicts["none", "hover", "smith"] == verdicts["gyro bias 3 deg/s", "roll", "smith"] == "held"
    # what the doublet's own scenario says of the baseline
    assert verdicts["none", "roll", "baseline"] == "lost"
    (table,) = found.tables()
    assert table.columns == ["fault", "from", "baseline", "smith", "detected, s"]
    assert [row[:2] for row in table.rows[:2]] == [["none", "hover"], ["none", "roll"]]
    assert table.rows[0][3].startswith("1/1")
    assert "hexjet: smith holds 4 of 4 flights" in found.lines()
    lost = next(row for row in found.survey.rows if row.verdict == "lost")
    again = found.fly_again(lost.flight)
    assert again.same
    assert again.run.reason == lost.reason  # as it was flown
    with pytest.raises(InputError, match="no fault begins with 'flat'"):
        faults("hexjet", kinds=["flat"])


def test_lean_height_and_detection_are_measured_from_the_fault_on() -> None:
    plan = plan_faults("hexjet", "edf-as-flown", ("smith",), ("flame-out",))
    scenario = scenario_of(plan.study, flights(plan.study)[0])
    run = fly(scenario)
    lean, lost, detected = measure_flight(run.log, 250)
    assert lean == pytest.approx(np.degrees(np.abs(run.log["roll_rad"]).max()), abs=2.0)
    assert lost == pytest.approx(run.log["altitude_m"][250] - run.log["altitude_m"][250:].min())
    assert detected == 255
    measured = run.summary.own_metrics
    assert list(measured.values()) == [lean, lost, pytest.approx(6 * STEP)]


def test_the_gains_of_a_design_are_flown_and_its_file_is_kept(tmp_path: Path) -> None:
    """Each refused in one line for another aircraft, and warned of with another engine."""
    path = DESIGNS / "turbojet.toml"
    with pytest.warns(Notice, match=r"designed for engine turbojet"):
        found = faults("hexjet", "edf", controllers=[str(path)], kinds=["none"], workers=1, out=tmp_path / "table")
    assert {row.controller for row in found.survey.rows} == {"turbojet.toml"}
    assert "designed for engine turbojet" in found.to_dict()["warnings"][0]
    assert (tmp_path / "table" / "turbojet.toml").read_bytes() == path.read_bytes()
    scenario = scenario_of(found.campaign.study, flights(found.campaign.study)[0])
    made = tomllib.loads(path.read_text(encoding="utf-8"))
    assert scenario.controller == made["controller"]
    assert scenario.vehicle["control"]["rate"] == made["vehicle"]["control"]["rate"]
    with pytest.raises(InputError, match=r"turbojet.toml: designed for aircraft 'hexjet', not for 'quadjet'"):
        plan_faults("quadjet", None, (str(path),), ("none",))
