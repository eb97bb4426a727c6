"""The index of a folder of runs, one row a run: read once, and again only where a folder has changed.

The rows are kept in ``.index.json`` of the folder, by name, with the times of the folder and of its summary: of ten
thousand runs two looks at each are left, and no file is opened.  The index may be deleted at any time.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from cosim.base.errors import InputError
from cosim.base.storage.files import map_os_errors, replace_on_success, write_whole
from cosim.campaign.folder import FLIGHTS, STUDY
from cosim.identify.logs import is_flight_log
from cosim.results.run import SUMMARY
from cosim.results.summary import ParametersRecord
from cosim.results.verdict import read_verdict
from cosim.spec.controller_name import describe_controller
from cosim.spec.file_kind import describe_path

INDEX, TAGS = ".index.json", "tags.json"
FORM = 3  # version of the index; other versions are ignored
RUN, CAMPAIGN, PAGE, UNFINISHED, LOG = "run", "campaign", "page", "unfinished", "log"
SCENARIO = "scenario.toml"
LOGS = (".ulg", ".bin", ".bbl", ".bfl", ".cfusdlog")  # suffixes of logs of other flight controllers
TAG = re.compile(r"[\w.+-]{1,40}")
SUMMARY_KEYS = ("scenario", "title", "aircraft", "engine", "controller", "started", "outcome", "verdict", "reason")


class Entry(NamedTuple):
    """One row of the index: a run, a campaign, another page, an unfinished run, or another controller's log."""

    name: str
    kind: str
    details: dict[str, str]  # such as its scenario; empty where nothing says it
    metrics: dict[str, float]  # SI, by the names of docs/metrics.md
    tags: list[str]
    page: str  # the file to look at; empty: none


class Shelf:
    """The index of a folder with runs, campaigns and whatever else leaves a page.

    Raises InputError where the folder cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: is no folder of runs; {describe_path(folder)}")
        self.folder = folder
        self._rows: dict[str, tuple[list[int], Entry]] = {}
        self._load()

    def entries(self) -> list[Entry]:
        """Return the entries of the folder now, the newest first; those that have not changed are not read again."""
        entries: dict[str, tuple[list[int], Entry]] = {}
        with map_os_errors(InputError, self.folder), os.scandir(self.folder) as items:
            folders = [item for item in items if _is_candidate(item)]
        changed = len(folders) != len(self._rows)
        for folder in folders:
            stamp = _stamp(folder)
            row = self._rows.get(folder.name)
            if row is None or row[0] != stamp:
                changed, row = True, (stamp, read_entry(Path(folder.path)))
            if row[1].kind:
                entries[folder.name] = row
            elif folder.name in self._rows:
                changed = True
        self._rows = entries
        if changed:
            self._save()
        ordered = sorted(entries.values(), key=lambda pair: pair[0][0], reverse=True)
        return [entry for _, entry in ordered]

    def path(self, name: str) -> Path:
        """Return the path of an entry.  Raises InputError for a name that is not in the index."""
        if name not in self._rows:
            raise InputError(f"{name}: is not here")
        return self.folder / name

    def tag(self, names: Iterable[str], add: Iterable[str] = (), remove: Iterable[str] = ()) -> None:
        """Add and remove tags; they are kept in the runs' own folders.  Raises InputError for a tag that is none."""
        add, remove = list(add), set(remove)
        for tag in add:
            if not TAG.fullmatch(tag):
                raise InputError(f"{tag!r} is no tag: letters, digits and . _ + -, 40 of them at most")
        for name in names:
            if self.path(name).is_file():
                raise InputError(f"{name}: is a file; tags are kept in folders")
            file = self.path(name) / TAGS
            tags = [tag for tag in dict.fromkeys([*_tags(file), *add]) if tag not in remove]
            write_whole(file, json.dumps(tags), InputError)

    def delete(self, name: str) -> None:
        """Delete a folder with all that is in it, or a log.

        Raises InputError where it is none of the entries, is a link, may still be written to, or cannot be deleted.
        """
        folder = self.path(name)
        if folder.is_symlink() or folder.parent.resolve() != self.folder.resolve():
            raise InputError(f"{name}: is a link; nothing was deleted")
        if self._rows[name][1].kind == UNFINISHED:
            raise InputError(f"{name}: has no end yet, and may still be written to; nothing was deleted")
        trash = self.folder / f".deleted-{name}"
        with map_os_errors(InputError, name):
            folder.rename(trash)  # whole or not at all, for whoever reads at the same time
            if trash.is_file():
                trash.unlink()
            else:
                shutil.rmtree(trash)
        self._rows.pop(name, None)

    def _load(self) -> None:
        with suppress(OSError, ValueError, LookupError, TypeError):
            table = json.loads((self.folder / INDEX).read_text(encoding="utf-8"))
            if table["form"] == FORM:
                self._rows = {row[1][0]: (row[0], Entry(*row[1])) for row in table["rows"]}

    def _save(self) -> None:
        rows = [[stamp, list(entry)] for stamp, entry in self._rows.values()]
        with (
            suppress(OSError),
            replace_on_success(self.folder / INDEX) as temporary,
        ):  # the folder may not be writable
            temporary.write_text(json.dumps({"form": FORM, "rows": rows}), encoding="utf-8")


