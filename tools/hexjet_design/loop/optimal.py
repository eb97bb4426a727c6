"""The controller at the limit of performance, of low order: its parameters are the answers to load and set-point.

With the ``T_i = q^N t`` and ``y`` of :mod:`hexjet_design.loop.limit` and a model ``H = q^N b / a``, a loop is stable
with ``t`` and ``y`` stable, 1 at rest, and ``1 - T_i`` 0 where angle and rate have their slow poles; twice at rest, so
that no load leaves a lean.  ``y`` is a lag of third order.  ``t`` is a sum of orthonormal functions with few poles
(S. Takenaka 1925, F. Malmquist 1926), found by :mod:`hexjet_design.loop.low_order`: the least error after a load that
poles of this number leave, with a peak sensitivity, a noise and a tolerance of the delay.  Its weights are moved by the
least that makes ``T_i`` exact at rest with the model at hand.

``t`` and ``y`` become a controller without dividing anything that is not stable.  With the gain ``K`` of the attitude
loop and ``A = a y / (b T)``, ``A e - B y_m = D u``, ``D = (1 - q^N t) / (1 - q)``, this is a proportional gain behind a
predictor,

    u = p (r - y^),   y^ = P_y y_m + P_u u,   P_y = K T (t / y - (1 + q) / 2) / (1 - q),   P_u = K D / A - 1 / p

with ``p`` so that ``P_u`` has no answer without delay, and ``K`` so that ``P_y`` is 1 at rest.  The predictor reads
what was applied of the command, so limits do not wind it up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, exp, log, sqrt

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.protocols import Parameter
from cosim.control.predictors.state import LinearPredictor
from cosim.control.rate import RateAxis
from cosim.laws import Axis, AxisLaw, Pid, RateLaw, positive_parameter
from cosim.spec.vehicle import RateModel

LAGS = 3  # equal lags of the set-point response
# Zeros this close to the unit circle are not inverted, and poles this close to 1 are integrators.
CIRCLE_TOLERANCE = 1e-6
DELAY_STATES = LAGS + 1  # states that hold the last samples


def orthonormal_basis(denominators: Sequence[Array], samples: int) -> Array:
    """Return orthonormal responses with these poles, a column each, from polynomials in ``q`` of degree 1 or 2.

    Behind the allpass of all the poles before, ``1 / d`` and, of a pair, what ``q / d`` adds to it.
    """
    passed = np.zeros(samples)
    passed[0] = 1.0
    columns: list[Array] = []
    for denominator in denominators:
        response = filter_response([1.0], denominator, passed)
        first = response / np.linalg.norm(response)
        columns.append(first)
        if len(denominator) == 3:
            late: Array = np.r_[0.0, response[:-1]]
            late -= first * (first @ late)
            columns.append(late / np.linalg.norm(late))
        passed = filter_response(denominator[::-1], denominator, passed)
    return np.stack(columns, axis=1)


def filter_response(numerator: Sequence[float] | Array, denominator: Array, response: Array) -> Array:
    """Return a response behind ``numerator / denominator``, polynomials in ``q``: scipy.signal takes long to import."""
    passed: Array = np.convolve(numerator, response)[: len(response)]
    feedback = denominator[1:].tolist()
    if not any(feedback):
        return passed
    past = [0.0] * len(feedback)
    values = []
    for value in passed.tolist():
        for coefficient, before in zip(feedback, past, strict=True):
            value -= coefficient * before
        values.append(value)
        past = [value, *past[:-1]]
    return np.array(values)


@dataclass(frozen=True)
class ModelForm:
    """A model of a rate as ``q^late kept b / a``: ``kept``, 1 at rest, has the zeros that cannot be inverted."""

    step: float
    late: int
    kept: Array
    numerator: Array
    denominator: Array
    slow_pole: float | None  # where ``1 - T_i`` has a zero
    fast_poles: tuple[complex, ...]  # poles that the controller keeps

    @classmethod
    def of(cls, model: RateModel, target: Target) -> ModelForm:
        """Return a model in this form, its delay in whole steps, rounded to the nearest."""
        zeros, poles = model.all_zeros, model.all_poles
        kept, inside = split_zeros(zeros)
        slow = max(model.poles, default=0.0)
        # A pole of the rate is an integrator if closer to 1 than this fraction of the slowest pole of ``t``.
        nearness = 0.5
        is_slow = 1.0 - slow < nearness * (1.0 - target.slowest(model.sample_time_s))
        fast = list(poles)
        if is_slow:
            fast.remove(slow)
        return cls(
            model.sample_time_s,
            round(model.delay_samples) + len(poles) - len(zeros),
            kept / kept.sum(),
            model.gain * float(kept.sum()) * inside,
            polynomial(poles),
            slow if is_slow else None,
            tuple(fast),
        )

    def interpolation(self, basis: Array, rounding: float = 1e-16) -> tuple[Array, Array]:
        """Return rows and values that weights of ``basis`` keep: ``T_i`` 1 and level at rest, 1 at the slow pole.

        At ``q = 1 + a`` that is ``sum_k t_k (q^k - 1 - a k) / a^2 = 0``, and a sum of binomials for any ``a``.
        """
        at = self.late + np.arange(len(basis) + len(self.kept) - 1.0)
        columns = np.stack([np.convolve(self.kept, column) for column in basis.T], axis=1)
        rows = [np.ones_like(at), at / self.late]
        if self.slow_pole is not None:
            away = 1.0 / self.slow_pole - 1.0
            term = total = at * (at - 1.0) / (2.0 * self.late**2)
            for k in range(2, len(at) + self.late):
                term = term * (at - k) * away / (k + 1.0)
                total = total + term
                if float(np.max(np.abs(term))) < rounding * float(np.max(total)):
                    break
            rows.append(total)
        return np.stack(rows) @ columns, np.eye(len(rows))[0]


@dataclass(frozen=True)
class Target:
    """Target responses of a loop: the lag of ``y``, and poles and weights of ``t``."""

    lag_s: float  # s, each of three equal lags
    pairs: tuple[tuple[float, float], ...]  # natural frequency [rad/s] and damping
    weights: tuple[float, ...]  # weights of orthonormal functions

    @classmethod
    def of(cls, values: Mapping[str, float], delay: float) -> Target:
        """Return the target of a law's parameters, which are in units of the delay at low frequency [s]."""
        pair_count = 4  # pole pairs of the response to a load
        pairs = tuple((values[f"speed_{k}"] / delay, values[f"damping_{k}"]) for k in range(1, pair_count + 1))
        weights = tuple(values[f"weight_{k}"] / sqrt(delay) for k in range(1, 2 * pair_count + 1))
        return cls(values["response"] * delay, pairs, weights)

    def to_values(self, delay: float) -> dict[str, float]:
        """Return the parameters of the law that has this target."""
        values = {"response": self.lag_s / delay}
        for k, (natural, damping) in enumerate(self.pairs, 1):
            values |= {f"speed_{k}": natural * delay, f"damping_{k}": damping}
        return values | {f"weight_{k}": weight * sqrt(delay) for k, weight in enumerate(self.weights, 1)}

    def denominators(self, step: float) -> list[Array]:
        """Return polynomials in ``q`` with the poles of the target response ``t``, one for each pair."""
        return [polynomial(pole_pair(natural, damping, step)) for natural, damping in self.pairs]

    def basis(self, step: float, lags: float = 28.0) -> Array:
        """Return the orthonormal responses whose weighted sum is the target ``t``, until they have decayed."""
        return orthonormal_basis(self.denominators(step), ceil(lags / -log(self.slowest(step))))

    def slowest(self, step: float) -> float:
        """Return the magnitude of the slowest pole of the target response ``t``, in z."""
        return max(abs(pole) for pair in self.pairs for pole in pole_pair(*pair, step))

    def lag(self, step: float) -> float:
        """Return the pole of the target response ``y``, in z."""
        return exp(-step / self.lag_s)


