"""Hostile input: whatever comes in, nothing changes that should not, no exception escapes, and refusals are counted.

20,000 frames by default; ``HEXJET_FUZZ=1000000`` says how many.
"""

from __future__ import annotations

import os
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import inf, isfinite, nan
from typing import Any

import pytest
from mavlink_tools import ABOUT, Bench, Desk, command, message_of

from cosim.control.autopilot.requests import from_dict, to_dict
from cosim.groundstation.mavlink.services.commands import _HANDLERS as HANDLERS
from cosim.groundstation.mavlink.wire.dialect import BY_NAME, KINDS, mav
from cosim.groundstation.mavlink.wire.signing import EPOCH_S, Signing

FRAMES = int(os.environ.get("HEXJET_FUZZ", "20000"))
SHARE = max(1, FRAMES // 5)  # of each kind of hostility
KEY = b"k" * 32

# Everything that asks something of the vehicle.
ACTING = [
    "COMMAND_LONG", "COMMAND_INT", "SET_MODE", "MANUAL_CONTROL", "SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT", "PING", "TIMESYNC", "SET_GPS_GLOBAL_ORIGIN", "REQUEST_DATA_STREAM", "HEARTBEAT",
    "PARAM_SET", "MISSION_ITEM_INT", "FILE_TRANSFER_PROTOCOL",
]  # fmt: skip


class Rig:
    """A bench without telemetry, so that whatever goes out is an answer."""

    def __init__(self, signing: Signing | None = None, **about: Any) -> None:
        self.bench = Bench(replace(ABOUT, **about), signing=signing)
        self.desk: Desk = self.bench.station()
        self.bench.step()
        self.desk.peer.intervals = dict.fromkeys(self.desk.peer.intervals | _all(), 0.0)
        self.before = dict(self.desk.peer.intervals)
        self.desk.got.clear()
        self.sent = 0

    def send(self, raw: bytes) -> None:
        self.sent += 1
        self.bench.time += 0.002  # below what counts as a flood
        self.desk.bytes(raw)

    @property
    def refused(self) -> int:
        return sum(self.bench.link.refused.values())

    def check_untouched(self) -> None:
        bench = self.bench
        bench.step()
        assert bench.pilot.asked == []
        assert self.desk.got == []
        assert self.desk.peer.intervals == self.before
        assert bench.vehicle.stations == {}
        assert bench.vehicle.acknowledged == 0
        assert not bench.link.failures
        assert bench.link.refused["flood"] == 0


def _all() -> dict[int, float]:
    return dict.fromkeys(KINDS, 0.0)


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.bench.close()


def asking(chance: random.Random) -> Any:
    """A message that would be obeyed."""
    number = chance.choice([400, 22, 20, 511, 420, 185, 176])
    p = {400: (1.0, 21196.0), 511: (30.0, 5000.0), 420: (101.0, 1.0, 1.0), 185: (1.0,), 176: (209.0, 4.0, 5.0)}
    return command(number, *p.get(number, ()))


def packed(message: Any, chance: random.Random, system: int = 255) -> bytearray:
    other = mav.MAVLink(None, srcSystem=system, srcComponent=190)
    other.seq = chance.randrange(256)
    return bytearray(message.pack(other))


def anything(chance: random.Random) -> bytes:
    start = chance.choice([b"", b"\xfd", b"\xfe", b"\xfd\x21\x00\x00", b"\xfd\x21\x01\x00"])
    return start + chance.randbytes(chance.randrange(1, 300))


def truncated(chance: random.Random) -> bytes:
    raw = packed(asking(chance), chance)
    return bytes(raw[: chance.randrange(1, len(raw))])


def mutated(chance: random.Random) -> bytes:
    """Up to three wrong bits, which the check sum always finds; of more, or a wrong length, all but 1 in 65,536."""
    raw = packed(asking(chance), chance)
    for bit in chance.sample(range(8, 8 * len(raw)), chance.randint(1, 3)):
        raw[bit // 8] ^= 1 << bit % 8
    return bytes(raw)


@pytest.mark.parametrize("made", [anything, truncated, mutated])
def test_what_is_no_frame_is_refused_and_changes_nothing(rig: Rig, made: Callable[[random.Random], bytes]) -> None:
    chance = random.Random(1)
    for _ in range(SHARE):
        rig.send(made(chance))
    assert rig.refused >= SHARE
    rig.check_untouched()


def test_frames_for_others_and_from_itself(rig: Rig) -> None:
    chance = random.Random(4)
    names = [name for name in ACTING if any(f in ("target_system", "target") for f in BY_NAME[name].fieldnames)]
    taken = 0
    for i in range(SHARE):
        kind = BY_NAME[chance.choice(names)]
        message = message_of(kind, chance.randbytes(kind.unpacker.size))
        field = "target" if kind.msgname == "MANUAL_CONTROL" else "target_system"
        own = i % 4 == 0
        setattr(message, field, 1 if own else chance.randrange(2, 256))
        raw = packed(message, chance, system=1 if own else 255)
        if own:
            raw[6] = 1  # its own component too
            body = bytes(raw[1:-2]) + bytes((kind.crc_extra,))
            raw[-2:] = mav.x25crc(body).crc.to_bytes(2, "little")
        rig.send(bytes(raw))
        taken += 1
    refused = rig.bench.link.refused
    assert refused["other vehicle"] + refused["own"] == taken
    rig.check_untouched()


def test_signatures_that_are_wrong() -> None:
    """Unsigned, of another key, changed after signing, or recorded: all refused, and the owner is heard all the same."""
    now = EPOCH_S + 3e8
    rig = Rig(Signing(KEY, clock=lambda: now))
    chance = random.Random(5)
    friend = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    friend.signing.secret_key, friend.signing.sign_outgoing = KEY, True
    friend.signing.timestamp = int((now - EPOCH_S) * 1e5)
    foe = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    foe.signing.secret_key, foe.signing.sign_outgoing = b"x" * 32, True
    foe.signing.timestamp = 2**47
    beat = mav.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)  # of no effect here
    tape = bytes(beat.pack(friend))
    rig.desk.bytes(tape)
    assert rig.refused == 0
    for i in range(SHARE):
        if i % 4 == 0:
            rig.send(bytes(packed(asking(chance), chance)))
        elif i % 4 == 1:
            rig.send(bytes(asking(chance).pack(foe)))
        elif i % 4 == 2:
            raw = bytearray(asking(chance).pack(friend))
            raw[chance.randrange(4, len(raw))] ^= 1 << chance.randrange(8)
            rig.send(bytes(raw))
        else:
            rig.send(tape)
    rig.desk.parser = mav.MAVLink(None)
    assert rig.refused >= SHARE
    refused = rig.bench.link.refused
    assert min(refused["unsigned"], refused["signature"], refused["replay"]) >= SHARE // 4
    rig.check_untouched()
    rig.desk.bytes(bytes(asking(chance).pack(friend)))
    rig.bench.step()
    assert len(rig.bench.pilot.asked) + rig.bench.vehicle.acknowledged >= 1
    rig.bench.close()


def _strange(kind: Any, chance: random.Random) -> Any:
    """A message for this vehicle with anything in it, NaN and infinities more often than chance would have them."""
    raw = bytearray(chance.randbytes(kind.unpacker.size))
    for place in range(0, len(raw) - 3, 4):
        if chance.random() < 0.3:
            raw[place : place + 4] = struct.pack("<f", chance.choice([nan, inf, -inf, 0.0, 1.0, 3e38]))
    message = message_of(kind, bytes(raw))
    for field, value in (("target_system", 1), ("target_component", 1), ("target", 1)):
        if field in kind.fieldnames:
            setattr(message, field, value)
    if kind.msgname in ("COMMAND_LONG", "COMMAND_INT") and chance.random() < 0.8:
        message.command = chance.choice(sorted(HANDLERS))
    return message


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_right_frames_with_anything_in_them(personality: Any) -> None:
    """Every command is acknowledged once, and what reaches the pilot is a record that a replay could read."""
    rig = Rig(personality=personality)
    chance = random.Random(6)
    kinds = [BY_NAME[name] for name in ACTING] + list(KINDS.values())
    commands = 0
    for i in range(SHARE // 2):
        kind = chance.choice(kinds[: len(ACTING)] if i % 2 else kinds)
        message = _strange(kind, chance)
        commands += kind.msgname in ("COMMAND_LONG", "COMMAND_INT")
        rig.send(bytes(packed(message, chance)))
        rig.bench.vehicle.port.deliver_answers(rig.bench.time)
        for waiting in rig.bench.exchange.take_requests(100):
            waiting.answer(rig.bench.pilot.handle(waiting.request))
        rig.bench.vehicle.poll(rig.bench.time)
        rig.desk.peer.intervals.update(rig.before)
    rig.bench.step()
    assert not rig.bench.link.failures
    assert rig.bench.vehicle.acknowledged == commands == len(rig.desk.named("COMMAND_ACK"))
    assert rig.bench.pilot.asked
    for request in rig.bench.pilot.asked:
        assert from_dict(to_dict(request)) == request
        assert all(isfinite(v) for v in vars(request).values() if isinstance(v, float))
    rig.bench.close()
