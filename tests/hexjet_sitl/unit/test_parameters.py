"""The vehicle in PX4's and ArduPilot's parameters: what a torque of 1 is there, against closed forms; and the files."""

from __future__ import annotations

import re
from math import atan2, cos, degrees, pi, radians, sqrt

import numpy as np
import pytest
from arducopter_standin import FRAMES
from command_tools import Hexjet

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.control.allocation.allocation import TiltAllocator
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, engine_of, load_vehicle
from hexjet_sitl.firmware_parameters import list_px4_parameters, vehicle_in_throttle
from hexjet_sitl.parameters import (
    ardupilot_parameters,
    ardupilot_script,
    ardupilot_torque_scale,
    parameter_file,
    px4_outputs,
    px4_parameters,
    px4_torque_scale,
)

HEXJET = load_vehicle("hexjet")[0]
QUADROTOR = load_vehicle("quadrotor")[0]


def test_a_torque_of_one_for_px4_with_tilts() -> None:
    """Six equal levers L and thrusts C, two tilts of torque 1: the pseudo-inverse is 1 / (6 C L) and 1/2 each; both are
    divided by sqrt(2)/2, the greater of their root mean squares times sqrt(2); yaw by its own greatest, 1/2."""
    assert HEXJET.servo is not None
    lever = HEXJET.jets[0].position_m[1]
    torque = px4_torque_scale(HEXJET)
    assert torque[0] == pytest.approx(sqrt(2.0) / (6.0 * 6.5 * lever), rel=1e-12)
    assert torque[1] == pytest.approx(HEXJET.servo.range_rad / sqrt(2.0), rel=1e-12)
    assert torque[2] == pytest.approx(HEXJET.servo.range_rad, rel=1e-12)


def test_a_torque_of_one_for_px4_without_tilts() -> None:
    """A square quadrotor: four equal entries a, divided by sqrt(4 a^2 / 2): 0.707 about roll and pitch, 1 about yaw."""
    assert px4_torque_scale(QUADROTOR) == pytest.approx((sqrt(0.5), sqrt(0.5), 1.0), rel=1e-9)


@pytest.mark.parametrize("vehicle", [HEXJET, QUADROTOR], ids=["hexjet", "quadrotor"])
def test_gains_times_a_torque_of_one_are_ours(vehicle: Vehicle) -> None:
    told, ours = px4_parameters(vehicle), vehicle.control.rate
    for axis, gains, worth in zip(
        ("ROLL", "PITCH", "YAW"), (ours.roll, ours.pitch, ours.yaw), px4_torque_scale(vehicle), strict=True
    ):
        assert told[f"MC_{axis}RATE_P"] * worth == pytest.approx(gains.p)
        assert told[f"MC_{axis}RATE_I"] * worth == pytest.approx(gains.i)
    assert told["CA_ROTOR_COUNT"] == len(vehicle.jets)
    assert px4_outputs(vehicle)[f"PWM_MAIN_FUNC{len(vehicle.jets)}"] == 100 + len(vehicle.jets)


def test_the_tilts_of_px4_are_the_banks() -> None:
    told = px4_parameters(HEXJET)
    assert (told["CA_AIRFRAME"], told["CA_SV_TL_COUNT"]) == (8, 2)
    assert [told[f"CA_ROTOR{index}_TILT"] for index in range(6)] == [
        1 if jet.servo == "left" else 2 for jet in HEXJET.jets
    ]
    assert HEXJET.servo is not None
    assert told["CA_SV_TL0_MAXA"] == pytest.approx(degrees(HEXJET.servo.range_rad))
    outputs = px4_outputs(HEXJET)
    assert (outputs["PWM_MAIN_FUNC7"], outputs["PWM_MAIN_FUNC8"]) == (201, 202)


def turned(vehicle: Vehicle, sense: float = 1.0, quarter: bool = False) -> Vehicle:
    """With rotors that turn the other way, or stand on the axes."""
    lever = vehicle.jets[0].position_m[0]
    places = {(1, 1): (0.0, lever), (-1, -1): (0.0, -lever), (1, -1): (lever, 0.0), (-1, 1): (-lever, 0.0)}
    jets = []
    for jet in vehicle.jets:
        x, y, z = jet.position_m
        if quarter:
            x, y = places[round(x / lever), round(y / lever)]
        jets.append(jet.model_copy(update={"position_m": (x, y, z), "reaction_m": sense * jet.reaction_m}))
    return vehicle.model_copy(update={"jets": jets})


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("quarter", [False, True])
def test_a_frame_of_ardupilot_turns_as_the_rotors_do(sense: float, quarter: bool) -> None:
    """By the frames' own rules, as the stand-in has them: where a motor stands, and that it turns the nose as it does."""
    vehicle = turned(QUADROTOR, sense, quarter)
    told = ardupilot_parameters(vehicle, 0.0025)
    motors = FRAMES[int(told["FRAME_TYPE"])]
    for number, jet in enumerate(vehicle.jets, 1):
        angle, turn = motors[int(told[f"SERVO{number}_FUNCTION"]) - 33]
        x, y, _ = jet.position_m
        assert cos(radians(angle - degrees(atan2(y, x)))) == pytest.approx(1.0)
        assert turn * jet.reaction_m > 0.0


