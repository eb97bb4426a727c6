"""hexjet compare: flights beside each other, whoever flew them."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.errors import InputError
from cosim.cli import opt
from cosim.cli.console import output_to_stderr, say, show_table, terminal
from cosim.cli.options import DONE, example
from cosim.cli.outputs import Out
from cosim.cli.trust import display_only

if TYPE_CHECKING:
    from cosim.results.comparison import ComparedFlight, LogComparison

PAGE = "comparison.html"
_OUT = Out(".html")
LETTERS = "ABCDEFGH"  # one per distinguishable colour
SIGNALS = ("roll_rad", "pitch_rad", "yaw_rad", "altitude_m", "north_m", "east_m", "collective")
EARLIEST = 5  # number of further signals shown: the first that differ
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
    no_page = opt.flag("--no-page", "Write none.")
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
    from cosim.base.storage.files import map_os_errors
    from cosim.results.comparison import compare_with_first
    from cosim.results.report.comparison import write_comparison

    requested = _expand_campaigns(options.names, options.flights)
    if not 2 <= len(requested) <= len(LETTERS):
        raise InputError(f"compare: {len(requested)} flights; allowed: 2 to {len(LETTERS)}")
    out = options.run_folder("comparison")
    page = None if options.no_page else out if _OUT.is_file(out) else out / PAGE
    if page is not None and page.exists():
        raise InputError(f"{page}: is there already; choose another name or remove it")
    with output_to_stderr(options.as_json):
        loaded = _shift_times(
            [_load_flight(letter, name) for letter, name in zip(LETTERS, requested, strict=False)], options.shifts
        )
    compared = compare_with_first(loaded)
    chosen = _select_signals(compared, options.patterns)
    if page is not None:
        with map_os_errors(InputError, page.parent):
            page.parent.mkdir(parents=True, exist_ok=True)
        write_comparison(loaded, compared, page)
    options.answer(lambda: _to_dict(loaded, compared, page), lambda: _print(loaded, compared, chosen, page))
    return DONE


@display_only
def write_page(names: Sequence[str], folder: Path) -> Path:
    """Write the comparison of these flights as a page in a new folder and return its path; none is flown."""
    from cosim.results.comparison import compare_with_first
    from cosim.results.report.comparison import write_comparison

    flights = [_load_flight(letter, name) for letter, name in zip(LETTERS, _expand_campaigns(names, ()), strict=False)]
    folder.mkdir(parents=True, exist_ok=True)
    write_comparison(flights, compare_with_first(flights), folder / PAGE)
    return folder / PAGE


def _expand_campaigns(names: Sequence[str], flights: Sequence[int]) -> list[str]:
    """Return the flights that are meant, one text each; a campaign's folder stands for the ``flights`` of it."""
    from cosim.campaign.folder import is_campaign

    requested: list[str] = []
    for name in names:
        if not is_campaign(Path(name)):
            requested.append(name)
        elif not flights:
            raise InputError(f"{name}: is a campaign; say which flight: {name}:0, or --flight 0")
        else:
            requested += [f"{name.rstrip('/')}:{number}" for number in flights]
    if flights and not any(is_campaign(Path(name)) for name in names):
        raise InputError("--flight: none of these is a campaign")
    return requested


def _shift_times(flights: Sequence[ComparedFlight], shifts: Sequence[str]) -> list[ComparedFlight]:
    """Move the times of these flights.  Raises InputError for what is no letter of theirs or no number."""
    from cosim.results.comparison import shift_times

    moved = list(flights)
    for text in shifts:
        letter, _, seconds = text.partition("=")
        index = LETTERS.find(letter.strip().upper()) if letter.strip() else -1
        try:
            by = float(seconds)
        except ValueError:
            by = nan
        if not 0 <= index < len(moved) or not isfinite(by):
            raise InputError(f"--shift {text}: is not one of {', '.join(LETTERS[: len(moved)])} = a number of seconds")
        moved[index] = shift_times(moved[index], by)
    return moved


