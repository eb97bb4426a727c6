"""A file of parameters that a scenario's numbers come from."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cosim.base.errors import InputError
from cosim.base.storage.toml import Model


class ParameterFile(Model):
    """A file whose numbers are in ``vehicle``: a controller of ``hexjet design``, or identified models.

    A flight reads it to see that it is still the file with this hash, and which of its numbers are in effect.
    """

    kind: Literal["design", "models"]
    file: str  # from the folder of the scenario
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # of its content; another one does not fly

    def seen_from(self, folder: Path) -> ParameterFile:
        """Return the same with a path that is valid anywhere."""
        return self.model_copy(update={"file": str((folder / self.file).absolute())})


def parameter_files(known: list[ParameterFile], kind: Literal["design", "models"], path: Path) -> list[dict[str, str]]:
    """Return a scenario's parameter files, as tables, with ``path`` in the place of the one of its kind.

    Raises InputError if the file cannot be read.
    """
    entry = {"kind": kind, "file": str(path.absolute()), "sha256": sha256(read_whole(path, str(path))).hexdigest()}
    return [*(file.model_dump() for file in known if file.kind != kind), entry]


def read_whole(path: Path, where: str) -> bytes:
    """Return a file's content.  Raises InputError that begins with ``where``."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: {path}: {error.strerror or error}") from error
