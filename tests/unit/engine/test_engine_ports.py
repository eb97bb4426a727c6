"""Engines of other people: ports under other names and in other units, mapping files, arrays, events, other exporters."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from engine_tools import STEP, archive, rewrite
from places import TOOLS

from cosim.base.errors import EngineError, InputError
from cosim.base.signals import Ambient, EngineOutput
from cosim.engine import EngineBank, EngineSpec, library, load_engine
from cosim.engine.fmu import units
from cosim.engine.fmu.archive import read_archive
from cosim.engine.fmu.instance import FmuInstance
from cosim.engine.fmu.mapping import PortMap
from cosim.engine.fmu.port_kinds import INPUTS, OUTPUTS
from cosim.engine.fmu.ports import find_ports, look_for_ports, split_unit
from cosim.engine.fmu.variables import Variable

pytestmark = pytest.mark.usefixtures("built_engines")

POUND_FORCE = 4.4482216152605  # N, exact: 0.45359237 * 9.80665
LAG = 0.05  # s, of every engine in this file


def load(path: Path, parameters: Mapping[str, float] | None = None, step: float = STEP) -> EngineSpec:
    """In this process: what a trial in another process finds is tested elsewhere."""
    return load_engine(str(path), parameters or {}, step, unchecked=True)


def refusal(path: Path, parameters: Mapping[str, float] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load(path, parameters)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def lag(throttle: Sequence[float], first: float = 0.0, step: float = STEP) -> list[float]:
    """The exact answer of x' = (u - x) / LAG to throttles that are held over a step each."""
    x, course = first, []
    for u in throttle:
        x = u + (x - u) * math.exp(-step / LAG)
        course.append(x)
    return course


@pytest.mark.parametrize(
    ("quantity", "unit", "value", "si"),
    [
        # one value each that everybody knows, from a source other than the table
        (units.FORCE, "lbf", 1.0, 4.4482216152605),
        (units.FORCE, "kN", 0.25, 250.0),
        (units.FORCE, "kgf", 1.0, 9.80665),
        (units.PRESSURE, "psi", 14.695948775513, 101325.0),
        (units.PRESSURE, "inHg", 29.92125, 101325.0),
        (units.PRESSURE, "mmHg", 760.0, 101325.0),
        (units.PRESSURE, "bar", 1.01325, 101325.0),
        (units.PRESSURE, "hPa", 1013.25, 101325.0),
        (units.TEMPERATURE, "degC", 15.0, 288.15),
        (units.TEMPERATURE, "degF", 59.0, 288.15),
        (units.TEMPERATURE, "degF", -40.0, 233.15),
        (units.TEMPERATURE, "degR", 518.67, 288.15),
        (units.SPEED, "kt", 100.0, 51.444444),
        (units.SPEED, "mph", 100.0, 44.704),
        (units.SPEED, "ft/s", 100.0, 30.48),
        (units.SPEED, "km/h", 36.0, 10.0),
        (units.ANGULAR_SPEED, "rpm", 60.0, 2.0 * math.pi),
        (units.ANGULAR_SPEED, "Hz", 1.0, 2.0 * math.pi),
        (units.ANGULAR_SPEED, "deg/s", 180.0, math.pi),
        (units.MASS_FLOW, "kg/h", 3600.0, 1.0),
        (units.MASS_FLOW, "g/min", 600.0, 0.01),
        (units.MASS_FLOW, "pph", 7936.6414, 1.0),
        (units.RATIO, "%", 50.0, 0.5),
    ],
)
def test_units_known_by_name(quantity: units.Quantity, unit: str, value: float, si: float) -> None:
    factor, offset = units.to_si(unit, None, quantity)
    assert factor * value + offset == pytest.approx(si, rel=1e-6)


def test_every_unit_belongs_to_one_quantity() -> None:
    """So that a name rules out every port but its own."""
    for one in units.QUANTITIES:
        for other in units.QUANTITIES:
            shared = set(one.units) & set(other.units)
            assert one is other or not shared, (one.name, other.name)


def test_a_units_case_counts_only_where_it_must() -> None:
    assert units.find_unit("RPM", units.ANGULAR_SPEED) == units.find_unit("rpm", units.ANGULAR_SPEED)
    assert units.find_unit("mN", units.FORCE) == (1e-3, 0.0)
    assert units.find_unit("MN", units.FORCE) == (1e6, 0.0)
    assert units.find_unit("Mn", units.FORCE) is None


