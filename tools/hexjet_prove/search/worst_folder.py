"""A search for the worst case or the most likely failure from a command line to a folder.

The folder is that of any search (:mod:`hexjet_prove.search.folder`): ``study/``, ``search.toml``, ``flights.jsonl``,
``search.json``, ``search.html``, and ``cases/`` with the run of what was found for each controller.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.spec.controller_name import short_name
from cosim.studies import Study, Workers, open_study, parse_number
from hexjet_prove.search.folder import REPORT, RESULT, SEARCH, fly_case, point_seeds
from hexjet_prove.search.probe import Point, Prober
from hexjet_prove.search.question import Answered, empty_cases, open_question
from hexjet_prove.search.result import Case
from hexjet_prove.search.worst_case import (
    LIKELY_WITHIN,
    WORST_WITHIN,
    WorstPlan,
    WorstSearch,
    check_region,
    search_worst,
    worst_row,
)
from hexjet_prove.search.worst_page import write_page

RANGES = "ranges"


SavedWorst = Answered[WorstSearch, Case]


def resolve_worst(
    name: str | Study,
    *,
    likely: bool = False,
    within: str | float | None = None,
    seeds: int = 1,
    budget: int = 1000,
    seed: int | None = None,
    **options: Any,
) -> tuple[Study, WorstPlan]:
    """Return the study and the plan that a command line states; ``options`` are those of ``open_study``.

    ``name`` is of a scenario or a study, or a study that is open already and takes no more options.  ``within`` is a
    number of standard deviations, or ``ranges``.  ``seeds`` flights a point have the scenario's seed, or ``seed``, and
    those that follow it; the search itself has the study's.  Raises InputError.
    """
    opened: dict[str, Any] = {"design": "random", "runs": 1, "until": ""} | options
    study = name if isinstance(name, Study) else open_study(name, **opened)
    plan = WorstPlan(likely, _within(within, likely), point_seeds(study, seed, seeds), budget, study.seed)
    check_region(study, plan)
    return study, plan


def _within(text: str | float | None, likely: bool) -> float | None:
    if text is None:
        return LIKELY_WITHIN if likely else WORST_WITHIN
    if text == RANGES:
        if likely:
            raise InputError("--within ranges: says nothing of what is likely; give a number of standard deviations")
        return None
    number = parse_number(str(text), "--within")
    if not (isfinite(number) and 0.0 < number <= 8.0):
        raise InputError(f"--within {text}: must be above 0 and at most 8 standard deviations, or ranges")
    return number


def run_worst(
    study: Study,
    plan: WorstPlan,
    out: Path,
    workers: Workers,
    resume: bool = False,
    progress: Callable[[int], None] = lambda flights: None,
) -> SavedWorst:
    """Search, and leave everything in ``out``; ``progress`` is told how many flights there are so far.

    ``resume``: go on with what the folder holds, if it holds anything; nothing is flown twice, and what is found is the
    same as without a stop.  Raises InputError if study or folder is not usable, FlightError if no more can be flown or
    written.
    """
    with open_question(study, plan.table(), out, resume, SEARCH) as (flown, journal):
        prober = Prober(flown, plan.seeds, 0.0, workers, journal, progress)
        result = search_worst(plan, prober)
        saved = SavedWorst(out, result, tuple(_cases(result, prober, empty_cases(out))))
        saved.write(RESULT)
        write_page(saved, out / REPORT)
    return saved


def _cases(result: WorstSearch, prober: Prober, folder: Path) -> Sequence[Case]:
    """Fly what was found for each controller once more, recorded in full."""
    kind = "likely" if result.plan.likely else "worst"
    cases = []
    for case in result.cases:
        point = Point.of(case.controller, case.values)
        label = re.sub(r"[^A-Za-z0-9_.-]+", "_", short_name(case.controller))
        _, row = worst_row(prober, point)
        cases.append(fly_case(prober, point, row, case.fails, folder / f"{label}-{kind}"))
    return cases
