"""Parameters of an engine that is simulated, fitted to bench logs: a turbine with its ECU, or anybody's FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import EngineError, InputError, NotIdentifiedError, nearest
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.engine.fmu.variables import Variable
from cosim.identify.bench.evidence import (
    HeldBack,
    Misfit,
    describe_held_back,
    describe_lack,
    hold_back,
    output_swing,
    test_residuals,
)
from cosim.identify.bench.fit import Part, Problem
from cosim.identify.bench.missing_evidence import describe_small_movements
from cosim.identify.bench.record import BenchRecord
from cosim.identify.engine_file import DEVIATIONS_95
from cosim.identify.robust import invert, memory_rows, robust_factor
from cosim.identify.verdict import Judgement, judge_model, shared_record

STEP_S = 0.004  # of the simulation, in which a command is the mean of what it is
UNIT_DELAY_S = 0.1  # of the delay among parameters that are all near 1
WIDEST = 1e3  # times a parameter's nominal value, up and down, that it is looked for
RPM = 60.0 / (2.0 * np.pi)
LEVELS = 41  # at which the engine's speed at rest is taken
FINE = 1e-4  # of a parameter, to see what it does
ROUNDS = 2  # of fit and memory of the noise in turn
POOR_PREDICTION = 1.5
CLOSE = 0.015  # of the output's range (rms), to which movements have to be foretold that are not explained to the noise
LEAST_PART = 0.05  # of a value, that is left of it at an end of its bounds
BEGINNING_S = 0.5  # of a log, in which an engine that rests does not move
NOT_AT_REST = 0.05  # of the output's range, by which an engine at rest may be off there
HORIZON_S = 3.0  # for which the output counts as on its way after a movement


class GreyChoices(NamedTuple):
    """What is fitted: parameters of an engine beside the delay, others that are set, and what throttle 0 and 1 are."""

    engine: str
    fitted: tuple[str, ...]
    settings: Mapping[str, float]
    limits: tuple[float, float] = (0.0, 1.0)
    straight: bool = False
    longest_delay: float = 2.0


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


@dataclass(frozen=True)
class _Model:
    """An engine whose parameters change, and the logs that it answers."""

    spec: EngineSpec
    variables: Mapping[str, Variable]
    start: Array  # of delay and parameters
    choices: GreyChoices
    speed: bool  # the output is its speed [rpm], not its thrust
    speed_command: bool  # and the command is a speed, which the throttle is taken from
    step: float

    def answer(self, values: Array, parts: Sequence[Part]) -> Array:
        """Return the output of all logs with these parameters, from rest at each log's first command."""
        with make_bank([self.with_values(values[1:])], self.step) as bank:
            return np.concatenate([self._run(bank, part, float(values[0])) for part in parts])

    def with_values(self, values: Array) -> EngineSpec:
        """Return the engine with these values of what is fitted."""
        chosen = dict(zip(self.choices.fitted, map(float, values), strict=True))
        kept = [(variable, value) for variable, value in self.spec.settings if variable.name not in chosen]
        settings = (*kept, *((self.variables[name], value) for name, value in chosen.items()))
        return replace(self.spec, parameters={**self.spec.parameters, **chosen}, settings=settings)

    def _run(self, bank: Any, part: Part, delay: float) -> Array:
        """Return the answer to the command as it is, at times that are earlier by the delay: both come to the same."""
        throttle = self._throttle(bank, part)
        begin, h = float(part.times[0]) - self.choices.longest_delay, self.step
        count = int(np.ceil((float(part.times[-1]) - begin) / h)) + 1
        edges: Array = np.asarray(begin + h * np.arange(count + 1), np.float64)
        means = np.clip(_means(part, throttle, edges), 0.0, 1.0)
        first = bank.reset(float(means[0]))
        if self.speed:
            outputs = [first] + [bank.step(k, (float(u),)) for k, u in enumerate(means)]
            course = np.array([one.spool_speed[0] * RPM for one in outputs])
        else:
            course = np.array([first.thrust[0], *bank.follow(0, means.tolist())])
        return np.asarray(np.interp(part.times - delay, edges, course))

    def _throttle(self, bank: Any, part: Part) -> Array:
        if not self.speed_command:
            return part.command
        levels = np.linspace(0.0, 1.0, LEVELS)
        speeds = [bank.reset(float(level)).spool_speed[0] * RPM for level in levels]
        return np.asarray(np.interp(part.command, speeds, levels))


