"""A search from a command line to a folder: what was asked, every flight, what was found, and the flights that show it.

``study/`` has the study and the scenario with all their numbers, ``search.toml`` what was searched, ``flights.jsonl`` a
line a flight, ``search.json`` and ``search.html`` the result, and ``cases/`` the runs of what breaks and of what just
holds: their ``scenario.toml`` flies as it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.spec.controller_name import short_name
from cosim.studies import (
    Row,
    Study,
    Vary,
    Workers,
    check_vary,
    default_draw,
    engine_draw,
    first_repeated,
    levels,
    open_study,
    parse_number,
    parse_vary,
)
from hexjet_prove.search.page import write_page
from hexjet_prove.search.probe import Point, Prober
from hexjet_prove.search.question import Words, empty_cases, fly_row_again, open_question
from hexjet_prove.search.result import Case, SavedSearch
from hexjet_prove.search.search import Edge, Plan, SearchResult, SecondKey, search
from hexjet_prove.search.span import span

RESULT, REPORT = "search.json", "search.html"
SEARCH = Words("search.toml", "search", "a search", "another search", "search")


def resolve_search(
    name: str,
    *,
    vary: Sequence[str],
    over: str | None = None,
    tolerance: Sequence[str] = (),
    seeds: int = 1,
    share: float = 0.0,
    seed: int | None = None,
    **options: Any,
) -> tuple[Study, Plan]:
    """Return the study and the plan that a command line states; ``options`` are those of ``open_study``.

    ``seeds`` flights a point have the scenario's seed, or ``seed``, and those that follow it.  An engine that states
    its uncertainty is drawn by it in all of them but the first, unless ``nominal_engine`` is among the options.
    Raises InputError.
    """
    varied = [parse_vary(text) for text in vary]
    if any(entry.uncertainty for entry in varied):
        raise InputError(
            "--vary engine: an engine's [uncertainty] is drawn with --seeds N, or by hexjet sweep; a search needs "
            "KEY=LO:HI"
        )
    over_entries = _parse_over(over)
    keys = [entry.key for entry in (*varied, *over_entries)]
    repeated = first_repeated(keys)
    if repeated is not None:
        raise InputError(f"--vary {repeated}: is there twice")
    if not varied:
        raise InputError(f"{name}: nothing varies; --vary KEY=LO:HI says what does")
    if over_entries and len(varied) > 1:
        raise InputError(f"--over {over}: goes with one --vary, and there are {len(varied)}")
    plain = [entry.model_copy(update={"levels": None}).text for entry in (*varied, *over_entries)]
    study = open_study(name, vary=plain, design="random", runs=1, **options | {"nominal_engine": True})
    study = study.changed(nominal_engine=bool(options.get("nominal_engine")))
    if len(study.vary) > len(keys):
        raise InputError(f"{name}: is a study, which draws; a search takes its scenario, {study.scenario}")
    fine = _tolerances(tolerance, [entry.key for entry in varied])
    over_key = study.key(over_entries[0].key) if over_entries else None
    plan = Plan(
        spans=tuple(span(entry, study.key(entry.key), fine.get(entry.key)) for entry in varied),
        over=None if over_key is None else SecondKey(over_key, tuple(levels(over_entries[0], over_key))),
        seeds=point_seeds(study, seed, seeds),
        share=share,
        draws_engine=seeds > 1 and default_draw(study.base(), study.nominal_engine, keys)[0] is not None,
    )
    if over_entries:
        check_vary(over_entries[0], study.key(over_entries[0].key))
    return study, plan


def point_seeds(study: Study, first: int | None, count: int) -> tuple[int, ...]:
    """Return the seeds of a point's flights: the ``first``, or the scenario's, and those that follow it.

    Raises InputError.
    """
    first = study.base().seed if first is None else first
    if not 0 <= first <= 2**53 - count:
        raise InputError(f"--seed {first}: must be from 0 to {2**53 - count}")
    return tuple(range(first, first + count))


def _parse_over(text: str | None) -> list[Vary]:
    if text is None:
        return []
    second = parse_vary(text)
    if not second.discrete:
        raise InputError(f"--over {text}: say at how many values, {second.key}=LO:HI:N, or at which, {second.key}=A,B")
    return [second]


def _tolerances(texts: Sequence[str], keys: Sequence[str]) -> dict[str, float]:
    """Parse ``X`` where one key is varied, else ``KEY=X``."""
    tolerances: dict[str, float] = {}
    for text in texts:
        key, equals, number = text.rpartition("=")
        key = key.strip() if equals else keys[0]
        if key not in keys or (not equals and len(keys) > 1):
            raise InputError(f"--tolerance {text}: write it as KEY=X with a key that is varied: {', '.join(keys)}")
        tolerances[key] = parse_number(number, f"--tolerance {text}")
    return tolerances


def run_search(
    study: Study,
    plan: Plan,
    out: Path,
    workers: Workers,
    resume: bool = False,
    progress: Callable[[int], None] = lambda flights: None,
) -> SavedSearch:
    """Search, and leave everything in ``out``; ``progress`` is told how many flights there are so far.

    ``resume``: go on with what the folder holds, if it holds anything; nothing is flown twice.
    Raises InputError if study or folder is not usable (another search's, in use, or one that is not resumed), and
    nothing is overwritten then; FlightError if no more can be flown or written.
    """
    with open_question(study, plan.table(), out, resume, SEARCH) as (flown, journal):
        engine = engine_draw(flown.base()) if plan.draws_engine else None
        prober = Prober(flown, plan.seeds, plan.share, workers, journal, progress, engine)
        result = search(plan, prober)
        searched = SavedSearch(out, result, tuple(_cases(result, prober, empty_cases(out))))
        searched.write(RESULT)
        write_page(searched, out / REPORT)
    return searched


def _cases(result: SearchResult, prober: Prober, folder: Path) -> Iterator[Case]:
    """Fly what breaks and what just holds once more, recorded in full."""
    for name, point, breaks in _points_to_record(result):
        verdict = prober.result(point)
        row = verdict.worst if breaks else _first_success(result, prober, point)
        yield fly_case(prober, point, row, breaks, folder / name)


def fly_case(prober: Prober, point: Point, row: Row, breaks: bool, folder: Path) -> Case:
    """Fly a flight of a search once more, recorded in full in ``folder``, and compare it with its row."""
    seed = int(row["seed"] or 0)
    again = fly_row_again(prober.study, prober.flight(point, seed), row, folder)
    return Case(folder.name, point.controller, breaks, dict(point.values), seed, *again)


def _first_success(result: SearchResult, prober: Prober, point: Point) -> Row:
    """Return the row of the first flight at a point that was a success."""
    rows = [prober.row(point, seed) for seed in result.plan.seeds]
    return next((row for row in rows if row["success"]), rows[0])


def _points_to_record(result: SearchResult) -> Iterator[tuple[str, Point, bool]]:
    """Yield the points whose flights get a folder, with name and whether the vehicle breaks there.

    These are the edges, and of a curve the nearest on each side.
    """
    for controller in result.study.controller_names:
        label = short_name(controller)
        for edge in _edges(result, controller):
            where = re.sub(r"[^A-Za-z0-9_.-]+", "_", f"{label}-{edge.key}-{edge.side}")
            for breaks, value in ((True, edge.breaks), (False, edge.holds)):
                if value is not None:
                    point = result.plan.point(controller, {edge.key: value}, edge.level)
                    yield f"{where}-{'breaks' if breaks else 'holds'}", point, breaks


def _edges(result: SearchResult, controller: str) -> list[Edge]:
    edges = [edge for edge in result.edges if edge.controller == controller]
    if result.plan.over is None:
        return edges
    broken = [edge for edge in edges if edge.deviation is not None]
    nearest = {edge.side: edge for edge in sorted(broken, key=lambda edge: abs(edge.deviation or 0.0), reverse=True)}
    return list(nearest.values())
