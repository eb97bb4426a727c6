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
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import exp, log, prod

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.design.identify.fit import apart

ORDERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 52, 64, 80, 100, 128, 160)  # of A, tried
EACH = 20  # terms of A that are each estimated; those beyond are linear between the orders above; chosen by us
LEAST_VALID = 0.4  # share of the equations that lost samples may leave, which bounds the order
CHI2_95 = 3.841458820694124  # of one degree of freedom
MIXED_95 = 5.1383807853214485  # of an even mixture of chi-squared of one and of two degrees of freedom
SHORTEST_LAG = 0.002  # of a sample
LONGEST_LAG_S = 5.0
FASTEST = 20.0  # 1/s: the slow pole of an axis, at most
LEAST_BLOCKS = 3  # times the parameters: fewer blocks do not tell a covariance; chosen by us
_STEPS = 25  # of Gauss and Newton
_TOLERANCE = 1e-6  # relative fall of the sum of squares that ends them: 0.01 of the deviance of 10,000 equations
_START_LAGS = (0.5, 2.0, 8.0, 32.0)  # samples, where the search begins
_START_RATE = 0.3  # 1/s, of an axis
_STARTS_FOLLOWED = 2  # starts of each kind that are followed to their end
_DIFFERENCE = 0.98  # 1 but for a constant, which it would not see
_NEGLIGIBLE = 1e-150  # of a column's size: its square would be none
_CACHE_SIZE = 8  # answers that are remembered

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Stretch:
    """One stretch of a log without a break; times in s from its beginning.

    ``command[k]`` acts over ``[k step, (k + 1) step)``.  Sample ``i`` of the output was taken at ``times[i]`` and
    counts to number ``block[i]`` of ``blocks`` working samples, each the mean of its samples.
    """

    start: float  # in the time of the log
    step: float
    command: Array
    times: Array
    output: Array
    block: Ints
    blocks: int

    @property
    def seconds(self) -> float:
        """Its duration."""
        return len(self.command) * self.step

    @cached_property
    def _counts(self) -> Array:
        return np.bincount(self.block, minlength=self.blocks).astype(np.float64)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """The working samples that there are."""
        return self._counts > 0.0

    def commanded(self, times: Array) -> Array:
        """The command that acts at these times."""
        return self.command[self._cell(times)]

    def _cell(self, times: Array) -> Ints:
        return np.clip((times / self.step).astype(np.int64), 0, len(self.command) - 1)

    def averaged(self, values: Array) -> Array:
        """The mean over each working sample, 0 for one that there is not."""
        return np.bincount(self.block, values, minlength=self.blocks) / np.maximum(self._counts, 1.0)

    def answer(self, pole: float, delay: float) -> Array:
        """Of ``1 / (s + pole)`` to the delayed command at ``times``, from rest at the first value."""
        states = self._states(pole)
        cell, within, begun = self._late(delay)
        fade = np.exp(-pole * within)
        held = (1.0 - fade) / pole if pole > 1e-6 else within
        return np.asarray((states[cell] * fade + held * self.command[cell]) * begun)

    @cached_property
    def _kept(self) -> tuple[dict[float, Array], dict[float, tuple[Ints, Array, Array]]]:
        """What was computed lately: a derivative changes one parameter at a time."""
        return {}, {}

    def _states(self, pole: float) -> Array:
        from scipy.signal import lfilter

        kept = self._kept[0]
        if pole not in kept:
            if len(kept) >= _CACHE_SIZE:
                kept.pop(next(iter(kept)))
            states = lfilter([float(_held(pole, self.step))], [1.0, -exp(-pole * self.step)], self.command)
            kept[pole] = np.concatenate([[0.0], states])
        return kept[pole]

    def _late(self, delay: float) -> tuple[Ints, Array, Array]:
        """The cell of each sample, less the delay, the time within it, and 0 where that is before the stretch."""
        kept = self._kept[1]
        if delay not in kept:
            if len(kept) >= _CACHE_SIZE:
                kept.pop(next(iter(kept)))
            late = self.times - delay
            cell = self._cell(late)
            kept[delay] = cell, late - cell * self.step, (late > 0.0).astype(np.float64)
        return kept[delay]


