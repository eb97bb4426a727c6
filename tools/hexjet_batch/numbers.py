"""Numbers of a batch: what differs between flights is an array over them, what all share is a plain number."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np


class Numbers(SimpleNamespace):
    """Numbers by name: those of aircraft, engine and scenario keep the names of their files."""

    def replace(self, **changes: Any) -> Numbers:
        """Return a copy with other values."""
        return Numbers(**{**vars(self), **changes})


def name_values(value: Any) -> Any:
    """Return tables as :class:`Numbers` and lists as tuples."""
    if isinstance(value, dict):
        return Numbers(**{key: name_values(entry) for key, entry in value.items()})
    return tuple(map(name_values, value)) if isinstance(value, (list, tuple)) else value


def stack(values: Sequence[Any]) -> Any:
    """Return values of the flights as one: a number that all share stays one, else it becomes an array over them.

    Tables and tuples, named ones too, are stacked entry by entry; what is no number must be the same in all flights.
    Raises ValueError where flights differ in structure: in the length of a tuple, in a text.
    """
    first = values[0]
    if all(value is first for value in values):
        return first
    if isinstance(first, Numbers):
        tables = [vars(value) for value in values]
        return Numbers(**{name: stack([table[name] for table in tables]) for name in tables[0]})
    if isinstance(first, tuple):
        members = [stack(column) for column in zip(*values, strict=True)]
        return type(first)(*members) if hasattr(first, "_fields") else tuple(members)
    if _is_number(first):
        row = np.array(values, dtype=np.float64)
        return first if np.all(row == row[0]) else row
    if any(describe(value) != describe(first) for value in values):
        raise ValueError("flights of one batch differ in structure")
    return first


def describe(value: Any) -> Any:
    """Return all of a value but its numbers, which must be equal for flights to be stacked."""
    if isinstance(value, Numbers):
        return tuple((name, describe(entry)) for name, entry in vars(value).items())
    if isinstance(value, tuple):
        return tuple(map(describe, value))
    return value.tobytes() if isinstance(value, np.ndarray) else "number" if _is_number(value) else value


def limit(value: Any, low: Any, high: Any, xp: Any) -> Any:
    """Return a value within limits: what ``xp.clip`` does, which takes three times as long over a thousand flights."""
    return xp.minimum(xp.maximum(value, low), high)


def is_absent(*values: Any) -> bool:
    """Return whether each is the plain number 0, for all flights; by a loop, in half the time of a generator."""
    for value in values:  # noqa: SIM110
        if not isinstance(value, (int, float)) or value != 0:
            return False
    return True


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
