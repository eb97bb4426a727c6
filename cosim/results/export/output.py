"""What the formats share: the file that is there whole or not at all, what was said when, where a run comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import FlightError, InputError
from cosim.base.outcomes import Verdict
from cosim.base.protocols import Column
from cosim.base.storage.files import one_line, replace_on_success
from cosim.results.events import list_events
from cosim.results.export import ulog_autopilot
from cosim.results.log.columns import COLUMNS
from cosim.results.run import RUN_FILES, Run
from cosim.results.summary import Summary
from cosim.spec.scenario import Scenario

Block = dict[str, Array]
Timed = tuple[int, int, int, bytes]  # of MCAP: step, time [ns], channel, message

ROWS = 4096  # converted at once
INFO, ERROR = 6, 3  # severities as in syslog
_DESCRIBED = {column.name: column for column in COLUMNS}


class LogLine(NamedTuple):
    """A line of text about a flight: its step, its time, its severity as in syslog, and what it is of."""

    k: int
    time_s: float
    severity: int
    kind: str
    text: str


def log_lines(run: Run, lines: Sequence[ulog_autopilot.Line]) -> list[LogLine]:
    """Return faults, verdicts, disturbances and contacts, their ends, the autopilot's messages, and the outcome."""
    step, summary = run.summary.step_s, run.summary
    texts = [LogLine(k, k * step, severity, "pilot", text) for k, severity, text in ulog_autopilot.messages(lines)]
    texts += [LogLine(k, k * step, INFO, "pilot", text) for k, text in ulog_autopilot.mode_changes(lines)]
    level = INFO if summary.outcome == "completed" else ERROR
    end, last = summary.steps, summary.duration_s
    worth = "" if summary.verdict in (None, Verdict.NOT_COMPLETED) else f"; {summary.verdict}"
    texts.append(LogLine(end, last, level, "outcome", f"{summary.outcome}: {summary.reason}{worth}"))
    texts += [LogLine(end, last, ERROR, "limit", f"beyond its limit: {text}") for text in summary.exceeded]
    for event in list_events(run):
        if event.kind != "pilot":
            texts.append(LogLine(round(event.time_s / step), event.time_s, event.severity, event.kind, event.text))
            if event.end_s is not None:
                texts.append(LogLine(round(event.end_s / step), event.end_s, INFO, event.kind, f"over: {event.text}"))
    return sorted(texts, key=lambda line: line.k)


def run_properties(summary: Summary) -> dict[str, str]:
    """Return what a run is, by names that are the same in every format."""
    return {
        "scenario": summary.scenario,
        "aircraft": summary.aircraft,
        "engine": summary.engine,
        "controller": summary.controller,
        "flown_by": summary.controller_shown,
        "seed": str(summary.seed),
        "outcome": summary.outcome,
        "reason": summary.reason,
        "verdict": summary.verdict or "",
        "started": summary.started,
        "step_s": repr(summary.step_s),
        "version": summary.versions.get("hexjet-cosim", "unknown"),
    }


def describe_columns(run: Run) -> list[Column]:
    """Return the columns of a log with their meanings: from its file, or as today's where an older file is silent."""
    columns = {column.name: column for column in run.log.described}
    empty = Column("", "", "", "")
    return [
        column
        if (column := columns.get(name, empty)).meaning
        else _DESCRIBED.get(name, empty)._replace(name=name, source="")
        for name in run.log.columns
    ]


def describe_column(column: Column) -> str:
    """Return unit, frame and meaning in a line, for formats whose fields have no units."""
    return f"[{column.unit}] {f'{column.frame}: ' if column.frame else ''}{column.meaning}"


def read_flown_scenario(run: Run) -> Scenario | None:
    """Return the scenario as flown; None where it is of another version or gone, while the log is still there."""
    try:
        scenario = run.scenario
        scenario.resolved_vehicle()
    except (InputError, FlightError):
        return None
    return scenario


def list_numbers(scenario: Scenario | None) -> dict[str, float]:
    """Return every number of the vehicle, with its gains, and of the scenario: under its key, parted by ``/``.

    Of the identified models only that of the engine that is flown.  What is whole is whole, truth is 0 or 1.
    """
    if scenario is None:
        return {}
    table = scenario.model_dump(mode="json", exclude={"vehicle", "expect"})
    vehicle = scenario.resolved_vehicle()[0].model_dump(mode="json")
    family = Path(scenario.engine).name.removesuffix("-fmi2")  # what a model is filed under, in either FMI version
    vehicle["identified"] = {name: models for name, models in vehicle["identified"].items() if name == family}
    return dict([*_leaves("vehicle", vehicle), *_leaves("scenario", table)])


def _leaves(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _leaves(f"{name}/{key}", part)
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from _leaves(f"{name}/{number}", part)
    elif isinstance(value, bool):
        yield name, int(value)
    elif isinstance(value, int | float):
        yield name, value


def quaternions(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Return quaternions w, x, y, z, shape (n, 4), of the yaw-pitch-roll sequence (rad): body to NED."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw))
    return np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=1,
    )


@contextmanager
def open_output(run: Run, path: Path) -> Iterator[Path]:
    """Yield a temporary file that becomes ``path`` if all goes well.  Raises InputError if it cannot be written."""
    if path.name in RUN_FILES and run.folder is not None and path.resolve().parent == run.folder.resolve():
        raise InputError(f"{path}: belongs to the run itself; choose another name")
    try:
        with replace_on_success(path) as temporary:
            yield temporary
    except OSError as error:
        raise InputError(f"{path}: {one_line(error)}") from error
