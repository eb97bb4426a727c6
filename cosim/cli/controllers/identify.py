"""hexjet identify: sweeps of an engine or an axis; tools add commands that read logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.cli import opt
from cosim.cli.console import output_to_stderr, say, show_table
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, example

if TYPE_CHECKING:
    from cosim.api.call import Result
    from cosim.api.identify import IdentifyResult, Subject


@click.group(cls=Group)
def identify() -> None:
    """Fit a model with a delay to a chirp, of an engine or of an axis in flight, or to a log of a flight or a bench."""


class Sweep(opt.Output):
    """Options of every sweep; its other choices are those of the function that sweeps."""

    from_hz = opt.number("--from-hz", "HZ", "Lowest frequency of the response.")
    to_hz = opt.number("--to-hz", "HZ", "Highest frequency of the response.")
    amplitude = opt.number("--amplitude", "A", "Amplitude of the chirp, in the unit of the command.")
    duration_s = opt.number("--duration", "S", "Duration of the chirp.")
    holds = opt.words("--hold", "NAME=VALUE", "Keep a parameter of the model.")
    out = opt.OUT
    as_json = opt.JSON
    lags: int


_SWEPT = ("from_hz", "to_hz", "amplitude", "duration_s", "lags")


class EngineSweep(opt.Record):
    """Options of ``hexjet identify engine`` before those of every sweep."""

    engine: str = opt.argument(metavar="NAME|FILE")
    throttle = opt.number("--throttle", None, "Around which the chirp is.", default=0.5)
    step_s = opt.number("--step", "S", "Sample time.", default=0.004)
    lags = opt.whole("--lags", None, "Lags beside the first pole.", min=0, max=2, default=0)
    settings = opt.words("--set", "PARAMETER=VALUE", "Set a parameter of the engine.")


class SweptEngine(Sweep, EngineSweep):
    """Options of ``hexjet identify engine``."""


@identify.command("engine", epilog=example("hexjet identify engine turbojet --set delay_samples=40"))
@opt.takes(SweptEngine)
def identify_engine(options: SweptEngine) -> int:
    """Identify an engine, throttle to thrust: one pole and a delay.

    Band, amplitude and duration are chosen to suit the engine where they are not given.
    """
    from cosim.engine import file_label

    return _identify(
        "engine",
        f"identify-{file_label(Path(options.engine))}",
        options,
        options.chosen("engine", "settings", "throttle", "step_s"),
    )


def _identify(subject: Subject, name: str, options: Sweep, choices: dict[str, Any]) -> int:
    """Sweep an axis or an engine with the options of every sweep and its own ``choices``; answer with what is found."""
    from cosim.api.identify import identify as sweep
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.files import FILES, RECORD

    options.check_out(RECORD, *FILES)
    with output_to_stderr(options.as_json):
        hold = parse_numbers(options.holds, "--hold")
        result = sweep(subject, hold=hold, **choices, **options.chosen(*_SWEPT))
    result.write(options.run_folder(name))
    options.answer(result.to_dict, lambda: print_identification(result))
    return DONE if result.found else FLIGHT_FAILED


class AxisSweep(opt.Record):
    """Options of ``hexjet identify roll``, pitch and yaw before those of every sweep."""

    aircraft = opt.word("--aircraft", "NAME|DIR", "See: hexjet list aircraft.", "hexjet")
    engine = opt.word("--engine", "NAME|FILE", "See: hexjet list engines.  [default: the aircraft's own]")
    controller = opt.word("--controller", "NAME", "[default: smith, or baseline if no model is known]")
    substeps = opt.whole("--substeps", None, "JSBSim steps in a control step.")
    seed = opt.whole("--seed", None, "Seed of the sensor noise.")
    lags = opt.whole("--lags", None, "Beside the slow pole.", min=1, max=2, default=1)
    settings: tuple[str, ...] = opt.SETTINGS


class SweptAxis(Sweep, AxisSweep):
    """Options of ``hexjet identify roll``, pitch and yaw."""


def _axis_command(axis: Subject) -> None:
    @identify.command(axis, epilog=example(f"hexjet identify {axis} --engine edf --out {axis}-model"))
    @opt.takes(SweptAxis)
    def command(options: SweptAxis) -> int:
        choices = options.chosen("engine", "settings", "aircraft", "controller", "substeps", "seed")
        return _identify(axis, f"identify-{axis}", options, choices)

    command.help = (
        f"Identify the {axis} axis in flight, torque command to measured rate: a slow pole, a lag and a delay.\n\n"
        "Writes a model file for hexjet fly --model."
    )


_axis_command("roll")
_axis_command("pitch")
_axis_command("yaw")


def _show_side_by_side(result: Result) -> None:
    """Print models beside each other, a row a parameter."""
    for table in result.tables():
        show_table(table.columns, table.rows, range(1, len(table.columns)))


def print_identification(result: IdentifyResult) -> None:
    """Print the models side by side, the discrete form of the best, how the specified one compares, and the files."""
    from cosim.identify.sweep.result import equations

    identification, paths = result.identification, result.files
    sweep, response = identification.sweep, identification.response
    say(
        f"{identification.subject}: [bold]{identification.channel}[/bold], {sweep.from_hz:.3g} to {sweep.to_hz:.3g} Hz "
        f"in {sweep.duration_s:g} s, amplitude {sweep.amplitude:.3g}; {len(response.hertz)} points, "
        f"coherence at least {response.coherence.min():.4f}",
        marked=True,
    )
    _show_side_by_side(result)
    for reason in identification.refused:
        say(f"no model: {reason}")
    for text in () if identification.refused else equations(identification):
        say(f"G(z) = {text}")
    deviation = identification.reference_deviation()
    if identification.reference is not None and deviation is not None:
        say(
            f"the model that {identification.subject} states ({identification.reference.source}) is within "
            f"{deviation[0]:.2f} dB and {deviation[1]:.1f} deg of the response"
        )
    if identification.ledger_samples is not None:
        say(f"all delay as the delay ledger has it: {identification.ledger_samples:.2f} samples")
    elif identification.no_ledger:
        say(f"the delay ledger has no sum for it: {identification.no_ledger}")
    for note in identification.notes:
        say(f"note: {note}")
    for name in ("model", "report"):
        if name in paths:
            say(f"{name}: {paths[name]}", wrap=False)
