"""Where the flights of a campaign are flown: what all who follow the protocol agree on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

from cosim.campaign.workers.flight_row import Row

if TYPE_CHECKING:
    from types import TracebackType

    from cosim.campaign.study.plan import Flight
    from cosim.campaign.study.study import Study

# Processes that one flight may crash before it counts as failed.
MAX_LOSSES = 3


class Workers(Protocol):
    """Flies a study's flights in other processes; a context manager that ends them all."""

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """Fly flights, taken only when they can be flown; yield rows as they finish.

        A flight whose process was lost is flown again, and is a row ``failed`` after three of them; one that takes too
        long is a row ``failed`` at once.  Raises FlightError if nothing can be flown any more.
        """

    def close(self) -> None:
        """End all processes, also busy ones; may be called twice."""

    def __enter__(self) -> Workers: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def time_limit(study: Study) -> float:
    """Return how long a flight of ``study`` may take by default, s of wall time."""
    before = 0.0 if study.autopilot is None else study.autopilot.before_s
    # A batch is handed out as one task and takes longer.
    together = 10.0 if study.batch else 1.0
    min_limit_s = 60.0  # s wall time; loading may take 20 s
    factor = 10.0  # s wall per s simulated; 0.01 is usual
    return together * max(min_limit_s, factor * (study.base().duration_s + before))


def update_mean(mean: float | None, seconds: float) -> float:
    """Return the running mean of flight durations [s] after one more flight; ``mean`` None: the first."""
    return seconds if mean is None else mean + 0.1 * (seconds - mean)


def describe_loss(end: str) -> str:
    """Return the reason of a flight that was given up because its processes ended; ``end`` describes the last end."""
    return f"the process was lost in this flight {MAX_LOSSES} times; the last {end}"


def describe_timeout(limit: float) -> str:
    """Return the reason of a flight that took longer than ``limit`` seconds."""
    return f"not finished within the time limit of {limit:g} s"
