"""A model of an engine out of its bench logs: the form by evidence, how sure each number is, and what is not told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, NotIdentifiedError
from cosim.identify.verdict import Judgement, judge_model, shared_record
from hexjet_identify.bench.command import is_noisy, moves_on
from hexjet_identify.bench.evidence import (
    HeldBack,
    Misfit,
    describe_held_back,
    describe_lack,
    output_swing,
    predict_held_back,
    test_residuals,
)
from hexjet_identify.bench.fit import Estimate, Form, Problem, bound_delay, fit, make_part
from hexjet_identify.bench.missing_evidence import describe_missing_evidence
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.running import SPEED_UNITS
from hexjet_identify.bench.stretches import answer_lags, bound_short_lag, measure_spread, widen

LONGEST_DELAY_S = 2.0
LEAST_DEVIANCE_FALL = 30.0  # that the command is worth, as of a flight's log
LEAST_LEVELS = 3  # of the command, from which on a curve can be told from a straight line
APART = 3.29  # standard deviations by which logs of one engine may differ: p = 0.001
LONG_RANGE = 100.5  # up to which a throttle without a unit is taken for percent
UNIT_RANGE = 1.05  # and up to which for a share of full throttle
MOST_PERCENT = 100.0 * UNIT_RANGE  # of a throttle that is said to be in percent
NO_UNITS = ("", "1", "-", "0..1", "0-1", "0/1")  # of a throttle
ENOUGH_ROWS = 4000  # of all logs; more are averaged where they are fine enough
SHORT = 0.04  # of delay and lags together: over so long rows may be averaged
ECU_RAMP = ("fuel_integral", "fuel_fall")  # of an ECU's fuel by error
POOR_PREDICTION = 1.5  # times the residual of what was fitted, above which the part held back is ill explained


class Choices(NamedTuple):
    """What a user may state of bench logs."""

    limits: tuple[float, float] | None = None  # of the command: what throttle 0 and 1 are
    between: str = "auto"  # rows, the command is: "held", "straight", or "auto": by how it moves
    longest_delay: float = LONGEST_DELAY_S


@dataclass(frozen=True)
class BenchIdentification:
    """What bench logs tell of an engine; ``estimates`` has the chosen form first."""

    records: tuple[BenchRecord, ...]
    problem: Problem
    limits: tuple[float, float]
    limits_known: bool
    straight: bool
    estimates: tuple[Estimate, ...]
    misfit: Misfit
    held_back: HeldBack | None  # rms of what was fitted, and of what was not
    spread: dict[str, float]  # standard deviations between several logs, of what one engine would have alike
    notes: tuple[str, ...]
    untold: tuple[str, ...]

    @property
    def chosen(self) -> Estimate:
        """The form that the evidence chooses."""
        return self.estimates[0]

    @property
    def is_explained(self) -> bool:
        """Whether what is left over no longer follows the command."""
        return not self.misfit.failed

    @property
    def refused(self) -> list[str]:
        """Why the model is none of this engine, a line a reason; empty where it explains the log."""
        return [self.misfit.words] if self.misfit.failed else []

    @property
    def judgement(self) -> Judgement:
        """Whether the model explains the logs, by what of the residuals follows the command."""
        return judge_model(
            self.is_explained,
            f"left over: {self.residual_rms:.3g} {self.records[0].output_unit}".rstrip() + " (rms)",
            f"{100.0 * self.misfit.share:.2g} % of that follow the command (p {self.misfit.p:.2g})",
        )

    @property
    def offset(self) -> float:
        """Output at throttle 0, the mean of all logs."""
        return float(np.mean(self.chosen.offsets))

    @property
    def residual_rms(self) -> float:
        """Root mean square of what is left over, in the output's unit."""
        return float(np.sqrt(np.mean(self.problem.residual(self.chosen) ** 2)))

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, for JSON."""
        first = self.records[0]
        channels, units = (first.command_name, first.output_name), (first.command_unit, first.output_unit)
        return {
            **shared_record("engine", channels, units, self.judgement, self.refused, self.notes),
            "logs": [str(record.path) for record in self.records],
            "throttle_range": list(self.limits),
            "throttle_range_known": self.limits_known,
            "between_rows": "straight" if self.straight else "held",
            "row_s": max(record.step for record in self.records),
            "lost_fraction": max(record.lost_fraction for record in self.records),
            "explained": self.is_explained,
            "misfit": self.misfit._asdict() | {"failed": self.misfit.failed},
            "residual_rms": self.residual_rms,
            "held_back_rms": None if self.held_back is None else list(self.held_back[:2]),
            "held_back": None if self.held_back is None else self.held_back.to_dict(),
            "delay_s": self.chosen.delay,
            "delay_bounds_95_s": list(self.chosen.delay_bounds),
            "estimates": [estimate_dict(estimate) for estimate in self.estimates],
            "spread": self.spread,
            "not_told": list(self.untold),
        }


def estimate_dict(estimate: Estimate) -> dict[str, Any]:
    """Return one form's parameters, standard deviations and criteria, for JSON."""
    names = (*estimate.form.names, "gain")
    low, high = estimate.delay_bounds
    return {
        "form": estimate.form.label,
        **{name: float(value) for name, value in zip(names, [*estimate.x, estimate.gain], strict=True)},
        "offsets": [float(value) for value in estimate.offsets],
        "standard_deviations": {name: estimate.deviation(i) for i, name in enumerate(names)},
        "delay_bounds_95_s": [low, high] if np.isfinite(low) else None,
        "noise_memory": estimate.memory,
        "rows": estimate.rows,
        "bic": estimate.bic,
    }