def pole_pair(natural: float, damping: float, step: float) -> list[complex]:
    """Return the poles in ``z`` of ``s^2 + 2 damping natural s + natural^2``, held over a step."""
    return [complex(np.exp(step * root)) for root in np.roots([1.0, 2.0 * damping * natural, natural * natural])]


def fit_weights(form: ModelForm, basis: Array, weights: Array) -> Array:
    """Return the nearest weights that satisfy the conditions on ``T_i`` at rest."""
    rows, values = form.interpolation(basis)
    return np.asarray(weights + np.linalg.lstsq(rows, values - rows @ weights, rcond=None)[0], np.float64)


@dataclass(frozen=True)
class PredictorBases:
    """Parts of a predictor that depend on poles alone, computed once for a search of weights."""

    form: ModelForm
    of_target: Array  # basis functions of ``t``
    of_predictor: Array  # predictor responses, one per column
    transition: Array

    @classmethod
    def of(cls, model: RateModel, target: Target) -> PredictorBases:
        """Return the bases of a target's poles with a model."""
        form, step = ModelForm.of(model, target), model.sample_time_s
        basis = target.basis(step)
        length = form.late + len(basis) + 8 * (len(form.kept) + LAGS)
        denominators = [np.array([1.0, 0.0])] * DELAY_STATES + _sections(form.fast_poles) + target.denominators(step)
        functions = orthonormal_basis(denominators, length)
        return cls(form, basis, functions, functions.T @ np.vstack([functions[1:], np.zeros(functions.shape[1])]))


