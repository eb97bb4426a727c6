"""How sure an estimate is: the delay's profile likelihood, and a covariance that holds where the form is only near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hexjet_identify.fit.estimate import find_end
from hexjet_identify.prediction_error.estimate import Estimate, Form
from hexjet_identify.prediction_error.problem import Problem
from hexjet_identify.prediction_error.search import evaluate, fit, jacobian_at, solve

CHI2_95 = 3.841458820694124  # of one degree of freedom
MIXED_95 = 5.1383807853214485  # of an even mixture of chi-squared of one and of two degrees of freedom
LEAST_BLOCKS = 3  # times the parameters: fewer blocks do not tell a covariance; chosen by us


def identify(
    problem: Problem, engine: bool, keep: dict[str, float] | None = None, form_count: int = 2
) -> list[Estimate]:
    """Return the estimates of so many forms, each with a lag more, the best by Akaike's criterion first.

    The bounds of the delay are of the best, and of the richest: which holds the others, and no data refute it.
    """
    fewest = 0 if engine else 1
    estimates: list[Estimate] = []
    for lags in range(fewest, fewest + form_count):
        estimates.append(fit(problem, Form(engine, lags), keep, estimates[-1] if estimates else None))
    richest = with_delay_bounds(problem, estimates.pop())
    ends = [richest.delay_bounds]
    for simpler in estimates:  # one that is not refuted is the richest with a lag of nothing, which Newton only nears
        if "delay_s" not in simpler.fixed and simpler.deviance < richest.deviance + MIXED_95:
            ends.append(with_delay_bounds(problem, simpler, richest.deviance).delay_bounds)
    richest = replace(richest, delay_bounds=(min(low for low, _ in ends), max(high for _, high in ends)))
    bounded = [*(with_delay_bounds(problem, estimate) for estimate in estimates), richest]
    return sorted(bounded, key=lambda estimate: estimate.aic)


def with_delay_bounds(problem: Problem, estimate: Estimate, best: float | None = None) -> Estimate:
    """Return the estimate with the ends of the delay's profile likelihood, 95 %.

    They are where twice the likelihood's logarithm has fallen by chi-squared's 3.84 from that of the estimate.

    ``best`` is the deviance of a form with a lag more, of which the estimate is the end where that lag is nothing.
    The fall from there is distributed as an even mixture of chi-squared of one and two degrees of freedom if the
    estimate's form is the true one (Self and Liang, J. Am. Stat. Assoc. 82, 1987, p. 605), and may be 5.14.
    """
    last, form_names = len(estimate.x) - 1, estimate.form.names
    if form_names[last] in estimate.fixed:
        return replace(estimate, delay_bounds=(estimate.delay, estimate.delay))
    above = 0.0 if best is None else estimate.deviance - best - MIXED_95 + CHI2_95
    held = [*(form_names.index(name) for name in estimate.fixed), last]
    wide = max(1.96 * estimate.deviation(last), 1e-4 * problem.working_step)
    ends = []
    for limit in (0.0, problem.longest_delay):
        near = estimate

        def risen(delay: float) -> float:
            nonlocal near
            near = solve(problem, estimate.form, np.array([*near.x[:-1], delay]), near.ar, held, estimate.order)
            return float(np.sqrt(max(near.deviance - estimate.deviance + above, 0.0)))

        ends.append(find_end(estimate.delay, limit, wide, float(np.sqrt(CHI2_95)), risen, 0.01))
    return replace(estimate, delay_bounds=(ends[0], ends[1]))


def robust(problem: Problem, estimate: Estimate) -> Estimate:
    """Return the estimate with the covariance that also holds where the form is only near the truth.

    It holds where the noise changes its size, too: ``H^-1 (sum of g g') H^-1``, H the sum of squares' curvature and g
    its slope over a block of equations as long as delay and lags together, within which what is left over may hang
    together (White, Econometrica 50, 1982, p. 1; in blocks Liang and Zeger, Biometrika 73, 1986, p. 13).  Of few blocks
    it says little: then, and for what it would make surer, the covariance stays.
    """
    free = estimate.free
    point = evaluate(problem, estimate.form, estimate.x, estimate.linear, estimate.ar)
    jacobian = jacobian_at(problem, estimate.form, point, free)
    indices = [*free, *range(len(estimate.x), len(estimate.covariance))]
    determined = [n for n, index in enumerate(indices) if estimate.covariance[index, index] > 0.0]
    rows = [indices[n] for n in determined]
    jacobian = jacobian[:, determined]
    count, parameters = jacobian.shape
    block = max(1, round(estimate.all_delay[0] / problem.working_step))
    starts = np.arange(0, count, block)
    if len(starts) < LEAST_BLOCKS * parameters:
        return estimate
    slopes = np.add.reduceat(jacobian * point.white[:, None], starts)
    variance = estimate.loss / (count - parameters)
    inverse = estimate.covariance[np.ix_(rows, rows)] / variance
    fraction = len(starts) / (len(starts) - 1) * (count - 1) / (count - parameters)
    sandwich = fraction * inverse @ (slopes.T @ slopes) @ inverse
    covariance = estimate.covariance.copy()
    covariance[np.ix_(rows, rows)] = sandwich
    wider = replace(estimate, covariance=covariance)
    chosen = wider if wider.all_delay[1] > estimate.all_delay[1] else estimate
    variances = np.stack([np.diag(estimate.covariance), np.diag(covariance)])[:, rows]
    factors = np.ones(len(covariance))
    factors[rows] = np.sqrt(variances.max(axis=0) / np.diag(chosen.covariance)[rows])
    return replace(chosen, covariance=chosen.covariance * np.outer(factors, factors))
