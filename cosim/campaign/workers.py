"""Where the flights of a campaign are flown: the protocol, and what all who follow it agree on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Protocol

from cosim.campaign.one import Row

if TYPE_CHECKING:
    from types import TracebackType

    from cosim.campaign.plan import Flight
    from cosim.campaign.study import Study

LOSSES = 3  # processes that a flight may take with it before it is given up
LEAST_LIMIT_S = 60.0  # chosen by us: of wall time; loading an engine that starts a run time of its own takes 20
LIMIT_FACTOR = 10.0  # chosen by us: of simulated time; a flight takes a hundredth of it


class Workers(Protocol):
    """Flies flights in other processes; a context manager that leaves none of them behind."""

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """The rows in the order in which they are finished; ``flights`` are taken only as they can be flown.

        A flight whose process was lost is flown again, and is a row ``failed`` after ``LOSSES`` of them; one that
        takes too long is a row ``failed`` at once.  Raises FlightError if nothing can be flown any more, a disk being
        full, say.
        """

    def close(self) -> None:
        """End every process, those at work included; may be called twice."""

    def __enter__(self) -> Workers: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def time_limit(study: Study) -> float:
    """How long a flight of ``study`` may take, s of wall time, where nobody says so."""
    return max(LEAST_LIMIT_S, LIMIT_FACTOR * study.base().duration_s)


def lost(end: str) -> str:
    """The reason of a flight that was given up; ``end`` says how its last process ended."""
    return f"the process was lost in this flight {LOSSES} times; the last {end}"


def too_slow(limit: float) -> str:
    """The reason of a flight that took longer than ``limit`` seconds."""
    return f"not finished within the time limit of {limit:g} s"
