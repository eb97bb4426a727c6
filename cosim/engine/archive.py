"""An ``.fmu`` archive as the co-simulation sees it: what it is, what it offers, and why it cannot be used."""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

from cosim.errors import InputError

INTEGERS = {"Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"}
REALS = {"Real", "Float64", "Float32"}
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError)  # from zipfile, on bad archives
INTERFACES = {"ModelExchange": "model exchange", "ScheduledExecution": "scheduled execution"}


@dataclass(frozen=True)
class Variable:
    """One scalar variable of an FMU; ``start`` is None where the description states none."""

    name: str
    type: str  # FMI's name of the type
    reference: int
    unit: str | None
    min: float | None
    max: float | None
    start: float | None
    description: str


@dataclass(frozen=True)
class Archive:
    """An archive that was read, validated and found usable as an engine on this machine."""

    path: Path
    sha256: str
    fmi: int  # 2 or 3
    version: str  # of FMI, as the description says
    model: str
    identifier: str
    token: str
    throttle: Variable
    thrust: Variable
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    internal_step: float | None  # s, where the description states it
    preferred_step: float | None  # s
    once_per_process: bool
    saves_state: bool
    serializes_state: bool

    def parameter(self, name: str) -> Variable:
        """The parameter of that name, which exists."""
        return next(variable for variable in self.parameters if variable.name == name)


def one_line(error: object) -> str:
    """An error's text without line breaks."""
    return " ".join(str(error).split())


def read_archive(path: Path, throttle: str = "throttle", thrust: str = "thrust") -> Archive:
    """Read an archive; ``throttle`` and ``thrust`` are the names of its ports, in any case.

    Raises InputError: one line with the file and what is wrong with it.
    """
    try:
        return _read(path, throttle, thrust)
    except _UnusableError as reason:
        raise InputError(f"{path}: {reason}") from reason


def unpack(archive: Archive) -> TemporaryDirectory[str]:
    """Unpack what running it on this machine takes into a temporary folder.

    Raises InputError if the file is no longer the one that was read.
    """
    folder = TemporaryDirectory(prefix="engine-")
    try:
        data = _bytes(archive.path)
        if hashlib.sha256(data).hexdigest() != archive.sha256:
            raise _UnusableError("was changed while it was in use")
        binaries = f"binaries/{platform_folder(archive.fmi)}/"
        with zipfile.ZipFile(io.BytesIO(data)) as fmu:
            for name in fmu.namelist():
                if name.startswith((binaries, "resources/")):
                    fmu.extract(name, folder.name)
    except _UnusableError as reason:
        folder.cleanup()
        raise InputError(f"{archive.path}: {reason}") from reason
    except DAMAGE as error:
        folder.cleanup()
        raise InputError(f"{archive.path}: is damaged: {one_line(error)}") from error
    return folder


def platform_folder(fmi: int) -> str:
    """The folder inside ``binaries`` with this machine's library."""
    import fmpy  # type: ignore[import-untyped]

    return str(fmpy.platform if fmi == 2 else fmpy.platform_tuple)


def validate(path: Path) -> list[str]:
    """Everything that FMPy's validation has to say against an archive; empty is good."""
    from fmpy.validation import validate_fmu  # type: ignore[import-untyped]

    return [one_line(problem) for problem in validate_fmu(str(path))]


class _UnusableError(Exception):
    """Why an archive cannot be used; the caller knows its path."""


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except IsADirectoryError as error:
        raise _UnusableError("is a folder; an .fmu archive is needed") from error
    except FileNotFoundError as error:
        raise _UnusableError("no such file") from error
    except OSError as error:
        raise _UnusableError(error.strerror or str(error)) from error


def _read(path: Path, throttle: str, thrust: str) -> Archive:
    data = _bytes(path)
    names, xml = _open(data)
    root = _root(xml)
    version = root.get("fmiVersion", "none stated")
    if version != "2.0" and not version.startswith("3.0"):
        raise _UnusableError(f"FMI version {version} is not supported; allowed: 2.0, 3.0")
    if root.find("CoSimulation") is None:
        other = [words for tag, words in INTERFACES.items() if root.find(tag) is not None]
        raise _UnusableError(f"has no co-simulation interface (it has: {', '.join(other) or 'none'})")
    fmi = int(version[0])
    description = _describe(data)
    slave = description.coSimulation
    _need_library(names, fmi, slave.modelIdentifier)
    scalars = [v for v in description.modelVariables if not v.shape and v.type in REALS | INTEGERS | {"Boolean"}]
    inputs, outputs, parameters = (
        {v.name: v for v in scalars if v.causality == causality} for causality in ("input", "output", "parameter")
    )
    throttle_in = _port("input", throttle, inputs)
    thrust_out = _port("output", thrust, outputs)
    _need_unit(description, throttle_in, "1", {})
    _need_unit(description, thrust_out, "N", {"kg": 1, "m": 1, "s": -2})
    experiment = description.defaultExperiment
    archive = Archive(
        path=path,
        sha256=hashlib.sha256(data).hexdigest(),
        fmi=fmi,
        version=version,
        model=description.modelName,
        identifier=slave.modelIdentifier,
        token=description.instantiationToken,
        throttle=_variable(throttle_in),
        thrust=_variable(thrust_out),
        inputs=tuple(_variable(v) for v in inputs.values()),
        outputs=tuple(_variable(v) for v in outputs.values()),
        parameters=tuple(_variable(v) for v in parameters.values()),
        internal_step=_positive(slave.fixedInternalStepSize),
        preferred_step=_positive(experiment.stepSize if experiment else None),
        once_per_process=slave.canBeInstantiatedOnlyOncePerProcess,
        saves_state=slave.canGetAndSetFMUstate,
        serializes_state=slave.canGetAndSetFMUstate and slave.canSerializeFMUstate,
    )
    low, high = archive.throttle.min, archive.throttle.max
    if (low is not None and low != 0.0) or (high is not None and high != 1.0):
        raise _UnusableError(f"its throttle runs from {low} to {high}; it must run from 0 to 1")
    return archive


