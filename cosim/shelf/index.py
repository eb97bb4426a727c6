"""The entries of a folder of runs, and the page that lists them."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from cosim.base.errors import InputError
from cosim.base.storage.files import map_os_errors, parse_json, read_file, read_text
from cosim.campaign.folder import FLIGHTS, STUDY
from cosim.results.log.readers import is_flight_log
from cosim.results.run import SUMMARY
from cosim.results.summary import ParametersRecord
from cosim.spec.controller_name import describe_controller

INDEX_NAME = "index.html"  # file name of the page
TITLE_MARK = "hexjet open"  # in the title of pages written here
TEMPLATE = Path(__file__).resolve().parent / "templates" / "shelf.html"  # template of the page
RUN, CAMPAIGN, PAGE, UNFINISHED, LOG = "run", "campaign", "page", "unfinished", "log"  # kinds of rows
SCENARIO = "scenario.toml"  # if alone: a run that was not completed
LOG_ENDINGS = (".ulg", ".bin", ".bbl", ".bfl", ".cfusdlog")  # of logs of other flight controllers
SUMMARY_KEYS = ("scenario", "title", "aircraft", "engine", "controller", "started", "outcome", "verdict", "reason")


class Entry(NamedTuple):
    """One row of the index: a run, campaign, page, unfinished run or foreign log."""

    name: str
    kind: str
    details: dict[str, str]  # details such as its scenario
    metrics: dict[str, float]  # SI values by names of docs/metrics.md
    page: str  # its HTML page; empty: none


def list_entries(folder: Path) -> list[Entry]:
    """Return the entries of a folder, the newest first.  Raises InputError where the folder cannot be read."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder of runs")
    with map_os_errors(InputError, folder), os.scandir(folder) as items:
        found = sorted(filter(_is_candidate, items), key=lambda item: item.stat().st_mtime_ns, reverse=True)
    entries = [read_entry(Path(item.path)) for item in found]
    return [entry for entry in entries if entry.kind]


def write_index(folder: Path) -> Path:
    """Write ``index.html`` into a folder of runs, with a row for each of its entries, and return its path.

    Raises InputError where the folder cannot be read or has an ``index.html`` that is not ours, FlightError where the
    page cannot be written.
    """
    from markupsafe import Markup

    from cosim.results.report.cards import Card, Page

    rows = [entry._asdict() | {"page": _url(entry), "text": _make_search_text(entry)} for entry in list_entries(folder)]
    page = folder / INDEX_NAME
    if page.exists() and TITLE_MARK not in read_file(page, first=1000).decode(errors="replace"):
        raise InputError(f"{page}: was not written by hexjet open; move it, or the page would replace it")
    data = json.dumps(rows, allow_nan=False).replace("<", "\\u003c")
    content = Markup(read_text(TEMPLATE).replace("{}</script>", f"{data}</script>", 1))
    Page(TITLE_MARK, f"Runs in {folder.resolve().name}", [Card("", content=content)]).write(page)
    return page


def _url(entry: Entry) -> str:
    return f"{quote(entry.name)}/{quote(entry.page)}" if entry.page else ""


def _make_search_text(entry: Entry) -> str:
    return " ".join([entry.name, entry.kind, *entry.details.values()]).lower()


def _is_candidate(entry: os.DirEntry[str]) -> bool:
    """Return whether a directory entry may be a row: a folder, or a flight controller's log, that is not hidden."""
    if entry.name[:1] == ".":
        return False
    return entry.is_dir(follow_symlinks=False) or (
        entry.is_file(follow_symlinks=False) and Path(entry.name).suffix.lower() in LOG_ENDINGS
    )


def read_entry(folder: Path) -> Entry:
    """Read the row of a folder or of a flight controller's log; its kind is empty for anything else."""
    if folder.is_file():
        began = {"started": datetime.fromtimestamp(folder.stat().st_mtime, UTC).isoformat(timespec="seconds")}
        return Entry(folder.name, LOG if is_flight_log(folder) else "", began, {}, "")
    page = next((name for name in ("report.html", "comparison.html", "search.html") if (folder / name).is_file()), "")
    page = page or next((path.name for path in sorted(folder.glob("[!.]*.html"))), "")
    with suppress(InputError):
        summary = parse_json(read_file(folder / SUMMARY), SUMMARY, finite=False)
        if isinstance(summary, dict):
            return Entry(folder.name, RUN, _list_summary_details(summary), flatten_metrics(summary), page)
    began = {"started": datetime.fromtimestamp(folder.stat().st_mtime, UTC).isoformat(timespec="seconds")}
    if (folder / STUDY).is_file() and (folder / FLIGHTS).is_dir():
        return Entry(folder.name, CAMPAIGN, _describe_study(folder / STUDY) | began, {}, page)
    kind = PAGE if page else UNFINISHED if (folder / SCENARIO).is_file() else ""
    return Entry(folder.name, kind, began, {}, page)


def _list_summary_details(summary: Mapping[str, Any]) -> dict[str, str]:
    details = {name: str(summary[name]) for name in SUMMARY_KEYS if isinstance(summary.get(name), str)}
    with suppress(KeyError, TypeError, ValueError):  # an older or foreign summary
        digest = (summary.get("own_controller") or {}).get("sha256") or ""
        files = [ParametersRecord.model_validate(entry) for entry in summary.get("parameter_files") or ()]
        details["controller"] = describe_controller(details["controller"], digest, files)
    return details


def _describe_study(path: Path) -> dict[str, str]:
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
    """Return a TOML file's keys before its first table, or all if those cannot be parsed alone; else nothing."""
    with suppress(ValueError, RecursionError):
        text = read_text(path)
        with suppress(tomllib.TOMLDecodeError):  # a line of text may look like a table
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
    return {name: value for name, value in metrics.items() if type(value) in (int, float) and isfinite(value)}
