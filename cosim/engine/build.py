"""Build of an engine's two archives from its folder: ``<name>.fmu`` (FMI 3.0) and ``<name>-fmi2.fmu`` (FMI 2.0).

Everything is generated from ``engine.toml``: the C struct, both model descriptions and the token that ties them
together.  Needs the standard library and FMPy only, because the package's own build loads this file by its path.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import tomllib
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

FMI_VERSIONS = (3, 2)
FMI2_SUFFIX = "-fmi2"

# By its path, as this file itself is loaded by the package's build, which cannot import the package.
UNITS: dict[str, dict[str, float]] = runpy.run_path(str(Path(__file__).with_name("unit_table.py")))["UNITS"]

# The adapter that turns an engine model into a slave; fmi2.c or fmi3.c joins them.
ADAPTER = ("engine.h", "slave.h", "slave.c")
ADAPTER_MADE = ("variables.h", "buildDescription.xml")  # written from engine.toml
GENERATION_TOOL = "hexjet-cosim"

# No fused multiply-add, so that every build computes the same bits.
C_FLAGS = "" if sys.platform == "win32" else "-ffp-contract=off"

# What the co-simulation calls a variable -> what it must be, and the unit it must have.
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
NEEDED_PORTS = {"throttle", "thrust"}
FLAME_OUT = ("thrust_left", "run_down_s", "exponent", "relight_s")
LEDGER = {"pole", "delay"}


class BuildError(ValueError):
    """An engine cannot be built: one line that says which and why."""


@dataclass(frozen=True)
class Variable:
    """One variable of an engine, as ``[variables.<name>]`` states it."""

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
class Engine:
    """An ``engine.toml``.

    ``ports`` maps what the co-simulation calls a variable (a key of ``PORTS``) to its name; ``ledger`` does so
    for the parameters of ``G(z) = gain / (z - pole) z^-delay`` that a delay ledger needs: a nonlinear engine names its
    delay alone.  ``rotor_inertia`` is that of everything that turns, about the jet's axis; 0 where it is not stated.
    """

    name: str
    folder: Path
    title: str
    description: str
    sources: tuple[Path, ...]
    internal_step: float  # s
    ports: Mapping[str, str]
    ledger: Mapping[str, str]
    rotor_inertia: float  # kg m^2
    flame_out: Mapping[str, float]  # FLAME_OUT of an engine without a port run, or "electric"; empty where not stated
    variables: tuple[Variable, ...]
    tool: Path | None = None  # C in place of slave.c, where a program outside the archive computes: no saved states

    @property
    def identifier(self) -> str:
        """The name of the shared library, fit for C."""
        return self.name.replace("-", "_")


def engine_folders(engines: Path) -> list[str]:
    """Return the names of the engines in the folder ``engines``."""
    return sorted(path.parent.name for path in engines.glob("*/engine.toml"))


def archive_path(fmus: Path, name: str, fmi: int) -> Path:
    """Return the path of an engine's archive in the folder ``fmus``."""
    return fmus / f"{name}{FMI2_SUFFIX if fmi == 2 else ''}.fmu"


def read_engine(folder: Path) -> Engine:
    """Read and check ``engine.toml``.  Raises BuildError with one line that names file, key and what is allowed."""
    path = folder / "engine.toml"
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BuildError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise BuildError(f"{path}: not valid TOML: {error}") from error
    try:
        return _engine(folder, data)
    except _WrongError as wrong:
        raise BuildError(f"{path}: {wrong}") from wrong


class _WrongError(Exception):
    """What is wrong with an engine.toml."""


