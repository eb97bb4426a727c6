"""The core's files alone, without the tools beside it: it flies, sweeps, and serves a ground station."""

from __future__ import annotations

import subprocess
import venv
from pathlib import Path
from site import getsitepackages

import gcs_tools
import pytest
from command_tools import Done
from gcs_tools import Station, VehicleProcess, until
from patience import PATIENCE
from places import ROOT

RUN = "from cosim.cli.start import main; main()"
TOOLS = ("design", "export", "identify", "prove", "sitl")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter that finds what the core needs, and of this project the folder of ``cosim`` alone."""
    folder = tmp_path_factory.mktemp("core")
    venv.create(folder / "venv", with_pip=False, symlinks=True)
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    core = folder / "core"
    core.mkdir()
    for name in ("cosim", "aircraft", "engines", "fmus", "scenarios", "studies"):
        (core / name).symlink_to(ROOT / name)
    # Lines of a file .pth in a folder that is named by one itself are not read: the tools stay away.
    (site / "core.pth").write_text("\n".join([*getsitepackages(), str(core)]) + "\n")
    return folder / "venv" / "bin" / "python"


def run(python: Path, folder: Path, code: str, *arguments: str) -> Done:
    command = [python, "-c", code, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=20 * PATIENCE, check=False)
    return Done(done.returncode, done.stdout, done.stderr)


def test_the_core_alone_has_no_tools(python: Path, tmp_path: Path) -> None:
    code = f"from importlib.util import find_spec; print([find_spec('hexjet_' + name) for name in {TOOLS}])"
    assert run(python, tmp_path, code).told.strip() == str([None] * len(TOOLS))


def test_it_flies_and_sweeps(python: Path, tmp_path: Path) -> None:
    for asked, folder in (
        ("fly hover --set duration_s=2 --out run", "run"),
        ("sweep hover --set duration_s=1 --vary vehicle.mass_kg*=0.9:1.1 --runs 2 --out sweep", "sweep"),
    ):
        done = run(python, tmp_path, RUN, *asked.split())
        assert done.told
        assert "Traceback" not in done.err
        assert (tmp_path / folder / "report.html").is_file()
    assert run(python, tmp_path, RUN, "show", "run").told


def test_it_serves_a_ground_station(python: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gcs_tools, "HEXJET", [str(python), "-c", RUN])
    vehicle = VehicleProcess(tmp_path, 1.0)
    try:
        with Station(vehicle.port) as station:
            until(lambda: station.counts["HEARTBEAT"] > 1, 30.0, "heartbeats")
        vehicle.stop()
    finally:
        vehicle.kill()


@pytest.mark.parametrize("command", ["design hover", "margins hover", "sitl hover", "replay log.ulg", "search hover"])
def test_the_command_of_a_tool_says_that_it_is_not_there(python: Path, tmp_path: Path, command: str) -> None:
    assert "is not installed" in run(python, tmp_path, RUN, *command.split()).refusal


def test_a_name_of_a_tool_says_that_it_is_not_there(python: Path, tmp_path: Path) -> None:
    code = "import cosim\ntry:\n    cosim.design\nexcept ImportError as error:\n    print(error)"
    assert "none of the tools that are installed has it" in run(python, tmp_path, code).told
