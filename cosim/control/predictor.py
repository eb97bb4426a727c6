"""Predictors: what the rate would be by now if the engines answered at once.

A predictor stands between the measured rate and the rate controller.  Once a step it is told the measurement and
the command that was applied in the step before, and answers with the rate to feed back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from cosim.vehicle import RateModel


class Predictor(Protocol):
    """A block with one output: the rate to feed back, rad/s."""

    def reset(self) -> None:
        """Forget everything: at rest, nothing applied."""

    def update(self, measured: float, applied: float) -> float:
        """The rate to feed back at ``t_k``, from the measurement there and the command applied over the step before."""


class NoPredictor:
    """The baseline: the measurement itself."""

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, measured: float, applied: float) -> float:
        return measured


class DelayLine:
    """``z^-n``: what went in ``samples`` updates ago, 0 before that."""

    def __init__(self, samples: int) -> None:
        self._samples = samples
        self.reset()

    def reset(self) -> None:
        """Fill with zeros."""
        self._line = [0.0] * self._samples
        self._at = 0

    def update(self, value: float) -> float:
        if not self._samples:
            return value
        line, at = self._line, self._at
        old = line[at]
        line[at] = value
        self._at = at + 1 if at + 1 < self._samples else 0
        return old


class DiscreteModel:
    """A strictly proper transfer function in z without its delay, as a difference equation.

    ``y_k = sum_i b_i u_k-i - sum_i a_i y_k-i``, i = 1..order, from rest.
    """

    def __init__(self, model: RateModel) -> None:
        a = _polynomial(model.poles)
        b = [model.gain * c for c in _polynomial(model.zeros)]
        self._a = a[1:]
        self._b = [0.0] * (len(self._a) - len(b)) + b
        self.reset()

    def reset(self) -> None:
        """At rest."""
        self._past = [0.0] * len(self._a)

    def update(self, applied: float) -> float:
        """Output at ``t_k`` from the input held over ``[t_k-1, t_k)``."""
        # transposed direct form: past[i] holds what is known by now of the output i steps ahead
        past = self._past
        value = past[0] + self._b[0] * applied
        last = len(past) - 1
        for i in range(last):
            past[i] = past[i + 1] + self._b[i + 1] * applied - self._a[i] * value
        past[last] = -self._a[last] * value
        return value


class SmithPredictor:
    """Smith's predictor: ``y + G_n u - z^-h G_n u`` (Smith 1957; the paper's predicted output).

    With a perfect model and no disturbance this is the output of the plant without its delay.  On an (almost)
    integrating plant a constant input disturbance ``d`` leaves the error ``K h T d`` in it for good.
    """

    def __init__(self, model: RateModel) -> None:
        self._model = DiscreteModel(model)
        self._delay = DelayLine(model.delay_samples)

    def reset(self) -> None:
        """Model and delay line at rest."""
        self._model.reset()
        self._delay.reset()

    def update(self, measured: float, applied: float) -> float:
        now = self._model.update(applied)
        return measured + (now - self._delay.update(now))


def _polynomial(roots: Sequence[float]) -> list[float]:
    """Coefficients, highest power first, of ``prod (z - root)``."""
    coefficients = [1.0]
    for root in roots:
        shifted = [*coefficients, 0.0]
        for i, c in enumerate(coefficients):
            shifted[i + 1] -= root * c
        coefficients = shifted
    return coefficients


# The controllers a user can choose: the same gains, and one of these between measurement and rate loop.
PREDICTORS: dict[str, Callable[[RateModel], Predictor]] = {
    "baseline": lambda model: NoPredictor(),
    "smith": SmithPredictor,
}
TITLES = {
    "baseline": "cascaded P and PID, fed with the measured rate",
    "smith": "the same gains, fed with a Smith predictor's rate on roll",
}
