"""The equations of prediction-error identification: stretches of a log, the model's columns, what is left over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import log, prod

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.identify.sweep.fit import separate_equal
from hexjet_identify.prediction_error.estimate import ORDERS, Estimate, Form, spread
from hexjet_identify.prediction_error.stretches import Stretch, hold_response

LEAST_VALID = 0.4  # share of the equations that lost samples may leave, which bounds the order
SHORTEST_LAG = 0.002  # of a sample
LONGEST_LAG_S = 5.0
FASTEST = 20.0  # 1/s: the slow pole of an axis, at most
NEGLIGIBLE = 1e-150  # of a column's size: its square would be none


@dataclass
class Problem:
    """The stretches, put one behind the other with gaps that no equation bridges."""

    stretches: Sequence[Stretch]
    working_step: float
    longest_delay: float
    gap: int = field(default=max(ORDERS) + 1)

    def __post_init__(self) -> None:
        outputs, marks = [], []
        for stretch in self.stretches:
            outputs += [np.where(stretch.present, stretch.averaged(stretch.output), 0.0), np.zeros(self.gap)]
            marks += [stretch.present, np.zeros(self.gap, bool)]
        self.output = np.concatenate(outputs)
        self.present = np.concatenate(marks)
        self.samples = int(self.present.sum())

    # ---- the model's parts

    def columns(self, form: Form, x: Array) -> Array:
        """Return what the linear parameters multiply: the answer, and of each stretch an offset and a free decay."""
        rate, lags, delay = float(x[0]), x[1:-1], float(x[-1])
        poles = separate_equal([rate, *(1.0 / lag for lag in lags)])
        scale = (rate if form.engine else 1.0) / prod(lags)
        weights = [scale / prod(other - pole for other in poles if other != pole) for pole in poles]
        matrix = np.zeros((len(self.output), 1 + 2 * len(self.stretches)))
        row = 0
        for n, stretch in enumerate(self.stretches):
            rows = slice(row, row + stretch.blocks)
            answer = np.zeros(len(stretch.times))
            for weight, pole in zip(weights, poles, strict=True):
                answer += weight * stretch.answer(pole, delay)
            matrix[rows, 0] = stretch.averaged(answer)
            matrix[rows, 1 + 2 * n] = stretch.present
            initial = np.exp(-rate * stretch.times) if form.engine else hold_response(rate, stretch.times)
            matrix[rows, 2 + 2 * n] = stretch.averaged(initial)
            row += stretch.blocks + self.gap
        return matrix

    def equations(self, order: int) -> NDArray[np.bool_]:
        """Return the mask of the rows whose ``order`` predecessors are all there."""
        if order not in self._masks:
            missing = np.convolve((~self.present).astype(np.float64), np.ones(order + 1))[: len(self.present)]
            use = missing < 0.5
            use[:order] = False
            self._masks[order] = np.asarray(use)
        return self._masks[order]

    @cached_property
    def _masks(self) -> dict[int, NDArray[np.bool_]]:
        """Return the masks by order, which are asked for at every step of a search."""
        return {}

    @cached_property
    def orders(self) -> list[int]:
        """The orders of A that lost samples and the length of the stretches allow."""
        allowed = [n for n in ORDERS if self.equations(n).sum() >= LEAST_VALID * self.samples]
        return [n for n in allowed or ORDERS[:1] if n < self.samples // 10] or [1]

    def best_order(self, error: Array, min_span: float) -> int:
        """Return the order of A for this v: by Akaike's criterion on equal equations, and at least ``min_span`` [s].

        As long as delay and lags it has to be in a loop: the command of that long before carries the noise of that time
        and earlier, and what a shorter A leaves of it in e would be taken for an answer to the command.
        """
        long_enough = [n for n in self.orders if n * self.working_step >= min_span]
        orders = long_enough or self.orders[-1:]
        use = self.equations(orders[-1])
        late = np.stack([shift(error, i) for i in range(1, orders[-1] + 1)], axis=1)[use]
        gram, right, power = late.T @ late, late.T @ error[use], float(error[use] @ error[use])
        best: tuple[float, int] = (float("inf"), 1)
        for order in orders:
            terms = spread(order)
            projected = terms.T @ right[:order]
            part = np.linalg.lstsq(terms.T @ gram[:order, :order] @ terms, projected, rcond=None)[0]
            loss = max(power - float(projected @ part), 1e-12 * power)
            best = min(best, (int(use.sum()) * log(loss) + 2.0 * terms.shape[1], order))
        return best[1]

    def linear(self, form: Form, x: Array, ar: Array) -> Array:
        """Return the linear parameters that fit best, for given x and A."""
        use = self.equations(len(ar))
        return least_squares(whiten(self.columns(form, x), ar)[use], whiten(self.output, ar)[use])

    def error(self, columns: Array, linear: Array) -> Array:
        """Return v: the output less the model's, 0 where there is no sample."""
        return np.asarray(np.where(self.present, self.output - columns @ linear, 0.0))

    def residuals(self, estimate: Estimate) -> tuple[Array, NDArray[np.bool_]]:
        """Return e, and the mask of where it is one."""
        error = self.error(self.columns(estimate.form, estimate.x), estimate.linear)
        return whiten(error, estimate.ar), self.equations(estimate.order)

    def without_command(self, estimate: Estimate) -> float:
        """Return the deviance of a model of noise alone, A of the same order on the same equations."""
        columns = self.columns(estimate.form, estimate.x)[:, 1:]
        ar, use = estimate.ar, self.equations(estimate.order)
        for _ in range(4):
            linear = least_squares(whiten(columns, ar)[use], whiten(self.output, ar)[use])
            error = self.error(columns, linear)
            ar = self.noise(error, estimate.order)
        loss = float(np.sum(whiten(error, ar)[use] ** 2))
        return int(use.sum()) * log(loss / int(use.sum()))

    def simulated(self, estimate: Estimate) -> Array:
        """Return the output of the model."""
        return np.asarray(self.columns(estimate.form, estimate.x) @ estimate.linear)

    def noise(self, error: Array, order: int) -> Array:
        """Return A of this order, without its leading 1, from v."""
        use, terms = self.equations(order), spread(order)
        late = np.stack([shift(error, i) for i in range(1, order + 1)], axis=1)[use]
        return np.asarray(-terms @ least_squares(late @ terms, error[use]))

    def limits(self, form: Form) -> tuple[Array, Array]:
        """Return the lowest and the highest x that are searched."""
        lag = SHORTEST_LAG * self.working_step
        low = [1.0 / LONGEST_LAG_S if form.engine else 0.0, *[lag] * form.lags, 0.0]
        high = [1.0 / lag if form.engine else FASTEST, *[LONGEST_LAG_S] * form.lags, self.longest_delay]
        return np.array(low), np.array(high)


def shift(values: Array, by: int) -> Array:
    """Return the values so many samples later, 0 before them."""
    return np.concatenate([np.zeros(by), values[: len(values) - by]]) if by else values


def whiten(values: Array, ar: Array) -> Array:
    """Return A(q) applied to each column."""
    from scipy.signal import lfilter

    return np.asarray(lfilter(np.concatenate([[1.0], ar]), [1.0], values, axis=0))


def least_squares(matrix: Array, right: Array) -> Array:
    """Solve by the normal equations, the columns brought to one size."""
    size = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    size[size < NEGLIGIBLE] = 1.0
    scaled = matrix / size
    return np.asarray(np.linalg.lstsq(scaled.T @ scaled, scaled.T @ right, rcond=1e-13)[0] / size)
