"""Bounds of delay and lags: of a lag that is shorter than the rows tell, and by what the clocks of a log leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cosim.identify.bench.fit import CHI2_95, MOST_TRIES, Estimate, Problem, solve
from cosim.identify.engine_file import DEVIATIONS_95

SHORT_LAG = 1.0  # rows, below which a lag's bounds are those of its likelihood: there the problem is not linear
LONGEST_SHORT = 8.0  # rows, to which such a lag may reach
NEAR = 0.1  # of the end of the bound, to which it is found


def widen(problem: Problem, estimate: Estimate, spread: float, clock: float) -> Estimate:
    """Return an estimate whose delay and lag each may be off by ``spread`` [s], a standard deviation.

    ``clock``: by how much more the delay may be, s; infinite where nothing tells it.
    """
    low, high = float(problem.limits(estimate.form)[0][0]), problem.longest_delay
    deviation = min(float(np.hypot(spread, clock)), high - low)
    covariance = estimate.covariance.copy()
    covariance[0, 0] += deviation**2
    covariance[1, 1] += spread**2
    below, above = (float(np.hypot(estimate.delay - end, DEVIATIONS_95 * deviation)) for end in estimate.delay_bounds)
    bounds = max(estimate.delay - below, low), min(estimate.delay + above, high)
    return replace(estimate, covariance=covariance, delay_bounds=(low, high) if np.isinf(clock) else bounds)


def bound_short_lag(problem: Problem, estimate: Estimate) -> Estimate:
    """Return an estimate whose lag, where it is shorter than a row, reaches as far up as its likelihood allows.

    Linearised, such a lag has no bounds at all, or none that are wider than nothing: it changes no row.
    """
    row, lag = min(part.step for part in problem.parts), float(estimate.x[1])
    if lag >= SHORT_LAG * row:
        return estimate

    def risen(value: float) -> float:
        start = estimate.x.copy()
        start[0], start[1] = max(start[0] + lag - value, 0.0), value
        loss = solve(problem, estimate.form, start, estimate.memory, 1)[1]
        return estimate.rows * float(np.log(loss / estimate.loss))

    inside, outside = lag, LONGEST_SHORT * row
    for _ in range(MOST_TRIES):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if risen(middle) < CHI2_95 else (inside, middle)
        if outside - inside < NEAR * outside:
            break
    covariance = estimate.covariance.copy()
    covariance[1, :] = covariance[:, 1] = 0.0
    covariance[1, 1] = ((outside - lag) / DEVIATIONS_95) ** 2
    low, high = estimate.delay_bounds
    if np.isfinite(low):  # the delay is what the lag is not
        covariance[0, 0] = ((high - low) / (2.0 * DEVIATIONS_95)) ** 2
    return replace(estimate, covariance=covariance)
