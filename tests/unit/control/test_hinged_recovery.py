"""Without an engine: hinges turn the vehicle beside the thrusts that there are, and give up no lift that they need not."""

from __future__ import annotations

from math import atan2

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from cosim.base.constants import GRAVITY
from cosim.base.layout import UP, HingeAxis, Layout, Station
from cosim.base.signals import Command, JetHealth, Measured
from cosim.control.allocation.effectiveness import AllocationModel, Effector
from cosim.control.allocation.hinged_recovery import EngineLag, HingedRecovery
from cosim.control.attitude import AttitudeController
from cosim.spec.vehicle import AttitudeGains, load_vehicle

MASS = 5.0
TENSOR = ((0.05, -0.004, 0.002), (-0.004, 0.06, 0.001), (0.002, 0.001, 0.09))
LOW, SPAN = 0.5, 25.0
LATE = EngineLag(0.4, 0.004)


def jetwing(*surfaces: Effector) -> tuple[HingedRecovery, Layout, list[tuple[float, float]]]:
    """The jetwing's hinges, with its mass and inertia, and engines of 0.5 to 24.5 N; and their ranges."""
    vehicle, _ = load_vehicle("jetwing")
    layout, step = vehicle.layout(), 0.004
    movers = [Effector(*h.angle_limits, h.rest_rad, h.rate_limit_rad_s * step, h.effort) for h in vehicle.hinges]
    effectors = AllocationModel(
        "jetwing", layout, vehicle.mass_kg, vehicle.tensor, 0.5, 24.0, [(0.0, 1.0)] * 4, [20.0] * 4,
        [*movers, *surfaces], vehicle.control.allocation.horizontal,
    )  # fmt: skip
    return HingedRecovery(effectors, LATE), layout, [hinge.angle_limits for hinge in vehicle.hinges]


