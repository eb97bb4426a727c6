"""Delay lines over a batch: a ring of past values, whose length may differ from flight to flight."""

from __future__ import annotations

from typing import Any

import numpy as np


def make_ring(delay: Any, value: Any, xp: Any) -> Any:
    """Return a ring for a delay [steps], a number or one a flight, as if ``value`` had been there for ever.

    Its shape is one row more than the longest delay by that of ``value``; None for no delay.
    """
    longest = int(np.max(delay))
    return xp.stack([value] * (longest + 1)) if longest else None


def put(ring: Any, row: Any, value: Any) -> Any:
    """Return a ring with another row: NumPy's arrays are written in place, others are copied by their library."""
    if isinstance(ring, np.ndarray):
        ring[row] = value
        return ring
    return ring.at[row].set(value)


def push(ring: Any, k: Any, delay: Any, value: Any, xp: Any) -> tuple[Any, Any]:
    """Put in the value of step ``k`` and return the ring, and the value of ``delay`` steps before."""
    if ring is None:
        return ring, value
    rows = ring.shape[0]
    ring = put(ring, k % rows, value)
    if isinstance(delay, (int, float)):
        return ring, xp.asarray(ring[(k - int(delay)) % rows], copy=True)
    at = (k - delay.astype(np.int64)) % rows
    return ring, xp.take_along_axis(ring, xp.broadcast_to(at, (1, *ring.shape[1:])), axis=0)[0]
