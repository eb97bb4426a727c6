"""One short text for a whole log, by which two flights are known to be the same bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

import numpy as np

from cosim.base.arrays import Array
from cosim.base.constants import SERVOS
from cosim.base.protocols import Column
from cosim.results.log.columns import log_columns, logged_vehicle_of, require
from cosim.results.log.recorder import Log, MemoryLog


class Digest:
    """SHA-256 of a log, however it is divided into blocks.

    Every column has a hash of its own, over its numbers as little-endian float64, every NaN as 7ff8000000000000
    (processors differ in the sign that they give it) and 0 and -0 apart.  The digest is the hash of all names, each
    ended by a zero byte and followed by its column's hash.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._columns = [(name, sha256()) for name in names]

    def update(self, table: Array) -> None:
        """Add the rows that follow, shape (columns, rows)."""
        same = table.astype("<f8", order="C")  # copies if needed
        same[np.isnan(table)] = np.nan
        for (_, column), values in zip(self._columns, same, strict=True):
            column.update(values)

    def hexdigest(self) -> str:
        total = sha256()
        for name, column in self._columns:
            total.update(name.encode() + b"\0" + column.digest())
        return total.hexdigest()


def log_digest(log: Log, block: int = 2048) -> str:
    """Return the :class:`Digest` of a finished log, read in blocks of ``block`` rows, some 2 MB."""
    digest = Digest(log.columns)
    for columns in log.blocks(log.columns, block):
        digest.update(np.stack(list(columns.values())))
    return digest.hexdigest()


class DigestSink:
    """Sink of campaign flights: keeps the columns ``names`` and the :class:`Digest` of all.

    The 73 columns that metrics and limits need (:func:`cosim.results.metrics.columns`) come to 0.53 GB an hour at
    250 Hz, all to 0.9 GB, which are kept if ``whole``.
    """

    def __init__(self, names: Sequence[str], whole: bool = False) -> None:
        self._names, self._whole = tuple(names), whole
        self._kept: list[Array] = []
        logged = logged_vehicle_of(self._names)  # unknown until the flight begins
        self.begin(log_columns(logged._replace(servos=logged.servos or SERVOS)))

    def begin(self, columns: Sequence[Column]) -> None:
        """Receive the log's columns before its first block, as every ``KeepingSink``."""
        names = [column.name for column in columns]
        chosen = names if self._whole else [require(name, names) for name in self._names]
        self._chosen = tuple(chosen)
        self._indices = [names.index(name) for name in chosen]
        self._described = tuple(columns[index] for index in self._indices)
        self._digest = Digest(names)

    def write(self, table: Array) -> None:
        self._digest.update(table)
        self._kept.append(table[self._indices])

    def hexdigest(self) -> str:
        return self._digest.hexdigest()

    def log(self) -> Log:
        """Return the rows that were kept."""
        return MemoryLog(self._kept, self._chosen, self._described)
