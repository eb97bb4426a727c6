"""Telemetry logs of ground stations, ``.tlog``: MAVLink frames of version 1 and 2, each behind the time it was taken.

The time is of 8 bytes, big-endian, in microseconds since 1970.  What the messages are the MAVLink module of the project
says, which the build makes, and pymavlink's dialect of all: ArduPilot's own messages are there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.logs.flight_log import NUMPY_TYPES, Channel, FlightLog, name_instances, numbers

# Loaded by name: of the ground station nothing is needed but what the build made of the messages.
DIALECTS = (
    "cosim.groundstation.mavlink.wire._messages",
    "pymavlink.dialects.v20.all",
)
STAMP_BYTES = 8  # bytes of the time before each frame
# Times of the years 1980, for a station without a clock, and 2100 [us].
EARLIEST_US, LATEST_US = 315_532_800_000_000, 4_102_444_800_000_000
MAGIC_1, MAGIC_2 = 0xFE, 0xFD
SIGNED, SIGNATURE, CHECKSUM = 0x01, 13, 2
OWN_CLOCKS = {"time_boot_ms": 1e-3, "time_usec": 1e-6}  # sender's times, with their unit in s
MAX_NAMED = 10
MIN_FRAME_BYTES = 8  # bytes of a frame without a payload

Sender = tuple[int, int]  # system and component
Key = tuple[int, int, Sender]


class Kind(NamedTuple):
    """A kind of message: layout of its payload, and the extra byte of its checksum."""

    name: str
    layout: np.dtype[np.void]
    extra: bytes
    units: dict[str, str]
    # Field that tells instances apart; empty if there is none.
    instance: str


class Frame(NamedTuple):
    """The head of a frame and its position in the file, bytes."""

    stamp: int
    message: int
    sender: Sender
    payload: slice  # the checksum stands behind it
    after: int  # where the time of the next one stands


def recognises(head: bytes) -> bool:
    """Return whether a file begins with a time and a frame, and goes on with the next, as far as ``head`` goes."""
    frame = _read_frame_head(head, 0)
    if frame is None or not EARLIEST_US < frame.stamp < LATEST_US:
        return False
    after = frame.after + STAMP_BYTES
    return after >= len(head) or head[after] in (MAGIC_1, MAGIC_2)


def read(path: Path) -> FlightLog:
    """Read the fields as ``MESSAGE.field``, an array's as ``MESSAGE.field[0]``.

    ``MESSAGE[1/1].field`` where several systems and components send it, ``MESSAGE[0].field`` where it has several
    instances.  Times count from the first frame [s].  They are the vehicle's own where a message has one, when it was
    measured, and else when the frame was received.  Raises InputError.
    """
    data = path.read_bytes()
    index = _index_messages(data)
    if not index.messages:
        raise InputError(f"{path}: the telemetry log holds no frame of a message that is known")
    begin = min(frames[0].stamp for frames in index.messages.values())
    tables = {
        key: _decode_payloads(data, _load_kinds()[key[0]][key[1]], frames) for key, frames in index.messages.items()
    }
    taken = {key: 1e-6 * np.array([f.stamp - begin for f in frames]) for key, frames in index.messages.items()}
    clocks = _find_clock_zeros(tables, taken)
    senders: dict[str, set[Sender]] = {}
    for number, which, sender in tables:
        senders.setdefault(_load_kinds()[number][which].name, set()).add(sender)
    channels: dict[str, Channel] = {}
    for key, table in tables.items():
        kind, sender = _load_kinds()[key[0]][key[1]], key[2]
        times = _choose_times(table, taken[key], clocks.get(sender))
        full = kind.name + (f"[{sender[0]}/{sender[1]}]" if len(senders[kind.name]) > 1 else "")
        for name, rows in name_instances(full, table, kind.instance, 2):
            channels |= _make_channels(name, kind, table[rows], times[rows])
    return FlightLog(path, "MAVLink telemetry log", channels, index.remarks(begin))


@cache
def _load_kinds() -> dict[int, list[Kind]]:
    """Return the kinds of message of each number; the checksum tells those of several dialects apart."""
    kinds: dict[int, list[Kind]] = {}
    for name in DIALECTS:
        try:
            message_table = import_module(name).mavlink_map
        except ImportError:
            continue
        for number, message in message_table.items():
            extra = bytes([message.crc_extra])
            if all(kind.extra != extra for kind in kinds.get(number, ())):
                kinds.setdefault(number, []).append(_make_kind(message, extra))
    return kinds


def _make_kind(message: Any, extra: bytes) -> Kind:
    fields: list[tuple[Any, ...]] = []
    codes = bytes(message.native_format).decode().lstrip("<")
    for name, code, length in zip(message.ordered_fieldnames, codes, message.array_lengths, strict=True):
        if code == "c":
            fields.append((name, f"S{max(length, 1)}"))
        else:
            fields.append((name, NUMPY_TYPES[code], (length,)) if length else (name, NUMPY_TYPES[code]))
    instance = getattr(message, "instance_field", None) or ""
    return Kind(message.msgname, np.dtype(fields), extra, dict(message.fieldunits_by_name), instance)


def _read_frame_head(data: bytes, at: int) -> Frame | None:
    """Read the head of the frame whose time is at ``at``; None for what is no frame's head."""
    start = at + STAMP_BYTES
    if len(data) < start + MIN_FRAME_BYTES or data[start] not in (MAGIC_1, MAGIC_2):
        return None
    size, signature = data[start + 1], 0
    if data[start] == MAGIC_1:
        head, sender, message = 6, (data[start + 3], data[start + 4]), data[start + 5]
    elif data[start + 2] & ~SIGNED or len(data) < start + 10:
        return None
    else:
        head, sender = 10, (data[start + 5], data[start + 6])
        message = int.from_bytes(data[start + 7 : start + 10], "little")
        signature = SIGNATURE * (data[start + 2] & SIGNED)
    payload = slice(start + head, start + head + size)
    stamp = int.from_bytes(data[at:start], "big")
    return Frame(stamp, message, sender, payload, payload.stop + CHECKSUM + signature)


