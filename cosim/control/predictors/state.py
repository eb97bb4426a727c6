"""d-step ahead state predictors: an observer of the present state, and the model predicted over the delay.

``x_p(k + d) = A^d x_k + A^(d-1) B u_k-d + ... + B u_k-1`` (the paper's equation; Lozano et al. 2004), in the
coordinates ``x = (rate, its slope)`` of a second-order model.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, nan
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import InputError
from cosim.base.protocols import Diagnostics
from cosim.spec.vehicle import RateModel

Pair = tuple[float, float]
Matrix: TypeAlias = NDArray[np.float64]


class StateModel:
    """A second-order model ``x_k+1 = A x_k + B u_k-d``, ``rate = x[0]``, that realises an identified response.

    ``A = exp([[0, 1], [-l1 l2, l1 + l2]] T)`` with ``l = ln(pole) / T``, so that ``x[1]`` is the slope of the rate
    between commands; ``B`` is matched to the numerator, so that ``C (zI - A)^-1 B`` is the transfer function.
    Raises InputError for a model that is not of second order with real poles in (0, 1].
    """

    def __init__(self, model: RateModel) -> None:
        if len(model.poles) != 2 or not all(0.0 < pole <= 1.0 for pole in model.poles):
            raise InputError(
                f"identified model: a state predictor needs two poles above 0 and at most 1, not {model.poles}"
            )
        self.step = model.sample_time_s
        l1, l2 = np.log(model.poles) / self.step
        self._modes = model.poles
        self.A = _exponential(l1, l2, self.step)
        b1 = model.gain if len(model.zeros) == 1 else 0.0
        b0 = -model.gain * model.zeros[0] if len(model.zeros) == 1 else model.gain
        self.B: Matrix = np.array([b1, (b0 + self.A[1, 1] * b1) / self.A[0, 1]])
        self._continuous = (float(l1), float(l2))

    def fraction(self, f: float) -> tuple[Matrix, Matrix]:
        """Return transition matrix and input matrix over a fraction ``f`` of a step, with the command held."""
        l1, l2 = self._continuous
        whole = _integral(l1, l2, self.step)
        return _exponential(l1, l2, f * self.step), _integral(l1, l2, f * self.step) @ np.linalg.solve(whole, self.B)


class Observer(Protocol):
    """Observer that estimates the model's state at ``t_k``."""

    def reset(self) -> None:
        """Return to rest."""

    def update(self, measured: float, late: float, push: Pair) -> tuple[Pair, float]:
        """Return state and input disturbance at ``t_k`` from the rate and the previous step's input.

        ``late`` is the command that arrived then, given ``d`` samples earlier (the mean of two where that is not a
        whole number), ``push`` what it adds to the state over the step.
        """


class DoubleIntegratorObserver:
    """The paper's observer ``x' = (A - L C) x + B u + L y`` of a double integrator, ``L = (beta_1, beta_2)``.

    ``beta_1 = 2 w``, ``beta_2 = w^2``: both poles at ``-w``.  The command enters as printed, ``B = (0, 1)``: in the
    unit of the command, which is nothing beside the slope of the rate, so this is a differentiator in effect.
    Discretised exactly for measurement and command held over the step.

    >>> observer = DoubleIntegratorObserver(bandwidth=50.0, step=0.004)
    >>> for k in range(500):
    ...     (rate, slope), _ = observer.update(0.004 * k, 0.0, (0.0, 0.0))
    >>> print(f"{slope:.2f} rad/s^2")
    1.00 rad/s^2
    """

    def __init__(self, bandwidth: float, step: float) -> None:
        w = bandwidth
        # Matrix exponential of [[-2w, 1], [-w^2, 0]], which has a double pole at -w.
        decay = float(np.exp(-w * step))
        self.transition = (decay * (1.0 - w * step), decay * step, -decay * w * w * step, decay * (1.0 + w * step))
        inverse = np.linalg.inv(np.array([[-2.0 * w, 1.0], [-w * w, 0.0]]))
        integral = inverse @ (np.array(self.transition).reshape(2, 2) - np.eye(2))
        self.of_rate = tuple(float(v) for v in integral @ np.array([2.0 * w, w * w]))
        self.of_command = tuple(float(v) for v in integral @ np.array([0.0, 1.0]))
        self.reset()

    def reset(self) -> None:
        self._x = self._v = 0.0

    def update(self, measured: float, late: float, push: Pair) -> tuple[Pair, float]:
        x, v = self._x, self._v
        a, b, c, d = self.transition
        self._x = a * x + b * v + self.of_rate[0] * measured + self.of_command[0] * late
        self._v = c * x + d * v + self.of_rate[1] * measured + self.of_command[1] * late
        return (self._x, self._v), 0.0


