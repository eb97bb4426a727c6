"""Every key of every scenario: found, explained, written, and refused where it cannot be."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command_tools import Hexjet

from cosim import fly
from cosim.base.errors import InputError
from cosim.base.storage.toml import split_key
from cosim.campaign.study.key import Key
from cosim.campaign.study.keys import all_keys, find_key, matching, with_values
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario, scenario_names
from cosim.spec.vehicle import load_vehicle


def numbers(scenario: Scenario) -> dict[str, Key]:
    return {key.path: key for key in all_keys(scenario) if key.kind in ("float", "int") and key.nominal is not None}


@pytest.mark.parametrize("name", scenario_names())
def test_what_is_there_can_be_written_over_itself(name: str) -> None:
    scenario = Scenario.load(name)
    keys = all_keys(scenario)
    stated = {key.path: key.fit(key.nominal) for key in keys if key.nominal is not None}
    assert len(keys) == len({key.path for key in keys})
    assert [key.path for key in keys if not key.meaning] == []
    assert stated == {key.path: key.nominal for key in keys if key.nominal is not None}
    assert all_keys(with_values(scenario, stated)) == keys


def test_every_number_arrives_where_it_is_named() -> None:
    """All numbers changed at once, each by a share of its own: no key writes where another one reads."""
    scenario = Scenario.load("payload-drop")
    changed: dict[str, Any] = {}
    for place, (path, key) in enumerate(numbers(scenario).items()):
        assert isinstance(key.nominal, (int, float))
        value = key.nominal + 1 if key.kind == "int" else key.nominal * (1.0 - 1e-5 * place) - 1e-9 * place
        if path != "step_s" and not path.endswith("_s") and key.low <= value <= key.high:
            changed[path] = value
    assert len(changed) > 150
    written = numbers(with_values(scenario, changed))
    assert {path: written[path].nominal for path in changed} == changed


def test_vehicle_flies_with_the_value() -> None:
    values = {"vehicle.jets.2.position_m.1": -0.16, "vehicle.inertia_kg_m2.0": 0.05}
    values |= {"engine_parameters.delay_samples": 9}
    values |= {"vehicle.identified.edf-as-flown.roll.poles.1": 0.91, "stations.3.parameters.gain": 0.3, "seed": 7}
    with build(with_values(Scenario.load("hover"), values)) as simulation:
        assert simulation.vehicle.jets[2].position_m == (0.13, -0.16, -0.08)
        assert simulation.vehicle.inertia_kg_m2 == (0.05, 0.052, 0.07)
        assert simulation.vehicle.identified["edf-as-flown"]["roll"].poles == [0.9999, 0.91]
        assert [spec.delay_samples for spec in simulation.stations] == [9] * 6
        assert [spec.parameters["gain"] for spec in simulation.stations] == [*[0.2554] * 2, 0.3, *[0.2554] * 3]
        assert simulation.scenario.seed == 7
        assert simulation.scenario.expect == []


def test_lists_of_a_resolved_scenario_are_written_by_place(tmp_path: Path) -> None:
    """A run's own scenario states the whole vehicle, lists and all."""
    fly(Scenario.load("hover").replace(duration_s=0.02, expect=[]), tmp_path / "run", report=False)
    resolved = Scenario.load(tmp_path / "run" / "scenario.toml")
    assert find_key(resolved, "vehicle.jets.2.position_m.1").nominal == -0.15
    written = with_values(resolved, {"vehicle.jets.2.position_m.1": -0.16, "vehicle.mass_kg": 6.0})
    vehicle, _ = load_vehicle(written.aircraft, written.vehicle)
    assert (vehicle.jets[2].position_m, vehicle.mass_kg) == ((0.13, -0.16, -0.08), 6.0)
    assert vehicle.jets[3] == load_vehicle("hexjet")[0].jets[3]


