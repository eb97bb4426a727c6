"""Systems of FMUs made on the spot: a governor, a fuel pump and a core, and structures that join them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from cosim.base.storage.paths import data_folder
from cosim.engine.library import EngineDefinition, VariableDefinition, build_one

STEP = 0.004
FULL = 20.0  # N

# what each does in a step, of the variables below
BODIES = {
    "governor": "v->valve = limit(v->demand + v->gain * (v->demand - v->speed), 0.0, 1.0);",
    "pump": "v->flow = v->flow + 0.2 * (v->command - v->flow);",
    "core": "v->n = v->n + 0.05 * (v->fuel - v->n); v->thrust_kN = 0.02 * v->n;",
}
VARIABLES: Mapping[str, Mapping[str, tuple[str, str | None, float]]] = {
    "governor": {
        "demand": ("input", "1", 0.0), "speed": ("input", "1", 0.0), "valve": ("output", "1", 0.0),
        "gain": ("parameter", None, 0.5),
    },
    "pump": {"command": ("input", "1", 0.0), "flow": ("output", "1", 0.0)},
    "core": {"fuel": ("input", "1", 0.0), "thrust_kN": ("output", None, 0.0), "n": ("output", "1", 0.0)},
}  # fmt: skip


def component(folder: Path, name: str, fmi: int) -> Path:
    """One of them as an FMU."""
    body, table = BODIES[name], VARIABLES[name]
    source = folder / f"{name}.c"
    source.write_text(
        '#include "engine.h"\nconst size_t engine_state_size = 1;\n'
        "void engine_start(Variables *v, void *s) { (void)v; (void)s; }\n"
        f"void engine_step(Variables *v, void *s) {{ (void)s; {body} }}\n"
    )
    variables = [
        VariableDefinition(
            each, i, causality, False, unit, *((0.0, 1.0) if each == "demand" else (None, None)),
            None if causality == "output" else start, each,
        )
        for i, (each, (causality, unit, start)) in enumerate(table.items(), 1)
    ]  # fmt: skip
    engine = EngineDefinition(name, folder, name, name, (source,), STEP, {}, {}, 0.0, {}, tuple(variables))
    target = folder / f"{name}.fmu"
    build_one(engine, data_folder("engines") / "fmi", fmi, target, {})
    return target


def components(folder: Path) -> dict[str, bytes]:
    """All three, of both FMI versions."""
    return {
        name: component(folder, name, fmi).read_bytes() for name, fmi in (("governor", 2), ("pump", 3), ("core", 2))
    }


def line(start: str, end: str, inside: str = "") -> str:
    """A connection; a name without a dot is the system's own."""

    def ends(which: str, text: str) -> str:
        element, dot, connector = text.rpartition(".")
        return (
            f'{which}Element="{element}" {which}Connector="{connector}"' if dot else f'{which}Connector="{connector}"'
        )

    return f"<ssd:Connection {ends('start', start)} {ends('end', end)}>{inside}</ssd:Connection>"


KILO = '<ssc:LinearTransformation factor="1000.0"/>'
LINES = (
    line("throttle", "governor.demand"),
    line("core.n", "governor.speed"),
    line("governor.valve", "pump.command"),
    line("pump.flow", "core.fuel"),
    line("core.thrust_kN", "thrust", KILO),
)
CONNECTORS = (
    '<ssd:Connector name="throttle" kind="input"><ssc:Real unit="1"/></ssd:Connector>'
    '<ssd:Connector name="thrust" kind="output"><ssc:Real unit="N"/></ssd:Connector>'
)
UNITS = (
    '<ssd:Units><ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>'
    '<ssc:Unit name="1"><ssc:BaseUnit/></ssc:Unit></ssd:Units>'
)


def parameter_set(values: Mapping[str, float]) -> str:
    """An SSV."""
    rows = "".join(
        f'<ssv:Parameter name="{name}"><ssv:Real value="{x!r}"/></ssv:Parameter>' for name, x in values.items()
    )
    uri = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    return f'<ssv:ParameterSet xmlns:ssv="{uri}" version="1.0" name="set"><ssv:Parameters>{rows}</ssv:Parameters></ssv:ParameterSet>'


def structure(
    lines: tuple[str, ...] = LINES,
    names: tuple[str, ...] = ("governor", "pump", "core"),
    more: str = "",
    connectors: str = CONNECTORS,
    version: str = "1.0",
) -> str:
    """A SystemStructure.ssd; ``more`` stands behind the connections."""
    uri = "http://ssp-standard.org/SSP1/SystemStructure"
    elements = "".join(
        f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{name}.fmu"/>'
        for name in names
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><ssd:SystemStructureDescription xmlns:ssd="{uri}Description" '
        f'xmlns:ssc="{uri}Common" xmlns:ssv="{uri}ParameterValues" version="{version}" name="jet"><ssd:System name="jet">'
        f"<ssd:Connectors>{connectors}</ssd:Connectors>{more}<ssd:Elements>{elements}</ssd:Elements>"
        f"<ssd:Connections>{''.join(lines)}</ssd:Connections></ssd:System>{UNITS}</ssd:SystemStructureDescription>"
    )


def pack(path: Path, text: str, fmus: Mapping[str, bytes], **files: str) -> Path:
    """An SSP; ``files``: more of them, by name."""
    with zipfile.ZipFile(path, "w") as ssp:
        ssp.writestr("SystemStructure.ssd", text)
        for name, data in fmus.items():
            ssp.writestr(f"resources/{name}.fmu", data)
        for name, content in files.items():
            ssp.writestr(name, content)
    return path


def by_hand(throttle: list[float], gain: float = 0.5) -> list[float]:
    """The thrust [N] of the system: the same arithmetic, governor first with the speed of the step before."""
    flow = n = 0.0
    thrusts = []
    for demand in throttle:
        valve = min(max(demand + gain * (demand - n), 0.0), 1.0)
        flow = flow + 0.2 * (valve - flow)
        n = n + 0.05 * (flow - n)
        thrusts.append(1000.0 * (0.02 * n))
    return thrusts
