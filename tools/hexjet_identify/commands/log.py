"""hexjet identify log: an axis or an engine out of the log of a flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.api import Result
from cosim.commands import Command, echo, one_thread, show_result
from hexjet_identify.commands import LOG_METAVARS, LOG_OPTIONS

if TYPE_CHECKING:
    from hexjet_identify.logs import FlightLog
    from hexjet_identify.prediction_error.result import LogIdentifyResult


def read_or_identify(log: str, *, channels: bool = False, **choices: Any) -> FlightLog | LogIdentifyResult:
    """Identify an axis or an engine from a flight's log, whoever flew it: lag, gain and delay with its bounds.

    Reads runs, ULog, ArduPilot DataFlash, Betaflight blackbox, Crazyflie, CSV and Parquet.  Leaves a page,
    identification.json for hexjet replay --model; of an axis a model file for hexjet fly and design --model, of an
    engine's thrust an engine.

    Parameters
    ----------
    channels : bool
        List what the log holds, and do nothing else.
    """
    if channels:
        from hexjet_identify.logs import read_flight_log

        return read_flight_log(Path(log), choices.get("time_column"), choices.get("time_unit"))
    from hexjet_identify.api.logs import identify_log

    return identify_log(log, **choices)


def show(found: FlightLog | LogIdentifyResult, verbose: bool) -> None:
    """Print an identification, or the contents of a log: its notes, and each channel with rate and span."""
    if isinstance(found, Result):
        show_result(found, verbose)
        return
    table = found.to_dict()
    echo(f"{table['log']}: {table['kind']}")
    for note in table["notes"]:
        echo(f"note: {note}")
    for channel in table["channels"]:
        text = "{name}  {values} values, {seconds:.1f} s, {rate_hz:.4g} Hz  {unit}"
        echo(text.format(**channel).rstrip())


def _name_folder(arguments: Any) -> str | None:
    what = arguments["axis"] or f"engine-{arguments['engine']}"
    return None if arguments["channels"] else f"identify-log-{what}"


identify_from_log = Command(
    "identify log",
    "hexjet_identify.commands.log:read_or_identify",
    "flight.ulg --axis roll --out roll-model",
    like="hexjet_identify.api.logs:identify_log",
    options={"axis": "--axis", "family": "--filed-under", **LOG_OPTIONS},
    metavars={"log": "FILE|RUN", "engine": "N", "command": "SUM", "output": "SUM", "setpoint": "SUM",
              "hold": "NAME=VALUE", "family": "NAME", **LOG_METAVARS},
    folder=_name_folder,
    before=lambda arguments: one_thread(),
    show=show,
    ends="Status 1: the log does not tell.",
)  # fmt: skip
