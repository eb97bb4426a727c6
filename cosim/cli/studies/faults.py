"""hexjet faults and failsafes: what a vehicle survives, and how it comes down."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from cosim.base.errors import InputError
from cosim.cli.console import output_to_stderr, part_progress, terminal
from cosim.cli.options import DONE, example, refuse_others
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.campaign.engine_out import EngineOut
    from cosim.campaign.failsafe_survey import Failsafes
    from cosim.campaign.fault_survey import Survival


@click.command(epilog=example("hexjet faults --kind flame-out --kind thrust"))
@click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
@click.option("--engine", metavar="NAME|FILE", help="See: hexjet list engines.  [default: the aircraft's own]")
@click.option(
    "controllers",
    "--controller",
    metavar="NAME|FILE",
    multiple=True,
    help="[default: those with a model]",
)
@click.option("kinds", "--kind", metavar="NAME", multiple=True, help="Only faults that begin so.  [default: all]")
@click.option("--limits", is_flag=True, help="Also: how much thrust may be lost, and how late it may be noticed.")
@click.option(
    "--engine-out",
    is_flag=True,
    help="Instead: one engine out in hover, at every station, of every aircraft (or --aircraft) with every engine (or "
    "--engine) that lifts it, each with the gains designed for it, beside the lean that no throttles avoid.",
)
@click.option(
    "--designs",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Of --engine-out: where its controllers are, ENGINE.toml by hexjet design; a missing one is designed and "
    "written there.  [default: designs in --out]",
)
@click.option(
    "--docs",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="Write the tables between the marks of faults.md, with --limits, or with --engine-out of faults.md and "
    "full-scale.md, there; of all that they hold.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
@click.pass_context
def faults(
    context: click.Context,
    aircraft: str,
    engine: str | None,
    controllers: tuple[str, ...],
    kinds: tuple[str, ...],
    limits: bool,
    engine_out: bool,
    designs: Path | None,
    docs: Path | None,
    workers: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly every single fault, from hover and from a roll of 10 deg, and tell which the vehicle survives.

    Leaves survival.csv and survival.html in DIR; with --engine-out, engine-out.csv.
    """
    from cosim.campaign.fault_survey import (
        PARTS,
        survival,
        write,
        write_page,
    )
    from cosim.flight import new_folder
    from cosim.results.report.marks import check_marks
    from cosim.spec.controller_name import seen_from

    if engine_out:
        own = ("aircraft", "engine", "engine_out", "designs", "docs", "workers", "out", "as_json")
        refuse_others(context, "does not go with --engine-out", *own)
        stated = context.get_parameter_source("aircraft") is ParameterSource.COMMANDLINE
        folder = out if out is not None else new_folder(Path("runs"), "engine-out")
        return _engine_out(
            (aircraft,) if stated else (), (engine,) if engine else (), folder, designs, docs, workers, as_json
        )
    if designs is not None:
        raise InputError("--designs goes with --engine-out")
    page = None if docs is None else docs / "faults.md"
    if page is not None:
        why = "the page holds every fault of the default vehicle with every controller; leave it out with --docs"
        refuse_others(context, why, "docs", "limits", "workers", "out", "as_json")
        check_marks(page, PARTS)

    with output_to_stderr(as_json), part_progress("faults", quiet=as_json) as say:
        named = [seen_from(controller, Path()) for controller in controllers]
        result = survival(aircraft, engine, named, kinds, workers, say, limits or page is not None)
    paths = write(result, out if out is not None else new_folder(Path("runs"), f"faults-{result.aircraft}"))
    for text in result.warnings:
        click.echo(f"hexjet: warning: {text}", err=True)
    if page is not None:
        write_page(result, page)
    if as_json:
        click.echo(json.dumps(result.to_dict(), allow_nan=False))
    else:
        print_survival(result, paths["report"])
    return DONE


def _engine_out(
    aircraft: tuple[str, ...],
    engines: tuple[str, ...],
    folder: Path,
    designs: Path | None,
    docs: Path | None,
    workers: int,
    as_json: bool,
) -> int:
    from cosim.campaign.engine_out import (
        check_pages,
        engine_out,
        write,
        write_pages,
    )

    if docs is not None:
        if aircraft or engines:
            raise InputError("--docs: the pages hold every aircraft and engine; leave out --aircraft and --engine")
        check_pages(docs)
    with output_to_stderr(as_json), part_progress("engine out", quiet=as_json) as say:
        result = engine_out(aircraft, engines, designs or folder / "designs", workers, say)
    path = write(result, folder)
    pages = write_pages(result, docs) if docs is not None else []
    if as_json:
        click.echo(json.dumps(result.to_dict(), allow_nan=False))
    else:
        print_engine_out(result, [path, *pages])
    return DONE


