"""hexjet sweep, search and rare: many flights."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from cosim.base.wording import printable
from cosim.cli import opt
from cosim.cli.console import CommandProgress, echo, on_terminal, output_to_stderr, part_progress, say, show_table
from cosim.cli.options import DONE, FLIGHT_FAILED, REPORTED, example

if TYPE_CHECKING:
    from cosim.api.searches import SearchResult
    from cosim.api.studies import SweepResult
    from cosim.campaign.rare.simulation import SavedRare
    from cosim.campaign.search.result import SavedSearch
    from cosim.campaign.search.worst_folder import SavedWorst
    from cosim.campaign.study.key import Key


class CampaignOptions(opt.Output):
    """Options of ``hexjet sweep``, ``search`` and ``rare`` that are not those of the study."""

    name: str
    aircraft: str | None
    settings: tuple[str, ...]
    metrics: tuple[str, ...]
    wind: str | None
    workers: int | None
    cluster: str | None
    time_limit_s: float | None
    resume: bool
    engine: str | None
    nominal_engine: bool

    def common(self) -> dict[str, Any]:
        """Return what every call of a study takes, as keywords."""
        return self.chosen("aircraft", "engine", "nominal_engine", "settings", "metrics", "wind", *FLEET)


FLEET = ("workers", "cluster", "time_limit_s", "out", "resume")

_AIRCRAFT = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with the engine that it is made for.")
_ENGINE = opt.word("--engine", "NAME|FILE", "Overrides the scenario's; drawn by its [uncertainty], where it has one.")
_METRICS = opt.words("--metric", "NAME", "One of yours, as in hexjet fly.")
_WIND = opt.word("--wind", "NAME|FILE.csv", "Yours, as in hexjet fly.")
_WORKERS = opt.whole("--workers", "N", "Processes.  [default: one a processor]", min=1)
_JSON = opt.json("Print one JSON object at the end and nothing else.")


class Sweep(CampaignOptions):
    """Options of ``hexjet sweep``."""

    name = opt.argument(metavar="SCENARIO|STUDY|DIR")
    vary = opt.words(
        "--vary",
        "KEY=...",
        "LO:HI, LO:HI:LEVELS, A,B,C, log(LO:HI), normal(MEAN,SD), ...; with *= or += what is drawn multiplies, or "
        "is added to, what the scenario has.",
    )
    runs = opt.whole("--runs", "N", "Draws; a grid has as many as it has points.", min=1)
    repeats = opt.whole("--repeats", "N", "Fly a whole grid more than once.", min=1)
    design = opt.renamed(opt.word("--sampling", "NAME", "grid, latin-hypercube, random or sobol."), "--design")
    controllers = opt.words("--controller", "NAME|FILE", "Each draw is flown with every one.")
    correlate = opt.words("--correlate", "KEY,KEY=R", "Rank correlation of what is drawn for two keys.")
    aircraft, engine, nominal_engine = _AIRCRAFT, _ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, _METRICS, _WIND
    success = opt.words("--success", "METRIC<=X", "What a completed flight must keep to count.")
    seed = opt.whole("--seed", None, "Seed of the draws.")
    until = opt.word(
        "--until",
        "P%@C%",
        "Stop when this probability of success is shown or refuted at this confidence, as 99.9%@95%; or that one "
        "controller does better, as 'smith>baseline@95%'.",
    )
    workers = _WORKERS
    cluster = opt.word("--cluster", "ADDRESS|local", "A Dask scheduler, such as tcp://HOST:8786, or one made here.")
    time_limit_s = opt.positive(
        "--time-limit", "S", "Time of the clock for a flight.  [default: 60, or ten of its lengths]"
    )
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with what the folder holds; nothing that is finished is repeated.")
    keys: str | None = opt.option(
        "--keys", is_flag=False, flag_value="*", metavar="[PATTERN]",
        help="List what can be varied, and fly nothing.",
    )  # fmt: skip
    as_json = _JSON


@click.command(epilog=example("hexjet sweep roll-doublet --vary vehicle.mass_kg=5:6.5 --runs 100"))
@opt.takes(Sweep)
def sweep(options: Sweep) -> int:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign in DIR.

    Leaves one Parquet data set with a row a flight, and a page.  Flights that fail are rows.  Status 0: all are flown,
    whatever became of them; 1: it was stopped before; 2: wrong input.
    """
    from cosim.api.studies import sweep as fly_all

    if options.keys is not None:
        return _list_keys(options.keys, options)
    drawn = ("vary", "runs", "repeats", "design", "controllers", "correlate", "success", "seed", "until")
    with output_to_stderr(options.as_json), sweep_progress(quiet=options.as_json) as progress:
        swept = fly_all(options.name, progress=progress, **options.chosen(*drawn), **options.common())
    options.answer(swept.to_dict, lambda: print_campaign(swept))
    return DONE


