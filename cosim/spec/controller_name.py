"""Names of controllers: built in, from an installed package, or from a file of the user."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

# Hexadecimal digits of a hash that are shown to tell files of one name apart.
HASH_DIGITS = 8

_FILE_PATTERN = re.compile(  # controllers that name a file
    r"(?P<before>process:)(?P<program>[^ ]+)(?P<arguments>( .*)?)"
    r"|(?P<python>.+\.py)(?P<object>:[A-Za-z_]\w*)"
    r"|(?P<whole>.+\.(fmu|toml|csv))",
    re.IGNORECASE | re.DOTALL,
)


class FlownFile(Protocol):
    """Parameter file of a flight, as :func:`describe_controller` needs it."""

    @property
    def kind(self) -> str:
        """Kind of the file: ``design`` or ``models``."""

    @property
    def file(self) -> str:
        """The file's name or path."""

    @property
    def sha256(self) -> str:
        """SHA-256 of the file's content, hexadecimal."""

    @property
    def changed(self) -> Sequence[str]:
        """Keys whose values in the flight differ from the file's."""


class FileName(NamedTuple):
    """Parts of a controller's name that has a file: ``process:FILE ARGUMENTS``, ``FILE.py:Class``, ``FILE.fmu``."""

    before: str
    file: str
    after: str

    @property
    def text(self) -> str:
        """Full name as in a scenario."""
        return self.before + self.file + self.after

    @property
    def label(self) -> str:
        """Name without the file's folder, for display."""
        return self.before + Path(self.file).name + self.after

    def resolve(self, folder: Path) -> FileName:
        """Return the name with an absolute path; a relative one is resolved against ``folder``."""
        return self._replace(file=str((folder / self.file).absolute()))


def split_file_name(controller: str) -> FileName | None:
    """Split a controller's name into file and the text around it; None if it names no file."""
    match = _FILE_PATTERN.fullmatch(controller)
    if match is None:
        return None
    if match["before"]:
        return FileName("process:", match["program"], match["arguments"])
    if match["python"]:
        return FileName("", match["python"], match["object"])
    return FileName("", match["whole"], "")


def is_design(controller: str) -> bool:
    """Return whether a name is a file of ``hexjet design`` (built-in controller gains), not an FMU mapping file."""
    named = split_file_name(controller)
    if named is None or named.before or named.after:
        return False
    return named.file.lower().endswith(".toml") and not named.file.lower().endswith(".fmu.toml")


def resolve_controller(controller: str, folder: Path) -> str:
    """Return a controller's name with its file's path, if any, made absolute; relative ones start from ``folder``."""
    named = split_file_name(controller)
    return controller if named is None else named.resolve(folder).text


def label(controller: str) -> str:
    """Return a controller's name for display: a file is shown without its folder."""
    named = split_file_name(controller)
    return controller if named is None else named.label


def folder_name(controller: str) -> str:
    """Return a controller's label with all characters but letters, digits, ``_``, ``.`` and ``-`` replaced by ``-``."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", label(controller)).strip("-")


def short_name(controller: str) -> str:
    """Return a controller's name for table cells: a design file without its suffix, else as :func:`label`."""
    return Path(controller).stem if is_design(controller) else label(controller)


def describe_file(file: str, sha256: str) -> str:
    """Return a parameter file's name without folder and suffix, followed by the first letters of its hash."""
    return f"{Path(file).stem} {sha256[:HASH_DIGITS]}"


def describe_controller(law: str, sha256: str, files: Iterable[FlownFile]) -> str:
    """Return the flown controller for display: ``my-design 1ada07e5 (smith)``, ``smith, models roll 5b0c2e11``.

    ``law`` is the controller's label and ``sha256`` the hash of its files, or empty; it is left out of a bare name.
    """
    text = f"{law} {sha256[:HASH_DIGITS]}" if sha256 and set(law) & {".", ":"} else law
    for file in files:
        words = describe_file(file.file, file.sha256) + (", changed" if file.changed else "")
        text = f"{words} ({text})" if file.kind == "design" else f"{text}, models {words}"
    return text
