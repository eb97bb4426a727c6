"""All measurements together, and how much of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.machine import Machine, compilers, load, look_around, package_versions
from benchmarks.measures.process import Startup, measure_startup
from benchmarks.measures.speed import RECORDED, measure_speed, warm_up
from benchmarks.peers.block_diagram import BlockDiagram, measure_block_diagram
from benchmarks.peers.multirotor import Multirotor, measure_multirotor
from benchmarks.peers.peers import Peers, measure_peers
from benchmarks.timing import Cost
from cosim import FlightError, InputError
from cosim.commands import nearest
from cosim.files import scratch

STEP, PEERS, PATHSIM, ROTORPY, START = "step", "peers", "pathsim", "rotorpy", "start"
PARTS = (STEP, PEERS, PATHSIM, ROTORPY, START)


@dataclass(frozen=True)
class Plan:
    """Parts to measure, and their numbers of steps, rounds and processes.

    ``dear_rounds``: most rounds of jobs that take long; ``starts``: of processes; ``hover_s``: length of the flights
    compared with RotorPy.

    ``folder``: where flights are recorded; None is the system's place for temporary files.
    """

    parts: tuple[str, ...] = PARTS
    steps: int = 2500
    rounds: int = 5
    dear_rounds: int = 3
    starts: int = 5
    hover_s: float = 1.0
    folder: str | None = None


FULL = Plan(steps=5000, rounds=9, hover_s=2.0)


def make_plan(full: bool, only: Sequence[str], amounts: Mapping[str, Any]) -> Plan:
    """Return the quick or the full plan, or only some parts; amounts that are None are unchanged.

    Raises InputError for an unknown part.
    """
    for part in only:
        if part not in PARTS:
            raise InputError(f"only: unknown part {part!r}; {nearest(part, PARTS)}")
    plan = FULL if full else Plan()
    settings = {name: value for name, value in amounts.items() if value is not None}
    return replace(plan, parts=tuple(part for part in PARTS if part in (only or PARTS)), **settings)


@dataclass(frozen=True)
class Result:
    """Measurements by part; None if a part was not measured, and its error in ``failed``.

    ``step``: by JSBSim runs a step, then by name.
    """

    machine: Machine
    versions: dict[str, str]
    compilers: dict[str, str]
    plan: Plan
    wall_s: float
    failed: dict[str, str] = field(default_factory=dict)
    step: dict[int, dict[str, Cost]] | None = None
    peers: Peers | None = None
    pathsim: BlockDiagram | None = None
    rotorpy: Multirotor | None = None
    start: Startup | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements as plain data for JSON."""
        data: dict[str, Any] = asdict(self)
        del data["plan"]["folder"]
        return data


def measure(plan: Plan, on_progress: Callable[[str, int, int], object] = lambda what, done, total: None) -> Result:
    """Measure the parts of a plan; ``on_progress`` gets the part, its steps done, and their number.

    A part that fails is stated in the result and does not end the others.
    """
    begin, before = time.perf_counter(), load()
    results: dict[str, Any] = {}
    failed: dict[str, str] = {}
    with TemporaryDirectory(prefix="bench-", dir=plan.folder or scratch()) as name:
        folder = Path(name)
        warm_up(folder / "warm")
        for part in PARTS:
            if part in plan.parts:
                measured, total = _make_measurement(part, plan, folder / part)
                (folder / part).mkdir()
                try:
                    results[part] = measured(_ProgressCounter(on_progress, part, total))
                except Exception as error:  # other parts are measured all the same
                    failed[part] = str(error) if isinstance(error, FlightError) else f"{type(error).__name__}: {error}"
    busy = None
    if STEP in results:
        busy = min(costs[RECORDED].cpu_us.median / costs[RECORDED].wall_us.median for costs in results[STEP].values())
    return Result(
        machine=look_around(before, busy),
        versions=package_versions(),
        compilers=compilers(),
        plan=plan,
        wall_s=time.perf_counter() - begin,
        failed=failed,
        **results,
    )


def _make_measurement(part: str, plan: Plan, folder: Path) -> tuple[Callable[[Callable[[], object]], object], int]:
    """Return the function that measures a part, and how many steps of progress it reports."""
    steps, rounds, dear = plan.steps, plan.rounds, min(plan.rounds, plan.dear_rounds)
    measures: dict[str, tuple[Callable[[Callable[[], object]], object], int]] = {
        STEP: (partial(measure_speed, steps, rounds, folder), rounds),
        PEERS: (partial(measure_peers, steps, rounds, folder), rounds),
        PATHSIM: (partial(measure_block_diagram, steps, rounds, folder), rounds),
        ROTORPY: (partial(measure_multirotor, plan.hover_s, dear, folder), dear),
        START: (partial(measure_startup, plan.starts, folder), 2 * (plan.starts + 1)),
    }
    return measures[part]


class _ProgressCounter:
    """Callable that counts its calls and reports them as progress towards ``total``."""

    def __init__(self, tell: Callable[[str, int, int], object], what: str, total: int) -> None:
        self._tell, self._what, self._total, self._done = tell, what, total, 0
        tell(what, 0, total)

    def __call__(self) -> None:
        self._done += 1
        self._tell(self._what, self._done, self._total)
