"""The scenario of a flight as it flies, with every number in it, and the files beside it in a run's folder."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml, toml_text
from cosim.engine import EngineSpec, load_engine
from cosim.results.run import REQUESTS, RUN_FILES
from cosim.simulation.controllers.source import Source
from cosim.simulation.plugins import Plugins
from cosim.simulation.step import Simulation
from cosim.spec.controller_name import FileName, split_file_name
from cosim.spec.scenario import (
    CommandEntry,
    Scenario,
    Station,
    SticksCommand,
    TableCommand,
    TrackCommand,
    copy_parameters,
    flown_parameters,
    list_changes,
)
from cosim.spec.vehicle import VEHICLE, is_aircraft_path, is_file, load_vehicle, read_tables
from cosim.vehicle.model_file import read_model


def resolve(simulation: Simulation) -> tuple[Scenario, dict[str, Path | bytes]]:
    """Return the scenario with all numbers of vehicle and engines, and the files that it is written with."""
    scenario = simulation.flown_scenario
    files: dict[str, Path | bytes] = {}
    if scenario.requests is not None:
        files[REQUESTS] = scenario.folder / scenario.requests
    commands: list[CommandEntry] = []
    for index, entry in enumerate(scenario.command):
        if isinstance(entry, (TableCommand, SticksCommand, TrackCommand)):
            source = scenario.folder / entry.file
            name = source.name if source.name not in files else f"{index}-{source.name}"
            files[name] = source
            entry = entry.model_copy(update={"file": name})
        commands.append(entry)
    parameters = flown_parameters(simulation.scenario)
    custom = simulation.controller_source
    controller: dict[str, Any] = _plugin_names(simulation.plugins, files)
    if custom is not None:
        controller |= {"controller": copy_controller(custom, files), "controller_sha256": custom.sha256 or None}
        custom_parameters = custom.resolve_values(scenario.controller_parameters, "controller_parameters")
        controller["controller_parameters"] = _to_floats(custom_parameters)
    aircraft, vehicle, names = copy_aircraft(simulation, files)
    engine, jets = simulation.engine, simulation.vehicle.jets
    # Each part was validated when the scenario was read, so nothing is validated again.
    return scenario.resolved(
        **{
            **controller,
            "parameter_files": copy_parameters(parameters, files, RUN_FILES),
            "changed": list_changes(simulation.scenario, parameters),
            "command": commands,
            "engine": names[id(engine)],
            "engine_parameters": _to_floats(engine.parameters),
            "stations": {
                str(number): Station(engine=names[id(station)], parameters=_to_floats(station.parameters))
                for number, station in enumerate(simulation.stations, 1)
                if station.source_key != engine.source_key or jets[number - 1].engine is not None
            },
            "aircraft": aircraft,
            "expect": [
                entry.model_copy(update={"aircraft": aircraft}) if entry.aircraft == scenario.aircraft else entry
                for entry in scenario.expect
            ],
            "vehicle": vehicle,
            **({"requests": REQUESTS} if scenario.requests is not None else {}),
        }
    ), files


def copy_aircraft(simulation: Simulation, files: dict[str, Path | bytes]) -> tuple[str, dict[str, Any], dict[int, str]]:
    """Return the aircraft's name relative to a resolved scenario, its numbers, and the names of its engines.

    The engines are those of their specs' ids; files of the user's, of aircraft and engines, are added to ``files``.

    Raises InputError where another file has the name of one of its own.
    """
    scenario, specs = simulation.flown_scenario, [simulation.engine, *simulation.stations]
    whole = simulation.vehicle.model_dump(mode="json", exclude_none=True)
    if not is_aircraft_path(scenario.aircraft):
        return scenario.aircraft, whole, engine_files(specs, files, simulation.vehicle.identified)
    _, folder = scenario.resolved_vehicle()
    table, written = read_tables(scenario.aircraft, scenario.folder), dict[str, Path | bytes]()
    model = simulation.vehicle.model
    if model is not None:
        written[Path(model).name] = read_model(folder / model)
        rename_engine = {"model": Path(model).name}
        table, whole = table | rename_engine, whole | rename_engine
    written[VEHICLE] = b""
    for name in written:
        if name in files:
            raise InputError(f"aircraft {scenario.aircraft_name}: another file of the flight has the name {name!r}")
    files |= written
    names = engine_files(specs, files, simulation.vehicle.identified)
    called = {(spec.mapping or spec.path).resolve(): names[id(spec)] for spec in specs}
    table, whole = (_with_engines(aircraft_table, folder, called) for aircraft_table in (table, whole))
    files[VEHICLE] = toml_text(_drop_none(table)).encode()
    return VEHICLE, whole, names


def _with_engines(table: dict[str, Any], folder: Path, called: Mapping[Path, str]) -> dict[str, Any]:
    """Return a vehicle's table with its engine files, relative to ``folder``, replaced by their copies' names.

    An engine that does not fly is left out.
    """

    def rename_engine(part: dict[str, Any]) -> dict[str, Any]:
        engine = part.get("engine")
        if engine is None or not is_file(engine):
            return part
        name = called.get((folder / engine).resolve())
        return {key: value for key, value in part.items() if key != "engine"} | ({"engine": name} if name else {})

    jets = {"jets": [rename_engine(jet) for jet in table["jets"]]} if "jets" in table else {}
    return rename_engine(table) | jets


def copy_vehicle(aircraft: str, folder: Path, files: dict[str, Path | bytes]) -> str:
    """Return the name of a user's aircraft next to a scenario, and add its files to ``files``.

    Its files begin with its name.  Raises InputError as :func:`cosim.spec.vehicle.load_vehicle`, for its engine, and
    where another file has the name of one of them.
    """
    vehicle, location = load_vehicle(aircraft, folder=folder)
    table, written = read_tables(aircraft, folder), dict[str, Path | bytes]()
    if vehicle.model is not None:
        name = f"{vehicle.name}-{Path(vehicle.model).name}"
        written[name] = read_model(location / vehicle.model)
        table = table | {"model": name}
    changes = {
        engine: None for engine in (vehicle.engine, *(jet.engine for jet in vehicle.jets)) if engine and is_file(engine)
    }
    step, sources = vehicle.control_step, [location / engine for engine in changes]
    specs = {source.resolve(): load_engine(str(source), {}, step, isolated=True) for source in sources}
    names = engine_files(list(specs.values()), files, vehicle.identified)
    table = _with_engines(table, location, {source: names[id(spec)] for source, spec in specs.items()})
    written[f"{vehicle.name}-{VEHICLE}"] = toml_text(_drop_none(table)).encode()
    for name in written:
        if name in files:
            raise InputError(f"aircraft {vehicle.name}: another file has the name {name!r}")
    files |= written
    return f"{vehicle.name}-{VEHICLE}"


def _drop_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table without the None that TOML cannot express."""
    return {
        key: _drop_none(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }


def _plugin_names(plugins: Plugins, files: dict[str, Path | bytes]) -> dict[str, Any]:
    """Return plug-ins by their names next to a resolved scenario, and their hashes."""
    by_key: dict[str, Any] = {}
    hashes: dict[str, str] = {}
    for key, sources in plugins.sources.items():
        names = [copy_controller(source, files) for source in sources]
        by_key[key] = names if key in ("metrics", "observers") else names[0]
        hashes |= {name: source.sha256 for name, source in zip(names, sources, strict=True)}
    return by_key | ({"own_sha256": hashes} if hashes else {})


def _to_floats(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}


def copy_controller(source: Source, files: dict[str, Path | bytes]) -> str:
    """Return a controller's name next to a resolved scenario, and add its files to ``files``.

    Raises InputError where another file has the name of one that it imports.
    """
    named = split_file_name(source.name) or FileName("", source.name, "") if source.files and source.is_copied else None
    if named is None:
        return source.name
    first, *others = source.files.items()
    name, number = first[0], len(files)
    while name in files and files[name] != first[1]:
        name, number = f"{number}-{first[0]}", number + 1
    files[name] = first[1]
    for title, path in others:
        if files.setdefault(title, path) != path:
            raise InputError(f"{source.label}: imports {title}, and another file has this name already")
    return named._replace(file=name).text


def engine_files(specs: Sequence[EngineSpec], files: dict[str, Path | bytes], known: Container[str]) -> dict[int, str]:
    """Return each spec's file name (by id) next to a resolved scenario; foreign ones add files to ``files``.

    A mapping file names its archive there.  Files are called as their engines; as before, if models are ``known`` so.
    """
    noted = {file.resolve(): name for name, file in files.items() if isinstance(file, Path)}
    copied: dict[Path, str] = {}

    def add_copy(source: Path, content: Path | bytes, called: str) -> str:
        target = source.resolve()
        if target not in copied:
            name, number = noted.get(target, called), len(copied)
            while name in files and name != noted.get(target):  # equal file names from several folders
                name, number = f"{number}-{called}", number + 1
            copied[target] = name
            files[name] = content
        return copied[target]

    names = {}
    for spec in specs:
        if spec.library:
            names[id(spec)] = spec.name
            continue
        file = spec.mapping or spec.path
        called = file.name if file.name in known or spec.family in RUN_FILES else spec.family
        archive = add_copy(spec.path, spec.path, spec.path.name if spec.mapping else called)
        names[id(spec)] = add_copy(file, _mapping(file, archive), called) if spec.mapping else archive
    return names


def _mapping(path: Path, archive: str) -> Path | bytes:
    """Return a mapping file, or its content with the archive's name here if that differs."""
    table = read_toml(path)
    return path if table["fmu"] == archive else toml_text(table | {"fmu": archive}).encode()