class ModelObserver:
    """Luenberger observer of the identified model, optionally with a constant input disturbance.

    ``x^ = A x + B (u + d)``, corrected by ``L (y - x^[0])`` at the same instant; all poles at ``exp(-bandwidth T)``.
    """

    def __init__(self, model: StateModel, bandwidth: float, disturbance: bool) -> None:
        self.with_disturbance = disturbance
        n = 3 if disturbance else 2
        F = np.eye(n)
        F[:2, :2] = model.A
        if disturbance:
            F[:2, 2] = model.B
        pole = float(np.exp(-bandwidth * model.step))
        # Ackermann's formula for the predictor form, then F^-1 for a correction at the same instant.
        c = np.zeros(n)
        c[0] = 1.0
        observability = np.array([c @ np.linalg.matrix_power(F, i) for i in range(n)])
        characteristic = np.linalg.matrix_power(F - pole * np.eye(n), n)
        late_gain = characteristic @ np.linalg.solve(observability, np.eye(n)[:, -1])
        self.gain = [float(v) for v in np.linalg.solve(F, late_gain)]
        self.F = [[float(v) for v in row] for row in F]
        self.reset()

    def reset(self) -> None:
        self._state = [0.0] * len(self.F)

    def update(self, measured: float, late: float, push: Pair) -> tuple[Pair, float]:
        old = self._state
        ahead = [_scalar_product(row, old) for row in self.F]
        ahead[0] += push[0]
        ahead[1] += push[1]
        error = measured - ahead[0]
        self._state = state = [ahead[i] + gain * error for i, gain in enumerate(self.gain)]
        return (state[0], state[1]), state[2] if self.with_disturbance else 0.0


class StatePredictor:
    """Predictor of an observer, and of the model over the delay with the commands in transport.

    A delay of ``n + f`` samples is run through exactly: ``f`` of a step with the oldest of ``n + 1`` commands, then
    ``n`` whole steps.  An estimated input disturbance is taken to last (the idea of Sanz et al. 2016).
    """

    def __init__(self, model: RateModel, observer: Observer, state_model: StateModel) -> None:
        self.observer = observer
        n = int(model.delay_samples)
        f = model.delay_samples - n
        A, B = state_model.A, state_model.B
        self.f = f
        # A command sent n + f samples ago replaces the previous one after the fraction f of the step.
        phi, new = state_model.fraction(1.0 - f)
        old = phi @ state_model.fraction(f)[1]
        self.push = (float(old[0]), float(new[0]), float(old[1]), float(new[1]))
        phi, gamma = state_model.fraction(f)
        row = np.linalg.matrix_power(A, n)[0]
        self.of_state = tuple(float(v) for v in row @ phi)
        # Oldest first: of the observer alone, of the fraction, then one weight per step.
        weights = [0.0, float(row @ gamma), *(float((np.linalg.matrix_power(A, n - 1 - j) @ B)[0]) for j in range(n))]
        self.weights = weights
        self.of_disturbance = sum(weights)
        self.diagnostics: Diagnostics = (nan, nan, model.delay_samples)  # the modal model has no delay-free output
        self.reset()

    def reset(self) -> None:
        """Return to rest, with no command in transport."""
        self.observer.reset()
        self._sent = [0.0] * len(self.weights)

    def update(self, measured: float, applied: float) -> float:
        sent = self._sent
        sent.append(applied)
        del sent[0]
        f = self.f
        before, now = sent[0], sent[1]
        old_x, new_x, old_v, new_v = self.push
        push = (old_x * before + new_x * now, old_v * before + new_v * now)
        (x, v), disturbance = self.observer.update(measured, f * before + (1.0 - f) * now, push)
        of_x, of_v = self.of_state
        return of_x * x + of_v * v + _scalar_product(self.weights, sent) + self.of_disturbance * disturbance


