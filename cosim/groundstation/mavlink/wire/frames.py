"""Bytes to messages and back: MAVLink 2 out, MAVLink 1 and 2 in, every refusal counted by its reason."""

from __future__ import annotations

import struct
from collections import Counter
from typing import NamedTuple

from cosim.groundstation.mavlink.wire.dialect import (
    BY_NAME,
    CHECKSUM,
    HEADER_1,
    HEADER_2,
    KINDS,
    MAGIC_1,
    MAGIC_2,
    SIGNATURE,
    SIGNED,
    Message,
    Packed,
    checksum,
    unpack,
)
from cosim.groundstation.mavlink.wire.signing import Signing

RADIO_STATUS = BY_NAME["RADIO_STATUS"].id
_HEAD_2 = struct.Struct("<BBBBBBBHB")


class Frame(NamedTuple):
    """One frame that was taken."""

    raw: bytes
    system: int
    component: int
    sequence: int
    signed: bool
    message: Message


class Parser:
    """Frames from the bytes of one sender.

    ``whole``: what is fed ends with a frame's end, as a datagram does; a rest is refused instead of being kept.
    With ``signing`` every frame has to carry a signature that is right and new.  RADIO_STATUS need not in a stream of
    bytes: it can do no more than slow that stream's telemetry down.
    """

    def __init__(self, refused: Counter[str], signing: Signing | None = None, whole: bool = False) -> None:
        self._refused = refused
        self._signing = signing
        self._whole = whole
        self._buffer = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Every frame that ``data`` completes.  Raises nothing, whatever the bytes are."""
        buffer = self._buffer + data
        frames: list[Frame] = []
        at, end = 0, len(buffer)
        while at < end:
            start = _next_magic(buffer, at)
            if start > at:
                self._refused["noise"] += 1
                at = start
                continue
            length = _length(buffer, at)
            if length is None or at + length > end:
                if not self._whole:
                    break
                self._refused["truncated"] += 1
                at += 1
                at = _next_magic(buffer, at)
                continue
            raw = buffer[at : at + length]
            reason, frame = self._read(raw)
            if frame is not None:
                frames.append(frame)
            if reason:
                self._refused[reason] += 1
            # of a frame that is none, all but the first byte may belong to another
            if reason in ("crc", "flags"):
                at = _next_magic(buffer, at + 1)
            else:
                at += length
        self._buffer = buffer[at:]
        return frames

    def _read(self, raw: bytes) -> tuple[str, Frame | None]:
        second = raw[0] == MAGIC_2
        if second:
            _, size, flags, _, sequence, system, component, low, high = _HEAD_2.unpack_from(raw)
            message_id, start = low | high << 16, HEADER_2
        else:
            _, size, sequence, system, component, message_id = raw[:HEADER_1]
            flags, start = 0, HEADER_1
        if flags & ~SIGNED:
            return "flags", None
        kind = KINDS.get(message_id)
        if kind is None:
            return "unknown", None
        stop = start + size
        if checksum(raw[1:stop], kind.crc_extra) != raw[stop] | raw[stop + 1] << 8:
            return "crc", None
        signed = bool(flags & SIGNED)
        if self._signing is not None:
            # a radio at the vehicle's end of a cable puts its own word in, and has no key
            of_radio = message_id == RADIO_STATUS and not self._whole
            reason = self._signing.refuse(raw, system, component) if signed else "" if of_radio else "unsigned"
            if reason:
                return reason, None
        message = unpack(message_id, raw[start:stop])
        return "", Frame(raw, system, component, sequence, signed, message)


class Sender:
    """Frames to one receiver: its sequence and its link's id."""

    def __init__(self, system: int, component: int, link: int = 0, signing: Signing | None = None) -> None:
        self._system, self._component = system, component
        self._link = link
        self._signing = signing
        self._sequence = 0
        self.signature = 0 if signing is None else SIGNATURE  # bytes of it

    def frame(self, packed: Packed, component: int | None = None) -> bytes:
        """The next frame."""
        flags = 0 if self._signing is None else SIGNED
        head = _HEAD_2.pack(
            MAGIC_2,
            len(packed.payload),
            flags,
            0,
            self._sequence,
            self._system,
            self._component if component is None else component,
            packed.message_id & 0xFFFF,
            packed.message_id >> 16,
        )
        self._sequence = (self._sequence + 1) & 0xFF
        body = head + packed.payload
        frame = body + checksum(body[1:], packed.crc_extra).to_bytes(2, "little")
        return frame if self._signing is None else frame + self._signing.sign(frame, self._link)


def _next_magic(buffer: bytes, at: int) -> int:
    first, second = buffer.find(MAGIC_1, at), buffer.find(MAGIC_2, at)
    starts = [place for place in (first, second) if place >= 0]
    return min(starts, default=len(buffer))


def _length(buffer: bytes, at: int) -> int | None:
    """Bytes of the frame that begins at ``at``; None while too little of it is there to know."""
    if len(buffer) < at + 3:
        return None
    size = buffer[at + 1]
    if buffer[at] == MAGIC_1:
        return HEADER_1 + size + CHECKSUM
    return HEADER_2 + size + CHECKSUM + (SIGNATURE if buffer[at + 2] & SIGNED else 0)
