"""Start of an engine as its mapping file specifies it: constant inputs, ignition stages, warm-up.

Every instance goes through it, in the check, when it is measured and before a flight, so the flight finds an engine
that runs; or, where the scenario says so, over the flight's own steps (:class:`Ignition`).  The stages follow each
other::

    [start]
    sequence = [
        { set = { mode = "crank" }, until = "N1 > 9000", at_most_s = 30.0 },
        { set = { mode = "run", igniter = true }, throttle = 0.1, for_s = 5.0 },
    ]
    warm_up_s = 60.0

``set`` holds inputs from there on, ``throttle`` (0 to 1) is that of the stage, 0 unless stated; ``until`` compares an
output, in the FMU's own unit.  Everything is counted in communication steps, so it is the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite
from typing import NamedTuple

from cosim.engine.fmu.mapping import CONDITION, ConstantValue, PortMap
from cosim.engine.fmu.ports import PortError
from cosim.engine.fmu.variables import REALS, Port, Variable

Setting = tuple[Variable, float]

AT_MOST_S = 120.0  # for a condition, unless stated


class Until(NamedTuple):
    """A condition on an output: beyond a limit."""

    output: Variable
    relation: str
    limit: float

    def is_met(self, value: float) -> bool:
        """Return whether a value of the output fulfils the condition."""
        return {
            ">": value > self.limit,
            "<": value < self.limit,
            ">=": value >= self.limit,
            "<=": value <= self.limit,
        }[self.relation]

    def __str__(self) -> str:
        return f"{self.output.name} {self.relation} {self.limit:g}"


class Stage(NamedTuple):
    """One stage of a start."""

    settings: tuple[Setting, ...]
    throttle: float
    seconds: float  # how long it lasts, or may last until the condition holds
    until: Until | None


class StartSequence(NamedTuple):
    """The complete start; ``constants`` are set before initialization and stay."""

    constants: tuple[Setting, ...] = ()
    stages: tuple[Stage, ...] = ()
    rest_n: float = 0.0  # N, peak to peak, within which the thrust stands still


class StartError(Exception):
    """A start condition not fulfilled in time: one line without the engine's name."""


class Ignition:
    """Execution of a start's ``stages``, one communication step of ``step`` seconds after the other.

    Call :meth:`advance` before every step; it returns whether the start needs one more step at :attr:`throttle`.
    """

    def __init__(self, stages: Sequence[Stage], step: float) -> None:
        self._stages, self._step = stages, step
        self._number = -1  # number of the present stage, from 0
        self._steps_made = 0  # of the present stage
        self.throttle = stages[0].throttle if stages else 0.0

    @property
    def stage(self) -> int:
        """The number of the present stage, from 1."""
        return self._number + 1

    def advance(self, write: Callable[[Sequence[Setting]], None], read: Callable[[Variable], float]) -> bool:
        """Begin the next stage when the present one is over: ``write`` sets its inputs, ``read`` returns an output.

        Raises StartError where a condition does not come about in time.
        """
        if self._number < 0:
            self._begin_stage(write)
        while self._number < len(self._stages):
            stage = self._stages[self._number]
            most = max(1, round(stage.seconds / self._step))
            until = stage.until
            if until is None:
                over = self._steps_made == most
            elif not (over := until.is_met(value := read(until.output))) and self._steps_made == most:
                raise StartError(
                    f"it does not start: {until} does not come about within {stage.seconds:g} s of stage "
                    f"{self.stage} of its [start]; {until.output.name} is {value:g}"
                )
            if not over:
                self._steps_made += 1
                return True
            self._begin_stage(write)
        return False

    def _begin_stage(self, write: Callable[[Sequence[Setting]], None]) -> None:
        self._number += 1
        self._steps_made = 0
        if self._number < len(self._stages):
            stage = self._stages[self._number]
            self.throttle = stage.throttle
            write(stage.settings)


def resolve_start(
    port_map: PortMap, inputs: Sequence[Variable], outputs: Sequence[Variable], ports: Mapping[str, Port]
) -> StartSequence:
    """Resolve the start of a mapping file to variables and numbers.

    Raises PortError for an input or output that is not there, a port, or a value that the input cannot have.
    """
    port_names = {port.variable.name: name for name, port in ports.items()}
    arrays = {port.variable.reference for port in ports.values() if port.variable.is_array}

    def settings(table: Mapping[str, ConstantValue], where: str) -> tuple[Setting, ...]:
        pairs = []
        for name, stated in table.items():
            variable = _find_input(name, inputs, where)
            if variable.name in port_names:
                raise PortError(f"{where}: {name} is its port {port_names[variable.name]}, which the simulation sets")
            if variable.reference in arrays and variable.is_array:
                raise PortError(f"{where}: {name} is an element of an array of which another is a port")
            pairs.append((variable, convert_value(variable, stated, where)))
        return tuple(pairs)

    stages = []
    for k, stage in enumerate(port_map.start.sequence, start=1):
        where = f"[start] stage {k}"
        until = None
        if stage.until is not None:
            match = CONDITION.fullmatch(stage.until)
            assert match is not None
            matches = [v for v in outputs if v.name == match[1]]
            if not matches:
                raise PortError(f"{where}: no output is called {match[1]} ({_list_names(outputs)})")
            until = Until(matches[0], match[2], float(match[3]))
        seconds = stage.for_s if stage.for_s is not None else stage.at_most_s or AT_MOST_S
        stages.append(Stage(settings(stage.set, where), stage.throttle or 0.0, seconds, until))
    if port_map.start.warm_up_s:
        stages.append(Stage((), 0.0, port_map.start.warm_up_s, None))
    return StartSequence(settings(port_map.inputs, "[inputs]"), tuple(stages), port_map.rest_n)


def convert_value(variable: Variable, specified: ConstantValue, where: str) -> float:
    """Return the number for a specified value of an input or a parameter; raise PortError if it cannot have it."""
    shown = f"{where}: {variable.name} = {f'{specified:g}' if isinstance(specified, float) else repr(specified)}"
    if isinstance(specified, str):
        items = dict(variable.items)
        if specified not in items:
            allowed = ", ".join(items) or "a number, because it is no enumeration"
            raise PortError(f"{shown}: allowed: {allowed}")
        return float(items[specified])
    if isinstance(specified, bool) and variable.type != "Boolean":
        raise PortError(f"{shown}: it is of type {variable.type}; a number goes here")
    value = float(specified)
    if variable.items and value not in {float(item) for _, item in variable.items}:
        raise PortError(f"{shown}: allowed: {', '.join(f'{name} ({item})' for name, item in variable.items)}")
    low = -inf if variable.min is None else variable.min
    high = inf if variable.max is None else variable.max
    if variable.type == "Boolean":
        low, high = 0.0, 1.0
    is_whole = variable.type not in REALS
    if not isfinite(value) or not low <= value <= high or (is_whole and value != round(value)):
        kind = "a whole number" if is_whole else "a number"
        raise PortError(f"{shown}: must be {kind} from {low:g} to {high:g}")
    return value


def _find_input(name: str, inputs: Sequence[Variable], where: str) -> Variable:
    matches = [v for v in inputs if v.name == name]
    if not matches:
        raise PortError(f"{where}: no input is called {name} ({_list_names(inputs)})")
    return matches[0]


def _list_names(variables: Sequence[Variable]) -> str:
    shown = ", ".join(v.name for v in variables[:20])
    return f"there are: {shown or 'none'}" + (f" and {len(variables) - 20} more" if len(variables) > 20 else "")
