"""Parser of SystemStructure.ssd in an SSP archive (Modelica Association, SSP 1.0 and 2.0).

Read are components that are FMUs, systems inside each other, connections with linear transformations and with units,
and parameter sets, inline or in files (SSV).  What else SSP has and would change a number is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from pathlib import PurePosixPath
from urllib.parse import unquote
from xml.etree import ElementTree

from cosim.base.errors import InputError, nearest
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.container import UnusableError, check_xml, read_bytes, to_one_line
from cosim.engine.fmu.units import Unit
from cosim.engine.library import BASE_UNITS

STRUCTURE = "SystemStructure.ssd"
TYPES = ("Real", "Float64", "Float32", "Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64",
         "UInt64", "Boolean", "Enumeration")  # fmt: skip
KINDS = ("input", "output", "parameter", "calculatedParameter")
Path = tuple[str, ...]  # the names of the systems around an element, and its own
Node = tuple[Path, str]  # a connector


@dataclass(frozen=True)
class Connector:
    """A connector of a component or system; ``unit`` is its unit's name, if any."""

    kind: str
    unit: str | None


@dataclass(frozen=True)
class Value:
    """A number of a parameter set with its unit's name, if any."""

    value: float
    unit: str | None


@dataclass(frozen=True)
class Connection:
    """A connection from ``start``: ``factor, offset`` of its linear transformation; None: the units determine it."""

    start: Node
    transformation: tuple[float, float] | None
    is_converted: bool  # whether units are converted


@dataclass
class Structure:
    """The contents of a system structure description."""

    name: str
    version: str
    components: dict[Path, str] = field(default_factory=dict)  # the file of each, in the order of the description
    connectors: dict[Node, Connector] = field(default_factory=dict)
    connections: dict[Node, Connection] = field(default_factory=dict)  # by target connector
    values: dict[Node, Value] = field(default_factory=dict)
    units: dict[str, Unit] = field(default_factory=dict)


def local_tag(element: ElementTree.Element) -> str:
    """Return an element's tag without its namespace, which differs between versions."""
    return element.tag.rpartition("}")[2]


def iterate_elements(element: ElementTree.Element | None, *tags: str) -> Iterator[ElementTree.Element]:
    """Yield the descendants of an element along a path of tags."""
    if element is None:
        return
    for child in element:
        if local_tag(child) == tags[0]:
            if len(tags) == 1:
                yield child
            else:
                yield from iterate_elements(child, *tags[1:])


def read_structure(xml: bytes, file: Callable[[str], bytes]) -> Structure:
    """Read the structure from a checked description; ``file`` returns a file of the archive by its name.

    Raises UnusableError.
    """
    root = ElementTree.fromstring(xml)
    if local_tag(root) != "SystemStructureDescription":
        raise UnusableError(f"{STRUCTURE} describes a {to_one_line(local_tag(root))[:80]}, not a system")
    version = root.get("version", "none stated")
    if not version.startswith(("1.", "2.")):
        raise UnusableError(f"SSP version {version} is not supported; allowed: 1.0, 2.0")
    systems = list(iterate_elements(root, "System"))
    if len(systems) != 1:
        raise UnusableError(f"{STRUCTURE} has {len(systems)} systems at its top; it must have one")
    structure = Structure(systems[0].get("name") or root.get("name") or "system", version)
    structure.units.update(read_units(root))
    _system(systems[0], (), structure, file)
    return structure


def read_units(root: ElementTree.Element) -> dict[str, Unit]:
    """Return the unit definitions of a description or a parameter set by name."""
    units = {}
    for unit in iterate_elements(root, "Units", "Unit"):
        for base in iterate_elements(unit, "BaseUnit"):
            powers = tuple(int(base.get(name, 0)) for name in BASE_UNITS)
            units[unit.get("name", "")] = Unit(powers, float(base.get("factor", 1.0)), float(base.get("offset", 0.0)))
    return units