def _engine(folder: Path, data: dict[str, Any]) -> Engine:
    name = folder.name
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or name.endswith(FMI2_SUFFIX):
        raise _WrongError(
            f"the folder's name {name!r} must be lower-case words joined by '-', not ending in {FMI2_SUFFIX}"
        )
    needed = {"title", "description", "sources", "internal_step_s", "ports", "variables"}
    _keys("", data, needed | {"ledger", "rotor", "flame_out"}, needed)
    step = _finite_number("internal_step_s", data["internal_step_s"])
    if not step > 0.0:
        raise _WrongError(f"internal_step_s = {step}: must be above 0")
    variables = tuple(_variable(key, i, table) for i, (key, table) in enumerate(data["variables"].items(), start=1))
    ports, ledger, rotor = data["ports"], data.get("ledger", {}), data.get("rotor", {})
    _keys("ports", ports, set(PORTS), NEEDED_PORTS)
    _keys("ledger", ledger, LEDGER, set())
    _keys("rotor", rotor, {"inertia_kg_m2"}, set())
    for port, variable in ports.items():
        _need_variable(variables, port, variable, *PORTS[port])
    for entry, variable in ledger.items():
        _need_variable(variables, entry, variable, "parameter")
    inertia = _finite_number("rotor.inertia_kg_m2", rotor.get("inertia_kg_m2", 0.0))
    if inertia < 0.0:
        raise _WrongError(f"rotor.inertia_kg_m2 = {inertia}: must not be below 0")
    law = _flame_out(data["flame_out"]) if "flame_out" in data else {}
    if law and "run" in ports:
        raise _WrongError("flame_out: an engine with a port run goes out by its own equations; leave out one of them")
    sources = tuple((folder / source).resolve() for source in data["sources"])
    for source in sources:
        if not source.is_file():
            raise _WrongError(f"sources: there is no file {source}")
    return Engine(
        name, folder, data["title"], data["description"], sources, step, ports, ledger, inertia, law, variables
    )


def _flame_out(table: dict[str, Any]) -> dict[str, float]:
    if "electric" in table:
        _keys("flame_out", table, {"electric"}, set())
        if table["electric"] is not True:
            raise _WrongError(f"flame_out.electric = {table['electric']!r}: allowed: true")
        return {"electric": True}
    _keys("flame_out", table, {*FLAME_OUT, "electric"}, set(FLAME_OUT))
    numbers = {key: _finite_number(f"flame_out.{key}", table[key]) for key in FLAME_OUT}
    for key, value in numbers.items():
        if key == "thrust_left" and not 0.0 <= value <= 1.0:
            raise _WrongError(f"flame_out.{key} = {value}: must be from 0 to 1")
        if key != "thrust_left" and not value > 0.0:
            raise _WrongError(f"flame_out.{key} = {value}: must be above 0")
    return numbers


def _need_variable(
    variables: Iterable[Variable], where: str, name: str, causality: str, unit: str | None = None
) -> None:
    """Refuse a port or ledger entry that names no variable of its kind, or one in another unit."""
    kind = [v for v in variables if v.causality == causality]
    variable = next((v for v in kind if v.name == name), None)
    if variable is None:
        article = "a" if causality == "parameter" else "an"
        allowed = ", ".join(v.name for v in kind) or "none is stated"
        raise _WrongError(f"{where} = {name!r}: must name {article} {causality} (allowed: {allowed})")
    if unit is not None and variable.unit != unit:
        raise _WrongError(f"variables.{name}.unit = {variable.unit!r}: the port {where} is in {unit}")


def _variable(name: str, reference: int, table: dict[str, Any]) -> Variable:
    where = f"variables.{name}"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or name == "time":
        raise _WrongError(f"{where}: a variable's name is a C identifier in lower case and not time")
    _keys(
        where, table, {"causality", "type", "unit", "min", "max", "start", "description"}, {"causality", "description"}
    )
    causality, kind = table["causality"], table.get("type", "real")
    if causality not in ("input", "output", "parameter"):
        raise _WrongError(f"{where}.causality = {causality!r}: allowed: input, output, parameter")
    if kind not in ("real", "integer"):
        raise _WrongError(f"{where}.type = {kind!r}: allowed: real, integer")
    if kind == "integer" and causality != "parameter":
        raise _WrongError(f"{where}: only a parameter may be an integer")
    unit = table.get("unit")
    if unit is not None and unit not in UNITS:
        raise _WrongError(f"{where}.unit = {unit!r}: allowed: {', '.join(UNITS)}")
    low, high, start = (
        _finite_number(f"{where}.{key}", table[key]) if key in table else None for key in ("min", "max", "start")
    )
    if (start is None) != (causality == "output"):
        raise _WrongError(f"{where}: inputs and parameters have a start, outputs have none")
    if kind == "integer" and (low is None or high is None):
        raise _WrongError(f"{where}: an integer needs min and max")
    if low is not None and high is not None and not low < high:
        raise _WrongError(f"{where}: min = {low:g} is not below max = {high:g}")
    if start is not None and not (-inf if low is None else low) <= start <= (inf if high is None else high):
        raise _WrongError(f"{where}.start = {start:g} is outside min and max")
    return Variable(name, reference, causality, kind == "integer", unit, low, high, start, table["description"])