def make_predictor(
    model: RateModel, target: Target, bases: PredictorBases | None = None
) -> tuple[LinearPredictor, float, float]:
    """Return the predictor, the proportional gain and the gain of the attitude loop, 1/s, of a target.

    ``bases`` are those of the target's poles, where they are known.  Raises InputError where the target is faster than
    the model can be.
    """
    bases, step = bases or PredictorBases.of(model, target), model.sample_time_s
    form, basis, functions = bases.form, bases.of_target, bases.of_predictor
    weights = fit_weights(form, basis, sqrt(step) * np.array(target.weights))
    t = basis @ weights
    length = len(functions)
    pad = np.zeros(length)

    def pad_response(response: Array) -> Array:
        return np.concatenate([response, pad])[:length]

    # y = kept top / bottom, but ``kept`` cancels in what follows.
    pole = target.lag(step)
    bottom, top = polynomial([pole] * LAGS), (1.0 - pole) ** LAGS
    of_rate = pad_response(np.convolve(bottom / top, t)) - pad_response(np.array([0.5, 0.5]))
    of_rate = step * np.cumsum(of_rate)
    ends = pad_response(np.array([1.0])) - pad_response(np.r_[np.zeros(form.late), np.convolve(form.kept, t)])
    of_command = np.cumsum(ends)
    of_command = filter_response(np.convolve(form.numerator, bottom) * step / top, form.denominator, of_command)
    attitude = 1.0 / float(of_rate.sum())
    if not attitude > 0.0:
        raise InputError("the answer to a load is too fast for the answer to a set-point: less speed, or less response")
    of_rate, of_command = attitude * of_rate, attitude * of_command
    tail = pad_response(of_command[form.late + 1 :])
    predictor = LinearPredictor(
        bases.transition.tolist(),
        (functions.T @ of_rate).tolist(),
        (functions.T @ tail).tolist(),
        functions[0].tolist(),
        [0.0, *of_command[form.late : 0 : -1].tolist()],
    )
    return predictor, 1.0 / float(of_command[0]), attitude


def polynomial(roots: Sequence[complex]) -> Array:
    """Return the coefficients in ``q`` of a polynomial with these roots in ``z``, which is 1 at ``q = 0``."""
    return np.atleast_1d(np.real(np.poly(roots)))


def split_zeros(zeros: Iterable[complex]) -> tuple[Array, Array]:
    """Return the polynomials of the zeros that cannot be inverted, on the unit circle or outside, and of the others."""
    kept = [zero for zero in zeros if abs(zero) > 1.0 - CIRCLE_TOLERANCE]
    return polynomial(kept), polynomial([zero for zero in zeros if abs(zero) <= 1.0 - CIRCLE_TOLERANCE])


def _sections(poles: Sequence[complex]) -> list[Array]:
    """Return real polynomials of degree 1 or 2 with these poles."""
    pairs = [[pole, pole.conjugate()] for pole in poles if complex(pole).imag > 0.0]
    single = [[pole] for pole in poles if complex(pole).imag == 0.0]
    return [polynomial(roots) for roots in (*single, *pairs)]


def _pole_parameters(*pairs: tuple[float, float]) -> list[Parameter]:
    parameters = []
    for k, (natural, damping) in enumerate(pairs, 1):
        of = f"of pair {k} of the poles of the answer to a load"
        parameters.append(positive_parameter(f"speed_{k}", natural, f"natural frequency {of} [rad/s] times theta"))
        parameters.append(positive_parameter(f"damping_{k}", damping, f"damping {of}"))
    return parameters


def _weight_parameters(*weights: float) -> list[Parameter]:
    meaning = "weight of an orthonormal function with these poles, times the root of theta"
    return [Parameter(f"weight_{k}", weight, "", meaning, -1e3, 1e3) for k, weight in enumerate(weights, 1)]


class Optimal(RateLaw):
    """The controller at the limit of performance, reduced to four pairs of poles."""

    parameters = (
        positive_parameter("response", 0.4528, "each of three lags of the answer to a set-point [s] over theta"),
        *_pole_parameters((0.6264, 0.37), (0.5957, 0.827), (1.462, 1.4), (5.716, 1.07)),
        *_weight_parameters(0.2609, -1.303, 0.1508, -0.5265, 0.07043, -0.5096, 0.1858, -0.08414),
    )

    def make_axis(self, axis: Axis, values: Mapping[str, float]) -> tuple[AxisLaw, float]:
        """Return a proportional gain behind the predictor of one axis, and the gain of the attitude loop above."""
        predictor, gain, attitude = make_predictor(axis.model, Target.of(values, axis.delay))
        gains = getattr(axis.belief.vehicle.control.rate, axis.name).model_copy(update={"p": gain, "i": 0.0, "d": 0.0})
        return Pid(RateAxis(gains, predictor, axis.step)), attitude
