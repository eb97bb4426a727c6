"""Two clocks of a bench: a load cell's laid on the engine controller's, and how sure that is."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.bench.command import make_command
from hexjet_identify.engine_file import DEVIATIONS_95
from hexjet_identify.logs.flight_log import Channel, FlightLog
from hexjet_identify.logs.table import columns_with_time, plain_name, unit_in_name
from hexjet_identify.logs.table_columns import TableColumns
from hexjet_identify.robust import memory_rows, robust_factor

GRID_S = 0.1  # of the first search
FASTEST_DRIFT = 0.02  # of one clock against the other, that is looked for
FINE_S = 0.02  # to which a faster output is averaged
LEAST_OVERLAP = 0.5  # of the shorter log, at any shift that is tried
MOST_DRIFTS = 81
SAME = 0.002  # of a correlation: shifts that are so near to the best are as good
APART_S = 2.0  # from one shift to another that is tried
MOST_STARTS = 6
LEAST_ALIKE = 0.7  # correlation, from which on a shift is tried
TRIES = 11  # of shift and of drift about each, before it is refined
AS_GOOD = 2.0  # times what the best shift leaves unexplained, up to which another is as good
DEGREE = 3  # of the static curve's polynomial
LEAST_EXPLAINED = 0.8  # of the output's variance, by the speed: with less there is nothing to align
LEAST_CLOCK = 20  # rows of a column of time
GROWS = 0.9  # share of them that are later than the one before
LEAST_S = 5.0  # of a log whose clock is to be told
LAGS_S = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # of an output behind its command, that are tried
ROOM_S = 0.2  # of delay, where nothing tells it
SAME_CLOCK = 0.1  # rows, to which two columns of time of one clock agree
CLOCKS = frozenset(("time", "t", "timestamp", "clock", "zeit", "temps", "tiempo", "elapsed", "utc", "uptime"))


class _Start(NamedTuple):
    """A shift [s] and a drift at which a power of a signal and the output are alike, over so many seconds."""

    alike: float  # correlation
    overlap: float
    shift: float
    drift: float


class Alignment(NamedTuple):
    """From the output's clock to the command's: ``time + shift + drift (time - middle)``, with deviations."""

    shift: float  # s
    drift: float  # s a second
    middle: float  # s, of the output's clock, at which the shift holds
    shift_deviation: float  # s, the row of the slower log included
    drift_deviation: float
    explained: float  # share of the output's variance
    others: tuple[float, ...] = ()  # s, shifts that explain it as well, over a shorter part of the logs

    def on_the_other(self, times: Array) -> Array:
        """Return times of the output [s] on the command's clock."""
        return np.asarray(times + self.shift + self.drift * (times - self.middle))

    @property
    def words(self) -> str:
        """What is to be said of it."""
        drift = f"drifts by {1e6 * self.drift:.0f} ±{1e6 * DEVIATIONS_95 * self.drift_deviation:.2g} ppm"
        return (
            f"two clocks: the output's is {self.shift:+.3f} s off at its {self.middle:.0f} s, "
            f"±{1e3 * DEVIATIONS_95 * self.shift_deviation:.2g} ms (95 %), and {drift}; laid over each other by the "
            "speed, which the output is taken to follow at once.  A shift between clocks is the same thing as a delay: "
            "the delay cannot be told better than that, and what output lags behind speed is not in it"
            + "".join(
                f"; the movements repeat: {shift:+.1f} s explains as much, over a shorter part" for shift in self.others
            )
        )


def split_clocks(path: Path, columns: TableColumns, time_unit: str | None = None) -> list[FlightLog]:
    """Return a table with columns of time of several clocks as a log each; an empty list where there is one clock.

    A signal is on the clock with a word of whose name its own begins or ends (``cell_time``, ``cell_force``), else on
    the one in the nearest column to its left.  Raises InputError where neither tells it.
    """
    names = columns.names
    named = [name for name in names if CLOCKS & _words(name)]
    if len(named) < 2:
        return []
    tables = {name: columns_with_time(path, columns, name, time_unit) for name in named}
    clocks = _different_clocks({name: table.times for name, table in tables.items()})
    if len(clocks) < 2:
        return []
    owner = _owners(names, list(clocks))
    if owner is None:
        raise InputError(
            f"{path}: {' and '.join(clocks)} are not one clock, and neither names nor order of the columns say which "
            "signal is on which: put each before its signals, or time_column (--time) takes one for all"
        )
    logs = []
    for clock, times in clocks.items():
        table, use = tables[clock], np.isfinite(times)
        units = {name: table.units.get(name, "") or unit_in_name(name) for name in names}
        channels = {
            name: Channel(times[use], table.columns[name][use], units[name])
            for name in names if owner.get(name) == clock and name in table.columns and name not in tables
        }  # fmt: skip
        logs.append(FlightLog(path, f"table by {clock}", channels, tuple(table.remarks)))
    return logs


def _words(name: str) -> set[str]:
    return set(re.split(r"[^a-z]+", plain_name(name)))


