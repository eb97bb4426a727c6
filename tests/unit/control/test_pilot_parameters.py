"""The parameter table, its refusals, and gains and predictors changed in flight without a bump."""

from __future__ import annotations

import re
from math import sin

import numpy as np
import pytest
from places import ROOT

from cosim.base.errors import InputError
from cosim.base.frames import from_euler
from cosim.base.protocols import Predictor
from cosim.base.signals import Command, Measured, Unallocated
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.control.autopilot.parameters import Parameters, table
from cosim.control.autopilot.tuning import Blocks, LiveTuning, rate_gains
from cosim.control.predictors.registry import PREDICTORS
from cosim.control.predictors.smith import NoPredictor, SmithPredictor
from cosim.control.rate import RateAxis, RateController
from cosim.spec.vehicle import AltitudeGains, PredictorTuning, RateGains, load_vehicle

DT = 0.004
VEHICLE, _ = load_vehicle("hexjet")
CONTROL = VEHICLE.control
MODEL = VEHICLE.identified["edf-as-flown"]["roll"]


def parameters() -> Parameters:
    return Parameters(table(CONTROL, CONTROL.pilot, "smith", 25.0))


def test_every_line_is_sound() -> None:
    """What MAVLink and QGroundControl need of a parameter, and defaults that are allowed."""
    table = parameters()
    assert len(set(table.values)) == len(list(table))
    for line in table:
        assert 0 < len(line.name) <= 16
        assert line.name.isascii()
        assert line.least <= line.default <= line.most, line.name
        assert line.text
        assert line.group
        assert "\n" not in line.text
        if line.kind == "int":
            assert line.default == int(line.default)
        for value, text in line.values:
            assert line.least <= value <= line.most
            assert text
        assert table.check(line.name, line.default) == line.default


def test_every_line_is_read() -> None:
    """By its name outside the table, or as one of a family that :class:`Live` hands to the loops."""
    sources = [path for room in ("control", "groundstation") for path in (ROOT / "cosim" / room).rglob("*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in sources if path.name != "parameters.py")
    named = set(re.findall(r'"([A-Z][A-Z0-9_]{2,15})"', text))
    families = tuple(f"HJ_{family}_" for family in ("ROLL", "PITCH", "YAW", "ATT", "RLIM", "PRED"))
    mute = [line.name for line in parameters() if not line.read_only and not line.name.startswith(families)]
    assert [name for name in mute if name not in named] == []


def test_defaults_are_the_vehicles_own() -> None:
    """Applying the table's defaults changes nothing."""
    values = parameters().values
    assert rate_gains(CONTROL, values) == [CONTROL.rate.roll, CONTROL.rate.pitch, CONTROL.rate.yaw]
    assert values["HJ_ATT_ROLL"] == CONTROL.attitude.gain_1_s[0]
    assert values["HJ_PRED_TYPE"] == PREDICTORS["smith"].value
    assert not parameters().changed()


def test_what_ground_stations_look_for_is_there() -> None:
    """So that QGroundControl does not send its user to a set-up page, and its buttons find their numbers."""
    values = parameters().values
    assert values["SYS_AUTOSTART"] != 0
    assert values["COM_RC_IN_MODE"] == 1
    assert values["CAL_GYRO0_ID"] != 0
    assert values["CAL_ACC0_ID"] != 0
    assert values["SYS_HAS_MAG"] == values["SYS_HITL"] == 0
    assert {"MIS_TAKEOFF_ALT", "RTL_RETURN_ALT", "MPC_XY_VEL_MAX", "MPC_LAND_SPEED", "SYS_FAILURE_EN"} <= set(values)
    assert not [name for name in values if name.startswith("BAT")]


def test_a_ground_station_may_read_where_the_engines_are() -> None:
    """PX4's names; its KM is positive for a rotor that turns left, whose reaction turns the nose right."""
    vehicle, _ = load_vehicle("quadrotor")
    settings = vehicle.control.pilot
    shown = Parameters(table(vehicle.control, settings, "smith", 0.0, "", vehicle.jets))
    values = shown.values
    assert values["CA_ROTOR_COUNT"] == len([name for name in values if name.endswith("_KM")]) == 4
    for number, jet in enumerate(vehicle.jets):
        assert tuple(values[f"CA_ROTOR{number}_P{letter}"] for letter in "XYZ") == jet.position_m
        assert values[f"CA_ROTOR{number}_KM"] == jet.reaction_m
    assert not [name for name in values if name[:-1].endswith("_A")]  # straight up, as PX4 takes it to be
    bent = [jet.model_copy(update={"axis": (0.0, 0.6, -0.8)}) if n == 1 else jet for n, jet in enumerate(vehicle.jets)]
    values = Parameters(table(vehicle.control, settings, "smith", 0.0, "", bent)).values
    told = {name: value for name, value in values.items() if name[:-1].endswith("_A")}
    assert told == {"CA_ROTOR1_AX": 0.0, "CA_ROTOR1_AY": 0.6, "CA_ROTOR1_AZ": -0.8}
    with pytest.raises(InputError, match=r"CA_ROTOR1_PX = 0\.3: cannot be changed, it is -0\.08"):
        shown.set("CA_ROTOR1_PX", 0.3)


LAST = max(spec.value for spec in PREDICTORS.values())  # of the predictors


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("HJ_NOTHING", 1.0, "unknown parameter 'HJ_NOTHING'"),
        ("HJ_ROLL_P", float("nan"), "HJ_ROLL_P = nan: must be a finite number"),
        ("HJ_ROLL_P", 1.0, "HJ_ROLL_P = 1: must be from 0 to 0.2 s/rad"),
        ("HJ_PRED_TYPE", 1.5, "HJ_PRED_TYPE = 1.5: must be a whole number"),
        ("HJ_PRED_TYPE", LAST + 1.0, f"HJ_PRED_TYPE = {LAST + 1}: must be from 0 to {LAST}"),
        ("SYS_AUTOSTART", 0.0, "SYS_AUTOSTART = 0: cannot be changed, it is 22000"),
    ],
)
def test_a_refused_value_changes_no_parameter(name: str, value: float, complaint: str) -> None:
    table = parameters()
    before = dict(table.values)
    with pytest.raises(InputError) as refusal:
        table.set(name, value)
    assert str(refusal.value) == complaint
    assert table.values == before


