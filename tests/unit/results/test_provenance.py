"""A run says which design, models, vehicle and engine flew it, and does not wear the story of another flight."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

import pytest
from comparisons import compare_report

from cosim import InputError, Scenario, Stepper, fly, open_run
from cosim.campaign.study.keys import with_values
from cosim.cli.main import run as run_command
from cosim.flight import name_controller
from cosim.shelf.index import read_entry
from cosim.simulation.controllers.controller_file import apply_controller
from cosim.spec.scenario import flown_parameters, list_changes
from cosim.spec.vehicle import load_vehicle

DESIGNS = Path(__file__).parents[2] / "designs"
SHORT = ["duration_s=0.2"]


@pytest.fixture
def design(tmp_path: Path) -> Path:
    path = tmp_path / "my-design.toml"
    path.write_bytes((DESIGNS / "turbojet.toml").read_bytes())
    return path


def test_a_run_names_its_design_and_flies_again_alone(
    design: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    arguments = ["fly", "roll-doublet", "--controller", str(design), "--set", "duration_s=0.2", "--out", str(out)]
    run_command(arguments)
    run = open_run(out)
    (given,) = run.summary.parameter_files
    assert (given.kind, given.file, given.changed) == ("design", "my-design.toml", ())
    assert (out / "my-design.toml").read_bytes() == design.read_bytes()
    name = f"my-design {given.sha256[:8]} (state-disturbance)"
    assert run.summary.controller_shown == name
    assert f"controller {name}" in " ".join(capsys.readouterr().out.split())
    assert given.sha256 in (out / "scenario.toml").read_text()
    assert given.sha256 in (out / "report.html").read_text()
    assert read_entry(out).details["controller"] == name
    compare_report([run, run], tmp_path / "comparison.html")
    assert name in (tmp_path / "comparison.html").read_text()
    design.unlink()
    again = fly(out / "scenario.toml", tmp_path / "again")
    assert again.summary.parameter_files == run.summary.parameter_files
    assert (tmp_path / "again" / "flight.parquet").read_bytes() == (out / "flight.parquet").read_bytes()


@pytest.mark.parametrize("kind", [str, Path])
@pytest.mark.parametrize("given", ["roll-doublet", Scenario.load("roll-doublet")])
def test_a_program_names_a_design_as_the_command_does(
    design: Path, kind: type, given: str | Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole scenario: law, gains, models, no expectations, the file with its hash; and a flight by steps too."""
    monkeypatch.chdir(tmp_path)
    commanded = apply_controller("roll-doublet", design)
    programmed, own = name_controller(given, kind("my-design.toml"))
    assert own is None
    assert programmed.stated() == commanded.stated()
    with Stepper(programmed.replace(duration_s=0.2), controller=kind("my-design.toml")) as flight:
        while flight.ending is None:
            flight.step()
        stepped = flight.run()
    flown = fly(programmed.replace(duration_s=0.2), controller=kind("my-design.toml"), report=False)
    assert flown.summary.controller_shown == stepped.summary.controller_shown
    reference = fly(apply_controller("roll-doublet", design, SHORT), report=False)
    assert flown.summary.parameter_files == reference.summary.parameter_files
    for name in ("time_s", "roll_rad", "throttle_1", "down_m"):
        assert reference.log[name].tobytes() == flown.log[name].tobytes() == stepped.log[name].tobytes(), name


@pytest.mark.parametrize(
    ("changes", "given", "message"),
    [
        ({}, "nowhere.toml", "nowhere.toml: No such file or directory"),
        ({"aircraft": "quadrotor"}, "my-design.toml", "designed for aircraft 'hexjet', not for 'quadrotor'"),
        ({"step_s": 0.002}, "my-design.toml", "designed for steps of 0.004 s, not of 0.002 s"),
    ],
)
def test_a_design_for_something_else_is_refused_to_a_program(
    design: Path, changes: dict[str, object], given: str, message: str
) -> None:
    scenario = Scenario.load("hover").replace(controller="baseline", expect=[], **changes)
    with pytest.raises(InputError, match=message):
        fly(scenario, controller=design.with_name(given))


def test_two_designs_of_one_name_are_told_apart(design: Path, tmp_path: Path) -> None:
    first = fly(apply_controller("roll-doublet", design, SHORT))
    design.write_text(design.read_text().replace("p = 0.0225", "p = 0.0226"))
    second = fly(apply_controller("roll-doublet", design, SHORT))
    labels = [run.summary.controller_shown for run in (first, second)]
    assert len(set(labels)) == 2
    assert all(label.startswith("my-design ") for label in labels)


