"""The seconds of a bench log in which the engine runs: without its start, its stop, and the time that it is off."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.logs.flight_log import Channel, FlightLog, unit_of

SPEEDS = r"\b(rpm|n1?|speed)\b"
NO_SPEED = r"set.?point|demand|target|command|cmd|air.?speed|wind|pump"
STATES = re.compile(r"(.*[_ ])?(state|status|ecu[_ ]state)", re.IGNORECASE)
MOST_STATES = 40  # different values of a column that is called so
OFF = 0.15  # of the greatest speed, below which the engine is off: jets idle above a fifth
STANDING = 0.015  # of the greatest speed, by which it may change while it stands
STANDING_S = 3.0  # for which it has to stand, to be started
SLOWEST_FAN_S = 8.0  # that an electric engine needs from standstill until its speed stands; a jet's start takes longer
SHORTEST_S = 5.0  # of a stretch that is worth keeping
ADRIFT = 0.05  # of the greatest set-point, by which a speed may be off it
SETTLED_S = 15.0  # after which it should be there
LEAST_ADRIFT_S = 1.0  # for which it is not: less is a frame that is wrong
SLOW_ROWS_S = 1.0  # from row to row, from where on a time is doubted to be in seconds
MOST_SPANS = 6  # that are said
SPEED_UNITS = {"rpm": 1.0, "krpm": 1e3}  # in rpm


def find_running(log: FlightLog, command: Channel, output: Channel, notes: list[str]) -> list[tuple[float, float]]:
    """Return the stretches, s, in which the engine of this log is started and runs; what is left out ``notes`` say.

    By its speed, where the log has one: below 0.15 of the greatest it is off; a start ends where it stands for 3 s
    for the first time, a stop begins where it stood for the last.  That is so where a start takes 8 s, as a jet's:
    a fan that steps from standstill is measured whole.  By a column ``state`` too, where there is one: the
    state in which the engine turned most is the one in which it runs.
    """
    begin, end = float(max(command.times[0], output.times[0])), float(min(command.times[-1], output.times[-1]))
    speed = find_speed(log)
    if speed is None or not end > begin:
        return [(begin, end)]
    times, values = speed.times, np.abs(speed.values)
    use = (times >= begin) & (times <= end)
    times, values = times[use], values[use]
    off = values < OFF * values.max(initial=0.0)
    if len(times) < 2 or not off.any() or off.all():
        return [(begin, end)]
    started, is_slow = _started(times, values, off)
    in_state = _in_state(log, times, values)
    if not is_slow and in_state is None:
        return [(begin, end)]
    running = ~off & started & (in_state if in_state is not None else True)
    spans = [span for span in _spans(times, running) if span[1] - span[0] > SHORTEST_S]
    if not spans:
        return [(begin, end)]
    kept = [(begin if low == times[0] else low, end if high == times[-1] else high) for low, high in spans]
    gone = zip([begin, *(high for _, high in kept)], [*(low for low, _ in kept), end], strict=True)
    words = ", ".join(f"{low:.1f} to {high:.1f} s" for low, high in gone if high > low)
    if words:
        notes.append(f"off, start or stop of the engine: {words}; left out")
    return kept


def describe_adrift(command: tuple[str, Channel], output: tuple[str, Channel]) -> list[str]:
    """Return a line where a speed stays away from its set-point, with the seconds in which it does.

    No engine under a governor does that long after the set-point has moved: its fuel does not let it.
    """
    (command_name, asked), (output_name, speed) = command, output
    units = unit_of(command_name, asked.unit), unit_of(output_name, speed.unit)
    if not set(units) <= set(SPEED_UNITS) or min(len(asked.times), len(speed.times)) < 2:
        return []
    if float(np.median(np.diff(speed.times))) >= SLOW_ROWS_S:
        return []
    wanted, measured = SPEED_UNITS[units[0]] * asked.values, SPEED_UNITS[units[1]] * speed.values
    begins = np.append(asked.times[0], asked.times[:-1][np.diff(wanted) != 0.0])  # of what the set-point did last
    last = begins[np.maximum(np.searchsorted(begins, speed.times, side="left") - 1, 0)]
    row = np.maximum(np.searchsorted(asked.times, speed.times, side="right") - 1, 0)
    off = np.abs(measured - wanted[row])
    away = off > ADRIFT * float(np.abs(wanted).max())
    spans: list[tuple[float, float]] = []
    for low, high in _spans(speed.times, away & (speed.times - last > SETTLED_S)):
        if high - low < LEAST_ADRIFT_S:
            continue
        there = speed.times[~away & (speed.times < low)]
        begin = max(float(last[speed.times == low][0]), float(there[-1]) if there.size else -np.inf)
        if spans and begin - spans[-1][1] < SHORTEST_S:
            begin = spans.pop()[0]
        spans.append((begin, high))
    if not spans:
        return []
    far = max(float(off[(speed.times >= low) & (speed.times <= high)][-1]) for low, high in spans)
    words = ", ".join(f"{low:.1f} to {high:.1f} s" for low, high in spans[:MOST_SPANS])
    more = ", and more" if len(spans) > MOST_SPANS else ""
    return [
        f"{output_name} does not come to {command_name}, which has long stood: {words}{more}, at its end {far:.0f} rpm "
        "off; an engine that its fuel does not let follow, or a command that it ignores? no governor is seen there; "
        "--begin and --end leave that out"
    ]


def find_speed(log: FlightLog) -> Channel | None:
    """Return the engine's speed, where exactly one channel is called so, without rows that are no numbers."""
    found = [
        channel
        for name, channel in log.channels.items()
        if re.search(SPEEDS, name.replace("_", " "), re.IGNORECASE) and not re.search(NO_SPEED, name, re.IGNORECASE)
        and unit_of(name, channel.unit) in ("", *SPEED_UNITS)
    ]  # fmt: skip
    if len(found) != 1:
        return None
    good = np.isfinite(found[0].times) & np.isfinite(found[0].values)
    return found[0]._replace(times=found[0].times[good], values=found[0].values[good])


