"""When an engine's thrust stands still: to its range, and by patience for what its own mapping file says."""

from __future__ import annotations

from math import exp

import pytest

from cosim.engine.response import MAX_SETTLING_S, RestlessError, measure_step_response, settle

STEP = 0.004
SPAN = 20.0  # N


class Slow:
    """Thrust that follows its throttle at once but for a share that comes back in ``tau`` seconds."""

    def __init__(self, share: float, tau: float, span: float = SPAN) -> None:
        self.share, self.fall, self.span, self.slow = share, exp(-STEP / tau), span, 0.0

    def hold(self, throttle: float, steps: int) -> list[float]:
        course = []
        for _ in range(steps):
            self.slow = throttle + (self.slow - throttle) * self.fall
            course.append(self.span * (throttle + self.share * (throttle - self.slow)))
        return course


def test_what_is_left_of_a_slow_overshoot_is_small_beside_the_thrust_of_its_range() -> None:
    """6 % that decays in 10 s: after three minutes 2e-8 of the range and less is left, and it was 20 N before."""
    engine = Slow(0.06, 10.0)
    response = measure_step_response(engine.hold, 0.0, 1.0, STEP)
    assert response.after == pytest.approx(SPAN, abs=1e-6)
    closed = measure_step_response(engine.hold, response.after, 0.0, STEP)
    assert abs(closed.after) < 1e-6
    again = Slow(0.06, 10.0)
    again.slow = 1.0
    assert abs(settle(again.hold, 0.0, 60, STEP, span=SPAN)) < 1e-6


def test_what_moves_by_more_than_that_does_not_settle() -> None:
    slower = Slow(0.06, 20.0)
    slower.slow = 1.0
    with pytest.raises(RestlessError, match=f"within {MAX_SETTLING_S:g} s at throttle 0"):
        settle(slower.hold, 0.0, 60, STEP, span=SPAN)
    alone = Slow(0.06, 10.0)
    alone.slow = 1.0
    with pytest.raises(RestlessError):  # the same engine where nobody says what its range is
        settle(alone.hold, 0.0, 60, STEP)


def test_a_small_engine_is_measured_by_its_own_range() -> None:
    """A hundredth of the thrust: what was still beside 1 N is so beside 0.2 N."""
    engine = Slow(0.06, 5.0, 0.01 * SPAN)
    response = measure_step_response(engine.hold, 0.0, 1.0, STEP)
    assert response.after == pytest.approx(0.2, abs=1e-8)
