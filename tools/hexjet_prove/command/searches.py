"""hexjet search and rare: a search among flights, and failures too rare to count."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from cosim.cli.old.sweep import AIRCRAFT, ENGINE, JSON, METRICS, WIND, WORKERS, CampaignOptions, report_interruption
from cosim.commands import (
    DONE,
    FLIGHT_FAILED,
    CommandProgress,
    example,
    opt,
    output_to_stderr,
    part_progress,
    say,
    show_table,
)

if TYPE_CHECKING:
    from hexjet_prove.api.searches import SearchResult
    from hexjet_prove.rare.folder import SavedRare
    from hexjet_prove.search.folder import SavedSearch
    from hexjet_prove.search.worst_folder import SavedWorst


class Search(CampaignOptions):
    """Options of ``hexjet search``."""

    name = opt.argument(metavar="SCENARIO|STUDY|DESIGN")
    vary = opt.words(
        "--vary",
        "KEY=LO:HI[:N]",
        "Search this key between LO and HI, scanned in N points; *= and += as in hexjet sweep, log(LO:HI) too.  Of "
        "several, each alone.  With --worst and --likely all together, and anything that hexjet sweep draws.",
    )
    worst = opt.flag(
        "--worst", "Search the flight of least margin over all keys at once; of a design's file, in its tolerances."
    )
    likely = opt.flag("--likely", "Search the failure that is nearest to the middle of what is drawn.")
    within = opt.word(
        "--within",
        "SD|ranges",
        "With --worst and --likely: at most so many standard deviations from the middle, or anywhere in the ranges.  "
        "[3, a design's ranges; 6 for --likely]",
    )
    over = opt.word("--over", "KEY=LO:HI:N", "A curve: search at each of these values of a second key.")
    controllers = opt.words("--controller", "NAME|FILE", "Each is searched.")
    tolerance = opt.words("--tolerance", "[KEY=]X", "How near the edge is to be known.  [(HI - LO) / 200]")
    seeds = opt.whole("--seeds", None, "Flights of every point.", min=1, max=10_000, default=1)
    share: float = opt.option(
        "--share",
        type=opt.Number(0.0, 1.0),
        default=0.0,
        help="Share of a point's flights that have to break before it does.  [default: any of them]",
    )
    success = opt.words("--success", "METRIC<=X", "What a completed flight must keep too.")
    budget = opt.whole("--budget", None, "With --worst and --likely: flights of each controller.", min=1, default=1000)
    aircraft, engine, nominal_engine = AIRCRAFT, ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, METRICS, WIND
    seed = opt.whole("--seed", None, "Seed of the first flight of a point.  [default: the scenario's]")
    workers = WORKERS
    cluster = opt.word("--cluster", "ADDRESS|local", "As in hexjet sweep.")
    time_limit_s = opt.positive("--time-limit", "S", "Time of the clock for a flight.")
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with the same search in DIR; nothing is flown twice.")
    as_json = JSON


@click.command(epilog=example("hexjet search roll-doublet --vary mismatch.delay_samples=0:60"))
@opt.takes(Search)
def search(options: Search) -> int:
    """Find the smallest change that breaks a controller, the worst case of a study, or its most likely failure.

    Leaves search.json, search.html, every flight, and the flights that show it.  Status 0: searched, whatever was
    found; 1: it was stopped before, or a flight that shows it came out otherwise when it was flown again.
    """
    from hexjet_prove.api.searches import search as find

    sought = (
        "vary", "worst", "likely", "within", "over", "controllers", "tolerance", "seeds", "share", "success", "budget",
        "seed",
    )  # fmt: skip
    with output_to_stderr(options.as_json), search_progress(quiet=options.as_json) as progress:
        found = find(options.name, progress=progress, **options.chosen(*sought), **options.common())
    options.answer(found.to_dict, lambda: print_found(found))
    return DONE if found.confirmed else FLIGHT_FAILED


class Rare(CampaignOptions):
    """Options of ``hexjet rare``."""

    name = opt.argument(metavar="SCENARIO|STUDY")
    vary = opt.words("--vary", "KEY=...", "As in hexjet sweep.")
    controllers = opt.words("--controller", "NAME|FILE", "The one that flies, of a study with several.")
    correlate = opt.words("--correlate", "KEY,KEY=R", "Rank correlation of what is drawn for two keys.")
    success = opt.words("--success", "METRIC<=X", "What a completed flight must keep to count.")
    target: float = opt.option(
        "--target",
        type=opt.Number(1e-9, 0.5),
        default=1e-6,
        metavar="P",
        help="The smallest probability to look for: with the budget, how many flights a level has.  [default: 1e-6]",
    )
    budget = opt.whole("--budget", None, "Flights at most.", min=1, default=5000)
    same_seed = opt.flag("--same-seed", "Fly all with one seed: wind and noise are no part of what varies.")
    aircraft, engine, nominal_engine = AIRCRAFT, ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, METRICS, WIND
    seed = opt.whole("--seed", None, "Seed of the draws.")
    workers = WORKERS
    cluster = opt.word("--cluster", "ADDRESS|local", "As in hexjet sweep.")
    time_limit_s = opt.positive("--time-limit", "S", "Time of the clock for a flight.")
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with the same simulation in DIR; nothing is flown twice.")
    as_json = JSON


@click.command(epilog=example("hexjet rare roll-doublet --vary 'mismatch.delay_samples=normal(0,4,-20,40)'"))
@opt.takes(Rare)
def rare(options: Rare) -> int:
    """Find the probability of a failure that is too rare to be counted, down to one in a million and beyond.

    Leaves rare.json, rare.html, every flight, and the most likely failures.  Status 0: done, whatever was found; 1: it
    was stopped before, or a failure came out otherwise when it was flown again.
    """
    from hexjet_prove.api.searches import rare as simulate

    simulated = ("vary", "controllers", "correlate", "success", "target", "budget", "same_seed", "seed")
    with output_to_stderr(options.as_json), search_progress(quiet=options.as_json, what="rare") as progress:
        result = simulate(options.name, progress=progress, **options.chosen(*simulated), **options.common())
    options.answer(result.to_dict, lambda: print_rare(result.simulated))
    return DONE if result.confirmed else FLIGHT_FAILED


def print_found(found: SearchResult) -> None:
    """Print what a search found, of one key or of all at once."""
    from hexjet_prove.search.worst_case import WorstSearch

    if isinstance(found.searched.result, WorstSearch):
        print_worst(found.searched)
    else:
        print_search(found.searched)


def print_search(searched: SavedSearch) -> None:
    """Print where each controller breaks, when that counts as broken, how closely was looked, and the files."""
    from hexjet_prove.search.page import describe_resolution, together_lines
    from hexjet_prove.search.page import table as edges

    result = searched.result
    base = result.study.base()
    say(f"{base.name}: {base.aircraft_name}, engine {base.engine}; {result.flights} flights")
    for text in (result.criterion, *([result.engine_note] if result.engine_note else [])):
        say(text, wrap=False)
    show_table(*edges(result), plain=True, pad_edge=False)
    for line in [*together_lines(result), *map(describe_resolution, result.plan.spans)]:
        say(line, wrap=False)
    for case in searched.cases:
        if not case.same:
            say(f"case {case.name}: flown again it ended {case.reason}, not as in the search")
    say(f"cases: {searched.folder / 'cases'}", wrap=False)
    say(f"report: {searched.folder / 'search.html'}", wrap=False)


def print_worst(saved: SavedWorst) -> None:
    """Print what was found for each controller, which keys matter there, what it rests on, and the files."""
    from hexjet_prove.search.worst_page import rows, titles

    result = saved.result
    base = result.study.base()
    say(f"{base.name}: {base.aircraft_name}, engine {base.engine}; {result.flights} flights")
    for line in result.lines():
        say(line, wrap=False)
    show_table(titles(result), rows(result), range(4, 8), plain=True, pad_edge=False)
    for line in result.notes:
        say(line, wrap=False)
    for case in saved.cases:
        replay = saved.folder / "cases" / case.name / "scenario.toml"
        again = "the same bit for bit" if case.same else f"NOT the same: it ended {case.reason}"
        say(f"flown again, {again}: hexjet fly {replay}", wrap=False)
    say(f"report: {saved.folder / 'search.html'}", wrap=False)


def print_rare(saved: SavedRare) -> None:
    """Print the probability and how it was made, what the failures have in common, and the files."""
    from hexjet_prove.rare.page import LIMITS, describe_deciders, describe_result, shift_rows

    result = saved.result
    for line in describe_result(result):
        say(line, wrap=False)
    if result.failures:
        titles = ["key", "mean [standard deviations]", "spread"]
        show_table(titles, shift_rows(result), [1, 2], plain=True, pad_edge=False)
        if result.deciders:
            say(describe_deciders(result), wrap=False)
    for case in saved.cases:
        ending = case.reason if case.same else f"flown again it ended {case.reason}, not as before"
        say(f"{case.name}: flight {case.flight}, {case.distance:.2f} standard deviations out; {ending}", wrap=False)
    for line in (LIMITS, f"folder: {saved.folder}", f"report: {saved.folder / 'rare.html'}"):
        say(line, wrap=False)


@contextmanager
def search_progress(quiet: bool, what: str = "search") -> Iterator[CommandProgress]:
    """Yield what is told how many flights there are so far; Ctrl-C is answered in a line, wherever."""
    with part_progress(what, quiet) as show:
        progress = CommandProgress(show)

        def describe_kept() -> str:
            if not progress.done:
                return "; before the first flight"
            again = f"the same command with --out {progress.folder} --resume goes on"
            return f"; {progress.done} flights are kept: {again}"

        with report_interruption(describe_kept):
            yield progress
