"""What came of a campaign as data: counts, probabilities, controllers compared, and what drives success."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.analysis.claim import format_interval, judge_claim
from cosim.campaign.analysis.sensitivity import Ranking, rank_effects
from cosim.campaign.analysis.statistics import (
    Interval,
    MedianDifference,
    Pairs,
    Proportion,
    count_pairs,
    holm,
    mcnemar,
    median_difference,
    newcombe,
    proportion,
    widen,
)
from cosim.campaign.analysis.table import KINDS, FlightTable, Mask, describe_criterion, read_flight_table
from cosim.campaign.workers.flight_row import describe_not_flown
from cosim.results.wording import metric

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign
    from cosim.spec.scenario import Range

SUCCESS = "success"  # name of success among the metrics
NUMBER = re.compile(r"(?<![A-Za-z_])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")  # numbers, replaced in reasons
BRACKETS = re.compile(r"\s*\([^()]*\)")  # parentheses, removed from reasons


class Comparison(NamedTuple):
    """Two controllers, by their indices, on the draws that both have flown."""

    first: int
    second: int
    pairs: Pairs
    interval: Interval | None  # difference, second minus first
    p: float  # p value of McNemar's exact test
    p_holm: float  # p value with Holm's correction
    metrics: dict[str, MedianDifference]  # second minus first, where both completed
    completed: int  # draws that both controllers completed


class Spread(NamedTuple):
    """Spread of one metric of one controller over the flights that completed and have it (SI)."""

    flights: int
    none: int  # completed without it, e.g. not settled
    of: int  # all flights, failed ones included
    low: float  # 5th percentile
    median: float
    high: float  # 95th percentile


def success_fractions(table: FlightTable) -> list[Proportion]:
    """Return the fraction of successes of every controller; a failed flight counts as no success."""
    fractions = []
    for controller, name in enumerate(table.controllers):
        rows, rates = table.rows_of(controller), (table.rates or {}).get(name, (0.0, 0.0))
        found = proportion(int(np.sum(table.success & rows)), int(np.sum(rows)))
        fractions.append(found._replace(wilson=widen(found.wilson, *rates), exact=widen(found.exact, *rates)))
    return fractions


def controller_indices(table: FlightTable) -> range:
    return range(len(table.controllers))


def count_kinds(table: FlightTable, controller: int) -> dict[str, int]:
    """Return how many flights of a controller ended in each kind of outcome."""
    counts = np.bincount(table.kind[table.rows_of(controller)], minlength=len(KINDS))
    return {name: int(count) for name, count in zip(KINDS, counts, strict=True)}


def find_spread(table: FlightTable, controller: int, name: str) -> Spread | None:
    """Return the spread of a metric of a controller; None if no flight has it."""
    flown = table.rows_of(controller)
    values = table.values[name][flown & table.completed]
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    low, median, high = np.quantile(finite, [0.05, 0.5, 0.95])
    of = int(np.count_nonzero(flown))
    return Spread(finite.size, values.size - finite.size, of, float(low), float(median), float(high))


def compare_controllers(table: FlightTable) -> list[Comparison]:
    """Compare every two controllers on the draws that both have flown."""
    compared = [_compare_pair(table, first, second) for first, second in combinations(controller_indices(table), 2)]
    corrected = holm([comparison.p for comparison in compared])
    return [comparison._replace(p_holm=p) for comparison, p in zip(compared, corrected, strict=True)]


def _compare_pair(table: FlightTable, first: int, second: int) -> Comparison:
    rows, others = common_draws(table, first, second)
    counted = count_pairs(table.success[rows], table.success[others])
    completed = table.completed[rows] & table.completed[others]
    metrics = {}
    for name in (metric_spec.name for metric_spec in table.metrics):
        apart = (table.values[name][others] - table.values[name][rows])[completed]
        if (difference := median_difference(apart[np.isfinite(apart)])) is not None:
            metrics[name] = difference
    p = mcnemar(counted)
    return Comparison(first, second, counted, newcombe(counted), p, p, metrics, int(np.sum(completed)))


def common_draws(table: FlightTable, first: int, second: int) -> tuple[Any, Any]:
    """Return the row numbers of two controllers, draw by draw, of the draws that both have flown."""
    rows, others = np.flatnonzero(table.rows_of(first)), np.flatnonzero(table.rows_of(second))
    _, first_rows, second_rows = np.intersect1d(
        table.draw[rows], table.draw[others], assume_unique=True, return_indices=True
    )
    return rows[first_rows], others[second_rows]


def ranked_result(table: FlightTable, name: str) -> Array:
    """Return the result of each row as a number: success as 0 or 1, or a metric, NaN if missing."""
    return table.success.astype(np.float64) if name == SUCCESS else table.values[name]


def rank_keys(table: FlightTable, controller: int, name: str) -> Ranking | None:
    """Return the effect of each key on the success or on a metric of a controller; None if it cannot be estimated."""
    values = ranked_result(table, name)
    rows = table.rows_of(controller) & np.isfinite(values)
    for key in table.keys:
        rows &= np.isfinite(key.numbers)
    numbers = {key.path: key.numbers[rows] for key in table.keys}
    return rank_effects(numbers, [key.path for key in table.keys if key.levels], values[rows])


def count_reasons(table: FlightTable, rows: Mask, success: Mapping[str, Range]) -> Counter[str]:
    """Count the reasons of failed flights; reasons that differ in numbers or brackets count as one."""
    counts: Counter[str] = Counter()
    missed = table.kind == KINDS.index("missed")
    for row in np.flatnonzero(rows & ~table.success):
        counts[
            " and ".join(unmet_criteria(table, int(row), success)) if missed[row] else strip_numbers(table.reason[row])
        ] += 1
    return counts


def strip_numbers(reason: str) -> str:
    """Return a reason without its numbers, so that the reasons of similar flights become one."""
    return NUMBER.sub("…", BRACKETS.sub("", reason)).strip() or "no reason given"


def unmet_criteria(table: FlightTable, row: int, success: Mapping[str, Range]) -> list[str]:
    """Return the criteria of a study that a completed flight does not meet."""
    lines = [f"{metric(name).label} beyond the flight's own limit" for name in table.beyond[row]]
    lines += [f"requirement {name} broken" for name in (table.broken[row] if table.broken else ())]
    for name, allowed in success.items():
        value = table.values[name][row] if name in table.values else np.nan
        of = metric(name)
        if not np.isfinite(value):
            lines.append(f"{of.label}: none")
        elif allowed.max is not None and value > allowed.max:
            lines.append(f"{of.label} above {of.factor * allowed.max:.4g} {of.unit}".rstrip())
        elif allowed.min is not None and value < allowed.min:
            lines.append(f"{of.label} below {of.factor * allowed.min:.4g} {of.unit}".rstrip())
    return lines or ["no success"]


def campaign_summary(campaign: Campaign) -> dict[str, Any]:
    """Return the statistics of a campaign as a table for JSON; a fraction of no flights is null."""
    table = read_flight_table(campaign)
    study = campaign.study
    claim = judge_claim(campaign)
    return {
        "study": study.name,
        "design": study.design,
        "seed": study.seed,
        "flights": int(table.flight.size),
        "planned": campaign.of,
        "finished": int(table.flight.size) == campaign.of if claim is None else claim.is_finished,
        "until": None if claim is None else claim.to_dict() | {"says": list(claim.lines())},
        "referee": dict(campaign.referee),
        "success_is": describe_criterion(study.success),
        "share_is": "share of the grid" if table.grid else "estimated probability",
        "controllers": {
            name: _controller_dict(table, controller, proportion, fixed_sample=claim is None and not table.grid)
            for controller, (name, proportion) in enumerate(
                zip(table.controllers, success_fractions(table), strict=True)
            )
        },
        "not_flown": describe_not_flown(len(table.not_flown), table.not_flown[0]) if table.not_flown else None,
        "comparisons": [_comparison_dict(table, comparison) for comparison in compare_controllers(table)],
        "reasons": {
            name: dict(count_reasons(table, table.rows_of(controller), study.success).most_common(10))
            for controller, name in enumerate(table.controllers)
        },
        "drives_success": {
            name: _rank_dict(rank_keys(table, controller, SUCCESS)) for controller, name in enumerate(table.controllers)
        },
        "wall_s": float(np.nansum(np.array(campaign.columns.get("wall_s", []), dtype=np.float64))),
    }


def _controller_dict(table: FlightTable, controller: int, success: Proportion, fixed_sample: bool) -> dict[str, Any]:
    spreads = {metric_spec.name: find_spread(table, controller, metric_spec.name) for metric_spec in table.metrics}
    return {
        "flights": success.of,
        "outcomes": count_kinds(table, controller),
        "success": success.value,
        "wilson_95": list(success.wilson) if fixed_sample and success.of else None,
        "clopper_pearson_95": list(success.exact) if fixed_sample and success.of else None,
        "metrics": {
            name: {
                "flights": quartiles.flights, "without": quartiles.none, "of": quartiles.of,
                "p05": quartiles.low, "median": quartiles.median, "p95": quartiles.high,
            }
            for name, quartiles in spreads.items()
            if quartiles is not None
        },
    }  # fmt: skip


def _comparison_dict(table: FlightTable, comparison: Comparison) -> dict[str, Any]:
    return {
        "first": table.controllers[comparison.first],
        "second": table.controllers[comparison.second],
        "draws": comparison.pairs.draws,
        "both": comparison.pairs.both,
        "only_first": comparison.pairs.first,
        "only_second": comparison.pairs.second,
        "neither": comparison.pairs.neither,
        "difference": comparison.pairs.difference,
        "newcombe_95": None if table.grid or comparison.interval is None else list(comparison.interval),
        "mcnemar_p": None if table.grid else comparison.p,
        "mcnemar_p_holm": None if table.grid else comparison.p_holm,
        "metrics": {
            name: {
                "draws": difference.draws,
                "median_difference": difference.median,
                "interval_95": None if table.grid or difference.interval is None else list(difference.interval),
                "wilcoxon_p": None if table.grid else difference.p,
            }
            for name, difference in comparison.metrics.items()
        },
    }


def _rank_dict(ranking: Ranking | None) -> dict[str, Any] | None:
    if ranking is None:
        return None
    return {
        "flights": ranking.flights,
        "noise_floor": ranking.floor,
        "keys": [
            {
                "key": effect.key, "first_order": effect.index, "interval_95": list(effect.interval),
                "above_noise": effect.real, "spearman": effect.rank, "partial": effect.partial,
            }
            for effect in ranking.effects
        ],
    }  # fmt: skip


def with_referee(lines: Iterable[str], referee: Mapping[str, Any]) -> list[str]:
    """Return lines with those on JSBSim's check of the flights added; they come first if it failed."""
    says = referee.get("says", [])
    return [*lines, *says] if referee.get("confirmed", True) else [*says, *lines]


