"""What flies: a scenario, with other choices written over it, as the options of the commands do."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import InputError
from cosim.base.storage.settings import as_settings
from cosim.base.trust import trust_named_code

if TYPE_CHECKING:
    from cosim.spec.scenario import Scenario

# Callback that receives one sentence for each input that is ignored or reinterpreted.
Note = Callable[[str], None]


def apply_choices(
    scenario: Scenario | str | Path,
    controller: str | Path | None = None,
    aircraft: str | Path | None = None,
    engine: str | Path | Sequence[str] | None = None,
    settings: Sequence[str] | Mapping[str, object] = (),
    seed: int | None = None,
    note: Note = lambda text: None,
    model: str | Path | None = None,
) -> Scenario:
    """Return the scenario with controller, aircraft, engine and settings replaced.  Raises InputError."""
    from cosim.spec.scenario import Scenario

    texts = tuple(as_settings(settings))
    engines = () if engine is None else (str(engine),) if isinstance(engine, (str, Path)) else tuple(engine)
    if isinstance(scenario, Scenario) and not (texts or engines or controller or aircraft or model or seed is not None):
        return scenario
    named = None if controller is None else str(controller)
    trust_named_code([*texts, *engines, named], Path())
    vehicle, models = None if aircraft is None else str(aircraft), None if model is None else Path(model)
    return load_scenario(scenario, named, engines, seed, texts, models, vehicle, note)


def load_scenario(
    scenario: Scenario | str | Path,
    controller: str | None,
    engines: tuple[str, ...],
    seed: int | None,
    settings: tuple[str, ...],
    model: Path | None = None,
    aircraft: str | None = None,
    note: Note = lambda text: None,
) -> Scenario:
    """Return the scenario with a command line's choices applied; ``note`` receives a line on a replaced controller."""
    from cosim.spec.controller_name import is_design, resolve_controller

    designed = Path(controller) if controller is not None and is_design(controller) else None
    if designed is not None:
        from cosim.simulation.controllers.controller_file import apply_controller

        scenario, controller = apply_controller(scenario, designed, settings, aircraft), None
    else:
        scenario = _apply_settings(scenario, settings)
    changes: dict[str, Any] = {}
    keys = {text.partition("=")[0].strip() for text in settings}
    if aircraft is not None:
        from cosim.spec.vehicle import aircraft_seen_from, engine_of

        aircraft = aircraft_seen_from(aircraft, Path())
        changes |= {"aircraft": aircraft, "engine": engine_of(aircraft) or scenario.engine}
        if controller is None and model is None and designed is None and "controller" not in keys:
            changes |= _replace_model_based_controller(aircraft, scenario, note)
    if controller is not None:
        # A command line's file is relative to the current folder, a scenario's file to the scenario's folder.
        changes["controller"] = resolve_controller(controller, Path())
        if any(text.strip().startswith("controller_parameters") for text in settings):
            changes["controller_parameters"] = scenario.controller_parameters
    chosen = engine_choices(engines)
    if "engine" in chosen and scenario.stations:
        scenario = scenario.model_copy(update={"stations": {}, "expect": []})  # one engine for all stations
    changes |= chosen if seed is None else chosen | {"seed": seed}
    if model is not None:
        from cosim.spec.scenario import parameter_files
        from cosim.spec.vehicle import read_models

        changes["vehicle"] = {
            "identified": {
                family: {axis: each.model_dump(mode="json") for axis, each in models.items()}
                for family, models in read_models(model).items()
            }
        }
        changes["parameter_files"] = parameter_files(scenario.parameter_files, "models", model)
    if settings or model is not None or designed is not None or "stations" in chosen:
        changes["expect"] = []
    scenario = scenario.replace(**changes) if changes else scenario
    # Check the vehicle now, so that a wrong key is reported before anything is built.
    scenario.resolved_vehicle()
    return scenario


def _apply_settings(scenario: Scenario | str | Path, settings: Sequence[str]) -> Scenario:
    """Return a scenario, given as object, name or file, with settings applied.  Raises InputError."""
    from cosim.base.storage.toml import parse_setting, set_path
    from cosim.spec.scenario import Scenario

    if not isinstance(scenario, Scenario):
        return Scenario.read(scenario, settings)
    if not settings:
        return scenario
    table, where = scenario.stated(), f"scenario {scenario.name}"
    for text in settings:
        key, value = parse_setting(text)
        set_path(table, key, value, f"{where}: settings")
    return Scenario.from_table(table, scenario.folder, where, scenario.origin or scenario)


def _replace_model_based_controller(aircraft: str, scenario: Any, note: Note) -> dict[str, str]:
    """Return the baseline controller, with a note, if the predictor needs a model that the aircraft lacks."""
    from cosim.control.predictors.registry import BASELINE, PREDICTORS
    from cosim.spec.vehicle import load_vehicle

    spec = PREDICTORS.get(scenario.controller)
    if spec is None or not spec.needs_model:
        return {}
    vehicle, _ = load_vehicle(aircraft)
    if vehicle.identified or scenario.vehicle.get("identified"):
        return {}
    note(
        f"{vehicle.name} states no identified model, which controller {scenario.controller} needs; "
        f"flown with {BASELINE.name}"
    )
    return {"controller": BASELINE.name}