def test_a_declared_unit_goes_before_its_name_unless_they_differ() -> None:
    newtons = (1, 1, -2, 0, 0, 0, 0, 0)
    assert units.to_si("tonne-force", units.Unit(newtons, 9806.65), units.FORCE) == (9806.65, 0.0)
    assert units.to_si("lbf", units.Unit(newtons, 4.448), units.FORCE) == (4.448, 0.0)  # rounded by its author
    with pytest.raises(units.UnitError, match="is in N, which the FMU defines as 1000 N and which is 1 N"):
        units.to_si("N", units.Unit(newtons, 1000.0), units.FORCE)
    message = r"is in degC, which the FMU defines as 1 K and which is 1 K above 273.15 K"
    with pytest.raises(units.UnitError, match=message):
        units.to_si("degC", units.Unit((0, 0, 0, 0, 1, 0, 0, 0)), units.TEMPERATURE)
    with pytest.raises(units.UnitError, match="is in kg; it must be a force, such as N"):
        units.to_si("kg", units.Unit((1, 0, 0, 0, 0, 0, 0, 0)), units.FORCE)
    with pytest.raises(units.UnitError, match="is in furlong, which the FMU does not define; known: N, newton, "):
        units.to_si("furlong", None, units.FORCE)


@pytest.mark.parametrize(
    ("name", "base", "factor"),
    [
        ("rpm", units.Unit((0, 0, -1, 0, 0, 0, 0, 1), math.pi / 30.0), math.pi / 30.0),
        ("rpm", units.Unit((0, 0, -1, 0, 0, 0, 0, 0), 1.0 / 60.0), math.pi / 30.0),  # as turns per second
        ("rad/s", units.Unit((0, 0, -1, 0, 0, 0, 0, 0)), 1.0),
        ("Hz", units.Unit((0, 0, -1, 0, 0, 0, 0, 0)), 2.0 * math.pi),
    ],
)
def test_a_turn_without_radians_goes_by_its_name(name: str, base: units.Unit, factor: float) -> None:
    assert units.to_si(name, base, units.ANGULAR_SPEED) == (pytest.approx(factor, rel=1e-15), 0.0)


def test_a_frequency_of_unknown_name_is_no_speed_of_rotation() -> None:
    with pytest.raises(units.UnitError, match="is in 1/s; it must be a speed of rotation, such as rad/s"):
        units.to_si("1/s", units.Unit((0, 0, -1, 0, 0, 0, 0, 0)), units.ANGULAR_SPEED)


@pytest.mark.parametrize(
    ("name", "quantity", "expected"),
    [
        ("thrust_lbf", units.FORCE, ("thrust", "lbf")),
        ("thrust-lbs", units.FORCE, ("thrust", "lbs")),
        ("net_thrust_kN", units.FORCE, ("net_thrust", "kN")),
        ("fuel_flow_kg_per_h", units.MASS_FLOW, ("fuel_flow", "kg/h")),
        ("fuel-flow-rate-pph", units.MASS_FLOW, ("fuel_flow_rate", "pph")),
        ("omega_rad_s", units.ANGULAR_SPEED, ("omega", "rad/s")),
        ("egt_degC", units.TEMPERATURE, ("egt", "degC")),
        ("thrust", units.FORCE, ("thrust", None)),
        ("N", units.FORCE, ("N", None)),  # a unit alone is a name
    ],
)
def test_a_unit_behind_a_name(name: str, quantity: units.Quantity, expected: tuple[str, str | None]) -> None:
    assert split_unit(name, quantity) == expected


def variable(text: str, causality: str, **more: object) -> Variable:
    """A variable from ``name [unit]``."""
    name, _, unit = text.partition(" ")
    fields = {"unit": unit.strip("[]") or None, "min": None, "max": None, "start": None, "description": ""} | more
    return Variable(name=name, type="Real", reference=hash(text) % 2**31, causality=causality, **fields)


def described(inputs: str, outputs: str, parameters: str = "") -> list[Variable]:
    lists = {"input": inputs, "output": outputs, "parameter": parameters}
    return [variable(text.strip(), kind) for kind, texts in lists.items() for text in texts.split(",") if text.strip()]


@pytest.mark.parametrize(
    ("inputs", "outputs", "expected"),
    [
        ("throttle", "thrust", {"throttle": "throttle", "thrust": "thrust"}),
        ("Throttle, u", "thrust, force", {"throttle": "Throttle", "thrust": "thrust"}),  # our own name first
        ("signal", "out1 [N], out2 [K]", {"throttle": "signal", "thrust": "out1"}),  # the only input, the only force
        ("PLA [%], P0 [hPa], T0 [K]", "FN [lbf], N1 [rpm]", {"throttle": "PLA", "thrust": "FN"}),
        (
            "throttle, Ambient-Pressure [hPa], air_speed [kt], mach, run",
            "thrust, Spool_Speed [rpm], fuel-flow [pph], EGT [K]",
            {
                "throttle": "throttle", "ambient_pressure": "Ambient-Pressure", "air_speed": "air_speed",
                "mach": "mach", "run": "run", "thrust": "thrust", "spool_speed": "Spool_Speed",
                "fuel_flow": "fuel-flow",
            },
        ),
    ],
)  # fmt: skip
def test_ports_are_found_by_causality_name_and_unit(inputs: str, outputs: str, expected: Mapping[str, str]) -> None:
    found, _ = find_ports(described(inputs, outputs), PortMap())
    assert {name: port.variable.name for name, port in found.items()} == expected


MAP = "hexjet engine map begins a file that states it: "


