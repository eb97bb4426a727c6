"""Conversion of bytes to messages and back: MAVLink 2 out, 1 and 2 in, every refusal counted by its reason.

A frame is packed, signed and read by pymavlink's class.  Where frames begin is found here and not by its parser, which
tells no reason of a refusal, keeps the rest of a datagram, and passes over all that a damaged length claims.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from cosim.groundstation.mavlink.wire.dialect import CHECKSUM_BYTES, COMPONENT_ID, Message, mav
from cosim.groundstation.mavlink.wire.signing import Signing

MAGIC_1, MAGIC_2 = mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2  # first byte of MAVLink 1, 2
SIGNED_FLAG = mav.MAVLINK_IFLAG_SIGNED  # the only supported incompatibility flag


class Frame(NamedTuple):
    """Accepted frame with its decoded message and sender."""

    raw: bytes
    system: int
    component: int
    sequence: int
    signed: bool
    message: Message


class Parser:
    """Parser of one sender's bytes into frames.

    ``is_datagram``: what is fed ends with the end of a frame; a rest is refused instead of being kept.
    With ``signing`` every frame has to carry a signature that is right and new.
    """

    def __init__(self, refused: Counter[str], signing: Signing | None = None, is_datagram: bool = False) -> None:
        self._refused = refused
        self._signing = signing
        self._is_datagram = is_datagram
        self._mav = mav.MAVLink(None)
        self._buffer = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return every frame that ``data`` completes; invalid bytes are skipped and counted."""
        buffer = self._buffer + data
        frames: list[Frame] = []
        at, end = 0, len(buffer)
        while at < end:
            start = _find_next_start(buffer, at)
            if start > at:
                self._refused["noise"] += 1
                at = start
                continue
            length = _frame_length(buffer, at)
            if length is None or at + length > end:
                if not self._is_datagram:
                    break
                self._refused["truncated"] += 1
                at = _find_next_start(buffer, at + 1)
                continue
            raw = buffer[at : at + length]
            reason, frame = self._decode_frame(raw)
            if frame is not None:
                frames.append(frame)
            if reason:
                self._refused[reason] += 1
            # Skip only the first byte of an invalid frame, because a frame may begin right after it.
            if reason in ("crc", "flags"):
                at = _find_next_start(buffer, at + 1)
            else:
                at += length
        self._buffer = buffer[at:]
        return frames

    def _decode_frame(self, raw: bytes) -> tuple[str, Frame | None]:
        flags = raw[2] if raw[0] == MAGIC_2 else 0
        if flags & ~SIGNED_FLAG:
            return "flags", None
        try:
            message = self._mav.decode(bytearray(raw))
        except mav.MAVError:  # wrong checksum, but the length is right
            return "crc", None
        if isinstance(message, mav.MAVLink_unknown):
            return "unknown", None
        system, component = message.get_srcSystem(), message.get_srcComponent()
        signed = bool(flags & SIGNED_FLAG)
        if self._signing is not None:
            reason = self._signing.find_refusal(raw, system, component) if signed else "unsigned"
            if reason:
                return reason, None
        return "", Frame(raw, system, component, message.get_seq(), signed, message)


class FramePacker:
    """Packer of frames for one receiver, with its own sequence numbers and link id."""

    def __init__(self, system: int, link: int = 0, signing: Signing | None = None) -> None:
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=COMPONENT_ID)
        self._signing = signing
        if signing is not None:
            signing.enable_signing(self._mav, link)
        self.signature = 0 if signing is None else mav.MAVLINK_SIGNATURE_BLOCK_LEN  # bytes of a signature

    def pack_frame(self, message: Message) -> bytes:
        """Return a message as the next frame."""
        if self._signing is not None:
            self._mav.signing.timestamp = self._signing.make_time_stamp()
        raw: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) & 0xFF
        return raw


def _find_next_start(buffer: bytes, at: int) -> int:
    first, second = buffer.find(MAGIC_1, at), buffer.find(MAGIC_2, at)
    starts = [position for position in (first, second) if position >= 0]
    return min(starts, default=len(buffer))


def _frame_length(buffer: bytes, at: int) -> int | None:
    """Return the length of the frame at ``at``; None if it is incomplete."""
    if len(buffer) < at + 3:
        return None
    size = buffer[at + 1]
    if buffer[at] == MAGIC_1:
        return int(mav.HEADER_LEN_V1) + size + CHECKSUM_BYTES
    signature = mav.MAVLINK_SIGNATURE_BLOCK_LEN if buffer[at + 2] & SIGNED_FLAG else 0
    return int(mav.HEADER_LEN_V2) + size + CHECKSUM_BYTES + int(signature)
