"""Tables as logs: CSV and Parquet of other tools, and a run's own rows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.results.arrow import read_numbers
from cosim.results.columns import COLUMNS
from cosim.results.logs.flight_log import Channel, FlightLog
from cosim.results.run import open_run
from cosim.results.tables import TIME

TIMES = (TIME, "time", "t")  # what the time [s] may be called in a log of another tool
AT_THE_END = re.compile(r"thrust_\d+_N")  # logged with the step at whose end the engine has it
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def numbers_with_time(path: Path, name: str | None = None) -> tuple[dict[str, Array], str, tuple[str, ...]]:
    """The columns of a table that are numbers, which of them is the time, and those that are no numbers.

    Raises InputError where there is no time.
    """
    columns, left_out = read_numbers(path)
    if name is not None and name not in columns:
        raise InputError(f"{path}: no column {name!r} of numbers; {nearest(name, columns)}")
    time = name or next((candidate for candidate in TIMES if candidate in columns), None)
    if time is None:
        raise InputError(f"{path}: no column of time; allowed: {', '.join(TIMES)}, in seconds")
    return columns, time, left_out


def read_table(path: Path, time: str | None = None, unit: str = "s") -> FlightLog:
    """A CSV or Parquet file; ``time`` names its time, in ``unit``.  Raises InputError.

    A table that has our ``time_s``, and is not told otherwise by ``time``, has our stamps: a thrust stands in the row
    of the step at whose end the engine has it, and is a step of the table later than that row's time.
    """
    if unit not in SECONDS:
        raise InputError(f"time in {unit!r}: allowed: {', '.join(SECONDS)}")
    columns, name, left_out = numbers_with_time(path, time)
    times = SECONDS[unit] * columns.pop(name)
    remarks = [f"left out, being no numbers: {', '.join(left_out)}"] if left_out else []
    step = float(np.median(np.diff(times))) if time is None and name == TIME and times.size > 1 else 0.0
    units = {column.name: column.unit for column in COLUMNS}
    late = [key for key in columns if step and AT_THE_END.fullmatch(key)]
    if late:
        remarks.append(
            f"{late[0]}{' and the like' if late[1:] else ''}: taken for the end of its step, {1e3 * step:g} ms after "
            f"{TIME}, as our logs have it; --time {TIME} takes the stamps as they are"
        )
    return FlightLog(
        path,
        "table",
        {
            key: Channel(times + step if key in late else times, values, units.get(key, ""))
            for key, values in columns.items()
        },
        tuple(remarks),
    )


def read_run(folder: Path) -> FlightLog:
    """The rows of a run.  Raises InputError if there is none."""
    run = open_run(folder)
    times = np.asarray(run.log[TIME])
    units = {column.name: column.unit for column in run.log.described}
    names = [name for name in run.log.columns if name != TIME]
    after = times + run.summary.step_s
    channels = {
        name: Channel(after if AT_THE_END.fullmatch(name) else times, np.asarray(run.log[name]), units.get(name, ""))
        for name in names
    }
    return FlightLog(folder, "run", channels, engine=Path(run.summary.engine).name.removesuffix("-fmi2"))
