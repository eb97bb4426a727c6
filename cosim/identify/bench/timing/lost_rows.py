"""When a held command moved behind rows that are lost: the log does not say, the output does; for any model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.bench.fit import Estimate, Problem, fit, slopes
from cosim.identify.robust import invert

ROUNDS = 3  # of fit and times in turn
ENDS = 3.0**0.5  # deviations, to the ends of where it may be anywhere
Fitted = TypeVar("Fitted")


class Model(NamedTuple, Generic[Fitted]):
    """What a fit leaves over of logs, its noise's memory, what it fits, and the fit of logs that are moved."""

    left: Callable[[Problem, Fitted], Array]  # output's unit
    memory: Callable[[Fitted], float]
    columns: Callable[[Problem, Fitted], Array]  # by how much what is left over, made white, goes with each parameter
    refit: Callable[[Problem, Fitted], Fitted]


def settle_moves(problem: Problem, fitted: Fitted, model: Model[Fitted]) -> tuple[Problem, Fitted, float]:
    """Return logs whose held commands move, behind lost rows, when the model says, within the gap; and its fit.

    And by how much less sure that makes the delay, a standard deviation in s.
    """
    loose = [(n, i) for n, part in enumerate(problem.parts) for i in np.flatnonzero(part.loose).tolist()]
    far = np.array([problem.parts[n].loose[i] for n, i in loose])
    late, settled, unsure = np.zeros(len(far)), problem, 0.0
    for _ in range(ROUNDS if loose else 0):
        now, memory = model.left(settled, fitted), model.memory(fitted)
        own = np.empty((len(now), len(far)))
        for k in range(len(far)):
            early, behind = late.copy(), late.copy()
            early[k], behind[k] = -far[k], far[k]
            ends = (model.left(_moved(problem, loose, one), fitted) for one in (early, behind))
            own[:, k] = (next(ends) - next(ends)) / (2.0 * far[k])
        white = np.column_stack([problem.whiten(own, memory), model.columns(settled, fitted)])
        late, unsure = _when(white, problem.whiten(now, memory), late, far)
        settled = _moved(problem, loose, late)
        fitted = model.refit(settled, fitted)
    return settled, fitted, unsure


def _moved(problem: Problem, loose: list[tuple[int, int]], late: Array) -> Problem:
    times = [part.command_times.copy() for part in problem.parts]
    for (n, i), each in zip(loose, late.tolist(), strict=True):
        times[n][i] += each
    parts = [replace(part, command_times=own) for part, own in zip(problem.parts, times, strict=True)]
    return Problem(parts, problem.longest_delay, problem.drift)


def _when(white: Array, left: Array, late: Array, far: Array) -> tuple[Array, float]:
    """Return how late each movement is, s, by least squares beside all that is fitted, and what the delay owes to that.

    Each may be ``far`` off; the delay's column is the first behind theirs.
    """
    noise, count = float(np.sqrt(left @ left / len(left))), len(far)
    known = np.zeros((count, white.shape[1]))
    known[np.arange(count), np.arange(count)] = noise * ENDS / far
    matrix = np.vstack([white, known])
    covariance = invert(matrix.T @ matrix)
    found = covariance @ (matrix.T @ np.concatenate([left, -noise * ENDS * late / far]))
    alone = invert(white[:, count:].T @ white[:, count:])[0, 0]
    unsure = noise * float(np.sqrt(max(covariance[count, count] - alone, 0.0)))
    return np.asarray(np.clip(late + found[:count], -far, far)), unsure


LAGS: Model[Estimate] = Model(
    Problem.residual,
    lambda one: one.memory,
    lambda problem, one: problem.whiten(slopes(problem, one), one.memory),
    lambda problem, one: fit(problem, one.form, one),
)
