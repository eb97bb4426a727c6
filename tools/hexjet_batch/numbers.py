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
    if isinstance(first, Numbers):
        return Numbers(**{key: stack([getattr(value, key) for value in values]) for key in vars(first)})
    if isinstance(first, tuple):
        members = [stack(member) for member in zip(*values, strict=True)]
        return type(first)(*members) if hasattr(first, "_fields") else tuple(members)
    if _is_number(first) and any(value != first for value in values):
        return np.array(values, dtype=np.float64)
    if not _is_number(first) and any(find_structure(value) != find_structure(first) for value in values):
        raise ValueError("flights of one batch differ in structure")
    return first


def find_structure(value: Any) -> Any:
    """Return what must be equal for flights to be stacked: the shapes of numbers, and all that is no number."""
    if isinstance(value, Numbers):
        return tuple((key, find_structure(entry)) for key, entry in vars(value).items())
    if isinstance(value, tuple):
        return tuple(find_structure(entry) for entry in value)
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return "number" if _is_number(value) else value


def is_absent(*values: Any) -> bool:
    """Return whether no flight has what these numbers are of: each is the plain number 0."""
    return all(isinstance(value, (int, float)) and value == 0 for value in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
