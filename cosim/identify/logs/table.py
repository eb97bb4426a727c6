"""Tables as logs: text and Parquet of other tools, and a run's own rows."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.base.storage.files import one_line
from cosim.identify.logs.flight_log import Channel, FlightLog
from cosim.identify.logs.text_table import is_number, read_text, seconds
from cosim.results.export.mcap_file import read_mcap_columns
from cosim.results.log.arrow import read_csv_numbers, read_numbers
from cosim.results.log.columns import COLUMNS
from cosim.results.log.tables import TIME
from cosim.results.run import open_run

PARQUET = b"PAR1"  # a file begins and ends with it
TIMES = (TIME, "time", "t")  # what the time [s] may be called in a log of another tool
OTHER_TIMES = (  # and what else, in any case, its unit behind it; the likeliest first
    "time", "t", "timestamp", "timestamp_sample", "timeus", "timems", "elapsed", "elapsed time", "datetime",
    "date_time", "date", "date/time", "utc", "clock", "zeit", "temps", "tiempo", "seconds", "sec", "s",
)  # fmt: skip
AT_THE_END = re.compile(r"thrust_\d+_N")  # logged with the step at whose end the engine has it
DAY_S = 86400.0
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": DAY_S}
_SAME_UNITS = {
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "minutes": "min",
    "hours": "h",
    "days": "d",
    "msec": "ms",
    "usec": "us",
    "µs": "us",
    "μs": "us",
}
_UNIT = re.compile(r"(.*?)[\s_]*(?:[\[(]\s*([^\[\]()]*?)\s*[\])]|_([mun]?s|[mu]?sec))")
LEAST_RUNNING = 0.9  # share of the steps from row to row in which a time has to grow
LEAST_NUMBERS = (
    0.5  # share of a column's texts that have to be numbers: the others are damaged, or say that there is none
)
NO_NUMBERS = "left out, being no numbers"  # a remark begins so


@dataclass
class Table:
    """The columns that are numbers, but for the time [s], which is called ``name``; and what is to be said of them."""

    columns: dict[str, Array]
    times: Array
    name: str
    unit: str  # of the time in the file
    units: dict[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()  # being no numbers
    remarks: list[str] = field(default_factory=list)


@dataclass
class _Columns:
    numbers: dict[str, Array]
    dates: set[str] = field(default_factory=set)  # of the numbers, those that are in seconds
    units: dict[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list)


def is_parquet(head: bytes) -> bool:
    """Return whether the first bytes of a file are Parquet's."""
    return head.startswith(PARQUET)


def columns_with_time(path: Path, name: str | None = None, unit: str | None = None) -> Table:
    """Read the columns of a table; ``name`` is its time, in ``unit`` or as its name or line of units says.

    Without a name the time is the first of those that are called so and run.  Raises InputError where there is none.
    """
    if unit is not None and unit not in SECONDS:
        raise InputError(f"time in {unit!r}: allowed: {', '.join(SECONDS)}")
    with path.open("rb") as file:
        columns = _of_parquet(path) if is_parquet(file.read(len(PARQUET))) else _of_text(path)
    time = _time(path, columns, name)
    taken = unit or ("s" if time in columns.dates else time_unit(time, columns.units.get(time, "")))
    times = SECONDS[taken] * columns.numbers.pop(time)
    remarks = list(columns.remarks)
    if time in columns.dates and len(times):
        times, remark = _since_first(times)
        remarks.append(f"{time}: {remark}")
    elif taken != "s" and unit is None:
        remarks.append(f"{time} is taken for the time, in {taken}")
    return Table(columns.numbers, times, time, taken, columns.units, columns.left_out, remarks)


def column_names(path: Path) -> list[str]:
    """Return what a table's columns are called, in its order.  Raises InputError for what is no table."""
    with path.open("rb") as file:
        if is_parquet(file.read(len(PARQUET))):
            return [name.strip() for name in read_numbers(path).numbers]
    return list(read_text(path).names)


def _of_parquet(path: Path) -> _Columns:
    read = read_numbers(path)
    numbers = {name.strip(): values for name, values in read.numbers.items()}
    columns = _Columns(numbers, {name.strip() for name in read.times})
    _add_texts(columns, read.texts)
    return columns


def _of_text(path: Path) -> _Columns:
    text = read_text(path)
    labels = [name or f"column_{n}" for n, name in enumerate(text.names, 1)]
    read, odd = read_csv_numbers(path, text.rows, labels, text.separator, text.decimal)
    remarks = list(text.remarks)
    if odd:
        remarks.append(f"{odd} rows have not a cell for each column, the last one perhaps cut short; left out")
    named = {name: values for name, values in read.numbers.items() if name in text.names}
    columns = _Columns(named, read.times, text.units, (), remarks)
    _add_texts(columns, {name: values for name, values in read.texts.items() if name in text.names})
    return columns


