"""Reading a log for figures: its columns thinned out, and the intervals in which something disturbs the flight."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.signals import AXES
from cosim.results.comparison import ComparedFlight, median_step
from cosim.results.events import row_spans
from cosim.results.log.recorder import Log
from cosim.results.log.tables import TIME
from cosim.results.report.plot import Figure

_DISTURBANCE_COLUMNS = (
    *(f"disturbance_force_{x}_N" for x in "xyz"),
    *(f"disturbance_moment_{x}_N_m" for x in "xyz"),
    *(f"disturbance_torque_{axis}" for axis in AXES),
    "payload_kg",
)


class Reader:
    """Columns of a log in the form that Plotly needs, with fewer rows where they are more than can be seen."""

    def __init__(self, log: Log, step_s: float, times: Array | None = None) -> None:
        self.log = log
        self.step_s = step_s
        self._times = times  # None: 0, step_s, 2 step_s, ...

    @classmethod
    def of(cls, flight: ComparedFlight) -> Reader:
        if flight.run is not None:
            return cls(flight.log, flight.run.summary.step_s)
        times = flight.log[TIME]
        return cls(flight.log, median_step(times), times)

    def xy(self, values: Array) -> Figure:
        """Return the x and y of a trace for one value a row."""
        rows = choose_rows(values)
        if self._times is not None:
            x, y = (self._times, values) if rows is None else (self._times[rows], values[rows])
            return {"x": x.astype(np.float64), "y": y.astype(np.float32)}
        if rows is None:
            return {"x0": 0.0, "dx": self.step_s, "y": values.astype(np.float32)}
        return {"x": rows * self.step_s, "y": values[rows].astype(np.float32)}

    def is_moving(self, column: str) -> bool:
        """Return whether a column is ever anything but 0."""
        return bool(np.any(np.abs(self.log[column]) > 0.0))

    def has_values(self, column: str) -> bool:
        """Return whether a column is there and ever a number."""
        return column in self.log.columns and bool(np.any(np.isfinite(self.log[column])))

    def upsets(self) -> list[tuple[float, float]]:
        """Return the intervals [s] in which something disturbs the vehicle, wind apart."""
        disturbed = np.zeros(len(self.log), dtype=bool)
        for column in _DISTURBANCE_COLUMNS:
            disturbed |= self.log[column] != 0.0
        return self.stretches(disturbed)

    def stretches(self, mask: NDArray[np.bool_], most: int = 30) -> list[tuple[float, float]]:
        """Return the intervals [s] of a mask, gaps of less than 0.1 s closed; none if more than ``most``."""
        starts, ends = (self.step_s * rows for rows in row_spans(mask))
        apart = starts[1:] - ends[:-1] >= 0.1
        first = np.concatenate(([True], apart))[: starts.size]
        last = np.concatenate((apart, [True]))[: ends.size]
        pairs = list(zip(starts[first].tolist(), ends[last].tolist(), strict=True))
        return pairs if len(pairs) <= most else []


def choose_rows(values: Array, limit: int = 4000) -> NDArray[np.intp] | None:
    """Return the rows to draw, at most ``limit``, so that no peak is lost; None for all rows.

    They are the first, the last, and the least and the greatest of each of many equal stretches.  A stretch without a
    number stays a gap.
    """
    if values.size <= limit:
        return None
    inner = values[1:-1]
    length = ceil(inner.size / (limit // 2 - 1))
    padded = np.full(ceil(inner.size / length) * length, np.nan)
    padded[: inner.size] = inner
    stretches = padded.reshape(-1, length)
    finite = np.isfinite(stretches)
    starts = 1 + length * np.arange(len(stretches))
    low = starts + np.argmin(np.where(finite, stretches, np.inf), axis=1)
    high = starts + np.argmax(np.where(finite, stretches, -np.inf), axis=1)
    return np.unique(np.concatenate(([0], low, high, [values.size - 1])))
