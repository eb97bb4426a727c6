"""The package alone: it flies, sweeps and waits for a ground station where no tool is installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from command_tools import Done
from patience import PATIENCE
from places import ROOT

# as if no package of a tool were there, though the metadata of the distribution still name them
HIDE = f"import sys; sys.path = [each for each in sys.path if each != {str(ROOT / 'tools')!r}]\n"


def run(code: str, folder: Path) -> Done:
    """Python without the tools, in a folder."""
    done = subprocess.run(
        [sys.executable, "-c", HIDE + code], capture_output=True, text=True, timeout=PATIENCE, cwd=folder
    )
    return Done(done.returncode, done.stdout, done.stderr)


def command(words: str, folder: Path) -> Done:
    return run(f"from cosim.cli.main import main; main({words.split()!r})", folder)


@pytest.mark.parametrize(
    "words",
    [
        "fly hover --set duration_s=0.2 --out run",
        "sweep hover --vary vehicle.mass_kg=5:6 --runs 2 --set duration_s=0.2 --workers 1 --out swept",
        "gcs --duration 0.2 --rtf 0 --mavlink udpout:127.0.0.1:14599 --parameters none --out flown",
        "show hover",
        "--help",
    ],
)
def test_what_needs_no_tool_runs(words: str, tmp_path: Path) -> None:
    done = command(words, tmp_path)
    assert done.status == 0, done.err
    assert ("changes of parameters are not judged: hexjet_design is not installed" in done.err) == ("gcs" in words)
    assert "design" not in done.out if words == "--help" else True


@pytest.mark.parametrize("name", ["design", "margins"])
def test_a_command_of_a_tool_says_that_it_is_not_installed(name: str, tmp_path: Path) -> None:
    done = command(name, tmp_path)
    assert done.status == 2
    assert done.err.startswith(f"hexjet: {name}: needs 'hexjet_design', which is not installed")
    assert done.err.count("\n") == 1
    done = run(f"from cosim import {name}", tmp_path)
    assert done.err.splitlines()[-1].startswith("ImportError: ")
    assert f"cosim.{name}: none of the tools that are installed has it" in done.err
