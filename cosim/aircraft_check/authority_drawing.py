"""The moments that a vehicle makes while it holds its weight, as a drawing in SVG: sections of the attainable set.

Drawn is what is attained; where hinges leave more open than a line is wide, what nothing exceeds is drawn around it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from math import cos, inf, isfinite, pi, sin

from cosim.base.signals import AXES
from cosim.control.allocation.authority import Reach
from cosim.results.report.three_views import begin_drawing, finish_drawing, line, text
from cosim.spec.vehicle import Vehicle

VIEW, MARGIN, TITLE = 300.0, 58.0, 44.0  # px: plot, its margin, its title
Corners = list[tuple[float, float]]
SECTION_AXES = ((0, 1), (0, 2), (1, 2))  # moments drawn to the right and up
STYLE = (  # CSS of the drawing
    "text { font: 11px system-ui, sans-serif; fill: #222; } .name { font-weight: 600; } .dim { fill: #666; }"
    " .frame { fill: #fff; } .axis { stroke: #999; stroke-width: 0.8; } .whole { fill: #1f4e79; fill-opacity: 0.12;"
    " stroke: #1f4e79; stroke-width: 1.6; } .lost { fill: none; stroke: #c0392b; stroke-width: 0.9; }"
    " .most { fill: none; stroke: #1f4e79; stroke-width: 0.9; stroke-dasharray: 4 3; }"
)


def draw_attainable_moments(vehicle: Vehicle, reach: Reach) -> str:
    """Draw the moments attainable with all engines, and those without each engine as a line in roll and pitch.

    A section holds the weight and keeps the third moment at zero.  It is a whole SVG document; ``reach`` is what the
    layout can do, all engines well.
    """
    title = f"{vehicle.name}: attainable moments in hover"
    root = begin_drawing(title, VIEW * len(SECTION_AXES), VIEW + 2 * TITLE, STYLE)
    ET.SubElement(root, "rect", {"class": "frame", "width": "100%", "height": "100%"})
    text(root, 12, 22, f"{vehicle.title}: moments in hover, N m", "name")
    caption = "filled: all engines; red: without each one, named by its number; the third moment is 0"
    if not reach.is_bounded:
        caption += "; found by search: there may be more"
    text(root, 12, 38, caption, "dim")
    for number, (right, up) in enumerate(SECTION_AXES):
        whole, bound = _section(reach, right, up)
        without: dict[str, Corners] = {}
        if not number:
            for jet in range(1, len(vehicle.jets) + 1):
                section, _ = _section(reach.without([jet]), right, up, 12)
                if section:
                    without[str(jet)] = section
        _draw_section(root, number * VIEW, (right, up), whole, bound, without)
    return finish_drawing(root)


def _section(
    reach: Reach, right: int, up: int, directions: int = 24, bound_gap: float = 0.02
) -> tuple[Corners, Corners]:
    """Return the corners of the attained moments [N m], and of their upper bound if its gap exceeds ``bound_gap``.

    Both are empty where the weight is not held or a size is not finite.  ``bound_gap``: of a moment, by which its bound
    is above it where that is drawn; a line is as wide.
    """
    angles = [2.0 * pi * n / directions for n in range(directions)]
    lines = []
    for angle in angles:
        direction = [0.0, 0.0, 0.0]
        direction[right], direction[up] = cos(angle), sin(angle)
        lines.append(direction)
    sizes = reach.section(lines)

    def to_corners(ends: list[float]) -> Corners:
        if not all(map(isfinite, ends)):
            return []
        return [(size * cos(angle), size * sin(angle)) for size, angle in zip(ends, angles, strict=True)]

    far = any(size.upper - size.lower > bound_gap * abs(size.upper) for size in sizes)
    return to_corners([size.lower for size in sizes]), to_corners([size.upper for size in sizes]) if far else []


def _draw_section(
    root: ET.Element, left_px: float, axes: tuple[int, int], whole: Corners, bound: Corners, without: dict[str, Corners]
) -> None:
    corners = [*whole, *bound, *(corner for section in without.values() for corner in section)]
    wide = _find_scale(abs(x) for x, _ in corners)
    high = _find_scale(abs(y) for _, y in corners)
    middle_x, middle_y, half = left_px + VIEW / 2.0, TITLE + VIEW / 2.0, VIEW / 2.0 - MARGIN

    def to_pixels(corner: tuple[float, float]) -> tuple[float, float]:
        return middle_x + half * corner[0] / wide, middle_y - half * corner[1] / high

    for (x, y), (u, v) in (((-wide, 0.0), (wide, 0.0)), ((0.0, -high), (0.0, high))):
        line(root, "axis", *to_pixels((x, y)), *to_pixels((u, v)))
    if not whole:
        text(root, middle_x, middle_y - 8, "the weight is not held in balance", "dim", "middle")
    for kind, section in (("whole", whole), ("most", bound), *(("lost", corners) for corners in without.values())):
        if section:
            points = " ".join(f"{x:.2f},{y:.2f}" for x, y in map(to_pixels, section))
            ET.SubElement(root, "polygon", {"class": kind, "points": points})
    for number, (name, section) in enumerate(without.items()):  # draw each pair of axes in its own corner
        x, y = to_pixels(section[number % len(section)])
        text(root, x + 3, y - 3, name, "dim")
    text(root, left_px + VIEW - 8, middle_y + 14, f"{AXES[axes[0]]} {wide:.3g}", "dim", "end")
    text(root, middle_x + 4, TITLE + MARGIN - 8, f"{AXES[axes[1]]} {high:.3g}", "dim")
    text(root, left_px + 12, TITLE + VIEW + 12, f"{AXES[axes[0]]} and {AXES[axes[1]]}", "dim")


def _find_scale(values: Iterable[float]) -> float:
    """Return the largest magnitude as an axis's scale, at least a small number."""
    size = max(values, default=-inf)
    return size if size > 1e-9 else 1.0
