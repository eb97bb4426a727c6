"""A limit on the size of a flight's log, however long the flight goes on."""

from __future__ import annotations

from collections.abc import Callable

from cosim.base.signals import Sample
from cosim.groundstation.exchange import FlightInfo
from cosim.results.log.columns import log_columns, logged_vehicle
from cosim.results.run import Recording

MEGABYTE = 1e6
BYTES = 8  # size of a number in the log
LIMIT_MB = 2000.0  # two hours of flight at 250 Hz; chosen by us
_WARN_AT = 0.8  # fraction of the limit


def estimate_hourly_mb(info: FlightInfo) -> float:
    """Return how many megabytes the log of an hour's flight has."""
    columns = log_columns(logged_vehicle(info.vehicle), info.columns)
    return BYTES * len(columns) * 3600.0 / info.scenario.step_s / MEGABYTE


class LogLimit:
    """Observer that passes samples on to a recording until its log has ``limit_mb`` (None: for ever).

    ``say`` gets a line for the people on the ground, at four fifths of the size and at the end.
    """

    def __init__(self, recording: Recording, limit_mb: float | None, say: Callable[[str], None]) -> None:
        self._recording, self._say = recording, say
        self._limit_mb = limit_mb
        self._most = None if limit_mb is None else max(1, int(limit_mb * MEGABYTE / (BYTES * recording.columns)))
        self.rows = 0  # number of rows that were recorded so far

    @property
    def is_full(self) -> bool:
        """Whether the log has its size, so that nothing more is recorded."""
        return self._most is not None and self.rows >= self._most

    def observe(self, sample: Sample) -> None:
        """Record the sample while there is room for it."""
        if self.is_full:
            return
        self._recording.observe(sample)
        self.rows += 1
        if self._most is not None and self._limit_mb is not None:
            if self.rows == max(1, int(_WARN_AT * self._most)):
                self._say(f"the log has {_WARN_AT * self._limit_mb:g} MB, and ends at {self._limit_mb:g} MB")
            if self.is_full:
                self._say(f"the log has {self._limit_mb:g} MB and ends here, the flight goes on")
