"""What a TOML file is, by its keys: one that is handed over for another kind is named as what it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError


class FileKind(NamedTuple):
    """A kind of file, in words, and how it is used."""

    name: str
    use: str


SCENARIO = FileKind("a scenario", "hexjet fly FILE")
DESIGN = FileKind("a controller file of hexjet design", "--controller FILE")
STUDY = FileKind("a study", "hexjet sweep FILE")
MAPPING = FileKind("the mapping file of an engine", "--engine FILE")
ENGINE = FileKind("the definition of an engine", "--engine with the engine's name")
AIRCRAFT = FileKind("an aircraft", "--aircraft with its folder")
MODELS = FileKind("a file of identified models", "--model FILE")


_ENDINGS = {  # of files that are no TOML
    ".bbl": "a log, not {}; it goes with hexjet replay FILE",
    ".bin": "a log, not {}; it goes with hexjet replay FILE",
    ".csv": "a table, not {}; it goes with hexjet replay FILE",
    ".fmu": "an FMU, not {}; it goes with --engine FILE",
    ".py": "a program, not {}; it goes with --controller FILE:CLASS",
    ".ssp": "a system of FMUs, not {}; it goes with --engine FILE",
    ".ulg": "a log, not {}; it goes with hexjet replay FILE",
}


def find_kind(table: Mapping[str, Any]) -> FileKind | None:
    """Return the kind of a file with these keys; None where they are no kind's."""
    if isinstance(table.get("design"), Mapping) and "controller" in table:
        return DESIGN
    for kind, keys in (
        (STUDY, {"scenario", "vary"}),
        (AIRCRAFT, {"jets", "inertia_kg_m2"}),
        (AIRCRAFT, {"scaled"}),
        (SCENARIO, {"duration_s"}),
        (MAPPING, {"fmu"}),
        (ENGINE, {"ports", "variables"}),
    ):
        if keys <= table.keys():
            return kind
    return MODELS if table.keys() == {"identified"} else None  # an aircraft may have some, too


def refuse_other_ending(path: Path, expected: FileKind) -> None:
    """Raise InputError where a file that should be TOML is of another kind by its ending."""
    kind = _ENDINGS.get(path.suffix.lower())
    if kind is not None:
        raise InputError(f"{path}: is {kind.format(expected.name)}")


def refuse_other_kind(table: Mapping[str, Any], path: Path, expected: FileKind) -> None:
    """Raise InputError where a file is of another kind than the one that is expected."""
    kind = find_kind(table)
    if kind is not None and kind is not expected:
        raise InputError(f"{path}: is {kind.name}, not {expected.name}; it goes with {kind.use}")