def _held(pole: float, seconds: float | Array) -> Array:
    """The answer of ``1 / (s + pole)`` to a command of 1 over so long."""
    return np.asarray(-np.expm1(-pole * seconds) / pole if pole > 1e-6 else seconds)


@dataclass(frozen=True)
class Form:
    """What is fitted: an engine (its pole is fast and its gain that at rest), or an axis (its pole is slow)."""

    engine: bool
    lags: int  # beside the pole

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that do not enter linearly: pole, lags, delay [s]."""
        lags = (f"lag_{i + 1}_s" if i else "lag_s" for i in range(self.lags))
        return ("rate_1_s", *lags, "delay_s")

    @property
    def label(self) -> str:
        """In words."""
        count = self.lags + 1 if self.engine else self.lags
        return f"{count} lag" if count == 1 else f"{count} lags"


@dataclass(frozen=True)
class Estimate:
    """What came out, with the sums on which its bounds rest."""

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
    held: tuple[str, ...] = ()
    delay_bounds: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def delay(self) -> float:
        """The delay [s]."""
        return float(self.x[-1])

    @property
    def parameters(self) -> int:
        """How many were estimated."""
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
        """Standard deviation of ``x[index]``, by the linearised problem."""
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


@dataclass
class Problem:
    """The stretches, put one behind the other with gaps that no equation bridges."""

    stretches: Sequence[Stretch]
    working_step: float
    longest_delay: float
    gap: int = field(default=max(ORDERS) + 1)

    def __post_init__(self) -> None:
        parts, marks = [], []
        for stretch in self.stretches:
            parts += [np.where(stretch.present, stretch.averaged(stretch.output), 0.0), np.zeros(self.gap)]
            marks += [stretch.present, np.zeros(self.gap, bool)]
        self.output = np.concatenate(parts)
        self.present = np.concatenate(marks)
        self.samples = int(self.present.sum())

    # ---- the model's parts

    def columns(self, form: Form, x: Array) -> Array:
        """What the linear parameters multiply: the answer, and for each stretch an offset and what was under way."""
        rate, lags, delay = float(x[0]), x[1:-1], float(x[-1])
        poles = apart([rate, *(1.0 / lag for lag in lags)])
        scale = (rate if form.engine else 1.0) / prod(lags)
        shares = [scale / prod(other - pole for other in poles if other != pole) for pole in poles]
        made = np.zeros((len(self.output), 1 + 2 * len(self.stretches)))
        row = 0
        for n, stretch in enumerate(self.stretches):
            rows = slice(row, row + stretch.blocks)
            answer = np.zeros(len(stretch.times))
            for share, pole in zip(shares, poles, strict=True):
                answer += share * stretch.answer(pole, delay)
            made[rows, 0] = stretch.averaged(answer)
            made[rows, 1 + 2 * n] = stretch.present
            under_way = np.exp(-rate * stretch.times) if form.engine else _held(rate, stretch.times)
            made[rows, 2 + 2 * n] = stretch.averaged(under_way)
            row += stretch.blocks + self.gap
        return made

    def equations(self, order: int) -> NDArray[np.bool_]:
        """The rows whose ``order`` predecessors are all there."""
        missing = np.convolve((~self.present).astype(np.float64), np.ones(order + 1))[: len(self.present)]
        use = missing < 0.5
        use[:order] = False
        return np.asarray(use)

    # ---- the start

    def starts(self, form: Form, held: Mapping[int, float]) -> list[tuple[Array, Array]]:
        """Where the search begins, x and A: the best of the lags tried, with A of a long ARX model, which is consistent
        in a loop too, and with a plain difference, where there is so little noise that such a model has nothing to fit.
        """
        arx = self._arx()
        plain = np.zeros(len(arx))
        plain[0] = -_DIFFERENCE
        starts = [(x, arx) for x in self._starts(form, arx)[:_STARTS_FOLLOWED]]
        kept = []
        for x in self._starts(form, plain):
            x[list(held)] = list(held.values())
            kept.append(self._newton(form, x, self._linear(form, x, plain), plain, list(held), noise=False))
        kept.sort(key=lambda estimate: estimate.loss)
        starts += [(estimate.x, plain) for estimate in kept[:_STARTS_FOLLOWED]]
        return starts

    def _starts(self, form: Form, ar: Array) -> list[Array]:
        """The best first, one for each lag."""
        use = self.equations(len(ar))
        output = _whitened(self.output, ar)[use]
        starts: list[tuple[float, Array]] = []
        delays = np.arange(0.0, self.longest_delay + 0.5 * self.working_step, max(self.working_step, 1e-3))
        for lag in _START_LAGS:
            lag_s = min(lag * self.working_step, 0.5 * LONGEST_LAG_S)
            rate = 1.0 / lag_s if form.engine else _START_RATE
            lags = [(0.3 if form.engine else 1.0) * lag_s * 0.6**i for i in range(form.lags)]
            frame, won = None, []
            for delay in delays:
                columns = self.columns(form, np.array([rate, *lags, delay]))
                if frame is None:  # what is not the answer does not depend on the delay
                    frame = np.linalg.qr(_whitened(columns[:, 1:], ar)[use])[0]
                    left = output - frame @ (frame.T @ output)
                answer = _whitened(columns[:, 0], ar)[use]
                answer = answer - frame @ (frame.T @ answer)
                power = float(answer @ answer)
                won.append(float(answer @ left) ** 2 / power if power > 0.0 else 0.0)
            best = int(np.argmax(won))
            starts.append((won[best], np.array([rate, *lags, delays[best]])))
        starts.sort(key=lambda start: -start[0])
        return [x for _, x in starts]

    def _arx(self, order: int = 12) -> Array:
        """A of ``A y = B u + e`` with as many terms of B as the longest delay has samples."""
        commands = []
        for stretch in self.stretches:
            at = np.arange(stretch.blocks, dtype=np.float64) * self.working_step
            commands += [stretch.commanded(at), np.zeros(self.gap)]
        command = np.concatenate(commands)
        while order > 1 and self.equations(order).sum() < LEAST_VALID * self.samples:
            order -= 1
        use = self.equations(order)
        taps = min(round(1.3 * self.longest_delay / self.working_step) + 1, int(use.sum()) // 4)
        offsets = np.concatenate([np.full(s.blocks + self.gap, n) for n, s in enumerate(self.stretches)])
        columns = [_late(self.output, i) for i in range(1, order + 1)]
        columns += [_late(command, i) for i in range(max(taps, 1))]
        columns += [(offsets == n).astype(np.float64) for n in range(len(self.stretches))]
        matrix = np.stack(columns, axis=1)[use]
        solution = _least_squares(matrix, self.output[use])
        return -solution[:order]

    @cached_property
    def orders(self) -> list[int]:
        """The orders of A that lost samples and the length of the stretches allow."""
        allowed = [n for n in ORDERS if self.equations(n).sum() >= LEAST_VALID * self.samples]
        return [n for n in allowed or ORDERS[:1] if n < self.samples // 10] or [1]

    def best_order(self, error: Array, least: float) -> int:
        """The order of A for this v: by Akaike's criterion, on the same equations for all, and ``least`` [s] at least.

        As long as delay and lags it has to be in a loop: the command of that long before carries the noise of that time
        and earlier, and what a shorter A leaves of it in e would be taken for an answer to the command.
        """
        long_enough = [n for n in self.orders if n * self.working_step >= least]
        orders = long_enough or self.orders[-1:]
        use = self.equations(orders[-1])
        late = np.stack([_late(error, i) for i in range(1, orders[-1] + 1)], axis=1)[use]
        gram, right, power = late.T @ late, late.T @ error[use], float(error[use] @ error[use])
        best: tuple[float, int] = (float("inf"), 1)
        for order in orders:
            terms = spread(order)
            known = terms.T @ right[:order]
            part = np.linalg.lstsq(terms.T @ gram[:order, :order] @ terms, known, rcond=None)[0]
            loss = max(power - float(known @ part), 1e-12 * power)
            best = min(best, (int(use.sum()) * log(loss) + 2.0 * terms.shape[1], order))
        return best[1]

    # ---- the solution

    def solve(self, form: Form, x: Array, ar: Array, fixed: Sequence[int] = (), order: int | None = None) -> Estimate:
        """The estimate nearest to ``x``, with the parameters ``fixed`` kept, for an order of A or the best one."""
        estimate = None
        for _ in range(1 if order is not None else 3):
            linear = self._linear(form, x, ar)
            error = self._error(form, x, linear)
            chosen = order if order is not None else self.best_order(error, float(x[1:].sum()))
            if estimate is not None and chosen == estimate.order:
                break
            ar = self._noise(error, chosen)
            estimate = self._newton(form, x, linear, ar, fixed)
            x, ar = estimate.x, estimate.ar
        assert estimate is not None
        return estimate

    def fit(self, form: Form, keep: Mapping[str, float] | None = None, near: Estimate | None = None) -> Estimate:
        """The estimate from the best of the starts, without the bounds of the delay; ``near``: of a lag less.

        Raises InputError for an unknown name in ``keep``.
        """
        keep = keep or {}
        for name in keep:
            if name not in form.names:
                raise InputError(f"--hold {name}: not a parameter of this form; allowed: {', '.join(form.names)}")
        fixed = [form.names.index(name) for name in keep]
        tried = []
        held = dict(zip(fixed, keep.values(), strict=True))
        for x, ar in self.starts(form, held) if near is None else _with_a_lag(near):
            x[fixed] = list(keep.values())
            tried.append(self.solve(form, x, ar, fixed, len(ar)))
        best = min(tried, key=lambda estimate: estimate.loss)
        # two forms are compared on the same equations, which the order of A decides
        order = None if near is None else near.order
        return replace(self.solve(form, best.x, best.ar, fixed, order), held=tuple(keep))

    def bounded(self, estimate: Estimate, best: float | None = None) -> Estimate:
        """With the ends of the delay's profile likelihood, 95 %: where twice the likelihood's logarithm has fallen by
        chi-squared's 3.84 from that of the estimate.

        ``best`` is the deviance of a form with a lag more, of which the estimate is the end where that lag is nothing.
        The fall from there is distributed as an even mixture of chi-squared of one and two degrees of freedom if the
        estimate's form is the true one (Self and Liang, J. Am. Stat. Assoc. 82, 1987, p. 605), and may be 5.14.
        """
        last = len(estimate.x) - 1
        if estimate.form.names[last] in estimate.held:
            return replace(estimate, delay_bounds=(estimate.delay, estimate.delay))
        most = CHI2_95 if best is None else MIXED_95
        best = estimate.deviance if best is None else best
        ends = (self._end(estimate, -1.0, best + most), self._end(estimate, 1.0, best + most))
        return replace(estimate, delay_bounds=ends)

    def profile(self, estimate: Estimate, delay: float, near: Estimate | None = None) -> Estimate:
        """Everything else estimated anew at this delay."""
        near = near or estimate
        x = near.x.copy()
        x[-1] = delay
        fixed = [*(i for i in range(len(x)) if estimate.form.names[i] in estimate.held), len(x) - 1]
        return self.solve(estimate.form, x, near.ar, fixed, estimate.order)

    def _end(self, estimate: Estimate, side: float, most: float) -> float:
        """Where the profile's deviance is ``most``."""
        wide = 1.96 * estimate.deviation(len(estimate.x) - 1)
        wide = min(max(wide, 1e-4 * self.working_step), self.longest_delay)
        inside, outside = 0.0, np.inf
        limit = estimate.delay if side < 0.0 else self.longest_delay - estimate.delay
        near = estimate
        for _ in range(12):
            wide = min(wide, limit)
            near = self.profile(estimate, estimate.delay + side * wide, near)
            fall = CHI2_95 - (most - near.deviance)  # CHI2_95 at the end that is looked for
            if abs(fall - CHI2_95) < 0.02 * CHI2_95:
                break
            if fall < CHI2_95:
                inside = wide
                if wide >= limit:
                    break
            else:
                outside = min(outside, wide)
            guess = wide * float(np.clip(np.sqrt(CHI2_95 / max(fall, 0.04)), 0.25, 4.0))
            if not inside < guess < outside:
                guess = 0.5 * (inside + outside)
            wide = guess
        return estimate.delay + side * wide

    def robust(self, estimate: Estimate) -> Estimate:
        """With the covariance that also holds where the form is only near the truth or the noise changes its size.

        That is ``H^-1 (sum of g g') H^-1``, H the sum of squares' curvature and g its slope over a block of equations
        as long as delay and lags together, within which what is left over may hang together (White, Econometrica 50,
        1982, p. 1; in blocks Liang and Zeger, Biometrika 73, 1986, p. 13).  Of few blocks it says little: then, and for
        what it would make surer, the covariance stays.
        """
        use = self.equations(estimate.order)
        columns = self.columns(estimate.form, estimate.x)
        error = np.where(self.present, self.output - columns @ estimate.linear, 0.0)
        white = _whitened(error, estimate.ar)[use]
        high, free = self._limits(estimate.form)[1], estimate.free
        jacobian = self._jacobian(
            estimate.form, estimate.x, estimate.linear, estimate.ar, columns, error, free, use, high
        )
        places = [*free, *range(len(estimate.x), len(estimate.covariance))]
        kept = [n for n, place in enumerate(places) if estimate.covariance[place, place] > 0.0]
        rows = [places[n] for n in kept]
        jacobian = jacobian[:, kept]
        count, parameters = jacobian.shape
        block = max(1, round(estimate.all_delay[0] / self.working_step))
        starts = np.arange(0, count, block)
        if len(starts) < LEAST_BLOCKS * parameters:
            return estimate
        slopes = np.add.reduceat(jacobian * white[:, None], starts)
        variance = estimate.loss / (count - parameters)
        inverse = estimate.covariance[np.ix_(rows, rows)] / variance
        share = len(starts) / (len(starts) - 1) * (count - 1) / (count - parameters)
        made = share * inverse @ (slopes.T @ slopes) @ inverse
        covariance = estimate.covariance.copy()
        covariance[np.ix_(rows, rows)] = made
        wider = replace(estimate, covariance=covariance)
        chosen = wider if wider.all_delay[1] > estimate.all_delay[1] else estimate
        variances = np.stack([np.diag(estimate.covariance), np.diag(covariance)])[:, rows]
        factors = np.ones(len(covariance))
        factors[rows] = np.sqrt(variances.max(axis=0) / np.diag(chosen.covariance)[rows])
        return replace(chosen, covariance=chosen.covariance * np.outer(factors, factors))

    # ---- pieces of it

    def _linear(self, form: Form, x: Array, ar: Array) -> Array:
        use = self.equations(len(ar))
        return _least_squares(_whitened(self.columns(form, x), ar)[use], _whitened(self.output, ar)[use])

    def _error(self, form: Form, x: Array, linear: Array) -> Array:
        return np.asarray(np.where(self.present, self.output - self.columns(form, x) @ linear, 0.0))

    def residuals(self, estimate: Estimate) -> tuple[Array, NDArray[np.bool_]]:
        """e, and where it is one."""
        error = self._error(estimate.form, estimate.x, estimate.linear)
        return _whitened(error, estimate.ar), self.equations(estimate.order)

    def without_command(self, estimate: Estimate) -> float:
        """The deviance of a model of noise alone, A of the same order on the same equations."""
        columns = self.columns(estimate.form, estimate.x)[:, 1:]
        ar, use = estimate.ar, self.equations(estimate.order)
        for _ in range(4):
            linear = _least_squares(_whitened(columns, ar)[use], _whitened(self.output, ar)[use])
            error = np.where(self.present, self.output - columns @ linear, 0.0)
            ar = self._noise(error, estimate.order)
        loss = float(np.sum(_whitened(error, ar)[use] ** 2))
        return int(use.sum()) * log(loss / int(use.sum()))

    def simulated(self, estimate: Estimate) -> Array:
        """What the model says of the output."""
        return np.asarray(self.columns(estimate.form, estimate.x) @ estimate.linear)

    def _noise(self, error: Array, order: int) -> Array:
        use, terms = self.equations(order), spread(order)
        late = np.stack([_late(error, i) for i in range(1, order + 1)], axis=1)[use]
        return np.asarray(-terms @ _least_squares(late @ terms, error[use]))

    def _limits(self, form: Form) -> tuple[Array, Array]:
        lag = SHORTEST_LAG * self.working_step
        low = [1.0 / LONGEST_LAG_S if form.engine else 0.0, *[lag] * form.lags, 0.0]
        high = [1.0 / lag if form.engine else FASTEST, *[LONGEST_LAG_S] * form.lags, self.longest_delay]
        return np.array(low), np.array(high)

    def _scale(self, form: Form, x: Array) -> Array:
        """How far each parameter is moved for its derivative."""
        made = 1e-3 * np.maximum(np.abs(x), 1e-3)
        made[0] = 1e-3 * max(x[0], 0.1)
        made[-1] = 0.05 * self.working_step
        return np.asarray(made)

    def _newton(
        self, form: Form, x: Array, linear: Array, ar: Array, fixed: Sequence[int], noise: bool = True
    ) -> Estimate:
        """Damped steps down; without ``noise`` A is kept."""
        use, terms = self.equations(len(ar)), spread(len(ar))
        low, high = self._limits(form)
        x = np.clip(x, low, high)
        free = [i for i in range(len(x)) if i not in fixed]
        damping, loss = 0.0, np.inf

        def losses(x: Array, linear: Array, ar: Array) -> tuple[float, Array, Array, Array]:
            columns = self.columns(form, x)
            error = np.where(self.present, self.output - columns @ linear, 0.0)
            white = _whitened(error, ar)[use]
            return float(white @ white), columns, error, white

        loss, columns, error, white = losses(x, linear, ar)
        for _ in range(_STEPS):
            jacobian = self._jacobian(form, x, linear, ar, columns, error, free, use, high)
            size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
            size[size < _NEGLIGIBLE] = 1.0
            scaled = jacobian / size
            right = -scaled.T @ white
            if not noise:
                scaled[:, len(free) + len(linear) :], right[len(free) + len(linear) :] = 0.0, 0.0
            for n, i in enumerate(free):  # what stands at its limit and would go beyond it stays there
                if (x[i] <= low[i] and right[n] < 0.0) or (x[i] >= high[i] and right[n] > 0.0):
                    scaled[:, n], right[n] = 0.0, 0.0
            gram = scaled.T @ scaled
            fell = 0.0
            for _ in range(12):
                step = np.linalg.lstsq(gram + damping * np.eye(len(gram)), right, rcond=1e-13)[0] / size
                moved = x.copy()
                moved[free] += step[: len(free)]
                moved = np.clip(moved, low, high)
                after = linear + step[len(free) : -terms.shape[1]], ar + terms @ step[-terms.shape[1] :]
                tried = losses(moved, *after)
                if tried[0] <= loss:
                    fell = (loss - tried[0]) / max(loss, 1e-300)
                    x, (linear, ar) = moved, after
                    loss, columns, error, white = tried
                    damping *= 0.1
                    break
                damping = max(10.0 * damping, 1e-6)
            if fell < _TOLERANCE:
                break
        jacobian = self._jacobian(form, x, linear, ar, columns, error, free, use, high)
        return self._estimate(form, x, linear, ar, loss, int(use.sum()), jacobian, free)

    def _jacobian(
        self,
        form: Form,
        x: Array,
        linear: Array,
        ar: Array,
        columns: Array,
        error: Array,
        free: Sequence[int],
        use: NDArray[np.bool_],
        high: Array,
    ) -> Array:
        scale = self._scale(form, x)
        parts = []
        for i in free:
            aside = x.copy()
            aside[i] += scale[i] if x[i] + scale[i] <= high[i] else -scale[i]
            slope = (self.columns(form, aside) - columns) @ linear / (aside[i] - x[i])
            parts.append(-_whitened(slope, ar)[use])
        whitened = -_whitened(columns, ar)[use]
        late = np.stack([_late(error, i) for i in range(1, len(ar) + 1)], axis=1)[use]
        return np.column_stack([*parts, whitened, late @ spread(len(ar))])

    def _estimate(
        self, form: Form, x: Array, linear: Array, ar: Array, loss: float, count: int, jacobian: Array, free: list[int]
    ) -> Estimate:
        low, high = self._limits(form)
        # a slow pole that ended at 0 is uncertain as any other, and the gain with it: held there both look surer than
        # they are
        within = [n for n, i in enumerate(free) if low[i] < x[i] < high[i] or (i == 0 and not form.engine)]
        kept = [*within, *range(len(free), jacobian.shape[1])]
        size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
        size[size < _NEGLIGIBLE] = 1.0
        scaled = (jacobian / size)[:, kept]
        variance = loss / max(count - len(kept), 1)
        inverse = variance * np.linalg.pinv(scaled.T @ scaled, rcond=1e-13)
        rest = jacobian.shape[1] - len(free)
        places = [free[n] for n in within] + [len(x) + n for n in range(rest)]
        covariance = np.zeros((len(x) + rest,) * 2)
        covariance[np.ix_(places, places)] = inverse / np.outer(size[kept], size[kept])
        return Estimate(form, x, float(linear[0]), len(ar), ar, linear, loss, count, covariance, tuple(free))


