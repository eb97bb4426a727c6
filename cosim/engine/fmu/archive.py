"""Reading of an ``.fmu`` archive: its variables, ports and features, and the reasons why it cannot be used."""

from __future__ import annotations

import hashlib
import io
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cosim.base.errors import InputError
from cosim.base.removed import describe_removed
from cosim.base.storage.cache import RecentCache
from cosim.engine.fmu.container import (
    DAMAGE_ERRORS,
    DESCRIPTION,
    UnusableError,
    Zip,
    has_sources,
    open_archive,
    parse_xml,
    read_bytes,
    read_fmi_version,
    to_one_line,
)
from cosim.engine.fmu.description import pack_descriptions, read_description
from cosim.engine.fmu.ports import PortError, PortMap, find_ports
from cosim.engine.fmu.starting import EngineStart, resolve_start
from cosim.engine.fmu.units import Unit
from cosim.engine.fmu.variables import INTEGERS, REALS, Port, Variable
from cosim.engine.library import ADAPTER_FILES, ADAPTER_GENERATED, GENERATION_TOOL, LIBRARY_SUFFIX, platform_folder

TYPES = {*REALS, *INTEGERS, "Boolean", "Enumeration"}  # FMI types of readable variables

_archives: RecentCache[Archive] = RecentCache(64)


@dataclass(frozen=True)
class Archive:
    """FMU archive that was read, validated and found usable as an engine on this machine."""

    path: Path
    sha256: str
    fmi: int  # FMI major version, 2 or 3
    version: str  # version text of the description
    model: str
    ports: Mapping[str, Port]  # empty if the ports were not searched
    port_notes: tuple[str, ...]  # assumptions made about the ports
    harmless_violations: tuple[str, ...]  # violations of FMI without effect here
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    once_per_process: bool
    starting: EngineStart = field(default_factory=EngineStart)
    equations_sha256: str | None = None  # hash_equations(); None: not shipped
    identifier: str = ""
    token: str = ""
    internal_step: float | None = None  # s, if the description states it
    returns_early: bool = False  # FMI 3.0: doStep may return early

    @property
    def throttle(self) -> Variable:
        return self.ports["throttle"].variable

    @property
    def thrust(self) -> Variable:
        return self.ports["thrust"].variable

    @property
    def start(self) -> str | None:
        """Name of the parameter that starts the engine in equilibrium at a throttle, or None."""
        return self.ports["start"].variable.name if "start" in self.ports else None


def read_archive(path: Path, ports: PortMap | None = None) -> Archive:
    """Return an archive that is read and checked; ``ports`` states ports, others are found by name and unit.

    Raises InputError: one line with the file and what is wrong with it.
    """
    try:
        port_map, data = ports or PortMap(), read_bytes(path)
        sha256 = hashlib.sha256(data).hexdigest()
        return _archives.get((path, sha256, repr(port_map)), lambda: _read_archive(path, data, sha256, port_map))
    except UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason


def find_library(archive: Archive) -> str:
    """Return the path of this platform's library in the archive of one FMU."""
    return f"binaries/{platform_folder(archive.fmi)}/{archive.identifier}{LIBRARY_SUFFIX}"


def validate(data: bytes) -> list[str]:
    """Return the complaints of FMPy's validation about an archive's descriptions, empty if there are none.

    The names of its files are left out; :func:`cosim.engine.fmu.container.note_unusual_names` has notes on them.
    """
    from fmpy.validation import validate_fmu  # type: ignore[import-untyped]

    return [to_one_line(problem) for problem in validate_fmu(pack_descriptions(data))]


def read_component(path: Path, data: bytes) -> Archive:
    """Return an FMU's archive without looking for engine ports.  Raises UnusableError."""
    return _read_archive(path, data, hashlib.sha256(data).hexdigest(), None)


