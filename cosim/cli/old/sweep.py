"""hexjet sweep: many flights of a study; and what the commands of other studies share with it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cosim.base.wording import printable
from cosim.cli.console import REPORTED, CommandProgress, echo, on_terminal
from cosim.cli.old import opt


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
