"""The command line as a user meets it: exit status, one line for wrong input, JSON, what is left behind."""

from __future__ import annotations

import errno
import json
import shutil
import tempfile
from pathlib import Path

import pytest
from command_tools import Hexjet

from cosim.base.storage.paths import data_folder

SHORT = ["--set", "duration_s=1.0"]


def test_fly_leaves_a_run_and_says_where(hexjet: Hexjet, tmp_path: Path) -> None:
    told = hexjet("fly", "roll-doublet", *SHORT).told
    assert "roll-doublet: completed" in told
    assert "report: runs/roll-doublet-smith-001/report.html" in told
    folder = tmp_path / "runs" / "roll-doublet-smith-001"
    assert {p.name for p in folder.iterdir()} == {"summary.json", "scenario.toml", "flight.parquet", "report.html"}
    assert hexjet("fly", "roll-doublet", *SHORT).status == 0
    assert (tmp_path / "runs" / "roll-doublet-smith-002").is_dir()


def test_json_is_one_object_and_nothing_else(hexjet: Hexjet) -> None:
    done = hexjet("fly", "hover", "--json", "--seed", "5", "--engine", "edf", "--controller", "baseline", *SHORT)
    summary = json.loads(done.out)
    assert done.err == ""
    told = {name: summary[name] for name in ("outcome", "seed", "engine", "controller")}
    assert told == {"outcome": "completed", "seed": 5, "engine": "edf", "controller": "baseline"}
    wanted = "reason scenario aircraft steps duration_s wall_s realtime_factor step_us metrics versions sha256"
    assert summary.keys() >= set(wanted.split())
    assert set(summary["sha256"]) == {"hexjet.xml", "hexjet.xml as flown", "edf.fmu"}
    of_an_axis = "rmse_rad max_abs_error_rad overshoot_percent settling_time_s rate_rmse_rad_s"
    assert summary["metrics"]["roll"].keys() >= set(of_an_axis.split())


