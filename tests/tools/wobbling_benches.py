"""Bench logs of one lag whose time stamps, or whose output's clock, run slow, then quick; and good ones beside them."""

from pathlib import Path

import numpy as np
from known_benches import LEVELS, Truth, thrust

TRUTH = Truth(delay=0.1037)
EXCITED = ("stairs of 2 s", "stairs of 5 s", "stairs of 15 s", "prbs", "ramp", "chirp")
FINE_S = 0.002  # between whose points the thrust goes straight
JITTER, MISSING = 0.2, 0.07  # of a row, to either side; of the rows


def excite_by_seed(seed, rate, seconds=60.0):
    """Times, command from 0 to 1 with levels, turns and phases of a seed, and whether it is straight between rows."""
    rng = np.random.default_rng([seed, 5])
    kind, times = EXCITED[seed % len(EXCITED)], np.arange(int(seconds * rate)) / rate
    if kind.startswith("stairs"):
        hold = float(kind.split()[-2])
        levels = np.concatenate([rng.permutation(LEVELS[:-1]) for _ in range(4)])
        return times, levels[((times + rng.uniform(0.0, 0.5 * hold)) / hold + 1e-9).astype(int)], False
    if kind == "prbs":
        return times, 0.3 + 0.4 * rng.integers(0, 2, 1000)[(times / 0.5 + 1e-9).astype(int)], False
    if kind == "ramp":
        turns = np.array([5.0, 25.0, 35.0, 55.0]) + rng.uniform(-2.0, 2.0, 4)
        return times, np.interp(times, turns, [0.2, 0.8, 0.8, 0.2]), True
    turns = rng.random() + 0.05 * times + 1.95 * times**2 / (2.0 * seconds)
    return times, 0.5 + 0.2 * np.sin(2.0 * np.pi * turns), True


def wobble_log(kind, seed, rate=10.0, wobble=(0.0, 1.0)):
    """Columns of time [s], throttle, thrust [N]; ``wobble``: amplitude and period, s.

    Kinds: ``stamps`` wobble about even rows; ``hidden``: the thrust's clock does, behind even stamps; ``regular``;
    ``jitter``: rows come early or late, and their stamps say so; ``missing`` rows.
    """
    times, command, straight = excite_by_seed(seed, rate)
    rng = np.random.default_rng([seed, 11, *kind.encode(), *(int(100 * one) for one in wobble)])
    off = wobble[0] * np.sin(2.0 * np.pi * times / wobble[1] + rng.uniform(0.0, 2.0 * np.pi))
    if kind == "jitter":
        times = times + rng.uniform(-JITTER, JITTER, len(times)) / rate
    fine = np.arange(times[0], times[-1], FINE_S)
    at = np.maximum(np.searchsorted(times, fine + 1e-9, side="right") - 1, 0)
    newtons = thrust(TRUTH, fine, np.interp(fine, times, command) if straight else command[at], straight)
    newtons = np.interp(times - off if kind == "hidden" else times, fine, newtons)
    newtons += 0.5 * rng.standard_normal(len(times))
    keep = rng.random(len(times)) >= (MISSING if kind == "missing" else 0.0)
    stamps = times + off if kind == "stamps" else times
    return stamps[keep], command[keep], newtons[keep]


def write_log(path: Path, columns) -> Path:
    """Columns of time [s], throttle, thrust [N] as a file."""
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header="time_s,throttle,thrust_N", comments="")
    return path
