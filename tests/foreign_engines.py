"""Engines as other people's tools write them, made on the spot: one compiled source, what they are made of in the token."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import zipfile
from functools import lru_cache
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

SOURCE = Path(__file__).with_name("foreign_engine.c")
FULL = 20.0  # N
REFERENCE = {
    "throttle": 1, "thrust": 2, "pulse": 3, "ignition": 4, "mode": 5, "speed": 6, "valve": 7, "drag": 8, "gross": 9,
    "throttles": 10, "thrusts": 20, "altitude": 30, "mach": 31, "density": 32, "total_pressure": 33,
    "total_temperature": 34, "gain": 40,
}  # fmt: skip
UNITS = """<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>
<Unit name="m"><BaseUnit m="1"/></Unit><Unit name="kg/m3"><BaseUnit kg="1" m="-3"/></Unit>
<Unit name="Pa"><BaseUnit kg="1" m="-1" s="-2"/></Unit><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions>"""
THROTTLE = '<Real {name} causality="input" min="0" max="1" start="0"/>'

Row = tuple[str, str, str, str]  # name in the FMU, what it is (of REFERENCE), causality, attributes


def lever(name: str = "throttle") -> Row:
    return name, "throttle", "input", 'min="0" max="1" start="0"'


def force(name: str = "thrust", what: str = "thrust") -> Row:
    return name, what, "output", 'unit="N"'


@lru_cache
def library(fmi: int, folder: Path) -> bytes:
    """The compiled source; every function that FMPy asks for and it does not have is a stub that fails."""
    defined = set(re.findall(r"(fmi\d[A-Z]\w+)\(", SOURCE.read_text())) | set(
        re.findall(r"(?:SETTER|GETTER)\((fmi\d\w+)", SOURCE.read_text())
    )
    kind = FMU2Slave if fmi == 2 else FMU3Slave
    needed = {each for each, _ in inspect.getmembers(kind) if each.startswith(f"fmi{fmi}")}
    stubs = folder / f"foreign{fmi}.c"
    stubs.write_text(
        "\n".join([f'#include "{SOURCE}"', *(f"int {each}(void) {{ return 3; }}" for each in sorted(needed - defined))])
    )
    target = folder / f"foreign{fmi}{fmpy.sharedLibraryExtension}"
    compiler = shutil.which("cc") or "gcc"
    command = [compiler, "-shared", "-fPIC", "-O2", "-w", f"-DFMI={fmi}", str(stubs), "-o", str(target), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    return target.read_bytes()


def _kind(attributes: str) -> tuple[str, str]:
    """A type that stands before the attributes, as in ``Integer: min="1000"``; Real where none does."""
    kind, colon, rest = attributes.partition(": ")
    return (kind, rest) if colon and kind.isalnum() else ("Real", attributes)


def description(token: str, rows: list[Row], fmi: int, more: str = "") -> str:
    made = []
    for name, what, causality, attributes in rows:
        kind, rest = _kind(attributes)
        place = REFERENCE[what.partition("[")[0]] + (int(what.partition("[")[2].rstrip("]")) if "[" in what else 0)
        if fmi == 2:
            varies = "" if kind == "Real" else ' variability="discrete"'
            varies = ' variability="fixed"' if causality == "parameter" else varies
            made.append(
                f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}"{varies}>'
                f"<{kind} {rest}/></ScalarVariable>"
            )
            continue
        dimension = re.search(r'size="(\d+)"', rest)
        rest = re.sub(r'size="\d+"', "", rest)
        inside = f'<Dimension start="{dimension[1]}"/>' if dimension else ""
        kind = {"Real": "Float64"}.get(kind, kind)
        varies = ' variability="fixed"' if causality == "parameter" else ""
        made.append(
            f'<{kind} name="{name}" valueReference="{place}" causality="{causality}"{varies} {rest}>{inside}</{kind}>'
        )
    outputs = [k for k, row in enumerate(rows, start=1) if row[2] == "output"]
    if fmi == 2:
        unknown = "".join(f'<Unknown index="{k}"/>' for k in outputs)
        structure = (
            f"<ModelStructure><Outputs>{unknown}</Outputs><InitialUnknowns>{unknown}</InitialUnknowns></ModelStructure>"
        )
        head = f'fmiVersion="2.0" modelName="foreign" guid="{token}"'
    else:
        at = [REFERENCE[rows[k - 1][1].partition("[")[0]] for k in outputs]
        structure = (
            "<ModelStructure>" + "".join(f'<Output valueReference="{k}"/>' for k in at)
            + "".join(f'<InitialUnknown valueReference="{k}"/>' for k in at) + "</ModelStructure>"
        )  # fmt: skip
        head = f'fmiVersion="3.0" modelName="foreign" instantiationToken="{token}"'
        made.insert(0, '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>')
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription {head}>\n'
        '<CoSimulation modelIdentifier="foreign" canHandleVariableCommunicationStepSize="true"/>\n'
        f"{UNITS}\n{more}<ModelVariables>\n"
        + "\n".join(made)
        + f"\n</ModelVariables>\n{structure}\n</fmiModelDescription>\n"
    )


def foreign(
    folder: Path,
    name: str,
    made_of: str,
    rows: list[Row] | None = None,
    fmi: int = 2,
    change: tuple[str, str] = ("", ""),
    types: str = "",
) -> Path:
    """An FMU in ``folder`` whose engine is ``made_of`` this, with these ports; ``change`` in its description."""
    path = folder / f"{name}.fmu"
    if rows is None:
        rows = [lever(), force()]
    text = description(f"foreign:{made_of}", rows, fmi, types)
    assert change[0] in text
    text = text.replace(*change) if change[0] else text
    place = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr(f"binaries/{place}/foreign{fmpy.sharedLibraryExtension}", library(fmi, folder))
    return path


def mapped(fmu: Path, *lines: str) -> Path:
    """A mapping file beside an FMU, of these lines."""
    path = fmu.with_suffix(".toml")
    path.write_text("\n".join([f'fmu = "{fmu.name}"', *lines, ""]))
    return path
