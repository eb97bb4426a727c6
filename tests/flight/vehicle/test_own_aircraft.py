"""An aircraft in a folder of one's own: named by its path, the same flight, copied into the run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_tools import Hexjet
from places import DESIGNS, ROOT

from cosim import InputError, Run, Scenario, fly
from cosim.base.storage.toml import read_toml
from cosim.results.log.digest import log_digest
from cosim.spec.vehicle import load_vehicle

SHORT = {"controller": "baseline", "duration_s": 0.4, "expect": []}
SCALED = 'name = "same"\ntitle = "a copy, at the same mass"\n[scaled]\nbase = "hexjet"\nmass_kg = 5.525\n'


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """The Hex-Jet, by another name and from elsewhere."""
    folder = tmp_path / "mine"
    shutil.copytree(ROOT / "aircraft" / "hexjet", folder)
    text = (folder / "vehicle.toml").read_text().replace('name = "hexjet"', 'name = "mine"')
    (folder / "vehicle.toml").write_text(text)
    return folder


def flown(aircraft: str, out: Path | None = None) -> Run:
    run = fly(Scenario.load("roll-doublet").replace(aircraft=aircraft, **SHORT), out)
    assert run.outcome == "completed", run.reason
    return run


def test_it_flies_as_the_one_that_it_is_a_copy_of(mine: Path, tmp_path: Path) -> None:
    run = flown(str(mine), tmp_path / "run")
    assert log_digest(run.log) == log_digest(flown("hexjet").log)
    assert run.summary.aircraft == "mine"


def test_a_run_that_was_moved_flies_again_without_the_folder(mine: Path, tmp_path: Path) -> None:
    first = flown(str(mine), tmp_path / "run")
    digest = log_digest(first.log)
    shutil.rmtree(mine)
    moved = (tmp_path / "run").rename(tmp_path / "moved")
    again = fly(moved / "scenario.toml", tmp_path / "again")
    assert log_digest(again.log) == digest
    assert again.summary.sha256 == first.summary.sha256
    assert again.summary.aircraft == "mine"


@pytest.mark.parametrize("named", ["../mine", "../mine/vehicle.toml"])
def test_a_scenario_names_it_as_seen_from_its_own_folder(mine: Path, tmp_path: Path, named: str) -> None:
    (tmp_path / "flights").mkdir()
    scenario = tmp_path / "flights" / "short.toml"
    scenario.write_text(f'name = "short"\naircraft = "{named}"\nduration_s = 0.1\n')
    assert fly(scenario).summary.aircraft == "mine"


def test_a_scaled_copy_of_a_shipped_one_is_copied_whole(tmp_path: Path) -> None:
    """At the mass of what it is a copy of, it is what it is a copy of."""
    (tmp_path / "same").mkdir()
    (tmp_path / "same" / "vehicle.toml").write_text(SCALED)
    run = flown(str(tmp_path / "same"), tmp_path / "run")
    assert log_digest(run.log) == log_digest(flown("hexjet").log)
    assert "scaled" not in read_toml(tmp_path / "run" / "vehicle.toml")
    assert log_digest(fly(tmp_path / "run" / "scenario.toml").log) == log_digest(run.log)


def test_its_own_engine_is_seen_from_its_own_folder(mine: Path, hexjet: Hexjet) -> None:
    (mine / "motor.fmu").write_bytes((ROOT / "fmus" / "edf-as-flown.fmu").read_bytes())
    replace_in(mine, 'engine = "edf-as-flown"', 'engine = "motor.fmu"')
    done = hexjet(
        "fly", "hover", "--aircraft", "./mine", "--set", "duration_s=0.1", "--controller", "baseline", "--out", "r"
    )
    assert done.status == 0, done.err
    assert Path("r/motor.fmu").is_file()


def test_engines_of_single_jets_go_along_and_stay_theirs(mine: Path, tmp_path: Path) -> None:
    """One seen from elsewhere, one that the scenario replaces by the common one, and an engine that does not fly."""
    data = {name: (ROOT / "fmus" / f"{name}.fmu").read_bytes() for name in ("edf", "edf-as-flown")}
    (tmp_path / "shelf").mkdir()
    (tmp_path / "shelf" / "other.fmu").write_bytes(data["edf"])
    (mine / "motor.fmu").write_bytes(data["edf-as-flown"])
    replace_in(mine, 'engine = "edf-as-flown"', 'engine = "motor.fmu"')
    jets = (mine / "vehicle.toml").read_text().split("[[jets]]")
    for number in (2, 5):
        jets[number] = '\nengine = "../shelf/other.fmu"' + jets[number]
    (mine / "vehicle.toml").write_text("[[jets]]".join(jets))
    changes = SHORT | {"aircraft": str(mine), "engine": "edf-as-flown", "stations": {"5": {"engine": "edf-as-flown"}}}
    first = fly(Scenario.load("roll-doublet").replace(**changes), tmp_path / "run")
    digest, moved = log_digest(first.log), (tmp_path / "run").rename(tmp_path / "moved")
    assert digest != log_digest(flown("hexjet").log)
    shutil.rmtree(mine)
    shutil.rmtree(tmp_path / "shelf")
    assert log_digest(fly(moved / "scenario.toml").log) == digest
    assert (moved / "other.fmu").is_file()
    assert "engine" not in read_toml(moved / "vehicle.toml")


def test_an_engine_of_a_jet_that_is_not_there_is_named(mine: Path) -> None:
    jets = (mine / "vehicle.toml").read_text().split("[[jets]]")
    jets[2] = '\nengine = "nowhere.fmu"' + jets[2]
    (mine / "vehicle.toml").write_text("[[jets]]".join(jets))
    with pytest.raises(InputError, match=r"jets.2.engine = 'nowhere.fmu': no such file, as seen from the folder"):
        load_vehicle(str(mine))


def test_a_study_of_it_flies_from_its_folder_alone(mine: Path, hexjet: Hexjet, tmp_path: Path) -> None:
    Path("own.toml").write_text('name = "own"\naircraft = "./mine"\nduration_s = 0.1\n')
    varied = ("--vary", "vehicle.mass_kg=5.5,5.6", "--workers", "1", "--out", "study")
    assert hexjet("sweep", "own.toml", *varied).status == 0
    shutil.rmtree(mine)
    moved = Path("study").rename(tmp_path / "moved")
    assert hexjet("fly", str(moved), "--flight", "1", "--out", "again").status == 0


def test_what_was_designed_for_it_flies_it_and_no_other(mine: Path, hexjet: Hexjet) -> None:
    design = DESIGNS / "edf-as-flown.toml"
    text = design.read_text()
    Path("own.toml").write_text(text.replace('aircraft = "hexjet"', 'aircraft = "mine"'))
    fly_it = ("fly", "hover", "--set", "duration_s=0.1", "--engine", "edf-as-flown", "--controller")
    assert hexjet(*fly_it, "own.toml", "--aircraft", "./mine").status == 0
    done = hexjet(*fly_it, "own.toml")
    line = "own.toml: designed for aircraft 'mine', which is not shipped; name it as aircraft"
    assert (done.status, done.err) == (2, f"hexjet: {line}\n")
    done = hexjet(*fly_it, str(design), "--aircraft", "./mine")
    assert done.status == 2
    assert "designed for aircraft 'hexjet', not for 'mine'" in done.err


def replace_in(folder: Path, old: str, new: str) -> None:
    text = (folder / "vehicle.toml").read_text()
    assert old in text
    (folder / "vehicle.toml").write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("aircraft", "said"),
    [
        ("nowhere/", "nowhere: no such file; name a folder with a vehicle.toml, or such a file"),
        ("empty/", "empty/vehicle.toml: no such file"),
        (
            "shipped",
            "allowed: crazyflie, hexjet, hexjet-100, hexjet-p220, jetwing, octojet, quadjet, quadrotor, trijet, or ./shipped",
        ),
    ],
)
def test_a_wrong_one_is_one_line(hexjet: Hexjet, aircraft: str, said: str) -> None:
    Path("empty").mkdir()
    Path("broken").mkdir()
    Path("broken/vehicle.toml").write_text("name = [")
    shutil.copytree(ROOT / "aircraft" / "hexjet", "shipped")
    done = hexjet("fly", "hover", "--aircraft", aircraft)
    assert done.status == 2
    assert said in done.err
    assert done.err.count("\n") == 1
