"""A command overwrites and removes what an earlier call of it left, and nothing that is somebody else's."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_tools import Hexjet

from cosim.base.errors import InputError
from cosim.base.storage.files import check_results_folder
from cosim.identify.files import write_identification


def bench_log(folder: Path) -> Path:
    """The log of an engine of 10 N with a lag of 0.3 s and a delay of 0.1 s, stepped up and down."""
    times = np.arange(0.0, 60.0, 0.02)
    throttle = 0.3 + 0.4 * (np.floor(times / 5.0) % 2)
    late = 0.3 + 0.4 * (np.floor((times - 0.1) / 5.0) % 2)
    thrust = np.empty_like(times)
    level = 3.0
    for k, target in enumerate(10.0 * late):
        level += 0.02 / 0.3 * (target - level)
        thrust[k] = level + 0.02 * ((k * 7919) % 13 - 6) / 6.0
    path = folder / "bench.csv"
    lines = [f"{t:.2f},{u:.3f},{f:.5f}" for t, u, f in zip(times, throttle, thrust, strict=True)]
    path.write_text("time [s],throttle,thrust [N]\n" + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("name", ["engine.toml", "engine.fmu", "README.md", "report.html"])
def test_an_identification_leaves_a_project_alone(name: str, hexjet: Hexjet, tmp_path: Path) -> None:
    log, project = bench_log(tmp_path), tmp_path / "project"
    project.mkdir()
    (project / name).write_text("mine")
    for arguments in (
        ("engine", "from-bench", str(log)),
        ("engine", "from-bench", str(log), "--engine", "fitted"),
        ("identify", "log", str(log), "--axis", "roll"),
    ):
        done = hexjet(*arguments, "--out", str(project))
        assert done.status == 2
        (line,) = done.err.splitlines()
        assert line.startswith(f"hexjet: {project / name}: is there already, and no identification.json beside it")
        assert [file.name for file in project.iterdir()] == [name]
        assert (project / name).read_text() == "mine"


def test_an_identification_is_renewed_in_its_own_folder(hexjet: Hexjet, tmp_path: Path) -> None:
    log, out = bench_log(tmp_path), tmp_path / "out"
    for _ in range(2):
        done = hexjet("engine", "from-bench", str(log), "--out", str(out))
        assert done.status == 0, done.err
        assert (out / "engine.toml").is_file()
    (out / "notes.txt").write_text("mine")
    done = hexjet("engine", "from-bench", str(log), "--out", str(out), "--longest-delay", "0.5")
    assert done.status == 0
    assert (out / "notes.txt").read_text() == "mine"


def test_an_identification_by_a_program_leaves_it_alone_too(tmp_path: Path) -> None:
    page: Any = SimpleNamespace(write=lambda path: None)
    (tmp_path / "engine.toml").write_text("mine")
    with pytest.raises(InputError, match=r"engine\.toml: is there already"):
        write_identification(tmp_path, {}, page, {})
    assert (tmp_path / "engine.toml").read_text() == "mine"
    (tmp_path / "identification.json").write_text("{}")
    assert write_identification(tmp_path, {}, page, {})["json"].read_text() == "{}\n"
    assert not (tmp_path / "engine.toml").exists()


@pytest.mark.parametrize("content", ["", "[]", "{", "mine", "\0"])
def test_a_record_that_is_none_is_somebody_elses(content: str, tmp_path: Path) -> None:
    (tmp_path / "margins.json").write_text(content)
    with pytest.raises(InputError, match=r"margins\.json: is there already"):
        check_results_folder(tmp_path, "margins.json", "report.html")
    (tmp_path / "margins.json").write_text(json.dumps({"axes": {}}))
    check_results_folder(tmp_path, "margins.json", "report.html")
    check_results_folder(tmp_path / "new", "margins.json", "report.html")


@pytest.mark.parametrize(
    ("arguments", "file"),
    [
        (("engine", "identify", "turbojet"), "report.html"),
        (("identify", "roll"), "model.toml"),
        (("margins", "hover"), "response.csv"),
        (("engine", "check", "edf"), "check.json"),
        (("replay", "log.csv", "--model", "model.toml"), "report.html"),
    ],
)
def test_results_are_refused_before_the_work(arguments: tuple, file: str, hexjet: Hexjet, tmp_path: Path) -> None:
    (tmp_path / file).write_text("mine")
    done = hexjet(*arguments, "--out", str(tmp_path))
    assert (done.status, (tmp_path / file).read_text()) == (2, "mine"), done.err
    assert f"{tmp_path / file}: is there already" in done.err
    assert [each.name for each in tmp_path.iterdir()] == [file]


def test_a_design_replaces_no_file_but_a_design(hexjet: Hexjet, tmp_path: Path) -> None:
    scenario, page = tmp_path / "mine.toml", tmp_path / "other.html"
    scenario.write_text('name = "mine"\nduration_s = 1.0\n')
    page.write_text("<title>mine</title>")
    for out, foreign in ((scenario, scenario), (tmp_path / "other.toml", page)):
        before = foreign.read_text()
        done = hexjet("design", "--out", str(out))
        assert (done.status, foreign.read_text()) == (2, before)
        assert f"{foreign} is there already" in done.err or f"{foreign}: is there already" in done.err
