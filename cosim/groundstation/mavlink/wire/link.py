"""Every socket of the vehicle, in one background thread that never makes the stepping thread wait."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Sequence
from math import inf
from typing import Any

from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.peer import Peer, Priority
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from cosim.groundstation.mavlink.wire.transports.channel import Channel, FrameHandler, Hub
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint
from cosim.groundstation.mavlink.wire.transports.tcp import TcpClient, TcpServer
from cosim.groundstation.mavlink.wire.transports.udp import UdpClient, UdpServer

# Chosen by us: the link's thread wakes at least this often, so that it ends soon when it is stopped.
_MAX_SLEEP_S = 0.05  # longest sleep of the link's thread
# Texts of refusals that are reported. Damaged frames are usual on a radio, so they are only counted.
_REPORT_TEXTS = {
    "signature": "frames with a wrong signature refused",
    "unsigned": "frames without a signature refused",
    "replay": "frames with the signature of an earlier time refused",
    "too many stations": "stations turned away because there is no place",
}


class Link(Hub):
    """All links of a vehicle, opened on creation to detect errors before the flight; silent until ``start``.

    ``handler`` is called in the link's thread only.  Raises InputError where a port cannot be opened.
    """

    def __init__(
        self,
        endpoints: Sequence[Endpoint],
        system: int = 1,
        signing: Signing | None = None,
        log: TelemetryLog | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(system, signing, log, clock)
        # By reason: count and time of the last report.
        self._reports: dict[str, tuple[int, float]] = {}
        self._channels: list[Channel] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._wake_writer, self._wake_reader = socket.socketpair()
        self._wake_writer.setblocking(False)
        self._wake_reader.setblocking(False)
        self.watch(self._wake_reader, self._drain_wakeups)
        try:
            for endpoint in endpoints:
                self._channels.append(_CHANNEL_CLASSES[endpoint.kind](self, endpoint))
        except BaseException:
            self.close()
            raise

    @property
    def peers(self) -> list[Peer]:
        """Ground stations that are connected now."""
        return [peer for channel in self._channels for peer in channel.peers]

    @property
    def ports(self) -> list[int]:
        return [getattr(channel, "port", 0) for channel in self._channels]

    def start(self, handler: FrameHandler) -> None:
        self.handler = handler
        self._thread = threading.Thread(target=self._run_loop, name="mavlink", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Wake the link's thread; may be called from any thread and never blocks."""
        with contextlib.suppress(OSError):
            self._wake_writer.send(b"!")

    def close(self) -> None:
        """Stop the link's thread and close all channels; may be called twice."""
        self._stop.set()
        self.wake()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
            self._thread = None
        for channel in self._channels:
            channel.close()
        self._channels = []
        self._selector.close()
        self._wake_writer.close()
        self._wake_reader.close()
        if self.log is not None:
            self.log.close()

    def broadcast(self, packed: Message, priority: Priority = Priority.ANSWER) -> None:
        """Send a message to every ground station."""
        for peer in self.peers:
            peer.send(packed, priority)
        self.log_sent(packed)

    def send(self, peer: Peer, packed: Message, priority: Priority = Priority.ANSWER) -> None:
        peer.send(packed, priority)
        self.log_sent(packed)

    def log_sent(self, packed: Message) -> None:
        if self.log is not None:
            self.log.write_sent(packed)

    def _run_loop(self, flush_s: float = 1.0) -> None:
        flushed = self.now()
        until = flushed
        while not self._stop.is_set():
            now = self.now()
            for key, mask in self._selector.select(min(_MAX_SLEEP_S, max(0.0, until - now))):
                self._run_isolated(key.data, mask)
            now = self.now()
            until = min(now + _MAX_SLEEP_S, self.poll(now))
            if self.log is not None and now - flushed > flush_s:
                self.log.flush()
                flushed = now

    def poll(self, now: float) -> float:
        """Poll channels and handler; return the time of the next poll [s of the clock]."""
        for channel in self._channels:
            self._run_isolated(channel.poll, now)
        self._report_problems(now)
        until = now + _MAX_SLEEP_S
        if self.handler is not None:
            until = self._run_isolated(self.handler.poll, now) or until
        return until

    def _run_isolated(self, callback: Callable[[Any], Any], argument: Any) -> Any:
        """Run a link's callback, and count an exception instead of letting it stop other links."""
        try:
            return callback(argument)
        except Exception as error:
            self.failures[f"{type(error).__name__}: {error}"[:200]] += 1
            return None

    def _report_problems(self, now: float, interval_s: float = 10.0) -> None:
        counts = {reason: self.refused[reason] for reason in _REPORT_TEXTS} | dict(self.failures)
        for reason, count in counts.items():
            reported, when = self._reports.get(reason, (0, -inf))
            if count > reported and now - when >= interval_s:
                self._reports[reason] = count, now
                self.report_event(f"{_REPORT_TEXTS.get(reason, reason)}: {count - reported}")

    def _drain_wakeups(self, mask: int) -> None:
        with contextlib.suppress(OSError):
            self._wake_reader.recv(4096)


_CHANNEL_CLASSES: dict[str, Callable[[Link, Endpoint], Channel]] = {  # by kind of endpoint
    "udpout": UdpClient,
    "udpin": UdpServer,
    "tcp": TcpClient,
    "tcpin": TcpServer,
}
