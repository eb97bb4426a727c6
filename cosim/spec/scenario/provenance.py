"""Provenance of a scenario's values: parameter files, and changes to the scenario's own file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.toml import merge
from cosim.spec.controller_name import HASH_DIGITS, describe_controller, label
from cosim.spec.scenario.parameter_file import ParameterFile, parse_table, read_verified
from cosim.spec.scenario.scenario import Scenario
from cosim.spec.vehicle import is_aircraft_path, is_file
from cosim.spec.vehicle.sensor_profile import load_with_profile

# Keys on how a flight is observed, evaluated or reproduced; they do not change the flight.
_NO_EFFECT_ON_FLIGHT = frozenset((
    "changed", "controller_limit_s", "controller_sha256", "description", "engine_isolated", "engine_unchecked",
    "expect", "limits", "metrics", "name", "observers", "own_sha256", "parameter_files", "seed", "title",
))  # fmt: skip


class FlownParameters(NamedTuple):
    """A parameter file as used in a flight."""

    kind: Literal["design", "models"]
    file: str  # path relative to the scenario
    sha256: str
    content: bytes
    controller: str  # controller of the design, if stated
    changed: list[str]  # keys with another value in the flight


def flown_parameters(scenario: Scenario) -> list[FlownParameters]:
    """Read a scenario's parameter files and compare their numbers with the flown ones.

    Raises InputError for a file that is missing or is another than the one whose hash is stated.
    """
    flown = []
    for index, entry in enumerate(scenario.parameter_files):
        where = f"scenario {scenario.name}: parameter_files.{index}"
        content = read_verified(entry, scenario.folder, where)
        table = parse_table(content, where)
        controller = str(table.get("controller", "")) if entry.kind == "design" else ""
        changed = [] if controller in ("", scenario.controller) else ["controller"]
        stated = table.get("vehicle") if entry.kind == "design" else {"identified": table.get("identified")}
        changed += _find_overridden_keys(scenario, stated if isinstance(stated, dict) else {})
        flown.append(FlownParameters(entry.kind, entry.file, entry.sha256, content, controller, changed))
    return flown


def controller_shown(scenario: Scenario) -> str:
    """Return a scenario's controller for display.  Raises InputError as :func:`flown_parameters`."""
    own = scenario.controller_sha256 or ""
    return describe_controller(label(scenario.controller), own, flown_parameters(scenario))


def copy_parameters(
    parameters: Sequence[FlownParameters], files: dict[str, Path | bytes], reserved: Collection[str]
) -> list[ParameterFile]:
    """Return parameter files with paths beside a resolved scenario; add their contents to ``files``.

    None gets a name that is ``reserved`` or that another file has.
    """
    entries = []
    for flown in parameters:
        first = Path(flown.file).name
        name, number = first, len(files)
        while name in reserved or files.get(name, flown.content) != flown.content:
            name, number = f"{number}-{first}", number + 1
        files[name] = flown.content
        entries.append(ParameterFile(kind=flown.kind, file=name, sha256=flown.sha256))
    return entries


def list_changes(scenario: Scenario, parameters: list[FlownParameters]) -> list[str]:
    """List changes from the scenario's file as ``key = value``, without ``parameters``.

    Aircraft, engine and controller come first, where they changed.
    """
    texts = {entry.partition(" = ")[0]: entry for entry in scenario.changed}
    if scenario.origin is not None:
        for flown in parameters:
            if flown.sha256 not in [file.sha256 for file in scenario.origin.parameter_files]:
                texts[flown.kind] = f"{flown.kind} = {Path(flown.file).name} {flown.sha256[:HASH_DIGITS]}"
        texts |= {key: f"{key} = {_to_text(value)}" for key, value in _changes(scenario, scenario.origin, parameters)}
    first = [key for key in ("aircraft", "engine", "controller") if key in texts]
    return [texts[key] for key in dict.fromkeys([*first, *texts])]


