"""Common parts of the vehicle's services: parameters, missions, files, logs.

A service runs in the thread of the links, and has no socket and no clock: ``now`` is monotonic time, s, which a
test can count.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from cosim.control.autopilot.requests import Answer, Request
from cosim.groundstation.mavlink.telemetry import statustext
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.peer import Peer

Outgoing = list[tuple[Peer | None, Message]]
# Function that queues a request, with a callback for the answer (from any thread) and the sender's name.
Ask = Callable[[Request, Callable[[Answer], None], str], None]

# Most clients for which a service keeps state; chosen by us, more than are ever connected.
MAX_CLIENTS = 16
_text_id = 0


class Client(NamedTuple):
    """Sender of a request; several systems may share one address."""

    peer: Peer
    system: int
    component: int

    @property
    def label(self) -> str:
        return f"{self.peer.name} {self.system}/{self.component}"


class Service:
    """Base class of MAVLink services, with default methods.

    ``handles``: names of the messages that it takes.  ``is_busy``: it must be polled every 10 ms, not every 50.
    """

    handles: frozenset[str] = frozenset()

    @property
    def is_busy(self) -> bool:
        return False

    def handle(self, message: Message, client: Client, now: float) -> Sequence[Message]:
        """Return the answers to a message, to be sent to the client's peer."""
        return ()

    def poll(self, now: float) -> Outgoing:
        """Return the messages that are due, to one peer or (None) to all."""
        return []

    def forget(self, peer: Peer) -> None:
        """Drop the state of a disconnected peer."""


class RateLimit:
    """Limit of outgoing messages: ``rate`` per second, at most ``burst`` at once."""

    def __init__(self, rate: float, burst: int) -> None:
        self._rate, self._burst = rate, float(burst)
        self._tokens = self._burst
        self._last: float | None = None

    def take_tokens(self, now: float, requested: int, peer: Peer) -> int:
        """Return how many of ``requested`` messages may go now; none while the link to the peer is behind."""
        if self._last is not None:
            self._tokens = min(self._burst, self._tokens + max(0.0, now - self._last) * self._rate)
        self._last = now
        if peer.is_behind:
            return 0
        count = min(requested, int(self._tokens))
        self._tokens -= count
        return count


class AnswerQueue:
    """Queue of the autopilot's answers, filled from any thread and emptied in the link's.

    ``max_open``: requests that wait for their answers at most.
    """

    def __init__(self, ask: Ask, max_open: int = 100) -> None:
        self.max_open = max_open
        self._ask = ask
        self._ready: deque[tuple[Callable[[Answer], Outgoing], Answer]] = deque()
        self._open = 0

    def request(self, request: Request, client: Client, then: Callable[[Answer], Outgoing]) -> bool:
        """Send a request to the pilot; ``then`` makes the answer's messages.  Return False if too many are open."""
        if self._open >= self.max_open:
            return False
        self._open += 1
        self._ask(request, lambda answer: self._ready.append((then, answer)), client.label)
        return True

    def take_messages(self) -> Outgoing:
        """Return the messages of all answers received since the last call."""
        messages: Outgoing = []
        while self._ready:
            then, answer = self._ready.popleft()
            self._open -= 1
            messages += then(answer)
        return messages


def make_service_text(text: str, severity: int, first_id: int = 0x8000) -> list[Message]:
    """Return a text as STATUSTEXT messages, with ids that the vehicle's own texts do not use."""
    global _text_id
    _text_id = (_text_id + 1) % first_id
    return statustext(severity, text, first_id + _text_id)


def decode_text(value: str | bytes) -> str:
    """Return a text field of a message up to its first NUL; other characters than ASCII are escaped."""
    data = value.encode("latin-1", "replace") if isinstance(value, str) else bytes(value)
    return data.split(b"\0")[0].decode("ascii", "backslashreplace")


def crc32(data: bytes, start: int = 0) -> int:
    """Return MAVLink's CRC32 (polynomial 0xEDB88320, no inversion); ``start``: CRC32 of the bytes before."""
    from zlib import crc32 as inverted

    return inverted(data, start ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
