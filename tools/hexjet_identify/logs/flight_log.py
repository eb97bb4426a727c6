"""What every log comes to: channels with times of their own, and sums of channels under one name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest

_QUOTED = r"""'[^']*'|"[^"]*\""""
_NAME = rf"(?:deg|square)\(\s*(?:{_QUOTED})\s*\)|{_QUOTED}|[A-Za-z_][^\s+*'\"]*"
_TERM = re.compile(rf"\s*([+-])?\s*(?:([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*\*\s*)?({_NAME})")
UNIT_AT_END = re.compile(r"(?:.*_)?(N|kN|mN|kgf|gf|lbf|rpm|krpm|V|percent|pct|us)")
SPEED_AT_END = re.compile(r"(?:.*[_ ])?(k?rpm)", re.IGNORECASE)
SAME_UNITS = {"%": "percent", "pct": "percent"} | dict.fromkeys(
    ("rpm", "1/min", "u/min", "r/min", "rev/min", "min-1", "min^-1"), "rpm"
)  # in small letters
SAME_UNITS |= {"krpm": "krpm", "µs": "us", "μs": "us"}
DEGREE = np.pi / 180.0
MAX_LOG_MB = 4096.0  # of a file that is read as a log
# The head of a log may stand behind other data, within so many bytes.
SEARCHED_BYTES = 2**16
# More instances of one message are damaged data.
MAX_INSTANCES = 256
# Types of numpy for numbers in a log's bytes, by the letters of struct.
NUMPY_TYPES = {
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "f": "<f4",
    "d": "<f8",
}


class Channel(NamedTuple):
    """One quantity of a log: ``values[i]`` at ``times[i]`` [s]."""

    times: Array
    values: Array
    unit: str = ""

    def extent(self) -> dict[str, float | int | str]:
        """Return the count of values, their span in s and their rate in Hz, which are 0 without usable times."""
        seconds = float(self.times[-1] - self.times[0]) if len(self.times) else 0.0
        seconds = seconds if np.isfinite(seconds) else 0.0
        rate = (len(self.times) - 1) / seconds if seconds > 0.0 else 0.0
        return {"values": len(self.times), "seconds": seconds, "rate_hz": rate, "unit": self.unit}


class LogSignals(NamedTuple):
    """Command, output and set-point in a log: sums of channels, as :meth:`FlightLog.signal` takes them."""

    command: str
    output: str
    setpoint: str = ""
    command_unit: str = "1"
    output_unit: str = "rad/s"


@dataclass(frozen=True)
class FlightLog:
    """A log: channels by name, its ``kind``, and ``remarks`` on the file."""

    path: Path
    kind: str
    channels: Mapping[str, Channel]
    remarks: tuple[str, ...] = ()
    engine: str = ""  # what flew, where the log says so

    def signal(self, text: str, notes: list[str] | None = None, min_shared: float = 0.5) -> Channel:
        """Return a channel, or a sum such as ``m1 + m2 - 0.5*m3``.

        ``deg(NAME)`` is a channel in degrees brought to radians, ``square(NAME)`` its square, as a rotor's thrust goes
        with that of its speed.  A text that is a channel's name is that channel; in a sum quotes hold a name with
        blanks or brackets: ``deg('gyro (deg/s)')``.  Rows of a sum whose stamp not all of its channels have are left
        out, which ``notes`` then says.  Raises InputError for a name that the log has not, and for channels of which
        at most ``min_shared`` of the rows have equal times.
        """
        total: Channel | None = None
        longest = 0
        for factor, name in self._parse_terms(text):
            taken, inner = _split_function(name)
            if inner not in self.channels:
                raise InputError(f"{self.path}: no channel {inner!r}; {nearest(inner, self.channels)}"[:600])
            channel = self.channels[inner]
            term = channel._replace(values=factor * _FUNCTIONS[taken](channel.values))
            longest = max(longest, len(channel.times))
            if total is None:
                total = term._replace(unit=f"({channel.unit})^2" if taken == "square" else channel.unit)
                continue
            if not np.array_equal(total.times, term.times):
                least = min_shared * min(len(total.times), len(term.times))
                total, term = _share_times(total, term)
                if not len(term.times) > least:
                    raise InputError(f"{self.path}: {text!r}: its channels do not have the same times")
            total = total._replace(values=total.values + term.values)
        assert total is not None
        if notes is not None and len(total.times) < longest:
            missing = longest - len(total.times)
            notes.append(f"{text}: {missing} of {longest} rows have a time that not all of its channels have; left out")
        return total

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of the log for JSON: each channel's unit, count of values, span [s] and rate [Hz]."""
        return {
            "log": str(self.path),
            "kind": self.kind,
            "notes": list(self.remarks),
            "channels": [{"name": name, **channel.extent()} for name, channel in self.channels.items()],
        }

    def has(self, text: str) -> bool:
        """Return whether the log has all channels of a sum."""
        try:
            return bool(text) and all(_split_function(name)[1] in self.channels for _, name in self._parse_terms(text))
        except InputError:  # neither a name that it has nor a sum
            return False

    def _parse_terms(self, text: str) -> list[tuple[float, str]]:
        """Return the factors and names of a sum, or the one channel of that name."""
        name = text.strip()
        return [(1.0, repr(name))] if name in self.channels and not {"'", '"'} & set(name) else parse_sum(text)