def test_a_bound_may_have_been_a_32_bit_float() -> None:
    table = parameters()
    table.set("MPC_LAND_SPEED", float(np.float32(0.1)))
    assert float(np.float32(0.1)) > 0.1
    table.set("HJ_ARM_LEAN", float(np.float32(30.0)) + 1e-6)
    assert table["HJ_ARM_LEAN"] == 30.0


def test_a_vehicle_without_a_model_has_no_predictors() -> None:
    table_ = Parameters(table(CONTROL, CONTROL.pilot, "baseline", None))
    with pytest.raises(InputError, match="HJ_PRED_TYPE = 1: must be from 0 to 0"):
        table_.set("HJ_PRED_TYPE", 1)


def flown(axis: RateAxis, steps: int, start: int = 0) -> list[float]:
    """Commands for a slow measured rate that the axis does not move: what matters is that nothing jumps."""
    return [axis.update(0.3, 0.2 * sin(2.0 * k * DT), 0.0) for k in range(start, start + steps)]


@pytest.mark.parametrize("change", [{"p": 0.06}, {"i": 0.05}, {"d": 0.004}, {"p": 0.0, "i": 0.0, "d": 0.0}])
def test_new_rate_gains_do_not_bump(change: dict[str, float]) -> None:
    """At the change the command is the old law's to the last bit but rounding; then it fades over."""
    gains = RateGains(p=0.02, i=0.01, d=0.001, d_filter_s=0.01, integral_limit=0.1)
    changed, kept = RateAxis(gains, NoPredictor(), DT), RateAxis(gains, NoPredictor(), DT)
    flown(changed, 400)
    flown(kept, 400)
    changed.retune(gains.model_copy(update=change))
    (at_change,), (unchanged,) = flown(changed, 1, 400), flown(kept, 1, 400)
    assert at_change == pytest.approx(unchanged, abs=1e-15)
    before, after = flown(kept, 2000, 401), flown(changed, 2000, 401)
    largest = max(abs(b - a) for a, b in zip([at_change, *after[:-1]], after, strict=True))
    # what both laws move in a step by themselves, and the fading of their difference
    own = max(abs(b - a) for a, b in zip([unchanged, *before[:-1]], before, strict=True))
    factor = max(1.0, *(value / getattr(gains, name) for name, value in change.items()))
    assert largest < own * factor + 0.02 * DT / 0.5
    assert abs(after[-1] - before[-1]) > 1e-6  # there is a new law


