"""The file of a study, and its named cases: settings written over its scenario, each a value of the key ``case``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from cosim.base.errors import InputError, nearest
from cosim.base.storage.paths import data_folder, files_in
from cosim.base.storage.toml import Model
from cosim.campaign.study.distributions import CASE, vary_tables


class Case(Model):
    """A named variant of a study's scenario: one value of the key ``case``."""

    name: Annotated[str, Field(min_length=1)]
    settings: dict[str, Any] = Field(default_factory=dict)  # override the scenario, its seed too
    autopilot: dict[str, Any] = Field(default_factory=dict)  # overrides the study's table [autopilot]


def vary_cases(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a study's table with the key ``case`` varied over all cases first, where ``vary`` does not name some."""
    cases = data.get("case")
    if not isinstance(cases, list) or not all(isinstance(case, Mapping) for case in cases) or not cases:
        return data
    stated = vary_tables(data.get("vary", []))
    if not isinstance(stated, list) or CASE in [each.get("key") for each in stated if isinstance(each, Mapping)]:
        return data
    return {**data, "vary": [{"key": CASE, "values": [case.get("name") for case in cases]}, *stated]}


def flatten_settings(settings: Mapping[str, Any], above: str = "") -> Iterable[tuple[str, Any]]:
    """Return nested tables as dotted keys, as the command line has them."""
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from flatten_settings(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def study_names() -> list[str]:
    """Return the name of every study that is shipped."""
    return files_in("studies")


def find_study(name: str | Path) -> Path:
    """Return the file of a study given by name or path."""
    path = Path(name)
    if path.suffix == ".toml" or path.is_file():
        if not path.is_file():
            raise InputError(f"{path}: no such study file")
        return path
    if str(name) not in study_names():
        raise InputError(f"unknown study {str(name)!r}; {nearest(str(name), study_names())}, or a path")
    return data_folder("studies") / f"{name}.toml"
