"""A study from the options of a command line: texts in, one checked study out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError, nearest, similar
from cosim.base.storage.paths import data_folder
from cosim.base.storage.toml import parse_setting, read_toml, validate
from cosim.base.trust import trust_named_code
from cosim.campaign.study.distributions import UNCERTAIN_KEY, parse_number, parse_vary, vary_tables
from cosim.campaign.study.engine_draw import default_draw
from cosim.campaign.study.sequential import default_runs, parse_claim
from cosim.campaign.study.study import DESIGNS, Correlation, Study, flatten_settings, study_names, vary_cases
from cosim.spec.controller_name import resolve_controller, short_name
from cosim.spec.file_kind import SCENARIO, STUDY, check_kind
from cosim.spec.scenario import Range, Scenario, scenario_names
from cosim.spec.vehicle import aircraft_seen_from, file_seen_from


class NothingVariesError(InputError):
    """Raised for a study without any varied key."""


def open_study(
    name: str | Path,
    *,
    vary: Sequence[str] = (),
    correlate: Sequence[str] = (),
    success: Sequence[str] = (),
    settings: Sequence[str] = (),
    controllers: Sequence[str] = (),
    design: str | None = None,
    runs: int | None = None,
    repeats: int | None = None,
    seed: int | None = None,
    until: str | None = None,
    nominal_engine: bool = False,
    batch: bool = False,
) -> Study:
    """Return a study, or one made from a scenario, with command-line options applied.

    ``vary``, ``correlate``, ``success`` and ``settings`` are texts; what is given for a key replaces what the study has
    for it, and ``controllers`` replace the study's.  A text of ``success`` with a parenthesis is the formula of a
    requirement.  Without a ``design`` a scenario is flown over a grid if every key
    has levels or values and no ``runs`` are given, and else over a Latin hypercube.  ``until`` is a claim such as
    ``99.9%@95%``, at which the study stops; without a ``design`` its draws are random, and without ``runs`` it has ten
    times as many as the claim needs at least; an empty one leaves out the study's.  An engine that states its
    uncertainty is drawn by it unless ``nominal_engine``.  Raises InputError.

    >>> study = open_study("hover", vary=["vehicle.mass_kg=5.4:5.8"], controllers=["smith", "baseline"], runs=3)
    >>> study.runs, study.controllers
    (3, ['smith', 'baseline'])
    """
    trust_named_code([*controllers, *settings, *vary], Path())
    data, folder, where = _read_source(name)
    listed = [_resolve_files(parse_vary(text).model_dump(mode="json", exclude_none=True)) for text in vary]
    try:
        data = dict(vary_cases(data))
        stated = vary_tables(data.get("vary", []))
    except ValueError as error:
        raise InputError(f"{where}: vary: {error}") from error
    data["vary"] = _merge_by_key(stated, listed, lambda table: table.get("key"))
    pairs = [parse_correlate(text).model_dump(mode="json") for text in correlate]
    data["correlate"] = _merge_by_key(data.get("correlate", []), pairs, lambda table: frozenset(table.get("keys", [])))
    data |= _add_success(data, success)
    data["settings"] = {
        **dict(flatten_settings(data.get("settings", {}))),
        **{".".join(path): value for path, value in map(parse_setting, settings)},
    }
    if controllers:
        data["controllers"] = [resolve_controller(controller, Path()) for controller in controllers]
    chosen = {"design": design, "runs": runs, "repeats": repeats, "seed": seed, "until": until}
    data |= {key: value for key, value in chosen.items() if value is not None}
    if until:
        parse_claim(until, "until")
    if not data.get("until"):
        data.pop("until", None)
    if "title" in data and (vary or settings or controllers or design or runs or repeats):
        data |= _retitle(data, settings, controllers)
    data |= {"nominal_engine": True} if nominal_engine else {}
    data |= {"batch": True} if batch else {}
    if _is_engine_drawn(data, folder, where):
        data["vary"] = [*data["vary"], {"key": UNCERTAIN_KEY, "uncertainty": True}]
    if not data["vary"]:
        raise NothingVariesError(f"{where}: nothing varies; vary KEY=LO:HI says what does")
    if data.get("until") is not None:
        data = {"design": "random", "runs": default_runs(str(data["until"]))} | data
    data.setdefault("design", _default_design(data))
    if data["design"] not in DESIGNS:
        raise InputError(f"design {data['design']}: {nearest(str(data['design']), DESIGNS)}")
    return Study.from_table(data, folder, where)


def _is_engine_drawn(data: Mapping[str, Any], folder: Path, where: str) -> bool:
    keys = [table.get("key", "") for table in data["vary"] if isinstance(table, dict)]
    if UNCERTAIN_KEY in keys or data.get("nominal_engine"):
        return False
    left_out = ("correlate", "controllers", "repeats", "until")
    kept = {key: value for key, value in data.items() if key not in left_out}
    study = Study.unchecked({**kept, "vary": [UNCERTAIN_KEY], "design": "random", "runs": 1}, folder, where)
    return default_draw(study.base(), False, [*keys, *study.case_keys])[0] is not None


def _add_success(data: Mapping[str, Any], texts: Sequence[str]) -> dict[str, Any]:
    """Return the conditions of a study with those of the command line, and its requirements with the formulas."""
    conditions = parse_success(text for text in texts if "(" not in text)
    spans = {metric: span.model_dump(exclude_none=True) for metric, span in conditions.items()}
    formulas = (text for text in texts if "(" in text)
    named = [{"name": f"success-{number}", "formula": text} for number, text in enumerate(formulas, 1)]
    return {"success": data.get("success", {}) | spans, "require": [*data.get("require", []), *named]}


def _retitle(data: Mapping[str, Any], settings: Sequence[str], controllers: Sequence[str]) -> dict[str, str]:
    """Return a title that names what flies, and mark the description as that of the file."""
    changes = [*settings, *([f"controllers {', '.join(map(short_name, controllers))}"] if controllers else [])]
    listed = [*changes[:3], *([f"{len(changes) - 3} more changes"] if len(changes) > 3 else [])]
    summary = ", ".join(listed) or "with options of its own"
    original = str(data.get("description", "")).strip()
    description = f"Of the study as its file states it, not of these flights: {original}" if original else ""
    return {"title": f"{data.get('name', '')}: {summary}", "description": description}


def _read_source(name: str | Path) -> tuple[dict[str, Any], Path, str]:
    """Return the table of a study's file or one that only names a scenario, its folder, and its name in messages."""
    path = Path(name)
    if path.suffix != ".toml" and not path.is_file():
        if str(name) in study_names():
            path = data_folder("studies") / f"{name}.toml"
        elif str(name) in scenario_names():
            return {"name": str(name), "scenario": str(name)}, Path(), f"scenario {name}"
        elif len(path.parts) > 1 or path.suffix or path.exists():
            raise InputError(f"{path}: no such study or scenario; a .toml file, or a name of hexjet show, is needed")
        else:
            suggestion = similar(str(name), [*study_names(), *scenario_names()])
            raise InputError(f"unknown study or scenario {str(name)!r}; {suggestion}, or give the path of a .toml file")
    if not path.is_file():
        raise InputError(f"{path}: no such study or scenario file")
    table = read_toml(path)
    if STUDY.matches(table):
        return table, path.parent, str(path)
    check_kind(table, path, SCENARIO)
    scenario = Scenario.from_table(table, path.parent, str(path))
    return {"name": scenario.name, "scenario": str(path.absolute())}, path.parent, str(path)


