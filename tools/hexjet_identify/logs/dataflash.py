"""ArduPilot's DataFlash log, ``.bin``: messages that a ``FMT`` message describes by type, length and format characters.

Read by us and not by pymavlink, whose reader is under the GPL and makes an object a message; a test compares both.
Format: ArduPilot, libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import InputError
from hexjet_identify.logs.flight_log import SEARCHED_BYTES, Channel, FlightLog, name_instances, numbers

MESSAGE_HEAD = b"\xa3\x95"  # first bytes of every message
FMT, FMT_LENGTH = 0x80, 89
MARK = MESSAGE_HEAD + bytes([FMT, FMT, FMT_LENGTH]) + b"FMT\0"  # the format of formats, which comes first
# By format character: numpy's type, and the value of a count.
TYPES = {
    "b": ("i1", 1.0), "B": ("u1", 1.0), "M": ("u1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0),
    "I": ("<u4", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "g": ("<f2", 1.0),
    "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01), "L": ("<i4", 1e-7),
    "n": ("S4", 0.0), "N": ("S16", 0.0), "Z": ("S64", 0.0), "a": ("S64", 0.0),
}  # fmt: skip
_Format = tuple[str, int, str, list[str]]  # name, length, format characters, labels
# Names of whole-number fields that tell instances apart in logs before 2018.
INSTANCE_LABELS = ("I", "Instance")
INSTANCE_UNIT = "#"  # and its unit since, in FMTU
FORMAT_MESSAGES = ("FMT", "FMTU", "UNIT", "MULT")  # messages about messages
_INTEGER_FORMATS = "bBhHiIqQM"  # format characters of whole numbers


def recognises(head: bytes) -> bool:
    """Return whether the first bytes of a file are a DataFlash log's."""
    return head.startswith(MESSAGE_HEAD + bytes([FMT]))


def read(path: Path) -> FlightLog:
    """Read every message's fields as ``NAME.Field``, or ``NAME[1].Field`` where messages have an instance.

    Raises InputError where nothing can be read.
    """
    data = path.read_bytes()
    data = data[max(data.find(MARK, 0, SEARCHED_BYTES), 0) :]
    formats, offsets, passed, cut = _index_messages(data)
    raw = np.frombuffer(data, np.uint8)
    tables = {
        kind: rows
        for kind, (name, length, columns, labels) in formats.items()
        if name != "FMT" and (rows := _decode_rows(raw, offsets.get(kind, ()), length, columns, labels)) is not None
    }
    units = _read_units(formats, tables)
    channels: dict[str, Channel] = {}
    for kind, rows in tables.items():
        name, _, columns, labels = formats[kind]
        stamp = next((label for label in ("TimeUS", "TimeMS") if label in labels), None)
        if stamp is None or name in FORMAT_MESSAGES:
            continue
        times = (1e-6 if stamp == "TimeUS" else 1e-3) * rows[stamp].astype(np.float64)
        for full, part in name_instances(name, rows, _find_instance_field(columns, labels, units.get(kind))):
            for label, c in zip(labels, columns, strict=True):
                if TYPES[c][1] and label != stamp:
                    channels[f"{full}.{label}"] = Channel(times[part], TYPES[c][1] * numbers(rows[label][part]))
    if not channels:
        raise InputError(f"{path}: the DataFlash log holds no message with a time: it was cut short, or is damaged")
    remarks = [f"{passed} bytes are damaged and were passed over"] if passed else []
    if cut:
        remarks.append(f"the log was cut short, or the power went: it ends {cut} bytes into a message")
    return FlightLog(path, "ArduPilot DataFlash", channels, tuple(remarks))


class DataFlashNotes(NamedTuple):
    """Version, parameters and messages of a DataFlash log."""

    # The version is as the program calls itself, and empty where the log does not say.
    version: str
    # All parameters at the beginning of the log, or None where some are missing.
    parameters: dict[str, float] | None
    messages: list[tuple[float, str]]  # time s, text


