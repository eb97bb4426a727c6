"""An engine of the library, or anybody's FMU, as a form: its own parameters and the delay before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import EngineError, InputError, nearest
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.engine.fmu.variables import Variable
from hexjet_identify.bench.record import BenchRecord
from hexjet_identify.bench.running import RPM_PER_UNIT
from hexjet_identify.fit.answers import average_over_rows
from hexjet_identify.fit.forms import Form
from hexjet_identify.fit.logs import Log
from hexjet_identify.fit.problem import Problem

# Step of the simulation [s]; the throttle of a step is the mean of the command over it.
STEP_S = 0.004
RPM = 60.0 / (2.0 * np.pi)  # rpm in 1 rad/s


class EngineChoices(NamedTuple):
    """The engine to fit, the names of the parameters to fit beside the delay, and values of other parameters."""

    engine: str
    fitted: tuple[str, ...]
    settings: Mapping[str, float]


@dataclass(frozen=True)
class EngineForm(Form):
    """An engine model as a form to fit: ``x`` = delay [s], then the fitted parameters.

    ``start``: where they begin; ``seconds``: delay and lags together, as lags alone would have them.  The output is the
    engine's speed [rpm] or its thrust [N]; with ``is_set_point`` the command is a speed, which gives the throttle.
    """

    choices: EngineChoices
    spec: EngineSpec
    variables: Mapping[str, Variable]
    start: Array
    is_speed: bool
    is_set_point: bool
    longest_delay: float
    seconds: float = 0.0

    @property
    def label(self) -> str:
        return self.choices.engine

    @property
    def unit(self) -> str:
        """Unit in which the engine's own output is compared."""
        return "rpm" if self.is_speed else "N"

    def limits(self, problem: Problem, widest: float = 1e3) -> tuple[Array, Array]:
        """Return the least and the greatest of delay and parameters, by the FMU's limits and ``widest`` times."""
        low, high = [0.0], [self.longest_delay]
        for name, begin in zip(self.choices.fitted, self.start[1:], strict=True):
            variable = self.variables[name]
            low.append(max(-np.inf if variable.min is None else variable.min, begin / widest))
            high.append(min(np.inf if variable.max is None else variable.max, begin * widest))
        return np.array(low), np.array(high)

    def widths(self, problem: Problem, x: Array) -> Array:
        return 1e-3 * np.array([0.1, *self.start[1:]])

    def columns(self, problem: Problem, x: Array) -> Array:
        """Return one column: the output of all logs, from rest at each log's first command."""
        try:
            with make_bank([self.with_values(x[1:])], STEP_S) as bank:
                answers = [self._simulate_log(bank, log, float(x[0])) for log in problem.logs]
        except EngineError:
            return np.asarray(problem.output - problem.swing)[:, None]
        return np.concatenate(answers)[:, None]

    @property
    def is_linear(self) -> bool:
        """False: the output is linear in no parameter."""
        return False

    def total(self, x: Array) -> float:
        """Return delay and lags together, s, as lags alone would have them."""
        return self.seconds

    def natural(self, x: Array) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(("delay_s", *self.choices.fitted), x.tolist(), strict=True))

    def with_values(self, values: Array) -> EngineSpec:
        """Return the engine with these values of what is fitted."""
        chosen = dict(zip(self.choices.fitted, map(float, values), strict=True))
        kept = [(variable, value) for variable, value in self.spec.settings if variable.name not in chosen]
        settings = (*kept, *((self.variables[name], value) for name, value in chosen.items()))
        return replace(self.spec, parameters={**self.spec.parameters, **chosen}, settings=settings)

    def _simulate_log(self, bank: Any, log: Log, delay: float) -> Array:
        """Simulate the engine with a log's command, and return its output at the log's rows, the delay later."""
        throttle = log.command
        if self.is_set_point:
            levels = np.linspace(0.0, 1.0, 41)
            throttle = np.interp(throttle, [bank.reset(float(u)).spool_speed[0] * RPM for u in levels], levels)
        begin = float(log.times[0]) - self.longest_delay
        count = int(np.ceil((float(log.times[-1]) - begin) / STEP_S)) + 1
        edges: Array = np.asarray(begin + STEP_S * np.arange(count + 1), np.float64)
        means = np.clip(_mean_throttle(log, throttle, edges), 0.0, 1.0)
        first = bank.reset(float(means[0]))
        if self.is_speed:
            outputs = [first] + [bank.step(k, (float(u),)) for k, u in enumerate(means)]
            course = np.array([one.spool_speed[0] * RPM for one in outputs])
        else:
            course = np.array([first.thrust[0], *bank.follow(0, means.tolist())])
        return average_over_rows(log, lambda times: np.asarray(np.interp(times - delay, edges, course)))


def _mean_throttle(log: Log, throttle: Array, edges: Array) -> Array:
    """Return the mean throttle between each two neighbouring times of ``edges`` [s]."""
    if log.is_straight:
        return np.asarray(np.interp(0.5 * (edges[1:] + edges[:-1]), log.command_times, throttle))
    times = log.command_times
    total = np.concatenate([[0.0], np.cumsum(throttle[:-1] * np.diff(times))])
    sums = np.interp(edges, times, total)
    sums += np.minimum(edges - times[0], 0.0) * throttle[0] + np.maximum(edges - times[-1], 0.0) * throttle[-1]
    return np.asarray(np.diff(sums) / np.diff(edges))


def make_form(records: Sequence[BenchRecord], choices: EngineChoices, longest_delay: float) -> EngineForm:
    """Return an engine as a form for these logs.  Raises InputError for what cannot be fitted."""
    first = records[0]
    is_speed = first.output_unit in RPM_PER_UNIT
    if not is_speed and first.newtons is None:
        raise InputError(
            f"{first.path}: {first.output_name} is in {first.output_unit or 'no unit'}; an engine has thrust or rpm"
        )
    spec = load_engine(choices.engine, dict(choices.settings), STEP_S)
    variables = {variable.name: variable for variable in spec.archive.parameters}
    for name in choices.fitted:
        if name not in spec.parameters:
            allowed = nearest(name, spec.parameters)
            raise InputError(f"fit {name}: {choices.engine} has no such parameter; {allowed}")
        if variables[name].type.startswith(("Int", "UInt", "Bool", "Enum")):
            raise InputError(f"fit {name}: is no continuous number; the delay is fitted anyway")
        if not spec.parameters[name] > 0.0:
            raise InputError(f"fit {name}: is {spec.parameters[name]:g}; say where to begin: settings {name}=...")
    late = spec.delay_samples
    if late is not None:
        # The delay is fitted before the engine, to any fraction of a step.
        spec = load_engine(choices.engine, {**choices.settings, "delay_samples": 0.0}, STEP_S)
    if is_speed:
        with make_bank([spec], STEP_S) as bank:
            if not np.isfinite(bank.reset(0.5).spool_speed[0]):
                raise InputError(f"{choices.engine} reports no speed, and {first.output_name} is one")
    begin = 0.1 if late is None else late * (spec.internal_step or STEP_S)
    start = np.array([begin, *(spec.parameters[name] for name in choices.fitted)])
    is_set_point = first.command_unit in RPM_PER_UNIT
    return EngineForm(choices, spec, variables, start, is_speed, is_set_point, longest_delay)
