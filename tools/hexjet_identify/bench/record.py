"""Bench logs as records of one command and one output, without the rows that are not to be believed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.bench.running import RPM_PER_UNIT, find_running
from hexjet_identify.logs.flight_log import Channel, FlightLog, unit_of
from hexjet_identify.logs.read import read_flight_log
from hexjet_identify.logs.table import NOT_NUMBERS

# Fewer rows cannot separate noise from a response.
MIN_ROWS = 20
COMMAND_PATTERNS = (
    r"throttle",
    r"\besc\b",
    r"pla\b",
    r"set.?point|demand|target",
    r"command|cmd",
    r"pwm|servo",
)  # the likeliest first
OUTPUT_PATTERNS = (r"thrust|schub|pouss", r"force|load|^f\b", r"rpm|speed|\bn1\b|\bn\b")
NO_OUTPUT_PATTERN = r"clip|flag|set.?point|demand|target|command|cmd|throttle|pump|air.?speed"
# Newtons in a unit of thrust; a kilogram or a pound of thrust is its weight.
NEWTONS_PER_UNIT = {
    "N": 1.0, "kN": 1e3, "mN": 1e-3, "kgf": 9.80665, "gf": 9.80665e-3, "kg": 9.80665, "g": 9.80665e-3,
    "lbf": 4.4482216152605, "lb": 4.4482216152605, "lbs": 4.4482216152605,
}  # fmt: skip
CLIPPED_COLUMN = re.compile(r"(.*[_ ])?clip(ped|s)?", re.IGNORECASE)


class Columns(NamedTuple):
    """Columns and times that the user chose; None: found by name.  Signals may be sums, see ``FlightLog.signal``."""

    command: str | None = None
    output: str | None = None
    time: str | None = None
    time_unit: str | None = None
    begin: float | None = None  # s, in the log's own time
    end: float | None = None


@dataclass(frozen=True)
class BenchRecord:
    """Command and output of one bench log over time [s], without lost and clipped rows of the output."""

    path: Path
    command_name: str
    output_name: str
    command_unit: str
    output_unit: str
    command_times: Array
    command: Array
    times: Array
    output: Array
    step: float  # s from row to row
    lost_fraction: float
    notes: tuple[str, ...] = ()

    @property
    def command_row(self) -> float:
        """Time between two rows of the command, s."""
        return float(np.median(np.diff(self.command_times)))

    @property
    def newtons(self) -> float | None:
        """Newtons in the output's unit, or None where it is no thrust."""
        return NEWTONS_PER_UNIT.get(self.output_unit)


def read_records(paths: Sequence[Path], columns: Columns | None = None) -> list[BenchRecord]:
    """Read bench logs: a record a file, or several where the engine was started more than once.

    Raises InputError: one line with file, column and what is allowed.
    """
    columns = columns or Columns()
    records = [record for path in paths for record in _read_file_records(path, columns)]
    first = records[0]
    for other in records[1:]:
        if (other.output_unit, other.command_unit) != (first.output_unit, first.command_unit):
            raise InputError(
                f"{other.path}: {other.command_name} [{other.command_unit}] to {other.output_name} "
                f"[{other.output_unit}], and {first.path} has [{first.command_unit}] to [{first.output_unit}]: "
                "several logs of one engine need the same units"
            )
    return records


def _read_file_records(path: Path, columns: Columns) -> list[BenchRecord]:
    log = read_flight_log(path, columns.time, columns.time_unit)
    command_name = columns.command or _find_column(log, COMMAND_PATTERNS, "", "command")
    output_name = columns.output or _find_column(log, OUTPUT_PATTERNS, NO_OUTPUT_PATTERN, "output")
    notes = list(log.remarks)
    log = _sort_by_time(log, notes)
    if columns.command is None or columns.output is None:
        notes.append(f"taken: {command_name} to {output_name}; others: hexjet engine from-bench --command X --output Y")
    command, output = (_select_usable(log.signal(name, notes), columns) for name in (command_name, output_name))
    _check_row_count(path, command_name, command)
    _check_row_count(path, output_name, output)
    _check_row_interval(path, output.times, columns.time_unit is None, notes)
    marked = [
        _select_usable(channel, columns) for name, channel in log.channels.items() if CLIPPED_COLUMN.fullmatch(name)
    ]
    flagged = np.concatenate([np.empty(0), *(channel.times[channel.values != 0.0] for channel in marked)])
    spans = find_running(log, command, output, notes)
    moved = [span for span in spans if np.ptp(_select_span(command, *span).values) > 0.0] or spans[:1]
    records = []
    for span in moved:
        asked, answered = (command_name, _select_span(command, *span)), (output_name, _select_span(output, *span))
        records.append(_make_record(path, asked, answered, flagged, notes))
    return records


