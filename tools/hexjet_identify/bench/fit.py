"""Output-error fit of a bench log: a static curve, a dead time and lags, behind noise that remembers itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.bench.command import LARGEST_RATIO, Command, make_command, thin
from hexjet_identify.bench.record import BenchRecord, average_rows
from hexjet_identify.robust import invert, memory_rows, robust_factor

CHI2_95 = 3.841458820694124  # one parameter: by how much the deviance rises to the end of a 95 % bound
# The same where no second lag is told: it cannot be below 0, and delay and it do nearly the same. So the rise is 0 in a
# quarter of all logs, chi-squared of one degree in half and of two in a quarter (Self and Liang, 1987; angle 0).
MIXED_95 = 4.230599177831499
EXPONENTS = (0.2, 6.0)
LONGEST_MEMORY = 0.9999  # of the noise from one row to the next
ROUNDS = 3  # of fit and memory of the noise in turn
SMALLEST_NOISE = 1e-9  # of the output's swing: below it is rounding
COARSE_ROWS = 1500  # of all logs, in the search for where to begin
COARSE_LAGS, COARSE_DELAYS = 12, 40
STARTS = 3
SAME_MEMORY = 1e-3  # by which another round may change the memory of the noise
MOST_TRIES = 12  # to find the end of a bound
LARGEST_BEGUN = 0.9  # ratio of two lags, to begin with: the search does not leave its end easily
NEAR = 0.01  # of its distance, to which it is found
SMALLEST_SHARE = 1e-12  # of the largest column, that one has to have of its own


class Form(NamedTuple):
    """What is fitted: one lag or two, the static curve straight or with an exponent."""

    lags: int = 1
    curve: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are searched for."""
        more = (self.lags == 2, "ratio"), (self.curve, "exponent")
        return ("delay_s", "lag_s", *(name for there, name in more if there))

    @property
    def label(self) -> str:
        """The form in words."""
        return ("delay and one lag" if self.lags == 1 else "delay and two lags") + (", curve" if self.curve else "")

    def split(self, x: Array) -> tuple[float, float, float, float]:
        """Return delay [s], lag [s], ratio of a second lag to it, and the curve's exponent."""
        ratio = float(x[2]) if self.lags == 2 else 0.0
        return float(x[0]), float(x[1]), ratio, float(x[-1]) if self.curve else 1.0


@dataclass(frozen=True)
class Estimate:
    """One form, fitted; ``covariance`` is that of ``x``, then of the gain, then of each log's offset."""

    form: Form
    x: Array
    gain: float
    offsets: Array
    covariance: Array
    memory: float
    loss: float
    rows: int
    deviance: float
    parameters: int
    delay_bounds: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def bic(self) -> float:
        """Schwarz' criterion."""
        return self.deviance + self.parameters * float(np.log(self.rows))

    @property
    def delay(self) -> float:
        """Dead time, s."""
        return float(self.x[0])

    def deviation(self, index: int) -> float:
        """Return the standard deviation of a parameter of ``x``, or of the gain behind them."""
        return float(np.sqrt(max(self.covariance[index, index], 0.0)))

    @property
    def lags(self) -> tuple[float, ...]:
        """Lags, s, the longer first."""
        _, lag, ratio, _ = self.form.split(self.x)
        return (lag, ratio * lag) if self.form.lags == 2 else (lag,)

    @property
    def total(self) -> tuple[float, float]:
        """Delay and lags together, s, and their standard deviation."""
        _, lag, ratio, _ = self.form.split(self.x)
        slope = np.zeros(len(self.covariance))
        slope[:2] = 1.0, 1.0 + ratio
        if self.form.lags == 2:
            slope[2] = lag
        return self.delay + sum(self.lags), float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))


