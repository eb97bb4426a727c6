"""What every figure is made with: colours, layouts, and curves in panels above each other, in Plotly's schema."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Figure = dict[str, Any]

BLUE, ORANGE, MAGENTA, GREEN, RED, GREY = "#2f7de1", "#f08c00", "#c2339b", "#2f9e44", "#e03131", "#868e96"
RUN_COLOURS = (ORANGE, BLUE, GREEN, MAGENTA, RED, "#7048e8", "#1098ad", "#a0522d")
ABOVE = {"xanchor": "left", "yanchor": "bottom"}  # corner of a legend at its position
LEGEND: Figure = {"orientation": "h", "x": 0, "y": 1.0, **ABOVE}  # legend in a row above the panels
HOVER = {"hovermode": "x unified"}  # one box with the values of all curves


def run_colour(number: int) -> str:
    """Return the colour of the n-th of several runs."""
    return RUN_COLOURS[number % len(RUN_COLOURS)]


def layout(height: int, left: int, right: int, top: int, bottom: int, **more: Any) -> Figure:
    """Return the layout of a figure with a height and margins [px]; ``more`` has further keys of Plotly."""
    return {"height": height, "margin": {"l": left, "r": right, "t": top, "b": bottom}, **more}


def closest(height: int, left: int = 64, *, has_legend: bool = True) -> Figure:
    """Return the layout of a figure that describes the point nearest to the pointer."""
    return layout(height, left, 16, 30, 46, hovermode="closest", showlegend=has_legend, legend=LEGEND)


def bars(label: str, names: Sequence[str], lengths: Sequence[float], **more: Any) -> Figure:
    """Return horizontal bars, one for each name."""
    return {"type": "bar", "orientation": "h", "name": label, "y": list(names), "x": list(lengths), **more}


def dotted(colour: str, *, x: float | None = None, y: float | None = None) -> Figure:
    """Return a dotted line across the whole figure: upright at ``x``, or level at ``y``."""
    ends = {"xref": "x", "yref": "paper", "x0": x, "x1": x, "y0": 0, "y1": 1}
    if x is None:
        ends = {"xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": y, "y1": y}
    return {"type": "line", **ends, "line": {"color": colour, "width": 1.4, "dash": "dot"}}


def axis_name(letter: str, number: int) -> str:
    """Return Plotly's name of the n-th axis, counted from 0: x, x2, x3."""
    return letter if number == 0 else f"{letter}{number + 1}"


def share(position: int, count: int, gap: float, *, from_top: bool = True) -> tuple[float, float]:
    """Return begin and end, 0 to 1, of the n-th of several panels, which are ``gap`` apart.

    >>> share(0, 2, gap=0.1)
    (0.55, 1.0)
    """
    size = (1.0 - gap * (count - 1)) / count
    low = (count - 1 - position if from_top else position) * (size + gap)
    return round(low, 6), round(low + size, 6)


def trace(label: str, colour: str, x: ArrayLike, y: ArrayLike, panel: int = 0, **more: Any) -> Figure:
    """Return a line in one of the panels, which share the horizontal axis."""
    line: Figure = {
        "type": "scatter",
        "mode": "lines",
        "name": label,
        "legendgroup": label,
        "showlegend": panel == 0,
        "line": {"color": colour, "width": 1.8},
        "x": np.asarray(x, np.float64),
        "y": np.asarray(y, np.float64),
        "yaxis": axis_name("y", panel),
    }
    return line | more


def beneath(colour: str) -> Figure:
    """Return the style of a line that another one may cover: wide and pale, so that both can be seen."""
    return {"line": {"color": colour, "width": 6.0}, "opacity": 0.45}


def panels(
    height: int, x: str, titles: Sequence[str], log: bool, domains: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Return panels above each other, the first on top; ``log`` of the horizontal axis.

    ``domains``: from which share of the height to which each goes; all alike where there are none.
    """
    figure_layout = layout(
        height, 64, 12, 36, 44,
        legend=LEGEND,
        xaxis={"title": {"text": x}, "anchor": axis_name("y", len(titles) - 1)},
    )  # fmt: skip
    if log:
        figure_layout["xaxis"]["type"] = "log"
    part = 1.0 / len(titles)
    tops = [1.0 - k * part for k in range(len(titles))]
    alike = [(max(0.0, top - part + 0.05), top) for top in tops]
    for k, (title, domain) in enumerate(zip(titles, domains or alike, strict=True)):
        figure_layout[axis_name("yaxis", k)] = {"domain": list(domain), "anchor": "x", "title": {"text": title}}
    return figure_layout
