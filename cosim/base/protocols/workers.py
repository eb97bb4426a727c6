"""The processes that fly a study's flights."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from types import TracebackType

Study = TypeVar("Study", contravariant=True)
Flight = TypeVar("Flight", contravariant=True)
Row = TypeVar("Row", covariant=True)


class Workers(Protocol[Study, Flight, Row]):
    """Flies a study's flights in other processes; a context manager that leaves none of them behind."""

    def fly(self, study: Study, flights: Iterable[Flight]) -> Iterator[Row]:
        """Fly them all.

        A flight whose process was lost is flown again, and is a row ``failed`` after three of them; one that takes too
        long is a row ``failed`` at once.

        Parameters
        ----------
        study : Study
            To which all of them belong.
        flights : iterable of Flight
            Taken only as they can be flown.

        Returns
        -------
        iterator of Row
            One a flight, in the order in which they are finished.

        Raises
        ------
        FlightError
            If nothing can be flown any more, a disk being full, say.
        """

    def close(self) -> None:
        """End every process, those at work included; may be called twice."""

    def __enter__(self) -> Workers[Study, Flight, Row]: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
