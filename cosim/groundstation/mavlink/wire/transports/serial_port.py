"""A serial port: a radio or a cable.

pyserial opens it and sets its speed; reading and writing are the operating system's own, because pyserial's write tries
again for ever where a port takes nothing.
"""

from __future__ import annotations

import contextlib
import os
from typing import Any

from cosim.base.errors import InputError
from cosim.groundstation.mavlink.wire.hub import Hub
from cosim.groundstation.mavlink.wire.peer import Peer
from cosim.groundstation.mavlink.wire.transports.channel import DATAGRAM, RETRY, STALL, Connection
from cosim.groundstation.mavlink.wire.transports.endpoint import Endpoint

_BITS = 10  # bits per byte on the line: a start bit, eight data bits, a stop bit
_BEHIND_S = 0.05  # s of the line's bytes that may wait in the driver; chosen by us: twice what is written at once
_FRAME = 280  # bytes of the longest frame


class SerialDevice:
    """An open serial device whose calls return at once.  Raises OSError or ValueError where it cannot be opened."""

    def __init__(self, device: str, baud: int) -> None:
        import serial

        self._device: Any = serial.Serial(device, baud, timeout=0, write_timeout=0)
        self._descriptor = int(self._device.fileno())
        self._most = _FRAME + _BEHIND_S * baud / _BITS
        self._is_full = False

    def fileno(self) -> int:
        """Return the file descriptor, for a selector."""
        return self._descriptor

    def read(self) -> bytes:
        return os.read(self._descriptor, DATAGRAM)

    def write(self, data: bytes) -> int:
        """Write, and return how many bytes the driver took; none while it has enough, as those would go first."""
        try:
            self._is_full = self._unsent() > self._most
            taken = 0 if self._is_full else os.write(self._descriptor, data)
        except BlockingIOError:
            taken = 0
        self._is_full = self._is_full or taken < len(data)
        return taken

    def close(self) -> None:
        """Close at once, discarding unsent bytes, for which the system would wait half a minute."""
        import termios

        with contextlib.suppress(OSError, termios.error):  # the device may have been unplugged
            if self._is_full or self._unsent():
                termios.tcflush(self._descriptor, termios.TCOFLUSH)
        with contextlib.suppress(OSError, termios.error):
            self._device.close()

    def _unsent(self) -> int:
        """Return the bytes in the driver; 0 where it does not report them."""
        waiting: int = self._device.out_waiting
        return waiting


class Serial:
    """A serial link, opened before the flight, as a missing device is a mistake then; reopened when it is lost."""

    port = 0

    def __init__(self, link: Hub, endpoint: Endpoint) -> None:
        self._link = link
        self._endpoint = endpoint
        self._stream: Connection | None = None
        self._is_lost = False
        self._next = self._opened_at = link.now()
        try:
            self._open()
        except ImportError as error:
            raise InputError(
                f"link {endpoint.url}: serial links need pyserial: pip install 'hexjet-cosim[serial]'"
            ) from error
        except (OSError, ValueError) as error:
            raise InputError(f"link {endpoint.url}: {error}") from error

    def _open(self) -> None:
        speed = self._endpoint.port
        port = SerialDevice(self._endpoint.host, speed)
        self._stream = Connection(self._link, self._endpoint.url, port, port.read, port.write, speed / _BITS)
        self._opened_at = self._link.now()

    @property
    def peers(self) -> list[Peer]:
        return [self._stream.peer] if self._stream is not None and self._stream.open else []

    def poll(self, now: float) -> None:
        stream = self._stream
        if stream is not None:
            stream.poll(now)
            if stream.open:
                self._report_recovery(stream, now)
                return
            self._stream, self._next = None, now + RETRY
            if not self._is_lost:
                self._link.report_event(f"{self._endpoint.url} is dropped: {stream.why}")
            self._is_lost = True
        if now >= self._next:
            self._next = now + RETRY
            with contextlib.suppress(OSError, ValueError):  # the device is not there yet
                self._open()

    def _report_recovery(self, stream: Connection, now: float) -> None:
        """Report a lost line as back once it has worked for as long as it may be stuck, not at each attempt."""
        if self._is_lost and now - self._opened_at > STALL and not stream.peer.blocked_seconds(now):
            self._is_lost = False
            self._link.report_event(f"{self._endpoint.url} carries again")

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()
