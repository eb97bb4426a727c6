"""A quadrotor on the rotors that are left: its equilibrium, its equations, and a rigid body of the test's own."""

from __future__ import annotations

from math import acos, cos, degrees, hypot, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Command, Measured
from cosim.control.allocation.thrust_map import StaticCurve, ThrustMap
from cosim.control.attitude import AttitudeController
from cosim.control.phases.reduced_attitude import ReducedAttitude, feedback_gains, linear_model
from cosim.simulation.controllers.built_in import find_opposite_jets
from cosim.spec.vehicle import Vehicle, load_vehicle

STEP, LAG, DELAY, FULL = 0.0025, 0.0173, 0.0125, 4.374747  # s, s, s, N: engines/motor/README.md
VEHICLE, _ = load_vehicle("quadrotor")
WEIGHT = VEHICLE.mass_kg * GRAVITY
INERTIA, DAMPING = VEHICLE.inertia_kg_m2[:3], VEHICLE.aero.damping_n_m_s
LIMIT = radians(VEHICLE.limits.rate_deg_s)
LEVER = VEHICLE.jets[2].reaction_m


def law(vehicle: Vehicle = VEHICLE, delay: float = DELAY, added: int = 0) -> ReducedAttitude:
    curve = StaticCurve("straight", (0.0, 1.0), (0.0, FULL))
    return ReducedAttitude(vehicle, find_opposite_jets(vehicle), ThrustMap(curve, [curve] * 4), LAG, delay, STEP, added)


def turned(angle: np.ndarray) -> np.ndarray:
    """Rodrigues' rotation matrix."""
    x, y, z = angle
    size = max(hypot(x, y, z), 1e-12)
    skew = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + sin(size) / size * skew + (1.0 - cos(size)) / size**2 * (skew @ skew)


