"""How a controller is named: built in, of a package, or of a file of the user's."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

SHORT = 8  # letters of a hash that tell two files of one name apart for people

_NAMED = re.compile(
    r"(?P<before>process:)(?P<program>[^ ]+)(?P<arguments>( .*)?)"
    r"|(?P<python>.+\.py)(?P<object>:[A-Za-z_]\w*)"
    r"|(?P<whole>.+\.(fmu|toml|csv))",
    re.IGNORECASE | re.DOTALL,
)


class FlownFile(Protocol):
    """What :func:`controller_words` needs of a parameter file that flew."""

    @property
    def kind(self) -> str:
        """Return design or models."""

    @property
    def file(self) -> str:
        """Return its name."""

    @property
    def sha256(self) -> str:
        """Return the hash of its content."""

    @property
    def changed(self) -> Sequence[str]:
        """Return the keys whose values in the flight are not the file's."""


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


def file_words(file: str, sha256: str) -> str:
    """Return a parameter file without its folder and ending, with the first letters of its hash."""
    return f"{Path(file).stem} {sha256[:SHORT]}"


def controller_words(law: str, sha256: str, files: Iterable[FlownFile]) -> str:
    """Return who flies, for people: ``my-design 1ada07e5 (smith)``, ``smith, models roll 5b0c2e11``, a file and hash.

    ``law`` is the controller's label and ``sha256`` the hash of its files, or empty; it is left out of a bare name.
    """
    text = f"{law} {sha256[:SHORT]}" if sha256 and set(law) & {".", ":"} else law
    for each in files:
        words = file_words(each.file, each.sha256) + (", changed" if each.changed else "")
        text = f"{words} ({text})" if each.kind == "design" else f"{text}, models {words}"
    return text