@pytest.mark.parametrize(
    ("inputs", "outputs", "words"),
    [
        (
            "a, b",
            "thrust",
            f'has several inputs that may be its throttle (inputs: a, b); {MAP}[ports] throttle = "..."',
        ),
        ("", "thrust", "has no input that may be its throttle (inputs: none); "),
        ("throttle", "a, b", "has no output that may be its thrust (outputs: a, b); "),
        ("throttle", "a [N], b [kN]", "has several outputs that may be its thrust (outputs: a, b); "),
        ("throttle", "thrust [kg/s]", "its thrust is in kg/s, which the FMU does not define; known: N, "),
        (
            "PLA",
            "thrust",
            "its PLA states neither range nor unit; a mapping file does: [range] throttle = [what 0 is, ",
        ),
        ("throttle [deg]", "thrust", "its throttle is in deg and states no range; a mapping file does: "),
    ],
)
def test_what_is_missing_or_ambiguous_is_told_with_the_candidates(inputs: str, outputs: str, words: str) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        find_ports(described(inputs, outputs), PortMap())
    assert str(caught.value).startswith(words)


def test_a_port_that_is_not_needed_is_left_out_with_a_note() -> None:
    found, notes = find_ports(described("throttle", "thrust, spool_speed, N1 [rpm], fuel_flow [K]"), PortMap())
    assert set(found) == {"throttle", "thrust"}
    assert notes == [
        "throttle states no range; it is taken to run from 0 to 1",
        "thrust states no unit; it is taken to be in N",
        'no spool_speed: spool_speed states no unit; a mapping file does: [units] spool_speed = "rad/s"',
        "no fuel_flow: its fuel_flow is in K, which the FMU does not define; known: kg/s, kg.s-1, kg/min, kg/h, kg/hr, "
        "g/s, g/min, g/h, g/hr, lb/s, lbm/s, pps, lb/min, lb/h, lb/hr, lbm/h, lbm/hr, pph; "
        f"{MAP}[units] fuel_flow = ...",
    ]


def test_what_may_be_an_optional_port_by_its_unit_is_asked_for() -> None:
    findings = look_for_ports(described("PLA [%], P0 [Pa]", "thrust [N], EGT [K], T5 [degC], M [N.m]"))
    assert {each.port: each.trouble for each in findings} == {
        "throttle": "", "thrust": "", "ambient_pressure": "may be P0, by the unit",
        "total_pressure": "may be P0, by the unit", "exhaust_temperature": "may be EGT, T5, by the unit",
    }  # fmt: skip


def test_a_unit_that_is_stated_against_the_fmus_own_counts_and_is_told() -> None:
    variables = described("throttle [1]", "thrust [N]")
    for unit, scale, said in (("lbf", 4.4482216152605, 1), ("N", 1.0, 0)):
        found, notes = find_ports(variables, PortMap(units={"thrust": unit}, throttle_range=(0.0, 1.0)))
        assert found["thrust"].scale == pytest.approx(scale)
        assert notes == ["thrust is in N, says the FMU; the mapping file says lbf, and that counts"] * said


def test_a_throttle_that_starts_outside_its_supposed_range_is_refused() -> None:
    inputs = [variable("throttle", "input", start=20.0), variable("thrust", "output")]
    with pytest.raises(ValueError, match=r"its throttle states no range and starts at 20, outside 0 to 1; a mapping"):
        find_ports(inputs, PortMap())


@pytest.mark.parametrize(
    ("unit", "low", "high", "stated", "expected"),
    [
        (None, None, None, None, (0.0, 0.25, 1.0)),
        ("%", None, None, None, (0.0, 25.0, 100.0)),
        ("V", 1.0, 5.0, None, (1.0, 2.0, 5.0)),
        ("1", -1e60, 1e60, None, (0.0, 0.25, 1.0)),  # what some tools write for no bound
        ("deg", 0.0, 130.0, (20.0, 100.0), (20.0, 40.0, 100.0)),
        ("1", 0.0, 1.0, (1.0, 0.0), (1.0, 0.75, 0.0)),  # a lever that works the other way
    ],
)
def test_the_throttles_range(unit: Any, low: Any, high: Any, stated: Any, expected: tuple) -> None:
    ports = [variable("throttle", "input", unit=unit, min=low, max=high), variable("thrust", "output")]
    throttle = find_ports(ports, PortMap(throttle_range=stated))[0]["throttle"]
    assert tuple(throttle.value(u) for u in (0.0, 0.25, 1.0)) == expected
    assert (throttle.value(-1.0), throttle.value(2.0)) == (expected[0], expected[2])  # never beyond the ends
    back = [throttle.scale * value + throttle.offset for value in expected]
    assert back == pytest.approx([0.0, 0.25, 1.0], abs=1e-15)


