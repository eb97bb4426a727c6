"""Predictors: what the rate would be by now if the engines answered at once.

A predictor stands between the measured rate and the rate controller.  Once a step it is told the measurement and
the command that was applied in the step before, and answers with the rate to feed back.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, prod

from cosim.base.errors import InputError
from cosim.base.protocols import Diagnostics
from cosim.spec.vehicle import RateModel


class NoPredictor:
    """Predictor that returns the measured rate, without prediction."""

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def update(self, measured: float, applied: float) -> float:
        return measured


class DelayLine:
    """``z^-n``: the input of ``samples`` updates ago, 0 before that.

    >>> line = DelayLine(2)
    >>> [line.update(value) for value in (1.0, 2.0, 3.0)]
    [0.0, 0.0, 1.0]
    """

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.reset()

    def reset(self) -> None:
        """Fill with zeros."""
        self._line = [0.0] * self.samples
        self._at = 0

    def update(self, value: float) -> float:
        if not self.samples:
            return value
        line, at = self._line, self._at
        old = line[at]
        line[at] = value
        self._at = at + 1 if at + 1 < self.samples else 0
        return old


class DiscreteModel:
    """A strictly proper transfer function in z, as a difference equation.

    ``y_k = sum_i b_i u_k-i - sum_i a_i y_k-i``, i = 1..order, from rest; ``numerator`` and ``denominator`` are
    polynomials in z, highest power first, the denominator's first coefficient 1.
    """

    def __init__(self, numerator: Sequence[float], denominator: Sequence[float]) -> None:
        self.a = list(denominator[1:])
        self.b = [0.0] * (len(self.a) - len(numerator)) + list(numerator)
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self._past = [0.0] * len(self.a)

    def update(self, applied: float) -> float:
        """Return the output at ``t_k`` from the input held over ``[t_k-1, t_k)``."""
        # Transposed direct form II: past[i] is the known part of the output i steps ahead.
        past = self._past
        value = past[0] + self.b[0] * applied
        last = len(past) - 1
        for i in range(last):
            past[i] = past[i + 1] + self.b[i + 1] * applied - self.a[i] * value
        past[last] = -self.a[last] * value
        return value


def rate_model(model: RateModel) -> DiscreteModel:
    """Return the identified response without its delay."""
    numerator, denominator = polynomial(model.zeros, model.zero_pairs), polynomial(model.poles, model.pole_pairs)
    return DiscreteModel([model.gain * c for c in numerator], denominator)


class DelayedModel:
    """The identified response with its delay, a whole number of samples or not.

    ``n + f`` samples are ``n`` in a delay line and ``f`` inside the model: each mode ``c / (z - p)`` then answers to
    the held input of this step for the last ``1 - f`` of it and to that of the step before until then,
    ``c (s + (1 - s) / z) / (z - p)``, ``s = (p^(1-f) - 1) / (p - 1)`` (the modified z-transform of the mode).
    Raises InputError where a fraction meets poles that are equal or not above 0.

    >>> model = load_vehicle("hexjet")[0].identified["edf-as-flown"]["roll"]
    >>> delayed, prompt = DelayedModel(model), rate_model(model)
    >>> model.delay_samples, [delayed.update(1.0) for _ in range(26)][-1] == prompt.update(1.0)
    (25.0, True)
    """

    def __init__(self, model: RateModel) -> None:
        samples = int(model.delay_samples)
        fraction = model.delay_samples - samples
        self.line = DelayLine(samples)
        self.model = _make_fractional_delay(model, fraction) if fraction else rate_model(model)

    def reset(self) -> None:
        """Return to rest."""
        self.line.reset()
        self.model.reset()

    def update(self, applied: float) -> float:
        """Return the output at ``t_k`` from inputs up to that held over ``[t_k-1, t_k)``."""
        return self.line.update(self.model.update(applied))


class SmithPredictor:
    """Smith's predictor: ``y + G_n u - z^-h G_n u`` (Smith 1957; the paper's predicted output).

    With a perfect model and no disturbance this is the output of the plant without its delay.  On an (almost)
    integrating plant a constant input disturbance ``d`` leaves the error ``K h T d`` in it; where the model's slowest
    pole is below 1 the error fades with that pole's time constant.
    """

    def __init__(self, model: RateModel) -> None:
        self.now = rate_model(model)
        # With a delay of whole samples the delayed output is the stored undelayed one.
        self.whole = model.delay_samples == int(model.delay_samples)
        self.then: DelayLine | DelayedModel
        self.then = DelayLine(int(model.delay_samples)) if self.whole else DelayedModel(model)
        self._delay = model.delay_samples
        self.diagnostics: Diagnostics = (0.0, 0.0, self._delay)

    def reset(self) -> None:
        """Return model and delay to rest."""
        self.now.reset()
        self.then.reset()
        self.diagnostics = (0.0, 0.0, self._delay)

    def update(self, measured: float, applied: float) -> float:
        now = self.now.update(applied)
        then = self.then.update(now if self.whole else applied)
        self.diagnostics = (now, then, self._delay)
        return measured + (now - then)


class FilteredSmithPredictor:
    """Filtered Smith predictor of Normey-Rico and Camacho: ``G_n u + F (y - z^-h G_n u)``.

    ``F`` is :func:`robustness_filter`; with ``F = 1`` this is Smith's predictor.  What the filter passes of the
    difference between plant and model is what the loop reacts to: slower is more robust, faster rejects sooner.
    """

    def __init__(self, model: RateModel, numerator: Sequence[float], denominator: Sequence[float]) -> None:
        self.now = rate_model(model)
        self.then = DelayedModel(model)
        # A filter in z^-1 is split into its feed-through and a strictly proper remainder.
        self.through = numerator[0]
        rest = [b - self.through * a for b, a in zip(numerator[1:], denominator[1:], strict=True)]
        self.rest = DiscreteModel(rest, denominator) if rest else None
        self._delay = model.delay_samples
        self.diagnostics: Diagnostics = (0.0, 0.0, self._delay)
        self.reset()

    def reset(self) -> None:
        self.now.reset()
        self.then.reset()
        if self.rest:
            self.rest.reset()
        self._before = 0.0
        self.diagnostics = (0.0, 0.0, self._delay)

    def update(self, measured: float, applied: float) -> float:
        then = self.then.update(applied)
        difference = measured - then
        filtered = self.through * difference
        if self.rest:
            filtered += self.rest.update(self._before)
        self._before = difference
        # Written as Smith's output plus the filter's correction, so that F = 1 is Smith's predictor bit for bit.
        now = self.now.update(applied)
        self.diagnostics = (now, then, self._delay)
        return measured + (now - then) + (filtered - difference)


def robustness_filter(model: RateModel, time_constant: float) -> tuple[list[float], list[float]]:
    """Return numerator and denominator (highest power of z first) of the filter of a :class:`FilteredSmithPredictor`.

    ``F = (b_0 z^2 + b_1 z) / (z - a)^2``, ``a = exp(-T / time_constant)``, with ``F(1) = 1`` (no offset of the
    prediction at rest) and ``F(p) = p^h`` at the model's slowest pole ``p`` (its mode leaves the answer to a
    disturbance, so that neither an integrator's offset nor a slow pole's tail remains).  At ``p = 1`` the second
    condition is ``F'(1) = h``.  ``time_constant`` 0 gives the fastest filter.
    """
    a = exp(-model.sample_time_s / time_constant) if time_constant > 0.0 else 0.0
    p, h = max(model.poles), model.delay_samples
    at_one = (1.0 - a) ** 2
    if abs(1.0 - p) < 1e-9:
        # Derivative of (b0 z^2 + b1 z) = F (z - a)^2 at z = 1.
        b0 = h * at_one + 2.0 * (1.0 - a) - at_one
    else:
        b0 = (p**h * (p - a) ** 2 / p - at_one) / (p - 1.0)
    return [b0, at_one - b0, 0.0], [1.0, -2.0 * a, a * a]


def _make_fractional_delay(model: RateModel, fraction: float) -> DiscreteModel:
    poles = model.poles
    if model.pole_pairs or model.zero_pairs:
        raise InputError("identified model: with pairs of poles or zeros its delay must be a whole number of samples")
    if min(poles) <= 0.0 or len(set(poles)) != len(poles):
        raise InputError(
            f"identified model: a delay of {model.delay_samples:g} samples needs poles above 0 and all different, "
            f"not {poles}"
        )
    numerator = [0.0] * (len(poles) + 1)
    for i, pole in enumerate(poles):
        others = poles[:i] + poles[i + 1 :]
        residue = model.gain * prod(pole - zero for zero in model.zeros) / prod(pole - other for other in others)
        weight = 1.0 - fraction if pole == 1.0 else (pole ** (1.0 - fraction) - 1.0) / (pole - 1.0)
        # Transfer function (share z + 1 - share) prod (z - other) / (z prod (z - pole)).
        rest = polynomial(others)
        for power, c in enumerate(rest):
            numerator[power] += residue * weight * c
            numerator[power + 1] += residue * (1.0 - weight) * c
    return DiscreteModel(numerator, polynomial([0.0, *poles]))


def polynomial(roots: Sequence[float], pairs: Sequence[tuple[float, float]] = ()) -> list[float]:
    """Return the coefficients, highest power first, of ``prod (z - root)``; ``pairs`` by real and imaginary part."""
    coefficients = [1.0]
    for root in roots:
        product = [*coefficients, 0.0]
        for i, c in enumerate(coefficients):
            product[i + 1] -= root * c
        coefficients = product
    for re, im in pairs:
        product = [*coefficients, 0.0, 0.0]
        for i, c in enumerate(coefficients):
            product[i + 1] -= 2.0 * re * c
            product[i + 2] += (re * re + im * im) * c
        coefficients = product
    return coefficients
