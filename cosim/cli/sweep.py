"""hexjet sweep: many flights of a study; and what the commands of other studies share with it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from cosim.base.wording import printable
from cosim.cli import opt
from cosim.cli.console import CommandProgress, echo, on_terminal, output_to_stderr, say, show_table
from cosim.cli.options import DONE, REPORTED, example

if TYPE_CHECKING:
    from cosim.api.studies import SweepResult
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

AIRCRAFT = opt.word("--aircraft", "NAME|DIR", "Overrides the scenario's, with the engine that it is made for.")
ENGINE = opt.word("--engine", "NAME|FILE", "Overrides the scenario's; drawn by its [uncertainty], where it has one.")
METRICS = opt.words("--metric", "NAME", "One of yours, as in hexjet fly.")
WIND = opt.word("--wind", "NAME|FILE.csv", "Yours, as in hexjet fly.")
WORKERS = opt.whole("--workers", "N", "Processes.  [default: one a processor]", min=1)
JSON = opt.json("Print one JSON object at the end and nothing else.")


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
    aircraft, engine, nominal_engine = AIRCRAFT, ENGINE, opt.NOMINAL_ENGINE
    settings, metrics, wind = opt.SETTINGS, METRICS, WIND
    success = opt.words("--success", "METRIC<=X", "What a completed flight must keep to count.")
    seed = opt.whole("--seed", None, "Seed of the draws.")
    until = opt.word(
        "--until",
        "P%@C%",
        "Stop when this probability of success is shown or refuted at this confidence, as 99.9%@95%; or that one "
        "controller does better, as 'smith>baseline@95%'.",
    )
    workers = WORKERS
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
    as_json = JSON


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
