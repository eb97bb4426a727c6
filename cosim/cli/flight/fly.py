"""hexjet fly: one flight, and a flight of a campaign again."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.errors import InputError
from cosim.base.wording import printable
from cosim.cli import opt
from cosim.cli.console import echo, on_terminal, output_to_stderr, say, show_table, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Flight, example, refuse_others, warn_of_fmu_defects

if TYPE_CHECKING:
    from cosim.base.protocols import Observer
    from cosim.base.signals import Sample
    from cosim.campaign.run import RepeatedFlight
    from cosim.results.run import Run
    from cosim.results.summary import Summary
    from cosim.spec.scenario import Scenario


class Fly(Flight, opt.Output):
    """Options of ``hexjet fly``."""

    scenario: str = opt.argument()
    controller = opt.word(
        "--controller",
        "NAME|FILE",
        "Overrides the scenario's; see: hexjet list controllers. Or a file that hexjet design wrote, with all "
        "gains; or one of yours: FILE.py:Class, package.module:Class, FILE.fmu, 'process:FILE ARGUMENTS'.",
    )
    aircraft = opt.word(
        "--aircraft",
        "NAME|DIR",
        "Overrides the scenario's, with the engine that it is made for; see: hexjet list aircraft.",
    )
    engines = opt.words(
        "--engine",
        "[N=]NAME|FILE",
        "Overrides the scenario's: a name (see: hexjet list engines), an .fmu or a .toml that maps one; with N= "
        "the one at station N alone.",
    )
    settings = opt.words(
        "--set",
        "KEY=VALUE",
        "Write a value over the scenario's, e.g. vehicle.mass_kg=6.0; its expectations are not checked then.",
    )
    model = opt.path(
        "--model", "FILE.toml", "Predict with the identified models in this file, as hexjet identify writes it."
    )
    out = opt.out("The run's folder.  [default: a new one in runs/]")
    seed = opt.whole("--seed", None, "Overrides the scenario's seed.")
    metrics, own_observers, sensors, wind = opt.METRICS, opt.OBSERVERS, opt.SENSORS, opt.WIND
    unchecked_engine = opt.flag("--unchecked-engine", "Fly an FMU that hexjet fmu check finds unfit, or has not seen.")
    realtime = opt.flag("--realtime", "Pace the flight in real time; the same as --rtf 1.")
    rtf = opt.number(
        "--rtf",
        "X",
        "Pace the flight at X times real time; 0 is as fast as it goes.  [default: 0, or 1 with --mavlink or "
        "--flightgear]",
        min=0.0,
    )
    links = opt.words(
        "--mavlink", "URL", "Let a ground station watch, e.g. udpout:127.0.0.1:14550; see: hexjet gcs --help."
    )
    flightgear = opt.word(
        "--flightgear", "[HOST:]PORT", "Let FlightGear show it: fgfs --fdm=null --native-fdm=socket,in,60,,5550,udp."
    )
    shared_assets: bool = opt.SHARED_ASSETS
    flight = opt.whole("--flight", "N", "Fly this flight of the campaign in the folder SCENARIO again.", min=0)
    as_json = opt.json("Print the run's summary as one JSON object and nothing else.")


@click.command(epilog=example("hexjet fly roll-doublet --controller baseline --set vehicle.mass_kg=6.0"))
@opt.takes(Fly)
def fly(options: Fly) -> int:
    """Fly SCENARIO: a name in scenarios/, the path of a TOML file, or with --flight the folder of a campaign.

    Leaves a folder with summary, resolved scenario, log and report.  Status 0: as planned; or completed within its
    limits, nothing checked, where the scenario expects nothing of what flew; or with --flight the same as in the
    campaign, bit for bit.  1: the flight failed, went beyond its limits or did not come to what the scenario expects
    or requires, or is not the same.  2: wrong input.
    """
    if options.flight is not None:
        why = "a flight of a campaign is flown as it was; leave it out with --flight"
        refuse_others(why, "scenario", "flight", "out", "as_json")
        return _repeat_flight(Path(options.scenario), options.flight, options)
    from cosim.flight import fly_watched as fly_scenario
    from cosim.results.run import finish_killed
    from cosim.spec.controller_name import folder_name, short_name

    controller, rtf, watched = options.controller, options.rtf, bool(options.links or options.flightgear)
    if options.realtime and rtf is not None:
        raise InputError("--realtime and --rtf: give one of them")
    factor = (rtf or None) if rtf is not None else 1.0 if options.realtime or watched else None
    finish_killed(Path(options.scenario))
    loaded = options.load()
    _warn(loaded, controller)
    label = short_name(controller) if controller is not None else loaded.controller
    folder = options.run_folder(f"{loaded.name}-{folder_name(label)}")
    with (
        output_to_stderr(options.as_json),
        _open_flightgear(loaded, options.flightgear) as viewers,
        flight_progress(loaded, quiet=options.as_json) as watching,
        _open_links(options.links) as watch,
    ):
        run = fly_scenario(
            loaded,
            folder,
            observers=(*watching, *viewers),
            realtime_factor=factor,
            watch=watch,
            shared_assets=options.shared_assets,
        )
    options.answer(lambda: run.summary.model_dump(mode="json"), lambda: print_run(run))
    return DONE if run.summary.succeeded else FLIGHT_FAILED


def _warn(scenario: Scenario, controller: str | None) -> None:
    """Say on standard error what of a design's file, of the scenario's times and of its FMUs is not as it may seem."""
    from cosim.flight import list_warnings

    for text in list_warnings(scenario, controller):
        echo(f"hexjet: warning: {text}", err=True)
    engines = (station.engine for station in scenario.stations.values() if station.engine)
    warn_of_fmu_defects(scenario.engine, *engines, folder=scenario.folder, isolated=scenario.engine_isolated)


def _repeat_flight(folder: Path, number: int, output: opt.Output) -> int:
    from cosim.campaign import fly_again, open_campaign

    campaign = open_campaign(folder)
    out = output.run_folder(f"{campaign.study.name}-flight-{number}")
    with output_to_stderr(output.as_json):
        repeated = fly_again(campaign, number, out)
    result = {"flight": number, "same": repeated.same, "otherwise": repeated.otherwise}
    output.answer(lambda: repeated.run.summary.model_dump(mode="json") | result, lambda: print_repeated(repeated))
    return DONE if repeated.same else FLIGHT_FAILED


@contextmanager
def _open_links(links: Sequence[str]) -> Iterator[Any]:
    """Let ground stations watch, where they are named."""
    if not links:
        yield None
        return
    from cosim.groundstation.links import Links

    with Links(links) as opened:
        yield opened.make_read_only_observer()


@contextmanager
def _open_flightgear(scenario: Scenario, flightgear: str | None) -> Iterator[Sequence[Observer]]:
    """Yield FlightGear as an observer, where it is asked for; a tool has it by an entry point."""
    if flightgear is None:
        yield ()
        return
    from cosim.base.plugins.entry_points import load_hook

    if (viewer_of := load_hook("flightgear")) is None:
        raise InputError("--flightgear: none of the tools that are installed sends to FlightGear")
    viewer = viewer_of(flightgear, scenario.environment)
    try:
        yield (viewer,)
    finally:
        viewer.close()


@contextmanager
def flight_progress(scenario: Scenario, quiet: bool) -> Iterator[Sequence[Observer]]:
    """Yield an observer that shows how far the flight is, on a terminal; none in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield ()
        return
    from rich.console import Console
    from rich.progress import Progress

    every = max(1, round(0.5 / scenario.step_s))
    with on_terminal(Progress(console=Console(stderr=True), transient=True)) as progress:
        task = progress.add_task(printable(scenario.name), total=scenario.steps)

        class Watch:
            def observe(self, sample: Sample) -> None:
                if sample.k % every == 0:
                    progress.update(task, completed=sample.k)

        yield (Watch(),)


