"""Which effects a vehicle has: those that it states, in the order of the sums, and nothing of the others."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from cosim.base.signals import ZERO3
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Jet, load_vehicle
from cosim.vehicle.effects.make import make_effects

SILENT = SimpleNamespace(name="silent", rotor_inertia=0.0, has_port=lambda port: False)
GIVES_ALL = SimpleNamespace(name="all", rotor_inertia=1e-5, has_port=lambda port: True)


def names(engine: SimpleNamespace, **more: object) -> list[str]:
    base, _ = load_vehicle("hexjet")
    plain = base.model_copy(
        update={"servo": None, "airflow": None, "ground_effect": None, "jets": [Jet(position_m=ZERO3)] * 6, **more}
    )
    return [type(effect).__name__ for effect in make_effects(plain, plain, [engine] * 6, 0.004)]


def test_a_vehicle_without_an_effect_has_none() -> None:
    assert names(SILENT) == []


def test_the_grounds_suction_comes_between_torques_and_forces_across() -> None:
    ground = load_vehicle("hexjet-p220")[0].ground_effect
    found = names(GIVES_ALL, ground_effect=ground.model_copy(update={"suckdown": True}))
    assert found == ["EngineTorques", "LiftLoss", "EngineSideForces"]
    reacting = [Jet(position_m=ZERO3, reaction_m=0.01, spin=1)] * 6
    assert names(GIVES_ALL, jets=reacting) == ["RotorDynamics", "EngineTorques", "EngineSideForces"]
    assert names(SILENT, jets=reacting) == ["JetReactions"]


@pytest.mark.parametrize("scenario", ["hover", "jetwing-hover"])
def test_a_flight_has_the_effects_of_its_vehicle(scenario: str) -> None:
    with build(Scenario.load(scenario)) as simulation:
        vehicle = simulation.vehicle
        expected = make_effects(vehicle, vehicle, simulation.stations, simulation.dt)
        assert [type(effect) for effect in simulation.propulsion.effects] == [type(effect) for effect in expected]
