"""Parameters of an engine that is simulated, fitted to bench logs: a turbine with its ECU, or anybody's FMU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import EngineError, NotIdentifiedError
from cosim.engine import EngineSpec
from cosim.identify.verdict import Judgement, judge_model, shared_record
from hexjet_identify.bench.evidence import (
    HeldBack,
    Misfit,
    describe_held_back,
    describe_lack,
    hold_back,
    output_swing,
    test_residuals,
)
from hexjet_identify.bench.fit import Part, Problem
from hexjet_identify.bench.grey_model import EngineModel, GreyChoices, make_model, make_parts, output_unit
from hexjet_identify.bench.missing_evidence import describe_small_movements
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.stretches import Answered, Spread, measure_spread
from hexjet_identify.engine_file import DEVIATIONS_95
from hexjet_identify.robust import invert, memory_rows, robust_factor

FINE = 1e-4  # of a parameter, to see what it does
ROUNDS = 2  # of fit and memory of the noise in turn
POOR_PREDICTION = 1.5
CLOSE = 0.015  # of the output's range (rms), to which movements have to be foretold that are not explained to the noise
LEAST_PART = 0.05  # of a value, that is left of it at an end of its bounds
BEGINNING_S = 0.5  # of a log, in which an engine that rests does not move
NOT_AT_REST = 0.05  # of the output's range, by which an engine at rest may be off there
SMALL_DELAY_S = 1e-3  # to see what a delay does
HORIZON_S = 3.0  # for which the output counts as on its way after a movement


@dataclass(frozen=True)
class GreyIdentification:
    """An engine's parameters as bench logs have them; ``values``, ``deviations`` begin with the delay in s."""

    records: tuple[BenchRecord, ...]
    choices: GreyChoices
    spec: EngineSpec
    values: Array
    covariance: Array
    residual: Array
    parts: tuple[Part, ...]
    misfit: Misfit
    held_back: HeldBack | None
    notes: tuple[str, ...]
    untold: tuple[str, ...] = ()

    @property
    def is_close(self) -> bool:
        """Whether the movements that were held back are foretold well, though more than noise is left over."""
        return self.misfit.failed and _is_close(self.held_back, self.swing)

    @property
    def leaves_engine(self) -> bool:
        """Whether the engine explains the logs, or foretells what was held back."""
        return not self.misfit.failed or self.is_close

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was fitted, the delay first."""
        return ("delay_s", *self.choices.fitted)

    @property
    def deviations(self) -> Array:
        """Standard deviations of ``values``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def residual_rms(self) -> float:
        """Root mean square of what is left over, in the output's unit."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def judgement(self) -> Judgement:
        """Whether the engine explains the logs, by what of the residuals follows the command."""
        return judge_model(
            not self.misfit.failed,
            f"left over: {100.0 * self.residual_rms / self.swing:.2g} % of the output's range (rms)",
            f"{100.0 * self.misfit.share:.2g} % of that follow the command (p {self.misfit.p:.2g})",
        )

    @property
    def swing(self) -> float:
        """Range of the output."""
        return output_swing(self.parts)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the signals, for JSON."""
        first = self.records[0]
        channels, units = (first.command_name, first.output_name), (first.command_unit, first.output_unit)
        refused = [] if self.leaves_engine else [self.misfit.words]
        parameters = dict(zip(self.names, map(float, self.values), strict=True))
        deviations = dict(zip(self.names, map(float, self.deviations), strict=True))
        return {
            **shared_record("engine", channels, units, self.judgement, refused, self.notes),
            "logs": [str(record.path) for record in self.records],
            "engine": self.choices.engine,
            "set": dict(self.choices.settings),
            "parameters": parameters,
            "standard_deviations": deviations,
            "estimates": [{"form": self.choices.engine, **parameters, "standard_deviations": deviations}],
            "residual_rms": self.residual_rms,
            "residual_of_swing": self.residual_rms / self.swing,
            "explained": not self.misfit.failed,
            "misfit": self.misfit._asdict() | {"failed": self.misfit.failed},
            "close": self.is_close,
            "held_back_rms": None if self.held_back is None else list(self.held_back[:2]),
            "held_back": None if self.held_back is None else self.held_back.to_dict(),
            "not_told": list(self.untold),
        }