def print_repeated(repeated: RepeatedFlight) -> None:
    """Print a flight of a campaign, and whether it is what it was."""
    print_run(repeated.run)
    say(f"flight {repeated.number}: [bold]{repeated.verdict}[/bold]", marked=True)
    for line in repeated.otherwise:
        say(line, wrap=False)


def _other_engines(summary: Summary) -> str:
    """Return the engines of another kind, and the stations where they are, as text."""
    at: dict[str, list[str]] = {}
    for number, station in enumerate(summary.stations, 1):
        if station.engine != summary.engine:
            at.setdefault(station.engine, []).append(str(number))
    return "".join(f", {engine} at {' and '.join(numbers)}" for engine, numbers in at.items())


def _sensors(summary: Summary) -> str:
    return f", sensors {summary.sensors}" if summary.sensors else ""


def _print_heading(summary: Summary) -> None:
    """Print how a flight ended, what flew, and what is to be known of the verdict."""
    from rich.markup import escape

    from cosim.base.outcomes import Verdict
    from cosim.results.verdict import NOTHING_EXPECTED

    say(f"{summary.scenario}: [bold]{escape(summary.ending)}[/bold]", marked=True)
    say(
        f"{summary.aircraft}, engine {summary.engine_shown}{_other_engines(summary)}, controller "
        f"{summary.controller_shown}, seed {summary.seed}{_sensors(summary)}: {summary.duration_s:.2f} s flown"
        + _speed(summary.realtime_factor)
    )
    if summary.verdict == Verdict.NOTHING_CHECKED:
        say(NOTHING_EXPECTED)
    for note in summary.notes:
        say(f"note: {note}", wrap=False)