def test_a_resolved_scenario_flies_again_to_the_same_bits(hexjet: Hexjet, tmp_path: Path) -> None:
    """From another folder, with sticks from a file, an overridden vehicle and an engine parameter."""
    settings = "--set duration_s=3.0 --set vehicle.mass_kg=5.8 --set engine_parameters.delay_samples=20"
    assert hexjet("fly", "manual", *settings.split(), "--out", "first").status == 0
    shutil.move(tmp_path / "first", tmp_path / "moved")
    assert hexjet("fly", "moved/scenario.toml", "--out", "second").status == 0
    for name in ("flight.parquet", "scenario.toml"):
        assert (tmp_path / "moved" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()


def test_a_lost_vehicle_is_status_1_with_log_and_report(hexjet: Hexjet, tmp_path: Path) -> None:
    done = hexjet("fly", "roll-doublet", "--controller", "baseline", "--out", "lost")
    assert done.status == 1
    assert "diverged" in done.out
    assert (tmp_path / "lost" / "report.html").is_file()


def test_a_missed_expectation_is_status_1_and_named(hexjet: Hexjet, tmp_path: Path) -> None:
    text = (data_folder("scenarios") / "hover.toml").read_text().replace("duration_s = 20.0", "duration_s = 1.0")
    strict = text.replace('"roll.rmse_rad" = { max = 0.01 }', '"roll.rmse_rad" = { max = 1e-9 }')
    (tmp_path / "strict.toml").write_text(strict)
    done = hexjet("fly", "strict.toml")
    assert done.status == 1
    assert "not as expected: roll.rmse_rad" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("fly rol-doublet", "unknown scenario 'rol-doublet'; did you mean 'roll-doublet', '"),
        ("fly hover --controller nowhere", "unknown controller 'nowhere'; allowed: adrc, baseline, fil"),
        ("fly hover --engine edg", "unknown engine 'edg'; did you mean 'edf'? allowed: edf, edf-as-flown"),
        ("fly hover --engine none.fmu --out empty", "none.fmu: "),
        ("fly hover --set vehicle.mass_kg=-2", "mass_kg = -2"),
        ("fly hover --set duration_s='2'", "hover.toml: settings: duration_s = '2': must be a number"),
        ("fly hover --set added_delay_samples=60ms", "60ms are 15 samples of 4 ms, the Hex-Jet's control step"),
        ("fly hover --set duration_s=2s", "'2s': must be a number, in the unit that the key ends with"),
        (
            "fly hover --set vehicle.mas=3",
            "unknown key 'mas'; did you mean 'mass_kg'? see: hexjet sweep --keys vehicle",
        ),
        ("fly hover --set mismatch.delay_samples=0.06", "part; a sample is one control step (step_s, 0.004 s"),
        ("fly hover --set vehicle.name='a/b'", "name = 'a/b'"),
        ("fly hover --seed -1", "seed = -1"),
        ("fly hover --engine turbojet", "needs an identified model of hexjet with engine 'turbojet'"),
        ("fly", "Missing argument 'SCENARIO'"),
        ("show nowhere --page", "nowhere: no run here"),
        ("export nowhere --to csv", "nowhere: no run here"),
        ("export nowhere --to xls", "'xls': allowed: csv, mat, mcap, parquet, ulog"),
        ("engine check edf --step nan", "nan is not a finite number"),
        ("design --engine edf --max-sensitivity nan", "nan is not a finite number"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_no_folder(
    hexjet: Hexjet, tmp_path: Path, arguments: str, message: str
) -> None:
    said = hexjet(*arguments.split()).refusal
    assert said.startswith("hexjet: ")
    assert message in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("expect", "message"),
    [
        ("controller = 'pd'\nengine = 'edf'", "expect.0.controller: unknown 'pd'"),
        ("controller = 'smith'\nengine = 'edg'", "expect.0.engine: unknown 'edg'; did you mean 'edf'?"),
        (
            "controller = 'smith'\nengine = 'edf'\nmetrics = { 'roll.rms' = { max = 1 } }",
            "expect.0.metrics: unknown 'roll.rms'; did you mean 'roll.rmse_rad'?",
        ),
    ],
)
def test_what_nothing_could_meet_is_refused(hexjet: Hexjet, tmp_path: Path, expect: str, message: str) -> None:
    (tmp_path / "x.toml").write_text(f"name = 'x'\nduration_s = 1.0\n[[expect]]\n{expect}\n")
    assert message in hexjet("fly", "x.toml").refusal
    assert not (tmp_path / "runs").exists()


def test_a_folder_with_a_run_is_not_written_over(hexjet: Hexjet, tmp_path: Path) -> None:
    assert hexjet("fly", "hover", *SHORT, "--out", "kept").status == 0
    before = {p.name: p.read_bytes() for p in (tmp_path / "kept").iterdir()}
    assert "already holds a run" in hexjet("fly", "hover", *SHORT, "--out", "kept").refusal
    assert {p.name: p.read_bytes() for p in (tmp_path / "kept").iterdir()} == before


def test_list(hexjet: Hexjet) -> None:
    everything = json.loads(hexjet("show", "--json").out)
    assert set(everything) == {"scenarios", "studies", "engines", "aircraft", "controllers"}
    assert {e["name"] for e in everything["engines"]} >= {"turbojet", "edf", "edf-as-flown"}
    assert all(entry["title"] for entries in everything.values() for entry in entries)
    text = hexjet("show", "scenarios").out
    assert "roll-doublet" in text
    assert "turbojet" not in text


def test_report_and_export_of_a_run(hexjet: Hexjet, tmp_path: Path) -> None:
    hexjet("fly", "hover", *SHORT, "--out", "run")
    (tmp_path / "run" / "report.html").unlink()
    assert hexjet("show", "run", "--page").status == 0
    assert (tmp_path / "run" / "report.html").is_file()
    assert hexjet("export", "run", "--to", "csv").out.strip() == "run/flight.csv"
    assert (tmp_path / "run" / "flight.csv").read_text().startswith("time_s,roll_rad,")
    assert hexjet("export", "run", "--to", "ulog").status == 0
    for target in ("mcap", "mat", "parquet"):
        assert hexjet("export", "run", "--to", target, "--out", f"x.{target}").out.strip() == f"x.{target}"
        assert (tmp_path / f"x.{target}").is_file()
    assert "the log is Parquet already" in hexjet("export", "run", "--to", "parquet").err
    assert hexjet("export", "run", "--to", "mat", "--rates", "px4").status == 2


def test_fmu_check_and_build(hexjet: Hexjet) -> None:
    assert "delay 25 samples" in hexjet("engine", "check", "turbojet", "-v").told
    assert json.loads(hexjet("engine", "check", "edf-as-flown-fmi2", "--json").out)["ok"]
    assert hexjet("engine", "build", "edf").out.split("\n")[0].endswith("edf.fmu")


def test_a_machine_that_has_no_more_to_give_is_told_in_a_line(hexjet: Hexjet, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("cosim.flight.fly_watched", full)
    said = f"hexjet: No space left on device; temporary files are in {tempfile.gettempdir()}\n"
    assert hexjet("fly", "hover") == (1, "", said)
