"""Betaflight's blackbox, ``.bbl`` and ``.bfl``: a head of text, then frames of differences against what came before.

Read by us: orangebox, which reads it too, is under the GPL, does not know every encoding, and pip cannot install its
releases.  Format: Betaflight, "Blackbox Internals"; src/main/blackbox/blackbox.c, blackbox_encoding.c and
blackbox_fielddefs.h.
"""

from __future__ import annotations

import re
import struct
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np

from cosim.base.errors import InputError
from hexjet_identify.logs.blackbox_encodings import EVEN, MASK, UNEVEN, extended, signed, tag2_3, tag8, tag8_4, unsigned
from hexjet_identify.logs.flight_log import Channel, FlightLog

MARKER = b"H Product:Blackbox flight data recorder"  # first bytes of a log
FRAME_KINDS = b"IPGHSE"  # letters that frames begin with
SIGNED, UNSIGNED, NEGATIVE, TAG8, TAG2_3, TAG8_4, NULL, TAG2_3V = 0, 1, 3, 6, 7, 8, 9, 10  # encodings
PREVIOUS, LINE, AVERAGE, LEAST_THROTTLE, FIRST_MOTOR, COUNT, HOME, CENTRE, BATTERY, LAST_TIME, LEAST_MOTOR = range(
    1, 12
)
# Predictors by earlier main frames, which P frames alone use.
DIFFERENCE_PREDICTORS = {PREVIOUS, LINE, AVERAGE, COUNT}
# Number of fields that one code holds.
FIELDS_PER_CODE = {SIGNED: 1, UNSIGNED: 1, NEGATIVE: 1, TAG2_3: 3, TAG8_4: 4, NULL: 1, TAG2_3V: 3}
MAX_TAG8_FIELDS = 8  # fields that share one TAG8 header byte
MAX_FRAME_BYTES = 256  # a longer frame counts as damaged
# Largest step of iteration and time [us] from frame to frame, as the format's own decoders allow.
MOST_COUNTS, MOST_US = 5000, 10_000_000
AUTOTUNE_EVENT_BYTES = {10: 5, 11: 3, 12: 3}  # bytes of events of firmware that is gone
ENDEVENT, END = 255, b"End of log"
_NAME = re.compile(r"(.*)\[(\d+)\]$")


def recognises(head: bytes) -> bool:
    """Return whether the first bytes of a file are a blackbox log's."""
    return head.startswith(MARKER)


def read(path: Path, number: int | None = None) -> FlightLog:
    """Read the fields of main, slow and GNSS frames by their names; gyro and set-point in deg/s.

    ``axisSum[n]`` is the sum of the terms of an axis that are logged.  A file may hold several logs: ``number`` counts
    from 1, and None is the longest.  Raises InputError.
    """
    data = path.read_bytes()
    begins = [match.start() for match in re.finditer(re.escape(MARKER), data)]
    if number is not None and not 1 <= number <= len(begins):
        raise InputError(f"{path}: it holds {len(begins)} logs; {number} is none of them")
    ends = [*begins[1:], len(data)]
    chosen = int(np.argmax(np.subtract(ends, begins))) if number is None else number - 1
    head, at = _read_head(path, data, begins[chosen], ends[chosen])
    frames = _FrameReader(data, ends[chosen], head)
    frames.read(at)
    if len(frames.rows) == 0:
        raise InputError(f"{path}: the blackbox log holds no frame that can be read: it was cut short, or is damaged")
    remarks = []
    if len(begins) > 1:
        how = "the longest" if number is None else "as asked"
        remarks.append(f"the file holds {len(begins)} logs; number {chosen + 1} is read, {how}; FILE:N reads another")
    if frames.refused or frames.unusable:
        damage = f"{frames.refused} frames are damaged and were passed over"
        remarks.append(f"{damage}, with {frames.unusable} that build on them" if frames.unusable else damage)
    if not frames.ended:
        remarks.append("the log has no end: it was cut short, or the power went")
    return FlightLog(path, "Betaflight blackbox", _make_channels(head, frames), tuple(remarks))


@dataclass(frozen=True)
class Layout:
    """The fields of one kind of frame."""

    names: tuple[str, ...]
    signed: tuple[bool, ...]
    predictors: tuple[int, ...]
    groups: tuple[tuple[int, int], ...]  # encoding, and how many fields it holds