def test_new_gains_end_as_if_they_had_always_been() -> None:
    """With the same integral: P alone, so that nothing is remembered."""
    gains = RateGains(p=0.02, i=0.0, d=0.0, d_filter_s=0.01, integral_limit=0.1)
    axis = RateAxis(gains, NoPredictor(), DT)
    flown(axis, 100)
    axis.retune(gains.model_copy(update={"p": 0.03}))
    command = flown(axis, 4000, 100)[-1]
    assert command == pytest.approx(0.03 * (0.3 - 0.2 * sin(2.0 * 4099 * DT)), abs=1e-9)


@pytest.mark.parametrize("d", [0.0, 0.001])
def test_a_new_predictor_does_not_bump_and_has_caught_up(d: float) -> None:
    gains = RateGains(p=0.02, i=0.01, d=d, d_filter_s=0.01, integral_limit=0.1)
    axis = RateAxis(gains, NoPredictor(), DT)
    axis.keep_history(1000)
    commands = flown(axis, 600)
    axis.retune(gains, SmithPredictor(MODEL))
    (bump,) = flown(axis, 1, 600)
    kept = RateAxis(gains, NoPredictor(), DT)
    assert bump == pytest.approx(flown(kept, 601)[-1], abs=1e-15)
    # the new predictor knows what was commanded: told the same from the start, it says the same
    alone, applied = SmithPredictor(MODEL), 0.0
    for k, command in enumerate([*commands, bump]):
        predicted = alone.update(0.2 * sin(2.0 * k * DT), applied)
        applied = command
    assert axis.predicted == pytest.approx(predicted, abs=1e-12)
    after = flown(axis, 1500, 601)
    # the command follows at the pace of the fading and of the predicted rate, and is finite
    assert max(abs(b - a) for a, b in zip([bump, *after[:-1]], after, strict=True)) < 1e-3


def test_two_changes_before_a_step_are_one() -> None:
    gains = RateGains(p=0.02, i=0.01, d=0.0, d_filter_s=0.01, integral_limit=0.1)
    twice, once, kept = (RateAxis(gains, NoPredictor(), DT) for _ in range(3))
    for axis in (twice, once, kept):
        flown(axis, 50)
    twice.retune(gains.model_copy(update={"p": 0.1}))
    twice.retune(gains.model_copy(update={"p": 0.04}))
    once.retune(gains.model_copy(update={"p": 0.04}))
    assert flown(twice, 300, 50) == flown(once, 300, 50)


def test_a_change_during_the_fading_of_another_does_not_bump() -> None:
    gains = RateGains(p=0.02, i=0.01, d=0.0, d_filter_s=0.01, integral_limit=0.1)
    first, second = RateAxis(gains, NoPredictor(), DT), RateAxis(gains, NoPredictor(), DT)
    for axis in (first, second):
        flown(axis, 50)
        axis.retune(gains.model_copy(update={"p": 0.05}))
        flown(axis, 30, 50)
    second.retune(gains)
    assert flown(second, 1, 80) == pytest.approx(flown(first, 1, 80), abs=1e-15)


def measured(roll: float = 0.0, altitude: float = 10.0, climb: float = 0.0) -> Measured:
    return Measured((0.0, 0.0, 0.0), from_euler(roll, 0.05, 0.2), (0.0, 0.0, -altitude), (0.0, 0.0, -climb), altitude)


def test_new_attitude_gains_do_not_bump() -> None:
    law = AttitudeController(CONTROL.attitude)
    command, here = Command((0.3, 0.0, 0.0), 10.0), measured(0.1)
    before = law.update(command, here)
    new = CONTROL.attitude.model_copy(update={"gain_1_s": (7.0, 2.0, 3.0), "rate_limit_rad_s": (0.5, 3.8, 2.0)})
    law.retune(new, DT)
    assert law.update(command, here) == pytest.approx(before, abs=1e-15)
    rates = np.array([law.update(command, here) for _ in range(4000)])
    after = AttitudeController(new).update(command, here)
    assert rates[-1] == pytest.approx(after, abs=1e-9)
    size = np.max(np.abs(np.subtract(after, before)))
    assert np.max(np.abs(np.diff(rates, axis=0, prepend=[before]))) <= size * DT / 0.5


