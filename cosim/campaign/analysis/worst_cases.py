"""The worst flights of a campaign, each with a scenario file that flies it again as it was."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import map_os_errors, read_file, write_whole
from cosim.base.storage.toml import toml_text
from cosim.base.trust import CodeRefusedError, is_code_forbidden
from cosim.campaign.analysis.summary import SUCCESS, unmet_criteria
from cosim.campaign.analysis.table import KINDS, FlightTable, KeyColumn
from cosim.campaign.folder import CASES, SCENARIO
from cosim.campaign.study.plan import flight_of, scenario_of
from cosim.results.report.cards import link
from cosim.results.resolved_scenario import resolve
from cosim.simulation.build import build

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign
    from cosim.campaign.study.study import Study
    from cosim.spec.scenario import Scenario

NONE = "–"  # shown where there is no number
CASE_COLUMNS = ("controller", "flight", "draw", "why", "ended", "drawn", "scenario")


class Case(NamedTuple):
    """Row number of a flight that the page lists for a closer look, and the reason in words."""

    row: int
    why: str


def case_rows(campaign: Campaign, table: FlightTable, named: Sequence[str]) -> list[tuple[str, ...]]:
    """Return table rows of each controller's worst flights, and write a scenario file for each beside the report.

    A row each, as :data:`CASE_COLUMNS` heads it; ``named``: the controllers.
    """
    return [
        (name, *_case_row(campaign, table, case))
        for controller, name in enumerate(named)
        for case in worst_flights(campaign.study, table, controller)
    ]


def worst_flights(study: Study, table: FlightTable, controller: int) -> list[Case]:
    """Return the flights that failed first, those that failed nearest to the middle, and those without a verdict.

    Then the successes with the worst of the first metric; a flight is named once.
    """
    flown = table.rows_of(controller)
    lost = flown & np.isin(table.kind, [KINDS.index("crashed"), KINDS.index("diverged")])
    bad = lost | (flown & (table.kind == KINDS.index("missed")))
    order = [
        ("failed first", lost, table.duration),
        ("fails nearest to the middle of the draws", bad, eccentricity(table)),
        ("failed", flown & (table.kind == KINDS.index("failed")), table.flight.astype(np.float64)),
    ]
    if table.metrics:
        metric = table.metrics[0]
        allowed = study.success.get(metric.name)
        is_smallest_worst = allowed is not None and allowed.max is None
        values = table.values[metric.name] * (1.0 if is_smallest_worst else -1.0)
        why = f"success with the {'smallest' if is_smallest_worst else 'largest'} {metric.label}"
        order.append((why, flown & table.success & np.isfinite(values), values))
    cases: dict[int, Case] = {}
    for why, rows, by in order:
        chosen = np.flatnonzero(rows)
        fresh = [int(row) for row in chosen[np.argsort(by[chosen], kind="stable")] if int(row) not in cases]
        cases |= {row: Case(row, why) for row in fresh[:3]}
    return list(cases.values())


def eccentricity(table: FlightTable) -> Array:
    """Return how extreme the drawn values of each flight are: 0 if all are medians, 1 if all are extreme."""
    size = max(table.flight.size, 1)
    squares = np.zeros(table.flight.size)
    count = 0
    for key in table.keys:
        if key.levels or not np.all(np.isfinite(key.numbers)):
            continue
        _, rank, counts = np.unique(key.numbers, return_inverse=True, return_counts=True)
        middle = (np.cumsum(counts) - 0.5 * counts)[rank] / size  # equal values share their middle rank
        squares += (2.0 * middle - 1.0) ** 2
        count += 1
    return np.sqrt(squares / max(count, 1))


def _case_row(campaign: Campaign, table: FlightTable, case: Case) -> tuple[str, ...]:
    place, refused = write_case(campaign, case.row)
    metric = table.metrics[0] if table.metrics else None
    value = np.nan if metric is None else metric.factor * table.values[metric.name][case.row]
    kind, seconds = KINDS[table.kind[case.row]], table.duration[case.row]
    reason = table.reason[case.row]
    if kind == "missed":
        reason = " and ".join(unmet_criteria(table, case.row, campaign.study.success))
    ended = f"{kind} after {seconds:.2f} s" if np.isfinite(seconds) else f"{kind}, not flown"
    ended += "" if kind == SUCCESS or not reason else f": {reason}"
    ended += "" if metric is None or not np.isfinite(value) else f"; {metric.label} {value:.3g} {metric.unit}"
    return (
        str(table.flight[case.row]),
        str(table.draw[case.row]),
        case.why,
        ended,
        ", ".join(f"{key.label} {_format_value(key, case.row)}" for key in table.keys),
        link(place, place) if place else f"no scenario file: {refused}",
    )


def _format_value(key: KeyColumn, row: int) -> str:
    number = key.numbers[row]
    if not np.isfinite(number):
        return NONE
    return key.levels[int(number)] if key.levels else f"{number:.5g} {key.unit}".strip()


def write_case(campaign: Campaign, row: int) -> tuple[str, str]:
    """Write the scenario of a row and return its path relative to the page, or why there is none.

    Where files go along with it, such as an engine of the user's, it has a folder of its own.  Raises FlightError if it
    cannot be written.
    """
    names = ("flight", "draw", "controller", "seed", *campaign.study.drawn)
    try:
        flight = flight_of(campaign.study, {name: campaign.columns[name][row] for name in names})
        name = f"flight-{flight.number:06d}"
        if is_code_forbidden() and (existing := _existing_case(campaign.folder, name)):
            return existing, ""
        scenario = scenario_of(campaign.study, flight)
        return write_flight(scenario, campaign.folder, name), ""
    except CodeRefusedError:
        return "", "its code is not run to look at it; hexjet fly flies it, and hexjet sweep --resume writes the file"
    except (InputError, FlightError) as error:
        return "", str(error)


def _existing_case(folder: Path, name: str) -> str:
    """Return the path of a case's existing scenario file; empty if there is none."""
    paths = [Path(CASES) / name / SCENARIO, Path(CASES) / f"{name}.toml"]
    return next((path.as_posix() for path in paths if (folder / path).is_file()), "")


def write_flight(scenario: Scenario, folder: Path, name: str) -> str:
    """Write a scenario as it flies below ``folder``, and return its relative path.

    With files it has a folder of its own.  Raises InputError or FlightError if it cannot be built or written.
    """
    with build(scenario) as simulation:
        resolved, files = resolve(simulation)
    link = Path(CASES) / name / SCENARIO if files else Path(CASES) / f"{name}.toml"
    path = folder / link
    for file, content in files.items():
        _write_file(path.with_name(file), content)
    _write_file(path, toml_text(resolved.model_dump(mode="json", exclude_none=True)).encode())
    return link.as_posix()


def _write_file(path: Path, content: Path | bytes) -> None:
    with map_os_errors(FlightError, path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content if isinstance(content, bytes) else read_file(content))
