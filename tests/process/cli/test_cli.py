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


def test_fly_leaves_a_run_and_says_where(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    done = hexjet("fly", "roll-doublet", *SHORT)
    assert done.status == 0
    assert "roll-doublet: completed" in done.out
    assert "report: runs/roll-doublet-smith-001/report.html" in done.out
    folder = tmp_path / "runs" / "roll-doublet-smith-001"
    assert {p.name for p in folder.iterdir()} == {"summary.json", "scenario.toml", "flight.parquet", "report.html"}
    assert hexjet("fly", "roll-doublet", *SHORT).status == 0
    assert (tmp_path / "runs" / "roll-doublet-smith-002").is_dir()


def test_json_is_one_object_and_nothing_else(hexjet) -> None:  # type: ignore[no-untyped-def]
    done = hexjet("fly", "hover", "--json", "--seed", "5", "--engine", "edf", "--controller", "baseline", *SHORT)
    summary = json.loads(done.out)
    assert done.err == ""
    assert (summary["outcome"], summary["seed"], summary["engine"], summary["controller"]) == (
        "completed",
        5,
        "edf",
        "baseline",
    )
    wanted = {
        "outcome", "reason", "scenario", "aircraft", "engine", "controller", "seed", "steps", "duration_s", "wall_s",
        "realtime_factor", "step_us", "metrics", "versions", "sha256",
    }  # fmt: skip
    assert wanted <= set(summary)
    assert set(summary["sha256"]) == {"hexjet.xml", "hexjet.xml as flown", "edf.fmu"}
    assert set(summary["metrics"]["roll"]) >= {
        "rmse_rad", "max_abs_error_rad", "overshoot_percent", "settling_time_s", "rate_rmse_rad_s",
    }  # fmt: skip


def test_a_resolved_scenario_flies_again_to_the_same_bits(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """From another folder, with sticks from a file, an overridden vehicle and an engine parameter."""
    settings = [
        "--set",
        "duration_s=3.0",
        "--set",
        "vehicle.mass_kg=5.8",
        "--set",
        "engine_parameters.delay_samples=20",
    ]
    assert hexjet("fly", "manual", *settings, "--out", "first").status == 0
    shutil.move(tmp_path / "first", tmp_path / "moved")
    assert hexjet("fly", "moved/scenario.toml", "--out", "second").status == 0
    assert (tmp_path / "moved/flight.parquet").read_bytes() == (tmp_path / "second/flight.parquet").read_bytes()
    assert (tmp_path / "moved/scenario.toml").read_bytes() == (tmp_path / "second/scenario.toml").read_bytes()


def test_a_lost_vehicle_is_status_1_with_log_and_report(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    done = hexjet("fly", "roll-doublet", "--controller", "baseline", "--out", "lost")
    assert done.status == 1
    assert "diverged" in done.out
    assert (tmp_path / "lost" / "report.html").is_file()


def test_a_missed_expectation_is_status_1_and_named(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    text = (data_folder("scenarios") / "hover.toml").read_text().replace("duration_s = 20.0", "duration_s = 1.0")
    (tmp_path / "strict.toml").write_text(
        text.replace('"roll.rmse_rad" = { max = 0.01 }', '"roll.rmse_rad" = { max = 1e-9 }')
    )
    done = hexjet("fly", "strict.toml")
    assert done.status == 1
    assert "not as expected: roll.rmse_rad" in done.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fly", "rol-doublet"], "unknown scenario 'rol-doublet'; did you mean 'roll-doublet', '"),
        (["fly", "hover", "--controller", "nowhere"], "unknown controller 'nowhere'; allowed: adrc, baseline, fil"),
        (["fly", "hover", "--engine", "edg"], "unknown engine 'edg'; did you mean 'edf'? allowed: edf, edf-as-flown"),
        (["fly", "hover", "--set", "vehicle.mass_kg=-2"], "mass_kg = -2"),
        (["fly", "hover", "--set", "duration_s='2'"], "hover.toml: settings: duration_s = '2': must be a number"),
        (["fly", "hover", "--set", "added_delay_samples=60ms"], "a sample is one control step (step_s, 0.004 s on the"),
        (
            ["fly", "hover", "--set", "mismatch.delay_samples=0.06"],
            "part; a sample is one control step (step_s, 0.004 s",
        ),
        (["fly", "hover", "--set", "vehicle.name='a/b'"], "name = 'a/b'"),
        (["fly", "hover", "--seed", "-1"], "seed = -1"),
        (["fly", "hover", "--engine", "turbojet"], "needs an identified model of hexjet with engine 'turbojet'"),
        (["fly"], "Missing argument 'SCENARIO'"),
        (["show", "nowhere", "--page"], "nowhere: no run here"),
        (["export", "nowhere", "--to", "csv"], "nowhere: no run here"),
        (["export", "nowhere", "--to", "xls"], "'xls': allowed: csv, mat, mcap, parquet, ulog"),
        (["engine", "check", "edf", "--step", "nan"], "nan is not a finite number"),
        (["design", "--engine", "edf", "--max-sensitivity", "nan"], "nan is not a finite number"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(hexjet, arguments: list[str], message: str) -> None:  # type: ignore[no-untyped-def]
    done = hexjet(*arguments)
    assert done.status == 2
    assert done.out == ""
    assert done.err.count("\n") == 1
    assert done.err.startswith("hexjet: ")
    assert message in done.err


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
    done = hexjet("fly", "x.toml")
    assert (done.status, done.err.count("\n")) == (2, 1)
    assert message in done.err
    assert not (tmp_path / "runs").exists()


def test_a_folder_with_a_run_is_not_written_over(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert hexjet("fly", "hover", *SHORT, "--out", "kept").status == 0
    before = {p.name: p.read_bytes() for p in (tmp_path / "kept").iterdir()}
    done = hexjet("fly", "hover", *SHORT, "--out", "kept")
    assert done.status == 2
    assert "already holds a run" in done.err
    assert {p.name: p.read_bytes() for p in (tmp_path / "kept").iterdir()} == before


def test_wrong_input_leaves_no_folder(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    hexjet("fly", "hover", "--set", "vehicle.mass_kg=-2")
    hexjet("fly", "hover", "--engine", "none.fmu", "--out", "empty")
    assert list(tmp_path.iterdir()) == []


def test_list(hexjet) -> None:  # type: ignore[no-untyped-def]
    everything = json.loads(hexjet("show", "--json").out)
    assert set(everything) == {"scenarios", "studies", "engines", "aircraft", "controllers"}
    assert {e["name"] for e in everything["engines"]} >= {"turbojet", "edf", "edf-as-flown"}
    assert all(entry["title"] for entries in everything.values() for entry in entries)
    text = hexjet("show", "scenarios").out
    assert "roll-doublet" in text
    assert "turbojet" not in text


def test_report_and_export_of_a_run(hexjet, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
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


def test_fmu_check_and_build(hexjet) -> None:  # type: ignore[no-untyped-def]
    done = hexjet("engine", "check", "turbojet", "-v")
    assert done.status == 0
    assert "delay 25 samples" in done.out
    found = json.loads(hexjet("engine", "check", "edf-as-flown-fmi2", "--json").out)
    assert found["ok"]
    assert hexjet("engine", "build", "edf").out.split("\n")[0].endswith("edf.fmu")


def test_a_machine_that_has_no_more_to_give_is_told_in_a_line(hexjet, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("cosim.flight.fly_watched", full)
    done = hexjet("fly", "hover")
    assert (done.status, done.out) == (1, "")
    assert done.err == f"hexjet: No space left on device; temporary files are in {tempfile.gettempdir()}\n"
