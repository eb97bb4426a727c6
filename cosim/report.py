"""A finished run as one HTML page that opens offline, and several runs laid over each other.

The only module that touches ``plotly``, and only its JavaScript: figures are plain dicts of Plotly's schema, because
building them here costs less than importing its Python classes.  Angles are shown in degrees, everything else in SI.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import ceil, degrees, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.columns import RATES
from cosim.metrics import flatten
from cosim.recorder import Log, one_line, replacing
from cosim.errors import FlightError
from cosim.run import SCENARIO, Run, Summary
from cosim.signals import AXES, JETS

Array = NDArray[np.float64]
Figure = dict[str, Any]

MOST_POINTS = 4000  # per trace; more cannot be seen and makes the page slow
DEG = 180.0 / pi

BLUE, ORANGE, MAGENTA, GREEN, RED, GREY = "#2f7de1", "#f08c00", "#c2339b", "#2f9e44", "#e03131", "#868e96"
RUN_COLOURS = (ORANGE, BLUE, GREEN, MAGENTA, RED, "#7048e8", "#1098ad", "#a0522d")
JET_LAYOUT = ((3, 1), (6, 5), (2, 4))  # front to back, left and right, where the run does not say where its jets are


class Trace(NamedTuple):
    """One column drawn in a panel."""

    column: str
    label: str
    colour: str
    dash: str = "solid"
    width: float = 1.6
    held: bool = False  # drawn as steps: commands are held over a control step


class Panel(NamedTuple):
    """One pair of axes; values are multiplied by ``scale`` to come to ``unit``."""

    title: str
    unit: str
    traces: Sequence[Trace]
    scale: float = 1.0
    least_span: float = 0.0  # so that noise around a constant does not fill the panel


def _tracking(name: str, columns: Mapping[str, str]) -> list[Trace]:
    """Set-point, measured, predicted and true in the order in which they are drawn."""
    looks = {
        "true": (BLUE, "solid", 1.8, False),
        "measured": (ORANGE, "solid", 1.2, False),
        "predicted": (MAGENTA, "solid", 1.4, False),
        "set-point": (GREY, "dash", 1.5, True),
    }
    return [Trace(columns[label].format(name), label, *looks[label]) for label in columns]


ATTITUDE = [
    Panel(
        axis.capitalize(),
        "deg",
        _tracking(axis, {"measured": "{}_measured_rad", "true": "{}_rad", "set-point": "{}_setpoint_rad"}),
        DEG,
        least_span=2.0,
    )
    for axis in AXES
]
RATE = [
    Panel(
        f"{axis.capitalize()} rate {rate}",
        "deg/s",
        _tracking(
            rate,
            {
                "measured": "rate_{}_measured_rad_s",
                "predicted": "rate_{}_predicted_rad_s",
                "set-point": "rate_{}_setpoint_rad_s",
            },
        ),
        DEG,
        least_span=5.0,
    )
    for axis, rate in zip(AXES, RATES, strict=True)
]
TILT = [
    Panel(
        f"{side.capitalize()} servo",
        "deg",
        [
            Trace(f"tilt_{side}_rad", "actual", BLUE, width=1.8),
            Trace(f"tilt_{side}_command_rad", "commanded", GREY, "dash", 1.5, held=True),
        ],
        DEG,
        least_span=2.0,
    )
    for side in ("left", "right")
]
EFFORT = [
    Panel(
        "Collective",
        "throttle",
        [
            Trace("collective", "asked for", BLUE, held=True),
            Trace("refused_collective", "refused", RED, held=True),
        ],
        least_span=0.1,
    ),
    Panel(
        "Roll effort",
        "throttle",
        [
            Trace("torque_roll", "asked for", BLUE, held=True),
            Trace("refused_roll", "refused", RED, held=True),
            Trace("disturbance_torque_roll", "disturbance", MAGENTA, "dot", held=True),
        ],
        least_span=0.02,
    ),
    *[
        Panel(
            f"{axis.capitalize()} effort",
            "deg of tilt",
            [
                Trace(f"torque_{axis}", "asked for", BLUE, held=True),
                Trace(f"refused_{axis}", "refused", RED, held=True),
                Trace(f"disturbance_torque_{axis}", "disturbance", MAGENTA, "dot", held=True),
            ],
            DEG,
            least_span=1.0,
        )
        for axis in ("pitch", "yaw")
    ],
]
HEIGHT = [
    Panel(
        "Altitude",
        "m",
        [
            Trace("altitude_measured_m", "measured", ORANGE, width=1.2),
            Trace("altitude_m", "true", BLUE, width=1.8),
            Trace("altitude_setpoint_m", "set-point", GREY, "dash", 1.5, held=True),
        ],
        least_span=1.0,
    ),
    Panel(
        "Climb rate",
        "m/s",
        [Trace("velocity_down_m_s", "true", BLUE, width=1.8)],
        scale=-1.0,
        least_span=0.5,
    ),
]


def _vector(pattern: str, names: Sequence[str]) -> list[Trace]:
    return [Trace(pattern.format(name), name, colour) for name, colour in zip(names, (BLUE, ORANGE, GREEN), strict=True)]


OUTSIDE = [  # left out where nothing happens
    Panel("Force", "N", _vector("disturbance_force_{}_N", ("x", "y", "z"))),
    Panel("Moment", "N m", _vector("disturbance_moment_{}_N_m", ("x", "y", "z"))),
    Panel("Wind", "m/s", _vector("wind_{}_m_s", ("north", "east", "down"))),
    Panel("Payload", "kg", [Trace("payload_kg", "payload", BLUE, held=True)]),
]


def write_report(run: Run, path: Path) -> None:
    """Write the page of one run.  Raises FlightError if the file cannot be written."""
    summary = run.summary
    _render(
        "report.html",
        path,
        summary=summary,
        verdict=verdict(summary),
        axes=[(axis, metrics) for axis, metrics in summary.metrics.items()],
        expectations=expectation_rows(summary),
        total_samples=total_samples(summary),
        jets=jet_drawing(summary),
        again=f"hexjet fly {run.folder / SCENARIO}" if run.folder is not None else "",
        figures=run_figures(run.log, summary),
    )


def compare_report(runs: Sequence[Run], path: Path) -> None:
    """Write one page with several runs laid over each other.  Raises FlightError if the file cannot be written."""
    labels = run_labels([run.summary for run in runs])
    _render(
        "compare.html",
        path,
        runs=[
            {
                "label": label,
                "colour": _run_colour(index),
                "summary": run.summary,
                "verdict": verdict(run.summary),
                "link": _link(run, path),
            }
            for index, (label, run) in enumerate(zip(labels, runs, strict=True))
        ],
        rows=comparison_rows([run.summary for run in runs]),
        figures=comparison_figures(runs, labels),
    )


# ---- figures


def run_figures(log: Log, summary: Summary) -> dict[str, Figure]:
    """The figures of one run, by the name of their place on the page."""
    reader = Reader(log, summary.step_s)
    disturbed = [panel for panel in OUTSIDE if any(reader.moves(trace.column) for trace in panel.traces)]
    figures = {
        "attitude": stacked(reader, ATTITUDE),
        "rate": stacked(reader, RATE),
        "thrust": thrust_figure(reader, summary),
        "tilt": stacked(reader, TILT),
        "height": stacked(reader, HEIGHT),
        "track": track_figure([(reader, "track", BLUE)]),
        "effort": stacked(reader, EFFORT),
    }
    if disturbed:
        figures["outside"] = stacked(reader, disturbed, each_legend=True)
    return figures


def comparison_figures(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Figure]:
    """The runs' attitudes, rates, efforts and tracks, each over the others."""
    readers = [Reader(run.log, run.summary.step_s) for run in runs]
    figures = {}
    for name, panels in (("attitude", ATTITUDE), ("rate", RATE), ("effort", EFFORT), ("height", HEIGHT)):
        chosen = {"attitude": "true", "rate": "measured", "effort": "asked for", "height": "true"}[name]
        figures[name] = stacked_runs(readers, labels, panels, chosen)
    figures["track"] = track_figure(
        [(reader, label, _run_colour(i)) for i, (reader, label) in enumerate(zip(readers, labels, strict=True))]
    )
    return figures


