"""How a log's clock is read: time stamps or rows at a fixed rate, one delay or one for each stretch; for any model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from cosim.base.arrays import Array
from cosim.identify.bench.evidence import Misfit
from cosim.identify.bench.fit import Problem
from cosim.identify.bench.record import BenchRecord
from cosim.identify.bench.timing.stretches import Answered, Delays, follow_delays, model_delays
from cosim.identify.engine_file import DEVIATIONS_95

CLEAR = 10.0  # by which Schwarz' criterion has to fall for a zero that drifts, or rise for a form to be refuted
Fitted = TypeVar("Fitted")


class Reading(NamedTuple, Generic[Fitted]):
    """Logs by the clock that explains them better; what the other leaves in doubt."""

    records: Sequence[BenchRecord]
    fitted: Fitted
    rates: float = 0.0  # relative, by which the clock's rate is not known
    other: Fitted | None = None  # by the other reading, where neither is clearly better


def choose_clock(
    records: Sequence[BenchRecord], by_stamps: Fitted, criterion: Callable[[Fitted], float],
    refit: Callable[[Sequence[BenchRecord]], Fitted], notes: list[str],
) -> Reading[Fitted]:  # fmt: skip
    """Return logs by their time stamps or, where these wander, by rows at a fixed rate: what explains them better.

    ``criterion`` is Schwarz' of a fit; the rate is unsure where it is not the stamps that are clearly better.
    """
    wandering = [record.even for record in records if record.even is not None]
    if not wandering:
        return Reading(records, by_stamps)
    by_rows = [record.on_even_rows() for record in records]
    fitted = refit(by_rows)
    better = criterion(by_stamps) - criterion(fitted)
    if better < -CLEAR:
        return Reading(records, by_stamps)
    size, rates = max(one.size for one in wandering), max(one.rates for one in wandering)
    notes.append(
        f"the time stamps wander by {size:.3g} s about rows that follow each other at a fixed rate, their own rate by "
        f"{100.0 * rates:.2g} %: a clock that runs slow, then quick; "
        + ("the log is explained better by the rows, which are taken" if better > CLEAR else "both explain the log")
        + f"; the bounds of delay and lags are wider by {100.0 * DEVIATIONS_95 * rates:.2g} % of them"
    )
    doubted = abs(better) <= CLEAR
    if better > 0.0:
        return Reading(by_rows, fitted, rates, by_stamps if doubted else None)
    return Reading(records, by_stamps, rates, fitted)


class Model(NamedTuple, Generic[Fitted]):
    """How logs are answered by a fit, fitted again with moved rows, and judged."""

    answer: Callable[[Problem, Fitted], Answered]
    refit: Callable[[Problem, Fitted], Fitted]
    judge: Callable[[Problem, Fitted], Misfit]


class Followed(NamedTuple, Generic[Fitted]):
    """Logs whose stretches are answered alike, or as they were where these do or where that does not explain them."""

    problem: Problem
    fitted: Fitted
    spread: float = 0.0  # s, of the stretches' delays where they differ by more than noise, else of their mean
    is_moved: bool = False


def follow_clock(
    problem: Problem, fitted: Fitted, model: Model[Fitted], notes: list[str],
    criterion: Callable[[Fitted], float] | None = None,
) -> Followed[Fitted]:  # fmt: skip
    """Return logs whose stretches are answered alike, where they are not by more than noise, and their spread.

    Where they are, the spread is what the mean delay owes to it.
    Where the model does not explain the logs they stay as they are, and without a ``criterion`` it is said whether
    that would.  With one, Schwarz' of a fit, they stay so too unless it is clearly for a delay of each stretch: what an
    engine lacks moves them as well.
    """
    delays, spans = model_delays(problem, model.answer(problem, fitted))
    if delays is None or not delays.differ:
        return Followed(problem, fitted, 0.0 if delays is None else delays.mean_deviation)
    failed = model.judge(problem, fitted).failed
    if failed and criterion is not None:
        return _hold_spread(problem, fitted, delays, notes)
    moved, found, moves, spread = follow_delays(problem, fitted, model.answer, model.refit, delays, spans)
    if criterion is not None:
        added = (len(delays.late) - sum(map(bool, spans))) * float(np.log(len(problem.output)))
        if criterion(found) + added > criterion(fitted) - CLEAR:
            return _hold_spread(problem, fitted, delays, notes)
    if failed:
        if not model.judge(moved, found).failed:
            notes.append(
                f"{_apart(moves)}: an output whose clock wobbles by that against the command's would explain the log"
            )
        return Followed(problem, fitted, spread)
    notes.append(
        f"{_apart(moves)}: a clock that wobbles, or an ECU that reads its command at intervals; each is fitted with "
        "its own delay, and the bounds hold their spread"
    )
    return Followed(moved, found, spread, True)


def _hold_spread(problem: Problem, fitted: Fitted, delays: Delays, notes: list[str]) -> Followed[Fitted]:
    """Return logs as they are, with the spread of the stretches' delays, and note it."""
    notes.append(f"{_apart(delays.late)}: a clock that wobbles, or what the engine lacks; the delay's bounds hold it")
    return Followed(problem, fitted, delays.spread())


def _apart(late: Array) -> str:
    return f"stretches of the log are answered {1e3 * np.ptp(late):.3g} ms apart, by more than noise"