def _different_clocks(times: dict[str, Array]) -> dict[str, Array]:
    """Return the times that grow from row to row and are not those of one before, in another unit or counted from then.

    Two clocks at the same rows may be one, but for where they count from.
    """
    found: dict[str, Array] = {}
    for name, own in times.items():
        good = own[np.isfinite(own)]
        if len(good) < LEAST_CLOCK or np.mean(np.diff(good) > 0.0) < GROWS:
            continue
        if not any(_same_clock(other, own) for other in found.values()):
            found[name] = own
    return found


def _same_clock(first: Array, second: Array) -> bool:
    both = np.isfinite(first) & np.isfinite(second)
    if not np.array_equal(np.isfinite(first), np.isfinite(second)):
        return False
    row = float(np.median(np.diff(first[both])))
    return float(np.ptp(second[both] - first[both])) < SAME_CLOCK * row


def _owners(names: Sequence[str], clocks: list[str]) -> dict[str, str] | None:
    """Return the clock of each signal; None where neither names nor order tell it."""
    labels = {clock: _words(clock) - CLOCKS - {""} for clock in clocks}
    signals = [name for name in names if name and not CLOCKS & _words(name)]
    named = {name: [clock for clock in clocks if labels[clock] & _words(name)] for name in signals}
    if all(len(found) == 1 for found in named.values()):
        return {name: found[0] for name, found in named.items()}
    at = [names.index(clock) for clock in clocks]
    between = [
        any(name in signals for name in names[a + 1 : b]) for a, b in zip(at, [*at[1:], len(names)], strict=True)
    ]
    if at[0] > min(map(names.index, signals)) or not all(between):
        return None
    return {name: clocks[int(np.searchsorted(at, names.index(name))) - 1] for name in signals}


