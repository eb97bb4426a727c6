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
    "altitude": 30, "mach": 31, "density": 32, "total_pressure": 33,
    "total_temperature": 34, "gain": 40, "forward": 41, "right": 42, "torque": 43, "runs": 50,
}  # fmt: skip
UNITS = """<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>
<Unit name="m"><BaseUnit m="1"/></Unit><Unit name="kg/m3"><BaseUnit kg="1" m="-3"/></Unit>
<Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit><Unit name="Pa"><BaseUnit kg="1" m="-1" s="-2"/></Unit><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions>"""
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
        place = REFERENCE[what]
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
        at = [REFERENCE[rows[k - 1][1]] for k in outputs]
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


PERCENT = ("N1_cmd", "throttle", "input", 'unit="%" min="0" max="1" start="0"')
PULSE = ("esc_us", "pulse", "input", 'Integer: min="1000" max="2000" start="1000"')
PULSE3 = ("esc_us", "pulse", "input", 'UInt16: min="1000" max="2000" start="1000"')
VALVE = ("fuel.valve", "valve", "input", 'min="0" max="1" start="0"')
POWER = ("power_available", "valve", "input", 'Boolean: start="false"')
IGNITION = ("ignition", "ignition", "input", 'Boolean: start="false"')
MODE = ("mode", "mode", "input", 'Enumeration: declaredType="Mode" start="0"')
SPEED = ("N1", "speed", "output", "")
_ITEMS = '<Item name="off" value="0"/><Item name="crank" value="1"/><Item name="run" value="2"/>'
MODES = {
    2: f'<TypeDefinitions><SimpleType name="Mode"><Enumeration>{_ITEMS}</Enumeration></SimpleType></TypeDefinitions>\n',
    3: f'<TypeDefinitions><EnumerationType name="Mode">{_ITEMS}</EnumerationType></TypeDefinitions>\n',
}
AIR = [("Mn", "mach", "input", 'start="0"'), ("rho", "density", "input", 'unit="kg/m3" start="1"'),
       ("alt", "altitude", "input", 'unit="m" start="0"')]  # fmt: skip
WEAK_MODE = "mode=0.01,damping=0.01,mode_hz="

