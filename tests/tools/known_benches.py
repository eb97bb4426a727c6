"""Bench logs of engines whose truth is known, solved exactly: delay, lags, a static curve, a limit of acceleration."""

from dataclasses import dataclass

import numpy as np

from hexjet_identify.bench.command import make_command

EXCITATIONS = ("step", "stairs of 2 s", "stairs of 5 s", "stairs of 15 s", "prbs", "ramp", "chirp")
LEVELS = np.array([0.2, 0.5, 0.8, 0.4, 0.7, 0.3, 0.6, 0.9, 0.5, 0.2])


@dataclass(frozen=True)
class Truth:
    """An engine; with ``slew``, N/s, it is one lag whose thrust changes no quicker.

    With ``full_lag`` the lag goes in a straight line to that one at full thrust; its ECU reads the command every
    ``interval`` s and keeps it until another differs by more than ``dead_band``.
    """

    delay: float = 0.1
    lags: tuple[float, ...] = (0.4,)
    gain: float = 100.0
    offset: float = 5.0
    exponent: float = 1.0
    slew: tuple[float, float] | None = None  # up, down
    full_lag: float = 0.0
    interval: float = 0.0
    dead_band: float = 0.0


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


def thrust(truth, times, command, straight):
    """The thrust at these times, N, without noise."""
    if truth.slew is not None or truth.full_lag or truth.interval or truth.dead_band:
        return _stepped(truth, times, _heard(truth, times, command, straight))
    made = make_command(times, command**truth.exponent, straight)
    first, second = (*truth.lags, 0.0)[:2]
    return truth.offset + truth.gain * made.twice_lagged(first, second / first, times - truth.delay)


def _heard(truth, times, command, straight):
    """What the ECU makes of the command, by time."""
    reads = np.arange(times[0] - 0.3 * truth.interval, times[-1], truth.interval or 0.002)
    at = np.interp(reads, times, command)
    if not straight:
        at = command[np.maximum(np.searchsorted(times, reads + 1e-9, side="right") - 1, 0)]
    taken, kept = at[0], []
    for value in at:
        taken = value if abs(value - taken) > truth.dead_band else taken
        kept.append(taken)
    return lambda t: kept[max(int(np.searchsorted(reads, t + 1e-9, side="right")) - 1, 0)]


def _stepped(truth, times, heard):
    every = max(1, round((times[1] - times[0]) / 0.002))
    h = (times[1] - times[0]) / every
    up, down = truth.slew or (np.inf, np.inf)
    now, thrusts = truth.offset + truth.gain * heard(times[0]), []
    for time in times:
        thrusts.append(now)
        for part in range(every):
            steady = truth.offset + truth.gain * heard(time + part * h - truth.delay)
            level = (now - truth.offset) / truth.gain
            lag = truth.lags[0] + ((truth.full_lag or truth.lags[0]) - truth.lags[0]) * min(max(level, 0.0), 1.0)
            now += h * min(max((steady - now) / lag, -down), up)
    return np.array(thrusts)


def bench_log(kind, rate, truth=Truth(), seed=0, noise=0.5, seconds=60.0):
    """Times, command and noisy thrust, and whether the command is straight between rows."""
    times, command, straight = excite(kind, rate, seconds, seed)
    rng = np.random.default_rng([seed, 11])
    return times, command, thrust(truth, times, command, straight) + noise * rng.standard_normal(len(times)), straight