def test_a_design_that_is_another_or_gone_does_not_fly(design: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    fly(apply_controller("roll-doublet", design, SHORT), out, report=False)
    copy = out / "my-design.toml"
    copy.write_text(copy.read_text() + "\n")
    with pytest.raises(InputError, match=r"parameter_files\.0: .*my-design\.toml: is another file"):
        fly(out / "scenario.toml")
    copy.unlink()
    with pytest.raises(InputError, match=r"parameter_files\.0: .*No such file"):
        fly(out / "scenario.toml")


def test_a_session_goes_on_with_the_design_that_it_was_given(design: Path, tmp_path: Path) -> None:
    scenario, content = apply_controller("roll-doublet", design, SHORT), design.read_bytes()
    design.write_text("written over")
    run = fly(scenario, tmp_path / "run", report=False)
    assert (tmp_path / "run" / "my-design.toml").read_bytes() == content
    assert run.summary.parameter_files[0].changed == ()


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("/dev/zero", None, "is a device or a pipe"),
        ("a\0b.toml", None, "null"),
        ("x.toml", b"\xff\xfe", "not valid TOML"),
        ("x.toml", b"= 3", "not valid TOML"),
    ],
)
def test_a_parameter_file_of_somebody_else_is_data(file: str, content: bytes | None, said: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / file).write_bytes(content)
    entry = {"kind": "design", "file": file, "sha256": sha256(content or b"").hexdigest()}
    table = {"name": "theirs", "duration_s": 0.1, "parameter_files": [entry]}
    with pytest.raises(InputError, match=rf"parameter_files\.0: .*{said}"):
        fly(Scenario.from_table(table, tmp_path, "theirs"), report=False)


def test_values_over_a_design_are_said(design: Path) -> None:
    run = fly(apply_controller("roll-doublet", design, [*SHORT, "vehicle.control.rate.roll.p=0.03"]))
    assert run.summary.parameter_files[0].changed == ("control.rate.roll.p",)
    assert ", changed (state-disturbance)" in run.summary.controller_shown
    assert "vehicle.control.rate.roll.p = 0.03" in run.summary.title


def test_models_from_a_file_are_recorded(tmp_path: Path) -> None:
    from cosim.base.storage.toml import toml_text

    stated = load_vehicle("hexjet")[0].model_dump(mode="json", exclude_none=True)["identified"]
    model, out = tmp_path / "model.toml", tmp_path / "run"
    model.write_bytes(toml_text({"identified": stated}).encode())
    run_command(["fly", "roll-doublet", "--model", str(model), "--set", "duration_s=0.2", "--out", str(out)])
    summary = open_run(out).summary
    (given,) = summary.parameter_files
    assert (given.kind, given.file, given.changed) == ("models", "model.toml", ())
    assert summary.controller_shown == f"smith, models model {summary.parameter_files[0].sha256[:8]}"


def test_a_scenario_as_its_file_states_it_keeps_title_and_description() -> None:
    scenario = Scenario.load("roll-doublet")
    assert list_changes(scenario, []) == []
    dropped = Scenario.load("payload-drop", ["disturbance.0.mass_kg=0.8"])
    assert list_changes(dropped, []) == ["disturbance.0.mass_kg = 0.8"]
    assert list_changes(dropped.replace(disturbance=[]), []) == ["disturbance = []"]
    run = fly(scenario.replace(seed=5, expect=[]), report=False)
    assert (run.summary.title, run.summary.description) == (scenario.title, scenario.description)


@pytest.mark.parametrize(
    ("changes", "title"),
    [
        ({"engine": "edf"}, "hover: hexjet, edf, "),
        ({"controller": "baseline"}, "hover: hexjet, edf-as-flown, baseline"),
        (
            {"aircraft": "quadjet", "engine": "turbine-100", "controller": "baseline"},
            "hover: quadjet, turbine-100, baseline",
        ),
        (
            {"vehicle": {"mass_kg": 5.6}},
            "hover: hexjet, edf-as-flown, pid, with duration_s = 0.1, vehicle.mass_kg = 5.6",
        ),
    ],
)
def test_another_flight_does_not_wear_the_story(changes: dict[str, object], title: str, tmp_path: Path) -> None:
    scenario = Scenario.load("hover").replace(controller="pid").replace(**changes)
    scenario = scenario.replace(duration_s=0.1, command=[], disturbance=[])
    run = fly(scenario, tmp_path / "run", report=False)
    assert title in run.summary.title
    assert run.summary.description.startswith("Of the scenario as its file states it, not of this flight: ")
    again = fly(tmp_path / "run" / "scenario.toml", report=False)
    assert again.summary.title == run.summary.title


def test_a_flight_of_a_study_names_its_design(design: Path) -> None:
    base = Scenario.load("roll-doublet", SHORT)
    flown = with_values(base, {"controller": str(design), "vehicle.mass_kg": 5.6})
    (given,) = flown_parameters(flown)
    assert given.changed == []
    assert Path(given.file).name == "my-design.toml"
    assert "vehicle.mass_kg = 5.6" in list_changes(flown, [given])


def test_an_older_summary_opens(design: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    fly(apply_controller("roll-doublet", design, SHORT), out, report=False)
    summary = json.loads((out / "summary.json").read_text())
    for key in ("parameter_files", "changed"):
        del summary[key]
    (out / "summary.json").write_text(json.dumps(summary))
    assert open_run(out).summary.controller_shown == "state-disturbance"


def test_margins_name_the_design(design: Path) -> None:
    from hexjet_design.measured.margins import MeasuredMargins

    margins = MeasuredMargins(apply_controller("hover", design), None, {}, "")
    (given,) = margins.to_dict()["parameter_files"]
    assert (given["kind"], given["file"], given["changed"]) == ("design", "my-design.toml", [])
    assert margins.controller_shown == f"my-design {given['sha256'][:8]} (state-disturbance)"
