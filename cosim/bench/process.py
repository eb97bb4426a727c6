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
from cosim.errors import FlightError

MEGABYTE = 1e6

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
    """Start ``times`` processes, after one that warms the file cache.  Raises FlightError if one does not get there."""
    rows = []
    for number in range(times + 1):
        arguments = ["fly", "hover", "--out", str(folder / f"start-{number}")]
        started = time.time()
        child = _python(["-c", _FIRST_STEP, *arguments])
        said, _ = child.communicate()
        if child.returncode:
            raise FlightError(f"the flight to its first step ended with status {child.returncode}")
        python, imported, stepped = (float(word) for word in said.split())
        if number:
            rows.append((stepped - started, python - started, imported - python, stepped - imported))
        on_start()
    return Startup(*(Spread.of(column) for column in zip(*rows, strict=True)))


def measure_memory(minutes: float, folder: Path, on_landmark: Callable[[], object]) -> Memory:
    """Fly in a process of its own.  Raises FlightError if it ends before its report is written."""
    out = folder / "long"
    begin = time.perf_counter()
    child = _python(["-m", "cosim.bench.long_flight", str(out), repr(minutes)])
    assert child.stdout is not None
    landmarks: list[Landmark] = []
    steps = 0
    with child:
        for line in child.stdout:
            where, resident, peak, steps = json.loads(line)
            # the system counts roughly, and its peak may go down by a few pages
            landmarks.append(Landmark(where, resident, max([peak, *(mark.peak_mb for mark in landmarks)])))
            on_landmark()
    if child.returncode or not landmarks or landmarks[-1].where != "report":
        raise FlightError(f"the long flight ended early, with status {child.returncode}")
    size = sum(file.stat().st_size for file in out.iterdir()) / MEGABYTE
    return Memory(minutes, steps, time.perf_counter() - begin, size, landmarks, landmarks[-1].peak_mb)


def _python(arguments: list[str]) -> subprocess.Popen[str]:
    """This Python, with this package."""
    package = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True, env=environment)
