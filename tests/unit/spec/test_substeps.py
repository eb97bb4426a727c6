"""From the error that a flight may have to the number of JSBSim runs in its control step."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest

from cosim import InputError, Scenario
from cosim.base.storage.paths import data_folder
from cosim.campaign.folder import freeze
from cosim.campaign.study.options import open_study
from cosim.results.resolved_scenario import resolve
from cosim.results.setup import make_setup
from cosim.simulation.build import build
from cosim.simulation.notes import note_few_substeps
from cosim.spec.scenario import measured_errors
from cosim.spec.scenario.substeps import SUBSTEPS, StepErrors, runs_for
from cosim.spec.vehicle import aircraft_names

RUNS = [1, 2, 3, 4, 6, 8]


def errors(*degrees: float) -> StepErrors:
    return StepErrors(flights=1, runs=RUNS, attitude_deg=list(degrees), place_mm=[10.0 * each for each in degrees])


@pytest.mark.parametrize(
    ("size", "unit", "runs"),
    [
        (5.0, "deg", 1),
        (0.5, "deg", 2),
        (0.49, "deg", 3),
        (0.05, "deg", 6),
        (0.02, "deg", 8),
        (0.01, "deg", None),
        (5.0, "mm", 2),
        (4.9, "mm", 3),
    ],
)
def test_the_fewest_runs_that_keep_to_an_error(size: float, unit: str, runs: int | None) -> None:
    assert errors(5.0, 0.5, 0.2, 0.1, 0.05, 0.02).fewest_runs(size, unit) == runs


def test_an_error_that_is_kept_to_by_chance_does_not_count() -> None:
    assert errors(5.0, 0.1, 0.2, 0.1, 0.05, 0.02).fewest_runs(0.1, "deg") == 4


@pytest.mark.parametrize(
    ("degrees", "runs"),
    [
        ((5.0, 0.15, 0.1, 0.05, 0.04, 0.03), 2),  # a tenth of a degree more than with four
        ((5.0, 0.16, 0.1, 0.05, 0.04, 0.03), 3),
        ((5.0, 0.5, 0.4, 0.05, 0.04, 0.03), 4),
        ((0.05, 0.05, 0.05, 0.05, 0.04, 0.03), 2),  # a single run is another scheme
    ],
)
def test_campaigns_take_the_fewest_that_are_hardly_worse_than_the_usual(degrees: tuple[float, ...], runs: int) -> None:
    assert errors(*degrees).for_campaigns() == runs


def test_campaigns_keep_to_the_place_as_well() -> None:
    attitude = [5.0, 0.1, 0.1, 0.1, 0.1, 0.1]
    place = [100.0, 40.1, 40.0, 20.0, 5.0, 5.0]  # 20 mm more than with four
    assert StepErrors(flights=1, runs=RUNS, attitude_deg=attitude, place_mm=place).for_campaigns() == 3


def test_every_shipped_aircraft_is_measured() -> None:
    for name in aircraft_names():
        measured = measured_errors(name)
        assert measured is not None, name
        assert measured.runs == RUNS
        assert len(measured.attitude_deg) == len(measured.place_mm) == len(RUNS)
        assert measured.attitude_deg[-1] < measured.attitude_deg[0]
        assert runs_for("campaign", name, "test") in RUNS[1 : RUNS.index(SUBSTEPS) + 1]


def test_a_scenario_keeps_the_number_and_knows_why() -> None:
    hexjet = measured_errors("hexjet")
    cheap = Scenario.load("hover", ["substeps=campaign"])
    assert cheap.substeps == hexjet.for_campaigns()
    assert cheap.step_error == "campaign"
    close = Scenario.load("hover").replace(substeps=f"{hexjet.attitude_deg[-1]} deg")
    assert close.substeps == 8
    assert Scenario.load("hover").step_error is None
    assert Scenario.load("hover").substeps == SUBSTEPS


def test_another_aircraft_takes_its_own_number() -> None:
    names = {name: runs_for("campaign", name, "test") for name in aircraft_names()}
    flown = Scenario.load("hover").replace(substeps="campaign")
    for name, runs in names.items():
        assert flown.replace(aircraft=name).substeps == runs
    assert flown.replace(aircraft="quadrotor", substeps=7).replace(aircraft="hexjet").substeps == 7


def test_a_runs_scenario_has_the_number() -> None:
    with build(Scenario.load("hover", ["substeps=campaign", "duration_s=0.1"])) as simulation:
        resolved, _ = resolve(simulation)
    assert resolved.model_dump(mode="json")["substeps"] == runs_for("campaign", "hexjet", "test")
    assert f"substeps = {resolved.substeps}" in resolved.changed


@pytest.mark.parametrize("vary", [["vehicle.mass_kg=5:6:2"], ["aircraft=hexjet,quadrotor"]])
def test_a_campaign_takes_it_by_name(vary: list[str], tmp_path: Path) -> None:
    study = open_study("hover", vary=vary, settings=["substeps=campaign", "controller=baseline"])
    frozen = freeze(study)
    frozen.write(tmp_path)
    stored = tomllib.loads((tmp_path / "scenario.toml").read_text())["substeps"]
    # of several aircraft each has its own
    assert stored == ("campaign" if vary[0].startswith("aircraft") else study.base().substeps)
    assert bool([note for note in study.notes() if note.startswith("substeps = ")]) == ("aircraft" not in vary[0])


def test_what_fewer_runs_cost_is_said() -> None:
    hexjet = measured_errors("hexjet")
    assert note_few_substeps(Scenario.load("hover")) == []
    assert note_few_substeps(Scenario.load("hover").replace(substeps=8)) == []
    (note,) = note_few_substeps(Scenario.load("hover").replace(substeps=2))
    degrees, place = hexjet.attitude_deg[1], hexjet.place_mm[1]
    assert note.startswith(
        f"substeps = 2: shipped flights of hexjet then differ by up to {degrees:g} deg and {place:g} mm"
    )
    (note,) = note_few_substeps(Scenario.load("gust").replace(substeps=2))
    assert note.endswith("the turbulence is another than with other numbers")


def note_of(scenario: str, *settings: str) -> str:
    (note,) = note_few_substeps(Scenario.load(scenario, list(settings)))
    return note


@pytest.mark.parametrize("substeps", ["2", "campaign", "'0.02 deg'"])
def test_a_flight_as_it_was_measured_has_no_reservation(substeps: str) -> None:
    assert "not measured" not in note_of("roll-doublet", f"substeps={substeps}", "seed=7", "duration_s=5")


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        (["vehicle.mass_kg=6"], "vehicle.mass_kg"),
        (["controller=baseline"], "controller"),
        (["engine=motor", "controller=baseline"], "engine, controller"),
        (["environment.turbulence_severity=3"], "environment.turbulence_severity; the turbulence is another"),
        (["sensor_noise=false"], "sensor_noise"),
        (["duration_s=600"], "duration_s"),
    ],
)
def test_what_was_not_measured_is_said(settings: list[str], what: str) -> None:
    for substeps in ("2", "campaign", "'0.02 deg'"):
        assert f"; not measured here: {what}" in note_of("roll-doublet", f"substeps={substeps}", *settings)


def test_a_number_at_another_step_is_not_what_was_measured() -> None:
    assert note_of("roll-doublet", "substeps=2", "step_s=0.002").endswith("; not measured here: step_s")


def test_an_error_at_another_step_is_refused() -> None:
    with pytest.raises(InputError, match=r"hexjet are measured at its control step of 0\.004 s, and not at 0\.002 s"):
        Scenario.load("roll-doublet", ["substeps='0.02 deg'", "step_s=0.002"])
    with pytest.raises(InputError, match=r"not at 0\.002 s"):
        Scenario.load("roll-doublet", ["substeps=campaign", "vehicle.step_s=0.002"])
    assert Scenario.load("roll-doublet", ["substeps=campaign", "step_s=0.004"]).substeps == 2


def test_a_flight_that_is_not_shipped_says_so(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'name = "mine"\nduration_s = 1.0\nsubsteps = "5 mm"\ncontroller = "baseline"\n[vehicle]\nmass_kg = 6.0\n'
    )
    assert note_of(str(file)).endswith(
        "; not measured here: this flight, which is none of them, controller, vehicle.mass_kg"
    )


def test_a_study_says_that_what_it_varies_was_not_measured() -> None:
    study = open_study("roll-doublet", vary=["vehicle.mass_kg=5:6:2"], settings=["substeps=campaign"])
    (note,) = (note for note in study.notes() if note.startswith("substeps"))
    assert note.endswith("; not measured here: vehicle.mass_kg")


def test_the_record_of_a_flight_says_it() -> None:
    settings = ["substeps='0.02 deg'", "vehicle.mass_kg=6", "duration_s=0.1", "command=[]"]
    with build(Scenario.load("roll-doublet", settings)) as simulation:
        notes = make_setup(simulation, resolve(simulation)[0]).notes
    (note,) = (note for note in notes if note.startswith("substeps = 6, for '0.02 deg'"))
    assert note.endswith("; not measured here: command, vehicle.mass_kg")


def test_what_fewer_runs_cost_an_aircraft_of_ones_own_is_not_known(tmp_path: Path) -> None:
    folder = shutil.copytree(data_folder("aircraft") / "quadrotor", tmp_path / "mine")
    shipped = (folder / "vehicle.toml").read_text()
    (folder / "vehicle.toml").write_text(shipped.replace('name = "quadrotor"', 'name = "mine"', 1))
    own = Scenario.load("hover").replace(aircraft=str(folder), engine="motor", controller="baseline", substeps=2)
    assert note_few_substeps(own) == ["substeps = 2: what fewer than 4 cost mine in accuracy has not been measured"]
    with pytest.raises(InputError, match=r"errors are measured for shipped aircraft, and not for .*mine; state a num"):
        own.replace(substeps="campaign")


def test_an_aircraft_that_there_is_not_is_still_told_by_name() -> None:
    with pytest.raises(InputError, match="unknown aircraft 'hexjat'; did you mean 'hexjet'"):
        Scenario.load("hover").replace(aircraft="hexjat", substeps="campaign")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "cheap",
            "substeps = 'cheap': a whole number, 'campaign', or the error to keep to, such as '0.01 deg' or '1 mm'",
        ),
        ("0 deg", "such as '0.01 deg'"),
        ("1e-9 deg", "deg with 8, the most that is measured; state a number"),
    ],
)
def test_wrong_errors_are_one_clear_line(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Scenario.load("hover").replace(substeps=text)
    assert said in str(caught.value)
    assert str(caught.value).startswith("scenario hover: substeps")