def _list_keys(pattern: str, options: Sweep) -> int:
    from cosim.api.studies import study_settings
    from cosim.campaign.study.keys import all_keys, matching
    from cosim.campaign.study.study import Study, study_names
    from cosim.spec.scenario import Scenario

    name, changes = options.name, options.chosen("settings", "aircraft", "engine", "metrics", "wind")
    settings = study_settings(**changes)
    base = Study.load(name).base() if name in study_names() else Scenario.load(name, settings)
    keys = matching(all_keys(base), pattern)
    listed = [{"key": key.path, "value": key.nominal, "unit": key.unit, "allowed": key.allowed} for key in keys]
    options.answer(lambda: {"keys": listed}, lambda: print_keys(keys))
    return DONE


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
    aircraft, engine, nominal_engine = _AIRCRAFT, _ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, _METRICS, _WIND
    seed = opt.whole("--seed", None, "Seed of the first flight of a point.  [default: the scenario's]")
    workers = _WORKERS
    cluster = opt.word("--cluster", "ADDRESS|local", "As in hexjet sweep.")
    time_limit_s = opt.positive("--time-limit", "S", "Time of the clock for a flight.")
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with the same search in DIR; nothing is flown twice.")
    as_json = _JSON


@click.command(epilog=example("hexjet search roll-doublet --vary mismatch.delay_samples=0:60"))
@opt.takes(Search)
def search(options: Search) -> int:
    """Find the smallest change that breaks a controller, the worst case of a study, or its most likely failure.

    Leaves search.json, search.html, every flight, and the flights that show it.  Status 0: searched, whatever was
    found; 1: it was stopped before, or a flight that shows it came out otherwise when it was flown again.
    """
    from cosim.api.searches import search as find

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
    aircraft, engine, nominal_engine = _AIRCRAFT, _ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, _METRICS, _WIND
    seed = opt.whole("--seed", None, "Seed of the draws.")
    workers = _WORKERS
    cluster = opt.word("--cluster", "ADDRESS|local", "As in hexjet sweep.")
    time_limit_s = opt.positive("--time-limit", "S", "Time of the clock for a flight.")
    out = opt.OUT
    resume = opt.flag("--resume", "Go on with the same simulation in DIR; nothing is flown twice.")
    as_json = _JSON


@click.command(epilog=example("hexjet rare roll-doublet --vary 'mismatch.delay_samples=normal(0,4,-20,40)'"))
@opt.takes(Rare)
def rare(options: Rare) -> int:
    """Find the probability of a failure that is too rare to be counted, down to one in a million and beyond.

    Leaves rare.json, rare.html, every flight, and the most likely failures.  Status 0: done, whatever was found; 1: it
    was stopped before, or a failure came out otherwise when it was flown again.
    """
    from cosim.api.searches import rare as simulate

    simulated = ("vary", "controllers", "correlate", "success", "target", "budget", "same_seed", "seed")
    with output_to_stderr(options.as_json), search_progress(quiet=options.as_json, what="rare") as progress:
        result = simulate(options.name, progress=progress, **options.chosen(*simulated), **options.common())
    options.answer(result.to_dict, lambda: print_rare(result.simulated))
    return DONE if result.confirmed else FLIGHT_FAILED


