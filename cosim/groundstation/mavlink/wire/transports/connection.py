"""A connection over which bytes flow: TCP or serial."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cosim.groundstation.mavlink.wire.hub import Hub
from cosim.groundstation.mavlink.wire.transports.channel import STALL, ReadGate


class Connection:
    """A station over one connection.

    ``item``: a file or socket to be watched; ``read`` and ``write`` are its own and never wait.  ``line``: bytes a
    second that it carries, if that is known.  A connection that has taken nothing for ``STALL`` is closed; ``why``
    then says so.
    """

    def __init__(
        self,
        link: Hub,
        name: str,
        item: Any,
        read: Callable[[], bytes],
        write: Callable[[bytes], int],
        line: float | None = None,
    ) -> None:
        self._link = link
        self.item = item
        self._read = read
        self._write = write
        self.open = True
        self.stalled = False  # True where it was closed because it accepted nothing
        self.why = ""
        self.peer = link.new_peer(name, self._transmit, is_datagram=False, line=line)
        self._gate = ReadGate(link, item, self._ready)

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

    def _ready(self, mask: int) -> None:
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
        """Send what waits; close it when it has been stuck for too long."""
        peer = self.peer
        peer.flush()
        if not self.open:
            return
        self._gate.poll(peer, now)
        if peer.blocked_seconds(now) > STALL or (peer.stuck and peer.line is None):
            self._link.refused["stuck"] += 1
            self.stalled = True
            self.close("too much waits for it" if peer.stuck else f"it has taken nothing for {STALL:g} s")

    def close(self, why: str = "") -> None:
        """Close the connection for a reason; may be called twice."""
        if self.open:
            self.open = False
            self.why = why
            self._link.unwatch(self.item)
            self.item.close()
