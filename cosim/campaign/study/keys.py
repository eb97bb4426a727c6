"""Everything of a flight that can be varied, by dotted key.

A key names one value of a scenario (``environment.wind_ned_m_s.1``), of one of its entries by place
(``disturbance.0.mass_kg``), of its vehicle (``vehicle.sensors.gyro.noise_rad_s``), of its engine
(``engine_parameters.delay_samples``) or of one station's (``stations.3.parameters.gain``), and of either as no
controller knows it (``mismatch.engine_parameters.gain``, ``mismatch.stations.3.gain``).  Places in lists are counted
from 0, stations from 1 as they are numbered on the aircraft.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from cosim.base.errors import InputError
from cosim.base.storage.toml import merge, set_path, split_key
from cosim.base.trust import CodeRefusedError, is_code_forbidden
from cosim.campaign.study.key import Key, Value, unit_of
from cosim.control.predictors.registry import PREDICTORS
from cosim.engine import list_engine_names
from cosim.engine.fmu.variables import INTEGERS
from cosim.engine.source import EngineSource, find_source, resolve_parameters
from cosim.simulation.controllers.source import find_controller_source
from cosim.simulation.controllers.source import list_installed as custom_controllers
from cosim.spec.controller_name import is_design
from cosim.spec.scenario import PREDICTOR_KEEPS_MODEL, UNKNOWN_TO_CONTROLLER, Scenario, parameter_files, suggest_key
from cosim.spec.vehicle import PredictorTuning, aircraft_names, engine_of
from cosim.spec.vehicle.sensor_profile import STATED, profile_names

WHOLE_STEPS = ("start_s", "duration_s", "width_s", "delay_s")  # keys of entries counted in whole steps
LISTS = ("command", "disturbance", "fault")  # tables of a scenario that are lists
NOT_VARIED = (  # keys that no study may vary
    "controller_sha256", "controller_limit_s", "seed", "expect", "name", "title", "description", "requests",
    "parameter_files", "changed", "engine_unchecked", "engine_isolated", "limits",
)  # fmt: skip
CUSTOM_PARAMETERS = "controller_parameters."  # keys of a custom controller
FLOWN_PARAMETERS, FLOWN_STATIONS = "mismatch.engine_parameters", "mismatch.stations."  # keys of flown parameters
ENGINE_KEYS = ("engine_parameters.", "stations.", f"{FLOWN_PARAMETERS}.", FLOWN_STATIONS)  # prefixes of engines' keys
CUSTOM_TUNING = "vehicle.control.predictor.own."  # keys of predictors of plug-ins
LIST_INDEX = re.compile(r"(?<=\.)\d+(?=\.|$)")  # index of an entry in a key


def find_key(scenario: Scenario, text: str) -> Key:
    """Return the key that a text names, with its value in ``scenario``.

    Raises InputError for a name that is no key (with the nearest ones of all), a table (with what is below it), or
    something that no study can vary.
    """
    name = text.strip()
    keys = {key.path: key for key in all_keys(scenario)}
    if name in keys:
        return keys[name]
    below = [path for path in keys if path.startswith(f"{name}.")]
    if below:
        names = list(dict.fromkeys(path.removeprefix(f"{name}.").split(".")[0] for path in below))
        raise InputError(f"{name}: is not one value but several; below it: {', '.join(names)}")
    if name == "seed":
        raise InputError("seed: every flight has one already, made from the seed of the whole")
    head = name.split(".")[0]
    if head in NOT_VARIED:
        raise InputError(f"{name}: is not a number or a choice that could be varied")
    if head in LISTS and head not in [path.split(".")[0] for path in keys]:
        raise InputError(f"{name}: scenario {scenario.name} has no [[{head}]]")
    meant = suggest_key(name) if head == "engine" or ("delay" in name and head not in Scenario.model_fields) else None
    raise InputError(f"unknown key {name!r}; {meant or _suggest_keys(name, keys)}")


def all_keys(scenario: Scenario) -> list[Key]:
    """Return every key of a scenario, its aircraft and engines: scenario first, then vehicle, engine, stations.

    Raises InputError if the aircraft or an engine is not usable.
    """
    vehicle, _ = scenario.resolved_vehicle()
    of_scenario = [
        key if key.field else replace(key, field=(Scenario, name))
        for name, field in Scenario.model_fields.items()
        for key in _scenario_keys(scenario, name, field)
    ]
    source = find_source(scenario.engine, scenario.folder)
    return [
        *of_scenario,
        *custom_keys(scenario),
        *(key for key in _table_keys("vehicle", vehicle) if not key.path.startswith(CUSTOM_TUNING)),
        *_predictor_keys(vehicle.control.predictor),
        *_parameter_keys("engine_parameters", source, scenario.engine_parameters),
        *flown_engine_keys(scenario, source, len(vehicle.jets)),
    ]


def flown_engine_keys(scenario: Scenario, source: EngineSource, jets: int) -> Iterator[Key]:
    """Yield the keys of the true engine, unknown to controllers, and those of each of ``jets`` stations."""
    flown = {**scenario.engine_parameters, **scenario.mismatch.engine_parameters}
    yield from _parameter_keys(FLOWN_PARAMETERS, source, flown)
    yield from _station_keys(scenario, source, jets)


def matching(keys: Iterable[Key], pattern: str) -> list[Key]:
    """Return the keys whose path or meaning contains ``pattern``; of one with ``*`` or ``?``, those that it matches.

    Raises InputError if there is none.
    """
    listed, word = list(keys), pattern.lower()
    if set(pattern) & set("*?"):
        selected = [key for key in listed if fnmatchcase(key.path, pattern)]
    else:
        selected = [key for key in listed if word in f"{key.path} {key.meaning}".lower()]
    if not selected:
        raise InputError(f"no key matches {pattern!r}; {_suggest_keys(pattern, [key.path for key in listed])}")
    return selected


def with_values(scenario: Scenario, values: Mapping[str, Value]) -> Scenario:
    """Return ``scenario`` without expectations, and with all ``values`` set together by key.

    Anything with a dotted path may be written, ``seed`` too.  Another aircraft comes with the engine that it is made
    for, another engine takes every station, and a ``controller`` that is a file, as ``hexjet design`` writes it, brings
    its gains.  Whether the vehicle and the engine take their values is seen when the flight is built.

    Raises InputError for a value that the scenario does not take, and for keys that cannot hold together.
    """
    values = _add_aircraft_engine(scenario, values)
    if "controller" in values:
        scenario, values = _select_parameters(scenario, values)
    _refuse_conflicting_changes(scenario, values)
    changes, values = _add_file_values(scenario, values)
    where, drawn = f"scenario {scenario.name}", dict[str, Any]()
    for path, value in values.items():
        set_path(drawn, split_key(path), value, where)
    is_new_engine = values.get("engine", scenario.engine) != scenario.engine
    kept = scenario.model_copy(update={"expect": []} | ({"stations": {}} if is_new_engine else {}))
    table = merge(kept.stated("json"), merge(changes, drawn), kept)
    return Scenario.from_table(table, scenario.folder, where, scenario.origin or scenario)


def _add_aircraft_engine(scenario: Scenario, values: Mapping[str, Value]) -> Mapping[str, Value]:
    aircraft = values.get("aircraft", scenario.aircraft)
    if aircraft == scenario.aircraft or "engine" in values:
        return values
    return {**values, "engine": engine_of(str(aircraft), scenario.folder) or scenario.engine}


def _add_file_values(scenario: Scenario, values: Mapping[str, Value]) -> tuple[dict[str, Any], Mapping[str, Value]]:
    """Return the values from a controller file, overridden by these; unchanged for a built-in controller."""
    path = str(values.get("controller", ""))
    if not is_design(path):
        return {}, values
    from cosim.simulation.controllers.controller_file import read_controller

    aircraft = str(values.get("aircraft", scenario.aircraft))
    file = read_controller(Path(path), aircraft, scenario.folder)
    step = float(values.get("step_s") or scenario.replace(aircraft=aircraft, vehicle={}).step_s)
    file.check_step(Path(path), step)
    files = parameter_files(scenario.parameter_files, "design", Path(path))
    changes: dict[str, Any] = {"vehicle": file.vehicle, "parameter_files": files}
    if file.controller_parameters:
        changes["controller_parameters"] = file.controller_parameters
    return changes, {**values, "controller": file.controller}


def custom_keys(scenario: Scenario) -> list[Key]:
    """Return the parameters of the scenario's user-supplied controller; none where user code may not run."""
    if is_design(scenario.controller):
        return []
    try:
        source = find_controller_source(
            scenario.controller, scenario.folder, f"unknown controller {scenario.controller!r}"
        )
    except CodeRefusedError:
        if is_code_forbidden():
            return []
        raise
    stated = scenario.controller_parameters
    return [
        Key(f"{CUSTOM_PARAMETERS}{p.name}", "float", stated.get(p.name, p.default), p.unit, *p[-2:], text=p.meaning)
        for p in (() if source is None else source.parameters)
    ]


