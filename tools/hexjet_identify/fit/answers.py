"""Exact answers of lags, and of a lag with limits of rise and fall, to the command of a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import exp

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.fit.logs import Log

Rows = NDArray[np.int64]


def interpolation_weights(command: Array, knots: Array) -> Array:
    """Return weights that interpolate linearly between levels at ``knots``, a row a command, a column a level."""
    inside = np.clip(command, knots[0], knots[-1])
    below = np.clip(np.searchsorted(knots, inside, "right") - 1, 0, len(knots) - 2)
    share = (inside - knots[below]) / (knots[below + 1] - knots[below])
    shares = np.zeros((len(command), len(knots)))
    rows = np.arange(len(command))
    shares[rows, below] = 1.0 - share
    shares[rows, below + 1] = share
    return shares


def answer_of_lags(log: Log, inputs: Array, delay: float, lags: Mapping[float, float]) -> Array:
    """Return the delayed response of a weighted sum of lags to each column of ``inputs``, at the output's rows.

    ``lags``: weight by lag [s]; each is lag x' = u(t - delay) - x, exactly, at rest before the first row.
    """
    times = log.command_times
    gap = np.diff(times)[:, None]
    slope = np.diff(inputs, axis=0, append=inputs[-1:])
    slope = slope / np.append(gap, 1.0)[:, None] if log.is_straight else np.zeros((len(inputs), 1))
    ahead, behind = np.zeros_like(inputs), []
    for lag, weight in lags.items():
        own = inputs - lag * slope
        kept = np.exp(-gap / lag)
        state = _recur(kept[:, 0], np.vstack([inputs[:1], own[:-1] * (1.0 - kept) + gap * slope[:-1]]))
        ahead += weight * own
        behind.append((lag, weight * (state - own)))
    slope = sum(lags.values()) * slope

    def respond_at(when: Array) -> Array:
        row = np.clip(np.searchsorted(times, when - delay, "right") - 1, 0, len(times) - 1)
        since = np.maximum(when - delay - times[row], 0.0)[:, None]
        value = ahead[row]
        if log.is_straight:
            value += slope[row] * since
        for lag, each in behind:
            value += each[row] * np.exp(-since / lag)
        return value

    return average_over_rows(log, respond_at)


def answer_of_poles(log: Log, delay: float, poles: Mapping[float, float]) -> Array:
    """Return the delayed response of the sum of weight / (s + pole) to the held command, at the output's rows."""
    times, gap = log.command_times, np.diff(log.command_times)
    states = [
        _recur(np.exp(-pole * gap), np.concatenate([[0.0], hold_response(pole, gap) * log.command[:-1]])[:, None])[:, 0]
        for pole in poles
    ]

    def respond_at(when: Array) -> Array:
        row = np.clip(np.searchsorted(times, when - delay, "right") - 1, 0, len(times) - 1)
        since, value = np.maximum(when - delay - times[row], 0.0), np.zeros(len(when))
        for (pole, weight), state in zip(poles.items(), states, strict=True):
            value += weight * (state[row] * np.exp(-pole * since) + hold_response(pole, since) * log.command[row])
        return value

    return average_over_rows(log, respond_at)


def hold_response(pole: float, seconds: Array) -> Array:
    """Return the response of ``1 / (s + pole)`` to a unit step after these ``seconds``."""
    return np.asarray(-np.expm1(-pole * seconds) / pole if pole > 1e-6 else seconds)


def _recur(kept: Array, added: Array) -> Array:
    """Return x with x[k] = kept[k - 1] x[k - 1] + added[k]."""
    from scipy.linalg.lapack import dtbtrs

    bands = np.ones((2, len(added)))
    bands[1, :-1] = -kept
    return np.asarray(dtbtrs(bands, added, uplo="L", diag="U")[0])


def answer_of_limits(
    log: Log, shares: Array, levels: Array, delay: float, lag: float, rise: float, fall: float
) -> Array:
    """Return the response of a lag with limits, and its derivatives by delay, lag, rise, fall and each level.

    x' = (target(t - delay) - x) / lag within -fall and rise, exactly for a held command, whose static output is
    ``shares @ levels``; one that goes straight is taken for held from half a row before on.
    """
    times, target = log.command_times, shares @ levels
    if log.is_straight:
        times = 0.5 * (np.concatenate([times[:1], times[:-1]]) + times)
    gap, states = np.diff(times), [float(target[0])]
    for goal, seconds in zip(target.tolist(), gap.tolist(), strict=False):
        states.append(_advance_limited_lag(states[-1], goal, seconds, lag, rise, fall))
    state = np.array(states)

    def advance(row: Rows, since: Array) -> tuple[Array, Array, Array, Array]:
        """Return output and rate ``since`` s after a row, and derivatives by the state there and by parameters."""
        error = target[row] - state[row]
        limit = np.where(error > 0.0, rise, -fall)
        until = np.clip(error / limit - lag, 0.0, since)
        kept = np.exp((until - since) / lag)
        left = np.sign(error) * np.minimum(np.abs(error), np.abs(limit) * lag) * kept
        is_straight = (until >= since) & (error / limit > lag)
        value = np.where(is_straight, state[row] + limit * since, target[row] - left)
        own = np.zeros((len(row), 3 + len(levels)))
        own[:, 0] = -left * (since - until) / lag**2
        own[:, 1], own[:, 2] = kept * until * (limit > 0.0), -kept * until * (limit < 0.0)
        own[:, 3:] = (1.0 - kept)[:, None] * shares[row]
        return value, np.where(is_straight, limit, left / lag), kept, own

    _, _, kept, own = advance(np.arange(len(gap)), gap)
    slopes = _recur(kept, np.vstack([np.concatenate([np.zeros(3), shares[0]]), own]))

    def respond_at(when: Array) -> Array:
        row = np.clip(np.searchsorted(times, when - delay, "right") - 1, 0, len(times) - 1)
        value, rate, kept, own = advance(row, np.maximum(when - delay - times[row], 0.0))
        return np.column_stack([value, -rate, kept[:, None] * slopes[row] + own])

    return average_over_rows(log, respond_at)


def _advance_limited_lag(state: float, goal: float, seconds: float, lag: float, rise: float, fall: float) -> float:
    """Return the state of a lag with limits after ``seconds`` towards a constant goal."""
    error = goal - state
    limit = rise if error > 0.0 else -fall
    until = error / limit - lag
    if until >= seconds:
        return state + limit * seconds
    if until > 0.0:
        error, seconds = limit * lag, seconds - until
    return goal - error * exp(-seconds / lag)


def average_over_rows(log: Log, respond_at: Callable[[Array], Array]) -> Array:
    """Return the response averaged over the width of each row of a log, by four samples."""
    if log.width <= 0.0:
        return respond_at(log.times)
    shifts = log.width * np.array([-0.375, -0.125, 0.125, 0.375])
    return np.asarray(sum(respond_at(log.times + shift) for shift in shifts) / len(shifts))
