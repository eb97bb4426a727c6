"""A payload that comes or goes and fuel that is burnt, against closed forms of rigid bodies."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from math import pi

import numpy as np
import pytest

from cosim.base.frames import from_euler, rotate
from cosim.base.signals import ZERO3, Disturbance, State, Vector3
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.mass_change import find_centre

STEP = 0.004
STILL = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}}
OFF: list[Vector3] = [ZERO3] * 6
MASS, PLACE = 1.0, (0.2, 0.1, 0.0)
LOADED, CALM = Disturbance(payload=(MASS, *PLACE)), Disturbance()


@contextmanager
def airframe(overrides: dict | None = None, air: Environment | None = None, substeps: int = 4) -> Iterator[Airframe]:
    vehicle, folder = load_vehicle("hexjet", {**STILL, **(overrides or {})})
    with closing(Airframe(vehicle, folder, air or Environment(), STEP, substeps, 1)) as frame:
        yield frame


def fly(initial: Initial, forces: list[Vector3], course: list[Disturbance], substeps: int = 4) -> list[State]:
    """The motion at the start and after every step."""
    with airframe(substeps=substeps) as frame:
        return [frame.reset(initial, forces, ZERO3), *(frame.step(forces, held) for held in course)]


def apart(one: State, other: State) -> tuple[np.ndarray, np.ndarray]:
    return np.subtract(one.position, other.position), np.subtract(one.velocity, other.velocity)


def test_a_spinning_body_takes_up_a_load_and_lets_go_of_it() -> None:
    """Free fall with a spin about z: no force but weight, so each centre of gravity flies on by itself.
    The body keeps turning and the load takes hold at its velocity, so the centre of both begins at ``c`` with
    ``omega x c``; when the load lets go the body has that velocity less ``omega x c`` as it stands then.  Against the
    same fall without a load, so that of the Earth's rotation a hundred-thousandth is left."""
    spin, steps = pi, 100
    initial = Initial(altitude_m=100.0, attitude_deg=(0.0, 0.0, 30.0), rate_deg_s=(0.0, 0.0, np.degrees(spin)))
    carried = fly(initial, OFF, [LOADED] * steps + [CALM] * steps)
    alone = fly(initial, OFF, [CALM] * (2 * steps))
    vehicle, _ = load_vehicle("hexjet")
    centre = find_centre(vehicle.mass_kg, [(MASS, PLACE)])
    assert centre == pytest.approx(np.array(PLACE) * MASS / (MASS + vehicle.mass_kg))

    def seen(angle: float) -> tuple[np.ndarray, np.ndarray]:
        """The centre from the body's origin, and omega x it, NED."""
        x, y, z = rotate(from_euler(0.0, 0.0, angle), centre)
        return np.array([x, y, z]), np.array([-spin * y, spin * x, 0.0])

    begin, speed = seen(pi / 6)
    end, fast = seen(pi / 6 + spin * steps * STEP)
    assert np.linalg.norm(speed) > 0.1
    for k in (1, steps):
        place, velocity = apart(carried[k], alone[k])
        np.testing.assert_allclose(velocity, speed, atol=2e-5)
        np.testing.assert_allclose(place, begin + speed * k * STEP, atol=2e-5)
    for k in (1, steps):
        place, velocity = apart(carried[steps + k], alone[steps + k])
        np.testing.assert_allclose(velocity, speed - fast, atol=2e-5)
        np.testing.assert_allclose(place, begin + speed * (steps + k) * STEP - end - fast * k * STEP, atol=2e-5)
        assert carried[steps + k].rate == pytest.approx((0.0, 0.0, spin), abs=2e-4)


@pytest.mark.parametrize("substeps", [2, 4, 8])
def test_acceleration_jumps_at_once_with_mass_and_inertia(substeps: int) -> None:
    """From rest with constant thrust: after the first step rate and velocity are the new acceleration times the step."""
    vehicle, _ = load_vehicle("hexjet")
    lift: list[Vector3] = [(0.0, 0.0, -vehicle.mass_kg * 9.8 / 6.0)] * 6
    initial = Initial(altitude_m=100.0)
    one, free = (fly(initial, forces, [LOADED], substeps)[1] for forces in (lift, OFF))
    total = vehicle.mass_kg + MASS
    place, centre = np.array(PLACE), np.array(PLACE) * MASS / total
    reduced = vehicle.mass_kg * MASS / total
    inertia = np.diag(vehicle.inertia_kg_m2) + reduced * (place @ place * np.eye(3) - np.outer(place, place))
    arms = [np.array(jet.position_m) - centre for jet in vehicle.jets]
    moment = sum(np.cross(arm, force) for arm, force in zip(arms, lift, strict=True))
    np.testing.assert_allclose(np.subtract(one.rate, free.rate), np.linalg.solve(inertia, moment) * STEP, atol=2e-5)
    np.testing.assert_allclose(apart(one, free)[1][2], np.sum(lift, axis=0)[2] / total * STEP, rtol=1e-6)


