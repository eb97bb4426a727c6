"""Six kinds of engines, seven excitations, three rates: what is said of the delay is true, or said to be unknown."""

from pathlib import Path

import numpy as np
import pytest
from bench_engines import DELAY, KINDS, LAG, RATES, SECOND_LAG, run
from known_benches import EXCITATIONS
from scipy.stats import binom

from cosim.identify.bench import BenchRecord, identify_bench

EXACT = ("one lag", "two lags")  # which the forms contain: there 95 % are 95 %


def identify(kind, excitation, rate, seed):
    log = run(kind, excitation, rate, seed)
    record = BenchRecord(
        Path("bench.csv"), "throttle", "thrust_N", "1", "N", log.times, log.command, log.times, log.thrust,
        1.0 / rate, 0.0,
    )  # fmt: skip
    return log, identify_bench([record])


def judge(kind, excitation, rate, seed):
    """Whether the delay's bounds hold it, those of the sum hold that, the delay is near, and what is said."""
    log, found = identify(kind, excitation, rate, seed)
    low, high = found.chosen.delay_bounds
    lags = LAG + (SECOND_LAG if kind == "two lags" else 0.0)
    value, deviation = found.chosen.total
    return {
        "held": low <= log.delays[1] and high >= log.delays[0],
        "sum": abs(value - DELAY - lags) <= 1.96 * deviation,
        "near": abs(found.chosen.delay - np.clip(found.chosen.delay, *log.delays)) <= 1.0 / rate,
        "explained": found.is_explained,
        "told": not any(line.startswith("the delay") for line in found.untold),
        "bounds": (low, high),
    }
