"""hexjet faults and failsafes: what a vehicle survives, and how it comes down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.cli import opt
from cosim.cli.console import output_to_stderr, part_progress, say, show_table
from cosim.cli.options import DONE, example, is_given, refuse_others

if TYPE_CHECKING:
    from cosim.campaign.surveys.engine_out import EngineOut
    from cosim.campaign.surveys.failsafes import Failsafes
    from cosim.campaign.surveys.faults import Survival


class Faults(opt.Output):
    """Options of ``hexjet faults``."""

    aircraft = opt.word("--aircraft", None, "See: hexjet list aircraft.", "hexjet")
    engine = opt.word("--engine", "NAME|FILE", "See: hexjet list engines.  [default: the aircraft's own]")
    controllers = opt.words("--controller", "NAME|FILE", "[default: those with a model]")
    kinds = opt.words("--kind", "NAME", "Only faults that begin so.  [default: all]")
    limits = opt.flag("--limits", "Also: how much thrust may be lost, and how late it may be noticed.")
    engine_out = opt.flag(
        "--engine-out",
        "Instead: one engine out in hover, at every station, of every aircraft (or --aircraft) with every engine "
        "(or --engine) that lifts it, each with the gains designed for it, beside the lean that no throttles avoid.",
    )
    designs = opt.path(
        "--designs",
        "DIR",
        "Of --engine-out: where its controllers are, ENGINE.toml by hexjet design; a missing one is designed and "
        "written there.  [default: designs in --out]",
        file_okay=False,
    )
    docs = opt.path(
        "--docs",
        "DIR",
        "Write the tables between the marks of faults.md, with --limits, or with --engine-out of faults.md and "
        "full-scale.md, there; of all that they hold.",
        exists=True,
        file_okay=False,
    )
    nominal_engine = opt.NOMINAL_ENGINE
    workers: int = opt.WORKERS
    out = opt.OUT
    as_json = opt.JSON


@click.command(epilog=example("hexjet faults --kind flame-out --kind thrust"))
@opt.takes(Faults)
def faults(options: Faults) -> int:
    """Fly every single fault, from hover and from a roll of 10 deg, and tell which the vehicle survives.

    Leaves survival.csv and survival.html in DIR; with --engine-out, engine-out.csv.
    """
    from cosim.campaign.surveys.fault_page import MARKS, write, write_page
    from cosim.campaign.surveys.faults import survival
    from cosim.results.report.marks import check_marks
    from cosim.spec.controller_name import seen_from

    if options.engine_out:
        return _engine_out(options)
    if options.designs is not None:
        raise InputError("--designs goes with --engine-out")
    page = None if options.docs is None else options.docs / "faults.md"
    if page is not None:
        why = "the page holds every fault of the default vehicle with every controller; leave it out with --docs"
        refuse_others(why, "docs", "limits", "workers", "out", "as_json")
        check_marks(page, MARKS)

    options.check_out("survival.csv", "survival.html", "cases")
    limits = options.limits or page is not None
    with output_to_stderr(options.as_json), part_progress("faults", quiet=options.as_json) as tell:
        named = [seen_from(controller, Path()) for controller in options.controllers]
        result = survival(
            options.aircraft, options.engine, named, options.kinds, options.workers, tell, limits,
            options.nominal_engine,
        )  # fmt: skip
    paths = write(result, options.run_folder(f"faults-{result.aircraft}"))
    for text in result.warnings:
        click.echo(f"hexjet: warning: {text}", err=True)
    if page is not None:
        write_page(result, page)
    options.answer(result.to_dict, lambda: print_survival(result, paths["report"]))
    return DONE


def _engine_out(options: Faults) -> int:
    from cosim.campaign.surveys.engine_out import check_pages, engine_out, write, write_pages

    allowed = (
        "aircraft", "engine", "engine_out", "designs", "docs", "nominal_engine", "workers", "out", "as_json",
    )  # fmt: skip
    refuse_others("does not go with --engine-out", *allowed)
    aircraft = (options.aircraft,) if is_given("aircraft") else ()
    engines = (options.engine,) if options.engine else ()
    folder, docs = options.run_folder("engine-out"), options.docs
    if docs is not None:
        if aircraft or engines:
            raise InputError("--docs: the pages hold every aircraft and engine; leave out --aircraft and --engine")
        check_pages(docs)
    with output_to_stderr(options.as_json), part_progress("engine out", quiet=options.as_json) as tell:
        designs = options.designs or folder / "designs"
        result = engine_out(aircraft, engines, designs, options.workers, tell, options.nominal_engine)
    path = write(result, folder)
    pages = write_pages(result, docs) if docs is not None else []
    options.answer(result.to_dict, lambda: print_engine_out(result, [path, *pages]))
    return DONE


class FailsafeOptions(opt.Output):
    """Options of ``hexjet failsafes``."""

    aircraft: tuple[str, ...] = opt.option(
        "--aircraft", metavar="NAME", multiple=True, default=["hexjet"], show_default=True,
        help="all: those of the table.",
    )  # fmt: skip
    engine = opt.word("--engine", "NAME|FILE", "See: hexjet list engines.  [default: the aircraft's own]")
    controller = opt.word("--controller", "NAME", "[default: smith, or baseline where there is no model]")
    kinds = opt.words("--failsafe", "NAME", "Only those that begin so.  [default: all]")
    heights: tuple[float, ...] = opt.option(
        "--height",
        type=float,
        metavar="M",
        multiple=True,
        help="[default: 3, 10 and 30 m, and 100 and 300 m where the fuel runs down]",
    )
    winds: tuple[float, ...] = opt.option(
        "--wind", type=float, metavar="M/S", multiple=True, help="[default: 0, 5 and 10 m/s]"
    )
    flights = opt.whole(
        "--flights",
        None,
        "From each height, each in the next of the winds and at a moment of its own.",
        min=1,
        max=1000,
        default=3,
    )
    seed = opt.whole("--seed", None, "Of the moments and the noise.", min=0, default=0)
    airborne = opt.flag("--airborne", "Begin in the air, trimmed, from every height in every wind once.")
    nominal_engine = opt.NOMINAL_ENGINE
    moving: float = opt.option(
        "--moving",
        type=float,
        metavar="M/S",
        default=5.0,
        show_default=True,
        help="What loses the position also begins at this speed, from 10 m on, in the least wind; 0: not.",
    )
    workers: int = opt.WORKERS
    out = opt.OUT
    page = opt.path("--page", "FILE", "Write the table there.", dir_okay=False)
    as_json = opt.JSON


@click.command(epilog=example("hexjet failsafes --failsafe GNSS --height 10 --wind 5"))
@opt.takes(FailsafeOptions)
def failsafes(options: FailsafeOptions) -> int:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Flown after a take-off to every height and some hover, several times, and moving, with the speeds of touch-down and
    the thrust ten seconds after disarming.  Leaves
    failsafes.csv in DIR, and in DIR/flights every flight as a scenario with its requests: hexjet fly flies it again.
    With several aircraft each has a folder of its name in DIR.
    """
    from cosim.campaign.surveys.failsafe_table import mark, markdown, write
    from cosim.campaign.surveys.failsafes import TABLED, WINDS_M_S, Conditions
    from cosim.campaign.surveys.failsafes import failsafes as fly_all
    from cosim.results.report.marks import check_marks, write_marks
    from cosim.spec.vehicle import aircraft_name

    aircraft, page = options.aircraft, options.page
    if "all" in aircraft:
        if len(aircraft) > 1:
            raise InputError("--aircraft all: leave out the others")
        aircraft = TABLED
    aircraft = tuple(dict.fromkeys(aircraft))
    several = len(aircraft) > 1
    if page is not None:
        if options.airborne:
            raise InputError("--page: the page has flights after a take-off; leave out --airborne")
        check_marks(page, [mark(aircraft_name(name)) for name in aircraft])
    conditions = Conditions(
        options.heights, options.winds or WINDS_M_S, options.moving, options.flights, options.airborne, options.seed,
        options.nominal_engine,
    )  # fmt: skip
    results: list[Failsafes] = []
    folder: Path | None = None
    with output_to_stderr(options.as_json), part_progress("failsafes", quiet=options.as_json) as tell:
        surveys = fly_all(
            aircraft, options.engine, options.controller, options.kinds, conditions, options.workers, tell
        )
        for survey in surveys:
            folder = folder or options.run_folder("failsafes" if several else f"failsafes-{survey.aircraft}")
            table = write(survey, folder / survey.aircraft if several else folder)
            if not options.as_json:
                print_failsafes(survey, table)
            results.append(survey)
    if page is not None:
        write_marks(page, {mark(survey.aircraft): markdown(survey) for survey in results})
    tables = [survey.to_dict() for survey in results]
    options.answer(lambda: {"tables": tables} if several else tables[0], lambda: None)
    return DONE


