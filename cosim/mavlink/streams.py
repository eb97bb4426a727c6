"""Which messages are due: rates in wall-clock time, per ground station, on one grid.

Every interval counts its slots from the same start, so that stations with the same rate get the same message at the
same time, which is built once; a slot that was missed is left out and not made up for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import floor, inf

from cosim.mavlink.dialect import BY_NAME
from cosim.mavlink.peer import Peer
from cosim.mavlink.telemetry import STREAMS, Stream

FASTEST = 0.004  # s: a control step; nothing is new more often
BY_ID: dict[int, Stream] = {BY_NAME[stream.name].id: stream for stream in STREAMS}
DEFAULT: dict[int, float] = {number: 1.0 / stream.rate if stream.rate else 0.0 for number, stream in BY_ID.items()}


def interval(peer: Peer, number: int) -> float:
    """Seconds between two messages to a station; 0: it gets none by itself."""
    return peer.intervals.get(number, DEFAULT[number])


class Streams:
    """The clockwork; ``start``: when the first slot begins."""

    def __init__(self, start: float) -> None:
        self._start = start
        self._next: dict[tuple[int, float], float] = {}
        self._at = start

    @property
    def next(self) -> float:
        """When something is due again, as of the last call."""
        return self._at

    def due(self, now: float, peers: Sequence[Peer]) -> Iterator[tuple[Stream, list[Peer]]]:
        """Every message that is due, with who gets it; nobody where it is only for the log."""
        earliest = inf
        following = self._next
        wanted: dict[tuple[int, float], float] = {}
        for number, stream in BY_ID.items():
            default = DEFAULT[number]
            takers: dict[float, list[Peer]] = {default: []} if default else {}
            for peer in peers:
                every = peer.intervals.get(number, default)
                if every:
                    takers.setdefault(every, []).append(peer)
            found: list[Peer] = []
            any_due = False
            for every, them in takers.items():
                at = following.get((number, every), self._start)
                if now >= at:
                    any_due = True
                    found += them
                    at = self._start + (floor((now - self._start) / every + 1e-9) + 1) * every
                wanted[number, every] = at
                earliest = min(earliest, at)
            if any_due:
                yield stream, found
        self._next = wanted
        self._at = earliest
