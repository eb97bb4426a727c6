"""The quadrotor of the predictor comparison: its response, its rotors' signs, its flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim import fly
from cosim.base.errors import InputError
from cosim.control.allocation.allocation import RotorAllocator
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, load_vehicle

STEP = 0.0025
VEHICLE, _ = load_vehicle("quadrotor")
LIMITS = VEHICLE.control.allocation
ALLOCATOR = RotorAllocator(VEHICLE.jets, LIMITS, 1 / 3)


def scenario(**changes: object) -> Scenario:
    base: dict[str, object] = {
        "name": "test", "aircraft": "quadrotor", "engine": "motor", "step_s": STEP, "duration_s": 3.0,
        "sensor_noise": False, "controller": "baseline",
    }  # fmt: skip
    return Scenario.from_table(base | changes, Path(), "test")


def test_swept_roll_response_is_the_papers() -> None:
    """Within 1 dB and 8 deg of G_n(z) from 0.5 to 12 Hz."""
    sweep = {
        "kind": "torque_command", "axis": "roll", "shape": "sweep", "start_s": 1.0, "duration_s": 35.0,
        "amplitude": 0.01, "from_hz": 0.3, "to_hz": 18.0,
    }  # fmt: skip
    log = fly(scenario(duration_s=38.0, disturbance=[sweep])).log
    command = log["torque_roll"] + log["disturbance_torque_roll"] - log["refused_roll"]
    hertz = np.array([0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0])
    kernel = np.exp(-2j * np.pi * hertz[:, None] * log["time_s"])
    z = np.exp(2j * np.pi * hertz * STEP)
    paper = (-0.7549 * z + 0.9393) / (z**2 - 1.8770 * z + 0.8786)
    ratio = (kernel @ log["rate_p_measured_rad_s"]) / (kernel @ command) / paper
    decibel, degrees = np.abs(20 * np.log10(np.abs(ratio))).max(), np.abs(np.degrees(np.angle(ratio))).max()
    assert decibel < 1.0
    assert degrees < 8.0


def test_identified_model_is_the_printed_one() -> None:
    model = VEHICLE.identified["motor"]["roll"]
    assert np.poly(model.poles) == pytest.approx([1.0, -1.8770, 0.8786], rel=1e-12)
    assert model.gain * np.poly(model.zeros) == pytest.approx([-0.7549, 0.9393], rel=1e-12)


def test_torque_commands_turn_the_right_way() -> None:
    for axis, torque in enumerate(np.eye(3) * 0.05):
        throttle, tilt, _ = ALLOCATOR.allocate(1 / 3, tuple(torque))[:3]
        forces = np.array([[0.0, 0.0, -t] for t in throttle])
        moment = np.cross([jet.position_m for jet in VEHICLE.jets], forces).sum(axis=0)
        moment[2] += sum(jet.reaction_m * t for jet, t in zip(VEHICLE.jets, throttle, strict=True))
        assert moment[axis] > 0.0
        assert np.abs(np.delete(moment, axis)).max() < 1e-12
        assert tilt == (0.0, 0.0)


@given(st.floats(-1, 2), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_allocation_stays_inside_and_accounts_for_everything(c: float, roll: float, pitch: float, yaw: float) -> None:
    throttle, _, refused = ALLOCATOR.allocate(c, (roll, pitch, yaw))[:3]
    low, high = LIMITS.throttle_min, LIMITS.throttle_max
    assert all(low <= t <= high for t in throttle)
    front_right, rear_left, front_left, rear_right = throttle
    quarter = 0.25
    given_roll = quarter * (front_left + rear_left - front_right - rear_right)
    given_pitch = quarter * (front_right + front_left - rear_right - rear_left)
    given_yaw = quarter * (front_left + rear_right - front_right - rear_left)
    assert given_roll + refused.roll == pytest.approx(roll, abs=1e-12)
    assert given_pitch + refused.pitch == pytest.approx(pitch, abs=1e-12)
    assert given_yaw + refused.yaw == pytest.approx(yaw, abs=1e-12)
    assert quarter * sum(throttle) + refused.collective == pytest.approx(c, abs=1e-12)


def test_reaction_moment_acts_in_flight() -> None:
    """A yaw doublet turns the vehicle by the rotors' reaction alone."""
    doublet = {"kind": "doublet", "signal": "yaw_deg", "start_s": 0.2, "amplitude": 10.0, "width_s": 2.0}
    run = fly(scenario(duration_s=6.0, command=[doublet]))
    assert run.outcome == "completed"
    assert np.degrees(run.log["yaw_rad"]).max() == pytest.approx(10.0, abs=1.5)


def test_added_delay_is_in_the_ledger_and_the_predictor_knows_it() -> None:
    with build(scenario(controller="smith", added_delay_samples=5)) as simulation:
        rows = {row.owner: row.samples for row in simulation.ledger if row.axis == "roll"}
    assert rows["added_delay_samples"] == 5.0
    doublet = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.2, "amplitude": 15.0, "width_s": 0.5}
    outcomes = {}
    for controller in ("baseline", "smith"):
        run = fly(scenario(controller=controller, added_delay_samples=25, command=[doublet]))
        outcomes[controller] = run.outcome, run.metrics["roll"].oscillation_rad
    assert outcomes["smith"][0] == "completed"
    assert outcomes["smith"][1] is not None
    assert outcomes["smith"][1] < 0.01
    assert outcomes["baseline"][0] == "diverged"


def test_vehicles_that_mix_jets_are_refused() -> None:
    data = VEHICLE.model_dump()
    data["jets"][0]["servo"] = "left"
    with pytest.raises(ValueError, match="either all jets have a servo"):
        Vehicle.model_validate(data)
    spinning_alike = [jet.model_copy(update={"reaction_m": 0.01}) for jet in VEHICLE.jets]
    with pytest.raises(InputError, match="give no yaw moment both ways"):
        RotorAllocator(spinning_alike, LIMITS, 0.3)
