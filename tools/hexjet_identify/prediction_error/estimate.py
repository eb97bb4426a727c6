"""Poles behind a delay, fitted to stretches of a flight's log: starts, forms of more and fewer lags, and bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.fit.estimate import Estimate, bound_delay, compute_residual, estimate_at, project, solve
from hexjet_identify.fit.forms import Poles
from hexjet_identify.fit.problem import Problem


def identify_poles(
    problem: Problem, is_engine: bool, hold: Mapping[str, float], lags: int | None = None
) -> list[Estimate]:
    """Fit the form with this number of lags, or two forms if it is None, the best by Akaike's criterion first.

    The bounds of the delay are of the best, and of the richest: which holds the others, and no data refute it.
    """
    fewest = (0 if is_engine else 1) if lags is None else lags
    simple = fit_poles(problem, Poles(is_engine, fewest), hold)
    if lags is not None:
        return [_add_delay_bounds(problem, simple)]
    rich = fit_poles(problem, Poles(is_engine, fewest + 1), hold, simple)
    low, high = bound_delay(problem, rich, near=0.01)
    # A form with a lag less that is not refuted is the richer one with a lag of nothing, which a search only nears.
    # From there the deviance falls as an even mixture of chi-squared of one and two degrees of freedom if it is true,
    # 95 % of which lie below 5.14 (Self and Liang, J. Am. Stat. Assoc. 82, 1987, p. 605).
    above = simple.deviance - rich.deviance - 5.138
    if above < 0.0:
        ends = bound_delay(problem, simple, above + 3.841, 0.01)
        low, high = min(low, ends[0]), max(high, ends[1])
    both = [_add_delay_bounds(problem, simple), replace(rich, delay_bounds=(low, high))]
    return sorted(both, key=lambda estimate: estimate.aic)


def _add_delay_bounds(problem: Problem, estimate: Estimate) -> Estimate:
    return replace(estimate, delay_bounds=bound_delay(problem, estimate, near=0.01))


def fit_poles(problem: Problem, form: Poles, hold: Mapping[str, float], near: Estimate | None = None) -> Estimate:
    """Fit poles from several starts and return the best; from ``near``, with one lag less, if given.

    Raises InputError for an unknown name in ``hold``.
    """
    for name in hold:
        if name not in form.names:
            raise InputError(f"hold {name}: not a parameter of this form; allowed: {', '.join(form.names)}")
    held = [form.names.index(name) for name in hold]
    # Two forms are compared on the same equations, which the order of the noise decides.
    order = None if near is None else near.noise
    tried = []
    for x in _list_starts(problem, form) if near is None else _list_starts_with_another_lag(near):
        x[held] = list(hold.values())
        tried.append(_fit_with_noise(problem, form, x, held, order))
    best = min(tried, key=lambda each: each[2] / problem.equations(len(each[1])).sum())
    # With a command in rows the misfit has several minima over the delay within a row.
    for shift in problem.step * np.array([-1.0, -0.5, 0.5, 1.0]) if 0 not in held else ():
        beside = np.array([max(best[0][0] + shift, 0.0), *best[0][1:]])
        best = min(best, solve(problem, form, beside, best[1], held), key=lambda each: each[2])
    x, noise, _ = best
    low, high = form.limits(problem)
    at_end = np.isclose(x, low, rtol=1e-6, atol=1e-9 * problem.step) | np.isclose(x, high, rtol=1e-6)
    # A pole at its slow limit stays uncertain, and the gain with it.
    at_end[1] &= form.is_engine and x[1] > 2.0 * low[1]
    fixed = sorted({*held, *np.flatnonzero(at_end).tolist()})
    estimate = estimate_at(problem, form, x, noise, fixed, round(form.total(x) / problem.step))
    return replace(estimate, held=tuple(held))


def _fit_with_noise(
    problem: Problem, form: Poles, x: Array, held: Sequence[int], noise: Array | None
) -> tuple[Array, Array, float]:
    """Fit poles from a start together with noise: of the order of ``noise``, or of the best order if it is None."""
    if noise is not None:
        residual = compute_residual(problem, form, x, project(problem, form, x, noise)[0])
        return solve(problem, form, x, problem.fit_noise(residual, len(noise)), held)
    found = solve(problem, form, x, np.array([0.98]), held)
    for _ in range(3):
        x, noise, _ = found
        residual = compute_residual(problem, form, x, project(problem, form, x, noise)[0])
        order = problem.best_order(residual, form.without_pole(x))
        if order == len(noise):
            break
        found = solve(problem, form, x, problem.fit_noise(residual, order), held)
    return found


def _list_starts(problem: Problem, form: Poles, lags: Sequence[float] = (0.5, 2.0, 8.0, 32.0)) -> list[Array]:
    """Return two starts of a fit: the likeliest of ``lags`` [rows], each at its best delay."""
    noise, tried = np.array([0.98]), []
    for lag in lags:
        seconds = min(lag * problem.step, 2.5)
        rate = 1.0 / seconds if form.is_engine else 0.3
        more = [(0.3 if form.is_engine else 1.0) * seconds * 0.6**i for i in range(form.lags)]
        for delay in np.linspace(0.0, problem.max_delay, 31):
            x = np.array([delay, rate, *more])
            tried.append((float(np.sum(project(problem, form, x, noise)[1] ** 2)), x))
    best = [min(tried[n : n + 31], key=lambda each: each[0]) for n in range(0, len(tried), 31)]
    return [x for _, x in sorted(best, key=lambda each: each[0])[:2]]


def _list_starts_with_another_lag(near: Estimate) -> list[Array]:
    """Return starts of a form with one more lag, as long as the last or shorter, taken out of the delay."""
    last = float(near.x[-1]) if len(near.x) > 2 else 1.0 / float(near.x[1])
    return [np.array([max(near.delay - lag, 0.0), *near.x[1:], lag]) for lag in (0.2 * last, last)]


def noise_only_deviance(problem: Problem, estimate: Estimate) -> float:
    """Return the deviance of noise alone, without the command, of the same order on the same equations."""
    columns, noise = estimate.form.columns(problem, estimate.x)[:, 1:], estimate.noise
    for _ in range(4):
        linear = np.linalg.lstsq(problem.whiten(columns, noise), problem.whiten(problem.output, noise))[0]
        residual = problem.output - columns @ linear
        noise = problem.fit_noise(residual, len(noise))
    loss = float(np.sum(problem.whiten(residual, noise) ** 2))
    return estimate.rows * float(np.log(loss / estimate.rows))


def estimate_dict(estimate: Estimate, step: float) -> dict[str, Any]:
    """Return one form's parameters, standard deviations, bounds and criteria, for JSON."""
    (total, deviation), (gain, gain_deviation), found = estimate.total, estimate.gain, estimate.to_dict()
    names = list(estimate.form.natural(estimate.x))
    return {
        **found,
        "gain": gain,
        "standard_deviations": {"gain": gain_deviation, **found["standard_deviations"]},
        "delay_samples": estimate.delay / step,
        "all_delay_s": total,
        "all_delay_deviation_s": deviation,
        "noise_order": len(estimate.noise),
        "held": [names[n] for n in estimate.held],
        "equations": estimate.rows,
        "residual_rms": float(np.sqrt(estimate.loss / estimate.rows)),
        "aic": estimate.aic,
    }
