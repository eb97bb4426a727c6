"""ArduPilot's DataFlash log, ``.bin``: messages that a ``FMT`` message describes by type, length and format characters.

Read by us and not by pymavlink, whose reader is under the GPL and makes an object a message; a test compares both.
Format: ArduPilot, libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from cosim.base.errors import InputError
from cosim.results.logs.flight_log import Channel, FlightLog, numbers

HEAD = b"\xa3\x95"
FMT, FMT_LENGTH = 0x80, 89
# format character: numpy's type, and what a count of it is worth
TYPES = {
    "b": ("i1", 1.0), "B": ("u1", 1.0), "M": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0),
    "I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
    "n": ("S4", 0.0), "N": ("S16", 0.0), "Z": ("S64", 0.0), "a": ("S64", 0.0),
}  # fmt: skip
INSTANCES = ("I", "Instance")


def recognises(head: bytes) -> bool:
    """Whether a file begins so."""
    return head.startswith(HEAD + bytes([FMT]))


def read(path: Path) -> FlightLog:
    """Every message's fields as ``NAME.Field``, ``NAME[1].Field`` where messages have an instance.

    Raises InputError where nothing can be read.
    """
    data = path.read_bytes()
    formats, places, passed = _places(data)
    channels: dict[str, Channel] = {}
    events: list[tuple[float, str]] = []
    raw = np.frombuffer(data, np.uint8)
    for kind, (name, length, columns, labels) in formats.items():
        at = np.array(places.get(kind, ()), np.int64)
        if not at.size or name == "FMT" or any(column not in TYPES for column in columns):
            continue
        layout = np.dtype([(label, TYPES[c][0]) for label, c in zip(labels, columns, strict=True)])
        if layout.itemsize + 3 != length:
            continue
        rows = raw[at[:, None] + np.arange(3, length)].copy().view(layout)[:, 0]
        stamp = next((label for label in ("TimeUS", "TimeMS") if label in labels), None)
        if stamp is None:
            continue
        times = (1e-6 if stamp == "TimeUS" else 1e-3) * rows[stamp].astype(np.float64)
        if name == "MSG" and "Message" in labels:
            texts = [bytes(text).split(b"\0")[0].decode("utf-8", "replace") for text in rows["Message"]]
            events = list(zip(times.tolist(), texts, strict=True))
        instance = next(
            (label for label in INSTANCES if label in labels and TYPES[columns[labels.index(label)]][1]), ""
        )
        for number in np.unique(rows[instance]).tolist() if instance else [None]:
            part = rows if number is None else rows[rows[instance] == number]
            when = times if number is None else times[rows[instance] == number]
            full = name if number is None else f"{name}[{number}]"
            for label, c in zip(labels, columns, strict=True):
                if TYPES[c][1] and label != stamp:
                    channels[f"{full}.{label}"] = Channel(when, TYPES[c][1] * numbers(part[label]))
    if not channels:
        raise InputError(f"{path}: the DataFlash log holds no message with a time: it was cut short, or is damaged")
    remarks = (f"{passed} bytes are damaged and were passed over",) if passed else ()
    return FlightLog(path, "ArduPilot DataFlash", channels, remarks, events)


_Format = tuple[str, int, str, list[str]]


def _places(data: bytes) -> tuple[dict[int, _Format], dict[int, list[int]], int]:
    """The formats by type, where the messages of each begin, and how many bytes were none."""
    formats: dict[int, _Format] = {FMT: ("FMT", FMT_LENGTH, "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])}
    lengths = [0] * 256
    lengths[FMT] = FMT_LENGTH
    places: dict[int, list[int]] = {}
    at, passed, end = 0, 0, len(data)
    while at + 3 <= end:
        kind = data[at + 2]
        length = lengths[kind]
        if data[at] != 0xA3 or data[at + 1] != 0x95 or not length or at + length > end:
            after = data.find(HEAD, at + 1)
            after = end if after < 0 else after
            passed += after - at
            at = after
            continue
        if kind == FMT:
            number, size, name, columns, labels = struct.unpack("<BB4s16s64s", data[at + 3 : at + FMT_LENGTH])
            if size >= 3:
                formats[number] = (_text(name), size, _text(columns), [x for x in _text(labels).split(",") if x])
                lengths[number] = size
        places.setdefault(kind, []).append(at)
        at += length
    whole = {
        kind: (name, size, columns, labels)
        for kind, (name, size, columns, labels) in formats.items()
        if len(columns) == len(labels) == len(set(labels))
    }
    return whole, places, passed


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("ascii", "replace")