def _read_archive(path: Path, data: bytes, sha256: str, port_map: PortMap | None) -> Archive:
    names, xml = open_archive(data)
    root = parse_xml(xml)
    fmi = read_fmi_version(root)
    description, blemishes = read_description(data)
    cosimulation = description.coSimulation
    _check_library(names, fmi, cosimulation.modelIdentifier)
    _read_unsigned(root, description)
    elements = _list_variables(description)
    inputs, outputs, parameters = (
        tuple(v for v in elements if v.causality == causality) for causality in ("input", "output", "parameter")
    )
    found: Mapping[str, Port] = {}
    notes: list[str] = []
    starting = EngineStart()
    try:
        if port_map is not None:
            _refuse_input_clocks(root)
            found, notes = find_ports([*inputs, *outputs, *parameters], port_map)
            starting = resolve_start(port_map, inputs, found)
            notes += note_unset_inputs(inputs, found, starting)
    except PortError as error:
        raise UnusableError(str(error)) from error
    return Archive(
        path=path,
        sha256=sha256,
        equations_sha256=hash_equations(data, root, description),
        fmi=fmi,
        version=root.attrib["fmiVersion"],
        model=description.modelName,
        identifier=cosimulation.modelIdentifier,
        token=description.instantiationToken,
        ports=found,
        port_notes=tuple(notes),
        harmless_violations=blemishes,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        internal_step=_positive_or_none(cosimulation.fixedInternalStepSize),
        once_per_process=cosimulation.canBeInstantiatedOnlyOncePerProcess,
        returns_early=cosimulation.mightReturnEarlyFromDoStep,
        starting=starting,
    )


def _refuse_input_clocks(root: ElementTree.Element) -> None:
    """Raise PortError for an input clock, because nothing would tick it."""
    clock = root.find("ModelVariables/Clock[@causality='input']")
    if clock is not None:
        raise PortError(f"has the input clock {clock.get('name')}: {describe_removed('input clock')}")


def hash_equations(data: bytes, root: ElementTree.Element, description: Any) -> str | None:
    """Return a hash of a library engine's C sources and variables with their start values.

    The hash does not depend on compiler or FMI adapter, while that of the archive changes with every compiler.  None
    for an archive that the library's build did not make, for which only the archive's hash exists.
    """
    if root.get("generationTool") != GENERATION_TOOL:
        return None
    digest = hashlib.sha256()
    for name, text in read_engine_sources(data):
        digest.update(f"{name}\0".encode() + text + b"\0")
    for v in sorted(description.modelVariables, key=lambda v: str(v.name)):
        digest.update(repr([str(value) for value in (v.name, v.causality, v.start, v.min, v.max, v.unit)]).encode())
    return digest.hexdigest()


def read_engine_sources(data: bytes) -> list[tuple[str, bytes]]:
    """Return the engine's own C sources in a shipped archive: names and contents.  Raises UnusableError."""
    adapter = {f"sources/{name}" for name in (*ADAPTER_FILES, *ADAPTER_GENERATED, "fmi2.c", "fmi3.c")}
    try:
        with Zip(io.BytesIO(data)) as fmu:
            names = sorted(set(fmu.namelist()) - adapter)
            return [(name, fmu.read(name)) for name in names if name.startswith("sources/")]
    except DAMAGE_ERRORS as error:
        raise UnusableError(f"is damaged or truncated: {to_one_line(error)}") from error


def note_unset_inputs(inputs: Sequence[Variable], ports: Mapping[str, Port], starting: EngineStart) -> list[str]:
    """Return a note on inputs that nothing sets, or an empty list."""
    assigned = {port.variable.name for port in ports.values()} | {v.name for v, _ in starting.constants}
    unset = [v for v in inputs if v.name not in assigned and not v.is_array]
    if not unset:
        return []
    shown = ", ".join(v.name if v.start is None else f"{v.name} = {v.start:g}" for v in unset[:10])
    more = f" and {len(unset) - 10} more" if len(unset) > 10 else ""
    return [f"inputs that stay at their start values, unless a mapping file says otherwise in [inputs]: {shown}{more}"]


def _read_unsigned(root: ElementTree.Element, description: Any) -> None:
    """Add the limits of FMI 3.0's unsigned variables to a description, as FMPy omits them."""
    unsigned = {
        element.get("name"): element for element in root.iterfind("ModelVariables/*") if element.tag.startswith("UInt")
    }
    for v in description.modelVariables:
        if v.name in unsigned:
            v.min, v.max = (unsigned[v.name].get(key) for key in ("min", "max"))


