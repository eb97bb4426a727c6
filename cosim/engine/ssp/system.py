"""Reading of a system of FMUs, an ``.ssp`` archive, as one engine: its components and its variables.

Its variables are the connectors of the system, and beside them every input, output and parameter of a component under
``component.variable``.  The ports of an engine are found among the connectors, as those of an FMU are among its
variables; a mapping file may name any.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cosim.base.errors import nearest
from cosim.base.storage.cache import RecentCache
from cosim.engine.fmu.archive import (
    Archive,
    Component,
    ComponentVariable,
    Feed,
    System,
    label_ports,
    note_unset_inputs,
    read_cached,
    read_component,
)
from cosim.engine.fmu.container import UnusableError, Zip, check_xml, open_archive
from cosim.engine.fmu.mapping import PortMap
from cosim.engine.fmu.ports import PortError, find_engines, has_several_engines
from cosim.engine.fmu.starting import Setting, resolve_start
from cosim.engine.fmu.units import Unit
from cosim.engine.fmu.variables import Variable
from cosim.engine.ssp.structure import (
    STRUCTURE,
    Node,
    Structure,
    Value,
    convert_units,
    read_structure,
    sort_components,
    trace_origin,
)
from cosim.engine.ssp.structure import Path as At

SUFFIX = ".ssp"
_systems: RecentCache[Archive] = RecentCache(16)


def is_system(path: Path) -> bool:
    """Return whether a path looks like an SSP archive."""
    return path.suffix.lower() == SUFFIX


def read_system(path: Path, ports: PortMap | None = None) -> Archive:
    """Read a system; ``ports`` specifies ports, the others are found by name and unit.

    Raises InputError: one line with the file, the component where it is one's fault, and what is wrong with it.
    """
    return read_cached(path, ports, _systems, _read)


class _Components:
    """The archives of a structure's components."""

    def __init__(self, path: Path, structure: Structure, zipped: Zip) -> None:
        self.structure = structure
        self.archives: dict[At, Archive] = {}
        for name, file in structure.components.items():
            try:
                self.archives[name] = read_component(path / file, zipped.read(file))
            except KeyError:
                raise UnusableError(f"component {'.'.join(name)}: there is no {file} in the archive") from None
            except UnusableError as reason:
                raise UnusableError(f"component {'.'.join(name)} ({file}): {reason}") from reason
        self._known = {
            name: {v.name: v for v in (*archive.inputs, *archive.outputs, *archive.parameters)}
            for name, archive in self.archives.items()
        }

    def variable(self, node: Node) -> Variable:
        """Return the variable of a component's connector; raise UnusableError if its FMU has none of that name."""
        path, name = node
        known = self._known[path]
        where = f"component {'.'.join(path)} ({self.structure.components[path]})"
        if name not in known:
            raise UnusableError(f"{where}: has no variable {name}; {nearest(name, list(known))}")
        if known[name].is_array:
            raise UnusableError(f"{where}: {name} is part of an array, which cannot be connected")
        return known[name]

    def unit(self, node: Node) -> Unit | None:
        """Return a connector's unit: its own, else that of the component's FMU, else None."""
        connector = self.structure.connectors.get(node)
        own = self.variable(node) if node[0] in self.archives else None
        if connector is not None and connector.unit is not None:
            if connector.unit in self.structure.units:
                return self.structure.units[connector.unit]
            if own is not None and own.unit == connector.unit:
                return own.base
            return None
        return own.base if own is not None else None

    def origin(self, node: Node) -> tuple[Node, float, float]:
        return trace_origin(self.structure, node, self.unit)


