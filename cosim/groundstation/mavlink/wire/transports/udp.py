"""UDP: datagrams to one address, or a server with a socket for each of its stations."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.transports.channel import (
    LIMITS,
    Address,
    Hub,
    ReadGate,
    is_replaceable,
    name_station,
    open_socket,
)
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint


def _nonblocking(send: Callable[[bytes], int]) -> Callable[[bytes], int]:
    """Return a ``send`` that returns 0 instead of blocking, and counts undeliverable datagrams as sent."""

    def transmit(data: bytes) -> int:
        try:
            return send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            return len(data)  # no listener or route: datagram lost

    return transmit


def _read_datagrams(source: socket.socket) -> Iterator[tuple[bytes, Address]]:
    """Yield received datagrams with their senders, up to the limit of one turn."""
    for _ in range(LIMITS.reads):
        try:
            yield source.recvfrom(LIMITS.datagram_bytes)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            continue  # an ICMP error: nobody listens there


class UdpClient:
    """UDP client that exchanges datagrams with one address only."""

    port = 0

    def __init__(self, link: Hub, endpoint: Endpoint) -> None:
        self._link = link
        self._socket = open_socket(endpoint, socket.SOCK_DGRAM, bind=False)
        self._target = (endpoint.host, endpoint.port)
        transmit = _nonblocking(lambda data: self._socket.sendto(data, self._target))
        self._peer = link.new_peer(endpoint.url, transmit, is_datagram=True)
        link.watch(self._socket, self._handle_ready_socket)

    @property
    def peers(self) -> list[Peer]:
        return [self._peer]

    def _handle_ready_socket(self, mask: int) -> None:
        for data, address in _read_datagrams(self._socket):
            if address[:2] != self._target:
                self._link.refused["stranger"] += 1
                continue
            now = self._link.now()
            self._link.dispatch_frames(self._peer.feed(data, now), self._peer, now)

    def poll(self, now: float) -> None:
        self._peer.flush()

    def close(self) -> None:
        self._link.unwatch(self._socket)
        self._socket.close()


class ConnectedStation:
    """Station of a UDP server with a separate socket at the server's port, and thus a separate buffer.

    What another sent while the socket was being made is handed to ``stray``.  Raises OSError where the system has no
    such sockets.
    """

    def __init__(
        self, link: Hub, server: socket.socket, address: Address, stray: Callable[[bytes, Address], None]
    ) -> None:
        self._link = link
        self._address = address
        self._stray = stray
        self._socket = socket.socket(server.family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            # The port may be shared only while the socket is bound, so that no other program takes it.
            for opened in (server, self._socket):
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind(server.getsockname())
            self._socket.connect(address)
        except OSError:
            self._socket.close()
            raise
        finally:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        self.peer = link.new_peer(name_station("udpin", address), _nonblocking(self._socket.send), is_datagram=True)
        self._gate = ReadGate(link, self._socket, self._handle_ready_socket)

    def _handle_ready_socket(self, mask: int) -> None:
        link = self._link
        for _ in range(LIMITS.reads):
            now = link.now()
            if self.peer.update_credit(now) < 1.0:
                self._gate.pause()
                return
            try:
                data, address = self._socket.recvfrom(LIMITS.datagram_bytes)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                continue
            if address == self._address:
                link.dispatch_frames(self.peer.feed(data, now), self.peer, now)
            else:
                self._stray(data, address)

    def poll(self, now: float) -> None:
        self.peer.flush()
        self._gate.poll(self.peer, now)

    def close(self) -> None:
        self._link.unwatch(self._socket)
        self._socket.close()


class SharedSocketStation:
    """Station of a UDP server that shares the server's socket, on systems without separate ones."""

    def __init__(self, link: Hub, server: socket.socket, address: Address) -> None:
        transmit = _nonblocking(lambda data: server.sendto(data, address))
        self.peer = link.new_peer(name_station("udpin", address), transmit, is_datagram=True)

    def poll(self, now: float) -> None:
        self.peer.flush()

    def close(self) -> None:
        pass


class UdpServer:
    """UDP server, whose stations are the addresses that sent a valid frame.

    ``forget_s``: after which a silent station is gone.
    """

    def __init__(self, link: Hub, endpoint: Endpoint, forget_s: float = 30.0) -> None:
        self.forget_s = forget_s
        self._link = link
        self._socket = open_socket(endpoint, socket.SOCK_DGRAM, bind=True)
        self.port = int(self._socket.getsockname()[1])
        self._stations: dict[Address, ConnectedStation | SharedSocketStation] = {}
        self._first_parser = link.new_parser(is_datagram=True)  # for addresses without a station yet
        link.watch(self._socket, self._handle_ready_socket)

    @property
    def peers(self) -> list[Peer]:
        return [station.peer for station in self._stations.values()]

    def _handle_ready_socket(self, mask: int) -> None:
        for data, address in _read_datagrams(self._socket):
            self._receive_datagram(data, address)

    def _receive_datagram(self, data: bytes, address: Address) -> None:
        link = self._link
        now = link.now()
        station = self._stations.get(address)
        if station is not None:
            link.dispatch_frames(station.peer.feed(data, now), station.peer, now)
            return
        frames = self._first_parser.feed(data)
        if not frames or not self._make_room_for_station(now):
            return
        try:
            station = ConnectedStation(link, self._socket, address, self._receive_datagram)
        except OSError:
            station = SharedSocketStation(link, self._socket, address)
        station.peer.last_heard, station.peer.received = now, len(frames)
        self._stations[address] = station
        link.dispatch_frames(frames, station.peer, now)

    def _make_room_for_station(self, now: float) -> bool:
        if len(self._stations) < LIMITS.max_stations:
            return True
        oldest = max(self._stations, key=lambda address: self._stations[address].peer.silent_seconds(now))
        if not is_replaceable(self._stations[oldest].peer, now):
            self._link.refused["too many stations"] += 1
            return False
        self._stations.pop(oldest).close()
        return True

    def poll(self, now: float) -> None:
        for address, station in list(self._stations.items()):
            station.poll(now)
            if now - station.peer.last_heard > self.forget_s:
                self._stations.pop(address).close()

    def close(self) -> None:
        for station in self._stations.values():
            station.close()
        self._link.unwatch(self._socket)
        self._socket.close()
