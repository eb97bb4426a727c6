"""What a Python user types first, as a reviewer typed it: each works, or its error names the cure."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import cosim
from cosim import InputError, Run, Scenario
from cosim.api import SweepResult
from cosim.base.errors import Notice
from cosim.campaign.study.distributions import parse_vary

pandas = pytest.importorskip("pandas", reason="no pandas, which makes tables")
SHORT = {"duration_s": 0.1, "command": []}
MASS = "vehicle.mass_kg"


def fly(**choices: Any) -> Run:
    return cosim.fly("roll-doublet", settings=SHORT, **choices)


def sweep(**choices: Any) -> SweepResult:
    return cosim.sweep("hover", workers=1, settings={"duration_s": 0.02}, out=f"swept-{len(repr(choices))}", **choices)


@cache
def flown(controller: str = "smith") -> Run:
    return fly(controller=controller)


@cache
def swept() -> SweepResult:
    return sweep(vary={MASS: [5.5, 5.6]})


WORKS = {
    "settings of a flight": lambda: fly().scenario.duration_s == 0.1,
    "engine of a flight": lambda: fly(engine="edf").scenario.engine == "edf",
    "aircraft of a flight": lambda: fly(aircraft="octojet").scenario.aircraft_name == "octojet",
    "seed of a flight": lambda: fly(seed=5).summary.seed == 5,
    "one setting as a text": lambda: cosim.fly("hover", settings="duration_s=0.1").scenario.duration_s == 0.1,
    "settings of a scenario": lambda: Scenario.load("hover", settings={MASS: 6.0}).vehicle[MASS[8:]] == 6.0,
    "settings by their place": lambda: Scenario.load("hover", {"duration_s": 2.0}).duration_s == 2.0,
    "a dotted key": lambda: (
        Scenario.load("hover").replace(**{"engine_parameters.delay_samples": 40}).engine_parameters
        == {"delay_samples": 40.0}
    ),
    "two dotted keys": lambda: (
        Scenario.load("roll-doublet").replace(**{"command.0.amplitude": 5, MASS: 6}).vehicle == {"mass_kg": 6}
    ),
    "a list to vary": lambda: swept().columns[MASS] == [5.5, 5.6],
    "one text to vary": lambda: sweep(vary=f"{MASS}=5.5,5.7").columns[MASS] == [5.5, 5.7],
    "one controller": lambda: (
        set(sweep(vary={MASS: (5.5, 5.8)}, controllers="baseline").columns["controller"]) == {"baseline"}
    ),
    "a list to compare": lambda: len(cosim.compare([flown(), flown("baseline")]).compared) == 1,
    "runs to compare": lambda: len(cosim.compare(flown(), flown("baseline")).compared) == 1,
    "a list to plot": lambda: len(cosim.plot([flown(), flown("baseline")], "roll_rad").data) == 2,
    "runs to plot": lambda: len(cosim.plot(flown(), flown("baseline"), "roll_rad").data) == 2,
    "the log as a table": lambda: pandas.DataFrame(flown().log).shape == (25, len(flown().log.columns)),
    "the run as a table": lambda: flown().table("roll_rad").shape == (25, 1),
    "the columns of a sweep as a table": lambda: list(pandas.DataFrame(swept().columns)[MASS]) == [5.5, 5.6],
    "a sweep as a table": lambda: list(swept().table()["success"]) == [True, True],
    "the verdict": lambda: flown().verdict == "completed, nothing checked" and swept().verdict.startswith("2 flights"),
    "a dictionary": lambda: flown().to_dict()["scenario"] == "roll-doublet" and "controllers" in swept().to_dict(),
    "files": lambda: fly(out="kept").files.keys() >= {"report", "summary", "flight"} and flown().files == {},
    "the report": lambda: fly(out="paged").report == Path("paged/report.html") and flown().report is None,
    "the altitude": lambda: flown().metrics["altitude"].rmse_m < 1.0 and next(iter(flown().metrics)) == "roll",
    "dir of a scenario": lambda: (
        not {n for n in dir(Scenario) if n[0] != "_"} & set(dir(BaseModel)) and "engine" in dir(Scenario)
    ),
}
FAILS = {
    "a design in a scenario": (
        lambda: cosim.fly(Scenario.load("hover").replace(controller="gryphon.toml")), "give it as controller",
    ),
    "a wrong axis": (lambda: cosim.margins("hover", axes="rol"), "did you mean 'roll'"),
    "a wrong metric": (lambda: flown().metrics["rol"], "did you mean 'roll'"),
    "a wrong column": (lambda: swept().columns["sucess"], "did you mean 'success'"),
}  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def _here(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("guesses"))
        yield


@pytest.mark.parametrize("guess", WORKS)
def test_a_first_guess_works(guess: str) -> None:
    assert WORKS[guess]()


@pytest.mark.parametrize("guess", FAILS)
def test_a_first_guess_that_is_wrong_names_the_cure(guess: str) -> None:
    call, cure = FAILS[guess]
    with pytest.raises((InputError, KeyError), match=cure):
        call()


def test_a_note_is_a_warning_at_the_line_of_the_guess() -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        cosim.fly("roll-doublet", settings={"duration_s": 0.1})
    assert {(each.category, Path(each.filename).name) for each in said} == {(Notice, "test_first_guesses.py")}


def test_values_to_vary_are_written_as_a_study_has_them() -> None:
    from cosim.base.storage.settings import as_texts

    assert as_texts({"a": [5, 6.5], "b": "1:2", "c": [True, False]}) == ["a=5,6.5", "b=1:2", "c=true,false"]
    assert [parse_vary(text).key for text in as_texts({MASS: (5, 6)})] == [MASS]