def _read_frame(data: bytes, at: int) -> tuple[Frame, int | None] | None:
    """Return the frame at ``at`` and which kind of its number it is, None for an unknown number.

    None alone where there is no frame, or a damaged one.
    """
    from fastcrc.crc16 import mcrf4xx

    frame = _read_frame_head(data, at)
    if frame is None or frame.after > len(data):
        return None
    kinds = _load_kinds().get(frame.message)
    if kinds is None:
        # Without a checksum to try, a following frame has to confirm it.
        behind = data[frame.after + STAMP_BYTES : frame.after + STAMP_BYTES + 1]
        follows = frame.after == len(data) or behind in (b"\xfe", b"\xfd")
        return (frame, None) if follows and EARLIEST_US < frame.stamp < LATEST_US else None
    crc = mcrf4xx(data[at + STAMP_BYTES + 1 : frame.payload.stop])
    checksum = data[frame.payload.stop] | data[frame.payload.stop + 1] << 8
    which = next((n for n, kind in enumerate(kinds) if mcrf4xx(kind.extra, crc) == checksum), None)
    return None if which is None else (frame, which)


@dataclass
class _MessageIndex:
    """Frames by message id, definition and sender, with unknown ids and the count of bytes outside any frame."""

    messages: dict[Key, list[Frame]] = field(default_factory=dict)
    unknown: set[int] = field(default_factory=set)
    passed: int = 0  # bytes outside any frame
    # Bytes at the end that begin a frame.
    cut: int = 0

    def remarks(self, begin: int) -> tuple[str, ...]:
        """Return remarks on the file, whose first frame was received at ``begin`` [us]."""
        date = datetime.fromtimestamp(1e-6 * begin, UTC) if EARLIEST_US < begin < LATEST_US else None
        remarks = [f"times count from its first frame{f', {date:%Y-%m-%d %H:%M:%S} UTC' if date else ''}"]
        if self.passed:
            remarks.append(f"{self.passed} bytes are damaged and were passed over")
        if self.cut:
            remarks.append(f"the log was cut short: it ends {self.cut} bytes into a frame")
        if self.unknown:
            more = ", ..." if len(self.unknown) > MAX_NAMED else ""
            named = ", ".join(map(str, sorted(self.unknown)[:MAX_NAMED]))
            remarks.append(f"messages of unknown numbers were left out: {named}{more}")
        return tuple(remarks)