def plugin_changes(
    metrics: tuple[str, ...], observers: tuple[str, ...] = (), sensors: str | None = None, wind: str | None = None
) -> dict[str, Any]:
    """Return the user's metrics, observers, sensors and wind as changes of a scenario, files by absolute paths."""
    from cosim.spec.controller_name import resolve_controller

    def absolute(name: str) -> str:
        return str(Path(name).absolute()) if name.lower().endswith(".csv") else resolve_controller(name, Path())

    changes: dict[str, Any] = {"metrics": [absolute(name) for name in metrics]} if metrics else {}
    changes |= {"observers": [absolute(name) for name in observers]} if observers else {}
    return changes | {key: absolute(name) for key, name in (("sensors", sensors), ("wind", wind)) if name is not None}


def plugin_settings(metrics: tuple[str, ...], wind: str | None = None) -> list[str]:
    """Return the user's metrics and wind as settings of a study, ``KEY=VALUE``."""
    return [f"{key}={json.dumps(value)}" for key, value in plugin_changes(metrics, wind=wind).items()]


def engine_for(aircraft: str, engine: str | None) -> str:
    """Return ``engine`` if named, else the aircraft's default engine.  Raises InputError if there is none."""
    from cosim.spec.vehicle import aircraft_seen_from, engine_of

    chosen = engine or engine_of(aircraft_seen_from(aircraft, Path()))
    if chosen is None:
        raise InputError(f"{aircraft}: vehicle.toml names no engine: name one as engine")
    return chosen


def aircraft_settings(aircraft: str | None) -> list[str]:
    """Return a study's settings for another aircraft with its default engine; a path is made absolute."""
    from cosim.spec.vehicle import aircraft_seen_from, engine_of

    if aircraft is None:
        return []
    aircraft = aircraft_seen_from(aircraft, Path())
    named = {"aircraft": aircraft, "engine": engine_of(aircraft)}
    return [f"{key}={json.dumps(name)}" for key, name in named.items() if name is not None]


def list_engine_notes(scenario: Scenario, drawn: bool = False) -> list[str]:
    """Return notes on FMUs and, unless engines are ``drawn``, on changed models of engines that are not flown."""
    from cosim.engine.library import FMI2_SUFFIX
    from cosim.simulation.engines import list_stations
    from cosim.spec.vehicle import is_file, load_vehicle

    vehicle = scenario.resolved_vehicle()[0]
    stations = list_stations(scenario, vehicle)
    engines = [scenario.engine, *(station.engine for station in stations if station and station.engine)]
    is_checked = "identified" in scenario.vehicle and not drawn and not any(map(is_file, engines))
    # A recorded run's scenario states every model of its aircraft, also those of engines that it does not fly.
    own = load_vehicle(scenario.aircraft, folder=scenario.folder)[0].identified
    changed = [name for name, model in vehicle.identified.items() if is_checked and model != own.get(name)]
    flown = [engine.removesuffix(FMI2_SUFFIX) for engine in engines]
    unused = [f"vehicle.identified.{name}: that engine does not fly" for name in changed if name not in flown]
    return unused + list_fmu_defects(*engines, folder=scenario.folder, isolated=scenario.engine_isolated)


def list_fmu_defects(*engines: str, folder: Path = Path(), isolated: bool | None = None) -> list[str]:
    """Return violations of FMI by engine FMUs (relative to ``folder``), and the risk of running them in process."""
    from cosim.spec.vehicle import is_file

    lines = []
    for engine in filter(is_file, dict.fromkeys(engines)):
        from cosim.engine import check, find_source

        source = find_source(engine, folder)
        found = check.note_harmless_violations(source.archive)
        if isolated is False or (isolated is None and source.mapping.isolated is False):
            found.append("isolated = false: a crash or a hang of its library ends the process that flies it")
        lines += [f"{engine}: {line}" for line in found]
    return lines


def engine_choices(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return engine texts ``NAME`` or ``STATION=NAME`` as changes of a scenario.  Raises InputError for duplicates."""
    from cosim.spec.vehicle import file_seen_from

    changes: dict[str, Any] = {}
    for text in texts:
        number, equals, name = text.partition("=")
        station = number.strip() if equals and number.strip().isdigit() else None
        engine = (name if station else text).strip()
        # A command line's file is relative to the current folder, a scenario's file to the scenario's folder.
        engine = file_seen_from(engine, Path())
        target = changes if station is None else changes.setdefault("stations", {}).setdefault(station, {})
        if "engine" in target:
            raise InputError(
                f"engine {text}: there is already another for {f'station {station}' if station else 'all'}"
            )
        target["engine"] = engine
    return changes
