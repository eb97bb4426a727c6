"""Frames: what is taken, what is refused and why, signatures, and the log."""

from __future__ import annotations

import os
import random
import re
import struct
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import InputError
from cosim.groundstation.mavlink.wire.dialect import mav, prepare_message
from cosim.groundstation.mavlink.wire.frames import FramePacker, Parser
from cosim.groundstation.mavlink.wire.signing import EPOCH_S, Signing, read_key
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog

KEY = bytes(range(32))
NOW = EPOCH_S + 3e8


def station(**more: Any) -> Any:
    return mav.MAVLink(None, srcSystem=255, srcComponent=190, **more)


def heartbeat() -> Any:
    return mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def raw(message: Any = None, seq: int = 0, old: bool = False) -> bytes:
    other = station()
    other.seq = seq
    return bytes((message or heartbeat()).pack(other, force_mavlink1=old))


def parser(**more: Any) -> tuple[Parser, Counter[str]]:
    refused: Counter[str] = Counter()
    return Parser(refused, **more), refused


@pytest.mark.parametrize("old", [False, True])
def test_a_frame_of_either_version_is_accepted(old: bool) -> None:
    reader, refused = parser()
    (frame,) = reader.feed(raw(seq=17, old=old))
    assert (frame.system, frame.component, frame.sequence, frame.signed) == (255, 190, 17, False)
    assert frame.message.type == 6
    assert not refused


def test_a_stream_may_break_anywhere() -> None:
    data = b"".join(raw(seq=i, old=i % 3 == 0) for i in range(50))
    chance = random.Random(1)
    reader, refused = parser()
    found, at = [], 0
    while at < len(data):
        size = chance.randint(1, 30)
        found += reader.feed(data[at : at + size])
        at += size
    assert [frame.sequence for frame in found] == list(range(50))
    assert not refused


def test_noise_is_skipped_and_counted() -> None:
    reader, refused = parser()
    assert len(reader.feed(b"hello" + raw() + b"\x00\x01" + raw())) == 2
    assert refused == {"noise": 2}


def test_a_broken_frame_costs_no_other() -> None:
    """A wrong check sum may have a wrong length: the next frame is looked for inside it."""
    broken = bytearray(raw())
    broken[1] = 60  # claims to be longer: swallows the next two
    reader, refused = parser()
    assert len(reader.feed(bytes(broken) + raw() * 3)) == 3
    assert refused["crc"] >= 1


def test_a_datagram_ends_with_a_frame() -> None:
    reader, refused = parser(is_datagram=True)
    assert not reader.feed(raw()[:-3])
    assert refused["truncated"] == 1
    assert len(reader.feed(raw())) == 1


def test_what_is_not_known_is_refused() -> None:
    reader, refused = parser()
    unknown = bytearray(raw())
    unknown[7:10] = (60000).to_bytes(3, "little")
    assert not reader.feed(bytes(unknown))
    flagged = bytearray(raw())
    flagged[2] = 0x02
    assert not reader.feed(bytes(flagged) + raw()[:0])
    assert refused["unknown"] == 1
    assert refused["flags"] == 1


def test_pymavlink_reads_what_is_sent() -> None:
    sender, other = FramePacker(1), station()
    for i in range(300):
        message = other.parse_char(sender.pack_frame(prepare_message(heartbeat())))
        assert message.get_seq() == i % 256
        assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)


def signed(key: bytes = KEY, at: float = NOW, link: int = 3, message: Any = None) -> bytes:
    other = station()
    other.signing.secret_key = key
    other.signing.sign_outgoing = True
    other.signing.link_id = link
    other.signing.timestamp = int((at - EPOCH_S) * 1e5)
    return bytes((message or heartbeat()).pack(other))


def guarded(now: float = NOW) -> tuple[Parser, Counter[str], Signing]:
    refused: Counter[str] = Counter()
    signing = Signing(KEY, clock=lambda: now)
    return Parser(refused, signing), refused, signing


def test_a_right_signature_of_pymavlink_is_believed_once() -> None:
    reader, refused, _ = guarded()
    (frame,) = reader.feed(signed())
    assert frame.signed
    assert not reader.feed(signed())
    assert refused == {"replay": 1}
    assert len(reader.feed(signed(at=NOW + 1e-4))) == 1


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (signed(key=b"x" * 32), "signature"),
        (raw(), "unsigned"),
        (raw(old=True), "unsigned"),
        (signed(at=NOW - 61.0), "replay"),
    ],
)
def test_unsigned_forged_and_old_frames_are_refused(frame: bytes, reason: str) -> None:
    reader, refused, _ = guarded()
    assert not reader.feed(frame)
    assert refused == {reason: 1}