def test_rotors_that_no_frame_has_are_refused() -> None:
    jets = [jet.model_copy(update={"reaction_m": 0.0}) for jet in QUADROTOR.jets]
    with pytest.raises(
        InputError, match=r"quadrotor: vehicle\.jets: no frame .* \(reaction_m = 0, 0, 0, 0\); allowed: X;"
    ):
        ardupilot_parameters(QUADROTOR.model_copy(update={"jets": jets}), 0.0025)
    alike = [QUADROTOR.jets[k].model_copy(update={"reaction_m": (-1) ** k * 0.012}) for k in range(4)]
    with pytest.raises(InputError, match="where rotors across the middle turn the same way"):
        ardupilot_parameters(QUADROTOR.model_copy(update={"jets": alike}), 0.0025)


def test_ardupilots_quadrotor() -> None:
    """Half of the motors' range for a torque of 1; and the sticks are the pulses that are sent."""
    told = ardupilot_parameters(QUADROTOR, 0.0025)
    half = 0.5 * (1.0 - QUADROTOR.control.allocation.throttle_min)
    assert told["ATC_RAT_RLL_P"] * half == pytest.approx(QUADROTOR.control.rate.roll.p)
    assert (told["SIM_RATE_HZ"], told["SCHED_LOOP_RATE"]) == (400, 400)
    assert [told[f"RC{n}_{key}"] for n in (1, 2, 3, 4) for key in ("MIN", "MAX", "DZ")] == [1000, 2000, 0] * 4
    assert (told["ATC_ANGLE_MAX"], told["PILOT_Y_RATE"]) == (30.0, 202.0)


def test_ardupilots_file_for_a_board_is_fit_for_a_board(hexjet: Hexjet) -> None:
    """Nothing of the stand: no ranges of sticks, no switches, no arming checks left out; and the gyro's filter is on."""
    said = hexjet("sitl", "params", "ardupilot", "--target", "board").out
    stand = hexjet("sitl", "params", "ardupilot", "--release", "4.6").out
    assert said.startswith("# For a board that flies")
    assert "# Names and units are those since ArduCopter 4.7.\n" in said
    assert stand.startswith("# For the stand, hexjet sitl ardupilot, and for no board")
    assert max(len(line) for line in (said + stand).splitlines()) <= 98  # what ArduPilot reads of a line
    board, told = (
        {line.split(",")[0]: float(line.split(",")[1]) for line in text.splitlines() if line[0] != "#"}
        for text in (said, stand)
    )
    foreign = ("RC", "SIM_", "ARMING", "ANGLE_MAX", "ATC_ANGLE_MAX", "PILOT_")
    assert not [name for name in board if name.startswith(foreign)]
    assert board["INS_GYRO_FILTER"] == round(sqrt(2.0) / (2.0 * pi * HEXJET.sensors.gyro.filter_s)) == 25
    assert (told["INS_GYRO_FILTER"], told["ARMING_CHECK"], told["ATC_ACCEL_R_MAX"]) == (0.0, 0.0, 0.0)
    same = {name.replace("_ACC_", "_ACCEL_") for name in board}
    assert {name for name in told if not name.startswith(foreign)} == same


# AP_MotorsMatrix_6DoF_Scripting: number; roll, pitch, yaw, throttle, forward, right; both ways, order of the motor test
ROW = re.compile(r"Motors_6DoF:add_motor\((\d+), (\S+), (\S+), (\S+), (\S+), 0, 0, (true|false), (\d+)\)")


@pytest.mark.parametrize("name", ["hexjet", "hexjet-100", "hexjet-p220", "octojet"])
def test_a_script_mixes_tilting_banks_as_our_allocation_does(name: str) -> None:
    """By its rows and scales ArduCopter's answer to torques is ours, at hover thrust: throttles and tilts."""
    vehicle = load_vehicle(name)[0]
    assert vehicle.servo is not None
    script, told, jets = ardupilot_script(vehicle), ardupilot_parameters(vehicle, 0.004), len(vehicle.jets)
    assert script is not None
    rows = [(float(r), float(p), float(y), float(t), both == "true") for _, r, p, y, t, both, _ in ROW.findall(script)]
    assert [int(row[0]) for row in ROW.findall(script)] == list(range(jets + 2))
    assert f"init({jets + 2})" in script
    functions = [told[f"SERVO{n}_FUNCTION"] for n in range(1, jets + 3)]
    assert functions == [*range(33, 41), 82, 83, 84, 85][: jets + 2]  # k_motor1 to 8, 9 to 12
    assert (told["FRAME_CLASS"], told["SCR_ENABLE"], told["MOT_YAW_HEADROOM"]) == (16, 1, 0)
    limits = vehicle.control.allocation
    ours = TiltAllocator(vehicle.jets, limits, vehicle.servo.range_rad, 0.5)
    scale = ardupilot_torque_scale(vehicle)
    torque = (0.03, 0.05, -0.02)
    flown = ours.allocate(0.5, torque)
    for k, (roll, pitch, yaw, throttle, both) in enumerate(rows):
        asked = [value / one for value, one in zip(torque, scale, strict=True)]
        stick = (0.5 - limits.throttle_min) / (1.0 - limits.throttle_min)
        thrust = throttle * stick + roll * asked[0] + pitch * asked[1] + yaw * asked[2]
        if both:
            assert thrust * vehicle.servo.range_rad == pytest.approx(flown.tilt[k - jets])
        else:
            assert limits.throttle_min + (1.0 - limits.throttle_min) * thrust == pytest.approx(flown.throttle[k])