def _keys(where: str, table: Mapping[str, Any], allowed: set[str], needed: set[str]) -> None:
    prefix = f"{where}." if where else ""
    for key in table:
        if key not in allowed:
            raise _WrongError(f"unknown key {prefix}{key}; allowed: {', '.join(sorted(allowed))}")
    for key in sorted(needed - set(table)):
        raise _WrongError(f"{prefix}{key} is missing")


def _finite_number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e300 or value != value:
        raise _WrongError(f"{where} = {value!r}: must be a finite number")
    return float(value)


# --- generated text -----------------------------------------------------------------------------------------------


def _token(engine: Engine, adapter: Path, fmi: int) -> str:
    """Return the FMI token, a hash of all build inputs that shows whether an archive is up to date."""
    return _named_by(f"{engine.name} FMI {fmi}", [engine.folder / "engine.toml", *_inputs(engine, adapter, fmi)])


def _inputs(engine: Engine, adapter: Path, fmi: int) -> list[Path]:
    return [*engine.sources, *([engine.tool] if engine.tool else []), *_adapter_files(adapter, fmi), Path(__file__)]


def _named_by(label: str, paths: Iterable[Path]) -> str:
    digest = hashlib.sha256(label.encode())
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _adapter_files(adapter: Path, fmi: int) -> list[Path]:
    return [adapter / name for name in (*ADAPTER, f"fmi{fmi}.c")]


def _literal(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else repr(value)


def _row(v: Variable) -> list[str]:
    """Return the entries of a variable's row in the C table."""
    kind = [f'"{v.name}"', v.causality.upper(), "INTEGER" if v.integer else "REAL", f"offsetof(Variables, {v.name})"]
    return [*kind, _literal(v.min, "-HUGE_VAL"), _literal(v.max, "HUGE_VAL"), _literal(v.start, "0.0")]


def _variables_header(engine: Engine, token: str) -> str:
    """``variables.h``: what the C code needs to know of ``engine.toml``."""
    fields = [f"    {'int32_t' if v.integer else 'double'} {v.name};" for v in engine.variables]
    limits = [f"#define {v.name.upper()}_MAX {int(v.max)}" for v in engine.variables if v.integer and v.max is not None]
    rows = [f"    {{{', '.join(_row(v))}}}" for v in engine.variables]
    return "\n".join(
        [
            "/* Generated from engine.toml: do not edit. */",
            "#ifndef VARIABLES_H",
            "#define VARIABLES_H",
            "",
            "#include <stdint.h>",
            "",
            f'#define ENGINE_TOKEN "{token}"',
            f"#define ENGINE_STEP {engine.internal_step!r}",
            *limits,
            "",
            "typedef struct {",
            *fields,
            "} Variables;",
            "",
            "/* name, causality, type, place, min, max, start; the first has value reference 1 */",
            "#define ENGINE_TABLE \\",
            ", \\\n".join(rows),
            "",
            "#endif",
            "",
        ]
    )


def _xml(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _number_text(value: float, integer: bool) -> str:
    return str(int(value)) if integer else repr(value)


def _sub(parent: ElementTree.Element, tag: str, **attributes: str | None) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {key: text for key, text in attributes.items() if text is not None})


def _add_units(root: ElementTree.Element, engine: Engine) -> None:
    definitions = _sub(root, "UnitDefinitions")
    for unit in sorted({"s", *(v.unit for v in engine.variables if v.unit)}):
        base = {key: repr(x) if key == "factor" else str(int(x)) for key, x in UNITS[unit].items()}
        _sub(_sub(definitions, "Unit", name=unit), "BaseUnit", **base)


def _add_log_categories_and_experiment(root: ElementTree.Element, engine: Engine) -> None:
    categories = _sub(root, "LogCategories")
    _sub(categories, "Category", name="logStatusError", description="Why a function returned an error")
    _sub(root, "DefaultExperiment", startTime="0", stepSize=repr(engine.internal_step))


def _variable_attributes(v: Variable) -> dict[str, str | None]:
    """Return the attributes of a variable's value that FMI 2.0 and 3.0 have in common."""
    numbers = {"min": v.min, "max": v.max, "start": v.start}
    return {"unit": v.unit} | {key: None if x is None else _number_text(x, v.integer) for key, x in numbers.items()}


def _common(engine: Engine, version: str, **token: str) -> ElementTree.Element:
    return ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": engine.name,
            **token,
            "description": f"{engine.title}: {engine.description}",
            "generationTool": GENERATION_TOOL,
            "variableNamingConvention": "flat",
        },
    )


