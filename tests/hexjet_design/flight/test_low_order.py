"""The controller at the limit, of low order: it keeps what it was found with, in a loop that is run by other code."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import law_loop
import numpy as np
import pytest
from optimal_block import Behind

from cosim.base.errors import InputError
from hexjet_design.assessment import predictor_model
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.limit import find_limit
from hexjet_design.loop.low_order import START_POLES, LowOrder, free_weights, reduce_order
from hexjet_design.loop.programme import Bounds

pytest.importorskip("clarabel", reason="Clarabel is not installed")

BOUNDS = Bounds(1.7, 1.5e-3, 0.4, 7.5)
LAG_S = 0.064


@cache
def roll() -> Channel:
    """The roll axis without a filter of its gyro, of which its own model is exact."""
    return replace(law_loop.roll(), rate_filter_s=0.0)


@cache
def reduced() -> LowOrder:
    return reduce_order(roll(), roll().model("exact"), BOUNDS, LAG_S, rounds=0)


def test_a_low_order_keeps_the_bounds_in_the_loop_and_is_near_the_limit() -> None:
    low, block = reduced(), Behind(roll(), reduced().target)
    loop = law_loop.LawLoop(roll(), block, block.attitude)
    assert loop.load_error == pytest.approx(low.loop.load_error, rel=1e-4)
    assert loop.step_error == pytest.approx(low.loop.step_error, rel=1e-4)
    assert loop.noise == pytest.approx(low.loop.noise, rel=1e-3)
    assert loop.peak_sensitivity == pytest.approx(low.loop.peak_sensitivity, rel=1e-4)
    assert loop.peak_sensitivity <= 1.001 * BOUNDS.peak_sensitivity
    assert loop.noise <= 1.001 * BOUNDS.noise
    for error in (-7.5, -4.0, 4.0, 7.5):
        assert (loop.with_delay(error) or np.inf) <= 2.001 * BOUNDS.peak_sensitivity
    least = find_limit(roll(), BOUNDS._replace(step_error=1.001 * low.loop.step_error)).load_error
    assert least < low.loop.load_error < 1.3 * least


def test_a_delay_that_the_controller_adds_counts_once() -> None:
    late = replace(roll(), added_delay=2)
    low = reduce_order(late, predictor_model(late, "exact"), BOUNDS, LAG_S, rounds=0)
    same = roll().with_delay(roll().actuator_delay + 2.0)
    block = Behind(same, low.target)
    loop = law_loop.LawLoop(same, block, block.attitude)
    assert loop.load_error == pytest.approx(low.loop.load_error, rel=1e-4)
    assert loop.peak_sensitivity == pytest.approx(low.loop.peak_sensitivity, rel=1e-4)


def test_a_search_of_poles_only_lowers_the_load_error() -> None:
    searched = reduce_order(roll(), roll().model("exact"), BOUNDS, LAG_S, rounds=12)
    assert searched.loop.load_error <= 1.0001 * reduced().loop.load_error


def test_weights_that_are_free_leave_the_loop_exact_at_rest() -> None:
    low = reduced().target
    free = free_weights(roll().model("exact"), low)
    assert free.shape == (2 * len(START_POLES), 2 * len(START_POLES) - 3)
    moved = replace(low, weights=tuple((np.array(low.weights) + 0.05 * free[:, 0]).tolist()))
    block = Behind(roll(), moved)
    loop = law_loop.LawLoop(roll(), block, block.attitude, 12.0)
    assert abs(loop.load_left) < 1e-5 * loop.load_error


def test_poles_that_keep_no_bounds_are_refused() -> None:
    with pytest.raises(InputError, match=r"no linear controller was found with a peak sensitivity of at most 1\.2"):
        reduce_order(roll(), roll().model("exact"), Bounds(1.2, 1e-4, 0.4), LAG_S, rounds=0)
