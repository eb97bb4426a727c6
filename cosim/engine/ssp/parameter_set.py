"""A parameter set (SSV of SSP) as values of an engine's parameters."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from cosim.base.errors import InputError, nearest
from cosim.engine.fmu.archive import Archive
from cosim.engine.fmu.container import UnusableError, check_xml, read_bytes
from cosim.engine.ssp.structure import convert_units, read_units, read_values


def read_parameter_set(path: Path, archive: Archive) -> dict[str, float]:
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