def _select_span(channel: Channel, begin: float, end: float) -> Channel:
    use = (channel.times >= begin) & (channel.times <= end)
    return channel._replace(times=channel.times[use], values=channel.values[use])


def _find_column(log: FlightLog, patterns: Sequence[str], never: str, option: str) -> str:
    """Return the name of the channel that matches the first pattern that any matches.  Raises InputError."""
    names = [name for name in log.channels if not (never and re.search(never, name, re.IGNORECASE))]
    for pattern in patterns:
        found = [name for name in names if re.search(pattern, name.replace("_", " "), re.IGNORECASE)]
        if len(found) > 1:
            raise InputError(f"{log.path}: {', '.join(found[:6])}: {option} NAME says which")
        if found:
            return found[0]
    have = ", ".join(list(log.channels)[:12])
    lost = "".join(f"; {remark}" for remark in log.remarks if remark.startswith(NOT_NUMBERS))
    raise InputError(
        f"{log.path}: no column is called like what {option} needs; {option} NAME, one of: {have}{lost}; command and "
        "output have to be on one clock in one file"
    )


def _select_usable(channel: Channel, columns: Columns) -> Channel:
    use = np.isfinite(channel.times) & np.isfinite(channel.values)
    if columns.begin is not None:
        use &= channel.times >= columns.begin
    if columns.end is not None:
        use &= channel.times <= columns.end
    return channel._replace(times=channel.times[use], values=channel.values[use])


def _check_row_count(path: Path, name: str, channel: Channel) -> None:
    if len(channel.times) < MIN_ROWS:
        raise InputError(f"{path}: {len(channel.times)} rows of {name} that can be used; at least {MIN_ROWS}")


def _sort_by_time(log: FlightLog, notes: list[str], restart_s: float = 1.0) -> FlightLog:
    """Return a log with its rows sorted by time: stands that write from several threads do not sort them.

    Where the time goes back by ``restart_s`` it begins again: a few rows of the test before or behind are left out, and
    two tests in one file raise InputError.
    """
    channels, said = {}, list[str]()
    for name, channel in log.channels.items():
        times = channel.times
        again = np.flatnonzero(np.diff(times) < -restart_s) + 1
        rows = max(np.split(np.arange(len(times)), again), key=len)
        if len(times) - len(rows) >= MIN_ROWS:
            raise InputError(
                f"{log.path}: the time begins again after {times[again[0] - 1]:g} s: two tests in one file; a file each"
            )
        if again.size:
            said.append(f"{len(times) - len(rows)} rows stand where the time begins again; left out")
        back = np.diff(times[rows], prepend=-np.inf)
        if (back < 0.0).any():
            count, most = int((back < 0.0).sum()), -float(np.nanmin(back))
            said.append(f"{count} rows are not in the order of time, by up to {most:.2g} s; sorted")
        rows = rows[np.argsort(times[rows], kind="stable")]
        channels[name] = channel._replace(times=times[rows], values=channel.values[rows])
    notes += dict.fromkeys(said)
    return replace(log, channels=channels)


def _check_row_interval(
    path: Path, times: Array, by_name: bool, notes: list[str], slow_s: float = 1.0, quick_s: float = 1e-5
) -> None:
    """Note rows over ``slow_s`` apart, perhaps of a wrong unit; raise InputError for rows under ``quick_s`` apart."""
    row = float(np.ptp(times)) / max(len(np.unique(times)) - 1, 1)
    if by_name and row >= slow_s:
        prefix, unit = ("milli", "ms") if row < 1e3 * slow_s else ("micro", "us")
        notes.append(f"{row:.3g} s from row to row: if the time is in {prefix}seconds, time_unit {unit}")
    if 0.0 < row < quick_s:
        raise InputError(
            f"{path}: {row:.2g} s from row to row; allowed: {quick_s:g} s or more.  If the time is in days, as "
            "a spreadsheet's dates are, or in hours: time_unit d, or h"
        )