def _model_description_3(engine: Engine, token: str) -> bytes:
    root = _common(engine, "3.0", instantiationToken=token)
    # FMI 3.0 says with the two step attributes together just what this slave does: the step may vary from call to
    # call, and should be a whole multiple of the internal one.
    _sub(
        root,
        "CoSimulation",
        modelIdentifier=engine.identifier,
        needsExecutionTool="true" if engine.tool else None,
        canGetAndSetFMUState=None if engine.tool else "true",
        canSerializeFMUState=None if engine.tool else "true",
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(engine.internal_step),
    )
    _add_units(root, engine)
    _add_log_categories_and_experiment(root, engine)
    variables = _sub(root, "ModelVariables")
    _sub(
        variables,
        "Float64",
        name="time",
        valueReference="0",
        causality="independent",
        variability="continuous",
        unit="s",
        description="Simulated time",
    )
    for v in engine.variables:
        _sub(
            variables,
            "Int32" if v.integer else "Float64",
            name=v.name,
            valueReference=str(v.reference),
            causality=v.causality,
            variability="fixed" if v.causality == "parameter" else "continuous",
            description=v.description,
            **_variable_attributes(v),
        )
    structure = _sub(root, "ModelStructure")
    outputs = [v for v in engine.variables if v.causality == "output"]
    for v in outputs:
        # between steps the outputs follow from the state alone: no direct feedthrough
        _sub(structure, "Output", valueReference=str(v.reference), dependencies="")
    for v in outputs:
        _sub(structure, "InitialUnknown", valueReference=str(v.reference))
    return _xml(root)


def _model_description_2(engine: Engine, token: str, compiled: Iterable[str]) -> bytes:
    root = _common(engine, "2.0", guid=token)
    # FMI 2.0 cannot state an internal step, so "variable step" would promise more than the slave keeps.
    slave = _sub(
        root,
        "CoSimulation",
        modelIdentifier=engine.identifier,
        needsExecutionTool="true" if engine.tool else None,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate=None if engine.tool else "true",
        canSerializeFMUstate=None if engine.tool else "true",
    )
    files = _sub(slave, "SourceFiles")
    for name in compiled:
        _sub(files, "File", name=name)
    _add_units(root, engine)
    _add_log_categories_and_experiment(root, engine)
    variables = _sub(root, "ModelVariables")
    time = _sub(
        variables,
        "ScalarVariable",
        name="time",
        valueReference="0",
        causality="independent",
        variability="continuous",
        description="Simulated time",
    )
    _sub(time, "Real", unit="s")
    for v in engine.variables:
        scalar = _sub(
            variables,
            "ScalarVariable",
            name=v.name,
            valueReference=str(v.reference),
            causality=v.causality,
            variability="fixed" if v.causality == "parameter" else "continuous",
            description=v.description,
        )
        _sub(scalar, "Integer" if v.integer else "Real", **_variable_attributes(v))
    structure = _sub(root, "ModelStructure")
    outputs = [str(v.reference + 1) for v in engine.variables if v.causality == "output"]  # an index counts from 1
    listed = _sub(structure, "Outputs")
    for index in outputs:
        _sub(listed, "Unknown", index=index, dependencies="")
    unknowns = _sub(structure, "InitialUnknowns")
    for index in outputs:
        _sub(unknowns, "Unknown", index=index)
    return _xml(root)


