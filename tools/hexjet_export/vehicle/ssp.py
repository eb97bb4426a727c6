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
FMU = "application/x-fmu-sharedlibrary"  # media type of an FMU


def write_ssp(flight: ExportedFlight, vehicle: Path, target: Path, fmi: int, seconds: float) -> None:
    """Write an SSP archive of the vehicle's FMU with external engines, and of the engines' FMUs.

    ``seconds``: of the default experiment.  Raises InputError for an engine that cannot be connected so.
    """
    for prefix, uri in NAMESPACES.items():
        ElementTree.register_namespace(prefix, uri)
    stations = flight.simulation.stations
    for jet, spec in enumerate(stations, 1):
        _check_engine(jet, spec)
    attributes = {"name": target.stem, "version": "1.0", "generationTool": "hexjet-cosim"}
    root = ElementTree.Element(_name("ssd:SystemStructureDescription"), attributes)
    system = _sub(root, "ssd:System", name=target.stem)
    elements, connections = _sub(system, "ssd:Elements"), _sub(system, "ssd:Connections")
    contents = {f"resources/{vehicle.name}": vehicle.read_bytes()}
    for jet, spec in enumerate(stations, 1):
        archive = _archive(spec, fmi)
        contents[f"resources/{archive.name}"] = archive.read_bytes()
        ports = _list_connected(spec)
        causalities = {port.variable.name: port.variable.causality for port in ports.values()}
        values = {v.name: value for v, value in (*spec.settings, *spec.archive.starting.constants)}
        if spec.start is not None:
            start = spec.archive.ports["start"]
            values[start.variable.name] = start.value(flight.start_throttle[jet - 1])
        _component(elements, f"engine_{jet}", archive.name, causalities, values)
        for name, port in ports.items():
            vehicle_end, engine_end = ("vehicle", f"{name}_{jet}"), (f"engine_{jet}", port.variable.name)
            if port.variable.causality == "input":
                _connect(connections, vehicle_end, engine_end, port.gain, port.bias)
            else:
                _connect(connections, engine_end, vehicle_end, port.scale, port.offset)
    causalities = {quantity.name: "input" for quantity in flight.inputs}
    causalities |= {quantity.name: "output" for quantity in flight.outputs}
    _component(elements, "vehicle", vehicle.name, causalities, {})
    _sub(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(seconds))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
    write_archive({"SystemStructure.ssd": text} | contents, target)


def _connect(
    connections: ElementTree.Element, start: tuple[str, str], end: tuple[str, str], factor: float, offset: float
) -> None:
    """Add a connection between two connectors, each given by element and name."""
    ends = {"startElement": start[0], "startConnector": start[1], "endElement": end[0], "endConnector": end[1]}
    connection = _sub(connections, "ssd:Connection", **ends)
    if (factor, offset) != (1.0, 0.0):
        _sub(connection, "ssc:LinearTransformation", factor=repr(factor), offset=repr(offset))


def _check_engine(jet: int, spec: EngineSpec) -> None:
    where = f"export vehicle: ssp: engine of jet {jet} ({spec.path.name})"
    if spec.start is None:
        raise InputError(f"{where}: has no parameter that starts it in equilibrium, which a system needs")
    if spec.archive.starting.warm_up_s:
        raise InputError(f"{where}: has a warm-up ([start]), which a system structure does not state")
    for name in ("throttle", "thrust"):
        if spec.archive.ports[name].variable.type not in REALS or spec.archive.ports[name].variable.is_array:
            raise InputError(f"{where}: its {name} is no real number, which the vehicle's is")


def _archive(spec: EngineSpec, fmi: int) -> Path:
    """Return a shipped engine's archive in this FMI version, or another engine's only one."""
    if not spec.library:
        return spec.path
    return archive_path(spec.path.parent, spec.name.removesuffix(FMI2_SUFFIX), fmi)


def _list_connected(spec: EngineSpec) -> Mapping[str, Port]:
    """Return the ports that are connected, by the names that they have here."""
    connected = ("throttle", "run", *AMBIENT, *REPORTS)
    return {
        name: port
        for name, port in spec.archive.ports.items()
        if name in connected and port.variable.type in REALS and not port.variable.is_array
    }


def _component(
    parent: ElementTree.Element, name: str, source: str, causalities: Mapping[str, str], values: Mapping[str, float]
) -> None:
    component = _sub(parent, "ssd:Component", name=name, source=f"resources/{source}", type=FMU)
    connectors = _sub(component, "ssd:Connectors")
    for variable, kind in causalities.items():
        _sub(_sub(connectors, "ssd:Connector", name=variable, kind=kind), "ssc:Real")
    if values:
        binding = _sub(_sub(component, "ssd:ParameterBindings"), "ssd:ParameterBinding")
        parameter_set = _sub(_sub(binding, "ssd:ParameterValues"), "ssv:ParameterSet", version="1.0", name="start")
        parameters = _sub(parameter_set, "ssv:Parameters")
        for variable, value in values.items():
            _sub(_sub(parameters, "ssv:Parameter", name=variable), "ssv:Real", value=repr(value))


def _name(tag: str) -> str:
    prefix, _, local = tag.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def _sub(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, _name(tag), attributes)
