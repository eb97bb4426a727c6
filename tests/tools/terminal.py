"""A pseudo-terminal as a serial port."""

from __future__ import annotations

import os
import tty


class Terminal:
    """A pseudo-terminal: ``url`` is the vehicle's end, ``file`` ours."""

    def __init__(self) -> None:
        self.file, self._theirs = os.openpty()
        tty.setraw(self.file)
        os.set_blocking(self.file, False)
        self.device = os.ttyname(self._theirs)
        self.url = f"serial:{self.device}:57600"

    def read(self) -> bytes:
        try:
            return os.read(self.file, 65536)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        os.close(self.file)
        os.close(self._theirs)
