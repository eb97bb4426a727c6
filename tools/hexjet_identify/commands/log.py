"""hexjet identify log: an axis or an engine out of the log of a flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from cosim.base.signals import AXES
from cosim.commands import DONE, echo, example, opt, say, show_table

if TYPE_CHECKING:
    from hexjet_identify.api.logs import LogIdentifyResult
    from hexjet_identify.logs import FlightLog


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


@click.command("log", epilog=example("hexjet identify log flight.ulg --axis roll --out roll-model"))
@opt.takes(FromLog)
def identify_from_log(options: FromLog) -> int:
    """Identify an axis or an engine from a flight's log, whoever flew it: lag, gain and delay with its bounds.

    Reads runs, ULog, ArduPilot DataFlash, Betaflight blackbox, Crazyflie, CSV and Parquet.  Leaves a page,
    identification.json for hexjet validate; of an axis a model file for hexjet fly and design --model, of an engine's
    thrust an engine.  Status 1: the log does not tell.
    """
    from cosim.commands import one_thread

    one_thread()
    from cosim.files import parse_numbers
    from cosim.identify.files import FILES, RECORD
    from hexjet_identify.api.logs import identify_log
    from hexjet_identify.logs import read_flight_log

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
    for table in result.tables():
        show_table(table.columns, table.rows, range(1, len(table.columns)))
    for line in others:
        say(line)
    for name in ("model", "engine", "report"):
        if name in result.files:
            say(f"{name}: {result.files[name]}", wrap=False)
