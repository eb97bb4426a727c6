"""Every socket of the vehicle, in one background thread that never makes the stepping thread wait."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from math import inf
from typing import Any, Protocol

from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.frames import Frame, Parser, Sender
from cosim.groundstation.mavlink.wire.peer import Kind, Peer
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import Log
from cosim.groundstation.mavlink.wire.transports.channel import Channel
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint
from cosim.groundstation.mavlink.wire.transports.serial_port import Serial
from cosim.groundstation.mavlink.wire.transports.tcp import Tcp, TcpIn
from cosim.groundstation.mavlink.wire.transports.udp import UdpIn, UdpOut

# Chosen by us.
_IDLE = 0.05  # s: the longest sleep
_FLUSH = 1.0  # s between two flushes of the log
_COMPLAIN = 10.0  # s between two lines about the same
_NEWS = 100  # lines that are kept
# refusals that somebody should know of at once; damaged frames are a radio's daily bread and are only counted
_LOUD = {
    "signature": "frames with a wrong signature refused",
    "unsigned": "frames without a signature refused",
    "replay": "frames with the signature of an earlier time refused",
    "too many stations": "stations turned away because there is no place",
}


class Station(Protocol):
    """Handler of frames that runs in the link's thread."""

    def receive(self, frame: Frame, peer: Peer, now: float) -> None: ...

    def poll(self, now: float) -> float:
        """Do everything that is due, and return when something is due again [s of the clock]."""
        ...


class Link:
    """All links of a vehicle, opened at once so that a wrong one is refused before the flight, until ``start`` silent.

    ``station`` is called in the link's thread only.  Raises InputError where a port cannot be opened.
    """

    def __init__(
        self,
        endpoints: Sequence[Endpoint],
        system: int = 1,
        component: int = 1,
        signing: Signing | None = None,
        log: Log | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.refused: Counter[str] = Counter()  # frames and bytes that were not taken, by reason
        self.failures: Counter[str] = Counter()  # of our own: there should be none
        self.taken = 0  # frames
        self.news: deque[str] = deque(maxlen=_NEWS)  # what somebody should know
        self.tell: Callable[[str], None] = lambda text: None  # hands on the same, in the link's thread
        self.log = log
        self.station: Station | None = None
        self._clock = clock
        self._ids = (system, component)
        self._signing = signing
        self._made = 0
        self._complaints: dict[str, tuple[int, float]] = {}  # of what has been said: how many, when
        self._selector = selectors.DefaultSelector()
        self._channels: list[Channel] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._bell, self._hear = socket.socketpair()
        for end in (self._bell, self._hear):
            end.setblocking(False)
        self._selector.register(self._hear, selectors.EVENT_READ, self._drain_bell)
        try:
            for endpoint in endpoints:
                self._channels.append(_OPEN[endpoint.kind](self, endpoint))
        except BaseException:
            self.close()
            raise

    @property
    def peers(self) -> list[Peer]:
        """Every ground station that is connected now."""
        return [peer for channel in self._channels for peer in channel.peers]

    @property
    def ports(self) -> list[int]:
        """The local port of each endpoint; 0 where it has none."""
        return [getattr(channel, "port", 0) for channel in self._channels]

    def start(self, station: Station) -> None:
        self.station = station
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)
        self._thread.start()

    def ring(self) -> None:
        """Wake the thread; may be called from any other, and never waits."""
        with contextlib.suppress(OSError):
            self._bell.send(b"!")

    def close(self) -> None:
        """Stop the thread and close everything.  May be called twice."""
        self._stop.set()
        self.ring()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        for channel in self._channels:
            channel.close()
        self._channels = []
        self._selector.close()
        self._bell.close()
        self._hear.close()
        if self.log is not None:
            self.log.close()

    def say(self, text: str) -> None:
        """Report an event to the people on the ground."""
        self.news.append(text)
        self.tell(f"link: {text}")

    def broadcast(self, packed: Message, kind: Kind = Kind.ANSWER) -> None:
        """Send a message to every ground station."""
        for peer in self.peers:
            peer.send(packed, kind)
        self.logged(packed)

    def send(self, peer: Peer, packed: Message, kind: Kind = Kind.ANSWER) -> None:
        """Send a message to one ground station."""
        peer.send(packed, kind)
        self.logged(packed)

    def logged(self, packed: Message) -> None:
        if self.log is not None:
            self.log.sent(packed)

    # --- the thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        flushed = self._clock()
        until = flushed
        while not self._stop.is_set():
            now = self._clock()
            for key, mask in self._selector.select(min(_IDLE, max(0.0, until - now))):
                self._run_isolated(key.data, mask)
            now = self._clock()
            until = min(now + _IDLE, self.poll(now))
            if self.log is not None and now - flushed > _FLUSH:
                self.log.flush()
                flushed = now

    def poll(self, now: float) -> float:
        """Do everything that is due, and return when something is due again [s of the clock]."""
        for channel in self._channels:
            self._run_isolated(channel.poll, now)
        self._complain(now)
        until = now + _IDLE
        if self.station is not None:
            until = self._run_isolated(self.station.poll, now) or until
        return min([until, *(peer.due for peer in self.peers)])

    def _run_isolated(self, do: Callable[[Any], Any], argument: Any) -> Any:
        """Run a link's callback; count an exception instead of letting it stop the other links."""
        try:
            return do(argument)
        except Exception as error:
            self.failures[f"{type(error).__name__}: {error}"[:200]] += 1
            return None

    def _complain(self, now: float) -> None:
        counts = {reason: self.refused[reason] for reason in _LOUD} | dict(self.failures)
        for reason, count in counts.items():
            reported, when = self._complaints.get(reason, (0, -inf))
            if count > reported and now - when >= _COMPLAIN:
                self._complaints[reason] = count, now
                self.say(f"{_LOUD.get(reason, reason)}: {count - reported}")

    def _drain_bell(self, mask: int) -> None:
        with contextlib.suppress(OSError):
            self._hear.recv(4096)

    def take(self, frames: Sequence[Frame], peer: Peer, now: float) -> None:
        """Log a station's frames and hand them to the handler."""
        self.taken += len(frames)
        for frame in frames:
            if self.log is not None:
                self.log.received(frame.raw)
            if self.station is None:
                continue
            try:
                self.station.receive(frame, peer, now)
            except Exception as error:
                self.failures[f"{frame.message.msgname}: {type(error).__name__}: {error}"[:200]] += 1

    def parser(self, whole: bool) -> Parser:
        return Parser(self.refused, self._signing, whole)

    def peer(
        self,
        name: str,
        transmit: Callable[[bytes], int],
        parser: Parser,
        whole: bool,
        line: float | None = None,
    ) -> Peer:
        """Return a new station with its own sequence and, for signatures, its own link id."""
        sender = Sender(*self._ids, link=self._made & 0xFF, signing=self._signing)
        self._made += 1
        return Peer(name, transmit, parser, sender, whole, self._clock, self.refused, line)

    def now(self) -> float:
        return self._clock()

    def watch(self, item: Any, ready: Callable[[int], None], events: int = selectors.EVENT_READ) -> None:
        self._selector.register(item, events, ready)

    def ignore(self, item: Any) -> None:
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(item)


_OPEN: dict[str, Callable[[Link, Endpoint], Channel]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcp": Tcp,
    "tcpin": TcpIn,
    "serial": Serial,
}
