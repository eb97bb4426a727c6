"""Tilting banks turn the body the other way: momentum that is kept, to the last digit, and where the zeros lie."""

from __future__ import annotations

from contextlib import closing
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from loads import acted

from cosim import fly
from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Disturbance, State, Vector3
from cosim.engine import load_engine
from cosim.identify.sweep import identify_axis
from cosim.spec.scenario import Environment, Initial, Scenario
from cosim.spec.vehicle import Vehicle, load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.effects.banks import Banks
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels
from hexjet_design.loop.dynamics import make_lag_dynamics

STEP = 0.004
NO_AERO = {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}
OFF = [ZERO3] * 6


def turned(course: np.ndarray, inertia: float, imbalance: float = 0.0) -> tuple[Vehicle, list[State]]:
    """A vehicle in free fall whose banks follow ``course`` (rad, left and right), and its states after each step."""
    servo = {"bank_inertia_kg_m2": inertia, "bank_imbalance_kg_m": imbalance}
    vehicle, folder = load_vehicle("hexjet", {"aero": NO_AERO, "servo": servo})
    banks = Banks(vehicle.servo, vehicle.jets, STEP)
    with closing(Airframe(vehicle, folder, Environment(), STEP, 4, 1)) as frame:
        state = frame.reset(Initial(altitude_m=500.0), OFF, ZERO3)
        states = []
        for left, right in course.tolist():
            forces, moment = acted(banks, OFF, (left, right), rate=state.rate)
            state = frame.step(forces, Disturbance(), moment)
            states.append(state)
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
    banks = Banks(vehicle.servo, vehicle.jets, STEP)
    rate: Vector3 = (0.3, -0.2, 0.5)
    acted(banks, OFF, (0.004, 0.008), rate=rate)
    forces, moment = acted(banks, OFF, (0.008, 0.016), rate=rate)
    h = np.array([0.0, -2e-3 * (1.0 + 2.0), 0.0])
    assert moment == pytest.approx(tuple(-np.cross(rate, h)), abs=1e-12)
    assert forces == OFF


WITHOUT = {"servo": {"bank_inertia_kg_m2": 0.0}}


def test_the_reaction_of_the_full_scale_banks_is_in_the_flight() -> None:
    """From the log alone: J_yy q' is the moment of thrust and drag and of the banks, J_b (a1'' + a2'')."""
    flown = Scenario.load("full-scale-pitch-doublet").replace(duration_s=4.0, sensor_noise=False, expect=[])
    with_banks = fly(flown)
    without = fly(flown.replace(vehicle=WITHOUT))
    vehicle, _ = load_vehicle("hexjet-p220")
    assert vehicle.servo.bank_inertia_kg_m2 == 0.08  # as its page says

    def rest(log, inertia: float) -> np.ndarray:
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


def pitch_of(aircraft: str, engine: str, **servo: float) -> tuple[Vehicle, Channel]:
    """The pitch channel as ``hexjet design`` composes it; the engine's dynamics are not in it."""
    table = {"name": "x", "duration_s": 1.0, "aircraft": aircraft, "engine": engine, "vehicle": {"servo": servo}}
    scenario = Scenario.from_table(table, Path(), "x")
    vehicle, _ = load_vehicle(aircraft, scenario.vehicle)
    spec = load_engine(engine, {}, scenario.step_s)
    none = Actuator.of(engine, make_lag_dynamics([0.0], 0.0, scenario.step_s))
    return vehicle, channels(scenario, vehicle, spec, none)["pitch"]