def _resolve_files(table: dict[str, Any]) -> dict[str, Any]:
    """Resolve aircraft and engine files of the command line against the current folder."""
    last = table["key"].split(".")[-1]
    resolve = {"aircraft": aircraft_seen_from, "engine": file_seen_from}.get(last)
    if resolve is None or "values" not in table:
        return table
    return table | {
        "values": [resolve(value, Path()) if isinstance(value, str) else value for value in table["values"]]
    }


def _default_design(data: Mapping[str, Any]) -> str:
    sides = [table for table in data["vary"] if not table.get("uncertainty")]
    discrete = all("levels" in table or "values" in table for table in sides)
    return "grid" if sides and discrete and data.get("runs") is None else "latin-hypercube"


def _merge_by_key(tables: Any, new: list[dict[str, Any]], key_of: Any) -> list[Any]:
    """Return ``tables`` with entries of ``new`` replacing those of the same key, others appended."""
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        return [tables] if new == [] else new  # validation will report what is wrong
    replaced = {key_of(table): table for table in new}
    if len(replaced) < len(new):
        return [*tables, *new]  # validation will report the duplicate
    merged = [replaced.pop(key_of(table), table) for table in tables]
    return [*merged, *replaced.values()]


def parse_correlate(text: str) -> Correlation:
    """Parse ``KEY,KEY=R``.  Raises InputError."""
    match = re.fullmatch(r"\s*([^=,\s]+)\s*,\s*([^=,\s]+)\s*=\s*(\S+)\s*", text)
    if match is None:
        raise InputError(f"correlate {text}: write it as KEY,KEY=R with the rank correlation R above -1 and below 1")
    rank = parse_number(match[3], f"correlate {text}")
    return validate(Correlation, {"keys": [match[1], match[2]], "rank": rank}, f"correlate {text}")


def parse_success(texts: Iterable[str]) -> dict[str, Range]:
    """Parse ``METRIC<=X`` and ``METRIC>=X``; both for one metric give a range.  Raises InputError."""
    success: dict[str, dict[str, float]] = {}
    for text in texts:
        match = re.fullmatch(r"\s*([^<>=\s]+)\s*(<=|>=)\s*(\S+)\s*", text)
        if match is None:
            raise InputError(
                f"success {text}: write it as METRIC<=X or METRIC>=X, or a formula as always(abs(roll_deg) < 30)"
            )
        limit = parse_number(match[3], f"success {text}")
        side = "max" if match[2] == "<=" else "min"
        if not isfinite(limit) or side in success.get(match[1], {}):
            raise InputError(f"success {text}: {'there is one already' if isfinite(limit) else 'must be finite'}")
        success.setdefault(match[1], {})[side] = limit
    empty = next((metric for metric, span in success.items() if span.get("min", -inf) > span.get("max", inf)), None)
    if empty is not None:
        raise InputError(
            f"success {empty}: nothing lies between {success[empty]['min']:g} and {success[empty]['max']:g}"
        )
    return {metric: Range(**span) for metric, span in success.items()}
