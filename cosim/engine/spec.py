"""Specification of an engine: its source, parameters, static curve and delay."""

from __future__ import annotations

import hashlib
import math
import os
from bisect import bisect_right
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from cosim.base.errors import InputError, nearest
from cosim.base.removed import describe_removed
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import data_folder
from cosim.base.trust import Code
from cosim.engine.fmu.air import STANDARD_AIR, Air
from cosim.engine.fmu.archive import Archive, read_archive
from cosim.engine.fmu.container import read_bytes
from cosim.engine.fmu.description import read_description
from cosim.engine.fmu.mapping import ConstantValue, MappingFile, PortMap, is_mapping, read_mapping
from cosim.engine.fmu.ports import PortError
from cosim.engine.fmu.starting import Setting, convert_value
from cosim.engine.fmu.uncertainty import ParameterRange, Uncertainty, without_uncertainty
from cosim.engine.fmu.variables import Port, Variable
from cosim.engine.library import (
    FMI2_SUFFIX,
    BuildError,
    EngineDefinition,
    archive_path,
    build_all,
    list_engines,
    read_engine,
)
from cosim.engine.response import NO_CHANGE, Curve, SmallStep, trim_flat_ends
from cosim.engine.rundown import FlameOutLaw

Axis = TypeVar("Axis")
Model = TypeVar("Model")


@dataclass(frozen=True)
class EngineSpec:
    """One engine, ready to be put into a bank.

    ``pole`` and ``delay_samples`` belong to ``G(z) = gain / (z - pole) z^-delay_samples`` at ``internal_step``, where
    the engine's ``engine.toml`` names the parameters; they are None for any other FMU.
    """

    name: str
    title: str
    library: bool  # one of the shipped engines
    path: Path
    fmi: str  # version
    sha256: str  # of the archive
    parameters: Mapping[str, float]  # value of every parameter
    curve: Curve  # steady thrust [N] over throttle
    internal_step: float | None  # s
    pole: float | None
    delay_samples: int | None
    start: str | None  # the parameter that starts the engine in equilibrium at a throttle
    rotor_inertia: float  # kg m^2, about the jet's axis; 0 where it is not known
    flame_out: FlameOutLaw | None  # law of the thrust after a flame-out; None where it is not known
    specified_delay: float | None  # s, from a mapping file
    mapping: Path | None  # the mapping file it was loaded by
    archive: Archive = field(repr=False)
    settings: tuple[Setting, ...] = field(repr=False)
    settling_window: int = field(repr=False)  # communication steps, longer than the engine's delay
    quiet: float = field(default=NO_CHANGE, repr=False)  # fraction of itself by which the thrust may move at rest
    air: Air = STANDARD_AIR  # in which the curve was measured
    isolated: bool = False  # whether it needs a process of its own
    small_step: SmallStep | None = None  # how late it is to a small step, at the control step; None: see Measured
    logged_outputs: tuple[tuple[str, Variable], ...] = ()  # further outputs by their names in the log
    misbehaviour: str = ""  # reason why a check gave it a process of its own
    uncertainty: Uncertainty | None = field(default=None, repr=False)  # of its parameters, from a mapping file
    uncertain_ranges: tuple[ParameterRange, ...] = field(default=(), repr=False)  # of these, about what the file states

    @property
    def identity(self) -> str:
        """Identity of the engine in a design: the hash of its equations, else of its archive."""
        return self.archive.equations_sha256 or self.sha256

    @property
    def fingerprint(self) -> str:
        """Identity of a file's engine in an identified model: a hash of archive and mapping file; empty: library.

        The name alone does not distinguish one ``kestrel.toml`` from another.  How well its parameters are known is no
        part of it, and neither is how the file is written.
        """
        if self.library:
            return ""
        stated = without_uncertainty(self.mapping) if self.mapping else b""
        return hashlib.sha256(self.identity.encode() + stated).hexdigest()

    def matches_model(self, model_sha256: str) -> bool:
        """Return whether a model with this engine hash, or an empty one, may be of this engine."""
        return self.library or model_sha256 in ("", self.fingerprint)

    @property
    def source_key(self) -> tuple[Hashable, ...]:
        """Origin of the engine: equal for all engines of one FMU."""
        return self.path, self.mapping, self.settings

    @property
    def behaviour_key(self) -> tuple[Hashable, ...]:
        """Everything besides its inputs that the behaviour of the engine depends on."""
        return *make_behaviour_key(self.archive, self.settings, self.air), self.start, self.settling_window, self.quiet

    @property
    def family(self) -> str:
        """Key of its identified models: the library's name without FMI version, else the name with the file's suffix.

        The file is the mapping file where there is one.  With its suffix, so that somebody's ``edf.fmu`` is not taken
        for the library's ``edf``.
        """
        file = self.mapping or self.path
        return self.name.removesuffix(FMI2_SUFFIX) if self.library else file_label(file) + file.suffix

    @property
    def families(self) -> tuple[str, ...]:
        """Keys of its identified models; version 0.2.0 had the file's name alone, also where that is ``engine``."""
        return (self.family,) if self.library else (self.family, (self.mapping or self.path).name)

    def models_in(self, identified: Mapping[str, Mapping[Axis, Model]]) -> Mapping[Axis, Model]:
        """Return the models of this engine, by axis, among those by engine; empty where there are none."""
        return next((identified[family] for family in self.families if family in identified), {})

    @property
    def ports(self) -> Mapping[str, Port]:
        """The engine's variables with their conversions, by port name."""
        return self.archive.ports

    def has_port(self, port: str) -> bool:
        """Return whether the engine has a port, such as ``ambient_pressure``, ``run`` or ``fuel_flow``."""
        return port in self.ports

    @property
    def transport_delay(self) -> float | None:
        """Transport delay [s]."""
        if self.specified_delay is not None:
            return self.specified_delay
        if self.delay_samples is None or self.internal_step is None:
            return None
        return self.delay_samples * self.internal_step

    @property
    def rising_curve(self) -> Curve:
        """The part of the static curve on which thrust grows with the throttle."""
        return trim_flat_ends(self.curve, self.quiet, self.archive.starting.rest_n)

    @property
    def lag(self) -> float | None:
        """Time constant [s]: -internal_step / ln(pole)."""
        if self.pole is None or self.internal_step is None:
            return None
        return -self.internal_step / math.log(self.pole) if self.pole > 0.0 else 0.0

    def thrust_at(self, throttle: float) -> float:
        """Return the steady thrust [N] at a throttle, interpolated linearly between the measured points."""
        throttles, thrusts = self.curve
        k = min(max(bisect_right(throttles, throttle), 1), len(throttles) - 1)
        fraction = (throttle - throttles[k - 1]) / (throttles[k] - throttles[k - 1])
        return thrusts[k - 1] + (thrusts[k] - thrusts[k - 1]) * min(max(fraction, 0.0), 1.0)


