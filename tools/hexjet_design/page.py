"""The page of a design."""

from __future__ import annotations

from cosim.pages import Card, Page, sentence
from hexjet_design.design import Design
from hexjet_design.figures import design_figures
from hexjet_design.proof.comparison import WORSE, WORSE_WORDS, comparison_columns, comparison_rows
from hexjet_design.result import COLUMNS, answer_lines, detail_lines, row_lines, rows

FIGURES = (  # figures of each channel and their titles
    ("step", "steps of set-point and load"),
    ("bode", "open loop"),
    ("nyquist", "Nyquist"),
    ("sensitivity", "sensitivity and closed loop"),
)
TOLERANCES_NOTE = (  # note on tolerances
    "The loop is broken at the plant's input with attitude and rate loop closed. Tolerated: how many times the "
    "tolerances ({:.0f} % of the delay and {:.0f} % of the gain, both ways, together) make the loop unstable. The "
    "height is in metres where the others are in radians."
)


def make_page(design: Design) -> Page:
    """Return the page of a design: shipped and designed loops, and evidence."""
    answers, lines = answer_lines(design), detail_lines(design)
    wrong = [line for line in (*answers, *lines) if "NOT" in line or "no acceptable" in line or line.startswith(WORSE)]
    compared, need = design.proof.compared if design.proof else (), design.need
    tolerances = TOLERANCES_NOTE.format(100.0 * need.delay_tolerance, 100.0 * need.gain_tolerance)
    drawn = [
        Card(f"{axis.capitalize()}: {title}", figure=f"{name}_{axis}", is_half=True)
        for name, title in FIGURES for axis in design.axes
    ]  # fmt: skip
    steps = len(design.axes)
    cards = [
        *drawn[:steps],
        Card("Shipped and designed, as flown", comparison_columns(compared), comparison_rows(compared),
             f"{WORSE_WORDS.capitalize()}.") if compared else None,
        Card("Shipped and designed, the linear loops", COLUMNS, rows(design), tolerances,
             lines=[f"{line}." for line in row_lines(design)]),
        *drawn[steps:],
        Card("Evidence", lines=[line for line in lines if line not in wrong]),
    ]  # fmt: skip
    unproved = f"{design.controller}, not proved" if design.is_written else "no acceptable design"
    return Page(
        "control design",
        f"{design.vehicle.name} with engine {design.engine.name}",
        cards,
        design_figures(design),
        verdict=design.controller if design.ok else unproved,
        badge="met" if design.ok else "failed",
        answer=[sentence(line) for line in answers if line not in wrong],
        problems=[sentence(line) for line in wrong],
        source=design.model_source,
    )
