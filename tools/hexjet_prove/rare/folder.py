"""A rare failure's probability from a command line to a folder.

``study/`` has the study and the scenario with all their numbers, ``rare.toml`` what was asked, ``flights.jsonl`` a line
a flight as it came, ``flights.parquet`` a row a flight in the order in which they were asked for, ``rare.json`` and
``rare.html`` the result, and ``cases/`` the runs of the failures that are most likely: their ``scenario.toml`` flies as
it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from cosim.studies import MAX_TESTED, Flight, NormalSpace, Study, Workers, only_controller, open_study, write_table
from cosim.studies import row_kinds as kinds
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.page import write_page
from hexjet_prove.rare.simulation import ASKED, Failure, Plan, RareCase, RareResult, SavedRare, simulate
from hexjet_prove.search.question import Words, empty_cases, fly_row_again, open_question

ROWS, RESULT, REPORT = "flights.parquet", "rare.json", "rare.html"
RARE = Words("rare.toml", "simulation of rare failures", "one", "another one", "process")
CASES_RECORDED = 3  # failures that are flown again, the most likely first


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
    # the points are not those of a study's design; as many runs as any claim of its file may need
    study = open_study(name, **options | {"design": "random", "runs": MAX_TESTED})
    study = study.changed(until=None, runs=budget)
    only_controller(study, ASKED)
    NormalSpace(study)
    return study, plan


def run_rare(
    study: Study,
    plan: Plan,
    out: Path,
    workers: Workers,
    resume: bool = False,
    progress: Callable[[int], None] = lambda flights: None,
) -> SavedRare:
    """Simulate, and leave everything in ``out``; ``progress`` is told how many flights there are so far.

    ``resume``: go on with what the folder holds, if it holds anything; nothing is flown twice, and the result is the
    same as without a stop.  Raises InputError if study or folder is not usable (another simulation's, in use, or one
    that is not resumed), and nothing is overwritten then; FlightError if no more can be flown or written.
    """
    with open_question(study, plan.table(), out, resume, RARE) as (flown, journal):
        result = simulate(flown, plan, workers, journal, progress)
        saved = SavedRare(out, result, tuple(_cases(result, empty_cases(out))))
        columns = {"repeat": int, "group": int, "level": int} | kinds(result.study) | {"margin": float}
        table = {name: [row.get(name) for row in result.rows] for name in columns}
        write_table(out / ROWS, table, kinds=columns)
        saved.write(RESULT)
        write_page(saved, out / REPORT)
    return saved


def _cases(result: RareResult, folder: Path) -> Iterator[RareCase]:
    """Fly the most likely failures once more, recorded in full."""
    likely = sorted(result.failures, key=lambda failure: (failure.distance, failure.number))
    for place, failure in enumerate(likely[:CASES_RECORDED], 1):
        yield _fly_again(result, failure, folder / f"failure-{place}")


def _fly_again(result: RareResult, failure: Failure, folder: Path) -> RareCase:
    row = result.rows[failure.number]
    seed, values = int(row["seed"] or 0), {name: row[name] for name in result.study.drawn}
    flight = Flight(failure.number, failure.number, result.controller, seed, values)  # type: ignore[arg-type]
    again = fly_row_again(result.study, flight, row, folder)
    return RareCase(folder.name, failure.number, failure.distance, seed, values, again.reason, again.same)
