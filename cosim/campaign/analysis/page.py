"""The page of a campaign: what its template asks for, and the scenario files of the flights it points to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.storage.files import parse_json
from cosim.campaign.analysis.claim import judge_claim
from cosim.campaign.analysis.figures import KIND_COLOURS, campaign_figures
from cosim.campaign.analysis.sensitivity import Ranking, joint
from cosim.campaign.analysis.stability_map import MAP_KEYS, map_tables
from cosim.campaign.analysis.summary import (
    SUCCESS,
    compare_controllers,
    controller_indices,
    count_kinds,
    count_reasons,
    find_spread,
    rank_keys,
    ranked_result,
    success_fractions,
)
from cosim.campaign.analysis.table import FlightTable, KeyColumn, describe_criterion, if_here, read_flight_table
from cosim.campaign.analysis.worst_cases import case_rows
from cosim.campaign.folder import REPORT
from cosim.campaign.study.engine_draw import DRAWN_BY
from cosim.campaign.study.keys import FLOWN_STATIONS
from cosim.campaign.workers.flight_row import describe_not_flown
from cosim.results.report.page import render
from cosim.results.report.plot import run_colour

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign
    from cosim.campaign.study.study import Correlation, Study, Vary

MAX_REASONS = 12
DESIGNS = {
    "grid": "a grid of every combination",
    "latin-hypercube": "a Latin hypercube",
    "random": "independent random draws",
    "sobol": "scrambled Sobol points",
}
INTERVALS = {
    "random": "The draws are independent of each other, as both intervals suppose.",
    "latin-hypercube": (
        "Both intervals suppose independent draws. A Latin hypercube spreads its draws evenly over each key: as a rule "
        "its shares vary less, so that the intervals are rather too wide than too narrow."
    ),
    "sobol": (
        "Both intervals suppose independent draws. Sobol points are more even than that, so that the intervals are an "
        "approximation, as a rule too wide."
    ),
}
STOPPED = (
    "Both suppose a number of flights that was fixed before. This study stops by its rule: what holds is what is said "
    "of its claim above."
)
NONE = "–"
TEMPLATE = Path(__file__).parent / "templates" / "campaign.html"


def write_campaign_report(campaign: Campaign) -> Path:
    """Write the page into the campaign's folder, with the scenario files that it links to, and return its path.

    Raises FlightError if a file cannot be written.
    """
    path = campaign.folder / REPORT
    figures, values = report_contents(campaign)
    render(TEMPLATE, path, figures, **values)
    return path


def report_contents(campaign: Campaign) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the figures of the report and the values for its template; write the scenario files of its cases."""
    table, study = read_flight_table(campaign), campaign.study
    proportions = success_fractions(table)
    names, controllers = [SUCCESS, *(metric.name for metric in table.metrics)], controller_indices(table)
    rankings = {name: [rank_keys(table, controller, name) for controller in controllers] for name in names}
    leading = next((name for name in names if any(rankings[name])), SUCCESS)
    order = order_by_influence(table, rankings[leading])
    figures = campaign_figures(table, proportions, rankings, order)
    claim = judge_claim(campaign)
    if len(table.keys) > 1 and table.flight.size:
        mapped = order[:MAP_KEYS]
        figures["map-tables"] = map_tables(
            table, mapped, strongest_pair(table, mapped, leading, rankings[leading]), leading
        )
    return figures, {
        "study": study,
        "controllers": [
            {
                "name": name,
                "colour": run_colour(controller),
                "share": proportion,
                "kinds": count_kinds(table, controller),
            }
            for controller, (name, proportion) in enumerate(zip(table.controllers, proportions, strict=True))
        ],
        "table": table,
        "finished": claim.is_finished if claim is not None else table.flight.size == campaign.of,
        "planned": campaign.of,
        "claims": [] if claim is None else list(claim.lines()),
        "facts": head_rows(campaign, table),
        "success_is": describe_criterion(study.success),
        "interval_note": INTERVALS.get(study.design, "") if claim is None else STOPPED,
        "kind_colours": KIND_COLOURS,
        "keys": key_rows(study, table),
        "correlations": [describe_correlation(correlation) for correlation in study.correlate],
        "comparisons": compare_controllers(table),
        "spreads": [[find_spread(table, each, metric.name) for each in controllers] for metric in table.metrics],
        "rankings": {
            name: [(number, found) for number, found in enumerate(ranking) if found is not None]
            for name, ranking in rankings.items()
            if any(ranking)
        },
        "labels": {SUCCESS: SUCCESS} | {metric.name: metric.label for metric in table.metrics},
        "reasons": reason_rows(campaign, table),
        "cases": case_rows(campaign, table),
        "warnings": warnings(campaign, table, stops=claim is not None),
        "most_curves": len([name for name in figures if name.startswith("key-")]),
        "python": python_lines(campaign.folder),
        "made_from": collect_sources(campaign),
    }


