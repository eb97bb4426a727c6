"""The engine that a bench log fills in, against its closed form (engines/fitted/README.md)."""

from itertools import pairwise
from math import exp

import pytest

from cosim.base.errors import InputError
from cosim.engine import EngineBank, load_engine

STEP = 0.004
GAIN, OFFSET, EXPONENT, LAG, DELAY = 180.0, 9.0, 1.7, 0.4, 12


def course(throttle: float, steps: int, **parameters: float) -> list[float]:
    """Thrust after each step of a throttle that goes from 0.25 to this one."""
    stated = {"gain": GAIN, "offset": OFFSET, "exponent": EXPONENT, "lag": LAG, "delay_samples": DELAY} | parameters
    with EngineBank(load_engine("fitted", stated, STEP), 1, STEP) as bank:
        thrusts = [bank.reset(0.25).thrust[0]]
        return thrusts + [bank.step(k, (throttle,)).thrust[0] for k in range(steps)]


def static(throttle: float) -> float:
    return float(OFFSET + GAIN * throttle**EXPONENT)


@pytest.mark.parametrize("lag_2", [0.0, 0.1, 0.4, 0.9])
def test_it_answers_as_its_page_says(lag_2: float) -> None:
    answered = course(0.8, 300, lag_2=lag_2)
    low, high = static(0.25), static(0.8)
    for k, thrust in enumerate(answered):
        t = max(k - DELAY, 0) * STEP
        left = (
            exp(-t / LAG) * (1.0 + t / LAG)
            if lag_2 == LAG
            else (LAG * exp(-t / LAG) - (lag_2 * exp(-t / lag_2) if lag_2 else 0.0)) / (LAG - lag_2)
        )
        assert thrust == pytest.approx(high - (high - low) * left, abs=1e-9)


@pytest.mark.parametrize("exponent", [1.0, EXPONENT])
def test_a_static_curve_that_crosses_zero_ends_there(exponent: float) -> None:
    """Half of all lines that are fitted to an engine without idle thrust cross 0 above throttle 0."""
    thrusts = course(0.0, 200, offset=-9.0, exponent=exponent)
    high = -9.0 + GAIN * 0.25**exponent
    assert thrusts[0] == pytest.approx(high, abs=1e-9)
    assert thrusts[-1] == pytest.approx(high * exp(-(200 - DELAY) * STEP / LAG), abs=1e-9)
    closed = load_engine("fitted", {"gain": 20.0, "offset": -0.06}, STEP).curve.thrust[0]
    assert closed == pytest.approx(0.0, abs=1e-9)  # within what counts as settled


def test_it_rises_and_falls_no_quicker_than_stated() -> None:
    up, down = course(0.8, 150, rise=0.3), course(0.0, 150, fall=0.2)
    steps = [later - before for before, later in pairwise(up)]
    assert max(steps) == pytest.approx(0.3 * GAIN * STEP, rel=1e-9)
    assert min(b - a for a, b in pairwise(down)) == pytest.approx(-0.2 * GAIN * STEP, rel=1e-9)


def test_a_lag_below_zero_is_refused() -> None:
    with pytest.raises(InputError, match="lag"):
        load_engine("fitted", {"lag": -0.1}, STEP)
