"""Numbers of a batch: what differs between flights is an array over them, what all share is a plain number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
    if len(values) == 1:
        return values[0]
    rows: list[list[float]] = [[] for _ in values]
    structures = [flatten(value, row) for value, row in zip(values, rows, strict=True)]
    if any(structure != structures[0] for structure in structures):
        raise ValueError("flights of one batch differ in structure")
    return stack_rows(values[0], rows)


def stack_rows(value: Any, rows: Sequence[Sequence[float]]) -> Any:
    """Return the values of the flights as one, from one of them and the numbers of each by :func:`flatten`."""
    if len(rows) == 1:
        return value
    table = np.ascontiguousarray(np.array(rows, dtype=np.float64).T)
    is_shared = np.all(table == table[:, :1], axis=1).tolist()
    return _build(value, iter([x if same else row for x, row, same in zip(rows[0], table, is_shared, strict=True)]))


def flatten(value: Any, numbers: list[float]) -> Any:
    """Append the numbers of a value and return all else, which must be equal for flights to be stacked."""
    if type(value) is float or _is_number(value):
        numbers.append(value)
        return "number"
    if isinstance(value, tuple):
        return tuple([flatten(entry, numbers) for entry in value])
    if isinstance(value, Numbers):
        own = vars(value)
        return (*own, *[flatten(entry, numbers) for entry in own.values()])
    return value.tobytes() if isinstance(value, np.ndarray) else value


def _build(value: Any, numbers: Iterator[Any]) -> Any:
    """Return a value with other numbers, in the order of :func:`flatten`."""
    if _is_number(value):
        return next(numbers)
    if isinstance(value, tuple):
        members = [_build(entry, numbers) for entry in value]
        return type(value)(*members) if hasattr(value, "_fields") else tuple(members)
    if isinstance(value, Numbers):
        return Numbers(**{key: _build(entry, numbers) for key, entry in vars(value).items()})
    return value


def is_absent(*values: Any) -> bool:
    """Return whether no flight has what these numbers are of: each is the plain number 0."""
    return all(map(_is_zero, values))


def _is_zero(value: Any) -> bool:
    return isinstance(value, (int, float)) and value == 0


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
