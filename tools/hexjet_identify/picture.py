"""A figure's curves over time as a drawing in SVG: the picture of an engine's README."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import ceil, floor, log10

import numpy as np

from cosim.base.arrays import Array
from cosim.results.report.plot import Figure
from cosim.results.report.three_views import begin_drawing, finish_drawing, line, text

WIDTH, LEFT, RIGHT = 860.0, 64.0, 844.0  # px
# Top and bottom of the figure's first two panels, px.
PANELS = {"y": (40.0, 120.0), "y2": (140.0, 400.0)}
MAX_POINTS = 1500  # a curve, about two a pixel
TICKS_PER_AXIS = 5  # of an axis, about
STYLE = (
    "text { font: 12px system-ui, sans-serif; fill: #222; } .grid { stroke: #ddd; } .frame { fill: #fff; }"
    " polyline { fill: none; stroke-linejoin: round; }"
)


def draw_picture(name: str, figure: Figure) -> str:
    """Return the curves of a figure's first two panels over time as a whole SVG document with this title."""
    curves = [one for one in figure["data"] if one["yaxis"] in PANELS]
    root = begin_drawing(name, WIDTH, PANELS["y2"][1] + 44.0, STYLE)
    ET.SubElement(root, "rect", {"class": "frame", "width": "100%", "height": "100%"})
    times = _finite_range([one["x"] for one in curves])
    for tick in _round_ticks(*times):
        x = _to_pixel(tick, times, (LEFT, RIGHT))
        for top, bottom in PANELS.values():
            line(root, "grid", x, top, x, bottom)
        text(root, x, PANELS["y2"][1] + 16.0, f"{tick:g}", "label", "middle")
    text(
        root,
        0.5 * (LEFT + RIGHT),
        PANELS["y2"][1] + 34.0,
        figure["layout"]["xaxis"]["title"]["text"],
        "label",
        "middle",
    )
    for axis, (top, bottom) in PANELS.items():
        own = [one for one in curves if one["yaxis"] == axis]
        values = _finite_range([one["y"] for one in own])
        for tick in _round_ticks(*values):
            y = _to_pixel(tick, values, (bottom, top))
            line(root, "grid", LEFT, y, RIGHT, y)
            text(root, LEFT - 6.0, y + 4.0, f"{tick:g}", "label", "end")
        text(root, LEFT, top - 6.0, figure["layout"][axis.replace("y", "yaxis")]["title"]["text"], "label")
        for one in own:
            _draw_curve(root, one, times, values, (bottom, top))
    _draw_legend(root, curves)
    return finish_drawing(root)


def _draw_curve(
    root: ET.Element, one: Figure, times: tuple[float, float], values: tuple[float, float], ends: tuple[float, float]
) -> None:
    kept = np.flatnonzero(np.isfinite(one["y"]))
    kept = kept[:: max(1, len(kept) // MAX_POINTS)]
    points = " ".join(
        f"{_to_pixel(x, times, (LEFT, RIGHT)):.1f},{_to_pixel(y, values, ends):.1f}"
        for x, y in zip(one["x"][kept].tolist(), one["y"][kept].tolist(), strict=True)
    )
    ET.SubElement(root, "polyline", {"points": points} | _line_style(one))


def _line_style(one: Figure) -> dict[str, str]:
    """Return how a curve is drawn, as its figure says."""
    width, opacity = 0.7 * one["line"]["width"], one.get("opacity", 1.0)
    return {"stroke": one["line"]["color"], "stroke-width": f"{width:g}", "stroke-opacity": f"{opacity:g}"}


def _draw_legend(root: ET.Element, curves: Sequence[Figure]) -> None:
    """Name each kind of curve once, in a row above the panels."""
    x = LEFT + 180.0
    for name, one in {one["name"]: one for one in reversed(curves)}.items():
        ET.SubElement(root, "polyline", {"points": f"{x:g},14 {x + 24:g},14"} | _line_style(one))
        text(root, x + 30.0, 18.0, name, "label")
        x += 54.0 + 7.0 * len(name)


def _finite_range(values: Sequence[Array]) -> tuple[float, float]:
    """Return the range of all finite values, widened if it is empty."""
    every = np.concatenate(values)
    every = every[np.isfinite(every)]
    low, high = float(every.min()), float(every.max())
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _to_pixel(value: float, values: tuple[float, float], ends: tuple[float, float]) -> float:
    """Return the position [px] of a value between the ends of an axis."""
    return ends[0] + (value - values[0]) / (values[1] - values[0]) * (ends[1] - ends[0])


def _round_ticks(low: float, high: float) -> list[float]:
    """Return round numbers between two limits."""
    power = 10.0 ** floor(log10((high - low) / TICKS_PER_AXIS))
    step = next(size * power for size in (1.0, 2.0, 5.0, 10.0) if size * power * TICKS_PER_AXIS >= high - low)
    return [float(f"{k * step:.12g}") for k in range(ceil(low / step), floor(high / step) + 1)]
