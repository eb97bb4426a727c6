"""What the formats share: what was said when, the numbers of what flew, and quaternions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim import FlightError, InputError, Run, Scenario
from cosim.base.arrays import Array
from cosim.logs import Column, Verdict, list_events, read_pilot_record

Block = dict[str, Array]
Line = dict[str, Any]  # line of the autopilot's record
Timed = tuple[int, int, int, bytes]  # step, time [ns], channel, message

INFO, ERROR = 6, 3  # syslog severities


class LogLine(NamedTuple):
    """One line of text of a flight: step, time, syslog severity, subject."""

    k: int
    time_s: float
    severity: int
    kind: str
    text: str


def read_pilot(run: Run) -> list[Line]:
    """Return the lines of a run's autopilot record; empty if no autopilot flew."""
    return [] if run.folder is None else read_pilot_record(run.folder)


def log_lines(run: Run, lines: Sequence[Line]) -> list[LogLine]:
    """Return events with their ends, the autopilot's changes of mode, outcome and exceeded limits as lines of text."""
    step, summary = run.summary.step_s, run.summary
    texts = []
    for event in list_events(run):
        texts.append(LogLine(round(event.time_s / step), event.time_s, event.severity, event.kind, event.text))
        if event.end_s is not None:
            texts.append(LogLine(round(event.end_s / step), event.end_s, INFO, event.kind, f"over: {event.text}"))
    texts += [LogLine(k, k * step, INFO, "pilot", text) for k, text in mode_changes(lines)]
    level = INFO if summary.outcome == "completed" else ERROR
    end, last = summary.steps, summary.duration_s
    worth = "" if summary.verdict in (None, Verdict.NOT_COMPLETED) else f"; {summary.verdict}"
    texts.append(LogLine(end, last, level, "outcome", f"{summary.outcome}: {summary.reason}{worth}"))
    texts += [LogLine(end, last, ERROR, "limit", f"beyond its limit: {text}") for text in summary.exceeded]
    order = {"pilot": 0, "outcome": 1, "limit": 1}  # order within one step
    return sorted(texts, key=lambda line: (line.k, order.get(line.kind, 2)))


def mode_changes(lines: Sequence[Line]) -> Iterator[tuple[int, str]]:
    """Yield the autopilot's changes of mode and arming, each as its step and a text."""
    states = [line for line in lines if line["kind"] == "state"]
    for before, line in pairwise(states):
        if line["armed"] != before["armed"]:
            yield line["k"], "armed" if line["armed"] else "disarmed"
        if line["mode"] != before["mode"]:
            yield line["k"], f"mode {line['mode']}"


def describe_column(column: Column) -> str:
    """Return unit, frame and meaning of a column in one line, for formats whose fields have no units."""
    return f"[{column.unit}] {f'{column.frame}: ' if column.frame else ''}{column.meaning}"


def read_flown_scenario(run: Run) -> Scenario | None:
    """Return the scenario that a run flew; None if it cannot be read (lost, or of another version)."""
    try:
        scenario = run.scenario
        scenario.resolved_vehicle()
    except (InputError, FlightError):
        return None
    return scenario


def list_numbers(scenario: Scenario | None) -> dict[str, float]:
    """Return every number of a scenario and its vehicle by its key, whose parts are separated by ``/``.

    Only the flown engine's identified model is included.  Whole numbers stay whole, truth values are 0 or 1.
    """
    if scenario is None:
        return {}
    table = scenario.model_dump(mode="json", exclude={"vehicle", "expect"})
    vehicle = scenario.resolved_vehicle()[0].model_dump(mode="json")
    family = Path(scenario.engine).name.removesuffix("-fmi2")  # engine family of the models
    vehicle["identified"] = {name: models for name, models in vehicle["identified"].items() if name == family}
    return dict([*_flatten_numbers("vehicle", vehicle), *_flatten_numbers("scenario", table)])


def _flatten_numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _flatten_numbers(f"{name}/{key}", part)
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from _flatten_numbers(f"{name}/{number}", part)
    elif isinstance(value, bool):
        yield name, int(value)
    elif isinstance(value, int | float):
        yield name, value


def quaternions(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Return quaternions body to NED (w, x, y, z), shape (n, 4), of roll, pitch and yaw [rad]."""
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
