"""The page of a campaign, and the scenario files of the flights it points to."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import parse_json, read_text
from cosim.campaign.analysis.cards import comparison_cards, metrics_card, ranking_cards, referee_cards, success_card
from cosim.campaign.analysis.claim import format_interval, judge_claim
from cosim.campaign.analysis.figures import KIND_COLOURS, campaign_figures
from cosim.campaign.analysis.sensitivity import Ranking, joint
from cosim.campaign.analysis.stability_map import MAX_MAP_KEYS, map_tables
from cosim.campaign.analysis.statistics import Proportion
from cosim.campaign.analysis.summary import (
    SUCCESS,
    controller_indices,
    count_reasons,
    rank_keys,
    ranked_result,
    success_fractions,
    with_referee,
)
from cosim.campaign.analysis.table import FlightTable, KeyColumn, describe_criterion, if_here, read_flight_table
from cosim.campaign.analysis.worst_cases import CASE_COLUMNS, case_rows
from cosim.campaign.folder import COMMAND, REPORT
from cosim.campaign.study.engine_draw import DRAWN_BY
from cosim.campaign.study.keys import FLOWN_STATIONS
from cosim.campaign.workers.flight_row import describe_not_flown
from cosim.results.report.cards import Card, Page, code, coloured, link
from cosim.results.report.plot import run_colour

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign
    from cosim.campaign.study.study import Correlation, Study, Vary

SAMPLING_PHRASES = {  # phrase for each sampling
    "grid": "a grid of every combination",
    "latin-hypercube": "a Latin hypercube",
    "random": "independent random draws",
    "sobol": "scrambled Sobol points",
}
INTERVAL_NOTES = {  # note on intervals for each sampling
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
STOPPED_NOTE = (  # note for studies stopped by a rule
    "Both suppose a number of flights that was fixed before. This study stops by its rule: what holds is what is said "
    "of its claim above."
)
CLASSES_NOTE = "Classes of equal count, with 95 % intervals (Wilson)."  # note under curves of success
CASES_NOTE = "Each can be flown again alone and recorded in full, by its number or from its scenario file."
NONE = "–"  # shown where there is no number
MAP_TEMPLATE = Path(__file__).parent / "templates" / "stability_map.html"  # template of the stability map


def write_campaign_report(campaign: Campaign) -> Path:
    """Write the campaign's page and the scenario files that it links to, and return the page's path.

    Raises FlightError if a file cannot be written, and InputError for the flights of another command than a sweep.
    """
    if command := campaign.plan.get(COMMAND):
        page = f"{command.split()[-1]}.html"
        raise InputError(f"{campaign.folder}: has the flights of {command}; its page is {campaign.folder / page}")
    path = campaign.folder / REPORT
    make_page(campaign).write(path)
    return path


def make_page(campaign: Campaign) -> Page:
    """Return the page of a campaign; write the scenario files of its cases."""
    table, study, claim = read_flight_table(campaign), campaign.study, judge_claim(campaign)
    names = [SUCCESS, *(metric.name for metric in table.metrics)]
    rankings = {name: [rank_keys(table, each, name) for each in controller_indices(table)] for name in names}
    leading = next((name for name in names if any(rankings[name])), SUCCESS)
    order, fractions = order_by_influence(table, rankings[leading]), success_fractions(table)
    figures = campaign_figures(table, fractions, rankings, order)
    if len(table.keys) > 1 and table.flight.size:
        mapped = order[:MAX_MAP_KEYS]
        pair = strongest_pair(table, mapped, leading, rankings[leading])
        figures["map-tables"] = map_tables(table, mapped, pair, leading)
    finished = claim.is_finished if claim is not None else table.flight.size == campaign.of
    count = f"{table.flight.size:,} flights" if finished else f"{table.flight.size:,} of {campaign.of:,} flights"
    judged, confirmed = campaign.referee.get("says", []), campaign.referee.get("confirmed", True)
    named = [coloured(name, run_colour(n)) for n, name in enumerate(table.controllers)]
    claims = [] if claim is None else [f"{line}." for line in claim.lines()]
    answers = [_success_sentence(*each, table.grid, bool(claims)) for each in zip(named, fractions, strict=True)]
    told = f"A flight succeeds if it {describe_criterion(study.success)}. {study.description.strip()}".strip()
    unfinished = Card("Flights", lines=["No flight is finished yet: there is nothing to show."])
    pages = [unfinished] if not table.flight.size else [
        Card("Share of the grid" if table.grid else "Probability", figure="probability", is_half=True),
        Card("Outcomes of the flights", figure="outcomes", is_half=True),
        success_card(table, named, fractions, STOPPED_NOTE if claims else INTERVAL_NOTES.get(study.design, "")),
        *referee_cards(campaign.referee),
        Card("Stability map", content=_render_stability_map()) if "map-tables" in figures else None,
        *comparison_cards(table, named),
        *ranking_cards(table, named, rankings, bool(study.correlate)),
        Card("Success over each key", text=f"All other keys as they come. {'' if table.grid else CLASSES_NOTE}",
             figure=[name for name in figures if name.startswith("key-")], lines=[Markup(" ").join(named)]),
        metrics_card(table, named),
        _failure_reasons_card(campaign, table, named),
        Card("Worst cases", CASE_COLUMNS, case_rows(campaign, table, named), CASES_NOTE,
             code=f"hexjet fly {shlex.quote(campaign.folder.as_posix())} --flight NUMBER"),
    ]  # fmt: skip
    return Page(
        "campaign",
        study.title or study.name,
        [*pages, _varied_keys_card(study, table), *_stored_data_cards(campaign)],
        figures,
        verdict=count if confirmed else f"{judged[0]}; {count}",
        badge="completed" if finished and confirmed else "failed",
        answer=with_referee([*answers, *claims], campaign.referee),
        summary=[told],
        notes=warnings(campaign, table, stops=claim is not None),
        facts=head_rows(campaign, table),
        are_figures_linked=False,
    )


def _render_stability_map() -> Markup:
    """Return the markup of the stability map, which has a choice of keys and colour, and a script of its own."""
    colours = json.dumps(KIND_COLOURS)
    return Markup(read_text(MAP_TEMPLATE).replace("KIND_COLOURS", colours))


def _success_sentence(name: Markup, found: Proportion, is_grid: bool, stops: bool) -> Markup:
    """Return a sentence on how often a controller succeeds."""
    if found.value is None:
        return Markup("{}: no flight yet.").format(name)
    share, counted = f"{100.0 * found.value:.1f} %", f"{found.hits:,} of {found.of:,}"
    if is_grid:
        return Markup("{}: {} of the grid's flights succeed ({}).").format(name, share, counted)
    bounds = "" if stops else f" (95 % interval {format_interval(found.wilson)})"
    return Markup("{}: {} succeed, {}{}.").format(name, share, counted, bounds)


def _failure_reasons_card(campaign: Campaign, table: FlightTable, named: Sequence[str]) -> Card:
    """Return the card of why flights were no success, with a column for each controller."""
    rows, title = reason_rows(campaign, table), "Why flights were no success"
    if not rows:
        return Card(title, lines=["Every flight was one."])
    return Card(title, ("reason", *named), rows, "Reasons that differ in their numbers only (…) are one.")


def _varied_keys_card(study: Study, table: FlightTable) -> Card:
    rows = [(code(r["path"]), r["drawn"], r["nominal"], r["observed"], r["unit"]) for r in key_rows(study, table)]
    asked = "; ".join(describe_correlation(correlation) for correlation in study.correlate)
    lines = [f"Requested rank correlations: {asked}."] if asked else []
    settings = ", ".join(f"{key} = {value}" for key, value in study.settings.items())
    lines += [f"Set in all flights: {settings}."] if settings else []
    return Card("What varies", ("key", "drawn from", "nominal", "flown", "unit"), rows, lines=lines)


def _stored_data_cards(campaign: Campaign) -> Iterator[Card]:
    stored = Markup("{} Parquet files in {}, the study in {}.").format(
        "One row a flight: what was drawn, what came of it, every metric in SI units, a hash of its log.",
        link("flights/", "flights/"),
        link("study.toml", "study.toml"),
    )
    yield Card("The data", lines=[stored], code="\n".join(python_lines(campaign.folder)))
    if made_from := collect_sources(campaign):
        rows = [(name, ", ".join(values)) for name, values in made_from.items()]
        yield Card("What the flights were made from", ("file", "version or hash"), rows)


def head_rows(campaign: Campaign, table: FlightTable) -> list[tuple[str, str]]:
    """Return name and value of each fact on what was flown, without any on the computer."""
    study = campaign.study
    wall = np.array([seconds or 0.0 for seconds in campaign.columns.get("wall_s", [])], dtype=np.float64)
    simulated, base = float(np.nansum(table.duration)), if_here(study.base)
    lines = [
        ("scenario", base.name if base else study.scenario),
        ("design", SAMPLING_PHRASES[study.design]),
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
                "nominal": NONE if varied is None or varied.nominal is None else _format_value(varied.nominal),
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
    """Describe a varied key's distribution in words, such as ``uniform, 1 to 2, times the nominal value``."""
    relative = {"": "", "factor": ", times the nominal value", "offset": ", added to the nominal value"}[vary.relative]
    return _describe_distribution(vary) + relative