def _check_library(names: list[str], fmi: int, identifier: str) -> None:
    needed = f"binaries/{platform_folder(fmi)}/{identifier}{LIBRARY_SUFFIX}"
    if needed in names:
        return
    inside = sorted(name.split("/", 2)[1:] for name in names if name.startswith("binaries/") and name.count("/") > 1)
    here = [file for folder, file in inside if folder == platform_folder(fmi)]
    folders = ", ".join(dict.fromkeys(folder for folder, file in inside if file))
    has = f"it has: {folders or 'no binary at all'}"
    if here:
        files = ", ".join(file for file in here if file)
        has = f"folder {platform_folder(fmi)} {f'holds {files}' if files else 'is empty'}"
    more = "; it has sources: python -m fmpy compile makes one of them" if has_sources(names) else ""
    raise UnusableError(f"has no binary for this machine, {needed} ({has}){more}")


def _units_in_si(description: Any) -> dict[str, Unit]:
    """Return the units that a description defines, by name, in SI base units."""
    bases = {}
    for unit in description.unitDefinitions:
        base = unit.baseUnit
        if base is not None:
            exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
            bases[unit.name] = Unit(exponents, float(base.factor), float(base.offset))
    return bases


def _list_variables(description: Any) -> list[Variable]:
    """Return all variables of a description, arrays by element.  Raises UnusableError for a value that is no number."""
    try:
        bases = _units_in_si(description)
        return [element for v in description.modelVariables if v.type in TYPES for element in _elements(v, bases)]
    except (ValueError, OverflowError) as error:
        raise UnusableError(f"{DESCRIPTION} cannot be used: {to_one_line(error)}") from error


def _elements(v: Any, bases: Mapping[str, Unit], max_elements: int = 10_000) -> list[Variable]:
    """Return a scalar variable, or an array's elements as ``array[1]`` or ``array[2,1]``, row by row as in FMI.

    The size is that at the structural parameters' start values.  ``max_elements``: elements that are listed one by one.
    """
    shape = tuple(v.shape or ())
    size = math.prod(shape)
    texts = (v.start or "").split() if shape else [v.start]
    starts = [parse_number(text) for text in texts]
    if shape and len(starts) != size:
        starts = (starts or [None]) * size if len(starts) < 2 else []
    if not shape:
        return [_make_variable(v, v.name, 0, starts, bases)]
    if not 1 <= size <= max_elements or not starts:
        return []
    subscripts = itertools.product(*(range(1, length + 1) for length in shape))
    return [
        _make_variable(v, f"{v.name}[{','.join(map(str, subscript))}]", index, starts, bases)
        for index, subscript in enumerate(subscripts)
    ]


def _make_variable(v: Any, name: str, index: int, starts: list[float | None], bases: Mapping[str, Unit]) -> Variable:
    declared = v.declaredType
    limits = (getattr(v, key) or (getattr(declared, key) if declared else None) for key in ("min", "max"))
    low, high = map(parse_number, limits)
    unit = v.unit or (declared.unit if declared else None)
    return Variable(
        name=name,
        type=v.type,
        reference=v.valueReference,
        unit=unit,
        min=low,
        max=high,
        start=starts[index],
        description=v.description or "",
        causality=v.causality or "local",
        variability=v.variability or ("continuous" if v.type in REALS else "discrete"),
        base=bases.get(unit or ""),
        items=tuple((item.name, int(item.value)) for item in (declared.items if declared else None) or ()),
        index=index,
        starts=tuple(0.0 if start is None else start for start in starts),
    )


def parse_number(text: str | None) -> float | None:
    """Return a number as a model description has it, a Boolean as 1 or 0; None for no text."""
    return None if text is None else float({"true": "1", "false": "0"}.get(text, text))


def _positive_or_none(value: object) -> float | None:
    number = None if value is None else float(str(value))
    return number if number is not None and math.isfinite(number) and number > 0.0 else None
