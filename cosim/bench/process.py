"""What a fresh process needs: time from the command to the first step, and memory for a long flight."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cosim.bench.timing import Spread

MEGABYTE = 1e6
LANDMARKS = 4  # parts of the flight at whose ends memory is looked at

# What `hexjet fly` does, with a clock where its first step begins; stamped against the time at which it was started.
_FIRST_STEP = """
import sys, time
python = time.time()
import cosim.console, cosim.flight
from cosim.cli import main
from cosim.simulation import Simulation
imported = time.time()
def step(self):
    print(python, imported, time.time(), flush=True)
    sys.exit(0)
Simulation.step = step
main()
"""


@dataclass(frozen=True)
class Startup:
    """Seconds from the start of ``hexjet fly hover`` to its first step, and of these: Python, imports, building."""

    first_step_s: Spread
    python_s: Spread
    imports_s: Spread
    build_s: Spread


@dataclass(frozen=True)
class Landmark:
    """Resident memory at one point of a flight, and the most there was until then."""

    where: str
    resident_mb: float | None  # None where the system does not tell
    peak_mb: float


@dataclass(frozen=True)
class Memory:
    """Memory of a process that flies ``hover`` for long with full recording, converts the log and writes the report."""

    minutes: float
    steps: int
    wall_s: float
    log_mb: float  # of the run's folder in the end
    landmarks: list[Landmark]
    peak_mb: float


def measure_startup(times: int, folder: Path, on_start: Callable[[], object]) -> Startup:
    """Start ``times`` processes, after one that warms the file cache."""
    rows = []
    for number in range(times + 1):
        arguments = ["fly", "hover", "--out", str(folder / f"start-{number}")]
        started = time.time()
        child = _python(["-c", _FIRST_STEP, *arguments])
        said, _ = child.communicate()
        if child.returncode:
            raise RuntimeError(f"the flight to its first step ended with status {child.returncode}")
        python, imported, stepped = (float(word) for word in said.split())
        if number:
            rows.append((stepped - started, python - started, imported - python, stepped - imported))
        on_start()
    return Startup(*(Spread.of(column) for column in zip(*rows, strict=True)))


def measure_memory(minutes: float, folder: Path, on_landmark: Callable[[], object]) -> Memory:
    """Fly in a process of its own.  Raises RuntimeError if it ends before its report is written."""
    out = folder / "long"
    begin = time.perf_counter()
    child = _python(["-m", "cosim.bench.process", str(out), repr(minutes)])
    assert child.stdout is not None
    landmarks, steps = [], 0
    with child:
        for line in child.stdout:
            where, resident, peak, steps = json.loads(line)
            landmarks.append(Landmark(where, resident, peak))
            on_landmark()
    if child.returncode or not landmarks or landmarks[-1].where != "report":
        raise RuntimeError(f"the long flight ended early, with status {child.returncode}")
    size = sum(file.stat().st_size for file in out.iterdir()) / MEGABYTE
    peak = max(landmark.peak_mb for landmark in landmarks)
    return Memory(minutes, steps, time.perf_counter() - begin, size, landmarks, peak)


def _python(arguments: list[str]) -> subprocess.Popen[str]:
    """This Python, with this package."""
    package = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True, env=environment)


def fly_long(folder: Path, minutes: float, tell: Callable[[str, int], None]) -> None:
    """Fly ``hover`` for so long with full recording; ``tell`` is called with each landmark and the steps until there."""
    from cosim.flight import fly
    from cosim.report import write_report
    from cosim.run import REPORT
    from cosim.scenario import Scenario
    from cosim.signals import Sample

    scenario = Scenario.load("hover").replace(duration_s=60.0 * minutes, expect=[])
    marks = {scenario.steps * part // LANDMARKS - 1: f"{part}/{LANDMARKS}" for part in range(1, LANDMARKS + 1)}

    class Watch:
        def observe(self, sample: Sample) -> None:
            if sample.k in marks:
                tell(marks[sample.k], sample.k + 1)

    tell("start", 0)
    run = fly(scenario, folder, observers=[Watch()], report=False)
    if run.outcome != "completed":
        raise RuntimeError(f"the long flight ended early: {run.reason}")
    tell("log and summary", run.summary.steps)
    write_report(run, folder / REPORT)
    tell("report", run.summary.steps)


def resident_and_peak() -> tuple[float | None, float]:
    """Resident memory of this process, None if the system does not tell, and the most there was of it: MB."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            words = [line.split() for line in status]
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS, kilobytes elsewhere
        return None, peak * (1.0 if sys.platform == "darwin" else 1024.0) / MEGABYTE
    # not ru_maxrss, which on Linux begins with that of the process that started this one
    kilobytes = {row[0]: int(row[1]) for row in words if row[0] in ("VmRSS:", "VmHWM:")}
    return 1024 * kilobytes["VmRSS:"] / MEGABYTE, 1024 * kilobytes["VmHWM:"] / MEGABYTE


def _tell(where: str, steps: int) -> None:
    print(json.dumps([where, *resident_and_peak(), steps]), flush=True)


if __name__ == "__main__":
    fly_long(Path(sys.argv[1]), float(sys.argv[2]), _tell)
