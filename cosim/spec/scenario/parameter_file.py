"""Parameter files that a scenario's values come from."""

import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from cosim.base.errors import InputError
from cosim.base.storage.files import read_file
from cosim.base.storage.toml import Model

_CONTENT_CACHE: dict[tuple[str, str], bytes] = {}  # file contents by path and hash


class ParameterFile(Model):
    """Record of a file whose values were merged into ``vehicle``: a designed controller, or identified models.

    A flight reads it to see that it is still the file with this hash, and which of its numbers are in effect.
    """

    kind: Literal["design", "models"]
    file: str  # path relative to the scenario
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]  # of its content, which must match to fly

    def resolve(self, folder: Path) -> Self:
        """Return the record with an absolute path; a relative one is resolved against ``folder``."""
        return self.model_copy(update={"file": str((folder / self.file).absolute())})


def parameter_files(known: list[ParameterFile], kind: Literal["design", "models"], path: Path) -> list[dict[str, str]]:
    """Return the records of a scenario's parameter files as tables, with ``path`` as the one of its kind.

    Raises InputError if the file cannot be read.
    """
    content = read_whole(path, str(path))
    entry = {"kind": kind, "file": str(path.absolute()), "sha256": sha256(content).hexdigest()}
    _CONTENT_CACHE[entry["file"], entry["sha256"]] = content
    return [*(file.model_dump() for file in known if file.kind != kind), entry]


def read_verified(entry: ParameterFile, folder: Path, where: str) -> bytes:
    """Return the content of a parameter file after checking its hash.

    Content that this process has read before is returned unchanged, even if the file was overwritten since, so that a
    session goes on with it.  Raises InputError that begins with ``where`` for a file that is missing or another one.
    """
    path = folder / entry.file
    content = _CONTENT_CACHE.get((str(path.absolute()), entry.sha256))
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