def file_label(path: Path) -> str:
    """Return what an engine that is a file is called: its name, or its folder's where the file is called ``engine``."""
    return Path(os.path.abspath(path)).parent.name or path.stem if path.stem == "engine" else path.stem


def list_engine_names() -> list[str]:
    """Return the shipped engines' names; each exists as FMI 3.0, and with ``-fmi2`` appended as FMI 2.0."""
    return list_engines(data_folder("engines"))


def build_engines(names: list[str] | None = None) -> list[Path]:
    """Build the FMUs of the shipped engines, those up to date excepted, and return the paths of all.

    Raises InputError if one cannot be built.
    """
    try:
        return build_all(data_folder("engines"), data_folder("fmus"), names)
    except BuildError as error:
        raise InputError(str(error)) from error


_definitions: RecentCache[EngineDefinition] = RecentCache(64)


def make_behaviour_key(archive: Archive, settings: tuple[Setting, ...], air: Air) -> tuple[Hashable, ...]:
    """Return a key of everything that the response of an FMU with these settings in this air depends on."""
    values = tuple((variable.name, value.hex()) for variable, value in settings)
    return archive.sha256, tuple(sorted(archive.ports.items())), archive.starting, values, air


@dataclass(frozen=True)
class EngineSource:
    """Source of an engine: the named file, its archive, and its definition or mapping file."""

    path: Path  # path of the archive, or of the mapping file that names it
    archive: Archive
    engine: EngineDefinition | None  # its definition, if it is one of the library
    mapping: MappingFile

    @property
    def uncertainty(self) -> Uncertainty | None:
        """How well its parameters are known, by its definition or its mapping file; None where neither says it."""
        if self.engine is not None and self.engine.uncertainty:
            return Uncertainty.model_validate(self.engine.uncertainty)
        return self.mapping.uncertainty

    @property
    def code(self) -> list[Code]:
        """Code that the engine runs: its archive, unless it is one of the library."""
        archive = self.archive
        return [Code(archive.path, (self.path, archive.path))] if self.engine is None else []


def _refuse_misspelt_file(path: Path) -> None:
    """Raise InputError with the likeliest engine's file beside ``path``, where a name is that of a file."""
    from difflib import get_close_matches

    files = [file.name for file in Path().iterdir() if file.suffix.lower() == ".fmu"] if path.suffix else []
    if meant := get_close_matches(path.name, files, n=1):
        raise InputError(f"engine {path}: no such file; did you mean {meant[0]!r}?")


