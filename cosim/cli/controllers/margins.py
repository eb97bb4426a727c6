"""hexjet margins: how much gain, phase and delay a controller's loops have left, measured in flight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.signals import AXES
from cosim.cli.console import output_to_stderr, part_progress, terminal
from cosim.cli.options import DONE, Number, example, load_scenario, offer_to_compile, warn_of_blemishes
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from cosim.design.measured import MeasuredMargins


@click.command(epilog=example("hexjet margins --controller mine.py:Mine --axis roll"))
@click.argument("scenario", default="hover")
@click.option(
    "--controller", metavar="NAME|FILE", help="As in hexjet fly: built in, a design's file, or one of yours in any way."
)
@click.option("--aircraft", metavar="NAME", help="With the engine that it is made for; see: hexjet list aircraft.")
@click.option("engines", "--engine", metavar="[N=]NAME|FILE", multiple=True, help="As in hexjet fly.")
@click.option("axes", "--axis", type=click.Choice(AXES), multiple=True, help="May be repeated.  [default: all]")
@click.option("--amplitude", type=Number(), metavar="A", help="Peak, of a share of thrust, rad of tilt or rad/s^2.")
@click.option("--from-hz", type=Number(min=0.0, min_open=True), metavar="HZ", help="[default: two periods]")
@click.option(
    "--to-hz", type=Number(min=0.0, min_open=True), metavar="HZ", help="[default: a tenth of the control rate]"
)
@click.option("--period", "period_s", type=Number(min=0.0, min_open=True), metavar="S",
              help="Of the multisine.  [default: 20, or 60 for a slow loop]")  # fmt: skip
@click.option("--periods", type=click.IntRange(3), default=5, show_default=True, help="That are measured.")
@click.option("--seed", type=int, help="Of sensor noise and turbulence.")
@click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def margins(
    scenario: str,
    controller: str | None,
    aircraft: str | None,
    engines: tuple[str, ...],
    axes: tuple[str, ...],
    amplitude: float | None,
    from_hz: float | None,
    to_hz: float | None,
    period_s: float | None,
    periods: int,
    seed: int | None,
    settings: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> int:
    """Measure gain, phase and delay margins, both ways, and peak sensitivity of any controller in flight.

    A multisine is added between the controller and its actuators while the vehicle of SCENARIO holds still; what passes
    before and behind gives the open loop, with 95 % bounds, beside the computed one where the controller is built in.
    Status 1: the vehicle does not stay in the air.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.design.measured import measure_margins, write
    from cosim.flight import new_folder
    from cosim.spec.controller_name import folder_name

    offer_to_compile(*engines)
    loaded = load_scenario(scenario, controller, engines, seed, settings, None, aircraft)
    warn_of_blemishes(loaded.engine, folder=loaded.folder)
    with output_to_stderr(as_json), part_progress("margins", as_json) as progress:
        done = 0

        def say(text: str) -> None:
            nonlocal done
            progress(text, done, 2 * len(axes or AXES) + 1)
            done += 1

        margins = measure_margins(
            loaded, axes or AXES, amplitude=amplitude, from_hz=from_hz, to_hz=to_hz, period_s=period_s, periods=periods,
            say=say,
        )  # fmt: skip
    paths = write(
        margins, out if out is not None else new_folder(Path("runs"), f"margins-{folder_name(margins.controller)}")
    )
    if as_json:
        click.echo(json.dumps(margins.to_dict(), allow_nan=False))
    else:
        print_margins(margins, paths)
    return DONE


def print_margins(margins: MeasuredMargins, paths: dict[str, Path]) -> None:
    """A table an axis, what is to be said about it, and where the page is."""
    from rich import box
    from rich.table import Table

    from cosim.design.measured.page import COLUMNS, heading, rows

    console = terminal()
    console.print(
        f"[bold]{margins.controller_shown}[/bold] on {margins.scenario.aircraft}, engine {margins.scenario.engine}",
        highlight=False,
    )
    for measured in margins.axes.values():
        table = Table(box=box.SIMPLE_HEAD, title=heading(measured), title_justify="left", title_style="")
        for column in COLUMNS:
            table.add_column(column, justify="right" if column else "left")
        for row in rows(measured):
            table.add_row(*row)
        console.print(table)
        for note in measured.notes:
            console.print(f"note: {measured.axis}: {note}", highlight=False, markup=False)
    if margins.uncomputed:
        console.print(f"not computed: {margins.uncomputed}", highlight=False, markup=False)
    console.print(f"report: {paths['report']}", highlight=False, soft_wrap=True)
