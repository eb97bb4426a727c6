"""One ground station on a link: its parser, its queues of outgoing messages, and the rates that it requested.

What waits has three classes.  Answers (acknowledgements, heartbeats, texts, the protocols) go first.  Lists and files,
and telemetry, take turns at what is left, byte by byte.  Telemetry is never queued behind itself: of every message the
newest waits, in the place in the row that the one before had, so that what goes out is as young as the line allows.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from cosim.groundstation.mavlink.wire.dialect import Message, frame_size
from cosim.groundstation.mavlink.wire.frames import Frame, FramePacker, Parser


class PeerLimits(NamedTuple):
    """Limits of queues and reading per station, chosen by us at hundreds of times a usual load."""

    max_bytes: int = 512_000  # of queued answers and lists
    pause_bytes: int = 2000  # queue size that pauses lists and files
    frames_1_s: int = 1000  # frames read per second; more are dropped
    burst_frames: int = 1000


LIMITS = PeerLimits()  # limits of one peer


class Priority(Enum):
    """Priority class of a queued message."""

    ANSWER = 1
    BULK = 2


class Peer:
    """Ground station on a link: its parser, send queues and counters.

    ``transmit``: hands bytes to the operating system and returns how many it took, without ever waiting.
    ``is_datagram``: a frame is taken whole or not at all.
    """

    def __init__(
        self,
        name: str,
        transmit: Callable[[bytes], int],
        parser: Parser,
        packer: FramePacker,
        is_datagram: bool,
        clock: Callable[[], float],
        refused: Counter[str],
    ) -> None:
        self.name = name
        self.is_datagram = is_datagram
        self._clock = clock
        self.created = now = clock()
        self.last_heard = -1.0  # time of the last frame; -1: none yet
        self.intervals: dict[int, float] = {}  # s, by message id; 0: not sent
        self.turn = 0  # slot counter of alternating messages
        self.received = self.sent = self.dropped = 0
        self.signature = packer.signature  # bytes of the signature in each frame
        self.stuck = False  # True: no room for another answer
        self._transmit = transmit
        self._parser = parser
        self._packer = packer
        self._refused = refused
        self._answers: deque[Message] = deque()
        self._bulk: deque[Message] = deque()
        self._telemetry: dict[tuple[int, int], Message] = {}
        self._frame = b""  # unsent rest of the current frame
        self._waiting = 0  # bytes of queued answers and bulk data
        self._balance = 0  # bulk bytes sent ahead of telemetry
        self._blocked: float | None = None  # time since it accepts nothing, or None
        self._credit = float(LIMITS.burst_frames)
        self._credited = now

    def feed(self, data: bytes, now: float) -> list[Frame]:
        """Return the frames in received bytes; frames beyond the rate limit are dropped and counted."""
        if self.update_credit(now) < 1.0:
            self._refused["flood"] += 1
            return []
        frames = self._parser.feed(data)
        self._credit -= max(1, len(frames))
        if frames:
            self.last_heard = now
            self.received += len(frames)
        return frames

    def update_credit(self, now: float) -> float:
        """Return the number of frames that may be read from the station now."""
        self._credit = min(float(LIMITS.burst_frames), self._credit + (now - self._credited) * LIMITS.frames_1_s)
        self._credited = now
        return self._credit

    def silent_seconds(self, now: float) -> float:
        """Return the seconds since the last frame of the station, or since it connected."""
        return now - max(self.last_heard, self.created)

    def send(self, packed: Message, priority: Priority = Priority.ANSWER) -> bool:
        """Queue a message that must not be replaced; return whether there was room."""
        if self._waiting > LIMITS.max_bytes:
            self.stuck = True
            self.dropped += 1
            return False
        (self._answers if priority is Priority.ANSWER else self._bulk).append(packed)
        self._waiting += self._frame_bytes(packed)
        self.flush()
        return True

    def send_telemetry(self, packed: Message, index: int = 0) -> None:
        """Queue telemetry in place of an older message; ``index``: number among several of the same kind."""
        key = (packed.get_msgId(), index)
        if key in self._telemetry:
            self.dropped += 1
        self._telemetry[key] = packed
        self.flush()

    def flush(self) -> None:
        """Send queued messages until the operating system accepts no more."""
        while self._frame or self._answers or self._bulk or self._telemetry:
            now = self._clock()
            frame = self._frame = self._frame or self._packer.pack_frame(self._pop_next())
            count = self._transmit(frame)
            if count <= 0:
                self._blocked = now if self._blocked is None else self._blocked
                return
            self._blocked = None
            self._frame = b"" if self.is_datagram else frame[count:]
            if self._frame:
                return
            self.sent += 1

    def _pop_next(self) -> Message:
        """Remove and return the next message: answers first, then bulk and telemetry in balance."""
        answers, bulk, telemetry = self._answers, self._bulk, self._telemetry
        if answers:
            packed = answers.popleft()
            self._waiting -= self._frame_bytes(packed)
            return packed
        if not (bulk and telemetry):
            self._balance = 0
        if bulk and (not telemetry or self._balance <= 0):
            packed = bulk.popleft()
            self._waiting -= self._frame_bytes(packed)
            self._balance += self._frame_bytes(packed)
            return packed
        packed = telemetry.pop(next(iter(telemetry)))
        self._balance -= self._frame_bytes(packed)
        return packed

    @property
    def waiting_bytes(self) -> int:
        return len(self._frame) + self._waiting + sum(map(self._frame_bytes, self._telemetry.values()))

    @property
    def is_behind(self) -> bool:
        """Whether so many answers wait that lists and files should pause."""
        return self._waiting > LIMITS.pause_bytes

    def _frame_bytes(self, packed: Message) -> int:
        return frame_size(packed) + self.signature

    def blocked_seconds(self, now: float) -> float:
        """Return the seconds for which the peer has accepted nothing while bytes were queued."""
        return 0.0 if self._blocked is None else now - self._blocked
