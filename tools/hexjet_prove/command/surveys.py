"""hexjet faults and failsafes: what a vehicle survives, and how it comes down."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.commands import DONE, CommandProgress, echo, example, opt, output_to_stderr, part_progress, say, show_table

if TYPE_CHECKING:
    from hexjet_prove.api.surveys import FailsafesResult, FaultsResult
    from hexjet_prove.surveys.failsafes import Failsafes


class Faults(opt.Output):
    """Options of ``hexjet faults``."""

    aircraft = opt.word("--aircraft", "NAME|DIR", "See: hexjet list aircraft.", "hexjet")
    engine = opt.word("--engine", "NAME|FILE", "See: hexjet list engines.  [default: the aircraft's own]")
    controllers = opt.words("--controller", "NAME|FILE", "[default: those with a model]")
    kinds = opt.words("--kind", "NAME", "Only faults that begin so.  [default: all]")
    limits = opt.flag("--limits", "Also: how much thrust may be lost, and how late it may be noticed.")
    nominal_engine = opt.NOMINAL_ENGINE
    workers: int = opt.WORKERS
    out = opt.OUT
    as_json = opt.JSON


@click.command(epilog=example("hexjet faults --kind flame-out --kind thrust"))
@opt.takes(Faults)
def faults(options: Faults) -> int:
    """Fly every single fault, from hover and from a roll of 10 deg, and tell which the vehicle survives.

    Leaves survival.csv and survival.html in DIR.
    """
    from hexjet_prove.api.surveys import WRITTEN
    from hexjet_prove.api.surveys import faults as fly_all

    options.check_out(*WRITTEN)
    chosen = options.chosen("aircraft", "engine", "controllers", "kinds", "nominal_engine", "workers")
    with output_to_stderr(options.as_json), part_progress("faults", quiet=options.as_json) as tell:
        found = fly_all(**chosen, limits=options.limits, progress=CommandProgress(tell))
    result = found.survival
    found.write(options.run_folder(f"faults-{result.aircraft}"))
    for text in result.warnings:
        echo(f"hexjet: warning: {text}", err=True)
    options.answer(found.to_dict, lambda: print_survival(found))
    return DONE


class FailsafeOptions(opt.Output):
    """Options of ``hexjet failsafes``."""

    aircraft: tuple[str, ...] = opt.option(
        "--aircraft", metavar="NAME|DIR", multiple=True, default=["hexjet"], show_default=True,
        help="all: those of the table.",
    )  # fmt: skip
    engine = opt.word("--engine", "NAME|FILE", "See: hexjet list engines.  [default: the aircraft's own]")
    controller = opt.word("--controller", "NAME|FILE", "[default: smith, or baseline where there is no model]")
    kinds = opt.words("--failsafe", "NAME", "Only those that begin so.  [default: all]")
    heights: tuple[float, ...] = opt.option(
        "--height",
        type=float,
        metavar="M",
        multiple=True,
        help="[default: 3, 10 and 30 m, and 100 and 300 m where the fuel runs down]",
    )
    winds: tuple[float, ...] = opt.renamed(
        opt.option("--wind-speed", type=float, metavar="M/S", multiple=True, help="[default: 0, 5 and 10 m/s]"),
        "--wind",
    )
    flights = opt.whole(
        "--flights",
        None,
        "From each height, each in the next of the winds and at a moment of its own.",
        min=1,
        max=1000,
        default=3,
    )
    seed = opt.whole("--seed", None, "Seed of the moments and the noise.", min=0, default=0)
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
    as_json = opt.JSON


@click.command(epilog=example("hexjet failsafes --failsafe GNSS --height 10 --wind-speed 5"))
@opt.takes(FailsafeOptions)
def failsafes(options: FailsafeOptions) -> int:
    """Let everything fail that the autopilot has an answer to, and tell how each flight ended.

    Flown after a take-off to every height and some hover, several times, and moving, with the speeds of touch-down and
    the thrust ten seconds after disarming.  Leaves
    failsafes.csv in DIR, and in DIR/flights every flight as a scenario with its requests: hexjet fly flies it again.
    With several aircraft each has a folder of its name in DIR.
    """
    from hexjet_prove.api.surveys import FailsafesResult
    from hexjet_prove.surveys.failsafes import TABLED, WINDS_M_S, Conditions
    from hexjet_prove.surveys.failsafes import failsafes as fly_all

    aircraft = options.aircraft
    if "all" in aircraft:
        if len(aircraft) > 1:
            raise InputError("--aircraft all: leave out the others")
        aircraft = TABLED
    aircraft = tuple(dict.fromkeys(aircraft))
    several = len(aircraft) > 1
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
            found = FailsafesResult(survey).write(folder / survey.aircraft if several else folder)
            if not options.as_json:
                print_failsafes(found)
            results.append(survey)
    data = [survey.to_dict() for survey in results]
    options.answer(lambda: {"tables": data} if several else data[0], lambda: None)
    return DONE


def print_survival(found: FaultsResult) -> None:
    """Print how many places of each fault are held, by controller, what explains it, and where the report is."""
    from cosim.spec.controller_name import label

    result = found.survival
    by_fault, by_loss = found.tables()
    show_table(by_fault.columns, by_fault.rows, range(2, len(by_fault.columns)))
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
    show_table(by_loss.columns, by_loss.rows, (1, 2, 3))
    say(f"report: {found.report}", wrap=False)


def print_failsafes(found: FailsafesResult) -> None:
    """Print what became of each failsafe from each start, and where the flights are."""
    result = found.survey
    for table in found.tables():
        show_table(table.columns, table.rows, (1, 2, 4, 5, 6) if result.airborne else ())
    say(
        f"{result.aircraft}, {result.engine}, {result.controller}: the fastest touch-down and the most thrust of all "
        f"{'heights' if result.airborne else 'flights of a cell'}; a leg that touches faster than "
        f"{result.limit_m_s:.2f} m/s counts as a crash; faster than {result.trip_m_s:.2f} m/s sideways it has slid"
    )
    if result.engine_note:
        say(result.engine_note, wrap=False)
    say(f"every flight: {found.files['table']}", wrap=False)
