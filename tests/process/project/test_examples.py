"""The examples run as they stand, from any folder."""

from __future__ import annotations

import re
import runpy
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from places import ROOT

from cosim import Scenario, fly, open_run
from hexjet_export.controller import measure

EXAMPLES = ROOT / "examples"
SAYS = {
    "demo": r"baseline  .*diverged.*\nsmith     .*completed(.|\n)*runs/demo-001/smith/report\.html",
    "first_flight": r"smith     completed \(flew 3000 steps\), greatest roll error 0\.348 rad\nbaseline  diverged \(leaned",
    "own_engine": r"Mine\.fmu: 25\.00 N at throttle 1\nsix of it: completed.*\none of it at station 3: completed",
    "own_controller": r"Ahead +completed.*\nAhead, half believed +completed.*\nsmith +completed.*\nbaseline",
    "campaign": r"smith +\d of 6 succeed: .*\nbaseline +\d of 6 succeed: .*\nflight \d+ with \w+: .*\nmass factor .*\nthe same log again, bit for bit: True",
    "gains_by_gradient": r"the vehicle's own: .* cost 0\.0\d+\nby gradient: .*, cost 0\.0\d+\nby design: .*, cost 0\.0\d+",
    "failure_by_gradient": r"by gradient: 2\.2\d standard deviations, \d flights, .*\nby search: 2\.2\d standard deviations, \d+ flights, at",
    "c_export": r"350 steps of the flight: the same bits\nvoid ours_reset\(.*\nvoid ours_step\(",
}


def test_every_example_is_run() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SAYS)


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs_as_it_is_printed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if name == "c_export" and measure.find_compiler() is None:
        pytest.skip("no C compiler")
    if name.endswith("by_gradient"):
        pytest.importorskip("jax", reason="the extra jax is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)  # an FMU that is Python finds what others called so
    with nullcontext() if name != "demo" else pytest.raises(SystemExit, match=r"^0$"):
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    said = capsys.readouterr().out
    assert re.search(SAYS[name], said), said
    if name == "first_flight":
        assert open_run("runs/first-flight-001").outcome == "completed"
    if name == "own_controller":  # and its folder flies again, by the copy in it
        folder = tmp_path / "runs" / "own-controller-001"
        assert (folder / "own_controller.py").read_bytes() == (EXAMPLES / "own_controller.py").read_bytes()
        again = fly(Scenario.load(folder / "scenario.toml").replace(duration_s=1.2))
        log = open_run(folder).log
        assert again.log["roll_ahead_rad_s"].tobytes() == log["roll_ahead_rad_s"][: len(again.log)].tobytes()