class LinearPredictor:
    """Any linear predictor of a finite order: ``x = F x + g y + h u_late``, ``y^ = c x`` and a weight for each command.

    ``u_late`` is the oldest of the commands in transport, whose weight is the first.
    """

    def __init__(
        self,
        transition: list[list[float]],
        of_rate: list[float],
        of_command: list[float],
        of_state: list[float],
        weights: list[float],
    ) -> None:
        self.transition, self.of_rate, self.of_command = transition, of_rate, of_command
        self.of_state, self.weights = of_state, weights
        self.reset()

    def reset(self) -> None:
        """Return to rest, with no command in transport."""
        self._state = [0.0] * len(self.of_state)
        self._sent = [0.0] * len(self.weights)

    def update(self, measured: float, applied: float) -> float:
        sent = self._sent
        sent.append(applied)
        del sent[0]
        late, old = sent[0], self._state
        rows, of_rate, of_command = self.transition, self.of_rate, self.of_command
        self._state = state = [
            _scalar_product(row, old) + of_rate[i] * measured + of_command[i] * late for i, row in enumerate(rows)
        ]
        return _scalar_product(self.of_state, state) + _scalar_product(self.weights, sent)


class Modes:
    """An identified response of any order as a sum of modes: ``x_i' = p_i x_i + u``, ``rate = sum c_i x_i``.

    A command given ``n + f`` samples ago reaches mode ``i`` for the last ``share_i`` of its step and the one before it
    until then, ``share = (p^(1-f) - 1) / (p - 1)`` (the modified z-transform).
    Raises InputError for a pole outside (0, 1].
    """

    def __init__(self, model: RateModel) -> None:
        if not all(pole > 0.0 for pole in model.poles):
            raise InputError(
                f"identified model: a state predictor needs poles above 0 and at most 1, not {model.poles}"
            )
        self.poles = _separate_equal_poles(model.all_poles)
        self.delay = model.delay_samples
        self.whole = int(model.delay_samples)
        f = self.delay - self.whole
        self.residues = [
            model.gain
            * _product([pole - zero for zero in model.all_zeros])
            / _product([pole - other for other in self.poles if other != pole])
            for pole in self.poles
        ]
        self.shares: list[complex] = [1.0 - f if p == 1.0 else (p ** (1.0 - f) - 1.0) / (p - 1.0) for p in self.poles]

    def state_weights(self) -> list[complex]:
        """Return the contribution of each mode's present state to the rate after the delay."""
        return [c * p**self.delay for c, p in zip(self.residues, self.poles, strict=True)]

    def command_weight(self) -> float:
        """Return the contribution of a constant command of 1 to the rate over the delay."""
        total: complex = 0.0
        for c, p in zip(self.residues, self.poles, strict=True):
            total += c * (self.delay if p == 1.0 else (p**self.delay - 1.0) / (p - 1.0))
        return total.real


def modal_observer(modes: Modes, bandwidth: float, step: float, disturbance: bool) -> tuple[Matrix, Matrix]:
    """Return the transition ``F`` (the input disturbance as its last state) and the gain of the correction.

    All poles of the observer at ``exp(-bandwidth T)``, by Ackermann's formula.
    """
    order = len(modes.poles)
    n = order + 1 if disturbance else order
    F: Matrix = np.eye(n, dtype=complex if any(isinstance(p, complex) for p in modes.poles) else float)
    F[:order, :order] = np.diag(modes.poles)
    if disturbance:
        F[:order, order] = 1.0
    c = np.zeros(n, F.dtype)
    c[:order] = modes.residues
    observability = np.array([c @ np.linalg.matrix_power(F, i) for i in range(n)])
    characteristic = np.linalg.matrix_power(F - exp(-bandwidth * step) * np.eye(n), n)
    return F, np.asarray(np.linalg.solve(F, characteristic @ np.linalg.solve(observability, np.eye(n)[:, -1])))


class _Mode:
    """Real mode of a :class:`ModalPredictor`: its constants and its state ``x``."""

    def __init__(self, pole: float, share: float, residue: float, gain: float, weight: float) -> None:
        self.pole, self.share, self.residue, self.gain, self.weight = pole, share, residue, gain, weight
        self.x = 0.0

    def step(self, disturbance: float, now: float, before: float) -> float:
        """Return the state after a step with the command ``before`` and then, for ``share`` of it, ``now``."""
        self.x = self.pole * self.x + disturbance + self.share * now + (1.0 - self.share) * before
        return self.x