# ---- the head


def head_rows(campaign: Campaign, table: FlightTable) -> list[tuple[str, str]]:
    """Return name and value of what was flown, without anything of the machine."""
    study = campaign.study
    wall = np.array([seconds or 0.0 for seconds in campaign.columns.get("wall_s", [])], dtype=np.float64)
    simulated, base = float(np.nansum(table.duration)), if_here(study.base)
    lines = [
        ("scenario", base.name if base else study.scenario),
        ("design", DESIGNS[study.design]),
        ("draws", f"{study.draws:,}" + (f", {study.repeats} at each point" if study.repeats > 1 else "")),
        ("controllers", ", ".join(table.controllers)),
        ("seed", str(study.seed)),
        ("engine", if_here(lambda: study.engine_note) or ""),
        ("simulated", format_duration(simulated)),
    ]
    if wall.sum() > 0.0:
        lines.append(("work", f"{format_duration(float(wall.sum()))}, {1e3 * float(wall.mean()):.0f} ms a flight"))
        lines.append(("workers", str(len(set(campaign.columns.get("worker", []))))))
    return [line for line in lines if line[1] not in ("", "0")]


def format_duration(seconds: float) -> str:
    """Return a time [s] as text in hours, minutes or seconds."""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"


def key_rows(study: Study, table: FlightTable) -> list[dict[str, str]]:
    """Return for each varied key its distribution, its nominal value and the range of values that were flown."""
    columns = {key.path: key for key in table.keys}
    rows = []
    by_key = {vary.key: describe_draws(vary) for vary in study.vary}
    for name in study.drawn:
        key = columns.get(name)
        if key is None and name.startswith(FLOWN_STATIONS):
            continue
        varied = if_here(study.key, name)
        rows.append(
            {
                "path": name,
                "drawn": by_key.get(name, DRAWN_BY),
                "nominal": NONE if varied is None or varied.nominal is None else _value_text(varied.nominal),
                "observed": NONE if key is None else _observed_range(key),
                "unit": "" if key is None else key.unit,
            }
        )
    return rows


def _observed_range(key: KeyColumn) -> str:
    finite = key.numbers[np.isfinite(key.numbers)]
    if not finite.size:
        return NONE
    if key.levels:
        return ", ".join(key.levels[int(code)] for code in np.unique(finite))
    return f"{finite.min():.4g} to {finite.max():.4g}"


def describe_draws(vary: Vary) -> str:
    """Describe a distribution."""
    relative = {"": "", "factor": ", times the nominal value", "offset": ", added to the nominal value"}[vary.relative]
    return _distribution(vary) + relative


def _distribution(vary: Vary) -> str:
    if vary.uncertainty:
        return DRAWN_BY
    if vary.values is not None:
        return f"one of {', '.join(map(_value_text, vary.values))}"
    if vary.range is not None:
        span = f"{vary.range[0]:g} to {vary.range[1]:g}"
        if vary.levels is not None:
            return f"{vary.levels} levels, {span}" + (", evenly in the logarithm" if vary.scale == "log" else "")
        return f"uniform in the logarithm, {span}" if vary.scale == "log" else f"uniform, {span}"
    if vary.triangular is not None:
        form = vary.triangular
        return f"triangular, {form.min:g} to {form.max:g}, most often {form.mode:g}"
    if vary.normal is not None:
        text = f"normal, mean {vary.normal.mean:g}, standard deviation {vary.normal.sd:g}"
        return text + _bounds(vary.normal.min, vary.normal.max)
    assert vary.lognormal is not None
    text = f"lognormal, median {vary.lognormal.median:g}, sigma {vary.lognormal.sigma:g}"
    return text + _bounds(vary.lognormal.min, vary.lognormal.max)


