"""The files and the report of a survey of faults."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import write_records
from cosim.pages import render
from cosim.results.resolved_scenario import copy_controller
from cosim.spec.controller_name import is_design, label
from cosim.studies import write_flight
from hexjet_prove.surveys.faults import Row, Survival, summary

TEMPLATE = Path(__file__).parent / "templates" / "survival.html"


def write(result: Survival, folder: Path) -> dict[str, Path]:
    """Write ``survival.csv`` and ``survival.html``, the files of controllers, and in ``cases/`` every flight.

    Raises InputError if they cannot be written.
    """
    paths = {"table": folder / "survival.csv", "report": folder / "survival.html"}
    digits = len(str(len(result.rows)))
    try:
        rows = [
            replace(row, case=write_flight(scenario, folder, _case_name(f"{n:0{digits}d}", row)))
            for n, (row, scenario) in enumerate(zip(result.rows, result.scenarios, strict=False), 1)
        ]
        result = replace(result, rows=rows + result.rows[len(rows) :])
        write_records(paths["table"], Row, result.rows)
        controllers, lines = summary(result)
        named = [label(name) for name in controllers]
        render(TEMPLATE, paths["report"], {}, result=result, controllers=named, table=lines, where=folder.name)
        copies: dict[str, Path | bytes] = {}
        for source in result.custom_controllers:
            copy_controller(source, copies)
        copies |= {Path(name).name: Path(name) for name in controllers if is_design(name)}
        for name, path in copies.items():
            assert isinstance(path, Path)
            shutil.copyfile(path, folder / name)
    except FlightError as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    return paths


def _case_name(prefix: str, row: Row) -> str:
    return "-".join([prefix, *re.findall(r"\w+", f"{row.kind} {row.place} {row.start}")])