def _system(element: ElementTree.Element, path: Path, structure: Structure, file: Callable[[str], bytes]) -> None:
    where = "the system" if not path else f"system {'.'.join(path)}"
    if any(iterate_elements(element, "SignalDictionaries")) or any(
        iterate_elements(element, "Elements", "SignalDictionaryReference")
    ):
        raise UnusableError(f"{where} has signal dictionaries, which are not supported")
    _connectors(element, path, structure)
    names: set[str] = set()
    for list_ in iterate_elements(element, "Elements"):
        for child in list_:
            name = child.get("name", "")
            if not name or name in names:
                raise UnusableError(f"{where} has two elements, or one without a name, called {to_one_line(name)!r}")
            names.add(name)
            if local_tag(child) == "System":
                _system(child, (*path, name), structure, file)
            elif local_tag(child) == "Component":
                _component(child, (*path, name), structure, file)
            else:
                raise UnusableError(f"{where} has a {to_one_line(local_tag(child))}, which is not supported")
    for connection in iterate_elements(element, "Connections", "Connection"):
        _connection(connection, path, names, structure)
    _bindings(element, path, structure, file)


def _component(element: ElementTree.Element, path: Path, structure: Structure, file: Callable[[str], bytes]) -> None:
    name, kind = ".".join(path), element.get("type", "application/x-fmu-sharedlibrary")
    source = unquote(element.get("source", ""))
    if "x-fmu" not in kind or not source.lower().endswith(".fmu"):
        raise UnusableError(
            f"component {name} ({source or 'no source'}, {kind}) is no FMU; an FMU in the archive is needed"
        )
    structure.components[path] = str(PurePosixPath(source))
    _connectors(element, path, structure)
    _bindings(element, path, structure, file)


def _connectors(element: ElementTree.Element, path: Path, structure: Structure) -> None:
    for connector in iterate_elements(element, "Connectors", "Connector"):
        name, kind = connector.get("name", ""), connector.get("kind", "")
        if kind not in KINDS:
            where = ".".join((*path, name))
            raise UnusableError(f"connector {where}: kind {kind!r} is not supported; allowed: {', '.join(KINDS)}")
        typed = [child for child in connector if local_tag(child) in TYPES]
        unit = typed[0].get("unit") if typed else None
        structure.connectors[(path, name)] = Connector(kind, unit)


def _connection(element: ElementTree.Element, path: Path, names: set[str], structure: Structure) -> None:
    ends: list[Node] = []
    for which in ("start", "end"):
        name, connector = element.get(f"{which}Element"), element.get(f"{which}Connector", "")
        if name is not None and name not in names:
            raise UnusableError(
                f"a connection {which}s at {to_one_line(name)}.{connector}, and there is no such element"
            )
        ends.append((path if name is None else (*path, name), connector))
    start, end = ends
    stated = None
    for child in element:
        if local_tag(child) == "LinearTransformation":
            stated = float(child.get("factor", 1.0)), float(child.get("offset", 0.0))
        elif local_tag(child).endswith("Transformation"):
            raise UnusableError(f"the connection to {_text(end)} has a {local_tag(child)}, which is not supported")
    if end in structure.connections:
        raise UnusableError(
            f"{_text(end)} is connected to both {_text(structure.connections[end].start)} and {_text(start)}"
        )
    structure.connections[end] = Connection(start, stated, element.get("suppressUnitConversion") not in ("true", "1"))


def _text(node: Node) -> str:
    return ".".join((*node[0], node[1]))


def _bindings(element: ElementTree.Element, path: Path, structure: Structure, file: Callable[[str], bytes]) -> None:
    """Read an element's parameter sets; those of an outer system take precedence, as SSP specifies."""
    where = ".".join(path) or "the system"
    for binding in iterate_elements(element, "ParameterBindings", "ParameterBinding"):
        if any(iterate_elements(binding, "ParameterMapping")):
            raise UnusableError(f"{where}: a parameter binding has a mapping (SSM), which is not supported")
        source, prefix = binding.get("source"), binding.get("prefix", "")
        if source is not None:
            sets = [ElementTree.fromstring(file(unquote(source)))]
        else:
            sets = list(iterate_elements(binding, "ParameterValues", "ParameterSet"))
        for parameter_set in sets:
            units = read_units(parameter_set)
            for name, value in read_values(parameter_set, where).items():
                node = _resolve_parameter(path, prefix + name, structure)
                if value.unit in units:  # the set's own definition, under a name of its own
                    structure.units[f"{where}:{value.unit}"] = units[value.unit]
                    value = Value(value.value, f"{where}:{value.unit}")
                structure.values[node] = value


