"""hexjet aircraft: one of your own begun, and looked over."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli import opt
from cosim.cli.console import echo, output_to_stderr, say, show_table
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, example

if TYPE_CHECKING:
    from cosim.api.checks import AircraftCheckResult

NOT_EXACT = (
    "Two numbers are what is attained and what nothing exceeds; one with at least, or none found: what lies beyond is "
    "not known."
)


@click.group(cls=Group)
def aircraft() -> None:
    """Begin an aircraft of your own, and look one over."""


class New(opt.Output):
    """Options of ``hexjet aircraft new``."""

    name: str = opt.argument()
    base = opt.word("--from", "NAME", "Any aircraft that is shipped; see: hexjet list aircraft.", "hexjet")
    out = opt.out("[default: ./NAME]")


@aircraft.command("new", epilog=example("hexjet aircraft new mine"))
@opt.takes(New)
def aircraft_new(options: New) -> int:
    """Write the folder of an aircraft of your own, called NAME, which flies as it is.

    It begins as a copy of the hexjet, or of any other that is shipped: --from quadjet.  Change its vehicle.toml, and
    look it over with hexjet aircraft check.
    """
    from cosim.spec.new_aircraft import new_aircraft
    from cosim.spec.vehicle import load_vehicle

    path = new_aircraft(options.name, options.base, options.out or Path(options.name))
    folder = path.parent if path.parent.is_absolute() else f"./{path.parent}"
    echo(f"{path}\nhexjet aircraft check {folder}\nhexjet fly hover --aircraft {folder}")
    if load_vehicle(options.base)[0].identified:
        echo(
            f"hexjet: note: its identified models are those of {options.base}: they hold until inertia, jets, sensors "
            f"or engine change; hexjet aircraft check {folder} compares them",
            err=True,
        )
    return DONE


class Check(opt.Output):
    """Options of ``hexjet aircraft check``."""

    aircraft: str = opt.argument(metavar="NAME|DIR")
    engine = opt.word("--engine", "NAME|FILE", "[default: the aircraft's own]")
    out = opt.out("[default: runs/check-NAME]")
    as_json = opt.JSON


@aircraft.command("check", epilog=example("hexjet aircraft check ./mine"))
@opt.takes(Check)
def aircraft_check(options: Check) -> int:
    """Check frames, signs, units, inertia, hover, authority with every engine and without any one, and a flight.

    Draws it in three views, and the moments that it can make in hover.  Status 1: something is not as it must be.
    """
    from cosim.api.checks import check_aircraft
    from cosim.spec.vehicle import aircraft_name

    folder = options.out or Path("runs") / f"check-{aircraft_name(options.aircraft)}"
    with output_to_stderr(options.as_json):
        result = check_aircraft(options.aircraft, options.engine, out=folder)
    options.answer(result.to_dict, lambda: print_check(result), nan=True)
    return DONE if result.is_fit else FLIGHT_FAILED


def print_check(result: AircraftCheckResult) -> None:
    """Print what was checked, the moments with each engine lost, and whether it is fit to fly."""
    report = result.check
    say(f"{report.aircraft}: {report.title}; engine {report.engine}")
    for table, right in zip(result.tables(), ((), range(5)), strict=True):
        show_table(table.columns, table.rows, right)
    say(
        "Largest moment either way while the weight is held and the other two moments are zero; all throttles and "
        "hinges are free within their limits." + ("" if report.is_exact else f" {NOT_EXACT}")
    )
    if report.drawing is not None:
        say(f"drawing: {report.drawing}", wrap=False)
    faults = [line.name for line in report.lines if line.fault]
    say("fit to fly" if report.is_fit else f"not fit to fly: {', '.join(faults)}")
