"""A packed column of a page as its script restores it."""

from __future__ import annotations

import base64
import zlib

import numpy as np

from cosim.base.arrays import Array
from cosim.results.report.signals_data import Packed


def unpack(column: Packed, rows: int) -> Array:
    """Return the values of a packed column as a page restores them: the inverse of ``pack``."""
    if not column.data:
        return np.full(rows, column.base)
    raw = np.frombuffer(zlib.decompress(base64.b64decode(column.data)), dtype=np.uint8)
    zigzag = np.zeros(rows, dtype=np.int64)
    for n in range(column.planes):
        zigzag |= raw[n * rows : (n + 1) * rows].astype(np.int64) << (8 * n)
    numbers = (zigzag >> 1) ^ -(zigzag & 1)
    for _ in range(column.order):
        numbers = np.cumsum(numbers)
    values: Array = column.base + column.step * numbers.astype(np.float64)
    if column.gaps:
        values[raw[column.planes * rows :] == 1] = np.nan
    return values
