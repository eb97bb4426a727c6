"""The files that an identification leaves."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.errors import FlightError, notify
from cosim.base.storage.files import check_results_folder, holds_record, map_os_errors, write_files

if TYPE_CHECKING:
    from cosim.results.report.cards import Page

# File of every identification: a folder without it has other content, which is not overwritten.
RECORD = "identification.json"
PICTURE = "measured.svg"  # curve of an engine's README
ENGINE_FILES = ("engine.toml", "engine.fmu", "README.md", PICTURE)  # files of an identified engine
FILES = ("report.html", "response.csv", "model.toml", *ENGINE_FILES)  # other files of an identification
_NAME_BY_KIND = {"response": "response.csv", "model": "model.toml", "engine": "engine.toml", "readme": "README.md"}


def write_identification(
    folder: Path,
    record: Mapping[str, Any],
    page: Page,
    texts: Mapping[str, str],
    others: Mapping[str, str | bytes] | None = None,
    removed: Iterable[str] = ENGINE_FILES,
) -> dict[str, Path]:
    """Write ``record`` as JSON, ``texts`` by kind, ``others`` by name, and the page.

    Returns the paths by kind.  What an earlier identification left there of the files ``removed`` goes, also where none
    is left now.  Raises InputError for a folder with files of these names and without RECORD, FlightError if a file
    cannot be written.
    """
    check_results_folder(folder, RECORD, *FILES)
    if holds_record(folder / RECORD):
        notify(f"{folder}: what an earlier identification left there is replaced")
    paths = {"json": folder / RECORD, **{kind: folder / _NAME_BY_KIND[kind] for kind in texts}}
    files: dict[Path, str | bytes] = {paths["json"]: json.dumps(record, indent=2, allow_nan=False) + "\n"}
    files |= {paths[kind]: text for kind, text in texts.items()}
    files |= {folder / name: content for name, content in (others or {}).items()}
    with map_os_errors(FlightError, folder):
        for name in removed:
            (folder / name).unlink(missing_ok=True)
    write_files(files)
    paths["report"] = folder / "report.html"
    page.write(paths["report"])
    return paths
