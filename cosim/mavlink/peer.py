"""One ground station as the link knows it: what it sent, what waits to be sent to it, which rates it asked for."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

from cosim.mavlink.dialect import Packed
from cosim.mavlink.frames import Frame, Parser, Sender

# Chosen by us: a second of the default telemetry is 8 kB.
ROOM = 64_000  # bytes that may wait for a slow receiver before telemetry is dropped
LIMIT = 512_000  # answers that wait beyond this mean that nobody reads: the connection is closed
FRAMES_A_SECOND = 1000  # that are read from one station; beyond it they are thrown away unread
_BURST = 1000


class Peer:
    """A ground station on a link.

    ``transmit``: hands bytes to the operating system and says how many it took, without ever waiting.  ``whole``:
    frames are datagrams, so one is taken whole or not at all.
    """

    def __init__(
        self,
        name: str,
        transmit: Callable[[bytes], int],
        parser: Parser,
        sender: Sender,
        whole: bool,
        now: float,
        refused: Counter[str],
    ) -> None:
        self.name = name
        self.whole = whole
        self.since = now
        self.heard = -1.0  # when the last frame came; -1: none yet
        self.intervals: dict[int, float] = {}  # s, by message; 0: not sent
        self.received = self.sent = self.dropped = 0
        self.stuck = False
        self._transmit = transmit
        self._parser = parser
        self._sender = sender
        self._refused = refused
        self._queue: deque[bytes] = deque()
        self._waiting = 0
        self._credit = float(_BURST)
        self._credited = now

    def feed(self, data: bytes, now: float) -> list[Frame]:
        """The frames in what has come; empty, and counted, for a station that floods."""
        if self.credit(now) < 1.0:
            self._refused["flood"] += 1
            return []
        frames = self._parser.feed(data)
        self._credit -= max(1, len(frames))
        if frames:
            self.heard = now
            self.received += len(frames)
        return frames

    def credit(self, now: float) -> float:
        """Frames that may be read from the station now."""
        self._credit = min(float(_BURST), self._credit + (now - self._credited) * FRAMES_A_SECOND)
        self._credited = now
        return self._credit

    def send(self, packed: Packed, urgent: bool, component: int | None = None) -> bool:
        """Queue a message.  Telemetry is dropped when too much waits; answers are ``urgent`` and are not."""
        if self.stuck or (not urgent and self._waiting > ROOM):
            self.dropped += 1
            return False
        frame = self._sender.frame(packed, component)
        self._queue.append(frame)
        self._waiting += len(frame)
        if self._waiting > LIMIT:
            self.stuck = True
        self.flush()
        return True

    def flush(self) -> None:
        """Give the operating system what it takes."""
        queue = self._queue
        while queue:
            frame = queue[0]
            taken = self._transmit(frame)
            if taken <= 0:
                return
            self._waiting -= taken
            if taken < len(frame) and not self.whole:
                queue[0] = frame[taken:]
                return
            queue.popleft()
            self.sent += 1

    @property
    def waiting(self) -> int:
        """Bytes that wait."""
        return self._waiting
