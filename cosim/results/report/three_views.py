"""A vehicle from above, from the right and from the front, as a drawing in SVG: drawn from its ``vehicle.toml``."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import hypot

from cosim.base.signals import Vector3
from cosim.spec.vehicle import Vehicle

VIEW, MARGIN, TITLE = 300.0, 34.0, 44.0  # sizes of a view, px
# Body axes that point to the right and downwards in each view, with their signs.
VIEWS = (
    ("from above", (1, 1.0), (0, -1.0)),
    ("from the right", (0, 1.0), (2, 1.0)),
    ("from the front", (1, -1.0), (2, 1.0)),
)
STYLE = (
    "text { font: 11px system-ui, sans-serif; fill: #222; } .name { font-weight: 600; } .dim { fill: #666; }"
    " .leg { stroke: #888; stroke-width: 2; fill: none; } .hull { fill: #888; } .jet { fill: #fff; stroke: #1f4e79;"
    " stroke-width: 1.6; } .thrust { stroke: #c0392b; stroke-width: 1.6; marker-end: url(#tip); }"
    " .reach { stroke: #c0392b; stroke-width: 0.8; stroke-dasharray: 3 3; } .body { fill: #1f4e79; fill-opacity: 0.08;"
    " stroke: #1f4e79; stroke-opacity: 0.4; }"
    " .panel { fill: #1f4e79; fill-opacity: 0.18; stroke: #1f4e79; stroke-width: 0.8; }"
    " .cg { stroke: #000; stroke-width: 1.2; } .frame { fill: #fff; }"
)


def three_views(vehicle: Vehicle) -> str:
    """Draw jets with their numbers, thrust and reach of tilts, panels, legs, hull, centre of gravity, and a scale.

    It is a whole SVG document; places are in m, body.
    """
    reach = max(max(map(abs, point)) for point in points_of(vehicle)) or 1.0
    scale = (VIEW / 2.0 - MARGIN) / reach
    root = begin_drawing(f"{vehicle.name}: three views", VIEW * len(VIEWS), VIEW + 2 * TITLE, STYLE)
    tip = ET.SubElement(
        ET.SubElement(root, "defs"), "marker", id="tip", viewBox="0 0 6 6", refX="5", refY="3", markerWidth="6",
        markerHeight="6", orient="auto",
    )  # fmt: skip
    ET.SubElement(tip, "path", d="M0,0 L6,3 L0,6 z", fill="#c0392b")
    ET.SubElement(root, "rect", {"class": "frame", "width": "100%", "height": "100%"})
    text(root, 12, 22, vehicle.title, "name")
    text(
        root,
        12,
        38,
        f"{vehicle.mass_kg:g} kg; {len(vehicle.jets)} jets, with their numbers; seen from above, forward is up",
        "dim",
    )
    for number, (name, right, down) in enumerate(VIEWS):
        view = _Projection(root, number * VIEW + VIEW / 2.0, TITLE + VIEW / 2.0, scale, right, down)
        text(root, number * VIEW + 12, TITLE + VIEW + 12, name, "dim")
        _draw_view(view, vehicle, reach)
    _draw_ruler(root, scale, reach)
    return finish_drawing(root)


class _Projection:
    """Projection of points of the body frame onto the drawing."""

    def __init__(
        self, root: ET.Element, x: float, y: float, scale: float, right: tuple[int, float], down: tuple[int, float]
    ) -> None:
        self.root, self._x, self._y, self._scale = root, x, y, scale
        self._right, self._down = right, down

    def at(self, point: Sequence[float]) -> tuple[float, float]:
        """Return where a point [m, body] is drawn, px."""
        (right, to_right), (down, downwards) = self._right, self._down
        return (
            round(self._x + self._scale * to_right * point[right], 2),
            round(self._y + self._scale * downwards * point[down], 2),
        )

    def line(self, kind: str, start: Sequence[float], end: Sequence[float]) -> None:
        """Draw a line between two points [m, body]."""
        line(self.root, kind, *self.at(start), *self.at(end))

    def circle(self, kind: str, point: Sequence[float], radius: float) -> None:
        """Draw a circle around a point [m, body], its radius in px."""
        x, y = self.at(point)
        ET.SubElement(self.root, "circle", {"class": kind, "cx": f"{x:g}", "cy": f"{y:g}", "r": f"{radius:g}"})

    def polygon(self, kind: str, corners: Sequence[tuple[float, float]]) -> None:
        points = " ".join(f"{x:g},{y:g}" for x, y in corners)
        ET.SubElement(self.root, "polygon", {"class": kind, "points": points})


def points_of(vehicle: Vehicle) -> list[Vector3]:
    """Return the positions of jets, contacts and panels [m, body]."""
    return [*_outline_points(vehicle), *(corner for panel in vehicle.panels for corner in panel.corners_m)]


def _outline_points(vehicle: Vehicle) -> list[Vector3]:
    return [*(jet.position_m for jet in vehicle.jets), *(contact.position_m for contact in vehicle.contacts)]


def _draw_view(view: _Projection, vehicle: Vehicle, reach: float) -> None:
    view.polygon("body", _convex_hull([view.at(point) for point in _outline_points(vehicle)]))
    for panel in vehicle.panels:
        view.polygon("panel", [view.at(corner) for corner in panel.corners_m])
    for contact in vehicle.contacts:
        x, y, z = contact.position_m
        if contact.kind == "leg":
            view.line("leg", (x, y, min(0.0, z)), contact.position_m)
        view.circle("hull", contact.position_m, 2.5 if contact.kind == "leg" else 1.5)
    # A jet in front hides the one behind it, so the names of both are written in one place.
    named: dict[tuple[float, float], list[str]] = {}
    layout, rest = vehicle.layout(), list(vehicle.rest)
    for jet in range(len(vehicle.jets)):
        ways = [("thrust", rest)]
        for number, _ in layout.chains[jet]:
            ways += [("reach", [*rest[:number], end, *rest[number + 1 :]]) for end in vehicle.turns[number]]
        for kind, angles in ways:
            start, axis = layout.positions(angles)[jet], layout.axes(angles)[layout.groups[jet]]
            end = _move_along(start, axis, 0.45 * reach)
            (a, b), (c, d) = view.at(start), view.at(end)
            if hypot(c - a, d - b) > 3.0:
                view.line(kind, start, end)
        point = layout.positions(rest)[jet]
        view.circle("jet", point, 9.0)
        named.setdefault(view.at(point), []).append(str(jet + 1))
    for (x, y), numbers in named.items():
        text(view.root, x, y + (4 if len(numbers) == 1 else 22), ", ".join(numbers), "name", "middle")
    x, y = view.at((0.0, 0.0, 0.0))
    for dx, dy in ((5, 0), (0, 5)):
        line(view.root, "cg", x - dx, y - dy, x + dx, y + dy)


def _move_along(start: Vector3, axis: Vector3, length: float) -> Vector3:
    x, y, z = (p + length * a for p, a in zip(start, axis, strict=True))
    return (x, y, z)


def _convex_hull(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the convex polygon around points, by Andrew's monotone chain."""
    ordered = sorted(set(points))

    def half_chain(part: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for x, y in part:
            while len(chain) > 1 and (chain[-1][0] - chain[-2][0]) * (y - chain[-2][1]) <= (
                chain[-1][1] - chain[-2][1]
            ) * (x - chain[-2][0]):
                chain.pop()
            chain.append((x, y))
        return chain[:-1]

    return half_chain(ordered) + half_chain(ordered[::-1]) if len(ordered) > 2 else ordered


def _draw_ruler(root: ET.Element, scale: float, reach: float) -> None:
    """Draw a scale bar of a round length [m]."""
    length = max(step for step in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if step <= max(reach, 0.01))
    y = TITLE + VIEW + TITLE - 14
    ET.SubElement(
        root, "line", {"class": "cg", "x1": "12", "y1": f"{y:g}", "x2": f"{12 + length * scale:.2f}", "y2": f"{y:g}"}
    )
    text(root, 18 + length * scale, y + 4, f"{length:g} m", "dim")


def begin_drawing(name: str, width: float, height: float, style: str) -> ET.Element:
    """Return the root of a drawing [px] with its title and its style sheet."""
    root = ET.Element("svg", xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {width:g} {height:g}", role="img")
    ET.SubElement(root, "title").text = name
    ET.SubElement(root, "style").text = style
    return root


def line(root: ET.Element, kind: str, x1: float, y1: float, x2: float, y2: float) -> None:
    """Add a line between two positions [px], of a class of the style sheet."""
    ends = {"x1": x1, "y1": y1, "x2": x2, "y2": y2}
    ET.SubElement(root, "line", {"class": kind} | {name: f"{value:g}" for name, value in ends.items()})


def text(root: ET.Element, x: float, y: float, words: str, kind: str, anchor: str = "start") -> None:
    """Add a text at a position [px], of a class of the style sheet."""
    ET.SubElement(root, "text", {"class": kind, "x": f"{x:g}", "y": f"{y:g}", "text-anchor": anchor}).text = words


def finish_drawing(root: ET.Element) -> str:
    """Return the document as text."""
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
