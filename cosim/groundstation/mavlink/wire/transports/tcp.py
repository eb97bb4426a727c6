"""TCP: a server for several connections, or a connection to a server."""

from __future__ import annotations

import contextlib
import selectors
import socket

from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.transports.channel import (
    LIMITS,
    Connection,
    Hub,
    is_replaceable,
    name_station,
    open_socket,
)
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint

# Socket option that limits unsent data in the kernel, because old telemetry is of no use to a slow reader.
_UNSENT_OPTION = getattr(socket, "TCP_NOTSENT_LOWAT", None)


def _make_connection(
    link: Hub, name: str, connection: socket.socket, kernel_bytes: int = 65536, unsent_bytes: int = 4096
) -> Connection:
    connection.setblocking(False)
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, kernel_bytes)
        if _UNSENT_OPTION is not None:
            connection.setsockopt(socket.IPPROTO_TCP, _UNSENT_OPTION, unsent_bytes)
    return Connection(link, name, connection, lambda: connection.recv(LIMITS.datagram_bytes), connection.send)


class TcpServer:
    """TCP server for several ground stations."""

    def __init__(self, link: Hub, endpoint: Endpoint) -> None:
        self._link = link
        self._socket = open_socket(endpoint, socket.SOCK_STREAM, bind=True)
        self._socket.listen(LIMITS.max_stations)
        self.port = int(self._socket.getsockname()[1])
        self._streams: list[Connection] = []
        link.watch(self._socket, self._handle_ready_socket)

    @property
    def peers(self) -> list[Peer]:
        return [stream.peer for stream in self._streams if stream.open]

    def _handle_ready_socket(self, mask: int) -> None:
        try:
            connection, address = self._socket.accept()
        except OSError:
            return
        if not self._has_room_for_station():
            self._link.refused["too many stations"] += 1
            connection.close()
            return
        self._streams.append(_make_connection(self._link, name_station("tcpin", address), connection))

    def _has_room_for_station(self) -> bool:
        """Return whether one more station can be accepted, closing a silent one if necessary."""
        streams = self._streams = [stream for stream in self._streams if stream.open]
        if len(streams) < LIMITS.max_stations:
            return True
        now = self._link.now()
        idle = [stream for stream in streams if is_replaceable(stream.peer, now)]
        if not idle:
            return False
        # Close first a station that has sent nothing.
        oldest = max(idle, key=lambda stream: (stream.peer.last_heard < 0.0, stream.peer.silent_seconds(now)))
        oldest.close()
        streams.remove(oldest)
        return True

    def poll(self, now: float) -> None:
        for stream in self._streams:
            stream.poll(now)
            if stream.stalled:
                self._link.report_event(f"{stream.peer.name} is dropped: {stream.why}")
        self._streams = [stream for stream in self._streams if stream.open]

    def close(self) -> None:
        for stream in self._streams:
            stream.close()
        self._link.unwatch(self._socket)
        self._socket.close()


class TcpClient:
    """TCP connection to a server, reopened when lost."""

    port = 0

    def __init__(self, link: Hub, endpoint: Endpoint) -> None:
        self._link = link
        self._endpoint = endpoint
        self._attempt: socket.socket | None = None
        self._stream: Connection | None = None
        self._next = link.now()

    @property
    def peers(self) -> list[Peer]:
        return [self._stream.peer] if self._stream is not None and self._stream.open else []

    def _handle_ready_socket(self, mask: int) -> None:
        attempt, self._attempt = self._attempt, None
        if attempt is None:
            return
        self._link.unwatch(attempt)
        if attempt.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            attempt.close()
            return
        self._stream = _make_connection(self._link, self._endpoint.url, attempt)

    def poll(self, now: float) -> None:
        if self._stream is not None:
            self._stream.poll(now)
            if self._stream.open:
                return
            if self._stream.stalled:
                self._link.report_event(f"{self._endpoint.url} is dropped: {self._stream.why}")
            self._stream = None
        if now < self._next or self._attempt is not None:
            return
        self._next = now + LIMITS.retry_s
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
        self._link.watch(attempt, self._handle_ready_socket, selectors.EVENT_WRITE)

    def close(self) -> None:
        if self._attempt is not None:
            self._link.unwatch(self._attempt)
            self._attempt.close()
        if self._stream is not None:
            self._stream.close()
