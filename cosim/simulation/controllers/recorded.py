"""Actuator commands that were recorded, as a controller: a flight with an autopilot of others again, without it.

The file is a table, ``actuators.csv``: a first line of names, ``throttle_1`` and on and, of a vehicle with servos,
``tilt_left_rad`` and ``tilt_right_rad``, and one line a control step.  What follows are columns for the log, those of
:data:`COLUMNS`.  Numbers are written so that they are read to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from cosim.base.errors import FlightError, InputError, nearest
from cosim.base.protocols import Applied, Column
from cosim.base.signals import Actuation, Command, Measured, PerJet, Unallocated
from cosim.base.storage.files import read_text

ACTUATORS = "actuators.csv"  # table in a run's folder
TILT_COLUMNS = ("tilt_left_rad", "tilt_right_rad")  # columns of the tilt servos
COLUMNS = (  # optional columns of the table
    Column("autopilot_armed", "1", "", "the autopilot drives the engines: 1; they stand at what it gives disarmed: 0"),
    Column("autopilot_time_s", "s", "", "time since the autopilot was told of its first state, before the flight"),
)
Row = tuple[PerJet, tuple[float, float], tuple[float, ...]]  # throttles, tilts [rad], own columns


def format_header(jets: int, servo: bool) -> str:
    """Return the header line of a table of actuator commands."""
    tilts = TILT_COLUMNS if servo else ()
    return ",".join([*(f"throttle_{number}" for number in range(1, jets + 1)), *tilts, *[c.name for c in COLUMNS]])


def format_row(row: Row, servo: bool) -> str:
    """Return one step's line of a table of actuator commands."""
    throttle, tilt, shown = row
    return ",".join([repr(value) for value in (*throttle, *(tilt if servo else ()), *shown)])


def read_commands(path: Path, where: str) -> tuple[list[Row], tuple[Column, ...]]:
    """Read recorded actuator commands: rows, and columns for the log.  Raises InputError that begins with ``where``."""
    try:
        first, *lines = read_text(path).splitlines()
    except ValueError as error:
        raise InputError(f"{where}: {path}: is no table of actuator commands: {error or 'it is empty'}") from None
    names = first.split(",")
    jets = 0
    while jets < len(names) and names[jets] == f"throttle_{jets + 1}":
        jets += 1
    servo = tuple(names[jets : jets + 2]) == TILT_COLUMNS
    extra_names = names[jets + (2 if servo else 0) :]
    columns_by_name = {column.name: column for column in COLUMNS}
    if not jets:
        raise InputError(f"{where}: {path}, line 1: {names[0]!r}: must be throttle_1, throttle_2 and on, then tilts")
    for name in extra_names:
        if name not in columns_by_name:
            raise InputError(f"{where}: {path}, line 1: {name!r}: {nearest(name, [*TILT_COLUMNS, *columns_by_name])}")
    rows: list[Row] = []
    for number, text in enumerate(lines, 2):
        values = _parse_numbers(text)
        if len(values) != len(names):
            if number == len(lines) + 1:  # the last line of a killed process
                break
            raise InputError(f"{where}: {path}, line {number}: must be {len(names)} finite numbers")
        tilt = (values[jets], values[jets + 1]) if servo else (0.0, 0.0)
        rows.append((tuple(values[:jets]), tilt, tuple(values[len(names) - len(extra_names) :])))
    return rows, tuple([columns_by_name[name] for name in extra_names])


def _parse_numbers(text: str) -> list[float]:
    """Return the cells of a line as numbers; empty if one is not a finite number."""
    try:
        values = [float(cell) for cell in text.split(",")]
    except ValueError:
        return []
    return values if all(map(isfinite, values)) else []


class RecordedController:
    """Controller that repeats recorded actuator commands, whatever is measured."""

    level = "controller"

    def __init__(self, rows: Sequence[Row], columns: Sequence[Column]) -> None:
        self._rows, self.columns = rows, tuple(columns)
        self.reset()

    def reset(self) -> None:
        """Start at the first row."""
        self._next = 0
        self.shown: tuple[float, ...] = (0.0,) * len(self.columns)

    def update(self, command: Command, measured: Measured, applied: Applied) -> Actuation:
        """Return the commands of the next row.  Raises FlightError behind the last."""
        if self._next >= len(self._rows):
            raise FlightError(f"the record ends after {len(self._rows)} steps")
        throttle, tilt, self.shown = self._rows[self._next]
        self._next += 1
        return Actuation(throttle, tilt, Unallocated())
