"""Bounds of delay and lags: by a lag shorter than the rows tell, and by how far apart stretches are answered."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.bench.fit import CHI2_95, MOST_TRIES, Estimate, Part, Problem, slopes, solve
from hexjet_identify.engine_file import DEVIATIONS_95

SHORT_LAG = 1.0  # rows, below which a lag's bounds are those of its likelihood: there the problem is not linear
LONGEST_SHORT = 8.0  # rows, to which such a lag may reach
NEAR = 0.1  # of the end of the bound, to which it is found
MAX_P = 1e-3  # with which noise alone spreads the delays of stretches that differ
MIN_STRETCHES = 3
MAX_STRETCHES = 12  # of a log; each has as much of what the log tells of the delay
MIN_LENGTH = 2.0  # of a stretch, in delays and lags together


class Answered(NamedTuple):
    """What a model leaves over of logs, and by how much that changes with the delay; rows as ``Problem.output``."""

    residual: Array  # output's unit
    slope: Array  # of the model over the delay, output's unit a second
    memory: float  # of the noise, from one row to the next
    total: float  # s, delay and lags together


class Spread(NamedTuple):
    """By how much stretches are answered earlier and later than their log."""

    deviation: float = 0.0  # s, of the delay: all of the spread where it is more than noise, else that of its mean
    apart: float = 0.0  # s, from the earliest to the latest where they differ by more than noise, else 0

    @property
    def notes(self) -> list[str]:
        """What is to be said of it."""
        if self.apart == 0.0:
            return []
        return [
            f"stretches of the log are answered {1e3 * self.apart:.3g} ms apart, by more than noise: a clock that "
            "wobbles, lost rows, an ECU that reads at intervals, or what the model lacks; the bounds of delay and lag "
            "hold it"
        ]


def answer_lags(problem: Problem, estimate: Estimate) -> Answered:
    """Return how a form as fitted answers logs."""
    slope = slopes(problem, estimate)[:, 0]
    return Answered(problem.residual(estimate), slope, estimate.memory, estimate.total[0])


def measure_spread(problem: Problem, answered: Answered) -> Spread:
    """Return how far apart the stretches of logs are answered, beside a model as fitted.

    A stretch's own delay is that of least squares with all else held; none is told of a log with few movements.
    """
    from scipy.special import fdtrc

    slope, white = (problem.whiten(rows, answered.memory) for rows in (answered.slope, answered.residual))
    delays, weights, begin = [], [], 0
    for part in problem.parts:
        rows = slice(begin, begin + len(part.times))
        begin = rows.stop
        told = np.concatenate([[0.0], np.cumsum(slope[rows] ** 2)])
        cuts = _cut(part, told, MIN_LENGTH * answered.total)
        if len(cuts) > MIN_STRETCHES:
            power = np.maximum(np.diff(told[cuts]), 1e-300)
            own = np.add.reduceat(slope[rows] * white[rows], cuts[:-1]) / power
            delays.append(own - np.average(own, weights=power))
            weights.append(power)
    if not delays:
        return Spread()
    late, power, free = np.concatenate(delays), np.concatenate(weights), len(white) - sum(map(len, delays))
    explained, count = float(power @ late**2), len(late) - len(delays)
    variance = max(float(white @ white) - explained, 1e-300) / max(free, 1)
    beyond = float(np.sqrt(max(float(np.mean(late**2) - np.mean(variance / power)), 0.0)))
    if fdtrc(count, max(free, 1), explained / count / variance) >= MAX_P:
        return Spread(beyond / float(np.sqrt(len(late))))
    return Spread(beyond, float(np.ptp(late)))


def _cut(part: Part, told: Array, shortest: float) -> NDArray[np.intp]:
    """Return the first row of each stretch of a log, s apart by ``shortest`` at least, and the row behind the last.

    A command that is held is cut where it moves, another anywhere; ``told``: what the rows before each tell.
    """
    moved = part.command_times[1:][np.diff(part.command) != 0.0]
    at = np.arange(part.times[0], part.times[-1], shortest) if part.straight else moved
    enough, cuts = float(told[-1]) / MAX_STRETCHES, [0]
    for row in np.unique(np.searchsorted(part.times, at)).tolist():
        if row == len(part.times):
            break
        if part.times[row] - part.times[cuts[-1]] >= shortest and told[row] - told[cuts[-1]] >= enough:
            cuts.append(row)
    if len(cuts) > 1 and told[-1] - told[cuts[-1]] < enough:
        cuts.pop()
    return np.array([*cuts, len(part.times)])


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
