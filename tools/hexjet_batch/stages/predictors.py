"""The predictors over a batch: Smith's, the filtered one, and those with an observer, in two forms of numbers.

A predictor's numbers come from the predictor that flies in JSBSim (:mod:`cosim.control.predictors`), so that both use
the same ones.  ``update(state, k, measured, applied)`` gives its next state and the rate to feed back [rad/s].
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import InputError
from cosim.control.predictors.smith import (
    DelayedModel,
    DiscreteModel,
    FilteredSmithPredictor,
    NoPredictor,
    SmithPredictor,
)
from cosim.control.predictors.state import DoubleIntegratorObserver, ModalPredictor, ModelObserver, StatePredictor
from hexjet_batch.numbers import is_absent
from hexjet_batch.stages.delays import make_ring, push, put

Row = tuple[Any, ...]


class Difference(NamedTuple):
    """A strictly proper transfer function in z as a difference equation: numerator and denominator less its first."""

    b: Row
    a: Row

    def update(self, past: Row, applied: Any) -> tuple[Row, Any]:
        """Return the next state and the output, in transposed direct form."""
        a, b = self.a, self.b
        value = past[0] + b[0] * applied
        moved = [past[i + 1] + b[i + 1] * applied - a[i] * value for i in range(len(a) - 1)]
        return (*moved, -a[-1] * value), value


class SmithNumbers(NamedTuple):
    """Smith's predictor ``y + G u - z^-h G u``, with a filter of the difference where ``filter`` has numbers.

    ``late``: the model with the fraction of its delay in it, None where the delay is a whole number of steps.
    """

    model: Difference
    late: Difference | None
    delay: Any
    through: Any = 1.0
    filter: Difference | None = None

    def start(self, zero: Any, xp: Any) -> Any:
        """Return the state at rest."""
        rest = [() if part is None else (zero,) * len(part.a) for part in (self.model, self.late, self.filter)]
        return (*rest, make_ring(self.delay, zero, xp), zero)

    def update(self, state: Any, k: Any, measured: Any, applied: Any, xp: Any) -> tuple[Any, Any]:
        past, late, filtered, ring, before = state
        past, now = self.model.update(past, applied)
        then = now
        if self.late is not None:
            late, then = self.late.update(late, applied)
        ring, then = push(ring, k, self.delay, then, xp)
        predicted = measured + (now - then)
        if self.filter is not None:
            difference = measured - then
            filtered, smooth = self.filter.update(filtered, before)
            predicted = predicted + (smooth + self.through * difference - difference)
            before = difference
        return (past, late, filtered, ring, before), predicted


class ObserverNumbers(NamedTuple):
    """An observer of the present state and the model run over the delay: any predictor that is linear in both.

    ``x- = F x + before u_-1 + now u_0`` with the two oldest commands in transport, ``x = x- + gain (y - output x-)``,
    and the answer ``of_state x + weights u``; ``weights`` are of the commands in transport, the oldest first.
    """

    transition: tuple[Row, ...]
    before: Row
    now: Row
    output: Row
    gain: Row
    of_state: Row
    weights: Row

    def start(self, zero: Any, xp: Any) -> Any:
        """Return the state at rest, with no command in transport."""
        weights = xp.stack([xp.asarray(weight) for weight in self.weights * 2])
        return (zero,) * len(self.gain), xp.stack([zero] * len(self.weights)), weights

    def update(self, state: Any, k: Any, measured: Any, applied: Any, xp: Any) -> tuple[Any, Any]:
        x, ring, weights = state
        rows = len(self.weights)
        ring = put(ring, k % rows, applied)
        first, second = ring[(k + 1) % rows], ring[(k + 2) % rows]
        ahead = [
            _sum_of_products((*row, before, now), (*x, first, second))
            for row, before, now in zip(self.transition, self.before, self.now, strict=True)
        ]
        error = measured - _sum_of_products(self.output, ahead)
        x = tuple(value + gain * error for value, gain in zip(ahead, self.gain, strict=True))
        # The weights in the order of the ring, from two turns of them: what NumPy takes without a copy.
        begin = (-k - 1) % rows
        own = weights[begin : begin + rows] if isinstance(k, int) else xp.roll(weights, -begin, axis=0)[:rows]
        # By no library of linear algebra, whose sums differ with the number of flights.
        in_transport = xp.einsum("i...,i...->...", own, ring)
        return (x, ring, weights), _sum_of_products(self.of_state, x) + in_transport


class Mixed(NamedTuple):
    """Predictors of several kinds, each with the flights that have it, which follow each other; None: no predictor."""

    kinds: list[tuple[Any, slice]]

    def start(self, zero: Any, xp: Any) -> Any:
        """Return the states at rest."""
        return tuple(None if kind is None else kind.start(zero[own], xp) for kind, own in self.kinds)

    def update(self, state: Any, k: Any, measured: Any, applied: Any, xp: Any) -> tuple[Any, Any]:
        """Return the next states and the rates to feed back, of all flights."""
        found = [
            (s, measured[own]) if kind is None else kind.update(s, k, measured[own], applied[own], xp)
            for (kind, own), s in zip(self.kinds, state, strict=True)
        ]
        states, rates = zip(*found, strict=True)
        return states, xp.concat(rates)


def mix(predictors: Sequence[tuple[Any, ...]], counts: Sequence[int]) -> tuple[Any, ...]:
    """Return the predictors of the axes of flights of several kinds, of each kind so many flights."""
    if len(predictors) == 1:
        return predictors[0]
    own = [slice(end - count, end) for count, end in zip(counts, accumulate(counts), strict=True)]
    return tuple(Mixed(list(zip(axis, own, strict=True))) for axis in zip(*predictors, strict=True))


def _sum_of_products(factors: Any, values: Any) -> Any:
    """Return the sum of products, without those that are 0 in every flight."""
    terms = [factor * value for factor, value in zip(factors, values, strict=True) if not is_absent(factor)]
    return sum(terms[1:], terms[0]) if terms else 0.0


def read_predictor(predictor: object, where: str) -> SmithNumbers | ObserverNumbers | None:
    """Return the numbers of a predictor, None of none.  Raises InputError for one that a batch has not."""
    if isinstance(predictor, NoPredictor):
        return None
    if isinstance(predictor, (SmithPredictor, FilteredSmithPredictor)):
        model, then = _make_difference_equation(predictor.now), predictor.then
        late = _make_difference_equation(then.model) if isinstance(then, DelayedModel) else None
        delay = then.line.samples if isinstance(then, DelayedModel) else then.samples
        if isinstance(predictor, SmithPredictor):
            return SmithNumbers(model, late, delay)
        rest = None if predictor.rest is None else _make_difference_equation(predictor.rest)
        return SmithNumbers(model, late, delay, predictor.through, rest)
    if isinstance(predictor, StatePredictor):
        return _state_predictor_numbers(predictor)
    if isinstance(predictor, ModalPredictor) and not any(isinstance(pole, complex) for pole in predictor.poles):
        return _modal_predictor_numbers(predictor)
    raise InputError(f"{where}: {type(predictor).__name__} is not flown in a batch; fly it without batch")


def _make_difference_equation(model: DiscreteModel) -> Difference:
    return Difference(tuple(model.b), tuple(model.a))


def _state_predictor_numbers(predictor: StatePredictor) -> ObserverNumbers:
    observer, f = predictor.observer, predictor.f
    of_state, weights = tuple(predictor.of_state), tuple(predictor.weights)
    if isinstance(observer, DoubleIntegratorObserver):
        a, b, c, d = observer.transition
        of_x, of_v = observer.of_command
        now = ((1.0 - f) * of_x, (1.0 - f) * of_v)
        gain = tuple(observer.of_rate)
        return ObserverNumbers(((a, b), (c, d)), (f * of_x, f * of_v), now, (0.0, 0.0), gain, of_state, weights)
    assert isinstance(observer, ModelObserver)
    old_x, new_x, old_v, new_v = predictor.push
    rest = (0.0,) if observer.with_disturbance else ()
    of_disturbance = (predictor.of_disturbance,) if observer.with_disturbance else ()
    transition = tuple(tuple(row) for row in observer.F)
    before, now, output = (old_x, old_v, *rest), (new_x, new_v, *rest), (1.0, 0.0, *rest)
    return ObserverNumbers(transition, before, now, output, tuple(observer.gain), of_state + of_disturbance, weights)


def _modal_predictor_numbers(predictor: ModalPredictor) -> ObserverNumbers:
    def real_parts(values: Any) -> Row:
        return tuple(float(complex(value).real) for value in values)

    poles, shares, estimates = real_parts(predictor.poles), real_parts(predictor.shares), predictor.with_disturbance
    order, rest = len(poles), (0.0,) if estimates else ()
    rows = np.diag([*poles, *(1.0 for _ in rest)])
    rows[:order, order:] = 1.0
    return ObserverNumbers(
        tuple(map(tuple, rows.tolist())),
        tuple(1.0 - share for share in shares) + rest,
        shares + rest,
        real_parts(predictor.residues) + rest,
        real_parts(predictor.gain)[: order + estimates],
        real_parts(predictor.state_weights) + ((predictor.command_weight,) if estimates else ()),
        tuple(predictor.weights),
    )