@dataclass(frozen=True)
class Head:
    """Layouts of the frames, and all lines of the head by name."""

    layouts: dict[str, Layout]
    headers: dict[str, str]

    def number(self, name: str, default: float) -> float:
        """Return the first number of a line of the head, which may be a float's bits in hexadecimal, or the default."""
        text = self.headers.get(name, "").split(",")[0].strip()
        try:
            bits = text.lower().startswith("0x")
            value = struct.unpack("<f", struct.pack("<I", int(text, 16)))[0] if bits else float(text)
        except (ValueError, struct.error):
            return default
        return float(value) if isfinite(value) else default

    def integer(self, name: str, default: int) -> int:
        """Return the first number of a line of the head as a whole one of 32 bits, or the default."""
        value = self.number(name, default)
        return int(value) if abs(value) < 2**31 else default

    @property
    def frame_ratio(self) -> tuple[int, int]:
        """Share of the main frames that is logged, as numerator and denominator, from ``P interval``."""
        numerator, _, of = self.headers.get("P interval", "1").partition("/")
        ratio = (numerator, of) if of else ("1", numerator)
        numbers = [int(text) if text.strip().isdecimal() and len(text) < 9 else 1 for text in ratio]
        return max(numbers[0], 1), max(numbers[1], 1)


def _read_head(path: Path, data: bytes, at: int, end: int) -> tuple[Head, int]:
    headers: dict[str, str] = {}
    while data.startswith(b"H ", at) and at < end:
        after = data.find(b"\n", at, end)
        if after < 0:
            break
        name, _, value = data[at + 2 : after].decode("ascii", "replace").partition(":")
        headers[name.strip()] = value
        at = after + 1
    layouts = {}
    for kind in "IPGHS":
        names = headers.get(f"Field {'I' if kind == 'P' else kind} name")
        if names is not None and f"Field {kind} encoding" in headers:
            layouts[kind] = _read_layout(path, headers, kind, names.split(","))
    if "I" not in layouts:
        raise InputError(f"{path}: the head of the blackbox log is damaged or cut short: it names no fields")
    if Head({}, headers).integer("Data version", 1) < 2:
        raise InputError(f"{path}: a blackbox log of data version 1; allowed: 2, which is written since 2015")
    return Head(layouts, headers), at


def _read_layout(path: Path, headers: dict[str, str], kind: str, names: Sequence[str]) -> Layout:
    def read_codes(key: str, of: str = kind) -> list[int]:
        try:
            codes = [int(text) for text in headers.get(f"Field {of} {key}", "").split(",")]
        except ValueError:
            codes = []
        if len(codes) != len(names):
            raise InputError(f"{path}: the head of the blackbox log is damaged: {kind} frames have no {key} each")
        return codes

    encodings = read_codes("encoding")
    unknown = sorted({code for code in encodings if code != TAG8 and code not in FIELDS_PER_CODE})
    predictors = read_codes("predictor")
    known_predictors = set(range(LEAST_MOTOR + 1)) - (set() if kind == "P" else DIFFERENCE_PREDICTORS)
    unknown_predictors = sorted(set(predictors) - known_predictors)
    if unknown or unknown_predictors:
        problem = f"encoding {unknown[0]}" if unknown else f"predictor {unknown_predictors[0]}"
        raise InputError(f"{path}: {problem} of {kind} frames is not known")
    groups, n = [], 0
    while n < len(encodings):
        code = encodings[n]
        size = FIELDS_PER_CODE.get(code, 0)
        if code == TAG8:
            size = 1
            while size < MAX_TAG8_FIELDS and n + size < len(encodings) and encodings[n + size] == TAG8:
                size += 1
        if n + size > len(encodings):
            raise InputError(f"{path}: the head of the blackbox log is damaged: the last {kind} fields are too few")
        groups.append((code, size))
        n += size
    of = "I" if kind == "P" else kind
    signed = read_codes("signed", of) if f"Field {of} signed" in headers else [1] * len(names)
    return Layout(tuple(map(str.strip, names)), tuple(map(bool, signed)), tuple(predictors), tuple(groups))


