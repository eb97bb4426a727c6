"""The head of the page of every identification, validation and replay, and the figure of their signals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.verdict import EXPLAINED, NOT_EXPLAINED, Judgement
from cosim.results.report.cards import Card, Page
from cosim.results.report.plot import BLUE, GREY, HOVER, MAGENTA, ORANGE, Figure, beneath, panels, trace

# head of the first column
WITH_BOUNDS = "with 95 % bounds"
_BADGES = {EXPLAINED: "met", NOT_EXPLAINED: "unmet"}  # badge of each verdict


def judged_page(judgement: Judgement, page: Page) -> Page:
    """Return a page with a verdict, its evidence and the first model's numbers at its head."""
    return replace(
        page,
        verdict=judgement.verdict,
        badge=_BADGES.get(judgement.verdict, "none"),
        evidence=judgement.evidence,
        answer=_answer(page.cards),
    )


def _answer(cards: Sequence[Card | None], limit: int = 5) -> list[str]:
    """Return up to ``limit`` numbers of the first model in one line; empty without models."""
    for card in cards:
        if card is not None and card.title == "Models" and card.rows and len(card.rows[0]) > 1:
            parts = [(*row[0].partition(", "), row[1]) for row in card.rows if row[1]]
            texts = [f"{name} {value} {unit}" for name, comma, unit, value in parts if comma]
            return [f"{card.columns[1]}: {', '.join(texts[:limit])}."]
    return []


class Signals(NamedTuple):
    """Measured and modelled signals of one log: s, and arrays in the channels' units."""

    command_times: Array
    command: Array
    times: Array
    measured: Array
    model: Array
    left_over: Array


def draw_signals(parts: Iterable[Signals], units: tuple[str, str], left_over: str = "left over") -> Figure:
    """Draw command, measured and modelled output, and residual over time.

    ``units``: of command and output, the titles of their axes.
    """
    data: list[Figure] = []
    dots = {"mode": "markers", "marker": {"size": 3, "color": MAGENTA}}
    for n, part in enumerate(parts):
        rows, at = _thin(part.command_times), _thin(part.times)
        legend, times = {"showlegend": n == 0}, part.times[at]
        data += [
            trace("command", GREY, part.command_times[rows], part.command[rows], 0, **legend),
            trace("measured", ORANGE, times, part.measured[at], 1, **legend, **beneath(ORANGE)),
            trace("model, of the command alone", BLUE, times, part.model[at], 1, **legend),
            trace(left_over, MAGENTA, times, part.left_over[at], 2, **legend, **dots),
        ]
    titles = (units[0], units[1], units[1])
    layout = panels(660, "time [s]", titles, log=False, domains=((0.72, 1.0), (0.3, 0.68), (0.0, 0.24)))
    return {"data": data, "layout": layout | HOVER}


def _thin(values: Array) -> Any:
    max_points = 4000  # of a curve
    return np.arange(0, len(values), max(1, len(values) // max_points))