def _read(path: Path, data: bytes, sha256: str, port_map: PortMap) -> Archive:
    _, xml = open_archive(data, STRUCTURE, "SSP")
    with Zip(io.BytesIO(data)) as zipped:

        def file(name: str) -> bytes:
            try:
                content = zipped.read(name)
            except KeyError:
                raise UnusableError(f"there is no {name} in the archive") from None
            check_xml(name, content)
            return content

        try:
            structure = read_structure(xml, file)
        except ValueError as error:
            raise UnusableError(f"{STRUCTURE}: {error}") from error
        if not structure.components:
            raise UnusableError("has no components")
        components = _Components(path, structure, zipped)
    for end in structure.connections:
        for node in (end, structure.connections[end].start):
            if node[0] in components.archives:
                components.variable(node)
    return _archive(path, sha256, port_map, structure, components)


def _archive(path: Path, sha256: str, port_map: PortMap, structure: Structure, components: _Components) -> Archive:
    origins = {
        (name, v.name): components.origin((name, v.name))
        for name, archive in components.archives.items()
        for v in (*archive.inputs, *archive.parameters)
    }
    fed: dict[At, set[At]] = {}
    for node, (source, _, _) in origins.items():
        if source != node and source[0] in components.archives and components.variable(node).causality == "input":
            fed.setdefault(node[0], set()).add(source[0])
    ordered, late = sort_components(list(components.archives), fed)
    number = {name: i for i, name in enumerate(ordered)}
    settings = _settings(structure, components, origins)
    fmus = tuple(
        Component(".".join(name), structure.components[name], components.archives[name], settings.get(name, ()))
        for name in ordered
    )
    feeds = tuple(
        Feed(number[node[0]], components.variable(node), number[source[0]], components.variable(source), factor, offset,
             (source[0], node[0]) in late)
        for node, (source, factor, offset) in origins.items()
        if source != node and source[0] in components.archives and components.variable(node).causality == "input"
    )  # fmt: skip
    starts = {(name, v.name): value for name, pairs in settings.items() for v, value in pairs}
    variables, places = _variables(structure, components, origins, number, starts)
    system = System(fmus, feeds, places)
    named = {name for each in port_map.ports.values() for name in (each if isinstance(each, list) else [each])}
    many = any(has_several_engines(port) and "." in port for port in port_map.ports.values())  # of components, with a *
    own = [v for v in variables if many or "." not in v.name or v.name in named]
    inputs, outputs, parameters = (
        tuple(v for v in variables if v.causality == causality) for causality in ("input", "output", "parameter")
    )
    try:
        engines, notes = find_engines(own or variables, port_map)
        begin = resolve_start(port_map, inputs, outputs, label_ports(engines))
    except PortError as error:
        raise UnusableError(str(error)) from error
    notes += note_unset_inputs(inputs, label_ports(engines), begin)
    notes += [f"component {fmu.name}: {text}" for fmu in fmus for text in fmu.archive.port_notes]  # on clocks
    notes += [f"exchanged a step late, because it is in a loop: {text}" for text in system.late_connections]
    return Archive(
        path=path,
        sha256=sha256,
        fmi=2,  # by whose functions it is stepped: see system_instance
        version=f"SSP {structure.version}",
        model=structure.name,
        engines=engines,
        port_notes=tuple(notes),
        harmless_violations=tuple(
            f"component {fmu.name}: {text}" for fmu in fmus for text in fmu.archive.harmless_violations
        ),
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        once_per_process=any(fmu.archive.once_per_process for fmu in fmus),
        saves_state=all(fmu.archive.saves_state for fmu in fmus),
        serializes_state=all(fmu.archive.serializes_state for fmu in fmus),
        starting=begin,
        system=system,
    )


def _settings(
    structure: Structure, components: _Components, origins: Mapping[Node, tuple[Node, float, float]]
) -> dict[At, tuple[Setting, ...]]:
    """Return the parameter sets' values for each component; outer sets take precedence over inner ones."""
    settings: dict[At, list[Setting]] = {}
    used = set()
    for node in origins:
        sources = [source for source in _upstream_connectors(structure, node) if source in structure.values]
        used.update(sources)
        if not sources:
            continue
        at, variable = sources[-1], components.variable(node)  # the outermost
        value = structure.values[at]
        number = _in_unit(structure, value, components, at)
        if at != node:
            _, scale, shift = trace_origin(_disconnect(structure, at), node, components.unit)
            number = scale * number + shift
        settings.setdefault(node[0], []).append((variable, number))
    for node in structure.values:
        if node in used:
            continue
        if node[0] in components.archives:
            components.variable(node)  # it may be an output, or an array
        text = ".".join((*node[0], node[1]))
        raise UnusableError(f"a parameter set states {text}, which is no parameter and no input")
    return {name: tuple(values) for name, values in settings.items()}