def _build_description(engine: Engine, compiled: Iterable[str]) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    files = _sub(_sub(root, "BuildConfiguration", modelIdentifier=engine.identifier), "SourceFileSet", language="C99")
    for name in compiled:
        _sub(files, "SourceFile", name=name)
    return _xml(root)


def _contents(engine: Engine, adapter: Path, fmi: int, token: str) -> dict[str, bytes]:
    """Return the archive's files without the binary by path; FMI's headers are left out, as the standard requires."""
    files = {path.name: path.read_bytes() for path in [*engine.sources, *_adapter_files(adapter, fmi)]}
    if engine.tool is not None:
        files["slave.c"] = engine.tool.read_bytes()
    files["variables.h"] = _variables_header(engine, token).encode()
    compiled = sorted(name for name in files if name.endswith(".c"))
    contents = {f"sources/{name}": data for name, data in files.items()}
    if fmi == 3:
        contents["modelDescription.xml"] = _model_description_3(engine, token)
        contents["sources/buildDescription.xml"] = _build_description(engine, compiled)
    else:
        contents["modelDescription.xml"] = _model_description_2(engine, token, compiled)
    return contents


# --- compiling and packing ----------------------------------------------------------------------------------------


def build_all(
    engines: Path, fmus: Path, names: Sequence[str] | None = None, *, adapter: Path | None = None, force: bool = False
) -> list[Path]:
    """Build the archives of the named engines, or of all, and return their paths; those up to date are left alone.

    ``adapter`` is the folder of the FMI adapter, ``engines/fmi`` unless stated.  Nothing is written to standard output.
    Raises BuildError for an unknown engine, a wrong ``engine.toml``, or a compiler that is missing or fails.
    """
    known = engine_folders(engines)
    for name in names or []:
        if name not in known:
            raise BuildError(f"unknown engine {name!r}; allowed: {', '.join(known)}")
    built = []
    fmus.mkdir(parents=True, exist_ok=True)
    for name in known if names is None else names:
        engine = read_engine(engines / name)
        for fmi in FMI_VERSIONS:
            target = archive_path(fmus, name, fmi)
            token = _token(engine, adapter or engines / "fmi", fmi)
            if force or not _up_to_date(target, token):
                _build(engine, adapter or engines / "fmi", fmi, token, target)
            built.append(target)
    return built


def build_one(
    engine: Engine, adapter: Path, fmi: int, target: Path, given: Mapping[str, bytes], within: Path | None = None
) -> None:
    """Build one archive of what has the three functions of ``engine.h``, or a tool of its own, and no ``engine.toml``.

    ``given`` go into its folder of resources; it is built below ``within``.  Raises BuildError if no compiler does it.
    """
    digest = hashlib.sha256(b"".join(f"{name}\0{len(given[name])}\0".encode() + given[name] for name in sorted(given)))
    label = f"{engine.name} {engine.variables} FMI {fmi}" + (f" {digest.hexdigest()}" if given else "")
    token = _named_by(label, _inputs(engine, adapter, fmi))
    _build(engine, adapter, fmi, token, target, given, within)


def _platform_folder(fmi: int) -> str:
    import fmpy  # type: ignore[import-untyped]

    return str(fmpy.platform if fmi == 2 else fmpy.platform_tuple)


def _up_to_date(archive: Path, token: str) -> bool:
    """Return whether the archive was built from the inputs of ``token`` and has a binary for this platform."""
    try:
        with zipfile.ZipFile(archive) as fmu:
            text = fmu.read("modelDescription.xml").decode()
            names = fmu.namelist()
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        return False
    folder = _platform_folder(2 if 'fmiVersion="2.0"' in text else 3)
    return f'"{token}"' in text and any(name.startswith(f"binaries/{folder}/") for name in names)


