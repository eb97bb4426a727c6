"""Bench logs of engines whose truth is known, solved exactly: delay, lags, a static curve, a limit of acceleration."""

from dataclasses import dataclass

import numpy as np

from cosim.identify.bench.command import make_command

EXCITATIONS = ("step", "stairs of 2 s", "stairs of 5 s", "stairs of 15 s", "prbs", "ramp", "chirp")
LEVELS = np.array([0.2, 0.5, 0.8, 0.4, 0.7, 0.3, 0.6, 0.9, 0.5, 0.2])


@dataclass(frozen=True)
class Truth:
    """An engine; with ``slew``, N/s, it is one lag whose thrust changes no quicker."""

    delay: float = 0.1
    lags: tuple[float, ...] = (0.4,)
    gain: float = 100.0
    offset: float = 5.0
    exponent: float = 1.0
    slew: tuple[float, float] | None = None  # up, down


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
    if truth.slew is not None:
        return _limited(truth, times, command)
    made = make_command(times, command**truth.exponent, straight)
    first, second = (*truth.lags, 0.0)[:2]
    return truth.offset + truth.gain * made.twice_lagged(first, second / first, times - truth.delay)


def _limited(truth, times, command):
    every = max(1, round((times[1] - times[0]) / 0.002))
    h = (times[1] - times[0]) / every
    up, down = truth.slew
    now, thrusts = truth.offset + truth.gain * command[0], []
    for n in range(len(times)):
        thrusts.append(now)
        for part in range(every):
            row = max(int(np.searchsorted(times, times[n] + part * h - truth.delay + 1e-9, side="right")) - 1, 0)
            steady = truth.offset + truth.gain * command[row]
            now += h * min(max((steady - now) / truth.lags[0], -down), up)
    return np.array(thrusts)


def bench_log(kind, rate, truth=Truth(), seed=0, noise=0.5, seconds=60.0):
    """Times, command and noisy thrust, and whether the command is straight between rows."""
    times, command, straight = excite(kind, rate, seconds, seed)
    rng = np.random.default_rng([seed, 11])
    return times, command, thrust(truth, times, command, straight) + noise * rng.standard_normal(len(times)), straight
