"""Any engines on any hinges: force and moment in JSBSim against rotations and finite differences by hand."""

from __future__ import annotations

from contextlib import closing
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loads import acted
from scipy.spatial.transform import Rotation

from cosim.base.errors import InputError
from cosim.base.signals import ZERO3, Actuation, Disturbance, EngineOutput, State, Unallocated
from cosim.engine.wrappers import EngineChain
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import Hinge, Jet, Servo, Vehicle, load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.effects.banks import Banks
from cosim.vehicle.effects.hinges import HingeReactions
from cosim.vehicle.effects.make import make_effects
from cosim.vehicle.propulsion import Propulsion
from cosim.vehicle.servo import TiltServo

STEP = 0.004
EXACT = 1e-9  # of the larger side: rounding
RATE = (0.4, -0.7, 1.1)


class Given:
    """Engines that give what they are told to."""

    wants_ambient = False

    def __init__(self, jets: int) -> None:
        self.thrust = (0.0,) * jets

    def reset(self, throttle: Any, ambient: Any = None) -> EngineOutput:
        return EngineOutput(self.thrust, (0.0,) * len(self.thrust), self.thrust, self.thrust)

    def step(self, k: int, throttle: Any, ambient: Any = None) -> EngineOutput:
        return self.reset(throttle)

    def set_run(self, index: int, on: bool) -> bool:
        return False

    def close(self) -> None:
        pass


def drawn(seed: int) -> tuple[list[Jet], list[Hinge], np.random.Generator]:
    """Jets and hinges anywhere; a jet may be on none, one or several of them."""
    draw = np.random.default_rng(seed)

    def place() -> tuple[float, float, float]:
        return tuple(draw.uniform(-0.5, 0.5, 3).tolist())

    def direction() -> tuple[float, float, float]:
        return tuple(draw.normal(size=3).tolist())

    count = int(draw.integers(1, 17))
    jets = [Jet(position_m=place(), axis=direction(), reaction_m=float(draw.normal()) * 0.05) for _ in range(count)]
    hinges = []
    for number in range(int(draw.integers(0, 6))):
        chosen = [int(jet) for jet in range(1, count + 1) if draw.random() < 0.5]
        carries = [jet for jet in chosen if draw.random() < 0.5]
        deflects = [jet for jet in chosen if jet not in carries]
        if not chosen:
            continue
        hinges.append(
            Hinge(
                name=f"h{number}", position_m=place(), axis=direction(), carries=carries, deflects=deflects,
                effect=float(draw.uniform(0.2, 1.0)), lag_s=0.0, rate_limit_rad_s=1e6, range_rad=3.0,
                mass_kg=float(draw.random()) * 0.1, centre_m=place(), inertia_kg_m2=1.0,
            )
        )  # fmt: skip
    return jets, hinges, draw