def _make_record(
    path: Path,
    command: tuple[str, Channel],
    output: tuple[str, Channel],
    flagged: Array,
    notes: list[str],
    max_shared_stamps: float = 0.1,
    max_gap_rows: float = 4.0,
) -> BenchRecord:
    """Return the record of a command and an output, without repeated times and clipped rows.

    A share of ``max_shared_stamps`` may have the stamp of the row before and another value.  They are left out, and
    with more of them the command would seem to move later than it does.  A gap of over ``max_gap_rows`` is noted.
    """
    (command_name, given), (output_name, measured) = command, output
    _check_row_count(path, output_name, measured)
    fresh = np.diff(given.times, prepend=-np.inf) > 0.0
    commands = given.times[fresh], given.values[fresh]
    times, values = measured.times, measured.values
    use = np.diff(times, prepend=-np.inf) > 0.0
    shared = int(np.count_nonzero(~use[1:] & (np.diff(values) != 0.0)))
    if shared > max_shared_stamps * len(times):
        raise InputError(
            f"{path}: {shared} of {len(times)} rows of {output_name} have the time of the row before and another "
            "value; allowed: a time for each row, as fine as the rows are"
        )
    if _has_fine_resolution(values) and (clipped := _find_clipped_rows(values)).any():
        use &= ~clipped
        where = "at the end of its range (clipped) or next to such"
        notes.append(f"{output_name}: {int(clipped.sum())} rows are {where}; left out")
    if flagged.size:
        marked = np.isin(times, flagged)
        notes.append(f"{output_name}: {int(marked.sum())} rows are marked as clipped; left out")
        use &= ~marked
    times, values = times[use], values[use]
    if len(times) < MIN_ROWS:
        raise InputError(f"{path}: {len(times)} rows of {output_name} that can be used; at least {MIN_ROWS}")
    step = float(np.median(np.diff(times)))
    lost = max(0.0, 1.0 - len(times) * step / (float(times[-1] - times[0]) + step))
    longest = float(np.diff(times).max())
    if longest > max_gap_rows * step:
        notes.append(f"{output_name}: {100.0 * lost:.2g} % of the rows are missing, up to {longest:.3g} s at a time")
    unit = unit_of(output_name, measured.unit)
    if unit not in ("", "percent", *NEWTONS_PER_UNIT, *RPM_PER_UNIT):
        units = ", ".join((*NEWTONS_PER_UNIT, *RPM_PER_UNIT))
        raise InputError(f"{path}: {output_name} is in {unit}; allowed: a thrust or a speed in {units}")
    return BenchRecord(
        path, command_name, output_name, unit_of(command_name, given.unit), unit,
        *commands, times, values, step, lost, tuple(notes),
    )  # fmt: skip


def _has_fine_resolution(values: Array, fine: float = 20.0) -> bool:
    """Return whether an output's usual change is ``fine`` times its resolution, so that equal rows mean clipping."""
    changes = np.abs(np.diff(np.unique(values)))
    steps = np.abs(np.diff(values))
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    is_fine = len(changes) > 0 and usual > fine * float(np.percentile(changes, 1.0))
    return is_fine and len(np.unique(values)) > 0.5 * len(values)


def _find_clipped_rows(values: Array, least: int = 5) -> NDArray[np.bool_]:
    """Return which rows are clipped: ``least`` in a row at the greatest or least value, and the rows near them."""
    at = np.zeros(len(values), bool)
    for stop in (values.max(), values.min()):
        here = (values == stop).astype(int)
        if np.convolve(here, np.ones(least), "valid").max(initial=0.0) >= least:
            at |= np.convolve(here, np.ones(2 * least + 1), "same") > 0.5
    return at


def describe_next_step(records: Sequence[BenchRecord], total: float) -> str:
    """Describe the command step that would best determine delay and lags of ``total`` s together."""
    low = min(float(record.command.min()) for record in records)
    high = max(float(record.command.max()) for record in records)
    return f"a step from {low:.4g} to {high:.4g} and back, each held {max(5.0 * total, 2.0):.2g} s"


def find_levels(record: BenchRecord) -> Mapping[float, float]:
    """Return the levels of the command, each with the longest time [s] for which it is held."""
    begins = np.flatnonzero(np.diff(record.command, prepend=np.inf) != 0.0)
    ends = np.append(record.command_times[begins[1:]], record.command_times[-1])
    longest: dict[float, float] = {}
    for begin, end in zip(begins, ends, strict=True):
        level = float(record.command[begin])
        longest[level] = max(longest.get(level, 0.0), float(end - record.command_times[begin]))
    return longest
