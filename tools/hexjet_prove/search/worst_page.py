"""The page of a search for the worst case or the most likely failure, and its table for the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.pages import bars, closest, render, run_colour
from cosim.spec.controller_name import short_name
from hexjet_prove.search.page import ROW_PX, text
from hexjet_prove.search.question import Answered, case_rows
from hexjet_prove.search.result import Case
from hexjet_prove.search.worst_case import WorstCase, WorstSearch, important

TEMPLATE = Path(__file__).parent / "templates" / "worst.html"
SHOWN = 12  # keys of a controller in the table
NONE = "–"


def titles(result: WorstSearch) -> list[str]:
    """Return the titles of the table of keys."""
    where = "of its range" if result.plan.within is None else "standard deviations"
    return ["controller", "key", "value", "middle", where, "share", "margin without it", "margin with it alone"]


def rows(result: WorstSearch) -> list[list[str]]:
    """Return a row for each key of each controller, in the order of their shares of the squared distance."""
    return [row for case in result.cases for row in _rows(case)]


def _rows(case: WorstCase) -> list[list[str]]:
    listed = []
    for effect in important(case.effects)[:SHOWN]:
        value, middle = (NONE if each is None else text(each) for each in (effect.value, effect.middle))
        moved = [f"{effect.place:+.2f}", f"{100.0 * effect.share:.0f} %"]
        margins = [NONE if each is None else f"{each:.3g}" for each in (effect.without, effect.alone)]
        listed.append([short_name(case.controller), effect.name, value, middle, *moved, *margins])
    return listed


def write_page(saved: Answered[WorstSearch, Case], path: Path) -> None:
    """Write the page of a search.  Raises FlightError if the file cannot be written."""
    result = saved.result
    render(
        TEMPLATE,
        path,
        {"places": _places(result)},
        result=result,
        base=result.study.base(),
        lines=result.lines(),
        notes=result.notes,
        columns=titles(result),
        rows=rows(result),
        cases=case_rows(saved, path),
        text=text,
    )


def _places(result: WorstSearch) -> dict[str, Any]:
    """Return the figure of how far each key is moved in what was found, a bar for each controller."""
    names = list(dict.fromkeys(effect.name for case in result.cases for effect in case.effects))
    data = []
    for number, case in enumerate(result.cases):
        label = short_name(case.controller)
        says = {"marker": {"color": run_colour(number)}, "hovertemplate": f"{label}: %{{y}} %{{x:+.3g}}<extra></extra>"}
        data.append(bars(label, names, [effect.place for effect in case.effects], **says))
    drawn = closest(130 + ROW_PX * len(names))
    unit = "half ranges" if result.plan.within is None else "standard deviations"
    drawn["xaxis"] = {"title": {"text": f"from the middle [{unit}]"}}
    drawn["yaxis"] = {"automargin": True, "autorange": "reversed"}
    return {"data": data, "layout": drawn}
