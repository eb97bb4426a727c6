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
from cosim.base.compiled import (
    MODULES,
    PURE,
    SHARED,
    STAMP,
    edited_modules,
)
from cosim.simulation.build import build

PACKAGE = ROOT / "cosim"

needs_compiled = pytest.mark.skipif(bool(os.environ.get(PURE)), reason=f"{PURE} is set")


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
    inherited = {key: value for key, value in os.environ.items() if key != PURE}
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
    assert edited_modules() == []
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
        **{PURE: "1"},
    )
    module, _, found = said.partition(" ")
    assert module.endswith("simulation/step.py")
    assert json.loads(found) == digests()


@needs_compiled
def test_an_edited_source_is_what_runs(tmp_path: Path) -> None:
    """And one line says so; until the edit nothing is said."""
    shutil.copytree(PACKAGE, tmp_path / "cosim", ignore=shutil.ignore_patterns("__pycache__", "mavlink", "web", "data"))
    code = (
        "import cosim.vehicle.servo, cosim.base.frames; print(cosim.vehicle.servo.__file__, cosim.base.frames.__file__)"
    )
    before, nothing = python(code, tmp_path)
    assert before.count(str(tmp_path)) == 2
    assert ".py" not in before.replace(".cpython", "")
    assert nothing == ""
    edited_file = tmp_path / "cosim" / "vehicle/servo.py"
    with edited_file.open("a", encoding="utf-8") as file:
        file.write("# another line\n")
    after, said = python(code, tmp_path)
    assert after.split() == [str(edited_file), str(tmp_path / "cosim" / "base/frames.py")]
    assert said.count("\n") == 1
    assert str(edited_file) in said
    assert "make setup" in said
    # and the line is not taken for the words of an FMU that is tried in a process of its own
    fmu = ROOT / "fmus" / "edf.fmu"
    check = f"from cosim.engine.qualify.check import check_fmu; print(check_fmu({str(fmu)!r}).notes)"
    notes, said = python(check, tmp_path)
    assert "prints" not in notes
    assert said.count("\n") == 1


@needs_compiled
@pytest.mark.parametrize("lost", [SHARED, STAMP])
def test_half_of_what_was_compiled_is_not_used(tmp_path: Path, lost: str) -> None:
    """As where another Python compiled last, or a build was broken off."""
    shutil.copytree(PACKAGE, tmp_path / "cosim", ignore=shutil.ignore_patterns("__pycache__", "mavlink", "web", "data"))
    (tmp_path / "cosim" / lost).unlink()
    found, said = python("import cosim.vehicle.servo; print(cosim.vehicle.servo.__file__)", tmp_path)
    assert found.split() == [str(tmp_path / "cosim" / "vehicle/servo.py")]
    assert said == ""


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