@dataclass
class _FrameReader:
    """Reads the frames of a log, with the state that predicted values build on."""

    data: bytes
    end: int
    head: Head
    rows: array[int] = field(default_factory=lambda: array("q"))
    others: dict[str, list[tuple[int, list[int]]]] = field(default_factory=dict)
    refused: int = 0  # frames that are damaged
    unusable: int = 0  # differences against a frame that is
    ended: bool = False
    # The last two main frames.
    last: list[int] | None = None
    before: list[int] | None = None
    time: int = 0  # of the last main frame, us
    # Iteration and time of the last accepted main frame.
    accepted: tuple[int, int] | None = None
    doubted: tuple[int, int] | None = None  # of an I frame that does not follow it
    home: list[int] | None = None

    def __post_init__(self) -> None:
        number = self.head.integer
        self.data = self.data[: self.end]
        self.every = max(1, number("I interval", 32))
        self.numerator, self.of = self.head.frame_ratio
        least = number("minthrottle", 1150)
        self.added = {
            LEAST_THROTTLE: least,
            CENTRE: 1500,
            BATTERY: number("vbatref", 0),
            LEAST_MOTOR: number("motorOutput", least),
        }
        names = self.head.layouts["I"].names
        self.counted = names.index("loopIteration") if "loopIteration" in names else None
        self.timed = names.index("time") if "time" in names else None
        self.motor = names.index("motor[0]") if "motor[0]" in names else 0

    def read(self, at: int) -> None:
        """Read all frames from ``at``, and skip bytes that cannot be a frame up to the next that can."""
        damaged = False  # several bytes in a row count once
        while at < len(self.data) and not self.ended:
            kind = chr(self.data[at])
            try:
                after, taken = self._read_frame(kind, at)
            except IndexError:
                after, taken = 0, None
            if taken is None:
                self.refused += not damaged
                damaged = True
                self.last = self.before = None
                at += 1
            else:
                damaged = False
                taken()
                at = after

    def _read_frame(self, kind: str, at: int) -> tuple[int, Callable[[], None] | None]:
        """Return where a frame ends and the function that applies it; None for no frame."""
        if kind == "E":
            after, apply = self._read_event(at + 1)
        else:
            layout = self.head.layouts.get(kind)
            if layout is None:
                return at, None
            values, after = self._decode_values(layout, at + 1)
            if after - at > MAX_FRAME_BYTES:
                return at, None

            def apply() -> None:
                self._store_frame(kind, layout, values)

        ended = kind == "E" and self.data[at + 1] == ENDEVENT
        is_whole = ended or after == len(self.data) or (after < len(self.data) and self.data[after] in FRAME_KINDS)
        return after, apply if is_whole else None

    def _decode_values(self, layout: Layout, at: int) -> tuple[list[int], int]:
        data = self.data
        values: list[int] = []
        for code, count in layout.groups:
            if code == SIGNED:
                value, at = signed(data, at)
                values.append(value)
            elif code == UNSIGNED:
                value, at = unsigned(data, at)
                values.append(value)
            elif code == NULL:
                values.append(0)
            elif code == NEGATIVE:
                value, at = unsigned(data, at)
                values.append(-extended(value, 14))
            else:
                if code == TAG8:
                    several, at = tag8(data, at, count)
                elif code == TAG8_4:
                    several, at = tag8_4(data, at)
                else:
                    several, at = tag2_3(data, at, EVEN if code == TAG2_3 else UNEVEN)
                values += several
        return values, at

    def _store_frame(self, kind: str, layout: Layout, values: list[int]) -> None:
        if kind == "P" and self.last is None:
            self.unusable += 1
            return
        self._add_predicted(layout, values)
        if kind in "GHS":
            if kind == "H":
                self.home = values
            time = values[layout.names.index("time")] if "time" in layout.names else self.time
            self.others.setdefault(kind, []).append((time, values))
            return
        if not self._follows_last_frame(kind, values):
            self.refused += 1
            self.last = self.before = None
            return
        self.before, self.last = (values if kind == "I" else self.last), values
        if self.timed is not None:
            self.time = values[self.timed]
        self.rows.extend(values)

    def _add_predicted(self, layout: Layout, values: list[int]) -> None:
        """Add its prediction to each value, in 32 bits."""
        last, before, homes = self.last or (), self.before or (), 0
        for n, code in enumerate(layout.predictors):
            value = values[n]
            if code == PREVIOUS:
                value += last[n]
            elif code == AVERAGE:
                both = last[n] + before[n]
                value += both // 2 if both >= 0 else -(-both // 2)
            elif code == LINE:
                value += 2 * last[n] - before[n]
            elif code == COUNT:
                value = self._next_logged_count(last[n] + 1)
            elif code == FIRST_MOTOR:
                value += values[self.motor]
            elif code == HOME:
                value += self.home[min(homes, len(self.home) - 1)] if self.home else 0
                homes += 1
            elif code == LAST_TIME:
                value += self.time
            elif code:
                value += self.added[code]
            values[n] = ((value + 0x80000000) & MASK) - 0x80000000 if layout.signed[n] else value & MASK

    def _next_logged_count(self, count: int) -> int:
        """Return the first iteration from ``count`` on whose main frame is logged, an I frame at the latest."""
        phase = count % self.every
        late = (phase + self.numerator - 1) % self.of
        return count + min(self.of - late, self.every - phase) if late >= self.numerator else count

    def _follows_last_frame(self, kind: str, values: list[int]) -> bool:
        """Return whether count and time go on from the last main frame.

        Two I frames that go on from each other are believed: the clock jumped, or the last main frame was noise.
        """
        count = values[self.counted] if self.counted is not None else 0
        time = values[self.timed] if self.timed is not None else 0
        here = count, time
        if self.accepted is None or _is_successor(self.accepted, here):
            self.accepted, self.doubted = here, None
            return True
        if kind == "I" and self.doubted is not None and _is_successor(self.doubted, here):
            self.accepted, self.doubted = here, None
            return True
        self.doubted = here if kind == "I" else self.doubted
        return False

    def _read_event(self, at: int) -> tuple[int, Callable[[], None] | None]:
        """Return where an event ends and the function that applies it; None for an unknown event."""
        data = self.data
        kind = data[at]
        at += 1
        resumed, ended = None, False
        # A sync beep, and the reason of a disarming.
        if kind in (0, 15):
            _, at = unsigned(data, at)
        elif kind in AUTOTUNE_EVENT_BYTES:
            at += AUTOTUNE_EVENT_BYTES[kind]
        elif kind == 13:
            # An adjustment, to a float or to a whole number.
            at = at + 5 if data[at] & 0x80 else signed(data, at + 1)[1]
        elif kind == 14:
            # Logging goes on.
            count, at = unsigned(data, at)
            time, at = unsigned(data, at)
            resumed = (count, time)
        elif kind == 30:
            # Flags of the flight mode, and those before.
            at = unsigned(data, unsigned(data, at)[1])[1]
        elif kind == ENDEVENT and data.startswith(END, at):
            ended = True
        else:
            return at, None

        def apply() -> None:
            self.accepted = resumed or self.accepted
            self.ended = ended

        return at, apply


