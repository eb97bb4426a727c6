"""Forms of an engine: how its output follows a command behind a delay.

The static line is a table of free levels at the ``knots`` of the command.  Behind a lag the output is linear in these
levels, so that a fit solves for them (variable projection, Golub and Pereyra, 1973); behind limits of rise and fall
they are parameters like the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Protocol

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.sweep.fit import separate_equal
from hexjet_identify.fit.answers import answer_of_lags, answer_of_limits, answer_of_poles, hold_response
from hexjet_identify.fit.problem import Problem


class Form(Protocol):
    """A form of an engine: parameters ``x``, the delay [s] first, and levels of its static line."""

    @property
    def label(self) -> str:
        """Name of the form in tables."""

    def limits(self, problem: Problem) -> tuple[Array, Array]:
        """Return the least and the greatest of each of ``x``."""

    def widths(self, problem: Problem, x: Array) -> Array:
        """Return the finite-difference step of each of ``x``."""

    def columns(self, problem: Problem, x: Array) -> Array:
        """Return the columns that the linear parameters multiply; without any, the answer as one column."""

    def slopes(self, problem: Problem, x: Array) -> Array | None:
        """Return the derivative of the answer by each of ``x``, or None where it has no closed form."""
        return None

    @property
    def is_linear(self) -> bool:
        """Whether there are linear parameters, one a column."""
        return True

    def levels(self, problem: Problem, x: Array, linear: Array) -> Array:
        """Return the static output at the problem's knots; of a form without such levels none."""
        return np.zeros(0)

    def total(self, x: Array) -> float:
        """Return delay and lags together, s."""

    def natural(self, x: Array) -> dict[str, float]:
        """Return the parameters by name, in s and in the output's unit a second."""


@dataclass(frozen=True)
class Lags(Form):
    """Free static levels behind a delay and one lag or two: ``x`` = delay [s], ln lag [s], second lag over first.

    A ``count`` of 0 is the static line alone, at no delay and a lag of nothing.
    """

    count: int = 1

    @property
    def label(self) -> str:
        return ("static line alone", "delay and one lag", "delay and two lags")[self.count]

    def limits(self, problem: Problem) -> tuple[Array, Array]:
        longest = max(float(log.times[-1] - log.times[0]) for log in problem.logs)
        low, high = [0.0, np.log(0.05 * problem.step), 0.0], [problem.max_delay, np.log(longest), 0.95]
        return np.array(low[: max(2, 1 + self.count)]), np.array(high[: max(2, 1 + self.count)])

    def widths(self, problem: Problem, x: Array) -> Array:
        return np.array([max(0.02 * problem.step, 1e-4 * float(np.exp(x[1]))), 1e-4, 1e-4][: max(2, 1 + self.count)])

    def columns(self, problem: Problem, x: Array) -> Array:
        """Return answers of the levels, offsets of further logs, decays of initial states, and the drift."""
        lag, count = float(np.exp(x[1])), len(problem.logs)
        ratio = float(x[2]) if self.count == 2 and x[2] > 1e-3 else 0.0
        weights = {lag: 1.0 / (1.0 - ratio)} | ({ratio * lag: -ratio / (1.0 - ratio)} if ratio else {})
        answers, extra = [], np.zeros((len(problem.output), 2 * count - 1))
        for n, (log, span, own) in enumerate(zip(problem.logs, problem.spans, problem.level_weights, strict=True)):
            answers.append(answer_of_lags(log, own, float(x[0]), weights))
            if n > 0:
                extra[span, n - 1] = 1.0
            extra[span, count - 1 + n] = np.exp(-(log.times - log.times[0]) / lag)
        return np.column_stack([np.concatenate(answers), extra, problem.drift])

    def levels(self, problem: Problem, x: Array, linear: Array) -> Array:
        """Return the static output at the problem's knots."""
        return linear[: len(problem.knots)]

    def total(self, x: Array) -> float:
        return sum(self.natural(x).values())

    def natural(self, x: Array) -> dict[str, float]:
        """Return the parameters by name, in s."""
        lag = float(np.exp(x[1]))
        second = {"second_lag_s": lag * float(x[2])} if self.count == 2 else {}
        return {"delay_s": float(x[0]), "lag_s": lag, **second}


