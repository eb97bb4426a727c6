"""The MAVLink messages, generated at build time from ``hexjet.xml`` with pymavlink; their classes pack, sign and read.

The dialects that pymavlink bundles lack seven of them, ESC_STATUS and FUEL_STATUS among these, so one more is made.
"""

from __future__ import annotations

import importlib
from typing import Any

from cosim.base.errors import InputError

try:
    mav: Any = importlib.import_module("cosim.groundstation.mavlink.wire._messages")
except ImportError as error:
    raise InputError("the MAVLink messages have not been made: install the project again (pip install -e .)") from error

mav.MAVLINK_IGNORE_CRC = False  # overrides the variable MAV_IGNORE_CRC
Message = Any  # an instance of a generated class
KINDS: dict[int, Any] = mav.mavlink_map  # generated classes by message id
BY_NAME: dict[str, Any] = {kind.msgname: kind for kind in KINDS.values()}  # generated classes by message name
COMPONENT_ID = 1  # MAV_COMP_ID_AUTOPILOT1
CHECKSUM_BYTES = 2  # at a frame's end
_PACKER = mav.MAVLink(None)  # packs messages without a link


def prepare_message(message: Message) -> Message:
    """Pack a message's payload and return it.  Raises struct.error for a value that does not fit its field."""
    message.pack(_PACKER)
    return message


def frame_size(message: Message) -> int:
    """Return the number of bytes of a packed message's frame, without a signature."""
    return int(mav.HEADER_LEN_V2) + len(message.get_payload()) + CHECKSUM_BYTES
