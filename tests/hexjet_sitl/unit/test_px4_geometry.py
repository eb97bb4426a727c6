"""What PX4's mixer does with our parameters, against r x F of the vehicle's own jets: signs, sizes, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet
from px4_program import DEFAULTS, configured, mixer

from cosim.base.errors import InputError
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Jet, Vehicle, aircraft_names, engine_of, load_vehicle
from hexjet_export.controller.form import make_form
from hexjet_sitl.lockstep import Setup
from hexjet_sitl.parameters import (
    PX4_OF_SOME_RELEASES,
    PX4_TARGETS,
    px4_link,
    px4_parameters,
    px4_target,
    px4_torque_scale,
)
from hexjet_sitl.prepare import prepare
from hexjet_sitl.px4 import Px4, check_unknown_parameters, invert_yaw_curve

VEHICLES = [load_vehicle(name)[0] for name in sorted(aircraft_names())]
TOLD = [vehicle for vehicle in VEHICLES if vehicle.allocation != "effectiveness"]
STEP = 0.004


def moment(vehicle: Vehicle, thrusts: list[float], tilts: tuple[float, float]) -> np.ndarray:
    """About the centre of gravity, of jets that are tilted forward by their bank's angle: the sum of r x F, and the
    reaction of rotors about their axis, which a positive ``reaction_m`` turns to the right."""
    total = np.zeros(3)
    for jet, thrust in zip(vehicle.jets, thrusts, strict=True):
        angle = {"left": tilts[0], "right": tilts[1], None: 0.0}[jet.servo]
        total += np.cross(jet.position_m, thrust * np.array([sin(angle), 0.0, -cos(angle)]))
        total[2] += jet.reaction_m * thrust
    return total


@pytest.mark.parametrize("vehicle", TOLD, ids=lambda vehicle: vehicle.name)
@pytest.mark.parametrize("axis", [0, 1, 2], ids=["roll", "pitch", "yaw"])
def test_a_torque_of_px4s_is_a_moment_of_that_sign_and_of_no_other_axis(vehicle: Vehicle, axis: int) -> None:
    """Its mixer by rules of its own, on our parameters; the moment by the vehicle's real places, x and all."""
    mix = mixer(DEFAULTS | px4_parameters(vehicle))
    jets, torque = len(vehicle.jets), 0.01 * np.eye(3)[axis]
    given = mix @ np.array([*torque, 0.5])
    size = 0.0 if vehicle.servo is None else vehicle.servo.range_rad
    tilts = tuple(size * given[jets:]) if vehicle.servo else (0.0, 0.0)
    made = moment(vehicle, list(given[:jets]), tilts) - moment(vehicle, [float(given[:jets].mean())] * jets, (0.0, 0.0))
    assert made[axis] > 0.0
    others = np.delete(np.abs(made), axis)
    assert others.max() < 1e-3 * made[axis]


@pytest.mark.parametrize("vehicle", TOLD, ids=lambda vehicle: vehicle.name)
def test_a_torque_of_one_is_what_its_mixer_makes_of_it(vehicle: Vehicle) -> None:
    mix, jets = mixer(DEFAULTS | px4_parameters(vehicle)), len(vehicle.jets)
    roll, pitch, yaw = px4_torque_scale(vehicle)
    assert np.abs(mix[:jets, 0]).max() == pytest.approx(roll, rel=1e-6)
    size = 1.0 if vehicle.servo is None else vehicle.servo.range_rad
    of = slice(jets, None) if vehicle.servo else slice(0, jets)
    assert size * np.abs(mix[of, 1]).max() == pytest.approx(pitch, rel=1e-6)
    assert size * np.abs(mix[of, 2]).max() == pytest.approx(yaw, rel=1e-6)
    assert mix[:jets, 3] == pytest.approx([1.0] * jets)  # and the thrust of full throttle is full throttle of all


def test_jets_above_and_below_are_told_apart() -> None:
    above, below = px4_parameters(load_vehicle("hexjet")[0]), px4_parameters(load_vehicle("hexjet-p220")[0])
    assert (above["CA_SV_TL0_TD"], above["CA_SV_TL1_TD"], below["CA_SV_TL0_TD"], below["CA_SV_TL1_TD"]) == (
        0,
        0,
        180,
        180,
    )
    sides = [jet.servo for jet in load_vehicle("hexjet-p220")[0].jets]
    assert [below[f"CA_ROTOR{n}_TILT"] for n in range(6)] == [1 if side == "right" else 2 for side in sides]