def wrench(layout: Layout, thrust: list[float], angles: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment, body."""
    axes, places = layout.axes(angles), layout.positions(angles)
    force, moment = np.zeros(3), np.zeros(3)
    for jet, newton in enumerate(thrust):
        push = newton * np.array(axes[layout.groups[jet]])
        force += push
        moment += np.cross(places[jet], push) + layout.stations[jet].twist * push
    return force, moment


def most_lift(layout: Layout, thrust: list[float], ranges: list[tuple[float, float]]) -> float:
    """By sequential quadratic programming from many starts: lift with no moment [N]."""
    draw, best = np.random.default_rng(1), 0.0
    for _ in range(12):
        start = [draw.uniform(low, high) for low, high in ranges]
        found = minimize(
            lambda a: wrench(layout, thrust, list(a))[0][2] / 10.0, start, method="SLSQP", bounds=ranges,
            constraints={"type": "eq", "fun": lambda a: wrench(layout, thrust, list(a))[1]},
        )  # fmt: skip
        force, moment = wrench(layout, thrust, list(found.x))
        if np.abs(moment).max() < 1e-6:
            best = max(best, -float(force[2]))
    return best


@pytest.mark.parametrize("thrust", [11.06, 15.2, 19.35])
def test_hinges_that_carry_engines_give_up_no_lift_that_they_need_not(thrust: float) -> None:
    """Followed from hover the engines beside the lost one were turned level, and half of the lift was gone."""
    caught, layout, ranges = jetwing()
    given = [0.0, thrust, thrust, thrust]
    caught.replan([JetHealth(0.0), *[JetHealth()] * 3])
    for _ in range(400):
        caught.observe(tuple(given))
        answer = caught.allocate(caught.hover, (0.0, 0.0, 0.0))
    force, moment = wrench(layout, given, list(answer.tilt))
    assert np.abs(moment).max() < 0.02
    assert -force[2] == pytest.approx(most_lift(layout, given, ranges), rel=0.01)


def test_it_leans_against_what_its_hinges_push_aside() -> None:
    caught, layout, _ = jetwing()
    given = [0.0, 15.2, 15.2, 15.2]
    caught.replan([JetHealth(0.0), *[JetHealth()] * 3])
    assert not caught.is_leaning
    for _ in range(600):
        caught.observe(tuple(given))
        answer = caught.allocate(caught.hover, (0.0, 0.0, 0.0))
    x, y, z = wrench(layout, given, list(answer.tilt))[0]
    roll, pitch = caught.lean
    assert caught.is_leaning
    assert roll == pytest.approx(np.clip(atan2(-y, -z), -0.2, 0.2), abs=0.01)
    assert pitch == pytest.approx(np.clip(atan2(x, -z), -0.2, 0.2), abs=0.01)
    # about these angles the force comes nearer to straight up
    straight = Rotation.from_rotvec([roll, pitch, 0.0]).apply([x, y, z])
    assert np.hypot(*straight[:2]) < 0.7 * np.hypot(x, y)
    # thrusts that hold the weight leave less of it
    for _ in range(600):
        caught.observe((0.0, 22.0, 22.0, 6.0))
        caught.allocate(caught.hover, (0.0, 0.0, 0.0))
    assert max(map(abs, caught.lean)) <= 0.1 + 1e-9
    caught.reset()
    assert not caught.is_leaning
    assert caught.lean == (0.0, 0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0, 3.1])
@pytest.mark.parametrize(("roll", "pitch"), [(-0.2, 0.1), (0.3, -0.4)])
def test_the_lean_is_asked_for_whatever_the_heading_is(yaw: float, roll: float, pitch: float) -> None:
    """By the error taken as one turn a vehicle that faces the other way leans across; and no heading is asked for."""
    control = AttitudeController(AttitudeGains(gain_1_s=(1.0, 1.0, 1.0), rate_limit_rad_s=(9.0, 9.0, 9.0)))
    within = min(1.0, 0.25 / np.hypot(roll, pitch))
    lean, now = Rotation.from_euler("ZYX", [0.0, within * pitch, within * roll]), Rotation.from_euler("Z", yaw)
    x, y, z, w = now.as_quat()
    measured = Measured((0.0, 0.0, 0.0), (w, x, y, z), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    command = Command((roll, pitch, 0.0), 0.0)
    rates = control.update_tilt_first(command, measured, (0.0, 0.0))
    # the least turn of the z axis, as seen from the body
    wanted = now.inv().apply(lean.apply([0.0, 0.0, 1.0]))
    axis = np.cross([0.0, 0.0, 1.0], wanted)
    angle = np.arccos(wanted[2])
    turn = 2.0 * np.sin(0.5 * angle) * axis / np.linalg.norm(axis)
    assert rates == pytest.approx((turn[0], turn[1], 0.0), abs=1e-12)
    rates = control.update_tilt_first(command, measured, (0.1, -0.2))
    assert rates == pytest.approx((turn[0] + 0.1, turn[1] - 0.2, 0.0))
    whole = np.array(control.update(command, measured)[:2])
    if abs(yaw) > 3.0:
        assert abs(whole @ turn[:2]) < 0.2 * np.linalg.norm(whole) * np.linalg.norm(turn)


def test_without_an_engine_surfaces_stay_at_zero() -> None:
    """The air's speed is not known: an elevator counted with the speed over the ground put the nose down in wind."""
    elevator = Effector(-1.0, 1.0, 0.0, 0.02, 1.0, (0.0, 0.0, -0.05, 0.0, -0.03, 0.0))
    caught, _, _ = jetwing(elevator)

    def deflection() -> float:
        for _ in range(100):
            caught.pressure = 60.0
            answer = caught.allocate(caught.hover, (0.0, -3.0, 0.0))
            caught.observe((15.2,) * 4)
        return answer.tilt[-1]

    assert deflection() > 0.1
    caught.replan([JetHealth(0.0), *[JetHealth()] * 3])
    caught.observe((0.0, 15.2, 15.2, 15.2))
    assert deflection() == pytest.approx(0.0, abs=1e-9)


def test_without_an_engine_hinges_turn_it_and_late_throttles_are_not_asked_to() -> None:
    """Four gimballed jets below the centre: asked for attitude, throttles answered too late and pumped the swing."""
    stations = [Station((x, y, 0.2), UP, 0.0) for x in (0.2, -0.2) for y in (0.2, -0.2)]
    ahead, aside = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    turns = [HingeAxis(s.position, axis, (), (jet,), 1.0) for jet, s in enumerate(stations) for axis in (ahead, aside)]
    movers = [Effector(-0.26, 0.26, 0.0, 0.02, 1.0)] * 8
    layout = Layout(stations, turns)
    effectors = AllocationModel("square", layout, MASS, TENSOR, LOW, SPAN, [(0.05, 1.0)] * 4, [20.0] * 4, movers)
    caught = HingedRecovery(effectors, LATE)
    even = MASS * GRAVITY / 4
    caught.replan([JetHealth(0.0), *[JetHealth()] * 3])
    caught.observe((even,) * 4)
    for _ in range(20):  # as far as hinges go, with the engines where they were
        given = caught.allocate(caught.hover, (-2.0, 1.0, 0.0))
        caught.observe((even,) * 4)
    # the one across at its least, and those beside it up, whatever moment is asked for
    assert given.throttle[3] == pytest.approx(0.05)
    assert min(given.throttle[1:3]) > 0.99
    # the hinges push against what the thrusts that are reported do, as far as they go
    assert max(map(abs, given.tilt[2:])) == pytest.approx(0.26)
    assert given.unallocated.roll != 0.0
    # thrusts in balance: hinges give what is asked for, and throttles stay as they are
    for _ in range(400):
        caught.observe((0.0, 2 * even, 2 * even, 0.0))
        still = caught.allocate(caught.hover, (0.0, 0.0, 0.0))
    for _ in range(20):
        caught.observe((0.0, 2 * even, 2 * even, 0.0))
        turned = caught.allocate(caught.hover, (0.5, -0.25, 0.0))
    assert turned.unallocated[:3] == (0.0, 0.0, 0.0)
    assert turned.throttle == pytest.approx(still.throttle)
    assert turned.tilt != still.tilt
    caught.reset()
    assert caught.allocate(caught.hover, (0.0, 0.0, 0.0)).throttle == pytest.approx((caught.hover,) * 4)
