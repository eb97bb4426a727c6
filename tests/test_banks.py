"""Tilting banks turn the body the other way: momentum that is kept, to the last digit, and where the zeros lie."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from cosim.airframe import Airframe
from cosim.banks import Banks
from cosim.errors import InputError
from cosim.flight import fly
from cosim.scenario import Environment, Initial, Scenario
from cosim.signals import ZERO3, Disturbance, State, Vector3
from cosim.vehicle import Vehicle, load_vehicle

STEP = 0.004
NO_AERO = {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}
OFF = [ZERO3] * 6


def turned(course: np.ndarray, inertia: float, imbalance: float = 0.0) -> tuple[Vehicle, list[State]]:
    """A vehicle in free fall whose banks follow ``course`` (rad, left and right), and its states after each step."""
    servo = {"bank_inertia_kg_m2": inertia, "bank_imbalance_kg_m": imbalance}
    vehicle, folder = load_vehicle("hexjet", {"aero": NO_AERO, "servo": servo})
    assert vehicle.servo is not None
    banks = Banks(vehicle.servo, vehicle.jets, STEP)
    frame = Airframe(vehicle, folder, Environment(), STEP, 4, 1)
    try:
        state = frame.reset(Initial(altitude_m=500.0), OFF, ZERO3)
        states = []
        for left, right in course.tolist():
            forces, moment = banks.act(OFF, (left, right), state.rate)
            state = frame.step(forces, Disturbance(), moment)
            states.append(state)
    finally:
        frame.close()
    return vehicle, states


def swing(count: int, apart: bool = False) -> np.ndarray:
    left = 0.3 * np.sin(0.11 * np.arange(1, count + 1)) + 0.05 * np.sin(0.7 * np.arange(1, count + 1))
    return np.stack([left, -left if apart else left], axis=1)


def test_the_banks_and_the_body_keep_their_angular_momentum() -> None:
    """J_yy q = J_b (a1' + a2') after every step, with a' the mean over it; and the body's angle follows the banks'."""
    course, inertia = swing(100), 2e-3
    vehicle, states = turned(course, inertia)
    speeds = np.diff(course, axis=0, prepend=0.0) / STEP
    q = np.array([state.rate[1] for state in states])
    wanted = inertia * speeds.sum(axis=1) / vehicle.inertia_kg_m2[1]
    # the Earth's rate seen by a body that turns: 7e-5 rad/s times the angle
    np.testing.assert_allclose(q, wanted, rtol=1e-9, atol=1e-5)
    assert np.abs(wanted).max() > 0.3
    # its angle is half a step behind the banks', whose mean rate over a step it has at the step's end
    pitch = np.array([state.euler[1] for state in states])
    lean = inertia * course.sum(axis=1) / vehicle.inertia_kg_m2[1]
    middle = 0.5 * (lean + np.concatenate([[0.0], lean[:-1]]))
    # within a step of four runs the rate follows in the third: less than 1.5 changes of q' times a run squared, for good
    change = np.abs(np.diff(np.diff(wanted, prepend=0.0), prepend=0.0)).max() / STEP
    np.testing.assert_allclose(pitch, middle, atol=1.5 * (STEP / 4) ** 2 * change)


def test_banks_that_turn_apart_leave_the_body_alone() -> None:
    _, states = turned(swing(50, apart=True), 2e-3)
    assert max(abs(value) for state in states for value in state.rate) < 1e-5


def test_an_unbalanced_bank_moves_the_body_by_what_it_moves_itself() -> None:
    """m v_x + S d/dt(sin a1 + sin a2) = 0 to first order in the step; apart, the push turns the vehicle in yaw."""
    S, lean = 0.05, 0.05 * np.sin(0.03 * np.arange(1, 201))
    course, slow = np.stack([lean, lean], axis=1), 0.03 * 0.05 / STEP  # rad/s, most
    vehicle, states = turned(course, 0.0, S)
    north = np.array([state.velocity[0] for state in states])
    speed = np.diff(lean, prepend=0.0) / STEP
    # a hundredth: the start at once, and the body, which turns by some thousandths of a rad
    np.testing.assert_allclose(north, -2.0 * S * speed / vehicle.mass_kg, atol=0.02 * S * slow / vehicle.mass_kg)
    # the push acts at the height of the axes and turns the body too
    q = np.array([state.rate[1] for state in states])
    by = -2.0 * S * vehicle.jets[0].position_m[2] / vehicle.inertia_kg_m2[1]
    np.testing.assert_allclose(q, by * speed, atol=0.01 * abs(by) * slow)
    vehicle, states = turned(np.stack([lean, -lean], axis=1), 0.0, S)
    r = np.array([state.rate[2] for state in states])
    # left forward and right back: the push on the left bank goes back, at -y, and turns the nose left
    by = -2.0 * S * vehicle.jets[0].position_m[1] / vehicle.inertia_kg_m2[2]
    np.testing.assert_allclose(r, by * speed, atol=0.01 * abs(by) * slow)
    assert max(abs(state.rate[1]) for state in states) < 1e-3


