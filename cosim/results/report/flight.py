"""A finished run as one HTML page that opens offline."""

from __future__ import annotations

import shlex
from math import degrees
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.outcomes import Verdict
from cosim.results.events import list_events, list_phases
from cosim.results.log.columns import custom_columns
from cosim.results.metrics import AxisMetrics
from cosim.results.report.flight_figures import run_figures
from cosim.results.report.log_reader import Reader
from cosim.results.report.page import TEMPLATES, Flights, render
from cosim.results.report.panels import make_rest_columns
from cosim.results.report.plot import BLUE
from cosim.results.report.requirements import (
    SOURCES,
    ZERO_COLUMN,
    allowed_range,
    by_margin,
    deciding_events,
    describe_margin,
    margin_columns,
    margins_over_time,
)
from cosim.results.report.signals_data import describe_run, run_data
from cosim.results.run import LOG, SCENARIO, Run
from cosim.results.summary import DelayRow, Summary
from cosim.results.verdict import BADGES
from cosim.results.wording import DIGITS, NONE, metric, show_value

EVENT_KINDS = {
    "fault": "fault",
    "monitor": "engine monitor",
    "disturbance": "from outside",
    "contact": "ground",
    "pilot": "autopilot",
    "requirement": "requirement",
}


def write_report(run: Run, path: Path, shared_assets: bool = False) -> None:
    """Write the page of one run.  Raises FlightError if the file cannot be written.

    ``shared_assets``: what draws it goes into one folder for all runs, beside that of this one.
    """
    with run.log.keep_open():
        _write_page(run, path, shared_assets)


def _write_page(run: Run, path: Path, shared_assets: bool) -> None:
    summary = run.summary
    events = sorted([*list_events(run), *deciding_events(summary)], key=lambda event: event.time_s)
    phases = list_phases(run)
    flights, margins = None, margins_over_time(run.log, summary) if summary.steps else []
    if summary.steps:
        flight = describe_run(run, summary.controller_shown, BLUE, events)._replace(
            derived=make_rest_columns(run.log, summary) | margin_columns(margins, len(run.log)),
            made=[ZERO_COLUMN, *(margin.column for margin in margins)],
            upsets=Reader(run.log, summary.step_s).upsets(),
            phases=phases,
        )
        data = run_data(flight)
        flights = Flights(summary.scenario, [data], run_figures(run.log, summary, margins))
    strips = {} if flights is None else flights.figures
    render(
        TEMPLATES / "report.html",
        path,
        {},
        flights,
        path.resolve().parent.parent if shared_assets else None,
        strips=strips,
        shaded=bool(flights and (flights.runs[0][0]["upsets"] or flights.runs[0][0]["events"])),
        events=events,
        kinds=EVENT_KINDS,
        grave=3,  # errors and above stand out
        phases=list(dict.fromkeys(phase.name for phase in phases)),
        refused=any(
            trace["label"] == "refused"
            for panel in strips.get("effort", {"panels": []})["panels"]
            for trace in panel["signals"]
        ),
        summary=summary,
        verdict=verdict(summary),
        badge=verdict_badge(summary),
        found=found_values(summary),
        requirements=by_margin(summary),
        sources=SOURCES,
        describe_margin=describe_margin,
        allowed=allowed_range,
        metric=metric,
        ledgers=ledgers(summary),
        jets=jet_drawing(summary),
        own=custom_columns(run.log.described),
        files={"log": LOG, "scenario": SCENARIO},
        folder=run.folder,
        command_path=shlex.quote((run.folder / SCENARIO).as_posix()) if run.folder is not None else "",
    )


def verdict_badge(summary: Summary) -> tuple[str, str]:
    """Return the class and the text of the badge with the verdict; a flight without one shows its outcome."""
    if summary.verdict is None or summary.verdict == Verdict.NOT_COMPLETED:
        expected = {True: ", as expected", False: ", not as expected", None: ""}[summary.expectations_met]
        return summary.outcome, summary.outcome + expected
    return BADGES[summary.verdict], summary.verdict