def fit_engine(records: Sequence[BenchRecord], choices: GreyChoices, is_strict: bool = False) -> GreyIdentification:
    """Fit parameters of an engine, and the delay before it, to bench logs; each log begins at rest.

    ``is_strict``: what does not explain the logs is of no use, and nothing is held back to see how close it comes.
    Raises InputError for an engine, a parameter or an output that does not serve, NotIdentifiedError where the logs
    do not tell what is asked.
    """
    model = make_model(records, choices)
    parts = make_parts(records, choices)
    fitted = _fit(model, parts)
    values, residual, covariance = fitted.values, fitted.residual, fitted.covariance
    apart = _measure_spread(model, parts, fitted)
    clock = float(np.hypot(apart.deviation, max(record.clock_deviation for record in records)))
    covariance[0, 0] += min(clock, choices.longest_delay) ** 2
    _check_told(records[0], choices, values, covariance)
    misfit = test_residuals(parts, residual, float(values[0]), HORIZON_S)
    held_back, halves = (None, []) if is_strict and misfit.failed else _predict(model, parts, values)
    swing = output_swing(parts)
    notes = [*dict.fromkeys(note for record in records for note in record.notes), *apart.notes]
    notes += _at_the_ends(model, values)
    notes += describe_beginning(records, parts, residual, swing)
    if model.speed:
        notes.append(f"the log has no thrust: thrust, fuel and temperature are those of {choices.engine} as it is set")
    if misfit.failed:
        size = f"{100.0 * misfit.size:.2g} % of the output's swing (rms)"
        bounds = "bounds do not cover that"
        if _is_close(held_back, swing):
            covariance = _hold_halves(covariance, values, halves)
            bounds = (
                "but what was held back is foretold: an engine is left, with bounds that hold the fits of both halves"
            )
        notes.append(f"not explained: what is left over still belongs to the command, {size}; {bounds}")
        notes.append(describe_lack(parts, residual))
    if held_back is not None and held_back.others > POOR_PREDICTION * held_back.fitted:
        notes.append(describe_held_back(held_back, output_unit(records[0]), swing))
    untold = [] if is_strict else _untold(model, records, parts, residual, _ends_of_bounds(model, values, covariance))
    return GreyIdentification(
        tuple(records), choices, model.with_values(values[1:]), values, covariance, residual, tuple(parts),
        misfit, held_back, tuple(notes), tuple(untold),
    )  # fmt: skip


def _measure_spread(model: EngineModel, parts: Sequence[Part], fitted: _Fit) -> Spread:
    """Return how far apart in time the stretches of logs are answered."""
    step = SMALL_DELAY_S * np.eye(1, len(fitted.values))[0]
    early, late = (model.answer(fitted.values + sign * step, parts) for sign in (-1.0, 1.0))
    slope = (late - early) / (2.0 * SMALL_DELAY_S)
    answered = Answered(fitted.residual, slope, fitted.memory, HORIZON_S)
    return measure_spread(Problem(parts, model.choices.longest_delay), answered)


def _check_told(record: BenchRecord, choices: GreyChoices, values: Array, covariance: Array) -> None:
    """Raise NotIdentifiedError for parameters whose bounds exceed their value."""
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unknown = [
        name
        for name, value, one in zip(choices.fitted, values[1:], deviations[1:], strict=True)
        if not DEVIATIONS_95 * one <= abs(value)
    ]
    if unknown:
        raise NotIdentifiedError(
            f"{record.path}: the log does not tell {' and '.join(unknown)} of {choices.engine}: the 95 % bounds exceed "
            f"the value; leave {unknown[0]} out of --fit, or log steps over the whole range, up and down"
        )


def _ends_of_bounds(model: EngineModel, values: Array, covariance: Array) -> tuple[Array, Array]:
    """Return two sets of values at the ends of the 95 % bounds, in the direction that the logs tell least."""
    scale = model.scale
    sizes, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    way = DEVIATIONS_95 * np.sqrt(max(float(sizes[-1]), 0.0)) * directions[:, -1] * scale
    low, high = model.ends()
    least = np.maximum(low, LEAST_PART * values)
    return np.clip(values - way, least, high), np.clip(values + way, least, high)


def _untold(
    model: EngineModel,
    records: Sequence[BenchRecord],
    parts: Sequence[Part],
    residual: Array,
    ends: tuple[Array, Array],
) -> list[str]:
    def answer(part: Part) -> tuple[Array, Array]:
        one, other = (model.answer(values, [part]) for values in ends)
        return one, other

    return describe_small_movements(records, parts, residual, HORIZON_S, answer, output_unit(records[0]))


