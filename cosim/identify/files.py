"""The files that an identification leaves beside its page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cosim.base.errors import FlightError
from cosim.base.storage.files import check_results_folder, map_os_errors, write_files

RECORD = "identification.json"  # every identification leaves it: a folder without it is somebody else's
_ENGINE = ("engine.toml", "engine.fmu", "README.md")
FILES = ("report.html", "response.csv", "model.toml", *_ENGINE)


def write_identification(
    folder: Path, texts: Mapping[Path, str], archive: Path | None, remove_engine: bool = False
) -> None:
    """Write files by their paths, and where an engine is left a copy of its ``archive`` as ``engine`` in ``folder``.

    ``remove_engine``: an engine that an earlier identification left there goes, also where none is left now.  Raises
    InputError for a folder with files of these names and without RECORD, FlightError if a file cannot be read or
    written.
    """
    check_results_folder(folder, RECORD, *FILES)
    files: dict[Path, str | bytes] = dict(texts)
    if archive is not None:
        with map_os_errors(FlightError, archive):
            files[folder / f"engine{archive.suffix}"] = archive.read_bytes()  # it may be the one that goes
    if remove_engine:
        with map_os_errors(FlightError, folder):
            for name in _ENGINE:
                (folder / name).unlink(missing_ok=True)
    write_files(files)
