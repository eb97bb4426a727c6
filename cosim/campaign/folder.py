"""What a campaign's folder says of its study: everything that flying any of its flights again takes.

``study.toml``, ``scenario.toml`` with every number of the vehicle and the engines in it, and beside them the files that
these name: commands, controllers, engines that are not of the library.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import read_file, write_whole
from cosim.base.storage.toml import read_toml, toml_text
from cosim.base.trust import remember_written
from cosim.campaign.installed import FILES, installed_versions
from cosim.campaign.study.keys import with_values
from cosim.campaign.study.study import Study, flatten_settings
from cosim.control.predictors.registry import BASELINE
from cosim.engine import EngineSpec, find_source, load_engine
from cosim.results.expectations import allowed_metric_names
from cosim.results.requirements.stated import check_signals
from cosim.results.resolved_scenario import copy_controller, copy_vehicle, engine_files, resolve
from cosim.simulation.build import build
from cosim.simulation.controllers.source import find_controller_source
from cosim.simulation.step import Simulation
from cosim.spec.controller_name import is_design, split_file_name
from cosim.spec.scenario import Scenario, flown_parameters, list_changes
from cosim.spec.vehicle import is_aircraft_path, is_file

STUDY, SCENARIO = "study.toml", "scenario.toml"  # files in a campaign's folder
FLIGHTS, JOURNAL, REPORT, CASES, COLUMNS = "flights", "flights.jsonl", "report.html", "cases", "columns.json"
REFEREE = "referee.json"  # JSBSim's check of flights on arrays
# What the campaign was started with: study, scenario, file hashes and installed versions.
ASKED = "asked.toml"
# Keys of the record: the table of what a command adds to the study, and in it the command's name.
PLAN, COMMAND = "plan", "command"
SWEEP = "hexjet sweep"  # command if the record names none
# Keys of study and scenario that no result depends on: titles and the origin of values.
DESCRIPTIVE_KEYS = ("title", "description", "changed")
CAMPAIGN_FILES = (  # files that campaigns write
    *(STUDY, SCENARIO, ASKED, FLIGHTS, JOURNAL, REPORT, CASES, COLUMNS, REFEREE),
    *("search.toml", "search.json", "search.html", "rare.toml", "rare.json", "rare.html"),
)


@dataclass(frozen=True)
class FrozenStudy:
    """A study with all files that it needs, except the shipped aircraft and engines."""

    study: dict[str, Any]
    scenario: dict[str, Any]
    files: dict[str, bytes]
    plan: dict[str, Any] = field(default_factory=dict)  # settings of a search; empty for a sweep

    def write(self, folder: Path) -> None:
        """Write the files, the study last, so that a folder with a study is complete.  Raises OSError."""
        self.write_files(folder)
        self.write_study(folder)

    def write_files(self, folder: Path) -> None:
        """Write all files but the study.  Raises OSError."""
        for name, content in self.files.items():
            write_whole(folder / name, content)
        write_whole(folder / SCENARIO, toml_text(self.scenario).encode())
        write_whole(folder / ASKED, toml_text(self.asked | {"installed": installed_versions()}).encode())
        remember_written(folder)

    def write_study(self, folder: Path) -> None:
        """Write the study.  Raises OSError."""
        write_whole(folder / STUDY, toml_text(self.study, multiline=True).encode())

    @property
    def asked(self) -> dict[str, Any]:
        """All inputs that rows depend on, as tables, with files as hashes."""
        files = {name: sha256(content).hexdigest() for name, content in self.files.items()}
        return {STUDY: self.study, SCENARIO: self.scenario, "file": files, PLAN: self.plan}


def check_asked(folder: Path, frozen: FrozenStudy | None) -> None:
    """Raise InputError unless a folder's campaign has the same inputs as this one.

    Study, scenario and their files have to be as they were then, and what is installed; ``frozen``, if there is one,
    has to be that study, with that plan.
    """
    if not (folder / ASKED).is_file():
        raise InputError(
            f"{folder}: {ASKED} is missing, as in folders of version 0.2.0; it can be looked at, that version goes on "
            "with it, and this one flies it anew in another folder"
        )
    check_unedited(folder)
    asked = read_asked(folder)
    command = (frozen.plan if frozen else {}).get(COMMAND, SWEEP)
    if (then := asked[PLAN].get(COMMAND, SWEEP)) != command:
        raise InputError(f"{folder}: holds flights of {then}, which goes on with them; choose another folder")
    for name, value in installed_versions().items():
        if (then := asked["installed"].get(name)) != value:
            change = f"other {FILES}" if name == FILES else f"{name} was {then} and is {value}"
            raise InputError(f"{folder}: what is installed changed since its first flight: {change}")
    if frozen is not None:
        for name, was, now in _compare_records(asked, frozen.asked):
            raise InputError(f"{folder}: holds another study; {name} is {was} there and {now} here")


def check_unedited(folder: Path) -> dict[str, Any]:
    """Check that a folder's study is unedited, and return its plan: empty for a sweep, or without a record.

    Raises InputError where study, scenario or a file of theirs is not as it was at the folder's first flight.
    """
    if not (folder / ASKED).is_file():
        return {}
    asked = read_asked(folder)
    files = {name: sha256(read_file(folder / name)).hexdigest() for name in asked["file"]}
    now = {name: read_toml(folder / name) for name in (STUDY, SCENARIO)} | {"file": files, PLAN: asked[PLAN]}
    for name, was, value in _compare_records(asked, now):
        raise InputError(f"{folder}: changed since its first flight; {name} was {was} and is {value}")
    return dict(asked[PLAN])


def read_asked(folder: Path) -> dict[str, Any]:
    """Return the record of a campaign's inputs.  Raises InputError if it is invalid."""
    asked = {PLAN: {}} | read_toml(folder / ASKED)
    for name in (STUDY, SCENARIO, "file", PLAN, "installed"):
        if not isinstance(asked.get(name), dict):
            raise InputError(f"{folder / ASKED}: has no table [{name}]; it is not as it was at the first flight")
    return asked