@click.command(epilog=example("hexjet failsafes --failsafe GNSS --height 10 --wind 5"))
@click.option(
    "--aircraft", metavar="NAME", multiple=True, default=["hexjet"], show_default=True, help="all: those of the table."
)
@click.option("--engine", metavar="NAME|FILE", help="See: hexjet list engines.  [default: the aircraft's own]")
@click.option("--controller", metavar="NAME", help="[default: smith, or baseline where there is no model]")
@click.option("kinds", "--failsafe", metavar="NAME", multiple=True, help="Only those that begin so.  [default: all]")
@click.option(
    "heights",
    "--height",
    type=float,
    metavar="M",
    multiple=True,
    help="[default: 3, 10 and 30 m, and 100 and 300 m where the fuel runs down]",
)
@click.option("winds", "--wind", type=float, metavar="M/S", multiple=True, help="[default: 0, 5 and 10 m/s]")
@click.option(
    "--flights",
    type=click.IntRange(1, 1000),
    default=3,
    show_default=True,
    help="From each height, each in the next of the winds and at a moment of its own.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the moments and the noise.")
@click.option("--airborne", is_flag=True, help="Begin in the air, trimmed, from every height in every wind once.")
@click.option(
    "--moving",
    type=float,
    metavar="M/S",
    default=5.0,
    show_default=True,
    help="What loses the position also begins at this speed, from 10 m on, in the least wind; 0: not.",
)
@click.option("--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("--page", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", help="Write the table there.")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def failsafes(
    aircraft: tuple[str, ...],
    engine: str | None,
    controller: str | None,
    kinds: tuple[str, ...],
    heights: tuple[float, ...],
    winds: tuple[float, ...],
    flights: int,
    seed: int,
    airborne: bool,
    moving: float,
    workers: int,
    out: Path | None,
    page: Path | None,
    as_json: bool,
) -> int:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Flown after a take-off to every height and some hover, several times, and moving, with the speeds of touch-down and
    the thrust ten seconds after disarming.  Leaves
    failsafes.csv in DIR, and in DIR/flights every flight as a scenario with its requests: hexjet fly flies it again.
    With several aircraft each has a folder of its name in DIR.
    """
    from cosim.campaign.failsafe_survey import TABLED, WINDS_M_S, Conditions
    from cosim.campaign.failsafe_survey import failsafes as fly_all
    from cosim.campaign.failsafe_table import mark, markdown, write
    from cosim.flight import new_folder
    from cosim.results.report.marks import check_marks, write_marks
    from cosim.spec.vehicle import aircraft_name

    if "all" in aircraft:
        if len(aircraft) > 1:
            raise InputError("--aircraft all: leave out the others")
        aircraft = TABLED
    aircraft = tuple(dict.fromkeys(aircraft))
    several = len(aircraft) > 1
    if page is not None:
        if airborne:
            raise InputError("--page: the page has flights after a take-off; leave out --airborne")
        check_marks(page, [mark(aircraft_name(name)) for name in aircraft])
    results: list[Failsafes] = []
    folder = out
    with output_to_stderr(as_json), part_progress("failsafes", quiet=as_json) as say:
        conditions = Conditions(heights, winds or WINDS_M_S, moving, flights, airborne, seed)
        for survey in fly_all(aircraft, engine, controller, kinds, conditions, workers, say):
            if folder is None:
                folder = new_folder(Path("runs"), "failsafes" if several else f"failsafes-{survey.aircraft}")
            table = write(survey, folder / survey.aircraft if several else folder)
            if not as_json:
                print_failsafes(survey, table)
            results.append(survey)
    if page is not None:
        write_marks(page, {mark(survey.aircraft): markdown(survey) for survey in results})
    if as_json:
        tables = [survey.to_dict() for survey in results]
        click.echo(json.dumps({"tables": tables} if several else tables[0], allow_nan=False))
    return DONE


def print_survival(result: Survival, report: Path) -> None:
    """How many places of each fault are held, by controller, what explains it, and where the report is."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.fault_survey import summary
    from cosim.spec.controller_name import label

    console = terminal()
    controllers, rows = summary(result)
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("fault", "from", *map(label, controllers), "detected, s"):
        table.add_column(title, justify="left" if title in ("fault", "from") else "right")
    for kind, start, cells in rows:
        times = [time for cell in cells if cell.detected_s for time in cell.detected_s]
        shown = [f"{cell.held}/{cell.flights}  {cell.lean_deg:3.0f} deg {cell.lost_m:4.1f} m" for cell in cells]
        table.add_row(kind, start, *shown, f"{min(times):.3f} to {max(times):.3f}" if times else "-")
    console.print(table)
    console.print(
        "held at so many of the places where it can happen; the largest lean and the most height lost there",
        highlight=False,
    )
    for name in result.unwatched:
        console.print(f"no engine monitor with {name}: a whole controller sees to lost engines itself", highlight=False)
    if result.moments is not None:
        moments = result.moments
        console.print(
            f"a jet lost in hover: {moments.moment:.3g} N m about roll, {moments.acceleration:.3g} rad/s^2; "
            f"{moments.late:.3g} s until the others answer: {moments.rate:.2g} rad/s, {moments.angle:.2g} rad by then",
            highlight=False,
        )
    for limit in result.limits:
        held, airborne = (" ".join(f"{value:g}" for value in values) or "-" for values in (limit.held, limit.airborne))
        lost = "nowhere" if limit.lost_at is None else f"at {limit.lost_at:g}"
        name = label(limit.controller)
        console.print(
            f"{limit.quantity}, {limit.start}, {name}: held at {held}; airborne at {airborne}; lost {lost}",
            highlight=False,
            soft_wrap=True,
        )
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("lost jets", "thrust over weight", "roll authority", "yaw balanced"):
        table.add_column(title, justify="left" if title == "lost jets" else "right")
    for attainable in result.attainable:
        roll = "cannot hover" if attainable.roll is None else f"{100.0 * attainable.roll:.0f} %"
        lost = ", ".join(map(str, attainable.lost)) or "none"
        table.add_row(lost, f"{attainable.thrust:.2f}", roll, "yes" if attainable.yaw else "no")
    console.print(table)
    console.print(f"report: {report}", highlight=False, soft_wrap=True)


