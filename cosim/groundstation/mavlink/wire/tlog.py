"""Telemetry logs: every frame behind its time, 8 bytes big-endian, microseconds since 1970.

What QGroundControl, MAVExplorer and mavlogdump read.  A message that goes to several ground stations is logged once,
with a sequence of the log's own.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from cosim.base.errors import InputError
from cosim.groundstation.mavlink.wire.dialect import Message
from cosim.groundstation.mavlink.wire.frames import FramePacker

_TIME_STAMP = struct.Struct(">Q")  # time stamp before each frame, us


class TelemetryLog:
    """Telemetry log, written frame by frame.  Raises InputError if its file cannot be opened."""

    def __init__(self, path: Path, system: int = 1, clock: Callable[[], float] = time.time) -> None:
        try:
            self._file: BinaryIO | None = path.open("wb")
        except OSError as error:
            raise InputError(f"{path}: the telemetry log cannot be written: {error}") from error
        self._clock = clock
        # Frames in the log are unsigned, because each link has a signature of its own.
        self._packer = FramePacker(system)
        self.frames = 0
        self.failure = ""  # why writing stopped; empty: it did not

    def write_sent(self, packed: Message) -> None:
        if self._file is not None:
            self._write(self._packer.pack_frame(packed))

    def write_received(self, raw: bytes) -> None:
        self._write(raw)

    def flush(self) -> None:
        self._run_until_error(lambda file: file.flush())

    def close(self) -> None:
        self._run_until_error(lambda file: file.close())
        self._file = None

    def _write(self, frame: bytes) -> None:
        stamp = _TIME_STAMP.pack(int(self._clock() * 1e6))
        self._run_until_error(lambda file: file.write(stamp + frame))
        self.frames += 1

    def _run_until_error(self, action: Callable[[BinaryIO], object]) -> None:
        """Apply an action to the file; an error, such as a full disk, ends the log but not the link."""
        if self._file is None:
            return
        try:
            action(self._file)
        except OSError as error:
            self.failure = str(error)
            self._file = None
