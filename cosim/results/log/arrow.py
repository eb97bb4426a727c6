"""Arrow and Parquet: a flight's log on disk, and tables of anything else.

The only module that imports ``pyarrow``.  In a run's folder the rows go to an Arrow IPC stream, each block in one
write, so that a killed process loses at most its last block; at the end the stream becomes a Parquet file whose bytes
depend on the rows alone.

What is written goes around what makes pyarrow import pandas where that is installed (``pa.array``, ``to_numpy``): it
costs more than a short flight, and 35 MB.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Column
from cosim.base.storage.appended import AppendedFile
from cosim.base.storage.files import map_os_errors, one_line, replace_on_success, try_lock
from cosim.results.log.columns import COLUMNS, require
from cosim.results.log.tables import Columnar

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

Value = float | int | bool | str | None

ROWS_PER_GROUP = 16_384  # rows written at once: 16 MB
_END_OF_STREAM = b"\xff\xff\xff\xff\x00\x00\x00\x00"  # of the Arrow IPC streaming format


class StreamSink:
    """Appends blocks to a new Arrow IPC stream, and locks it while open.

    What the columns mean travels in the stream's metadata, and ``note``.  Raises InputError if the file exists or
    cannot be made.
    """

    def __init__(self, path: Path, note: str, columns: Sequence[Column] = COLUMNS) -> None:
        self.path = path
        with map_os_errors(InputError, path):
            self._file = AppendedFile(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND)
        try_lock(self._file.number)
        self._file.append(_make_schema(columns, note).serialize().to_pybytes())

    def write(self, table: Array) -> None:
        """Append a record batch.  Raises FlightError if it cannot be written; then nothing is."""
        numbers = np.asarray(table, "<f8").ravel()
        self._file.append(_batch_head(*table.shape), numbers.view(np.uint8).data)

    def end(self) -> None:
        """Mark the stream as complete.  Raises FlightError."""
        self._file.append(_END_OF_STREAM)

    def close(self) -> None:
        """Close the file and release the lock."""
        self._file.close()


@cache
def _batch_head(columns: int, rows: int) -> bytes:
    """Return the bytes before the columns of a record batch of this size.

    Behind it a batch of float64 without nulls is its columns, one after the other: whole multiples of 8 bytes, as Arrow
    aligns them.
    """
    import pyarrow as pa

    zeros = pa.Array.from_buffers(pa.float64(), rows, [None, pa.py_buffer(bytes(8 * rows))])
    schema = pa.schema([pa.field(str(n), pa.float64(), nullable=False) for n in range(columns)])
    message: bytes = pa.RecordBatch.from_arrays([zeros] * columns, schema=schema).serialize().to_pybytes()
    return message[: len(message) - 8 * rows * columns]


class ParquetLog(Columnar):
    """A log in a Parquet file, with columns read on demand.  Raises InputError if it cannot be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: Any = None  # the open file, or None
        with _open_parquet_or_refuse(self._path) as file:
            self.described = _columns_of_schema(file.schema_arrow)
            self.columns = tuple(file.schema_arrow.names)
            self._rows: int = file.metadata.num_rows

    def __len__(self) -> int:
        return self._rows

    def __getitem__(self, name: str) -> Array:
        values, begin = np.empty(self._rows), 0
        for block in self.blocks((name,)):  # by blocks: a third of the memory
            end = begin + block[name].size
            values[begin:end] = block[name]
            begin = end
        return values

    def blocks(self, names: tuple[str, ...], rows: int = ROWS_PER_GROUP) -> Iterator[dict[str, Array]]:
        """Yield the named columns, at most ``rows`` rows at a time."""
        chosen = [require(name, self.columns) for name in names]
        with self._open_file() as file:
            for batch in file.iter_batches(batch_size=rows, columns=chosen, use_threads=False):
                yield {name: _to_numpy(batch.column(name)) for name in names}

    @contextmanager
    def keep_open(self) -> Iterator[None]:
        if self._file is not None:
            yield
            return
        with _map_read_errors(self._path):
            file = _open_parquet(self._path)
        with file:
            self._file = file
            try:
                yield
            finally:
                self._file = None
        _return_memory()

    @contextmanager
    def _open_file(self) -> Iterator[Any]:
        with _map_read_errors(self._path), nullcontext(self._file) if self._file else _open_parquet(self._path) as file:
            yield file


