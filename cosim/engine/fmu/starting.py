"""What an engine is set to at its start: inputs that are held, and how long it runs before a flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import NamedTuple

from cosim.engine.fmu.ports import PortError, PortMap
from cosim.engine.fmu.variables import REALS, ConstantValue, Port, Variable

Setting = tuple[Variable, float]


class EngineStart(NamedTuple):
    """Settings with which each instance of an engine is started."""

    constants: tuple[Setting, ...] = ()  # set before initialization and held
    warm_up_s: float = 0.0  # s at zero throttle before the flight
    rest_n: float = 0.0  # N, peak-to-peak ripple of steady thrust


def resolve_start(port_map: PortMap, inputs: Sequence[Variable], ports: Mapping[str, Port]) -> EngineStart:
    """Return the start settings of a mapping file, resolved to variables and numbers.

    Raises PortError for an input that is not there, a port, or a value that the input cannot have.
    """
    port_names = {port.variable.name: name for name, port in ports.items()}
    arrays = {port.variable.reference for port in ports.values() if port.variable.is_array}
    constants = []
    for name, stated in port_map.inputs.items():
        variable = next((v for v in inputs if v.name == name), None)
        if variable is None:
            raise PortError(f"[inputs]: no input is called {name} ({_join_variable_names(inputs)})")
        if name in port_names:
            raise PortError(f"[inputs]: {name} is its port {port_names[name]}, which the simulation sets")
        if variable.is_array and variable.reference in arrays:
            raise PortError(f"[inputs]: {name} is an element of an array of which another is a port")
        constants.append((variable, convert_value(variable, stated, "[inputs]")))
    return EngineStart(tuple(constants), port_map.warm_up_s, port_map.rest_n)


def convert_value(variable: Variable, specified: ConstantValue, where: str) -> float:
    """Return the number for a stated value of an input or parameter.  Raises PortError."""
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


def _join_variable_names(variables: Sequence[Variable]) -> str:
    shown = ", ".join(v.name for v in variables[:20])
    return f"there are: {shown or 'none'}" + (f" and {len(variables) - 20} more" if len(variables) > 20 else "")
