"""Logs that are fitted together: the static line's levels, and noise that remembers itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array, Flags
from hexjet_identify.fit.answers import interpolation_weights
from hexjet_identify.fit.logs import Log

# Upper limit of the correlation of noise from row to row.
MAX_MEMORY = 0.999
# Orders of the noise model that are tried for logs of a closed loop.
ORDERS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 52, 64, 80, 100, 128, 160)


@dataclass
class Problem:
    """Logs of one engine that are fitted together, with ``knots`` of the static line in shares of the command.

    ``drift``: columns at the rows of all logs, which take up a gain that drifts.
    """

    logs: Sequence[Log]
    knots: Array
    max_delay: float
    drift: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        self.logs = [log.without_repeats() for log in self.logs]
        self.drift = self.drift if self.drift.size else np.zeros((len(self.output), 0))

    @cached_property
    def spans(self) -> list[slice]:
        """Slice of each log's rows in the rows of all logs."""
        ends = np.cumsum([0, *(len(log.times) for log in self.logs)])
        return [slice(int(begin), int(end)) for begin, end in pairwise(ends)]

    @property
    def parts(self) -> list[tuple[Log, slice]]:
        """Each log with the slice of its rows in the rows of all logs."""
        return list(zip(self.logs, self.spans, strict=True))

    @cached_property
    def output(self) -> Array:
        """All logs' output, one behind the other."""
        return np.concatenate([log.output for log in self.logs])

    @cached_property
    def swing(self) -> float:
        """Range of the output."""
        return max(float(np.ptp(self.output)), 1e-300)

    @cached_property
    def step(self) -> float:
        """Shortest time between two rows, s."""
        return min(log.step for log in self.logs)

    @cached_property
    def level_weights(self) -> list[Array]:
        """Weights of the static levels in each log's commands."""
        return [interpolation_weights(log.command, self.knots) for log in self.logs]

    @cached_property
    def binding(self) -> Array:
        """Weak regularisation of each level towards its neighbours, for levels that no row determines."""
        rows = np.zeros((max(len(self.knots) - 2, 0), len(self.knots)))
        for row, (low, mid, high) in enumerate(zip(self.knots, self.knots[1:], self.knots[2:], strict=False)):
            rows[row, row : row + 3] = (high - mid) / (high - low), -1.0, (mid - low) / (high - low)
        return np.asarray(rows * 1e-6 * np.sqrt(len(self.output)))

    def at(self, rows: Flags) -> Problem:
        """Return the problem with these rows alone, and the logs that have any of them."""
        logs = [log.at(rows[span]) for log, span in self.parts if rows[span].any()]
        return Problem(logs, self.knots, self.max_delay, self.drift[rows])

    def whiten(self, values: Array, noise: Array) -> Array:
        """Return whitened rows: each less what ``noise``, the nearest first, predicts of it from the rows before.

        Of one row it may be farther before, of which less is kept, and all rows come out; of more those alone that have
        all their predecessors.
        """
        if len(noise) == 0:
            return values
        if len(noise) > 1:
            from scipy.signal import lfilter

            white = lfilter(np.concatenate([[1.0], -noise]), [1.0], self.on_grid(values), axis=0)
            return np.asarray(white[self.grid[self.equations(len(noise))]])
        white = np.array(values, dtype=float)
        shape, memory = (-1,) + (1,) * (white.ndim - 1), float(noise[0])
        for log, span in self.parts:
            kept, scale = _noise_decay(log, memory)
            own = values[span]
            new = (own[1:] - kept.reshape(shape) * own[:-1]) / scale.reshape(shape)
            white[span] = np.concatenate([own[:1] * np.sqrt(1.0 - memory**2), new])
        return white

    def whitening_deviance(self, noise: Array) -> float:
        """Return the log-determinant of the whitening, its part of the deviance."""
        if len(noise) != 1:
            return 0.0
        memory = float(noise[0])
        own = (2.0 * float(np.log(_noise_decay(log, memory)[1]).sum()) for log in self.logs)
        return sum(own) - len(self.logs) * float(np.log(1.0 - memory**2))

    @cached_property
    def grid(self) -> NDArray[np.int64]:
        """Place of each row on an even clock, on which logs are farther apart than any order."""
        places, begin = [], 0
        for log in self.logs:
            index = np.arange(len(log.times)) if log.index is None else log.index
            places.append(begin + index - index[0])
            begin = int(places[-1][-1]) + max(ORDERS) + 2
        return np.concatenate(places)

    def on_grid(self, values: Array, rows: Flags | None = None) -> Array:
        """Return values of all ``rows``, or of these, on the even clock, 0 where there is no row."""
        spread_out = np.zeros((int(self.grid[-1]) + 1, *values.shape[1:]))
        spread_out[self.grid if rows is None else self.grid[rows]] = values
        return spread_out

    @cached_property
    def _counts(self) -> Array:
        """Number of rows before each place of the even clock."""
        return np.concatenate([[0.0], np.cumsum(self.on_grid(np.ones(len(self.grid))))])

    def equations(self, order: int) -> Flags:
        """Return which rows have ``order`` rows before them without a gap."""
        return np.asarray(self._counts[self.grid + 1] - self._counts[np.maximum(self.grid - order, 0)] > order)

    def earlier(self, values: Array, order: int) -> Array:
        """Return the ``order`` values before each row of :meth:`equations`, a column for each, the nearest first."""
        rows = self.grid[self.equations(order)]
        return np.asarray(self.on_grid(values)[rows[:, None] - np.arange(1, order + 1)])

    def fit_noise(self, residual: Array, order: int) -> Array:
        """Return the coefficients of noise of this order, fitted to a residual."""
        terms = noise_basis(order)
        late = self.earlier(residual, order) @ terms
        return np.asarray(terms @ np.linalg.lstsq(late, residual[self.equations(order)])[0])

    def best_order(self, residual: Array, seconds: float, valid: float = 0.4) -> int:
        """Return the noise order of a residual by Akaike's criterion on equal equations, at least ``seconds`` long.

        As long as delay and lags it has to be in a loop: the command of that long before carries the noise of that time
        and earlier, and what a shorter one leaves of it would be taken for an answer to the command.  A share of
        ``valid`` of the rows has to have all predecessors.
        """
        rows = len(residual)
        allowed = [n for n in ORDERS if self.equations(n).sum() >= valid * rows and n < rows // 10] or list(ORDERS[:1])
        orders = [n for n in allowed if n * self.step >= seconds] or allowed[-1:]
        late, own = self.earlier(residual, orders[-1]), residual[self.equations(orders[-1])]
        gram, right, power, best = late.T @ late, late.T @ own, float(own @ own), (np.inf, orders[0])
        for order in orders:
            terms = noise_basis(order)
            projected = terms.T @ right[:order]
            part = np.linalg.lstsq(terms.T @ gram[:order, :order] @ terms, projected)[0]
            loss = max(power - float(projected @ part), 1e-12 * power)
            best = min(best, (len(own) * float(np.log(loss)) + 2.0 * terms.shape[1], order))
        return best[1]

    def memory_of(self, residual: Array) -> float:
        """Return the correlation of a residual with the row before it, between 0 and MAX_MEMORY."""
        above = below = 0.0
        for log, span in self.parts:
            own, near = residual[span], np.diff(log.times) < 1.5 * log.step
            above += float((own[1:] * own[:-1])[near].sum())
            below += float((0.5 * (own[1:] ** 2 + own[:-1] ** 2))[near].sum())
        return float(np.clip(above / below, 0.0, MAX_MEMORY)) if below > 0.0 else 0.0


def _noise_decay(log: Log, memory: float) -> tuple[Array, Array]:
    """Return the share of noise that each row keeps of the one before, and the relative size of its new noise."""
    kept = memory ** (np.diff(log.times) / log.step)
    return kept, np.sqrt((1.0 - kept**2) / (1.0 - memory**2))


@cache
def noise_basis(order: int, separate: int = 20) -> Array:
    """Return the matrix (order, terms) from fitted terms to a noise model; below order 2 none is fitted.

    So many ``separate`` terms stand alone.  Those beyond are linear between the orders, because noise that goes through
    an airframe fades slowly and smoothly.
    """
    if order < 2:
        return np.zeros((order, 0))
    knots = [*range(1, min(order, separate) + 1), *(n for n in ORDERS if separate < n < order), order]
    at = np.unique(knots)
    return np.asarray([np.interp(np.arange(1, order + 1), at, row) for row in np.eye(len(at))]).T
