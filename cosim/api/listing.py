"""The names of what can be flown: what ``hexjet show`` lists."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, get_args

from cosim.api.call import Result
from cosim.base.storage.paths import data_folder, files_in, names_in

Kind = Literal["scenarios", "studies", "engines", "aircraft", "controllers"]
KINDS = get_args(Kind)  # kinds that hexjet show lists


class CatalogueResult(Result):
    """Names of what can be flown; ``catalogues`` has by kind a list of entries with ``name`` and ``title``."""

    def __init__(self, kinds: Iterable[str]) -> None:
        self.catalogues = {kind: catalogue(kind) for kind in kinds}
        self.files = {}

    def to_dict(self) -> dict[str, Any]:
        """Return the entries by their kind."""
        return dict(self.catalogues)

    def lines(self) -> list[str]:
        """Return a heading for each kind, and a line for each entry."""
        lines = []
        for kind, entries in self.catalogues.items():
            width = max((len(entry["name"]) for entry in entries), default=0)
            lines += [kind, *(f"  {entry['name']:{width}}  {entry['title']}" for entry in entries)]
        return lines


def catalogue(kind: str) -> list[dict[str, Any]]:
    """Return the entries of one kind, each with ``name`` and ``title``."""
    if kind in ("scenarios", "studies"):
        return [_make_entry(name, data_folder(kind) / f"{name}.toml") for name in files_in(kind)]
    if kind == "controllers":
        from cosim.control.predictors.registry import PREDICTORS
        from cosim.simulation.controllers.source import list_installed as custom_controllers

        built_in = [{"name": spec.name, "title": spec.title} for spec in PREDICTORS.values()]
        return built_in + [{"name": name, "title": title} for name, title in custom_controllers()]
    marker = {"aircraft": "vehicle.toml", "engines": "engine.toml"}[kind]
    return [_make_entry(name, data_folder(kind) / name / marker) for name in names_in(kind, marker)]


def _make_entry(name: str, path: Path) -> dict[str, Any]:
    """Return the name and the title in the TOML file of a library entry."""
    from cosim.base.storage.toml import read_toml

    return {"name": name, "title": str(read_toml(path).get("title", ""))}
