"""One flight of a study and its row.

A row says everything about a flight: what was varied, what came of it, and hashes of its whole log and of what it was
made from, by which the same flight flown elsewhere, or another year, is known to be the same.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from socket import gethostname
from typing import TYPE_CHECKING, Any

from cosim.base.errors import RESOURCE_ERRNOS, FlightError, InputError
from cosim.base.storage.scratch import temporary
from cosim.campaign.study.keys import CUSTOM_PARAMETERS
from cosim.campaign.study.plan import Flight, case_of, scenario_of
from cosim.flight import fly_watched as fly
from cosim.results import metrics
from cosim.results.log.columns import logged_vehicle
from cosim.results.log.digest import DigestSink, log_digest
from cosim.results.metrics import check_expectations, metric_names
from cosim.results.requirements import (
    FailedFlight,
    FlightSignals,
    Requirement,
    RequirementResult,
    range_requirements,
    smallest_margin,
)
from cosim.results.requirements.stated import columns_of, stated_requirements
from cosim.simulation.plugins import load_metrics
from cosim.spec.scenario import WaypointsCommand

if TYPE_CHECKING:
    from cosim.campaign.study.study import Study
    from cosim.results.run import Run
    from cosim.spec.scenario import Scenario

Value = float | int | str | bool | None
Row = dict[str, Value]
Kinds = dict[str, type[Value]]

_IDS: Kinds = {"flight": int, "draw": int, "controller": str, "seed": int}  # columns that identify a flight
_OUTCOME: Kinds = {"outcome": str, "reason": str, "success": bool, "beyond": str, "steps": int, "duration_s": float}
KEY = "key"  # column: hash of what was flown
MARGIN_OF = "margin_"  # prefix of requirements' margins
# Column with the smallest scaled margin of the flight's own limits and expectations.
LIMITS_MARGIN = "limits_margin"
_ORIGIN: Kinds = {  # columns on the origin of a row
    "controller_sha256": str,
    "controller_repeatable": bool,
    "log_sha256": str,
    "inputs_sha256": str,
    "inputs": str,
    "wall_s": float,
    "worker": str,
    KEY: str,
}
# Sentence on flights that cannot be flown, for example because the drawn vehicle has no equilibrium.
NOT_FLOWN = (
    "what cannot be flown is no success wherever flights are counted, refutes no claim, and is no failure that a "
    "search finds"
)
_COLUMN_TYPES: Kinds = {"float": float, "int": int, "bool": bool, "choice": str}  # column type of each kind of key


@dataclass(frozen=True)
class Chunk(Flight):
    """Flights that one process flies together, by a function that it imports by its name; their rows are in its row."""

    flights: Sequence[Flight]
    fly_together: Callable[[Study, Sequence[Flight]], Sequence[Row]]


def kinds(study: Study, custom: Sequence[str] | None = None) -> Kinds:
    """Return the columns of a study's rows in order, with types; ``custom``: names of the custom metrics, if known.

    What was not measured is None; flight, draw, controller, seed, what was varied, outcome, reason and success always
    have a value.
    """
    varied = {name: _column_type(study, name) for name in study.drawn}
    measured = dict.fromkeys([*metric_names(), *(custom_metric_names(study) if custom is None else custom)], float)
    flown = {"autopilot": str, **study.autopilot.columns} if study.autopilot is not None else {}
    by: Kinds = {"by": str} if study.batch else {}
    return _IDS | varied | _OUTCOME | _margin_kinds(study) | measured | _ORIGIN | by | _plugin_kinds(study) | flown


def fly_one(study: Study, flight: Flight) -> Row:
    """Fly one flight and return its row; any error makes a row ``failed`` with the reason.

    Raises FlightError where it is the machine that fails, its disk being full, say: the flight is to be flown again.
    """
    begin = time.perf_counter()
    if isinstance(flight, Chunk):
        rows: Any = flight.fly_together(study, flight.flights)
        return {"flight": flight.number, "rows": rows, "wall_s": time.perf_counter() - begin}
    try:
        scenario = scenario_of(study, flight)
        if study.autopilot is not None:
            with temporary("autopilot-") as folder:
                outcome, _ = with_autopilot(study, scenario, folder / "run", case_of(flight.values), page=False)
        else:
            sink = _make_metric_sink(scenario)
            outcome = outcome_row(study, fly(scenario, sink=sink), sink.hexdigest())
    except Exception as error:
        if (trouble := _find_resource_error(error)) is not None:
            raise FlightError(f"{worker_name()}: {trouble.strerror}") from error
        expected = isinstance(error, (InputError, FlightError))
        reason = str(error) if expected else ": ".join([type(error).__name__, *str(error).splitlines()[:1]])
        outcome = {"reason": reason}
    return failed_row(study, flight, "") | outcome | {"wall_s": time.perf_counter() - begin, "worker": worker_name()}


def with_autopilot(
    study: Study, scenario: Scenario, folder: Path, case: str | None = None, page: bool = True
) -> tuple[Row, Run]:
    """Fly a case with the study's autopilot into ``folder``; return the autopilot's values of the row and the run.

    What it was made from is the scenario as the study has it: the record of the autopilot's commands is of the flight.
    Raises InputError and FlightError.
    """
    autopilot = study.autopilot_of(case)
    run, flown = autopilot.fly(scenario, study.folder, folder, page)
    row = outcome_row(study, run, log_digest(run.log)) | {
        "controller_sha256": None,
        "controller_repeatable": None,
        "inputs_sha256": hash_inputs(inputs(run), scenario),
        "autopilot": autopilot.name,
    }
    return row | flown, run


def custom_metric_names(study: Study) -> list[str]:
    return [name for metric in load_metrics(study.base()) for name in metric.names]


def _plugin_kinds(study: Study) -> Kinds:
    """Return the column of a study with plug-ins other than controllers."""
    base = study.base()
    return {"brought_sha256": str} if base.metrics or base.observers or base.sensor_plugin or base.wind else {}


def _margin_kinds(study: Study) -> Kinds:
    """Return the columns of margins: the smallest, its requirement, that of limits, and one per requirement."""
    names = [requirement.name for requirement in study_requirements(study)]
    smallest: Kinds = {"margin": float, "decided_by": str, LIMITS_MARGIN: float}
    return smallest | dict.fromkeys([MARGIN_OF + name for name in names], float)


def study_requirements(study: Study) -> list[Requirement]:
    """Return the requirements of a study besides a flight's limits: ``[[require]]`` and ``[success]``."""
    return [*stated_requirements(study.base()), *range_requirements(study.success, "success")]


