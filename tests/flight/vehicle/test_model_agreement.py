"""Identified models against geometry, inertia and engine: those that are shipped agree, and a later edit is found."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from math import exp
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet
from places import ROOT

from cosim import Scenario, fly
from cosim.aircraft_check.check import check_aircraft
from cosim.campaign.study.model_notes import design_warnings, model_notes
from cosim.campaign.study.options import open_study
from cosim.simulation.build import build
from cosim.simulation.delay_ledger import sum_samples
from cosim.simulation.engines import load_engines
from cosim.simulation.model_agreement import ModelAgreement, compare_flown_models, compare_models, list_model_notes
from cosim.spec.vehicle import Vehicle, aircraft_names, load_vehicle

# Engine by aircraft, and whether it burns fuel.
SHIPPED = (
    ("hexjet", "edf-as-flown", False), ("hexjet", "edf", False), ("hexjet-100", "turbine-100", True), ("hexjet-p220", "p220", True),
    ("hexjet-p220", "p220-2025", True), ("octojet", "turbine-100", True), ("quadrotor", "motor", False),
)  # fmt: skip
LEVER_M, THRUST_N, INERTIA = 0.15, 20.005, 0.041571  # aircraft/hexjet/README.md


def scenario_of(aircraft: str = "hexjet", engine: str = "edf-as-flown", **changes: Any) -> Scenario:
    table = {"name": "agreement", "aircraft": aircraft, "engine": engine, "controller": "smith", "duration_s": 0.2}
    return Scenario.from_table({**table, **changes}, Path(), "test")


def of(compare: Callable[..., Any], scenario: Scenario, fuel: float | None = None) -> list[Any]:
    """What a comparison of the scenario's vehicle comes to."""
    vehicle, _ = scenario.resolved_vehicle()
    vehicle = vehicle if fuel is None else vehicle.with_fuel(fuel)
    return list(compare(scenario, vehicle, load_engines(scenario, vehicle)[0]))


def agreements(scenario: Scenario) -> list[ModelAgreement]:
    return of(compare_models, scenario)


def notes(scenario: Scenario) -> list[str]:
    return of(list_model_notes, scenario)


def test_the_table_has_every_shipped_model() -> None:
    vehicles = {name: load_vehicle(name)[0] for name in aircraft_names()}
    stated = {(name, engine, bool(it.fuel)) for name, it in vehicles.items() for engine in it.identified}
    assert set(SHIPPED) == stated


@pytest.mark.parametrize(
    ("aircraft", "engine", "fuel"),
    [(name, engine, fuel) for name, engine, burns in SHIPPED for fuel in ((1.0, 0.0) if burns else (1.0,))],
)
def test_shipped_models_are_their_vehicles(aircraft: str, engine: str, fuel: float) -> None:
    """With full and with empty tank."""
    (found,) = of(compare_models, scenario_of(aircraft, engine), fuel)
    assert found.axis == "roll"
    assert not found.is_noteworthy, found.note
    # designs swept the engine at the throttle of a full tank, and composed the model from that
    if (aircraft, engine, True) in SHIPPED and fuel:
        assert found.ratio == pytest.approx(1.0, abs=0.005)
        assert found.model_delay == pytest.approx(found.vehicle_delay, abs=0.5)


def inertia(factor: float) -> dict[str, Any]:
    """About roll."""
    return {"vehicle": {"inertia_kg_m2": [INERTIA * factor, 0.052, 0.07]}}


HEAVY: dict[str, Any] = {"vehicle": {"inertia_kg_m2": [0.08, 0.09, 0.12]}}


def delay(samples: int) -> dict[str, Any]:
    return {"engine_parameters": {"delay_samples": samples}}


@pytest.mark.parametrize(
    ("changes", "settles"),
    [(inertia(1.5), True), (inertia(1.75), False), (delay(25 + 10), True), (delay(25 + 15), False)],
)
def test_where_a_model_is_unfit_the_doublet_does_not_settle(changes: dict[str, Any], settles: bool) -> None:
    scenario = Scenario.load("roll-doublet").replace(expect=[], **changes)
    assert (fly(scenario).metrics["roll"].settling_time_s is not None) == settles


def test_the_hexjets_gain_is_its_levers_over_its_inertia() -> None:
    (found,) = agreements(scenario_of())
    assert found.unit == "rad/s^2 per throttle"
    assert found.vehicle_gain == pytest.approx(6.0 * LEVER_M * THRUST_N / INERTIA, rel=1e-3)
    assert found.ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("engine", ["edf-as-flown", "edf"])