def read_values(root: ElementTree.Element, where: str) -> dict[str, Value]:
    """Return the numbers of a parameter set (SSV) by name; raise UnusableError for a value that is no number."""
    if local_tag(root) != "ParameterSet":
        raise UnusableError(
            f"{where}: a parameter set begins with a {to_one_line(local_tag(root))[:80]}; ParameterSet is needed"
        )
    values = {}
    for parameter in iterate_elements(root, "Parameters", "Parameter"):
        name = parameter.get("name", "")
        typed = [child for child in parameter if local_tag(child) in TYPES]
        if len(typed) != 1:
            raise UnusableError(f"{where}: parameter {to_one_line(name)} is no number; allowed: {', '.join(TYPES)}")
        text = typed[0].get("value", "")
        try:
            number = float({"true": "1", "false": "0"}.get(text, text))
        except ValueError:
            raise UnusableError(
                f"{where}: parameter {to_one_line(name)} = {to_one_line(text)!r}: is no number"
            ) from None
        values[name] = Value(number, typed[0].get("unit"))
    return values


def read_parameter_set(path: FilePath, archive: Archive) -> dict[str, float]:
    """Return the values of a parameter set file by parameter, in the units of the archive's parameters.

    Raises InputError: one line with the file, and the parameter that is unknown or has an incompatible unit.
    """
    try:
        data = read_bytes(path)
        check_xml(path.name, data)
        root = ElementTree.fromstring(data)
        units, values = read_units(root), read_values(root, "the set")
        known = {v.name: v for v in archive.parameters}
        converted = {}
        for name, value in values.items():
            if name not in known:
                allowed = nearest(name, known) if known else "it has none"
                raise UnusableError(f"{name}: {archive.path.name} has no such parameter; {allowed}")
            variable = known[name]
            factor, offset = 1.0, 0.0
            if value.unit is not None and value.unit != variable.unit:
                source_unit = units.get(value.unit)
                if source_unit is None or variable.base is None:
                    raise UnusableError(f"{name}: is in {value.unit}, the parameter in {variable.unit or 'no unit'}")
                factor, offset = convert_units(source_unit, variable.base, name)
            converted[name] = factor * value.value + offset
    except UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason
    return converted


def _resolve_parameter(path: Path, name: str, structure: Structure) -> Node:
    """Return the connector that a parameter's name means: the element's own, or of the longest nested element named."""
    if path in structure.components:
        return path, name
    elements = dict.fromkeys(
        component[:length] for component in structure.components for length in range(1, len(component) + 1)
    )
    inside = [element for element in elements if element[: len(path)] == path and len(element) > len(path)]
    fitting = [element for element in inside if name.startswith(".".join(element[len(path) :]) + ".")]
    if fitting:
        best = max(fitting, key=lambda element: len(".".join(element)))
        return best, name[len(".".join(best[len(path) :])) + 1 :]
    return path, name


def trace_origin(structure: Structure, node: Node, unit_of: Callable[[Node], Unit | None]) -> tuple[Node, float, float]:
    """Return the connector that a connector's value comes from, with the ``factor`` and ``offset`` along the way.

    Raises UnusableError for a circular connection, and for units of different quantities.
    """
    factor, offset, passed = 1.0, 0.0, {node}
    while node in structure.connections:
        line = structure.connections[node]
        scale, shift = line.transformation or (1.0, 0.0)
        if line.transformation is None and line.is_converted:
            scale, shift = convert_units(unit_of(line.start), unit_of(node), f"{_text(line.start)} to {_text(node)}")
        factor, offset = factor * scale, factor * shift + offset
        node = line.start
        if node in passed:
            raise UnusableError(f"the connections of {_text(node)} go in a circle")
        passed.add(node)
    return node, factor, offset


def convert_units(source: Unit | None, target: Unit | None, what: str) -> tuple[float, float]:
    """Return factor and offset from one unit to another, 1 and 0 where one of them is unknown.

    Raises UnusableError for units of different quantities.
    """
    if source is None or target is None or source == target:
        return 1.0, 0.0
    if source.exponents != target.exponents:
        raise UnusableError(f"{what}: the units measure different things")
    return source.factor / target.factor, (source.offset - target.offset) / target.factor


def sort_components(names: list[Path], feeds: Mapping[Path, set[Path]]) -> tuple[list[Path], set[tuple[Path, Path]]]:
    """Sort components so that each follows its sources; return also the (source, target) pairs that loops make late.

    In a loop the component that is listed first comes first.
    """
    left, done, late = list(names), [], set()
    while left:
        ready = [name for name in left if not feeds.get(name, set()) & (set(left) - {name})]
        following = ready[0] if ready else left[0]
        late |= {(source, following) for source in feeds.get(following, set()) if source in left}
        left.remove(following)
        done.append(following)
    return done, late
