"""A model of an engine out of its bench logs: the form by evidence, how sure each number is, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, NotIdentifiedError
from hexjet_identify.bench.engine_table import engine_parameters
from hexjet_identify.bench.identification import Identification
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.remarks import describe_doubts, describe_untold
from hexjet_identify.fit.estimate import Estimate, bound_delay, find_start, fit, fit_limits, fit_static
from hexjet_identify.fit.evidence import PredictedMovement, judge, predict_held_back, spread_of_delay
from hexjet_identify.fit.forms import Lags, Limits
from hexjet_identify.fit.logs import Log
from hexjet_identify.fit.problem import Problem


class Choices(NamedTuple):
    """Options of the identification from bench logs.

    ``limits``: what throttle 0 and 1 are; ``between`` rows the command is ``held``, ``straight``, or ``auto``: by how
    it moves; ``longest_delay`` [s] that is looked for.
    """

    limits: tuple[float, float] | None = None
    between: str = "auto"
    longest_delay: float = 2.0


def identify_bench(records: Sequence[BenchRecord], choices: Choices | None = None) -> Identification:
    """Identify command to output of an engine's bench logs.

    Raises NotIdentifiedError where the logs do not move, and InputError for a range that cannot be.
    """
    choices = choices or Choices()
    notes: list[str] = []
    limits, known = throttle_limits(records, choices.limits, notes)
    fitted = _fit_lags(records, limits, choices, notes)
    static = fit_static(fitted.problem)
    held_back: tuple[PredictedMovement, ...] = ()
    if _is_static(fitted.estimates[0], static):
        problem, best, total, estimates = fitted.problem, static, 0.0, (static, *fitted.estimates)
    else:
        fitted = _try_limits_and_drift(fitted, notes)
        problem, best = fitted.problem, fitted.estimates[0]
        total = best.form.total(best.x)
        held_back = predict_held_back(problem, best, total)
        estimates = (replace(best, delay_bounds=_bound_delay(fitted, records, total, notes)), *fitted.estimates[1:])
    verdict = judge(problem, best, total, held_back)
    notes = [*(note for record in records for note in record.notes), *notes]
    found = Identification(
        tuple(records), problem, limits, known, estimates, total, verdict, held_back, tuple(dict.fromkeys(notes))
    )
    found = compare_logs(found)
    return replace(found, notes=(*describe_doubts(found), *found.notes), untold=tuple(describe_untold(found)))


def _is_static(best: Estimate, static: Estimate, clear: float = 10.0, wide: float = 0.5) -> bool:
    """Return whether the logs determine the static line alone: BIC is hardly worse without lags, or bounds are wide.

    What they explain the half of is told, whatever noise with memory makes of the rest.
    """
    value, deviation = best.total
    is_no_better = float(np.mean(static.residual**2)) < 2.0 * float(np.mean(best.residual**2))
    return is_no_better and (static.bic < best.bic + clear or 1.96 * deviation >= wide * value)


def check_moves(record: BenchRecord) -> None:
    """Raise NotIdentifiedError for a log in which command or output stands still."""
    inside = record.command_times <= record.times[-1]
    if not inside.any() or not np.ptp(record.command[inside]) > 0.0:
        raise NotIdentifiedError(
            f"{record.path}: {record.command_name} does not move; step it: a step up and one down, "
            "each held until the output stands still"
        )
    if not np.ptp(record.output) > 0.0:
        raise NotIdentifiedError(f"{record.path}: {record.output_name} does not move")


def throttle_limits(
    records: Sequence[BenchRecord], given: tuple[float, float] | None, notes: list[str], room: float = 0.05
) -> tuple[tuple[float, float], bool]:
    """Return what throttle 0 and 1 are, and whether that is known: as given, by the unit, or by how far it goes.

    ``room``: the share of the range by which a command may go beyond its ends.
    """
    low = min(float(record.command.min()) for record in records)
    high = max(float(record.command.max()) for record in records)
    name, unit = records[0].command_name, records[0].command_unit
    if given is not None:
        words, beyond = f"throttle_range {given[0]:g} {given[1]:g}", room * (given[1] - given[0])
        if not given[1] > given[0]:
            raise InputError(f"{words}: the second must be above the first")
        if low < given[0] - beyond or high > given[1] + beyond:
            raise InputError(
                f"{words}: {name} goes from {low:g} to {high:g}; allowed: {100.0 * room:.0f} % of the range beyond "
                "its ends"
            )
        return given, True
    is_bare = unit in ("", "1", "-", "0..1", "0-1", "0/1") and low >= 0.0
    if unit == "percent" and 1.0 + room < high <= 100.0 * (1.0 + room):
        return (0.0, 100.0), True
    if (is_bare or unit == "us") and low >= 900.0 and high <= 2100.0:
        notes.append(f"{name}: 1000 to 2000 us are taken for throttle 0 to 1; throttle_range LOW HIGH says otherwise")
        return (1000.0, 2000.0), True
    if is_bare and high <= 1.0 + room:
        return (0.0, 1.0), True
    if is_bare and high <= 100.5:
        notes.append(
            f"{name} goes from {low:g} to {high:g} and has no unit: taken for percent; throttle_range LOW HIGH says "
            "what throttle 0 and 1 are"
        )
        return (0.0, 100.0), True
    if unit == "percent" and high <= 1.0 + room:
        notes.append(
            f"{name} is in percent and never above {high:g}: is it a share? no engine is left; throttle_range 0 1 or "
            "throttle_range 0 100 says what throttle 0 and 1 are"
        )
        return (0.0, 1.0), False
    notes.append(
        f"what throttle 0 and 1 are is not known ({name} goes from {low:g} to {high:g}): the gain is that of this "
        "range, and no engine is left; throttle_range LOW HIGH says it"
    )
    return (low, high), False


def as_log(record: BenchRecord, limits: tuple[float, float], is_straight: bool) -> Log:
    """Return a record as a log to fit, its command scaled so that ``limits`` are 0 and 1.

    A held command that moves after rows that are lost moves in the middle of them, for all that is known.
    """
    command, times = (record.command - limits[0]) / (limits[1] - limits[0]), record.command_times
    if not is_straight:
        gap = np.diff(times, prepend=times[0])
        row = float(np.median(gap[1:]))
        unknown = (gap > 1.5 * row) & (np.diff(command, prepend=command[0]) != 0.0)
        times = times - np.where(unknown, 0.5 * (gap - row), 0.0)
    return Log(times, command, record.times, record.output, record.step, is_straight)


def moves_gradually(command: Array) -> bool:
    """Return whether a command that changes does so from row to row, as a ramp and unlike steps."""
    moved = np.diff(command) != 0.0
    return bool((moved[1:] & moved[:-1]).sum() > 0.5 * max(moved.sum(), 1))


def make_problem(logs: Sequence[Log], longest_delay: float, most_levels: int = 12) -> Problem:
    """Return logs as one problem, with static levels at the commands that occur, or evenly spaced if these are many."""
    command = np.concatenate([log.command for log in logs])
    levels = np.unique(np.round(command, 4))
    if len(levels) > most_levels:
        levels = np.linspace(command.min(), command.max(), most_levels)
    span = min(float(log.times[-1] - log.times[0]) for log in logs)
    return Problem(logs, levels, min(longest_delay, 0.5 * span))


class _FormFits(NamedTuple):
    """Estimates of the forms, best first; whether hold or line between rows was open, and is still doubtful."""

    problem: Problem
    estimates: tuple[Estimate, ...]
    two_lags: Estimate
    is_open: bool = False
    is_doubtful: bool = False


def _fit_lags(
    records: Sequence[BenchRecord], limits: tuple[float, float], choices: Choices, notes: list[str], rows: int = 1500
) -> _FormFits:
    """Fit one lag and two; a command that moves from row to row both as held and as straight, if neither is said.

    More than so many ``rows`` are averaged where they are far finer than the answer.
    """
    for record in records:
        check_moves(record)
    is_open = choices.between == "auto" and any(moves_gradually(record.command) for record in records)
    ways = (True, False) if is_open else (choices.between == "straight",)
    first = make_problem([as_log(record, limits, ways[0]) for record in records], choices.longest_delay)
    start = find_start(first)
    fine = 0.04 * Lags(1).total(start)
    most = min(fine, len(first.output) / rows * first.step)
    found = []
    for straight in ways:
        logs = [as_log(record, limits, straight).with_more_commands(fine).averaged(most) for record in records]
        problem, near = make_problem(logs, choices.longest_delay), start.copy()
        if is_open and not straight:
            near[0] = max(start[0] - 0.5 * records[0].command_row, 0.0)
        one = fit(problem, Lags(1), near)
        two = fit(problem, Lags(2), np.array([*one.x, 0.2]))
        found.append(_FormFits(problem, tuple(sorted((one, two), key=lambda each: each.bic)), two))
    found.sort(key=lambda each: each.estimates[0].bic)
    if not is_open:
        return found[0]
    best, other = found
    row = max(record.command_row for record in records)
    # With averaged rows of the command the log cannot show whether it is held or goes straight between rows.
    is_averaged = any(len(log.command) < len(record.command) for log, record in zip(logs, records, strict=True))
    is_doubtful = is_averaged or other.estimates[0].bic - best.estimates[0].bic < 20.0
    name, taken = records[0].command_name, "straight" if best.problem.logs[0].is_straight else "held"
    notes.append(
        f"{name} moves from row to row: taken for {taken} between rows, as it fits better; between says which"
        + (f".  Hardly: half a row, {500.0 * row:.3g} ms, is in the delay's bounds" if is_doubtful else "")
    )
    return best._replace(is_open=True, is_doubtful=is_doubtful)


def _select_one_lag(fitted: _FormFits) -> Estimate:
    return next(each for each in fitted.estimates if each.form == Lags(1))


def _try_limits_and_drift(
    fitted: _FormFits, notes: list[str], least: float = 0.002, clear: float = 10.0, largest_drift: float = 0.15
) -> _FormFits:
    """Try limits of rise and fall, and a gain that drifts, where lags leave more than ``least`` of the range.

    Either is taken where BIC falls by ``clear`` and a fifth of the residual's power goes; a gain that drifts by more
    than ``largest_drift`` is none, it may be a governor's overshoot.
    """
    problem, best = fitted.problem, fitted.estimates[0]
    off = judge(problem, best, best.form.total(best.x), ()).off
    if off <= least or not any(len(log.command) > 3 for log in problem.logs):
        return fitted
    power = float(np.mean(best.residual**2))
    limits = fit_limits(problem, best)
    left = np.inf if limits is None else float(np.mean(limits.residual**2))
    memory = problem.memory_of(best.residual)
    rows = len(problem.output) * (1.0 - memory) / (1.0 + memory)
    is_limited = left < 0.8 * power and rows * np.log(power / left) - 2.0 * np.log(rows) > clear
    span = max(float(np.ptp(log.times)) for log in problem.logs)
    since = np.concatenate([(log.times - log.times[0]) / span - 0.5 for log in problem.logs])
    model = best.answer(problem)
    drifting = replace(problem, drift=np.column_stack([model * since, model * since**2]))
    one = fit(drifting, Lags(1), _select_one_lag(fitted).x)
    two = fit(drifting, Lags(2), np.array([*one.x, 0.2]))
    found = min((one, two), key=lambda each: each.bic)
    drifted = float(np.mean(found.residual**2))
    slope, bend = found.linear[-2:]
    share = float(np.ptp(slope * since + bend * since**2))
    drifts = best.bic - found.bic > clear and drifted < 0.8 * power and share < largest_drift
    if limits is not None and is_limited and not (drifts and drifted < left):
        return fitted._replace(estimates=(limits, *fitted.estimates), is_doubtful=fitted.is_open)
    if not drifts:
        return fitted
    notes.append(f"the gain drifts by {100.0 * share:.2g} % over the log; the numbers are those of its middle")
    return fitted._replace(problem=drifting, estimates=tuple(sorted((one, two), key=lambda e: e.bic)), two_lags=two)


def _bound_delay(
    fitted: _FormFits, records: Sequence[BenchRecord], total: float, notes: list[str]
) -> tuple[float, float]:
    """Return 95 % bounds of the delay [s] by the profile likelihood of two lags, which contain one.

    A held command may have moved a row before it is logged; of one that may be held half a row is not known.
    """
    problem, best = fitted.problem, fitted.estimates[0]
    half = 1.96 * best.deviation(0)
    low, high = best.delay - half, best.delay + half
    if not isinstance(best.form, Limits):
        ends = bound_delay(problem, fitted.two_lags)
        low, high = min(low, ends[0]), max(high, ends[1])
    row = max(record.command_row for record in records)
    if problem.logs[0].is_straight and fitted.is_doubtful:
        low, high = low - 0.5 * row, high + 0.5 * row
    if not problem.logs[0].is_straight:
        wider = spread_of_delay(problem, best, total, row)
        low, high = low - wider, high + row + wider
        if wider > 0.1 * total:
            notes.append(
                f"movements are answered earlier and later than the model says: bounds are {1e3 * wider:.3g} ms wider"
            )
    return max(low, 0.0), min(high, problem.max_delay + row)


def compare_logs(found: Identification, apart: float = 3.29) -> Identification:
    """Return the result with the spread of parameters between logs; note those ``apart`` by so many deviations."""
    logs, chosen = found.problem.logs, found.chosen
    if len(logs) < 2 or not found.is_told or isinstance(chosen.form, Limits) or found.problem.drift.size:
        return found
    alone = []
    for log, record in zip(logs, found.records, strict=True):
        problem = make_problem([log], found.problem.max_delay)
        one = fit(problem, chosen.form, chosen.x)
        alone.append(engine_parameters(replace(found, records=(record,), problem=problem, estimates=(one,))))
    spread, notes = {}, []
    for row, name in enumerate(alone[0].names):
        values, deviations = (np.array([getattr(one, key)[row] for one in alone]) for key in ("values", "deviations"))
        spread[name] = float(np.sqrt(max(np.var(values, ddof=1) - np.mean(deviations**2), 0.0)))
        low, high = int(np.argmin(values)), int(np.argmax(values))
        if values[high] - values[low] > apart * np.hypot(deviations[low], deviations[high]):
            notes.append(
                f"{name} is {values[low]:.4g} in {found.records[low].path.name} and {values[high]:.4g} in "
                f"{found.records[high].path.name}, farther apart than noise: two engines, or another day; the spread "
                "is kept"
            )
    return replace(found, spread=spread, notes=(*notes, *found.notes))
