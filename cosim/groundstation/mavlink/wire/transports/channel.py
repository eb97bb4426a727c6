"""Common parts of all transports: sockets and stations of a link, flow control, connections, room for stations."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from cosim.base.errors import InputError
from cosim.groundstation.mavlink.wire.frames import Frame, FramePacker, Parser
from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint


class TransportLimits(NamedTuple):
    """Limits of servers and connections, chosen by us."""

    max_stations: int = 16  # stations per server
    # A new station may replace one that was silent for ``evict_s``, or one that has sent nothing for ``unheard_s``:
    # ground stations send a heartbeat each second.
    evict_s: float = 10.0
    unheard_s: float = 3.0
    reads: int = 64  # reads from one socket per turn
    datagram_bytes: int = 2048  # a frame has at most 280 bytes
    stall_s: float = 10.0  # until a stalled connection is closed
    retry_s: float = 1.0  # between two attempts to connect
    # Credit in frames at which a station that flooded the link is read again.
    resume_frames: float = 100.0


LIMITS = TransportLimits()  # limits of all transports
Address = Any


class Channel(Protocol):
    """Open endpoint: socket of a link with its stations."""

    @property
    def peers(self) -> list[Peer]: ...

    def poll(self, now: float) -> None: ...

    def close(self) -> None: ...


class FrameHandler(Protocol):
    """Handler of frames that runs in the link's thread."""

    def receive(self, frame: Frame, peer: Peer, now: float) -> None: ...

    def poll(self, now: float) -> float:
        """Send due messages; return the time of the next call [s of the clock]."""
        ...


class Hub:
    """Registry of a link's sockets and stations; times are by ``clock`` [s]."""

    def __init__(
        self, system: int, signing: Signing | None, log: TelemetryLog | None, clock: Callable[[], float]
    ) -> None:
        self.refused: Counter[str] = Counter()  # refused frames and bytes, by reason
        self.failures: Counter[str] = Counter()  # exceptions in this code: defects
        self.taken = 0  # frames that were accepted
        self.events: deque[str] = deque(maxlen=100)  # messages about the links for the user
        self.on_event: Callable[[str], None] = lambda text: None  # called in the link's thread
        self.log = log
        self.handler: FrameHandler | None = None
        self.now = clock
        self._system, self._signing = system, signing
        self._peer_count = 0
        self._selector = selectors.DefaultSelector()

    def report_event(self, text: str) -> None:
        """Log an event of the links, and report it to the ground."""
        self.events.append(text)
        self.on_event(f"link: {text}")

    def dispatch_frames(self, frames: Sequence[Frame], peer: Peer, now: float) -> None:
        """Log a station's frames and pass them to the handler."""
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
        """Return a new station with its own sequence and signature link id; see :class:`.Peer`."""
        packer = FramePacker(self._system, self._peer_count & 0xFF, self._signing)
        self._peer_count += 1
        return Peer(name, transmit, self.new_parser(is_datagram), packer, is_datagram, self.now, self.refused)

    def watch(self, item: Any, ready: Callable[[int], None], events: int = selectors.EVENT_READ) -> None:
        """Call ``ready`` whenever ``item``, a socket or a descriptor, is ready."""
        self._selector.register(item, events, ready)

    def unwatch(self, item: Any) -> None:
        """Stop watching a socket or descriptor."""
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(item)


class ReadGate:
    """Flow control of a socket, read only while its station has credit, so that a flood stays in the kernel."""

    def __init__(self, link: Hub, item: Any, ready: Callable[[int], None]) -> None:
        self._link, self._item, self._handle_ready_socket = link, item, ready
        self._open = True
        link.watch(item, ready)

    def pause(self) -> None:
        if self._open:
            self._open = False
            self._link.refused["flood"] += 1
            self._link.unwatch(self._item)

    def poll(self, peer: Peer, now: float) -> None:
        """Resume reading once the station has enough credit."""
        if not self._open and peer.update_credit(now) > LIMITS.resume_frames:
            self._open = True
            self._link.watch(self._item, self._handle_ready_socket)


class Connection:
    """Ground station on a TCP connection.

    ``item``: a file or socket to be watched; ``read`` and ``write`` are its own and never wait.
    A connection that has taken nothing for ``LIMITS.stall_s`` is closed; ``why`` then says so.
    """

    def __init__(
        self, link: Hub, name: str, item: Any, read: Callable[[], bytes], write: Callable[[bytes], int]
    ) -> None:
        self._link = link
        self.item = item
        self._read = read
        self._write = write
        self.open = True
        self.stalled = False  # closed because it accepted nothing
        self.why = ""
        self.peer = link.new_peer(name, self._transmit, is_datagram=False)
        self._gate = ReadGate(link, item, self._handle_ready_socket)

    def _transmit(self, data: bytes) -> int:
        if not self.open:
            return 0
        try:
            return self._write(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            self.close(f"it was lost: {error.strerror or error}")
            return 0

    def _handle_ready_socket(self, mask: int) -> None:
        now = self._link.now()
        if self.peer.update_credit(now) < 1.0:
            self._gate.pause()
            return
        why = "the other end has closed it"
        try:
            data = self._read()
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            data, why = b"", f"it was lost: {error.strerror or error}"
        if not data:
            self.close(why)
            return
        self._link.dispatch_frames(self.peer.feed(data, now), self.peer, now)

    def poll(self, now: float) -> None:
        """Send queued bytes; close the connection if the station accepts nothing for too long."""
        peer = self.peer
        peer.flush()
        if not self.open:
            return
        self._gate.poll(peer, now)
        if peer.blocked_seconds(now) > LIMITS.stall_s or peer.stuck:
            self._link.refused["stuck"] += 1
            self.stalled = True
            self.close("too much waits for it" if peer.stuck else f"it has taken nothing for {LIMITS.stall_s:g} s")

    def close(self, why: str = "") -> None:
        """Close the connection for a reason; may be called twice."""
        if self.open:
            self.open = False
            self.why = why
            self._link.unwatch(self.item)
            self.item.close()


def open_socket(endpoint: Endpoint, kind: int, bind: bool) -> socket.socket:
    """Return a non-blocking socket.  Raises InputError if its port is not available."""
    opened = socket.socket(endpoint.family, kind)
    try:
        opened.setblocking(False)
        if bind:
            if kind == socket.SOCK_STREAM:
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.bind((endpoint.host, endpoint.port))
    except OSError as error:
        opened.close()
        raise InputError(f"link {endpoint.url}: {error.strerror or error}") from error
    return opened


def name_station(kind: str, address: Address) -> str:
    """Return the name of a station, ``kind:host:port``."""
    return f"{kind}:{address[0]}:{address[1]}"


def is_replaceable(peer: Peer, now: float) -> bool:
    """Return whether a station was silent for so long that a new one may replace it."""
    return peer.silent_seconds(now) > (LIMITS.evict_s if peer.last_heard >= 0.0 else LIMITS.unheard_s)
