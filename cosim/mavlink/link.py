"""Every socket of the vehicle, in one background thread that never makes the stepping thread wait."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from cosim.errors import InputError
from cosim.mavlink.dialect import Packed
from cosim.mavlink.endpoint import Endpoint
from cosim.mavlink.frames import Frame, Parser, Sender
from cosim.mavlink.peer import Peer
from cosim.mavlink.signing import Signing
from cosim.mavlink.tlog import Log

# Chosen by us.
MOST_PEERS = 16  # on one server
FORGET = 30.0  # s: a station behind a UDP server that is silent for so long is gone
_EVICT = 10.0  # s: and for so long makes room for a new one
_READS = 64  # from one socket before the others have their turn
_DATAGRAM = 2048  # bytes; a frame has at most 280
_KERNEL = 65536  # bytes that may lie in a connection: old telemetry is worth nothing to a slow reader
_RESUME = 100.0  # frames of credit with which a station that flooded is read again
_RETRY = 1.0  # s between two attempts to connect
_IDLE = 0.05  # s: the longest sleep
_FLUSH = 1.0  # s between two flushes of the log

Address = Any


class Station(Protocol):
    """What runs in the link's thread."""

    def receive(self, frame: Frame, peer: Peer, now: float) -> None: ...

    def poll(self, now: float) -> float:
        """Do what is due; returns when there is something to do again."""
        ...


class Channel(Protocol):
    """One endpoint while it is open."""

    @property
    def peers(self) -> list[Peer]: ...

    def poll(self, now: float) -> None: ...

    def close(self) -> None: ...


