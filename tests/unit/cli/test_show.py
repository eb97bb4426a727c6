"""hexjet show: the numbers of what can be flown, against the files and against exact figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cosim import fly
from cosim.api.listing import catalogue
from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.cli.main import run
from cosim.spec.new_aircraft import new_aircraft
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    assert run(["show", *arguments, "--json"]) == 0
    found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)
    return found


def numbers(one: dict[str, Any]) -> dict[str, Any]:
    return {number["name"]: number["value"] for number in one["numbers"]}


def test_an_aircraft_can_be_judged_by_its_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = shown(capsys, "hexjet")
    said = numbers(one)
    vehicle, _ = load_vehicle("hexjet")
    assert (one["kind"], said["mass"], said["jets"]) == ("aircraft", vehicle.mass_kg, 6)
    assert said["hover thrust"] == pytest.approx(vehicle.mass_kg * 9.80665 / 6.0)
    assert said["thrust to weight"] == pytest.approx(said["full thrust"] / said["hover thrust"])
    # the closed form of the engine: gain / (1 - pole), in kgf
    assert said["full thrust"] == pytest.approx(0.2554 / (1.0 - 0.8748) * 9.80665)
    delay = vehicle.identified["edf-as-flown"]["roll"].delay_samples
    assert said["dead time, roll, edf-as-flown"] == pytest.approx(delay * 0.004)


def test_engines_of_two_kinds_count_each_with_its_own_thrust(capsys: pytest.CaptureFixture[str]) -> None:
    (one,) = shown(capsys, "trijet")
    said = numbers(one)
    assert said["full thrust, edf-as-flown"] == pytest.approx(0.2554 / (1.0 - 0.8748) * 9.80665)
    both = 2.0 * said["full thrust, turbine-20"] + said["full thrust, edf-as-flown"]
    assert said["thrust to weight"] == pytest.approx(both / (load_vehicle("trijet")[0].mass_kg * 9.80665))
    hinge = next(each for each in one["numbers"] if each["name"] == "hinge tilt_left")
    assert hinge["meaning"] == "either way; carries 1"


def test_an_engine_and_a_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    (engine,) = shown(capsys, "motor")
    assert numbers(engine)["internal step"] == 0.0025
    assert numbers(engine)["dead time"] == pytest.approx(0.0125)
    assert numbers(engine)["idle thrust"] == 0.0
    (gust,) = shown(capsys, "gust", "--kind", "scenarios")
    assert numbers(gust)["controller"] == "smith"  # the file leaves it to the default
    assert numbers(gust)["limits.drift_m"] == 51.0
    assert {"name": "duration_s", "value": 15.0, "unit": "s", "meaning": "of the flight"} in gust["numbers"]
    assert run(["show", "gust"]) == 0
    assert "velocity_ned_m_s=[0, " in " ".join(capsys.readouterr().out.split())


def test_every_controller_and_a_name_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    for entry in catalogue("controllers"):
        assert shown(capsys, entry["name"])[0]["kind"] == "controllers"
    with pytest.raises(InputError, match="called 'gusty'; did you mean 'gust'") as complaint:
        run(["show", "gusty"])
    assert "hexjet show" in str(complaint.value)


def test_a_design_says_what_it_is_for_and_what_its_proof_came_to(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folder = Path(__file__).parents[2]
    (one,) = shown(capsys, str(folder / "designs" / "p220.toml"))
    assert (one["kind"], one["title"]) == ("designs", "baseline for hexjet-p220 with engine p220")
    assert one["description"] == "its proof of 22 flights kept what was promised"
    design = read_toml(folder / "designs" / "p220.toml")
    assert numbers(one)["roll.gain_margin_db"] == design["design"]["axes"]["roll"]["gain_margin_db"]
    assert numbers(one)["control.rate.yaw.p"] == design["vehicle"]["control"]["rate"]["yaw"]["p"]
    (tmp_path / "controller.toml").write_bytes((folder / "designs" / "p220.toml").read_bytes())
    (beside,) = shown(capsys, str(tmp_path))
    assert (beside["title"], numbers(beside)) == (one["title"], numbers(one))
    (older,) = shown(capsys, str(folder / "older" / "0.2.0-a" / "design.toml"))
    assert older["description"].startswith("has no proof flights")


@pytest.mark.parametrize("name", ["scenarios/hover.toml", "studies/mass.toml", "nothing.toml"])
def test_another_file_is_no_design(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "mass.toml").write_text('design = "random"\n')
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "hover.toml").write_text('name = "hover"\n')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"cannot be shown|nothing is called"):
        run(["show", name])


def test_a_run_shows_what_fly_printed_and_margins_to_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    folder = tmp_path / "run"
    scenario = Scenario.load("roll-doublet").replace(duration_s=6.0, expect=[])
    summary = fly(scenario, folder).summary
    assert run(["show", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert max(len(line) for line in printed.splitlines() if not line.startswith("report: ")) <= 80
    rows = [line.split() for line in printed.partition(" limit or expectation")[2].splitlines()]
    (drift,) = [result for result in summary.requirements if result.name == "position.drift_m"]
    assert drift.kept
    assert drift.margin is not None
    limit = f"{summary.limits['position.drift_m']:.4g}"
    assert ["drift", "from", "the", "start", "limit", "≤", limit, "m", f"{drift.margin:.4g}", "m",
            f"{drift.decided_at_s:.3f}", "s"] in rows  # fmt: skip
    (one,) = shown(capsys, str(folder))
    assert (one["kind"], one["title"]) == ("runs", summary.ending)
    (number,) = [each for each in one["numbers"] if each["name"] == "position.drift_m"]
    assert number["value"] == summary.position.drift_m
    assert number["meaning"].startswith(f"limit ≤ {limit} m, margin ")
    message = r"summary.json: cannot be shown; allowed: a name of hexjet show, the folder of a run"
    with pytest.raises(InputError, match=message):
        run(["show", str(folder / "summary.json")])


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("empty", "empty: cannot be shown; allowed: a name of hexjet show, the folder of a run"),
        ("hover-smith-001", "nothing is called 'hover-smith-001'; did you mean 'runs/hover-smith-001'? see: hexjet"),
        ("runs/hover-smith-01", "nothing is called 'runs/hover-smith-01'; did you mean 'runs/hover-smith-001'?"),
    ],
)
def test_what_cannot_be_shown_is_answered_with_what_can(name: str, line: str, tmp_path: Path, monkeypatch: Any) -> None:
    for each in ("empty", "runs/hover-smith-001"):
        (tmp_path / each).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as refused:
        run(["show", name])
    assert str(refused.value).startswith(line)


def test_files_and_folders_of_ones_own_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\ntitle = "My flight"\nduration_s = 3.0\nengine = "motor"\n')
    (one,) = shown(capsys, str(file))
    assert (one["kind"], one["title"], numbers(one)["engine"]) == ("scenarios", "My flight", "motor")
    study = tmp_path / "mass.toml"
    study.write_text('scenario = "hover"\ntitle = "Masses"\nruns = 4\n[[vary]]\nkey = "seed"\nvalues = [1, 2]\n')
    (one,) = shown(capsys, str(study))
    assert (one["kind"], one["title"], numbers(one)["runs"]) == ("studies", "Masses", 4)
    new_aircraft("mine", "quadjet", tmp_path / "mine")
    (one,) = shown(capsys, str(tmp_path / "mine"))
    (shipped,) = shown(capsys, "quadjet")
    assert (one["kind"], numbers(one)) == ("aircraft", numbers(shipped))
