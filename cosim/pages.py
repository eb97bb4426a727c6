"""What reports and pages are made of: tables of Markdown between a page's marks, and pages of HTML, a list of cards.

Figures are dicts of Plotly's schema; the colours are those of the reports, ``"#rrggbb"``.
"""

from cosim.base.wording import spell
from cosim.results.report.cards import Card, Page, code, coloured, link, marked, sentence
from cosim.results.report.marks import cell, check_marks, filled, page_parts, parts_of, row, table, write_marks
from cosim.results.report.page import render
from cosim.results.report.plot import (
    BLUE,
    GREEN,
    GREY,
    MAGENTA,
    ORANGE,
    RED,
    axis_name,
    bars,
    beneath,
    closest,
    dotted,
    layout,
    panels,
    run_colour,
    share,
    trace,
)

__all__ = [
    "BLUE", "GREEN", "GREY", "MAGENTA", "ORANGE", "RED", "Card", "Page", "axis_name", "bars", "beneath", "cell",
    "check_marks", "closest", "code", "coloured", "dotted", "filled", "layout", "link", "marked", "page_parts",
    "panels", "parts_of", "render", "row", "run_colour", "sentence", "share", "spell", "table", "trace", "write_marks",
]  # fmt: skip
