"""What every log comes to: channels with times of their own, and sums of channels under one name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, nearest

_TERM = re.compile(r"\s*([+-])?\s*(?:([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*\*\s*)?([A-Za-z_][^\s+*]*)")
DEGREE = np.pi / 180.0


class Channel(NamedTuple):
    """One quantity of a log: ``values[i]`` at ``times[i]`` [s]."""

    times: Array
    values: Array
    unit: str = ""


class LogSignals(NamedTuple):
    """What to look at in a log: sums of channels, as :meth:`FlightLog.signal` takes them."""

    command: str
    output: str
    setpoint: str = ""
    command_unit: str = "1"
    output_unit: str = "rad/s"


@dataclass(frozen=True)
class FlightLog:
    """A log: ``kind`` is what wrote it, ``remarks`` what is to be said of the file, ``events`` what it says itself."""

    path: Path
    kind: str
    channels: Mapping[str, Channel]
    remarks: tuple[str, ...] = ()
    events: Sequence[tuple[float, str]] = field(default=())
    engine: str = ""  # what flew, where the log says so

    def signal(self, text: str) -> Channel:
        """A channel, or a sum such as ``m1 + m2 - 0.5*m3``; ``deg(NAME)`` is one in degrees, brought to radians, and
        ``square(NAME)`` its square, as a rotor's thrust goes with that of its speed.

        The terms must have the same times.  Raises InputError for a name that the log has not.
        """
        total: Array | None = None
        times: Array | None = None
        unit = ""
        for factor, name in terms(text):
            taken, inner = _inner(name)
            if inner not in self.channels:
                raise InputError(f"{self.path}: no channel {inner!r}; {nearest(inner, self.channels)}"[:600])
            channel = self.channels[inner]
            term = factor * _TAKEN[taken](channel.values)
            if times is None or total is None:
                times, total, unit = channel.times, term, f"({channel.unit})^2" if taken == "square" else channel.unit
            elif len(times) == len(channel.times) and bool(np.array_equal(times, channel.times)):
                total = total + term
            else:
                raise InputError(f"{self.path}: {text!r}: its channels do not have the same times")
        assert times is not None
        assert total is not None
        return Channel(times, total, unit)

    def has(self, text: str) -> bool:
        """Whether the log has all channels of a sum."""
        return bool(text) and all(_inner(name)[1] in self.channels for _, name in terms(text))


_TAKEN: dict[str, Callable[[Array], Array]] = {
    "": lambda values: values,
    "deg": lambda values: DEGREE * values,
    "square": np.square,
}


def _inner(name: str) -> tuple[str, str]:
    """What is made of a channel in a term, such as ``deg(NAME)``, and the channel."""
    taken, bracket, rest = name.partition("(")
    return (taken, rest[:-1]) if bracket and taken in _TAKEN and rest.endswith(")") else ("", name)


def numbers(values: Any) -> Array:
    """As floats; bytes that are damaged may be any number, or none."""
    with np.errstate(invalid="ignore"):
        return np.asarray(values).astype(np.float64)


def terms(text: str) -> list[tuple[float, str]]:
    """The factors and names of a sum.  Raises InputError for what is none."""
    summands, at = [], 0
    while at < len(text.rstrip()):
        match = _TERM.match(text, at)
        if match is None or (at > 0 and match.group(1) is None):
            raise InputError(f"{text!r}: is no sum of channels, such as m1 + m2 - 0.5*m3 (blanks around + and -)")
        sign, factor, name = match.groups()
        summands.append(((-1.0 if sign == "-" else 1.0) * (float(factor) if factor else 1.0), name))
        at = match.end()
    if not summands:
        raise InputError("a channel, or a sum of channels, is needed")
    return summands