def print_survival(result: Survival, report: Path) -> None:
    """Print how many places of each fault are held, by controller, what explains it, and where the report is."""
    from cosim.campaign.surveys.faults import summary
    from cosim.spec.controller_name import label

    controllers, survived = summary(result)
    rows = []
    for kind, start, cells in survived:
        times = [time for cell in cells if cell.detected_s for time in cell.detected_s]
        columns = [f"{cell.held}/{cell.flights}  {cell.lean_deg:3.0f} deg {cell.lost_m:4.1f} m" for cell in cells]
        rows.append((kind, start, *columns, f"{min(times):.3f} to {max(times):.3f}" if times else "-"))
    titles = ("fault", "from", *map(label, controllers), "detected, s")
    show_table(titles, rows, range(2, len(titles)))
    if result.engine_note:
        say(result.engine_note, wrap=False)
    say("held at so many of the places where it can happen; the largest lean and the most height lost there")
    for name in result.unmonitored_controllers:
        say(f"no engine monitor with {name}: a whole controller sees to lost engines itself")
    if result.moments is not None:
        moments = result.moments
        say(
            f"a jet lost in hover: {moments.moment:.3g} N m about roll, {moments.acceleration:.3g} rad/s^2; "
            f"{moments.late:.3g} s until the others answer: {moments.rate:.2g} rad/s, {moments.angle:.2g} rad by then"
        )
    for limit in result.limits:
        held, airborne = (" ".join(f"{value:g}" for value in values) or "-" for values in (limit.held, limit.airborne))
        lost = "nowhere" if limit.lost_at is None else f"at {limit.lost_at:g}"
        name = label(limit.controller)
        say(f"{limit.quantity}, {limit.start}, {name}: held at {held}; airborne at {airborne}; lost {lost}", wrap=False)
    rows = []
    for attainable in result.attainable:
        roll = "cannot hover" if attainable.roll is None else f"{100.0 * attainable.roll:.0f} %"
        lost = ", ".join(map(str, attainable.lost)) or "none"
        rows.append((lost, f"{attainable.thrust:.2f}", roll, "yes" if attainable.yaw else "no"))
    show_table(("lost jets", "thrust over weight", "roll authority", "yaw balanced"), rows, (1, 2, 3))
    say(f"report: {report}", wrap=False)