def _flight_margins(study: Study, run: Run) -> Row:
    """Return the margins of a flight: each requirement's own, and the smallest of all, in scales."""
    summary = run.summary
    lost = None if summary.outcome == "completed" else FailedFlight(summary.duration_s, summary.planned_s)
    flight = FlightSignals(run.log, summary.step_s, summary.flat_metrics, {})
    success = [
        RequirementResult.of(requirement.assess(flight, lost))
        for requirement in range_requirements(study.success, "success")
    ]
    results = [*summary.requirements, *success]
    margin, decided_by = smallest_margin(results, lost)
    named = [result for result in results if result.source in ("require", "success")]
    limits, _ = smallest_margin([result for result in results if result.source in ("limits", "expect")], lost)
    smallest = {"margin": margin, "decided_by": decided_by, LIMITS_MARGIN: limits}
    return smallest | {MARGIN_OF + result.name: result.margin for result in named}


def _make_metric_sink(scenario: Scenario) -> DigestSink:
    """Return a sink that keeps what metrics read: all columns if a custom metric does not name its own."""
    waypoints = any(isinstance(entry, WaypointsCommand) for entry in scenario.command)
    names = list(metrics.columns(logged_vehicle(scenario.resolved_vehicle()[0]), waypoints))
    custom = load_metrics(scenario)
    extra = [name for metric in custom for name in metric.columns or ()]
    extra += columns_of(scenario, [*metric_names(), *(name for metric in custom for name in metric.names)])
    return DigestSink([*names, *(name for name in dict.fromkeys(extra) if name not in names)],
                      whole=any(metric.columns is None for metric in custom))  # fmt: skip