def fingerprint(asked: Mapping[str, Any]) -> str:
    """Return the hash of the inputs that all flights of a folder share."""
    scenario = {key: value for key, value in asked[SCENARIO].items() if key not in DESCRIPTIVE_KEYS}
    judged = [asked[STUDY].get(key) for key in ("success", "autopilot", "case", "batch")]
    flown = json.dumps([scenario, asked["file"], asked["installed"], judged], sort_keys=True, default=str)
    return sha256(flown.encode()).hexdigest()


def extend_asked(folder: Path, study: Study) -> None:
    """Replace a folder's study by a longer one that begins with the same draws, and record that."""
    write_whole(folder / ASKED, toml_text(read_toml(folder / ASKED) | {STUDY: study.table()}), FlightError)
    study.save(folder / STUDY)


def _compare_records(asked: Mapping[str, Any], current: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield the differences of two records of inputs, the study's first: file, key and both values."""
    defaults = {
        name: field.get_default(call_default_factory=True)
        for name, field in Study.model_fields.items()
        if not field.is_required()
    }
    for name in (STUDY, SCENARIO, "file", PLAN):
        unstated = defaults if name == STUDY else {}
        for key, was, now in _compare_tables("", unstated | asked[name], unstated | current[name]):
            if key.partition(".")[0] not in DESCRIPTIVE_KEYS:
                yield f"{name}: {key}", _format_value(was), _format_value(now)


def freeze(study: Study, plan: Mapping[str, Any] | None = None) -> FrozenStudy:
    """Return everything that a folder needs to fly ``study``.

    Each controller is tried on the scenario, so that what cannot fly at all is found here.  Raises InputError.
    """
    base = study.base()
    for controller in study.tried:
        build(with_values(base, {"controller": controller})).close()
    with build(with_values(base, {"controller": BASELINE.name})) as simulation:
        check_signals(simulation, allowed_metric_names(base))
        resolved, sources = resolve(simulation)
        scenario = _make_scenario_table(study, resolved, simulation, sources)
    controllers = [_copy_controller(name, study.folder, sources) for name in study.controllers]
    if not study.controllers:
        scenario["controller"] = _copy_controller(base.controller, base.folder, sources)
    renamed = study.resolved(Path(SCENARIO)).changed(
        controllers=controllers,
        vary=[
            vary if vary.values is None
            else vary.model_copy(update={"values": [_copied(base, vary.key, value, sources) for value in vary.values]})
            for vary in study.vary
        ],
        case=[
            case.model_copy(update={"settings": {
                key: _copied(base, key, value, sources) for key, value in flatten_settings(case.settings)
            }})
            for case in study.case
        ],
    )  # fmt: skip
    reserved = next((name for name in sources if name in CAMPAIGN_FILES), None)
    if reserved is not None:
        raise InputError(f"scenario {base.name}: a file named {reserved!r} cannot be copied into a campaign's folder")
    files = {name: source if isinstance(source, bytes) else read_file(source) for name, source in sources.items()}
    return FrozenStudy(renamed.table(), scenario, files, dict(plan or {}))


def load(folder: Path) -> Study:
    """Load the study of a campaign's folder.  Raises InputError if there is none."""
    path = folder.absolute() / STUDY
    refuse_older_search(folder)
    if not path.is_file():
        raise InputError(f"{folder}: no campaign here ({STUDY} is missing)")
    return Study.load(path)


def is_campaign(folder: Path) -> bool:
    """Return whether a folder has the flights of a study, some or all."""
    return ((folder / STUDY).is_file() and (folder / FLIGHTS).is_dir()) or _is_older_search(folder)


def refuse_older_search(folder: Path) -> None:
    """Raise InputError for a folder in which version 0.2.0 searched."""
    if _is_older_search(folder):
        raise InputError(f"{folder}: is a search of version 0.2.0; its page shows it, and that version goes on with it")


def _is_older_search(folder: Path) -> bool:
    """Return whether the folder holds a search of version 0.2.0, which had another layout."""
    return any((folder / name).is_file() for name in ("search.toml", "rare.toml"))


def _make_scenario_table(
    study: Study, resolved: Scenario, simulation: Simulation, sources: dict[str, Path | bytes]
) -> dict[str, Any]:
    """Return the resolved scenario as a table; values of varied aircraft, engines or sensors stay unresolved."""
    base = study.base()
    data = resolved.model_dump(mode="json", exclude_none=True) | {
        "controller": base.controller if split_file_name(base.controller) is None else BASELINE.name,
        "controller_parameters": base.controller_parameters,
        "changed": list_changes(base, flown_parameters(base)),
    }
    changed = [*(vary.key for vary in study.vary), *study.case_keys]
    swapped = {key.split(".")[-1] for key in changed} & {"aircraft", "engine"}
    if swapped:
        names = engine_files([simulation.engine, *simulation.stations], sources, simulation.vehicle.identified)
        stations = {number: station.model_dump(exclude_none=True) for number, station in base.stations.items()}
        for number, station in stations.items():
            if "engine" in station:
                station["engine"] = names[id(simulation.stations[int(number) - 1])]
        engine = names[id(simulation.engine)]
        data |= {"engine": engine, "engine_parameters": base.engine_parameters, "stations": stations}
    if "sensors" in changed:
        data["vehicle"]["sensors"] = base.vehicle.get("sensors", {})
    if "aircraft" in swapped:
        data["vehicle"] = base.vehicle
        if "step_s" not in base.model_fields_set:
            del data["step_s"]
        data["substeps"] = base.step_error or base.substeps
    return data


def _copied(base: Scenario, key: str, value: Any, sources: dict[str, Path | bytes]) -> Any:
    """Return a key's value; an aircraft or engine file by the name of its copy in the campaign's folder."""
    if key == "aircraft" and isinstance(value, str) and is_aircraft_path(value):
        return copy_vehicle(value, base.folder, sources)
    if key.split(".")[-1] == "engine" and isinstance(value, str) and is_file(value):
        source, unchecked, apart = find_source(value, base.folder), base.engine_unchecked, base.engine_isolated
        spec: EngineSpec = load_engine(source, {}, base.step_s, unchecked=unchecked, isolated=apart)
        return engine_files([spec], sources, base.resolved_vehicle()[0].identified)[id(spec)]
    return value


def _copy_controller(name: str, folder: Path, sources: dict[str, Path | bytes]) -> str:
    """Return a controller's name in the campaign's folder; add the copies of its files to ``sources``."""
    if is_design(name):
        return _add_copy(folder / name, sources)
    source = find_controller_source(name, folder, f"unknown controller {name!r}")
    return name if source is None else copy_controller(source, sources)


def _add_copy(source: Path, sources: dict[str, Path | bytes]) -> str:
    """Add a file to those that are copied to the campaign's folder, and return its name there."""
    name, number = source.name, len(sources)
    while name in sources:
        name, number = f"{number}-{source.name}", number + 1
    sources[name] = source
    return name


def _compare_tables(where: str, saved: Any, current: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield the leaves in which two tables differ: dotted key and both values, None if missing."""
    saved, current = _index_by_key(saved), _index_by_key(current)
    if isinstance(saved, Mapping) and isinstance(current, Mapping):
        for key in dict.fromkeys([*current, *saved]):
            yield from _compare_tables(f"{where}.{key}" if where else key, saved.get(key), current.get(key))
    elif isinstance(saved, list) and isinstance(current, list) and len(saved) == len(current):
        for index, (saved_value, current_value) in enumerate(zip(saved, current, strict=True)):
            yield from _compare_tables(f"{where}.{index}", saved_value, current_value)
    elif saved != current:
        yield where, saved, current


def _index_by_key(value: Any) -> Any:
    """Return a list of entries with ``key`` as a table by that key; other values unchanged."""
    keyed = isinstance(value, list) and value and all(isinstance(entry, Mapping) and "key" in entry for entry in value)
    return {entry["key"]: entry for entry in value} if keyed else value


def _format_value(value: Any) -> str:
    if value is None:
        return "not stated"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
