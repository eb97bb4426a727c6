"""A search for the worst case or the most likely failure from a command line to a folder."""

from __future__ import annotations

import re
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.spec.controller_name import short_name
from cosim.studies import Progress, Study, Workers, open_study, parse_number, run_sampler
from hexjet_prove.search.folder import COMMAND, REPORT, RESULT, point_seeds
from hexjet_prove.search.minimise import need_optimiser
from hexjet_prove.search.question import SavedResult, fly_cases
from hexjet_prove.search.worst_case import (
    DEFAULT_WORST_REGION,
    LIKELY_REGION,
    WorstPlan,
    WorstSearch,
    check_region,
    search_worst,
)
from hexjet_prove.search.worst_page import write_page

WHOLE_RANGES = "ranges"  # value of the option within: no radius
SavedWorst = SavedResult[WorstSearch]


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
    need_optimiser()
    opened: dict[str, Any] = {"design": "random", "runs": 1, "until": ""} | options
    study = name if isinstance(name, Study) else open_study(name, **opened)
    plan = WorstPlan(likely, _parse_region(within, likely), point_seeds(study, seed, seeds), budget, study.seed)
    check_region(study, plan)
    return study, plan


def _parse_region(text: str | float | None, likely: bool) -> float | None:
    """Return the search radius in standard deviations, or None to search the whole ranges."""
    if text is None:
        return LIKELY_REGION if likely else DEFAULT_WORST_REGION
    if text == WHOLE_RANGES:
        if likely:
            raise InputError("within ranges: says nothing of what is likely; give a number of standard deviations")
        return None
    number = parse_number(str(text), "within")
    if not (isfinite(number) and 0.0 < number <= 8.0):
        raise InputError(f"within {text}: must be above 0 and at most 8 standard deviations, or ranges")
    return number


def run_worst(
    study: Study, plan: WorstPlan, out: Path, workers: Workers, resume: bool = False, progress: Progress | None = None
) -> SavedWorst:
    """Search like :func:`hexjet_prove.search.folder.run_search`; ``cases/`` has the found flight of each controller."""
    asked = COMMAND | plan.table()
    campaign, result = run_sampler(study, out, partial(search_worst, plan), workers, resume, progress, asked)
    kind = "likely" if plan.likely else "worst"
    labels = [re.sub(r"[^A-Za-z0-9_.-]+", "_", short_name(case.controller)) for case in result.cases]
    found = [(f"{at}-{kind}", c.flight, c.fails, c.distance) for at, c in zip(labels, result.cases, strict=True)]
    saved = SavedWorst(out, result, fly_cases(campaign, found), campaign.referee)
    saved.write(RESULT)
    write_page(saved, out / REPORT)
    return saved