def _select_parameters(scenario: Scenario, values: Mapping[str, Value]) -> tuple[Scenario, Mapping[str, Value]]:
    """Return scenario and values without parameters that the controller among the values does not have."""
    controller = str(values["controller"])
    changed = scenario.model_copy(update={"controller": controller, "controller_parameters": {}})
    names = {key.path.removeprefix(CUSTOM_PARAMETERS) for key in custom_keys(changed)}
    parameters = {name: value for name, value in scenario.controller_parameters.items() if name in names}
    changes: dict[str, Any] = {"controller_parameters": parameters}
    if controller != scenario.controller:
        changes["controller_sha256"] = None
    selected = {
        path: value
        for path, value in values.items()
        if not path.startswith(CUSTOM_PARAMETERS) or path.removeprefix(CUSTOM_PARAMETERS) in names
    }
    return scenario.model_copy(update=changes), selected


def _refuse_conflicting_changes(scenario: Scenario, values: Mapping[str, Value]) -> None:
    """Refuse to change aircraft or engine together with values meant for the scenario's own."""
    rules: list[tuple[str, str, Mapping[str, Any], tuple[str, ...]]] = [
        ("aircraft", scenario.aircraft, scenario.vehicle, ("vehicle.",)),
        ("engine", scenario.engine, scenario.engine_parameters, ENGINE_KEYS),
    ]
    for path in [key for key in values if key.startswith("stations.") and key.endswith(".engine")]:
        station = scenario.stations.get(path.split(".")[1])
        engine = (station and station.engine) or scenario.engine
        rules.append((path, engine, station.parameters if station else {}, (path.replace("engine", "parameters."),)))
    for key, nominal, changes, prefixes in rules:
        if values.get(key, nominal) == nominal:
            continue
        clash = [path for path in values if path.startswith(prefixes)]
        where = (
            clash[0] if clash else f"{prefixes[0]}{next(iter(changes))}, which the scenario states," if changes else ""
        )
        if where:
            raise InputError(
                f"{key} = {values[key]}: {where} belongs to {nominal}, and would be written over the other one; "
                f"vary one of them, or make one study for each {key}"
            )


