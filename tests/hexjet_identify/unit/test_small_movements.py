"""What a bench log of large movements does not tell of small ones, and the test that is named to tell it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.base.arrays import Array
from hexjet_identify.bench.fit import Part
from hexjet_identify.bench.missing_evidence import TOLD, describe_small_movements, find_small_test
from hexjet_identify.bench.record import BenchRecord

ROW_S = 0.05
GAIN = 80.0  # N per unit of throttle
DELAYS_S = (0.1, 0.3)
LAG_S = 0.4


def two_engines(part: Part) -> tuple[Array, Array]:
    """One lag behind either delay."""
    one, other = (5.0 + GAIN * part.answer(1.0, LAG_S, 0.0, delay) for delay in DELAYS_S)
    return one, other


def stairs(levels: list[float], noise: float) -> tuple[BenchRecord, Part, Array]:
    """Levels of 10 s each, and a residual of this much noise."""
    times = np.arange(0.0, 10.0 * len(levels), ROW_S)
    command = np.array(levels)[(times / 10.0).astype(int)]
    residual = noise * np.random.default_rng(3).standard_normal(len(times))
    part = Part(times, command, times, residual, ROW_S, False)
    record = BenchRecord(Path("b.csv"), "throttle", "thrust", "", "N", times, command, times, residual, ROW_S, 0.0)
    return record, part, residual


@pytest.mark.parametrize("noise", [0.05, 3.0])
def test_the_test_that_is_named_tells_two_engines_apart_by_what_it_says(noise: float) -> None:
    """Flown with that noise a thousand times, the log of their likelihoods is as far from 0 as that."""
    record, part, _ = stairs([0.2, 0.6], noise)
    named = find_small_test(part, 0.4, 0.03, (0.0, noise), two_engines)
    assert named is not None
    assert named.deviations >= 0.999 * TOLD
    begins = np.arange(0.0, named.seconds, named.hold_s)
    command = 0.4 + 0.03 * np.resize([1.0, -1.0], len(begins))
    times = np.arange(0.0, named.seconds, ROW_S)
    one, other = two_engines(Part(begins, command, times, times, ROW_S, False))
    drawn = one + noise * np.random.default_rng(5).standard_normal((1000, len(times)))
    better = (np.sum((drawn - other) ** 2, axis=1) - np.sum((drawn - one) ** 2, axis=1)) / (2.0 * noise**2)
    apart = float(np.mean(better) / np.std(better)) * 2.0  # (d^2 / 2) / d, twice
    assert apart == pytest.approx(named.deviations, rel=0.1)
    assert float(np.std(one - other)) == pytest.approx(named.apart, rel=0.1)
    assert find_small_test(part, 0.4, 0.03, (0.0, 60.0), two_engines) is None
    assert record.step == ROW_S


def test_large_movements_alone_do_not_tell_small_ones_and_the_line_says_which_next() -> None:
    """About the level that stood nearest the middle; a log with a small step, or a quick one, has no such line."""
    record, part, residual = stairs([0.1, 0.5, 0.9, 0.3], 0.1)
    (line,) = describe_small_movements([record], [part], residual, 0.5, two_engines, "N")
    assert "no movement of throttle is smaller than 0.4 (50 % of its range) or sooner than 10 s" in line
    assert "Next: 0.02 up and down about 0.5, or about where it hovers, each held " in line
    assert " N apart there (rms)" in line
    for levels in ([0.1, 0.5, 0.9, 0.85], [0.1, 0.1]):
        record, part, residual = stairs(levels, 0.1)
        assert describe_small_movements([record], [part], residual, 0.5, two_engines, "N") == []
    record, part, residual = stairs([0.1, 0.5, 0.9, 0.3], 900.0)
    (line,) = describe_small_movements([record], [part], residual, 0.5, two_engines, "N")
    assert line.endswith("engines at the ends of these bounds differ little")


def test_small_steps_between_large_ones_are_seen_though_none_of_them_is_waited_out() -> None:
    """Three steps of 0.02 in a second, on the way from 0.5 to 0.9: the log has small, quick commands."""
    record, part, residual = stairs([0.1, 0.5, 0.9, 0.3], 0.1)
    command = part.command.copy()
    for late in (19.2, 19.5, 19.8):
        command[part.times >= late] += np.where(part.times[part.times >= late] < 20.0, 0.02, 0.0)
    small = replace(part, command_times=part.times, command=command)
    said = describe_small_movements([replace(record, command=command)], [small], residual, 0.5, two_engines, "N")
    assert said == []
