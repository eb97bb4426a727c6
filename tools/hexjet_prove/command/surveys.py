"""hexjet faults and failsafes: what a vehicle survives, and how it comes down."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.errors import InputError
from cosim.commands import DONE, CommandProgress, example, opt, output_to_stderr, part_progress, say, show_table

if TYPE_CHECKING:
    from cosim.api.studies import SweepResult


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

    Leaves a campaign in DIR, with a case for each fault, place and start; the same again goes on where it was stopped.
    """
    from hexjet_prove.api.surveys import faults as fly_all

    chosen = options.chosen("aircraft", "engine", "controllers", "kinds", "limits", "nominal_engine", "workers", "out")
    with output_to_stderr(options.as_json), part_progress("faults", quiet=options.as_json) as tell:
        found = fly_all(**chosen, progress=CommandProgress(tell))
    options.answer(found.to_dict, lambda: print_survey(found))
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
    the thrust ten seconds after disarming.  Leaves a campaign in DIR with a case a flight; the same again goes on where
    it was stopped.  With several aircraft each has a folder of its name in DIR.
    """
    from hexjet_prove.api.surveys import failsafes as fly_all
    from hexjet_prove.surveys.failsafes import TABLED
    from hexjet_prove.surveys.survey import load_subject

    aircraft = tuple(dict.fromkeys(options.aircraft))
    if "all" in aircraft:
        if len(aircraft) > 1:
            raise InputError("--aircraft all: leave out the others")
        aircraft = TABLED
    for name in aircraft:
        load_subject(name, options.engine)
    several = len(aircraft) > 1
    folder = options.run_folder("failsafes") if several else options.out
    shared = ("engine", "controller", "kinds", "heights", "winds", "flights", "seed", "airborne", "moving")
    chosen = options.chosen(*shared, "nominal_engine", "workers")
    data = []
    for name in aircraft:
        out = folder / Path(name).name if several and folder is not None else folder
        with output_to_stderr(options.as_json), part_progress("failsafes", quiet=options.as_json) as tell:
            found = fly_all(name, out=out, progress=CommandProgress(tell), **chosen)
        if not options.as_json:
            print_survey(found)
        data.append(found.to_dict())
    options.answer(lambda: {"tables": data} if several else data[0], lambda: None)
    return DONE


def print_survey(found: SweepResult) -> None:
    """Print what became of each case, and where the flights are."""
    for table in found.tables():
        show_table(table.columns, table.rows)
    for line in found.lines():
        say(line)
    say(f"report: {found.report}", wrap=False)
    say(f"one flight again: hexjet fly {found.campaign.folder} --flight N", wrap=False)
