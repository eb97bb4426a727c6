"""hexjet new: the flight, the study, the script and the notebook of a new project run as they are, untrusted before."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_tools import Hexjet

from cosim import Scenario, fly
from cosim.base import trust


@pytest.fixture
def project(hexjet: Hexjet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.delenv(trust.ENV_VAR)
    monkeypatch.chdir(tmp_path)
    made = hexjet("new", "mine")
    assert made.status == 0
    assert made.out.splitlines()[:3] == ["mine", "cd mine", "hexjet fly flight.toml"]
    monkeypatch.chdir("mine")
    return tmp_path / "mine"


def test_a_project_runs_as_it_is(project: Path, hexjet: Hexjet) -> None:
    assert "as planned" in hexjet("fly", "flight.toml", "--out", "flown").out
    swept = hexjet("sweep", "study.toml", "--runs", "2", "--out", "swept")
    assert (swept.status, "smith: 100.0 % of 2" in swept.out) == (0, True)
    for cells in ([(project / "compare.py").read_text()], notebook_cells()):
        names = {"__file__": str(project / "compare.py")}
        for cell in cells:
            exec(compile(cell, "cell", "exec"), names)
    assert (project / "runs/compared-001/comparison.html").is_file()


def notebook_cells() -> list[str]:
    notebook = json.loads(Path("notebook.ipynb").read_text())
    assert (notebook["nbformat"], notebook["cells"][0]["source"][0]) == (4, "# mine\n")
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] for cell in cells)
    return ["".join(cell["source"]) for cell in cells]


def test_the_number_that_the_flight_names_makes_it_red(project: Path) -> None:
    engine = project / "engine/engine.toml"
    engine.write_text(engine.read_text().replace("delay_samples = 25", "delay_samples = 40"))
    assert not fly(Scenario.load("flight.toml")).summary.succeeded


def test_a_folder_that_is_not_empty_is_refused(project: Path, hexjet: Hexjet) -> None:
    os.chdir("..")
    for arguments, said in (
        (("mine",), "mine: is not empty; choose another name, or another folder (out)"),
        (("other", "--out", "mine/flight.toml"), "mine/flight.toml"),
        (("hexjet",), "hexjet: is the name of an aircraft that is shipped"),
    ):
        done = hexjet("new", *arguments)
        assert (done.status, done.err.count("\n")) == (2, 1)
        assert said in done.err
    assert not Path("hexjet").exists()