def success_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Return lines for a terminal: how often each controller succeeds, and how the other flights ended."""
    whole = "" if summary["finished"] else f" of {summary['planned']}: not finished"
    yield f"{summary['flights']:,} flights{whole}; success: {summary['success_is']}"
    for line in (summary["until"] or {"says": []})["says"]:
        yield f"  {line}"
    for name, entry in summary["controllers"].items():
        yield f"  {name}: {_describe_probability(entry)}{_count_failures(entry['outcomes'])}"
    if summary["not_flown"]:
        yield f"  {summary['not_flown']}"


def spread_table(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return titles and rows for a terminal: the metrics' medians, a column a controller, with the flights behind each.

    Where there is one controller, with the middle 90 % as well.
    """
    controllers = summary["controllers"]
    names = list(dict.fromkeys(name for entry in controllers.values() for name in entry["metrics"]))
    if len(controllers) != 1:
        rows = [
            [metric(name).label, metric(name).unit]
            + [_format_median(name, entry["metrics"].get(name)) for entry in controllers.values()]
            for name in names
        ]
        return ["median", "", *controllers], rows
    (only,) = controllers.values()
    titles = ["metric", "", "median", "5 %", "95 %"]
    return titles, [
        [metric(name).label, metric(name).unit, _format_median(name, only["metrics"][name])]
        + [f"{metric(name).factor * only['metrics'][name][key]:.3g}" for key in ("p05", "p95")]
        for name in names
    ]


