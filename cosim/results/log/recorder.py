"""Recording a flight: one row of float64 a control step, handed on in blocks of one second of flight.

In a run's folder the blocks go to disk (:mod:`cosim.results.log.arrow`), so that a killed process loses at most its
last second; without a folder they stay in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from queue import Full, Queue
from threading import Thread
from typing import Any, Protocol

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import FlightError
from cosim.base.protocols import Column
from cosim.base.signals import Sample
from cosim.results._rows import Rows
from cosim.results.log.arrow import ROWS_PER_GROUP
from cosim.results.log.columns import COLUMNS, NAMES, require
from cosim.results.log.row_program import Program, program
from cosim.results.log.tables import Columnar

# Longest time for which recorded rows of a slow flight wait before they are passed to the sink.
MAX_FLUSH_INTERVAL_S = 1.0


class Sink(Protocol):
    """Receives blocks of the log, shape (columns, rows), valid only during the call."""

    def write(self, table: Array) -> None: ...


class KeepingSink(Sink, Protocol):
    """A sink that keeps all or some columns in memory."""

    def begin(self, columns: Sequence[Column]) -> None:
        """Receive the columns before the first block, by default COLUMNS.  Raises InputError."""

    def log(self) -> Log:
        """Return the rows that were kept."""


class Log(Protocol):
    """Columns of a finished flight, read on demand."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    @property
    def described(self) -> tuple[Column, ...]:
        """Columns with their meanings, if known."""

    def keys(self) -> tuple[str, ...]: ...

    def __iter__(self) -> Iterator[str]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, name: str) -> Array: ...

    def keep_open(self) -> AbstractContextManager[None]: ...

    def table(self, *names: str) -> Any: ...

    def blocks(self, names: tuple[str, ...], rows: int = ROWS_PER_GROUP) -> Iterator[dict[str, Array]]: ...


class Observe(Protocol):
    """Records one row.  Raises FlightError if a block cannot be written, TypeError for a wrong sample."""

    def __call__(self, sample: Sample, /) -> None: ...


class Recorder:
    """An observer of the control loop that makes every sample a row; ``step_s`` is the control step.

    ``columns``: of :func:`cosim.results.log.columns.log_columns`.  Raises InputError for one whose source is no place
    of a sample.
    """

    def __init__(self, step_s: float, sink: Sink, columns: Sequence[Column] = COLUMNS) -> None:
        run = program(columns)
        self._blocks = _Blocks(sink, len(columns), run)
        rows = max(1, round(1.0 / step_s))
        self._rows = Rows(rows, MAX_FLUSH_INTERVAL_S, self._blocks.write_rows, run.width, run.nodes, run.reads)
        self.observe: Observe = self._rows.add  # the method itself, for speed

    @property
    def steps(self) -> int:
        """Rows recorded so far."""
        return self._blocks.row_count + len(self._rows)

    def flush(self) -> None:
        """Pass the remaining rows on.  Raises FlightError if they cannot be written."""
        self._blocks.write_rows(self._rows)


class _Blocks:
    """Passes the rows' columns to a sink, including angles computed from others."""

    def __init__(self, sink: Sink, columns: int, run: Program) -> None:
        self._sink = sink
        self._columns, self._angles = columns, run.angles
        self.row_count = 0  # rows passed to the sink so far

    def write_rows(self, rows: Rows) -> None:
        count = len(rows)
        if count:
            memory = np.asarray(rows)[:, :count]
            table = memory[: self._columns]
            for angle in self._angles:
                table[angle.column] = angle.law(*memory[angle.first : angle.first + 4])
            self._sink.write(table)
            self.row_count += count
        rows.clear()


class MemorySink:
    """Keeps the blocks in memory: 0.25 MB a second of flight at 250 Hz."""

    def __init__(self) -> None:
        self.tables: list[Array] = []
        self.begin(COLUMNS)

    def begin(self, columns: Sequence[Column]) -> None:
        self._columns = tuple(columns)

    def write(self, table: Array) -> None:
        self.tables.append(table.copy())

    def log(self) -> Log:
        """Return the log so far; later rows are not in it."""
        return MemoryLog(list(self.tables), tuple(column.name for column in self._columns), self._columns)


class OneRow:
    """Converter of one sample to a row of the log, for programs that step a flight."""

    def __init__(self, columns: Sequence[Column] = COLUMNS) -> None:
        self._recorder = Recorder(1.0, self, columns)  # a step of 1 s makes blocks of one row
        self.names = tuple(column.name for column in columns)

    def begin(self, columns: Sequence[Column]) -> None:
        """Do nothing, as the columns are those given at the start."""

    def write(self, table: Array) -> None:
        self._table = table.copy()

    def __call__(self, sample: Sample) -> Array:
        """Return the columns of a sample, each an array of one row: shape (columns, 1)."""
        self._recorder.observe(sample)
        self._recorder.flush()
        return self._table


class BackgroundSink:
    """Writes blocks in another thread, so that a paced flight does not wait for a disk.

    What went wrong there is raised by the next :meth:`write`, or by :meth:`settle`.  ``max_blocks``: blocks, of 0.3 MB
    at 250 Hz, that may wait for a disk.
    """

    def __init__(self, sink: Sink, max_blocks: int = 60) -> None:
        self.max_blocks = max_blocks
        self._sink = sink
        self._blocks: Queue[Array | None] = Queue(self.max_blocks)
        self._error: FlightError | None = None
        self._thread = Thread(target=self._write_blocks, name="recorder", daemon=True)
        self._thread.start()

    def write(self, table: Array) -> None:
        """Queue a block.  Raises FlightError if an earlier one failed, or too many wait."""
        self._raise_stored_error()
        try:
            self._blocks.put_nowait(table.copy())
        except Full:
            raise FlightError(f"the log is {self.max_blocks} blocks behind: the disk is too slow") from None

    def settle(self) -> None:
        """Wait until all blocks are written, after which no more may be.  Raises FlightError."""
        if self._thread.is_alive():
            self._blocks.put(None)
            self._thread.join()
        self._raise_stored_error()

    def _raise_stored_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _write_blocks(self) -> None:
        while (table := self._blocks.get()) is not None:
            if self._error is None:
                try:
                    self._sink.write(table)
                except FlightError as error:
                    self._error = error


class MemoryLog(Columnar):
    """A log with its blocks in memory, each of shape (columns, rows)."""

    def __init__(
        self, tables: list[Array], columns: tuple[str, ...] = NAMES, described: tuple[Column, ...] = COLUMNS
    ) -> None:
        self.columns, self.described = columns, described
        self._indices = {name: index for index, name in enumerate(columns)}
        self._tables = tables

    def __len__(self) -> int:
        return sum(table.shape[1] for table in self._tables)

    def __getitem__(self, name: str) -> Array:
        index = self._column_index(name)
        return np.concatenate([np.empty(0), *[table[index] for table in self._tables]])

    def _column_index(self, name: str) -> int:
        if name not in self._indices:
            require(name, self.columns)
        return self._indices[name]

    def blocks(self, names: tuple[str, ...], rows: int = ROWS_PER_GROUP) -> Iterator[dict[str, Array]]:
        """Yield the named columns block by block; ``rows`` is ignored."""
        indices = [self._column_index(name) for name in names]
        for table in self._tables:
            yield {name: table[index] for name, index in zip(names, indices, strict=True)}