@dataclass(frozen=True)
class Part:
    """Rows of one log that count, with its command as a share of the throttle's range."""

    command_times: Array
    command: Array
    times: Array
    output: Array
    step: float
    straight: bool
    width: float = 0.0  # s, over which each row is a mean

    def answer(self, exponent: float, lag: float, ratio: float, delay: float) -> Array:
        """Return the delayed command behind the static curve and the lags, averaged as the rows are."""
        command, at = self.piecewise(exponent), self.times - delay
        if self.width > 0.0:
            begins, ends = at - 0.5 * self.width, at + 0.5 * self.width
            return command.twice_lagged_means(lag, ratio, begins, ends)
        return command.twice_lagged(lag, ratio, at)

    def piecewise(self, exponent: float) -> Command:
        """Return the command behind the static curve."""
        known = self._commands
        if exponent not in known:
            values = self.command if exponent == 1.0 else np.maximum(self.command, 0.0) ** exponent
            known.clear()
            known[exponent] = make_command(self.command_times, values, self.straight)
        return known[exponent]

    @cached_property
    def _commands(self) -> dict[float, Command]:
        return {}

    def chosen(self, use: NDArray[Any]) -> Part:
        """Return it with some of its rows."""
        return replace(self, times=self.times[use], output=self.output[use])

    def averaged(self, seconds: float) -> Part:
        """Return it with rows that are means over as long as this, at most, and the model's alike."""
        many = int(seconds / self.step)
        if many < 2:
            return self
        times, output = average_rows(self.times, self.output, self.step, many)
        step = many * self.step
        commands = self.command_times, self.command
        if self.straight:
            commands = thin(*commands, max(1, int(step / float(np.median(np.diff(self.command_times))))))
        return replace(
            self, command_times=commands[0], command=commands[1], times=times, output=output, step=step, width=step
        )


def make_part(record: BenchRecord, limits: tuple[float, float], straight: bool) -> Part:
    """Return a log with its command as a share of a range."""
    low, high = limits
    command = (record.command - low) / (high - low)
    times = record.command_times if straight else record.command_times - _lost_before(record.command_times, command)
    return Part(times, command, record.times, record.output, record.step, straight, record.width)


def _lost_before(times: Array, command: Array) -> Array:
    """Return half of how long the rows that are lost before each movement of a held command took, s, else 0.

    So much before its row is the middle of where the movement may have been.
    """
    gap = np.diff(times, prepend=times[0])
    row = float(np.median(gap[1:]))
    unknown = (gap > 1.5 * row) & (np.diff(command, prepend=command[0]) != 0.0)
    return np.asarray(np.where(unknown, 0.5 * (gap - row), 0.0))