def verdict(summary: Summary) -> str:
    """Describe the outcome of the flight in a few sentences."""
    duration = f"{summary.duration_s:.2f} s"
    if summary.outcome == "completed":
        sentences = [f"Flew all {duration}{', but beyond its limits' if summary.beyond else ''}."]
        sentences += [f"{text[0].upper()}{text[1:]}." for text in summary.exceeded]
        sentences += [f"Not as expected: {text}." for text in summary.complaints]
    else:
        sentences = [f"{summary.outcome.capitalize()} after {duration} of {summary.planned_s:g} s: {summary.reason}."]
    sentences += axis_sentences(summary)
    if summary.touchdown_m_s is not None:
        sentences.append(f"Touched down at {summary.touchdown_m_s:.2f} m/s.")
    return " ".join(sentences)


def axis_sentences(summary: Summary) -> list[str]:
    """Return a sentence on each commanded axis, or on the largest attitude error where none was commanded."""
    commanded = [_describe_axis(axis, metrics) for axis, metrics in summary.metrics.items() if metrics.commanded]
    return [text for text in commanded or [_describe_worst_error(summary)] if text]


def _describe_axis(axis: str, metrics: AxisMetrics) -> str:
    clauses = []
    if metrics.overshoot_percent is not None:
        clauses.append(f"{metrics.overshoot_percent:.0f} % overshoot")
        settling = metrics.settling_time_s
        clauses.append("not settled" if settling is None else f"settled within {settling:.2f} s")
    if metrics.oscillation_rad is not None and degrees(metrics.oscillation_rad) >= 1.0:
        clauses.append(f"residual oscillation ±{degrees(metrics.oscillation_rad):.1f}°")
    elif metrics.final_error_rad is not None:
        clauses.append(f"{degrees(metrics.final_error_rad):.2g}° off at the end")
    return f"{axis.capitalize()}: {', '.join(clauses)}." if clauses else ""


def _describe_worst_error(summary: Summary) -> str:
    errors = [(metrics.max_abs_error_rad, axis) for axis, metrics in summary.metrics.items()]
    finite = [(error, axis) for error, axis in errors if error is not None]
    if not finite:
        return ""
    error, axis = max(finite)
    return f"Largest attitude error: {degrees(error):.2g}°, in {axis}."


def found_values(summary: Summary) -> dict[str, str]:
    """Return a flight's metrics by label, those of the user last: texts without units."""
    flat = summary.flat_metrics
    texts = {name: show_value(flat.get(name), metric(name).factor, digits) for name, digits in DIGITS.items()}
    for axis, metrics in summary.metrics.items():
        if metrics.settling_time_s is None and metrics.overshoot_percent is not None:
            texts[f"{axis}.settling_time_s"] = "not settled"
    for name, value in summary.own_metrics.items():
        texts[name] = NONE if value is None else f"{metric(name).factor * value:.4g}"
    return {name: text for name, text in texts.items() if text != NONE}


class AxisLedger(NamedTuple):
    """Delay ledger of axes with equal rows; ``total`` in samples, or None if a row has no number."""

    axes: str
    rows: list[DelayRow]
    total: float | None


def ledgers(summary: Summary) -> list[AxisLedger]:
    """Return the delay ledgers, one for all axes with equal rows."""
    axes_of: dict[tuple[DelayRow, ...], list[str]] = {}
    for axis in dict.fromkeys(row.axis for row in summary.delay_ledger):
        rows = tuple([row.model_copy(update={"axis": ""}) for row in summary.delay_ledger if row.axis == axis])
        axes_of.setdefault(rows, []).append(axis)
    axis_ledgers = []
    for rows, axes in axes_of.items():
        samples = [row.samples for row in rows if row.samples is not None]
        total = sum(samples) if len(samples) == len(rows) else None
        axis_ledgers.append(AxisLedger(" and ".join(axes), list(rows), total))
    return axis_ledgers


def jet_drawing(summary: Summary) -> list[dict[str, Any]]:
    """Return the jets seen from above, nose up, in a square of 100 by 100."""
    if not summary.jets_m:
        return []
    reach = max(max(abs(x), abs(y)) for x, y, _ in summary.jets_m) or 1.0
    return [
        {"number": number, "x": 50.0 + 36.0 * y / reach, "y": 52.0 - 36.0 * x / reach}
        for number, (x, y, _) in enumerate(summary.jets_m, start=1)
    ]
