"""What differs between the stretches of a log: its halves' parameters, and how late its movements are answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.bench.fit import Estimate, Part, Problem, delay_slope, fit
from cosim.identify.engine_file import DEVIATIONS_95

HALVES_APART = 4.0  # standard deviations by which two halves of one log may differ: p = 6e-5
SIGNIFICANCE = 1e-3  # with which stretches are answered at different times
MOST_STRETCHES = 12  # of a log, each with as much of the answer
LEAST_STRETCHES = 3
LONG = 2.0  # delay and lags, as which a stretch is longer
ROUNDS = 8  # in which the rows are moved
LEAST_MOVE = 0.2  # of its deviation: by less no stretch is moved again
LEAST_ROW = 0.05  # of a row, that two rows are apart behind a move

Spans = list[tuple[int, int]]  # first row and the one behind the last, of one log


class Delays(NamedTuple):
    """How much later than its log's mean each stretch is answered."""

    late: Array  # s, of one log behind the other
    deviations: Array  # s
    p: float  # with which noise alone spreads them so

    @property
    def differ(self) -> bool:
        """Whether they differ by more than noise."""
        return self.p < SIGNIFICANCE


def measure_delays(problem: Problem, residual: Array, slope: Array, memory: float, spans: Sequence[Spans]) -> Delays:
    """Return how late the stretches between these rows of each log are answered.

    ``residual`` is what a model leaves over, ``slope`` [1/s] by how much it changes with the delay; ``memory`` is the
    noise's, from one row to the next.
    """
    from scipy.special import fdtrc

    columns, white = problem.whiten(slope, memory), problem.whiten(residual, memory)
    late, power, begin = [], [], 0
    for part, own in zip(problem.parts, spans, strict=True):
        column, left = columns[begin : begin + len(part.times)], white[begin : begin + len(part.times)]
        begin += len(part.times)
        powers = np.array([max(float(column[a:b] @ column[a:b]), 1e-300) for a, b in own])
        found = np.array([column[a:b] @ left[a:b] for a, b in own]) / powers
        late.append(found - (np.average(found, weights=powers) if own else 0.0))
        power.append(powers)
    delays, weights = np.concatenate(late), np.concatenate(power)
    explained = float(weights @ delays**2)
    freedom = len(delays) - sum(1 for own in spans if own)
    variance = max(float(white @ white) - explained, 1e-300) / max(len(white) - len(delays), 1)
    p = float(fdtrc(freedom, len(white) - len(delays), explained / freedom / variance))
    return Delays(delays, np.sqrt(variance / weights), p)


def find_stretches(problem: Problem, slope: Array, memory: float, total: float) -> list[Spans]:
    """Return the stretches of each log whose answers' delays are compared; none of one that has too few movements.

    A command that is held is cut where it moves, another anywhere; each is longer than two times ``total``, delay and
    lags together [s], and has a twelfth of what the log tells of the delay.
    """
    columns, spans, begin = problem.whiten(slope, memory), [], 0
    for part in problem.parts:
        column = columns[begin : begin + len(part.times)]
        begin += len(part.times)
        spans.append(_stretches(part, np.concatenate([[0.0], np.cumsum(column**2)]), LONG * total))
    return spans


def _stretches(part: Part, power: Array, shortest: float) -> Spans:
    moved = part.command_times[1:][np.diff(part.command) != 0.0]
    at = np.arange(part.times[0], part.times[-1], shortest) if part.straight else moved
    enough, cuts = float(power[-1]) / MOST_STRETCHES, [0]
    for edge in np.unique(np.searchsorted(part.times, at)).tolist():
        if edge == len(part.times):
            break
        if part.times[edge] - part.times[cuts[-1]] >= shortest and power[edge] - power[cuts[-1]] >= enough:
            cuts.append(edge)
    if len(cuts) > 1 and power[-1] - power[cuts[-1]] < enough:
        cuts.pop()
    return list(pairwise([*cuts, len(part.times)])) if len(cuts) >= LEAST_STRETCHES else []


def model_delays(
    problem: Problem, estimate: Estimate, spans: Sequence[Spans] = ()
) -> tuple[Delays | None, list[Spans]]:
    """Return how late the stretches of logs are answered, beside a form as fitted; None where there are none."""
    slope = delay_slope(problem, estimate)
    spans = spans or find_stretches(problem, slope, estimate.memory, estimate.total[0])
    if not any(spans):
        return None, list(spans)
    return measure_delays(problem, problem.residual(estimate), slope, estimate.memory, spans), list(spans)


