"""Pages that are a list of cards: every page but the flight's own."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from cosim.results.report.page import TEMPLATES, Flights, render

_NUMBER = re.compile(r"[<>≥≤+−–-]?\s*\d|[–-]?$")


class Card(NamedTuple):
    """One part of a page: its lines, figures, table, text, code and content are shown in this order.

    A text may be HTML that :func:`code`, :func:`coloured`, :func:`link` or :func:`marked` made; any other is escaped.
    """

    title: str
    # Of a table: what heads its columns, and its rows.
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    # Small print.
    text: str = ""
    # One or several of the page's figures, by name.
    figure: str | Sequence[str] = ""
    # A list; one line alone is a sentence.
    lines: Sequence[str] = ()
    code: str = ""
    # Beside the next card where the window is wide enough.
    is_half: bool = False
    # Only its title is seen until it is clicked.
    is_folded: bool = False
    # Markup of its own, where a card needs more than these.
    content: str = ""

    @property
    def figures(self) -> Sequence[str]:
        """The names of its figures."""
        return [name for name in ([self.figure] if isinstance(self.figure, str) else self.figure) if name]

    @property
    def alignments(self) -> list[str]:
        """The class of each column of the table: numbers are to the right, texts to the left."""
        return [_alignment(column) for column in zip(*self.rows, strict=True)]


def _alignment(cells: Sequence[str], max_number: int = 30, min_wrapped: int = 16, min_long: int = 40) -> str:
    """Return the class of a column of a table.

    ``max_number``: a cell of more characters is a text though it begins with a digit.  Cells of texts are broken into
    lines from ``min_wrapped`` characters on, and are at least a third of a narrow window wide, or more from
    ``min_long`` on.
    """
    texts = [cell.striptags() if isinstance(cell, Markup) else cell for cell in cells]
    longest = max(map(len, texts))
    if sum(_NUMBER.match(text) is not None for text in texts) > len(texts) // 2 and longest < max_number:
        return "nowrap"
    return "left nowrap" if longest < min_wrapped else "left" if longest < min_long else "left long"


@dataclass(frozen=True)
class Page:
    """A page: what is found is at its head, its cards are below, and where it is from stands at its foot."""

    # Of what it is a page ("margins measured in flight"), and of which vehicle, engine or scenario.
    kind: str
    heading: str
    # In the order in which they are shown; an entry of None is left out.
    cards: Sequence[Card | None]
    # Figures of Plotly's schema that cards name.
    figures: Mapping[str, Any] = field(default_factory=dict)
    # The verdict in one or two words, and its colour: met, unmet, failed (a warning) or none.
    verdict: str = ""
    badge: str = "none"
    # Lines: the result, why it may not be used, what was done, what the verdict is from, what to look out for.
    answer: Sequence[str] = ()
    problems: Sequence[str] = ()
    summary: Sequence[str] = ()
    evidence: Sequence[str] = ()
    notes: Sequence[str] = ()
    # Names and values.
    facts: Sequence[tuple[str, str]] = ()
    # Where it is from.
    source: str = ""
    # Flights that are replayed in three dimensions, with their strips.
    flights: Flights | None = None
    # Whether figures over the same quantity are zoomed together.
    are_figures_linked: bool = True

    def write(self, path: Path) -> None:
        """Write it.  Raises FlightError if the file cannot be written."""
        several = self.flights is not None and len(self.flights.runs) > 1
        render(TEMPLATES / "page.html", path, dict(self.figures), self.flights, page=self, two=several)


def code(text: str) -> Markup:
    """Return a text in the letters of a program."""
    return Markup("<code>{}</code>").format(text)


def coloured(text: str, colour: str) -> Markup:
    """Return a text behind a swatch of a colour, ``"#rrggbb"``."""
    return Markup('<span class="swatch" style="background:{}"></span>{}').format(colour, text)


def link(text: str, address: str) -> Markup:
    """Return a text that leads to an address, relative to the page; the text alone where the address is empty."""
    return Markup('<a href="{}">{}</a>').format(address, text) if address else escape(text)


def sentence(text: str) -> str:
    """Return a line as a sentence: with a capital first and a full stop last."""
    return f"{text[:1].upper()}{text[1:]}."


def marked(text: str, kind: str) -> Markup:
    """Return a text in the style of a kind: ``met``, ``unmet``, ``note``, ``best``, ``dim`` or ``small``."""
    return Markup('<span class="{}">{}</span>').format(kind, text)