def test_letting_go_with_thrust_on_is_felt_at_once() -> None:
    """The body has its own mass from the step on in which the load lets go, and turns on as it did."""
    vehicle, _ = load_vehicle("hexjet")
    lift: list[Vector3] = [(0.0, 0.0, -vehicle.mass_kg * 9.8 / 6.0)] * 6
    under = Disturbance(payload=(MASS, 0.0, 0.0, 0.0))
    states = fly(Initial(altitude_m=100.0), lift, [under] * 5 + [CALM] * 5)
    frees = fly(Initial(altitude_m=100.0), OFF, [under] * 5 + [CALM] * 5)
    gained = np.array([apart(a, b)[1][2] for a, b in zip(states, frees, strict=True)])
    push = np.sum(lift, axis=0)[2] * STEP
    expected = [push / (vehicle.mass_kg + MASS)] * 5 + [push / vehicle.mass_kg] * 5
    np.testing.assert_allclose(np.diff(gained), expected, rtol=1e-6)


def test_fuel_is_lacking_from_the_step_on_in_which_it_is_burnt() -> None:
    """The impulse of a constant thrust on a mass that falls from step to step."""
    burn, steps = 0.01, 50
    tank = {"fuel": {"mass_kg": 1.0, "position_m": [0.0, 0.0, 0.0]}}
    with airframe(tank) as frame:
        gained = []
        for newtons in (-9.0, 0.0):
            forces: list[Vector3] = [(0.0, 0.0, newtons)] * 6
            frame.reset(Initial(altitude_m=100.0), forces, ZERO3)
            for k in range(1, steps + 1):
                frame.prepare_step(ZERO3, k * burn)
                state = frame.step(forces, CALM)
            gained.append(state.velocity[2])
    mass = load_vehicle("hexjet", tank)[0].mass_kg - burn * np.arange(1, steps + 1)
    assert gained[0] - gained[1] == pytest.approx(-54.0 * STEP * np.sum(1.0 / mass), rel=2e-6)


def test_on_the_ground_the_legs_stay_where_they_stand() -> None:
    """A load below the body moves the centre of gravity, not the vehicle."""
    initial = Initial(on_ground=True)
    low = Disturbance(payload=(1.0, 0.0, 0.0, 0.1))
    states = fly(initial, OFF, [CALM] * 50 + [low])
    shift = find_centre(load_vehicle("hexjet")[0].mass_kg, [(1.0, (0.0, 0.0, 0.1))])
    assert states[-1].on_ground
    np.testing.assert_allclose(np.subtract(states[-1].position, states[-2].position), shift, atol=2e-4)
    assert states[-1].altitude - states[-2].altitude == pytest.approx(-shift[2], abs=2e-4)


def test_turbulence_goes_on_as_it_was() -> None:
    """No time passes while forces are evaluated anew, and no random number is drawn."""
    rough = Environment(turbulence_severity=3, turbulence_wind_m_s=5.0)
    initial = Initial(altitude_m=100.0, velocity_ned_m_s=(10.0, 0.0, 0.0))
    courses = []
    for load in (CALM, Disturbance(payload=(1e-6, 0.0, 0.0, 0.0))):
        with airframe(air=rough) as frame:
            frame.reset(initial, OFF, ZERO3)
            courses.append([frame.step(OFF, held) for held in [CALM] * 20 + [load] * 20])
    for one, other in zip(*courses, strict=True):
        assert any(one.air_rate)
        assert one.air_rate == pytest.approx(other.air_rate, rel=1e-4, abs=1e-7)
        assert one.wind == pytest.approx(other.wind, rel=1e-4, abs=1e-7)
        assert one.velocity == pytest.approx(other.velocity, rel=1e-5, abs=1e-6)
