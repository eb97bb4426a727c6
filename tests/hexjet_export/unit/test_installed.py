"""Formats of logs that packages add, and the core without this tool."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import cosim
from cosim import InputError, Run, Scenario, fly
from cosim.cli.main import run as run_command

SOURCE = """from cosim.logs import describe_columns
def export_units(run, path):
    path.write_text("".join(f"{column.name} {column.unit}\\n" for column in describe_columns(run)))
"""


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return fly(Scenario.load("hover", ["duration_s=0.1"]), tmp_path / "run", report=False)


def test_a_package_adds_a_format(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unit_list.py").write_text(SOURCE)
    folder = tmp_path / "unit_list-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: unit-list\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[hexjet.exporters]\nunits.txt = unit_list:export_units\n")
    monkeypatch.syspath_prepend(tmp_path)
    written = cosim.export(run, "units")
    assert written == tmp_path / "run" / "flight.txt"
    assert written.read_text().startswith("time_s s\n")
    with pytest.raises(InputError, match=r"x\.csv: .*writes \.txt or \.units"):
        cosim.export(run, "units", tmp_path / "x.csv")


def test_without_this_tool_it_is_said(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Finder:
        def find_spec(self, name: str, *others: object) -> None:
            if name.partition(".")[0] == "hexjet_export":
                raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    for name in [name for name in sys.modules if name.partition(".")[0] == "hexjet_export"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(
        "cosim.base.plugins.entry_points.find_spec", lambda name: None if name == "hexjet_export" else find_spec(name)
    )
    assert cosim.export(run, "csv", tmp_path / "x.csv").is_file()
    with pytest.raises(InputError, match=r"to: 'ulog': allowed: csv, parquet"):
        cosim.export(run, "ulog")
    with pytest.raises(ImportError, match=r"cosim\.export_controller: none of the tools that are installed has it"):
        _ = cosim.export_controller
    with pytest.raises(InputError, match="export controller: needs 'hexjet_export', which is not installed"):
        run_command(["export", "controller"])
    with pytest.raises(InputError, match="flightgear: none of the tools that are installed sends to"):
        run_command(["fly", "hover", "--flightgear", "5550", "--out", str(tmp_path / "shown")])
    assert run_command(["export", "--help"]) == 0
