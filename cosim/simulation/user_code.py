"""The code that a scenario names: the user is asked for trust once, before any of it runs."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from cosim.base.errors import InputError
from cosim.base.storage.toml import read_toml
from cosim.base.trust import Code, need_trust, program_code
from cosim.engine.make.controller_fmu import MAPPING_SUFFIX
from cosim.engine.source import find_source
from cosim.spec.controller_name import split_file_name
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import is_aircraft_path, is_file, load_vehicle


def check_scenario_trust(scenario: Scenario) -> None:
    """Refuse a scenario with code that the user does not trust.  Raises CodeRefusedError."""
    need_trust(list_scenario_code(scenario), f"scenario {scenario.name}")


def list_scenario_code(scenario: Scenario) -> list[Code]:
    """Return the files that a scenario names and that run: of its controller, its own blocks and its engines.

    What cannot be read is left out: whatever loads it says what is wrong.
    """
    blocks = [scenario.controller, *scenario.metrics, *scenario.observers, scenario.sensors, scenario.wind]
    code = [item for name in blocks if name for item in list_block_code(name, scenario.folder)]
    engines = [scenario.engine, *(station.engine for station in scenario.stations.values())]
    code += [item for engine in engines if engine for item in list_engine_code(engine, scenario.folder)]
    return list(dict.fromkeys([*code, *list_aircraft_code(scenario.aircraft, scenario.folder)]))


def list_aircraft_code(aircraft: str, folder: Path, with_engine: bool = False) -> list[Code]:
    """Return the code of the engines at single jets of an aircraft; ``with_engine``: also of its common engine."""
    if not is_aircraft_path(aircraft):
        return []
    try:
        vehicle, own_folder = load_vehicle(aircraft, folder=folder)
    except InputError:
        return []
    engines = [vehicle.engine if with_engine else None, *(jet.engine for jet in vehicle.jets)]
    return [item for engine in dict.fromkeys(engines) if engine for item in list_engine_code(engine, own_folder)]


def list_engine_code(engine: str, folder: Path) -> list[Code]:
    """List the code that a foreign engine runs; paths are relative to ``folder``."""
    if is_file(engine):
        with suppress(InputError, OSError):
            return find_source(engine, folder).code
    return []


def list_block_code(name: str, folder: Path) -> list[Code]:
    """List the code of a user's controller or block; paths are relative to ``folder``."""
    parsed = split_file_name(name)
    if parsed is None:
        return []
    path, code = Path(parsed.resolve(folder).file), list[Code]()
    if parsed.before:
        code = [program_code(path, parsed.after)]
    elif parsed.after or path.suffix.lower() == ".fmu":
        code = [Code(path)]
    elif path.name.lower().endswith(MAPPING_SUFFIX):
        with suppress(InputError, OSError, KeyError, TypeError):
            fmu = path.parent / read_toml(path)["fmu"]
            code = [Code(fmu, (path, fmu))]
    return [item for item in code if item.path.is_file()]