def identify_bench(records: Sequence[BenchRecord], choices: Choices | None = None) -> BenchIdentification:
    """Identify command to output of an engine's bench logs.

    Raises NotIdentifiedError where the logs do not tell, and InputError for a range that cannot be.
    """
    choices = choices or Choices()
    for record in records:
        _check_moves(record)
    notes = list(dict.fromkeys(note for record in records for note in record.notes))
    limits, known = throttle_limits(records, choices.limits, notes)
    straight = is_straight(records, choices.between, notes)
    problem, estimates = _fit_forms(records, limits, straight, choices.longest_delay)
    bounded = replace(estimates[0], delay_bounds=_delay_bounds(problem, estimates))
    estimates = (bound_short_lag(problem, bounded), *estimates[1:])
    apart = measure_spread(problem, answer_lags(problem, estimates[0]))
    clock = max(record.clock_deviation for record in records)
    if straight and choices.between == "auto" and any(is_noisy(record.command) for record in records):
        clock = float(np.hypot(clock, _half_a_row(records)))  # held between its rows, for all that is known
    estimates = tuple(widen(problem, one, apart.deviation, clock) for one in estimates)
    chosen = estimates[0]
    spread, doubts = _compare_logs(problem, chosen, records)
    left_over = problem.residual(chosen)
    misfit = test_residuals(problem.parts, left_over, chosen.delay, chosen.total[0])
    lacks = _lacks(problem, left_over, records[0]) if misfit.failed else []
    held_back = predict_held_back(problem, chosen)
    doubts += _doubt_zero(chosen, records[0], limits)
    doubts += _doubts(chosen, misfit, held_back, records[0], output_swing(problem.parts))
    found = BenchIdentification(
        tuple(records), problem, limits, known, straight, estimates, misfit, held_back, spread,
        (*notes, *apart.notes, *doubts, *lacks), (),
    )  # fmt: skip
    untold = describe_missing_evidence(chosen, records, limits, problem.longest_delay, straight, found.is_explained)
    return replace(found, untold=tuple(untold))


def _fit_forms(
    records: Sequence[BenchRecord], limits: tuple[float, float], straight: bool, longest_delay: float
) -> tuple[Problem, tuple[Estimate, ...]]:
    """Return logs, averaged where they are far finer than the answer, and all forms, the likeliest first."""
    parts = [make_part(record, limits, straight) for record in records]
    problem = Problem(parts, _longest(records, longest_delay))
    problem, base = _average(problem, fit(problem, Form()))
    _check_answer(problem, base, ", ".join(str(record.path) for record in records))
    return problem, _choose(problem, base, records)


def _check_moves(record: BenchRecord) -> None:
    inside = record.command_times <= record.times[-1]
    if not inside.any() or not np.ptp(record.command[inside]) > 0.0:
        raise NotIdentifiedError(
            f"{record.path}: {record.command_name} does not move; step it: a step up and one down, "
            "each held until the output stands still"
        )
    if not np.ptp(record.output) > 0.0:
        raise NotIdentifiedError(f"{record.path}: {record.output_name} does not move")


def _longest(records: Sequence[BenchRecord], longest: float) -> float:
    span = min(float(record.times[-1] - record.times[0]) for record in records)
    return min(longest, 0.5 * span)


