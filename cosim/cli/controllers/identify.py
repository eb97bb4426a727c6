"""hexjet identify: sweeps of an engine or an axis, and logs of flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cosim.base.signals import AXES
from cosim.cli import opt
from cosim.cli.console import echo, output_to_stderr, say, show_table
from cosim.cli.controllers.bench import identify_bench
from cosim.cli.groups import Group
from cosim.cli.options import DONE, FLIGHT_FAILED, example

if TYPE_CHECKING:
    from cosim.api.call import Result
    from cosim.api.identify import IdentifyResult, Subject
    from cosim.api.logs import LogIdentifyResult
    from cosim.identify.logs import FlightLog


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
identify.add_command(identify_bench)


class FromLog(opt.LogPart, opt.Output):
    """Options of ``hexjet identify log``."""

    log: Path = opt.argument(metavar="FILE|RUN", type=click.Path(path_type=Path))
    axis = opt.choice("--axis", AXES, "Identify torque command to measured rate of an axis.")
    engine = opt.whole("--engine", "N", "Identify engine N instead.", min=1)
    command = opt.word("--command", "SUM", "The channels instead: 'm1 + m2 - 0.5*m3'.")
    output = opt.word(
        "--output",
        "SUM",
        "The same; deg(NAME) is one in degrees, square(NAME) a square; quotes hold a name with blanks.",
    )
    setpoint = opt.word("--setpoint", "SUM", "What was asked of the output: to test for bias.")
    time_column, time_unit, begin, end = opt.LOG_PART
    longest_delay_s = opt.number(
        "--longest-delay", "S", "Longest delay that is looked for.", min=0.0, max=5.0, min_open=True, default=0.4
    )
    working_step_s = opt.positive("--working-step", "S", "Samples are averaged to it.")
    lags = opt.whole("--lags", None, "Beside the pole.  [default: the better of two]", min=0, max=3)
    holds = opt.words("--hold", "NAME=VALUE", "Keep a parameter: lag_s=0.009.")
    step_s = opt.positive("--step", None, "Control step of the model.", default=0.004)
    family = opt.word(
        "--filed-under", "NAME", "The engine of an axis' model file.  [default: the run's, or edf-as-flown]"
    )
    channels = opt.flag("--channels", "List what the log holds, and do nothing else.")
    out = opt.OUT
    as_json = opt.JSON


_FROM_LOG = (
    "axis", "engine", "command", "output", "setpoint", "time_column", "time_unit", "begin", "end", "longest_delay_s",
    "working_step_s", "lags", "step_s", "family",
)  # fmt: skip


@identify.command("log", epilog=example("hexjet identify log flight.ulg --axis roll --out roll-model"))
@opt.takes(FromLog)
def identify_from_log(options: FromLog) -> int:
    """Identify an axis or an engine from a flight's log, whoever flew it: lag, gain and delay with its bounds.

    Reads runs, ULog, ArduPilot DataFlash, Betaflight blackbox, Crazyflie, CSV and Parquet.  Leaves a page,
    identification.json for hexjet validate; of an axis a model file for hexjet fly and design --model, of an engine's
    thrust an engine.  Status 1: the log does not tell.
    """
    from cosim.base.runtime.threads import one_thread

    one_thread()
    from cosim.api.logs import identify_log
    from cosim.base.storage.toml import parse_numbers
    from cosim.identify.files import FILES, RECORD
    from cosim.identify.logs import read_flight_log

    if options.channels:
        log = read_flight_log(options.log, options.time_column, options.time_unit)
        options.answer(log.to_dict, lambda: print_channels(log))
        return DONE
    options.check_out(RECORD, *FILES)
    result = identify_log(options.log, hold=parse_numbers(options.holds, "--hold"), **options.chosen(*_FROM_LOG))
    what = options.axis or f"engine-{options.engine}"
    result.write(options.run_folder(f"identify-log-{what}"))
    options.answer(result.to_dict, lambda: print_from_log(result))
    return DONE


def print_channels(log: FlightLog) -> None:
    """Print what a log holds: its remarks, and each channel with its rate and span."""
    table = log.to_dict()
    echo(f"{table['log']}: {table['kind']}")
    for note in table["notes"]:
        echo(f"note: {note}")
    for channel in table["channels"]:
        text = "{name}  {values} values, {seconds:.1f} s, {rate_hz:.4g} Hz  {unit}"
        echo(text.format(**channel).rstrip())


def print_from_log(result: LogIdentifyResult) -> None:
    """Print the forms side by side, what is to be said of them, and where the files are."""
    summary, *others = result.lines()
    say(summary)
    _show_side_by_side(result)
    for line in others:
        say(line)
    for name in ("model", "engine", "report"):
        if name in result.files:
            say(f"{name}: {result.files[name]}", wrap=False)


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
