"""Prediction-error identification of one input and one output, with a delay, from stretches of a flight's log.

The model is ``y(t) = g(t) * u(t - delay) + offset + what was under way + v(t)`` with ``g`` of
``gain / ((s + rate) prod(lag s + 1))``, a command that is held between its values, and an error ``v`` that is
autoregressive: ``A(q) v = e``, ``e`` white.  All of it is estimated together by Gauss and Newton's method on the sum of
``e^2``, which is the likelihood of normal errors (Ljung, System Identification, 2nd ed., chapters 7 and 10).

What that gives and what it does not:

- The output of the model is evaluated at the very times at which samples were taken, in closed form between the
  changes of the command.  A delay of a fraction of a sample, jitter and lost samples need no interpolation.
- In a closed loop the command contains the output's noise.  The direct method is consistent there if the model of the
  noise is rich enough (Ljung, section 13.4), and biased otherwise; so the order of ``A`` is chosen by Akaike's
  criterion out of a long list, as long as delay and lags at least, and what is left is tested for whiteness and against
  the set-point, which contains no noise.  In the loop the parameters of ``g`` and ``A`` are not independent: the bounds
  are those of both together.
- The bounds of the delay are those of its profile likelihood, all other parameters estimated anew at each delay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.prediction_error.estimate import Estimate, Form, spread
from hexjet_identify.prediction_error.problem import (
    LEAST_VALID,
    LONGEST_LAG_S,
    NEGLIGIBLE,
    Problem,
    least_squares,
    shift,
    whiten,
)

_STEPS = 25  # of Gauss and Newton
_TOLERANCE = 1e-6  # relative fall of the sum of squares that ends them: 0.01 of the deviance of 10,000 equations
_START_LAGS = (0.5, 2.0, 8.0, 32.0)  # samples, where the search begins
_START_RATE = 0.3  # 1/s, of an axis
_STARTS_FOLLOWED = 2  # starts of each kind that are followed to their end
_DIFFERENCE = 0.98  # 1 but for a constant, which it would not see


class Point(NamedTuple):
    """Parameters, and the residuals of the model with them."""

    x: Array
    linear: Array
    ar: Array
    columns: Array
    error: Array  # v
    white: Array  # e, of the equations alone
    loss: float  # sum of e^2


def evaluate(problem: Problem, form: Form, x: Array, linear: Array, ar: Array) -> Point:
    """Return the point of these parameters."""
    columns = problem.columns(form, x)
    error = problem.error(columns, linear)
    white = whiten(error, ar)[problem.equations(len(ar))]
    return Point(x, linear, ar, columns, error, white, float(white @ white))


def jacobian_at(problem: Problem, form: Form, point: Point, free: Sequence[int]) -> Array:
    """Return the slopes of e by the free ones of x, the linear parameters and the terms of A."""
    x, ar, use = point.x, point.ar, problem.equations(len(point.ar))
    high = problem.limits(form)[1]
    scale = _difference_steps(problem, x)
    blocks = []
    for i in free:
        aside = x.copy()
        aside[i] += scale[i] if x[i] + scale[i] <= high[i] else -scale[i]
        slope = (problem.columns(form, aside) - point.columns) @ point.linear / (aside[i] - x[i])
        blocks.append(-whiten(slope, ar)[use])
    by_linear = -whiten(point.columns, ar)[use]
    late = np.stack([shift(point.error, i) for i in range(1, len(ar) + 1)], axis=1)[use]
    return np.column_stack([*blocks, by_linear, late @ spread(len(ar))])


def fit(
    problem: Problem, form: Form, keep: Mapping[str, float] | None = None, near: Estimate | None = None
) -> Estimate:
    """Return the estimate from the best of the starts, without bounds of the delay; ``near``: of a lag less.

    Raises InputError for an unknown name in ``keep``.
    """
    keep = keep or {}
    for name in keep:
        if name not in form.names:
            raise InputError(f"hold {name}: not a parameter of this form; allowed: {', '.join(form.names)}")
    fixed = [form.names.index(name) for name in keep]
    tried = []
    fixed_values = dict(zip(fixed, keep.values(), strict=True))
    for x, ar in _starts(problem, form, fixed_values) if near is None else _starts_with_a_lag(near):
        x[fixed] = list(keep.values())
        tried.append(solve(problem, form, x, ar, fixed, len(ar)))
    best = min(tried, key=lambda estimate: estimate.loss)
    # Two forms are compared on the same equations, which the order of A decides.
    order = None if near is None else near.order
    return replace(solve(problem, form, best.x, best.ar, fixed, order), fixed=tuple(keep))


def solve(
    problem: Problem, form: Form, x: Array, ar: Array, fixed: Sequence[int] = (), order: int | None = None
) -> Estimate:
    """Return the estimate nearest to ``x``, the parameters ``fixed`` kept, for an order of A or the best one."""
    estimate = None
    for _ in range(1 if order is not None else 3):
        linear = problem.linear(form, x, ar)
        error = problem.error(problem.columns(form, x), linear)
        chosen = order if order is not None else problem.best_order(error, float(x[1:].sum()))
        if estimate is not None and chosen == estimate.order:
            break
        ar = problem.noise(error, chosen)
        estimate = _newton(problem, form, (x, linear, ar), fixed)
        x, ar = estimate.x, estimate.ar
    assert estimate is not None
    return estimate


# ---- the start


def _starts(problem: Problem, form: Form, fixed: Mapping[int, float]) -> list[tuple[Array, Array]]:
    """Return where the search begins, x and A: the best of the lags that are tried.

    A is that of a long ARX model, which is consistent in a loop too, and a plain difference, where there is so little
    noise that such a model has nothing to fit.
    """
    arx = _arx(problem)
    plain = np.zeros(len(arx))
    plain[0] = -_DIFFERENCE
    starts = [(x, arx) for x in _best_delays(problem, form, arx)[:_STARTS_FOLLOWED]]
    solved = []
    for x in _best_delays(problem, form, plain):
        x[list(fixed)] = list(fixed.values())
        solved.append(_newton(problem, form, (x, problem.linear(form, x, plain), plain), list(fixed), noise=False))
    solved.sort(key=lambda estimate: estimate.loss)
    return starts + [(estimate.x, plain) for estimate in solved[:_STARTS_FOLLOWED]]


def _best_delays(problem: Problem, form: Form, ar: Array) -> list[Array]:
    """Return a start for each lag, at its best delay, the best first."""
    use = problem.equations(len(ar))
    output = whiten(problem.output, ar)[use]
    starts: list[tuple[float, Array]] = []
    delays = np.arange(0.0, problem.longest_delay + 0.5 * problem.working_step, max(problem.working_step, 1e-3))
    for lag in _START_LAGS:
        lag_s = min(lag * problem.working_step, 0.5 * LONGEST_LAG_S)
        rate = 1.0 / lag_s if form.engine else _START_RATE
        lags = [(0.3 if form.engine else 1.0) * lag_s * 0.6**i for i in range(form.lags)]
        frame, won = None, []
        for delay in delays:
            columns = problem.columns(form, np.array([rate, *lags, delay]))
            if frame is None:  # what is not the answer does not depend on the delay
                frame = np.linalg.qr(whiten(columns[:, 1:], ar)[use])[0]
                residual = output - frame @ (frame.T @ output)
            answer = whiten(columns[:, 0], ar)[use]
            answer = answer - frame @ (frame.T @ answer)
            power = float(answer @ answer)
            won.append(float(answer @ residual) ** 2 / power if power > 0.0 else 0.0)
        best = int(np.argmax(won))
        starts.append((won[best], np.array([rate, *lags, delays[best]])))
    starts.sort(key=lambda start: -start[0])
    return [x for _, x in starts]


def _arx(problem: Problem, order: int = 12) -> Array:
    """Return A of ``A y = B u + e`` with as many terms of B as the longest delay has samples."""
    commands = []
    for stretch in problem.stretches:
        at = np.arange(stretch.blocks, dtype=np.float64) * problem.working_step
        commands += [stretch.commanded(at), np.zeros(problem.gap)]
    command = np.concatenate(commands)
    while order > 1 and problem.equations(order).sum() < LEAST_VALID * problem.samples:
        order -= 1
    use = problem.equations(order)
    taps = min(round(1.3 * problem.longest_delay / problem.working_step) + 1, int(use.sum()) // 4)
    offsets = np.concatenate([np.full(s.blocks + problem.gap, n) for n, s in enumerate(problem.stretches)])
    columns = [shift(problem.output, i) for i in range(1, order + 1)]
    columns += [shift(command, i) for i in range(max(taps, 1))]
    columns += [(offsets == n).astype(np.float64) for n in range(len(problem.stretches))]
    matrix = np.stack(columns, axis=1)[use]
    return -least_squares(matrix, problem.output[use])[:order]


def _starts_with_a_lag(near: Estimate) -> list[tuple[Array, Array]]:
    """Return where the search for a form with a lag more begins: that lag shorter or as long, out of the delay."""
    last = float(near.x[-2]) if near.form.lags else 1.0 / float(near.x[0])
    starts = []
    for fraction in (0.2, 1.0):
        lag = fraction * last
        starts.append((np.array([*near.x[:-1], lag, max(near.delay - lag, 0.0)]), near.ar))
    return starts


# ---- the steps


def _newton(
    problem: Problem, form: Form, start: tuple[Array, Array, Array], fixed: Sequence[int], noise: bool = True
) -> Estimate:
    """Return the estimate at the end of damped steps down from x, linear and A; without ``noise`` A is kept."""
    x, linear, ar = start
    low, high = problem.limits(form)
    free = [i for i in range(len(x)) if i not in fixed]
    point = evaluate(problem, form, np.clip(x, low, high), linear, ar)
    damping = 0.0
    for _ in range(_STEPS):
        size, gram, right = _normal_equations(problem, form, point, free, noise)
        fell = 0.0
        for _ in range(12):
            step = np.linalg.lstsq(gram + damping * np.eye(len(gram)), right, rcond=1e-13)[0] / size
            tried = evaluate(problem, form, *_move(point, step, free, (low, high)))
            if tried.loss <= point.loss:
                fell = (point.loss - tried.loss) / max(point.loss, 1e-300)
                point = tried
                damping *= 0.1
                break
            damping = max(10.0 * damping, 1e-6)
        if fell < _TOLERANCE:
            break
    return _estimate(problem, form, point, free)


def _normal_equations(
    problem: Problem, form: Form, point: Point, free: list[int], noise: bool
) -> tuple[Array, Array, Array]:
    """Return the columns' sizes, and both sides of the normal equations of the columns brought to one size."""
    jacobian = jacobian_at(problem, form, point, free)
    low, high = problem.limits(form)
    size = _column_sizes(jacobian)
    scaled = jacobian / size
    right = -scaled.T @ point.white
    if not noise:
        first = len(free) + len(point.linear)
        scaled[:, first:], right[first:] = 0.0, 0.0
    for n, i in enumerate(free):  # what stands at its limit and would go beyond it stays there
        if (point.x[i] <= low[i] and right[n] < 0.0) or (point.x[i] >= high[i] and right[n] > 0.0):
            scaled[:, n], right[n] = 0.0, 0.0
    return size, scaled.T @ scaled, right