def _scenario_keys(scenario: Scenario, name: str, field: FieldInfo) -> Iterator[Key]:
    value = getattr(scenario, name)
    if name in NOT_VARIED or name in ("controller_parameters", "vehicle", "engine_parameters", "stations"):
        return
    if name == "mismatch":
        value = value.model_copy(update={"engine_parameters": {}, "stations": {}})  # the engine has its own ones
    if name in ("aircraft", "engine", "controller"):
        yield Key(name, "choice", value, choices=tuple(_choice_names(name)))
    elif name == "sensors":
        yield Key(name, "choice", value or STATED, choices=tuple(profile_names()))
    elif name in LISTS:
        for index, entry in enumerate(value):
            for key in _table_keys(f"{name}.{index}", entry):
                yield _refine_key(key, entry, scenario)
    else:
        yield from _value_keys(name, _restore_bounds(field), value)


def _choice_names(name: str) -> list[str]:
    if name == "controller":
        return [*PREDICTORS, *(name for name, _ in custom_controllers())]
    return aircraft_names() if name == "aircraft" else list_engine_names()


def _refine_key(key: Key, entry: BaseModel, scenario: Scenario) -> Key:
    """Return a command's, disturbance's or fault's key with its grid of steps, unit, or the number of jets as bound."""
    parts = key.path.split(".")
    name, last = parts[2], parts[-1]
    if name == "jet":
        return replace(key, high=float(len(scenario.resolved_vehicle()[0].jets)))
    kind = str(getattr(entry, "kind", ""))
    if last in WHOLE_STEPS and kind not in ("table", "sticks"):
        return replace(key, grid=scenario.step_s)
    if last == "amplitude" and hasattr(entry, "signal"):
        return replace(key, unit=unit_of(entry.signal))
    return key