def test_the_library_goes_by_its_own_statement(tmp_path: Path) -> None:
    """Nothing is looked for that its engine.toml does not name."""
    spec = load_engine("edf", {}, STEP)
    assert set(spec.ports) == {"throttle", "thrust", "start"}
    assert (spec.has_port("thrust"), spec.has_port("run")) == (True, False)
    assert spec.specified_delay is spec.mapping is None
    assert all(port.scale == port.gain == 1.0 and port.offset == port.bias == 0.0 for port in spec.ports.values())


@pytest.fixture(scope="module")
def pythons(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Engines made by PythonFMU (FMI 2.0) and PythonFMU3 (FMI 3.0), a lag of 50 ms each, and no other."""
    folder = tmp_path_factory.mktemp("pythons")
    return {
        "pythonfmu": export(folder, "pythonfmu", "LbfEngine", LBF_ENGINE),
        "pythonfmu3": export(folder, "pythonfmu3", "KnEngine", KN_ENGINE),
    }


def export(folder: Path, exporter: str, name: str, source: str) -> Path:
    """Make an FMU of a Python source with the tool that it is written for."""
    script = folder / f"{name.lower()}.py"
    script.write_text(re.sub(r"class \w+", f"class {name}", source))
    command = [sys.executable, "-m", exporter, "build", "-f", str(script), "-d", str(folder)]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    return folder / f"{name}.fmu"


LBF_ENGINE = """
import math
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class LbfEngine(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.PLA, self.Fn, self.N1, self.x = 20.0, 0.0, 0.0, 0.0
        self.scale = 4.4
        self.register_variable(Real("PLA", causality=Fmi2Causality.input, start=20.0))
        self.register_variable(Real("Fn", causality=Fmi2Causality.output))
        self.register_variable(Real("N1", causality=Fmi2Causality.output))
        self.register_variable(Real("scale", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed, start=4.4))

    def do_step(self, time, step):
        u = (self.PLA - 20.0) / 80.0
        self.x = u + (self.x - u) * math.exp(-step / 0.05)
        self.Fn = self.scale * self.x
        self.N1 = 1e5 * self.x
        return True
"""

KN_ENGINE = """
import math
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64, Unit

class KnEngine(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.register_units([
            Unit(name="kN", kg=1, m=1, s=-2, factor=1000.0),
            Unit(name="%", factor=0.01),
            Unit(name="degC", K=1, offset=273.15),
        ])
        self.time, self.throttle_cmd, self.net_thrust, self.EGT, self.x = 0.0, 0.0, 0.0, 15.0, 0.0
        moving = {"variability": Fmi3Variability.continuous}
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, **moving))
        self.register_variable(Float64("throttle_cmd", causality=Fmi3Causality.input, unit="%", **moving))
        self.register_variable(Float64("net_thrust", causality=Fmi3Causality.output, unit="kN", **moving))
        self.register_variable(Float64("EGT", causality=Fmi3Causality.output, unit="degC", **moving))

    def do_step(self, time, step):
        u = self.throttle_cmd / 100.0
        self.x = u + (self.x - u) * math.exp(-step / 0.05)
        self.net_thrust = 0.02 * self.x
        self.EGT = 15.0 + 600.0 * self.x
        return True
"""

MAPPING = """
fmu = "LbfEngine.fmu"
title = "Somebody's engine"
[ports]
throttle = "PLA"
thrust = "Fn"
spool_speed = "N1"
[units]
thrust = "lbf"
spool_speed = "rpm"
[range]
throttle = [20.0, 100.0]
[parameters]
scale = 5.0
[rotor]
inertia_kg_m2 = 2.0e-5
[ledger]
delay_s = 0.1
"""


def mapping(folder: Path, fmu: Path, text: str) -> Path:
    """A mapping file beside a copy of the archive it speaks of."""
    shutil.copy(fmu, folder / fmu.name)
    path = folder / "engine.toml"
    path.write_text(text)
    return path


def test_an_engine_of_pythonfmu_in_pounds_with_a_mapping_file(pythons: Mapping[str, Path], tmp_path: Path) -> None:
    path = mapping(tmp_path, pythons["pythonfmu"], MAPPING)
    spec = load(path)
    assert (spec.name, spec.family, spec.title) == (tmp_path.name, f"{tmp_path.name}.toml", "Somebody's engine")
    assert (spec.rotor_inertia, spec.transport_delay, spec.specified_delay, spec.mapping) == (2e-5, 0.1, 0.1, path)
    assert spec.path == tmp_path / "LbfEngine.fmu"
    assert spec.parameters == {"scale": 5.0}
    # standing still to 1e-10 of a newton or of itself, times what the lag still has to go in that window
    np.testing.assert_allclose(
        spec.curve.thrust, np.array(spec.curve.throttle) * 5.0 * POUND_FORCE, rtol=0.0, atol=1e-8
    )
    throttles = [0.1, 0.25, 0.5, 0.6, 0.75, 1.0]
    with EngineBank(spec, 6, STEP) as bank:
        assert not bank.wants_ambient
        rest = bank.reset(0.0)
        outputs = [bank.step(k, tuple(throttles)) for k in range(50)]
    assert rest.thrust == (0.0,) * 6
    for i, u in enumerate(throttles):
        x = np.array(lag([u] * 50))
        # what is left of rounding: the throttle through 20..100 and back
        np.testing.assert_allclose([o.thrust[i] for o in outputs], 5.0 * POUND_FORCE * x, rtol=1e-12)
        np.testing.assert_allclose([o.spool_speed[i] for o in outputs], 1e5 * math.pi / 30.0 * x, rtol=1e-12)


def test_a_parameter_given_goes_first_and_a_port_may_be_left_unconnected(pythons: Mapping, tmp_path: Path) -> None:
    path = mapping(tmp_path, pythons["pythonfmu"], MAPPING.replace('spool_speed = "N1"', 'spool_speed = ""'))
    spec = load(path, {"scale": 1.0})
    assert spec.thrust_at(1.0) == pytest.approx(POUND_FORCE, rel=1e-9)
    assert not spec.has_port("spool_speed")
    path = mapping(tmp_path, pythons["pythonfmu"], MAPPING.replace("scale = 5.0", "scael = 5.0"))
    with pytest.raises(InputError, match=r"scael: no such parameter; did you mean 'scale'\? allowed: scale"):
        load(path)


def test_an_engine_with_one_input_and_one_force_needs_no_mapping_file(pythons: Mapping[str, Path]) -> None:
    spec = load(pythons["pythonfmu3"])
    names = {name: port.variable.name for name, port in spec.ports.items()}
    assert names == {"throttle": "throttle_cmd", "thrust": "net_thrust"}
    assert (spec.fmi, spec.family, spec.rotor_inertia) == ("3.0", "KnEngine.fmu", 0.0)
    with EngineBank(spec, 6, STEP) as bank:
        bank.reset(0.5)
        output = bank.step(0, (0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
    x = [lag([u], first=0.5)[0] for u in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)]
    # run up to 0.5, where it stands still to 1e-10 N over a window
    np.testing.assert_allclose(output.thrust, 20.0 * np.array(x), rtol=0.0, atol=1e-8)


def test_engines_of_three_exporters_and_two_versions_in_one_bank(pythons: Mapping[str, Path], tmp_path: Path) -> None:
    mine = load(mapping(tmp_path, pythons["pythonfmu"], MAPPING))
    specs = [mine, load(pythons["pythonfmu3"]), load_engine("turbojet-fmi2", {}, STEP)] * 2
    throttles = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
    with EngineBank(specs, 6, STEP) as bank:
        output = bank.reset(throttles)
        expected = [spec.thrust_at(u) for spec, u in zip(specs, throttles, strict=True)]
        np.testing.assert_allclose(output.thrust, expected, rtol=0.0, atol=1e-8)
        assert [math.isnan(x) for x in output.spool_speed] == [False, True, True] * 2
        runs = [[bank.step(k, throttles) for k in range(100)]]
        bank.reset(throttles)
        runs.append([bank.step(k, throttles) for k in range(100)])
    # a NaN is not equal to itself, and repr is exact for every other
    assert repr(runs[0]) == repr(runs[1])


@pytest.mark.parametrize("exporter", ["pythonfmu", "pythonfmu3"])
def test_fmus_in_python_do_not_lend_each_other_their_modules(exporter: str, tmp_path: Path) -> None:
    """Two engines whose module has the same name, as whoever changes an engine and exports it again has them."""
    source, old = (LBF_ENGINE, "self.scale * self.x") if exporter == "pythonfmu" else (KN_ENGINE, "0.02 * self.x")
    archives = []
    for gain in (0.01, 0.03):
        folder = tmp_path / f"{gain}"
        folder.mkdir()
        text = source.replace(old, f"{gain} * self.x").replace("PLA", "throttle").replace("Fn", "thrust")
        archives.append(export(folder, exporter, "Engine", text.replace("20.0", "0.0")))
    path, modules = list(sys.path), set(sys.modules)
    specs = [load(each) for each in archives]
    assert specs[1].thrust_at(1.0) / specs[0].thrust_at(1.0) == pytest.approx(3.0, rel=1e-6)
    with EngineBank(specs * 2, 4, STEP) as bank:
        thrust = bank.reset(1.0).thrust
    assert (thrust[1] / thrust[0], thrust[3] / thrust[2]) == pytest.approx((3.0, 3.0), rel=1e-6)
    assert (sys.path, {name for name in set(sys.modules) - modules if "ngine" in name}) == (path, set())


# what stands there, what instead of it, and what is said
WRONG_MAPPINGS = [
    (MAPPING, 'title = "x"', "is not the mapping file of an engine, which has the key fmu"),
    ("throttle =", "throtle =", "unknown key 'ports.throtle'; did you mean 'throttle'? allowed: "),
    ('"lbf"', '"furlong"', "units.thrust = 'furlong': allowed: N, newton, "),
    ('"rpm"', '"K"', "units.spool_speed = 'K': allowed: rad/s, "),
    ('"Fn"', '"Thrust"', "{fmu}: has no output called Thrust for thrust (outputs: Fn, N1)"),
    ('"PLA"', '"Fn"', "{fmu}: has no input called Fn for throttle (inputs: PLA)"),
    ('"Fn"', '""', "{fmu}: its thrust cannot be left unconnected"),
    ('"N1"', '"Fn"', "{fmu}: its Fn is both thrust and spool_speed; state one of them in [ports]"),
    ('spool_speed = "rpm"', "", '{fmu}: N1 states no unit; a mapping file does: [units] spool_speed = "rad/s"'),
    ("[range]", 'fuel_flow = "kg/h"\n[range]', f"{{fmu}}: has no output called fuel_flow; {MAP}[ports] fuel_flow = "),
    (
        "[range]\nthrottle = [20.0, 100.0]",
        "",
        "{fmu}: its PLA states neither range nor unit; a mapping file does: [range] throttle = ",
    ),
    ("20.0, 100.0", "5.0, 5.0", "range.throttle = [5.0, 5.0]: what 0 and 1 are must differ"),
    ("2.0e-5", "-1.0", "rotor.inertia_kg_m2"),
    (MAPPING, 'fmu = "nowhere.fmu"', "{folder}/nowhere.fmu: no such file"),
]


@pytest.mark.parametrize(("old", "new", "words"), WRONG_MAPPINGS)
def test_a_wrong_mapping_file_gets_one_line(old: str, new: str, words: str, pythons: Mapping, tmp_path: Path) -> None:
    assert old in MAPPING
    path = mapping(tmp_path, pythons["pythonfmu"], MAPPING.replace(old, new, 1))
    assert refusal(path).startswith(words.format(fmu=tmp_path / "LbfEngine.fmu", folder=tmp_path))


NOTHING, EARLY, STUCK, TERMINATE, TINY, DISCARDS = range(6)

ODD_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="odd" instantiationToken="{odd}">
  <CoSimulation modelIdentifier="odd" canHandleVariableCommunicationStepSize="true" mightReturnEarlyFromDoStep="true"/>
  <UnitDefinitions>
    <Unit name="lbf"><BaseUnit kg="1" m="1" s="-2" factor="4.4482216152605"/></Unit>
    <Unit name="rpm"><BaseUnit s="-1" rad="1" factor="0.10471975511965977"/></Unit>
    <Unit name="hPa"><BaseUnit kg="1" m="-1" s="-2" factor="100"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="3"/>
    <Float64 name="levers" valueReference="2" causality="input" start="10 35" min="10" max="110"><Dimension start="2"/></Float64>
    <Float64 name="forces" valueReference="3" causality="output" unit="lbf"><Dimension valueReference="1"/></Float64>
    <Float32 name="speed" valueReference="4" causality="output" unit="rpm"/>
    <Float32 name="pressure" valueReference="5" causality="input" start="1013.25" unit="hPa"/>
    <Float64 name="gains" valueReference="6" causality="parameter" variability="fixed" start="1 2 3"><Dimension start="3"/></Float64>
    <Int32 name="trouble" valueReference="7" causality="parameter" variability="fixed" start="0"/>
    <Float64 name="egt" valueReference="8" causality="output" unit="degC"/>
    <Float64 name="sets" valueReference="9" causality="output"/>
    <Boolean name="run" valueReference="10" causality="input" start="true"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3"/><Output valueReference="4"/><Output valueReference="8"/><Output valueReference="9"/>
    <InitialUnknown valueReference="3"/><InitialUnknown valueReference="4"/>
    <InitialUnknown valueReference="8"/><InitialUnknown valueReference="9"/>
  </ModelStructure>
</fmiModelDescription>
"""

ODD_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="odd">
    <SourceFileSet language="C99"><SourceFile name="odd_engine.c"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""

ODD_MAPPING = """
fmu = "odd.fmu"
[ports]
throttle = "levers[1]"
thrust = "forces[2]"
fuel_flow = "sets" # how often the pressure was set
ambient_pressure = "pressure"
spool_speed = "speed"
exhaust_temperature = "egt"
[units]
fuel_flow = "kg/s"
"""


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mapping file beside the engine of odd_engine.c."""
    folder = tmp_path_factory.mktemp("odd")
    source = TOOLS / "odd_engine.c"
    contents = {"modelDescription.xml": ODD_DESCRIPTION.encode(), "sources/odd_engine.c": source.read_bytes()}
    contents["sources/buildDescription.xml"] = ODD_BUILD.encode()
    for name, data in contents.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    library.compile_sources(folder, "odd")
    for path in (folder / "binaries").rglob("*.*"):
        contents[path.relative_to(folder).as_posix()] = path.read_bytes()
    library.write_archive(contents, folder / "odd.fmu")
    (folder / "odd.toml").write_text(ODD_MAPPING)
    return folder / "odd.toml"


def fly_odd(path: Path, trouble: int, steps: int = 100) -> list[EngineOutput]:
    with EngineBank(load(path, {"trouble": trouble}), 2, STEP) as bank:
        bank.reset(0.25)
        return [bank.step(k, (0.5, 1.0)) for k in range(steps)]


def test_an_element_of_an_array_as_port(odd: Path) -> None:
    spec = load(odd)
    stated = tomllib.loads(ODD_MAPPING)["ports"] | {"run": "run"}
    assert {name: port.variable.name for name, port in spec.ports.items()} == stated
    assert spec.thrust_at(1.0) == pytest.approx(2.0 * POUND_FORCE, rel=1e-8)
    outputs = fly_odd(odd, NOTHING)
    for i, u in enumerate((0.5, 1.0)):
        x = np.array(lag([u] * 100, first=0.25))
        # run up to 0.25, where it stands still to 1e-10 N over a window; the speed travels as Float32
        np.testing.assert_allclose([o.thrust[i] for o in outputs], 2.0 * POUND_FORCE * x, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose([o.spool_speed[i] for o in outputs], 2000.0 * math.pi * x, rtol=1e-6)


def test_the_other_elements_of_an_input_stay_at_their_start(odd: Path) -> None:
    """The first of the forces is the second of the levers."""
    echo = odd.with_name("echo.toml")
    text = ODD_MAPPING.replace('spool_speed = "speed"', 'spool_speed = "forces[1]"')
    echo.write_text(text.replace("[units]", '[units]\nspool_speed = "rad/s"'))
    with EngineBank(load(echo), 1, STEP) as bank:
        bank.reset(0.5)
        assert [bank.step(k, (0.7,)).spool_speed[0] for k in range(3)] == [35.0] * 3


def test_an_element_of_a_parameter(odd: Path) -> None:
    spec = load(odd, {"gains[2]": 7.0})
    assert spec.parameters == {"gains[1]": 1.0, "gains[2]": 7.0, "gains[3]": 3.0, "trouble": 0.0}
    assert spec.thrust_at(1.0) == pytest.approx(7.0 * POUND_FORCE, rel=1e-8)


@pytest.mark.parametrize("element", ["forces", "forces[0]", "forces[4]", "forces[2,1]"])
def test_an_element_that_is_not_there(odd: Path, element: str) -> None:
    path = odd.with_name("wrong.toml")
    path.write_text(ODD_MAPPING.replace("forces[2]", element))
    there = "(outputs: forces[1], forces[2], forces[3], speed, "
    assert f"has no output called {element} for thrust {there}" in refusal(path)


def test_the_ambient_is_set_when_it_changes_and_only_then(odd: Path) -> None:
    spec = load(odd)
    air = Ambient(90000.0, 280.0, (0.0, 0.0))
    with EngineBank(spec, 2, STEP) as bank:
        assert bank.wants_ambient
        assert bank.reset(0.5).fuel_flow == (1.0, 1.0)  # once, before the start
        thrust = [2.0 * POUND_FORCE * 0.5 * pressure / 101325.0 for pressure in (101325.0, 90000.0, 80000.0)]
        courses = [None, None, air, air, air, None, air._replace(pressure=80000.0), air, air]
        outputs = [bank.step(k, (0.5, 0.5), given) for k, given in enumerate(courses)]
        assert [o.fuel_flow[0] for o in outputs] == [1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 4.0, 4.0]
        expected = [thrust[i] for i in (0, 0, 1, 1, 1, 1, 2, 1, 1)]
        # the pressure travels as Float32, and the engine was run up
        np.testing.assert_allclose([o.thrust[0] for o in outputs], expected, rtol=1e-6)
        assert bank.reset(0.5, air).thrust == pytest.approx([thrust[1]] * 2, rel=1e-6)
        for wrong in [(1.0, 2.0), Ambient(1.0, 2.0, (0.0,)), Ambient(1.0, 2.0, (0.0, 0.0, 0.0))]:
            with pytest.raises(TypeError, match="pressure, temperature and 2 air speeds"):
                bank.step(0, (0.5, 0.5), wrong)
        message = r"^engine 1 \(odd\.fmu\): ambient_pressure is not finite at step 0 \(0 s\)$"
        with pytest.raises(EngineError, match=message):
            bank.step(0, (0.5, 0.5), air._replace(pressure=math.nan))


def test_a_throttle_beyond_its_ends_stays_there(odd: Path) -> None:
    """This engine has no limit of its own."""
    with EngineBank(load(odd), 2, STEP) as bank:
        bank.reset(0.5)
        outputs = [bank.step(k, (1.5, 1.0) if k % 2 else (-0.5, 0.0)).thrust for k in range(6)]
    assert all(one == other for one, other in outputs)


def test_an_engine_is_shut_off_and_on_again(odd: Path) -> None:
    with EngineBank(load(odd), 2, STEP) as bank:
        bank.reset(0.5)
        assert bank.set_run(1, False)
        off = bank.step(0, (0.5, 0.5)).thrust
        assert bank.set_run(1, True)
        on = bank.step(1, (0.5, 0.5)).thrust
    assert off == (pytest.approx(POUND_FORCE), 0.0)
    assert on == pytest.approx((POUND_FORCE, POUND_FORCE))
    with EngineBank(load_engine("edf", {}, STEP), 1, STEP) as bank:
        bank.reset(0.5)
        assert not bank.set_run(0, False)


def test_a_step_in_parts_is_the_same_step(odd: Path) -> None:
    """The FMU refuses to step from anywhere but where it returned."""
    whole, parts = fly_odd(odd, NOTHING), fly_odd(odd, EARLY)
    np.testing.assert_allclose([o.thrust for o in parts], [o.thrust for o in whole], rtol=0.0, atol=1e-8)
    assert repr(fly_odd(odd, EARLY)) == repr(parts)


IN_TROUBLE = {
    STUCK: "it returned early from doStep and gets no further",
    TINY: "it does not reach the end of the step",
    TERMINATE: "it asked to end the simulation",
    DISCARDS: "doStep returned discard",
}


@pytest.mark.parametrize("trouble", IN_TROUBLE)
def test_an_fmu_that_gets_no_further_is_told_so(odd: Path, trouble: int) -> None:
    with pytest.raises(InputError) as caught:
        load(odd, {"trouble": trouble})
    fmu = odd.with_name("odd.fmu")
    assert str(caught.value) == f"{fmu}: {IN_TROUBLE[trouble]} while its thrust was measured"


def test_an_fmu_with_an_input_clock_is_refused(odd: Path) -> None:
    """Nothing ticks it, so what depends on it would stand still."""
    clock = '<Clock name="ecu.tick" valueReference="44" causality="input" intervalVariability="constant"/>'

    def change(contents: dict[str, bytes]) -> None:
        text = contents["modelDescription.xml"].decode()
        contents["modelDescription.xml"] = text.replace("</ModelVariables>", f"{clock}</ModelVariables>").encode()

    path = rewrite(odd.with_name("odd.fmu"), odd.with_name("ticks.fmu"), change)
    ports = PortMap({"throttle": "levers[1]", "thrust": "forces[2]"})
    message = r"has the input clock ecu\.tick: input clocks of FMI 3\.0 left in version 0\.3\.0"
    with pytest.raises(InputError, match=message):
        read_archive(path, ports)


def test_variables_of_two_types_may_share_a_reference() -> None:
    """FMI 2.0 counts its references anew for every type."""
    calls: list[tuple[object, ...]] = []
    slave = SimpleNamespace(
        make_values=lambda kind, values: (kind, values),
        bind_values=lambda verb, kind, references, values: lambda: calls.append((verb + kind, references, values[1])),
    )
    real, whole = variable("gain", "parameter"), replace(variable("samples", "parameter"), type="Integer")
    settings = [(replace(real, reference=1), 2.0), (replace(whole, reference=1), 3.0)]
    instance: Any = FmuInstance.__new__(FmuInstance)
    instance.fmu, instance.archive = slave, SimpleNamespace(fmi=2)
    instance.write(settings)
    assert calls == [("SetReal", [1], [2.0]), ("SetInteger", [1], [3])]


def test_the_order_of_the_ports_is_that_of_the_c_loop() -> None:
    source = (Path(library.__file__).parents[1] / "_bank.c").read_text()
    for names, title in ((INPUTS, "INPUT_NAMES[INPUTS]"), (OUTPUTS, "OUTPUT_NAMES[OUTPUTS]")):
        listed = ", ".join(f'"{name}"' for name in names)
        assert f"{title} = {{{listed}}};" in source


def test_the_library_engine_by_path_is_the_library_engine() -> None:
    by_path = load(archive("turbojet", 3))
    assert set(by_path.ports) == {"throttle", "thrust", "start"}
    assert by_path.start == "throttle_start"


def test_engines_whose_file_is_called_engine_have_the_names_of_their_folders(tmp_path: Path) -> None:
    for name in ("my-engine", "other"):
        (tmp_path / name).mkdir()
        shutil.copy(archive("edf", 3), tmp_path / name / "engine.fmu")
        (tmp_path / name / "engine.toml").write_text('fmu = "engine.fmu"\n')
    mine, other, bare = (
        load(tmp_path / each) for each in ("my-engine/engine.toml", "other/engine.toml", "other/engine.fmu")
    )
    assert [(each.name, each.family) for each in (mine, other, bare)] == [
        ("my-engine", "my-engine.toml"), ("other", "other.toml"), ("other", "other.fmu"),
    ]  # fmt: skip
    # models that version 0.2.0 filed under the bare name are found, behind those of the name of today
    unknown, known = ({"roll": SimpleNamespace(engine_sha256=sha256)} for sha256 in ("", mine.fingerprint))
    assert mine.models_in({"engine.toml": unknown}) == unknown
    assert mine.models_in({"engine.toml": known, "my-engine.toml": unknown}) == unknown
    assert load_engine("edf", {}, STEP).models_in({"edf.fmu": unknown}) == {}
    # a copy of the file in a campaign's folder has another name and is the same engine
    assert mine.models_in({"other.toml": unknown, "elsewhere.toml": known}) == known
