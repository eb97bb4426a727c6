"""The forms that are fitted, and what an estimate of one holds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import log
from typing import Any

import numpy as np

from cosim.base.arrays import Array

ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 52, 64, 80, 100, 128, 160)  # of A, tried
SEPARATE = 20  # terms of A that are each estimated; those beyond are linear between the orders above; chosen by us


@dataclass(frozen=True)
class Form:
    """A form of model: an engine (its pole is fast and its gain that at rest), or an axis (its pole is slow)."""

    engine: bool
    lags: int  # beside the pole

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that do not enter linearly: pole, lags, delay [s]."""
        lags = (f"lag_{i + 1}_s" if i else "lag_s" for i in range(self.lags))
        return ("rate_1_s", *lags, "delay_s")

    @property
    def label(self) -> str:
        """Description of the form in words."""
        count = self.lags + 1 if self.engine else self.lags
        return f"{count} lag" if count == 1 else f"{count} lags"


@dataclass(frozen=True)
class Estimate:
    """The fitted parameters, with the sums on which their bounds rest."""

    form: Form
    x: Array  # rate, lags, delay: in their own units
    gain: float
    order: int  # of A
    ar: Array  # A without its leading 1: e = v + ar[0] v[-1] + ...
    linear: Array
    loss: float  # sum of e^2
    count: int  # equations
    covariance: Array  # of (x, linear, terms of A), 0 for what is at its limit
    free: tuple[int, ...]  # of x
    fixed: tuple[str, ...] = ()
    delay_bounds: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def delay(self) -> float:
        """The delay [s]."""
        return float(self.x[-1])

    @property
    def parameters(self) -> int:
        """Count of the estimated parameters."""
        return len(self.free) + len(self.linear) + int(spread(self.order).shape[1])

    @property
    def deviance(self) -> float:
        """-2 ln of the likelihood, but for a constant."""
        return self.count * log(self.loss / self.count)

    @property
    def aic(self) -> float:
        """Akaike's criterion."""
        return self.deviance + 2.0 * self.parameters

    @property
    def bic(self) -> float:
        """Schwarz' criterion."""
        return self.deviance + log(self.count) * self.parameters

    def deviation(self, index: int) -> float:
        """Return the standard deviation of ``x[index]``, by the linearised problem."""
        return float(np.sqrt(max(self.covariance[index, index], 0.0)))

    @property
    def gain_deviation(self) -> float:
        """Standard deviation of the gain."""
        n = len(self.x)
        return float(np.sqrt(max(self.covariance[n, n], 0.0)))

    @property
    def all_delay(self) -> tuple[float, float]:
        """Delay and lags together [s], which is what low frequencies show, and its standard deviation."""
        value = float(self.x[1:].sum()) + (1.0 / float(self.x[0]) if self.form.engine else 0.0)
        slope = np.zeros(len(self.covariance))
        slope[1 : len(self.x)] = 1.0
        if self.form.engine:
            slope[0] = -1.0 / float(self.x[0]) ** 2
        return value, float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))


def estimate_dict(estimate: Estimate, sample: float) -> dict[str, Any]:
    """Return one form's parameters, standard deviations, bounds and criteria, for JSON."""
    value, deviation = estimate.all_delay
    low, high = estimate.delay_bounds
    bounded = bool(np.isfinite(low))
    return {
        "form": estimate.form.label,
        "gain": estimate.gain,
        **{name: float(value) for name, value in zip(estimate.form.names, estimate.x, strict=True)},
        "delay_bounds_95_s": [low, high] if bounded else None,
        "delay_samples": estimate.delay / sample,
        "standard_deviations": {
            "gain": estimate.gain_deviation,
            **{name: estimate.deviation(i) for i, name in enumerate(estimate.form.names)},
        },
        "all_delay_s": value,
        "all_delay_deviation_s": deviation,
        "noise_order": estimate.order,
        "held": list(estimate.fixed),
        "equations": estimate.count,
        "residual_rms": float(np.sqrt(estimate.loss / estimate.count)),
        "aic": estimate.aic,
        "bic": estimate.bic,
    }


@cache
def spread(order: int) -> Array:
    """Return the matrix from estimated terms to coefficients of A, (order, terms): the first ``SEPARATE`` alone.

    Those beyond are linear between ``ORDERS``, because noise that goes through an airframe fades slowly and smoothly.
    """
    knots = [*range(1, min(order, SEPARATE) + 1), *(n for n in ORDERS if SEPARATE < n < order), order]
    at = np.unique(knots)
    return np.asarray([np.interp(np.arange(1, order + 1), at, row) for row in np.eye(len(at))]).T