def read_notes(path: Path) -> DataFlashNotes:
    """Read version, parameters and messages of a DataFlash log.

    ArduPilot logs its parameters one after the other when a log begins, and then its version (VER).
    """
    data = path.read_bytes()
    formats, offsets, _, _ = _index_messages(data)
    raw = np.frombuffer(data, np.uint8)
    kinds = {name: kind for kind, (name, _, _, _) in formats.items()}

    def read_table(name: str, *labels: str) -> np.ndarray | None:
        kind = kinds.get(name, -1)
        if kind < 0 or not set(labels) <= set(formats[kind][3]):
            return None
        return _decode_rows(raw, offsets.get(kind, ()), *formats[kind][1:])

    listed, version = (offsets.get(kinds.get(name, -1), []) for name in ("PARM", "VER"))
    parameters: dict[str, float] | None = None
    if listed and version and version[0] > listed[0] and (rows := read_table("PARM", "Name", "Value")) is not None:
        first = int(np.searchsorted(listed, version[0]))  # what comes behind was changed in flight
        pairs = zip(rows["Name"][:first].tolist(), rows["Value"][:first].tolist(), strict=True)
        parameters = {_as_text(name): float(value) for name, value in pairs}
    said = read_table("MSG", "TimeUS", "Message")
    named = read_table("VER", "FWS")
    return DataFlashNotes(
        "" if named is None else _as_text(named["FWS"][0]),
        parameters,
        []
        if said is None
        else [
            (1e-6 * stamp, _as_text(text))
            for stamp, text in zip(said["TimeUS"].tolist(), said["Message"].tolist(), strict=True)
        ],
    )


def _decode_rows(
    raw: NDArray[np.uint8], offsets: Sequence[int], length: int, columns: str, labels: Sequence[str]
) -> np.ndarray | None:
    """Return the messages of one kind as a table; None where there are none, or the format cannot be read."""
    at = np.array(offsets, np.int64)
    if not at.size or not columns or any(column not in TYPES for column in columns):
        return None
    layout = np.dtype([(label, TYPES[c][0]) for label, c in zip(labels, columns, strict=True)])
    if layout.itemsize + 3 != length:
        return None
    return np.asarray(raw[at[:, None] + np.arange(3, length)].copy().view(layout)[:, 0])


def _read_units(formats: Mapping[int, _Format], tables: Mapping[int, np.ndarray]) -> dict[int, str]:
    """Return the units that FMTU gives each kind of message, a character a field."""
    names: dict[int, str] = {}
    for kind, rows in tables.items():
        if formats[kind][0] == "FMTU" and {"FmtType", "UnitIds"} <= set(formats[kind][3]):
            numbered = zip(rows["FmtType"].tolist(), rows["UnitIds"].tolist(), strict=True)
            names |= {number: _as_text(bytes(ids)) for number, ids in numbered if isinstance(ids, bytes)}
    return names


def _find_instance_field(columns: str, labels: Sequence[str], units: str | None) -> str:
    """Return the field that numbers instances, by FMTU or else by the name of a whole number; "" for none.

    The integrator of a PID message is called I too.
    """
    integers = [label for label, c in zip(labels, columns, strict=True) if c in _INTEGER_FORMATS]
    if units is not None and len(units) == len(labels):
        return next((x for x, unit in zip(labels, units, strict=True) if unit == INSTANCE_UNIT and x in integers), "")
    return next((label for label in INSTANCE_LABELS if label in integers), "")


def _index_messages(data: bytes) -> tuple[dict[int, _Format], dict[int, list[int]], int, int]:
    """Find the messages of each type.

    Return the formats by type, where messages begin, and how many bytes were skipped and are cut at the end.
    """
    formats: dict[int, _Format] = {FMT: ("FMT", FMT_LENGTH, "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])}
    lengths = [0] * 256
    lengths[FMT] = FMT_LENGTH
    offsets: dict[int, list[int]] = {}
    at, passed, end = 0, 0, len(data)
    while at + 3 <= end:
        kind = data[at + 2]
        length = lengths[kind]
        if data[at] != 0xA3 or data[at + 1] != 0x95 or not length or at + length > end:
            after = data.find(MESSAGE_HEAD, at + 1)
            if after < 0 and data.startswith(MESSAGE_HEAD, at) and length:
                return _complete_formats(formats), offsets, passed, end - at
            after = end if after < 0 else after
            passed += after - at
            at = after
            continue
        if kind == FMT:
            number, size, name, columns, labels = struct.unpack("<BB4s16s64s", data[at + 3 : at + FMT_LENGTH])
            if size >= 3:
                formats[number] = (
                    _as_text(name),
                    size,
                    _as_text(columns),
                    [x for x in _as_text(labels).split(",") if x],
                )
                lengths[number] = size
        offsets.setdefault(kind, []).append(at)
        at += length
    return _complete_formats(formats), offsets, passed + end - at if at < end else passed, 0


def _complete_formats(formats: Mapping[int, _Format]) -> dict[int, _Format]:
    """Return the formats with a label for each character, and no label twice."""
    return {
        kind: (name, size, columns, labels)
        for kind, (name, size, columns, labels) in formats.items()
        if len(columns) == len(labels) == len(set(labels))
    }


def _as_text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("ascii", "replace")