def moved(change: Callable[[Jet, tuple[float, float, float]], tuple[float, float, float]]) -> Vehicle:
    vehicle = load_vehicle("hexjet")[0]
    jets = [jet.model_copy(update={"position_m": change(jet, jet.position_m)}) for jet in vehicle.jets]
    return vehicle.model_copy(update={"jets": jets})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda jet, r: (r[0], r[1], 0.05 if jet.servo == "left" else -0.08),
            r"stand below \(left\) and above \(right\)",
        ),
        (lambda jet, r: (r[0], r[1], 0.0), r"stand at the height of \(left\) and at the height of \(right\)"),
        (lambda jet, r: (r[0], -r[1], r[2]), r"the left bank's jet at x = -0\.13 m stands at y = 0\.15 m"),
        (lambda jet, r: (r[0], 0.06 * r[1], r[2]), r"stands at y = -0\.009 m; PX4 takes a tilt's yaw from its side"),
    ],
    ids=["mixed", "level", "crossed", "middle"],
)
def test_banks_that_px4_has_no_words_for_are_refused(
    change: Callable[[Jet, tuple[float, float, float]], tuple[float, float, float]], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        px4_parameters(moved(change))


def test_more_engines_than_it_allocates_are_refused() -> None:
    vehicle = load_vehicle("octojet")[0]
    with pytest.raises(InputError, match="px4: octojet: has 16 engines; allowed are 12 at most"):
        px4_parameters(vehicle.model_copy(update={"jets": [*vehicle.jets, *vehicle.jets]}))


def test_its_estimator_runs_at_every_step() -> None:
    """At the rates of steps that vehicles have; the answer to a sample waits for it."""
    for step in (0.001, 0.0025, 1.0 / 300.0, 0.004, 0.005, 0.01, 0.02):
        told = px4_link(step)["IMU_INTEG_RATE"]
        assert 100 <= told <= 1000  # its limits
        assert max(1, round(1.0 / (told * step))) == 1  # samples to one of its runs
    with pytest.raises(InputError, match=r"step_s = 0\.0005: its estimator takes 1000 samples a second at most"):
        px4_link(0.0005)


@pytest.mark.parametrize("vehicle", TOLD, ids=lambda vehicle: vehicle.name)
def test_its_program_has_every_name_that_is_told_to_it(vehicle: Vehicle, capsys: pytest.CaptureFixture[str]) -> None:
    """And as many digits as its single precision has."""
    told = px4_target(vehicle, STEP, "sitl")
    values = configured({f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in told.items()})
    printed = capsys.readouterr().out
    assert [name for name in told if f"Parameter {name} not found" in printed] == ["EKF2_GPS_DELAY"]
    here = {name: value for name, value in told.items() if name in values}
    assert {name: values[name] for name in here} == {name: float(np.float32(value)) for name, value in here.items()}


def test_a_name_of_another_release_is_missed_by_who_states_it_alone(tmp_path: Path) -> None:
    log = tmp_path / "px4.log"
    log.write_text("ERROR [param] Parameter EKF2_GPS_DELAY not found.\n")
    told, setup = px4_target(TOLD[0], STEP, "sitl"), Setup(parameters={"EKF2_GPS_DELAY": 10.0})
    check_unknown_parameters(log, told, PX4_OF_SOME_RELEASES)
    hover = Scenario.load("hover")
    ours, stated = (prepare("px4", hover, tmp_path, None, how) for how in (Setup(), setup))
    assert isinstance(ours, Px4)
    assert isinstance(stated, Px4)
    check_unknown_parameters(log, told, ours.optional)
    with pytest.raises(InputError, match="EKF2_GPS_DELAY: this PX4 has none of that name"):
        check_unknown_parameters(log, told, stated.optional)
    log.write_text("ERROR [param] Parameter MAN_DEADZONE not found.\n")
    said = r"MAN_DEADZONE: this PX4 has none of that name.*; the first PX4 that is flown is 1\.17"
    with pytest.raises(InputError, match=said):
        check_unknown_parameters(log, told, ours.optional)


def test_a_target_is_told_of_what_it_has(hexjet: Hexjet) -> None:
    """HIL_ACT_FUNCn is of a board in the loop alone; a board that flies keeps its own radio and its estimator's pace."""
    vehicle = load_vehicle("hexjet")[0]
    sitl, hil, board = (px4_target(vehicle, STEP, target) for target in PX4_TARGETS)
    assert ("HIL_ACT_FUNC1" in sitl, "HIL_ACT_FUNC1" in hil, "HIL_ACT_FUNC1" in board) == (False, True, False)
    assert ("PWM_MAIN_FUNC8" in sitl, "PWM_MAIN_FUNC8" in hil, "PWM_MAIN_FUNC8" in board) == (True, False, True)
    link = set(px4_link(STEP))
    assert (link <= set(sitl), link <= set(hil), link & set(board)) == (True, True, set())
    done = hexjet("sitl", "params", "px4", "--target", "board")
    assert done.status == 0
    assert done.out.startswith("# For a board that flies")
    assert "PWM_MAIN_FUNC1\t101\t6" in done.out
    assert "RC_MAP" not in done.out
    assert hexjet("sitl", "params", "px4").out.startswith("# For the stand")
    done = hexjet("sitl", "params", "ardupilot", "--target", "hil", "--aircraft", "quadrotor")
    assert (done.status, "target hil: allowed for ardupilot: sitl, board" in done.err) == (2, True)
    assert "IMU_INTEG_RATE\t400\t6" in hexjet("sitl", "params", "px4", "--rate", "400").out


def test_a_board_filters_its_gyro_as_late_as_the_vehicles_is() -> None:
    """By the analogue filter of second order that PX4 states, at a tenth of the vehicle's corner; and never with 0 Hz,
    which switches it off.  What the stand sends is filtered already."""
    vehicle = load_vehicle("hexjet")[0]
    stand, board = (px4_target(vehicle, STEP, target) for target in ("sitl", "board"))
    assert stand["IMU_GYRO_CUTOFF"] == 0.0
    w, corner = 0.1 / vehicle.sensors.gyro.filter_s, 2.0 * np.pi * board["IMU_GYRO_CUTOFF"]
    lag = np.arctan2(np.sqrt(2.0) * w / corner, 1.0 - (w / corner) ** 2)
    assert lag / w == pytest.approx(vehicle.sensors.gyro.filter_s, rel=0.01)
    plain = vehicle.sensors.model_copy(update={"gyro": vehicle.sensors.gyro.model_copy(update={"filter_s": 0.0})})
    assert "IMU_GYRO_CUTOFF" not in px4_target(vehicle.model_copy(update={"sensors": plain}), STEP, "board")


def test_the_yaw_stick_undoes_what_px4_bends() -> None:
    for turn in np.linspace(-1.0, 1.0, 41):
        stick = invert_yaw_curve(float(turn))
        assert 0.4 * stick + 0.6 * stick**3 == pytest.approx(turn, abs=1e-12)
    assert (invert_yaw_curve(3.0), invert_yaw_curve(-3.0)) == pytest.approx((1.0, -1.0))


@pytest.mark.parametrize("vehicle", TOLD, ids=lambda vehicle: vehicle.name)
def test_what_an_exported_controller_takes_for_a_torque_is_that_torque_to_the_mixer(vehicle: Vehicle) -> None:
    """Its rows turn throttles and tilts back to torques; the mixer, with our parameters, makes these of a torque."""
    scenario = Scenario.load("hover").replace(
        aircraft=vehicle.name, engine=engine_of(vehicle.name), controller="baseline"
    )
    with build(scenario) as simulation:
        back = np.array(make_form(simulation)["allocation"]["inverse"])
    mix, jets = mixer(DEFAULTS | px4_parameters(vehicle)), len(vehicle.jets)
    size = np.ones(mix.shape[0])
    size[jets:] = 0.0 if vehicle.servo is None else vehicle.servo.range_rad
    told = back @ np.vstack([size[:, None] * mix[:, :3], np.zeros((back.shape[1] - mix.shape[0], 3))])
    assert told / np.array(px4_torque_scale(vehicle))[:, None] == pytest.approx(np.eye(3), abs=1e-6)
