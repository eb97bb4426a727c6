"""The exported vehicle and its engines as components of one system: an SSP 1.0 archive of the Modelica Association.

The engines come first and the vehicle last, so that a master that goes through the components in their order steps them
as a control step does.  Connectors state no units: what differs between a port and an engine's own variable is a linear
transformation in the connection.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from cosim import InputError
from cosim.blocks import AMBIENT, REALS, EngineSpec, Port
from cosim.engine.library import FMI2_SUFFIX, archive_path, write_archive
from hexjet_export.vehicle.ports import REPORTS, ExportedFlight

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"  # base of the XML namespaces
NAMESPACES = {"ssd": f"{_SSP}Description", "ssc": f"{_SSP}Common", "ssv": f"{_SSP}ParameterValues"}
FMU_TYPE = "application/x-fmu-sharedlibrary"


def write_ssp(flight: ExportedFlight, vehicle: Path, target: Path, fmi: int, seconds: float) -> None:
    """Write an SSP archive of the vehicle's FMU with external engines, and of the engines' FMUs.

    ``seconds``: of the default experiment.  Raises InputError for an engine that cannot be connected so.
    """
    for prefix, uri in NAMESPACES.items():
        ElementTree.register_namespace(prefix, uri)
    stations = flight.simulation.stations
    for jet, spec in enumerate(stations, 1):
        _require_connectable(jet, spec)
    attributes = {"name": target.stem, "version": "1.0", "generationTool": "hexjet-cosim"}
    root = ElementTree.Element(_qualify_tag("ssd:SystemStructureDescription"), attributes)
    system = _add(root, "ssd:System", name=target.stem)
    elements, connections = _add(system, "ssd:Elements"), _add(system, "ssd:Connections")
    contents = {f"resources/{vehicle.name}": vehicle.read_bytes()}
    for jet, spec in enumerate(stations, 1):
        archive = _find_archive(spec, fmi)
        contents[f"resources/{archive.name}"] = archive.read_bytes()
        ports = _list_connected(spec)
        causalities = {port.variable.name: port.variable.causality for port in ports.values()}
        values = {v.name: value for v, value in (*spec.settings, *spec.archive.starting.constants)}
        if spec.start is not None:
            start = spec.archive.ports["start"]
            values[start.variable.name] = start.value(flight.start_throttle[jet - 1])
        _add_component(elements, f"engine_{jet}", archive.name, causalities, values)
        for name, port in ports.items():
            vehicle_end, engine_end = ("vehicle", f"{name}_{jet}"), (f"engine_{jet}", port.variable.name)
            if port.variable.causality == "input":
                _add_connection(connections, vehicle_end, engine_end, port.gain, port.bias)
            else:
                _add_connection(connections, engine_end, vehicle_end, port.scale, port.offset)
    causalities = {quantity.name: "input" for quantity in flight.inputs}
    causalities |= {quantity.name: "output" for quantity in flight.outputs}
    _add_component(elements, "vehicle", vehicle.name, causalities, {})
    _add(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(seconds))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
    write_archive({"SystemStructure.ssd": text} | contents, target)


def _add_connection(
    connections: ElementTree.Element, start: tuple[str, str], end: tuple[str, str], factor: float, offset: float
) -> None:
    """Add a connection between two connectors, each given by element and name."""
    ends = {"startElement": start[0], "startConnector": start[1], "endElement": end[0], "endConnector": end[1]}
    connection = _add(connections, "ssd:Connection", **ends)
    if (factor, offset) != (1.0, 0.0):
        _add(connection, "ssc:LinearTransformation", factor=repr(factor), offset=repr(offset))


def _require_connectable(jet: int, spec: EngineSpec) -> None:
    where = f"export vehicle: ssp: engine of jet {jet} ({spec.path.name})"
    if spec.start is None:
        raise InputError(f"{where}: has no parameter that starts it in equilibrium, which a system needs")
    if spec.archive.starting.warm_up_s:
        raise InputError(f"{where}: has a warm-up ([start]), which a system structure does not state")
    for name in ("throttle", "thrust"):
        if spec.archive.ports[name].variable.type not in REALS or spec.archive.ports[name].variable.is_array:
            raise InputError(f"{where}: its {name} is no real number, which the vehicle's is")


def _find_archive(spec: EngineSpec, fmi: int) -> Path:
    """Return a shipped engine's archive in this FMI version, or another engine's only one."""
    if not spec.library:
        return spec.path
    return archive_path(spec.path.parent, spec.name.removesuffix(FMI2_SUFFIX), fmi)


def _list_connected(spec: EngineSpec) -> Mapping[str, Port]:
    """Return the engine's ports that the system connects, by this project's port names."""
    connected = ("throttle", "run", *AMBIENT, *REPORTS)
    return {
        name: port
        for name, port in spec.archive.ports.items()
        if name in connected and port.variable.type in REALS and not port.variable.is_array
    }


def _add_component(
    parent: ElementTree.Element, name: str, source: str, causalities: Mapping[str, str], values: Mapping[str, float]
) -> None:
    component = _add(parent, "ssd:Component", name=name, source=f"resources/{source}", type=FMU_TYPE)
    connectors = _add(component, "ssd:Connectors")
    for variable, kind in causalities.items():
        _add(_add(connectors, "ssd:Connector", name=variable, kind=kind), "ssc:Real")
    if values:
        binding = _add(_add(component, "ssd:ParameterBindings"), "ssd:ParameterBinding")
        parameter_set = _add(_add(binding, "ssd:ParameterValues"), "ssv:ParameterSet", version="1.0", name="start")
        parameters = _add(parameter_set, "ssv:Parameters")
        for variable, value in values.items():
            _add(_add(parameters, "ssv:Parameter", name=variable), "ssv:Real", value=repr(value))


def _qualify_tag(tag: str) -> str:
    prefix, _, local = tag.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, _qualify_tag(tag), attributes)
