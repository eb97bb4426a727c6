"""Signatures of MAVLink 2: the key, the vehicle's own time stamps, and the check of others'.

A signature is the link's id, a time stamp (48 bit, 10 us since 2015-01-01) and the first six bytes of
SHA-256(key, frame up to here).  https://mavlink.io/en/guide/message_signing.html
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cosim.base.errors import InputError
from cosim.base.storage.files import read_text

EPOCH_S = 1420070400.0  # 2015-01-01 as UNIX time
_TICKS_PER_S = 100_000  # time stamps per second
_MAX_LATENESS_TICKS = 60 * _TICKS_PER_S  # of a new stream's time stamps
_HEX = "hex:"  # prefix of a hexadecimal key


def read_key(path: Path, min_length: int = 8) -> bytes:
    """Return the signing key in a file: a pass phrase, or ``hex:`` and 64 digits.

    The key of a pass phrase is its SHA-256, as in QGroundControl and MAVProxy.  Raises InputError.
    """
    text = read_text(path).strip()
    if text.startswith(_HEX):
        try:
            key = bytes.fromhex(text.removeprefix(_HEX))
        except ValueError:
            key = b""
        if len(key) != 32:
            raise InputError(f"{path}: {_HEX} must be followed by 64 hexadecimal digits")
        return key
    if len(text) < min_length or "\n" in text:
        raise InputError(f"{path}: must hold one line: a pass phrase of at least {min_length} characters, or {_HEX}...")
    return hashlib.sha256(text.encode()).digest()


class Signing:
    """Signing of frames with one key on all links; each link uses its own id.

    A time stamp is used once: the vehicle's rise from frame to frame and never fall behind the clock or behind what
    was accepted from others; another's must rise within its stream (link, system, component), and a new stream may be
    at most a minute behind.
    """

    def __init__(self, key: bytes, clock: Callable[[], float] = time.time) -> None:
        self._key = key
        self._clock = clock
        self._last = 0  # highest time stamp sent or accepted
        self._streams: dict[tuple[int, int, int], int] = {}

    def enable_signing(self, packer: Any, link: int) -> None:
        """Let a pymavlink object sign its messages with this link id."""
        packer.signing.secret_key, packer.signing.link_id, packer.signing.sign_outgoing = self._key, link, True

    def make_time_stamp(self) -> int:
        self._last = max(self._last + 1, self._current_ticks())
        return self._last

    def find_refusal(self, frame: bytes, system: int, component: int) -> str:
        """Return the reason to reject a complete signed frame; empty if it is authentic.

        The time stamp counts only once the signature has proved right, so nobody without the key moves it.  pymavlink's
        check remembers the time stamp first, so that a forged one would lock out those who have the key.
        """
        if not hmac.compare_digest(hashlib.sha256(self._key + frame[:-6]).digest()[:6], frame[-6:]):
            return "signature"
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[-13], system, component)
        last = self._streams.get(stream)
        if stamp <= last if last is not None else stamp + _MAX_LATENESS_TICKS < max(self._last, self._current_ticks()):
            return "replay"
        self._streams[stream] = stamp
        self._last = max(self._last, stamp)
        return ""

    def _current_ticks(self) -> int:
        return int((self._clock() - EPOCH_S) * _TICKS_PER_S)
