"""The first lines of docs/own-engine.md, run as they stand, with an FMU made on the spot."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from foreign_engines import foreign
from places import ROOT

from cosim.cli.main import main
from hexjet_design import design as making
from hexjet_design import tune as search

PAGE = ROOT / "docs" / "own-engine.md"


def first_lines() -> list[list[str]]:
    """The commands of the page's first block, without what stands behind them."""
    lines = []
    for line in PAGE.read_text().splitlines()[1:]:
        if line.startswith("    hexjet "):
            lines.append(shlex.split(line.strip().split("   ")[0])[1:])
        elif lines:
            break
    return lines


def run(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


def test_the_first_lines_fly_an_engine_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Checked, designed for, proved and flown: with a short search, which the page does not have."""
    monkeypatch.setattr(search, "MAX_GENERATIONS", 4)
    monkeypatch.setattr(search, "MAX_EVALUATIONS", 40)
    monkeypatch.setattr(making, "tune_digits", lambda *a, **k: None)
    monkeypatch.setattr(making, "bandwidths_without_limits", lambda *a, **k: {})
    foreign(tmp_path, "mine", "lag=0.15,delay=0.04")
    monkeypatch.chdir(tmp_path)
    check, design, fly = first_lines()
    assert (check[:2], design[0], fly[0]) == (["engine", "check"], "design", "fly")
    assert run(check) == 0
    assert "fit to fly" in capfd.readouterr().out
    # what fly says where nothing was designed is the next line of the page
    bare = fly[: fly.index("--controller")]
    assert run(bare) == 2
    assert "hexjet design --engine" in capfd.readouterr().err
    # without tolerances the proof has no corners: those are flown elsewhere
    narrow = ["--gain-tolerance", "0", "--delay-tolerance", "0"]
    assert run([*design, "--controller", "baseline", "--no-lead", *narrow]) == 0
    assert Path("mine-hexjet.toml").is_file()
    capfd.readouterr()
    assert run(fly) == 0
    out = capfd.readouterr().out
    assert "completed" in out
    shutil.rmtree("runs")