def list_differing_keys(scenario: Scenario, other: Scenario) -> list[str]:
    """List the keys whose values differ between two scenarios' flights, vehicles as flown.

    The number of JSBSim runs and the seed are none of them.
    """
    now, before = (dict(_flatten(_list_flown_keys(one))) for one in (scenario, other))
    return [key for key in dict.fromkeys([*now, *before]) if now.get(key) != before.get(key)]


def _list_flown_keys(scenario: Scenario) -> dict[str, Any]:
    """Return the values that affect the flight by key, with the complete vehicle."""
    table = _list_comparable_keys(scenario) | {"vehicle": scenario.resolved_vehicle()[0].model_dump(mode="json")}
    return {key: value for key, value in table.items() if key not in ("substeps", "step_s")} | {
        "step_s": scenario.step_s
    }


def _changes(scenario: Scenario, origin: Scenario, parameters: list[FlownParameters]) -> Iterator[tuple[str, Any]]:
    """Yield keys and values that differ from the scenario's file and are not set by a parameter file."""
    now, before = (dict(_flatten(_list_comparable_keys(one))) for one in (scenario, origin))
    kinds = {file.kind: parse_table(file.content, file.file) for file in parameters}
    design = kinds.get("design", {}).get("vehicle")
    stated = dict(_flatten(design if isinstance(design, dict) else {}, "vehicle."))
    for key in dict.fromkeys([*now, *before]):
        modelled = "models" in kinds and key.startswith("vehicle.identified.")
        if now.get(key) != before.get(key) and not modelled and stated.get(key, now) != now.get(key):
            yield from _inside(key, now.get(key), before.get(key))


def _inside(key: str, now: Any, before: Any) -> Iterator[tuple[str, Any]]:
    """Yield what differs in the entries of two lists of as many tables, such as disturbances; else the whole value."""
    entries = list(zip(now, before, strict=False)) if isinstance(now, list) and isinstance(before, list) else []
    if not entries or len(now) != len(before) or not all(isinstance(each, Mapping) for each in (*now, *before)):
        yield key, now
        return
    for number, (one, other) in enumerate(entries):
        names = [name for name in dict.fromkeys([*one, *other]) if one.get(name) != other.get(name)]
        yield from ((f"{key}.{number}.{name}", one.get(name)) for name in names)


def _list_comparable_keys(scenario: Scenario) -> dict[str, Any]:
    """Return the values that affect the flight by key, with absolute paths, so that equal files compare equal."""
    table = {key: value for key, value in scenario.stated("json").items() if key not in _NO_EFFECT_ON_FLIGHT}
    table["substeps"] = scenario.substeps
    if is_aircraft_path(scenario.aircraft):
        table["aircraft"] = str((scenario.folder / scenario.aircraft).resolve())
    if is_file(scenario.engine):
        table["engine"] = str((scenario.folder / scenario.engine).resolve())
    return table


def _find_overridden_keys(scenario: Scenario, stated: Mapping[str, Any]) -> list[str]:
    """Return the flown vehicle's keys that would change if a parameter file were merged again."""
    flown, _ = scenario.resolved_vehicle()
    try:
        again, _ = load_with_profile(
            scenario.aircraft, merge(scenario.vehicle, stated), "vehicle", scenario.folder, scenario.sensor_profile,
            scenario.step_s,
        )  # fmt: skip
    except InputError:  # for another aircraft
        return ["vehicle"]
    if again == flown:
        return []
    now, then = (dict(_flatten(one.model_dump(mode="json"))) for one in (flown, again))
    return [key for key in dict.fromkeys([*now, *then]) if now.get(key) != then.get(key)]


def _flatten(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested tables as dotted keys with their values; lists stay whole."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _to_text(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, list):
        return f"[{', '.join(map(_to_text, value))}]"
    if isinstance(value, Mapping):
        return str(value.get("kind", "..."))
    if isinstance(value, str) and "/" in value:
        return Path(value).name
    return f"{value:g}" if isinstance(value, float) else str(value)
