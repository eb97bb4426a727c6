"""How a controller is named: built in, of a package, or of a file of the user's."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

_NAMED = re.compile(
    r"(?P<before>process:)(?P<program>[^ ]+)(?P<arguments>( .*)?)"
    r"|(?P<python>.+\.py)(?P<object>:[A-Za-z_]\w*)"
    r"|(?P<whole>.+\.(fmu|toml|csv))",
    re.IGNORECASE | re.DOTALL,
)


class FileName(NamedTuple):
    """A controller's name with the file in it: ``process:FILE ARGUMENTS``, ``FILE.py:Class``, ``FILE.fmu``, a table."""

    before: str
    file: str
    after: str

    @property
    def text(self) -> str:
        """The whole."""
        return self.before + self.file + self.after

    @property
    def label(self) -> str:
        """The whole with no folder, for people."""
        return self.before + Path(self.file).name + self.after

    def seen_from(self, folder: Path) -> FileName:
        """The same with a path that is valid anywhere."""
        return self._replace(file=str((folder / self.file).absolute()))


def file_name(controller: str) -> FileName | None:
    """The file in a controller's name; None: it is no file."""
    match = _NAMED.fullmatch(controller)
    if match is None:
        return None
    if match["before"]:
        return FileName("process:", match["program"], match["arguments"])
    if match["python"]:
        return FileName("", match["python"], match["object"])
    return FileName("", match["whole"], "")


def is_design(controller: str) -> bool:
    """Whether it is a file of hexjet design: gains of the built-in controller, and no mapping file of an FMU."""
    named = file_name(controller)
    if named is None or named.before or named.after:
        return False
    return named.file.lower().endswith(".toml") and not named.file.lower().endswith(".fmu.toml")


def seen_from(controller: str, folder: Path) -> str:
    """The same with an absolute path where it names a file."""
    named = file_name(controller)
    return controller if named is None else named.seen_from(folder).text


def label(controller: str) -> str:
    """What people call it: a file without its folder."""
    named = file_name(controller)
    return controller if named is None else named.label


def folder_name(controller: str) -> str:
    """The same in letters that a folder's name may have."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", label(controller)).strip("-")


def short_name(controller: str) -> str:
    """What a table has room for: a design's file without its ending, else as :func:`label`."""
    return Path(controller).stem if is_design(controller) else label(controller)
