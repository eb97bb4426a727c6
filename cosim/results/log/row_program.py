"""How the columns' sources become a program: what the C of ``_rows.c`` runs once a step to make a row of the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.protocols import Column
from cosim.base.signals import (
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    Sample,
    State,
    Unallocated,
)
from cosim.results.log.columns import require

_RECORDS = {  # type of each part of a sample
    "": Sample, "command": Command, "state": State, "measured": Measured, "control": ControlSignals,
    "actuation": Actuation, "actuation.unallocated": Unallocated, "engines": EngineOutput, "disturbance": Disturbance,
}  # fmt: skip
_OPTIONAL = ("command.place",)  # parts that may be None
_AT_LEAST = ("health",)  # parts that may have further elements


def _roll(w: Array, x: Array, y: Array, z: Array) -> Array:
    angle: Array = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return angle


def _pitch(w: Array, x: Array, y: Array, z: Array) -> Array:
    angle: Array = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    return angle


def _yaw(w: Array, x: Array, y: Array, z: Array) -> Array:
    angle: Array = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return angle


# Functions of a quaternion's elements w, x, y, z, as cosim.base.frames.to_euler, but for whole blocks with numpy, whose
# arctan2 differs from the C library's.
ANGLES: dict[str, Callable[[Array, Array, Array, Array], Array]] = {"roll": _roll, "pitch": _pitch, "yaw": _yaw}


class Angle(NamedTuple):
    """A column with an angle that is computed from the four elements of a quaternion, by blocks."""

    column: int
    first: int  # of the quaternion's elements in the row
    law: Callable[[Array, Array, Array, Array], Array]


class Program(NamedTuple):
    """Plan that flattens a sample into ``width`` numbers: the log columns, then the quaternions of angles.

    ``nodes``: the tuples to open, each by its name, the node it is in (-1: it is the sample) and its place there, how
    many elements it has (negative: at least), and whether it may be None.  ``reads``: from a node, from an element on,
    so many to a column and those behind it, NaN if the element of another node (-1: of none) is not None, to be added
    to what is there (1) or not.  Columns that no read gives are NaN.
    """

    width: int
    nodes: list[tuple[str, int, int, int, bool]]
    reads: list[tuple[int, int, int, int, int, int, bool]]
    angles: list[Angle]


def program(columns: Sequence[Column]) -> Program:
    """Return the plan for these columns.  Raises InputError for a column whose source a sample lacks."""
    return _compile_program(tuple(columns))


@lru_cache(16)
def _compile_program(columns: tuple[Column, ...]) -> Program:
    compiled = _Compiler()
    angles: list[Angle] = []
    quaternions: dict[str, int] = {}
    width = len(columns)
    for n, column in enumerate(columns):
        law, _, quaternion = column.source.partition(" of ")
        place, _, other = column.source.partition(" unless ")
        if quaternion:
            if quaternion not in quaternions:
                quaternions[quaternion] = width
                for element in range(4):
                    compiled.add_read(f"{quaternion}.{element}", width + element)
                width += 4
            if law not in ANGLES:
                raise InputError(f"column {column.name!r}: no angle {law!r}; allowed: {', '.join(ANGLES)}")
            angles.append(Angle(n, quaternions[quaternion], ANGLES[law]))
        elif place:
            for k, part in enumerate(place.split(" + ")):
                try:
                    compiled.add_read(part, n, other, k > 0)
                except InputError:
                    raise
                except ValueError:
                    raise InputError(f"column {column.name!r}: no place of a sample: {part!r}") from None
    return Program(width, *compiled.get_plan(), angles)


class _Compiler:
    """Makes a program: nodes, the parts of a sample to visit, and reads, what is copied from them into columns."""

    def __init__(self) -> None:
        self._nodes: dict[str, tuple[int, int, int]] = {}  # node, its parent, index in the parent
        self._sizes: dict[str, int] = {}
        self._reads: list[tuple[int, int, int, int, int, int, bool]] = []
        self._add_node("")

    def add_read(self, source: str, column: int, other: str = "", add: bool = False) -> None:
        node, element = self._find(source)
        unless = self._find(other) if other else (-1, 0)
        last = self._reads[-1] if self._reads else None
        if last and (last[0], last[1] + last[2], last[3] + last[2], *last[4:]) == (node, element, column, *unless, add):
            self._reads[-1] = (node, last[1], last[2] + 1, *last[3:])
        else:
            self._reads.append((node, element, 1, column, *unless, add))

    def get_plan(self) -> tuple[list[tuple[str, int, int, int, bool]], list[tuple[int, int, int, int, int, int, bool]]]:
        nodes = [
            (name or "it", parent, element, self._sizes[name] * (-1 if name in _AT_LEAST else 1), name in _OPTIONAL)
            for name, (_, parent, element) in self._nodes.items()
        ]
        return nodes, self._reads

    def _find(self, source: str) -> tuple[int, int]:
        """Return the node that holds a source, and its index there."""
        parent, _, element = source.rpartition(".")
        node = self._add_node(parent)
        if parent in _RECORDS:
            fields: tuple[str, ...] = _RECORDS[parent]._fields  # type: ignore[attr-defined]
            index = int(element) if element.isdigit() else fields.index(require(element, fields, f"record {parent!r}"))
        else:
            index = int(element)
            self._sizes[parent] = max(self._sizes[parent], index + 1)
        return node, index

    def _add_node(self, name: str) -> int:
        if name not in self._nodes:
            parent, element = self._find(name) if name else (-1, 0)
            self._nodes[name] = (len(self._nodes), parent, element)
            self._sizes[name] = len(_RECORDS[name]._fields) if name in _RECORDS else 0  # type: ignore[attr-defined]
        return self._nodes[name][0]