def test_bounds_units_and_nominal_values() -> None:
    scenario = Scenario.load("payload-drop")
    delay = find_key(scenario, "engine_parameters.delay_samples")
    assert (delay.kind, delay.nominal, delay.unit, delay.low, delay.high) == ("int", 25, "samples", 0.0, 1000.0)
    mass = find_key(scenario, "disturbance.0.mass_kg")
    assert (mass.kind, mass.nominal, mass.unit, mass.low, mass.open_low) == ("float", 0.5, "kg", 0.0, True)
    start = find_key(scenario, "disturbance.0.start_s")
    assert start.fit(1.0013) == 1.0  # 250.325 steps
    assert find_key(scenario, "controller").fit("state") == "state"
    assert find_key(scenario, "vehicle.jets.0.spin").fit(-1) == -1
    assert find_key(Scenario.load("roll-doublet"), "command.0.amplitude").unit == "deg"
    assert find_key(scenario, "vehicle.contacts.0.spring_n_m").unit == "N/m"
    assert find_key(scenario, "vehicle.control.attitude.gain_1_s.1").unit == "1/s"
    assert find_key(scenario, "monitor").nominal is None
    # what stands at a station is the scenario's engine with the scenario's parameters until it is stated
    changed = with_values(scenario, {"engine_parameters.gain": 0.3})
    assert find_key(changed, "stations.2.parameters.gain").nominal == 0.3