def print_run(run: Run) -> None:
    """Print outcome, metrics, what was expected and not met, and where the report is."""
    summary, controller = run.summary, run.summary.own_controller
    _print_heading(summary)
    print_metrics([run])
    _print_whole(run)
    _print_checked(summary)
    for text in summary.exceeded:
        say(f"beyond its limit: {text}")
    for result in summary.requirements:
        if result.source == "require":
            say(f"requirement {result.describe()}", wrap=False)
    if controller is not None and controller.repeatable is False:
        say(f"controller {summary.controller} is not repeatable: asked the same again, it answered otherwise")
    if controller is not None and controller.level == "controller" and run.scenario.monitored:
        say(f"engines were not watched: {summary.controller} is a whole controller, and sees to lost ones itself")
    for line in [*summary.own_metrics_failed, *(f"not as expected: {complaint}" for complaint in summary.complaints)]:
        say(line)
    if run.folder is not None:
        say(f"report: {run.folder / 'report.html'}", wrap=False)


_WIDE = 110  # columns of the terminal that a row an axis takes


def print_metrics(runs: Sequence[Run], by: str = "axis") -> None:
    """Print the axes' metrics in the units of the page, one row an axis and run; ``by`` names the first column."""
    from cosim.results.report.flight import axis_cell
    from cosim.results.wording import AXIS_ROWS

    heads = [f"{row.title}, {row.unit}".lower().replace("rmse", "RMSE") for row in AXIS_ROWS]
    lines = [
        [
            axis if by == "axis" else f"{run.summary.controller_shown}, {axis}",
            *(axis_cell(metrics, row.key, row.factor, row.digits) for row in AXIS_ROWS),
        ]
        for run in runs
        for axis, metrics in run.metrics.items()
        if metrics.commanded or by == "axis"
    ]
    if terminal().width < _WIDE:  # lying down: a metric a row
        heads, lines = (
            [line[0] for line in lines],
            [list(cells) for cells in zip(heads, *(line[1:] for line in lines), strict=True)],
        )
        by = "metric"
    show_table((by, *heads), lines, range(1, 1 + len(heads)), pad_edge=False)


def _print_whole(run: Run) -> None:
    """Print what is measured of the whole flight, with its limits."""
    from cosim.results.report.flight import whole_rows

    rows = [
        (
            row["label"].lower().replace("rmse", "RMSE"),
            f"[bold]{row['value']}[/bold]" if row["beyond"] else row["value"],
            row["limit"],
            row["unit"],
        )
        for row in whole_rows(run.summary)
    ]
    show_table(("whole flight", "value", "limit", "unit"), rows, (1, 2), pad_edge=False)


def _print_checked(summary: Summary) -> None:
    """Print the limits and expectations of a flight that came to its end, each with its margin and what decided it."""
    from cosim.results.report.requirements import CHECKED, checked_rows

    rows = [cells for _, cells in checked_rows(summary)] if summary.outcome == "completed" else []
    if len(rows) > 1:
        show_table(CHECKED, rows, (3, 4), pad_edge=False)
    for name, source, allowed, margin, at in rows if len(rows) == 1 else ():
        say(f"{source}: {name} {allowed}: margin {margin}, decided at {at}".replace("at overall", "overall"))


def _speed(factor: float | None) -> str:
    return "" if factor is None else f", {factor:.0f} x real time"