@dataclass(frozen=True)
class Problem:
    """Logs of one engine, fitted together: what each form leaves over of them."""

    parts: Sequence[Part]
    longest_delay: float
    _spans: list[slice] = field(default_factory=list)

    def __post_init__(self) -> None:
        ends = np.cumsum([0, *(len(part.times) for part in self.parts)])
        self._spans.extend(slice(int(a), int(b)) for a, b in pairwise(ends))

    @cached_property
    def output(self) -> Array:
        """All logs' output, one behind the other."""
        return np.concatenate([part.output for part in self.parts])

    @cached_property
    def floor(self) -> float:
        """Least sum of squares that means anything."""
        return len(self.output) * (SMALLEST_NOISE * max(float(np.ptp(self.output)), 1e-300)) ** 2

    def regressors(self, form: Form, x: Array) -> Array:
        """Return the columns that gain, offsets and starts multiply; rows as ``output``."""
        delay, lag, ratio, exponent = form.split(x)
        count = len(self.parts)
        columns = np.zeros((len(self.output), 1 + 2 * count))
        for n, (part, span) in enumerate(zip(self.parts, self._spans, strict=True)):
            columns[span, 0] = part.answer(exponent, lag, ratio, delay)
            columns[span, 1 + n] = 1.0
            columns[span, 1 + count + n] = np.exp(-(part.times - part.times[0]) / lag)
        return columns

    def whiten(self, rows: Array, memory: float) -> Array:
        """Return rows less what the row before says of them, all of one size; gaps make that less."""
        white = np.empty_like(rows)
        for part, span in zip(self.parts, self._spans, strict=True):
            kept, scale = _kept(part, memory)
            own = rows[span]
            shape = (-1,) + (1,) * (own.ndim - 1)
            white[span] = own
            white[span][1:] -= kept.reshape(shape) * own[:-1]
            white[span][1:] /= scale.reshape(shape)
            white[span][0] *= np.sqrt(1.0 - memory**2)
        return white

    def scales(self, memory: float) -> float:
        """Return what the whitening adds to the deviance."""
        total = 0.0
        for part in self.parts:
            total += 2.0 * float(np.log(_kept(part, memory)[1]).sum()) - float(np.log(1.0 - memory**2))
        return total

    def memory_of(self, residual: Array) -> float:
        """Return the correlation of a residual with the row before, of rows that follow each other."""
        above = below = 0.0
        for part, span in zip(self.parts, self._spans, strict=True):
            own = residual[span]
            near = np.diff(part.times) < 1.5 * part.step
            above += float((own[1:] * own[:-1])[near].sum())
            below += float((0.5 * (own[1:] ** 2 + own[:-1] ** 2))[near].sum())
        return float(np.clip(above / below, 0.0, LONGEST_MEMORY)) if below > 0.0 else 0.0

    def shares(self, form: Form, x: Array, memory: float) -> tuple[Array, Array]:
        """Return the linear parameters that suit ``x`` best, and what is left over, made white."""
        matrix = self.whiten(self.regressors(form, x), memory)
        output = self.whiten(self.output, memory)
        linear = np.linalg.lstsq(matrix, output, rcond=1e-12)[0]
        return np.asarray(linear), np.asarray(output - matrix @ linear)

    def residual(self, estimate: Estimate) -> Array:
        """Return what an estimate leaves over of the output, in its unit."""
        matrix = self.regressors(estimate.form, estimate.x)
        linear = np.linalg.lstsq(self.whiten(matrix, estimate.memory), self.whiten(self.output, estimate.memory))[0]
        return np.asarray(self.output - matrix @ linear)

    def limits(self, form: Form) -> tuple[Array, Array]:
        """Return the least and the greatest of each parameter that is searched for."""
        step = min(part.step for part in self.parts)
        span = max(float(part.times[-1] - part.times[0]) for part in self.parts)
        low, high = [0.0, 0.05 * step], [self.longest_delay, span]
        if form.lags == 2:
            low, high = [*low, 0.0], [*high, LARGEST_RATIO]
        if form.curve:
            low, high = [*low, EXPONENTS[0]], [*high, EXPONENTS[1]]
        return np.array(low), np.array(high)


def _kept(part: Part, memory: float) -> tuple[Array, Array]:
    """Return what each row keeps of the noise of the one before, and the size of what is new in it, relative."""
    if memory == 0.0:
        return np.zeros(len(part.times) - 1), np.ones(len(part.times) - 1)
    kept = memory ** (np.diff(part.times) / part.step)
    return kept, np.sqrt((1.0 - kept**2) / (1.0 - memory**2))


def fit(problem: Problem, form: Form, near: Estimate | None = None) -> Estimate:
    """Fit one form; from ``near``, a simpler one, or from a search over all delays and lags."""
    start = _start(problem) if near is None else near.x[:2]
    memory = 0.0 if near is None else near.memory
    best, loss = solve(problem, form, _complete(form, start), memory)
    if form.lags == 2:  # a longer second lag may be better
        other = np.array([max(best[0] - 0.3 * best[1], 0.0), 0.7 * best[1], 0.5, *best[3:]])
        found = solve(problem, form, other, memory)
        best, loss = found if found[1] < loss else (best, loss)
    for _ in range(ROUNDS):
        linear = problem.shares(form, best, memory)[0]
        before, memory = memory, problem.memory_of(problem.output - problem.regressors(form, best) @ linear)
        if abs(memory - before) < SAME_MEMORY:
            break
        best = solve(problem, form, best, memory)[0]
    return _estimate(problem, form, best, memory)


def _complete(form: Form, start: Array) -> Array:
    more = (form.lags == 2, 0.2), (form.curve, 1.0)
    return np.array([*start[:2], *(value for there, value in more if there)])


