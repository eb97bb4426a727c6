"""hexjet sweep and search: many flights."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.errors import InputError
from cosim.cli.console import on_terminal, output_to_stderr, part_progress, terminal
from cosim.cli.options import (
    DONE,
    FLIGHT_FAILED,
    REPORTED,
    Number,
    aircraft_settings,
    brought_settings,
    example,
)
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.campaign.search.result import SavedSearch
    from cosim.campaign.store import Campaign, Tally
    from cosim.campaign.study.keys import Key


@click.command(epilog=example("hexjet sweep roll-doublet --vary vehicle.mass_kg=5:6.5 --runs 100 --controller smith"))
@click.argument("name", metavar="SCENARIO|STUDY|DIR")
@click.option(
    "--vary",
    metavar="KEY=...",
    multiple=True,
    help="LO:HI, LO:HI:LEVELS, A,B,C, log(LO:HI), normal(MEAN,SD), ...; with *= or += what is drawn multiplies, or is "
    "added to, what the scenario has.",
)
@click.option("--runs", type=click.IntRange(min=1), metavar="N", help="Draws; a grid has as many as it has points.")
@click.option("--repeats", type=click.IntRange(min=1), metavar="N", help="Fly a whole grid more than once.")
@click.option("--design", metavar="NAME", help="grid, latin-hypercube, random or sobol.")
@click.option(
    "controllers", "--controller", metavar="NAME|FILE", multiple=True, help="Each draw is flown with every one."
)
@click.option("--correlate", metavar="KEY,KEY=R", multiple=True, help="Rank correlation of what is drawn for two keys.")
@click.option("--aircraft", metavar="NAME|DIR", help="Overrides the scenario's, with the engine that it is made for.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("metrics", "--metric", metavar="NAME", multiple=True, help="One of yours, as in hexjet fly.")
@click.option("--wind", metavar="NAME|FILE.csv", help="Yours, as in hexjet fly.")
@click.option("--success", metavar="METRIC<=X", multiple=True, help="What a completed flight must keep to count.")
@click.option("--seed", type=int, help="Of the draws.")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes.  [default: one a processor]")
@click.option("--cluster", metavar="ADDRESS|local", help="A Dask scheduler, such as tcp://HOST:8786, or one made here.")
@click.option(
    "--time-limit",
    type=Number(min=0.0, min_open=True),
    metavar="S",
    help="For a flight.  [default: 60, or ten of its lengths]",
)
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--resume", is_flag=True, help="Go on with what the folder holds; nothing that is finished is repeated.")
@click.option(
    "--keys", is_flag=False, flag_value="*", metavar="[PATTERN]", help="List what can be varied, and fly nothing."
)
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object at the end and nothing else.")
def sweep(
    name: str,
    workers: int | None,
    cluster: str | None,
    time_limit: float | None,
    out: Path | None,
    resume: bool,
    keys: str | None,
    as_json: bool,
    metrics: tuple[str, ...],
    wind: str | None,
    aircraft: str | None,
    **options: Any,
) -> int:
    """Fly a scenario many times with what varies drawn for each flight, or a study, or go on with a campaign in DIR.

    Leaves one Parquet data set with a row a flight, and a page.  Flights that fail are rows.  Status 0: all are flown,
    whatever became of them; 1: it was stopped before; 2: wrong input.
    """
    from cosim.campaign.analysis.page import write_campaign_report
    from cosim.campaign.analysis.summary import campaign_summary
    from cosim.campaign.run import opened, run_campaign, workers_at
    from cosim.campaign.study.model_notes import model_notes

    options["settings"] = [*aircraft_settings(aircraft), *options["settings"], *brought_settings(metrics, wind)]
    if keys is not None:
        return _list_keys(name, options["settings"], keys, as_json)
    study, folder = opened(name, out, resume, **options)
    notes = (*study.notes(), *model_notes(study)) if study is not None else ()
    with output_to_stderr(as_json), sweep_progress(folder, quiet=as_json) as tell:
        with workers_at(workers, cluster, time_limit) as flying:
            for text in notes:
                click.echo(f"hexjet: note: {text}", err=True)
            campaign = run_campaign(study, folder, flying, resume, tell)
        page = write_campaign_report(campaign)
    if as_json:
        places = {"folder": str(folder), "report": str(page)}
        click.echo(json.dumps(places | campaign_summary(campaign), allow_nan=False))
    else:
        print_campaign(campaign, page)
    return DONE


def _list_keys(name: str, settings: tuple[str, ...], pattern: str, as_json: bool) -> int:
    from cosim.campaign.study.keys import all_keys, matching
    from cosim.campaign.study.study import Study, study_names
    from cosim.spec.scenario import Scenario

    base = Study.load(name).base() if name in study_names() else Scenario.load(name, list(settings))
    keys = matching(all_keys(base), pattern)
    if as_json:
        listed = [{"key": key.path, "value": key.nominal, "unit": key.unit, "allowed": key.allowed} for key in keys]
        click.echo(json.dumps({"keys": listed}, allow_nan=False))
    else:
        print_keys(keys)
    return DONE


@click.command(epilog=example("hexjet search roll-doublet --vary mismatch.delay_samples=0:60 --controller smith"))
@click.argument("name", metavar="SCENARIO")
@click.option(
    "--vary",
    metavar="KEY=LO:HI[:N]",
    multiple=True,
    help="Search this key between LO and HI, scanned in N points; *= and += as in hexjet sweep, log(LO:HI) too.  Of "
    "several, each alone and then all together.",
)
@click.option("--over", metavar="KEY=LO:HI:N", help="A curve: search at each of these values of a second key.")
@click.option("controllers", "--controller", metavar="NAME|FILE", multiple=True, help="Each is searched.")
@click.option(
    "--tolerance", metavar="[KEY=]X", multiple=True, help="How near the edge is to be known.  [(HI - LO) / 200]"
)
@click.option("--seeds", type=click.IntRange(1, 10_000), default=1, show_default=True, help="Flights of every point.")
@click.option(
    "--share",
    type=Number(0.0, 1.0),
    default=0.0,
    help="Of a point's flights that have to break before it does.  [default: any of them]",
)
@click.option("--success", metavar="METRIC<=X", multiple=True, help="What a completed flight must keep too.")
@click.option(
    "--budget", type=click.IntRange(min=1), default=1000, show_default=True, help="Flights for keys together."
)
@click.option("--aircraft", metavar="NAME|DIR", help="Overrides the scenario's, with the engine that it is made for.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("metrics", "--metric", metavar="NAME", multiple=True, help="One of yours, as in hexjet fly.")
@click.option("--wind", metavar="NAME|FILE.csv", help="Yours, as in hexjet fly.")
@click.option("--seed", type=int, help="Of the first flight of a point.  [default: the scenario's]")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes.  [default: one a processor]")
@click.option("--cluster", metavar="ADDRESS|local", help="As in hexjet sweep.")
@click.option("--time-limit", type=Number(min=0.0, min_open=True), metavar="S", help="For a flight.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--resume", is_flag=True, help="Go on with the same search in DIR; nothing is flown twice.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object at the end and nothing else.")
def search(
    name: str,
    workers: int | None,
    cluster: str | None,
    time_limit: float | None,
    out: Path | None,
    resume: bool,
    as_json: bool,
    metrics: tuple[str, ...],
    wind: str | None,
    aircraft: str | None,
    **options: Any,
) -> int:
    """Find the smallest change that breaks a controller: of a delay, a gain, a payload, a gust, or any other key.

    Leaves search.json, search.html, every flight, and the flights that show it.  Status 0: searched, whatever was
    found; 1: it was stopped before, or a flight that shows it came out otherwise when it was flown again.
    """
    from cosim.campaign.run import workers_at
    from cosim.campaign.search.folder import opened, run_search
    from cosim.flight import new_folder

    options["settings"] = [*aircraft_settings(aircraft), *options["settings"], *brought_settings(metrics, wind)]
    study, plan = opened(name, **options)
    if resume and out is None:
        raise InputError("--resume: give the folder of the search with --out")
    folder = out if out is not None else new_folder(Path("runs"), f"search-{study.name}")
    with (
        output_to_stderr(as_json),
        search_progress(folder, quiet=as_json) as tell,
        workers_at(workers, cluster, time_limit) as flying,
    ):
        searched = run_search(study, plan, folder, flying, resume, tell)
    if as_json:
        click.echo(json.dumps(searched.to_dict(), allow_nan=False))
    else:
        print_search(searched)
    return DONE if searched.confirmed else FLIGHT_FAILED


@contextmanager
def sweep_progress(folder: Path, quiet: bool) -> Iterator[Callable[[Tally, int, int], None]]:
    """A function that is told what became of the flights, how many are finished, and of how many.

    On a terminal it shows them, their rate and the time left.  Ctrl-C is answered in a line, wherever.
    """
    reached = [0, 0]
    try:
        with _sweep_bar(quiet) as show:

            def tell(tally: Tally, done: int, of: int) -> None:
                reached[:] = done, of
                show(tally, done, of)

            yield tell
    except KeyboardInterrupt as stop:
        stop.add_note(REPORTED)
        done, of = reached
        print(
            f"hexjet: stopped; {done} of {of} flights are kept: hexjet sweep {folder} --resume goes on"
            if of
            else "hexjet: stopped before the first flight",
            file=sys.stderr,
        )
        raise


@contextmanager
def _sweep_bar(quiet: bool) -> Iterator[Callable[[Tally, int, int], None]]:
    if quiet or not sys.stderr.isatty():
        yield lambda tally, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn())
    shares = TextColumn("{task.fields[shares]}")
    # the processor is for the flights
    bar = Progress(*columns, shares, console=Console(stderr=True), transient=True, refresh_per_second=2)
    with on_terminal(bar) as progress:
        task = progress.add_task("", total=None, rate="", shares="")

        def show(tally: Tally, done: int, of: int) -> None:
            if progress.tasks[0].total is None:
                progress.reset(task, total=of, completed=done)  # what was flown before says nothing of the rate
            speed = progress.tasks[0].speed
            rate = "" if speed is None else f"{speed:.1f}/s"
            shares = ", ".join(f"{name} {tally.successes[name] / n:.0%}" for name, n in sorted(tally.flights.items()))
            progress.update(task, completed=done, rate=rate, shares=shares)

        yield show


def print_campaign(campaign: Campaign, page: Path) -> None:
    """What became of the flights, by controller, and where the data and the page are."""
    from cosim.campaign.analysis.summary import campaign_summary, comparison_lines, spread_table, success_lines

    console, summary = terminal(), campaign_summary(campaign)
    for line in success_lines(summary):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    titles, rows = spread_table(summary)
    if rows:
        console.print(_table(titles, rows, range(2, len(titles))), highlight=False, markup=False)
    for line in comparison_lines(summary):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(f"folder: {campaign.folder}", highlight=False, soft_wrap=True)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)


def print_keys(keys: Sequence[Key]) -> None:
    """What can be varied: its value now, its unit, and what it may be."""
    rows = []
    for key in keys:
        nominal = str(key.nominal).lower() if isinstance(key.nominal, bool) else key.nominal
        rows.append([key.path, "-" if nominal is None else f"{nominal}", key.unit, key.allowed])
    terminal().print(_table(["key", "value", "unit", "allowed"], rows, [1]), highlight=False, markup=False)


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]], numbers: Container[int] = ()) -> Any:
    """A table of text; the columns of ``numbers``, counted from 0, stand to the right."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for number, title in enumerate(titles):
        table.add_column(title, justify="right" if number in numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def print_search(searched: SavedSearch) -> None:
    """Where each controller breaks, when that counts as broken, how closely was looked, and the files."""
    from cosim.campaign.search.page import how_fine, joint_lines
    from cosim.campaign.search.page import table as edges

    console, result = terminal(), searched.result
    base = result.study.base()
    console.print(f"{base.name}: {base.aircraft_name}, engine {base.engine}; {result.flights} flights", highlight=False)
    console.print(result.criterion, highlight=False, markup=False, soft_wrap=True)
    console.print(_table(*edges(result)), markup=False)
    for line in [*joint_lines(result), *map(how_fine, result.plan.spans)]:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for case in searched.cases:
        if not case.same:
            console.print(
                f"case {case.name}: flown again it ended {case.reason}, not as in the search", highlight=False
            )
    console.print(f"cases: {searched.folder / 'cases'}", highlight=False, soft_wrap=True)
    console.print(f"report: {searched.folder / 'search.html'}", highlight=False, soft_wrap=True)


@contextmanager
def search_progress(folder: Path, quiet: bool) -> Iterator[Callable[[int], None]]:
    """A function that is told how many flights there are so far; Ctrl-C is answered in a line, wherever."""
    reached = 0
    try:
        with part_progress("search", quiet) as show:

            def tell(flights: int) -> None:
                nonlocal reached
                reached = flights
                show(f"{flights} flights", flights, 0)

            yield tell
    except KeyboardInterrupt as stop:
        stop.add_note(REPORTED)
        kept = f"{reached} flights are kept: the same command with --out {folder} --resume goes on"
        print(f"hexjet: stopped; {kept if reached else 'before the first flight'}", file=sys.stderr)
        raise
