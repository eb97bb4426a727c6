"""hexjet compare: flights beside each other, whoever flew them."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli import opt
from cosim.cli.console import CommandProgress, echo, output_to_stderr, say, show_table, terminal
from cosim.cli.options import DONE, example
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.results.comparison import ComparedFlight, LogComparison

_OUT = Out(".html")
_MAX_INPUTS = 12  # lines in the terminal; the page has all


class Compare(opt.Output):
    """Options of ``hexjet compare``."""

    names: tuple[str, ...] = opt.argument(nargs=-1, required=True, metavar="A B [C...]")
    flights: tuple[int, ...] = opt.option(
        "--flight",
        type=click.IntRange(min=0),
        metavar="N",
        multiple=True,
        help="This flight of the campaigns among A, B, C; the same as CAMPAIGN:N.",
    )
    patterns = opt.words(
        "--signal",
        "PATTERN",
        "The signals of the table, such as 'thrust_*'.  [default: attitude, place, collective and the first that "
        "differ]",
    )
    shifts = opt.words(
        "--shift",
        "LETTER=SECONDS",
        "Add so much to the times of one of the flights, as of a log whose clock began elsewhere: B=-12.4.",
    )
    out = opt.out("The page, or its folder.  [default: a new one in runs/]", "DIR|FILE.html", _OUT)
    page: bool = opt.option("--page/--no-page", default=True, help="Write the page, or none.  [default: --page]")
    as_json = opt.json("Print one JSON object, in SI units, and nothing else.")


@click.command(epilog=example("hexjet compare runs/roll-doublet-smith-001 runs/roll-doublet-baseline-001"))
@opt.takes(Compare)
def compare(options: Compare) -> int:
    """Lay two to eight flights over each other: metrics side by side, and every signal against that of the first.

    Each of A, B, C is the folder of a run; a flight of a campaign, DIR:N, which is flown again; a scenario, flown here
    and now; a log of another tool, .csv or .parquet, with the time in seconds (time_s, time or t) and columns called
    as ours; or a log of another flight controller: ULog, DataFlash, Betaflight's blackbox, the Crazyflie's.

    What is flown runs code (--trust); what was flown is only looked at.  Leaves a page with all of it.  Status 0,
    whatever differs; 2: wrong input.
    """
    from cosim.api.compare import compare as lay_over
    from cosim.api.compare import expand_campaigns, page_path

    requested = expand_campaigns(options.names, options.flights)
    page = page_path(options.run_folder("comparison")) if options.page else None
    if page is not None and page.exists():
        raise InputError(f"{page}: is there already; choose another name or remove it")
    with output_to_stderr(options.as_json):
        result = lay_over(*requested, shift=_shifts(options.shifts), progress=_Warnings())
    chosen = _select_signals(result.compared, options.patterns)
    if page is not None:
        result.write(page)
    options.answer(result.to_dict, lambda: _print(result.flights, result.compared, chosen, page))
    return DONE


class _Warnings(CommandProgress):
    """Prints what a call notes as a warning."""

    def note(self, text: str) -> None:
        """Print it on standard error."""
        echo(f"hexjet: warning: {text}", err=True)


def _shifts(texts: Sequence[str]) -> dict[str, float]:
    """Return the seconds that are added to the times of each flight, by its letter.  Raises InputError."""
    shifts = {}
    for text in texts:
        letter, _, seconds = text.partition("=")
        try:
            shifts[letter.strip()] = float(seconds)
        except ValueError:
            raise InputError(f"--shift {text}: is not one of A, B, ... = a number of seconds") from None
    return shifts


def _select_signals(compared: Sequence[LogComparison], patterns: Sequence[str]) -> list[list[str]]:
    """Return the signals of each pair's table.  Raises InputError for a pattern that matches none."""
    from cosim.api.compare import EARLIEST, SIGNALS
    from cosim.results.report.comparison import by_time

    for pattern in patterns:
        if not any(fnmatchcase(signal.name, pattern) for pair in compared for signal in pair.signals):
            raise InputError(f"--signal {pattern}: no signal that the flights share is called so")
    if patterns:
        return [[s.name for s in pair.signals if any(fnmatchcase(s.name, p) for p in patterns)] for pair in compared]
    return [
        list(dict.fromkeys([*SIGNALS, *(signal.name for signal in by_time(pair.signals)[:EARLIEST])]))
        for pair in compared
    ]


def _print(
    flights: Sequence[ComparedFlight], compared: Sequence[LogComparison], chosen: Sequence[list[str]], page: Path | None
) -> None:
    from cosim.api.compare import SIGNAL_TITLES, describe
    from cosim.results.report.comparison import describe_pair, inputs_between, signal_cells

    for flight in flights:
        terminal().print(f"[bold]{flight.label[0]}[/bold]", end=" ")
        say(f"{flight.source}: {describe(flight)}", wrap=False)
    _print_metrics(flights)
    for pair, flight, names in zip(compared, flights[1:], chosen, strict=True):
        say(" ".join(describe_pair(pair)))
        inputs = inputs_between(flights[0], flight)
        for key, first, second in inputs[:_MAX_INPUTS]:
            say(f"  {key}: {first}; {flight.label[0]} {second}", wrap=False)
        if len(inputs) > _MAX_INPUTS:
            say(f"  and {len(inputs) - _MAX_INPUTS} inputs more that are not the same")
        rows = {signal.name: signal for signal in pair.signals}
        cells = [
            (name, "the same", "", "", "", "") if rows[name].same else signal_cells(rows[name])
            for name in names
            if name in rows
        ]
        if not pair.same:
            show_table(SIGNAL_TITLES, cells, range(1, 5), plain=True, pad_edge=False)
    if page is not None:
        say(f"report: {page}", wrap=False)


def _print_metrics(flights: Sequence[ComparedFlight]) -> None:
    from cosim.results.report.comparison import comparison_rows

    table = [
        (
            f"{row['axis']} {row['title'].lower()}" if row["axis"] != "whole flight" else row["title"].lower(),
            *(cell["text"] for cell in row["cells"]),
            row["unit"],
        )
        for row in comparison_rows([None if flight.run is None else flight.run.summary for flight in flights])
    ]
    titles = ("metric", *(flight.label[0] for flight in flights), "unit")
    rows = [(name.replace("rmse", "RMSE"), *rest) for name, *rest in table]
    show_table(titles, rows, range(1, 1 + len(flights)), plain=True, pad_edge=False)
