"""The messages, made at build time from ``hexjet.xml``, and the way between a message and the bytes of a frame."""

from __future__ import annotations

import importlib
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

from cosim.base.errors import InputError

try:
    mav: Any = importlib.import_module("cosim.groundstation.mavlink.wire._messages")
except ImportError as error:
    raise InputError("the MAVLink messages have not been made: install the project again (pip install -e .)") from error

Message = Any  # an instance of one of the made classes
KINDS: dict[int, Any] = mav.mavlink_map
BY_NAME: dict[str, Any] = {kind.msgname: kind for kind in KINDS.values()}

MAGIC_1, MAGIC_2 = 0xFE, 0xFD
HEADER_1, HEADER_2 = 6, 10
CHECKSUM = 2
SIGNATURE = 13
SIGNED = 0x01  # the only incompatibility flag that there is
LONGEST = HEADER_2 + 255 + CHECKSUM + SIGNATURE


class Packed(NamedTuple):
    """A message as bytes, before it has a place in a sequence."""

    message_id: int
    name: str
    payload: bytes  # without the zeros at its end, as MAVLink 2 sends it
    crc_extra: int


# what the made classes ask of a sender when they pack
_BARE = SimpleNamespace(seq=0, srcSystem=0, srcComponent=0, signing=SimpleNamespace(sign_outgoing=False))


def pack(message: Message) -> Packed:
    """The payload.  Raises struct.error for a value that does not fit its field."""
    kind = type(message)
    message.pack(_BARE)
    return Packed(kind.id, kind.msgname, bytes(message._payload), kind.crc_extra)


def checksum(data: bytes, extra: int) -> int:
    """CRC-16/MCRF4XX of everything after the magic byte, and of the extra byte of the message's definition."""
    crc = mav.x25crc(data)
    crc.accumulate(bytes((extra,)))
    return int(crc.crc)


def unpack(message_id: int, payload: bytes) -> Message:
    """The message of a payload whose checksum was right; what is missing at its end is 0, what is too much is left.

    Raises KeyError for an unknown message.
    """
    kind = KINDS[message_id]
    size = kind.unpacker.size
    values = kind.unpacker.unpack(payload[:size].ljust(size, b"\0"))
    fields = [values[start] if stop == start + 1 else list(values[start:stop]) for start, stop in _places(message_id)]
    return kind(*(v.rstrip(b"\0") if isinstance(v, bytes) else v for v in fields))


@cache
def _places(message_id: int) -> list[tuple[int, int]]:
    """Where among the unpacked values each field stands, in the order of the fields."""
    kind = KINDS[message_id]
    starts = [sum(kind.lengths[:order]) for order in range(len(kind.lengths))]
    return [(starts[order], starts[order] + kind.lengths[order]) for order in kind.orders]
