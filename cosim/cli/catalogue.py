"""What is shipped, by name, with a line about each."""

from __future__ import annotations

from typing import Any

from cosim.base.paths import data_folder, files_in, names_in
from cosim.base.toml import read_toml


def catalogue(kind: str) -> list[dict[str, Any]]:
    """The entries of one kind, each with ``name`` and ``title``."""
    if kind in ("scenarios", "studies"):
        return [_entry(name, read_toml(data_folder(kind) / f"{name}.toml")) for name in files_in(kind)]
    if kind == "controllers":
        from cosim.control.predictors.registry import TITLES

        return [{"name": name, "title": title} for name, title in TITLES.items()]
    marker = {"aircraft": "vehicle.toml", "engines": "engine.toml"}[kind]
    return [_entry(name, read_toml(data_folder(kind) / name / marker)) for name in names_in(kind, marker)]


def _entry(name: str, table: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "title": str(table.get("title", ""))}