def test_new_height_gains_do_not_bump() -> None:
    def law(gains: AltitudeGains) -> AltitudeController:
        return AltitudeController(gains, VEHICLE.mass_kg, lambda thrust: thrust / 120.0, DT)

    changed, kept = law(CONTROL.altitude), law(CONTROL.altitude)
    command, here = Command((0.0, 0.0, 0.0), 11.0), measured(altitude=10.0, climb=0.3)
    for one in (changed, kept):
        for _ in range(100):
            one.update(command, here, Unallocated())
    new = CONTROL.altitude.model_copy(update={"position_1_s": 1.6, "velocity_1_s": 1.0, "climb_limit_m_s": 0.5})
    changed.retune(new)
    # the integral takes its step with the new law's error: 0.3 m/s less climb rate is asked for
    off = VEHICLE.mass_kg * CONTROL.altitude.integral_1_s2 * 0.3 * DT / 120.0
    usual = kept.update(command, here, Unallocated())
    assert changed.update(command, here, Unallocated()) == pytest.approx(usual, abs=1.1 * off)
    previous, largest = changed.update(command, here, Unallocated()), 0.0
    for _ in range(1000):
        now = changed.update(command, here, Unallocated())
        largest, previous = max(largest, abs(now - previous)), now
    # the fading of 2 m/s^2 and the integral's own run, as a share of 120 N
    assert largest < VEHICLE.mass_kg * (2.0 * DT / 0.5 + CONTROL.altitude.integral_1_s2 * DT) / 120.0


def live() -> tuple[LiveTuning, Parameters, Blocks, list[tuple[str, float, PredictorTuning]]]:
    made: list[tuple[str, float, PredictorTuning]] = []

    def make(name: str, delay: float, tuning: PredictorTuning) -> list[Predictor]:
        if name == "state":
            raise InputError("not this one")
        made.append((name, delay, tuning))
        return [NoPredictor(), NoPredictor(), NoPredictor()]

    rate = RateController((CONTROL.rate.roll, CONTROL.rate.pitch, CONTROL.rate.yaw), [NoPredictor() for _ in "rpy"], DT)
    blocks = Blocks(
        AttitudeController(CONTROL.attitude),
        AltitudeController(CONTROL.altitude, VEHICLE.mass_kg, lambda thrust: thrust / 120.0, DT),
        rate,
        PositionController(CONTROL.position, DT),
        Tracker(1.5, 1.5, DT),
        make,
    )
    table_ = parameters()
    return LiveTuning(table_, CONTROL, blocks, DT), table_, blocks, made


def test_a_parameter_reaches_its_block() -> None:
    """Each is set far off, and the block then answers with it."""
    act, table_, blocks, made = live()
    far, here = Command((0.4, 0.0, 0.2), 12.0), measured()
    act.set("HJ_ATT_ROLL", 1.0)
    act.set("HJ_RLIM_ROLL", 5.0)
    act.set("HJ_ROLL_P", 0.1)
    act.set("HJ_ROLL_I", 0.0)
    act.set("HJ_ALT_P", 0.1)
    act.set("HJ_CLIMB_I", 0.0)
    for _ in range(5000):
        rate = blocks.attitude.update(far, here)
        torque = blocks.rate.update((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), Unallocated())
        collective = blocks.altitude.update(far, here, Unallocated())
    assert rate[0] == pytest.approx(5.0 * np.pi / 180.0, abs=1e-9)
    # P on the whole error, and the integral of the one step in which the old law still held
    assert torque[0] == pytest.approx(0.1, abs=2 * CONTROL.rate.roll.i * DT)
    tilt = 1.0 - 2.0 * (here.attitude[1] ** 2 + here.attitude[2] ** 2)
    wanted = VEHICLE.mass_kg * (9.80665 + CONTROL.altitude.velocity_1_s * 0.1 * 2.0) / tilt / 120.0
    assert collective == pytest.approx(wanted, rel=1e-6)
    act.set("HJ_PRED_TYPE", PREDICTORS["filtered-smith"].value)
    act.set("HJ_PRED_DELAY", 30.5)
    act.set("HJ_PRED_FILT", 0.4)
    assert [each[:2] for each in made] == [("filtered-smith", delay) for delay in (25.0, 30.5, 30.5)]
    assert made[-1][2].filter_s == 0.4
    assert table_.changed().keys() == {
        "HJ_ATT_ROLL", "HJ_RLIM_ROLL", "HJ_ROLL_P", "HJ_ROLL_I", "HJ_ALT_P", "HJ_CLIMB_I", "HJ_PRED_TYPE", "HJ_PRED_DELAY", "HJ_PRED_FILT",
    }  # fmt: skip


def test_what_a_block_refuses_is_not_stored() -> None:
    act, table_, _, made = live()
    with pytest.raises(InputError, match="not this one"):
        act.set("HJ_PRED_TYPE", PREDICTORS["state"].value)
    assert table_["HJ_PRED_TYPE"] == PREDICTORS["smith"].value
    assert not made


def test_the_same_value_again_does_nothing() -> None:
    act, _, _, made = live()
    act.set("HJ_PRED_DELAY", 25.0)
    assert not made
