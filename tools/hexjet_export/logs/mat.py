"""A run's log as a MAT-file of level 5, for MATLAB and what reads its files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from cosim import InputError, Run
from cosim.logs import describe_columns, run_properties
from hexjet_export.logs.contents import log_lines, read_pilot

# Names that a field of a MATLAB structure may not have (MATLAB's iskeyword).
_KEYWORDS = {
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while",
}  # fmt: skip


def export_mat(run: Run, path: Path, max_values: int = 2**31) -> None:
    """Write a run's log as MAT with one structure, ``flight``.

    ``flight.time`` [s] and each of ``flight.columns`` are columns of doubles, one row a control step, NaN where the log
    has NaN.  ``flight.units``, ``flight.frames`` and ``flight.meanings`` have a text under the same name,
    ``flight.names`` the column's name in the log where MATLAB cannot have it.  ``flight.events`` has times, severities
    (as in syslog), kinds and texts; ``flight.metrics`` and ``flight.metadata`` are of the whole flight.  Raises
    InputError if there is no run, the file cannot be written, or the log is longer than such a file can hold.
    ``max_values``: what MATLAB reads of a variable in a file of level 5.
    """
    from scipy.io import savemat

    names = fields(run.log.columns)
    rows = len(run.log)
    if 8 * rows * (len(names) + 1) >= max_values:
        raise InputError(f"{run.folder}: {rows} rows are more than a MAT-file of level 5 holds; take mcap or csv")
    columns = {name: np.zeros((rows, 1)) for name in names.values()}
    first = 0
    for block in run.log.blocks(run.log.columns):
        count = len(next(iter(block.values())))
        for name, values in block.items():
            columns[names[name]][first : first + count, 0] = values
        first += count
    events = log_lines(run, read_pilot(run))
    descriptions = describe_columns(run)
    metrics = {name: value for name, value in run.summary.flat_metrics.items() if value is not None}
    flight: dict[str, Any] = {
        "time": columns[names["time_s"]],
        "columns": columns,
        "units": {names[column.name]: column.unit for column in descriptions},
        "frames": {names[column.name]: column.frame for column in descriptions},
        "meanings": {names[column.name]: column.meaning for column in descriptions},
        "names": {field: name for name, field in names.items() if field != name},
        "events": {
            "time": np.array([[event.time_s] for event in events]),
            "severity": np.array([[float(event.severity)] for event in events]),
            "kind": _make_cell_column([event.kind for event in events]),
            "text": _make_cell_column([event.text for event in events]),
        },
        "metrics": {field: metrics[name] for name, field in fields(tuple(metrics)).items()},
        "metadata": run_properties(run.summary),
    }
    flight = {name: part for name, part in flight.items() if not (isinstance(part, dict) and not part)}
    with open(path, "wb") as file:
        savemat(file, {"flight": flight}, long_field_names=True, do_compression=True, oned_as="column")


def fields(names: tuple[str, ...], max_length: int = 63) -> dict[str, str]:
    """Return a valid and unique field name of a MATLAB structure for each name: at most 63 letters, digits and _.

    ``max_length``: MATLAB's namelengthmax.
    """
    short_names: dict[str, str] = {}
    taken = set(names)
    for name in names:
        field = re.sub(r"\W", "_", name, flags=re.ASCII)
        if not field[:1].isalpha() or field in _KEYWORDS:
            field = f"x{field}"
        field = field[:max_length]
        number = 1
        while field != name and field in taken:
            number += 1
            field = f"{field[: max_length - len(str(number)) - 1]}_{number}"
        taken.add(field)
        short_names[name] = field
    return short_names


def _make_cell_column(texts: list[str]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return a column of MATLAB cells, each with a text."""
    cells = np.empty((len(texts), 1), dtype=object)
    cells[:, 0] = texts
    return cells