def test_a_turning_body_feels_the_banks_as_a_rotor() -> None:
    """- omega x h with h = -J (a1' + a2') about y."""
    vehicle, _ = load_vehicle("hexjet", {"servo": {"bank_inertia_kg_m2": 2e-3}})
    assert vehicle.servo is not None
    banks = Banks(vehicle.servo, vehicle.jets, STEP)
    rate: Vector3 = (0.3, -0.2, 0.5)
    banks.act(OFF, (0.004, 0.008), rate)
    forces, moment = banks.act(OFF, (0.008, 0.016), rate)
    h = np.array([0.0, -2e-3 * (1.0 + 2.0), 0.0])
    assert moment == pytest.approx(tuple(-np.cross(rate, h)), abs=1e-12)
    assert forces == OFF


BANKS = {"servo": {"bank_inertia_kg_m2": 0.08}}  # of hexjet-p220, by its README


def test_the_reaction_of_the_full_scale_banks_is_in_the_flight() -> None:
    """From the log alone: J_yy q' is the moment of thrust and drag and of the banks, J_b (a1'' + a2'')."""
    flown = Scenario.load("full-scale-pitch-doublet").replace(duration_s=4.0, sensor_noise=False, expect=[])
    with_banks = fly(flown.replace(vehicle=BANKS))
    without = fly(flown)
    vehicle, _ = load_vehicle("hexjet-p220")
    assert vehicle.servo is not None
    assert vehicle.servo.bank_inertia_kg_m2 == 0.0  # as its page says

    def rest(log, inertia: float) -> np.ndarray:  # type: ignore[no-untyped-def, type-arg]
        """What is left of q' beside the thrust's moment and the banks'."""
        tilt = {side: log[f"tilt_{side}_rad"] for side in ("left", "right")}
        moment = np.zeros(len(log))
        for number, jet in enumerate(vehicle.jets, 1):
            x, _, z = jet.position_m
            a, thrust = tilt[str(jet.servo)], log[f"thrust_{number}_N"]
            moment += thrust * (z * np.sin(a) + x * np.cos(a))
        growth = sum(np.diff(a, n=2, prepend=[0.0, 0.0]) for a in tilt.values()) / STEP**2
        q = log["rate_q_rad_s"]
        return np.asarray(np.diff(q) / STEP * vehicle.inertia_kg_m2[1] - (moment + inertia * growth)[:-1])[2:]

    # intake drag and the drag of the frame are what is left, some N m at a few m/s
    assert np.abs(rest(with_banks.log, 0.08)).max() < 5.0
    assert np.abs(rest(with_banks.log, 0.0)).max() > 15.0
    assert np.abs(rest(without.log, 0.0)).max() < 5.0


def test_the_zeros_of_the_full_scale_vehicle_are_where_its_page_says() -> None:
    vehicle, folder = load_vehicle("hexjet-p220", BANKS)
    assert vehicle.servo is not None
    thrust = vehicle.mass_kg * 9.80665
    zero = sqrt(thrust * vehicle.jets[0].position_m[2] / (2.0 * vehicle.servo.bank_inertia_kg_m2))
    page = (folder / "README.md").read_text()
    assert f"±j {zero:.1f} rad/s (T = {thrust:.1f} N in hover" in page
    assert "0.28 kg m" in page  # 3 x 1.85 kg x 0.05 m
    assert round(3 * 1.85 * 0.05, 2) == 0.28
    assert f"{3 * 1.85 * 0.05 * vehicle.jets[0].position_m[2]:.3f} kg m² from J_b" in page


def test_banks_heavier_than_the_vehicle_are_refused() -> None:
    with pytest.raises(InputError, match=r"servo\.bank_inertia_kg_m2 0\.03: two banks are a part of the vehicle"):
        load_vehicle("hexjet", {"servo": {"bank_inertia_kg_m2": 0.03}})


def test_a_vehicle_that_states_no_bank_flies_as_without() -> None:
    vehicle, _ = load_vehicle("hexjet")
    assert vehicle.servo is not None
    assert not Banks(vehicle.servo, vehicle.jets, STEP).any
