"""Recording a flight: one row of float64 a control step, handed on in blocks of one second of flight.

The only module that imports ``pyarrow``.  In a run's folder the blocks go to an Arrow IPC stream, each in one write,
so that a killed process loses at most its last second; at the end the stream becomes a Parquet file whose bytes depend
on the rows alone.  Without a folder the blocks stay in memory.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from math import nan
from operator import add
from pathlib import Path
from queue import Full, Queue
from struct import Struct
from threading import Thread
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.columns import COLUMNS, NAMES
from cosim.config import nearest
from cosim.errors import FlightError, InputError
from cosim.signals import JETS, ZERO3, Sample, Vector3

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

ROW_GROUP = 16_384  # rows of Parquet written at once: 14 MB of float64
_BEHIND = 60  # blocks, of 0.3 MB at 250 Hz, that may wait for a disk
WALL_FLUSH_S = 1.0  # a slow flight is handed on this often too
_NO_JETS = [(nan,) * (JETS - jets) for jets in range(JETS + 1)]  # of a vehicle with fewer
_NO_ATTITUDE: Vector3 = (nan, nan, nan)
_EULER = NAMES.index("roll_measured_rad")  # three columns that come from the measured quaternion
_WIDTH = len(NAMES) - 3 + 4  # of a row as recorded: the quaternion at its end in place of the three angles
_END_OF_STREAM = b"\xff\xff\xff\xff\x00\x00\x00\x00"  # Arrow IPC streaming format


class Sink(Protocol):
    """Takes blocks of the log, shape (columns, rows)."""

    def write(self, table: Array) -> None: ...


class Log(Protocol):
    """The columns of a finished flight, each read when asked for."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    def __len__(self) -> int: ...

    def __getitem__(self, name: str) -> Array: ...

    def blocks(self, names: tuple[str, ...], rows: int = ROW_GROUP) -> Iterator[dict[str, Array]]: ...


class Recorder:
    """An observer of the control loop that packs every sample into a row; ``step_s`` is the control step."""

    def __init__(self, step_s: float, sink: Sink) -> None:
        self._sink = sink
        self._rows = max(1, round(1.0 / step_s))
        struct = Struct(f"<{_WIDTH}d")
        self._pack = struct.pack_into
        self._row_bytes = struct.size
        self._buffer = bytearray(self._rows * struct.size)
        self._offset = 0
        self._flushed = time.monotonic()
        self._handed_on = 0

    @property
    def steps(self) -> int:
        """Rows recorded so far."""
        return self._handed_on + self._offset // self._row_bytes

    def observe(self, sample: Sample) -> None:
        """Record one row.  Raises FlightError if a full block cannot be written."""
        _, start, command, state, measured, rate_setpoint, predicted, torque, collective, acts, tilt = sample[:11]
        (thrust, speed, temperature, flow), out, fuel, spool_moment, faults, health = sample[11:]
        position, velocity, _, euler, rate, specific_force, altitude, wind, mass, on_ground, hull_contact = state
        measured_rate, measured_attitude, measured_position, measured_velocity, measured_altitude = measured
        throttle, tilt_command, refused = acts
        none = _NO_JETS[len(throttle)]
        force, moment, torque_disturbance, _, payload, _, output, _ = out
        if output is not ZERO3:
            torque_disturbance = tuple(map(add, torque_disturbance, output))
        self._pack(
            self._buffer,
            self._offset,
            start,
            *euler,
            *(command.attitude if command.rate is None else _NO_ATTITUDE),
            *rate,
            *measured_rate,
            *predicted,
            *rate_setpoint,
            *torque,
            *refused,
            collective,
            *throttle,
            *none,
            *thrust,
            *none,
            *tilt,
            *tilt_command,
            *position,
            altitude,
            command.altitude if command.collective is None else nan,
            measured_altitude,
            *velocity,
            *measured_position,
            *measured_velocity,
            *specific_force,
            *wind,
            mass,
            on_ground,
            hull_contact,
            *force,
            *moment,
            *torque_disturbance,
            *payload,
            *speed,
            *none,
            *temperature,
            *none,
            *flow,
            *none,
            fuel,
            *spool_moment,
            *health[: len(throttle)],
            *none,
            *faults,
            *measured_attitude,
        )
        self._offset += self._row_bytes
        if self._offset == len(self._buffer) or time.monotonic() - self._flushed >= WALL_FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Hand on what is not handed on yet.  Raises FlightError if it cannot be written."""
        if self._offset:
            rows = np.frombuffer(self._buffer, dtype="<f8", count=self._offset // 8).reshape(-1, _WIDTH)
            self._sink.write(_table(rows))
            self._handed_on += len(rows)
            self._offset = 0
        self._flushed = time.monotonic()


def _table(rows: Array) -> Array:
    """Rows as packed, turned into the log's columns."""
    table = np.empty((len(NAMES), len(rows)))
    table[:_EULER] = rows[:, :_EULER].T
    table[_EULER : _EULER + 3] = euler_angles(rows[:, -4:].T)
    table[_EULER + 3 :] = rows[:, _EULER:-4].T
    return table