def test_all_delay_is_that_of_the_ledger(engine: str) -> None:
    """At low frequency; where it is compared a little of the lags' phase is missing."""
    scenario = scenario_of(engine=engine)
    with build(scenario) as simulation:
        total = sum_samples(simulation.ledger)
    (found,) = agreements(scenario)
    assert total is not None
    assert total - 0.05 * total - 0.2 < found.vehicle_delay < total + 0.1


def changed(vehicle: Vehicle, **model: Any) -> dict[str, Any]:
    roll = vehicle.identified["edf-as-flown"]["roll"].model_copy(update=model)
    return {"identified": {"edf-as-flown": {"roll": roll.model_dump(mode="json")}}}


@pytest.mark.parametrize(
    ("changes", "ratio", "later", "noted", "unfit"),
    [
        (inertia(1.1), 1.1, 0.0, False, False),
        (inertia(1.3), 1.3, 0.0, True, False),
        (inertia(0.7), 0.7, 0.0, True, False),
        (HEAVY, 0.08 / INERTIA, 0.0, True, True),
        ({"vehicle": {"mass_kg": 6.5}}, 1.0, 0.0, False, False),  # throttles turn it, whatever it weighs
        (delay(29), 1.0, -4.0, False, False),
        (delay(35), 1.0, -10.0, True, False),
        (delay(60), 1.0, -35.0, True, True),
        ({"engine_parameters": {"newton_per_unit": 2.0 * 9.80665}}, 0.5, 0.0, True, True),
        ({"vehicle": {"sensors": {"gyro": {"latency_samples": 10}}}}, 1.0, -10.0, True, False),
    ],
)
def test_what_is_changed_is_found_by_its_size(
    changes: dict[str, Any], ratio: float, later: float, noted: bool, unfit: bool
) -> None:
    (right,), (found,) = agreements(scenario_of()), agreements(scenario_of(**changes))
    assert found.ratio / right.ratio == pytest.approx(ratio, rel=0.03)
    off, usual = (each.model_delay - each.vehicle_delay for each in (found, right))
    assert off - usual == pytest.approx(later, abs=0.6)
    assert (found.is_noteworthy, found.is_unfit) == (noted, unfit)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({"gain": -0.0689}, "it turns the other way"),
        ({"poles": [0.9999, 0.5], "gain": 0.0689 * 0.5 / 0.0976}, "all delay 27.1 samples, and 34.2 by engine"),
        ({"poles": [0.9999, 0.9733], "gain": 0.0689 * 0.0267 / 0.0976, "delay_samples": 0}, "lags of another length"),
    ],
)
def test_a_model_of_another_form_is_found(model: dict[str, Any], said: str) -> None:
    vehicle, _ = load_vehicle("hexjet")
    (found,) = notes(scenario_of(vehicle=changed(vehicle, **model)))
    assert said in found


def test_an_axis_that_banks_turn_goes_with_the_weight() -> None:
    """Pitch by tilt: a model of its own gain and lag agrees, and one made at twice the weight does not."""
    vehicle, _ = load_vehicle("hexjet")
    assert vehicle.servo is not None
    height = abs(sum(jet.position_m[2] for jet in vehicle.jets)) / 6.0
    gain = height * vehicle.mass_kg * 9.80665 / vehicle.inertia_kg_m2[1]
    step = scenario_of().step_s
    servos, gyro = exp(-step / vehicle.servo.lag_s), exp(-step / vehicle.sensors.gyro.filter_s)
    model = {"gain": gain * step * (1.0 - servos) * (1.0 - gyro), "zeros": [0.0, 0.0], "poles": [0.9999, servos, gyro]}
    model |= {"delay_samples": 0, "sample_time_s": step, "source": "by hand"}
    stated = {"identified": {"edf-as-flown": {"pitch": model}}}
    found = agreements(scenario_of(vehicle=stated))[-1]
    assert found.unit == "rad/s^2 per rad"
    assert found.vehicle_gain == pytest.approx(gain, rel=1e-6)
    assert not found.is_noteworthy, found.note
    light = agreements(scenario_of(vehicle=stated | {"mass_kg": vehicle.mass_kg / 1.6}))[-1]
    assert light.ratio == pytest.approx(1.6 * found.ratio, rel=1e-3)
    assert light.is_unfit


def test_an_axis_of_hinges_is_an_acceleration_asked_for() -> None:
    """Its gain is 1, whatever the inertia: allocation is told that."""
    model = {"gain": 0.004, "zeros": [], "poles": [1.0], "delay_samples": 20, "sample_time_s": 0.004, "source": "none"}
    stated = {"identified": {"turbine-100": {"roll": model}}}
    (found,) = agreements(scenario_of("quadjet", "turbine-100", vehicle=stated))
    assert found.vehicle_gain == 1.0
    assert found.unit == "rad/s^2 per rad/s^2"
    assert found.ratio == pytest.approx(1.0, abs=0.2)


