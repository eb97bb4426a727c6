"""The one fit: output error by variable projection, noise by evidence, bounds that stand model errors.

What is left over is made white before it is squared: each row is less what noise keeps of the rows before.  Of a bench
the order is 0 or 1, by BIC.  Of a closed loop it is higher, for the command contains the noise that came back, and its
terms are fitted with the rest: the direct method (Ljung, System Identification, 2nd ed., section 13.4).  Deviations are
those of Newey and West (1987), which hold where what is left over is correlated, and at least the plain ones; the delay
has bounds by its profile likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from hexjet_identify.fit.forms import Form, Lags, Limits
from hexjet_identify.fit.logs import Log
from hexjet_identify.fit.problem import Problem, noise_basis


@dataclass(frozen=True)
class Estimate:
    """A fitted form: parameters ``x``, linear parameters, their covariance, and the residual of the output.

    ``noise``: what each row keeps of the noise of those before; ``covariance``: of ``x``, what is linear, and terms of
    the noise; ``held``: numbers of parameters that were not fitted; ``loss``: sum of squares of ``rows``, made white.
    """

    form: Form
    x: Array
    linear: Array
    covariance: Array
    residual: Array
    noise: Array
    loss: float
    rows: int
    deviance: float
    count: int
    widening: float
    held: tuple[int, ...] = ()
    delay_bounds: tuple[float, float] = (np.nan, np.nan)

    @property
    def delay(self) -> float:
        """Delay, s."""
        return float(self.x[0])

    @property
    def bic(self) -> float:
        """Schwarz' criterion: of two forms the smaller one is the likelier."""
        return self.deviance + self.count * float(np.log(self.rows))

    @property
    def aic(self) -> float:
        """Akaike's criterion."""
        return self.deviance + 2.0 * self.count

    @property
    def gain(self) -> tuple[float, float]:
        """The first linear parameter, and its standard deviation."""
        return float(self.linear[0]), self.deviation(len(self.x))

    def deviation(self, number: int) -> float:
        """Return a parameter's standard deviation."""
        return float(np.sqrt(max(self.covariance[number, number], 0.0)))

    def derive(self, quantity: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return a function of ``x`` and its covariance, linearised."""
        count, at = len(self.x), quantity(self.x)
        steps = 1e-6 * np.maximum(1.0, np.abs(self.x))
        slopes = [(quantity(self.x + row) - at) / step for row, step in zip(np.diag(steps), steps, strict=True)]
        own = self.covariance[:count, :count]
        unknown = np.isinf(np.diag(own))
        slope = np.array(slopes).T
        covariance = slope @ np.where(unknown | unknown[:, None], 0.0, own) @ slope.T
        silent = np.any(slope[:, unknown] != 0.0, axis=1)
        covariance[silent, silent] = np.inf
        return at, covariance

    @property
    def numbers(self) -> dict[str, tuple[float, float]]:
        """The form's physical parameters by name, each with its standard deviation."""
        names = list(self.form.natural(self.x))
        values, covariance = self.derive(lambda x: np.array(list(self.form.natural(x).values())))
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return dict(zip(names, zip(values.tolist(), deviations.tolist(), strict=True), strict=True))

    @property
    def total(self) -> tuple[float, float]:
        """Delay and lags together, s, and their standard deviation."""
        value, covariance = self.derive(lambda x: np.array([self.form.total(x)]))
        return float(value[0]), float(np.sqrt(max(covariance[0, 0], 0.0)))

    def to_dict(self) -> dict[str, Any]:
        """Return form, parameters with standard deviations, bounds of the delay and BIC, for JSON."""
        numbers = self.numbers
        return {
            "form": self.form.label,
            **{name: value for name, (value, _) in numbers.items()},
            "standard_deviations": {name: one if np.isfinite(one) else None for name, (_, one) in numbers.items()},
            "delay_bounds_95_s": list(self.delay_bounds) if np.isfinite(self.delay_bounds[0]) else None,
            "bic": self.bic,
        }

    def levels(self, problem: Problem) -> Array:
        """Return the static output at the problem's knots; of a form without such levels none."""
        return self.form.levels(problem, self.x, self.linear)

    def answer(self, problem: Problem, delay: float | None = None) -> Array:
        """Return the form's answer at the rows of a problem; ``delay``: with another delay, s."""
        x = self.x if delay is None else np.concatenate([[delay], self.x[1:]])
        columns = self.form.columns(problem, x)
        return np.asarray(columns @ self.linear if len(self.linear) else columns[:, 0])


def project(problem: Problem, form: Form, x: Array, noise: Array) -> tuple[Array, Array]:
    """Return the least-squares linear parameters at ``x``, and the whitened residual with the rows that bind levels."""
    columns = form.columns(problem, x)
    if not form.is_linear:
        levels = form.levels(problem, x, x)
        bound = problem.binding @ levels if len(levels) else levels
        return np.zeros(0), np.concatenate([problem.whiten(problem.output - columns[:, 0], noise), -bound])
    matrix, output = problem.whiten(columns, noise), problem.whiten(problem.output, noise)
    count = len(problem.knots)
    gram = matrix.T @ matrix
    gram[:count, :count] += problem.binding.T @ problem.binding
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram / np.outer(scale, scale) + 1e-12 * np.eye(len(gram))
    linear = np.linalg.solve(gram, matrix.T @ output / scale) / scale
    # One step of refinement makes the normal equations as exact as a decomposition of the matrix.
    left = matrix.T @ (output - matrix @ linear)
    left[:count] -= problem.binding.T @ (problem.binding @ linear[:count])
    linear += np.linalg.solve(gram, left / scale) / scale
    return linear, np.concatenate([output - matrix @ linear, -(problem.binding @ linear[:count])])


def compute_residual(problem: Problem, form: Form, x: Array, linear: Array) -> Array:
    """Return the residual: the measured output less the form's answer."""
    columns = form.columns(problem, x)
    return np.asarray(problem.output - (columns @ linear if len(linear) else columns[:, 0]))


def solve(
    problem: Problem, form: Form, start: Array, noise: Array, held: Sequence[int] = ()
) -> tuple[Array, Array, float]:
    """Fit parameters from ``start``; return them, the noise and the sum of squares of the whitened residual.

    Parameters numbered ``held`` are kept; noise of order 1 too, that of a higher one is fitted with the rest.
    """
    from scipy.optimize import least_squares

    low, high = form.limits(problem)
    inside = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
    x = np.where(np.isin(np.arange(len(low)), held), start, np.clip(start, low + inside, high - inside))
    free = np.setdiff1d(np.arange(len(x)), held)
    size, terms, begin = 1e-6 * problem.swing, noise_basis(len(noise)), noise
    many = terms.shape[1]

    at, last, linear = np.empty(0), np.empty(0), np.empty(0)

    def left_at(values: Array) -> Array:
        nonlocal at, last, linear, noise
        if not np.array_equal(at, values):
            x[free], noise = values[: len(free)], begin + terms @ values[len(free) :]
            linear, rest = project(problem, form, x, noise)
            at, last = values.copy(), rest / size
        return last

    def slopes_at(values: Array) -> Array:
        base = left_at(values)
        if (known := form.slopes(problem, x)) is not None:
            bound = np.pad(problem.binding, ((0, 0), (len(x) - len(problem.knots), 0)))
            return np.asarray(-np.concatenate([problem.whiten(known, noise), bound])[:, free] / size)
        widths = form.widths(problem, x)[free]
        widths = np.where(values[: len(free)] + widths <= high[free], widths, -widths)
        of_noise = np.zeros((len(base), 0))
        if many:
            # Derivatives by the noise's terms, projected off the linear parameters (Kaufman, 1975).
            answers = form.columns(problem, x)
            late = problem.earlier(problem.output - answers @ linear, len(noise)) @ terms
            frame = np.linalg.qr(problem.whiten(answers, noise))[0]
            of_noise = (frame @ (frame.T @ late) - late) / size
        moved = np.pad(np.diag(widths), ((0, 0), (0, many)))
        columns = [(left_at(values + step) - base) / width for step, width in zip(moved, widths, strict=True)]
        return np.column_stack([*columns, of_noise])

    if len(free) + many:
        scale = np.concatenate([1e3 * form.widths(problem, x)[free], np.ones(many)])
        ends = [np.concatenate([end[free], sign * np.full(many, np.inf)]) for end, sign in ((low, -1.0), (high, 1.0))]
        values = np.concatenate([x[free], np.zeros(many)])
        found = least_squares(left_at, values, slopes_at, bounds=ends, x_scale=scale, xtol=1e-6, ftol=1e-8, max_nfev=40)
        left_at(found.x)
    rest = project(problem, form, x, noise)[1]
    return x.copy(), noise, max(float(rest @ rest), len(problem.output) * (1e-7 * problem.swing) ** 2)


def fit(problem: Problem, form: Form, start: Array) -> Estimate:
    """Fit a form from a start, with white noise and with noise of order 1, and keep what the evidence prefers."""
    white = np.zeros(0)
    best = estimate_at(problem, form, solve(problem, form, start, white)[0], white)
    memory = problem.memory_of(best.residual)
    if memory < 2.0 / np.sqrt(len(best.residual)):
        return best
    found, before = best, 0.0
    while abs(memory - before) > 0.01 and (before == 0.0 or memory > before):
        noise = np.array([memory])
        found = estimate_at(problem, form, solve(problem, form, found.x, noise)[0], noise)
        before, memory = memory, problem.memory_of(found.residual)
    return found if found.bic < best.bic else best


def fit_static(problem: Problem) -> Estimate:
    """Fit the static line alone, without delay and lags, for logs that do not determine them."""
    form = Lags(0)
    x = form.limits(problem)[0]
    white = estimate_at(problem, form, x, np.zeros(0))
    memory = np.array([problem.memory_of(white.residual)])
    best = min((white, estimate_at(problem, form, x, memory)), key=lambda each: each.bic)
    covariance = best.covariance.copy()
    covariance[:2], covariance[:, :2] = 0.0, 0.0
    covariance[[0, 1], [0, 1]] = np.inf
    return replace(best, covariance=covariance, count=best.count - 2, delay_bounds=(0.0, problem.max_delay))


def thin_rows(problem: Problem, rows: int = 400) -> Problem:
    """Return the problem with about so many ``rows``, those of each log alike, and commands: enough to search."""
    every = max(1, len(problem.output) // rows)
    coarse = problem.at(np.concatenate([np.arange(len(log.times)) % every == 0 for log in problem.logs]))
    seconds = 2.0 * sum(float(np.ptp(log.times)) for log in coarse.logs) / rows
    return replace(coarse, logs=[log.with_fewer_commands(seconds) for log in coarse.logs])


def find_start(problem: Problem) -> Array:
    """Return delay [s] and ln lag to start a fit from, by a search over a grid with thinned rows."""
    coarse, form = thin_rows(problem), Lags(1)
    low, high = form.limits(coarse)
    delays = np.concatenate([[0.0], np.geomspace(0.02 * high[0], 0.95 * high[0], 14)])
    found = []
    for lag in np.linspace(max(low[1], np.log(2e-3)), high[1] + np.log(0.5), 10):
        losses = [float(np.sum(project(coarse, form, np.array([delay, lag]), np.zeros(0))[1] ** 2)) for delay in delays]
        best = int(np.argmin(losses))
        found.append((losses[best], np.array([delays[best], lag])))
    likeliest = sorted(found, key=lambda each: each[0])[:3]
    return min((solve(coarse, form, x, np.zeros(0)) for _, x in likeliest), key=lambda each: each[2])[0]


def fit_limits(problem: Problem, lags: Estimate, share: float = 0.9) -> Estimate | None:
    """Fit limits of rise and fall from several starts, with lags far shorter than that of a lag alone.

    None where they leave more than a ``share`` of what lags leave of thinned rows: they are not clearly better.
    """
    rates = np.concatenate([_compute_rates(log) for log in problem.logs])
    rise = max(float(np.percentile(rates, 97.0)), 1e-3 * problem.swing)
    fall = max(float(-np.percentile(rates, 3.0)), 1e-3 * problem.swing)
    total, levels = lags.form.total(lags.x), lags.levels(problem)
    coarse, form, white = thin_rows(problem), Limits(), np.zeros(0)
    starts = [
        np.array([delay * total, np.log(lag * total), np.log(rise), np.log(fall), *levels])
        for delay, lag in ((0.3, 0.5), (0.3, 0.15), (0.1, 0.3))
    ]
    near, _, loss = min((solve(coarse, form, start, white) for start in starts), key=lambda each: each[2])
    if loss > share * solve(coarse, lags.form, lags.x, white)[2]:
        return None
    return fit(problem, form, near)


def _compute_rates(log: Log) -> Array:
    """Return the output's rates over a tenth of a second, 1/s."""
    rows = max(1, round(0.1 / log.step))
    return np.asarray((log.output[rows:] - log.output[:-rows]) / (log.times[rows:] - log.times[:-rows]))


def estimate_at(
    problem: Problem, form: Form, x: Array, noise: Array, held: Sequence[int] = (), width: int = 0
) -> Estimate:
    """Return the estimate at given parameters and noise with its covariance; those numbered ``held`` are exact.

    ``width``: rows over which what is left over may be correlated at least.
    """
    linear = project(problem, form, x, noise)[0]
    residual = compute_residual(problem, form, x, linear)
    white = problem.whiten(residual, noise)
    count = len(white)
    loss = max(float(white @ white), count * (1e-7 * problem.swing) ** 2)
    slopes = _differentiate(problem, form, x, linear)
    linear_slopes = [form.columns(problem, x)[:, : len(linear)]] if len(linear) else []
    jacobian = problem.whiten(np.column_stack([slopes, *linear_slopes]), noise)
    if len(noise) > 1:
        jacobian = np.column_stack([jacobian, problem.earlier(residual, len(noise)) @ noise_basis(len(noise))])
    fitted = np.setdiff1d(np.arange(jacobian.shape[1]), held)
    jacobian = jacobian[:, fitted]
    inverse = invert(jacobian.T @ jacobian)
    free = max(count - jacobian.shape[1], 1)
    plain = loss / free * inverse
    robust = _newey_west(jacobian, white, inverse, width) * count / free
    wider = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
    deviance = count * float(np.log(loss / count)) + problem.whitening_deviance(noise)
    parameters = jacobian.shape[1] + 1 + (len(noise) == 1 and noise[0] > 0.0)
    covariance = np.zeros((len(x) + len(linear) + noise_basis(len(noise)).shape[1],) * 2)
    covariance[np.ix_(fitted, fitted)] = plain * np.outer(wider, wider)
    # A parameter that changes nothing has an infinite variance.
    silent = np.setdiff1d(np.flatnonzero(~np.any(slopes != 0.0, axis=0)), held)
    covariance[silent, silent] = np.inf
    # Noise terms that are fitted already describe the correlation of the residual.
    widening = float(wider[0]) if len(noise) < 2 and 0 not in held else 1.0
    return Estimate(
        form, x, linear, covariance, residual, noise, loss, count, deviance, parameters, widening, tuple(held)
    )


def invert(matrix: Array) -> Array:
    """Return the inverse of normal equations whose columns are of very different size."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def _differentiate(problem: Problem, form: Form, x: Array, linear: Array) -> Array:
    """Return the derivative of the answer by each of ``x``, a column each."""
    if (known := form.slopes(problem, x)) is not None:
        return known
    low, high = form.limits(problem)
    columns = []
    for number, width in enumerate(form.widths(problem, x)):
        above, below = x.copy(), x.copy()
        above[number], below[number] = min(x[number] + width, high[number]), max(x[number] - width, low[number])
        change = form.columns(problem, above) - form.columns(problem, below)
        change = change @ linear if len(linear) else change[:, 0]
        columns.append(change / (above[number] - below[number]))
    return np.column_stack(columns)


def _newey_west(jacobian: Array, white: Array, inverse: Array, width: int = 0) -> Array:
    """Return the covariance for a residual that is correlated over a few rows, at least ``width``.

    The width is that of Newey and West (1994), 4 (n / 100)^(2/9) rows.
    """
    scores = jacobian * white[:, None]
    width = min(max(int(np.ceil(4.0 * (len(white) / 100.0) ** (2.0 / 9.0))), width), len(white) // 4)
    middle = scores.T @ scores
    for lag in range(1, width + 1):
        product = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (width + 1.0)) * (product + product.T)
    return np.asarray(inverse @ middle @ inverse)


def find_profile_end(
    value: float, limit: float, width: float, wanted: float, drop: Callable[[float], float], near: float = 0.08
) -> float:
    """Return where a profile likelihood has fallen by ``wanted`` deviations between ``value`` and ``limit``.

    ``drop``: root of twice the fall of the log-likelihood at a value; ``near``: relative tolerance of it.
    """
    inside, outside = value, limit
    at = value + float(np.copysign(min(width, abs(limit - value)), limit - value))
    for _ in range(12):
        by = drop(at)
        if by < wanted:
            inside = at
        else:
            outside = at
        if abs(by - wanted) < near * wanted or inside == limit:
            break
        guess = value + (at - value) * wanted / max(by, 0.3 * wanted)
        between = min(inside, outside) < guess < max(inside, outside)
        at = guess if between else (limit if outside == limit else 0.5 * (inside + outside))
    return at


def bound_delay(
    problem: Problem, estimate: Estimate, above: float = 0.0, near: float = 0.08, deviations: float = 1.96
) -> tuple[float, float]:
    """Return 95 % bounds of the delay [s] by its profile; of noise of order 0 or 1 as much wider as robust deviations.

    ``above``: by how much the deviance is above one that the bounds are measured from; ``near`` is near enough.
    """
    if 0 in estimate.held:
        return estimate.delay, estimate.delay
    width = max(1.96 * estimate.deviation(0) / estimate.widening, 1e-3 * problem.step)
    ends = []
    for limit in (end[0] for end in estimate.form.limits(problem)):
        x, noise = estimate.x, estimate.noise

        def drop(at: float) -> float:
            nonlocal x, noise
            x, noise, loss = solve(problem, estimate.form, np.array([at, *x[1:]]), noise, (0, *estimate.held))
            return float(np.sqrt(max(estimate.rows * np.log(loss / estimate.loss) + above, 0.0)))

        ends.append(find_profile_end(estimate.delay, float(limit), width, deviations * estimate.widening, drop, near))
    return ends[0], ends[1]
