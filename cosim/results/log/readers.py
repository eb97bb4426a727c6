"""Logs that are not ours: installed packages read them, by the entry points ``hexjet.logs``.

Each names a module, or another object, that has the two functions of :class:`LogReader`.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Protocol

from cosim.base.errors import InputError
from cosim.base.plugins.entry_points import list_tools
from cosim.results.log.recorder import MemoryLog

GROUP = "hexjet.logs"  # entry points of readers of other logs


class LogReader(Protocol):
    """Reader of logs of flight controllers and of other tools' tables."""

    def is_flight_log(self, path: Path) -> bool:
        """Return whether a file is the log of a flight controller that this reader knows by its first bytes."""
        ...

    def read_flight_columns(self, path: Path) -> tuple[MemoryLog, tuple[str, ...]]:
        """Return a log, or a ``.csv`` or ``.parquet`` table, under our column names, and remarks.

        Raises InputError.
        """
        ...


def is_flight_log(path: Path) -> bool:
    """Return whether a file is the log of a flight controller that an installed package can read."""
    return any(reader.is_flight_log(path) for reader in _readers())


def read_flight_log(path: Path) -> tuple[MemoryLog, tuple[str, ...]]:
    """Return a foreign log under our column names, and remarks.

    The reader that knows the file reads it, or the first one.  Raises InputError where none is installed.
    """
    readers = _readers()
    if not readers:
        raise InputError(f"{path}: no package that reads logs is installed: hexjet_identify is one")
    return next((each for each in readers if each.is_flight_log(path)), readers[0]).read_flight_columns(path)


@cache
def _readers() -> tuple[LogReader, ...]:
    return tuple(entry.load() for entry in list_tools(GROUP))
