"""The control step of a scenario that states none is its aircraft's; one that is stated stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.base.errors import InputError
from cosim.campaign.study.keys import with_values
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle


def test_not_stated_it_follows_the_aircraft() -> None:
    hover = Scenario.load("hover")
    assert hover.step_s == 0.004
    other = hover.replace(aircraft="quadrotor", engine="motor")
    assert other.step_s == 0.0025  # that of its identified model
    assert other.replace(seed=3).step_s == 0.0025
    assert other.replace(aircraft="hexjet", engine="edf").step_s == 0.004
    assert other.replace(vehicle={"step_s": 0.005}).step_s == 0.005  # the vehicle's own word comes first
    assert with_values(hover, {"aircraft": "quadrotor", "controller": "baseline"}).step_s == 0.0025


def test_a_stated_step_stays_with_another_aircraft() -> None:
    stated = Scenario.load("hover", ["step_s=0.005"])
    assert stated.replace(aircraft="quadrotor", engine="motor").step_s == 0.005
    assert stated.replace(duration_s=1.0).step_s == 0.005
    # as a run's own file has it
    again = Scenario.from_table(Scenario.load("hover").model_dump(exclude_none=True), Path(), "run")
    assert again.replace(aircraft="quadrotor", engine="motor").step_s == 0.004


def test_models_of_several_steps_say_nothing() -> None:
    vehicle, _ = load_vehicle("quadrotor")
    model = vehicle.identified["motor"]["roll"]
    other = {"motor": {"roll": model}, "fan": {"roll": model.model_copy(update={"sample_time_s": 0.005})}}
    assert vehicle.model_copy(update={"identified": other}).control_step == 0.004
    assert vehicle.model_copy(update={"identified": {}}).control_step == 0.004


def test_one_that_the_engine_cannot_make_is_told_with_those_that_it_can() -> None:
    with pytest.raises(InputError, match=r"motor\.fmu: step 0\.004 s .* step_s of .* may be 0\.0025 or 0\.005$"):
        load_engine("motor", {}, 0.004)