def _load_flight(letter: str, name: str) -> ComparedFlight:
    from cosim.campaign import fly_again, open_campaign
    from cosim.campaign.folder import is_campaign
    from cosim.flight import fly
    from cosim.identify.logs import is_flight_log, read_flight_log
    from cosim.identify.logs.log_columns import as_columns, read_log
    from cosim.results.comparison import ComparedFlight
    from cosim.results.run import finish_killed, open_run
    from cosim.spec.scenario import Scenario, scenario_names

    path = Path(name)
    label = f"{letter}: {path.name or path.absolute().name}"
    folder, _, number = name.rpartition(":")
    if folder and number.isdigit() and is_campaign(Path(folder)):
        repeated = fly_again(open_campaign(Path(folder)), int(number))
        if not repeated.same:
            click.echo(f"hexjet: warning: {name}: {repeated.verdict}: {'; '.join(repeated.otherwise)}", err=True)
        return ComparedFlight(label, repeated.run.log, repeated.run, name, (f"flown again: {repeated.verdict}",))
    if path.is_dir():
        run = open_run(path)
        return ComparedFlight(label, run.log, run, name)
    if path.suffix.lower() in (".csv", ".parquet"):
        log, remarks = read_log(path)
        return ComparedFlight(label, log, None, name, remarks)
    if name not in scenario_names() and path.suffix.lower() != ".toml" and is_flight_log(path):
        log, remarks = as_columns(read_flight_log(path))
        return ComparedFlight(label, log, None, name, remarks)
    if path.suffix.lower() == ".toml" or name in scenario_names():
        finish_killed(path)
        run = fly(Scenario.read(name, []))
        return ComparedFlight(label, run.log, run, name, ("flown for this comparison",))
    raise InputError(
        f"{name}: no flight; allowed: the folder of a run, CAMPAIGN:NUMBER, a scenario, a log "
        "(.csv, .parquet, ULog, DataFlash, Betaflight's blackbox, Crazyflie, .tlog)"
    )


def _select_signals(compared: Sequence[LogComparison], patterns: Sequence[str]) -> list[list[str]]:
    """Return the signals of each pair's table.  Raises InputError for a pattern that matches none."""
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


def _to_dict(flights: Sequence[ComparedFlight], compared: Sequence[LogComparison], page: Path | None) -> dict[str, Any]:
    """Return the comparison as data for JSON, everything in SI."""
    from cosim.results.report.comparison import inputs_between

    runs = []
    for flight in flights:
        summary = None if flight.run is None else flight.run.summary
        identity = (
            {}
            if summary is None
            else {key: getattr(summary, key) for key in ("scenario", "aircraft", "engine", "controller", "seed")}
            | {key: getattr(summary, key) for key in ("outcome", "reason", "verdict", "step_s", "duration_s")}
            | {"metrics": summary.flat_metrics}
        )
        runs.append({"label": flight.label, "source": flight.source, "remarks": list(flight.remarks)} | identity)
    differences = [
        pair._asdict()
        | {"signals": {s.name: s._asdict() for s in pair.signals}}
        | {"inputs": {key: [first, second] for key, first, second in inputs_between(flights[0], flight)}}
        for pair, flight in zip(compared, flights[1:], strict=True)
    ]
    return {"runs": runs, "differences": differences, "page": None if page is None else str(page)}


def _print(
    flights: Sequence[ComparedFlight], compared: Sequence[LogComparison], chosen: Sequence[list[str]], page: Path | None
) -> None:
    from cosim.results.report.comparison import describe_pair, inputs_between, signal_cells

    for flight in flights:
        terminal().print(f"[bold]{flight.label[0]}[/bold]", end=" ")
        say(": ".join([flight.source, *_describe(flight)]), wrap=False)
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
            titles = ("signal", "first at, s", "largest", "at, s", "RMS", "unit")
            show_table(titles, cells, range(1, 5), plain=True, pad_edge=False)
    if page is not None:
        say(f"page: {page}", wrap=False)


def _describe(flight: ComparedFlight) -> list[str]:
    if flight.run is None:
        text = "a log"
    else:
        summary = flight.run.summary
        text = f"{summary.scenario}, {summary.aircraft}, {summary.engine_shown}, {summary.controller_shown}, "
        text += summary.ending
    return ["; ".join([text, *flight.remarks])]


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
