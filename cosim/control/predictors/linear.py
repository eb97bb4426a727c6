"""The predictors as linear systems, for the design of loops: frequency response and state space.

``z`` are points on the upper half of the unit circle or outside it; ``y`` is the measured rate, ``u`` the command,
``y^ = P_y y + P_u u`` the predicted rate, all of the instant ``t_k``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, prod
from typing import Protocol

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.control.predictors.smith import robustness_filter
from cosim.control.predictors.state import LinearPredictor, Modes, modal_observer
from cosim.spec.vehicle import RateModel

Pair = tuple[Complex, Complex]
PairResponse = Callable[[Complex], Pair]  # (``P_y``, ``P_u``) over ``z``


def model_response(model: RateModel, z: Complex) -> Complex:
    """Return the identified response at ``z`` without its delay."""
    zeros = prod((z - zero for zero in model.all_zeros), start=np.ones_like(z))
    poles = prod((z - pole for pole in model.all_poles), start=np.ones_like(z))
    return np.asarray(model.gain * zeros / poles)


def delayed_response(model: RateModel, z: Complex) -> Complex:
    """Return the identified response at ``z`` with its delay of ``n + f`` samples, by the modified z-transform.

    >>> model = load_vehicle("hexjet")[0].identified["edf-as-flown"]["roll"]
    >>> z = np.exp(np.array([0.1j]))
    >>> print(np.angle(model_response(model, z) / delayed_response(model, z)).round(6), 0.1 * model.delay_samples)
    [2.5] 2.5
    """
    n = int(model.delay_samples)
    f = model.delay_samples - n
    if not f:
        return np.asarray(model_response(model, z) * z**-n)
    total = np.zeros_like(z)
    poles = model.all_poles
    for i, pole in enumerate(poles):
        others = poles[:i] + poles[i + 1 :]
        residue = model.gain * prod(pole - zero for zero in model.all_zeros) / prod(pole - other for other in others)
        weight = 1.0 - f if pole == 1.0 else (pole ** (1.0 - f) - 1.0) / (pole - 1.0)
        total += residue * (weight + (1.0 - weight) / z) / (z - pole)
    return np.asarray(total * z**-n)


def no_response(z: Complex) -> Pair:
    """Return ``P_y = 1`` and ``P_u = 0``, those of a loop without predictor."""
    return np.ones_like(z), np.zeros_like(z)


def smith_response(model: RateModel, filter_s: float | None = None) -> PairResponse:
    """Return ``P_y`` and ``P_u`` of Smith's predictor, filtered where ``filter_s`` is not None."""
    numerator, denominator = ([1.0], [1.0]) if filter_s is None else robustness_filter(model, filter_s)

    def compute_response(z: Complex) -> Pair:
        f = np.polyval(numerator, z) / np.polyval(denominator, z)
        return f, model_response(model, z) - f * delayed_response(model, z)

    return compute_response


