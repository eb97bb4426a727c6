"""What the pages of flights show at first: strips of one flight, and the figures of several laid over each other.

Strips are drawn by ``assets/strips.js`` in the page.  Angles are shown in degrees, everything else in SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.base.protocols import Column
from cosim.base.signals import AXES
from cosim.results.comparison import ComparedFlight, difference, make_time_base
from cosim.results.log.columns import custom_columns
from cosim.results.log.recorder import Log, MemoryLog
from cosim.results.log.tables import TIME
from cosim.results.metrics import AxisMetrics
from cosim.results.report.log_reader import Reader
from cosim.results.report.panels import (
    ATTITUDE,
    DEG,
    DISTURBANCES,
    EFFORT,
    HEIGHT,
    POSITION,
    RATE,
    Panel,
    Trace,
    effort_panels,
    engine_panels,
    make_rest_columns,
    thrust_panels,
    tilt_panels,
)
from cosim.results.report.plot import BLUE, Figure, run_colour
from cosim.results.report.requirements import MarginOverTime, margin_panels
from cosim.results.summary import Summary

# Columns and panels of a flight's difference from the first flight, see subtract_first.
_SUFFIX = "_less"
DIFF_NAMES = (*(f"{axis}_rad{_SUFFIX}" for axis in AXES), f"altitude_m{_SUFFIX}", "apart_m")
DIFF_COLUMNS = (
    *(
        Column(name, name.split("_")[1], "", f"{name.removesuffix(_SUFFIX)} less the first flight's")
        for name in DIFF_NAMES[:-1]
    ),
    Column("apart_m", "m", "", "distance from the first flight, level"),
)
DIFF_PANELS = (
    *(Panel(axis.capitalize(), "deg", [Trace(name, axis)], DEG) for axis, name in zip(AXES, DIFF_NAMES, strict=False)),
    Panel("Altitude", "m", [Trace(DIFF_NAMES[-2], "altitude")]),
    Panel("Apart, level", "m", [Trace(DIFF_NAMES[-1], "apart")]),
)


def run_figures(log: Log, summary: Summary, margins: Sequence[MarginOverTime] = ()) -> dict[str, Figure]:
    """Return the strips of one run that its page shows first, by name: panels and their signals.

    ``shared``: one scale for all panels.  ``equal``: cross-plots with both axes to one scale, east and north.
    """
    reader = Reader(log, summary.step_s)
    first = first_panel(reader, summary.metrics)
    east_north = [Trace("east_m", "east", BLUE), Trace("north_m", "north", BLUE)]
    figures = {
        "first": strips(reader, [first]),
        "attitude": strips(reader, [panel for panel in ATTITUDE if panel != first]),
        "rate": strips(reader, RATE),
        "thrust": strips(reader, thrust_panels(summary)) | {"shared": True},
        "tilt": strips(reader, tilt_panels(log)),
        "effort": strips(reader, effort_panels(log)),
        "height": strips(reader, [panel for panel in HEIGHT if panel != first]),
        "track": strips(reader, [Panel("Track", "m", east_north)]) | {"equal": True},
    }
    answer = first_answer(reader, summary)
    if answer:
        figures["answer"] = answer
    if margins:
        figures["margins"] = strips(reader, margin_panels(margins))
    if any(
        reader.has_values(trace.column) for panel in POSITION for trace in panel.traces if trace.label == "set-point"
    ):
        figures["place"] = strips(reader, POSITION)
    outside = [panel for panel in DISTURBANCES if any(reader.is_moving(trace.column) for trace in panel.traces)]
    if outside:
        figures["outside"] = strips(reader, outside)
    custom = [column for column in custom_columns(log.described) if reader.has_values(column.name)]
    if custom:
        figures["own"] = strips(
            reader, [Panel(column.name, column.unit, [Trace(column.name, column.name)]) for column in custom]
        )
    inside = engine_panels(reader)
    if inside:
        figures["engines"] = strips(reader, inside)
    return figures


def first_panel(reader: Reader, metrics: Mapping[str, AxisMetrics]) -> Panel:
    """Return the panel that a page shows first: that of the commanded axis with the largest error.

    Where no axis is commanded it is the height, if its set-point moves, or else the axis of the largest error.
    """
    ranks = [(each.commanded, each.max_abs_error_rad or 0.0) for each in (metrics[axis] for axis in AXES)]
    height = HEIGHT[0].traces[-1].column
    climbs = reader.has_values(height) and np.nanmin(reader.log[height]) < np.nanmax(reader.log[height])
    return HEIGHT[0] if climbs and not max(ranks)[0] else ATTITUDE[ranks.index(max(ranks))]


def first_answer(reader: Reader, summary: Summary, min_step_rad: float = 0.02) -> Figure | None:
    """Return the strip of the jet or servo that moves most about the first step of an attitude's set-point.

    It shows the time around that step; shaded are the delays on its way that the delay ledger states, one after the
    other.  None without a step of ``min_step_rad`` between two rows.
    """
    log, step_s = reader.log, summary.step_s
    jumps = {axis: np.flatnonzero(np.abs(np.diff(log[f"{axis}_setpoint_rad"])) > min_step_rad) for axis in AXES}
    steps = [(int(rows[0]) + 1, axis) for axis, rows in jumps.items() if rows.size]
    if not steps:
        return None
    (row, axis), rest = min(steps), make_rest_columns(log, summary)
    begin = end = row * step_s
    spans, beyond = [], ("sensors.", "JSBSim")
    for owned in summary.delay_ledger:
        if owned.axis == axis and owned.kind in ("transport", "lag") and not owned.owner.startswith(beyond):
            late = (owned.samples or 0.0) * step_s
            spans += [[end, end + late, f"{1e3 * late:.0f} ms", owned.element.split(",")[0]]] if late else []
            end += late
    around = max(end - begin, 0.05)
    rows = slice(row - 1, row + int(2.5 * around / step_s))

    def measure_movement(panel: Panel) -> float:
        command = panel.traces[0].column
        values = (rest[command]() if command in rest else log[command])[rows]
        return float(np.ptp(values)) * panel.scale / panel.least_span

    panel = max([*thrust_panels(summary), *tilt_panels(log)], key=measure_movement)
    window = {"from": begin - around, "to": begin + 2.5 * around}
    return {"panels": [_strip(panel, [(0, each) for each in panel.traces]) | {"window": window, "spans": spans}]}


def strips(reader: Reader, panels: Sequence[Panel]) -> Figure:
    """Return the data of panels for ``assets/strips.js``; omit traces marked ``only_if_moving`` that never move."""
    return {
        "panels": [
            _strip(
                panel,
                [(0, trace) for trace in panel.traces if not trace.only_if_moving or reader.is_moving(trace.column)],
            )
            for panel in panels
        ]
    }


def _strip(panel: Panel, traces: Sequence[tuple[int, Trace]]) -> dict[str, Any]:
    """Return the data of a panel for strips; each trace is given with the number of its run."""
    return {
        "title": panel.title,
        "unit": panel.unit,
        "least": panel.least_span,
        "signals": [
            {
                "run": run,
                "column": trace.column,
                "label": trace.label,
                "colour": trace.colour,
                "dash": trace.dash,
                "width": trace.width,
                "held": trace.is_staircase,
                "scale": panel.scale,
                "shown": panel.unit,
            }
            for run, trace in traces
        ],
    }


def comparison_figures(flights: Sequence[ComparedFlight], less: Mapping[int, Log]) -> dict[str, Figure]:
    """Return the strips of several flights: attitudes, rates, efforts, heights and tracks, each over the others.

    What each is less the first is among them.  Figures of columns that no log has are left out.

    ``less``: by the number of a flight its :func:`subtract_first`, on the page as runs after the flights, in order.
    """
    readers = [Reader.of(flight) for flight in flights]
    labels = [flight.label for flight in flights]
    with_run = [(reader, flight.run) for reader, flight in zip(readers, flights, strict=True) if flight.run is not None]
    first = first_panel(with_run[0][0], with_run[0][1].metrics) if with_run else ATTITUDE[0]
    attitude, height = ([panel for panel in panels if panel != first] for panels in (ATTITUDE, HEIGHT))
    chosen = {
        "first": ([first], "true"),
        "attitude": (attitude, "true"),
        "rate": (RATE, "measured"),
        "effort": (EFFORT, "asked for"),
    }
    figures: dict[str, list[tuple[Panel, list[tuple[int, Trace]]]]] = {
        name: overlay_panels(readers, labels, panels, which) for name, (panels, which) in chosen.items()
    }
    figures["height"] = overlay_panels(readers, labels, height, "true")
    figures["difference"] = []
    for panel in DIFF_PANELS:
        name = panel.traces[0].column
        apart = [
            (len(flights) + n, Trace(name, labels[number], run_colour(number), width=1.4))
            for n, (number, log) in enumerate(less.items())
            if name in log.columns
        ]
        if apart:
            figures["difference"].append((panel, apart))
    placed = [n for n, flight in enumerate(flights) if {"north_m", "east_m"} <= set(flight.log.columns)]
    track = [(n, Trace(f"{way}_m", f"{labels[n]}, {way}", run_colour(n))) for n in placed for way in ("east", "north")]
    figures["track"] = [(Panel("Track", "m", []), track)] if track else []
    strips_by_name: dict[str, Figure] = {
        name: {"panels": [_strip(panel, traces) for panel, traces in panels]}
        for name, panels in figures.items()
        if panels
    }
    if "track" in strips_by_name:
        strips_by_name["track"]["equal"] = True
    return strips_by_name


def subtract_first(flights: Sequence[ComparedFlight]) -> dict[int, MemoryLog]:
    """Return the difference of each further flight from the first, by the number of the flight.

    They are of true attitude [rad], height [m] and level distance [m], at the times that both flights have; as far as
    both have the columns.
    """
    first, differences = flights[0].log, {}
    level = ("north_m", "east_m")
    sources = [((name.removesuffix(_SUFFIX),), name) for name in DIFF_NAMES[:-1]] + [(level, DIFF_NAMES[-1])]
    for number, flight in enumerate(flights[1:], 1):
        base = make_time_base(first, flight.log)
        common = {*first.columns} & {*flight.log.columns}
        columns = {TIME: base.times}
        for names, name in sources:
            if common.issuperset(names):
                apart = [difference(first, flight.log, one, base) for one in names]
                columns[name] = apart[0] if len(apart) == 1 else np.hypot(*apart)
        if base.times.size > 1 and len(columns) > 1:
            differences[number] = MemoryLog([np.stack(list(columns.values()))], tuple(columns), DIFF_COLUMNS)
    return differences


def overlay_panels(
    readers: Sequence[Reader], labels: Sequence[str], panels: Sequence[Panel], which: str
) -> list[tuple[Panel, list[tuple[int, Trace]]]]:
    """Return panels above each other, each with the trace ``which`` of every run that has it, by run number.

    The set-point is the longest run's where the others ask for the same as long as they last, else each run's own.
    """
    longest = max(range(len(readers)), key=lambda run: len(readers[run].log))
    overlaid = []
    for panel in panels:
        chosen = [trace for trace in panel.traces if trace.label == which]
        traces = [
            (run, trace._replace(label=labels[run], colour=run_colour(run)))
            for run, reader in enumerate(readers)
            for trace in chosen
            if trace.column in reader.log.columns
        ]
        if not traces:
            continue
        for setpoint in (trace for trace in panel.traces if trace.label == "set-point" and which == "true"):
            having = [run for run, reader in enumerate(readers) if reader.has_values(setpoint.column)]
            if having and all(_has_same_setpoint(readers[run], readers[longest], setpoint.column) for run in having):
                traces.append((longest, setpoint))
            else:
                traces += [
                    (run, setpoint._replace(label=f"{labels[run]}, set-point", colour=run_colour(run)))
                    for run in having
                ]
        overlaid.append((panel, traces))
    return overlaid


def _has_same_setpoint(reader: Reader, other: Reader, column: str) -> bool:
    """Return whether a set-point column equals that of a longer log for this log's duration."""
    if reader is other:
        return True
    if column not in other.log.columns or reader.step_s != other.step_s:
        return False
    values = reader.log[column]
    return np.array_equal(values, other.log[column][: values.size], equal_nan=True)
