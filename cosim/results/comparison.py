"""Two flights beside each other: on one time base, signal by signal, and what of their scenarios differs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.results.log.columns import COLUMNS, EULER
from cosim.results.log.recorder import Log, MemoryLog
from cosim.results.log.tables import TIME
from cosim.results.metrics import wrap
from cosim.results.run import Run
from cosim.spec.scenario import Scenario

# Times closer than this many steps are the same, because k * dt is rounded.
_TIME_TOLERANCE = 1e-6


class ComparedFlight(NamedTuple):
    """One compared flight; ``run`` is None for a log of another tool."""

    label: str
    log: Log
    run: Run | None = None
    source: str = ""
    remarks: tuple[str, ...] = ()


class Signal(NamedTuple):
    """Difference of one column between second and first log; None if incomparable."""

    name: str
    unit: str
    same: bool  # same bits: NaN equals NaN, 0 is not -0
    first_step: int | None  # first compared step that differs
    first_s: float | None  # time of first_step
    largest: float | None  # largest second minus first
    largest_s: float | None
    rms: float | None
    alone: int  # steps where only one has a number


class LogComparison(NamedTuple):
    """Comparison of a second log with a first one, over the time that both cover."""

    first: str
    second: str
    steps: int  # number of compared steps
    begins_s: float
    ends_s: float  # start of the last compared step
    steps_of: str  # the log with the shorter steps
    held: str  # log with held rows; empty: equal steps
    same: bool  # True: both whole logs are equal
    signals: tuple[Signal, ...]
    only_first: tuple[str, ...]  # columns that only the first log has
    only_second: tuple[str, ...]


class TimeBase(NamedTuple):
    """Steps for comparing two logs: times, and the valid row of each log."""

    times: Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    held_log: int  # which log is held: 1, 2 or 0 for none


def shift_times(flight: ComparedFlight, by: float) -> ComparedFlight:
    """Return the flight with times shifted by ``by`` [s], which its label states."""
    columns = {name: flight.log[name] for name in flight.log.columns}
    columns[TIME] = columns[TIME] + by
    log = MemoryLog([np.stack(list(columns.values()))], flight.log.columns, flight.log.described)
    return flight._replace(log=log, remarks=(*flight.remarks, f"its times moved by {by:g} s"))


def compare_with_first(flights: Sequence[ComparedFlight]) -> list[LogComparison]:
    """Return how the log of each further flight differs from the first one's."""
    return [_compare_pair(flights[0], other) for other in flights[1:]]


def make_time_base(first: Log, second: Log) -> TimeBase:
    """Return the time base of two logs: the steps of the log with the shorter ones, over the time that both cover.

    The other's values are held.  A row is in force from its time on, for as long as a step.  With equal steps both are
    taken as they are.
    """
    times = (first[TIME], second[TIME])
    steps = tuple(median_step(series) for series in times)
    which = 1 if steps[1] < (1.0 - _TIME_TOLERANCE) * steps[0] else 0
    none = np.empty(0, np.intp)
    if not (times[0].size and times[1].size):
        return TimeBase(np.empty(0), none, none, 0)
    slack = _TIME_TOLERANCE * min(steps)
    other = times[1 - which]
    begins = max(times[0][0], times[1][0]) - slack
    rows = np.flatnonzero((times[which] >= begins) & (times[which] < other[-1] + steps[1 - which] - slack))
    latest = np.searchsorted(other, times[which][rows] + slack, side="right") - 1
    apart = rows.size > 0 and bool(np.max(np.abs(other[latest] - times[which][rows])) > slack)
    rows_first, rows_second = (rows, latest) if which == 0 else (latest, rows)
    return TimeBase(times[which][rows], rows_first, rows_second, 2 - which if apart else 0)


def difference(first: Log, second: Log, name: str, base: TimeBase) -> Array:
    """Return a column of the second log less that of the first on a time base, angles wrapped to 180 deg."""
    return _subtract_columns(first[name][base.first], second[name][base.second], name, first)


def median_step(times: Array) -> float:
    """Return the median step of a log [s]; 1 s for one of fewer than two rows."""
    return float(np.median(np.diff(times))) if times.size > 1 else 1.0