def _describe_distribution(vary: Vary) -> str:
    if vary.uncertainty:
        return DRAWN_BY
    if vary.values is not None:
        return f"one of {', '.join(map(_format_value, vary.values))}"
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
        return text + _describe_bounds(vary.normal.min, vary.normal.max)
    assert vary.lognormal is not None
    text = f"lognormal, median {vary.lognormal.median:g}, sigma {vary.lognormal.sigma:g}"
    return text + _describe_bounds(vary.lognormal.min, vary.lognormal.max)


def _describe_bounds(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    if low is None:
        return f", cut off above {high:g}"
    return f", cut off below {low:g}" if high is None else f", cut off outside {low:g} to {high:g}"


def _format_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def describe_correlation(correlation: Correlation) -> str:
    return f"{correlation.keys[0]} with {correlation.keys[1]}: {correlation.rank:g}"


def warnings(campaign: Campaign, table: FlightTable, stops: bool = False) -> list[str]:
    """Return warnings on the numbers of the report, such as failed or missing flights.

    ``stops``: by a rule of its study, so that missing flights are none.
    """
    lines = []
    finished, planned = table.flight.size, campaign.of
    if finished < planned and not stops:
        lines.append(
            f"The study is not finished: {finished:,} of {planned:,} flights ({finished / planned:.1%}). "
            "Flights that fail early end early, so that the finished ones may look worse than all will."
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
    """Return all versions, and file hashes of aircraft and engines, that flights were computed with, by name."""
    sources: dict[str, list[str]] = {}
    for text in dict.fromkeys(campaign.columns.get("inputs", [])):
        for part in parse_json(str(text), "inputs", finite=False).values() if text else ():
            for name, value in part.items():
                sources.setdefault(name, [])
                sources[name] += [value] if value not in sources[name] else []
    return sources


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
            _joint_effect(finite & table.rows_of(controller), a, b, values) for controller in controller_indices(table)
        )
    default_pair = (keys[0], keys[1])
    best = max(together, key=lambda pair: together[pair])
    return (
        best
        if together[best] > together[default_pair] + sum(ranking.floor for ranking in rankings if ranking)
        else default_pair
    )


def _joint_effect(rows: Any, first: Array, second: Array, values: Array) -> float:
    """Return the fraction of the variance of ``values`` that two keys explain together in these rows."""
    some = int(np.sum(rows)) > 1 and np.ptp(values[rows]) > 0.0
    return max(0.0, joint(first[rows], second[rows], values[rows])) if some else 0.0


def reason_rows(campaign: Campaign, table: FlightTable, limit: int = 12) -> list[list[str]]:
    """Return the reasons of flights without success, the commonest first, with the count of every controller.

    ``limit``: so many have a row of their own.
    """
    counted = [
        count_reasons(table, table.rows_of(controller), campaign.study.success)
        for controller in controller_indices(table)
    ]
    names = sorted(
        {name for counter in counted for name in counter},
        key=lambda name: (-sum(counter[name] for counter in counted), name),
    )
    rows = [(name, [counter[name] for counter in counted]) for name in names[:limit]]
    if others := names[limit:]:
        rows.append((f"{len(others)} other reasons", [sum(counter[name] for name in others) for counter in counted]))
    return [[name, *(f"{count:,}" if count else NONE for count in counts)] for name, counts in rows]


def python_lines(folder: Path) -> list[str]:
    """Return the lines of Python that open the campaign."""
    return [
        "from cosim.campaign import open_campaign",
        f"campaign = open_campaign({folder.as_posix()!r})",
        'campaign.columns["outcome"]  # one entry a flight, in the order of their numbers',
    ]