def observer_response(model: RateModel, bandwidth: float, disturbance: bool) -> PairResponse:
    """Return ``P_y`` and ``P_u`` of a predictor with an observer, in closed form.

    The observer is a :class:`~cosim.control.predictors.state.ModelObserver`.  With ``x`` its state,
    ``M = (I - L C) F`` and ``v`` the contribution of each state to the rate after the delay,

        P_y = v z (z I - M)^-1 L,   P_u = sum_i c_i (1 - p_i^h D_i) / (z - p_i) + v (z I - M)^-1 (I - L C) D,

    ``D_i = z^-n (s_i + (1 - s_i) / z)`` the delay from a command to mode ``i``; ``det(z I - M) = (z - q)^n``, and the
    numerators come from Faddeev's recursion.
    """
    modes = Modes(model)
    step, order = model.sample_time_s, len(modes.poles)
    F, gain = modal_observer(modes, bandwidth, step, disturbance)
    n = len(F)
    c = np.zeros(n, F.dtype)
    c[:order] = modes.residues
    v = np.zeros(n, F.dtype)
    v[:order] = modes.state_weights()
    if disturbance:
        v[order] = modes.command_weight()
    correct = np.eye(n) - np.outer(gain, c)
    M = correct @ F
    denominator = np.poly([exp(-bandwidth * step)] * n)
    rows = []
    adjugate = np.eye(n, dtype=F.dtype)
    for k in range(n):
        rows.append(v @ adjugate)
        adjugate = M @ adjugate + denominator[k + 1] * np.eye(n)
    of_rate = [row @ gain for row in rows]
    of_mode = [[row @ correct[:, i] for row in rows] for i in range(order)]

    def compute_response(z: Complex) -> Pair:
        denominator_at = np.polyval(denominator, z)
        command = np.zeros_like(z)
        delay = z**-modes.whole
        for c_i, p, s, numerator in zip(modes.residues, modes.poles, modes.shares, of_mode, strict=True):
            input_delay = delay if s == 1.0 else delay * (s + (1.0 - s) / z)
            command += c_i * (1.0 - p**modes.delay * input_delay) / (z - p)
            command += np.polyval(numerator, z) / denominator_at * input_delay
        return np.asarray(z * np.polyval(of_rate, z) / denominator_at), command

    return compute_response


@dataclass(frozen=True)
class DelayedSystem:
    """``x' = A x + B v``, ``y' = C x'`` with inputs ``v`` delayed by whole samples.

    A delay of ``n + f`` samples has two inputs, of ``n`` and of ``n + 1`` samples ago.
    """

    A: Array
    B: Array  # one column per input
    C: Array
    delay: int


def make_delayed_system(model: RateModel) -> DelayedSystem:
    """Return the state space of a sampled response with its delay; mode by mode where the delay is not whole."""
    samples = int(model.delay_samples)
    if model.delay_samples == samples:
        A, B, C = cascade(model)
        return DelayedSystem(A, B[:, None], C, samples)
    modes = Modes(model)
    weights = np.array(modes.shares)
    A, B, C = real_form(np.diag(modes.poles), np.stack([weights, 1.0 - weights], axis=1), np.array(modes.residues))
    return DelayedSystem(A, B, C, samples)


def cascade(model: RateModel) -> tuple[Array, Array, Array]:
    """Return ``x_k+1 = A x_k + B u_k``, ``y_k = C x_k`` of a response without its delay, as a cascade of sections.

    One polynomial of six poles near 1 would lose most digits.
    """
    zeros, sections = [*model.all_zeros], []
    for pole in sorted((complex(p) for p in model.all_poles), key=abs):
        if pole.imag < 0.0:
            continue
        order = 2 if pole.imag else 1
        section_zeros = [zeros.pop() for _ in range(min(order, len(zeros)))]
        if len(section_zeros) == 1 and isinstance(section_zeros[0], complex) and section_zeros[0].imag:
            zeros.append(section_zeros.pop())  # keeps conjugate pairs together
        sections.append(_make_section(pole, np.real(np.poly(section_zeros)) if section_zeros else np.array([1.0])))
    if zeros:
        raise InputError(f"identified model: more pairs of zeros ({model.zero_pairs}) than pairs of poles take")
    A, B, C, D = sections[0]
    for a, b, c, d in sections[1:]:
        A = np.block([[A, np.zeros((len(A), len(a)))], [np.outer(b, C), a]])
        B, C, D = np.concatenate([B, b * D]), np.concatenate([d * C, c]), d * D
    return A, B, model.gain * C


def _make_section(pole: complex, numerator: Array) -> tuple[Array, Array, Array, float]:
    """Return the state space (A, B, C, D) of a section with a real pole or a conjugate pair, and a numerator."""
    re, im = pole.real, pole.imag
    size = abs(1.0 - pole) or 1.0  # scales the state to the input
    if not im:
        feedthrough = numerator[0] if len(numerator) == 2 else 0.0
        rest = numerator[-1] + feedthrough * re
        return np.array([[re]]), np.array([size]), np.array([rest / size]), float(feedthrough)
    denominator = np.array([1.0, -2.0 * re, re * re + im * im])
    numerator = np.concatenate([np.zeros(3 - len(numerator)), numerator])
    feedthrough = numerator[0]
    linear, constant = numerator[1:] - feedthrough * denominator[1:]
    C = np.array([(constant + linear * re) / im, linear]) / size
    return np.array([[re, im], [-im, re]]), np.array([0.0, size]), C, float(feedthrough)