def _is_candidate(entry: os.DirEntry[str]) -> bool:
    """Return whether a directory entry may be a row: a folder, or a flight controller's log, that is not hidden."""
    if entry.name[:1] == ".":
        return False
    return entry.is_dir(follow_symlinks=False) or (
        entry.is_file(follow_symlinks=False) and Path(entry.name).suffix.lower() in LOGS
    )


def _stamp(folder: os.DirEntry[str]) -> list[int]:
    """Return the modification times [ns] of a folder and of its summary, if it has one."""
    stamp = [folder.stat(follow_symlinks=False).st_mtime_ns]
    with suppress(OSError):
        stamp.append(os.stat(f"{folder.path}/{SUMMARY}").st_mtime_ns)
    return stamp


def read_entry(folder: Path) -> Entry:
    """Read the row of a folder or of a flight controller's log; its kind is empty for anything else."""
    if folder.is_file():
        began = {"started": datetime.fromtimestamp(folder.stat().st_mtime, UTC).isoformat(timespec="seconds")}
        return Entry(folder.name, LOG if is_flight_log(folder) else "", began, {}, [], "")
    page = next((name for name in ("report.html", "comparison.html", "search.html") if (folder / name).is_file()), "")
    page = page or next((path.name for path in sorted(folder.glob("[!.]*.html"))), "")
    tags = _tags(folder / TAGS)
    with suppress(OSError, ValueError):
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        if isinstance(summary, dict):
            return Entry(folder.name, RUN, _summary_details(summary), flatten_metrics(summary), tags, page)
    began = {"started": datetime.fromtimestamp(folder.stat().st_mtime, UTC).isoformat(timespec="seconds")}
    if (folder / STUDY).is_file() and (folder / FLIGHTS).is_dir():
        return Entry(folder.name, CAMPAIGN, _study(folder / STUDY) | began, {}, tags, page)
    kind = PAGE if page else UNFINISHED if (folder / SCENARIO).is_file() else ""
    return Entry(folder.name, kind, began, {}, tags, page)


def _summary_details(summary: Mapping[str, Any]) -> dict[str, str]:
    details = {name: str(summary[name]) for name in SUMMARY_KEYS if isinstance(summary.get(name), str)}
    if "verdict" in details:
        details["verdict"] = read_verdict(
            details["verdict"], summary.get("expectations_met"), summary.get("requirements_kept")
        )
    with suppress(KeyError, TypeError, ValueError):  # an older summary, or not quite one of ours
        digest = (summary.get("own_controller") or {}).get("sha256") or ""
        files = [ParametersRecord.model_validate(entry) for entry in summary.get("parameter_files") or ()]
        details["controller"] = describe_controller(details["controller"], digest, files)
    return details


def _study(path: Path) -> dict[str, str]:
    """Return title and scenario of a campaign; for a scenario file in its own folder, the name that the file states.

    A scenario over whose own file something was written has no title: what flies is another.
    """
    study = _read_head(path)
    details = {key: study[key] for key in ("title", "scenario") if isinstance(study.get(key), str)}
    if details.get("scenario") == SCENARIO:
        scenario = _read_head(path.parent / SCENARIO)
        if isinstance(scenario.get("title"), str) and not scenario.get("changed"):
            details.setdefault("title", scenario["title"])
        details["scenario"] = str(scenario.get("name", SCENARIO))
    return details


def _read_head(path: Path) -> dict[str, Any]:
    """Return what a TOML file has before its first table, all of it where that alone cannot be read; else nothing."""
    with suppress(OSError, ValueError, RecursionError):
        text = path.read_text(encoding="utf-8")
        with suppress(tomllib.TOMLDecodeError):  # a line of a text or of a list may begin like a table
            return tomllib.loads(text.partition("\n[")[0])
        return tomllib.loads(text)
    return {}


def flatten_metrics(summary: Mapping[str, Any]) -> dict[str, float]:
    """Return the metrics of a summary as ``group.name``: every number in the groups that have metrics."""
    metrics: dict[str, Any] = {}
    groups: dict[str, Any] = dict(summary.get("metrics") or {})
    groups |= {name: summary.get(name) for name in ("altitude", "position", "speed", "effort")}
    for name, group in groups.items():
        for key, value in group.items() if isinstance(group, dict) else ():
            metrics[f"{name}.{key}"] = value
    custom = summary.get("own_metrics") or {}
    metrics |= {name: summary.get(name) for name in ("touchdown_m_s", "fuel_burnt_kg", "duration_s")} | dict(custom)
    return {name: value for name, value in metrics.items() if type(value) in (int, float)}


def _tags(path: Path) -> list[str]:
    with suppress(OSError, ValueError):
        tags = json.loads(path.read_text(encoding="utf-8"))
        return [tag for tag in tags if isinstance(tag, str) and TAG.fullmatch(tag)] if isinstance(tags, list) else []
    return []
