"""Where an engine comes from: its file, its archive, its definition or mapping file, and its parameters."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from cosim.base.errors import InputError, nearest
from cosim.base.storage.cache import RecentCache
from cosim.base.storage.files import read_file
from cosim.base.storage.paths import ENGINE, data_folder
from cosim.base.trust import Code
from cosim.engine.fmu.archive import Archive, read_archive
from cosim.engine.fmu.container import read_bytes
from cosim.engine.fmu.description import read_description
from cosim.engine.fmu.mapping import MappingFile, read_mapping
from cosim.engine.fmu.ports import PortError, PortMap
from cosim.engine.fmu.starting import Setting, convert_value
from cosim.engine.fmu.uncertainty import Uncertainty
from cosim.engine.fmu.variables import ConstantValue
from cosim.engine.library import (
    FMI2_SUFFIX,
    BuildError,
    EngineDefinition,
    archive_path,
    build_all,
    list_engines,
    read_engine,
)
from cosim.engine.spec import file_label


def list_engine_names() -> list[str]:
    """Return the names of the shipped engines, each as FMI 3.0, and with ``-fmi2`` appended as FMI 2.0."""
    return list_engines(data_folder("engines"))


def build_engines(engines: list[str] | None = None) -> list[Path]:
    """Build the outdated FMUs of the shipped engines from their sources.

    Parameters
    ----------
    engines : list of str or None
        Names of engines; None: all.
    """
    try:
        return build_all(data_folder("engines"), data_folder("fmus"), engines)
    except BuildError as error:
        raise InputError(str(error)) from error


_definitions: RecentCache[EngineDefinition] = RecentCache(64)


@dataclass(frozen=True)
class EngineSource:
    """Source of an engine: the file that was named, its archive, and its definition or mapping file."""

    name: str  # library name, or the file's name
    path: Path  # file of archive or mapping
    archive: Archive
    engine: EngineDefinition | None  # None: not a library engine
    mapping: MappingFile

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Uncertainty of the engine's parameters, from its definition or mapping file, or None."""
        if self.engine is not None and self.engine.uncertainty:
            return Uncertainty.model_validate(self.engine.uncertainty)
        return self.mapping.uncertainty

    @property
    def code(self) -> list[Code]:
        """Code that the engine runs and the user must trust: its archive, unless it is a shipped one."""
        return [] if self.engine else [Code(self.archive.path, (self.path, self.archive.path))]


def _refuse_wrong_path(path: Path) -> None:
    """Raise InputError for the folder of an engine, for one that was not identified, and for a misspelt file."""
    from difflib import get_close_matches

    if (path / ENGINE).is_file() and path.name not in list_engine_names():
        raise InputError(f"engine {path}: is a folder; name its file: {path / ENGINE}")
    if path.name == ENGINE and (path.parent / "identification.json").is_file():
        raise InputError(f"{path}: the identification left no engine; {path.parent / 'report.html'} says why")
    if path.suffix and not path.exists():
        files = [file.name for file in path.parent.glob("*") if file.suffix.lower() in (".fmu", ".toml")]
        if meant := get_close_matches(path.name, files, n=1):
            raise InputError(f"engine {path}: no such file; did you mean {meant[0]!r}?")


def find_source(engine: str | EngineSource, folder: Path = Path()) -> EngineSource:
    """Return the source of an engine: by its name in the library, or the path of its archive or mapping file.

    A path is seen from ``folder``; a source that was found before is returned as it is.

    Raises InputError for an unknown name (lists the known ones) or a file that cannot be used.
    """
    if isinstance(engine, EngineSource):
        return engine
    path = folder / engine
    if not os.path.isfile(path):
        _refuse_wrong_path(path)
    if path.suffix.lower() == ".toml":
        mapping, fmu, ports = read_mapping(path)
        try:
            archive = read_archive(fmu, ports)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        if mapping.uncertainty is not None:
            mapping.uncertainty.check_parameters(archive.parameters, archive.start, str(path))
        return EngineSource(file_label(path), path, archive, None, mapping)
    if path.suffix.lower() in (".fmu", ".ssp") or len(Path(engine).parts) > 1 or path.is_file():
        return EngineSource(file_label(path), path, read_archive(path), None, _make_empty_mapping(path.name))
    name = engine.removesuffix(FMI2_SUFFIX)
    home = data_folder("engines") / name
    if not (home / ENGINE).is_file():
        allowed = nearest(name, list_engine_names())
        raise InputError(f"unknown engine {engine!r}; {allowed}, or the path of an .fmu, or of a .toml that maps one")
    definition = _read_definition(home)
    path = archive_path(data_folder("fmus"), name, 2 if engine != name else 3)
    if not path.is_file():
        raise InputError(f"engine {engine}: {path} has not been built; run: hexjet engine build")
    known = PortMap(ports=definition.ports, search=False)
    return EngineSource(engine, path, read_archive(path, known), definition, _make_empty_mapping(path.name))


@lru_cache(64)
def _make_empty_mapping(fmu: str) -> MappingFile:
    """Return the contents of an empty mapping file; cached, as pydantic inspects all defaults for each."""
    return MappingFile.model_construct(fmu=fmu)


def _read_definition(folder: Path) -> EngineDefinition:
    try:
        return _definitions.get((folder, read_file(folder / ENGINE)), lambda: read_engine(folder))
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
            raise InputError(f"{archive.path}: {name}{_explain_unknown_parameter(archive, name)}; {allowed}")
        try:
            values[name] = convert_value(parameters[name], specified, str(archive.path))
        except PortError as error:
            raise InputError(str(error)) from error
        settings.append((parameters[name], values[name]))
    return values, tuple(settings)


def _explain_unknown_parameter(archive: Archive, name: str) -> str:
    """Return why a name is no settable parameter, as text that follows the name."""
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
