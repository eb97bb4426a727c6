"""What differs between the stretches of a log: its halves' parameters, and how late its movements are answered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.bench.fit import Estimate, Part, Problem, fit, slopes
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
Fitted = TypeVar("Fitted")


class Answered(NamedTuple):
    """What a model leaves over of logs, and by how much that changes with the delay; rows as ``Problem.output``."""

    residual: Array  # output's unit
    slope: Array  # of the model over the delay, output's unit a second
    memory: float  # of the noise, from one row to the next
    total: float  # s, delay and lags together


class Delays(NamedTuple):
    """How much later than its log's mean each stretch is answered."""

    late: Array  # s, of one log behind the other
    deviations: Array  # s, by noise
    p: float  # with which noise alone spreads them so

    @property
    def differ(self) -> bool:
        """Whether they differ by more than noise."""
        return self.p < SIGNIFICANCE

    def spread(self, moves: Array | None = None) -> float:
        """Return the standard deviation of the delays, or of ``moves`` by them, without what noise adds, s."""
        late = self.late if moves is None else moves
        return float(np.sqrt(max(float(np.mean(late**2) - np.mean(self.deviations**2)), 0.0)))

    @property
    def mean_deviation(self) -> float:
        """Standard deviation of the mean delay, s, by what the delays are apart beyond noise."""
        return self.spread() / float(np.sqrt(len(self.late)))


def measure_delays(problem: Problem, answered: Answered, spans: Sequence[Spans]) -> Delays:
    """Return how late the stretches between these rows of each log are answered."""
    from scipy.special import fdtrc

    columns, white = (problem.whiten(rows, answered.memory) for rows in (answered.slope, answered.residual))
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


def find_stretches(problem: Problem, answered: Answered) -> list[Spans]:
    """Return the stretches of each log whose answers' delays are compared; none of one that has too few movements.

    A command that is held is cut where it moves, another anywhere; each is longer than two times delay and lags
    together, and has a twelfth of what the log tells of the delay.
    """
    columns, spans, begin = problem.whiten(answered.slope, answered.memory), [], 0
    for part in problem.parts:
        column = columns[begin : begin + len(part.times)]
        begin += len(part.times)
        spans.append(_stretches(part, np.concatenate([[0.0], np.cumsum(column**2)]), LONG * answered.total))
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


def answer_lags(problem: Problem, estimate: Estimate) -> Answered:
    """Return how a form as fitted answers logs."""
    slope = slopes(problem, estimate)[:, 0]
    return Answered(problem.residual(estimate), slope, estimate.memory, estimate.total[0])


def model_delays(
    problem: Problem, answered: Answered, spans: Sequence[Spans] = ()
) -> tuple[Delays | None, list[Spans]]:
    """Return how late the stretches of logs are answered, beside a model as fitted; None where there are none."""
    spans = spans or find_stretches(problem, answered)
    return (measure_delays(problem, answered, spans) if any(spans) else None), list(spans)


def follow_delays(
    problem: Problem, fitted: Fitted, answer: Callable[[Problem, Fitted], Answered],
    refit: Callable[[Problem, Fitted], Fitted], delays: Delays, spans: Sequence[Spans],
) -> tuple[Problem, Fitted, Array, float]:  # fmt: skip
    """Return logs whose rows are moved so that all stretches are answered alike, the fit, the moves and their spread.

    Moves are in s; they are those of the stretches where these tell the delay, and go straight between.
    """
    answered = answer(problem, fitted)
    moves, moved, total = np.zeros(len(delays.late)), problem, answered.total
    middles = _middles(problem, answered, spans)
    for _ in range(ROUNDS):
        moves = moves + np.clip(delays.late, -total, total)
        moved = _moved(problem, middles, moves)
        fitted = refit(moved, fitted)
        answered = answer(moved, fitted)
        delays, total = measure_delays(moved, answered, spans), answered.total
        if np.all(np.abs(delays.late) < LEAST_MOVE * delays.deviations):
            break
    return moved, fitted, moves, delays.spread(moves)


def _middles(problem: Problem, answered: Answered, spans: Sequence[Spans]) -> list[Array]:
    """Return the times of each log about which its stretches tell the delay: behind a step, not amid a long hold."""
    weights, middles, begin = problem.whiten(answered.slope, answered.memory) ** 2, [], 0
    for part, own in zip(problem.parts, spans, strict=True):
        weight = weights[begin : begin + len(part.times)] + 1e-300
        begin += len(part.times)
        middles.append(np.array([np.average(part.times[a:b], weights=weight[a:b]) for a, b in own]))
    return middles


def _moved(problem: Problem, middles: Sequence[Array], moves: Array) -> Problem:
    parts, begin = [], 0
    for part, own in zip(problem.parts, middles, strict=True):
        late = np.interp(part.times, own, moves[begin : begin + len(own)]) if len(own) else 0.0
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


def widen(problem: Problem, estimate: Estimate, moves: Sequence[Array], deviation: float) -> Estimate:
    """Return an estimate as uncertain as its parameters, those in front, may each have moved by ``moves``.

    ``deviation``: of the delay by a clock beside another, s; infinite where nothing tells it.
    """
    low, high = float(problem.limits(estimate.form)[0][0]), problem.longest_delay
    moves = [*moves, np.array([min(deviation, high - low)])]
    covariance = estimate.covariance.copy()
    for move in moves:
        covariance[: len(move), : len(move)] += np.outer(move, move)
    half = DEVIATIONS_95 * float(np.sqrt(sum(float(move[0]) ** 2 for move in moves)))
    below, above = (float(np.hypot(estimate.delay - end, half)) for end in estimate.delay_bounds)
    bounds = max(estimate.delay - below, low), min(estimate.delay + above, high)
    return replace(estimate, covariance=covariance, delay_bounds=(low, high) if np.isinf(deviation) else bounds)


def clock_moves(estimate: Estimate, rates: float, spread: float, others: Sequence[Estimate]) -> list[Array]:
    """Return by how much a clock may have moved parameters of ``x``, and the gain behind them.

    Its rate, unsure by ``rates``, relative, moves all times; stretches' delays, ``spread`` s, are also had as lag; and
    another reading of the clock has other values, where one of ``others`` is of the same form.
    """
    times = np.array([name.endswith("_s") for name in estimate.form.names], float)
    lags = times * (np.arange(len(times)) > 0)
    moves = [rates * times * estimate.x, spread * lags]
    same = [one for one in others if one.form == estimate.form]
    return [*moves, *(np.array([*(estimate.x - one.x), estimate.gain - one.gain]) for one in same)]