def body(
    lost: int, duration: float, late: float = 1.0, fire: float = 0.02, added: int = 0, pushed: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Leans [rad], spins [rad/s] and total thrusts [N] of a free rigid body that loses a rotor while it hovers.
    Rotation matrix, Euler's equations, motors as engines/motor states them with their delay
    times ``late``; the law looks on from ``fire`` s after the loss on."""
    block = law(added=added)
    levers = np.array([(-jet.position_m[1], jet.position_m[0], jet.reaction_m) for jet in VEHICLE.jets]).T
    inertia, damping, left = np.array(INERTIA), np.array(DAMPING), np.exp(-STEP / LAG)
    attitude, rate = np.eye(3), np.zeros(3)
    thrust = np.full(4, WEIGHT / 4)
    pipe = [thrust.copy()] * round(late * DELAY / STEP)
    leans, spins, totals = [], [], []
    for k in range(round(duration / STEP)):
        asked = np.full(4, WEIGHT / 4)
        if k * STEP >= fire:
            if not block.is_flying:
                block.begin(lost, tuple(thrust), [tuple(asked)] * 20)
            block.observe(tuple(thrust))
            told, _ = block.update(tuple(attitude.T[:, 2]), tuple(rate), WEIGHT, (0.0, pushed, 0.0))
            asked = FULL * np.array(told)
        pipe.append(asked)
        now = pipe.pop(0)
        now[lost] = 0.0
        thrust = now + left * (thrust - now)
        p, q, r = inertia * rate
        gyroscopic = np.array((rate[1] * r - rate[2] * q, rate[2] * p - rate[0] * r, rate[0] * q - rate[1] * p))
        rate = rate + STEP * (levers @ thrust - damping * rate - gyroscopic) / inertia
        attitude = attitude @ turned(STEP * rate)
        leans.append(acos(min(1.0, attitude[2, 2])))
        spins.append(rate[2])
        totals.append(thrust.sum())
    return np.array(leans), np.array(spins), np.array(totals)


def test_the_spin_is_where_damping_holds_the_reaction_and_within_the_vehicles_limit() -> None:
    """Two rotors alone would turn it faster than its limit; the one across takes away twice what it gives."""
    alone = LEVER * WEIGHT / DAMPING[2]
    assert alone > LIMIT
    _, spins, totals = body(0, 8.0)
    assert spins[-1] == pytest.approx(0.9 * LIMIT, rel=0.01)
    assert totals[-1] == pytest.approx(WEIGHT, rel=0.01)


@pytest.mark.parametrize("lost", range(4))
def test_any_rotor_may_be_lost_and_it_is_level_again(lost: int) -> None:
    leans, spins, _ = body(lost, 2.5)
    assert degrees(leans.max()) < 26.0
    assert degrees(leans[-400:].max()) < 3.0
    assert spins[-1] * VEHICLE.jets[lost].reaction_m < 0.0


def test_it_takes_a_delay_that_is_not_the_stated_one_an_added_one_and_a_push() -> None:
    """Two steps less and two more than the stated five; four more that it knows of; throttle that nobody asked for."""
    for changed in ({"late": 0.6}, {"late": 1.4}, {"added": 4}, {"pushed": 0.02}):
        leans, _, _ = body(1, 2.5, **changed)
        assert degrees(leans.max()) < 50.0, changed
        assert degrees(leans[-400:].max()) < 10.0, changed


def test_the_direction_is_the_set_points_and_the_heading_has_no_part_in_it() -> None:
    attitude = Rotation.from_euler("ZYX", (2.5, -0.3, 0.4))
    x, y, z, w = attitude.as_quat()
    measured = Measured(ZERO3, (w, x, y, z), ZERO3, ZERO3, 0.0)
    for yaw in (-3.0, 0.1, 2.4):
        answer = AttitudeController(VEHICLE.control.attitude).direction(Command((0.2, -0.1, yaw), 0.0), measured)
        wanted = attitude.inv().apply(Rotation.from_euler("ZYX", (yaw, -0.1, 0.2)).apply((0.0, 0.0, 1.0)))
        assert answer == pytest.approx(wanted, abs=1e-12)


def test_one_input_reaches_every_state_while_it_spins_and_not_before() -> None:
    """Rank of the controllability matrix by its singular values; at rest the lean about the other axis is left out."""
    axis = (-(0.5**0.5), 0.5**0.5)

    def rank(spin: float) -> int:
        a, b = linear_model(axis, spin, INERTIA, DAMPING, LAG)
        scale = 1.0 / max(1.0, np.abs(a).max())
        return int(np.linalg.matrix_rank(np.array([np.linalg.matrix_power(a * scale, n) @ b for n in range(5)])))

    assert rank(0.0) == 3
    assert rank(5.0) == rank(-30.0) == 5


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_last_gain_is_the_riccati_equations_and_every_one_holds_its_spin(sense: float) -> None:
    from scipy.linalg import solve_continuous_are

    axis, last = (0.6, 0.8), sense * 31.0
    gains = np.array(feedback_gains(axis, last, INERTIA, DAMPING, LAG))
    a, b = linear_model(axis, last, INERTIA, DAMPING, LAG)
    weight = (INERTIA[0] * 100.0) ** -2
    cost = solve_continuous_are(a, b[:, None], np.diag([0.01, 0.01, 1.0, 1.0, 0.0]), [[weight]])
    exact = b @ cost / weight
    # the recursion holds its input over steps of 10 ms; the loop's poles tell
    one, other = (np.sort_complex(np.linalg.eigvals(a - np.outer(b, gain))) for gain in (exact, gains[-2]))
    assert np.abs(other - one).max() < 0.25 * np.abs(one).max()
    for spin, gain in list(zip(np.arange(0.0, 31.0, 0.5), gains, strict=False))[6:]:
        a, b = linear_model(axis, sense * spin, INERTIA, DAMPING, LAG)
        assert np.linalg.eigvals(a - np.outer(b, gain)).real.max() < 0.0, spin


def test_other_vehicles_are_refused_in_one_line() -> None:
    alike = [jet.model_copy(update={"reaction_m": 0.01}) for jet in VEHICLE.jets]
    with pytest.raises(InputError, match=r"quadrotor: control.monitor.catch: not four rotors in pairs that turn alike"):
        law(VEHICLE.model_copy(update={"jets": alike}))
    still = VEHICLE.aero.model_copy(update={"damping_n_m_s": (*DAMPING[:2], 0.0)})
    with pytest.raises(InputError, match=r"quadrotor: control.monitor.catch: without damping of yaw"):
        law(VEHICLE.model_copy(update={"aero": still}))
