"""hexjet identify: sweeps of an engine or an axis, and logs of flights."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.cli.console import output_to_stderr, terminal
from cosim.cli.options import DONE, FLIGHT_FAILED, Number, example, log_options
from cosim.cli.outputs import Out

if TYPE_CHECKING:
    from rich.table import Table

    from cosim.identify.logs import FlightLog
    from cosim.identify.prediction_error.identify_log import LogIdentification
    from cosim.identify.sweep import Identification


@click.group()
def identify() -> None:
    """Sweep an engine or an axis in flight, or take a flight's log, and fit a model with a delay."""


def _sweep_options(command: Any) -> Any:
    for option in reversed(
        [
            click.option("--from-hz", type=Number(), metavar="HZ", help="Lowest frequency of the response."),
            click.option("--to-hz", type=Number(), metavar="HZ", help="Highest frequency of the response."),
            click.option("--amplitude", type=Number(), metavar="A", help="Of the sweep, in the unit of the command."),
            click.option("--duration", type=Number(), metavar="S", help="Of the sweep."),
            click.option("holds", "--hold", metavar="NAME=VALUE", multiple=True, help="Keep a parameter of the model."),
            click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]"),
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
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.sweep import identify_engine as identify

    with output_to_stderr(as_json):
        numbers, hold = parse_numbers(settings, "--set"), parse_numbers(holds, "--hold")
        identification = identify(name, numbers, hold=hold, **choices)
    return _finish_identification(identification, out, f"identify-{Path(name).stem}", as_json)


def _identify_axis(
    axis: str, settings: tuple[str, ...], holds: tuple[str, ...], out: Path | None, as_json: bool, **choices: Any
) -> int:
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.sweep import identify_axis

    with output_to_stderr(as_json):
        identification = identify_axis(axis, settings=settings, hold=parse_numbers(holds, "--hold"), **choices)
    return _finish_identification(identification, out, f"identify-{axis}", as_json)


def _finish_identification(identification: Any, out: Path | None, name: str, as_json: bool) -> int:
    from cosim.flight import new_folder
    from cosim.identify.sweep import write

    paths = write(identification, out if out is not None else new_folder(Path("runs"), name))
    if as_json:
        click.echo(json.dumps(identification.to_dict(), allow_nan=False))
    else:
        print_identification(identification, paths)
    return FLIGHT_FAILED if identification.refused else DONE


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


@identify.command("log", epilog=example("hexjet identify log flight.ulg --axis roll --out roll-model"))
@click.argument("log", metavar="FILE|RUN", type=click.Path(path_type=Path))
@click.option("--axis", type=click.Choice(AXES), help="Identify torque command to measured rate of an axis.")
@click.option("--engine", "number", type=click.IntRange(min=1), metavar="N", help="Identify engine N instead.")
@click.option("--command", "command_text", metavar="SUM", help="The channels instead: 'm1 + m2 - 0.5*m3'.")
@click.option(
    "--output",
    "output_text",
    metavar="SUM",
    help="The same; deg(NAME) is one in degrees, square(NAME) a square; quotes hold a name with blanks.",
)
@click.option("--setpoint", "setpoint_text", metavar="SUM", help="What was asked of the output: to test for bias.")
@log_options
@click.option(
    "--longest-delay", type=Number(min=0.0, min_open=True, max=5.0), default=0.4, show_default=True, metavar="S"
)
@click.option("--working-step", type=Number(min=0.0, min_open=True), metavar="S", help="Samples are averaged to it.")
@click.option("--lags", type=click.IntRange(0, 3), help="Beside the pole.  [default: the better of two]")
@click.option("holds", "--hold", metavar="NAME=VALUE", multiple=True, help="Keep a parameter: lag_s=0.009.")
@click.option(
    "--step", type=Number(min=0.0, min_open=True), default=0.004, show_default=True, help="Control step of the model."
)
@click.option(
    "--filed-under",
    "family",
    metavar="NAME",
    help="The engine of an axis' model file.  [default: the run's, or edf-as-flown]",
)
@click.option("--channels", is_flag=True, help="List what the log holds, and do nothing else.")
@click.option("--out", type=Out(), metavar="DIR", help="[default: a new one in runs/]")
@click.option("as_json", "--json", is_flag=True, help="Print one JSON object and nothing else.")
def identify_from_log(log: Path, channels: bool, out: Path | None, as_json: bool, **choices: Any) -> int:
    """Identify an axis or an engine from a flight's log, whoever flew it: lag, gain and delay with its bounds.

    Reads runs, ULog, ArduPilot DataFlash, Betaflight blackbox, Crazyflie, CSV and Parquet.  Leaves a page,
    identification.json for hexjet validate; of an axis a model file for hexjet fly and design --model, of an engine's
    thrust an engine.  Status 1: the log does not tell.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.identify.logs import read_flight_log

    read = read_flight_log(log, choices.pop("time_column"), choices.pop("time_unit"))
    if channels:
        if as_json:
            click.echo(json.dumps(read.to_dict(), allow_nan=False))
        else:
            print_channels(read)
        return DONE
    return _identify_log(read, out, as_json, **choices)


def _identify_log(
    log: FlightLog,
    out: Path | None,
    as_json: bool,
    *,
    axis: str | None,
    number: int | None,
    command_text: str | None,
    output_text: str | None,
    setpoint_text: str | None,
    begin: float | None,
    end: float | None,
    longest_delay: float,
    working_step: float | None,
    lags: int | None,
    holds: tuple[str, ...],
    step: float,
    family: str | None,
) -> int:
    from cosim.base.storage.toml import parse_numbers
    from cosim.flight import new_folder
    from cosim.identify.logs import LogSignals, signals_of
    from cosim.identify.prediction_error.identify_log import identify_log
    from cosim.identify.prediction_error.result import write

    if (axis is None) == (number is None):
        raise InputError("identify log: say --axis roll, pitch or yaw, or --engine N")
    if axis is not None and lags == 0:
        raise InputError("--lags 0: an axis has one at least")
    what = axis or f"engine:{number}"
    if command_text and output_text:
        chosen = LogSignals(command_text, output_text, setpoint_text or "", "command", "rad/s" if axis else "output")
    elif command_text or output_text:
        raise InputError("--command and --output: both or none")
    else:
        chosen = signals_of(log, what)
        chosen = chosen._replace(setpoint=setpoint_text or chosen.setpoint)
    identified = identify_log(
        log,
        what,
        chosen,
        longest_delay=longest_delay,
        step=working_step,
        begin=begin,
        end=end,
        hold=parse_numbers(holds, "--hold"),
        lags=lags,
    )
    folder = out if out is not None else new_folder(Path("runs"), f"identify-log-{what.replace(':', '-')}")
    paths = write(identified, folder, step, family or log.engine or "edf-as-flown")
    if as_json:
        click.echo(json.dumps(identified.to_dict(step), allow_nan=False))
    else:
        print_from_log(identified, paths)
    return DONE


def print_channels(log: FlightLog) -> None:
    """What a log holds: its remarks, and each channel with its rate and span."""
    held = log.to_dict()
    click.echo(f"{held['log']}: {held['kind']}")
    for note in held["notes"]:
        click.echo(f"note: {note}")
    for channel in held["channels"]:
        text = "{name}  {values} values, {seconds:.1f} s, {rate_hz:.4g} Hz  {unit}"
        click.echo(text.format(**channel).rstrip())


def print_from_log(identified: LogIdentification, paths: dict[str, Path]) -> None:
    """The forms side by side, what is to be said of them, and where the files are."""
    from cosim.identify.prediction_error.result import rows, summary

    console = terminal()
    console.print(summary(identified), highlight=False, markup=False)
    console.print(_side_by_side([estimate.form.label for estimate in identified.estimates], rows(identified)))
    for note in identified.notes:
        console.print(f"note: {note}", highlight=False, markup=False)
    for name in ("model", "engine", "report"):
        if name in paths:
            console.print(f"{name}: {paths[name]}", highlight=False, soft_wrap=True)


def _side_by_side(labels: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Models beside each other, a row a parameter."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("with 95 % bounds")
    for label in labels:
        table.add_column(label, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def print_identification(identification: Identification, paths: dict[str, Path]) -> None:
    """The models side by side, the chosen one's discrete form, how the stated one compares, and where the files are."""
    from cosim.identify.sweep.result import equations, fit_rows

    console = terminal()
    sweep, response = identification.sweep, identification.response
    console.print(
        f"{identification.subject}: [bold]{identification.channel}[/bold], {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz "
        f"in {sweep.duration_s:g} s, amplitude {sweep.amplitude:.3g}; {len(response.hertz)} points, "
        f"coherence at least {response.coherence.min():.4f}",
        highlight=False,
    )
    console.print(_side_by_side([fit.label for fit in identification.fits], fit_rows(identification)))
    for reason in identification.refused:
        console.print(f"no model: {reason}", highlight=False, markup=False)
    for text in () if identification.refused else equations(identification):
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
    elif identification.no_ledger:
        console.print(f"the delay ledger has no sum for it: {identification.no_ledger}", highlight=False)
    for note in identification.notes:
        console.print(f"note: {note}", highlight=False)
    for name in ("model", "report"):
        if name in paths:
            console.print(f"{name}: {paths[name]}", highlight=False, soft_wrap=True)
