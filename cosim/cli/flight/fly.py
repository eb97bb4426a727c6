"""hexjet fly: one flight, and a flight of a campaign again."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli.console import on_terminal, output_to_stderr, terminal
from cosim.cli.options import (
    DONE,
    FLIGHT_FAILED,
    Number,
    example,
    load_scenario,
    offer_to_compile,
    own_blocks,
    refuse_others,
    shared_assets,
    warn_of_blemishes,
    with_own_blocks,
)
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.base.protocols import Observer
    from cosim.base.signals import Sample
    from cosim.campaign.run import RepeatedFlight
    from cosim.results.run import Run, Summary
    from cosim.spec.scenario import Scenario


@click.command(epilog=example("hexjet fly roll-doublet --controller baseline --set vehicle.mass_kg=6.0"))
@click.argument("scenario")
@click.option(
    "--controller",
    metavar="NAME|FILE",
    help="Overrides the scenario's; see: hexjet list controllers. Or a file that hexjet design wrote, with all gains; "
    "or one of yours: FILE.py:Class, package.module:Class, FILE.fmu, 'process:FILE ARGUMENTS'.",
)
@click.option(
    "--aircraft",
    metavar="NAME",
    help="Overrides the scenario's, with the engine that it is made for; see: hexjet list aircraft.",
)
@click.option(
    "engines",
    "--engine",
    metavar="[N=]NAME|FILE",
    multiple=True,
    help="Overrides the scenario's: a name (see: hexjet list engines), an .fmu or a .toml that maps one; with N= "
    "the one at station N alone.",
)
@click.option(
    "settings",
    "--set",
    metavar="KEY=VALUE",
    multiple=True,
    help="Write a value over the scenario's, e.g. vehicle.mass_kg=6.0; its expectations are not checked then.",
)
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="Predict with the identified models in this file, as hexjet identify writes it.",
)
@click.option("--out", type=Out(), metavar="DIR", help="The run's folder.  [default: a new one in runs/]")
@click.option("--seed", type=int, help="Overrides the scenario's seed.")
@own_blocks
@click.option("--unchecked-engine", is_flag=True, help="Fly an FMU that hexjet fmu check finds unfit, or has not seen.")
@click.option("--realtime", is_flag=True, help="Pace the flight in real time; the same as --rtf 1.")
@click.option(
    "--rtf",
    type=Number(min=0.0),
    metavar="X",
    help="Pace the flight at X times real time; 0 is as fast as it goes.  "
    "[default: 0, or 1 with --mavlink or --flightgear]",
)
@click.option(
    "links",
    "--mavlink",
    metavar="URL",
    multiple=True,
    help="Let a ground station watch, e.g. udpout:127.0.0.1:14550; see: hexjet gcs --help.",
)
@click.option(
    "--flightgear",
    metavar="[HOST:]PORT",
    help="Let FlightGear show it: fgfs --fdm=null --native-fdm=socket,in,60,,5550,udp.",
)
@shared_assets
@click.option("--flight", type=click.IntRange(min=0), metavar="N", help="Of a campaign in the folder SCENARIO.")
@click.option("as_json", "--json", is_flag=True, help="Print the run's summary as one JSON object and nothing else.")
@click.pass_context
def fly(
    context: click.Context,
    scenario: str,
    controller: str | None,
    aircraft: str | None,
    engines: tuple[str, ...],
    settings: tuple[str, ...],
    model: Path | None,
    out: Path | None,
    seed: int | None,
    metrics: tuple[str, ...],
    own_observers: tuple[str, ...],
    sensors: str | None,
    wind: str | None,
    unchecked_engine: bool,
    realtime: bool,
    rtf: float | None,
    links: tuple[str, ...],
    flightgear: str | None,
    shared_assets: bool,
    flight: int | None,
    as_json: bool,
) -> int:
    """Fly SCENARIO: a name in scenarios/, the path of a TOML file, or with --flight the folder of a campaign.

    Leaves a folder with summary, resolved scenario, log and report.  Status 0: as planned; or completed within its
    limits, nothing checked, where the scenario expects nothing of what flew; or with --flight the same as in the
    campaign, bit for bit.  1: the flight failed, went beyond its limits or did not come to what the scenario expects,
    or is not the same.  2: wrong input.
    """
    if flight is not None:
        why = "a flight of a campaign is flown as it was; leave it out with --flight"
        refuse_others(context, why, "scenario", "flight", "out", "as_json")
        return _fly_again(Path(scenario), flight, out, as_json)
    from cosim.flight import fly as fly_scenario
    from cosim.flight import new_folder
    from cosim.results.run import finish_killed
    from cosim.spec.controller_name import folder_name, is_design, short_name

    if realtime and rtf is not None:
        raise InputError("--realtime and --rtf: give one of them")
    factor = (rtf or None) if rtf is not None else 1.0 if realtime or links or flightgear else None
    finish_killed(Path(scenario))
    offer_to_compile(*engines)
    loaded = load_scenario(scenario, controller, engines, seed, settings, model, aircraft)
    loaded = with_own_blocks(loaded, metrics, own_observers, sensors, wind)
    if unchecked_engine:
        loaded = loaded.replace(engine_unchecked=True)
    if controller is not None and is_design(controller):
        from cosim.simulation.controllers.controller_file import differences

        for text in differences(loaded, Path(controller)):
            click.echo(f"hexjet: warning: {controller}: {text}", err=True)
    for text in loaded.after_the_end():
        click.echo(f"hexjet: warning: scenario {loaded.name}: {text}", err=True)
    warn_of_blemishes(loaded.engine, *(s.engine for s in loaded.stations.values() if s.engine), folder=loaded.folder)
    named = short_name(controller) if controller is not None else loaded.controller
    folder = out if out is not None else new_folder(Path("runs"), f"{loaded.name}-{folder_name(named)}")
    with (
        output_to_stderr(as_json),
        _shown(loaded, flightgear) as viewers,
        flight_progress(loaded, quiet=as_json) as watching,
    ):
        observers = (*watching, *viewers)
        if links:
            from cosim.groundstation.links import Links

            with Links(links) as opened:
                watch = opened.read_only()
                run = fly_scenario(
                    loaded,
                    folder,
                    observers=observers,
                    realtime_factor=factor,
                    watch=watch,
                    shared_assets=shared_assets,
                )
        else:
            run = fly_scenario(loaded, folder, observers=observers, realtime_factor=factor, shared_assets=shared_assets)
    if as_json:
        click.echo(json.dumps(run.summary.model_dump(mode="json"), allow_nan=False))
    else:
        print_run(run)
    return DONE if run.summary.succeeded else FLIGHT_FAILED


def _fly_again(folder: Path, number: int, out: Path | None, as_json: bool) -> int:
    from cosim.campaign import fly_again, open_campaign
    from cosim.flight import new_folder

    campaign = open_campaign(folder)
    out = out if out is not None else new_folder(Path("runs"), f"{campaign.study.name}-flight-{number}")
    with output_to_stderr(as_json):
        again = fly_again(campaign, number, out)
    if as_json:
        same = {"flight": number, "same": again.same, "otherwise": again.otherwise}
        click.echo(json.dumps(again.run.summary.model_dump(mode="json") | same, allow_nan=False))
    else:
        print_again(again)
    return DONE if again.same else FLIGHT_FAILED


@contextmanager
def _shown(scenario: Scenario, flightgear: str | None) -> Iterator[Sequence[Observer]]:
    """FlightGear as an observer, where it is asked for."""
    if flightgear is None:
        yield ()
        return
    from cosim.results.export.flightgear import FlightGear

    place = scenario.environment
    viewer = FlightGear(flightgear, place.latitude_deg, place.longitude_deg, place.ground_m)
    try:
        yield (viewer,)
    finally:
        viewer.close()


@contextmanager
def flight_progress(scenario: Scenario, quiet: bool) -> Iterator[Sequence[Observer]]:
    """An observer that shows how far the flight is, on a terminal; none in a pipe."""
    if quiet or not sys.stderr.isatty():
        yield ()
        return
    from rich.console import Console
    from rich.progress import Progress

    every = max(1, round(0.5 / scenario.step_s))
    with on_terminal(Progress(console=Console(stderr=True), transient=True)) as progress:
        task = progress.add_task(scenario.name, total=scenario.steps)

        class Watch:
            def observe(self, sample: Sample) -> None:
                if sample.k % every == 0:
                    progress.update(task, completed=sample.k)

        yield (Watch(),)


def print_again(again: RepeatedFlight) -> None:
    """A flight of a campaign, and whether it is what it was."""
    print_run(again.run)
    console = terminal()
    console.print(f"flight {again.number}: [bold]{again.verdict}[/bold]", highlight=False)
    for line in again.otherwise:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _others(summary: Summary) -> str:
    """The engines of another kind, and the stations where they are."""
    at: dict[str, list[str]] = {}
    for number, station in enumerate(summary.stations, 1):
        if station.engine != summary.engine:
            at.setdefault(station.engine, []).append(str(number))
    return "".join(f", {engine} at {' and '.join(numbers)}" for engine, numbers in at.items())


def _sensors(summary: Summary) -> str:
    return f", sensors {summary.sensors}" if summary.sensors else ""


def print_run(run: Run) -> None:
    """Outcome, metrics, what was expected and not met, and where the report is."""
    from rich.markup import escape

    summary = run.summary
    console = terminal()
    console.print(f"{summary.scenario}: [bold]{escape(summary.ending)}[/bold]", highlight=False)
    console.print(
        f"{summary.aircraft}, engine {summary.engine_shown}{_others(summary)}, controller {summary.controller_shown}, "
        f"seed {summary.seed}{_sensors(summary)}: {summary.duration_s:.2f} s flown" + _speed(summary.realtime_factor),
        highlight=False,
    )
    for note in summary.notes:
        console.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    print_metrics([run])
    _print_whole(run)
    for text in summary.exceeded:
        console.print(f"beyond its limit: {text}", highlight=False)
    for engine, why in dict.fromkeys((station.engine, station.apart) for station in summary.stations if station.apart):
        text = f"engines in a process of their own, because {engine} {why}"
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    own = summary.own_controller
    if own is not None and own.repeatable is False:
        console.print(
            f"controller {summary.controller} is not repeatable: asked the same again, it answered otherwise",
            highlight=False,
            markup=False,
        )
    if own is not None and own.level == "controller" and run.scenario.monitored:
        console.print(
            f"engines were not watched: {summary.controller} is a whole controller, and sees to lost ones itself",
            highlight=False,
            markup=False,
        )
    for line in summary.own_metrics_failed:
        console.print(line, highlight=False, markup=False)
    for complaint in summary.complaints:
        console.print(f"not as expected: {complaint}", highlight=False)
    if run.folder is not None:
        console.print(f"report: {run.folder / 'report.html'}", highlight=False, soft_wrap=True)


_WIDE = 110  # columns of the terminal that a row an axis takes


def print_metrics(runs: Sequence[Run], by: str = "axis") -> None:
    """A table of the axes' metrics in the units of the page, one row an axis and run; ``by`` names the first column."""
    from rich import box
    from rich.table import Table

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
    console = terminal()
    if console.width < _WIDE:  # lying down: a metric a row
        heads, lines = (
            [line[0] for line in lines],
            [list(cells) for cells in zip(heads, *(line[1:] for line in lines), strict=True)],
        )
        by = "metric"
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(by)
    for head in heads:
        table.add_column(head, justify="right")
    for line in lines:
        table.add_row(*line)
    console.print(table)


def _print_whole(run: Run) -> None:
    """What is measured of the whole flight, with its limits."""
    from rich import box
    from rich.table import Table

    from cosim.results.report.flight import whole_rows

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for title in ("whole flight", "value", "limit", "unit"):
        table.add_column(title, justify="right" if title in ("value", "limit") else "left")
    for row in whole_rows(run.summary):
        value = f"[bold]{row['value']}[/bold]" if row["beyond"] else row["value"]
        table.add_row(row["label"].lower().replace("rmse", "RMSE"), value, row["limit"], row["unit"])
    if table.row_count:
        terminal().print(table)


def _speed(factor: float | None) -> str:
    return "" if factor is None else f", {factor:.0f} x real time"