def identify(problem: Problem, engine: bool, keep: dict[str, float] | None = None, most: int = 2) -> list[Estimate]:
    """So many forms, each with a lag more, the best by Akaike's criterion first.

    The bounds of the delay are of the best, and of the richest: which holds the others, and no data refute it.
    """
    fewest = 0 if engine else 1
    estimates: list[Estimate] = []
    for lags in range(fewest, fewest + most):
        estimates.append(problem.fit(Form(engine, lags), keep, estimates[-1] if estimates else None))
    richest = problem.bounded(estimates.pop())
    ends = [richest.delay_bounds]
    for simpler in estimates:  # one that is not refuted is the richest with a lag of nothing, which Newton only nears
        if "delay_s" not in simpler.held and simpler.deviance < richest.deviance + MIXED_95:
            ends.append(problem.bounded(simpler, richest.deviance).delay_bounds)
    richest = replace(richest, delay_bounds=(min(low for low, _ in ends), max(high for _, high in ends)))
    return sorted([*map(problem.bounded, estimates), richest], key=lambda estimate: estimate.aic)


# ---- small things


@cache
def spread(order: int) -> Array:
    """What each estimated term of A gives to its coefficients, (order, terms): the first ``EACH`` one each.

    Those beyond are linear between ``ORDERS``, because noise that goes through an airframe fades slowly and smoothly.
    """
    knots = [*range(1, min(order, EACH) + 1), *(n for n in ORDERS if EACH < n < order), order]
    at = np.unique(knots)
    return np.asarray([np.interp(np.arange(1, order + 1), at, row) for row in np.eye(len(at))]).T


def _with_a_lag(near: Estimate) -> list[tuple[Array, Array]]:
    """Where the search for a form begins that has a lag more: that lag shorter or as long, out of the delay."""
    last = float(near.x[-2]) if near.form.lags else 1.0 / float(near.x[0])
    made = []
    for share in (0.2, 1.0):
        lag = share * last
        made.append((np.array([*near.x[:-1], lag, max(near.delay - lag, 0.0)]), near.ar))
    return made


def _late(values: Array, by: int) -> Array:
    return np.concatenate([np.zeros(by), values[: len(values) - by]]) if by else values


def _whitened(values: Array, ar: Array) -> Array:
    from scipy.signal import lfilter

    return np.asarray(lfilter(np.concatenate([[1.0], ar]), [1.0], values, axis=0))


def _least_squares(matrix: Array, right: Array) -> Array:
    """By the normal equations, the columns brought to one size."""
    size = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    size[size < _NEGLIGIBLE] = 1.0
    scaled = matrix / size
    return np.asarray(np.linalg.lstsq(scaled.T @ scaled, scaled.T @ right, rcond=1e-13)[0] / size)
