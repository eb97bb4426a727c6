"""The one fit: answers in closed form, exact numbers without noise, the rule of the verdict."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_benches import Truth, bench_log

from hexjet_identify.bench.engine_table import fit_power_law
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.remarks import describe_small_movements
from hexjet_identify.fit.answers import answer_of_lags, answer_of_limits, interpolation_weights
from hexjet_identify.fit.estimate import fit, thin_rows
from hexjet_identify.fit.evidence import PredictedMovement, Verdict, describe_movements, judge, predict_held_back
from hexjet_identify.fit.forms import Lags, Limits, Poles
from hexjet_identify.fit.logs import Log
from hexjet_identify.fit.problem import Problem

TIMES = np.arange(0.0, 20.0, 0.01)


def log_of(times: np.ndarray, command: np.ndarray, output: np.ndarray, is_straight: bool = False) -> Log:
    return Log(times, command, times, output, float(times[1] - times[0]), is_straight)


def test_a_step_and_a_ramp_behind_a_lag_are_answered_in_closed_form() -> None:
    since = np.maximum(TIMES - 5.0 - 0.123, 0.0)
    step = Log(np.array([0.0, 5.0]), np.array([0.0, 1.0]), TIMES, TIMES, 0.01)
    np.testing.assert_allclose(
        answer_of_lags(step, step.command[:, None], 0.123, {0.4: 1.0})[:, 0], 1.0 - np.exp(-since / 0.4), atol=1e-12
    )
    ramp = Log(np.array([0.0, 5.0, 25.0]), np.array([0.0, 0.0, 20.0]), TIMES, TIMES, 0.01, True)
    np.testing.assert_allclose(
        answer_of_lags(ramp, ramp.command[:, None], 0.123, {0.4: 1.0})[:, 0],
        since - 0.4 * (1.0 - np.exp(-since / 0.4)),
        atol=1e-12,
    )


def test_poles_behind_a_delay_are_answered_in_closed_form_and_noise_needs_rows_without_a_gap() -> None:
    kept = np.delete(np.arange(2000), [700, 701, 702])
    log = Log(np.array([0.0, 5.0]), np.array([0.0, 1.0]), TIMES[kept], TIMES[kept], 0.01, index=kept)
    problem, since = Problem([log], np.empty(0), 1.0), np.maximum(log.times - 5.123, 0.0)
    wanted = 1.25 * (np.expm1(-10.0 * since) / 10.0 - np.expm1(-2.0 * since) / 2.0)
    np.testing.assert_allclose(Poles(False, 1).columns(problem, np.array([0.123, 2.0, 0.1]))[:, 0], wanted, atol=1e-12)
    assert problem.equations(2).sum() == len(kept) - 4


def test_limits_go_in_a_straight_line_until_the_lag_takes_over() -> None:
    """From 0 to 10 at 4 a second with a lag of 0.5 s: straight until 2 are left, at 2 s, then an exponential."""
    step = Log(np.array([0.0, 5.0]), np.array([0.0, 1.0]), TIMES, TIMES, 0.01)
    since = np.maximum(TIMES - 5.1, 0.0)
    wanted = np.where(since < 2.0, 4.0 * since, 10.0 - 2.0 * np.exp(-(since - 2.0) / 0.5))
    levels = (np.eye(2), np.array([0.0, 10.0]))
    np.testing.assert_allclose(answer_of_limits(step, *levels, 0.1, 0.5, 4.0, 9.0)[:, 0], wanted, atol=1e-12)


@pytest.mark.parametrize("is_straight", [False, True])
def test_slopes_of_limits_are_the_differences(is_straight: bool) -> None:
    log = log_of(TIMES, 0.5 + 0.4 * np.sin(0.2 * TIMES**2), TIMES, is_straight)
    knots = np.linspace(0.1, 0.9, 4)
    at, shares = np.array([0.1037, 0.2, 150.0, 100.0, *(200.0 * knots**1.5)]), interpolation_weights(log.command, knots)
    slopes = answer_of_limits(log, shares, at[4:], *at[:4])[:, 1:]
    for number, step in enumerate(np.diag(1e-6 * at)):
        above, below = (answer_of_limits(log, shares, x[4:], *x[:4])[:, 0] for x in (at + step, at - step))
        wanted = (above - below) / (2.0 * step[number])
        np.testing.assert_allclose(slopes[:, number], wanted, atol=1e-5 * np.abs(wanted).max())


def test_shares_of_levels_are_hats() -> None:
    np.testing.assert_allclose(
        interpolation_weights(np.array([-1.0, 0.25, 0.5, 2.0]), np.array([0.0, 0.5, 1.0])),
        [[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    )


@pytest.mark.parametrize(("lags", "count"), [((0.4,), 1), ((0.4, 0.17), 2)])
def test_without_noise_numbers_and_levels_are_the_truth(lags: tuple[float, ...], count: int) -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0, Truth(0.1037, lags, exponent=1.6), noise=0.0)
    problem = Problem([log_of(times, command, thrust)], np.unique(command), 2.0)
    found = fit(problem, Lags(count), np.array([0.2, np.log(0.2), 0.3][: 1 + count]))
    assert [value for value, _ in found.numbers.values()] == pytest.approx([0.1037, *lags], abs=1e-3)
    np.testing.assert_allclose(found.levels(problem), 5.0 + 100.0 * problem.knots**1.6, atol=1e-2)
    assert found.total[0] == pytest.approx(0.1037 + sum(lags), abs=1e-4)


def test_limits_of_rise_and_fall_are_the_truth() -> None:
    times, command, thrust, _ = bench_log("stairs of 5 s", 50.0, Truth(lags=(0.2,), slew=(30.0, 20.0)), noise=0.0)
    problem = Problem([log_of(times, command, thrust)], np.unique(command), 2.0)
    start = np.array([0.2, np.log(0.3), np.log(40.0), np.log(15.0), *(5.0 + 100.0 * problem.knots)])
    found = fit(problem, Limits(), start)
    assert [value for value, _ in found.numbers.values()] == pytest.approx([0.1, 0.2, 30.0, 20.0], rel=0.02)


@pytest.mark.parametrize(
    ("verdict", "explained", "words"),
    [
        (Verdict(0.002, 24, 24), True, "explained to 0.2 % of the range, 24 of 24 times within 10 %"),
        (Verdict(0.039, 10, 24), False, "not explained: 3.9 %, 10 of 24 times"),
        (Verdict(0.01, 19, 24), False, "not explained: 1 %, 19 of 24 times"),
        (Verdict(0.014, 0, 0), True, "explained to 1.4 % of the range"),
        (Verdict(0.016, 3, 3), False, "not explained: 1.6 %, 3 of 3 times"),
    ],
)
def test_the_verdict_is_decided_by_what_is_left_over_and_by_times(
    verdict: Verdict, explained: bool, words: str
) -> None:
    assert verdict.is_explained is explained
    assert verdict.words == words


def test_a_long_hold_hides_nothing_of_a_movement() -> None:
    """A step that is a second late of ten, in a log that stands for a hundred more, is off as in a short one."""
    offs = []
    for seconds in (20.0, 120.0):
        times = np.arange(0.0, seconds, 0.05)
        problem = Problem([log_of(times, (times > 5.0) * 1.0, (times > 6.0) * 1.0)], np.array([0.0, 1.0]), 2.0)
        fitted = fit(problem, Lags(1), np.array([1.0, np.log(0.05)]))
        late = replace(fitted, residual=problem.output - (times > 7.0))
        offs.append(judge(problem, late, 3.0, ()).off)
    assert offs[0] == pytest.approx(offs[1], rel=0.01)
    assert offs[0] > 0.2


def test_each_movement_of_a_staircase_is_foretold_from_every_second_other_one() -> None:
    """The times of a lag of 0.4 s behind 0.1 s: delay - lag ln(1 - share)."""
    times, command, thrust, _ = bench_log("stairs of 5 s", 100.0)
    problem = Problem([log_of(times, command, thrust)], np.unique(command), 2.0)
    held = predict_held_back(problem, fit(problem, Lags(1), np.array([0.2, np.log(0.2)])), 0.5)
    assert [one.begin for one in held] == pytest.approx([*range(5, 50, 5), 55], abs=0.011)
    for one in held:
        assert one.model == pytest.approx([0.1 - 0.4 * np.log(1.0 - share) for share in (0.1, 0.5, 0.9)], abs=0.03)
        assert one.rms == pytest.approx(0.5, rel=0.15)
    assert sum(one.count_near() for one in held) >= 0.9 * 3 * len(held)
    stuck = PredictedMovement(0, 88.9, 33.0, 60.0, 1.0, (1.0, 2.0, 4.0), (1.05, 2.5, float("nan")), (0.0, 0.0, 0.0))
    assert stuck.count_near() == 1
    assert describe_movements((stuck,), "krpm", 67.0) == [
        ["88.9 s", "33 to 60 krpm", "1.5 %", "1 s (+5 %)", "2 s (+25 %)", "4 s (never)"]
    ]


def test_rows_are_thinned_evenly_in_each_log() -> None:
    logs = [log_of(TIMES[:count], TIMES[:count], TIMES[:count]) for count in (1003, 901)]
    thinned = thin_rows(Problem(logs, np.array([0.0, 20.0]), 1.0), rows=190)
    assert [log.times[:2].tolist() for log in thinned.logs] == [[0.0, 0.1], [0.0, 0.1]]


def test_a_power_law_is_laid_through_levels() -> None:
    knots = np.array([0.1, 0.4, 0.7, 1.0])
    assert fit_power_law(knots, 4.0 + 200.0 * knots**1.6, np.ones(4)) == pytest.approx((200.0, 4.0, 1.6), rel=1e-5)
    assert fit_power_law(knots[:2], 4.0 + 200.0 * knots[:2], np.ones(2))[2] == 1.0


def test_of_large_movements_alone_small_ones_are_the_next_test() -> None:
    def said(*levels: float) -> list[str]:
        times = np.arange(0.0, 10.0 * len(levels), 0.1)
        command = np.repeat(levels, 100)
        record = BenchRecord(Path("b.csv"), "setpoint", "rpm", "rpm", "rpm", times, command, times, times, 0.1, 0.0)
        return describe_small_movements([record], 1.0)

    (line,) = said(33e3, 60e3, 100e3, 60e3)
    assert "no movement of setpoint is smaller than 27000 rpm (40 % of its range). Next: 2000 rpm up" in line
    assert "about 60000, or about where it hovers, each held 0.5 s, 40 times" in line
    assert said(33e3, 60e3, 62e3, 100e3) == []
