"""Whether a form explains its logs: the size of what is left over, and movements that it had not seen."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isnan
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from hexjet_identify.fit.estimate import Estimate, project, solve
from hexjet_identify.fit.logs import Log, smooth
from hexjet_identify.fit.problem import Problem

# Shares of a movement's change whose times are compared.
CROSSING_SHARES = (0.1, 0.5, 0.9)


class PredictedMovement(NamedTuple):
    """One movement of the command, predicted by the form as fitted to every second other one.

    ``log`` counts from 0; times in s, outputs in their unit; no times where a movement goes nowhere, or is passed.
    ``slack``: by how much a row and noise may move each time, s.
    """

    log: int
    begin: float
    first: float
    last: float
    rms: float
    measured: tuple[float, ...] = ()
    model: tuple[float, ...] = ()
    slack: tuple[float, ...] = ()

    @property
    def off(self) -> tuple[float, ...]:
        """Relative error of each time; infinite if the model never reaches the level."""
        return tuple(inf if isnan(b) else b / a - 1.0 for a, b in zip(self.measured, self.model, strict=True))

    def count_near(self, share: float = 0.1) -> int:
        """Return how many times are within ``share`` of the measured one, allowing for ``slack``."""
        each = zip(self.measured, self.model, self.slack, strict=True)
        return sum(abs(b - a) <= share * a + slack for a, b, slack in each)

    def to_dict(self) -> dict[str, object]:
        """Return the movement for JSON."""
        return self._asdict() | {"model": [None if isnan(time) else time for time in self.model]}


class Verdict(NamedTuple):
    """Residual and predicted times, which alone decide whether a form explains its logs.

    ``off``: what is left over of movements (rms), averaged over a quarter of delay and lags together, as a share of the
    range; ``near`` of ``times`` that were predicted are within 10 %, but for a row and noise.
    """

    off: float
    near: int
    times: int

    @property
    def is_explained(self) -> bool:
        """Whether the residual is small and most of the held-back times are near.

        3 % of the range are allowed; 1.5 % where fewer than six times could be held back.
        """
        return self.off <= (0.03 if self.times >= 6 else 0.015) and self.near >= 0.8 * self.times

    @property
    def words(self) -> str:
        """The verdict in a line."""
        off = f"{100.0 * self.off:.2g} %" if self.off < 1.0 else "more than the range"
        times = f", {self.near} of {self.times} times" if self.times else ""
        if self.is_explained:
            return f"explained to {off} of the range{times}{' within 10 %' if times else ''}"
        return f"not explained: {off}{times}"


def judge(problem: Problem, estimate: Estimate, total: float, held_back: tuple[PredictedMovement, ...]) -> Verdict:
    """Return the verdict on a form; ``total``: delay and lags together, s.

    A movement lasts until three times that after the command last moved, so that long holds hide nothing.  The range is
    that of the model's answer, which noise does not widen.
    """
    quarter = 0.25 * total
    residual = np.concatenate([smooth(log.times, estimate.residual[rows], quarter) for log, rows in problem.parts])
    moving = np.concatenate([log.moves_within(3.0 * total if total > 0.0 else np.inf) for log in problem.logs])
    reach = min(float(np.ptp(problem.output - estimate.residual)), problem.swing)
    off = float(np.sqrt(np.mean(residual[moving if moving.any() else ~moving] ** 2))) / max(reach, 1e-300)
    times = sum(len(one.measured) for one in held_back)
    return Verdict(off, sum(one.count_near() for one in held_back), times)


def predict_held_back(problem: Problem, estimate: Estimate, total: float) -> tuple[PredictedMovement, ...]:
    """Fit the form to every second movement and predict the others, then the other way round.

    It takes four movements, before each of which the command stands for two times ``total`` s.
    """
    spans = [(number, span) for number, log in enumerate(problem.logs) for span in log.find_movements(2.0 * total)]
    if len(spans) < 4:
        return ()
    predicted = []
    for parity in (0, 1):
        others = _exclude_movements(problem, spans[parity::2])
        part = problem.at(others)
        x = solve(part, estimate.form, estimate.x, estimate.noise)[0]
        fitted = replace(estimate, x=x, linear=project(part, estimate.form, x, estimate.noise)[0])
        answer = fitted.answer(problem)
        for number, span in spans[parity::2]:
            log, rows = problem.logs[number], problem.spans[number]
            predicted.append(_compare_movement(number, log, answer[rows], span, 0.1 * total, 0.1 * problem.swing))
    return tuple(sorted(predicted, key=lambda one: one[:2]))


def _exclude_movements(problem: Problem, spans: list[tuple[int, tuple[float, float]]], least: int = 20) -> Flags:
    """Return the rows outside of these movements; a log with fewer than ``least`` such rows stays whole."""
    kept = np.ones(len(problem.output), bool)
    for number, (begin, end) in spans:
        times = problem.logs[number].times
        kept[problem.spans[number]] &= (times < begin) | (times >= end)
    for rows in problem.spans:
        if kept[rows].sum() < least:
            kept[rows] = True
    return kept


def _compare_movement(
    number: int, log: Log, answer: Array, span: tuple[float, float], seconds: float, least: float
) -> PredictedMovement:
    """Compare a predicted with the measured movement, averaged over ``seconds``; times need ``least`` change."""
    use = (log.times >= span[0]) & (log.times < span[1])
    courses = [smooth(log.times, values, seconds) for values in (log.output, answer)]
    last = max(2, round(0.1 * np.count_nonzero(use)))
    before = np.flatnonzero(log.times < span[0])[-last:]
    firsts = [float(course[before].mean() if len(before) else course[use][0]) for course in courses]
    ends = [float(course[use][-last:].mean()) for course in courses]
    rms = float(np.sqrt(np.mean((log.output - answer)[use] ** 2)))
    found = PredictedMovement(number, span[0], firsts[0], ends[0], rms)
    if np.count_nonzero(use) < 5 or abs(ends[0] - firsts[0]) < least:
        return found
    times = log.times[use] - span[0]
    measured, model = (
        _find_crossing_times(times, course[use], first, end)
        for course, first, end in zip(courses, firsts, ends, strict=True)
    )
    if any(isnan(time) or not time > 0.0 for time in measured):
        return found
    # White noise is estimated from differences of successive rows; averaging n rows divides its variance by n.  Where
    # the answer is slow it moves a time by so much, and by three tenths of it at most.
    noise = float(np.median(np.abs(np.diff(log.output)))) / 0.954 / np.sqrt(2 * int(0.5 * seconds / log.step) + 1)
    rates = np.interp(measured, times, np.abs(np.gradient(courses[1][use], times)))
    slack = log.step + np.minimum(noise / np.maximum(rates, 1e-300), 0.3 * np.array(measured))
    return found._replace(measured=measured, model=model, slack=tuple(slack.tolist()))


def _find_crossing_times(times: Array, values: Array, first: float, end: float) -> tuple[float, ...]:
    """Return the first times [s] at which CROSSING_SHARES of the change are passed; nan for one that never is."""
    way = (values - first) / (end - first if end != first else np.nan)
    found = []
    for share in CROSSING_SHARES:
        above = np.flatnonzero(way >= share)
        k = int(above[0]) if len(above) else 0
        found.append(float(np.interp(share, way[k - 1 : k + 1], times[k - 1 : k + 1])) if k else float("nan"))
    return tuple(found)


def spread_of_delay(problem: Problem, estimate: Estimate, total: float, row: float) -> float:
    """Return by how much to widen the delay's bounds [s] because movements are answered at varying delays.

    The spread beyond noise is DerSimonian and Laird's (1986), taken where it is significant (p < 0.01); one within a
    ``row`` [s] of the command, as of an ECU that reads at intervals, averages out over the movements.
    """
    from scipy.special import chdtrc

    width = max(0.25 * problem.step, 1e-4)
    early, late = (estimate.answer(problem, estimate.delay + sign * width) for sign in (-1.0, 1.0))
    slope, left = (late - early) / (2.0 * width), estimate.residual
    memory = problem.memory_of(left)
    variance = float(np.mean(left**2)) * (1.0 + memory) / (1.0 - memory)
    found = []
    for log, rows in problem.parts:
        for begin, end in log.find_movements(2.0 * total):
            use = (log.times >= begin) & (log.times < end)
            found.append((float(np.sum(slope[rows][use] ** 2)), float(np.sum((slope * left)[rows][use]))))
    power, product = np.array(found or [(0.0, 0.0)]).T
    told = power > 0.05 * power.max()
    if told.sum() < 4 or not variance > 0.0:
        return 0.0
    shift, weight = product[told] / power[told], power[told] / variance
    heterogeneity = float(np.sum(weight * (shift - np.average(shift, weights=weight)) ** 2))
    if chdtrc(len(shift) - 1, heterogeneity) > 0.01:
        return 0.0
    scale = float(weight.sum() - np.sum(weight**2) / weight.sum())
    spread = float(np.sqrt(max(heterogeneity - (len(shift) - 1), 0.0) / scale))
    return 1.96 * spread / (float(np.sqrt(len(shift))) if spread < row else 1.0)


def describe_movements(held_back: tuple[PredictedMovement, ...], unit: str, reach: float) -> list[list[str]]:
    """Return a row of a table for each movement; :data:`MOVEMENT_COLUMNS` has its head."""
    several = any(one.log for one in held_back)
    return [
        [
            f"{f'log {one.log + 1}, ' if several else ''}{one.begin:.5g} s",
            f"{one.first:.4g} to {one.last:.4g} {unit}".strip(),
            f"{100.0 * one.rms / reach:.2g} %",
            *(
                f"{time:.3g} s ({'never' if off == inf else f'{100.0 * off:+.0f} %'})"
                for time, off in zip(one.measured, one.off, strict=True)
            ),
            *([""] * (len(CROSSING_SHARES) - len(one.measured))),
        ]
        for one in held_back
    ]


MOVEMENT_COLUMNS: Any = ("movement", "output", "off, of the range", "measured to 10 %", "50 %", "90 %")
