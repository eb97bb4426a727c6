"""Tables as logs: text and Parquet of other tools, and a run's own rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.results.log.columns import COLUMNS
from cosim.results.log.tables import TIME
from hexjet_identify.logs.flight_log import Channel, FlightLog
from hexjet_identify.logs.table_columns import TableColumns

# Names of a time in seconds, in logs of other tools.
TIME_NAMES = (TIME, "time", "t")
# Other names of a time, in any case and with its unit behind it; the likeliest first.
OTHER_TIME_NAMES = (
    "time", "t", "timestamp", "timestamp_sample", "timeus", "timems", "elapsed", "elapsed time", "datetime",
    "date_time", "date", "date/time", "utc", "clock", "zeit", "temps", "tiempo", "seconds", "sec", "s",
)  # fmt: skip
# Columns of thrust at the end of the step in whose row they stand.
STEP_END_COLUMN = re.compile(r"thrust_\d+_N")
DAY_S = 86400.0
SECONDS_PER_UNIT = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": DAY_S}
_SAME_UNITS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "minutes": "min", "hours": "h", "days": "d", "msec": "ms",
    "usec": "us", "µs": "us", "μs": "us",
}  # fmt: skip
_UNIT = re.compile(r"(.*?)[\s_]*(?:[\[(]\s*([^\[\]()]*?)\s*[\])]|_([mun]?s|[mu]?sec))")
NOT_NUMBERS = "left out, being no numbers"  # a remark begins so


@dataclass
class Table:
    """Columns of numbers of a table, and its time [s], whose column is called ``name``."""

    columns: dict[str, Array]
    times: Array
    name: str
    unit: str  # unit of the file's time
    units: dict[str, str] = field(default_factory=dict)
    left_out: Sequence[str] = ()  # columns that are not numbers
    remarks: list[str] = field(default_factory=list)


def columns_with_time(path: Path, columns: TableColumns, name: str | None = None, unit: str | None = None) -> Table:
    """Return the columns of a table; ``name`` is its time, in ``unit`` or as its name or line of units says.

    Without a name the time is the first of those that are called so and run.  Raises InputError where there is none.
    """
    if unit is not None and unit not in SECONDS_PER_UNIT:
        raise InputError(f"time in {unit!r}: allowed: {', '.join(SECONDS_PER_UNIT)}")
    time, numbers = _find_time(path, columns, name), dict(columns.numbers)
    taken = unit or ("s" if time in columns.dates else time_unit(time, columns.units.get(time, "")))
    times = SECONDS_PER_UNIT[taken] * numbers.pop(time)
    remarks = list(columns.remarks)
    if time in columns.dates and len(times):
        times, remark = _seconds_since_first(times)
        remarks.append(f"{time}: {remark}")
    elif taken != "s" and unit is None:
        remarks.append(f"{time} is taken for the time, in {taken}")
    return Table(numbers, times, time, taken, columns.units, columns.left_out, remarks)


def _find_time(path: Path, held: TableColumns, name: str | None) -> str:
    columns = held.numbers
    if name is not None:
        stripped = next((column for column in (name, name.strip()) if column in columns), None)
        if stripped is None:
            raise InputError(f"{path}: no column {name!r} of numbers; {nearest(name, columns)}"[:600])
        return stripped
    plain = {column: plain_name(column) for column in columns}
    called = [column for column in TIME_NAMES if column in columns]
    called += [column for other in OTHER_TIME_NAMES for column in columns if plain[column] == other]
    called += [column for column in columns if column in held.dates]
    running = [column for column in dict.fromkeys(called) if _is_increasing(columns[column])]
    if running or called:
        return (running or called)[0]
    growing = [repr(column) for column in columns if _is_increasing(columns[column])][:5]
    grow = f"; {', '.join(growing)} grow from row to row: time_column says which" if growing else ""
    raise InputError(f"{path}: no column of time; allowed: {', '.join(TIME_NAMES)}, in seconds{grow}")


def plain_name(name: str) -> str:
    """Return a name without its unit, in small letters."""
    match = _UNIT.fullmatch(name)
    return (match.group(1) if match else name).strip().lower()


def unit_in_name(name: str) -> str:
    """Return the unit that stands in brackets at the end of a name, or an empty string."""
    match = _UNIT.fullmatch(name)
    return (match.group(2) if match else "") or ""


def time_unit(name: str, unit_given: str) -> str:
    """Return the unit of a time, by the line of units or by its name; seconds where neither says one."""
    match = _UNIT.fullmatch(name)
    texts = [
        unit_given,
        *((match.group(2), match.group(3)) if match else ()),
        name[4:] if name in ("TimeUS", "TimeMS") else "",
    ]
    for text in texts:
        unit = (text or "").strip().lower()
        unit = _SAME_UNITS.get(unit, unit)
        if unit in SECONDS_PER_UNIT:
            return unit
    return "s"


def _is_increasing(values: Array, min_share: float = 0.9) -> bool:
    """Return whether values grow from at least ``min_share`` of the rows to the next."""
    values = values[np.isfinite(values)]
    return len(values) > 1 and float(np.mean(np.diff(values) > 0.0)) >= min_share


def _seconds_since_first(times: Array) -> tuple[Array, str]:
    """Return dates, or times of day that may pass midnight, as seconds from the first one, with a remark."""
    good = np.flatnonzero(np.isfinite(times))
    if not good.size:
        return times, "no cell of it is a date"
    first = float(times[good[0]])
    if first > DAY_S:
        return times - first, f"counts from its first row, {datetime.fromtimestamp(first, UTC):%Y-%m-%d %H:%M:%S}"
    filled = np.interp(np.arange(len(times)), good, times[good])
    days = np.concatenate([[0.0], np.cumsum(np.diff(filled) < -0.5 * DAY_S)])
    return times + DAY_S * days - first, f"counts from its first row, {first:g} s of the day"


def make_log(path: Path, columns: TableColumns, time: str | None = None, unit: str | None = None) -> FlightLog:
    """Return a table as a log; ``time`` names its time, in ``unit``.  Raises InputError.

    A table that has our ``time_s``, and is not told otherwise by ``time``, has our stamps: a thrust stands in the row
    of the step at whose end the engine has it, and is a step of the table later than that row's time.
    """
    table, has_our_stamps = columns_with_time(path, columns, time, unit), time is None
    times, name = table.times, table.name
    remarks = [f"{NOT_NUMBERS}: {', '.join(table.left_out)}"] if table.left_out else []
    remarks += table.remarks
    step = float(np.median(np.diff(times))) if has_our_stamps and name == TIME and times.size > 1 else 0.0
    named = {key: unit_in_name(key) for key in table.columns}
    units = named | {column.name: column.unit for column in COLUMNS} | table.units
    late = [key for key in table.columns if step and STEP_END_COLUMN.fullmatch(key)]
    if late:
        remarks.append(
            f"{late[0]}{' and the like' if late[1:] else ''}: taken for the end of its step, {1e3 * step:g} ms after "
            f"{TIME}, as our logs have it; time_column {TIME} takes the stamps as they are"
        )
    channels = {
        key: Channel(times + step if key in late else times, values, units.get(key, ""))
        for key, values in table.columns.items()
    }
    if not channels:
        raise InputError(f"{path}: the table has no column of numbers but its time")
    return FlightLog(path, "table", channels, tuple(remarks))


def read_run(folder: Path) -> FlightLog:
    """Read the log of a run's folder.  Raises InputError if there is none."""
    from cosim.results.run import open_run

    run = open_run(folder)
    times = np.asarray(run.log[TIME])
    units = {column.name: column.unit for column in run.log.described}
    names = [name for name in run.log.columns if name != TIME]
    after = times + run.summary.step_s
    channels = {
        name: Channel(
            after if STEP_END_COLUMN.fullmatch(name) else times, np.asarray(run.log[name]), units.get(name, "")
        )
        for name in names
    }
    return FlightLog(folder, "run", channels, engine=Path(run.summary.engine).name.removesuffix("-fmi2"))
