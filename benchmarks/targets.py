"""What the project asks of itself, and how the measurements stand to it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.measures.process import FLY, HELP, IMPORT, UNIT
from benchmarks.measures.speed import ENGINES, OUTSIDE, RECORDED
from benchmarks.suite import Result
from benchmarks.timing import Spread

RUNS = "JSBSim runs"
OUTSIDE_UNITS = 1.0  # JSBSim runs, a control step of the standard flight
BY_BARE = {1: 4.5, 4: 2.0}  # whole flight by bare JSBSim, by runs a step
ENGINE_UNITS = 1.5  # JSBSim runs: six engine FMUs, a control step
FIRST_STEP_S = 1.5
COMMAND_UNITS = {HELP: 1.0, IMPORT: 1.0, FLY: 5.7}  # processor time by that of importing numpy and pydantic

_COMMAND_KEYS = {HELP: "help", IMPORT: "import", FLY: "fly"}


@dataclass(frozen=True)
class TargetResult:
    """One thing that is asked for: at most ``bound``, or at least if ``least``.  The median decides.

    ``key`` is its name in ``before.toml``.
    """

    name: str
    measured: Spread
    bound: float
    unit: str
    least: bool = False
    key: str = ""

    @property
    def met(self) -> bool:
        median = self.measured.median
        return median >= self.bound if self.least else median <= self.bound

    @property
    def before(self) -> str | None:
        """What it came to before, in words, as ``before.toml`` has it; None: it was not measured."""
        return values_before().get(self.key)


@cache
def values_before() -> dict[str, str]:
    """Return what was measured before, by key, whatever it is from."""
    table = tomllib.loads((Path(__file__).parent / "before.toml").read_text(encoding="utf-8"))
    return {key: value for source in table.values() for key, value in source.items()}


def judge_targets(result: Result) -> list[TargetResult]:
    """Everything that is asked for and was measured."""
    return [*_step(result), *_processes(result)]


def to_dict(result: Result) -> dict[str, Any]:
    """Return a result as it goes into JSON, with what is asked for."""
    return result.to_dict() | {
        "asked": [asdict(row) | {"met": row.met, "before": row.before} for row in judge_targets(result)]
    }


def runs_a_step(runs: int) -> str:
    """In words."""
    return f"{runs} run{'s' if runs > 1 else ''} a step"


def _step(result: Result) -> Iterator[TargetResult]:
    for runs, costs in (result.step or {}).items():
        in_it = runs_a_step(runs)
        yield TargetResult(
            f"not JSBSim, recorded in full, {in_it}", costs[OUTSIDE].units, OUTSIDE_UNITS, RUNS, key=f"outside-{runs}"
        )
        recorded = costs[RECORDED].units.times(1.0 / runs)
        yield TargetResult(
            f"whole flight by bare JSBSim, {in_it}", recorded, BY_BARE[runs], "times", key=f"bare-{runs}"
        )
        yield TargetResult(f"{ENGINES}, {in_it}", costs[ENGINES].units, ENGINE_UNITS, RUNS, key=f"engines-{runs}")


def _processes(result: Result) -> Iterator[TargetResult]:
    if result.start:
        yield TargetResult("from command to first step", result.start.first_step_s, FIRST_STEP_S, "s", key="first-step")
        for name, bound in COMMAND_UNITS.items():
            yield TargetResult(
                f"{name}, by {UNIT}", result.start.commands[name].units, bound, "times", key=_COMMAND_KEYS[name]
            )