def _start(problem: Problem) -> Array:
    """Return the delay and lag with which the rows, thinned, are best explained."""
    every = max(1, len(problem.output) // COARSE_ROWS)
    thin = [part.chosen(np.arange(0, len(part.times), every)) for part in problem.parts]
    coarse = Problem(thin, problem.longest_delay)
    low, high = problem.limits(Form())
    lags = np.geomspace(max(low[1], 2e-3), 0.5 * high[1], COARSE_LAGS)
    delays = np.concatenate([[0.0], np.geomspace(0.02 * high[0], 0.95 * high[0], COARSE_DELAYS)])
    found = []
    for lag in lags:
        losses = [float(np.sum(coarse.shares(Form(), np.array([d, lag]), 0.0)[1] ** 2)) for d in delays]
        best = int(np.argmin(losses))
        found.append((losses[best], np.array([delays[best], lag])))
    likeliest = sorted(found, key=lambda one: one[0])[:STARTS]
    return min((solve(coarse, Form(), x, 0.0) for _, x in likeliest), key=lambda one: one[1])[0]


def solve(problem: Problem, form: Form, start: Array, memory: float, held: int | None = None) -> tuple[Array, float]:
    """Return the parameters nearest ``start`` that leave least, and what they leave; that numbered ``held`` is kept."""
    from scipy.optimize import least_squares

    low, high = problem.limits(form)
    free = np.flatnonzero(np.arange(len(start)) != (-1 if held is None else held))
    x = start.copy()
    size = np.sqrt(max(problem.floor / len(problem.output), 1e-300))
    output = problem.whiten(problem.output, memory)
    base, basis = np.empty(0), np.empty(0)

    def left(values: Array) -> Array:
        nonlocal base, basis
        x[free] = values
        base, basis = values.copy(), _basis(problem.whiten(problem.regressors(form, x), memory))
        return np.asarray((output - basis @ (basis.T @ output)) / size)

    def slopes(values: Array) -> Array:
        """Return how what is left over changes, the linear parameters held (Kaufman, 1975)."""
        if not np.array_equal(base, values):
            left(values)
        x[free] = values
        linear = problem.shares(form, x, memory)[0]
        columns = problem.whiten(_slopes(problem, form, x, linear, free), memory)
        return np.asarray((basis @ (basis.T @ columns) - columns) / size)

    inside = np.clip(x, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    scale = np.maximum(0.1 * np.abs(inside), 1e-3 * (high - low))
    answer = least_squares(
        left, inside[free], slopes, bounds=(low[free], high[free]), x_scale=scale[free], xtol=1e-8, ftol=1e-9,
        max_nfev=60,
    )  # fmt: skip
    x[free] = answer.x
    return x.copy(), max(float(2.0 * answer.cost) * size**2, problem.floor)


def _basis(matrix: Array) -> Array:
    """Return an orthonormal basis of a matrix' columns, zero where one adds nothing to those before it."""
    basis, triangle = np.linalg.qr(matrix)
    size = np.abs(np.diag(triangle))
    return np.asarray(basis * (size > SMALLEST_SHARE * size.max()))


def _estimate(problem: Problem, form: Form, x: Array, memory: float) -> Estimate:
    linear, white = problem.shares(form, x, memory)
    rows, count = len(white), len(problem.parts)
    loss = max(float(white @ white), problem.floor)
    matrix = problem.whiten(problem.regressors(form, x), memory)
    slopes = _slopes(problem, form, x, linear, np.arange(len(x)))
    jacobian = np.column_stack([problem.whiten(slopes, memory), matrix])
    covariance = loss / max(rows - jacobian.shape[1], 1) * invert(jacobian.T @ jacobian)
    wider = robust_factor(jacobian, white, covariance, memory_rows(white))
    covariance = covariance * np.outer(wider, wider)
    keep = np.arange(len(x) + 1 + count)
    parameters = jacobian.shape[1] + 2
    deviance = rows * float(np.log(loss / rows)) + problem.scales(memory)
    return Estimate(
        form, x, float(linear[0]), linear[1 : 1 + count], covariance[np.ix_(keep, keep)],
        memory, loss, rows, deviance, parameters,
    )  # fmt: skip


def _slopes(problem: Problem, form: Form, x: Array, linear: Array, which: NDArray[Any]) -> Array:
    """Return by how much the model changes with these of the parameters, a column each."""
    low, high = problem.limits(form)
    widths = np.maximum(1e-4 * np.abs(x), 1e-6 * (high - low))
    widths[0] = 0.02 * min(part.step for part in problem.parts)
    columns = []
    for i in which:
        above, below = x.copy(), x.copy()
        above[i], below[i] = min(x[i] + widths[i], high[i]), max(x[i] - widths[i], low[i])
        change = problem.regressors(form, above) @ linear - problem.regressors(form, below) @ linear
        columns.append(change / (above[i] - below[i]))
    return np.column_stack(columns)


def slopes(problem: Problem, estimate: Estimate) -> Array:
    """Return by how much a form changes with what is fitted, the delay [s] first: rows as the output, a column each."""
    linear = problem.shares(estimate.form, estimate.x, estimate.memory)[0]
    searched = _slopes(problem, estimate.form, estimate.x, linear, np.arange(len(estimate.x)))
    return np.column_stack([searched, problem.regressors(estimate.form, estimate.x)])


def plain_factor(problem: Problem, estimate: Estimate) -> float:
    """Return by how much wider the delay's deviation was made than white residuals would have it."""
    jacobian = problem.whiten(slopes(problem, estimate), estimate.memory)
    plain = estimate.loss / estimate.rows * invert(jacobian.T @ jacobian)[0, 0]
    return float(max(estimate.deviation(0) / np.sqrt(max(plain, 1e-300)), 1.0))


def _delayed(form: Form, x: Array, delay: float) -> Array:
    """Return parameters with another delay and, as far as can be, delay and lags together as they were."""
    _, lag, ratio, _ = form.split(x)
    second = ratio * lag + float(x[0]) - delay
    y = x.copy()
    y[0] = delay
    if form.lags == 2:
        y[2] = min(max(second, 0.0) / lag, LARGEST_BEGUN)
        y[1] = max(lag + min(second, 0.0), 0.1 * lag)
    return y


def bound_delay(problem: Problem, estimate: Estimate, has_second: bool) -> tuple[float, float]:
    """Return 95 % bounds of the delay [s] by its profile likelihood, between 0 and the longest that is looked for.

    ``estimate`` has two lags; ``has_second``: the second is told by the log.
    """
    wanted = float(np.sqrt(CHI2_95 if has_second else MIXED_95)) * plain_factor(problem, estimate)
    low, high = problem.limits(estimate.form)

    def risen(delay: float, start: Array) -> tuple[float, Array]:
        """Return the root of the deviance's rise, which goes straight with the delay where the problem is linear."""
        x, loss = solve(problem, estimate.form, _delayed(estimate.form, start, delay), estimate.memory, 0)
        return float(np.sqrt(max(estimate.rows * float(np.log(loss / estimate.loss)), 0.0))), x

    width = max(1.96 * estimate.deviation(0), 1e-3 * min(part.step for part in problem.parts))
    ends = []
    for sign, limit in ((-1.0, float(low[0])), (1.0, float(high[0]))):
        inside, outside, x = estimate.delay, limit, estimate.x
        at = float(np.clip(estimate.delay + sign * width, low[0], high[0]))
        for _ in range(MOST_TRIES):
            value, found = risen(at, x)
            if value < wanted:
                inside, x = at, found
            else:
                outside = at
            if abs(value - wanted) < NEAR * wanted or inside == limit:
                break
            near = estimate.delay + (at - estimate.delay) * wanted / max(value, 0.3 * wanted)
            within = min(inside, outside) < near < max(inside, outside)
            at = near if within else (limit if outside == limit else 0.5 * (inside + outside))
        ends.append(at)
    return ends[0], ends[1]