def _share_times(first: Channel, second: Channel) -> tuple[Channel, Channel]:
    """Return the rows of two channels at common times; of equal times the first row."""
    times, rows = np.unique(second.times, return_index=True)
    alone = np.zeros(len(first.times), bool)
    alone[np.unique(first.times, return_index=True)[1]] = True
    index = np.minimum(np.searchsorted(times, first.times), max(len(times) - 1, 0))
    use = alone & (times[index] == first.times) if len(times) else alone & False
    matched = rows[index[use]] if len(times) else rows[:0]
    return (
        first._replace(times=first.times[use], values=first.values[use]),
        second._replace(times=second.times[matched], values=second.values[matched]),
    )


_FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "": lambda values: values,
    "deg": lambda values: DEGREE * values,
    "square": np.square,
}


def _split_function(name: str) -> tuple[str, str]:
    """Split a term such as ``deg(NAME)`` into the function, "" for none, and the channel's name without quotes."""
    taken, bracket, tail = name.partition("(")
    if bracket and taken in _FUNCTIONS and tail.endswith(")"):
        return taken, _unquote(tail[:-1].strip())
    return "", _unquote(name)


def _unquote(name: str) -> str:
    return name[1:-1] if len(name) > 1 and name[0] == name[-1] and name[0] in "'\"" else name


def numbers(values: Any) -> Array:
    """Return values as floats; damaged bytes may be any number, or a NaN, which is made a quiet one."""
    with np.errstate(invalid="ignore"):
        numeric = np.asarray(values).astype(np.float64)
    return np.where(np.isnan(numeric), np.nan, numeric)


def name_instances(name: str, rows: np.ndarray, column: str, fewest: int = 1) -> list[tuple[str, Any]]:
    """Return the name and the indices of the rows of each instance of a message, which ``column`` numbers.

    All rows are of one where there is no such column, or it has fewer numbers than ``fewest`` or too many for that.
    """
    if column:
        found, which = np.unique(rows[column], return_inverse=True)
        if fewest <= len(found) <= MAX_INSTANCES:
            return [(f"{name}[{number}]", np.flatnonzero(which == n)) for n, number in enumerate(found.tolist())]
    return [(name, slice(None))]


def parse_sum(text: str) -> list[tuple[float, str]]:
    """Return the factors and names of a sum of channels.  Raises InputError for a text that is no sum."""
    summands, at = [], 0
    while at < len(text.rstrip()):
        match = _TERM.match(text, at)
        if match is None or (at > 0 and match.group(1) is None):
            raise InputError(
                f"{text!r}: is no sum of channels, such as m1 + m2 - 0.5*m3 (blanks around + and -, quotes around a "
                "name with blanks or brackets: deg('gyro (deg/s)'))"
            )
        sign, factor, name = match.groups()
        summands.append(((-1.0 if sign == "-" else 1.0) * (float(factor) if factor else 1.0), name))
        at = match.end()
    if not summands:
        raise InputError("a channel, or a sum of channels, is needed")
    return summands


def unit_of(name: str, unit: str, max_letters: int = 3) -> str:
    """Return a channel's unit, by its log or by the end of its name; "" where neither says one.

    A word in brackets that is no unit, as of ``RPM (actual)``, leaves the unit to what stands before it: one of more
    than ``max_letters`` that is not known.
    """
    unit = "percent" if unit.endswith("%") else SAME_UNITS.get(unit.lower(), unit)
    if unit and not (len(unit) > max_letters and unit.isalpha() and unit not in SAME_UNITS.values()):
        return unit
    bare = name.partition("(")[0].partition("[")[0].strip() or name
    match = UNIT_AT_END.fullmatch(bare) or SPEED_AT_END.fullmatch(bare)
    return SAME_UNITS.get(match.group(1).lower(), match.group(1)) if match else unit