def _to_numpy(column: pa.Array) -> Array:
    return np.asarray(np.from_dlpack(column), np.float64)


def read_note(stream: Path) -> str | None:
    """Return the note in a stream's metadata; None if the stream is torn before its end."""
    import pyarrow as pa

    try:
        with pa.OSFile(str(stream)) as file, pa.ipc.open_stream(file) as reader:
            return str((reader.schema.metadata or {}).get(b"note", b""), "utf-8")
    except pa.ArrowException:
        return None
    except OSError as error:
        raise InputError(f"{stream}: {one_line(error)}") from error


def stream_to_parquet(stream: Path, parquet: Path) -> int:
    """Convert every complete batch of a stream, torn or not, and return the number of rows.

    The Parquet file appears under its name only when it is complete; how the rows were cut into batches leaves no trace
    in it.  Raises FlightError if it cannot be written.
    """
    rows = _convert_stream(stream, parquet)
    _return_memory()  # frees what the conversion used
    return rows


def _convert_stream(stream: Path, parquet: Path) -> int:
    import pyarrow as pa

    rows = 0
    try:
        with (
            closing(pa.OSFile(str(stream))) as file,
            _open_stream(file) as reader,
            replace_on_success(parquet) as temporary,
            _log_writer(temporary, reader.schema.remove_metadata()) as writer,
        ):
            for table in _regroup(_complete_batches(reader)):
                writer.write_table(table, row_group_size=ROWS_PER_GROUP)
                rows += table.num_rows
    except (OSError, pa.ArrowException) as error:
        raise FlightError(f"{parquet}: {one_line(error)}") from error
    return rows


def _log_writer(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    import pyarrow.parquet as pq

    encoding = dict.fromkeys(schema.names, "BYTE_STREAM_SPLIT")
    return pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=False, column_encoding=encoding)


def _return_memory() -> None:
    """Return unused memory of Arrow and the C library to the system, some 60 MB after an hour's log."""
    import pyarrow as pa

    pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # function of glibc only
        if trim is not None:
            trim(0)


def write_log(
    path: Path, columns: Sequence[Column], blocks: Iterator[dict[str, Array]], note: Mapping[str, str]
) -> None:
    """Write a log's blocks as Parquet, with the columns' meanings and ``note`` as metadata.

    Raises FlightError if the file cannot be written.
    """
    import pyarrow as pa

    schema = _make_schema(columns).with_metadata(dict(note))
    try:
        with _log_writer(path, schema) as writer:
            for block in blocks:
                arrays = [_to_arrow(block[name]) for name in schema.names]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema), row_group_size=ROWS_PER_GROUP)
    except (OSError, pa.ArrowException) as error:
        raise FlightError(f"{path}: {one_line(error)}") from error


def _to_arrow(values: Array) -> pa.Array:
    import pyarrow as pa

    numbers = np.ascontiguousarray(values, np.float64)
    return pa.Array.from_buffers(pa.float64(), len(numbers), [None, pa.py_buffer(numbers)])


def _make_schema(columns: Sequence[Column], note: str = "") -> pa.Schema:
    import pyarrow as pa

    fields = [
        pa.field(
            c.name, pa.float64(), nullable=False, metadata={"unit": c.unit, "frame": c.frame, "meaning": c.meaning}
        )
        for c in columns
    ]
    return pa.schema(fields, metadata={"note": note})


def _columns_of_schema(schema: pa.Schema) -> tuple[Column, ...]:
    """Return the columns of a log, with unit, frame and meaning from its file."""
    columns = []
    for field in schema:
        notes = {str(key, "utf-8"): str(value, "utf-8") for key, value in (field.metadata or {}).items()}
        columns.append(Column(field.name, notes.get("unit", ""), notes.get("frame", ""), notes.get("meaning", "")))
    return tuple(columns)


def _open_stream(file: pa.OSFile) -> pa.ipc.RecordBatchStreamReader:
    """Open a stream; a stream torn before its schema counts as empty."""
    import pyarrow as pa

    try:
        return pa.ipc.open_stream(file)
    except pa.ArrowInvalid:
        return pa.ipc.open_stream(_make_schema(COLUMNS).serialize().to_pybytes() + _END_OF_STREAM)