def _index_messages(data: bytes) -> _MessageIndex:
    index = _MessageIndex()
    at, end = 0, len(data)
    while at < end:
        frame_read = _read_frame(data, at)
        if frame_read is None:
            after = _find_next_frame(data, at + 1)
            if after == end and (_read_frame_head(data, at) or end - at < STAMP_BYTES + MIN_FRAME_BYTES):
                index.cut = end - at
            else:
                index.passed += after - at
            at = after
            continue
        frame, which = frame_read
        at = frame.after
        if which is None:
            index.unknown.add(frame.message)
        else:
            index.messages.setdefault((frame.message, which, frame.sender), []).append(frame)
    return index


def _find_next_frame(data: bytes, at: int) -> int:
    """Return where the time of the next frame may be, from ``at`` on: eight bytes before a magic byte."""
    candidates = [candidate for magic in (MAGIC_1, MAGIC_2) if (candidate := data.find(magic, at + STAMP_BYTES)) >= 0]
    return min(candidates) - STAMP_BYTES if candidates else len(data)


def _decode_payloads(data: bytes, kind: Kind, frames: list[Frame]) -> np.ndarray:
    """Return the payloads as rows, with the zeros at the end that the wire leaves out."""
    size = kind.layout.itemsize
    return np.frombuffer(b"".join(data[f.payload][:size].ljust(size, b"\0") for f in frames), kind.layout)


def _find_clock_zeros(tables: dict[Key, np.ndarray], taken: dict[Key, Array]) -> dict[Sender, float]:
    """Return when each sender's own clock was at 0, s, by the frame that was received the soonest."""
    clocks: dict[Sender, float] = {}
    for key, table in tables.items():
        if "time_boot_ms" in (table.dtype.names or ()):
            zero = float(np.min(taken[key] - 1e-3 * table["time_boot_ms"].astype(np.float64)))
            clocks[key[2]] = min(zero, clocks.get(key[2], zero))
    return clocks


def _choose_times(table: np.ndarray, taken: Array, zero: float | None, max_late_s: float = 5.0) -> Array:
    """Return the sender's own times, s, or those of reception where these differ by ``max_late_s`` (another clock)."""
    for name, unit in OWN_CLOCKS.items():
        if zero is not None and name in (table.dtype.names or ()):
            boot_times = zero + unit * table[name].astype(np.float64)
            if np.all(np.abs(taken - boot_times) < max_late_s):
                return boot_times
    return taken


def _make_channels(name: str, kind: Kind, table: np.ndarray, times: Array, max_array: int = 32) -> dict[str, Channel]:
    """Return the fields of a message as channels; arrays beyond ``max_array`` numbers are pieces of files."""
    columns = {}
    for label in kind.layout.names or ():
        column, unit = table[label], kind.units.get(label, "")
        if column.dtype.kind == "S" or label in OWN_CLOCKS:
            continue
        if column.ndim == 1:
            columns[f"{name}.{label}"] = Channel(times, numbers(column), unit)
        elif column.shape[1] <= max_array:
            columns |= {f"{name}.{label}[{n}]": Channel(times, numbers(part), unit) for n, part in enumerate(column.T)}
    return columns