class ModalPredictor:
    """:class:`StatePredictor` with :class:`ModelObserver` in modal form, for a model of any order.

    An engine with a slow spool, the airframe and the gyro's filter make three poles or more; a model of two would
    have to call one of them delay.
    """

    def __init__(self, model: RateModel, bandwidth: float, disturbance: bool) -> None:
        modes = Modes(model)
        _, gain = modal_observer(modes, bandwidth, model.sample_time_s, disturbance)
        self.poles = modes.poles
        self.residues = modes.residues
        self.shares = modes.shares
        self.with_disturbance = disturbance
        self.gain: list[complex] = gain.tolist()
        self.state_weights = modes.state_weights()
        self.command_weight = modes.command_weight()
        n, f = modes.whole, modes.delay - modes.whole
        # Oldest first: of the observer alone, of the fraction, then one weight per step.
        over_fraction: list[complex] = [f if p == 1.0 else (p**f - 1.0) / (p - 1.0) for p in modes.poles]
        residues, poles = modes.residues, modes.poles
        late = [c * p**n for c, p in zip(residues, poles, strict=True)]
        self.weights = [
            0.0,
            _product_sum(late, over_fraction).real,
            *[_product_sum(residues, [p ** (n - 1 - j) for p in poles]).real for j in range(n)],
        ]
        self.diagnostics: Diagnostics = (nan, nan, model.delay_samples)
        self._is_real = not any(isinstance(pole, complex) for pole in modes.poles)
        # Pole, share, residue, gain and weight of each mode, for modes that are all real.
        numbers = zip(modes.poles, modes.shares, modes.residues, self.gain, self.state_weights, strict=False)
        self._modes = [_Mode(*[number.real for number in mode]) for mode in numbers]
        self.reset()

    def reset(self) -> None:
        """Return to rest, with no command in transport."""
        self._x: list[complex] = [0.0] * len(self.poles)
        for mode in self._modes:
            mode.x = 0.0
        self._d = 0.0
        self._sent = [0.0] * len(self.weights)

    def update(self, measured: float, applied: float) -> float:
        sent = self._sent
        sent.append(applied)
        del sent[0]
        before, now, d = sent[0], sent[1], self._d
        ahead = _scalar_product(self.weights, sent)
        if self._is_real:
            rate = after = 0.0
            for mode in self._modes:
                rate += mode.residue * mode.step(d, now, before)
            error = measured - rate
            for mode in self._modes:
                mode.x += mode.gain * error
                after += mode.weight * mode.x
            if self.with_disturbance:
                self._d = d = d + self.gain[-1].real * error
            return after + ahead + self.command_weight * d
        old, shares = self._x, self.shares
        x = [p * old[i] + d + shares[i] * now + (1.0 - shares[i]) * before for i, p in enumerate(self.poles)]
        error = measured - _product_sum(self.residues, x).real
        self._x = x = [value + self.gain[i] * error for i, value in enumerate(x)]
        if self.with_disturbance:
            self._d = d = d + self.gain[-1].real * error
        return _product_sum(self.state_weights, x).real + ahead + self.command_weight * d


def _scalar_product(a: list[float], b: list[float]) -> float:
    """Return the scalar product, summed in order."""
    total = 0.0
    for i, x in enumerate(a):
        total += x * b[i]
    return total


def _product_sum(a: list[complex], b: list[complex]) -> complex:
    """Return the product sum of two modal vectors in order, without conjugation."""
    total: complex = 0.0
    for i, x in enumerate(a):
        total += x * b[i]
    return total


def _product(factors: list[complex]) -> complex:
    product: complex = 1.0
    for factor in factors:
        product *= factor
    return product


def _separate_equal_poles(poles: Sequence[complex]) -> list[complex]:
    """Return the poles with equal ones moved slightly apart, because modes need different poles."""
    separate: list[complex] = []
    for pole in poles:
        while any(abs(pole - other) <= 1e-7 * abs(pole) for other in separate):
            pole *= 1.0 - 1e-5
        separate.append(pole)
    return separate


def _exponential(l1: float, l2: float, t: float) -> Matrix:
    """Return ``exp([[0, 1], [-l1 l2, l1 + l2]] t)``."""
    e1, e2 = np.exp(l1 * t), np.exp(l2 * t)
    if abs(l1 - l2) < 1e-9 * max(1.0, abs(l1)):
        return np.asarray(e1 * np.array([[1.0 - l1 * t, t], [-l1 * l1 * t, 1.0 + l1 * t]]))
    d = l1 - l2
    return np.asarray(np.array([[l1 * e2 - l2 * e1, e1 - e2], [l1 * l2 * (e2 - e1), l1 * e1 - l2 * e2]]) / d)


def _integral(l1: float, l2: float, t: float) -> Matrix:
    """Return the integral of :func:`_exponential` from 0 to ``t``, by its series: steps are short against modes."""
    M = np.array([[0.0, 1.0], [-l1 * l2, l1 + l2]])
    term = np.eye(2) * t
    total = term.copy()
    for n in range(2, 40):
        term = term @ M * (t / n)
        total += term
    return total