def align(speed_times: Array, speed: Array, times: Array, output: Array, where: str) -> Alignment:
    """Return how the output's clock lies on that of a speed which the output follows by a static curve.

    Times in s.  Raises InputError where the two do not show the same movements.
    """
    if not np.ptp(speed) > 0.0 or np.ptp(speed_times) < LEAST_S or np.ptp(times) < LEAST_S:
        raise InputError(f"{where}: the clocks of two files are told by movements, and there are none")
    row = float(np.median(np.diff(speed_times)))
    times, output = _averaged(times, output, min(FINE_S, row))
    share = (speed - speed.min()) / np.ptp(speed)
    middle = 0.5 * float(times[0] + times[-1])
    span = float(times[-1] - times[0])
    steps = min(MOST_DRIFTS // 2, int(FASTEST_DRIFT * span / 2.0 / GRID_S))
    drifts = np.linspace(-FASTEST_DRIFT, FASTEST_DRIFT, 2 * steps + 1) if steps else (0.0,)
    starts = _search(speed_times, share, times, output, middle, drifts)
    found = [_refine(speed_times, share, times, output, middle, start) for start in starts]
    explained = max((one[-1] for one in found), default=0.0)
    if explained < LEAST_EXPLAINED:
        raise InputError(
            f"{where}: the clocks of the two files cannot be laid over each other: at best the speed explains "
            f"{100.0 * explained:.0f} % of the output; another engine, another run, a load cell of the other sign, or "
            "no movement in common"
        )
    near = [n for n, one in enumerate(found) if 1.0 - one[-1] <= AS_GOOD * (1.0 - explained)]
    longest = max(near, key=lambda n: starts[n].overlap)  # of movements that repeat
    shift, drift, deviations, explained = found[longest]
    if abs(drift) > FASTEST_DRIFT:
        raise InputError(
            f"{where}: the clocks of the two files drift apart by {100.0 * abs(drift):.2g} %, and no clock does by "
            f"more than {100.0 * FASTEST_DRIFT:g} %; a time in another unit or counted in rows, or another run"
        )
    others = tuple(found[n][0] for n in near if abs(found[n][0] - shift) > APART_S)
    deviation = float(np.hypot(deviations[0], row / 12.0**0.5))
    return Alignment(shift, drift, middle, deviation, deviations[1], explained, others)


def align_by_command(command: Channel, times: Array, output: Array, where: str) -> tuple[float, str]:
    """Return the shift [s] that lays an output on the clock of its command, and what is to be said of it.

    Nothing else is in both files, so the delay is not told: the shift is one at which it is about ``ROOM_S``.
    """
    if not np.ptp(command.values) > 0.0 or np.ptp(times) < LEAST_S:
        raise InputError(f"{where}: the clocks of two files are told by movements, and there are none")
    times, output = _averaged(times, output, FINE_S)
    best, shift = -1.0, 0.0
    for lag in LAGS_S:
        answer = make_command(command.times, command.values, False).lagged(lag, command.times)
        starts = _search(command.times, answer, times, output, 0.0, (0.0,), 1)
        if starts and starts[0].alike > best:
            best = starts[0].alike
            shift = max((one for one in starts if one.alike > best - SAME), key=lambda one: one.overlap).shift
    if best**2 < LEAST_EXPLAINED:
        raise InputError(
            f"{where}: the clocks of the two files cannot be laid over each other: at best the command explains "
            f"{100.0 * best**2:.0f} % of the output; another engine, another run, or no movement in common"
        )
    return shift + ROOM_S, (
        "two clocks, and nothing that both files have: a shift between clocks is the same thing as a delay, so the "
        "delay is not told at all, and its bounds are all that was looked for.  Log the speed with the command: it "
        "tells the clocks apart; or both on one clock"
    )


def _averaged(times: Array, values: Array, seconds: float) -> tuple[Array, Array]:
    cell = np.floor((times - times[0]) / seconds).astype(np.int64)
    count = np.bincount(cell)
    full = count > 0
    return np.bincount(cell, times)[full] / count[full], np.bincount(cell, values)[full] / count[full]


def _search(
    known_times: Array, known_values: Array, times: Array, output: Array, middle: float, drifts: Iterable[float],
    degree: int = DEGREE,
) -> list[_Start]:  # fmt: skip
    """Return where a power of a signal and the output are most alike, the best first, some seconds from each other."""
    from scipy.ndimage import maximum_filter1d
    from scipy.signal import fftconvolve

    at = np.arange(known_times[0], known_times[-1], GRID_S)
    known = np.interp(at, known_times, known_values) ** degree
    found: list[_Start] = []
    for drift in drifts:
        own = times + drift * (times - middle)
        grid = np.arange(own[0], own[-1], GRID_S)
        moved = np.interp(grid, own, output)
        ones = [np.ones(len(known)), np.ones(len(moved))]
        count, a, b, aa, bb, ab = (
            fftconvolve(x, y[::-1])
            for x, y in (
                (ones[0], ones[1]), (known, ones[1]), (ones[0], moved), (known**2, ones[1]), (ones[0], moved**2),
                (known, moved),
            )
        )  # fmt: skip
        enough = count > LEAST_OVERLAP * min(len(known), len(moved))
        n = np.maximum(count, 1.0)
        power = np.maximum(aa - a * a / n, 1e-9 * aa.max()) * np.maximum(bb - b * b / n, 1e-9 * bb.max())
        alike = np.where(enough, (ab - a * b / n) / np.sqrt(power), -1.0)
        peaks = np.flatnonzero(
            enough & (alike > LEAST_ALIKE) & (alike == maximum_filter1d(alike, 2 * int(APART_S / GRID_S) + 1))
        )
        begin = float(at[0] - grid[0]) - (len(moved) - 1) * GRID_S
        found += [
            _Start(float(alike[k]), float(count[k]) * GRID_S, begin + float(k) * GRID_S, float(drift)) for k in peaks
        ]
    starts: list[_Start] = []
    for one in sorted(found, reverse=True):
        if len(starts) < MOST_STARTS and all(abs(one.shift - other.shift) > APART_S for other in starts):
            starts.append(one)
    return starts


def _refine(
    speed_times: Array, share: Array, times: Array, output: Array, middle: float, start: _Start
) -> tuple[float, float, tuple[float, float], float]:
    """Return shift and drift by least squares, their deviations, and the share of the output that is explained."""
    from scipy.optimize import least_squares

    length = 0.5 * float(times[-1] - times[0])
    own = times + start.shift + start.drift * (times - middle)
    margin = 2.0 + FASTEST_DRIFT * length
    use = (own > speed_times[0] + margin) & (own < speed_times[-1] - margin)
    use = use if use.sum() > 0.3 * len(use) else (own > speed_times[0]) & (own < speed_times[-1])
    times, output = times[use], output[use]

    def columns(x: Array) -> Array:
        at = times + x[0] + x[1] * (times - middle) / length
        v = np.interp(at, speed_times, share)
        return np.column_stack([v**n for n in range(DEGREE + 1)])

    def left(x: Array) -> Array:
        basis = np.linalg.qr(columns(x))[0]
        return np.asarray(output - basis @ (basis.T @ output))

    ahead = GRID_S * np.linspace(-1.0, 1.0, TRIES)  # from a row of the first search to the next
    tries = [np.array([start.shift + a, start.drift * length + b]) for a in ahead for b in ahead]
    begun = min(tries, key=lambda x: float(np.sum(left(x) ** 2)))
    answer = least_squares(left, begun, x_scale=GRID_S, diff_step=1e-2)
    x, h = answer.x, 0.01
    white = left(x)
    slopes = [(left(x + h * e) - left(x - h * e)) / (2.0 * h) for e in np.eye(2)]
    jacobian = np.column_stack([*slopes, columns(x)])
    covariance = float(white @ white) / len(white) * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    wider = robust_factor(jacobian, white, covariance, memory_rows(white))
    deviation = np.sqrt(np.diag(covariance)) * wider
    explained = 1.0 - float(np.var(white)) / max(float(np.var(output)), 1e-300)
    if not float(np.cov(columns(x)[:, 1], output - white)[0, 1]) > 0.0:  # no thrust falls where the speed rises
        explained = 0.0
    return float(x[0]), float(x[1]) / length, (float(deviation[0]), float(deviation[1]) / length), explained
