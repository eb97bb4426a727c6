"""The page of a rare failure: its probability, how it was reached, and what the failures have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cosim.pages import GREY, RED, Card, Page, closest, dotted, run_colour, sentence, trace
from cosim.spec.controller_name import short_name
from cosim.studies import referee_cards, with_referee
from hexjet_prove.rare.estimate import probability_text
from hexjet_prove.rare.simulation import RareResult, describe_plan
from hexjet_prove.rare.subset import Repeat
from hexjet_prove.search.page import cases_card, list_facts
from hexjet_prove.search.question import SavedResult

Figure = dict[str, Any]

CURVES_NOTE = "A failure is a margin below 0, dotted; the interval is made from how far the curves lie apart there."
SHIFTS_NOTE = (  # note on the table of shifts
    "Where each key is in the failures, in standard deviations of what is drawn: of all flights the mean is 0 and the "
    "spread 1. Furthest out first."
)
LIMITS_NOTE = (  # note on what the method can miss
    "The margin must lead there: failures that nothing announces, in a region that no level leads to, are not found, "
    "and not in the interval"
)


def write_page(saved: SavedResult[RareResult], path: Path) -> None:
    """Write the page of a simulation.  Raises FlightError if the file cannot be written."""
    result = saved.result
    base, plan = result.study.base(), describe_plan(result.plan, len(result.groups))
    notes = (result.estimate.method, result.search_note, result.groups_note, result.study.engine_note)
    deciders = describe_deciders(result)
    cards = [
        Card("How rare each margin is", text=f"{sentence(plan)} {CURVES_NOTE} {LIMITS_NOTE}.", figure="levels"),
        Card("The simulations", ("requirements", "flights", "thresholds", "probability"), repeat_rows(result),
             is_half=True),
        Card("What the failures have in common", ("key", "mean", "spread"), shift_rows(result),
             f"{SHIFTS_NOTE} {sentence(deciders) if deciders else ''}", is_half=True) if result.shifts else None,
        cases_card("The most likely failures that were met", saved, path, ("flight", "standard deviations"),
                   lambda case: (str(case.flight), f"{case.distance:.2f}")),
    ]  # fmt: skip
    page = Page(
        "rare failures",
        result.study.name,
        [*cards, *referee_cards(saved.referee)],
        {"levels": _make_levels_figure(result)},
        answer=with_referee([sentence(result.sentence)], saved.referee),
        problems=[sentence(line) for line in (result.contradiction, result.seed_note) if line],
        summary=[sentence(line) for line in notes if line],
        facts=list_facts(
            base, result.flights, [("controller", short_name(result.controller)), ("seed", str(result.study.seed))]
        ),
    )
    page.write(path)


def describe_result(result: RareResult) -> list[str]:
    """Return the result in lines: sentence, contradictions, and method."""
    lines = (
        result.sentence, result.contradiction, result.estimate.method, result.groups_note, result.search_note,
        result.seed_note, describe_plan(result.plan, len(result.groups)), result.study.engine_note,
    )  # fmt: skip
    return [line for line in lines if line]


def repeat_rows(result: RareResult) -> list[list[str]]:
    """Return a row for each simulation: its requirements, flights, thresholds and probability."""
    rows = []
    for names, repeat in _group_repeats(result):
        log = repeat.log_probability
        thresholds = ", ".join(f"{level.threshold:.3g}" for level in repeat.levels[:-1])
        probability = "no failure" if log is None else probability_text(float(np.exp(log)))
        rows.append([", ".join(names), str(repeat.flights), thresholds or "-", probability])
    return rows


def _group_repeats(result: RareResult) -> list[tuple[list[str], Repeat]]:
    """Return each group's simulation with the names of its requirements."""
    pairs = zip(result.groups, result.simulations.repeats, strict=True)
    return [(names, repeat) for names, repeats in pairs for repeat in repeats]


def shift_rows(result: RareResult) -> list[list[str]]:
    """Return one row per key: mean and spread in the failures, in standard deviations."""
    return [[shift.name, f"{shift.mean:+.2f}", f"{shift.spread:.2f}"] for shift in result.shifts[:12]]


def describe_deciders(result: RareResult) -> str:
    """Return which requirements the failures break furthest, in words; empty without a failure."""
    named = ", ".join(f"{name} in {100.0 * part:.0f} % of them" for name, part in result.deciders.items())
    return f"what the failures break furthest is {named}" if named else ""


def _make_levels_figure(result: RareResult) -> Figure:
    """Return the figure of the probability of a smaller margin: a curve a repeat, and thresholds of levels."""
    data: list[Figure] = []
    for number, (names, repeat) in enumerate(_group_repeats(result)):
        margins, probabilities = _probability_curve(repeat)
        name, says = f"simulation {number + 1}, {', '.join(names)}", "margin %{x:.3g}: %{y:.2e}<extra></extra>"
        data.append(trace(name, run_colour(number), margins, probabilities, hovertemplate=says))
    figure = closest(420, 80)
    figure["xaxis"] = {"title": {"text": "margin"}}
    figure["yaxis"] = {"title": {"text": "probability of less"}, "type": "log"}
    figure["shapes"] = [dotted(RED if result.failures else GREY, x=0.0)]
    return {"data": data, "layout": figure}


def _probability_curve(repeat: Repeat) -> tuple[list[float], list[float]]:
    """Return falling margins of a repeat, and the probability of a smaller margin at each."""
    margins: list[float] = []
    points = 40  # points of a curve per level
    for level in repeat.levels:
        inside = np.unique(level.margins[level.margins >= level.threshold])[::-1]
        margins += inside[:: max(1, inside.size // points)].tolist()
    margins = sorted({*margins, 0.0}, reverse=True)
    logs = [(margin, repeat.log_below(margin)) for margin in margins]
    kept = [(margin, float(np.exp(log))) for margin, log in logs if log is not None]
    return [margin for margin, _ in kept], [probability for _, probability in kept]