def list_input_differences(first: Run, second: Run) -> list[tuple[str, str, str]]:
    """Return keys of two runs' scenarios, versions and files that differ, with both values as texts."""
    try:
        left, right = (_flatten_inputs(side) for side in (first, second))
    except InputError:  # an old scenario, no longer readable
        return []
    keys = dict.fromkeys([*left, *right])
    return [
        (key, _format_abbreviated(left.get(key)), _format_abbreviated(right.get(key)))
        for key in keys
        if left.get(key) != right.get(key) and key not in ("title", "description", "changed")
    ]


def _compare_pair(first: ComparedFlight, second: ComparedFlight) -> LogComparison:
    base = make_time_base(first.log, second.log)
    columns_first, columns_second = first.log.columns, second.log.columns
    common = [name for name in columns_first if name in columns_second and name != TIME]
    signals = tuple(_compare_signals(first.log, second.log, common, base)) if base.times.size else ()
    is_whole = base.times.size == len(first.log) == len(second.log) and columns_first == columns_second
    times = is_whole and _to_bytes(first.log[TIME]) == _to_bytes(second.log[TIME])
    finer = median_step(second.log[TIME]) < (1.0 - _TIME_TOLERANCE) * median_step(first.log[TIME])
    return LogComparison(
        first.label,
        second.label,
        int(base.times.size),
        float(base.times[0]) if base.times.size else 0.0,
        float(base.times[-1]) if base.times.size else 0.0,
        second.label if finer else first.label,
        ("", first.label, second.label)[base.held_log],
        times and all(signal.same for signal in signals),
        signals,
        tuple(name for name in columns_first if name not in columns_second),
        tuple(name for name in columns_second if name not in columns_first),
    )


def _compare_signals(first: Log, second: Log, names: Sequence[str], base: TimeBase) -> Iterator[Signal]:
    units = {column.name: column.unit for log in (first, second) for column in log.described}
    for name in names:
        left, right = first[name][base.first], second[name][base.second]
        unlike = np.flatnonzero(_canonical_bits(left) != _canonical_bits(right))
        finite = np.isfinite(left) & np.isfinite(right)
        size = np.abs(_subtract_columns(left, right, name, first))
        peak = int(np.argmax(np.where(finite, size, -1.0)))
        yield Signal(
            name,
            units.get(name, ""),
            not unlike.size,
            int(unlike[0]) if unlike.size else None,
            float(base.times[unlike[0]]) if unlike.size else None,
            float(size[peak]) if finite.any() else None,
            float(base.times[peak]) if finite.any() and size[peak] > 0.0 else None,
            float(np.sqrt(np.mean(size[finite] ** 2))) if finite.any() else None,
            int(np.sum(np.isfinite(left) != np.isfinite(right))),
        )


def _subtract_columns(left: Array, right: Array, name: str, log: Log) -> Array:
    apart: Array = right - left
    frame = next((column.frame for column in (*log.described, *COLUMNS) if column.name == name), "")
    return np.asarray(wrap(apart)) if frame == EULER else apart


def _canonical_bits(values: Array) -> NDArray[np.int64]:
    """Return numbers as bits, with one pattern for every NaN."""
    same = np.array(values, "<f8")
    same[np.isnan(same)] = np.nan
    return same.view(np.int64)


def _to_bytes(values: Array) -> bytes:
    return _canonical_bits(values).tobytes()


def _flatten_inputs(run: Run) -> dict[str, Any]:
    scenario: Scenario = run.scenario
    table = scenario.model_dump(mode="json", exclude_none=True)
    inputs = {"version": run.summary.versions, "blas_kernels": run.summary.blas_kernels, "sha256": run.summary.sha256}
    return dict(_list_leaves({key: value for key, value in table.items() if key != "expect"} | inputs))


def _list_leaves(table: Mapping[str, Any] | Sequence[Any], before: str = "") -> Iterator[tuple[str, Any]]:
    entries = table.items() if isinstance(table, Mapping) else enumerate(table)
    for key, value in entries:
        nested = isinstance(value, Mapping) or (isinstance(value, list) and any(isinstance(v, dict) for v in value))
        if nested:
            yield from _list_leaves(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def _format_abbreviated(value: Any) -> str:
    text = "-" if value is None else value if isinstance(value, str) else str(value)
    return text if len(text) <= 40 else f"{text[:12]}..." if " " not in text else f"{text[:37]}..."
