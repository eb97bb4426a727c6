"""Exact answers of lags, and of a lag with limits of rise and fall, to the command of a log."""

from __future__ import annotations

from collections.abc import Callable
from math import exp

import numpy as np
from scipy.linalg import solve_banded

from cosim.base.arrays import Array
from hexjet_identify.fit.logs import Log


def hats(command: Array, knots: Array) -> Array:
    """Return the shares of the levels at ``knots`` in the static output of each command, a column a level."""
    inside = np.clip(command, knots[0], knots[-1])
    below = np.clip(np.searchsorted(knots, inside, "right") - 1, 0, len(knots) - 2)
    share = (inside - knots[below]) / (knots[below + 1] - knots[below])
    shares = np.zeros((len(command), len(knots)))
    rows = np.arange(len(command))
    shares[rows, below] = 1.0 - share
    shares[rows, below + 1] = share
    return shares


def answer_of_a_lag(log: Log, inputs: Array, delay: float, lag: float) -> Array:
    """Return the answers of a lag to columns of ``inputs`` at the command's rows, at the output's rows.

    lag x' = u(t - delay) - x, exactly; before the first row x rests at its input.
    """
    times = log.command_times
    gap = np.diff(times)
    kept = np.exp(-gap / lag)[:, None]
    slope = np.diff(inputs, axis=0) / gap[:, None] if log.is_straight else np.zeros((len(gap), inputs.shape[1]))
    ahead = inputs[:-1] - lag * slope
    end = inputs[1:] - lag * slope if log.is_straight else inputs[:-1]
    bands = np.ones((2, len(times)))
    bands[1, :-1] = -kept[:, 0]
    state = solve_banded((1, 0), bands, np.vstack([inputs[:1], end - kept * ahead]), check_finite=False)
    slope = np.vstack([slope, np.zeros((1, inputs.shape[1]))])

    def answer(when: Array) -> Array:
        row = np.clip(np.searchsorted(times, when - delay, "right") - 1, 0, len(times) - 1)
        since = np.maximum(when - delay - times[row], 0.0)[:, None]
        target = inputs[row] + slope[row] * (since - lag)
        return np.asarray(target + (state[row] - inputs[row] + lag * slope[row]) * np.exp(-since / lag))

    return average_over_rows(log, answer)


def answer_of_limits(log: Log, target: Array, delay: float, lag: float, rise: float, fall: float) -> Array:
    """Return the answer of a lag with limits to the static output ``target`` at the command's rows.

    x' = (target(t - delay) - x) / lag within -fall and rise, exactly for a held command; one that goes straight is
    taken for held from half a row before on.
    """
    times = log.command_times
    if log.is_straight:
        times = 0.5 * (np.concatenate([times[:1], times[:-1]]) + times)
    states = [float(target[0])]
    for goal, seconds in zip(target.tolist(), np.diff(times).tolist(), strict=False):
        states.append(_approach(states[-1], goal, seconds, lag, rise, fall))
    state = np.array(states)

    def answer(when: Array) -> Array:
        row = np.clip(np.searchsorted(times, when - delay, "right") - 1, 0, len(times) - 1)
        since = np.maximum(when - delay - times[row], 0.0)
        error = target[row] - state[row]
        limit = np.where(error > 0.0, rise, fall)
        until = np.maximum(np.abs(error) / limit - lag, 0.0)
        line = state[row] + np.sign(error) * limit * since
        left = np.minimum(np.abs(error), limit * lag) * np.exp(-np.maximum(since - until, 0.0) / lag)
        return np.asarray(np.where(since < until, line, target[row] - np.sign(error) * left))

    return average_over_rows(log, answer)


def _approach(state: float, goal: float, seconds: float, lag: float, rise: float, fall: float) -> float:
    """Return where a lag with limits is after ``seconds`` towards a goal that stands still."""
    error = goal - state
    limit = rise if error > 0.0 else -fall
    until = error / limit - lag
    if until >= seconds:
        return state + limit * seconds
    if until > 0.0:
        error, seconds = limit * lag, seconds - until
    return goal - error * exp(-seconds / lag)


def average_over_rows(log: Log, answer: Callable[[Array], Array]) -> Array:
    """Return the mean of ``answer`` over the width of each row of a log, by four of its parts."""
    if log.width <= 0.0:
        return answer(log.times)
    shifts = log.width * np.array([-0.375, -0.125, 0.125, 0.375])
    return np.asarray(sum(answer(log.times + shift) for shift in shifts) / len(shifts))
