"""What a flight's page says of its requirements: a table, each margin over time, and the instants that decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.protocols import Column
from cosim.results.events import Event
from cosim.results.log.recorder import Log
from cosim.results.report.panels import Panel, Trace
from cosim.results.report.plot import BLUE, RED
from cosim.results.requirements import FlightSignals, RequirementResult
from cosim.results.summary import Summary
from cosim.results.wording import NONE, display_unit, metric

ZERO_COLUMN = Column("margin_zero", "", "", "below it a requirement is broken")
SOURCES = {"require": "required", "expect": "expected", "limits": "limit", "success": "success"}


class MarginOverTime(NamedTuple):
    """The margin of the comparison that decides a requirement, in every row of the log."""

    result: RequirementResult
    column: Column
    values: Callable[[], Array]


def margins_over_time(log: Log, summary: Summary) -> list[MarginOverTime]:
    """Return the margins that change during a flight; those of metrics of the whole flight do not."""
    flight = FlightSignals(log, summary.step_s, summary.flat_metrics, summary.event_times_s)
    found: dict[str, MarginOverTime] = {}
    for result in by_margin(summary):
        name = f"margin_{result.name}"
        name = f"margin_{result.source}_{result.name}" if name in found else name
        if result.decided_at_s is not None and not flight.metrics.keys() >= set(result.requirement.names):
            meaning = f"margin of {result.decided_by or result.formula}: positive kept, negative broken; not in the log"
            column = Column(name, "" if result.unit == "1" else result.unit, "", meaning)
            found[name] = MarginOverTime(result, column, partial(_margin_values, flight, result))
    return list(found.values())


def _margin_values(flight: FlightSignals, result: RequirementResult) -> Array:
    """Return a margin in every row; only one column is held at a time, as one of an hour takes 7 MB."""
    values = result.requirement.assess(flight).margin_over_time
    return np.full(flight.rows, np.nan) if values is None else values


def margin_columns(margins: Sequence[MarginOverTime], rows: int) -> dict[str, Callable[[], Array]]:
    """Return functions that compute the columns of margins for the page, by name."""
    columns = {margin.column.name: margin.values for margin in margins}
    return columns | {ZERO_COLUMN.name: partial(np.zeros, rows)} if margins else {}


def by_margin(summary: Summary) -> list[RequirementResult]:
    """Return the requirements of a flight, the smallest margin in scales first, those without one last.

    A limit is left out where the scenario expects more of the same metric.
    """
    all_of = summary.requirements
    expected = {each.name: each.margin for each in all_of if each.source == "expect" and each.margin is not None}
    found = [
        each
        for each in all_of
        if each.source != "limits" or each.margin is None or expected.get(each.name, np.inf) > each.margin
    ]
    return sorted(found, key=lambda result: np.inf if result.scaled is None else result.scaled)


CHECKED = ("limit or expectation", "of", "allowed", "margin", "decided at")


def checked_rows(summary: Summary) -> list[tuple[str, tuple[str, ...]]]:
    """Return a row of texts for each limit and expectation of the flight, the smallest margin first.

    Each with its metric, and cells as :data:`CHECKED` heads them.  What a flight has nothing of, and keeps so, is left
    out.
    """
    rows: list[tuple[str, tuple[str, ...]]] = []
    for result in by_margin(summary):
        if result.source in ("limits", "expect") and not (result.margin is None and result.kept):
            of = metric(result.name)
            margin = result.note if result.margin is None else f"{of.factor * result.margin:z.4g} {of.unit}".strip()
            at = "overall" if result.decided_at_s is None else f"{result.decided_at_s:.3f} s"
            rows.append((result.name, (of.label, SOURCES[result.source], allowed_range(result, summary), margin, at)))
    return rows


def allowed_range(result: RequirementResult, summary: Summary) -> str:
    """Return the range of a metric that a limit or an expectation allows."""
    of, least, most = metric(result.name), None, summary.limits.get(result.name)
    if result.source == "expect" and summary.expectation is not None:
        allowed = summary.expectation.metrics[result.name]
        least, most = allowed.min, allowed.max
    ends = [f"{sign} {of.factor * end:.4g}" for sign, end in (("≥", least), ("≤", most)) if end is not None]
    return f"{' and '.join(ends)} {of.unit}".strip()


def compared_margins(summaries: Sequence[Summary | None]) -> list[dict[str, Any]]:
    """Return a row for each requirement that one of several flights states, with a cell for each flight."""
    stated = [
        {result.name: result for result in (summary.requirements if summary else ()) if result.source == "require"}
        for summary in summaries
    ]
    formulas = {(name, result.formula) for results in stated for name, result in results.items()}
    rows = []
    for name, formula in sorted(formulas):
        found = [results.get(name) for results in stated]
        same = [result if result is not None and result.formula == formula else None for result in found]
        cells = [("", "") if result is None else _margin_cell(result) for result in same]
        rows.append({"name": name, "formula": formula, "cells": cells})
    return rows


def _margin_cell(result: RequirementResult) -> tuple[str, str]:
    return describe_margin(result) if result.margin is not None else result.note, "" if result.kept else "unmet"


def describe_margin(result: RequirementResult) -> str:
    """Format a margin with its unit; a dash where there is none."""
    unit, factor = display_unit(result.unit)
    return NONE if result.margin is None else f"{factor * result.margin:z.4g} {'' if unit == '1' else unit}".strip()


def margin_panels(margins: Sequence[MarginOverTime]) -> list[Panel]:
    """Return a panel for each margin, with the line below which it is broken."""
    panels = []
    for margin in margins:
        unit, factor = display_unit(margin.column.unit)
        traces = [Trace(ZERO_COLUMN.name, "broken below", RED, "dash", 1.2), Trace(margin.column.name, "margin", BLUE)]
        panels.append(Panel(margin.result.name, unit, traces, factor))
    return panels


def deciding_events(summary: Summary) -> list[Event]:
    """Return the instants that decide what is required, and the smallest margin of all."""
    smallest = [result for result in by_margin(summary)[:1] if result.source != "require"]
    chosen = [result for result in summary.requirements if result.source == "require"] + smallest
    return [
        Event(time_s=result.decided_at_s, kind="requirement", text=result.describe(), severity=6 if result.kept else 3)
        for result in chosen
        if result.decided_at_s is not None
    ]
