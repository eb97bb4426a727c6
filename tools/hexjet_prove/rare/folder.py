"""A rare failure's probability from a command line to a folder.

``rare.json`` and ``rare.html`` are the result, and ``cases/`` has the runs of the failures that are most likely.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from cosim.studies import MAX_TESTED, NormalSpace, Progress, Study, Workers, only_controller, open_study, run_sampler
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.page import write_page
from hexjet_prove.rare.simulation import SUBJECT, Plan, RareResult, simulate
from hexjet_prove.search.question import SavedResult, fly_cases

RESULT, REPORT = "rare.json", "rare.html"
COMMAND = {"command": "hexjet search --rare"}  # command in the folder's record
SavedRare = SavedResult[RareResult]


def resolve_rare(
    name: str | Path,
    *,
    target: float = 1e-6,
    budget: int = 5000,
    same_seed: bool = False,
    **options: Any,
) -> tuple[Study, Plan]:
    """Return the study and the plan that a command line states; ``options`` are those of ``open_study``.

    ``target`` is the smallest probability that the levels reach, ``budget`` the flights at most; with ``same_seed`` all
    flights have one seed.  Raises InputError.
    """
    plan = Plan(Budget(target, budget), not same_seed)
    plan.budget.check()
    # The points do not come from the study's design, and a claim in its file may need up to MAX_TESTED runs.
    study = open_study(name, **options | {"design": "random", "runs": MAX_TESTED})
    study = study.changed(until=None, runs=budget)
    only_controller(study, SUBJECT)
    NormalSpace(study)
    return study, plan


def run_rare(
    study: Study, plan: Plan, out: Path, workers: Workers, resume: bool = False, progress: Progress | None = None
) -> SavedRare:
    """Simulate rare failures and write everything to ``out``; ``progress`` is given the number of flights.

    ``resume``: go on with what the folder holds, if it holds anything; nothing is flown twice, and the result is the
    same as without a stop.  Raises InputError if study or folder is not usable (another simulation's, in use, or one
    that is not resumed), and nothing is overwritten then; FlightError if no more can be flown or written.
    """
    asked = COMMAND | plan.table()
    campaign, result = run_sampler(study, out, partial(simulate, plan), workers, resume, progress, asked)
    likely = sorted(result.failures, key=lambda failure: (failure.distance, failure.number))[:3]
    cases = [
        (f"failure-{place}", int(result.rows[failure.number]["flight"] or 0), True, failure.distance)
        for place, failure in enumerate(likely, 1)
    ]
    saved = SavedRare(out, result, fly_cases(campaign, cases), campaign.referee)
    saved.write(RESULT)
    write_page(saved, out / REPORT)
    return saved
