"""The Crazyflie's log on its memory card: events of named, typed fields, which the head of the file lists.

Format: Bitcraze, "uSD-card deck", log files of version 1 (times in ms) and 2 (in us), little-endian, a CRC32 last.
"""

from __future__ import annotations

import struct
from pathlib import Path
from zlib import crc32

import numpy as np

from cosim.base.errors import InputError
from hexjet_identify.logs.flight_log import NUMPY_TYPES, Channel, FlightLog, numbers

MAGIC = 0xBC  # first byte of a log
UNITS = {"acc": "g", "gyro": "deg/s"}  # by the group of the firmware's variable


def recognises(head: bytes) -> bool:
    """Return whether the first bytes of a file are a Crazyflie log's."""
    return len(head) >= 5 and head[0] == MAGIC and struct.unpack("<H", head[1:3])[0] in (1, 2)


def read(path: Path) -> FlightLog:
    """Read the fields by their names (``gyro.x``), of several kinds of event as ``event/name``.  Raises InputError."""
    data = path.read_bytes()
    version, count = struct.unpack("<HH", data[1:5])
    clock, unit = ("<u4", 1e-3) if version == 1 else ("<u8", 1e-6)
    kinds: dict[int, tuple[str, np.dtype[np.void]]] = {}
    at = 5
    try:
        for _ in range(count):
            (number,) = struct.unpack_from("<H", data, at)
            name, at = _read_text(data, at + 2)
            (fields,) = struct.unpack_from("<H", data, at)
            at += 2
            layout = [("event", "<u2"), ("time", clock)]
            for _ in range(fields):
                text, at = _read_text(data, at)
                layout.append((text[:-3], NUMPY_TYPES[text[-2]]))
            kinds[number] = name, np.dtype(layout)
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise InputError(f"{path}: the head of the Crazyflie log is damaged or cut short") from error
    is_intact = len(data) >= 4 and crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]
    end = len(data) - 4 if is_intact else len(data)
    rows, remainder = _split_events(data, at, end, kinds)
    remarks = []
    if not is_intact:
        remarks.append("the file's checksum is wrong: it was cut short, or is damaged")
    if remainder:
        remarks.append(f"{remainder} bytes at the end are no events that the head describes; left out")
    channels = {}
    for number, columns_of_kind in rows.items():
        name, _ = kinds[number]
        table = np.concatenate(columns_of_kind)
        for field in table.dtype.names[2:] if table.dtype.names else ():
            label = field if len(kinds) == 1 else f"{name}/{field}"
            times = unit * table["time"].astype(np.float64)
            channels[label] = Channel(times, numbers(table[field]), UNITS.get(field.split(".")[0], ""))
    if not channels:
        raise InputError(f"{path}: the Crazyflie log holds no event")
    return FlightLog(path, "Crazyflie", channels, tuple(remarks))


def _split_events(
    data: bytes, at: int, end: int, kinds: dict[int, tuple[str, np.dtype[np.void]]]
) -> tuple[dict[int, list[np.ndarray]], int]:
    """Return the events by kind, each run of one kind in one piece, and how many bytes at the end are none."""
    events: dict[int, list[np.ndarray]] = {}
    # Events are compared in blocks, which grow in a long run of one kind.
    reach = 64
    while at + 2 <= end:
        (number,) = struct.unpack_from("<H", data, at)
        if number not in kinds:
            break
        layout = kinds[number][1]
        most = min((end - at) // layout.itemsize, reach)
        if not most:
            break
        table = np.frombuffer(data, layout, most, at)
        other = np.flatnonzero(table["event"] != number)
        part = table[: int(other[0])] if other.size else table
        reach = 64 if other.size else 2 * reach
        events.setdefault(number, []).append(part)
        at += len(part) * layout.itemsize
    return events, end - at


def _read_text(data: bytes, at: int) -> tuple[str, int]:
    after = data.index(b"\0", at)
    return data[at:after].decode("ascii", "replace"), after + 1
