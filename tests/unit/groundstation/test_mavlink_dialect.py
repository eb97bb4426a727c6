"""The messages: made at build time, the added ones byte for byte those of the MAVLink project."""

from __future__ import annotations

import importlib.util
import random
import struct
import subprocess
import sys
from collections import Counter
from math import nan
from pathlib import Path
from typing import Any

import pytest
from mavlink_tools import ABOUT, message_of, sample, snapshot, status

from cosim.groundstation.mavlink.streams import STREAMS
from cosim.groundstation.mavlink.telemetry_state import FlightEvents, TelemetryState
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, KINDS, mav, prepare_message
from cosim.groundstation.mavlink.wire.frames import FramePacker, Parser
from cosim.groundstation.mavlink.wire.generate import generate

# id, CRC_EXTRA, length: from the C headers that the MAVLink project publishes (mavlink/c_library_v2, common/).
PUBLISHED = {
    "ESC_INFO": (290, 251, 46),
    "ESC_STATUS": (291, 10, 57),
    "PROTOCOL_VERSION": (300, 217, 22),
    "FUEL_STATUS": (371, 10, 26),
    "COMPONENT_INFORMATION": (395, 0, 212),
    "COMPONENT_INFORMATION_BASIC": (396, 50, 160),
    "COMPONENT_METADATA": (397, 182, 108),
    # of those that pymavlink bundles, the newest that ground stations read
    "AVAILABLE_MODES": (435, 134, 46),
    "CURRENT_MODE": (436, 193, 9),
    "HEARTBEAT": (0, 50, 9),
    "COMMAND_LONG": (76, 152, 33),
}


@pytest.mark.parametrize(("name", "published"), PUBLISHED.items())
def test_a_message_is_the_published_one(name: str, published: tuple[int, int, int]) -> None:
    kind = BY_NAME[name]
    assert (kind.id, kind.crc_extra, kind.unpacker.size) == published


def test_the_build_makes_the_module_that_is_in_use(tmp_path: Path) -> None:
    made = generate(tmp_path)
    spec = importlib.util.spec_from_file_location("made_again", made)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    again = {number: (kind.msgname, kind.crc_extra) for number, kind in module.mavlink_map.items()}
    assert again == {number: (kind.msgname, kind.crc_extra) for number, kind in KINDS.items()}
    assert len(again) > 200


def test_the_generator_needs_nothing_of_the_package() -> None:
    """The build loads it where ``import cosim`` does not work."""
    path = Path(sys.modules[generate.__module__].__file__ or "")
    script = f"import runpy, sys; sys.modules['cosim'] = None; runpy.run_path({str(path)!r}, run_name='made')"
    subprocess.run([sys.executable, "-c", script], check=True)


def _random(kind: Any, chance: random.Random) -> Any:
    """A message with every field anything that it can be."""
    return message_of(kind, chance.randbytes(kind.unpacker.size))


@pytest.mark.parametrize("number", sorted(KINDS))
def test_every_message_is_read_as_pymavlink_reads_it(number: int) -> None:
    chance = random.Random(number)
    theirs = mav.MAVLink(None, srcSystem=7, srcComponent=8)
    for _ in range(5):
        message = _random(KINDS[number], chance)
        raw = message.pack(theirs)
        found = theirs.decode(bytearray(raw))
        ((_, *_, ours),) = Parser(Counter(), is_datagram=True).feed(raw)
        for field in KINDS[number].fieldnames:
            a, b = getattr(found, field), getattr(ours, field)
            assert repr(a) == repr(b), field


@pytest.mark.parametrize("number", sorted(KINDS))
def test_every_message_is_sent_as_pymavlink_sends_it(number: int) -> None:
    theirs = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    ours = FramePacker(1)
    chance = random.Random(number)
    for _ in range(3):
        message = _random(KINDS[number], chance)
        raw = message.pack(theirs)
        theirs.seq = (theirs.seq + 1) & 0xFF
        assert ours.pack_frame(prepare_message(message)) == raw


def test_zeros_at_the_end_are_not_sent_and_come_back() -> None:
    message = mav.MAVLink_statustext_message(6, b"a")
    packed = prepare_message(message)
    assert packed.get_payload() == b"\x06a"
    assert message_of(type(packed), packed.get_payload()).text == "a"


def test_every_stream_is_a_message_and_survives_what_cannot_be() -> None:
    """Numbers beyond any field are brought into it or refused by the packing, never wrapped around."""
    wild = sample()
    far = (9e9, -9e9, 9e9)
    measured = wild.measured._replace(position=far, velocity=far)
    state = wild.state._replace(position=far, velocity=far, specific_force=far)
    engines = wild.engines._replace(spool_speed=(float("inf"),) * 6, fuel_flow=(float("nan"),) * 6)
    nothing = ((nan,) * 3,) * 3
    wild = wild._replace(measured=measured, state=state, engines=engines)
    view = TelemetryState(ABOUT, snapshot(wild, status(), nothing, 7.0), FlightEvents())
    for stream in STREAMS:
        for message in stream.make_messages(view):
            assert message.msgname == stream.name
            assert prepare_message(message).msgname == stream.name


def test_a_value_that_does_not_fit_is_an_error_of_packing() -> None:
    with pytest.raises(struct.error):
        prepare_message(mav.MAVLink_heartbeat_message(256, 0, 0, 0, 0, 3))
