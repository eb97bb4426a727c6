"""Curves in panels above each other, which share the horizontal axis: figures of Plotly's schema."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Figure = dict[str, Any]

HOVER = {"hovermode": "x unified"}  # of a layout: all curves at the pointer's place, in one box


def trace(label: str, colour: str, x: ArrayLike, y: ArrayLike, panel: int = 0, **more: Any) -> Figure:
    """A line in one of the panels, which share the horizontal axis."""
    drawn: Figure = {
        "type": "scatter",
        "mode": "lines",
        "name": label,
        "legendgroup": label,
        "showlegend": panel == 0,
        "line": {"color": colour, "width": 1.8},
        "x": np.asarray(x, np.float64),
        "y": np.asarray(y, np.float64),
        "yaxis": "y" if panel == 0 else f"y{panel + 1}",
    }
    return drawn | more


def beneath(colour: str) -> Figure:
    """How a line is drawn that another one may cover: wide and pale, so that both are seen."""
    return {"line": {"color": colour, "width": 6.0}, "opacity": 0.45}


def panels(
    height: int, x: str, titles: Sequence[str], log: bool, domains: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Panels above each other, the first on top; ``log`` of the horizontal axis.

    ``domains``: from which share of the height to which each goes; all alike where there are none.
    """
    layout: Figure = {
        "height": height,
        "margin": {"l": 64, "r": 12, "t": 36, "b": 44},
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "xanchor": "left", "yanchor": "bottom"},
        "xaxis": {"title": {"text": x}, "anchor": f"y{len(titles)}" if len(titles) > 1 else "y"},
    }
    if log:
        layout["xaxis"]["type"] = "log"
    share = 1.0 / len(titles)
    tops = [1.0 - k * share for k in range(len(titles))]
    alike = [(max(0.0, top - share + 0.05), top) for top in tops]
    for k, (title, domain) in enumerate(zip(titles, domains or alike, strict=True)):
        layout["yaxis" if k == 0 else f"yaxis{k + 1}"] = {
            "domain": list(domain),
            "anchor": "x",
            "title": {"text": title},
        }
    return layout
