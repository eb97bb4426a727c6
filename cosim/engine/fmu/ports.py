"""Assignment of an FMU's variables to an engine's ports, and the conversion of their values.

A port is found by its own name, and throttle and thrust also where one variable alone can be it by causality and unit;
all others are specified in a mapping file (:mod:`cosim.engine.fmu.mapping`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import NamedTuple

from cosim.engine.fmu.port_kinds import KINDS, NEEDED, PortKind
from cosim.engine.fmu.units import (
    FORCE,
    PRESSURE,
    RATIO,
    SPEED,
    TEMPERATURE,
    Quantity,
    UnitError,
    find_unit,
    is_unit_of,
    to_si,
)
from cosim.engine.fmu.variables import INTEGERS, ConstantValue, Port, Variable


@dataclass(frozen=True)
class PortMap:
    """Ports of an FMU that a mapping file states; all others are found by name and unit."""

    ports: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    throttle_range: tuple[float, float] | None = None
    search: bool = True  # search for ports that are not stated
    scale: Mapping[str, float] = field(default_factory=dict)  # port value over variable value
    inputs: Mapping[str, ConstantValue] = field(default_factory=dict)  # inputs held constant
    warm_up_s: float = 0.0
    rest_n: float = 0.0  # N, peak-to-peak ripple of steady thrust


RANGE_ADVICE = "a mapping file does: [range] throttle = [what 0 is, what 1 is]"  # advice for a throttle without range


class PortError(ValueError):
    """Error for a missing, ambiguous or unsuitable port: one line without the FMU's name."""


def find_ports(variables: Sequence[Variable], port_map: PortMap) -> tuple[dict[str, Port], list[str]]:
    """Return all ports of an engine, stated or found, and notes on assumptions and omissions.

    Raises PortError if a needed or specified port is unfit; an unfit optional one is left out with a note.
    """
    ports: dict[str, Port] = {}
    notes: list[str] = []
    for name, kind in KINDS.items():
        mapped = port_map.ports.get(name)
        is_required = name in NEEDED or mapped or name in port_map.units
        if mapped == "" and name in NEEDED:
            raise PortError(f"its {name} cannot be left unconnected")
        if mapped == "" or (mapped is None and (kind.only_mapped or not port_map.search)):
            continue
        try:
            variable = _find_mapped(name, kind, mapped, variables) if mapped else _search(name, kind, variables, ports)
            if variable is None and is_required:
                raise PortError(f"has no {kind.causality} called {name}; {_advise_mapping(name)}")
            if variable is not None:
                ports[name] = _make_port(name, kind, variable, port_map, ports, notes)
        except PortError as error:
            if is_required:
                raise
            notes.append(f"no {name}: {error}")
    used: dict[tuple[str, int, int], str] = {}
    for name, port in ports.items():
        other = used.setdefault((port.variable.type, port.variable.reference, port.variable.index), name)
        if other != name:
            raise PortError(f"its {port.variable.name} is both {other} and {name}; state one of them in [ports]")
    return ports, notes


class PortFinding(NamedTuple):
    """Result of the search for one port: variable, and why it is not ready; ``part``: mapping table that states it."""

    port: str
    variable: Variable | None
    trouble: str = ""
    part: str = "ports"
    notes: tuple[str, ...] = ()  # assumptions that were made


def look_for_ports(variables: Sequence[Variable]) -> Iterator[PortFinding]:
    """Yield the results of the search for each port of an engine, with problems; absent optional ones are omitted.

    :func:`find_ports` raises the first trouble of a port that is needed.
    """
    ports: dict[str, Port] = {}
    for name, kind in KINDS.items():
        if kind.only_mapped:
            continue
        variable: Variable | None = None
        try:
            variable = _search(name, kind, variables, ports)
            if variable is None and (candidates := _with_unit(name, kind, variables, ports)):
                yield PortFinding(name, None, f"may be {', '.join(v.name for v in candidates)}, by the unit")
            if variable is not None and (name != "start" or "throttle" in ports):
                notes: list[str] = []
                ports[name] = _make_port(name, kind, variable, PortMap(), ports, notes)
                yield PortFinding(name, variable, notes=tuple(notes))
        except PortError as error:
            part = "ports" if variable is None else "range" if name == "throttle" else "units"
            if variable is not None and name == "throttle":
                ports[name] = Port(variable)  # one variable is one port
            yield PortFinding(name, variable, str(error), part)