def companion(numerator: Array, denominator: Array) -> tuple[Array, Array, Array]:
    """Return the companion form (A, B, C) of a strictly proper fraction of low order."""
    n = len(denominator) - 1
    A = np.eye(n, k=-1)
    A[0] = -denominator[1:]
    C = np.zeros(n)
    C[n - len(numerator) :] = numerator
    return A, np.eye(n)[:, 0], C


def real_form(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Replace adjacent conjugate states by their real and imaginary parts."""
    n = len(A)
    transform = np.eye(n, dtype=complex)
    i = 0
    while i < n:
        if i + 1 < n and A[i, i].imag:
            transform[i : i + 2, i : i + 2] = [[0.5, 0.5], [-0.5j, 0.5j]]
            i += 1
        i += 1
    inverse = np.linalg.inv(transform)
    return np.real(transform @ A @ inverse), np.real(transform @ B), np.real(C @ inverse)


Rows = Mapping[str, Array]
Keep = Callable[[str, Array], None]


class PredictorSpace(Protocol):
    """State space of a predictor, as a part of a closed loop.

    Signals are rows, their coefficients over all states and inputs of the loop: they add up like signals.
    """

    @property
    def history_length(self) -> int:
        """Number of past commands that the predictor uses."""

    @property
    def states(self) -> Mapping[str, int]:
        """Names of the predictor's states, with their sizes."""

    def predicted(self, measured: Array, x: Rows, keep: Keep) -> Array:
        """Return the predicted rate, once a step, before the command of the step is known.

        ``x["sent"]`` are the past commands, the last first; ``keep`` stores the next value of a state.
        """

    def apply_command(self, command: Array, x: Rows, keep: Keep) -> None:
        """Update the states by the command of the step, after :meth:`predicted`."""


class NoSpace:
    """State space without predictor: the measured rate is fed back."""

    history_length = 1
    states: Mapping[str, int] = {}

    def predicted(self, measured: Array, x: Rows, keep: Keep) -> Array:
        return measured

    def apply_command(self, command: Array, x: Rows, keep: Keep) -> None:
        """Do nothing, as there is no state."""


class SmithSpace:
    """State space of Smith's predictor or, with a filter time constant, of the filtered one."""

    def __init__(self, model: RateModel, filter_s: float | None = None) -> None:
        self.history_length = int(model.delay_samples) + 2
        self._now, self._then = cascade(model), make_delayed_system(model)
        self.states = {"now": len(self._now[0]), "then": len(self._then.A)}
        self._filter: tuple[Array, Array] | None = None
        if filter_s is not None:
            numerator, denominator = robustness_filter(model, filter_s)
            self._filter = (np.array(numerator), np.array(denominator))
            self.states["filter"] = len(denominator) - 1

    def predicted(self, measured: Array, x: Rows, keep: Keep) -> Array:
        now = self._now[2] @ x["now"]
        error = measured - self._then.C @ x["then"]
        if self._filter is not None:
            numerator, denominator = self._filter
            A, B, C = companion(numerator[1:] - numerator[0] * denominator[1:], denominator)
            keep("filter", A @ x["filter"] + np.outer(B, error))
            error = C @ x["filter"] + numerator[0] * error
        return np.asarray(now + error)

    def apply_command(self, command: Array, x: Rows, keep: Keep) -> None:
        A, B, _ = self._now
        keep("now", A @ x["now"] + np.outer(B, command))
        then, line = self._then, [command, *x["sent"]]
        entering = [line[then.delay + k] for k in range(then.B.shape[1])]
        keep("then", then.A @ x["then"] + then.B @ np.vstack(entering))


class ObserverSpace:
    """An observer of the identified model, and the model predicted over the delay."""

    def __init__(self, model: RateModel, bandwidth: float, disturbance: bool) -> None:
        self.history_length = int(model.delay_samples) + 2
        modes = Modes(model)
        F, gain = modal_observer(modes, bandwidth, model.sample_time_s, disturbance)
        n = len(modes.poles)
        size = n + 1 if disturbance else n
        weights = np.zeros((size, 2), complex)
        weights[:n, 0] = modes.shares
        weights[:n, 1] = 1.0 - weights[:n, 0]
        output, prediction = np.zeros(size, complex), np.zeros(size, complex)
        output[:n], prediction[:n] = modes.residues, modes.state_weights()
        if disturbance:
            prediction[n] = modes.command_weight()
        entering = np.concatenate([weights, np.asarray(gain)[:, None]], axis=1)
        A, B, C = real_form(F, entering, np.vstack([output, prediction]))
        self._observer = (A, B[:, :2], B[:, 2], C[0], C[1])
        samples, f = modes.whole, modes.delay - modes.whole
        poles, residues = np.array(modes.poles), np.array(modes.residues)
        # Newest first: one weight per whole step, the last one for the fraction.
        on_the_way = [np.sum(residues * poles**j).real for j in range(samples)]
        part_of = np.array([f if p == 1.0 else (p**f - 1.0) / (p - 1.0) for p in modes.poles])
        on_the_way.append(np.sum(residues * poles**samples * part_of).real)
        self._on_the_way = np.array(on_the_way)
        self.states = {"observer": size}

    def predicted(self, measured: Array, x: Rows, keep: Keep) -> Array:
        A, B, gain, output, prediction = self._observer
        sent, samples = x["sent"], len(self._on_the_way) - 1
        state = A @ x["observer"] + B @ sent[samples : samples + 2]
        state = state + np.outer(gain, measured - output @ state)
        keep("observer", state)
        return np.asarray(prediction @ state + self._on_the_way @ sent[: samples + 1])

    def apply_command(self, command: Array, x: Rows, keep: Keep) -> None:
        """Do nothing, as it uses the past commands."""


def linear_response(predictor: LinearPredictor) -> PairResponse:
    """Return ``P_y`` and ``P_u`` of a predictor that is stated as matrices.

    ``P_y = c (I - F / z)^-1 g``, and ``P_u`` the same of ``h`` behind the oldest of the ``n`` commands that it keeps,
    ``z^-n``, with what it weighs each of them by.
    """
    transition, entering = np.array(predictor.transition), np.stack([predictor.of_rate, predictor.of_command], axis=1)
    of_state, weights = np.array(predictor.of_state), np.array(predictor.weights)

    def compute_response(z: Complex) -> Pair:
        states = np.linalg.solve(np.eye(len(of_state)) - transition / z[:, None, None], entering.astype(complex))
        of_rate, of_late = (of_state @ states).T
        return np.asarray(of_rate), np.asarray(of_late * z ** -len(weights) + np.polyval([*weights, 0.0], 1.0 / z))

    return compute_response


class LinearSpace:
    """A predictor that is stated as matrices."""

    def __init__(self, predictor: LinearPredictor) -> None:
        self._transition, self._of_state = np.array(predictor.transition), np.array(predictor.of_state)
        self._of_rate, self._of_command = np.array(predictor.of_rate), np.array(predictor.of_command)
        self._weights = np.array(predictor.weights[::-1])  # newest command last
        self.history_length = len(self._weights)
        self.states = {"predictor": len(self._of_state)}

    def predicted(self, measured: Array, x: Rows, keep: Keep) -> Array:
        sent = x["sent"][: self.history_length]
        state = self._transition @ x["predictor"]
        state = state + np.outer(self._of_rate, measured) + np.outer(self._of_command, sent[-1])
        keep("predictor", state)
        return np.asarray(self._of_state @ state + self._weights @ sent)

    def apply_command(self, command: Array, x: Rows, keep: Keep) -> None:
        """Do nothing, as it uses the past commands."""