class Reader:
    """Columns of a log, thinned out for drawing."""

    def __init__(self, log: Log, step_s: float) -> None:
        self._log = log
        self._step = step_s

    def trace(self, column: str, scale: float = 1.0) -> Figure:
        """The x and y of a Plotly trace."""
        return self.of_values(scale * self._log[column])

    def of_values(self, values: Array) -> Figure:
        """The same for values that were worked out from columns, one a row."""
        rows = thinned(values)
        if rows is None:
            return {"x0": 0.0, "dx": self._step, "y": values.astype(np.float32)}
        return {"x": rows * self._step, "y": values[rows].astype(np.float32)}

    def column(self, name: str) -> Array:
        return self._log[name]

    def moves(self, column: str) -> bool:
        """Whether a column is ever anything but 0."""
        return bool(np.any(np.abs(self._log[column]) > 1e-9))

    def __len__(self) -> int:
        return len(self._log)


def thinned(values: Array, most: int = MOST_POINTS) -> NDArray[np.intp] | None:
    """The rows to draw: first, last, and the least and greatest of each of equal stretches; None for all rows.

    A gap (NaN) that fills a stretch is kept.
    """
    if values.size <= most:
        return None
    length = ceil((values.size - 2) / (most // 2 - 1))
    inner = values[1:-1]
    padded = np.full(ceil(inner.size / length) * length, np.nan)
    padded[: inner.size] = inner
    stretches = padded.reshape(-1, length)
    known = np.isfinite(stretches)
    starts = 1 + length * np.arange(len(stretches))
    low = starts + np.argmin(np.where(known, stretches, np.inf), axis=1)
    high = starts + np.argmax(np.where(known, stretches, -np.inf), axis=1)
    return np.unique(np.concatenate(([0], low, high, [values.size - 1])))


def stacked(reader: Reader, panels: Sequence[Panel], each_legend: bool = False) -> Figure:
    """Panels above each other over one time axis; the legend names each label once, or panel by panel."""
    data: list[Figure] = []
    named: set[str] = set()
    for index, panel in enumerate(panels):
        for trace in panel.traces:
            if not each_legend and trace.label in ("refused", "disturbance") and not reader.moves(trace.column):
                continue
            label = f"{panel.title} {trace.label}" if each_legend and len(panel.traces) > 1 else trace.label
            line = _line(reader.trace(trace.column, panel.scale), label, index, trace)
            line["showlegend"] = label not in named
            named.add(label)
            data.append(line)
    return {"data": data, "layout": _stacked_layout(panels, data)}


def stacked_runs(readers: Sequence[Reader], labels: Sequence[str], panels: Sequence[Panel], chosen: str) -> Figure:
    """Panels above each other, in each the chosen trace of every run and the set-point of the first."""
    data: list[Figure] = []
    for index, panel in enumerate(panels):
        trace = next(trace for trace in panel.traces if trace.label == chosen)
        for number, (reader, label) in enumerate(zip(readers, labels, strict=True)):
            look = trace._replace(colour=_run_colour(number), width=1.8)
            data.append(_line(reader.trace(trace.column, panel.scale), label, index, look) | {"showlegend": index == 0})
        asked = next((trace for trace in panel.traces if trace.label == "set-point"), None)
        if asked is not None and chosen == "true":
            line = _line(readers[0].trace(asked.column, panel.scale), "set-point", index, asked)
            data.append(line | {"showlegend": index == 0})
    return {"data": data, "layout": _stacked_layout(panels, data)}


def thrust_figure(reader: Reader, summary: Summary) -> Figure:
    """Six panels where the jets sit: what each was told, at rest, and what it delivered."""
    curve = np.array(summary.engine_curve, dtype=float).reshape(-1, 2)
    data: list[Figure] = []
    layout = _base_layout(3 * 165 + 90)
    top = 1.0
    rows = jet_rows(summary)
    for row, pair in enumerate(rows):
        for side, jet in enumerate(pair):
            number = 2 * row + side + 1
            axes = {"xaxis": _axis("x", 1 + side), "yaxis": _axis("y", number)}
            delivered = reader.column(f"thrust_{jet}_N")
            lines = [(reader.of_values(delivered), Trace("", "delivered", BLUE, width=1.8))]
            if len(curve):
                told = np.interp(reader.column(f"throttle_{jet}"), curve[:, 0], curve[:, 1])
                lines.append((reader.of_values(told), Trace("", "commanded", GREY, "dash", 1.5, held=True)))
                top = max(top, float(np.max(told, initial=0.0)))
            top = max(top, float(np.max(delivered[np.isfinite(delivered)], initial=0.0)))
            for values, look in lines:
                data.append(_line(values, look.label, 0, look) | axes | {"showlegend": number == 1})
            layout |= _thrust_axes(number, jet, row, side, len(rows))
    for number in range(1, JETS + 1):
        layout[_axis("yaxis", number)] |= {"range": [0.0, 1.08 * top]}
    layout |= {
        "xaxis": _time_axis() | {"domain": [0.0, 0.48], "anchor": _axis("y", JETS - 1)},
        "xaxis2": _time_axis() | {"domain": [0.52, 1.0], "anchor": _axis("y", JETS), "matches": "x"},
    }
    return {"data": data, "layout": layout}


def _thrust_axes(number: int, jet: int, row: int, side: int, rows: int) -> Figure:
    low, high = _domain(row, rows, gap=0.09)
    key = _axis("yaxis", number)
    axis = {"domain": [low, high], "anchor": _axis("x", 1 + side), "matches": "y" if number > 1 else None}
    title = {"title": {"text": "thrust [N]"}} if side == 0 else {"showticklabels": False}
    return {key: {k: v for k, v in (axis | title).items() if v is not None}, f"_{key}": _note(f"Jet {jet}", side, high)}


def track_figure(tracks: Sequence[tuple[Reader, str, str]]) -> Figure:
    """Seen from above, with equal scales: where each vehicle went, from its start (open) to its end (filled)."""
    data: list[Figure] = []
    spans = []
    for reader, label, colour in tracks:
        east, north = reader.column("east_m"), reader.column("north_m")
        every = max(1, ceil(len(reader) / MOST_POINTS))
        rows = np.unique(np.append(np.arange(0, len(reader), every), max(0, len(reader) - 1)))[: len(reader)]
        line = {"x": east[rows].astype(np.float32), "y": north[rows].astype(np.float32)}
        hover = "%{y:.2f} m north, %{x:.2f} m east<extra></extra>"
        data.append(
            {"type": "scatter", "mode": "lines", "name": label, "line": {"color": colour, "width": 2}} | line
            | {"hovertemplate": hover, "showlegend": len(tracks) > 1}
        )
        if len(reader):
            ends = {"x": line["x"][[0, -1]], "y": line["y"][[0, -1]]}
            marker = {"symbol": ["circle-open", "circle"], "size": 9, "color": colour, "line": {"width": 2, "color": colour}}
            data.append(
                {"type": "scatter", "mode": "markers", "name": "start, end", "marker": marker, "showlegend": False}
                | {"hovertemplate": hover} | ends
            )
            spans.append((np.nanmin(line["x"]), np.nanmax(line["x"]), np.nanmin(line["y"]), np.nanmax(line["y"])))
    layout = _base_layout(460) | {"hovermode": "closest"}
    layout["xaxis"] = {"title": {"text": "east [m]"}, "range": _padded([s[:2] for s in spans], 2.0)}
    layout["yaxis"] = {
        "title": {"text": "north [m]"}, "range": _padded([s[2:] for s in spans], 2.0), "scaleanchor": "x", "scaleratio": 1
    }
    return {"data": data, "layout": layout}
