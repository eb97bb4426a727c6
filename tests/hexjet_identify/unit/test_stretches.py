"""How far apart in time the stretches of a log are answered, and what that does to bounds."""

from __future__ import annotations

import numpy as np
import pytest

from hexjet_identify.bench.fit import Estimate, Form, Part, Problem
from hexjet_identify.bench.stretches import Answered, measure_spread, widen

LATE_S = np.array([-0.03, -0.04, 0.1, 0.0, -0.03])  # of five stretches
STEP_S, STRETCH_S = 0.1, 20.0
NOISE = 0.05


def steps() -> Part:
    """Return a command up and down each 20 s, and a first-order answer of 1 s."""
    times = np.arange(0.0, len(LATE_S) * STRETCH_S, STEP_S)
    stretch = (times // STRETCH_S).astype(int)
    command = (stretch % 2 == 0).astype(float)
    since = times - stretch * STRETCH_S
    output = np.where(command > 0.0, 1.0 - np.exp(-since), np.exp(-since))
    return Part(times, command, times, 100.0 * output, STEP_S, False)


@pytest.mark.parametrize("late", [LATE_S, 0.0 * LATE_S])
def test_the_spread_of_the_stretches_delays_is_measured_beyond_noise(late: np.ndarray) -> None:
    part = steps()
    slope = -np.gradient(part.output, part.times)
    noise = np.random.default_rng(1).normal(0.0, NOISE, len(part.times))
    residual = slope * np.repeat(late, round(STRETCH_S / STEP_S)) + noise
    spread = measure_spread(Problem([part], 2.0), Answered(residual, slope, 0.0, 1.0))
    if late.any():
        assert spread.deviation == pytest.approx(float(np.std(late)), rel=0.05)
        assert spread.apart == pytest.approx(float(np.ptp(late)), rel=0.05)
        (note,) = spread.notes
        assert note.startswith(
            f"stretches of the log are answered {1e3 * spread.apart:.3g} ms apart, by more than noise"
        )
    else:
        assert spread.deviation < 1e-3
        assert spread.notes == []


def test_a_log_of_two_movements_tells_no_spread() -> None:
    part = steps()
    few = part.chosen(part.times < 2.0 * STRETCH_S)
    slope = np.ones(len(few.times))
    assert measure_spread(Problem([few], 2.0), Answered(slope, slope, 0.0, 1.0)).deviation == 0.0


@pytest.mark.parametrize(
    ("spread", "clock", "bounds", "lag"),
    [
        (0.0, 0.0, (0.2, 0.4), 0.02),
        (0.1, 0.0, (0.3 - float(np.hypot(0.1, 0.196)), 0.3 + float(np.hypot(0.1, 0.196))), float(np.hypot(0.02, 0.1))),
        (0.0, 0.1, (0.3 - float(np.hypot(0.1, 0.196)), 0.3 + float(np.hypot(0.1, 0.196))), 0.02),
        (0.0, np.inf, (0.0, 2.0), 0.02),
    ],
)
def test_a_spread_widens_the_bounds_of_delay_and_lag_and_nothing_else(
    spread: float, clock: float, bounds: tuple[float, float], lag: float
) -> None:
    covariance = np.diag([0.05, 0.02, 0.1, 1.0, 2.0]) ** 2
    given = Estimate(
        Form(2), np.array([0.3, 0.5, 0.2]), 10.0, np.zeros(1), covariance, 0.0, 1.0, 100, 0.0, 5, (0.2, 0.4)
    )
    wide = widen(Problem([steps()], 2.0), given, spread, clock)
    assert wide.delay_bounds == pytest.approx(bounds, abs=1e-4)
    assert wide.deviation(0) == pytest.approx(min(float(np.hypot(0.05, np.hypot(spread, clock))), 2.001), rel=1e-3)
    assert wide.deviation(1) == pytest.approx(lag)
    assert np.array_equal(wide.covariance[2:, 2:], covariance[2:, 2:])
    assert np.array_equal(wide.x, given.x)