def test_a_stream_may_be_a_minute_behind() -> None:
    reader, _, _ = guarded()
    assert len(reader.feed(signed(at=NOW - 59.0))) == 1


def test_each_link_and_component_has_its_own_time() -> None:
    reader, _, _ = guarded()
    assert len(reader.feed(signed(link=1) + signed(link=2))) == 2


def test_a_forged_time_stamp_moves_nothing() -> None:
    """Without the key nobody can make the vehicle refuse those who have it."""
    reader, refused, _ = guarded()
    forged = bytearray(signed(at=NOW + 1e6))
    forged[-1] ^= 1
    assert not reader.feed(bytes(forged))
    assert refused == {"signature": 1}
    assert len(reader.feed(signed())) == 1


def test_pymavlink_believes_our_signature() -> None:
    signing = Signing(KEY, clock=lambda: NOW)
    sender = FramePacker(1, link=5, signing=signing)
    other = station()
    other.signing.secret_key = KEY
    stamps = []
    for _ in range(5):
        message = other.parse_char(sender.pack_frame(prepare_message(heartbeat())))
        assert message.get_signed()
        assert message.get_link_id() == 5
        stamps.append(int.from_bytes(message.get_msgbuf()[-12:-6], "little"))
    assert stamps == sorted(set(stamps))  # although the clock stood still
    wrong = station()
    wrong.robust_parsing = True
    wrong.signing.secret_key = b"y" * 32
    assert wrong.parse_char(sender.pack_frame(prepare_message(heartbeat()))).get_type() == "BAD_DATA"


def test_the_vehicle_signs_later_than_what_it_has_accepted() -> None:
    reader, _, signing = guarded()
    reader.feed(signed(at=NOW + 1000.0))
    frame = FramePacker(1, signing=signing).pack_frame(prepare_message(heartbeat()))
    assert int.from_bytes(frame[-12:-6], "little") > int((NOW + 1000.0 - EPOCH_S) * 1e5)


def test_a_key_is_a_pass_phrase_or_digits(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("correct horse\n")
    # echo -n "correct horse" | sha256sum
    assert read_key(file).hex() == "4104d36f8da2c254349f85836793ebe029e0c957063a34c91c2e9203187b5631"
    file.write_text("hex:" + KEY.hex())
    assert read_key(file) == KEY


@pytest.mark.parametrize("text", ["", "short", "hex:12", "hex:" + "zz" * 32, "two\nlines of text"])
def test_a_wrong_key_is_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "key"
    file.write_text(text)
    with pytest.raises(InputError, match=re.escape(str(file))):
        read_key(file)


def test_a_missing_key_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none: No such file or directory"):
        read_key(tmp_path / "none")


def test_the_log_is_read_by_pymavlink(tmp_path: Path) -> None:
    from pymavlink import mavutil

    path = tmp_path / "telemetry.tlog"
    now = [1.7e9]
    log = TelemetryLog(path, clock=lambda: now[0])
    for i in range(5):
        log.write_sent(prepare_message(mav.MAVLink_attitude_message(i * 20, 0.1 * i, 0.0, 0.0, 0.0, 0.0, 0.0)))
        now[0] += 0.02
    log.write_received(raw(seq=9))
    log.close()
    log.write_received(raw())  # after the end: nothing
    read = mavutil.mavlink_connection(str(path), dialect="common", robust_parsing=True)
    found = []
    while (message := read.recv_msg()) is not None:
        found.append((message.get_type(), round(message._timestamp, 3)))
    read.close()
    assert found == [("ATTITUDE", round(1.7e9 + 0.02 * i, 3)) for i in range(5)] + [("HEARTBEAT", 1700000000.1)]
    # and byte for byte: the time, then the frame
    assert struct.unpack(">Q", path.read_bytes()[:8]) == (1_700_000_000_000_000,)
    assert path.read_bytes()[8] == 0xFD


def test_a_log_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="telemetry log"):
        TelemetryLog(tmp_path / "no" / "telemetry.tlog")


def test_the_environment_lets_no_damaged_frame_in() -> None:
    """pymavlink looks at MAV_IGNORE_CRC when its module is imported."""
    script = (
        "from collections import Counter; from cosim.groundstation.mavlink.wire.frames import Parser, mav;"
        "raw = bytearray(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav.MAVLink(None))); raw[-1] ^= 1;"
        "assert not Parser(Counter()).feed(bytes(raw))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env=os.environ | {"MAV_IGNORE_CRC": "1"})
