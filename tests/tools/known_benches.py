"""Bench logs of engines whose truth is known, integrated without the product: exact where the command stands still."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

EXCITATIONS = ("step", "stairs of 2 s", "stairs of 5 s", "stairs of 15 s", "prbs", "ramp", "chirp")
LEVELS = np.array([0.2, 0.5, 0.8, 0.4, 0.7, 0.3, 0.6, 0.9, 0.5, 0.2])
GRID_S = 0.001


@dataclass(frozen=True)
class Truth:
    """An engine: a delay and lags [s], thrust = offset + gain throttle^exponent [N].

    With ``slew``, N/s up and down, it is one lag whose thrust changes no quicker; its ECU reads the command every
    ``interval`` s; a governor integrates the error of the thrust outside of a dead band instead of any lag.
    """

    delay: float = 0.1
    lags: tuple[float, ...] = (0.4,)
    gain: float = 100.0
    offset: float = 5.0
    exponent: float = 1.0
    slew: tuple[float, float] | None = None
    interval: float = 0.0
    governor: bool = False


def excite(kind, rate, seconds=60.0, seed=0):
    """Times, command from 0 to 1, and whether it is straight between rows."""
    rng = np.random.default_rng([seed, 5])
    times = np.arange(int((20.0 if kind == "step" else seconds) * rate)) / rate
    if kind == "step":
        return times, np.where(times < 5.0, 0.3, 0.7), False
    if kind.startswith("stairs"):
        hold = float(kind.split()[-2])
        return times, LEVELS[(times / hold + 1e-9).astype(int) % len(LEVELS)], False
    if kind == "prbs":
        return times, 0.3 + 0.4 * rng.integers(0, 2, 1000)[(times / 0.5 + 1e-9).astype(int)], False
    if kind == "ramp":
        return times, np.interp(times, [0, 5, 25, 35, 55, 60], [0.2, 0.2, 0.8, 0.8, 0.2, 0.2]), True
    return times, 0.5 + 0.2 * np.sin(2 * np.pi * (0.05 * times + 1.95 * times**2 / (2 * seconds))), True


def thrust(truth, times, course, straight):
    """The thrust at these times, N, without noise; ``course``: times and values of the command."""
    moments, command = course
    grid = np.arange(times[0] - 1.0, times[-1] + 2.0 * GRID_S, GRID_S)
    looked = grid - truth.delay
    if truth.interval:
        looked = np.floor(looked / truth.interval) * truth.interval
    if straight:
        seen = np.interp(looked + 0.5 * GRID_S * (not truth.interval), moments, command)
    else:
        seen = command[np.maximum(np.searchsorted(moments, looked + 1e-9, side="right") - 1, 0)]
        moved = np.flatnonzero(np.diff(command)) + 1
        for row in moved if not truth.interval else ():
            k = int(np.floor((moments[row] + truth.delay - grid[0]) / GRID_S + 1e-9))
            part = (moments[row] + truth.delay - grid[k]) / GRID_S
            seen[k] = part * command[row - 1] + (1.0 - part) * command[row]
    goal = truth.offset + truth.gain * seen**truth.exponent
    if truth.governor or truth.slew is not None:
        return np.interp(times, grid, _stepped(truth, goal))
    answer = goal - goal[0]
    for number, lag in enumerate(truth.lags):
        fade = np.exp(-GRID_S / lag)
        drive = answer if number == 0 else 0.5 * (answer + np.append(answer[1:], answer[-1]))
        answer = lfilter([0.0, 1.0 - fade], [1.0, -fade], drive)
    return np.interp(times, grid, goal[0] + answer)


def _stepped(truth, goals):
    now, integral, course = float(goals[0]), 0.0, []
    up, down = truth.slew or (np.inf, np.inf)
    for goal in goals.tolist():
        course.append(now)
        error = goal - now
        if truth.governor:
            error = error if abs(error) > 0.02 * truth.gain else 0.0
            integral += 0.25 * error * GRID_S
            now += GRID_S * (0.6 * error + integral)
        else:
            now += GRID_S * min(max(error / truth.lags[0], -down), up)
    return np.array(course)


def bench_log(kind, rate, truth=Truth(), seed=0, noise=0.5, seconds=60.0):
    """Times, command and noisy thrust, and whether the command is straight between rows."""
    times, command, straight = excite(kind, rate, seconds, seed)
    rng = np.random.default_rng([seed, 11])
    # A command that moves on moves on between its rows too.
    course = excite(kind, 200.0, seconds, seed)[:2] if straight else (times, command)
    return times, command, thrust(truth, times, course, straight) + noise * rng.standard_normal(len(times)), straight