@dataclass(frozen=True)
class Limits:
    """Free static levels behind a delay, a lag and limits of the output's rise and fall.

    ``x`` = delay [s], ln lag [s], ln rise and ln fall [of the output, 1/s], then the levels.
    """

    label: str = "delay, a lag, limits of rise and fall"
    is_linear: bool = False

    def limits(self, problem: Problem) -> tuple[Array, Array]:
        """Return the least and the greatest of each of ``x``."""
        low, high = Lags(1).limits(problem)
        quickest, slowest = 1e3 * problem.swing, 0.05 * problem.swing / float(np.exp(high[1]))
        unbounded = np.full(len(problem.knots), np.inf)
        slow, quick = np.log([slowest, slowest]), np.log([quickest, quickest])
        return np.concatenate([low, slow, -unbounded]), np.concatenate([high, quick, unbounded])

    def widths(self, problem: Problem, x: Array) -> Array:
        """Return the finite-difference step of each of ``x``."""
        return np.concatenate(
            [Lags(1).widths(problem, x), [1e-4, 1e-4], np.full(len(problem.knots), 1e-4 * problem.swing)]
        )

    def columns(self, problem: Problem, x: Array) -> Array:
        """Return one column: the answer."""
        return self._compute_answers_and_slopes(problem, x)[:, :1]

    def slopes(self, problem: Problem, x: Array) -> Array | None:
        """Return the derivative of the answer by each of ``x``."""
        slopes = self._compute_answers_and_slopes(problem, x)[:, 1:]
        slopes[:, 1:4] *= np.exp(x[1:4])
        return slopes

    def _compute_answers_and_slopes(self, problem: Problem, x: Array) -> Array:
        return np.concatenate(
            [
                answer_of_limits(log, own, x[4:], float(x[0]), *np.exp(x[1:4]).tolist())
                for log, own in zip(problem.logs, problem.level_weights, strict=True)
            ]
        )

    def levels(self, problem: Problem, x: Array, linear: Array) -> Array:
        """Return the static output at the problem's knots."""
        return x[4:]

    def total(self, x: Array) -> float:
        """Return delay and lag together, s."""
        return float(x[0] + np.exp(x[1]))

    def natural(self, x: Array) -> dict[str, float]:
        """Return the parameters by name, in s and in the output's unit a second."""
        return dict(zip(("delay_s", "lag_s", "rise", "fall"), [float(x[0]), *np.exp(x[1:4]).tolist()], strict=True))


@dataclass(frozen=True)
class Poles(Form):
    """``gain e^(-delay s) / ((s + rate) prod(lag s + 1))``, the gain times the rate where it ``is_engine``.

    ``x`` = delay [s], rate [1/s], then so many ``lags`` [s].  An engine's pole is fast and its gain that at rest; that
    of an axis is slow.
    """

    is_engine: bool
    lags: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters ``x``."""
        return ("delay_s", "rate_1_s", *(f"lag_{i + 1}_s" if i else "lag_s" for i in range(self.lags)))

    @property
    def label(self) -> str:
        count = self.lags + 1 if self.is_engine else self.lags
        return f"{count} lag" if count == 1 else f"{count} lags"

    def limits(self, problem: Problem, longest: float = 5.0, fastest: float = 20.0) -> tuple[Array, Array]:
        """Return the least and the greatest of each of ``x``; lags are up to ``longest`` s, the rate of an axis 1/s."""
        shortest = 0.002 * problem.step
        rate = (1.0 / longest, 1.0 / shortest) if self.is_engine else (0.0, fastest)
        ends = [(0.0, problem.max_delay), rate, *[(shortest, longest)] * self.lags]
        low, high = np.array(ends).T
        return low, high

    def widths(self, problem: Problem, x: Array) -> Array:
        return 1e-3 * np.concatenate([[50.0 * problem.step, max(x[1], 0.1)], np.maximum(x[2:], 1e-3)])

    def columns(self, problem: Problem, x: Array) -> Array:
        """Return the answer, and of each log an offset and a free decay of the pole."""
        rate, lags = float(x[1]), x[2:].tolist()
        poles = separate_equal([rate, *(1.0 / lag for lag in lags)])
        scale = (rate if self.is_engine else 1.0) / prod(lags)
        weights = {pole: scale / prod(other - pole for other in poles if other != pole) for pole in poles}
        columns = np.zeros((len(problem.output), 1 + 2 * len(problem.logs)))
        for n, (log, rows) in enumerate(zip(problem.logs, problem.spans, strict=True)):
            since = log.times - log.times[0]
            columns[rows, 0] = answer_of_poles(log, float(x[0]), weights)
            columns[rows, 1 + 2 * n] = 1.0
            columns[rows, 2 + 2 * n] = np.exp(-rate * since) if self.is_engine else hold_response(rate, since)
        return columns

    def total(self, x: Array) -> float:
        return self.without_pole(x) + (1.0 / float(x[1]) if self.is_engine else 0.0)

    def without_pole(self, x: Array) -> float:
        """Return delay and lags together, but for an engine's pole, s."""
        return float(x[0] + x[2:].sum())

    def natural(self, x: Array) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.names, x.tolist(), strict=True))
