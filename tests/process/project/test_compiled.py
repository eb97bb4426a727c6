"""What is compiled is what the source says: the same bits, never of yesterday's source, and no memory lost."""

from __future__ import annotations

import gc
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT, TOOLS

from cosim import Scenario, fly
from cosim.base.compiled import MODULES, PURE_VARIABLE, SHARED, is_current
from cosim.simulation.build import build

PACKAGE = ROOT / "cosim"

needs_compiled = pytest.mark.skipif(bool(os.environ.get(PURE_VARIABLE)), reason=f"{PURE_VARIABLE} is set")
WHERE = "import cosim.vehicle.servo as a, cosim.base.frames as b; print(a.__file__, b.__file__)"


def flights() -> dict[str, Scenario]:
    """A second or two of everything that a step may come by."""
    doublet = {"kind": "doublet", "signal": "roll_deg", "start_s": 0.2, "amplitude": 15.0, "width_s": 0.4}
    seen = {"kind": "torque_command", "axis": "pitch", "start_s": 0.3, "duration_s": 0.2, "amplitude": 0.01}
    turbulent = {"turbulence_severity": 4, "turbulence_wind_m_s": 8.0, "wind_ned_m_s": [3.0, 1.0, 0.0]}
    late = {"sensors": {name: {"latency_samples": 2} for name in ("gyro", "attitude", "barometer")}}
    faults = [
        {"kind": "flame_out", "jet": 3, "start_s": 0.2},
        {"kind": "slow_spool", "jet": 1, "lag_s": 0.1, "start_s": 0.3},
        {"kind": "servo_jam", "servo": "left", "start_s": 0.5},
        {"kind": "sensor_bias", "sensor": "gyro", "bias": [0.02, 0.0, 0.0], "start_s": 0.6},
        {"kind": "sensor_dropout", "sensor": "gnss", "start_s": 0.7},
    ]
    near = {"initial": {"altitude_m": 1.5}}
    ahead = {"kind": "step", "signal": "ahead_m_s", "start_s": 0.2, "amplitude": 25.0}
    surge = {"kind": "gust", "start_s": 0.1, "rise_s": 0.3, "hold_s": 0.2, "fall_s": 0.3}
    out = [{"kind": "flame_out", "jet": 6, "start_s": 0.1}]
    blown = {"wind_ned_m_s": [-20.0, 2.0, 0.0]}  # on the wing, while it hovers
    plain = Scenario.load("roll-doublet").replace(duration_s=1.0, command=[doublet])
    made = {name: plain.replace(controller=name) for name in ("filtered-smith", "state", "state-disturbance")}
    return {
        **made,
        "gust": Scenario.load("gust").replace(duration_s=2.0, environment=turbulent, substeps=1, vehicle=late),
        "payload": Scenario.load("payload-drop").replace(duration_s=2.0, added_delay_samples=3),
        "lost": plain.replace(fault=faults, duration_s=1.6, monitor=True, **near),
        "added": plain.replace(disturbance=[seen | {"at": "controller", "seen": True}, seen]),
        "full scale": Scenario.load("full-scale-gust").replace(duration_s=1.0),
        "turbine": plain.replace(engine="turbine-20", controller="baseline", duration_s=0.5),
        # of other engines and servos: hinges, surfaces, stations that are not alike
        "trijet": Scenario.load("trijet-gust").replace(
            duration_s=1.0, command=[doublet], disturbance=[surge | {"velocity_ned_m_s": [0.0, 8.0, 0.0]}]
        ),
        "jetwing": Scenario.load("jetwing-transition").replace(
            duration_s=1.0, command=[ahead], environment=blown, initial={"altitude_m": 30.0}
        ),
        "octojet": Scenario.load("octojet-flame-out-inner").replace(duration_s=1.0, fault=out),
    }


def digests() -> dict[str, str]:
    """The hash of every flight's whole log, and how it ended."""
    found = {}
    for name, scenario in flights().items():
        run = fly(scenario.replace(expect=[]), report=False)
        whole = hashlib.sha256()
        for column in run.log.columns:
            whole.update(np.ascontiguousarray(run.log[column]).tobytes())
        found[name] = f"{whole.hexdigest()[:16]} {len(run.log)} rows, {run.outcome}"
    return found