def _move(point: Point, step: Array, free: list[int], limits: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Return x, linear and A a step on, x within its limits."""
    terms = spread(len(point.ar))
    x = point.x.copy()
    x[free] += step[: len(free)]
    linear = point.linear + step[len(free) : -terms.shape[1]]
    return np.clip(x, *limits), linear, point.ar + terms @ step[-terms.shape[1] :]


def _difference_steps(problem: Problem, x: Array) -> Array:
    """Return how far each parameter is moved for its derivative."""
    steps = 1e-3 * np.maximum(np.abs(x), 1e-3)
    steps[0] = 1e-3 * max(x[0], 0.1)
    steps[-1] = 0.05 * problem.working_step
    return np.asarray(steps)


def _column_sizes(jacobian: Array) -> Array:
    size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    size[size < NEGLIGIBLE] = 1.0
    return np.asarray(size)


def _estimate(problem: Problem, form: Form, point: Point, free: list[int]) -> Estimate:
    """Return the point as an estimate, with its covariance."""
    x, count = point.x, int(problem.equations(len(point.ar)).sum())
    jacobian = jacobian_at(problem, form, point, free)
    low, high = problem.limits(form)
    # A slow pole that ended at 0 is uncertain as any other, and the gain with it: kept there both look surer than
    # they are.
    within = [n for n, i in enumerate(free) if low[i] < x[i] < high[i] or (i == 0 and not form.engine)]
    determined = [*within, *range(len(free), jacobian.shape[1])]
    size = _column_sizes(jacobian)
    scaled = (jacobian / size)[:, determined]
    variance = point.loss / max(count - len(determined), 1)
    inverse = variance * np.linalg.pinv(scaled.T @ scaled, rcond=1e-13)
    linear_count = jacobian.shape[1] - len(free)
    rows = [free[n] for n in within] + [len(x) + n for n in range(linear_count)]
    covariance = np.zeros((len(x) + linear_count,) * 2)
    covariance[np.ix_(rows, rows)] = inverse / np.outer(size[determined], size[determined])
    gain, order = float(point.linear[0]), len(point.ar)
    return Estimate(form, x, gain, order, point.ar, point.linear, point.loss, count, covariance, tuple(free))
