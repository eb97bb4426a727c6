"""A search for the worst case or the most likely failure from a command line to a folder.

The folder is that of any search (:mod:`cosim.campaign.search.folder`): ``study/``, ``search.toml``, ``flights.jsonl``,
``search.json``, ``search.html``, and ``cases/`` with the run of what was found for each controller.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import lock_file, map_os_errors, write_whole
from cosim.campaign.folder import freeze
from cosim.campaign.folder import load as load_study
from cosim.campaign.search.folder import REPORT, RESULT, SEARCH, fly_case, point_seeds
from cosim.campaign.search.probe import Journal, Point, Prober
from cosim.campaign.search.question import CASES, JOURNAL, STUDY, Answered, begin_question, holds_question
from cosim.campaign.search.result import Case
from cosim.campaign.search.worst_case import (
    LIKELY_WITHIN,
    WORST_WITHIN,
    WorstPlan,
    WorstSearch,
    check_region,
    search_worst,
    worst_row,
)
from cosim.campaign.search.worst_page import write_page
from cosim.campaign.study.distributions import parse_number
from cosim.campaign.study.options import open_study
from cosim.campaign.study.study import Study
from cosim.campaign.workers.protocol import Workers
from cosim.spec.controller_name import short_name

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
    frozen = freeze(study)
    with map_os_errors(FlightError, out):
        if not holds_question(out, frozen, plan.table(), resume, SEARCH):
            begin_question(out, frozen, plan.table(), SEARCH)
        with lock_file(out / JOURNAL, f"{out}: another search is at work there"):
            flown = load_study(out / STUDY)
            prober = Prober(flown, plan.seeds, 0.0, workers, Journal(out / JOURNAL), progress)
            result = search_worst(plan, prober)
            shutil.rmtree(out / CASES, ignore_errors=True)  # left by a search stopped while it flew them
            saved = SavedWorst(out, result, tuple(_cases(result, prober, out / CASES)))
            write_whole(out / RESULT, json.dumps(saved.to_json(), indent=1, allow_nan=False) + "\n")
            write_page(saved.result, saved.cases, out / REPORT)
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