def python(code: str, path: Path, **environment: str) -> tuple[str, str]:
    """Standard output and standard error of ``code``, run with ``path`` before everything else."""
    inherited = {key: value for key, value in os.environ.items() if key != PURE_VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=path,
        env=inherited | {"PYTHONPATH": os.pathsep.join(map(str, (path, ROOT)))} | environment,
        capture_output=True,
        text=True,
        timeout=3000,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


@needs_compiled
def test_the_compiled_modules_are_flown_here() -> None:
    """Where this fails the other tests have tested the source: run make setup."""
    assert is_current()
    for name in MODULES:
        module = f"cosim.{name.removesuffix('.py').replace('/', '.')}"
        __import__(module)
        assert not str(sys.modules[module].__file__).endswith(".py"), module


@needs_compiled
def test_compiled_and_from_source_a_flight_is_the_same_bit_for_bit() -> None:
    said, _ = python(
        f"import sys; sys.path.insert(0, {str(TOOLS)!r}); import json, test_compiled, cosim.simulation.step as s; "
        "print(s.__file__, json.dumps(test_compiled.digests()))",
        Path(__file__).parent,
        **{PURE_VARIABLE: "1"},
    )
    module, _, found = said.partition(" ")
    assert module.endswith("simulation/step.py")
    assert json.loads(found) == digests()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A package with files that stand for compiled ones, which nothing can import, older than the checkout's sources."""
    shutil.copytree(
        PACKAGE,
        tmp_path / "cosim",
        ignore=shutil.ignore_patterns("__pycache__", "web", "data", "*mypyc*", "*.cpython*"),
    )
    for path in PACKAGE.rglob("_*.cpython*"):
        if not path.name.startswith("_native") and path.suffix != ".pyc":
            shutil.copy(path, tmp_path / path.relative_to(ROOT))
    (tmp_path / "setup.py").write_text("")
    for name in MODULES:
        (tmp_path / "cosim" / name).with_suffix(SHARED.removeprefix("_native__mypyc")).write_text("nothing to import")
    (tmp_path / "cosim" / SHARED).write_text("")
    return tmp_path


def set_times(checkout: Path, built: float) -> None:
    """All sources are of the second 1,000; what was compiled is of another."""
    for name in MODULES:
        os.utime(checkout / "cosim" / name, (1000.0, 1000.0))
    shared = checkout / "cosim" / SHARED
    shared.write_text("")
    os.utime(shared, (built, built))


def test_a_source_that_is_newer_than_what_was_compiled_runs(checkout: Path) -> None:
    """All do, because compiled modules call each other directly; nothing is said."""
    set_times(checkout, built=2000.0)
    servo = checkout / "cosim" / "vehicle" / "servo.py"
    with servo.open("a", encoding="utf-8") as file:
        file.write("# another line\n")
    files = f"{servo} {checkout / 'cosim' / 'base' / 'frames.py'}"
    assert python(WHERE, checkout) == (f"{files}\n", "")
    set_times(checkout, built=2000.0)
    with pytest.raises(AssertionError, match="ImportError"):  # nothing is newer: what was compiled is taken
        python(WHERE, checkout)
    assert python(WHERE, checkout, **{PURE_VARIABLE: "1"}) == (f"{files}\n", "")
    other = checkout / "cosim" / "other.py"
    shutil.copy2(servo, other)  # copied over it later, with the older time that it has
    os.replace(other, servo)
    assert python(WHERE, checkout) == (f"{files}\n", "")


def test_without_the_shared_library_the_source_runs(checkout: Path) -> None:
    """As where another Python compiled last, or a build was broken off."""
    set_times(checkout, built=2000.0)
    (checkout / "cosim" / SHARED).unlink()
    assert python(WHERE, checkout)[0].split()[0] == str(checkout / "cosim" / "vehicle" / "servo.py")


def test_what_is_installed_stays_as_it_was_built(checkout: Path) -> None:
    """Whatever times an installer gives its files."""
    set_times(checkout, built=500.0)
    (checkout / "setup.py").unlink()
    with pytest.raises(AssertionError, match="ImportError"):
        python(WHERE, checkout)


def test_make_compiles_again_what_was_edited() -> None:
    """Its list is read out of ours."""
    command = ["make", "--silent", "--eval=stated: ; @echo $(COMPILED)", "stated"]
    stated = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert stated == [f"cosim/{name}" for name in MODULES]
    assert len(set(stated)) == len(stated)


def test_a_step_leaves_nothing_behind() -> None:
    """Counted in blocks of Python's allocator after whole blocks of noise; one kept a step would be a thousand."""
    steps = 256
    scenario = Scenario.load("roll-doublet").replace(expect=[], duration_s=6.144, monitor=True)
    with build(scenario) as simulation:
        for _ in range(2 * steps):
            simulation.step()
        gc.collect()
        before = sys.getallocatedblocks()
        for _ in range(4 * steps):
            simulation.step()
        gc.collect()
        assert sys.getallocatedblocks() - before < 100