def print_engine_out(result: EngineOut, paths: Sequence[Path]) -> None:
    """What became of every vehicle with one engine out, what no control could have done better, and where it stands."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.engine_out import TABLES, rows

    console = terminal()
    aircraft = [flight.aircraft for flight in result.flights] + [flight.aircraft for flight in result.left]
    for name, lines in rows(result, aircraft).items():
        table = Table(box=box.SIMPLE_HEAD)
        for title in TABLES[name]:
            table.add_column(title)
        for line in lines:
            table.add_row(*line)
        if lines:
            console.print(table)
    console.print(
        "each jet: verdict, largest lean, height lost, furthest drift; bounds: the lean that no throttles avoid, "
        "and while it does not spin no tilts either, told of it at once; the second table: the bound for throttles "
        "alone with one thing changed, and when the opposite engine has to be shut off for a bound at the limit",
        highlight=False,
    )
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)


def print_failsafes(result: Failsafes, table: Path) -> None:
    """What became of each failsafe from each start, and where the flights are."""
    from rich import box
    from rich.table import Table

    from cosim.campaign.failsafe_table import grid, summary

    console = terminal()
    shown = Table(box=box.SIMPLE_HEAD)
    if result.airborne:
        numbers = ("wind, m/s", "moving, m/s", "ended", "down, m/s", "sideways, m/s", "thrust 10 s later, N")
        for title in ("failsafe", *numbers):
            shown.add_column(title, justify="left" if title in ("failsafe", "ended") else "right")
        for row in summary(result):
            worst = [
                "-" if value != value else f"{value:{form}}"
                for value, form in ((row.touchdown_m_s, ".2f"), (row.sideways_m_s, ".2f"), (row.thrust_n, ".1f"))
            ]
            shown.add_row(row.failsafe, f"{row.wind_m_s:g}", f"{row.speed_m_s:g}", row.ends, *worst)
    else:
        head, *lines = grid(result)
        for title in head:
            shown.add_column(title)
        for line in lines:
            shown.add_row(*line)
    console.print(shown)
    console.print(
        f"{result.aircraft}, {result.engine}, {result.controller}: the fastest touch-down and the most thrust of all "
        f"{'heights' if result.airborne else 'flights of a cell'}; a leg that touches faster than "
        f"{result.limit_m_s:.2f} m/s counts as a crash; faster than {result.trip_m_s:.2f} m/s sideways it has slid",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"every flight: {table}", highlight=False, soft_wrap=True)
