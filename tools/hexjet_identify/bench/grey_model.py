"""An engine of the library, or anybody's FMU, simulated with the commands of bench logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.engine.fmu.variables import Variable
from hexjet_identify.bench.fit import Part, make_part
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.running import SPEED_UNITS

STEP_S = 0.004  # of the simulation, in which a command is the mean of what it is
UNIT_DELAY_S = 0.1  # of the delay among parameters that are all near 1
WIDEST = 1e3  # times a parameter's nominal value, up and down, that it is looked for
RPM = 60.0 / (2.0 * np.pi)
LEVELS = 41  # at which the engine's speed at rest is taken


class GreyChoices(NamedTuple):
    """What is fitted: parameters of an engine beside the delay, others that are set, and what throttle 0 and 1 are."""

    engine: str
    fitted: tuple[str, ...]
    settings: Mapping[str, float]
    limits: tuple[float, float] = (0.0, 1.0)
    straight: bool = False
    longest_delay: float = 2.0


@dataclass(frozen=True)
class EngineModel:
    """An engine whose parameters change, and the logs that it answers."""

    spec: EngineSpec
    variables: Mapping[str, Variable]
    start: Array  # of delay and parameters
    choices: GreyChoices
    speed: bool  # the output is its speed [rpm], not its thrust
    speed_command: bool  # and the command is a speed, which the throttle is taken from
    step: float

    @property
    def scale(self) -> Array:
        """Sizes of delay and parameters."""
        return np.array([UNIT_DELAY_S, *self.start[1:]])

    def ends(self) -> tuple[Array, Array]:
        """Return the least and the greatest of delay and parameters, by the FMU's own limits."""
        low, high = [0.0], [self.choices.longest_delay]
        for name, begin in zip(self.choices.fitted, self.start[1:], strict=True):
            variable = self.variables[name]
            low.append(max(-np.inf if variable.min is None else variable.min, begin / WIDEST))
            high.append(min(np.inf if variable.max is None else variable.max, begin * WIDEST))
        return np.array(low), np.array(high)

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


def output_unit(record: BenchRecord) -> str:
    """Return the unit in which an engine's own output is compared: rpm of a speed, N of a thrust."""
    return "rpm" if record.output_unit in SPEED_UNITS else "N"


def make_parts(records: Sequence[BenchRecord], choices: GreyChoices) -> list[Part]:
    """Return logs with the output in rpm or N, and the command as a share of its range; a set-point in rpm."""
    first = records[0]
    unit = SPEED_UNITS.get(first.output_unit, first.newtons or 1.0)
    by_speed = first.command_unit in SPEED_UNITS
    limits = (0.0, 1.0 / SPEED_UNITS[first.command_unit]) if by_speed else choices.limits
    parts = [make_part(record, limits, choices.straight) for record in records]
    return [replace(part, output=unit * part.output) for part in parts]


def make_model(records: Sequence[BenchRecord], choices: GreyChoices) -> EngineModel:
    """Return the engine that is fitted to logs.  Raises InputError for what cannot be fitted."""
    first = records[0]
    speed = first.output_unit in SPEED_UNITS
    if not speed and first.newtons is None:
        raise InputError(
            f"{first.path}: {first.output_name} is in {first.output_unit or 'no unit'}; an engine has thrust or rpm"
        )
    spec = load_engine(choices.engine, dict(choices.settings), STEP_S)
    variables = {variable.name: variable for variable in spec.archive.parameters}
    for name in choices.fitted:
        if name not in spec.parameters:
            allowed = nearest(name, spec.parameters)
            raise InputError(f"--fit {name}: {choices.engine} has no such parameter; {allowed}")
        if variables[name].type.startswith(("Int", "UInt", "Bool", "Enum")):
            raise InputError(f"--fit {name}: is no continuous number; the delay is fitted anyway")
        if not spec.parameters[name] > 0.0:
            raise InputError(f"--fit {name}: is {spec.parameters[name]:g}; say where to begin: --set {name}=...")
    late = spec.delay_samples
    if late is not None:  # the delay is fitted before the engine, to any fraction of a step
        spec = load_engine(choices.engine, {**choices.settings, "delay_samples": 0.0}, STEP_S)
    if speed and not np.isfinite(_at_rest(spec).spool_speed[0]):
        raise InputError(f"{choices.engine} reports no speed, and {first.output_name} is one")
    begin = UNIT_DELAY_S if late is None else late * (spec.internal_step or STEP_S)
    start = np.array([begin, *(spec.parameters[name] for name in choices.fitted)])
    return EngineModel(spec, variables, start, choices, speed, first.command_unit in SPEED_UNITS, STEP_S)


def _at_rest(spec: EngineSpec) -> Any:
    with make_bank([spec], STEP_S) as bank:
        return bank.reset(0.5)
