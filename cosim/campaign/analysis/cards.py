"""The cards of a campaign's page that have its statistics: successes, pairs of controllers, influences, metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from cosim.campaign.analysis.claim import format_interval
from cosim.campaign.analysis.sensitivity import Ranking
from cosim.campaign.analysis.statistics import Interval, Proportion
from cosim.campaign.analysis.summary import (
    SUCCESS,
    Spread,
    compare_controllers,
    controller_indices,
    count_kinds,
    find_spread,
)
from cosim.campaign.analysis.table import KINDS, FlightTable
from cosim.results.report.cards import Card, code

NONE = "–"  # shown where there is no number
GRID_NOTE = "Shares of the grid's points and not probabilities: every combination counts alike, however likely it is."
INTERVALS_NOTE = (  # note on Wilson's and the exact interval
    "Thick is Wilson's interval, which holds 95 % on average; thin is Clopper and Pearson's exact one, which never "
    "holds less: quote it where a requirement must be shown to hold."
)
OUTCOMES_NOTE = "Missed: flew to its end, outside what counts as success. Failed: not flown to a verdict; no success."
PAIR_COLUMNS = (  # heads of the paired comparison
    "second against first", "draws", "both succeed", "only the second", "only the first", "neither",
    "difference [points]", "95 %, paired", "p, McNemar",
)  # fmt: skip
COMMON_DRAWS_NOTE = "Only draws that both controllers have flown count: the same numbers, noise and turbulence."
PAIRED_TEST_NOTE = (  # note on the paired comparison's test
    "The interval is Newcombe's for pairs (method 10); p, of McNemar's exact test, is corrected for the number of "
    "comparisons (Holm)."
)
DIFFERENCE_COLUMNS = ("metric", "draws", "median difference", "95 %", "p, Wilcoxon", "unit")  # table of differences
DIFFERENCES = (  # note on median differences
    "Negative: the second's is smaller. Only flights that completed and have the metric count: where one controller "
    "loses the hard draws, both are compared on the easier ones. The interval is bounded by order statistics; p is not "
    "corrected for the number of metrics."
)
RANKING_COLUMNS = ("controller", "key", "index [%]", "95 %", "rank correlation", "95 %", "partial", "")
FIRST_ORDER_NOTE = (  # note on first-order indices
    "First-order index: the share of the variance that would go if the key were known, for an effect of any shape, "
    "corrected for chance. Shaded is what the largest of all keys reaches by chance in 19 of 20 cases; a pale bar is "
    "not above it. A key that acts only together with others has no bar: the map shows it."
)
CORRELATED_KEYS_NOTE = "Correlated keys share what they explain; the partial correlation holds the others."
NO_RANKING_NOTE = "Too few flights (30 are needed), or they all came out alike: nothing can be ranked."
SPREADS_NOTE = (  # note on the spread of metrics
    "Median, the span of the middle 90 %, and of how many flights: those that completed and have the metric. Where "
    "many failed these are the survivors' figures. The curves are of all flights: what one lacks of 100 % did not "
    "complete, or has none."
)


def format_span(ends: Interval | None, form: str, factor: float = 1.0) -> str:
    """Return both ends of an interval as text; an empty string for None."""
    return "" if ends is None else f"{factor * ends[0]:{form}} to {factor * ends[1]:{form}}"


def _as_points(fraction: float | None) -> str:
    if fraction is None:
        return NONE
    text = f"{100.0 * fraction:+.1f}"
    return text[1:] if text[1:] == "0.0" else text


def _format_signed(value: float) -> str:
    return f"{value:+.3g}" if value else "0"


def _format_p_value(p: float) -> str:
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def _card(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    text: str,
    is_grid: bool,
    is_folded: bool = False,
    figure: str | Sequence[str] = "",
) -> Card:
    """Return a card of a page; for a grid study, which is no random sample, without intervals and tests."""
    kept = [n for n, column in enumerate(columns) if not (is_grid and column.startswith(("95 %", "p, ")))]
    return Card(title, [columns[n] for n in kept], [[row[n] for n in kept] for row in rows], text, figure,
                is_folded=is_folded)  # fmt: skip


def success_card(table: FlightTable, named: Sequence[str], found: Sequence[Proportion], note: str) -> Card:
    """Return how often each controller succeeds, and how its other flights ended."""
    kinds = [name for name in KINDS if name != SUCCESS]
    share = "share [%]" if table.grid else "probability [%]"
    rows = [
        (
            name, f"{each.of:,}", f"{each.hits:,}", NONE if each.value is None else f"{100.0 * each.value:.1f}",
            format_interval(each.wilson), format_interval(each.exact),
            *(f"{count_kinds(table, number)[kind]:,}" for kind in kinds),
        )
        for number, (name, each) in enumerate(zip(named, found, strict=True))
    ]  # fmt: skip
    columns = ("controller", "flights", "successes", share, "95 %, Wilson", "95 %, exact", *kinds)
    text = f"{GRID_NOTE if table.grid else f'{INTERVALS_NOTE} {note}'} {OUTCOMES_NOTE}"
    title = "Success over the grid" if table.grid else "Probability of success"
    return _card(title, columns, rows, text, table.grid)


def comparison_cards(table: FlightTable, named: Sequence[str]) -> Iterator[Card]:
    """Yield the cards that compare controllers on the same draws: successes, then metrics."""
    compared = compare_controllers(table)
    against = [Markup("{} against {}").format(named[each.second], named[each.first]) for each in compared]
    rows = [
        (
            name, *(f"{count:,}" for count in (pairs.draws, pairs.both, pairs.second, pairs.first, pairs.neither)),
            _as_points(pairs.difference),
            "" if each.interval is None else f"{_as_points(each.interval[0])} to {_as_points(each.interval[1])}",
            _format_p_value(each.p_holm),
        )
        for name, each in zip(against, compared, strict=True)
        for pairs in (each.pairs,)
    ]  # fmt: skip
    if rows:
        text = f"{COMMON_DRAWS_NOTE} {'Counts of points, and no test.' if table.grid else PAIRED_TEST_NOTE}"
        yield _card("Controllers on the same draws", PAIR_COLUMNS, rows, text, table.grid)
    for name, each in zip(against, compared, strict=True):
        differences = [
            (
                metric.label, f"{found.draws:,}", _format_signed(metric.factor * found.median),
                "" if found.interval is None
                else " to ".join(_format_signed(metric.factor * end) for end in found.interval),
                _format_p_value(found.p), metric.unit,
            )
            for metric in table.metrics
            if (found := each.metrics.get(metric.name)) is not None
        ]  # fmt: skip
        if differences:
            title = Markup("Metrics, {}, over the {:,} draws that both completed").format(name, each.completed)
            yield _card(title, DIFFERENCE_COLUMNS, differences, DIFFERENCES, table.grid, is_folded=len(compared) > 1)


def ranking_cards(
    table: FlightTable, named: Sequence[str], rankings: Mapping[str, Sequence[Ranking | None]], is_correlated: bool
) -> Iterator[Card]:
    """Yield the cards that rank keys by their influence on success and, folded, on each metric."""
    labels = {SUCCESS: SUCCESS} | {metric.name: metric.label for metric in table.metrics}
    ranked = {name: ranking for name, ranking in rankings.items() if any(ranking)}
    if not ranked:
        yield Card("What drives it", lines=[NO_RANKING_NOTE])
    for name, ranking in ranked.items():
        found = [(number, each) for number, each in enumerate(ranking) if each is not None]
        rows = [
            (
                named[number] if effect is each.effects[0] else "", code(effect.key),
                f"{100.0 * max(effect.index, 0.0):.1f}", format_span(effect.interval, ".1f", 100.0),
                NONE if effect.rank is None else f"{effect.rank:+.2f}", format_span(effect.rank_interval, "+.2f"),
                NONE if effect.partial is None else f"{effect.partial:+.2f}",
                "" if effect.real else "index not above chance",
            )
            for number, each in found
            for effect in each.effects
        ]  # fmt: skip
        counted = "; ".join(
            f"{table.controllers[number]}: {each.flights:,} flights, chance reaches {100.0 * each.floor:.1f} %, the "
            f"keys one at a time explain {100.0 * each.explained:.0f} %"
            for number, each in found
        )
        is_first = name == next(iter(ranked))
        first = f"{FIRST_ORDER_NOTE} {CORRELATED_KEYS_NOTE if is_correlated else ''}" if is_first else ""
        text = f"{counted}. The rest is effects of several keys together, and noise. {first}".strip()
        title = f"What drives it: {labels[name]}"
        yield _card(title, RANKING_COLUMNS, rows, text, table.grid, not is_first, f"ranking-{name}")


def referee_cards(referee: Mapping[str, Any]) -> Iterator[Card]:
    """Yield the card of JSBSim's check of flights computed on arrays: differences of metrics and verdicts."""
    if referee:
        columns = ("metric", "largest", "unit", "flight", "half within [%]", "nine of ten within [%]", "")
        yield Card("Flown again by JSBSim", columns, referee["metrics"], " ".join(referee["says"]),
                   is_folded=referee["confirmed"])  # fmt: skip
    if referee.get("verdicts"):
        both = ("flight", "controller", "on arrays", "by JSBSim", "margin on arrays", "margin by JSBSim")
        yield Card("Verdicts that differ", both, referee["verdicts"])


def metrics_card(table: FlightTable, named: Sequence[str]) -> Card | None:
    """Return the card with the spread of metrics; None if there are none."""
    rows = [
        (
            metric.label,
            *(_show_spread(find_spread(table, each, metric.name), metric.factor) for each in controller_indices(table)),
            metric.unit,
        )
        for metric in table.metrics
    ]
    figures = [f"metric-{number}" for number in range(len(rows))]
    return Card("Metrics", ("metric", *named, "unit"), rows, SPREADS_NOTE, figures) if rows else None


def _show_spread(found: Spread | None, factor: float) -> str:
    if found is None:
        return NONE
    none = f", {found.none:,} have none" if found.none else ""
    span = format_span((found.low, found.high), ".3g", factor)
    return f"{factor * found.median:.3g} ({span}); {found.flights:,} of {found.of:,}{none}"