def follow_delays(
    problem: Problem, estimate: Estimate, delays: Delays, spans: Sequence[Spans]
) -> tuple[Problem, Estimate, Array, float]:
    """Return logs whose rows are moved so that all stretches are answered alike, the fit, the moves and their spread.

    Moves are in s; between the middles of two stretches they go straight.
    """
    moves, moved, found = np.zeros(len(delays.late)), problem, estimate
    for _ in range(ROUNDS):
        moves = moves + np.clip(delays.late, -found.total[0], found.total[0])
        moved = _moved(problem, spans, moves)
        found = fit(moved, found.form, found)
        again, _ = model_delays(moved, found, spans)
        assert again is not None
        delays = again
        if np.all(np.abs(delays.late) < LEAST_MOVE * delays.deviations):
            break
    variance = float(np.mean(moves**2) - np.mean(delays.deviations**2))
    return moved, found, moves, max(variance, 0.0) ** 0.5


def _moved(problem: Problem, spans: Sequence[Spans], moves: Array) -> Problem:
    parts, begin = [], 0
    for part, own in zip(problem.parts, spans, strict=True):
        middles = [float(part.times[a:b].mean()) for a, b in own]
        late = np.interp(part.times, middles, moves[begin : begin + len(own)]) if own else 0.0
        begin += len(own)
        times = part.times - late
        rows = np.maximum(np.diff(times), LEAST_ROW * np.diff(part.times))
        parts.append(replace(part, times=times[0] + np.concatenate([[0.0], np.cumsum(rows)])))
    return Problem(parts, problem.longest_delay, problem.drift)


def fit_alone(problem: Problem, parts: Sequence[Part], chosen: Estimate) -> list[tuple[str, Array, Array]]:
    """Fit a form to each part alone: of each parameter, the gain last, its name, values and standard deviations."""
    fits = [fit(Problem([part], problem.longest_delay, problem.drift), chosen.form, chosen) for part in parts]
    values = np.array([[*one.x, one.gain] for one in fits]).T
    return [
        (name, values[i], np.array([one.deviation(i) for one in fits]))
        for i, name in enumerate((*chosen.form.names, "gain"))
    ]


def hold_both_halves(problem: Problem, chosen: Estimate) -> tuple[Estimate, list[str]]:
    """Return an estimate whose bounds hold the fits of both halves of a log, and what is to be said of that.

    It is the same where the halves agree to the noise, where there are several logs, and where a half has no movement.
    """
    if len(problem.parts) != 1:
        return chosen, []
    (part,), count = problem.parts, len(chosen.form.names) + 1
    moved = part.command_times[1:][np.diff(part.command) != 0.0]
    middle = float(np.median(moved)) if len(moved) else part.times[0]
    sides = [part.chosen(part.times < middle), part.chosen(part.times >= middle)]
    if not all(len(side.times) > 10 * count and np.ptp(side.output) > 0.0 for side in sides) or len(moved) < 4:
        return chosen, []
    halves = fit_alone(problem, sides, chosen)
    apart = [
        f"{name} {first:.4g} and {second:.4g}"
        for name, (first, second), deviations in halves
        if abs(second - first) > HALVES_APART * float(np.hypot(*deviations))
    ]
    if not apart:
        return chosen, []
    covariance = chosen.covariance.copy()
    covariance[np.arange(count), np.arange(count)] += [(second - first) ** 2 for _, (first, second), _ in halves]
    _, delays, deviations = halves[0]
    low = min(chosen.delay_bounds[0], *(delays - DEVIATIONS_95 * deviations))
    high = max(chosen.delay_bounds[1], *(delays + DEVIATIONS_95 * deviations))
    bounds = max(float(low), 0.0), min(float(high), problem.longest_delay)
    return replace(chosen, covariance=covariance, delay_bounds=bounds), [
        f"the log's halves, before {middle:.0f} s and after, differ by more than noise: {' and '.join(apart)}; two "
        "engines, an engine that changed, or a clock that does; the bounds hold both"
    ]


def stretch_times(problem: Problem, estimate: Estimate, rates: float) -> Estimate:
    """Return an estimate whose delay and lags are as uncertain as a clock's rate is, relative."""
    if rates == 0.0:
        return estimate
    scaled = np.zeros(len(estimate.covariance))
    for i, name in enumerate(estimate.form.names):
        scaled[i] = rates * estimate.x[i] if name.endswith("_s") else 0.0
    low, high = (
        (1.0 + sign * DEVIATIONS_95 * rates) * end for sign, end in zip((-1.0, 1.0), estimate.delay_bounds, strict=True)
    )
    bounds = max(low, 0.0), min(high, problem.longest_delay)
    covariance = estimate.covariance + np.outer(scaled, scaled)
    return replace(estimate, covariance=covariance, delay_bounds=bounds if np.isfinite(low) else estimate.delay_bounds)
