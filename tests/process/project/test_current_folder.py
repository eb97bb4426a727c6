"""What lies in the current folder is never run by a process that is started there: no module of it is seen."""

from __future__ import annotations

import ast
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from campaign_tools import study
from patience import PATIENCE
from places import ROOT

from benchmarks.measures.process import start_python
from cosim import fly
from cosim.base.errors import InputError
from cosim.base.storage.paths import data_folder
from cosim.campaign.study.plan import flights
from cosim.campaign.workers.local import LocalWorkers
from cosim.engine import IsolatedBank, check_fmu, load_engine
from cosim.engine.make.controller_fmu import make_command
from cosim.groundstation.mavlink.services.logs import LogStore
from cosim.simulation.controllers.process import request_description
from cosim.spec.scenario import Scenario
from hexjet_sitl.lockstep import Program

STEP = 0.004
TRAPS = ("cosim/__init__.py", "numpy.py", "pickle.py", "json.py", "socket.py", "ctypes.py", "fmpy.py", "struct.py")
ENGINE = "edf-as-flown"


def archive() -> Path:
    return data_folder("fmus") / f"{ENGINE}-fmi2.fmu"


def isolated_engines() -> None:
    bank = IsolatedBank([load_engine(ENGINE, {}, STEP)], STEP)
    bank.reset(0.5)
    bank.close()


def fmu_check() -> None:
    assert check_fmu(ENGINE).ok


def worker() -> None:
    planned = study(runs=1, duration=0.1, controllers=["baseline"])
    with LocalWorkers(1, PATIENCE) as workers:
        assert [row["outcome"] for row in workers.fly(planned, flights(planned))] == ["completed"]


def log_maker() -> None:
    run = Path("run").absolute()
    fly(Scenario.load("hover").replace(duration_s=0.1, expect=[]), run, report=False)
    store = LogStore(lambda: [run])
    try:
        end = time.monotonic() + PATIENCE
        store.search(0.0)
        while (store.is_searching or store.is_converting) and time.monotonic() < end:
            store.poll(0.0)
            time.sleep(0.01)
        assert [bool(log.file and log.file.size) for log in store.logs] == [True]
    finally:
        store.close()


def controller_fmu() -> None:
    with pytest.raises(InputError, match=r"before it had said what it is: .*edf"):  # an engine is no controller
        request_description(lambda: make_command(archive()), Path.cwd(), "none")


def bench() -> None:
    with start_python("import numpy, cosim; print(numpy.pi)") as child:
        assert child.communicate()[0].startswith("3.14")


def autopilot() -> None:
    program = Program(["/bin/true"], Path.cwd(), Path("log.txt").absolute(), {})
    assert program.process.wait(PATIENCE) == 0
    program.close()


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


WAYS = [isolated_engines, fmu_check, worker, log_maker, controller_fmu, bench, autopilot]


@pytest.mark.parametrize("way", WAYS, ids=[way.__name__ for way in WAYS])
def test_a_process_runs_nothing_that_lies_in_the_current_folder(way: Callable[[], None], trapped: Path) -> None:
    way()


def starts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and first argument of every command that begins with this interpreter."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.List) and node.elts and ast.unparse(node.elts[0]) in ("sys.executable", "executable"):
            rest = [ast.unparse(each) for each in node.elts[1:]]
            yield node.lineno, next((each for each in rest if each != "'-B'"), "nothing")  # -B is of what it writes


def test_no_interpreter_is_started_that_looks_into_the_current_folder() -> None:
    """Every start has -P or -I first, or a script, whose own folder it then sees and no other."""
    files = [
        ROOT / "setup.py",
        *(
            path
            for name in ("cosim", "tools", "docs", "examples", "benchmarks")
            for path in (ROOT / name).rglob("*.py")
        ),
    ]
    found = {f"{path.relative_to(ROOT)}:{line}": flag for path in files for line, flag in starts(path)}
    assert len(found) >= 5
    scripts = {"__file__", "str(HERE)", "str(path)"}
    assert {where: flag for where, flag in found.items() if flag not in {"'-P'", "'-I'", *scripts}} == {}
    assert 'flags[] = "-EP"' in (ROOT / "tools" / "hexjet_export" / "vehicle" / "process.c").read_text()


def test_no_pool_of_processes_is_started() -> None:
    """Its children look into the current folder: nothing but the environment tells them not to."""
    files = [
        path for name in ("cosim", "tools", "docs", "examples", "benchmarks") for path in (ROOT / name).rglob("*.py")
    ]
    assert [path for path in files if "ProcessPoolExecutor(" in path.read_text(encoding="utf-8")] == []