def euler_angles(quaternions: Array) -> Array:
    """Roll, pitch and yaw (rad), shape (3, n), of unit quaternions w, x, y, z, shape (4, n), body to NED."""
    w, x, y, z = quaternions
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack((roll, pitch, yaw))


class MemorySink:
    """Keeps the blocks in memory: 0.21 MB a second of flight at 250 Hz."""

    def __init__(self) -> None:
        self.tables: list[Array] = []

    def write(self, table: Array) -> None:
        self.tables.append(table)

    def log(self) -> Log:
        """What was recorded."""
        return MemoryLog(self.tables)


class BackgroundSink:
    """Hands blocks on in a thread of its own, so that a flight that keeps step with the clock does not wait for a disk.

    What went wrong there is raised by the next :meth:`write`, or by :meth:`settle`.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._blocks: Queue[Array | None] = Queue(_BEHIND)
        self._error: FlightError | None = None
        self._thread = Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def write(self, table: Array) -> None:
        """Raises FlightError if a block before could not be written, or too many wait."""
        self._complain()
        try:
            self._blocks.put_nowait(table)
        except Full:
            raise FlightError(f"the log is {_BEHIND} blocks behind: the disk is too slow") from None

    def settle(self) -> None:
        """Wait until everything is written; nothing may be written afterwards.  Raises FlightError."""
        if self._thread.is_alive():
            self._blocks.put(None)
            self._thread.join()
        self._complain()

    def _complain(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _work(self) -> None:
        while (table := self._blocks.get()) is not None:
            if self._error is None:
                try:
                    self._sink.write(table)
                except FlightError as error:
                    self._error = error


class StreamSink:
    """Appends the blocks to a new Arrow IPC stream, and holds a lock on it for as long as it is open.

    ``note`` travels in the stream's metadata.  Raises InputError if the file exists or cannot be made.
    """

    def __init__(self, path: Path, note: str) -> None:
        self.path = path
        self._schema = _schema(note)
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        except OSError as error:
            raise InputError(f"{path}: {one_line(error)}") from error
        _lock(self._file)
        self._size = 0
        self._append(self._schema.serialize())

    def write(self, table: Array) -> None:
        import pyarrow as pa

        batch = pa.RecordBatch.from_arrays([pa.array(column) for column in table], schema=self._schema)
        self._append(batch.serialize())

    def end(self) -> None:
        """Mark the stream as complete."""
        self._append(_END_OF_STREAM)

    def close(self) -> None:
        """Close the file and give up the lock."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _append(self, message: Any) -> None:
        rest = memoryview(message)
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError as error:
            os.ftruncate(self._file, self._size)  # half a message would hide what is written after it
            raise FlightError(f"{self.path}: {one_line(error)}") from error
        self._size += memoryview(message).nbytes


class MemoryLog:
    """A log whose blocks are in memory."""

    columns = NAMES

    def __init__(self, tables: list[Array]) -> None:
        self._tables = tables

    def __len__(self) -> int:
        return sum(table.shape[1] for table in self._tables)

    def __getitem__(self, name: str) -> Array:
        index = NAMES.index(_known(name, NAMES))
        return np.concatenate([np.empty(0), *(table[index] for table in self._tables)])

    def blocks(self, names: tuple[str, ...], rows: int = ROW_GROUP) -> Iterator[dict[str, Array]]:
        """The named columns, block by block; ``rows`` does not matter here."""
        indices = [NAMES.index(_known(name, NAMES)) for name in names]
        for table in self._tables:
            yield {name: table[index] for name, index in zip(names, indices, strict=True)}