def _complete_batches(reader: pa.ipc.RecordBatchStreamReader) -> Iterator[pa.RecordBatch]:
    """Yield the batches of a stream to its end or to where it is torn."""
    import pyarrow as pa

    while True:
        try:
            batch = reader.read_next_batch()
        except (StopIteration, pa.ArrowInvalid, OSError):
            return
        yield batch


def _regroup(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Yield the rows of record batches in tables of ROWS_PER_GROUP rows."""
    import pyarrow as pa

    waiting: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        while count + batch.num_rows >= ROWS_PER_GROUP:
            part = batch.slice(0, ROWS_PER_GROUP - count)
            batch = batch.slice(ROWS_PER_GROUP - count)
            yield pa.Table.from_batches([*waiting, part])
            waiting, count = [], 0
        if batch.num_rows:
            waiting.append(batch)
            count += batch.num_rows
    if waiting:
        yield pa.Table.from_batches(waiting)


def write_table(
    path: Path,
    columns: Mapping[str, Sequence[Value]],
    note: Mapping[str, str] | None = None,
    kinds: Mapping[str, type[Value]] | None = None,
) -> None:
    """Write columns of equal length to a Parquet file atomically, with ``note`` as metadata.

    A column is of float (64 bits), int (64 bits), bool or str: what ``kinds`` says or else what its values are.  Whole
    numbers among others are floats then, and so is nothing but None.  None and NaN stay apart.

    Raises InputError for a value that is not of its column's kind, FlightError if the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {name: _make_array(name, values, (kinds or {}).get(name)) for name, values in columns.items()}
    table = pa.table(arrays).replace_schema_metadata(dict(note or {}) or None)
    try:
        with replace_on_success(path) as temporary:
            pq.write_table(table, temporary, compression="zstd")
    except (OSError, pa.ArrowException) as error:
        raise FlightError(f"{path}: {one_line(error)}") from error


def read_table(
    paths: Path | Sequence[Path], names: Sequence[str] | None = None, lacking: bool = False
) -> dict[str, list[Value]]:
    """Return the columns of one or several files, only ``names`` if given.

    Where a file lacks a column, its rows have None; with ``lacking`` also where every file does.  Raises InputError if
    a file cannot be read, or none has a name.
    """
    columns: dict[str, list[Value]] = {}
    rows = 0
    for path in [paths] if isinstance(paths, Path) else paths:
        with _open_parquet_or_refuse(path) as file:
            names_there = file.schema_arrow.names
            table = file.read([name for name in names_there if names is None or name in names], use_threads=False)
            length = file.metadata.num_rows
        for name in names_there:
            column = columns.setdefault(name, [None] * rows)
            if name in table.column_names:
                column.extend(table.column(name).to_pylist())
        rows += length
        for values in columns.values():
            values.extend([None] * (rows - len(values)))
    if names is not None and lacking:
        return {name: columns.get(name, [None] * rows) for name in names}
    return columns if names is None else {require(name, columns, "table"): columns[name] for name in names}


class ByType(NamedTuple):
    """Columns of a table by type: numbers, NaN if missing; names of those that were times, now in seconds; texts."""

    numbers: dict[str, Array]
    times: set[str]
    texts: dict[str, list[str | None]]


def read_numbers(path: Path) -> ByType:
    """Return the columns of a Parquet file.

    Raises InputError for what cannot be read, and for two columns of one name.
    """
    with _open_parquet_or_refuse(path) as file:
        table = _map_arrow_errors(path, lambda: file.read(use_threads=False))
    return _sort_columns(path, table)


def read_csv_numbers(path: Path, rows: bytes, names: Sequence[str], separator: str, decimal: str) -> tuple[ByType, int]:
    """Return the columns of ``rows`` of text from ``path``, and how many rows have not a cell for each name."""
    import pyarrow as pa
    from pyarrow import csv

    odd = 0

    def skip_row(_: object) -> str:
        nonlocal odd
        odd += 1
        return "skip"

    options = {
        "read_options": csv.ReadOptions(column_names=names, use_threads=False, block_size=len(rows) + 1),
        "parse_options": csv.ParseOptions(delimiter=separator, invalid_row_handler=skip_row),
        "convert_options": csv.ConvertOptions(decimal_point=decimal, null_values=_NULLS, strings_can_be_null=True),
    }
    table = _map_arrow_errors(path, lambda: csv.read_csv(pa.BufferReader(rows), **options))
    return _sort_columns(path, table), odd


_NULLS = ["", "NaN", "nan", "-nan", "-NaN", "NULL", "null", "None", "N/A", "n/a", "NA", "-"]  # texts for no value


def _map_arrow_errors(path: Path, read: Callable[[], pa.Table]) -> pa.Table:
    import pyarrow as pa

    try:
        return read()
    except (OSError, UnicodeDecodeError, pa.ArrowException) as error:
        raise InputError(f"{path}: {one_line(error)}") from error


def _sort_columns(path: Path, table: pa.Table) -> ByType:
    import pyarrow as pa

    names = table.column_names
    if doubled := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{path}: two columns are called {doubled[0]!r}")
    result = ByType({}, set(), {})
    for name in names:
        column, kind, unit = table.column(name), table.column(name).type, 1.0
        if pa.types.is_timestamp(kind) or pa.types.is_time(kind):
            integer = pa.int32() if pa.types.is_time32(kind) else pa.int64()
            unit = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
            column, kind = column.cast(integer), integer
            result.times.add(name)
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or kind in (pa.bool_(), pa.null()):
            chunks = column.cast(pa.float64(), safe=False).chunks
            values = np.concatenate([np.empty(0), *map(_fill_nan, chunks)])
            result.numbers[name] = unit * np.where(np.isnan(values), np.nan, values)  # a signalling NaN would warn
        else:
            result.texts[name] = [None if value is None else str(value) for value in column.to_pylist()]
    return result


def _fill_nan(column: pa.Array) -> Array:
    """Return floats, NaN for what is missing.

    With ``fill_null`` or ``to_numpy`` pyarrow would load pandas, which takes longer than to read most tables.
    """
    import pyarrow as pa

    values = np.full(len(column), np.nan)
    values[_to_numpy(column.is_valid().cast(pa.uint8())) > 0.0] = _to_numpy(column.drop_null())
    return values


def _make_array(name: str, values: Sequence[Value], expected: type[Value] | None) -> pa.Array:
    import pyarrow as pa

    types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
    types_met = {type(value) for value in values if value is not None}
    kinds = {next((kind for kind in (bool, *types) if issubclass(kind_met, kind)), kind_met) for kind_met in types_met}
    numbers = {float, int}
    kind = expected or (next(iter(kinds)) if len(kinds) == 1 else float)
    if kind not in types or not kinds <= (numbers if kind is float else {kind}):
        kinds_there = ", ".join(sorted(kind_met.__name__ for kind_met in kinds))
        allowed = f"{kind.__name__} or None" if expected else "one of float, int, bool and str in a column, or None"
        raise InputError(f"column {name!r}: {kinds_there}; allowed: {allowed}")
    try:
        buffers = _make_buffers([kind() if value is None else value for value in values], kind)
    except OverflowError as error:
        raise InputError(f"column {name!r}: {one_line(error)}") from error
    present = np.packbits(np.array([value is not None for value in values], np.bool_), bitorder="little")
    return pa.Array.from_buffers(types[kind], len(values), [pa.py_buffer(part) for part in (present, *buffers)])


def _make_buffers(values: Sequence[Any], kind: type[Value]) -> list[bytes]:
    """Return the buffers of an Arrow array of these values, after the validity buffer."""
    if kind is str:
        texts = [value.encode() for value in values]
        ends = np.cumsum([0, *map(len, texts)])
        return [ends.astype("<i4").tobytes(), b"".join(texts)]
    if kind is bool:
        return [np.packbits(np.array(values, np.bool_), bitorder="little").tobytes()]
    return [np.array(values, "<f8" if kind is float else "<i8").tobytes()]


@contextmanager
def _open_parquet_or_refuse(path: Path) -> Iterator[Any]:
    with _map_read_errors(path), _open_parquet(path) as file:
        yield file


def _open_parquet(path: Path) -> Any:
    import pyarrow.parquet as pq

    return pq.ParquetFile(path, pre_buffer=False)


@contextmanager
def _map_read_errors(path: Path) -> Iterator[None]:
    """Convert pyarrow's errors about a file to InputError."""
    import pyarrow as pa

    try:
        yield
    except (OSError, UnicodeDecodeError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {one_line(error)}") from error