def _means(part: Part, throttle: Array, edges: Array) -> Array:
    """Return the mean throttle between each two of these times."""
    if part.straight:
        return np.asarray(np.interp(0.5 * (edges[1:] + edges[:-1]), part.command_times, throttle))
    times = part.command_times
    total = np.concatenate([[0.0], np.cumsum(throttle[:-1] * np.diff(times))])
    sums = np.interp(edges, times, total)
    sums += np.minimum(edges - times[0], 0.0) * throttle[0] + np.maximum(edges - times[-1], 0.0) * throttle[-1]
    return np.asarray(np.diff(sums) / np.diff(edges))


def fit_engine(records: Sequence[BenchRecord], choices: GreyChoices, is_strict: bool = False) -> GreyIdentification:
    """Fit parameters of an engine, and the delay before it, to bench logs; each log begins at rest.

    ``is_strict``: what does not explain the logs is of no use, and nothing is held back to see how close it comes.
    Raises InputError for an engine, a parameter or an output that does not serve, NotIdentifiedError where the logs
    do not tell what is asked.
    """
    model, parts = _model(records, choices)
    values, residual, covariance = _fit(model, parts)
    covariance[0, 0] += min(max(record.clock_deviation for record in records), choices.longest_delay) ** 2
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unknown = [
        name
        for name, value, one in zip(choices.fitted, values[1:], deviations[1:], strict=True)
        if not DEVIATIONS_95 * one <= abs(value)
    ]
    if unknown:
        names = " and ".join(unknown)
        raise NotIdentifiedError(
            f"{records[0].path}: the log does not tell {names} of {choices.engine}: the 95 % bounds exceed the value; "
            f"leave out --fit {unknown[0]}, or log steps over the whole range, up and down"
        )
    misfit = test_residuals(parts, residual, float(values[0]), HORIZON_S)
    held_back, halves = (None, []) if is_strict and misfit.failed else _predict(model, parts, values)
    swing = output_swing(parts)
    notes = [*dict.fromkeys(note for record in records for note in record.notes)]
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


def _ends_of_bounds(model: _Model, values: Array, covariance: Array) -> tuple[Array, Array]:
    """Return two sets of values at the ends of the 95 % bounds, in the direction that the logs tell least."""
    scale = _scale(model)
    sizes, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    way = DEVIATIONS_95 * np.sqrt(max(float(sizes[-1]), 0.0)) * directions[:, -1] * scale
    low, high = _ends(model)
    least = np.maximum(low, LEAST_PART * values)
    return np.clip(values - way, least, high), np.clip(values + way, least, high)


def _untold(
    model: _Model, records: Sequence[BenchRecord], parts: Sequence[Part], residual: Array, ends: tuple[Array, Array]
) -> list[str]:
    def answer(part: Part) -> tuple[Array, Array]:
        one, other = (model.answer(values, [part]) for values in ends)
        return one, other

    return describe_small_movements(records, parts, residual, HORIZON_S, answer, output_unit(records[0]))


def output_unit(record: BenchRecord) -> str:
    """Return the unit in which an engine's own output is compared: rpm of a speed, N of a thrust."""
    return "rpm" if record.output_unit in ("rpm", "krpm") else "N"