@pytest.mark.parametrize(
    ("aircraft", "engine", "inertia", "below"),
    [("hexjet-p220", "p220", 0.08, True), ("hexjet-100", "turbine-100", 0.03, True), ("hexjet", "edf", 2e-3, False)],
)
def test_the_zeros_of_a_designs_channel_are_newtons(aircraft: str, engine: str, inertia: float, below: bool) -> None:
    """T z a + 2 J (a_k - 2 a_k-1 + a_k-2) / T^2 is nothing at 1 - 1/z = +-j w0 T, w0^2 = T z / 2 J: exactly.
    Jets above the centre of gravity turn the vehicle the other way, and the zeros are real: 1 - 1/z = +-w0 T."""
    vehicle, pitch = pitch_of(aircraft, engine, bank_inertia_kg_m2=inertia)
    lever = abs(vehicle.jets[0].position_m[2])
    turn = sqrt(vehicle.mass_kg * 9.80665 * lever / (2.0 * inertia)) * pitch.step
    wanted = [1.0 / (1.0 - side * (1j if below else 1.0) * turn) for side in (1.0, -1.0)]
    assert (vehicle.jets[0].position_m[2] > 0.0) == below
    for z in wanted:
        assert abs(pitch.responses(np.array([z]))[0][0]) < 1e-9
        assert min(abs(z - zero) for zero in pitch.model("x").all_zeros) < 1e-9
    # far above them the tilt turns the body by the ratio of the inertias: 2 J a'' / J_yy, the servo and the gyro apart
    z = np.array([-1.0 + 0.0j])
    plain = pitch_of(aircraft, engine, bank_inertia_kg_m2=0.0)[1]
    ratio = (pitch.responses(z)[0] / plain.responses(z)[0])[0]
    assert ratio == pytest.approx(1.0 + (4.0 if below else -4.0) / turn**2, rel=1e-9)


def test_a_sweep_in_flight_finds_the_designs_channel_with_its_banks() -> None:
    """``hexjet identify pitch`` in six degrees of freedom, below, in and above the dip at the zeros.
    Within 2 % of the thrust's part and the whole together: fuel burns, so the collective falls, and the allocation tilts
    by 0.4 % (at first) to 1.4 % more for the same moment of the thrust; the reaction is as much larger."""
    found = identify_axis("pitch", "hexjet-p220", "p220", settings=["sensor_noise=false"], from_hz=1.0, to_hz=12.0)
    response = found.response
    z = np.exp(2j * np.pi * response.hertz * response.step)
    vehicle, pitch = pitch_of("hexjet-p220", "p220")
    assert vehicle.servo.bank_inertia_kg_m2 > 0.0
    told, thrust = pitch.responses(z)[0], pitch_of("hexjet-p220", "p220", bank_inertia_kg_m2=0.0)[1].responses(z)[0]
    use = response.coherence > 0.95
    zero = 24.1 / (2.0 * np.pi)
    for part in (response.hertz < 0.8 * zero, abs(response.hertz / zero - 1.0) < 0.1, response.hertz > 1.2 * zero):
        assert (use & part).sum() > 1
    off = np.abs(told - response.value) / (np.abs(thrust) + np.abs(told))
    assert off[use].max() < 0.02
    assert np.abs(told / thrust).min() < 0.15  # the dip
    assert np.abs(told / thrust).max() > 8.0  # and what comes after it


def test_a_servo_stated_whole_before_there_were_banks_has_none() -> None:
    """A scenario that names every number of its servo flies as it was; one that names a part takes the aircraft's."""
    whole = {"lag_s": 0.05, "rate_limit_rad_s": 4.0, "range_rad": 0.5}
    for stated, inertia in ((whole, 0.0), (whole | {"bank_inertia_kg_m2": 0.05}, 0.05), ({"lag_s": 0.04}, 0.08)):
        vehicle, _ = load_vehicle("hexjet-p220", {"servo": stated})
        assert vehicle.servo.bank_inertia_kg_m2 == inertia


def test_banks_heavier_than_the_vehicle_are_refused() -> None:
    with pytest.raises(InputError, match=r"servo\.bank_inertia_kg_m2 0\.03: two banks are a part of the vehicle"):
        load_vehicle("hexjet", {"servo": {"bank_inertia_kg_m2": 0.03}})


def test_a_vehicle_that_states_no_bank_flies_as_without() -> None:
    vehicle, _ = load_vehicle("hexjet")
    assert not Banks(vehicle.servo, vehicle.jets, STEP).is_active
