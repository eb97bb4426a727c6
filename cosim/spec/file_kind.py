"""What a file or a folder is: one that is handed over for another kind is named as what it is."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
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
    ".ulg": "a log, not {}; it goes with hexjet replay FILE",
}


_FOLDERS = (  # by files in them; the first that has all is it
    (("proof.json",), FileKind("the folder of a proof", "hexjet prove --resume")),
    (
        ("study.toml", "flights"),
        FileKind("the folder of a campaign", "hexjet report FOLDER, or hexjet fly FOLDER --flight N"),
    ),
    (("search.json",), FileKind("the folder of a search", "hexjet search --resume")),
    (("rare.json",), FileKind("the folder of a hexjet rare", "hexjet rare --resume")),
    (("summary.json",), FileKind("the folder of a run", "hexjet show FOLDER")),
    (("controller.toml",), FileKind("the folder of a design", "--controller FOLDER/controller.toml")),
    (("margins.json",), FileKind("the folder of measured margins", "its report.html")),
    (("identification.json",), FileKind("the folder of an identification", "hexjet validate")),
    (("replay.json",), FileKind("the folder of a replay", "its report.html")),
    (("validation.json",), FileKind("the folder of a validation", "its report.html")),
    (("check.json",), FileKind("the folder of an engine's check", "its report.html")),
    (("vehicle.toml",), FileKind("the folder of an aircraft", "--aircraft FOLDER")),
    (("engine.toml",), ENGINE),
)


def describe_path(path: Path) -> str:
    """Return what is at a path and what it goes with, or that nothing is and the nearest names: a clause of a line."""
    if path.is_dir():
        kind = _folder_kind(path)
        if kind is None:
            return "it is a folder of another kind" if any(path.iterdir()) else "it is an empty folder"
        return f"it is {_with_use(kind)}"
    if path.is_file():
        from cosim.base.storage.toml import read_toml

        if (ending := _ENDINGS.get(path.suffix.lower())) is not None:
            return "it is " + ending.replace(", not {}", "")
        kind = None
        with suppress(InputError):
            kind = find_kind(read_toml(path)) if path.suffix.lower() == ".toml" else None
        if kind is not None:
            return f"it is {_with_use(kind)}"
        around = _folder_kind(path.parent)
        return "it is a file of another kind" + (f" in {path.parent}, {_with_use(around)}" if around else "")
    close = ", ".join(repr(str(other)) for other in nearest_paths(path))
    return f"nothing is there{f'; did you mean {close}?' if close else ''}"


def _folder_kind(folder: Path) -> FileKind | None:
    """Return the kind of a folder by the files in it, None for another."""
    return next((kind for marks, kind in _FOLDERS if all((folder / mark).exists() for mark in marks)), None)


def _with_use(kind: FileKind) -> str:
    """Return a kind's name, and what it goes with."""
    return f"{kind.name}; {'see' if kind.use.startswith('its ') else 'it goes with'} {kind.use}"


def nearest_paths(path: Path) -> list[Path]:
    """Return paths whose last part is like that of one that is not there: beside it, and in the folder ``runs``."""
    import difflib

    others: dict[str, Path] = {}
    for folder in (Path("runs"), path.parent):
        with suppress(OSError):
            others |= {each.name: each for each in folder.iterdir() if not each.name.startswith(".")}
    return [others[name] for name in difflib.get_close_matches(path.name, others)]


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