def _model(records: Sequence[BenchRecord], choices: GreyChoices) -> tuple[_Model, list[Part]]:
    first = records[0]
    speed = first.output_unit in ("rpm", "krpm")
    if not speed and first.newtons is None:
        raise InputError(
            f"{first.path}: {first.output_name} is in {first.output_unit or 'no unit'}; an engine has thrust or rpm"
        )
    unit = {"rpm": 1.0, "krpm": 1e3}.get(first.output_unit, first.newtons or 1.0)
    by_speed = first.command_unit in ("rpm", "krpm")
    low, high = (0.0, {"krpm": 1e-3}.get(first.command_unit, 1.0)) if by_speed else choices.limits
    parts = [
        Part(record.command_times, (record.command - low) / (high - low), record.times, unit * record.output,
             record.step, choices.straight, record.width)
        for record in records
    ]  # fmt: skip
    spec = load_engine(choices.engine, dict(choices.settings), STEP_S)
    variables = {variable.name: variable for variable in spec.archive.parameters}
    for name in choices.fitted:
        if name not in spec.parameters:
            raise InputError(f"--fit {name}: {choices.engine} has no such parameter; {nearest(name, spec.parameters)}")
        if variables[name].type.startswith(("Int", "UInt", "Bool", "Enum")):
            raise InputError(f"--fit {name}: is no continuous number; the delay is fitted anyway")
        if not spec.parameters[name] > 0.0:
            raise InputError(f"--fit {name}: is {spec.parameters[name]:g}; set where to begin: --set {name}=...")
    late = spec.delay_samples
    if late is not None:  # the delay is fitted before the engine, to any fraction of a step
        spec = load_engine(choices.engine, {**choices.settings, "delay_samples": 0.0}, STEP_S)
    if speed and not np.isfinite(_at_rest(spec).spool_speed[0]):
        raise InputError(f"{choices.engine} reports no speed, and {first.output_name} is one")
    begin = UNIT_DELAY_S if late is None else late * (spec.internal_step or STEP_S)
    start = np.array([begin, *(spec.parameters[name] for name in choices.fitted)])
    return _Model(spec, variables, start, choices, speed, by_speed, STEP_S), parts


def _at_rest(spec: EngineSpec) -> Any:
    with make_bank([spec], STEP_S) as bank:
        return bank.reset(0.5)


def _scale(model: _Model) -> Array:
    return np.array([UNIT_DELAY_S, *model.start[1:]])


def _ends(model: _Model) -> tuple[Array, Array]:
    """Return the least and the greatest of delay and parameters, by the FMU's own limits."""
    low, high = [0.0], [model.choices.longest_delay]
    for name, begin in zip(model.choices.fitted, model.start[1:], strict=True):
        variable = model.variables[name]
        low.append(max(-np.inf if variable.min is None else variable.min, begin / WIDEST))
        high.append(min(np.inf if variable.max is None else variable.max, begin * WIDEST))
    return np.array(low), np.array(high)


def _fit(model: _Model, parts: Sequence[Part]) -> tuple[Array, Array, Array]:
    """Return delay and parameters, what is left over, and their covariance."""
    from scipy.optimize import least_squares

    problem = Problem(parts, model.choices.longest_delay)
    low, high = _ends(model)
    scale, values, memory = _scale(model), np.clip(model.start, low, high), 0.0
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
    jacobian = _slopes(problem, left, values / scale, memory)
    loss = max(float(white @ white), problem.floor)
    covariance = loss / max(len(white) - len(values), 1) * invert(jacobian.T @ jacobian)
    wider = robust_factor(jacobian, white, covariance, memory_rows(white)) * scale
    covariance = covariance * np.outer(wider, wider)
    silent = np.flatnonzero(~np.any(jacobian != 0.0, axis=0))  # parameters that change nothing
    covariance[silent, silent] = np.inf
    return values, residual, covariance


def _slopes(problem: Problem, left: Any, x: Array, memory: float) -> Array:
    columns = []
    for i in range(len(x)):
        width = 1e-3 * max(float(x[i]), 0.1)
        above, below = x.copy(), x.copy()
        above[i], below[i] = x[i] + width, max(x[i] - width, 0.0)
        columns.append(problem.whiten(left(above) - left(below), memory) / (above[i] - below[i]))
    return np.column_stack(columns)


def _predict(model: _Model, parts: Sequence[Part], values: Array) -> tuple[HeldBack | None, list[Array]]:
    """Return how far the engine is off, fitted to a part of the movements, there and in the others; and these fits."""
    begun, halves = replace(model, start=values), []

    def foretell(use: list[NDArray[np.bool_]]) -> Array:
        halves.append(_fit(begun, [part.chosen(rows) for part, rows in zip(parts, use, strict=True)])[0])
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


def _at_the_ends(model: _Model, values: Array) -> list[str]:
    low, high = _ends(model)
    notes = []
    for name, value, least, most in zip(("delay", *model.choices.fitted), values, low, high, strict=True):
        if name != "delay" and (value <= 1.001 * least or value >= 0.999 * most):
            notes.append(f"{name} ends at {value:.4g}, a limit of what is looked for")
    return notes
