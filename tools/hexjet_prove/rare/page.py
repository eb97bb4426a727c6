"""The page of a rare failure: its probability, how it was reached, and what the failures have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cosim.pages import GREY, RED, closest, dotted, render, run_colour
from cosim.spec.controller_name import short_name
from hexjet_prove.rare.estimate import probability_text
from hexjet_prove.rare.simulation import RareResult, SavedRare, describe_plan
from hexjet_prove.rare.subset import Repeat
from hexjet_prove.search.page import text
from hexjet_prove.search.question import case_rows

Figure = dict[str, Any]

TEMPLATE = Path(__file__).parent / "templates" / "rare.html"
POINTS = 40  # of a curve, each at a margin that so many parts of a level's flights lie apart
SHOWN = 12  # keys of the table, those that the failures are furthest out in
LIMITS = (
    "The margin must lead there: failures that nothing announces, in a region that no level leads to, are not found, "
    "and not in the interval"
)


def write_page(saved: SavedRare, path: Path) -> None:
    """Write the page of a simulation.  Raises FlightError if the file cannot be written."""
    result = saved.result
    base = result.study.base()
    render(
        TEMPLATE,
        path,
        {"levels": _levels(result)},
        result=result,
        base=base,
        controller=short_name(result.controller),
        sentence=result.sentence,
        plan=describe_plan(result.plan, len(result.groups)),
        limits=LIMITS,
        repeats=repeat_rows(result),
        shifts=shift_rows(result),
        deciders=describe_deciders(result),
        cases=case_rows(saved, path),
        text=text,
    )


def describe_result(result: RareResult) -> list[str]:
    """Return the result in lines: its sentence, what contradicts it, and how it was made."""
    lines = (
        result.sentence,
        result.contradiction,
        result.estimate.method,
        result.groups_note,
        result.search_note,
        result.seed_note,
        describe_plan(result.plan, len(result.groups)),
        result.study.engine_note,
    )
    return [line for line in lines if line]


def repeat_rows(result: RareResult) -> list[list[str]]:
    """Return a row for each simulation: its requirements, flights, thresholds and probability."""
    rows = []
    for names, repeat in _named_repeats(result):
        log = repeat.log_probability
        thresholds = ", ".join(f"{level.threshold:.3g}" for level in repeat.levels[:-1])
        probability = "no failure" if log is None else probability_text(float(np.exp(log)))
        rows.append([", ".join(names), str(repeat.flights), thresholds or "-", probability])
    return rows


def _named_repeats(result: RareResult) -> list[tuple[list[str], Repeat]]:
    """Return each simulation with the requirements that it is of."""
    pairs = zip(result.groups, result.simulations.repeats, strict=True)
    return [(names, repeat) for names, repeats in pairs for repeat in repeats]


def shift_rows(result: RareResult) -> list[list[str]]:
    """Return a row for each key: where the failures are in it, in standard deviations, and how wide they lie."""
    return [[shift.name, f"{shift.mean:+.2f}", f"{shift.spread:.2f}"] for shift in result.shifts[:SHOWN]]


def describe_deciders(result: RareResult) -> str:
    """Return which requirements the failures break furthest, in words; empty without a failure."""
    named = ", ".join(f"{name} in {100.0 * part:.0f} % of them" for name, part in result.deciders.items())
    return f"what the failures break furthest is {named}" if named else ""


def _levels(result: RareResult) -> Figure:
    """Return the figure of the probability of a margin below a number, a curve a repeat, and the levels' thresholds."""
    data: list[Figure] = []
    for number, (names, repeat) in enumerate(_named_repeats(result)):
        margins, probabilities = _curve(repeat)
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"simulation {number + 1}, {', '.join(names)}",
                "x": margins,
                "y": probabilities,
                "line": {"color": run_colour(number), "width": 1.5},
                "hovertemplate": "margin %{x:.3g}: %{y:.2e}<extra></extra>",
            }
        )
    figure = closest(420, 80)
    figure["xaxis"] = {"title": {"text": "margin"}}
    figure["yaxis"] = {"title": {"text": "probability of less"}, "type": "log"}
    figure["shapes"] = [dotted(RED if result.failures else GREY, x=0.0)]
    return {"data": data, "layout": figure}


def _curve(repeat: Repeat) -> tuple[list[float], list[float]]:
    """Return margins, falling, and the probability of less than each, level by level."""
    margins: list[float] = []
    for level in repeat.levels:
        inside = np.unique(level.margins[level.margins >= level.threshold])[::-1]
        margins += inside[:: max(1, inside.size // POINTS)].tolist()
    margins = sorted({*margins, 0.0}, reverse=True)
    logs = [(margin, repeat.log_below(margin)) for margin in margins]
    kept = [(margin, float(np.exp(log))) for margin, log in logs if log is not None]
    return [margin for margin, _ in kept], [probability for _, probability in kept]
