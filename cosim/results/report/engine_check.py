"""The page of a checked engine: thrust at rest over throttle, and thrust after the throttle was moved."""

from __future__ import annotations

import json
from pathlib import Path

from cosim.base.storage.files import write_files
from cosim.engine.check_report import CheckReport
from cosim.engine.response import REST_TOLERANCE
from cosim.results.report.cards import Card, Page, marked
from cosim.results.report.plot import BLUE, HOVER, ORANGE, Figure, panels, trace
from cosim.results.run import REPORT

MOVES = (("up", "opened, 0 to 1", ORANGE), ("down", "closed, 1 to 0", BLUE))


def write_check(report: CheckReport, folder: Path) -> Path:
    """Write ``check.json`` and the page of a checked engine, and return the page's path.

    Raises FlightError if a file cannot be written.
    """
    path, data = folder / REPORT, folder / "check.json"
    write_files({data: json.dumps(report.to_dict(), indent=2, allow_nan=False) + "\n"})
    make_page(report).write(path)
    return path


def make_page(report: CheckReport) -> Page:
    figures = check_figures(report)
    still = f"Each point held until the thrust stands still to {REST_TOLERANCE:.0e} of itself."
    marks = {"yes": "met", "no": "unmet"}
    both, found = len(figures) == 2, [(label, marked(text, marks.get(text, ""))) for label, text in report.lines()]
    cards = [
        Card("Thrust at rest", text=still, figure="curve", is_half=both) if "curve" in figures else None,
        Card("Throttle opened and closed", text="Dotted: where a delay ends.", figure="response", is_half=both)
        if "response" in figures
        else None,
        Card("What was found", ("finding", "what it is"), found),
    ]
    return Page(
        "engine check",
        report.name,
        cards,
        figures,
        verdict="fit to fly" if report.ok else "not fit to fly",
        badge="met" if report.ok else "unmet",
        problems=report.problems,
        summary=[
            f"{report.path}: FMI {report.fmi_version}, tried at steps of {1e3 * report.step:g} ms.",
            *report.notes,
        ],
        source=f"sha256 {report.sha256}",
    )


def check_figures(report: CheckReport) -> dict[str, Figure]:
    """Return the figures of a checked engine: thrust over throttle, and thrust over time."""
    figures = {}
    if report.throttle is not None and report.thrust is not None:
        figures["curve"] = {
            "data": [_make_trace("thrust at rest", ORANGE, report.throttle, report.thrust, "lines+markers")],
            "layout": _make_layout("throttle", ".2f"),
        }
    courses = [
        (label, colour, getattr(report, f"course_{way}"), getattr(report, f"course_step_{way}"))
        for way, label, colour in MOVES
    ]
    complete = [(label, colour, course, step) for label, colour, course, step in courses if course and step]
    if complete:
        layout = _make_layout("time since the throttle was moved [s]", ".3f")
        layout["shapes"] = [_delay_line(report, way, colour) for way, _, colour in MOVES if _delay_s(report, way)]
        figures["response"] = {
            "data": [
                _make_trace(label, colour, [k * step for k in range(len(course))], course, "lines")
                for label, colour, course, step in complete
            ],
            "layout": layout,
        }
    return figures


def _delay_s(report: CheckReport, way: str) -> float:
    return float(getattr(report, f"delay_samples_{way}") or 0) * report.step


def _delay_line(report: CheckReport, way: str, colour: str) -> Figure:
    """Return a dotted vertical line at the time at which the delay ends."""
    at = _delay_s(report, way)
    line = {"color": colour, "width": 1.2, "dash": "dot"}
    return {"type": "line", "x0": at, "x1": at, "yref": "paper", "y0": 0.0, "y1": 1.0, "line": line}


def _make_trace(label: str, colour: str, x: list[float], y: list[float], mode: str) -> Figure:
    says, marker = f"{label}: %{{y:.5~g}} N<extra></extra>", {"color": colour, "size": 5}
    return trace(label, colour, x, y, mode=mode, marker=marker, hovertemplate=says, showlegend=mode == "lines")


def _make_layout(title: str, hover_format: str) -> Figure:
    figure_layout = panels(360, title, ["thrust [N]"], log=False) | HOVER
    figure_layout["xaxis"]["hoverformat"] = hover_format
    figure_layout["yaxis"]["rangemode"] = "tozero"
    return figure_layout