class _Fit(NamedTuple):
    """Delay and parameters as fitted, what they leave over, and how much a row of that keeps of the row before."""

    values: Array
    residual: Array
    covariance: Array
    memory: float


def _fit(model: EngineModel, parts: Sequence[Part]) -> _Fit:
    from scipy.optimize import least_squares

    problem = Problem(parts, model.choices.longest_delay)
    low, high = model.ends()
    scale, values, memory = model.scale, np.clip(model.start, low, high), 0.0
    worst = float(np.ptp(problem.output))

    def left(x: Array) -> Array:
        try:
            return np.asarray(problem.output - model.answer(np.clip(x * scale, low, high), parts))
        except EngineError:
            return np.full(len(problem.output), worst)

    for _ in range(ROUNDS):
        answer = least_squares(
            lambda x, memory=memory: problem.whiten(left(x), memory) / worst,
            np.clip(values, low + 1e-6 * scale, high) / scale,
            bounds=(low / scale, high / scale),
            diff_step=FINE,
            xtol=1e-6,
            ftol=1e-7,
            max_nfev=30,
        )
        values = np.clip(answer.x * scale, low, high)
        residual = left(answer.x)
        memory = problem.memory_of(residual)
    white = problem.whiten(residual, memory)
    jacobian = _slopes(problem, left, values / scale, memory) / scale
    loss = max(float(white @ white), problem.floor)
    covariance = loss / max(len(white) - len(values), 1) * invert(jacobian.T @ jacobian)
    wider = robust_factor(jacobian, white, covariance, memory_rows(white))
    covariance = covariance * np.outer(wider, wider)
    silent = np.flatnonzero(~np.any(jacobian != 0.0, axis=0))  # parameters that change nothing
    covariance[silent, silent] = np.inf
    return _Fit(values, residual, covariance, memory)


def _slopes(problem: Problem, left: Any, x: Array, memory: float) -> Array:
    columns = []
    for i in range(len(x)):
        width = 1e-3 * max(float(x[i]), 0.1)
        above, below = x.copy(), x.copy()
        above[i], below[i] = x[i] + width, max(x[i] - width, 0.0)
        columns.append(problem.whiten(left(above) - left(below), memory) / (above[i] - below[i]))
    return np.column_stack(columns)


def _predict(model: EngineModel, parts: Sequence[Part], values: Array) -> tuple[HeldBack | None, list[Array]]:
    """Return how far the engine is off, fitted to a part of the movements, there and in the others; and these fits."""
    begun, halves = replace(model, start=values), []

    def foretell(use: list[NDArray[np.bool_]]) -> Array:
        halves.append(_fit(begun, [part.chosen(rows) for part, rows in zip(parts, use, strict=True)]).values)
        return model.answer(halves[-1], parts)

    return hold_back(parts, HORIZON_S, foretell), halves


def _is_close(held_back: HeldBack | None, swing: float) -> bool:
    return held_back is not None and bool(held_back.movements) and held_back.others <= CLOSE * swing


def _hold_halves(covariance: Array, values: Array, halves: Sequence[Array]) -> Array:
    """Return a covariance whose deviations reach to the fit of each half of the movements; the correlation is kept."""
    own = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    far = np.max(np.abs(np.array(halves) - values), axis=0)
    wider = np.maximum(far / own, 1.0)
    return covariance * np.outer(wider, wider)


def describe_beginning(
    records: Sequence[BenchRecord], parts: Sequence[Part], residual: Array, swing: float
) -> list[str]:
    """Return a line for each log that does not begin as the engine does, which is at rest with its first command.

    ``residual`` is of all parts, ``swing`` the output's range, in one unit.
    """
    notes = []
    rows = np.split(residual, np.cumsum([len(part.times) for part in parts])[:-1])
    for record, part, left in zip(records, parts, rows, strict=True):
        off = abs(float(np.mean(left[part.times - part.times[0] <= BEGINNING_S])))
        if off > NOT_AT_REST * swing:
            notes.append(
                f"{record.path.name} begins {100.0 * off / swing:.2g} % of the output's range from where the engine "
                f"rests: each log has to begin at rest; --begin after {part.times[0]:.4g} s"
            )
    return notes


def _at_the_ends(model: EngineModel, values: Array) -> list[str]:
    low, high = model.ends()
    notes = []
    for name, value, least, most in zip(("delay", *model.choices.fitted), values, low, high, strict=True):
        if name != "delay" and (value <= 1.001 * least or value >= 0.999 * most):
            notes.append(f"{name} ends at {value:.4g}, a limit of what is looked for")
    return notes
