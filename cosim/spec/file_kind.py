"""Required keys of each kind of file, to tell the user which kind was expected."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError


class FileKind(NamedTuple):
    """Kind of TOML file: its name in words, and keys one of which every such file has."""

    name: str
    keys: tuple[str, ...]

    def matches(self, table: Mapping[str, Any]) -> bool:
        return any(key in table for key in self.keys)


SCENARIO = FileKind("a scenario", ("duration_s",))  # only scenarios have this key
DESIGN = FileKind("a controller file of hexjet design", ("design",))
STUDY = FileKind("a study", ("vary", "scenario"))
AIRCRAFT = FileKind("an aircraft", ("jets", "scaled"))
MODELS = FileKind("a file of identified models", ("identified",))
MAPPING = FileKind("the mapping file of an engine", ("fmu",))


def check_kind(table: Mapping[str, Any], path: Path, expected: FileKind) -> None:
    """Raise InputError if a file's table is not of the expected kind."""
    if not expected.matches(table):
        raise InputError(f"{path}: is not {expected.name}, which has the key {' or '.join(expected.keys)}")