def _predictor_keys(tuning: PredictorTuning) -> Iterator[Key]:
    """Yield the tuning parameters of user-supplied predictors, whether the vehicle sets them or not."""
    for name, spec in PREDICTORS.items():
        values = spec.own(tuning)
        for parameter in spec.parameters:
            if parameter.name not in PredictorTuning.model_fields:
                path = f"{CUSTOM_TUNING}{name}.{parameter.name}"
                at, unit, text = values[parameter.name], parameter.unit, parameter.text
                yield Key(path, "float", at, unit, parameter.least, parameter.most, text=text)


def _table_keys(path: str, value: BaseModel) -> Iterator[Key]:
    for name, field in type(value).model_fields.items():
        for key in _value_keys(f"{path}.{name}", _restore_bounds(field), getattr(value, name)):
            yield key if key.field else replace(key, field=(type(value), name))


def _restore_bounds(field: FieldInfo) -> Any:
    """Return a field's annotation with the bounds that pydantic keeps apart from it."""
    return Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation


def _value_keys(path: str, annotation: Any, value: Any) -> Iterator[Key]:
    """Yield the keys at and below ``path``, given its value."""
    if isinstance(value, BaseModel):
        yield from _table_keys(path, value)
        return
    plain, bounds = _unwrap(annotation)
    if _is_union(plain):
        plain, bounds = _unwrap(_select_member(plain, value))
    arguments = get_args(plain)
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _value_keys(f"{path}.{name}", arguments[1] if len(arguments) == 2 else Any, item)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            inner = arguments[index] if get_origin(plain) is tuple and Ellipsis not in arguments else arguments[0]
            yield from _value_keys(f"{path}.{index}", inner, item)
    else:
        key = _scalar_key(path, plain, bounds, value)
        if key is not None:
            yield key


def _scalar_key(path: str, plain: Any, bounds: list[Any], value: Any) -> Key | None:
    """Return one value's key; None for text, tables that are not stated, and choices without names."""
    if get_origin(plain) is Literal:
        choices = get_args(plain)
        return Key(path, "choice", value, choices=choices) if len(choices) > 1 else None
    if plain is bool:
        return Key(path, "bool", value)
    if plain not in (float, int):
        return None
    key = Key(path, "int" if plain is int else "float", value, unit_of(path))
    for bound in bounds:
        if isinstance(bound, Ge):
            key = replace(key, low=float(bound.ge))  # type: ignore[arg-type]
        elif isinstance(bound, Gt):
            key = replace(key, low=float(bound.gt), open_low=True)  # type: ignore[arg-type]
        elif isinstance(bound, Le):
            key = replace(key, high=float(bound.le))  # type: ignore[arg-type]
        elif isinstance(bound, Lt):
            key = replace(key, high=float(bound.lt), open_high=True)  # type: ignore[arg-type]
    return key


def _unwrap(annotation: Any) -> tuple[Any, list[Any]]:
    """Return an annotation without its wrappings and without None, and the bounds that were in them."""
    bounds: list[Any] = []
    while True:
        if get_origin(annotation) is Annotated:
            annotation, *constraints = get_args(annotation)
            for constraint in constraints:
                bounds += constraint.metadata if isinstance(constraint, FieldInfo) else [constraint]
        elif _is_union(annotation):
            members = [member for member in get_args(annotation) if member is not type(None)]
            if len(members) != 1:
                return annotation, bounds
            annotation = members[0]
        else:
            return annotation, bounds