def throttle_limits(
    records: Sequence[BenchRecord], given: tuple[float, float] | None, notes: list[str]
) -> tuple[tuple[float, float], bool]:
    """Return what throttle 0 and 1 are, and whether that is known: as given, by the unit, or by how far it goes."""
    low = min(float(record.command.min()) for record in records)
    high = max(float(record.command.max()) for record in records)
    record = records[0]
    if given is not None:
        return _check_limits(given, low, high, record), True
    if record.command_unit == "percent" and UNIT_RANGE < high <= MOST_PERCENT:
        return (0.0, 100.0), True
    if record.command_unit == "percent" and high <= UNIT_RANGE:
        notes.append(
            f"{record.command_name} is in percent and never above {high:g}: is it a share? no engine is left; "
            "--throttle-range 0 1 or --throttle-range 0 100 says what throttle 0 and 1 are"
        )
        return (0.0, 1.0), False
    is_bare = record.command_unit in NO_UNITS and low >= 0.0
    if is_bare and high <= UNIT_RANGE:
        return (0.0, 1.0), True
    if is_bare and high <= LONG_RANGE:
        notes.append(
            f"{record.command_name} goes from {low:g} to {high:g} and has no unit: taken for percent; "
            "--throttle-range LOW HIGH says what throttle 0 and 1 are"
        )
        return (0.0, 100.0), True
    notes.append(
        f"what throttle 0 and 1 are is not known ({record.command_name} goes from {low:g} to {high:g}): the gain is "
        "that of this range, and no engine is left; --throttle-range LOW HIGH says it"
    )
    return (low, high), False


def _check_limits(given: tuple[float, float], low: float, high: float, record: BenchRecord) -> tuple[float, float]:
    """Return what throttle 0 and 1 are, as given.  Raises InputError where the command goes far beyond that."""
    words, room = f"--throttle-range {given[0]:g} {given[1]:g}", (UNIT_RANGE - 1.0) * (given[1] - given[0])
    if not given[1] > given[0]:
        raise InputError(f"{words}: the second must be above the first")
    if low < given[0] - room or high > given[1] + room:
        raise InputError(
            f"{words}: {record.command_name} goes from {low:g} to {high:g}; allowed: {100.0 * (UNIT_RANGE - 1.0):.0f} "
            "% of the range beyond its ends"
        )
    return given


def is_straight(records: Sequence[BenchRecord], between: str, notes: list[str]) -> bool:
    """Return whether commands go straight between rows; ``auto`` by how they move, which ``notes`` then says."""
    if between != "auto":
        return between == "straight"
    straight = any(moves_on(record.command) for record in records)
    if straight:
        half = 1e3 * _half_a_row(records)
        notes.append(
            f"{records[0].command_name} moves from row to row: taken for straight between rows; if it is held, the "
            f"delay is {half:.3g} ms less (--between held)"
        )
    return straight


def _half_a_row(records: Sequence[BenchRecord]) -> float:
    return 0.5 * max(float(np.median(np.diff(record.command_times))) for record in records)


def _average(problem: Problem, base: Estimate) -> tuple[Problem, Estimate]:
    """Return logs whose rows are far finer than the answer with fewer rows, and the fit of them.

    The model is averaged as the rows are, and over so short a part of delay and lags nothing is lost.
    """
    if len(problem.output) <= ENOUGH_ROWS:
        return problem, base
    parts = [part.averaged(SHORT * base.total[0]) for part in problem.parts]
    fewer = Problem(parts, problem.longest_delay)
    return fewer, fit(fewer, Form(), base)


def _check_answer(problem: Problem, base: Estimate, where: str) -> None:
    output = problem.output
    matrix = problem.regressors(base.form, base.x)[:, 1:]
    linear = np.linalg.lstsq(matrix, output, rcond=None)[0]
    left = output - matrix @ linear
    memory = problem.memory_of(left)
    white = problem.whiten(left, memory)
    without = len(white) * float(np.log(max(float(white @ white), problem.floor) / len(white)))
    fall = without + problem.scales(memory) - base.deviance
    if not fall >= LEAST_DEVIANCE_FALL:
        raise NotIdentifiedError(
            f"{where}: the output does not show the command (it lowers the deviance by {fall:.1f}, "
            f"{LEAST_DEVIANCE_FALL:g} are needed); step it farther, or look at other columns"
        )


