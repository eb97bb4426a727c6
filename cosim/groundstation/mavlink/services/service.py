"""Common parts of the vehicle's services: parameters, missions, files, logs.

A service lives in the thread of the links, and holds no socket and no clock: ``now`` is monotonic time, s, and a test
can make it run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

from cosim.control.autopilot.requests import Answer, Request
from cosim.groundstation.mavlink.telemetry import statustext
from cosim.groundstation.mavlink.wire.dialect import Message

Peer = Hashable  # an address, as the link knows it
Outgoing = list[tuple[Peer | None, Message]]
# request, what to do with the answer (later, from any thread), who asks
Ask = Callable[[Request, Callable[[Answer], None], str], None]

MAX_CLIENTS = 16  # that a service remembers something of; chosen by us: more than anybody connects
_OWN_IDS = 0x8000  # from here on texts of services are numbered
_text_id = 0


class Client(NamedTuple):
    """Sender of a request; several systems may be behind one address."""

    peer: Peer
    system: int
    component: int

    @property
    def text(self) -> str:
        """Name of the client for people to read."""
        return f"{getattr(self.peer, 'name', self.peer)} {self.system}/{self.component}"


class Service:
    """Base of a service, with defaults for all that it need not do.

    ``handles``: names of the messages that it takes.  ``busy``: it wants to be polled every 10 ms, not every 50.
    """

    handles: frozenset[str] = frozenset()

    @property
    def busy(self) -> bool:
        return False

    def handle(self, message: Message, client: Client, now: float) -> Sequence[Message]:
        """Return the answers to a message for this vehicle, which go to the client's peer."""
        return ()

    def poll(self, now: float) -> Outgoing:
        """Return the messages that are due, to one peer or (None) to all."""
        return []

    def forget(self, peer: Peer) -> None:
        """Forget a peer that is gone."""


class RateLimit:
    """Limit of outgoing messages: ``rate`` a second, and not more than ``burst`` at once."""

    def __init__(self, rate: float, burst: int) -> None:
        self._rate, self._burst = rate, float(burst)
        self._saved = self._burst
        self._last: float | None = None

    def take(self, now: float, most: int, peer: Peer) -> int:
        """Return how many of ``most`` messages may go now; none while the link to the peer is behind."""
        if self._last is not None:
            self._saved = min(self._burst, self._saved + max(0.0, now - self._last) * self._rate)
        self._last = now
        if getattr(peer, "behind", False):
            return 0
        given = min(most, int(self._saved))
        self._saved -= given
        return given


class Answers:
    """Queue of the autopilot's answers, filled from any thread and emptied in the link's."""

    def __init__(self, ask: Ask, most: int = 100) -> None:
        self._ask, self._most = ask, most
        self._ready: deque[tuple[Callable[[Answer], Outgoing], Answer]] = deque()
        self._open = 0

    def request(self, request: Request, client: Client, then: Callable[[Answer], Outgoing]) -> bool:
        """Ask the pilot; ``then`` makes messages of the answer.  False: too much is open, the client will ask again."""
        if self._open >= self._most:
            return False
        self._open += 1
        self._ask(request, lambda answer: self._ready.append((then, answer)), client.text)
        return True

    def take(self) -> Outgoing:
        """Return the messages of every answer that has come."""
        messages: Outgoing = []
        while self._ready:
            then, answer = self._ready.popleft()
            self._open -= 1
            messages += then(answer)
        return messages


def status_text(text: str, severity: int) -> list[Message]:
    """Return STATUSTEXT in as many pieces as it needs, with numbers that the vehicle's own texts do not use."""
    global _text_id
    _text_id = (_text_id + 1) % _OWN_IDS
    return statustext(severity, text, _OWN_IDS + _text_id)


def text_of(value: str | bytes) -> str:
    """Return a text field of a message up to its first NUL; other characters than ASCII are escaped."""
    data = value.encode("latin-1", "replace") if isinstance(value, str) else bytes(value)
    return data.split(b"\0")[0].decode("ascii", "backslashreplace")


def crc32(data: bytes, start: int = 0) -> int:
    """Return MAVLink's CRC32 (polynomial 0xEDB88320, no inversion); ``start``: that of the bytes before."""
    from zlib import crc32 as inverted

    return inverted(data, start ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