class Link:
    """Opens every endpoint at once, so that a wrong one is refused before the flight; ``start`` begins to talk.

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
        self.log = log
        self.station: Station | None = None
        self._clock = clock
        self._ids = (system, component)
        self._signing = signing
        self._made = 0
        self._selector = selectors.DefaultSelector()
        self._channels: list[Channel] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._bell, self._hear = socket.socketpair()
        for end in (self._bell, self._hear):
            end.setblocking(False)
        self._selector.register(self._hear, selectors.EVENT_READ, self._rung)
        try:
            for endpoint in endpoints:
                self._channels.append(_OPEN[endpoint.kind](self, endpoint))
        except BaseException:
            self.close()
            raise

    @property
    def peers(self) -> list[Peer]:
        """Every ground station there is now."""
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

    def broadcast(self, packed: Packed, urgent: bool = True) -> None:
        """To every ground station."""
        for peer in self.peers:
            peer.send(packed, urgent)
        self.logged(packed)

    def send(self, peer: Peer, packed: Packed, component: int | None = None) -> None:
        """An answer to one ground station."""
        peer.send(packed, True, component)
        self.logged(packed)

    def logged(self, packed: Packed) -> None:
        if self.log is not None:
            self.log.sent(packed)

    # --- the thread --------------------------------------------------------------------------------------------

    def _run(self) -> None:
        flushed = self._clock()
        until = flushed
        while not self._stop.is_set():
            try:
                now = self._clock()
                for key, mask in self._selector.select(min(_IDLE, max(0.0, until - now))):
                    key.data(mask)
                now = self._clock()
                for channel in self._channels:
                    channel.poll(now)
                if self.station is not None:
                    until = self.station.poll(now)
                if self.log is not None and now - flushed > _FLUSH:
                    self.log.flush()
                    flushed = now
            except Exception as error:
                # whatever comes in, the link stays up; the counter says that something here is wrong
                self.failures[f"{type(error).__name__}: {error}"[:200]] += 1
                until = self._clock() + _IDLE

    def _rung(self, mask: int) -> None:
        with contextlib.suppress(OSError):
            self._hear.recv(4096)

    def take(self, frames: Sequence[Frame], peer: Peer, now: float) -> None:
        """Frames that came from a station."""
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

    def peer(self, name: str, transmit: Callable[[bytes], int], parser: Parser, whole: bool) -> Peer:
        """A new station; each has its own sequence and, for signatures, its own link id."""
        sender = Sender(*self._ids, link=self._made & 0xFF, signing=self._signing)
        self._made += 1
        return Peer(name, transmit, parser, sender, whole, self._clock(), self.refused)

    def now(self) -> float:
        return self._clock()

    def watch(self, item: Any, ready: Callable[[int], None], events: int = selectors.EVENT_READ) -> None:
        self._selector.register(item, events, ready)

    def ignore(self, item: Any) -> None:
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(item)


def _sendto(channel: socket.socket, address: Address) -> Callable[[bytes], int]:
    def transmit(data: bytes) -> int:
        try:
            return channel.sendto(data, address)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            return len(data)  # nobody listens, or there is no way: as lost as any datagram

    return transmit


def _open(endpoint: Endpoint, kind: int, bind: bool) -> socket.socket:
    made = socket.socket(endpoint.family, kind)
    try:
        made.setblocking(False)
        if bind:
            if kind == socket.SOCK_STREAM:
                made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind((endpoint.host, endpoint.port))
    except OSError as error:
        made.close()
        raise InputError(f"link {endpoint.url}: {error.strerror or error}") from error
    return made


def _datagrams(source: socket.socket) -> Iterator[tuple[bytes, Address]]:
    """What has arrived and from whom, as much as one socket may be read in its turn."""
    for _ in range(_READS):
        try:
            yield source.recvfrom(_DATAGRAM)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            continue  # an ICMP message: nobody listens there


class UdpOut:
    """Datagrams to one address; taken is what comes back from there."""

    port = 0

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        self._link = link
        self._socket = _open(endpoint, socket.SOCK_DGRAM, bind=False)
        self._target = (endpoint.host, endpoint.port)
        transmit = _sendto(self._socket, self._target)
        self._peer = link.peer(endpoint.url, transmit, link.parser(whole=True), whole=True)
        link.watch(self._socket, self._ready)

    @property
    def peers(self) -> list[Peer]:
        return [self._peer]

    def _ready(self, mask: int) -> None:
        for data, address in _datagrams(self._socket):
            if address[:2] != self._target:
                self._link.refused["stranger"] += 1
                continue
            now = self._link.now()
            self._link.take(self._peer.feed(data, now), self._peer, now)

    def poll(self, now: float) -> None:
        self._peer.flush()

    def close(self) -> None:
        self._link.ignore(self._socket)
        self._socket.close()


class Tap:
    """A socket that is read only while its station has credit: a flood stays in the operating system."""

    def __init__(self, link: Link, item: Any, ready: Callable[[int], None]) -> None:
        self._link, self._item, self._ready = link, item, ready
        self._open = True
        link.watch(item, ready)

    def shut(self) -> None:
        if self._open:
            self._open = False
            self._link.refused["flood"] += 1
            self._link.ignore(self._item)

    def poll(self, peer: Peer, now: float) -> None:
        if not self._open and peer.credit(now) > _RESUME:
            self._open = True
            self._link.watch(self._item, self._ready)


class Datagrams:
    """One station behind a UDP server, on a socket of its own at the server's port: nobody fills its buffer but itself.

    What another sent while the socket was being made is handed to ``stray``.  Raises OSError where the system has no
    such sockets.
    """

    def __init__(
        self, link: Link, server: socket.socket, address: Address, stray: Callable[[bytes, Address], None]
    ) -> None:
        self._link = link
        self._address = address
        self._stray = stray
        self._socket = socket.socket(server.family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            # for this moment only, so that no other program can take the port
            for each in (server, self._socket):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind(server.getsockname())
            self._socket.connect(address)
        except OSError:
            self._socket.close()
            raise
        finally:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        self.peer = link.peer(_named("udpin", address), self._transmit, link.parser(whole=True), whole=True)
        self._tap = Tap(link, self._socket, self._ready)

    def _transmit(self, data: bytes) -> int:
        try:
            return self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            return len(data)  # the station is gone: as lost as any datagram

    def _ready(self, mask: int) -> None:
        link = self._link
        for _ in range(_READS):
            now = link.now()
            if self.peer.credit(now) < 1.0:
                self._tap.shut()
                return
            try:
                data, address = self._socket.recvfrom(_DATAGRAM)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                continue
            if address == self._address:
                link.take(self.peer.feed(data, now), self.peer, now)
            else:
                self._stray(data, address)

    def poll(self, now: float) -> None:
        self.peer.flush()
        self._tap.poll(self.peer, now)

    def close(self) -> None:
        self._link.ignore(self._socket)
        self._socket.close()


class Shared:
    """One station behind a UDP server where the system has no sockets of their own for them."""

    def __init__(self, link: Link, server: socket.socket, address: Address) -> None:
        parser = link.parser(whole=True)
        self.peer = link.peer(_named("udpin", address), _sendto(server, address), parser, whole=True)

    def poll(self, now: float) -> None:
        self.peer.flush()

    def close(self) -> None:
        pass


def _named(kind: str, address: Address) -> str:
    return f"{kind}:{address[0]}:{address[1]}"


class UdpIn:
    """A server; stations are known by the address from which a frame that was right has come."""

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        self._link = link
        self._socket = _open(endpoint, socket.SOCK_DGRAM, bind=True)
        self.port = int(self._socket.getsockname()[1])
        self._known: dict[Address, Datagrams | Shared] = {}
        self._stranger = link.parser(whole=True)
        link.watch(self._socket, self._ready)

    @property
    def peers(self) -> list[Peer]:
        return [station.peer for station in self._known.values()]

    def _ready(self, mask: int) -> None:
        for data, address in _datagrams(self._socket):
            self._datagram(data, address)

    def _datagram(self, data: bytes, address: Address) -> None:
        link = self._link
        now = link.now()
        station = self._known.get(address)
        if station is not None:
            link.take(station.peer.feed(data, now), station.peer, now)
            return
        frames = self._stranger.feed(data)
        if not frames or not self._room(now):
            return
        try:
            station = Datagrams(link, self._socket, address, self._datagram)
        except OSError:
            station = Shared(link, self._socket, address)
        station.peer.heard, station.peer.received = now, len(frames)
        self._known[address] = station
        link.take(frames, station.peer, now)

    def _room(self, now: float) -> bool:
        if len(self._known) < MOST_PEERS:
            return True
        oldest = min(self._known, key=lambda address: self._known[address].peer.heard)
        if now - self._known[oldest].peer.heard < _EVICT:
            self._link.refused["too many stations"] += 1
            return False
        self._known.pop(oldest).close()
        return True

    def poll(self, now: float) -> None:
        for address, station in list(self._known.items()):
            station.poll(now)
            if now - station.peer.heard > FORGET:
                self._known.pop(address).close()

    def close(self) -> None:
        for station in self._known.values():
            station.close()
        self._link.ignore(self._socket)
        self._socket.close()


class Stream:
    """One connection over which bytes flow: TCP or serial."""

    def __init__(
        self, link: Link, name: str, item: Any, read: Callable[[], bytes], write: Callable[[bytes], int]
    ) -> None:
        self._link = link
        self.item = item
        self._read = read
        self._write = write
        self.open = True
        self.peer = link.peer(name, self._transmit, link.parser(whole=False), whole=False)
        self._tap = Tap(link, item, self._ready)

    def _transmit(self, data: bytes) -> int:
        if not self.open:
            return 0
        try:
            return self._write(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self.close()
            return 0

    def _ready(self, mask: int) -> None:
        now = self._link.now()
        if self.peer.credit(now) < 1.0:
            self._tap.shut()
            return
        try:
            data = self._read()
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self.close()
            return
        self._link.take(self.peer.feed(data, now), self.peer, now)

    def poll(self, now: float) -> None:
        self.peer.flush()
        if self.open:
            self._tap.poll(self.peer, now)
        if self.peer.stuck and self.open:
            self._link.refused["stuck"] += 1
            self.close()

    def close(self) -> None:
        if self.open:
            self.open = False
            self._link.ignore(self.item)
            self.item.close()


def _connection(link: Link, name: str, connection: socket.socket) -> Stream:
    connection.setblocking(False)
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL)
    return Stream(link, name, connection, lambda: connection.recv(_DATAGRAM), connection.send)


class TcpIn:
    """A server for several connections."""

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        self._link = link
        self._socket = _open(endpoint, socket.SOCK_STREAM, bind=True)
        self._socket.listen(MOST_PEERS)
        self.port = int(self._socket.getsockname()[1])
        self._streams: list[Stream] = []
        link.watch(self._socket, self._ready)

    @property
    def peers(self) -> list[Peer]:
        return [stream.peer for stream in self._streams if stream.open]

    def _ready(self, mask: int) -> None:
        try:
            connection, address = self._socket.accept()
        except OSError:
            return
        if len(self._streams) >= MOST_PEERS:
            self._link.refused["too many stations"] += 1
            connection.close()
            return
        self._streams.append(_connection(self._link, _named("tcpin", address), connection))

    def poll(self, now: float) -> None:
        for stream in self._streams:
            stream.poll(now)
        self._streams = [stream for stream in self._streams if stream.open]

    def close(self) -> None:
        for stream in self._streams:
            stream.close()
        self._link.ignore(self._socket)
        self._socket.close()


class Tcp:
    """A connection to a server; made again when it is lost."""

    port = 0

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        self._link = link
        self._endpoint = endpoint
        self._attempt: socket.socket | None = None
        self._stream: Stream | None = None
        self._next = link.now()

    @property
    def peers(self) -> list[Peer]:
        return [self._stream.peer] if self._stream is not None and self._stream.open else []

    def _ready(self, mask: int) -> None:
        attempt, self._attempt = self._attempt, None
        if attempt is None:
            return
        self._link.ignore(attempt)
        if attempt.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            attempt.close()
            return
        self._stream = _connection(self._link, self._endpoint.url, attempt)

    def poll(self, now: float) -> None:
        if self._stream is not None:
            self._stream.poll(now)
            if self._stream.open:
                return
            self._stream = None
        if now < self._next or self._attempt is not None:
            return
        self._next = now + _RETRY
        attempt = socket.socket(self._endpoint.family, socket.SOCK_STREAM)
        attempt.setblocking(False)
        try:
            attempt.connect((self._endpoint.host, self._endpoint.port))
        except BlockingIOError:
            pass
        except OSError:
            attempt.close()
            return
        self._attempt = attempt
        self._link.watch(attempt, self._ready, selectors.EVENT_WRITE)

    def close(self) -> None:
        if self._attempt is not None:
            self._link.ignore(self._attempt)
            self._attempt.close()
        if self._stream is not None:
            self._stream.close()


class Serial:
    """A radio or a cable; opened once, because a device that is not there is a mistake."""

    port = 0

    def __init__(self, link: Link, endpoint: Endpoint) -> None:
        try:
            import serial
        except ImportError as error:
            raise InputError(f"link {endpoint.url}: serial links need pyserial: pip install pyserial") from error
        try:
            device = serial.Serial(endpoint.host, endpoint.port, timeout=0, write_timeout=0)
            device.fileno()
        except (OSError, ValueError) as error:
            raise InputError(f"link {endpoint.url}: {error}") from error

        def write(data: bytes) -> int:
            try:
                return int(device.write(data) or 0)
            except serial.SerialTimeoutException:
                return 0

        self._stream = Stream(link, endpoint.url, device, lambda: bytes(device.read(_DATAGRAM)), write)

    @property
    def peers(self) -> list[Peer]:
        return [self._stream.peer] if self._stream.open else []

    def poll(self, now: float) -> None:
        self._stream.poll(now)

    def close(self) -> None:
        self._stream.close()


_OPEN: dict[str, Callable[[Link, Endpoint], Channel]] = {
    "udpout": UdpOut,
    "udpin": UdpIn,
    "tcp": Tcp,
    "tcpin": TcpIn,
    "serial": Serial,
}
