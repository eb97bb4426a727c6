"""Columns over time as figures of Plotly, which notebooks draw: one run, or several laid over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.results.log.columns import require
from cosim.results.report.flight_figures import overlay_panels
from cosim.results.report.log_reader import Reader
from cosim.results.report.page import as_plotly
from cosim.results.report.panels import ATTITUDE, Panel, Trace
from cosim.results.report.plot import ABOVE, Figure, axis_name, layout, run_colour, share
from cosim.results.run import Run

_DASHES = ("solid", "dash", "dot", "dashdot")  # line styles of several runs


def plot(runs: Run | Sequence[Run], *columns: Run | str) -> Any:
    """Plot columns of a run, or of several, over time.

    >>> type(plot(fly("hover", settings={"duration_s": 0.2}))).__name__
    'Figure'

    Parameters
    ----------
    runs : Run or sequence of Run
        Whose logs are drawn over each other.
    *columns : str or Run
        Their names; those of one unit share a panel, in SI units.  The attitude in degrees where none is named.  Runs
        among them are drawn too.

    Returns
    -------
    plotly.graph_objects.Figure
        A notebook shows it; ``write_html(path)`` makes a page of it, ``show()`` opens a browser.

    Raises
    ------
    InputError
        For what is no run, a column that a log has not, or where Plotly is not installed.
    """
    flights = [runs] if isinstance(runs, Run) else list(runs) if isinstance(runs, Sequence) else []
    flights += [each for each in columns if isinstance(each, Run)]
    names = [each for each in columns if isinstance(each, str)]
    if not flights or not all(isinstance(run, Run) for run in flights):
        raise InputError(f"plot: {runs!r:.60}; allowed: a Run, or a sequence of some")
    readers = [Reader(run.log, run.summary.step_s) for run in flights]
    if not names:
        labels = [
            f"{n}: {run.summary.controller_shown}, {run.summary.engine_shown}" for n, run in enumerate(flights, 1)
        ]
        one = len(flights) == 1
        return as_plotly(stack_panels(readers[0], ATTITUDE) if one else overlay(readers, labels, ATTITUDE, "true"))
    units = {column.name: column.unit for run in flights for column in run.log.described}
    for name in names:
        for run in flights:
            require(name, run.log.columns)
    shared = list(dict.fromkeys(units.get(name, "") for name in names))
    panels = [Panel("", unit, []) for unit in shared]
    data = []
    for number, reader in enumerate(readers):
        for n, name in enumerate(names):
            at = shared.index(units.get(name, ""))
            label = name if len(readers) == 1 else f"{number + 1}: {name}"
            trace = Trace(name, label, run_colour(n), _DASHES[number % len(_DASHES)])
            data.append(_trace(reader, panels[at], at, trace))
    return as_plotly({"data": _show_once(data), "layout": _layout_panels(panels, data)})


def stack_panels(reader: Reader, panels: Sequence[Panel]) -> Figure:
    """Return panels above each other over one time axis."""
    data = [
        _trace(reader, panel, number, trace)
        for number, panel in enumerate(panels)
        for trace in panel.traces
        if not trace.only_if_moving or reader.is_moving(trace.column)
    ]
    return {"data": _show_once(data), "layout": _layout_panels(panels, data)}


def overlay(readers: Sequence[Reader], labels: Sequence[str], panels: Sequence[Panel], which: str) -> Figure:
    """Return the panels of :func:`~cosim.results.report.flight_figures.overlay_panels` as a figure of Plotly."""
    figures = overlay_panels(readers, labels, panels, which)
    data = [_trace(readers[run], panel, n, trace) for n, (panel, traces) in enumerate(figures) for run, trace in traces]
    return {"data": _show_once(data), "layout": _layout_panels([panel for panel, _ in figures], data)}


def _trace(reader: Reader, panel: Panel, number: int, trace: Trace) -> Figure:
    values = panel.scale * reader.log[trace.column]
    return {
        "type": "scatter",
        "mode": "lines" if values.size > 1 else "markers",
        "name": trace.label,
        "legendgroup": trace.label,
        "hovertemplate": f"{panel.title}, {trace.label}: %{{y:.4~g}} {panel.unit}<extra></extra>",
        "line": {
            "color": trace.colour,
            "width": trace.width,
            "dash": trace.dash,
            "shape": "hv" if trace.is_staircase else "linear",
        },
        **reader.xy(values),
        "yaxis": axis_name("y", number),
    }


def _show_once(data: list[Figure]) -> list[Figure]:
    """Show each label once in the legend; a click on it works on all panels."""
    seen: set[str] = set()
    for trace in data:
        trace["showlegend"] = trace["name"] not in seen
        seen.add(trace["name"])
    return data


def _layout_panels(panels: Sequence[Panel], data: Sequence[Mapping[str, Any]]) -> Figure:
    figure_layout = _make_layout(len(panels) * 165 + 80)
    for number, panel in enumerate(panels):
        low, high = share(number, len(panels), gap=0.04)
        axis = {"domain": [low, high], "anchor": "x", "title": {"text": f"{panel.title} [{panel.unit}]".lstrip()}}
        values = [trace["y"] for trace in data if trace["yaxis"] == axis_name("y", number)]
        narrow = _value_range(values, panel.least_span)
        if narrow[1] - narrow[0] <= panel.least_span:
            axis["range"] = narrow
        figure_layout[axis_name("yaxis", number)] = axis
    figure_layout["xaxis"] = _time_axis(data) | {"anchor": axis_name("y", len(panels) - 1)}
    return figure_layout


def _make_layout(height: int) -> Figure:
    corner = {"xref": "paper", "yref": "paper", "x": 0, "y": 1}
    return layout(
        height, 64, 12, 40, 44, hovermode="x unified", hoversubplots="axis",
        legend={"orientation": "h", "traceorder": "normal", **corner, **ABOVE},
    )  # fmt: skip


def _time_axis(data: Sequence[Mapping[str, Any]]) -> Figure:
    ends = [(t["x"][-1] if "x" in t else t["x0"] + t["dx"] * (len(t["y"]) - 1)) for t in data if len(t["y"])]
    return {
        "title": {"text": "time [s]"},
        "hoverformat": ".3f",
        "range": [0.0, max([float(end) for end in ends] + [1e-3])],
    }


def _value_range(values: Sequence[Array], min_span: float) -> list[float]:
    """Return the range from least to greatest with a margin, widened to ``min_span`` around the middle."""
    finite = np.concatenate([np.empty(0), *(part[np.isfinite(part)] for part in values)])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    margin = max(0.06 * (high - low), 0.5 * (min_span - (high - low)))
    return [low - margin, high + margin]
