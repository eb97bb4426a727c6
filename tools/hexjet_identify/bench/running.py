"""The seconds of a bench log in which the engine runs: without its start, its stop, and the time that it is off."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.logs.flight_log import Channel, FlightLog, unit_of

SPEED_PATTERN = r"\b(rpm|n1?|speed)\b"
NO_SPEED_PATTERN = r"set.?point|demand|target|command|cmd|air.?speed|wind|pump"
STATE_COLUMN = re.compile(r"(.*[_ ])?(state|status|ecu[_ ]state)", re.IGNORECASE)
RPM_PER_UNIT = {"rpm": 1.0, "krpm": 1e3}  # in rpm


def find_running(
    log: FlightLog, command: Channel, output: Channel, notes: list[str], off_share: float = 0.15, shortest: float = 5.0
) -> list[tuple[float, float]]:
    """Return the spans [s] of a log in which the engine runs, without start and stop; note what is left out.

    By its speed, where the log has one: below ``off_share`` of the greatest it is off (jets idle above a fifth).  A
    start ends where it stands for 3 s for the first time, a stop begins where it stood for the last, if a start takes
    8 s, as a jet's: a fan that steps from standstill is measured whole.  By a column ``state`` too, where there is one:
    the state in which the engine turned most is the one in which it runs.  Spans up to ``shortest`` s are left out.
    """
    begin, end = float(max(command.times[0], output.times[0])), float(min(command.times[-1], output.times[-1]))
    speed = find_speed(log)
    if speed is None or not end > begin:
        return [(begin, end)]
    times, values = speed.times, np.abs(speed.values)
    use = (times >= begin) & (times <= end)
    times, values = times[use], values[use]
    off = values < off_share * values.max(initial=0.0)
    if len(times) < 2 or not off.any() or off.all():
        return [(begin, end)]
    started, is_slow = _find_started_rows(times, values, off)
    in_state = _find_running_rows(log, times, values)
    if not is_slow and in_state is None:
        return [(begin, end)]
    running = ~off & started & (in_state if in_state is not None else True)
    spans = [span for span in _find_spans(times, running) if span[1] - span[0] > shortest]
    if not spans:
        return [(begin, end)]
    kept = [(begin if low == times[0] else low, end if high == times[-1] else high) for low, high in spans]
    gone = zip([begin, *(high for _, high in kept)], [*(low for low, _ in kept), end], strict=True)
    words = ", ".join(f"{low:.1f} to {high:.1f} s" for low, high in gone if high > low)
    if words:
        notes.append(f"off, start or stop of the engine: {words}; left out")
    return kept


def find_speed(log: FlightLog) -> Channel | None:
    """Return the engine's speed, where exactly one channel is called so, without rows that are no numbers."""
    found = [
        channel
        for name, channel in log.channels.items()
        if re.search(SPEED_PATTERN, name.replace("_", " "), re.IGNORECASE)
        and not re.search(NO_SPEED_PATTERN, name, re.IGNORECASE) and unit_of(name, channel.unit) in ("", *RPM_PER_UNIT)
    ]  # fmt: skip
    if len(found) != 1:
        return None
    good = np.isfinite(found[0].times) & np.isfinite(found[0].values)
    return found[0]._replace(times=found[0].times[good], values=found[0].values[good])


def _find_started_rows(
    times: Array, values: Array, off: NDArray[np.bool_], standing_s: float = 3.0, slowest_fan_s: float = 8.0
) -> tuple[NDArray[np.bool_], bool]:
    """Return which rows lie behind the start, once the speed settled, and before the stop, until it was last settled.

    And whether a start is as slow as a jet's is: an electric fan that is switched on is no start.  A speed stands that
    changes by less than 1.5 % of the greatest in ``standing_s``.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    rows = max(2, round(standing_s / float(np.median(np.diff(times)))))
    change = maximum_filter1d(values, rows) - minimum_filter1d(values, rows)
    stands = (change < 0.015 * values.max()) & ~off
    kept, is_slow = np.zeros(len(times), bool), False
    edges = np.flatnonzero(np.diff(off.astype(np.int8), prepend=1, append=1))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        standing = np.flatnonzero(stands[first:last]) + first
        if standing.size:
            is_slow |= first > 0 and times[standing[0]] - times[first] > slowest_fan_s
            kept[(first if first == 0 else standing[0]) : (last if last == len(times) else standing[-1] + 1)] = True
    return kept, bool(is_slow)


def _find_running_rows(log: FlightLog, times: Array, values: Array, most_states: int = 40) -> NDArray[np.bool_] | None:
    """Return which rows have the ECU state in which the engine turned most; None without a column of states."""
    states = [channel for name, channel in log.channels.items() if STATE_COLUMN.fullmatch(name)]
    if len(states) != 1:
        return None
    good = np.isfinite(states[0].times) & np.isfinite(states[0].values)
    row = np.searchsorted(states[0].times[good], times, side="right") - 1
    state = states[0].values[good][np.maximum(row, 0)]
    known = np.unique(state)
    if not 1 < len(known) <= most_states:
        return None
    turned = [float(values[state == one].sum()) for one in known]
    return np.asarray(state == known[int(np.argmax(turned))])


def _find_spans(times: Array, use: NDArray[np.bool_]) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(use.astype(np.int8), prepend=0, append=0))
    return [(float(times[a]), float(times[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