def print_engine_out(result: EngineOut, paths: Sequence[Path]) -> None:
    """Print what became of every vehicle with one engine out, its bounds, and where it stands."""
    from cosim.campaign.surveys.engine_out import TABLES, rows

    aircraft = [flight.aircraft for flight in result.flights] + [flight.aircraft for flight in result.left]
    for name, lines in rows(result, aircraft).items():
        show_table(TABLES[name], lines)
    say(
        "each jet: verdict, largest lean, height lost, furthest drift; bounds: the lean that no throttles avoid, "
        "and while it does not spin no tilts either, told of it at once; the second table: the bound for throttles "
        "alone with one thing changed, and when the opposite engine has to be shut off for a bound at the limit"
    )
    for text in (*result.engine_notes, *map(str, paths)):
        say(text, wrap=False)


def print_failsafes(result: Failsafes, table: Path) -> None:
    """Print what became of each failsafe from each start, and where the flights are."""
    from cosim.campaign.surveys.failsafe_table import grid, summary

    if result.airborne:
        titles = ("failsafe", "wind, m/s", "moving, m/s", "ended", "down, m/s", "sideways, m/s", "thrust 10 s later, N")
        rows = []
        for row in summary(result):
            worst = [
                "-" if value != value else f"{value:{form}}"
                for value, form in ((row.touchdown_m_s, ".2f"), (row.sideways_m_s, ".2f"), (row.thrust_n, ".1f"))
            ]
            rows.append((row.failsafe, f"{row.wind_m_s:g}", f"{row.speed_m_s:g}", row.ends, *worst))
        show_table(titles, rows, (1, 2, 4, 5, 6))
    else:
        head, *lines = grid(result)
        show_table(head, lines)
    say(
        f"{result.aircraft}, {result.engine}, {result.controller}: the fastest touch-down and the most thrust of all "
        f"{'heights' if result.airborne else 'flights of a cell'}; a leg that touches faster than "
        f"{result.limit_m_s:.2f} m/s counts as a crash; faster than {result.trip_m_s:.2f} m/s sideways it has slid"
    )
    if result.engine_note:
        say(result.engine_note, wrap=False)
    say(f"every flight: {table}", wrap=False)
