"""Parameter files that a scenario's values come from."""

import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from cosim.base.errors import InputError
from cosim.base.storage.files import read_file
from cosim.base.storage.toml import Model

_CONTENTS: dict[tuple[str, str], bytes] = {}  # file contents by path and hash


class ParameterFile(Model):
    """File whose numbers are in ``vehicle``: a designed controller, or identified models.

    A flight reads it to see that it is still the file with this hash, and which of its numbers are in effect.
    """

    kind: Literal["design", "models"]
    file: str  # path relative to the scenario
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # of its content, which must match to fly

    def seen_from(self, folder: Path) -> Self:
        """Return the same with a path that is valid anywhere."""
        return self.model_copy(update={"file": str((folder / self.file).absolute())})


def parameter_files(known: list[ParameterFile], kind: Literal["design", "models"], path: Path) -> list[dict[str, str]]:
    """Return a scenario's parameter files as tables, with ``path`` replacing the one of its kind.

    Raises InputError if the file cannot be read.
    """
    content = read_whole(path, str(path))
    entry = {"kind": kind, "file": str(path.absolute()), "sha256": sha256(content).hexdigest()}
    _CONTENTS[entry["file"], entry["sha256"]] = content
    return [*(file.model_dump() for file in known if file.kind != kind), entry]


def read_verified(entry: ParameterFile, folder: Path, where: str) -> bytes:
    """Return the content of a parameter file after checking its hash.

    Content that this process has read before is returned unchanged, even if the file was overwritten since, so that a
    session goes on with it.  Raises InputError that begins with ``where`` for a file that is missing or another one.
    """
    path = folder / entry.file
    content = _CONTENTS.get((str(path.absolute()), entry.sha256))
    if content is not None:
        return content
    content = read_whole(path, where)
    found = sha256(content).hexdigest()
    if found != entry.sha256:
        raise InputError(f"{where}: {path}: is another file (SHA-256 {found[:12]}) than stated ({entry.sha256[:12]})")
    return content


def read_whole(path: Path, where: str) -> bytes:
    """Return a file's content.  Raises InputError that begins with ``where``."""
    try:
        return read_file(path)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def parse_table(content: bytes, where: str) -> dict[str, Any]:
    """Parse a parameter file.  Raises InputError that begins with ``where``."""
    try:
        return tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not valid TOML: {str(error).splitlines()[0]}") from error
