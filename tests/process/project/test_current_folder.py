"""What lies in the current folder is never run by a process that is started there: no module of it is seen."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from campaign_tools import study
from patience import PATIENCE
from places import ROOT

from cosim.campaign.study.plan import flights
from cosim.campaign.workers.local import LocalWorkers
from cosim.engine import IsolatedBank, load_engine

STEP = 0.004
TRAPS = ("cosim/__init__.py", "numpy.py", "pickle.py", "json.py", "socket.py", "ctypes.py", "fmpy.py", "struct.py")
ENGINE = "edf-as-flown"


def isolated_engines() -> None:
    bank = IsolatedBank([load_engine(ENGINE, {}, STEP)], STEP)
    bank.reset(0.5)
    bank.close()


def worker() -> None:
    planned = study(runs=1, duration=0.1, controllers=["baseline"])
    with LocalWorkers(1, PATIENCE) as workers:
        assert [row["outcome"] for row in workers.fly(planned, flights(planned))] == ["completed"]


@pytest.fixture
def trapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, with modules of a stranger's that say so when they are run."""
    folder = tmp_path / "download"
    for name in TRAPS:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("open(__file__ + '.sprung', 'w').close()\nraise SystemExit(3)\n")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield folder
    assert sorted(folder.rglob("*.sprung")) == []


@pytest.mark.parametrize("way", [isolated_engines, worker])
def test_a_process_runs_nothing_that_lies_in_the_current_folder(way: Callable[[], None], trapped: Path) -> None:
    way()


def starts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and first argument of every command that begins with this interpreter."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.List) and node.elts and ast.unparse(node.elts[0]) in ("sys.executable", "executable"):
            rest = [ast.unparse(each) for each in node.elts[1:]]
            yield node.lineno, next((each for each in rest if each != "'-B'"), "nothing")  # -B is of what it writes


FOLDERS = ("cosim", "tools", "docs", "examples", "benchmarks")
SOURCES = [ROOT / "setup.py", *(path for name in FOLDERS for path in (ROOT / name).rglob("*.py"))]


def test_no_interpreter_is_started_that_looks_into_the_current_folder() -> None:
    """Every start has -P or -I first, or a script, whose own folder it then sees and no other."""
    found = {f"{path.relative_to(ROOT)}:{line}": flag for path in SOURCES for line, flag in starts(path)}
    assert len(found) >= 5
    scripts = {"__file__", "str(HERE)", "str(path)"}
    assert {where: flag for where, flag in found.items() if flag not in {"'-P'", "'-I'", *scripts}} == {}
    assert 'flags[] = "-EP"' in (ROOT / "tools" / "hexjet_export" / "vehicle" / "process.c").read_text()


def test_no_pool_of_processes_is_started() -> None:
    """Its children look into the current folder: nothing but the environment tells them not to."""
    assert [path for path in SOURCES if "ProcessPoolExecutor(" in path.read_text(encoding="utf-8")] == []