def turn(hinge: Hinge, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(angle * np.array(hinge.axis)).as_matrix()


def stance(jets: list[Jet], hinges: list[Hinge], angles: Any) -> tuple[np.ndarray, np.ndarray]:
    """Places and axes by matrices, from the outermost part inwards to the body."""
    places, axes = [], []
    for number, jet in enumerate(jets, 1):
        place, axis = np.array(jet.position_m), np.array(jet.axis)
        for hinge, angle in reversed(list(zip(hinges, angles, strict=True))):
            point = np.array(hinge.position_m)
            if number in hinge.carries:
                place, axis = point + turn(hinge, angle) @ (place - point), turn(hinge, angle) @ axis
            elif number in hinge.deflects:
                axis = turn(hinge, hinge.effect * angle) @ axis
        places.append(place)
        axes.append(axis)
    return np.array(places), np.array(axes)


def reactions(hinges: list[Hinge], past: list[np.ndarray], k: int) -> tuple[np.ndarray, np.ndarray]:
    """Of all parts, by Newton and Euler with speeds and accelerations from the angles of the last steps."""
    force, moment = np.zeros(3), np.zeros(3)
    before = [*past]
    speeds = [(b - a) / STEP for a, b in pairwise(before)]
    speed = speeds[-1]
    growth = (speeds[-1] - (speeds[-2] if len(speeds) > 1 else 0.0)) / STEP
    for number, hinge in enumerate(hinges):
        own = {*hinge.carries, *hinge.deflects}
        outer = [other for other in range(number) if own & set(hinges[other].carries)]
        axis, point = np.array(hinge.axis), np.array(hinge.position_m)
        arm = np.array(hinge.centre_m) - point
        foot = point + axis * (arm @ axis)
        arm = turn(hinge, past[-1][number]) @ (arm - axis * (arm @ axis))
        for other in reversed(outer):
            matrix, about = turn(hinges[other], past[-1][other]), np.array(hinges[other].position_m)
            axis, arm, foot = matrix @ axis, matrix @ arm, about + matrix @ (foot - about)
        a, v = growth[number], speed[number]
        push = -hinge.mass_kg * (a * np.cross(axis, arm) + v * v * np.cross(axis, np.cross(axis, arm)))
        held = hinge.inertia_kg_m2 * v * axis
        force += push
        moment += np.cross(foot, push) - hinge.inertia_kg_m2 * a * axis - np.cross(RATE, held)
    return force, moment


@given(st.integers(0, 10**6))
@settings(max_examples=25)
def test_force_and_moment_of_any_layout_are_those_of_levers_and_newton(seed: int) -> None:
    jets, hinges, draw = drawn(seed)
    base, folder = load_vehicle("quadrotor")
    vehicle = base.model_copy(update={"jets": jets, "hinges": hinges, "model": None})
    engines = Given(len(jets))
    silent = SimpleNamespace(rotor_inertia=0.0, has_port=lambda port: False)
    propulsion = Propulsion(
        jets, EngineChain(engines, [None] * len(jets), lambda jet: 0.1, STEP), [TiltServo(h, STEP) for h in hinges],
        make_effects(vehicle, vehicle, [silent] * len(jets), STEP), None, lambda: (101325.0, 288.15), hinges,
    )  # fmt: skip
    with closing(Airframe(vehicle, folder, Environment(), STEP, 1, 0)) as frame:
        state = frame.reset(Initial(altitude_m=100.0), [ZERO3] * len(jets), ZERO3)
        state = State(*state)._replace(rate=RATE)
        propulsion.reset((0.0,) * len(jets), None, ZERO3)
        past = [np.zeros(len(hinges))]
        for k in range(3):
            engines.thrust = tuple(draw.uniform(0.0, 20.0, len(jets)).tolist())
            past.append(draw.uniform(-0.01, 0.01, len(hinges)) + past[-1])
            asked = Actuation((0.0,) * len(jets), tuple(past[-1].tolist()), Unallocated())
            forces, moment = propulsion.step(k, asked, state)
        frame.step(forces, Disturbance(), moment)
        got_force, got_moment = frame.external_wrench()
    places, axes = stance(jets, hinges, past[-1])
    thrusts = np.array(engines.thrust)[:, None] * axes
    twists = -np.array([jet.reaction_m for jet in jets])[:, None] * thrusts
    force, moment = reactions(hinges, past, 2)
    force, moment = force + thrusts.sum(0), moment + (np.cross(places, thrusts) + twists).sum(0)
    size = max(1.0, np.abs(force).max(), np.abs(moment).max())
    assert np.abs(np.array(got_force) - force).max() <= EXACT * size
    assert np.abs(np.array(got_moment) - moment).max() <= EXACT * size


def test_two_banks_are_two_hinges_about_minus_y() -> None:
    servo = Servo(lag_s=0.02, rate_limit_rad_s=5.0, range_rad=0.5, bank_inertia_kg_m2=0.002, bank_imbalance_kg_m=0.03)
    places = [(0.1, 0.2, -0.1), (-0.1, 0.2, -0.1), (0.1, -0.2, -0.1), (-0.1, -0.2, -0.1)]
    jets = [Jet(position_m=place, servo="right" if place[1] > 0.0 else "left") for place in places]
    # the imbalance as 1 kg at 0.03 m along the thrust
    common = {"axis": (0.0, -1.0, 0.0), "lag_s": 0.02, "rate_limit_rad_s": 5.0, "range_rad": 0.5, "mass_kg": 1.0}
    common["inertia_kg_m2"] = 0.002
    hinges = [
        Hinge(name=name, position_m=(0.0, y, -0.1), centre_m=(0.0, y, -0.13), carries=carries, **common)
        for name, y, carries in (("left", -0.2, [3, 4]), ("right", 0.2, [1, 2]))
    ]
    banks, parts = Banks(servo, jets, STEP), HingeReactions(hinges, jets, STEP)
    for tilt in ((0.01, 0.02), (0.03, -0.01), (0.02, 0.0)):
        spread, beside = acted(banks, [ZERO3] * 4, tilt, rate=RATE)
        push, moment = parts.reaction(tilt, RATE)
    force = np.sum(spread, axis=0)
    lever = np.sum(np.cross(places, spread), axis=0) + beside
    assert push == pytest.approx(force, abs=1e-12)
    assert np.cross(places[0], push) + moment == pytest.approx(lever, abs=1e-11)


def test_products_of_inertia_turn_the_vehicle_as_the_tensor_says() -> None:
    given = {"products_kg_m2": [0.0003, 0.0005, -0.0002], "inertia_kg_m2": [0.002, 0.0025, 0.0034]}
    vehicle, folder = load_vehicle("quadrotor", given)
    for axis in range(3):
        moment = tuple(1e-3 * (n == axis) for n in range(3))
        frame = Airframe(vehicle, folder, Environment(), 0.0025, 1, 0)
        frame.reset(Initial(altitude_m=100.0), [ZERO3] * 4, ZERO3)
        assert frame.products_of_inertia() == pytest.approx(given["products_kg_m2"], rel=1e-12)
        frame.step([ZERO3] * 4, Disturbance(moment=moment))
        # at rest but for the Earth's own turning, whose gyroscopic part is 1e-8 of this
        got = [frame._fdm.get_property_value(f"accelerations/{x}dot-rad_sec2") for x in "pqr"]
        frame.close()
        assert got == pytest.approx(np.linalg.solve(vehicle.tensor, moment), rel=1e-5, abs=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"products_kg_m2": [0.003, 0.0, 0.0]}, "no body with inertia_kg_m2"),
        ({"jets": {"0": {"axis": [0.0, 0.0, 0.0]}}}, "must have a direction"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [9]}]}, "there are jets 1 to 4"),
        ({"hinges": [{"axis": [1, 0, 0]}]}, "name the jets that it moves"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [1], "deflects": [1]}]}, "name a jet once"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [1], "range_rad": 30.0}]}, "which unit?"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [1], "range_rad": [0.1, 0.2]}]}, "must be within range_rad"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [1]}] * 2}, "two are called 'h'"),
        ({"hinges": [{"axis": [1, 0, 0], "carries": [1], "mass_kg": 1.0, "centre_m": [0, 1, 0]}]}, "have at least 1 "),
        ({"surfaces": [{"name": "s", "property": "fcs/x", "lag_s": 0, "rate_limit_1_s": 1}], "model": None}, "model"),
        ({"control": {"allocation": {"method": "banks"}}}, "is for two banks"),
    ],
)
def test_a_layout_that_cannot_be_is_named_in_one_line(change: dict[str, Any], said: str) -> None:
    usual = {"name": "h", "position_m": [0, 0, 0], "lag_s": 0.0, "rate_limit_rad_s": 1.0, "range_rad": 0.3}
    if "hinges" in change:
        change = {"hinges": [usual | hinge for hinge in change["hinges"]]}
    with pytest.raises(InputError, match=said.replace("?", r"\?")):
        load_vehicle("quadrotor", change)


def test_old_files_are_written_as_they_were() -> None:
    vehicle = load_vehicle("hexjet")[0]
    stated = vehicle.model_dump(mode="json", exclude_none=True)
    assert not {"hinges", "surfaces", "products_kg_m2"} & set(stated)
    assert set(stated["jets"][0]) == {"position_m", "servo", "reaction_m", "spin"}
    assert set(stated["control"]["allocation"]) == {"throttle_min", "throttle_max"}
    assert Vehicle.model_validate(stated) == vehicle
