"""Many flights in one process: each is what it would be alone, work is not done twice, and nothing piles up."""

from __future__ import annotations

import _ctypes
import ast
import errno
import gc
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from ctypes import CDLL
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from fmpy.fmi3 import FMU3Slave
from places import TOOLS

import cosim
from cosim import fly
from cosim.base.errors import InputError
from cosim.base.storage import toml as config
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.paths import data_folder
from cosim.base.storage.scratch import scratch
from cosim.engine import build_engines, check, load_checked, load_engine
from cosim.engine import measure as engine_measure
from cosim.engine.fmu import archive, unpacked
from cosim.engine.fmu.air import STANDARD_AIR
from cosim.engine.fmu.archive import find_library
from cosim.engine.fmu.unpacked import unpack
from cosim.engine.measure import EngineMeasurement
from cosim.engine.response import REST_TOLERANCE, Response
from cosim.engine.source import find_source
from cosim.results.run import Run
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_names, load_vehicle
from cosim.spec.vehicle import files as vehicle_files
from cosim.vehicle import jsbsim_model
from cosim.vehicle.jsbsim_model import render

STEP = 0.004
SOMETHING = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.1, "amplitude": 10.0, "width_s": 0.2}
PLAIN: dict[str, Any] = {"name": "many", "duration_s": 0.6, "command": [SOMETHING]}
FLIGHTS: dict[str, dict[str, Any]] = {
    "plain": PLAIN,
    "other numbers": PLAIN | {"vehicle": {"mass_kg": 5.0}, "engine_parameters": {"delay_samples": 10}, "seed": 2},
    "other aircraft": PLAIN | {"aircraft": "quadrotor", "engine": "motor", "controller": "baseline", "step_s": 0.0025},
    # watched engines that state no lag, in thin air, with spools and fuel
    "watched": PLAIN
    | {"aircraft": "hexjet-100", "engine": "turbine-100", "controller": "baseline", "environment": {"ground_m": 900.0}}
    | {"fault": [{"kind": "flame_out", "start_s": 0.2, "jet": 2}]},
}


def digest(table: dict[str, Any]) -> str:
    """Of everything that a flight leaves behind, but for the time of day and how long it took."""
    run = fly(Scenario.from_table(table, Path(), "test"))
    columns = b"".join(run.log[name].tobytes() for name in run.log.columns)
    return hashlib.sha256(columns + json.dumps(left_behind(run), sort_keys=True).encode()).hexdigest()


def left_behind(run: Run) -> dict[str, Any]:
    # scipy's kernels are known once something has loaded scipy
    passing = {"started", "wall_s", "realtime_factor", "step_us", "blas_kernels"}
    return {key: value for key, value in run.summary.model_dump(mode="json").items() if key not in passing}