def _is_successor(before: tuple[int, int], here: tuple[int, int]) -> bool:
    """Return whether iteration and time go forward, and not far; both have 32 bits and may roll over."""
    return (here[0] - before[0]) & MASK < MOST_COUNTS and (here[1] - before[1]) & MASK < MOST_US


def _make_channels(head: Head, frames: _FrameReader) -> dict[str, Channel]:
    layout = head.layouts["I"]
    table = np.frombuffer(frames.rows, np.int64).reshape(-1, len(layout.names))
    time = table[:, layout.names.index("time")] if "time" in layout.names else np.arange(len(table))
    turns = np.concatenate([[0], np.cumsum(np.diff(time) < -(1 << 31))])  # of 32 bits
    times = 1e-6 * (time + turns * (1 << 32)).astype(np.float64)
    fine = 0.1 if head.number("blackbox_high_resolution", 0) else 1.0
    gyro = head.number("gyro_scale", 1.0)
    channels: dict[str, Channel] = {}
    totals: dict[str, list[np.ndarray]] = {}
    for n, name in enumerate(layout.names):
        values = table[:, n].astype(np.float64)
        match = _NAME.match(name)
        kind, number = (match.group(1), match.group(2)) if match else (name, "")
        unit = ""
        if kind in ("gyroADC", "gyroUnfilt"):
            values, unit = values * fine * gyro, "deg/s"
        elif (kind == "setpoint" and number != "3") or kind == "rcCommand":
            values, unit = values * fine, "deg/s" if kind == "setpoint" else ""
        elif kind in ("axisP", "axisI", "axisD", "axisF", "axisS"):
            totals.setdefault(number, []).append(values)
        if name != "time":
            channels[name] = Channel(times, values, unit)
    for number, columns_of_kind in totals.items():
        channels[f"axisSum[{number}]"] = Channel(times, np.sum(columns_of_kind, axis=0))
    for kind, rows in frames.others.items():
        names = head.layouts[kind].names
        when = 1e-6 * np.array([at for at, _ in rows], np.float64)
        for n, name in enumerate(names):
            if name != "time" and name not in channels:
                channels[name] = Channel(when, np.array([row[n] for _, row in rows], np.float64))
    return channels
