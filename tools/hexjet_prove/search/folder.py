"""A search from a command line to a folder: every flight, what was found, and the flights that show it.

``search.json`` and ``search.html`` are the result, and ``cases/`` has the runs of what breaks and of what just holds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.spec.controller_name import short_name
from cosim.studies import (
    Progress,
    Study,
    Vary,
    Workers,
    check_vary,
    default_draw,
    first_repeated,
    levels,
    open_study,
    parse_number,
    parse_vary,
    run_sampler,
)
from hexjet_prove.search.page import write_page
from hexjet_prove.search.probe import Point
from hexjet_prove.search.question import SavedResult, fly_cases
from hexjet_prove.search.search import Edge, Plan, SearchResult, SecondKey, search
from hexjet_prove.search.span import span

RESULT, REPORT = "search.json", "search.html"  # files of a search
COMMAND = {"command": "hexjet search"}  # command in the folder's record
SavedSearch = SavedResult[SearchResult]


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
    its uncertainty is drawn by it in all but the first, unless ``nominal_engine`` is an option.  Raises InputError.
    """
    varied = [parse_vary(text) for text in vary]
    if any(entry.uncertainty for entry in varied):
        raise InputError(
            "vary engine: an engine's [uncertainty] is drawn with seeds N, or by hexjet sweep; a search needs KEY=LO:HI"
        )
    over_entries = _parse_second_key(over)
    keys = [entry.key for entry in (*varied, *over_entries)]
    repeated = first_repeated(keys)
    if repeated is not None:
        raise InputError(f"vary {repeated}: is there twice")
    if not varied:
        raise InputError(f"{name}: nothing varies; vary KEY=LO:HI says what does")
    if over_entries and len(varied) > 1:
        raise InputError(f"over {over}: goes with one vary, and there are {len(varied)}")
    plain = [entry.model_copy(update={"levels": None}).text for entry in (*varied, *over_entries)]
    study = open_study(name, vary=plain, design="random", runs=1, **options | {"nominal_engine": True})
    study = study.changed(nominal_engine=bool(options.get("nominal_engine")))
    if len(study.vary) > len(keys):
        raise InputError(f"{name}: is a study, which draws; a search takes its scenario, {study.scenario}")
    fine = _parse_tolerances(tolerance, [entry.key for entry in varied])
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
    if plan.draws_engine:
        study = study.changed(vary=[*study.vary, parse_vary("engine")])
    return study, plan


def point_seeds(study: Study, first: int | None, count: int) -> tuple[int, ...]:
    """Return the seeds of a point's flights, beginning at ``first`` or the scenario's.

    Raises InputError.
    """
    first = study.base().seed if first is None else first
    if not 0 <= first <= 2**53 - count:
        raise InputError(f"seed {first}: must be from 0 to {2**53 - count}")
    return tuple(range(first, first + count))


def _parse_second_key(text: str | None) -> list[Vary]:
    if text is None:
        return []
    second = parse_vary(text)
    if not second.discrete:
        raise InputError(f"over {text}: say at how many values, {second.key}=LO:HI:N, or at which, {second.key}=A,B")
    return [second]


def _parse_tolerances(texts: Sequence[str], keys: Sequence[str]) -> dict[str, float]:
    """Parse ``X`` for one key, else ``KEY=X``."""
    tolerances: dict[str, float] = {}
    for text in texts:
        key, equals, number = text.rpartition("=")
        key = key.strip() if equals else keys[0]
        if key not in keys or (not equals and len(keys) > 1):
            raise InputError(f"tolerance {text}: write it as KEY=X with a key that is varied: {', '.join(keys)}")
        tolerances[key] = parse_number(number, f"tolerance {text}")
    return tolerances


def run_search(
    study: Study, plan: Plan, out: Path, workers: Workers, resume: bool = False, progress: Progress | None = None
) -> SavedSearch:
    """Search and write everything to ``out``; ``progress`` is given the number of flights.

    ``resume``: go on with what the folder holds, if it holds anything; nothing is flown twice, and what is found is the
    same as without a stop.  Raises InputError if study or folder is not usable (another search's, in use, or one that
    is not resumed), and nothing is overwritten then; FlightError if no more can be flown or written.
    """
    asked = COMMAND | plan.table()
    campaign, result = run_sampler(study, out, partial(search, plan), workers, resume, progress, asked)
    cases = ((name, _flight(result, point, breaks), breaks, None) for name, point, breaks in _points_to_record(result))
    saved = SavedSearch(out, result, fly_cases(campaign, cases), campaign.referee)
    saved.write(RESULT)
    write_page(saved, out / REPORT)
    return saved


def _flight(result: SearchResult, point: Point, breaks: bool) -> int:
    """Return the flight that shows that a point breaks, or holds."""
    rows = [result.prober.rows[point, seed] for seed in result.plan.seeds]
    holds = next((row for row in rows if row["success"]), rows[0])
    return int((result.prober.result(point).worst if breaks else holds)["flight"] or 0)


def _points_to_record(result: SearchResult) -> Iterator[tuple[str, Point, bool]]:
    """Yield the points to be recorded, with name and whether the vehicle fails there.

    These are the edges, and of a curve the nearest on each side.
    """
    for controller in result.study.controller_names:
        label = short_name(controller)
        for edge in _select_edges(result, controller):
            where = re.sub(r"[^A-Za-z0-9_.-]+", "_", f"{label}-{edge.key}-{edge.side}")
            for breaks, value in ((True, edge.breaks), (False, edge.holds)):
                if value is not None:
                    point = result.plan.point(controller, {edge.key: value}, edge.level)
                    yield f"{where}-{'breaks' if breaks else 'holds'}", point, breaks


def _select_edges(result: SearchResult, controller: str) -> list[Edge]:
    edges = [edge for edge in result.edges if edge.controller == controller]
    if result.plan.over is None:
        return edges
    broken = [edge for edge in edges if edge.deviation is not None]
    nearest = {edge.side: edge for edge in sorted(broken, key=lambda edge: abs(edge.deviation or 0.0), reverse=True)}
    return list(nearest.values())
