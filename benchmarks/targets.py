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
# Goals of a control step of the standard flight: its part outside JSBSim [JSBSim runs], the whole by bare JSBSim for
# each number of runs a step, six engine FMUs [JSBSim runs].
MAX_OUTSIDE = 1.0
MAX_BY_BARE = {1: 4.5, 4: 2.0}
MAX_ENGINE_UNITS = 1.5
MAX_START_S = 1.5
# Goals of processor time relative to importing numpy and pydantic.
COMMAND_UNITS = {HELP: 1.0, IMPORT: 1.0, FLY: 5.7}

_COMMAND_KEYS = {HELP: "help", IMPORT: "import", FLY: "fly"}


@dataclass(frozen=True)
class TargetResult:
    """A goal and its measured value: at most ``bound``, or at least if ``least``.  The median decides.

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
        """Text on an earlier value from ``before.toml``; None if it was not measured."""
        return values_before().get(self.key)


@cache
def values_before() -> dict[str, str]:
    """Return the earlier values of ``before.toml`` by key, of all sources."""
    table = tomllib.loads((Path(__file__).parent / "before.toml").read_text(encoding="utf-8"))
    return {key: value for source in table.values() for key, value in source.items()}


def judge_targets(result: Result) -> list[TargetResult]:
    """Return all goals whose quantities were measured, with the results."""
    return [*_judge_step(result), *_judge_processes(result)]


def to_dict(result: Result) -> dict[str, Any]:
    """Return a result as plain data for JSON, with its goals."""
    return result.to_dict() | {
        "asked": [asdict(row) | {"met": row.met, "before": row.before} for row in judge_targets(result)]
    }


def runs_a_step(runs: int) -> str:
    """Return a text on the number of JSBSim runs a step."""
    return f"{runs} run{'s' if runs > 1 else ''} a step"


def _judge_step(result: Result) -> Iterator[TargetResult]:
    for runs, costs in (result.step or {}).items():
        in_it = runs_a_step(runs)
        yield TargetResult(
            f"not JSBSim, recorded in full, {in_it}", costs[OUTSIDE].units, MAX_OUTSIDE, RUNS, key=f"outside-{runs}"
        )
        recorded = costs[RECORDED].units.times(1.0 / runs)
        yield TargetResult(
            f"whole flight by bare JSBSim, {in_it}", recorded, MAX_BY_BARE[runs], "times", key=f"bare-{runs}"
        )
        yield TargetResult(f"{ENGINES}, {in_it}", costs[ENGINES].units, MAX_ENGINE_UNITS, RUNS, key=f"engines-{runs}")


def _judge_processes(result: Result) -> Iterator[TargetResult]:
    if result.start:
        yield TargetResult("from command to first step", result.start.first_step_s, MAX_START_S, "s", key="first-step")
        for name, bound in COMMAND_UNITS.items():
            yield TargetResult(
                f"{name}, by {UNIT}", result.start.commands[name].units, bound, "times", key=_COMMAND_KEYS[name]
            )