def _choose(problem: Problem, base: Estimate, records: Sequence[BenchRecord]) -> tuple[Estimate, ...]:
    """Return all forms that were tried, the least of Schwarz' criterion first; of a tie the simplest."""
    estimates = [base, fit(problem, Form(2), base)]
    levels = {level for record in records for level in np.round(np.unique(record.command), 6)}
    if len(levels) >= LEAST_LEVELS:
        curve = fit(problem, Form(1, True), base)
        estimates += [curve, fit(problem, Form(2, True), curve)]
    return tuple(sorted(estimates, key=lambda one: one.bic))


def _delay_bounds(problem: Problem, estimates: Sequence[Estimate]) -> tuple[float, float]:
    """Return bounds of the delay, s: those of the form with two lags, which contains that with one."""
    lags, curve = estimates[0].form
    two = next(one for one in estimates if one.form == Form(2, curve))
    return bound_delay(problem, two, lags == 2)


def _compare_logs(
    problem: Problem, chosen: Estimate, records: Sequence[BenchRecord]
) -> tuple[dict[str, float], list[str]]:
    """Return how far several logs of one engine are apart, and what is to be said of that."""
    if len(problem.parts) < 2:
        return {}, []
    spread, doubts = {}, []
    for name, values, deviations in _fit_alone(problem, chosen):
        more = float(np.var(values, ddof=1) - np.mean(deviations**2))
        spread[name] = float(np.sqrt(max(more, 0.0)))
        order = np.argsort(values)
        first, last = int(order[0]), int(order[-1])
        if values[last] - values[first] > APART * float(np.hypot(deviations[first], deviations[last])):
            doubts.append(
                f"{name} is {values[first]:.4g} in {records[first].path.name} and {values[last]:.4g} in "
                f"{records[last].path.name}, farther apart than noise: two engines, or another day; the spread is kept"
            )
    return spread, doubts


def _fit_alone(problem: Problem, chosen: Estimate) -> list[tuple[str, Array, Array]]:
    """Fit a form to each log alone: of each parameter, the gain last, its name, values and standard deviations."""
    fits = [fit(Problem([part], problem.longest_delay), chosen.form, chosen) for part in problem.parts]
    values = np.array([[*one.x, one.gain] for one in fits]).T
    return [
        (name, values[i], np.array([one.deviation(i) for one in fits]))
        for i, name in enumerate((*chosen.form.names, "gain"))
    ]


def _doubt_zero(chosen: Estimate, record: BenchRecord, limits: tuple[float, float]) -> list[str]:
    """Return what is to be said where the static curve is below no thrust at no throttle, by more than noise."""
    offset, rows = float(np.mean(chosen.offsets)), slice(len(chosen.x) + 1, len(chosen.x) + 1 + len(chosen.offsets))
    deviation = float(np.sqrt(np.mean(chosen.covariance[rows, rows])))
    if record.newtons is None or chosen.gain < 0.0 or not offset < -APART * deviation:
        return []
    crossing = min(-offset / chosen.gain, 1.0) ** (1.0 / chosen.form.split(chosen.x)[3])
    return [
        f"the static curve is below 0 up to {record.command_name} {limits[0] + (limits[1] - limits[0]) * crossing:.2g} "
        f"({offset:.3g} {record.output_unit} at {limits[0]:g}), where an engine that is left gives no thrust: is it "
        "the load cell's zero? then take it out of the column first"
    ]


def _lacks(problem: Problem, left_over: Array, record: BenchRecord) -> list[str]:
    lacks = [describe_lack(problem.parts, left_over)]
    if record.command_unit in SPEED_UNITS and record.output_unit in SPEED_UNITS:
        options = " ".join(f"--fit {name}" for name in ECU_RAMP)
        lacks.append(
            f"a speed that follows its set-point is a turbine's under an ECU: try --engine jetcat-p300 {options}"
        )
    return lacks


def _doubts(
    chosen: Estimate, misfit: Misfit, held_back: HeldBack | None, record: BenchRecord, swing: float
) -> list[str]:
    doubts = []
    if chosen.gain < 0.0:
        doubts.append(
            f"{record.output_name} falls where {record.command_name} rises; if the load cell's sign is the other one: "
            f"--output=-{record.output_name}"
        )
    if misfit.failed:
        doubts.append(misfit.words)
    if held_back is not None and held_back.others > POOR_PREDICTION * held_back.fitted:
        doubts.append(describe_held_back(held_back, record.output_unit, swing))
    if chosen.delay_bounds[0] == 0.0:
        doubts.append(
            "no delay at all is within the bounds: an engine without one, or an output that moves before its command, "
            "as where columns are swapped or clocks are apart"
        )
    return doubts