def test_a_script_is_for_tilting_banks_alone(hexjet: Hexjet) -> None:
    assert ardupilot_script(QUADROTOR) is None
    done = hexjet("sitl", "params", "ardupilot", "--script")
    assert (done.status, done.out) == (0, ardupilot_script(HEXJET))
    done = hexjet("sitl", "params", "ardupilot", "--script", "--aircraft", "quadrotor")
    assert (done.status, "quadrotor: has no tilting banks" in done.err) == (2, True)
    done = hexjet("sitl", "params", "px4", "--script")
    assert (done.status, "script: px4 has none; allowed is ardupilot" in done.err) == (2, True)
    many = HEXJET.model_copy(update={"jets": list(HEXJET.jets) * 2})
    with pytest.raises(InputError, match="hexjet: 12 engines and two tilts; allowed are 12 outputs at most"):
        ardupilot_parameters(many, 0.004)


def test_the_files(hexjet: Hexjet) -> None:
    """For PX4 counts are whole numbers and the rest is real, whatever its value; what is not to be had is one line."""
    lines = [line.split("\t") for line in parameter_file("px4", px4_parameters(HEXJET)).splitlines() if line[0] != "#"]
    kinds = {name: kind for _, _, name, _, kind in lines}
    assert (kinds["CA_ROTOR_COUNT"], kinds["CA_ROTOR0_TILT"], kinds["CA_ROTOR0_PX"], kinds["MC_PITCHRATE_D"]) == (
        "6",
        "6",
        "9",
        "9",
    )
    done = hexjet("sitl", "params", "ardupilot", "--aircraft", "quadjet")
    assert done.status == 2
    assert done.err.splitlines()[-1].startswith("hexjet: ardupilot: quadjet: is flown by effectiveness")
    for aircraft, said in (("octojet", "8 engines and 2 servos, and Betaflight has 8"), ("trijet", "by effectiveness")):
        done = hexjet("sitl", "params", "betaflight", "--aircraft", aircraft)
        assert (done.status, done.out, said in done.err) == (2, "", True)
    done = hexjet("sitl", "params", "betaflight", "--aircraft", "quadrotor")
    assert done.status == 0
    assert done.out.splitlines()[0].startswith("# For the stand, hexjet sitl betaflight, and for no board")
    assert next(line for line in done.out.splitlines() if line[0] != "#") == "mixer CUSTOM"
    assert done.out.splitlines()[-1] == "save"


@pytest.mark.parametrize(("aircraft", "turned"), [("hexjet-100", {"roll"}), ("hexjet", set())])
def test_gains_are_of_the_throttle_where_an_engines_curve_is_bent(aircraft: str, turned: set[str]) -> None:
    """A share of thrust is as much throttle as the curve says around hover, for which no mixer of theirs is bent; tilts
    are tilts."""
    scenario = Scenario.load("hover").replace(aircraft=aircraft, engine=engine_of(aircraft) or "edf")
    ours, theirs = scenario.resolved_vehicle()[0], vehicle_in_throttle(scenario)
    curve = load_engine(scenario.engine, {}, scenario.step_s).curve
    weight = ours.mass_kg * GRAVITY / len(ours.jets)
    span = curve.thrust[-1] - curve.thrust[0]
    low, high = (np.interp(weight + way * span, curve.thrust, curve.throttle) for way in (-0.02, 0.02))
    slope = (high - low) / 0.04
    for axis in ("roll", "pitch", "yaw"):
        before, after = (getattr(vehicle.control.rate, axis) for vehicle in (ours, theirs))
        for name in ("p", "i", "d"):
            assert getattr(after, name) == pytest.approx(
                getattr(before, name) * (slope if axis in turned else 1.0), rel=0.01
            )
    assert (abs(slope - 1.0) > 0.05) == bool(turned)
    told = list_px4_parameters(scenario, scenario.step_s)
    assert told["MC_ROLLRATE_P"] == px4_parameters(theirs)["MC_ROLLRATE_P"]
