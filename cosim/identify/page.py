"""The page that every identification, validation and replay leaves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.verdict import EXPLAINED, NOT_EXPLAINED, Judgement
from cosim.results.report.page import Flights, render
from cosim.results.report.plot import BLUE, GREY, HOVER, MAGENTA, ORANGE, Figure, beneath, panels, trace

# First column of a table of parameters.
WITH_BOUNDS = "with 95 % bounds"
TEMPLATE = Path(__file__).parent / "templates" / "identification.html"
MOST_POINTS = 4000  # a curve
MOST_NUMBERS = 5  # of the line that a page begins with
_BADGES = {EXPLAINED: "met", NOT_EXPLAINED: "unmet"}


class Card(NamedTuple):
    """One part of a page, in the order in which it is shown."""

    title: str
    columns: Sequence[str] = ()  # of a table, with
    rows: Iterable[Sequence[str]] = ()
    text: str = ""
    figure: str = ""  # by name
    lines: Sequence[str] = ()  # of a list
    code: str = ""


@dataclass(frozen=True)
class Page:
    """The page of an identification, of a validation, or of a replay."""

    kind: str
    heading: str
    summary: str
    source: str
    judgement: Judgement
    cards: Sequence[Card]
    figures: dict[str, Any]
    notes: Sequence[str] = ()
    refused: Sequence[str] = ()  # why there is no model or engine, a line a reason

    flights: Flights | None = None  # replayed in three dimensions

    @property
    def badge(self) -> str:
        """The class of the verdict's badge."""
        return _BADGES.get(self.judgement.verdict, "none")

    @property
    def answer(self) -> str:
        """The first model's numbers in one line; an empty string where there is no table of models."""
        for card in self.cards:
            rows = list(card.rows)
            if card.title == "Models" and rows and len(rows[0]) > 1:
                parts = [(*row[0].partition(", "), row[1]) for row in rows if row[1]]
                texts = [f"{name} {value} {unit}" for name, comma, unit, value in parts if comma]
                return f"{card.columns[1]}: {', '.join(texts[:MOST_NUMBERS])}."
        return ""

    def write(self, path: Path) -> None:
        """Write it.  Raises FlightError if the file cannot be written."""
        many = self.flights is not None and len(self.flights.runs) > 1
        render(TEMPLATE, path, self.figures, self.flights, page=self, two=many)


class Signals(NamedTuple):
    """What was measured and modelled in one log or stretch: s, and arrays in the units of the channels."""

    command_times: Array
    command: Array
    times: Array
    measured: Array
    model: Array
    left_over: Array


def draw_signals(parts: Iterable[Signals], units: tuple[str, str], left_over: str = "left over") -> Figure:
    """Return command, measured and modelled output, and what is left over, over time.

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
    return np.arange(0, len(values), max(1, len(values) // MOST_POINTS))
