"""hexjet aircraft: one of your own begun, and looked over."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.cli.console import output_to_stderr, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, example
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.campaign.aircraft_check import AircraftCheck

NOT_EXACT = (
    "Two numbers are what is attained and what nothing exceeds; one with at least, or none found: what lies beyond is "
    "not known."
)


@click.group()
def aircraft() -> None:
    """Begin an aircraft of your own, and look one over."""


@aircraft.command("new", epilog=example("hexjet aircraft new mine"))
@click.argument("name")
@click.option("--from", "base", default="hexjet", show_default=True, metavar="NAME", help="What it begins as.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: ./NAME]")
def aircraft_new(name: str, base: str, out: Path | None) -> int:
    """Write the folder of an aircraft of your own, called NAME, which flies as it is.

    It begins as one that is shipped; change its vehicle.toml, and look it over with hexjet aircraft check.
    """
    from cosim.spec.new_aircraft import new_aircraft
    from cosim.spec.vehicle import load_vehicle

    path = new_aircraft(name, base, Path(name) if out is None else out)
    folder = path.parent if path.parent.is_absolute() else f"./{path.parent}"
    click.echo(f"{path}\nhexjet aircraft check {folder}\nhexjet fly hover --aircraft {folder}")
    if load_vehicle(base)[0].identified:
        click.echo(
            f"hexjet: note: its identified models are those of {base}: they hold until inertia, jets, sensors or "
            f"engine change; hexjet aircraft check {folder} compares them",
            err=True,
        )
    return DONE


@aircraft.command("check", epilog=example("hexjet aircraft check ./mine"))
@click.argument("aircraft", metavar="NAME|FOLDER")
@click.option("--engine", metavar="NAME|FILE", help="[default: the aircraft's own]")
@click.option("--out", type=Out(), metavar="DIR", help="[default: runs/check-NAME]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
def aircraft_check(aircraft: str, engine: str | None, out: Path | None, as_json: bool) -> int:
    """Frames, signs, units, inertia, hover, authority with every engine and without any one of them, and a flight.

    Draws it in three views, and the moments that it can make in hover.  Status 1: something is not as it must be.
    """
    from cosim.campaign.aircraft_check import check_aircraft
    from cosim.spec.vehicle import aircraft_name

    folder = Path("runs") / f"check-{aircraft_name(aircraft)}" if out is None else out
    with output_to_stderr(as_json):
        report = check_aircraft(aircraft, engine, folder)
    if as_json:
        click.echo(json.dumps(report.to_dict()))
    else:
        print_check(report)
    return DONE if report.fit else FLIGHT_FAILED


def print_check(report: AircraftCheck) -> None:
    from rich import box
    from rich.table import Table

    console = terminal()
    console.print(f"{report.aircraft}: {report.title}; engine {report.engine}", highlight=False)
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("checked")
    table.add_column("what it is")
    table.add_column("fault")
    for line in report.lines:
        table.add_row(line.name, line.text, line.fault)
    console.print(table)
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("engine lost", "lift / weight", "roll, N m", "pitch, N m", "yaw, N m"):
        table.add_column(head, justify="right")
    for row in report.authority:
        moments = [row.span(axis).in_words() for axis in range(3)]
        if row.moment is None:
            moments = ["falls" if row.falls else "none found", "", ""]
        table.add_row(", ".join(map(str, row.lost)) or "none", f"{row.lift:.2f}", *moments)
    console.print(table)
    console.print(
        "Largest moment either way while the weight is held and the other two moments are zero; all throttles and "
        "hinges are free within their limits." + ("" if report.exact else f" {NOT_EXACT}"),
        highlight=False,
    )
    if report.drawing is not None:
        console.print(f"drawing: {report.drawing}", highlight=False, soft_wrap=True)
    faults = [line.name for line in report.lines if line.fault]
    console.print("fit to fly" if report.fit else f"not fit to fly: {', '.join(faults)}", highlight=False)
