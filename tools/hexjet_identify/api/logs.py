"""A model from the log of a flight, and one compared with it: ``hexjet identify log``, ``replay --model``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cosim.api.call import Limits, check_types
from cosim.base.errors import InputError
from cosim.base.signals import AXES

if TYPE_CHECKING:
    from hexjet_identify.logs import FlightLog, LogSignals
    from hexjet_identify.prediction_error.result import LogIdentifyResult
    from hexjet_identify.prediction_error.validate import ValidateResult

VALIDATION_FILES = ("validation.json", "report.html")
# The model of an axis is filed under this engine where nothing says whose it is.
DEFAULT_FAMILY = "edf-as-flown"


@check_types(
    engine=Limits(1),
    longest_delay_s=Limits(0.0, 5.0, is_open=True),
    working_step_s=Limits(0.0, is_open=True),
    lags=Limits(0, 3),
    step_s=Limits(0.0, is_open=True),
)
def identify_log(
    log: str | Path,
    axis: Literal["roll", "pitch", "yaw"] | None = None,
    *,
    engine: int | None = None,
    command: str | None = None,
    output: str | None = None,
    setpoint: str | None = None,
    time_column: str | None = None,
    time_unit: str | None = None,
    begin: float | None = None,
    end: float | None = None,
    longest_delay_s: float = 0.4,
    working_step_s: float | None = None,
    lags: int | None = None,
    hold: Mapping[str, float] | None = None,
    step_s: float = 0.004,
    family: str | None = None,
    out: str | Path | None = None,
) -> LogIdentifyResult:
    """Identify an axis or an engine from the log of a flight, whoever flew it: lag, gain and delay with its bounds.

    Parameters
    ----------
    log : str or Path
        ULog, DataFlash, blackbox, Crazyflie, a table, or the folder of a run.
    axis : str or None
        ``roll``, ``pitch`` or ``yaw``: torque command to measured rate.
    engine : int or None
        Instead: the engine of this number, from 1.
    command : str or None
        The channels instead, with ``output``: a sum such as ``m1 + m2 - 0.5*m3``.
    output : str or None
        The same; ``deg(NAME)`` is one in degrees, ``square(NAME)`` a square; quotes hold a name with blanks.
    setpoint : str or None
        What was asked of the output: to test for bias.
    time_column : str or None
        A table's column of time; None: the one called so.
    time_unit : str or None
        Unit of that column: s, ms, us, ns, min, h or d.
    begin : float or None
        The log is used from here on, in its own time [s].
    end : float or None
        And to here [s].
    longest_delay_s : float
        Longest delay that is looked for [s].
    working_step_s : float or None
        Samples are averaged to it [s]; None: as it suits.
    lags : int or None
        Lags beside the pole; None: the better of two.
    hold : mapping or None
        Parameters of the model that are not fitted, by name, such as ``lag_s=0.009``.
    step_s : float
        Control step of the model [s].
    family : str or None
        The engine under which the model of an axis is filed; None: the run's, or ``edf-as-flown``.
    out : str or Path or None
        A folder for model, page and data; without it nothing is written.

    Returns
    -------
    LogIdentifyResult
        The models with their bounds.

    Raises
    ------
    InputError
        For a log that cannot be read, or one that does not tell.
    """
    from cosim.base.storage.files import check_results_folder
    from cosim.identify.files import FILES, RECORD
    from hexjet_identify.logs import read_flight_log
    from hexjet_identify.prediction_error.identify_log import identify_log as identify
    from hexjet_identify.prediction_error.result import LogIdentifyResult

    check_results_folder(out, RECORD, *FILES)
    if (axis is None) == (engine is None):
        raise InputError("identify_log: say axis (roll, pitch or yaw) or engine")
    if axis is not None and lags == 0:
        raise InputError("identify_log: lags: 0; allowed: at least 1 of an axis")
    read, subject = read_flight_log(Path(log), time_column, time_unit), axis or f"engine:{engine}"
    found = identify(
        read,
        subject,
        _signals_of(read, subject, command, output, setpoint),
        longest_delay=longest_delay_s,
        step=working_step_s,
        begin=begin,
        end=end,
        hold=hold,
        lags=lags,
    )
    result = LogIdentifyResult(found, step_s, family or read.engine or DEFAULT_FAMILY)
    return result if out is None else result.write(out)


def _signals_of(
    log: FlightLog, subject: str, command: str | None, output: str | None, setpoint: str | None
) -> LogSignals:
    """Return the channels that are named, or those that the log has of an axis or an engine.  Raises InputError."""
    from hexjet_identify.logs import LogSignals, signals_of, unit_of

    if command and output:
        unit = "rad/s" if subject in AXES else unit_of(output, log.signal(output).unit) or "output"
        return LogSignals(command, output, setpoint or "", "command", unit)
    if command or output:
        raise InputError("command and output: both or none")
    signals = signals_of(log, subject)
    return signals._replace(setpoint=setpoint or signals.setpoint)


@check_types()
def validate(
    model: str | Path,
    log: str | Path,
    *,
    axis: Literal["roll", "pitch", "yaw"] | None = None,
    time_column: str | None = None,
    time_unit: str | None = None,
    begin: float | None = None,
    end: float | None = None,
    out: str | Path | None = None,
) -> ValidateResult:
    """Fly a model with the commands of a log, beside what happened.

    Says whether gain and delay, fitted anew to it, are the model's.  Leaves a page and validation.json.

    Parameters
    ----------
    model : str or Path
        The folder of an identification from a log, its ``identification.json``, or a model file (.toml) of any.
    log : str or Path
        What an identification from a log reads, of another flight best.
    axis : str or None
        The axis, of a model file that has several.
    time_column : str or None
        A table's column of time; None: the one called so.
    time_unit : str or None
        Unit of that column: s, ms, us, ns, min, h or d.
    begin : float or None
        The log is used from here on, in its own time [s].
    end : float or None
        And to here [s].
    out : str or Path or None
        A folder for page and data; without it nothing is written.

    Returns
    -------
    ValidateResult
        Whether gain and delay, fitted anew to the log, are the model's.

    Raises
    ------
    InputError
        For a model or a log that cannot be read.
    """
    from cosim.base.storage.files import check_results_folder
    from hexjet_identify.logs import read_flight_log
    from hexjet_identify.prediction_error.validate import ValidateResult, read_model
    from hexjet_identify.prediction_error.validate import validate as compare

    check_results_folder(out, *VALIDATION_FILES)
    stated = read_model(Path(model), axis)
    read = read_flight_log(Path(log), time_column, time_unit)
    result = ValidateResult(compare(stated, read, begin, end))
    return result if out is None else result.write(out)
