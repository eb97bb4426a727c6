"""hexjet identify: sweeps of an engine or an axis."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.signals import AXES
from cosim.cli.console import terminal
from cosim.cli.options import DONE, Number, example

if TYPE_CHECKING:
    from cosim.design.identify import Identification


@click.group()
def identify() -> None:
    """Sweep an engine or an axis in flight, and fit a model with a delay to its response."""


def _sweep_options(command: Any) -> Any:
    for option in reversed(
        [
            click.option("--from-hz", type=Number(), metavar="HZ", help="Lowest frequency of the response."),
            click.option("--to-hz", type=Number(), metavar="HZ", help="Highest frequency of the response."),
            click.option("--amplitude", type=Number(), metavar="A", help="Of the sweep, in the unit of the command."),
            click.option("--duration", type=Number(), metavar="S", help="Of the sweep."),
            click.option("holds", "--hold", metavar="NAME=VALUE", multiple=True, help="Keep a parameter of the model."),
            click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="[default: a new one in runs/]"),
            click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else."),
        ]
    ):
        command = option(command)
    return command


@identify.command("engine", epilog=example("hexjet identify engine turbojet --set delay_samples=40"))
@click.argument("name", metavar="NAME|FILE.fmu")
@click.option("--throttle", type=Number(), default=0.5, show_default=True, help="Around which it is swept.")
@click.option("--step", type=Number(), default=0.004, show_default=True, metavar="S", help="Sample time.")
@click.option("--lags", type=click.IntRange(0, 2), default=0, show_default=True, help="Lags beside the first pole.")
@click.option("settings", "--set", metavar="PARAMETER=VALUE", multiple=True, help="Set a parameter of the engine.")
@_sweep_options
def identify_engine(
    name: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    """Identify an engine, throttle to thrust: one pole and a delay.

    Band, amplitude and duration are chosen to suit the engine where they are not given.
    """
    from cosim.base.toml import parse_numbers
    from cosim.design.identify import identify_engine as identify

    identification = identify(name, parse_numbers(settings, "--set"), hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(identification, out, f"identify-{Path(name).stem}", as_json)


def _identify_axis(
    axis: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    from cosim.base.toml import parse_numbers
    from cosim.design.identify import identify_axis

    identification = identify_axis(axis, settings=settings, hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(identification, out, f"identify-{axis}", as_json)


def _finish_identification(identification: Any, out: Path | None, name: str, as_json: bool) -> int:
    from cosim.design.identify import write
    from cosim.flight import new_folder

    paths = write(identification, out if out is not None else new_folder(Path("runs"), name))
    if as_json:
        click.echo(json.dumps(identification.to_dict(), allow_nan=False))
    else:
        print_identification(identification, paths)
    return DONE


def _axis_command(axis: str) -> None:
    @identify.command(axis, epilog=example(f"hexjet identify {axis} --engine edf --out {axis}-model"))
    @click.option("--aircraft", default="hexjet", show_default=True, help="See: hexjet list aircraft.")
    @click.option("--engine", metavar="NAME|FILE.fmu", help="See: hexjet list engines.  [default: the aircraft's own]")
    @click.option("--controller", metavar="NAME", help="[default: smith, or baseline if no model is known]")
    @click.option("--substeps", type=int, help="JSBSim steps in a control step.")
    @click.option("--seed", type=int, help="Of the sensor noise.")
    @click.option("--lags", type=click.IntRange(1, 2), default=1, show_default=True, help="Beside the slow pole.")
    @click.option("settings", "--set", metavar="KEY=VALUE", multiple=True, help="As in hexjet fly.")
    @_sweep_options
    def command(**choices: Any) -> int:
        return _identify_axis(axis, **choices)

    command.help = (
        f"Identify the {axis} axis in flight, torque command to measured rate: a slow pole, a lag and a delay.\n\n"
        "Writes a model file for hexjet fly --model."
    )


for _axis in AXES:
    _axis_command(_axis)


def print_identification(identification: Identification, paths: dict[str, Path]) -> None:
    """The models side by side, the chosen one's discrete form, how the stated one compares, and where the files are."""
    from rich import box
    from rich.table import Table

    from cosim.design.identify.result import equations, fit_rows

    console = terminal()
    sweep, response = identification.sweep, identification.response
    console.print(
        f"{identification.subject}: [bold]{identification.channel}[/bold], {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz "
        f"in {sweep.duration_s:g} s, amplitude {sweep.amplitude:.3g}; {len(response.hertz)} points, "
        f"coherence at least {response.coherence.min():.4f}",
        highlight=False,
    )
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("with 95 % bounds")
    for fit in identification.fits:
        table.add_column(fit.label, justify="right")
    for row in fit_rows(identification):
        table.add_row(*row)
    console.print(table)
    for text in equations(identification):
        console.print(f"G(z) = {text}", highlight=False, markup=False)
    deviation = identification.reference_deviation()
    if identification.reference is not None and deviation is not None:
        console.print(
            f"the model that {identification.subject} states ({identification.reference.source}) is within "
            f"{deviation[0]:.2f} dB and {deviation[1]:.1f} deg of the response",
            highlight=False,
        )
    if identification.ledger_samples is not None:
        console.print(
            f"all delay as the delay ledger has it: {identification.ledger_samples:.2f} samples", highlight=False
        )
    for note in identification.notes:
        console.print(f"note: {note}", highlight=False)
    for name in ("model", "report"):
        if name in paths:
            console.print(f"{name}: {paths[name]}", highlight=False, soft_wrap=True)