def test_a_flight_says_it_once_and_everywhere(hexjet: Hexjet) -> None:
    setting = "vehicle.inertia_kg_m2=[0.08,0.09,0.12]"
    done = hexjet("fly", "roll-doublet", "--set", setting, "--set", "duration_s=0.3", "--out", "run")
    assert done.out.count("note: roll: the identified model with edf-as-flown is not that of the vehicle") == 1
    assert "and 225.1 by geometry, inertia and engine (1.92 times)" in done.out
    (note,) = json.loads(Path("run/summary.json").read_text())["notes"]
    assert Path("run/report.html").read_text().count(note) == 1
    done = hexjet("fly", "roll-doublet", "--set", "duration_s=0.3", "--json", "--out", "right")
    assert json.loads(done.out)["notes"] == []


def test_who_believes_no_model_is_told_nothing() -> None:
    """And a mismatch is what no controller knows of."""
    assert notes(scenario_of(**HEAVY))
    assert not notes(scenario_of(**HEAVY, controller="baseline"))
    assert not notes(scenario_of(mismatch={"mass_factor": 1.5, "delay_samples": 20}))
    assert not notes(scenario_of(added_delay_samples=20))


def test_a_payload_and_a_part_of_the_tank_count() -> None:
    load = {"kind": "payload", "start_s": 0.0, "mass_kg": 1.5, "offset_m": [0.0, 0.0, 0.1]}
    (said,) = notes(scenario_of(disturbance=[load]))
    assert "with the payload of 1.5 kg" in said
    assert fly(scenario_of(disturbance=[load])).summary.notes == [said]
    found = of(compare_flown_models, scenario_of("hexjet-p220", "p220", initial={"fuel": 0.25}))
    assert [each.state for each in found] == ["with 25 % of its fuel"]


def test_a_study_says_it_once() -> None:
    vary = ["vehicle.inertia_kg_m2.0*=0.7:1.3"]
    (note,) = model_notes(open_study("roll-doublet", controllers=["baseline", "smith"], vary=vary, runs=20))
    assert "is not that of the vehicle" in note
    assert "the farthest off of 2 among 3 at the ends of what varies" in note
    quiet = open_study("roll-doublet", controllers=["smith"], vary=["mismatch.delay_samples=0:20"], runs=5)
    assert model_notes(quiet) == design_warnings(quiet) == []


def test_a_study_says_which_design_is_for_another_engine() -> None:
    controllers = [str(ROOT / "tests" / "designs" / "edf.toml"), "smith"]
    study = open_study("roll-doublet", controllers=controllers, vary=["environment.ground_m=0:10"], runs=2)
    (note,) = design_warnings(study)
    assert note.startswith("edf.toml: designed for engine edf (")


def test_an_edit_after_new_is_not_fit_to_fly(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.aircraft_check.check.FLIGHT_S", 0.3)
    made = hexjet("aircraft", "new", "mine")
    assert "begun as a copy of hexjet: its identified models are those of that aircraft" in made.err
    assert "hexjet aircraft check ./mine compares them" in made.err
    assert "its identified models" not in hexjet("aircraft", "new", "tri", "--from", "trijet").err
    path = Path("mine/vehicle.toml")
    text = path.read_text()
    assert check_aircraft("./mine").is_fit
    edited = re.sub("(?m)^inertia_kg_m2 = .*$", "inertia_kg_m2 = [0.08, 0.09, 0.12]", text)
    path.write_text(edited.replace("mass_kg = 5.525", "mass_kg = 7.5"))
    done = hexjet("aircraft", "check", "./mine")
    assert done.status == 1
    assert "not fit to fly\nroll model, edf-as-flown: not of this vehicle" in done.out
    assert "\nroll model, edf: not of this vehicle" in done.out
    said = {line.name: line for line in check_aircraft("./mine").lines}["roll model, edf-as-flown"]
    assert "and 225.1 by geometry, inertia and engine (1.92 times)" in said.text
    assert "hexjet identify roll" in said.fault
    path.write_text(text.replace("[identified.edf.roll]", '[identified."theirs.fmu".roll]'))
    told = {line.name: line.text for line in check_aircraft("./mine").lines}
    assert told["roll model, theirs.fmu"] == "not compared: state as engine the file of engine theirs.fmu"
