"""What all surveys share: the vehicle, the cases chosen, the flights in worker processes, and how they are judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import degrees, nan
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from cosim.base.errors import InputError
from cosim.base.outcomes import Verdict
from cosim.base.signals import AXES
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import load_engine
from cosim.results.log.columns import jets_in
from cosim.results.log.recorder import Log
from cosim.results.requirements import FlightSignals, Lost, Requirement
from cosim.results.run import Run
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_seen_from, engine_of, load_vehicle
from cosim.studies import EngineDraw, run_in_order, with_values

Progress = Callable[[str, int, int], None]  # is told what was flown, how many are, and of how many
T = TypeVar("T")
R = TypeVar("R")

LEVEL_DEG = 5.0  # chosen by us: within this of what is asked, on every axis over the last second, the vehicle is held


class Subject(NamedTuple):
    """The vehicle that is surveyed, with its engine."""

    aircraft: str
    vehicle: Vehicle
    engine: str

    def scenario(self, name: str, controller: str, height: float, duration: float, **table: Any) -> Scenario:
        """Return a flight at its control step, from ``height`` [m] on, of ``duration`` [s].  Raises InputError."""
        table |= {"name": name, "aircraft": self.aircraft, "engine": self.engine, "controller": controller}
        table |= {"duration_s": duration, "initial": {"altitude_m": height}}
        return Scenario.from_table({"step_s": self.vehicle.control_step} | table, Path(), name)

    def controllers(self) -> list[str]:
        """Return those of the compared controllers whose model the vehicle has with this engine."""
        engine = load_engine(self.engine, {}, self.vehicle.control_step)
        modelled = bool(engine.models_in(self.vehicle.identified))
        return [name for name, spec in PREDICTORS.items() if spec.compared and (modelled or not spec.needs_model)]


def load_subject(aircraft: str, engine: str | None = None) -> Subject:
    """Return an aircraft with an engine, None: the one that it is made for.  Raises InputError for unknown names."""
    aircraft = aircraft_seen_from(aircraft, Path())
    vehicle, _ = load_vehicle(aircraft)
    return Subject(aircraft, vehicle, engine or engine_of(aircraft) or Scenario.model_fields["engine"].default)


def draw_engine(scenario: Scenario, draw: EngineDraw | None, name: str) -> Scenario:
    """Return a flight with its engine drawn under this name; without draws as it is."""
    return scenario if draw is None else with_values(scenario, draw.named(name))


def select_cases(cases: Sequence[T], kinds: Sequence[str], subject: str, name_of: Callable[[T], str]) -> list[T]:
    """Return the cases that begin as one of ``kinds``, all if there are none.  Raises InputError if none does."""
    chosen = [case for case in cases if not kinds or name_of(case).startswith(tuple(kinds))]
    if not chosen:
        names = ", ".join(dict.fromkeys(map(name_of, cases)))
        raise InputError(f"no {subject} begins with {' or '.join(map(repr, kinds))}; there are: {names}")
    return chosen


def fly_all(
    act: Callable[[T], R],
    tasks: Sequence[T],
    workers: int,
    progress: Progress,
    describe: Callable[[R], str],
    finished: int = 0,
    total: int = 0,
) -> Iterator[R]:
    """Yield the outcome of every task, in order; ``finished`` of ``total`` were flown before them."""
    for count, result in enumerate(run_in_order(act, tasks, workers), finished + 1):
        progress(describe(result), count, total or len(tasks))
        yield result


def measure_flight(log: Log, begin: int) -> tuple[float, float, int | None]:
    """Return the largest lean [deg], the height lost [m] and the row of the first detection, from row ``begin`` on."""
    roll, pitch, height = (log[name][begin:] for name in ("roll_rad", "pitch_rad", "altitude_m"))
    if not roll.size:
        return nan, nan, None
    upright = np.cos(roll) * np.cos(pitch)
    # A column is NaN where a vehicle has no such jet.
    health = np.nanmin([log[f"health_{jet}"] for jet in range(1, jets_in(log.columns) + 1)], 0)
    ill = np.flatnonzero(health < 1.0)
    lean = degrees(float(np.arccos(np.clip(upright.min(), -1.0, 1.0))))
    return lean, max(0.0, float(height[0] - height.min())), int(ill[0]) if ill.size else None


def held_requirement(duration_s: float) -> Requirement:
    """Return what a vehicle keeps that is held: every axis level to ``LEVEL_DEG`` over the last second."""
    level = " and ".join(f"abs({axis}_error_deg) <= {LEVEL_DEG:g}" for axis in AXES)
    return Requirement(name="held", formula=f"after({duration_s - 1.0:.9g} s, always({level}))")


def judge_outcome(run: Run) -> tuple[Verdict, float | None]:
    """Return whether a vehicle is held, airborne and no more than that, or lost; and by how much it is held [deg].

    The margin is that of :func:`held_requirement`, None where an axis has no set-point.
    """
    summary = run.summary
    lost = None if summary.outcome == "completed" else Lost(summary.duration_s, summary.planned_s)
    held = held_requirement(summary.planned_s).assess(FlightSignals(run.log, summary.step_s, {}, {}), lost)
    if lost is not None:
        return Verdict.LOST, held.margin
    return Verdict.HELD if held.kept else Verdict.AIRBORNE, held.margin
