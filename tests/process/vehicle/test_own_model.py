"""Commands with a JSBSim file of the user's that cannot fly: one line and status 2, whatever JSBSim does when it ends."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_tools import Done

from cosim.spec.vehicle import load_vehicle

MODEL = """<?xml version="1.0"?>
<fdm_config name="wing" version="2.0" release="ALPHA">
  <aerodynamics>
    <axis name="LIFT"><function name="aero/force/lift-by-wash"><product>
      <property>aero/qbar-psf</property>
      <property>propulsion/engine/prop-induced-velocity_fps</property>
    </product></function></axis>
  </aerodynamics>
</fdm_config>
"""
LINE = (
    "mine/wing.xml, line 6: the model has no property propulsion/engine/prop-induced-velocity_fps: take out what reads"
)
COMMANDS = {
    "check": "aircraft check ./mine",
    "fly": "fly hover --aircraft ./mine",
    "sweep": "sweep hover --aircraft ./mine --vary vehicle.mass_kg=5.2:5.8 --runs 2 --workers 1",
    "export": "export vehicle --aircraft ./mine",
}


def hexjet(folder: Path, command: str) -> Done:
    words = [sys.executable, "-c", "from cosim.cli.main import main; main()", *command.split()]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=300)
    return Done(done.returncode, done.stdout, done.stderr)


def with_model(folder: Path, name: str, text: str) -> None:
    """Make an aircraft ``mine`` with a JSBSim file of this name."""
    vehicle, place = load_vehicle("hexjet")
    assert vehicle.model is not None
    (folder / "mine").mkdir()
    (folder / "mine" / name).write_text(text)
    table = (place / "vehicle.toml").read_text()
    table = table.replace(f'model = "{vehicle.model}"', f'model = "{name}"').replace('name = "hexjet"', 'name = "mine"')
    (folder / "mine" / "vehicle.toml").write_text(table)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_property_that_is_not_there_is_one_line_and_status_2(command: str, tmp_path: Path) -> None:
    with_model(tmp_path, "wing.xml", MODEL)
    done = hexjet(tmp_path, COMMANDS[command])
    assert (done.status, done.out) == (2, ""), done.err
    *notes, line = done.err.splitlines()
    assert LINE in line
    assert all("note:" in note or "runs from source" in note for note in notes)


def test_what_is_left_out_of_a_model_is_said_once(tmp_path: Path) -> None:
    """And what it would have written is not there."""
    written = tmp_path / "written.csv"
    output = f'<output name="{written}" type="CSV" rate="50"><rates>ON</rates></output>'
    with_model(tmp_path, "../own.xml", f"<fdm_config>\n{output}\n</fdm_config>")  # a path may lead out: it is read
    done = hexjet(tmp_path, "fly hover --aircraft ./mine --set duration_s=1 --out flown")
    assert done.told
    (note,) = [line for line in done.err.splitlines() if "left out" in line]
    assert note.startswith("hexjet: note: ")
    assert note.endswith("mine/../own.xml: left out, as no part of what flies: <output> (line 2)")
    assert b"<output" not in (tmp_path / "flown" / "own.xml").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "own.xml", "flown"}  # nothing is written elsewhere


CRASHES = {
    "SIGSEGV": '<aerodynamics><axis name="LIFT"><function name="f"/></axis></aerodynamics>',
    "SIGABRT": '<system name="late"><channel name="c"><pure_gain name="g"><input>velocities/p-rad_sec</input><gain>1</gain>'
    "<delay>1e9</delay></pure_gain></channel></system>",  # 20 TB of memory
}


@pytest.mark.parametrize("crash", CRASHES)
def test_a_file_that_crashes_jsbsim_is_one_line(crash: str, tmp_path: Path) -> None:
    with_model(tmp_path, "own.xml", f"<fdm_config>\n{CRASHES[crash]}\n</fdm_config>")
    done = hexjet(tmp_path, "aircraft check ./mine")
    assert done.status == 2, done.err
    (line,) = [line for line in done.err.splitlines() if "runs from source" not in line]
    part = "own.xml, line 2: system late" if crash == "SIGABRT" else "own.xml: aerodynamics"
    assert f"{part}: JSBSim fails: the process was ended by {crash}" in line
