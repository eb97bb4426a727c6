"""The columns of a table that another tool wrote, as text or Parquet, or that a flight of ours was exported to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import one_line
from cosim.results.log.arrow import read_csv_numbers, read_numbers
from cosim.results.log.tables import TIME
from hexjet_identify.logs.text_table import is_number, parse_dates, read_text

_KINDS = {"c": "complex numbers", "U": "text", "O": "objects", "b": "truth values"}  # by numpy's letter


@dataclass
class TableColumns:
    """The columns of a table: those of numbers, and remarks on the others."""

    names: Sequence[str]  # of all, in the file's order
    numbers: dict[str, Array]
    # Names of those numbers that are dates, in seconds.
    dates: list[str] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    left_out: Sequence[str] = ()  # columns that are not numbers
    remarks: list[str] = field(default_factory=list)


def read_parquet(path: Path) -> TableColumns:
    """Read a file of Parquet.  Raises InputError."""
    read = read_numbers(path)
    numbers = {name.strip(): values for name, values in read.numbers.items()}
    columns = TableColumns(tuple(numbers), numbers, [name.strip() for name in read.times])
    _add_texts(columns, read.texts)
    return columns


def read_text_table(path: Path) -> TableColumns:
    """Read a table of text.  Raises InputError."""
    text = read_text(path)
    labels = [name or f"column_{n}" for n, name in enumerate(text.names, 1)]
    read, odd = read_csv_numbers(path, text.rows, labels, text.separator, text.decimal)
    remarks = list(text.remarks)
    if odd:
        remarks.append(f"{odd} rows have not a cell for each column, the last one perhaps cut short; left out")
    named = {name: values for name, values in read.numbers.items() if name in text.names}
    columns = TableColumns(text.names, named, list(read.times), text.units, (), remarks)
    _add_texts(columns, {name: values for name, values in read.texts.items() if name in text.names})
    return columns


def _add_texts(columns: TableColumns, texts: dict[str, list[str | None]]) -> None:
    """Add columns of texts that are dates, or mostly numbers."""
    left_out = []
    for name, values in texts.items():
        if (numeric := _parse_numbers(values)) is not None:
            columns.numbers[name], missing = numeric
            columns.remarks += [f"{name}: {missing} of {len(values)} cells are no numbers; left out"] if missing else []
        elif (dates := parse_dates(values)) is not None:
            columns.numbers[name] = np.array(dates)
            columns.dates.append(name)
        else:
            left_out.append(name)
    columns.left_out = tuple(left_out)


def _parse_numbers(values: list[str | None], min_share: float = 0.5) -> tuple[Array, int] | None:
    """Return texts as numbers, NaN for damaged ones, and their count; None below a ``min_share`` of numbers."""
    texts = [(text or "").strip() for text in values]
    good = [text for text in texts if text and is_number(text)]
    if len(good) < max(min_share * sum(map(bool, texts)), 1):
        return None
    numeric = np.array([_parse_number(text) for text in texts])
    return numeric, sum(bool(text) and not is_number(text) for text in texts)


def _parse_number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return float("nan")


def read_mcap(path: Path) -> TableColumns:
    """Read a run's log that was exported as MCAP.  Raises InputError for MCAP of another tool.

    A message of ours is one row of a channel: of each field its tag, of two bytes from the sixteenth field on, and a
    float64.  All messages of a channel are as long.
    """
    try:
        from google.protobuf.descriptor_pb2 import FileDescriptorSet
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: MCAP needs {error.name}, which is not installed: "
            "pip install mcap mcap-protobuf-support foxglove-schemas-protobuf"
        ) from None
    rows: dict[str, list[bytes]] = {}
    names: dict[str, list[str]] = {}
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if schema is None or not schema.name.startswith("hexjet."):
                    continue
                if channel.topic not in names:
                    (described,) = FileDescriptorSet.FromString(schema.data).file
                    names[channel.topic] = [field.name for field in described.message_type[0].field]
                rows.setdefault(channel.topic, []).append(message.data)
    except (McapError, ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as MCAP: {one_line(error)}") from error
    if not rows:
        raise InputError(f"{path}: is MCAP of another tool; export the flight as ULog or CSV")
    columns: dict[str, Array] = {}
    for topic, messages in rows.items():
        tags = (("u1", (1 if number < 16 else 2,)) for number in range(1, len(names[topic]) + 1))
        fields = [part for n, tag in enumerate(tags) for part in ((f"tag{n}", *tag), (f"value{n}", "<f8"))]
        kind = np.dtype(fields)
        if any(len(message) != kind.itemsize for message in messages):
            raise InputError(f"{path}: its messages are not as hexjet export writes them")
        table = np.frombuffer(b"".join(messages), kind)
        columns |= {name: table[f"value{n}"] for n, name in enumerate(names[topic])}
    return _check_export(path, {TIME: columns[TIME]} | columns)


def read_mat(path: Path) -> TableColumns:
    """Read a run's log that was exported for MATLAB.  Raises InputError for another file of MATLAB's."""
    from scipy.io import loadmat

    try:
        flight = loadmat(path, simplify_cells=True).get("flight", {})
    except NotImplementedError as error:
        raise InputError(f"{path}: cannot be read as a file of MATLAB: {one_line(error)}") from error
    if not isinstance(flight, dict) or "time" not in flight or not isinstance(flight.get("columns"), dict):
        raise InputError(f"{path}: is a file of MATLAB without a flight of ours; export it as CSV")
    names = flight["names"] if isinstance(flight.get("names"), dict) else {}
    columns = {str(names.get(name, name)): values for name, values in flight["columns"].items()}
    return _check_export(path, {TIME: flight["time"]} | columns)


def _check_export(path: Path, columns: dict[str, Any]) -> TableColumns:
    """Return the columns of an export of ours.  Raises InputError for columns that it cannot have."""
    numbers = {}
    for name, values in columns.items():
        column = np.atleast_1d(np.asarray(values))
        if column.ndim != 1 or column.dtype.kind not in "fiu":
            kind = _KINDS.get(column.dtype.kind, "no numbers") if column.ndim == 1 else f"{column.ndim}-dimensional"
            raise InputError(f"{path}: {name}: is {kind}; a flight of ours has columns of real numbers")
        numbers[name] = column.astype(np.float64)
        if len(column) != len(numbers[TIME]):
            raise InputError(f"{path}: {name}: has {len(column)} rows, and the time has {len(numbers[TIME])}")
    wrong = np.flatnonzero(~(np.diff(numbers[TIME]) > 0.0))
    if wrong.size:
        raise InputError(f"{path}: row {wrong[0] + 2}: the time must grow from row to row")
    return TableColumns(tuple(numbers), numbers)
