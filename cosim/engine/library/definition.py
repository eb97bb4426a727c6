"""Definition of an engine of the library: its ``engine.toml``, read and checked."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

from .unit_table import UNITS

FMI2_SUFFIX = "-fmi2"  # suffix of an engine's FMI 2.0 version

# Causality and unit of each variable that the co-simulation uses.
PORTS = {
    "throttle": ("input", "1"),
    "run": ("input", "1"),
    "ambient_pressure": ("input", "Pa"),
    "ambient_temperature": ("input", "K"),
    "air_speed": ("input", "m/s"),
    "thrust": ("output", "N"),
    "spool_speed": ("output", "rpm"),
    "exhaust_temperature": ("output", "K"),
    "fuel_flow": ("output", "kg/s"),
    "start": ("parameter", "1"),
}
REQUIRED_PORTS = {"throttle", "thrust"}  # ports that every engine must have
FLAME_OUT_KEYS = ("thrust_left", "run_down_s", "exponent", "relight_s")  # keys of the table [flame_out]
# Keys of [ledger], which names the engine's parameters for pole and delay that the delay ledger reads.
LEDGER_KEYS = {"pole", "delay"}


class BuildError(ValueError):
    """Error of an engine that cannot be built: one line with engine and reason."""


@dataclass(frozen=True)
class VariableDefinition:
    """Variable of an engine, from ``[variables.<name>]`` of ``engine.toml``."""

    name: str
    reference: int
    causality: str  # input, output, parameter
    integer: bool
    unit: str | None
    min: float | None
    max: float | None
    start: float | None  # None for outputs
    description: str


@dataclass(frozen=True)
class EngineDefinition:
    """Definition of an engine in ``engine.toml``.

    ``ports`` maps what the co-simulation calls a variable (a key of ``PORTS``) to its name; ``ledger`` does so
    for the parameters of ``G(z) = gain / (z - pole) z^-delay`` that a delay ledger needs: a nonlinear engine names its
    delay alone.  ``rotor_inertia`` is that of everything that turns, about the jet's axis; 0 where it is not stated.
    """

    name: str
    folder: Path
    title: str
    description: str
    sources: tuple[Path, ...]
    internal_step: float  # s, of the solver
    ports: Mapping[str, str]
    ledger: Mapping[str, str]
    rotor_inertia: float  # of all that turns, kg m^2
    flame_out: Mapping[str, float]  # law of an engine without port "run"
    variables: tuple[VariableDefinition, ...]
    uncertainty: Mapping[str, Any] = field(default_factory=dict)  # table on parameters; empty: none
    tool: Path | None = None  # program that generates the C, if any

    @property
    def identifier(self) -> str:
        """Name of the shared library, a C identifier."""
        return self.name.replace("-", "_")


def read_engine(folder: Path) -> EngineDefinition:
    """Return the checked definition in ``engine.toml``.  Raises BuildError with file, key and allowed values."""
    path = folder / "engine.toml"
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BuildError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise BuildError(f"{path}: not valid TOML: {error}") from error
    try:
        return _parse_engine(folder, data)
    except BuildError as error:
        raise BuildError(f"{path}: {error}") from error


def _parse_engine(folder: Path, data: dict[str, Any]) -> EngineDefinition:
    name = folder.name
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or name.endswith(FMI2_SUFFIX):
        raise BuildError(
            f"the folder's name {name!r} must be lower-case words joined by '-', not ending in {FMI2_SUFFIX}"
        )
    required = {"title", "description", "sources", "internal_step_s", "ports", "variables"}
    _check_keys("", data, required | {"ledger", "rotor", "flame_out", "uncertainty"}, required)
    step = _require_finite("internal_step_s", data["internal_step_s"])
    if not step > 0.0:
        raise BuildError(f"internal_step_s = {step}: must be above 0")
    variables = tuple(
        _parse_variable(key, i, table) for i, (key, table) in enumerate(data["variables"].items(), start=1)
    )
    ports, ledger, rotor = data["ports"], data.get("ledger", {}), data.get("rotor", {})
    _check_keys("ports", ports, set(PORTS), REQUIRED_PORTS)
    _check_keys("ledger", ledger, LEDGER_KEYS, set())
    _check_keys("rotor", rotor, {"inertia_kg_m2"}, set())
    for port, variable in ports.items():
        _check_variable(variables, port, variable, *PORTS[port])
    for entry, variable in ledger.items():
        _check_variable(variables, entry, variable, "parameter")
    inertia = _require_finite("rotor.inertia_kg_m2", rotor.get("inertia_kg_m2", 0.0))
    if inertia < 0.0:
        raise BuildError(f"rotor.inertia_kg_m2 = {inertia}: must not be below 0")
    flame_out = _parse_flame_out(data["flame_out"]) if "flame_out" in data else {}
    if flame_out and "run" in ports:
        raise BuildError("flame_out: an engine with a port run goes out by its own equations; leave out one of them")
    sources = tuple((folder / source).resolve() for source in data["sources"])
    for source in sources:
        if not source.is_file():
            raise BuildError(f"sources: there is no file {source}")
    uncertainty = data.get("uncertainty", {})
    for parameter in uncertainty.get("parameters", ()):
        _check_variable(variables, "uncertainty.parameters", parameter, "parameter")
    return EngineDefinition(
        name, folder, data["title"], data["description"], sources, step, ports, ledger, inertia, flame_out, variables,
        uncertainty=uncertainty,
    )  # fmt: skip


def _parse_flame_out(table: dict[str, Any]) -> dict[str, float]:
    if "electric" in table:
        _check_keys("flame_out", table, {"electric"}, set())
        if table["electric"] is not True:
            raise BuildError(f"flame_out.electric = {table['electric']!r}: allowed: true")
        return {"electric": True}
    _check_keys("flame_out", table, {*FLAME_OUT_KEYS, "electric"}, set(FLAME_OUT_KEYS))
    numbers = {key: _require_finite(f"flame_out.{key}", table[key]) for key in FLAME_OUT_KEYS}
    for key, value in numbers.items():
        if key == "thrust_left" and not 0.0 <= value <= 1.0:
            raise BuildError(f"flame_out.{key} = {value}: must be from 0 to 1")
        if key != "thrust_left" and not value > 0.0:
            raise BuildError(f"flame_out.{key} = {value}: must be above 0")
    return numbers


def _check_variable(
    variables: Iterable[VariableDefinition], where: str, name: str, causality: str, unit: str | None = None
) -> None:
    """Raise BuildError for a port or ledger entry without a variable of its causality and unit."""
    kind = [v for v in variables if v.causality == causality]
    variable = next((v for v in kind if v.name == name), None)
    if variable is None:
        article = "a" if causality == "parameter" else "an"
        allowed = ", ".join(v.name for v in kind) or "none is stated"
        raise BuildError(f"{where} = {name!r}: must name {article} {causality} (allowed: {allowed})")
    if unit is not None and variable.unit != unit:
        raise BuildError(f"variables.{name}.unit = {variable.unit!r}: the port {where} is in {unit}")


def _parse_variable(name: str, reference: int, table: dict[str, Any]) -> VariableDefinition:
    where = f"variables.{name}"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or name == "time":
        raise BuildError(f"{where}: a variable's name is a C identifier in lower case and not time")
    _check_keys(
        where, table, {"causality", "type", "unit", "min", "max", "start", "description"}, {"causality", "description"}
    )
    causality, kind = table["causality"], table.get("type", "real")
    if causality not in ("input", "output", "parameter"):
        raise BuildError(f"{where}.causality = {causality!r}: allowed: input, output, parameter")
    if kind not in ("real", "integer"):
        raise BuildError(f"{where}.type = {kind!r}: allowed: real, integer")
    if kind == "integer" and causality != "parameter":
        raise BuildError(f"{where}: only a parameter may be an integer")
    unit = table.get("unit")
    if unit is not None and unit not in UNITS:
        raise BuildError(f"{where}.unit = {unit!r}: allowed: {', '.join(UNITS)}")
    low, high, start = (
        _require_finite(f"{where}.{key}", table[key]) if key in table else None for key in ("min", "max", "start")
    )
    if (start is None) != (causality == "output"):
        raise BuildError(f"{where}: inputs and parameters have a start, outputs have none")
    if kind == "integer" and (low is None or high is None):
        raise BuildError(f"{where}: an integer needs min and max")
    if low is not None and high is not None and not low < high:
        raise BuildError(f"{where}: min = {low:g} is not below max = {high:g}")
    if start is not None and not (-inf if low is None else low) <= start <= (inf if high is None else high):
        raise BuildError(f"{where}.start = {start:g} is outside min and max")
    return VariableDefinition(
        name, reference, causality, kind == "integer", unit, low, high, start, table["description"]
    )


def _check_keys(where: str, table: Mapping[str, Any], allowed: set[str], required: set[str]) -> None:
    prefix = f"{where}." if where else ""
    for key in table:
        if key not in allowed:
            raise BuildError(f"unknown key {prefix}{key}; allowed: {', '.join(sorted(allowed))}")
    for key in sorted(required - set(table)):
        raise BuildError(f"{prefix}{key} is missing")


def _require_finite(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300 or value != value:
        raise BuildError(f"{where} = {value!r}: must be a finite number")
    return float(value)
