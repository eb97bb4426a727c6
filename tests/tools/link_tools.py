"""A flight behind real sockets, and clients of them."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any

from mavlink_tools import ABOUT, MOST, Pilot, Udp, sample, snapshot
from patience import PATIENCE, stretched

from cosim.groundstation.exchange import Exchange, Port
from cosim.groundstation.mavlink.vehicle import MavlinkVehicle
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from cosim.groundstation.mavlink.wire.transports.endpoint import parse_endpoint


class Flight:
    """A thread that steps at 250 Hz, as far as the link can tell; ``late``: steps that began 4 ms late or more."""

    def __init__(self, *urls: str, signing: Signing | None = None, log: TelemetryLog | None = None) -> None:
        self.link = Link([parse_endpoint(url) for url in urls], signing=signing, log=log)
        self.exchange = Exchange()
        self.vehicle = MavlinkVehicle(ABOUT, Port(self.exchange, "mavlink"), self.link)
        self.pilot = Pilot()
        self.worst = 0.0  # s that handing over took
        self.late = self.steps = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()
        self.link.start(self.vehicle)

    def _fly(self) -> None:
        start, k = time.monotonic(), 0
        while not self._stop.is_set():
            began = time.perf_counter()
            for waiting in self.exchange.take_requests(MOST):
                waiting.answer(self.pilot.handle(waiting.request))
            self.exchange.publish(snapshot(sample(k), self.pilot.status))
            self.worst = max(self.worst, time.perf_counter() - began)
            k += 1
            self.steps = k
            left = start + k * 0.004 - time.monotonic()
            self.late += left < -0.004
            time.sleep(max(0.0, left))

    @property
    def port(self) -> int:
        return self.link.ports[0]

    def close(self) -> None:
        self.link.close()
        self._stop.set()
        self._thread.join()


def until(condition: Any, seconds: float = 3.0) -> bool:
    end = time.monotonic() + stretched(seconds)
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


class Tcp(Udp):
    """A station on a connection."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self.socket.close()
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
        self.socket.settimeout(0.05)

    def write(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self) -> None:
        try:
            data = self.socket.recv(4096)
        except TimeoutError:
            return
        self.got += self.mav.parse_buffer(data) or []