def normalise_name(name: str) -> str:
    """Return a name reduced to letters and digits, in lower case."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def split_unit(name: str, quantity: Quantity) -> tuple[str, str | None]:
    """Split a name such as ``thrust_lbf`` into stem and unit; None without a unit."""
    words = re.split(r"[^A-Za-z0-9%]+", name)
    for count in (3, 2, 1):
        unit = "/".join(word for word in words[-count:] if word.lower() != "per")
        if len(words) > count and unit and find_unit(unit, quantity) is not None:
            return "_".join(words[:-count]), unit
    return name, None


def _find_mapped(port: str, kind: PortKind, name: str, variables: Sequence[Variable]) -> Variable:
    """Return the variable specified for a port; raise PortError if it is missing, ambiguous or of a wrong type."""
    candidates = [v for v in variables if v.causality == kind.causality]
    matches = [v for v in candidates if v.name == name] or [v for v in candidates if v.name.lower() == name.lower()]
    if not matches:
        raise PortError(f"has no {kind.causality} called {name} for {port} ({_join_names(kind.causality, candidates)})")
    if len(matches) > 1:
        raise PortError(f"has several {kind.causality}s called {name} in other case; state the exact name")
    if matches[0].type not in kind.types:
        raise _make_type_error(matches[0], kind)
    return matches[0]


def _search(port: str, kind: PortKind, variables: Sequence[Variable], ports: Mapping[str, Port]) -> Variable | None:
    """Return the variable with a port's name, or the only candidate for throttle or thrust.

    None if there is none and the port is not needed.
    """
    names = {normalise_name(port), normalise_name(kind.library_name)}
    candidates = _list_unused(kind, variables, ports)
    named = [v for v in candidates if normalise_name(v.name) in names]
    if len(named) == 1:
        if named[0].type not in kind.types:
            raise _make_type_error(named[0], kind)
        if _is_other_quantity(port, kind, named[0]):
            raise _make_unit_error(port, named[0], _explain_unit(named[0], kind))
        return named[0]
    if not named and port not in NEEDED:
        return None
    others = {normalise_name(each) for each in KINDS}
    usable = named or [
        v
        for v in candidates
        if v.type in kind.types and not _is_other_quantity(port, kind, v) and normalise_name(v.name) not in others
    ]
    if port == "thrust" and not named:
        usable = [v for v in usable if is_unit_of(v.unit, v.base, kind.quantity)]
    if len(usable) == 1:
        return usable[0]
    listed = _join_names(kind.causality, usable or candidates)
    count = f"several {kind.causality}s" if usable else f"no {kind.causality}"
    raise PortError(f"has {count} that may be its {port} ({listed}); {_advise_mapping(port)}")


def _list_unused(kind: PortKind, variables: Sequence[Variable], ports: Mapping[str, Port]) -> list[Variable]:
    """Return the scalar variables of a port's causality that are no port yet."""
    used = {port.variable.name for port in ports.values()}
    return [v for v in variables if v.causality == kind.causality and v.name not in used and not v.is_array]


def _with_unit(port: str, kind: PortKind, variables: Sequence[Variable], ports: Mapping[str, Port]) -> list[Variable]:
    """Return the unused variables with a unit of an optional port; none for ratios, which fit everything."""
    if port in NEEDED or kind.quantity is RATIO:
        return []
    free = _list_unused(kind, variables, ports)
    return [v for v in free if v.type in kind.types and is_unit_of(v.unit, v.base, kind.quantity)]


def _is_other_quantity(port: str, kind: PortKind, v: Variable) -> bool:
    """Return whether a variable's declared unit is of another quantity than the port's."""
    if v.unit is None or port in ("throttle", "run", "start"):
        # A throttle may be in degrees or volts or any unit, if its range is stated.
        return port == "throttle" and any(
            is_unit_of(v.unit, v.base, other) for other in (PRESSURE, TEMPERATURE, SPEED, FORCE)
        )
    return not is_unit_of(v.unit, v.base, kind.quantity)


def _explain_unit(v: Variable, kind: PortKind) -> str:
    try:
        to_si(v.unit or "", v.base, kind.quantity)
    except UnitError as error:
        return str(error)
    return f"must be {kind.quantity.name}"


def _make_type_error(v: Variable, kind: PortKind) -> PortError:
    return PortError(f"its {v.name} is of type {v.type}; it must be one of: {', '.join(kind.types)}")


def _make_unit_error(port: str, v: Variable, complaint: str) -> PortError:
    return PortError(f"its {v.name} {complaint}; hexjet engine map begins a file that states it: [units] {port} = ...")


def _advise_mapping(port: str) -> str:
    return f'hexjet engine map begins a file that states it: [ports] {port} = "..."'


def _join_names(causality: str, variables: Sequence[Variable]) -> str:
    names = [v.name for v in variables]
    shown = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    return f"{causality}s: {shown or 'none'}"


