"""Pages that are a list of cards: every page but the flight's own."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup, escape

from cosim.base.wording import spell
from cosim.results.report.page import TEMPLATES, Flights, render

_NUMBER_CELL = re.compile(r"[<>≥≤+−–-]?\s*\d|[–-]?$")


class Card(NamedTuple):
    """One part of a page: its lines, figures, table, text, code and content are shown in this order.

    A text may be HTML that :func:`code`, :func:`coloured`, :func:`link` or :func:`marked` made; any other is escaped.
    """

    title: str
    # The titles of a table's columns, and its rows.
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    # A note in small print.
    text: str = ""
    # The names of one or several of the page's figures.
    figure: str | Sequence[str] = ""
    # Lines of text, shown as a list; a single line is shown as a sentence.
    lines: Sequence[str] = ()
    code: str = ""
    # Whether the card stands beside the next one where the window is wide enough.
    is_half: bool = False
    # Whether only the title is shown until it is clicked.
    is_folded: bool = False
    # HTML that the card shows as well, for what the other fields cannot express.
    content: str = ""

    @property
    def figures(self) -> Sequence[str]:
        return [name for name in ([self.figure] if isinstance(self.figure, str) else self.figure) if name]

    @property
    def alignments(self) -> list[str]:
        """CSS class of each column of the table: numbers are aligned to the right, texts to the left."""
        return [_choose_alignment(column) for column in zip(*self.rows, strict=True)]


def _choose_alignment(cells: Sequence[str], max_number: int = 30, min_wrapped: int = 16, min_long: int = 40) -> str:
    """Return the CSS class that aligns a column of a table with these cells.

    ``max_number``: a cell of more characters is a text though it begins with a digit.  Cells of texts are broken into
    lines from ``min_wrapped`` characters on, and are at least a third of a narrow window wide, or more from
    ``min_long`` on.
    """
    texts = [cell.striptags() if isinstance(cell, Markup) else cell for cell in cells]
    longest = max(map(len, texts))
    if sum(_NUMBER_CELL.match(text) is not None for text in texts) > len(texts) // 2 and longest < max_number:
        return "nowrap"
    return "left nowrap" if longest < min_wrapped else "left" if longest < min_long else "left long"


@dataclass(frozen=True)
class Page:
    """Page with the result at its head, cards below, and the origin of the numbers at its foot.

    >>> page = Page("drag", "hexjet", [Card("Speeds", ("m/s", "N"), [("5", "1.2")])], answer=["1.2 N at 5 m/s"])
    >>> page.write(Path("drag.html"))
    """

    # The kind of result ("margins measured in flight"), and the vehicle, engine or scenario that it is of.
    kind: str
    heading: str
    # The cards in the order in which they are shown; an entry of None is left out.
    cards: Sequence[Card | None]
    # Figures in Plotly's schema by the names that cards use.
    figures: Mapping[str, Any] = field(default_factory=dict)
    # The verdict in one or two words, and its colour: met, unmet, failed (a warning) or none.
    verdict: str = ""
    badge: str = "none"
    # Lines of text: the result, why it may not be used, what was done, the evidence, and warnings.
    answer: Sequence[str] = ()
    problems: Sequence[str] = ()
    summary: Sequence[str] = ()
    evidence: Sequence[str] = ()
    notes: Sequence[str] = ()
    # Facts about the result, as names and values.
    facts: Sequence[tuple[str, str]] = ()
    # The origin of the result: program, version and command.
    source: str = ""
    # Flights that are replayed in three dimensions, with their strips.
    flights: Flights | None = None
    # Whether figures over the same quantity are zoomed together.
    are_figures_linked: bool = True

    def write(self, path: Path) -> None:
        """Write the page.  Raises FlightError if the file cannot be written."""
        several = self.flights is not None and len(self.flights.runs) > 1
        shown = replace(self, problems=[*map(spell, self.problems)], notes=[*map(spell, self.notes)])
        render(TEMPLATES / "page.html", path, dict(self.figures), self.flights, page=shown, two=several)


def code(text: str) -> Markup:
    """Return a text in a monospaced font."""
    return Markup("<code>{}</code>").format(text)


def coloured(text: str, colour: str) -> Markup:
    """Return a text behind a swatch of the colour ``"#rrggbb"``."""
    return Markup('<span class="swatch" style="background:{}"></span>{}').format(colour, text)


def link(text: str, address: str) -> Markup:
    """Return a text that leads to an address, relative to the page; the text alone where the address is empty.

    >>> print(link("the run", "runs/one/report.html"))
    <a href="runs/one/report.html">the run</a>
    """
    return Markup('<a href="{}">{}</a>').format(address, text) if address else escape(text)


def sentence(text: str) -> str:
    """Return a line of text with a capital first letter and a full stop at its end."""
    return f"{text[:1].upper()}{text[1:]}."


def marked(text: str, kind: str) -> Markup:
    """Return a text in the style of a kind: ``met``, ``unmet``, ``note``, ``best``, ``dim`` or ``small``."""
    return Markup('<span class="{}">{}</span>').format(kind, text)