def test_whole_numbers_are_rounded() -> None:
    scenario = Scenario.load("hover")
    assert find_key(scenario, "engine_parameters.delay_samples").fit(24.6) == 25
    assert isinstance(find_key(scenario, "substeps").fit(3.9), int)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("engine_parameters.delay_samples", -1, "engine_parameters.delay_samples = -1: must be a whole number from 0"),
        ("vehicle.mass_kg", 0.0, "vehicle.mass_kg = 0.0: must be a number above 0"),
        ("vehicle.mass_kg", float("nan"), "vehicle.mass_kg = nan: must be a number above 0"),
        ("vehicle.mass_kg", True, "must be a number"),
        ("vehicle.control.allocation.throttle_min", 1.0, "must be a number from 0 below 1"),
        ("controller", "smth", "must be one of baseline, smith"),
        ("sensor_noise", 1, "must be true or false"),
    ],
)
def test_values_out_of_range(key: str, value: Any, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        find_key(Scenario.load("hover"), key).fit(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gyro.noise", "did you mean vehicle.sensors.gyro.noise_rad_s?"),
        ("vehicle.mass", "did you mean vehicle.mass_kg?"),
        ("mass_kg", "vehicle.mass_kg"),
        ("engine.gain", "engine_parameters.gain (the predictor's model stays) or mismatch.engine_parameters.gain (no "),
        ("engine_parameters.delai_samples", "did you mean engine_parameters.delay_samples"),
        ("vehicle.control.rate.rol.p", "did you mean vehicle.control.rate.roll.p"),
        ("wind", "did you mean environment.wind_ned_m_s.0"),
        ("xyzzy", "lists all of them"),
        (
            "vehicle.sensors.gyro",
            "below it: filter_s, noise_rad_s, bias_rad_s, latency_samples, bias_sigma_rad_s, resolution_rad_s",
        ),
        ("environment.wind_ned_m_s", "below it: 0, 1, 2"),
        ("seed", "every flight has one already"),
        ("title", "is not a number or a choice"),
        ("command.0.amplitude", "scenario hover has no [[command]]"),
        ("", "lists all of them"),
    ],
)
def test_names_that_are_no_key(text: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        find_key(Scenario.load("hover"), text)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"aircraft": "hexjet-100", "vehicle.mass_kg": 6.0},
            "aircraft = hexjet-100: vehicle.mass_kg belongs to hexjet",
        ),
        ({"engine": "turbojet", "engine_parameters.gain": 1.0}, "engine = turbojet: engine_parameters.gain belongs to"),
        (
            {"stations.2.engine": "turbojet", "stations.2.parameters.gain": 1.0},
            "stations.2.engine = turbojet: stations.2.parameters.gain belongs to edf-as-flown",
        ),
    ],
)
def test_values_that_cannot_hold(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        with_values(Scenario.load("hover"), values)


def test_parameters_stated_for_one_engine_do_not_go_to_another() -> None:
    stated = with_values(Scenario.load("hover"), {"engine_parameters.gain": 0.3})
    with pytest.raises(InputError, match="which the scenario states, belongs to edf-as-flown"):
        with_values(stated, {"engine": "turbojet"})
    assert with_values(stated, {"engine": "edf-as-flown"}).engine_parameters == {"gain": 0.3}
    assert with_values(stated, {"stations.2.engine": "turbojet"}).stations["2"].parameters == {}
    stated = with_values(Scenario.load("hover"), {"stations.2.parameters.gain": 0.3})
    with pytest.raises(InputError, match=r"stations.2.parameters.gain, which the scenario states, belongs to edf-as-f"):
        with_values(stated, {"stations.2.engine": "turbojet"})
    other = {"stations.3.engine": "turbojet", "stations.2.engine": "edf-as-flown"}
    assert with_values(stated, other).stations["2"].parameters == {"gain": 0.3}


def test_another_aircraft_brings_its_engine_and_another_engine_takes_every_station() -> None:
    other = with_values(Scenario.load("hover"), {"aircraft": "hexjet-100"})
    assert other.engine == load_vehicle("hexjet-100")[0].engine
    mixed = with_values(Scenario.load("hover"), {"stations.2.engine": "turbojet"})
    assert list(mixed.stations) == ["2"]
    assert with_values(mixed, {"engine": "edf"}).stations == {}


def test_names_with_dots_of_their_own() -> None:
    assert split_key("engine_parameters.core.fan[1].gain") == ["engine_parameters", "core.fan[1].gain"]
    assert split_key("stations.2.parameters.core.gain") == ["stations", "2", "parameters", "core.gain"]
    assert split_key("vehicle.identified.mine.fmu.roll.poles.1") == [
        "vehicle",
        "identified",
        "mine.fmu",
        "roll",
        "poles",
        "1",
    ]
    model = load_vehicle("hexjet")[0].identified["edf"]["roll"].model_dump()
    scenario = Scenario.load("hover").replace(vehicle={"identified": {"mine.fmu": {"roll": model}}})
    key = find_key(scenario, "vehicle.identified.mine.fmu.roll.delay_samples")
    written = with_values(scenario, {key.path: 12.5})
    assert find_key(written, key.path).nominal == 12.5


@pytest.mark.parametrize("name", ["delay_s", "delay_samples", "engine.delay", "engine.delay_samples", "plant.delay"])
def test_a_delay_is_answered_with_its_keys_and_who_knows_of_them(name: str) -> None:
    for refused in (lambda: find_key(Scenario.load("hover"), name), lambda: Scenario.load("hover", [f"{name}=4"])):
        with pytest.raises(InputError) as error:
            refused()
        assert str(error.value).endswith(
            f"unknown key {name!r}; did you mean added_delay_samples (on the roll output; the predictor knows), "
            "mismatch.delay_samples (of every engine; no controller knows it) or engine_parameters.delay_samples (the "
            "predictor's model stays)?"
        )


def test_the_command_lists_keys_with_their_meaning_without_a_scenario(hexjet: Hexjet, monkeypatch: Any) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    listed = {key["key"]: key for key in json.loads(hexjet("sweep", "--keys", "delay", "--json").out)["keys"]}
    assert listed["mismatch.delay_samples"]["meaning"] == "of every engine; no controller knows it"
    assert listed["engine_parameters.delay_samples"]["meaning"].endswith("; the predictor's model stays")
    shown = " ".join(hexjet("sweep", "--keys", "White Noise").out.split())
    assert "in scenario roll-doublet" in shown
    assert "vehicle.sensors.gyro.noise_rad_s" in shown
    assert "name a scenario" in hexjet("sweep").err


def test_keys_are_found_by_word_or_pattern() -> None:
    keys = all_keys(Scenario.load("hover"))
    names = ("gain", "pole", "delay_samples", "newton_per_unit")
    assert [key.path for key in matching(keys, "engine_parameters")] == [
        f"{table}.{name}" for table in ("engine_parameters", "mismatch.engine_parameters") for name in names
    ]
    assert [key.path for key in matching(keys, "*.gain") if key.path.startswith("eng")] == ["engine_parameters.gain"]
    with pytest.raises(InputError, match=r"no key matches 'gryo'; did you mean vehicle\.sensors\.gyro"):
        matching(keys, "gryo")
