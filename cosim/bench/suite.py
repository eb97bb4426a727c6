"""All measurements together, and the machine that they were taken on."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cosim.bench.blocks import Breakdown, measure_blocks
from cosim.bench.peers import Peers, measure_peers
from cosim.bench.process import Memory, Startup, measure_memory, measure_startup
from cosim.bench.speed import ENGINES, OUTSIDE, RECORDED, measure_speed
from cosim.bench.timing import Cost
from cosim.run import versions

# What the project asks of itself, on any machine.
OUTSIDE_UNITS = 8.0  # of one JSBSim run, a control step
ENGINE_UNITS = 1.5  # the same for six engine FMUs
FIRST_STEP_S = 1.5
PEAK_MB = 300.0


@dataclass(frozen=True)
class Plan:
    """How much to measure: steps a flight, rounds, processes started, minutes of the long flight (None: no long one).

    ``folder``: where flights are recorded; None is the system's place for temporary files.
    """

    steps: int = 5000
    rounds: int = 9
    starts: int = 5
    memory_minutes: float | None = None
    folder: str | None = None


@dataclass(frozen=True)
class Machine:
    """What the figures belong to.  ``processor_share``: processor time by wall time in flight; 1 on a quiet machine."""

    cpu: str
    cores: int
    system: str
    load: tuple[float, float] | None  # processes wanting to run, in the last minute: at the beginning, at the end
    processor_share: float


@dataclass(frozen=True)
class Result:
    """Everything that was measured.  ``speed``: by JSBSim runs a step, then by name."""

    machine: Machine
    versions: dict[str, str]
    plan: Plan
    speed: dict[int, dict[str, Cost]]
    breakdown: Breakdown
    peers: Peers
    startup: Startup
    memory: Memory | None
    wall_s: float

    def to_dict(self) -> dict[str, Any]:
        """As it goes into JSON."""
        data = asdict(self)
        del data["plan"]["folder"]
        targets = {
            "outside_units": OUTSIDE_UNITS,
            "engine_units": ENGINE_UNITS,
            "first_step_s": FIRST_STEP_S,
            "peak_mb": PEAK_MB,
        }
        return data | {"speed": {str(runs): costs for runs, costs in data["speed"].items()}, "targets": targets}

    def headlines(self) -> list[tuple[str, float, float, str]]:
        """What is asked for: name, measured, at most, unit."""
        rows = [
            (f"outside JSBSim, {runs} runs a step", costs[OUTSIDE].units.median, OUTSIDE_UNITS, "JSBSim runs")
            for runs, costs in self.speed.items()
        ]
        rows += [
            (f"{ENGINES}, {runs} runs a step", costs[ENGINES].units.median, ENGINE_UNITS, "JSBSim runs")
            for runs, costs in self.speed.items()
        ]
        rows.append(("from command to first step", self.startup.first_step_s.median, FIRST_STEP_S, "s"))
        if self.memory:
            rows.append((f"memory, {self.memory.minutes:g} min flown", self.memory.peak_mb, PEAK_MB, "MB"))
        return rows


def measure(plan: Plan, on_progress: Callable[[str, int, int], object] = lambda what, done, total: None) -> Result:
    """Measure; ``on_progress`` is told what is measured, how much of it is done, and of how much."""
    begin, load = time.perf_counter(), _load()
    with TemporaryDirectory(prefix="hexjet-bench-", dir=plan.folder) as name:
        folder = Path(name)
        counter = partial(_Counter, on_progress)
        speed = measure_speed(plan.steps, plan.rounds, folder / "speed", counter("step", plan.rounds))
        (folder / "blocks").mkdir()
        breakdown = measure_blocks(plan.steps, plan.rounds, folder / "blocks", counter("blocks", plan.rounds))
        (folder / "peers").mkdir()
        peers = measure_peers(plan.steps, plan.rounds, folder / "peers", counter("engines", plan.rounds))
        startup = measure_startup(plan.starts, folder, counter("first step", plan.starts + 1))
        memory = None
        if plan.memory_minutes is not None:
            memory = measure_memory(plan.memory_minutes, folder, counter("long flight", 7))
    share = [costs[RECORDED].cpu_us.median / costs[RECORDED].wall_us.median for costs in speed.values()]
    end = _load()
    return Result(
        machine=Machine(_cpu(), os.cpu_count() or 1, _system(), (load, end) if load and end else None, min(share)),
        versions=versions(),
        plan=plan,
        speed=speed,
        breakdown=breakdown,
        peers=peers,
        startup=startup,
        memory=memory,
        wall_s=time.perf_counter() - begin,
    )


class _Counter:
    """Counts its calls towards ``total``."""

    def __init__(self, tell: Callable[[str, int, int], object], what: str, total: int) -> None:
        self._tell, self._what, self._total, self._done = tell, what, total, 0
        tell(what, 0, total)

    def __call__(self) -> None:
        self._done += 1
        self._tell(self._what, self._done, self._total)


def _load() -> float | None:
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def _system() -> str:
    return f"{platform.system()} {platform.machine()}"


def _cpu() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()
