"""docs/tutorial.md, run as it is written by a user who has flown nothing: its files, its commands, in an empty folder.

Long.  That its commands exist is asked daily, in test_site.py.
"""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from known_benches import Truth, bench_log
from places import DOCS

from cosim.base import trust
from cosim.simulation.controllers.controller_file import read_controller

PAGE = (DOCS / "tutorial.md").read_text(encoding="utf-8")
FILE = re.compile(r"<!-- file: (\S+) -->\n```\w*\n(.*?)^```$|^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run(line: str, folder: Path) -> str:
    """What a line of a shell prints, which must succeed."""
    here = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "80"}
    environment |= {"XDG_CONFIG_HOME": str(folder / "settings")}
    environment.pop(trust.ENV_VAR, None)
    done = subprocess.run(
        line, shell=True, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.long
def test_the_tutorial_as_written(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu3", reason="no pythonfmu3, with which the tutorial makes its engine")
    said = {}
    for name, text, commands in FILE.findall(PAGE):
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
        for line in commands.splitlines():
            said[line] = run(line, tmp_path)
    assert "fit to fly" in next(out for line, out in said.items() if line.startswith("hexjet engine check"))
    for page in (
        "first/report.html",
        "compared/comparison.html",
        "verdict/report.html",
        "check-my-vehicle-001/aircraft.svg",
    ):
        assert (tmp_path / "runs" / page).stat().st_size > 1000
    assert (tmp_path / "designed.html").exists()
    designed = read_controller(tmp_path / "designed.toml", "./my-vehicle", tmp_path).controller
    assert designed == "filtered-smith"


@pytest.mark.long
def test_from_a_bench_log_to_a_proven_design_in_one_line(tmp_path: Path) -> None:
    """Twice the same engine, logged well and badly: another log is another verdict, and no number is typed."""
    (line,) = re.findall(r"^hexjet engine from-bench bench.csv .*$", PAGE, re.MULTILINE)
    truth = Truth(delay=0.06, lags=(0.05,), gain=20.0, offset=1.0)
    kept = {}
    for name, rate, noise in (("well", 100.0, 0.1), ("badly", 12.5, 0.4)):
        folder = tmp_path / name
        folder.mkdir()
        times, command, thrust, _ = bench_log("stairs of 2 s", rate, truth, noise=noise, seconds=40.0)
        rows = np.column_stack([times, command, thrust])
        np.savetxt(folder / "bench.csv", rows, "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
        said = " ".join(run(line, folder).split())
        assert "22 of 22 flights kept what was promised" in said
        page = html.unescape((folder / "my-design.html").read_text(encoding="utf-8"))
        assert "engine's uncertainty, 3 standard deviations of its parameters: " in page
        assert "; source: bench.csv: 39.9" in page
        (share,) = re.findall(r"my-design: (\S+) % of 10 ", said)
        kept[name] = float(share)
    assert kept["well"] == 100.0
    assert kept["badly"] < 50.0
