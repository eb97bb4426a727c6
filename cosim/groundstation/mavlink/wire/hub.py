"""Sockets, stations and counts that every channel of a link shares."""

from __future__ import annotations

import contextlib
import selectors
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from cosim.groundstation.mavlink.wire.frames import Frame, FramePacker, Parser
from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog

_MOST_EVENTS = 100  # event lines that are kept; chosen by us


class FrameHandler(Protocol):
    """Handler of frames that runs in the link's thread."""

    def receive(self, frame: Frame, peer: Peer, now: float) -> None: ...

    def poll(self, now: float) -> float:
        """Do everything that is due, and return when something is due again [s of the clock]."""
        ...


class Hub:
    """Registry of a link's sockets and stations.  ``clock`` [s] gives all times here."""

    def __init__(
        self, system: int, signing: Signing | None, log: TelemetryLog | None, clock: Callable[[], float]
    ) -> None:
        self.refused: Counter[str] = Counter()  # frames and bytes that were refused, by reason
        self.failures: Counter[str] = Counter()  # exceptions of this program by kind, each of which is a defect
        self.taken = 0  # frames that were accepted
        self.events: deque[str] = deque(maxlen=_MOST_EVENTS)  # lines about the links, for the user
        self.on_event: Callable[[str], None] = lambda text: None  # called with each event line, in the link's thread
        self.log = log
        self.handler: FrameHandler | None = None
        self.now = clock
        self._system, self._signing = system, signing
        self._peer_count = 0
        self._selector = selectors.DefaultSelector()

    def report_event(self, text: str) -> None:
        """Report an event to the people on the ground."""
        self.events.append(text)
        self.on_event(f"link: {text}")

    def dispatch_frames(self, frames: Sequence[Frame], peer: Peer, now: float) -> None:
        """Log a station's frames and hand them to the handler."""
        self.taken += len(frames)
        for frame in frames:
            if self.log is not None:
                self.log.write_received(frame.raw)
            if self.handler is None:
                continue
            try:
                self.handler.receive(frame, peer, now)
            except Exception as error:
                self.failures[f"{frame.message.msgname}: {type(error).__name__}: {error}"[:200]] += 1

    def new_parser(self, is_datagram: bool) -> Parser:
        return Parser(self.refused, self._signing, is_datagram)

    def new_peer(self, name: str, transmit: Callable[[bytes], int], is_datagram: bool) -> Peer:
        """Return a new station with its own sequence and, for signatures, its own link id; see :class:`.Peer`."""
        packer = FramePacker(self._system, self._peer_count & 0xFF, self._signing)
        self._peer_count += 1
        return Peer(name, transmit, self.new_parser(is_datagram), packer, is_datagram, self.now, self.refused)

    def watch(self, item: Any, ready: Callable[[int], None], events: int = selectors.EVENT_READ) -> None:
        """Call ``ready`` whenever ``item``, a socket or a descriptor, is ready."""
        self._selector.register(item, events, ready)

    def unwatch(self, item: Any) -> None:
        """Watch an item no more."""
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(item)
