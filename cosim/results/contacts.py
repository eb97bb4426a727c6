"""Where a flight's log has the vehicle on the ground, and what follows from it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.protocols import Columns

CONTACTS = ("leaves the ground", "touches the ground")  # event when a leg lifts off, touches


def find_contact_rows(log: Columns) -> NDArray[np.bool_]:
    """Return the rows on which a leg or the hull touches the ground."""
    return (log["on_ground"] > 0.0) | (log["hull_contact"] > 0.0)


def find_contact_changes(contact: NDArray[np.bool_], step_s: float, apart_s: float = 0.5) -> Iterator[tuple[int, bool]]:
    """Yield rows on which the vehicle leaves the ground (False) or comes to stand on it (True), without bounces.

    ``apart_s``: contacts nearer to each other than this are one.
    """
    edges = np.flatnonzero(np.diff(contact.astype(np.int8))) + 1
    last = contact[0]
    for index, row in enumerate(edges.tolist()):
        following = edges[index + 1] if index + 1 < edges.size else contact.size
        if contact[row] != last and (following - row) * step_s >= apart_s:
            last = contact[row]
            yield row, bool(last)


def height_error(setpoint: Array, altitude: Array, contact: NDArray[np.bool_] | None = None) -> Array:
    """Return the set-point of the height minus the height (m) in every row.

    Where the vehicle stands (``contact``) and a lower height is asked for there is no error: the ground carries it.
    """
    error = setpoint - altitude
    if contact is not None:
        error[contact & (error < 0.0)] = 0.0
    return error
