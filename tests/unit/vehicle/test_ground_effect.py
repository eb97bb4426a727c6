"""Lift loss and swallowed hot gas near the ground: closed forms, the switches, and what a landing becomes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loads import acted

from cosim import fly
from cosim.base.errors import InputError
from cosim.simulation.build import build
from cosim.spec.scaling import scale_vehicle
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import GroundEffect, Vehicle, load_vehicle
from cosim.vehicle.effects.ground_effect import HotGas, LiftLoss, lift_loss

PLATE = {"planform_m": 0.4, "jet_m": 0.1}
GAS = {"hot_gas": True, "hot_gas_height_m": [0.5, 1.0, 2.0], "hot_gas_rise_k": [20.0, 10.0, 0.0]}


def p220() -> tuple[Vehicle, GroundEffect]:
    vehicle, _ = load_vehicle("hexjet-p220")
    return vehicle, vehicle.ground_effect


def test_lift_loss_is_wyatts_correlation() -> None:
    assert lift_loss(0.9, 1.0, 0.1) == pytest.approx(0.012, rel=1e-14)  # one D - d up
    assert lift_loss(1.8, 1.0, 0.1) / lift_loss(0.9, 1.0, 0.1) == pytest.approx(2.0**-2.3, rel=1e-14)
    edge = 0.012 * 0.3**-2.3
    assert [lift_loss(h, 1.0, 0.1) for h in (0.27, 0.1, 0.0, -1.0)] == pytest.approx([edge] * 4, rel=1e-12)
    assert lift_loss(100.0, 1.0, 0.1) < 1e-6


def test_the_loss_acts_at_the_centre() -> None:
    """Force along body z, no moment, also of jets that do not stand round the centre."""
    vehicle, _ = p220()
    effect = GroundEffect(suckdown=True, planform_m=1.0, jet_m=0.1, planform_z_m=0.2)
    places = [(x + 0.1, y - 0.05, z) for x, y, z in (jet.position_m for jet in vehicle.jets)]
    moved = [jet.model_copy(update={"position_m": at}) for jet, at in zip(vehicle.jets, places, strict=True)]
    rng = np.random.default_rng(1)
    before = [(float(x), 0.0, -float(z)) for x, z in rng.uniform(10.0, 100.0, (6, 2))]
    after, moment = acted(LiftLoss(effect, moved), before, altitude=1.1)
    change = np.array(after) - np.array(before)
    thrust = -sum(z for _, _, z in before)
    assert change.sum(axis=0) == pytest.approx([0.0, 0.0, 0.012 * thrust], rel=1e-12)
    whole = np.cross([jet.position_m for jet in moved], change).sum(axis=0) + moment
    assert whole == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    nothing = [(0.0, 0.0, 0.0)] * 6
    assert acted(LiftLoss(effect, moved), nothing, altitude=1.1) == (nothing, (0.0, 0.0, 0.0))


def test_intakes_are_warmed_near_the_ground_only() -> None:
    near = HotGas(GroundEffect(**PLATE, **GAS))
    heights = (0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 50.0)
    assert [near.temperature_rise(h) for h in heights] == pytest.approx(
        [20.0, 20.0, 15.0, 10.0, 5.0, 0.0, 0.0], rel=1e-14
    )


def same(one: Any, other: Any) -> bool:
    return all(
        np.array_equal(one.log[c], other.log[c], equal_nan=True) for c in ("altitude_m", "thrust_1_N", "rate_q_rad_s")
    )


def test_switched_off_is_absent_to_the_last_bit() -> None:
    base = Scenario.load("hover").replace(duration_s=1.0, expect=[])
    base = base.replace(initial=base.initial.model_copy(update={"altitude_m": 0.5}))
    without = fly(base)
    assert same(without, fly(base.replace(vehicle={"ground_effect": {**PLATE, **GAS, "hot_gas": False}})))
    assert not same(without, fly(base.replace(vehicle={"ground_effect": {**PLATE, "suckdown": True}})))


def test_hot_gas_reaches_engines_that_take_the_temperature() -> None:
    base = Scenario.load("full-scale-hover").replace(duration_s=0.4, expect=[])
    base = base.replace(initial=base.initial.model_copy(update={"altitude_m": 1.0}))
    hot = {"ground_effect": GAS}
    for engine, felt in (("turbine-220", True), ("p220", False)):
        flown = base.replace(engine=engine, vehicle={})
        assert same(fly(flown), fly(flown.replace(vehicle=hot))) is not felt
    flown = base.replace(engine="turbine-220")
    thrust = []
    for vehicle in ({}, hot):
        with build(flown.replace(vehicle=vehicle)) as simulation:
            thrust.append(sum(simulation.step().engines.thrust))
    # corrected flow and speed: at a given throttle a warmer intake gives less thrust, here by some per cent for 10 K
    assert 0.9 * thrust[0] < thrust[1] < thrust[0]


def test_grows_with_the_vehicle() -> None:
    base, _ = load_vehicle("hexjet")
    stated = base.model_dump(mode="json", exclude_none=True) | {"ground_effect": {**PLATE, **GAS}}
    grown = scale_vehicle(stated, 8.0 * base.mass_kg)["ground_effect"]
    assert (grown["planform_m"], grown["jet_m"]) == pytest.approx((0.8, 0.2), rel=1e-12)
    assert grown["hot_gas_height_m"] == pytest.approx([1.0, 2.0, 4.0], rel=1e-12)
    assert grown["hot_gas_rise_k"] == GAS["hot_gas_rise_k"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"planform_m": 0.1, "jet_m": 0.1}, r"jet_m 0\.1 must be below planform_m 0\.1"),
        ({**PLATE, "hot_gas": True}, "hot_gas: needs two or more heights"),
        ({**PLATE, **GAS, "hot_gas_rise_k": [1.0, 0.0]}, "needs one value for each of the 3"),
        ({**PLATE, **GAS, "hot_gas_height_m": [1.0, 1.0, 2.0]}, "every height must be above"),
        ({**PLATE, **GAS, "hot_gas_rise_k": [3.0, 2.0, 1.0]}, "the last must be 0, not 1"),
    ],
)
def test_wrong_tables_are_refused(table: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build(Scenario.load("hover").replace(vehicle={"ground_effect": table}, expect=[]))


@pytest.mark.parametrize("engine", ["p220", pytest.param("p220-2025", marks=pytest.mark.long)])
def test_a_landing_with_lift_loss(engine: str) -> None:
    """Touch-down with and without, well within the vehicle's limit."""
    vehicle, _ = p220()
    base = Scenario.load("full-scale-climb-and-land").replace(engine=engine, expect=[])
    speeds = []
    for on in (False, True):
        run = fly(base.replace(vehicle={"ground_effect": {"suckdown": on}}))
        assert run.outcome == "completed"
        speed = run.summary.flat_metrics["touchdown_m_s"]
        speeds.append(speed)
    assert speeds[0] < speeds[1] < vehicle.limits.touchdown_m_s / 3.0


def test_hover_near_the_ground_with_lift_loss() -> None:
    """aircraft/hexjet-p220/README.md: from 1 m the vehicle sinks onto its legs, 2 m it holds."""
    ends = {}
    for height, on in ((1.0, True), (2.0, True), (1.0, False)):
        base = Scenario.load("full-scale-hover").replace(
            duration_s=20.0, expect=[], vehicle={"ground_effect": {"suckdown": on}}
        )
        run = fly(base.replace(initial=base.initial.model_copy(update={"altitude_m": height})))
        ends[height, on] = float(np.array(run.log["altitude_m"])[-1])
    assert ends[1.0, True] < 0.46
    assert ends[2.0, True] == pytest.approx(2.0, abs=0.1)
    assert ends[1.0, False] == pytest.approx(1.0, abs=0.1)