def _add_texts(columns: _Columns, texts: dict[str, list[str | None]]) -> None:
    """Add the columns of texts that are numbers but for some cells, or dates."""
    left_out = []
    for name, values in texts.items():
        if (numeric := _numbers(values)) is not None:
            columns.numbers[name], missing = numeric
            columns.remarks += [f"{name}: {missing} of {len(values)} cells are no numbers; left out"] if missing else []
        elif (dates := seconds(values)) is not None:
            columns.numbers[name] = np.array(dates)
            columns.dates.add(name)
        else:
            left_out.append(name)
    columns.left_out = tuple(left_out)


def _numbers(values: list[str | None]) -> tuple[Array, int] | None:
    """Return texts as numbers, NaN for what is none, and how many are none; None where most are none."""
    texts = [(text or "").strip() for text in values]
    good = [text for text in texts if text and is_number(text)]
    if len(good) < max(LEAST_NUMBERS * sum(map(bool, texts)), 1):
        return None
    numeric = np.array([_number(text) for text in texts])
    return numeric, sum(bool(text) and not is_number(text) for text in texts)


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


# ---- the time


def _time(path: Path, held: _Columns, name: str | None) -> str:
    columns = held.numbers
    if name is not None:
        stripped = next((column for column in (name, name.strip()) if column in columns), None)
        if stripped is None:
            raise InputError(f"{path}: no column {name!r} of numbers; {nearest(name, columns)}"[:600])
        return stripped
    plain = {column: plain_name(column) for column in columns}
    called = [column for column in TIMES if column in columns]
    called += [column for other in OTHER_TIMES for column in columns if plain[column] == other]
    called += [column for column in columns if column in held.dates]
    running = [column for column in dict.fromkeys(called) if _runs(columns[column])]
    if running or called:
        return (running or called)[0]
    growing = [repr(column) for column in columns if _runs(columns[column])][:5]
    grow = f"; {', '.join(growing)} grow from row to row: --time NAME says which" if growing else ""
    raise InputError(f"{path}: no column of time; allowed: {', '.join(TIMES)}, in seconds{grow}")


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
        if unit in SECONDS:
            return unit
    return "s"


def _runs(values: Array) -> bool:
    """Return whether values grow from nearly every row to the next."""
    values = values[np.isfinite(values)]
    return len(values) > 1 and float(np.mean(np.diff(values) > 0.0)) >= LEAST_RUNNING


def _since_first(times: Array) -> tuple[Array, str]:
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


# ---- logs


def read_table(path: Path, time: str | None = None, unit: str | None = None) -> FlightLog:
    """Read a table of text or Parquet; ``time`` names its time, in ``unit``.  Raises InputError.

    A table that has our ``time_s``, and is not told otherwise by ``time``, has our stamps: a thrust stands in the row
    of the step at whose end the engine has it, and is a step of the table later than that row's time.
    """
    return _log_of(path, columns_with_time(path, time, unit), time is None)


def read_mcap(path: Path) -> FlightLog:
    """Read a run's log that was exported as MCAP.  Raises InputError for MCAP of another tool."""
    columns = read_mcap_columns(path)
    return _log_of(path, Table(columns, columns.pop(TIME), TIME, "s"), True)


def read_mat(path: Path) -> FlightLog:
    """Read a run's log that was exported for MATLAB.  Raises InputError for another file of MATLAB's."""
    from scipy.io import loadmat

    try:
        flight = loadmat(path, simplify_cells=True).get("flight", {})
    except (ValueError, TypeError, NotImplementedError, OSError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a file of MATLAB: {one_line(error)}") from error
    if not isinstance(flight, dict) or not {"time", "columns"} <= flight.keys():
        raise InputError(f"{path}: is a file of MATLAB without a flight of ours; export it as CSV")
    names = flight["names"] if isinstance(flight.get("names"), dict) else {}
    columns = {names.get(name, name): np.asarray(values, np.float64) for name, values in flight["columns"].items()}
    times = columns.pop(TIME, np.asarray(flight["time"], np.float64))
    return _log_of(path, Table(columns, times, TIME, "s"), True)


def _log_of(path: Path, table: Table, has_our_stamps: bool) -> FlightLog:
    """Return a table as a log; ``has_our_stamps``: unless its time is called otherwise."""
    times, name = table.times, table.name
    remarks = [f"{NO_NUMBERS}: {', '.join(table.left_out)}"] if table.left_out else []
    remarks += table.remarks
    step = float(np.median(np.diff(times))) if has_our_stamps and name == TIME and times.size > 1 else 0.0
    named = {key: unit_in_name(key) for key in table.columns}
    units = named | {column.name: column.unit for column in COLUMNS} | table.units
    late = [key for key in table.columns if step and AT_THE_END.fullmatch(key)]
    if late:
        remarks.append(
            f"{late[0]}{' and the like' if late[1:] else ''}: taken for the end of its step, {1e3 * step:g} ms after "
            f"{TIME}, as our logs have it; --time {TIME} takes the stamps as they are"
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