def _bounds(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    if low is None:
        return f", cut off above {high:g}"
    return f", cut off below {low:g}" if high is None else f", cut off outside {low:g} to {high:g}"


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def describe_correlation(correlation: Correlation) -> str:
    """Describe one requested correlation."""
    return f"{correlation.keys[0]} with {correlation.keys[1]}: {correlation.rank:g}"


def warnings(campaign: Campaign, table: FlightTable, stops: bool = False) -> list[str]:
    """Return the reasons for which a reader should doubt a number of the report.

    ``stops``: by a rule of its study, so that missing flights are none.
    """
    lines = []
    finished, planned = table.flight.size, campaign.of
    if finished < planned and not stops:
        lines.append(
            f"The study is not finished: {finished:,} of {planned:,} flights ({finished / planned:.1%}). "
            "Flights that are lost early end early, so that the finished ones may look worse than all will."
            + (" Of a grid only a part is here." if table.grid else "")
        )
    if table.not_flown:
        lines.append(f"{describe_not_flown(len(table.not_flown), table.not_flown[0])}; all reasons are below.")
    changed = [name for name, values in collect_sources(campaign).items() if len(values) > 1]
    if changed:
        lines.append(
            f"What the flights were made from changed while the study was flown: {', '.join(changed)}. "
            "Flights from before and after do not belong together."
        )
    return lines


def collect_sources(campaign: Campaign) -> dict[str, list[str]]:
    """Return by name every version and file hash of aircraft and engines with which flights were computed."""
    sources: dict[str, list[str]] = {}
    for text in dict.fromkeys(campaign.columns.get("inputs", [])):
        for part in parse_json(str(text), "inputs", finite=False).values() if text else ():
            for name, value in part.items():
                sources.setdefault(name, [])
                sources[name] += [value] if value not in sources[name] else []
    return sources


# ---- what drives it


def order_by_influence(table: FlightTable, rankings: Sequence[Ranking | None]) -> list[int]:
    """Return the keys' indices by their largest sensitivity with any controller; unranked keys last, in order."""
    largest = dict.fromkeys((key.path for key in table.keys), -1.0)
    for ranking in rankings:
        for effect in ranking.effects if ranking else ():
            largest[effect.key] = max(largest[effect.key], effect.index)
    return sorted(range(len(table.keys)), key=lambda key: -largest[table.keys[key].path])


def strongest_pair(
    table: FlightTable, keys: Sequence[int], name: str, rankings: Sequence[Ranking | None]
) -> tuple[int, int]:
    """Return the two of these keys that explain most of a result together, over all controllers.

    The first two, which explain most one at a time, unless others are above them by more than chance.
    """
    values = ranked_result(table, name)
    together = {}
    for first, second in combinations(keys, 2):
        a, b = table.keys[first].numbers, table.keys[second].numbers
        finite = np.isfinite(values) & np.isfinite(a) & np.isfinite(b)
        together[first, second] = sum(
            _joint(finite & table.rows_of(controller), a, b, values) for controller in controller_indices(table)
        )
    default_pair = (keys[0], keys[1])
    best = max(together, key=lambda pair: together[pair])
    return (
        best
        if together[best] > together[default_pair] + sum(ranking.floor for ranking in rankings if ranking)
        else default_pair
    )


def _joint(rows: Any, first: Array, second: Array, values: Array) -> float:
    some = int(np.sum(rows)) > 1 and np.ptp(values[rows]) > 0.0
    return max(0.0, joint(first[rows], second[rows], values[rows])) if some else 0.0


# ---- why flights were no success, and the data


def reason_rows(campaign: Campaign, table: FlightTable) -> list[dict[str, Any]]:
    """Return the reasons of flights without success, the commonest first, with the count of every controller."""
    counted = [
        count_reasons(table, table.rows_of(controller), campaign.study.success)
        for controller in controller_indices(table)
    ]
    names = sorted(
        {name for counter in counted for name in counter},
        key=lambda name: (-sum(counter[name] for counter in counted), name),
    )
    rows = [{"reason": name, "counts": [counter[name] for counter in counted]} for name in names[:MAX_REASONS]]
    others = names[MAX_REASONS:]
    if others:
        counts = [sum(counter[name] for name in others) for counter in counted]
        rows.append({"reason": f"{len(others)} other reasons", "counts": counts})
    return rows


def python_lines(folder: Path) -> list[str]:
    """Return the lines of Python that open the campaign."""
    return [
        "from cosim.campaign import open_campaign",
        f"campaign = open_campaign({folder.as_posix()!r})",
        'campaign.columns["outcome"]  # one entry a flight, in the order of their numbers',
    ]
