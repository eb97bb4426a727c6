"""The process that reads a log of somebody else: what it does, and what it is asked.

What reads a format, ours or of a library, may crash, never end or ask for all memory over a damaged file.  So it runs
in a process of its own with limits, which answers on its standard output: a line of JSON with the lengths of all
arrays, a line of JSON with what was read, in which an array is its number, and the arrays as doubles.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.runtime.host import HostError, run_code
from cosim.base.storage.files import one_line
from hexjet_identify.logs.flight_log import Channel, FlightLog
from hexjet_identify.logs.table_columns import TableColumns

# Limits of processor time [s], ten times that of the slowest reader, pyulog.
MAX_CPU_S, MAX_CPU_S_PER_MB = 20.0, 3.0
# Limits of address space [MB]: libraries take 300, the content ten times the file, of text twenty times.
MAX_MB, MAX_MB_PER_MB = 1024.0, 40.0
_READER_CODE = "from hexjet_identify.logs.reader import main; main()"
# Threads and memory pools of libraries reserve address space that they do not use.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
_ARRAY_KEY = "array"  # key of an array's number


def read_apart(reader: str, path: Path, *numbers: int) -> FlightLog | TableColumns:
    """Return what ``reader``, a function of this package as ``module.name``, reads in a process of its own.

    Raises InputError, also where it crashes or goes beyond its limits.
    """
    size = path.stat().st_size / 2**20
    seconds, megabytes = MAX_CPU_S + MAX_CPU_S_PER_MB * size, MAX_MB + MAX_MB_PER_MB * size
    try:
        arguments, environ = (reader, str(path), *map(str, numbers)), dict(os.environ) | _ONE_THREAD
        answer = run_code(_READER_CODE, *arguments, seconds=seconds, megabytes=megabytes, environ=environ)
    except HostError as error:
        raise InputError(f"{path}: cannot be read: it is damaged; {error}") from error
    return _unpack_answer(path, bytearray(answer), megabytes)


def main() -> None:
    """Read the log that the arguments name, and write its packed content to standard output."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library may print
    reader, path, *numbers = sys.argv[1:]
    try:
        with out:
            _pack_answer(read_here(reader, Path(path), *map(int, numbers)), out)
    except MemoryError:
        # There may be no memory for a message.
        os._exit(0)


def read_here(reader: str, path: Path, *numbers: int) -> FlightLog | TableColumns | str:
    """Return what a reader reads in this process, or in a line why it cannot; raises MemoryError alone."""
    module, _, name = reader.partition(".")
    try:
        read = getattr(import_module(f"hexjet_identify.logs.{module}"), name)
        content: FlightLog | TableColumns = read(path, *numbers)
        _check_content(path, content)
        return content
    except InputError as error:
        return str(error)
    except MemoryError:
        raise
    except Exception as error:
        # A reader of a damaged file may raise any exception.
        return f"{path}: cannot be read: it is damaged ({type(error).__name__}: {one_line(error)})"


def _check_content(path: Path, content: FlightLog | TableColumns) -> None:
    """Raise InputError for a column that is not of numbers, or has not a time for each value."""
    if isinstance(content, TableColumns):
        columns = {name: (values, values) for name, values in content.numbers.items()}
    else:
        columns = {name: (channel.times, channel.values) for name, channel in content.channels.items()}
    for name, pair in columns.items():
        if any(not isinstance(each, np.ndarray) or each.ndim != 1 or each.dtype != np.float64 for each in pair):
            raise InputError(f"{path}: {name}: is no column of numbers")
        if len(pair[0]) != len(pair[1]):
            raise InputError(f"{path}: {name}: has {len(pair[1])} values and {len(pair[0])} times")


def _pack_answer(content: FlightLog | TableColumns | str, out: BinaryIO) -> None:
    arrays: list[Array] = []
    numbered: dict[int, int] = {}

    def replace_array(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value.item() if isinstance(value, np.generic) else str(value)
        if id(value) not in numbered:
            numbered[id(value)] = len(arrays)
            arrays.append(value)
        return {_ARRAY_KEY: numbered[id(value)]}

    fields = {"refused": content} if isinstance(content, str) else dict(vars(content))
    text = json.dumps(fields, default=replace_array)
    out.write(json.dumps([len(array) for array in arrays]).encode() + b"\n" + text.encode() + b"\n")
    for array in arrays:
        out.write(np.ascontiguousarray(array, "<f8").data)


def _unpack_answer(path: Path, answer: bytearray, megabytes: float) -> FlightLog | TableColumns:
    """Return the content of an answer.  Raises InputError for a refusal, or an empty answer for want of memory."""
    first, second = answer.find(b"\n"), answer.find(b"\n", answer.find(b"\n") + 1)
    if first < 0:
        raise InputError(f"{path}: cannot be read: its content asks for more than {megabytes:.0f} MB of memory")
    arrays: list[Array] = []
    at = second + 1
    for length in json.loads(answer[:first]):
        arrays.append(np.frombuffer(answer, "<f8", length, at))
        at += 8 * length

    def restore_array(table: dict[str, Any]) -> Any:
        return arrays[table[_ARRAY_KEY]] if table.keys() == {_ARRAY_KEY} and type(table[_ARRAY_KEY]) is int else table

    fields: Mapping[str, Any] = json.loads(answer[first + 1 : second], object_hook=restore_array)
    if "refused" in fields:
        raise InputError(fields["refused"])
    if "channels" not in fields:
        return TableColumns(**fields)
    channels = {name: Channel(*channel) for name, channel in fields["channels"].items()}
    return FlightLog(path, fields["kind"], channels, tuple(fields["remarks"]), fields["engine"])