def _build(
    engine: Engine,
    adapter: Path,
    fmi: int,
    token: str,
    target: Path,
    resources: Mapping[str, bytes] | None = None,
    within: Path | None = None,
) -> None:
    given = {f"resources/{name}": data for name, data in (resources or {}).items()}
    contents = _contents(engine, adapter, fmi, token) | given
    with tempfile.TemporaryDirectory(prefix="engine-", dir=within) as folder:
        for name, data in contents.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        compile_sources(Path(folder), target.name)
        for path in Path(folder, "binaries").rglob("*"):
            if path.is_file() and path.suffix != ".pdb":
                contents[path.relative_to(folder).as_posix()] = path.read_bytes()
    pack(contents, target)


def pack(contents: Mapping[str, bytes], target: Path) -> None:
    """Write an archive whose bytes depend on its contents alone, and put it in place at once."""
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as stream, zipfile.ZipFile(stream, "w") as archive:
            for path in sorted(contents):
                entry = zipfile.ZipInfo(path, date_time=(1980, 1, 1, 0, 0, 0))
                entry.create_system = 3  # Unix, so that the permission bits mean something
                entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, contents[path])
        Path(name).chmod(0o644)
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def compile_sources(folder: Path, label: str) -> None:
    """Compile the sources of an unpacked archive into its ``binaries`` with FMPy's builder.

    Raises BuildError, naming ``label``, if there is no compiler or it refuses the sources.
    """
    from fmpy.build import build_platform_binary  # type: ignore[import-untyped]

    with tempfile.TemporaryFile() as chatter, tempfile.TemporaryDirectory(dir=folder) as build:
        try:
            with _cmake_on_path(), _output_to(chatter.fileno()):
                build_platform_binary(folder, build, cmake_options=_cmake_options())
        except (subprocess.CalledProcessError, OSError) as error:
            chatter.seek(0)
            reason = _reason(chatter.read().decode(errors="replace"), error)
            raise BuildError(f"{label}: {reason}") from error


def _cmake_options() -> dict[str, str]:
    options = {"CMAKE_C_FLAGS:STRING": C_FLAGS}
    compiler = shutil.which((os.environ.get("CC") or "cc").split()[0])
    if compiler and sys.platform != "win32":
        # FMPy's CMake project enables C++ too; nothing is compiled with it, so no such compiler is asked for
        options |= {"CMAKE_CXX_COMPILER:STRING": compiler, "CMAKE_CXX_COMPILER_FORCED:BOOL": "TRUE"}
    if sys.platform != "win32":
        # or only an importer that has the library of mathematics itself, as Python has, could load the FMU
        options["CMAKE_C_STANDARD_LIBRARIES:STRING"] = "-lm"
    return options


def _reason(chatter: str, error: Exception) -> str:
    """Return one line from the output of CMake and the compiler that says why compilation failed."""
    if isinstance(error, FileNotFoundError):
        return "cannot be compiled: cmake is not found (it comes with the Python package cmake)"
    if re.search(r"No CMAKE_C(XX)?_COMPILER could be found|no such file or directory: .*cl\.exe", chatter):
        return "cannot be compiled: no C compiler found (on Debian: apt install build-essential)"
    lines = [line.strip() for line in chatter.splitlines()]
    errors = [line for line in lines if re.search(r"\b(fatal )?error\b", line, re.IGNORECASE)]
    return f"cannot be compiled: {(errors or [str(error)])[0]}"


@contextlib.contextmanager
def _cmake_on_path() -> Iterator[None]:
    """Let FMPy's bare ``cmake`` be the one it depends on, also where the environment is not on PATH."""
    before = os.environ.get("PATH", "")
    try:
        from cmake import CMAKE_BIN_DIR

        os.environ["PATH"] = f"{CMAKE_BIN_DIR}{os.pathsep}{before}"
    except ImportError:
        pass  # the one on PATH, if there is one
    try:
        yield
    finally:
        os.environ["PATH"] = before


@contextlib.contextmanager
def _output_to(descriptor: int) -> Iterator[None]:
    """Send this process's and its children's standard output and error to a file descriptor."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    try:
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        yield
    finally:
        os.dup2(saved[0], 1)
        os.dup2(saved[1], 2)
        for event in saved:
            os.close(event)