def comparison_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Return lines for a terminal: each controller against the first, draw by draw, and what drives success.

    Where there are more than three pairs the others are left to the page, and that is said.
    """
    pairs = summary["comparisons"]
    max_pairs = 3  # pairs of controllers that are printed
    listed = pairs if len(pairs) <= max_pairs else [pair for pair in pairs if pair["first"] == pairs[0]["first"]]
    for pair in listed:
        yield f"  {_describe_comparison(pair)}"
    if len(listed) < len(pairs):
        yield f"  {len(pairs) - len(listed)} more pairs are in the report; each p is corrected for all {len(pairs)}"
    for name, entry in summary["drives_success"].items():
        keys = [key for key in (entry or {"keys": []})["keys"] if key["above_noise"]]
        if keys:
            strongest = ", ".join(f"{key['key']} {100.0 * key['first_order']:.0f} %" for key in keys[:4])
            yield f"  {name}, what drives success: {strongest} of its variance"


def _format_median(name: str, entry: Mapping[str, Any] | None) -> str:
    """Format a median, with its number of flights if some have no value."""
    if entry is None:
        return "–"
    median = f"{metric(name).factor * entry['median']:.3g}"
    return median if entry["flights"] == entry["of"] else f"{median} ({entry['flights']} of {entry['of']})"


def _describe_probability(entry: Mapping[str, Any]) -> str:
    if entry["success"] is None:
        return "no flight yet"
    text = f"{100.0 * entry['success']:.1f} % of {entry['flights']:,}"
    return text if entry["wilson_95"] is None else f"{text} ({format_interval(entry['wilson_95'])})"


def _count_failures(outcomes: Mapping[str, int]) -> str:
    named = [f"{count} {name}" for name, count in outcomes.items() if count and name != SUCCESS]
    return f"; {', '.join(named)}" if named else ""


def _describe_comparison(entry: Mapping[str, Any]) -> str:
    if entry["difference"] is None:
        return f"{entry['first']} and {entry['second']} have flown no draw in common"
    text = f"{entry['second']} against {entry['first']}: {100.0 * entry['difference']:+.1f} points"
    if entry["newcombe_95"] is not None:
        low, high = (100.0 * end for end in entry["newcombe_95"])
        text += f" ({low:+.1f} to {high:+.1f}), McNemar p = {entry['mcnemar_p_holm']:.2g}"
    return f"{text}, {entry['only_second']} draws won and {entry['only_first']} lost of {entry['draws']}"
