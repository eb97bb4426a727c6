"""ULog, as PX4 writes it, read by pyulog."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import one_line, read_file
from hexjet_identify.logs.flight_log import MAX_LOG_MB, SEARCHED_BYTES, Channel, FlightLog, numbers

MAGIC = b"ULog\x01\x12\x35"  # first bytes of a ULog
HEAD_BYTES = 16  # bytes of the file's head
_PARAMETER_TYPES = {"float": "<f", "int32_t": "<i"}  # types of a parameter's value
_LOGGED, _TAGGED = ord("L"), ord("C")


def recognises(head: bytes) -> bool:
    """Return whether the first bytes of a file are a ULog's."""
    return head.startswith(MAGIC)


def read(path: Path) -> FlightLog:
    """Read every topic's fields as ``topic.field``, those of further instances as ``topic#1.field``.

    Times are those of ``timestamp_sample`` where a topic has it: when it was measured, not when it was published.
    Raises InputError, and whatever pyulog may for a damaged file.
    """
    if find_spec("pyulog") is None:
        raise InputError("a ULog needs pyulog, which is not installed: pip install pyulog")
    data = path.read_bytes()
    begin = max(data[:SEARCHED_BYTES].find(MAGIC), 0)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        log = _load_with_pyulog(path, data, begin)
    step = log.initial_parameters.get("step_s")
    channels, untimed = _make_channels(log, None if step is None else float(step))
    if not channels:
        raise InputError(f"{path}: the ULog holds no data: it was cut short before the first message, or damaged")
    remarks = [f"left out, having no time: {', '.join(untimed)}"] if untimed else []
    if log.file_corruption or printed.getvalue().strip():
        remarks.append("parts of the file are damaged and were passed over")
    elif not _is_complete(data, begin):
        remarks.append("the log was cut short, or the power went: it ends within a message")
    if missing := [int(dropout.duration) for dropout in log.dropouts]:
        remarks.append(f"{len(missing)} times the logger lost data, {1e-3 * sum(missing):.1f} s together")
    return FlightLog(path, "ULog", channels, tuple(remarks))


class _Remainder(io.BytesIO):
    """The rest of a file, which refuses as a file does to go back to before its beginning; BytesIO stops there.

    pyulog goes back by what a damaged message says, and would come to it again for ever.
    """

    def seek(self, offset: int, whence: int = 0, /) -> int:
        if whence == io.SEEK_CUR and self.tell() + offset < 0:
            raise OSError("before the beginning")
        return super().seek(offset, whence)


def _load_with_pyulog(path: Path, data: bytes, begin: int) -> Any:
    """Load the log with pyulog.  Raises InputError with the byte of the file by which it stopped."""
    from pyulog import ULog
    from pyulog.core import ULogException

    source = _Remainder(data[begin:])
    try:
        return ULog(source)
    except ULogException as error:
        raise InputError(f"{path}: cannot be read as ULog: {one_line(error)}") from error
    except Exception as error:
        # pyulog may raise any exception over a damaged file.
        at = begin + source.tell()
        raise InputError(f"{path}: cannot be read as ULog: it is damaged at byte {at} or before that") from error


def _make_channels(log: Any, step: float | None) -> tuple[dict[str, Channel], list[str]]:
    """Return the channels of a log, and the topics that have no time."""
    channels, untimed = {}, []
    for topic in log.data_list:
        stamp = topic.data.get("timestamp_sample", topic.data.get("timestamp"))
        if stamp is None:
            untimed.append(topic.name)
            continue
        times = 1e-6 * numbers(stamp)
        if topic.name == "hexjet_thrust":
            # Our logs have the thrust at the end of the message's step.
            times = times + _find_step(step, times)
        name = topic.name + (f"#{topic.multi_id}" if topic.multi_id else "")
        for field, values in topic.data.items():
            if not field.startswith("timestamp"):
                channels[f"{name}.{field}"] = Channel(times, numbers(values))
    return channels, untimed


def _find_step(nominal: float | None, times: Array) -> float:
    """Return the control step of a log of ours, s: as stated in the log, or else that of its rows, the default."""
    if nominal is not None or times.size < 2:
        return nominal or 0.0
    return float(np.median(np.diff(times)))


def _is_complete(data: bytes, begin: int) -> bool:
    """Return whether the log's last message ends where the file does; each says its size first."""
    at, end = begin + HEAD_BYTES, len(data)
    while at + 3 <= end:
        at += 3 + (data[at] | data[at + 1] << 8)
    return at == end


class UlogNotes(NamedTuple):
    """Facts, parameters and messages of a ULog."""

    facts: dict[str, str | int]  # such as ver_sw and ver_sw_release
    parameters: dict[str, float]  # those at its beginning
    messages: list[tuple[float, int, str]]  # time s, severity as in syslog, text


def read_notes(path: Path) -> UlogNotes:
    """Read the facts, parameters and messages of a ULog, by its messages' sizes alone, also of one that was cut short.

    Topics are passed over, so that it takes no pyulog.  What does not have the form of its kind is passed over too.
    Raises InputError for a file that cannot be read.
    """
    data = read_file(path, MAX_LOG_MB)
    facts: dict[str, str | int] = {}
    parameters: dict[str, float] = {}
    messages: list[tuple[float, int, str]] = []
    # Parameters behind the definitions were changed in flight.
    begun = False
    for kind, body in _iterate_messages(data):
        if kind in (_LOGGED, _TAGGED):
            begin = 9 if kind == _LOGGED else 11
            if len(body) >= begin:
                (stamp,) = struct.unpack_from("<Q", body, begin - 8)
                messages.append((1e-6 * stamp, body[0] & 7, body[begin:].decode("utf-8", "replace")))
        elif kind in b"IP" and body and len(body) > body[0]:
            typed, _, name = body[1 : 1 + body[0]].decode("ascii", "replace").partition(" ")
            value = body[1 + body[0] :]
            if kind == ord("P") and not begun and typed in _PARAMETER_TYPES and len(value) == 4:
                parameters[name] = struct.unpack(_PARAMETER_TYPES[typed], value)[0]
            elif kind == ord("I") and typed.startswith("char["):
                facts[name] = value.decode("utf-8", "replace")
            elif kind == ord("I") and typed == "uint32_t" and len(value) == 4:
                facts[name] = int.from_bytes(value, "little")
        begun = begun or kind == ord("D")
    return UlogNotes(facts, parameters, messages)


def _iterate_messages(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the kind and the body of every whole message of a ULog."""
    at, end = HEAD_BYTES, len(data) if data.startswith(MAGIC) else 0
    while at + 3 <= end:
        size = data[at] | data[at + 1] << 8
        if at + 3 + size <= end:
            yield data[at + 2], data[at + 3 : at + 3 + size]
        at += 3 + size