@contextmanager
def report_interruption(describe: Callable[[], str]) -> Iterator[None]:
    """Answer Ctrl-C in a line that says what is kept, wherever it comes."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note(REPORTED)
        echo(f"hexjet: stopped{describe()}", err=True)
        raise


@contextmanager
def sweep_progress(quiet: bool, goes_on: str | None = None) -> Iterator[CommandProgress]:
    """Yield what is told the fractions of successes, how many flights are finished, and of how many.

    ``goes_on``: the command that goes on with them in their folder, by default ``hexjet sweep``.  On a terminal it
    shows them, their rate and the time left.  Ctrl-C is answered in a line, wherever.
    """
    with _sweep_bar(quiet) as show:
        progress = CommandProgress(show)

        def describe_kept() -> str:
            if not progress.of:
                return " before the first flight"
            command = f"{goes_on or 'hexjet sweep'} {progress.folder}"
            if progress.is_concluding:
                return f"; what was flown is kept: {command} --resume goes on"
            return f"; {progress.done} of {progress.of} flights are kept: {command} --resume goes on"

        with report_interruption(describe_kept):
            yield progress


@contextmanager
def _sweep_bar(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    if quiet or not sys.stderr.isatty():
        yield lambda part, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
    shares = TextColumn("{task.fields[shares]}")
    # the processor is for the flights
    bar = Bar(*columns, shares, console=Console(stderr=True), transient=True, refresh_per_second=2)
    with on_terminal(bar) as progress:
        task = progress.add_task("", total=None, rate="", shares="")

        def show(part: str, done: int, of: int) -> None:
            if of == 0:
                progress.update(task, rate="", shares=printable(part))
                return
            if progress.tasks[0].total is None:
                progress.reset(task, total=of, completed=done)  # flights of an earlier run do not count for the rate
            speed = progress.tasks[0].speed
            rate = "" if speed is None else f"{speed:.1f}/s"
            progress.update(task, completed=done, rate=rate, shares=printable(part))

        yield show


def print_campaign(swept: SweepResult) -> None:
    """Print what became of the flights, by controller, and where the data and the page are."""
    from cosim.campaign.analysis.summary import comparison_lines, spread_table, success_lines

    summary = swept.to_dict()
    titles, rows = spread_table(summary)
    for line in success_lines(summary):
        say(line, wrap=False)
    show_table(titles, rows, range(2, len(titles)), plain=True, pad_edge=False)
    for line in [*comparison_lines(summary), f"folder: {summary['folder']}", f"report: {summary['report']}"]:
        say(line, wrap=False)


def print_keys(keys: Sequence[Key]) -> None:
    """Print what can be varied: its value now, its unit, and what it may be."""
    rows = []
    for key in keys:
        nominal = str(key.nominal).lower() if isinstance(key.nominal, bool) else key.nominal
        rows.append([key.path, "-" if nominal is None else f"{nominal}", key.unit, key.allowed])
    show_table(["key", "value", "unit", "allowed"], rows, [1], plain=True, pad_edge=False)


def print_found(found: SearchResult) -> None:
    """Print what a search found, of one key or of all at once."""
    from cosim.campaign.search.result import SavedSearch

    searched = found.searched
    if isinstance(searched, SavedSearch):
        print_search(searched)
    else:
        print_worst(searched)


def print_search(searched: SavedSearch) -> None:
    """Print where each controller breaks, when that counts as broken, how closely was looked, and the files."""
    from cosim.campaign.search.page import describe_resolution, together_lines
    from cosim.campaign.search.page import table as edges

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
    from cosim.campaign.search.worst_page import rows, titles

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
    from cosim.campaign.rare.page import LIMITS, describe_deciders, describe_result, shift_rows

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