def test_a_flight_does_not_depend_on_those_before_it() -> None:
    script = (
        f"import sys; sys.path[:0] = {[str(TOOLS), str(Path(__file__).parent)]!r};"
        "from test_many_flights import *; print(digest(FLIGHTS[sys.argv[1]]))"
    )
    alone = {
        name: subprocess.run(
            [sys.executable, "-c", script, name], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in FLIGHTS
    }
    assert len(set(alone.values())) == len(FLIGHTS)
    forth, back = list(FLIGHTS), list(reversed(FLIGHTS))
    for name in [*forth, *back]:
        assert digest(FLIGHTS[name]) == alone[name], name


def test_a_second_flight_repeats_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading, measuring and rendering what has not changed; a flight of its own would do all of it."""
    scenario = Scenario.from_table(FLIGHTS["watched"], Path(), "test")
    fly(scenario)
    done: list[str] = []
    for module, name in (
        (config.tomllib, "loads"),
        (ElementTree, "fromstring"),  # of models, and of what describes engines
        (ElementTree, "tostring"),
        (archive, "_read_archive"),
        (engine_measure, "measure"),
        (vehicle_files, "_read_vehicle"),
        (FMU3Slave, "_loadFunctions"),
    ):
        monkeypatch.setattr(module, name, counted(done, name, getattr(module, name)))
    fly(scenario)
    assert done == []
    other = scenario.replace(vehicle={"mass_kg": 27.0}, engine_parameters={"combustion_efficiency": 0.95})
    fly(other)
    assert set(done) == {"measure"}  # the model is the same but for its numbers


def counted(done: list[str], name: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def counting(*args: Any, **kwargs: Any) -> Any:
        done.append(name)
        return call(*args, **kwargs)

    return counting


def test_nothing_piles_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files, libraries, descriptors, memory.  A JSBSim model that is not freed takes a megabyte a flight."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    scenario = Scenario.from_table(FLIGHTS["plain"], Path(), "test")
    kept: list[list[Path]] = []

    def some(count: int) -> tuple[int, int, int]:
        for k in range(count):
            fly(scenario.replace(duration_s=0.04, seed=k, vehicle={"mass_kg": 5.4 + 0.001 * k}))
        gc.collect()
        assert list(tmp_path.iterdir()) == []
        kept.append(sorted(scratch().iterdir()))
        resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        libraries = Path("/proc/self/maps").read_text().count(".so")
        return resident, libraries, len(os.listdir("/proc/self/fd"))

    before, libraries, descriptors = some(120)  # until the memories are full and the heap is as large as it gets
    after, *rest = some(60)
    assert rest == [libraries, descriptors]
    assert kept[0] == kept[1]
    # The heap of a busy process still grows by some pages; a model that is not freed takes thirty times the limit.
    assert after - before < 60 * 30_000


def replaced(path: Path, old: str, new: str) -> None:
    """Change a file without a trace in its directory entry."""
    assert len(old) == len(new)
    text, state = path.read_text(), path.stat()
    assert old in text
    path.write_text(text.replace(old, new))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert path.stat().st_mtime_ns == state.st_mtime_ns
    assert path.stat().st_size == state.st_size


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Aircraft and engines that may be changed."""
    build_engines(["edf", "edf-as-flown"])
    for name in ("aircraft", "engines"):
        shutil.copytree(data_folder(name), tmp_path / name)
    (tmp_path / "fmus").mkdir()
    for path in data_folder("fmus").glob("edf*.fmu"):
        shutil.copy(path, tmp_path / "fmus")
    monkeypatch.setattr("cosim.base.storage.paths._DATA_ROOT", tmp_path)
    return tmp_path


def test_a_changed_aircraft_is_another(house: Path) -> None:
    path = house / "aircraft" / "hexjet" / "vehicle.toml"
    before, scaled = load_vehicle("hexjet")[0], load_vehicle("hexjet-100")[0]
    assert before.mass_kg == 5.525
    replaced(path, "mass_kg = 5.525", "mass_kg = 5.625")
    assert load_vehicle("hexjet")[0].mass_kg == 5.625
    assert load_vehicle("hexjet", {"title": "x"})[0].mass_kg == 5.625
    assert load_vehicle("hexjet-100")[0].inertia_kg_m2 != scaled.inertia_kg_m2  # made from that file too
    replaced(path, "mass_kg = 5.625", "mass_kg = -5.25")
    with pytest.raises(InputError, match=r"vehicle.toml: mass_kg = -5.25"):
        load_vehicle("hexjet")
    replaced(path, "mass_kg = -5.25", "mass_kg = 5.525")
    assert load_vehicle("hexjet")[0] == before


def test_a_changed_model_is_another(house: Path) -> None:
    stated, folder = load_vehicle("hexjet")
    path = folder / stated.model
    before = render(stated, path)
    text = path.read_text()
    replaced(path, ">0.16</wingarea>", ">0.17</wingarea>")
    assert b">0.17</wingarea>" in render(stated, path)
    path.write_text("<fdm_config>")
    with pytest.raises(InputError, match="not valid XML"):
        render(stated, path)
    path.write_text(text)
    assert render(stated, path) == before


def test_a_changed_engine_is_another(house: Path) -> None:
    before = load_engine("edf", {}, STEP)
    title = before.title
    replaced(house / "engines" / "edf" / "engine.toml", title, title[::-1])
    assert load_engine("edf", {}, STEP).title == title[::-1]
    path = house / "fmus" / "edf.fmu"
    shutil.copy(house / "fmus" / "edf-as-flown.fmu", path)
    assert load_engine(str(path), {}, STEP, unchecked=True).sha256 != before.sha256
    assert load_engine("edf", {}, STEP).parameters["delay_samples"] == 25.0


@pytest.mark.parametrize("aircraft", aircraft_names())
def test_a_vehicle_with_other_numbers_has_them_in_its_model(aircraft: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that is remembered without its numbers gives every vehicle its own."""
    stated, folder = load_vehicle(aircraft)
    path = None if stated.model is None else folder / stated.model
    other = Vehicle.model_validate(scaled(stated.model_dump()))
    remembered = render(stated, path), render(other, path)
    monkeypatch.setattr(jsbsim_model, "_templates", RecentCache(64))
    assert render(other, path) == remembered[1] != remembered[0]


def scaled(table: Any) -> Any:
    """The numbers of masses, places, contacts and air forces a little larger, the structure the same."""

    def larger(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: larger(inner) for key, inner in value.items()}
        if isinstance(value, (list, tuple)):
            return [larger(inner) for inner in value]
        return value * 1.01 if isinstance(value, float) else value

    keys = {"mass_kg", "inertia_kg_m2", "products_kg_m2", "aero", "contacts", "fuel"}
    jets = [jet | {"position_m": larger(jet["position_m"])} for jet in table["jets"]]
    return table | {key: larger(table[key]) for key in keys & table.keys()} | {"jets": jets}


def test_the_model_is_made_of_what_it_is_remembered_by() -> None:
    """Else a vehicle that differs in something else would fly with the model of another."""
    tree = ast.parse((Path(cosim.__file__).parent / "vehicle" / "jsbsim_model.py").read_text())
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}

    def fields(function: str, *apart: str) -> set[str]:
        names, read, waiting = set(), set(apart), [function]
        while waiting:  # what it hands the vehicle to reads it too
            read.add(name := waiting.pop())
            for node in ast.walk(functions[name]):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "vehicle":
                    names.add(node.attr)
                if isinstance(node, ast.Call) and any(isinstance(a, ast.Name) and a.id == "vehicle" for a in node.args):
                    assert isinstance(node.func, ast.Name)
                    waiting += [node.func.id] * (node.func.id in functions and node.func.id not in read)
        return names

    assert fields("_make_template", "_list_numbers") == fields("_template_key") <= set(Vehicle.model_fields)


def test_a_foreign_engine_is_checked_once_and_then_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study may give it other parameters in every flight: these are measured, and come to what a check finds."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    build_engines(["edf-as-flown"])
    path = tmp_path / "theirs.fmu"
    shutil.copy(data_folder("fmus") / "edf-as-flown.fmu", path)
    checks: list[object] = []
    once = check.check_and_measure
    monkeypatch.setattr(check, "check_and_measure", lambda *asked: checks.append(1) or once(*asked))
    monkeypatch.setattr(load_checked, "_fit_engines", set())
    load_engine(str(path), {"delay_samples": 3.0}, STEP)
    assert len(checks) == 1
    many = [load_engine(str(path), {"delay_samples": float(k), "gain": 0.1 + 0.01 * k}, STEP) for k in range(4, 9)]
    assert len(checks) == 1
    assert len(list((tmp_path / "cache").rglob("*.json"))) == 1
    assert [each.settling_window for each in many] == [2 * k + 50 for k in range(4, 9)]
    measured = once(str(path), STEP, {"delay_samples": 5.0, "gain": 0.1 + 0.01 * 5})[1]
    assert measured is not None
    assert (measured.curve, measured.start) == (many[1].curve, many[1].start)
    with pytest.raises(InputError, match=r"thrust is the same at throttle 0 and 1|does not answer the throttle"):
        load_engine(str(path), {"gain": 0.0}, STEP)
    shutil.copy(data_folder("fmus") / "edf.fmu", path)  # another file under the same name
    load_engine(str(path), {"delay_samples": 3.0}, STEP)
    assert len(checks) == 2


def test_what_is_measured_here_is_judged_as_in_a_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = tmp_path / "theirs.fmu"
    shutil.copy(data_folder("fmus") / "edf-as-flown.fmu", path)
    known = load_engine("edf-as-flown", {"delay_samples": 7.0}, STEP)
    falling = known.curve._replace(thrust=tuple(reversed(known.curve.thrust)))
    source = load_checked.find_source(str(path))
    monkeypatch.setattr(load_checked, "_fit_engines", {(source.archive.sha256, source.mapping.model_dump_json(), STEP)})
    measured = EngineMeasurement(falling, Response(7, 0.1, 0.0, 20.0), None, REST_TOLERANCE)
    monkeypatch.setattr(load_checked, "measure_isolated", lambda *_: measured)
    with pytest.raises(InputError, match=r"theirs.fmu: is not fit to fly: its thrust does not rise with the throttle"):
        load_checked.measure_checked(source, {"delay_samples": 7.0}, STEP, STANDARD_AIR)


def test_unpacked_files_are_used_again_if_nobody_changed_them() -> None:
    known = find_source("edf").archive
    first, second = unpack(known), unpack(known)
    assert first.path != second.path  # one user at a time
    first.close()
    with unpack(known) as again:
        assert again == first.path
    for change in (
        lambda folder: (folder / find_library(known)).write_bytes(b"other"),
        lambda folder: (folder / "left").mkdir(),
        lambda folder: (folder / "left").write_text("behind"),
        lambda folder: (folder / find_library(known)).unlink(),
        lambda folder: shutil.rmtree(folder),
    ):
        with unpack(known) as folder:
            change(folder)
        assert not unpacked._free[-1].is_untouched
        with unpack(known) as other:
            assert other != folder
            assert (other / find_library(known)).stat().st_size > 1000
            assert not (other / "left").exists()
        assert not folder.exists()
    second.close()


def test_no_room_to_unpack_is_no_damage(monkeypatch: pytest.MonkeyPatch) -> None:
    known = find_source("edf").archive

    def full(**_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(unpacked, "_free", [])
    monkeypatch.setattr("tempfile.mkdtemp", full)
    with pytest.raises(InputError, match=r"edf.fmu: cannot be unpacked: /.*: No space left on device"):
        unpack(known)


def test_no_place_for_temporary_files_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(prefix: str) -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr("cosim.base.storage.scratch._folders", {})
    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with pytest.raises(InputError, match=r"^temporary files: No usable temporary directory found; TMPDIR can"):
        unpack(find_source("edf").archive)


def test_a_library_that_stays_loaded_is_not_used_again() -> None:
    """It would keep what it has in its memory from one flight to the next."""
    known = find_source("edf").archive
    with unpack(known) as folder:
        library = CDLL(str(folder / find_library(known)))
    with unpack(known) as other:
        assert other != folder
    _ctypes.dlclose(library._handle)


def test_a_forked_process_uses_files_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    known = find_source("edf").archive
    with unpack(known) as folder:
        pass
    monkeypatch.setattr(os, "getpid", lambda: 4711)
    with unpack(known) as other:
        assert other.parent != folder.parent
    shutil.rmtree(scratch())
    monkeypatch.undo()
    assert folder.is_dir()
    assert folder.parent == scratch()


def test_what_a_killed_process_leaves_is_removed_by_the_next(tmp_path: Path) -> None:
    script = "import os, signal, sys; from cosim.base.storage.scratch import scratch; print(scratch(), flush=True); "
    wait = "sys.stdin.read(); "
    environment = os.environ | {"TMPDIR": str(tmp_path)}

    def start(then: str) -> tuple[subprocess.Popen[str], Path]:
        command = [sys.executable, "-c", script + then]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True)
        assert process.stdout is not None
        return process, Path(process.stdout.readline().strip())

    living, kept = start(wait)
    killed, left = start("os.kill(os.getpid(), signal.SIGKILL)")
    killed.communicate()
    assert left.is_dir()
    last, own = start(wait)
    assert not left.exists()
    assert kept.is_dir()
    assert own.is_dir()
    for process in (living, last):
        process.communicate("")
        assert process.returncode == 0
    assert list(tmp_path.iterdir()) == []


def test_a_memory_keeps_what_was_asked_for_last() -> None:
    made: list[int] = []
    memory: RecentCache[int] = RecentCache(2)

    def ask(key: int) -> int:
        return memory.get(key, lambda: made.append(key) or 10 * key)  # type: ignore[func-returns-value]

    assert [ask(key) for key in (1, 2, 1, 3, 1, 2)] == [10, 20, 10, 30, 10, 20]
    assert made == [1, 2, 3, 2]  # 2 had to go when 3 came, because 1 had been asked for since


def test_a_memory_forgets_failures() -> None:
    memory: RecentCache[int] = RecentCache(2)
    with pytest.raises(InputError):
        memory.get("key", raises)
    assert memory.get("key", lambda: 5) == 5


def raises() -> int:
    raise InputError("not this time")
