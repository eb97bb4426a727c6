"""ULog, as PX4 writes it, read by pyulog in a process of its own."""

from __future__ import annotations

import json
import signal
import struct
import subprocess
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.compiled import child_environment
from cosim.base.errors import InputError
from cosim.base.runtime.processes import Child, python_command
from cosim.identify.logs.flight_log import SEARCHED, Channel, FlightLog, numbers

MAGIC = b"ULog\x01\x12\x35"
HEAD_BYTES = 16
MOST_S, MOST_S_A_MB = 20.0, 3.0  # of CPU, to begin with and for every MB: some ten times what pyulog takes
MOST_MB, MOST_MB_A_MB = 2048.0, 40.0  # of address space; what is resident is ten times the file
MOST_SILENT = 30.0  # times its limit of CPU that it may take by the clock: on a machine that is busy, or asleep
_NUMBERS = {"float": "<f", "int32_t": "<i"}  # types of a parameter's value
_LOGGED, _TAGGED = ord("L"), ord("C")
_PROGRAM = Path(__file__).with_name("ulog_child.py")
_RUN = 'import runpy; del sys.argv[0]; runpy.run_path(sys.argv[0], run_name="__main__")'


def recognises(head: bytes) -> bool:
    """Return whether the first bytes of a file are a ULog's."""
    return head.startswith(MAGIC)


def read(path: Path) -> FlightLog:
    """Read every topic's fields as ``topic.field``, those of further instances as ``topic#1.field``.

    Times are those of ``timestamp_sample`` where a topic has it: when it was measured, not when it was published.
    Raises InputError.
    """
    if find_spec("pyulog") is None:
        raise InputError("a ULog needs pyulog, which is not installed: pip install 'hexjet-cosim[logs]'")
    data = path.read_bytes()
    begin, size = max(data[:SEARCHED].find(MAGIC), 0), len(data) / 2**20
    answer, end = _read_apart(path, begin, MOST_S + MOST_S_A_MB * size, MOST_MB + MOST_MB_A_MB * size)
    if end:
        raise InputError(f"{path}: cannot be read as ULog: it is damaged; the reader {end}")
    head, _, doubles = answer.partition(b"\n")
    header = json.loads(head)
    if "error" in header:
        raise InputError(f"{path}: cannot be read as ULog: {header['error']}")
    channels = _channels(header, numbers(np.frombuffer(doubles, "<f8")))
    if not channels:
        raise InputError(f"{path}: the ULog holds no data: it was cut short before the first message, or damaged")
    remarks = [f"left out, having no time: {', '.join(header['untimed'])}"] if header["untimed"] else []
    if header["damaged"]:
        remarks.append("parts of the file are damaged and were passed over")
    elif not _ends(data, begin):
        remarks.append("the log was cut short, or the power went: it ends within a message")
    if missing := header["lost"]:
        remarks.append(f"{len(missing)} times the logger lost data, {1e-3 * sum(missing):.1f} s together")
    events = [(1e-6 * at, text) for at, text in header["events"]]
    return FlightLog(path, "ULog", channels, tuple(remarks), events)


def _read_apart(path: Path, begin: int, seconds: float, megabytes: float) -> tuple[bytes, str]:
    """Return what the reader says of a log, and why it came to no end, in words: damaged, it may run or grow for ever.

    It may take ``seconds`` of CPU and ``megabytes`` of address space.
    """
    child = Child(
        python_command(_RUN, str(_PROGRAM), str(path), str(begin), seconds=int(seconds) + 1, megabytes=megabytes),
        {**child_environment(), "OPENBLAS_NUM_THREADS": "1"},  # each of its threads would ask for address space
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        answer, _ = child.finish(MOST_SILENT * seconds)
    except subprocess.TimeoutExpired:
        return b"", f"was not done within {MOST_SILENT * seconds:.3g} s"
    if child.returncode == -signal.SIGXCPU:
        return b"", f"was not done within {seconds:.3g} s of processor time"
    return answer, f"ended its process (status {child.returncode})" if child.returncode else ""


def _channels(header: dict[str, Any], columns: Array) -> dict[str, Channel]:
    channels = {}
    at = 0
    for topic in header["topics"]:
        fields, rows = topic["fields"], topic["rows"]
        count = (1 + len(fields)) * rows
        table = columns[at : at + count].reshape(1 + len(fields), rows)
        at += count
        times = 1e-6 * table[0]
        if topic["name"] == "hexjet_thrust":  # ours: what the engine has at the end of the step that the message is of
            times = times + _step(header["step"], times)
        name = topic["name"] + (f"#{topic['instance']}" if topic["instance"] else "")
        for field, values in zip(fields, table[1:], strict=True):
            channels[f"{name}.{field}"] = Channel(times, values)
    return channels


def _step(nominal: float | None, times: Array) -> float:
    """Return the control step of a log of ours, s: as stated in the log, or else that of its rows, the default."""
    if nominal is not None or times.size < 2:
        return nominal or 0.0
    return float(np.median(np.diff(times)))


def _ends(data: bytes, begin: int) -> bool:
    """Return whether the log's last message ends where the file does; each says its size first."""
    at, end = begin + HEAD_BYTES, len(data)
    while at + 3 <= end:
        at += 3 + (data[at] | data[at + 1] << 8)
    return at == end


class UlogNotes(NamedTuple):
    """What a ULog says in words and of its program, beside its topics."""

    facts: dict[str, str | int]  # such as ver_sw and ver_sw_release
    parameters: dict[str, float]  # those at its beginning
    messages: list[tuple[float, int, str]]  # time s, severity as in syslog, text


def read_notes(path: Path) -> UlogNotes:
    """Read the facts, parameters and messages of a ULog, by its messages' sizes alone, also of one that was cut short.

    Topics are passed over, so that it takes no pyulog.  What does not have the form of its kind is passed over too.
    Raises InputError for a file that cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    facts: dict[str, str | int] = {}
    parameters: dict[str, float] = {}
    messages: list[tuple[float, int, str]] = []
    begun = False  # a parameter that comes behind the definitions was changed in flight
    for kind, body in _walk(data):
        if kind in (_LOGGED, _TAGGED):
            begin = 9 if kind == _LOGGED else 11
            if len(body) >= begin:
                (stamp,) = struct.unpack_from("<Q", body, begin - 8)
                messages.append((1e-6 * stamp, body[0] & 7, body[begin:].decode("utf-8", "replace")))
        elif kind in b"IP" and body and len(body) > body[0]:
            typed, _, name = body[1 : 1 + body[0]].decode("ascii", "replace").partition(" ")
            value = body[1 + body[0] :]
            if kind == ord("P") and not begun and typed in _NUMBERS and len(value) == 4:
                parameters[name] = struct.unpack(_NUMBERS[typed], value)[0]
            elif kind == ord("I") and typed.startswith("char["):
                facts[name] = value.decode("utf-8", "replace")
            elif kind == ord("I") and typed == "uint32_t" and len(value) == 4:
                facts[name] = int.from_bytes(value, "little")
        begun = begun or kind == ord("D")
    return UlogNotes(facts, parameters, messages)


def _walk(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the kind and the body of every whole message of a ULog."""
    at, end = HEAD_BYTES, len(data) if data.startswith(MAGIC) else 0
    while at + 3 <= end:
        size = data[at] | data[at + 1] << 8
        if at + 3 + size <= end:
            yield data[at + 2], data[at + 3 : at + 3 + size]
        at += 3 + size
