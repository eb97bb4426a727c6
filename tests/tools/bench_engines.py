"""Engines on a bench whose truth is known, integrated without the product: six kinds, to 1e-6 of their thrust."""

from dataclasses import dataclass

import numpy as np
from known_benches import EXCITATIONS, excite
from scipy.signal import lfilter

GRID_S = 0.001  # of the integration; between its points a command is the mean of what it is
GAIN, OFFSET = 100.0, 5.0  # N
DELAY, LAG, SECOND_LAG = 0.1037, 0.4, 0.17  # s
SAMPLE_S = 0.1  # of an ECU that looks at its command ten times a second
BAND = 0.02  # of full throttle: a change within it is not seen
RISE, FALL = 30.0, 20.0  # N/s
KINDS = ("one lag", "two lags", "levels", "acceleration limit", "sampled", "dead band")
RATES = (5.0, 100.0, 1000.0)


@dataclass(frozen=True)
class Bench:
    """One log: rows of time [s], command and thrust [N], and between which delays [s] the engine's lies."""

    times: np.ndarray
    command: np.ndarray
    thrust: np.ndarray
    delays: tuple[float, float]


def run(kind, excitation, rate, seed, noise=0.5, seconds=60.0):
    """Return the log of an engine of this kind under this excitation, with noise [N] of this seed."""
    times, command, straight = excite(excitation, rate, seconds, seed)
    rng = np.random.default_rng([seed, KINDS.index(kind), EXCITATIONS.index(excitation), int(rate)])
    grid = np.arange(-1.0, times[-1] + 1.0 / rate, GRID_S)
    seen, delays = _seen(kind, grid, times, command, straight, rng)
    thrust = np.interp(times, grid, _answer(kind, seen))
    return Bench(times, command, thrust + noise * rng.standard_normal(len(times)), delays)


def _seen(kind, grid, times, command, straight, rng):
    """The delayed command's mean over each step of the grid, and the delays that the engine has."""
    if kind == "sampled":
        phase = SAMPLE_S * rng.random()
        looked = np.floor((grid - DELAY - phase) / SAMPLE_S) * SAMPLE_S + phase
        return _value(looked, times, command, straight), (DELAY, DELAY + SAMPLE_S)
    if straight:
        return _band(kind, np.interp(grid + 0.5 * GRID_S - DELAY, times, command)), (DELAY, DELAY)
    command = _band(kind, command)
    total = np.concatenate([[-10.0 * command[0], 0.0], np.cumsum(np.diff(times, append=times[-1] + 10.0) * command)])
    at = np.append(grid, grid[-1] + GRID_S) - DELAY
    ends = np.concatenate([[times[0] - 10.0], times, [times[-1] + 10.0]])
    return np.diff(np.interp(at, ends, total)) / GRID_S, (DELAY, DELAY)


def _value(at, times, command, straight):
    if straight:
        return np.interp(at, times, command)
    return command[np.maximum(np.searchsorted(times, at + 1e-9, side="right") - 1, 0)]


def _band(kind, command):
    """What an ECU with a dead band takes of a command: a change from the last that it took, if it is large enough."""
    if kind != "dead band":
        return command
    taken, last = [], command[0]
    for value in command.tolist():
        last = value if abs(value - last) > BAND else last
        taken.append(last)
    return np.array(taken)


def _answer(kind, command):
    """The thrust [N] at the beginning of each step of the grid, from rest."""
    if kind == "two lags":
        return OFFSET + GAIN * _second(_first(command, LAG), command)
    if kind not in ("levels", "acceleration limit"):
        return OFFSET + GAIN * _first(command, LAG)
    now, course = float(command[0]), []
    for value in command.tolist():
        course.append(now)
        if kind == "levels":
            now += (value - now) * GRID_S / (0.8 - 0.6 * now)
        else:
            now += min(max((value - now) * GRID_S / (0.5 * LAG), -GRID_S * FALL / GAIN), GRID_S * RISE / GAIN)
    return OFFSET + GAIN * np.array(course)


def _first(command, lag):
    """States of one lag at the beginning of each step, the command held over each: exact."""
    fade = np.exp(-GRID_S / lag)
    return command[0] + lfilter([0.0, 1.0 - fade], [1.0, -fade], command - command[0])


def _second(first, command):
    """States of a second lag, behind one whose course within a step is an exponential: exact."""
    fast, slow = np.exp(-GRID_S / SECOND_LAG), np.exp(-GRID_S / LAG)
    through = LAG / (LAG - SECOND_LAG) * (slow - fast)
    drive = (1.0 - fast - through) * (command - command[0]) + through * (first - command[0])
    return command[0] + lfilter([0.0, 1.0], [1.0, -fast], drive)