def failed_row(study: Study, flight: Flight, reason: str) -> Row:
    """Return the row of a flight of which only the reason of its failure is known."""
    numbers: Row = {"flight": flight.number, "draw": flight.draw, "controller": flight.controller, "seed": flight.seed}
    failed: Row = {"outcome": "failed", "reason": reason, "success": False}
    return {**dict.fromkeys(kinds(study)), **numbers, **flight.values, **failed}


def verdict_of(outcome: Value, success: Value) -> bool | None:
    """Return whether a row's flight succeeded; None without a verdict."""
    return None if outcome == "failed" else bool(success)


def describe_not_flown(flights: int, reason: str) -> str:
    """Describe flights without a verdict: how many, the reason of the first, and how they are counted."""
    many = "" if flights == 1 else "s"
    return f"{flights:,} flight{many} could not be flown to a verdict, the first because: {reason}; {NOT_FLOWN}"


def inputs(run: Run) -> str:
    """Return the inputs of a run as JSON: versions of packages, and hashes of the files of aircraft and engines."""
    summary = run.summary
    files = {name: value for name, value in summary.sha256.items() if not name.endswith(" as flown")}
    return json.dumps({"versions": summary.versions, "sha256": files}, sort_keys=True)


def hash_inputs(inputs_text: str, scenario: Scenario) -> str:
    """Return the hash of :func:`inputs` and of every number that the aircraft and the engines flew with."""
    return hashlib.sha256("\n".join([inputs_text, scenario.model_dump_json()]).encode()).hexdigest()


def outcome_row(study: Study, run: Run, digest: str) -> Row:
    """Return the columns of a row that a finished flight determines; ``digest`` is its log's hash."""
    summary, controller = run.summary, run.summary.own_controller
    measured, inputs_text = summary.flat_metrics, inputs(run)
    brought = "; ".join(f"{block.key} {block.name} {block.sha256}" for block in summary.brought)
    return {
        "outcome": summary.outcome,
        "reason": summary.reason,
        "success": summary.outcome == "completed"
        and not summary.beyond
        and summary.requirements_kept is not False
        and not check_expectations(measured, study.success),
        "beyond": " ".join(summary.beyond),
        "steps": summary.steps,
        "duration_s": summary.duration_s,
        **_flight_margins(study, run),
        **measured,
        "controller_sha256": None if controller is None else controller.sha256,
        "controller_repeatable": None if controller is None else controller.repeatable,
        "log_sha256": digest,
        "inputs_sha256": hash_inputs(inputs_text, run.scenario),
        "inputs": inputs_text,
        **({"brought_sha256": brought} if brought else {}),
    }


def _column_type(study: Study, key: str) -> type[Value]:
    if key.startswith(CUSTOM_PARAMETERS):
        return float
    varied = study.key(key)
    return type(varied.choices[0]) if varied.kind == "choice" and varied.choices else _COLUMN_TYPES[varied.kind]


def _find_resource_error(error: BaseException | None) -> OSError | None:
    """Return the operating system's error behind another, if it means a lack of resources."""
    while error is not None and not (isinstance(error, OSError) and error.errno in RESOURCE_ERRNOS):
        error = error.__cause__ or error.__context__
    return error


@cache
def worker_name() -> str:
    """Return the name of the machine and the process, as rows record it."""
    return f"{gethostname()}:{os.getpid()}"