def find_source(name_or_path: str) -> EngineSource:
    """Find an engine by its name in the library, the path of its archive, or that of a mapping file.

    Raises InputError for an unknown name (lists the known ones) or a file that cannot be used.
    """
    path = Path(name_or_path)
    if removed := describe_removed(path.suffix.lower()):
        raise InputError(f"engine {name_or_path}: {removed}")
    if is_mapping(path):
        _refuse_engine_not_left(path)
        mapping, fmu, ports = read_mapping(path)
        try:
            archive = read_archive(fmu, ports)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        if mapping.uncertainty is not None:
            mapping.uncertainty.check_parameters(archive.parameters, archive.start, str(path))
        return EngineSource(path, archive, None, mapping)
    if path.suffix.lower() == ".fmu" or len(path.parts) > 1 or path.is_file():
        return EngineSource(path, read_archive(path), None, _without_mapping(path.name))
    name = name_or_path.removesuffix(FMI2_SUFFIX)
    folder = data_folder("engines") / name
    if not (folder / "engine.toml").is_file():
        _refuse_misspelt_file(path)
        allowed = nearest(name, list_engine_names())
        raise InputError(
            f"unknown engine {name_or_path!r}; {allowed}, or the path of an .fmu, or of a .toml that maps one"
        )
    engine = _definition(folder)
    path = archive_path(data_folder("fmus"), name, 2 if name_or_path != name else 3)
    if not path.is_file():
        raise InputError(f"engine {name_or_path}: {path} has not been built; run: hexjet fmu build")
    known = PortMap(ports=engine.ports, search=False)
    return EngineSource(path, read_archive(path, known), engine, _without_mapping(path.name))


def _refuse_engine_not_left(path: Path) -> None:
    """Refuse the engine of an identification that left none."""
    if not path.exists() and (path.parent / "identification.json").is_file():
        raise InputError(f"{path}: the identification left no engine; {path.parent / 'report.html'} says why")


@lru_cache(64)
def _without_mapping(fmu: str) -> MappingFile:
    """Return a mapping file that states nothing: pydantic looks at the signature of every default as it makes one."""
    return MappingFile.model_construct(fmu=fmu)


def _definition(folder: Path) -> EngineDefinition:
    path = folder / "engine.toml"
    try:
        return _definitions.get((folder, read_file(path)), lambda: read_engine(folder))
    except BuildError as error:
        raise InputError(str(error)) from error


def check_whole_steps(archive: Archive, engine: EngineDefinition | None, step: float) -> None:
    """Raise InputError for a communication step that is no multiple of the engine's internal step."""
    internal = engine.internal_step if engine else archive.internal_step
    if internal is None:
        return
    count = round(step / internal)
    if count < 1 or abs(step - count * internal) > 1e-9 * step:
        below = max(1, int(step / internal))
        raise InputError(
            f"{archive.path}: step {step:g} s is not a whole multiple of the engine's internal step {internal:g} s; "
            f"step_s of the scenario or the vehicle may be {below * internal:g} or {(below + 1) * internal:g}"
        )


def resolve_parameters(
    source: EngineSource, overrides: Mapping[str, ConstantValue]
) -> tuple[dict[str, float], tuple[Setting, ...]]:
    """Return every parameter's value, and the settings for those of the mapping file and of ``overrides``.

    Raises InputError for an unknown parameter, one that the simulation sets itself, or a value out of range.
    """
    archive = source.archive
    parameters = {v.name: v for v in archive.parameters if v.name != archive.start}
    values = {name: v.start for name, v in parameters.items() if v.start is not None}
    settings = []
    for name, specified in {**source.mapping.parameters, **overrides}.items():
        if name not in parameters:
            allowed = nearest(name, list(parameters)) if parameters else "it has none"
            raise InputError(f"{archive.path}: {name}{_why_no_parameter(archive, name)}; {allowed}")
        try:
            values[name] = convert_value(parameters[name], specified, str(archive.path))
        except PortError as error:
            raise InputError(str(error)) from error
        settings.append((parameters[name], values[name]))
    return values, tuple(settings)


def _why_no_parameter(archive: Archive, name: str) -> str:
    """Return why a name is no parameter that can be set, in words that follow it."""
    if name == archive.start:
        return " is set by the simulation itself"
    if any(v.name == name for v in archive.inputs):
        return " is an input, which a mapping file holds under [inputs], and no parameter"
    for v in read_description(read_bytes(archive.path))[0].modelVariables:
        if v.name == name and v.causality == "parameter":
            return f" is a parameter of type {v.type}, which cannot be set"
        if v.name == name:
            return f" is of causality {v.causality or 'local'}, and no parameter"
    return ": no such parameter"