def _started(times: Array, values: Array, off: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], bool]:
    """Return which rows lie neither in a start, until the speed first stands, nor in a stop, since it last stood.

    And whether a start is as slow as a jet's is: an electric fan that is switched on is no start.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    rows = max(2, round(STANDING_S / float(np.median(np.diff(times)))))
    change = maximum_filter1d(values, rows) - minimum_filter1d(values, rows)
    stands = (change < STANDING * values.max()) & ~off
    kept, is_slow = np.zeros(len(times), bool), False
    edges = np.flatnonzero(np.diff(off.astype(np.int8), prepend=1, append=1))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        standing = np.flatnonzero(stands[first:last]) + first
        if standing.size:
            is_slow |= first > 0 and times[standing[0]] - times[first] > SLOWEST_FAN_S
            kept[(first if first == 0 else standing[0]) : (last if last == len(times) else standing[-1] + 1)] = True
    return kept, bool(is_slow)


def _in_state(log: FlightLog, times: Array, values: Array) -> NDArray[np.bool_] | None:
    """Return which rows are in the state in which the engine turned most; None where no column says a state."""
    states = [channel for name, channel in log.channels.items() if STATES.fullmatch(name)]
    if len(states) != 1:
        return None
    good = np.isfinite(states[0].times) & np.isfinite(states[0].values)
    row = np.searchsorted(states[0].times[good], times, side="right") - 1
    state = states[0].values[good][np.maximum(row, 0)]
    known = np.unique(state)
    if not 1 < len(known) <= MOST_STATES:
        return None
    turned = [float(values[state == one].sum()) for one in known]
    return np.asarray(state == known[int(np.argmax(turned))])


def _spans(times: Array, use: NDArray[np.bool_]) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(use.astype(np.int8), prepend=0, append=0))
    return [(float(times[a]), float(times[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
