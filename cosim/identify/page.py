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

# Head of the first column of parameters.
WITH_BOUNDS = "with 95 % bounds"
_BADGES = {EXPLAINED: "met", NOT_EXPLAINED: "unmet"}  # badge of each verdict


def judged_page(judgement: Judgement, page: Page) -> Page:
    """Return the page with the verdict, its evidence and the first model's numbers added at its head."""
    return replace(
        page,
        verdict=judgement.verdict,
        badge=_BADGES.get(judgement.verdict, "none"),
        evidence=judgement.evidence,
        answer=_summarise_model(page.cards),
    )


def _summarise_model(cards: Sequence[Card | None], limit: int = 5) -> list[str]:
    """Return one line with up to ``limit`` parameters of the first model; empty without models."""
    for card in cards:
        if card is not None and card.title == "Models" and card.rows and len(card.rows[0]) > 1:
            # What is not told, and what compares the models, is in the table alone.
            told = [row for row in card.rows if any(map(str.isdigit, row[1])) and not row[0].startswith("BIC")]
            parts = [(*row[0].partition(", "), row[1]) for row in told]
            texts = [f"{name} {value} {unit}" for name, comma, unit, value in parts if comma]
            return [f"{card.columns[1]}: {', '.join(texts[:limit])}."]
    return []


class Signals(NamedTuple):
    """Measured and modelled signals of one log: times in s, values in the channels' units."""

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
        rows, at = _select_drawn_points(part.command_times), _select_drawn_points(part.times)
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


def _select_drawn_points(values: Array) -> Any:
    """Return the indices of evenly spaced points of a curve, few enough to draw."""
    max_points = 4000  # per curve
    return np.arange(0, len(values), max(1, len(values) // max_points))