def _make_port(
    name: str, kind: PortKind, v: Variable, port_map: PortMap, ports: Mapping[str, Port], notes: list[str]
) -> Port:
    """Return a port on a variable with the conversion to SI units, or to 0..1 for throttle and start."""
    if name == "throttle":
        return _make_throttle_port(v, port_map, notes)
    if name == "start":
        own = _declared_range(v)
        return _scale_to_range(v, *own) if own else replace(ports["throttle"], variable=v)
    if name == "run":
        if v.is_array:
            raise PortError(f"its {v.name} is an element of an array; {name} must be a scalar")
        return Port(v)
    return _make_quantity_port(name, kind, v, port_map, notes)


def _make_quantity_port(name: str, kind: PortKind, v: Variable, port_map: PortMap, notes: list[str]) -> Port:
    """Return a port on a physical quantity, converted from the unit specified, declared or in the variable's name."""
    unit = port_map.units.get(name, v.unit)
    if unit is None:
        unit = split_unit(v.name, kind.quantity)[1]
        if unit is not None:
            notes.append(f"{v.name} states no unit; it is taken to be in {unit}, as its name says")
    scale = port_map.scale.get(name, 1.0)
    if unit is None and kind.quantity is RATIO:
        return Port(v)
    if unit is None:
        if name not in NEEDED:
            raise PortError(f'{v.name} states no unit; a mapping file does: [units] {name} = "{kind.quantity.si}"')
        notes.append(f"{v.name} states no unit; it is taken to be in {kind.quantity.si}")
        return Port(v, scale, 0.0, 1.0 / scale)
    try:
        factor, offset = to_si(unit, None if name in port_map.units else v.base, kind.quantity)
    except UnitError as error:
        raise _make_unit_error(name, v, str(error)) from error
    if name in port_map.units and v.unit is not None and v.unit != unit:
        notes.append(f"{v.name} is in {v.unit}, says the FMU; the mapping file says {unit}, and that counts")
    if not (isfinite(factor) and factor != 0.0 and isfinite(offset)):
        raise PortError(f"its {v.name} is in {unit}, which the FMU defines by {factor:g} and {offset:g}")
    factor, offset = scale * factor, scale * offset
    return Port(v, factor, offset, 1.0 / factor, -offset / factor if offset else 0.0)


def _make_throttle_port(v: Variable, port_map: PortMap, notes: list[str], min_steps: int = 20) -> Port:
    """Return the throttle port, 0 to 1 over the range that is specified, declared or implied by the unit."""
    limits = port_map.throttle_range or _declared_range(v)
    if limits is None and v.type in INTEGERS and port_map.units.get("throttle", v.unit) is None:
        raise PortError(f"its {v.name} is a whole number and states no range; {RANGE_ADVICE}")
    if limits is None:
        limits = _range_of_unit(v, port_map.units.get("throttle", v.unit))
        notes.append(f"{v.name} states no range; it is taken to run from {limits[0]:g} to {limits[1]:g}")
    if v.type in INTEGERS:
        steps = abs(limits[1] - limits[0])
        if steps < min_steps:
            raise PortError(f"its {v.name} is a whole number from {limits[0]:g} to {limits[1]:g}: a throttle needs "
                            f"{min_steps} steps at least; {RANGE_ADVICE}")  # fmt: skip
        notes.append(f"{v.name} is a whole number: the throttle moves in {steps:.0f} steps")
    return _scale_to_range(v, *limits)


def _declared_range(v: Variable, no_bound: float = 1e9) -> tuple[float, float] | None:
    if v.min is None or v.max is None or max(abs(v.min), abs(v.max)) >= no_bound:
        return None
    if not v.min < v.max:
        raise PortError(f"its {v.name} runs from {v.min:g} to {v.max:g}, which is no range")
    return v.min, v.max


def _scale_to_range(v: Variable, low: float, high: float) -> Port:
    span = high - low
    return Port(v, 1.0 / span, -low / span if low else 0.0, span, low, min(low, high), max(low, high))


def _range_of_unit(v: Variable, unit: str | None) -> tuple[float, float]:
    """Return the throttle range implied by its unit: 0 to 1 for a ratio, 0 to 100 for a percentage."""
    if unit is None and normalise_name(v.name).endswith(("pla", "tla", "angle")):
        raise PortError(f"its {v.name} states neither range nor unit; {RANGE_ADVICE}")
    base = v.base if unit == v.unit else None
    if unit is not None and not is_unit_of(unit, base, RATIO):
        raise PortError(f"its {v.name} is in {unit} and states no range; {RANGE_ADVICE}")
    high = 1.0 if unit is None else 1.0 / to_si(unit, base, RATIO)[0]
    if not 0.0 <= (v.start or 0.0) <= high:
        raise PortError(
            f"its {v.name} states no range and starts at {v.start:g}, outside 0 to {high:g}; {RANGE_ADVICE}"
        )
    return 0.0, high