class ParquetLog:
    """A log in a Parquet file; every column is read when it is asked for.  Raises InputError if it cannot be read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._open() as file:
            self.columns: tuple[str, ...] = tuple(file.schema_arrow.names)
            self._rows: int = file.metadata.num_rows

    def __len__(self) -> int:
        return self._rows

    def __getitem__(self, name: str) -> Array:
        with self._open() as file:
            column: Array = file.read([_known(name, self.columns)], use_threads=False).column(0).to_numpy()
        return column

    def blocks(self, names: tuple[str, ...], rows: int = ROW_GROUP) -> Iterator[dict[str, Array]]:
        """The named columns, at most ``rows`` rows at a time."""
        wanted = [_known(name, self.columns) for name in names]
        with self._open() as file:
            for batch in file.iter_batches(batch_size=rows, columns=wanted, use_threads=False):
                yield {name: batch.column(name).to_numpy() for name in names}

    @contextmanager
    def _open(self) -> Iterator[Any]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            with pq.ParquetFile(self._path, pre_buffer=False) as file:
                yield file
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{self._path}: cannot be read as Parquet: {one_line(error)}") from error


def read_note(stream: Path) -> str | None:
    """The note in a stream's metadata; None if the stream is torn before its end."""
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
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 0
    try:
        with (
            replacing(parquet) as temporary,
            pq.ParquetWriter(
                temporary,
                _schema(),
                compression="zstd",
                use_dictionary=False,
                column_encoding=dict.fromkeys(NAMES, "BYTE_STREAM_SPLIT"),
            ) as writer,
        ):
            for table in _regrouped(_complete_batches(stream)):
                writer.write_table(table, row_group_size=ROW_GROUP)
                rows += table.num_rows
    except (OSError, pa.ArrowException) as error:
        raise FlightError(f"{parquet}: {one_line(error)}") from error
    return rows


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its name if all goes well and is removed if not."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def locked(stream: Path) -> Iterator[None]:
    """Hold the lock of a leftover stream.  Raises InputError if whoever writes it is still at work."""
    try:
        file = os.open(stream, os.O_RDWR)
    except OSError as error:
        raise InputError(f"{stream}: {one_line(error)}") from error
    try:
        if not _lock(file):
            raise InputError(f"{stream.parent}: a run is still being recorded here; wait until it ends")
        yield
    finally:
        os.close(file)


def one_line(error: BaseException) -> str:
    """An error in one line; of a failed system call, what the system said."""
    said = getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]
    return str(said).rpartition("Detail: [errno ")[2].rpartition("] ")[2] if "Detail: [errno " in said else str(said)


def _lock(file: int) -> bool:
    """Try to take the file's lock, which goes when the process goes; False if another holds it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True


def _known(name: str, columns: tuple[str, ...]) -> str:
    if name not in columns:
        raise InputError(f"the log has no column {name!r}; {nearest(name, columns)}")
    return name


def _schema(note: str | None = None) -> pa.Schema:
    import pyarrow as pa

    fields = [
        pa.field(
            c.name, pa.float64(), nullable=False, metadata={"unit": c.unit, "frame": c.frame, "meaning": c.meaning}
        )
        for c in COLUMNS
    ]
    return pa.schema(fields, metadata=None if note is None else {"note": note})


def _complete_batches(stream: Path) -> Iterator[pa.RecordBatch]:
    """The batches of a stream up to its end or to the place where it is torn."""
    import pyarrow as pa

    with closing(pa.OSFile(str(stream))) as file:
        try:
            reader = pa.ipc.open_stream(file)
        except pa.ArrowInvalid:
            return
        while True:
            try:
                batch = reader.read_next_batch()
            except (StopIteration, pa.ArrowInvalid, OSError):
                return
            yield batch


def _regrouped(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """The same rows in tables of ROW_GROUP rows, the last one shorter."""
    import pyarrow as pa

    waiting: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        while count + batch.num_rows >= ROW_GROUP:
            part = batch.slice(0, ROW_GROUP - count)
            batch = batch.slice(ROW_GROUP - count)
            yield pa.Table.from_batches([*waiting, part])
            waiting, count = [], 0
        if batch.num_rows:
            waiting.append(batch)
            count += batch.num_rows
    if waiting:
        yield pa.Table.from_batches(waiting)