def _upstream_connectors(structure: Structure, node: Node) -> list[Node]:
    """Return a component's connector followed by the connectors that it is fed from, up to the first source."""
    connectors = [node]
    while connectors[-1] in structure.connections:
        connectors.append(structure.connections[connectors[-1]].start)
    return connectors


def _disconnect(structure: Structure, at: Node) -> Structure:
    """Return the structure without the connection to a connector."""
    return replace(structure, connections={end: line for end, line in structure.connections.items() if end != at})


def _in_unit(structure: Structure, value: Value, components: _Components, node: Node) -> float:
    text = ".".join((*node[0], node[1]))
    own = components.variable(node).unit if node[0] in components.archives else None
    if value.unit is None or value.unit == own:
        return value.value
    source = structure.units.get(value.unit)
    if source is None:
        raise UnusableError(f"parameter {text}: its unit {value.unit} is not defined")
    factor, offset = convert_units(source, components.unit(node), f"parameter {text}")
    return factor * value.value + offset


def _variables(
    structure: Structure,
    components: _Components,
    origins: Mapping[Node, tuple[Node, float, float]],
    number: Mapping[At, int],
    starts: Mapping[Node, float],
) -> tuple[list[Variable], tuple[tuple[ComponentVariable, ...], ...]]:
    """Return the system's variables, all of them real numbers, and the component variables behind each."""
    variables: list[Variable] = []
    places: list[tuple[ComponentVariable, ...]] = []

    names = {i: name for name, i in number.items()}

    def add(name: str, causality: str, at: list[ComponentVariable], unit: tuple[str | None, Unit | None]) -> None:
        first = at[0]
        plain = (first.factor, first.offset) == (1.0, 0.0)
        v = first.variable
        low, high = (0.0, 1.0) if v.type == "Boolean" else (v.min, v.max)
        variables.append(
            Variable(
                name=name,
                type="Real",
                reference=len(places),
                unit=unit[0],
                min=low if plain else None,
                max=high if plain else None,
                start=starts.get((names[first.component], v.name), v.start) if plain else None,
                description=v.description,
                causality=causality,
                variability="fixed" if causality == "parameter" else "continuous",
                base=unit[1],
            )
        )
        places.append(tuple(at))

    for node, connector in structure.connectors.items():
        if node[0] or connector.kind == "calculatedParameter":
            continue
        if connector.kind == "output":
            source, factor, offset = components.origin(node)
            if source[0] not in components.archives:
                raise UnusableError(f"its output {node[1]} is connected to no component")
            at = [ComponentVariable(number[source[0]], components.variable(source), factor, offset)]
        else:
            at = [
                ComponentVariable(number[end[0]], components.variable(end), factor, offset)
                for end, (source, factor, offset) in origins.items()
                if source == node
            ]
            if not at:
                continue  # no component reads this input
        plain = (at[0].factor, at[0].offset) == (1.0, 0.0)
        same = at[0].variable if plain else None
        unit = connector.unit or (same.unit if same else None)
        add(node[1], connector.kind, at, (unit, components.unit(node) or (same.base if same else None)))
    for name, archive in components.archives.items():
        for v in (*archive.inputs, *archive.outputs, *archive.parameters):
            free = v.causality == "output" or origins[(name, v.name)][0] == (name, v.name)
            if free and not v.is_array:
                add(f"{'.'.join(name)}.{v.name}", v.causality, [ComponentVariable(number[name], v)], (v.unit, v.base))
    return variables, tuple(places)
