"""A run's log in other formats: CSV and Parquet are here, others come by entry points.

``FORMAT = "module:function"`` in the group ``hexjet.exporters`` adds ``hexjet export DIR --to FORMAT``, whose files end
in ``.FORMAT``; ``"FORMAT.ENDING"`` names another ending.  The function gets a run that has a folder and the path of a
new file to write, ``function(run, path)``, and raises InputError for a run that the format cannot hold.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.plugins.entry_points import list_tools
from cosim.base.protocols import Column
from cosim.base.storage.files import one_line, replace_on_success
from cosim.results.log.arrow import write_log
from cosim.results.log.columns import COLUMNS
from cosim.results.run import LOG, RUN_FILES, Run, open_run
from cosim.results.summary import Summary

GROUP = "hexjet.exporters"  # entry points of further formats
_COLUMN_BY_NAME = {column.name: column for column in COLUMNS}  # unit and frame of the log's columns


def list_endings() -> dict[str, tuple[str, ...]]:
    """Return the endings of the files of each format that is installed, that of the default name first."""
    endings: dict[str, tuple[str, ...]] = {to: (f".{to}",) for to in _BUILT_IN}
    for entry in list_tools(GROUP):
        to, _, ending = entry.name.partition(".")
        endings[to] = (f".{ending}", f".{to}") if ending else (f".{to}",)
    return endings


def export_log(to: str, folder: Path, out: Path | None = None, **options: Any) -> Path:
    """Write the log of the run in ``folder`` as a file of a format and return its path.

    ``out`` is the file or its folder, None that of the run.  Raises InputError for what cannot be read or written.
    """
    path, run = log_path(to, folder if out is None else out), open_run(folder)
    if path.name in RUN_FILES and path.resolve().parent == folder.resolve():
        is_log, copy = (
            path.name == LOG,
            "the log is Parquet already; another file (out) is a copy that says what was flown",
        )
        raise InputError(f"{path}: {copy if is_log else 'belongs to the run itself; choose another name'}")
    write = _BUILT_IN.get(to) or next(each for each in list_tools(GROUP) if each.name.partition(".")[0] == to).load()
    try:
        with replace_on_success(path) as temporary:
            write(run, temporary, **options)
    except OSError as error:
        raise InputError(f"{path}: {one_line(error)}") from error
    except FlightError as error:
        raise InputError(f"{path}: {str(error).rpartition(': ')[2]}") from error
    return path


def log_path(to: str, out: Path) -> Path:
    """Return the file of a format in ``out``, or ``out`` itself.  Raises InputError for a wrong ending."""
    endings = list_endings()
    if to not in endings:
        raise InputError(f"export: to: {to!r}: {nearest(to, endings)}")
    if out.is_dir() or not any(out.suffix.lower() in each for each in endings.values()):
        return out / f"flight{endings[to][0]}"
    if out.suffix.lower() not in endings[to]:
        raise InputError(f"out: {out}: {to} writes {' or '.join(endings[to])}")
    return out


def export_csv(run: Run, path: Path) -> None:
    """Write every column of a run's log as CSV, each number with all its digits; missing set-points are ``nan``."""
    with open(path, "w", encoding="ascii", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run.log.columns)
        for block in run.log.blocks(run.log.columns):
            writer.writerows(zip(*(values.tolist() for values in block.values()), strict=True))


def export_parquet(run: Run, path: Path) -> None:
    """Write a run's log as Parquet, every column float64, with unit, frame and meaning in each field's metadata.

    The run's own file says the same of its columns, and nothing of the flight; this one has the run's facts in its
    metadata too, and descriptions also where an older run's file has none.  Raises FlightError.
    """
    write_log(path, describe_columns(run), run.log.blocks(run.log.columns), run_properties(run.summary))


_BUILT_IN: dict[str, Callable[..., None]] = {"csv": export_csv, "parquet": export_parquet}  # built-in formats


def run_properties(summary: Summary) -> dict[str, str]:
    """Return the metadata of a run, under names that are the same in every format."""
    return {
        "scenario": summary.scenario,
        "aircraft": summary.aircraft,
        "engine": summary.engine,
        "controller": summary.controller,
        "flown_by": summary.controller_shown,
        "seed": str(summary.seed),
        "outcome": summary.outcome,
        "reason": summary.reason,
        "verdict": summary.verdict or "",
        "started": summary.started,
        "step_s": repr(summary.step_s),
        "version": summary.versions.get("hexjet-cosim", "unknown"),
    }


def describe_columns(run: Run) -> list[Column]:
    """Return the columns of a log with unit, frame and meaning: from its file, or current ones if it has none."""
    columns = {column.name: column for column in run.log.described}
    empty = Column("", "", "", "")
    return [
        column
        if (column := columns.get(name, empty)).meaning
        else _COLUMN_BY_NAME.get(name, empty)._replace(name=name, source="")
        for name in run.log.columns
    ]
