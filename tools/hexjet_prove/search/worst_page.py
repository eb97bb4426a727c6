"""The page of a search for the worst case or the most likely failure, and its table for the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.pages import Card, Page, bars, closest, run_colour, sentence
from cosim.spec.controller_name import short_name
from cosim.studies import referee_cards, with_referee
from hexjet_prove.search.page import ROW_PX, cases_card, list_facts, text
from hexjet_prove.search.question import SavedResult
from hexjet_prove.search.worst_case import WorstCase, WorstSearch, important

SHARES_NOTE = (  # note on the table
    "A margin below 0 is a failure. The share is of the squared distance from the middle; without it: the key is put "
    "back to the middle and all others are kept; with it alone: all others are put back."
)
NONE = "–"  # shown where there is no number


def titles(result: WorstSearch) -> list[str]:
    """Return the titles of the table of keys."""
    where = "of its range" if result.plan.within is None else "standard deviations"
    return ["controller", "key", "value", "middle", where, "share", "margin without it", "margin with it alone"]


def rows(result: WorstSearch) -> list[list[str]]:
    """Return a row for each key of each controller, in the order of their shares of the squared distance."""
    return [row for case in result.cases for row in _case_rows(case)]


def _case_rows(case: WorstCase) -> list[list[str]]:
    listed = []
    for effect in important(case.effects)[:12]:
        value, middle = (NONE if each is None else text(each) for each in (effect.value, effect.middle))
        moved = [f"{effect.place:+.2f}", f"{100.0 * effect.share:.0f} %"]
        margins = [NONE if each is None else f"{each:.3g}" for each in (effect.without, effect.alone)]
        listed.append([short_name(case.controller), effect.name, value, middle, *moved, *margins])
    return listed


def write_page(saved: SavedResult[WorstSearch], path: Path) -> None:
    """Write the page of a search.  Raises FlightError if the file cannot be written."""
    result = saved.result
    base, kind = result.study.base(), "most likely failure" if result.plan.likely else "worst case"
    page = Page(
        f"the {kind}",
        result.study.title or base.title or base.name,
        [
            Card("Which keys matter", titles(result), rows(result), SHARES_NOTE, "places"),
            cases_card("The flight", saved, path),
            *referee_cards(saved.referee),
        ],
        {"places": _make_places_figure(result)},
        answer=with_referee([f"{line}." for line in result.lines()], saved.referee),
        summary=[sentence(note) for note in result.notes],
        facts=list_facts(base, result.flights, [("searched in", result.plan.where)]),
    )
    page.write(path)


def _make_places_figure(result: WorstSearch) -> dict[str, Any]:
    """Return the figure of how far the found case is from the middle in each key, a bar a controller."""
    names = list(dict.fromkeys(effect.name for case in result.cases for effect in case.effects))
    data = []
    for number, case in enumerate(result.cases):
        label = short_name(case.controller)
        says = {"marker": {"color": run_colour(number)}, "hovertemplate": f"{label}: %{{y}} %{{x:+.3g}}<extra></extra>"}
        data.append(bars(label, names, [effect.place for effect in case.effects], **says))
    drawn = closest(130 + ROW_PX * len(names))
    unit = "half ranges" if result.plan.within is None else "standard deviations"
    drawn["xaxis"] = {"title": {"text": f"{unit} from the middle"}}
    drawn["yaxis"] = {"automargin": True, "autorange": "reversed"}
    return {"data": data, "layout": drawn}