# name: what it is made of, ports, FMI, lines of mapping, a change in the description
Engine = tuple[str, "list[Row] | None", int, tuple[str, ...], tuple[str, str]]
NO_CHANGE = ("", "")
KINDS: dict[str, Engine] = {
    **{name: (of, None, 2, (), NO_CHANGE) for name, of in {
        "lag-and-delay": "lag=0.2,delay=0.08", "quick": "lag=0.02", "slow": "lag=0.8", "late": "lag=0.2,delay=0.24",
        "two-lags": "lag=0.2,lag2=0.08,delay=0.04", "zero": "lag=0.3,lag2=0.05,zero=0.1",
        "wrong-way-a-little": "lag=0.3,lag2=0.05,zero=-0.05,delay=0.02", "wrong-way": "lag=0.3,lag2=0.03,zero=-0.35",
        "wrong-way-half": "lag=0.3,lag2=0.03,zero=-0.15", "samples-100-hz": "lag=0.2,delay=0.04,sampled=0.01",
        "samples-50-hz": "lag=0.2,delay=0.04,sampled=0.02", "samples-20-hz": "lag=0.33,sampled=0.05",
        "samples-20-hz-late": "lag=0.33,delay=0.08,sampled=0.05", "samples-4-hz": "lag=0.2,delay=0.04,sampled=0.25",
        "mode-9-hz": f"lag=0.2,{WEAK_MODE}9", "mode-9-hz-slow": f"lag=0.4,{WEAK_MODE}9",
        "mode-7-hz": "lag=0.4,mode=0.02,damping=0.01,mode_hz=7", "mode-30-hz": f"lag=0.4,{WEAK_MODE}30",
        "later-down": "lag=0.2,delay=0.04,delay_down=0.12", "later-up": "lag=0.2,delay=0.12,delay_down=0.04",
        "later-when-slow": "lag=0.2,delay=0.2,delay_full=0.04", "limited": "lag=0.2,accelerates=0.25",
        "limited-much": "lag=0.1,accelerates=0.05", "flat-top": "lag=0.1,flat=0.9", "curved": "lag=0.1,exponent=3.5",
        "idles": "lag=0.2,idle=0.1,delay=0.04", "stiff": "lag=0.004", "hunts": "lag=0.1,hunts=0.003",
        "noisy-unsaid": "lag=0.1,noise=0.0025", "overshoots": "lag=0.15,delay=0.048,over=0.1,over_s=4", "overshoots-long": "lag=0.15,delay=0.048,over=0.06,over_s=10",
        "overshoots-by-half": "lag=0.15,delay=0.048,over=0.5,over_s=4", "creeps": "lag=0.15,delay=0.048,over=-0.5,over_s=8",
        "leads": "lag=0.12,lag2=0.05,zero=0.35", "leads-by-far": "lag=0.12,lag2=0.05,zero=2",
        "warms": "lag=0.15,delay=0.048,warm=0.45,warm_s=45", "two-equal-lags": "lag=0.12,lag2=0.12,delay=0.02",
        "six-lags": "lag=0.05,more=5,more_s=0.05", "delay-alone": "lag=0.00001,delay=0.1", "told-of-changes": "lag=0.15,delay=0.048,delta=0.015", "gain-alone": "lag=0.00001",
        "crashes-in-flight": "lag=0.1,crashes=1",
        "hangs-in-flight": "lag=0.1,hangs=1", "floods-in-flight": "lag=0.1,floods=1", "never-lit": "lag=0.1,start=20",
    }.items()},
    "fmi3": ("lag=0.2,delay=0.08", None, 3, (), NO_CHANGE),
    "undeclared-unit": ("lag=0.2,delay=0.04", None, 2, (), ('unit="N"', 'unit="newton"')),
    "display-unit": ("lag=0.2,delay=0.04", None, 2, (), ('unit="N"', 'unit="newton" displayUnit="kp"')),
    "furlong": ("lag=0.2", None, 2, (), ('unit="N"', 'unit="furlong"')),
    "no-variability": ("lag=0.2", [lever(), force(), POWER], 2, (), (' variability="discrete"', "")),
    "pulses": ("lag=0.1,delay=0.04,pulse=1", [PULSE, force()], 2, (), NO_CHANGE),
    "pulses-fmi3": ("lag=0.1,delay=0.04,pulse=1", [PULSE3, force()], 3, (), NO_CHANGE),
    "percent": ("lag=0.1", [PERCENT, force()], 2, ("[ports]", "throttle = 'N1_cmd'"), NO_CHANGE),
    "valve": ("lag=0.1,valve=1", [lever(), force(), VALVE], 2, ("[inputs]", "fuel.valve = 1.0"), NO_CHANGE),
    "power": ("lag=0.1,valve=1", [lever(), force(), POWER], 2, ("[inputs]", "power_available = true"), NO_CHANGE),
    "ignition": ("lag=0.1,start=20", [lever(), force(), IGNITION], 2,
                 ("[inputs]", "ignition = true", "[start]", "warm_up_s = 20.5"), NO_CHANGE),
    "noisy": ("lag=0.1,delay=0.04,noise=0.0025", None, 2, ("[rest]", "thrust = 0.5"), NO_CHANGE),
    "heat": ("lag=0.1,soak=0.02", None, 2, ("[rest]", "thrust = 0.05"), NO_CHANGE),
    "backwards": ("lag=0.1,sign=-1", None, 2, ("[scale]", "thrust = -1.0"), NO_CHANGE),
    "gross": ("lag=0.1,drag=0.5", [lever(), force("Fg", "gross"), force("Fram", "drag")], 2,
              ("[ports]", "thrust = 'Fg'", "ram_drag = 'Fram'"), NO_CHANGE),
    "deck": ("lag=0.1,air=1", [lever(), force(), *AIR], 2,
             ("[ports]", "mach = 'Mn'", "density = 'rho'", "altitude = 'alt'"), NO_CHANGE),
}  # fmt: skip


def mapped(fmu: Path, *lines: str) -> Path:
    """A mapping file beside an FMU, of these lines."""
    path = fmu.with_suffix(".toml")
    path.write_text("\n".join([f'fmu = "{fmu.name}"', *lines, ""]))
    return path