def _select_member(union: Any, value: Any) -> Any:
    """Return the first list or tuple type of a union if the value is one, else the first other type."""
    is_list = isinstance(value, (list, tuple))
    for member in get_args(union):
        if (get_origin(_unwrap(member)[0]) in (list, tuple)) == is_list and member is not type(None):
            return member
    return Any


def _is_union(annotation: Any) -> bool:
    from types import UnionType

    return get_origin(annotation) in (Union, UnionType)


def _parameter_keys(path: str, source: EngineSource, values: Mapping[str, float]) -> Iterator[Key]:
    """Yield the engine's parameters that the simulation does not set itself."""
    nominals = {**resolve_parameters(source, {})[0], **values}
    known = UNKNOWN_TO_CONTROLLER if path.startswith("mismatch.") else PREDICTOR_KEEPS_MODEL
    for variable in source.archive.parameters:
        if variable.name not in nominals:
            continue
        whole = variable.type in {*INTEGERS, "Boolean", "Enumeration"}
        low, high = (0.0, 1.0) if variable.type == "Boolean" else (variable.min, variable.max)
        nominal = nominals[variable.name]
        yield Key(
            f"{path}.{variable.name}",
            "int" if whole else "float",
            round(nominal) if whole else nominal,
            unit_of(variable.name) if variable.unit in (None, "", "1") else variable.unit,
            -inf if low is None else low,
            inf if high is None else high,
            text="; ".join(filter(None, (variable.description, known))),
        )


def _station_keys(scenario: Scenario, common_source: EngineSource, jets: int) -> Iterator[Key]:
    names = tuple(list_engine_names())
    for number in range(1, jets + 1):
        station = scenario.stations.get(str(number))
        engine = station.engine if station else None
        values = station.parameters if station else {}
        yield Key(f"stations.{number}.engine", "choice", engine or scenario.engine, choices=names, text="of one jet")
        common = scenario.engine_parameters if engine is None else {}
        source = find_source(engine or common_source, scenario.folder)
        known = {**common, **values}
        yield from _parameter_keys(f"stations.{number}.parameters", source, known)
        flown = scenario.mismatch.engine_parameters if engine is None else {}
        flown = {**known, **flown, **scenario.mismatch.stations.get(str(number), {})}
        yield from _parameter_keys(f"{FLOWN_STATIONS}{number}", source, flown)


def _suggest_keys(name: str, keys: Iterable[str], min_similarity: float = 0.6, max_gap: float = 0.15) -> str:
    """Return a hint with up to four keys of the highest similarity to ``name``, within ``max_gap`` of the best."""
    # Keys that differ in list indices alone are similar to the same degree, so only the first is suggested.
    by_name = {LIST_INDEX.sub("#", path): path for path in reversed(list(keys))}
    scored = sorted((-_similarity(name, path), len(path), path) for path in by_name.values())
    close = [path for score, _, path in scored[:4] if -score >= max(min_similarity, -scored[0][0] - max_gap)]
    if close:
        return f"did you mean {' or '.join([', '.join(close[:-1]), close[-1]] if len(close) > 1 else close)}?"
    return "hexjet sweep SCENARIO --keys lists all of them"


def _similarity(name: str, path: str) -> float:
    """Return the similarity, 0 to 1, of a name to a path or its last parts; list indices are ignored."""
    typed, parts = ([each for each in text.split(".") if not each.isdigit()] for text in (name, path))
    tail = parts[-len(typed) :]
    if name and len(tail) == len(typed) and all(want in part for want, part in zip(typed, tail, strict=True)):
        return 0.9 + 0.1 * len("".join(typed)) / len("".join(tail))
    texts = [".".join(tail), ".".join(parts), *(parts if len(typed) == 1 else ())]
    return max(difflib.SequenceMatcher(None, ".".join(typed), text).ratio() for text in texts)