def _open(data: bytes) -> tuple[list[str], bytes]:
    """The names in an archive and its model description."""
    if not data.startswith(b"PK"):
        raise _UnusableError("is not an FMU: not a zip archive")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as fmu:
            names = fmu.namelist()
            for name in names:
                if "\\" in name or ":" in name or name.startswith("/") or ".." in PurePosixPath(name).parts:
                    raise _UnusableError(f"has an unsafe path inside: {name!r}")
            if "modelDescription.xml" not in names:
                raise _UnusableError("is not an FMU: it has no modelDescription.xml")
            return names, fmu.read("modelDescription.xml")
    except DAMAGE as error:
        raise _UnusableError(f"is damaged or truncated: {one_line(error)}") from error


def _root(xml: bytes) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise _UnusableError(f"modelDescription.xml is not valid XML: {error}") from error
    if root.tag != "fmiModelDescription":
        raise _UnusableError(f"modelDescription.xml describes a {root.tag}, not an FMU")
    return root


def _describe(data: bytes) -> Any:
    """FMPy's object for the model description."""
    from fmpy.model_description import ValidationError, read_model_description  # type: ignore[import-untyped]

    try:
        return read_model_description(io.BytesIO(data))
    except ValidationError as error:
        more = f" (and {len(error.problems) - 1} more)" if len(error.problems) > 1 else ""
        raise _UnusableError(f"modelDescription.xml is not valid: {one_line(error.problems[0])}{more}") from error
    except Exception as error:  # FMPy raises bare exceptions, and stumbles in its own ways over strange descriptions
        raise _UnusableError(f"modelDescription.xml cannot be used: {one_line(error)}") from error


def _need_library(names: list[str], fmi: int, identifier: str) -> None:
    import fmpy

    needed = f"binaries/{platform_folder(fmi)}/{identifier}{fmpy.sharedLibraryExtension}"
    if needed in names:
        return
    found = {PurePosixPath(name).parts[1] for name in names if name.startswith("binaries/") and name.count("/") > 1}
    has = ", ".join(sorted(found)) or "no binary at all"
    raise _UnusableError(f"has no binary for this machine, {needed} (it has: {has})")


def _port(causality: str, wanted: str, variables: dict[str, Any]) -> Any:
    found = [v for v in variables.values() if v.name.lower() == wanted.lower()]
    if not found:
        raise _UnusableError(f"has no {causality} called {wanted} ({causality}s: {', '.join(variables) or 'none'})")
    if found[0].type not in ("Real", "Float64"):
        raise _UnusableError(
            f"its {found[0].name} is of type {found[0].type}; it must be Real (FMI 2.0) or Float64 (FMI 3.0)"
        )
    return found[0]


def _need_unit(description: Any, variable: Any, name: str, base: dict[str, int]) -> None:
    """Accept no unit, one that is the same in SI base units, or, where these are not stated, one of the same name."""
    stated = variable.unit or (variable.declaredType.unit if variable.declaredType else None)
    defined = next((unit.baseUnit for unit in description.unitDefinitions if unit.name == stated), None)
    if stated is None or (defined is None and stated == name):
        return
    exponents = {key: getattr(defined, key) for key in ("kg", "m", "s", "A", "K", "mol", "cd", "rad") if defined}
    same = defined is not None and defined.factor == 1.0 and defined.offset == 0.0
    if not same or {key: value for key, value in exponents.items() if value} != base:
        raise _UnusableError(f"its {variable.name} is in {stated}; it must be in {name}")


def _variable(v: Any) -> Variable:
    declared = v.declaredType
    low, high = (_number(getattr(v, key) or (getattr(declared, key) if declared else None)) for key in ("min", "max"))
    unit = v.unit or (declared.unit if declared else None)
    return Variable(v.name, v.type, v.valueReference, unit, low, high, _number(v.start), v.description or "")


def _number(text: str | None) -> float | None:
    if text is None:
        return None
    return float({"true": "1", "false": "0"}.get(text, text))


def _positive(value: object) -> float | None:
    number = None if value is None else float(str(value))
    return number if number is not None and math.isfinite(number) and number > 0.0 else None
