"""Lines that carry little, or nothing any more: what goes first, what is left out, and that the others go on."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from typing import Any

import pytest
from link_tools import Flight, Tcp, until
from mavlink_tools import Bench, Udp, command
from patience import PATIENCE

from cosim.control.autopilot.requests import LinkBack, LinkLost
from cosim.groundstation.mavlink.wire.dialect import mav, prepare_message
from cosim.groundstation.mavlink.wire.peer import LIMITS as PEER
from cosim.groundstation.mavlink.wire.peer import Priority
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.transports import channel
from cosim.groundstation.mavlink.wire.transports.channel import LIMITS

LONGEST = 280  # bytes of a frame


class Wire:
    """A slow connection: a driver that holds ``most`` bytes, and sends them at the line's speed."""

    def __init__(self, bench: Bench, baud: int, most: float = 2.0 * LONGEST) -> None:
        self.bench, self.rate, self.most = bench, baud / 10.0, most
        self.frames: list[tuple[float, float, bytes]] = []  # handed over, arrived, frame
        self._free = bench.time
        bench.link._channels.append(self)
        self.peer = bench.link.new_peer("wire", self._take, is_datagram=False)
        self.peers = [self.peer]

    def _take(self, data: bytes) -> int:
        now = self.bench.time
        if (self._free - now) * self.rate + len(data) > self.most:
            return 0
        self._free = max(now, self._free) + len(data) / self.rate
        self.frames.append((now, self._free, data))
        return len(data)

    def poll(self, now: float) -> None:
        self.peer.flush()

    def close(self) -> None:
        pass

    def arrived(self, since: float = 0.0) -> list[tuple[float, Any]]:
        """What has come out at the other end, and when."""
        parser = mav.MAVLink(None)
        return [(at, parser.parse_char(data)) for _, at, data in self.frames if since < at <= self.bench.time + 1e-9]

    def send(self, message: Any) -> None:
        sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        frames = self.peer.feed(message.pack(sender), self.bench.time)
        self.bench.link.dispatch_frames(frames, self.peer, self.bench.time)


def run(bench: Bench, seconds: float, each: Callable[[], None] = lambda: None) -> None:
    """The link's loop, every 10 ms."""
    for _ in range(round(seconds / 0.01)):
        bench.link.poll(bench.time)
        each()
        bench.step(0.0)
        bench.time += 0.01
        bench.k = round(bench.time / 0.004)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    assert not made.link.failures
    made.close()


def test_an_acknowledgement_goes_before_telemetry_and_lists(bench: Bench) -> None:
    """Whatever else is asked for: its delay is that of what the driver has already, and one frame."""
    wire = Wire(bench, 57600)
    for number in (30, 31, 32, 33, 291, 251, 24, 74, 331):
        wire.send(command(511, float(number), 4000.0))
    run(bench, 3.0)
    text = prepare_message(mav.MAVLink_log_data_message(0, 0, 90, [1] * 90))
    asked: list[float] = []

    def busy() -> None:
        while not wire.peer.is_behind:
            wire.peer.send(text, Priority.BULK)
        if len(asked) < 40 and (not asked or bench.time - asked[-1] >= 0.11):
            asked.append(bench.time)
            wire.send(command(512, 148.0))

    since = bench.time
    run(bench, 5.0, busy)
    acks = [at for at, m in wire.arrived(since) if m.get_type() == "COMMAND_ACK"]
    assert len(acks) == 40
    # behind what the driver holds and one frame that was begun; 10 ms of the loop; and the answer itself behind
    # AUTOPILOT_VERSION of the command before at the most
    assert max(a - b for a, b in zip(acks, asked, strict=True)) < 0.02 + 3 * LONGEST / 5760.0 + 0.01


def test_lists_and_telemetry_take_turns(bench: Bench) -> None:
    wire = Wire(bench, 57600)
    for number in (30, 31, 32, 33, 331):
        wire.send(command(511, float(number), 4000.0))
    data = prepare_message(mav.MAVLink_log_data_message(0, 0, 90, [1] * 90))

    def busy() -> None:
        while not wire.peer.is_behind:
            wire.peer.send(data, Priority.BULK)

    since = bench.time
    run(bench, 20.0, busy)
    sizes: Counter[bool] = Counter()
    for at, _, frame in wire.frames:
        if at > since:
            sizes[frame[7] == data.get_msgId()] += len(frame)
    assert sizes[True] == pytest.approx(sizes[False], rel=0.05)
    assert sizes.total() == pytest.approx(20.0 * 5760.0, rel=0.02)  # and the line is full


def test_of_telemetry_that_waits_the_newest_goes(bench: Bench) -> None:
    desk = bench.station()
    desk.full = True
    bench.step(2.0)
    desk.send(command(20))
    bench.step()
    desk.full = False
    desk.got.clear()
    desk.peer.flush()
    assert len(desk.named("ATTITUDE")) <= 2  # one that was begun, and the newest
    newest = desk.named("ATTITUDE")[-1].time_boot_ms
    assert newest == pytest.approx(bench.k * 4, abs=41)
    assert len(desk.named("NAMED_VALUE_FLOAT")) == 5  # of every name
    names = [message.get_type() for message in desk.got]
    assert names.index("COMMAND_ACK") <= 4  # after what was begun and two or three heartbeats
    assert desk.peer.waiting_bytes == 0
    sequence = [m.get_seq() for m in desk.got]
    assert [(b - a) % 256 for a, b in pairwise(sequence)] == [1] * (len(sequence) - 1)


def test_answers_that_nobody_takes_are_bounded(bench: Bench) -> None:
    wire = Wire(bench, 57600, most=0)
    ack = prepare_message(mav.MAVLink_command_ack_message(20, 0))
    sent = 0
    while wire.peer.send(ack):
        sent += 1
        assert sent < 100_000
    assert wire.peer.waiting_bytes <= PEER.max_bytes + 1000
    assert wire.peer.dropped == 1


def drain(station: Udp) -> None:
    """Throw away what a station has not read: a full buffer would take no answer."""
    station.socket.setblocking(False)
    with suppress(BlockingIOError):
        while station.socket.recv(65536):
            pass
    station.socket.settimeout(0.05)
    station.got.clear()


def test_a_connection_that_takes_nothing_is_dropped_and_told_of(monkeypatch: Any) -> None:
    monkeypatch.setattr(channel, "LIMITS", LIMITS._replace(stall_s=0.5))
    flight = Flight("tcpin:127.0.0.1:0", "udpin:127.0.0.1:0")
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    reader = Udp(flight.link.ports[1])
    try:
        deaf.connect(("127.0.0.1", flight.link.ports[0]))
        reader.heartbeat()
        for number in (30, 31, 32, 33, 291, 251, 24, 74, 115, 331):
            deaf.sendall(command(511, float(number), 4000.0).pack(mav.MAVLink(None, 9, 9)))
        assert until(lambda: bool(flight.link.events), 60.0)
        assert flight.link.events[0].endswith("is dropped: it has taken nothing for 0.5 s")
        assert flight.link.events[0].startswith("tcpin:127.0.0.1:")
        drain(reader)
        reader.send(command(512, 148.0))
        assert reader.name("AUTOPILOT_VERSION", 30.0)
        assert len(flight.link.peers) == 1
    finally:
        flight.close()
        deaf.close()
        reader.close()


def test_a_link_that_fails_does_not_stop_the_others(bench: Bench) -> None:
    class Broken:
        peers: tuple[Any, ...] = ()

        def poll(self, now: float) -> None:
            raise RuntimeError("broken")

        def close(self) -> None:
            pass

    bench.link._channels.append(Broken())
    desk = bench.station()
    run(bench, 2.0)
    assert len(desk.named("ATTITUDE")) == pytest.approx(50, abs=1)
    assert bench.link.failures["RuntimeError: broken"] > 100
    assert list(bench.link.events) == ["RuntimeError: broken: 1"]  # said, and not each time
    bench.link.failures.clear()


def test_ten_thousand_ids_do_not_make_the_vehicle_return(bench: Bench) -> None:
    """A station that comes after them is alive, and keeps the vehicle from returning when it is the last one."""
    pilot, flood, late = bench.station(), bench.station(), bench.station(99, 190)
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    pilot.send(beat)
    for number in range(10_000):
        raw = beat.pack(mav.MAVLink(None, srcSystem=2 + number % 240, srcComponent=1 + number // 240))
        flood.bytes(raw)
        if number % 900 == 0:
            pilot.send(beat)
        if number % 10 == 0:
            bench.step(0.01, every=0.01)
    assert len(bench.vehicle.stations) == 64
    for _ in range(20):
        late.send(beat)
        bench.step(1.0)
    assert not [request for request in bench.pilot.asked if isinstance(request, LinkLost)]
    bench.step(4.0)
    assert [type(r) for r in bench.pilot.asked if isinstance(r, LinkLost | LinkBack)] == [LinkLost]


def test_idle_connections_make_room_for_a_new_one(monkeypatch: Any) -> None:
    monkeypatch.setattr(channel, "LIMITS", LIMITS._replace(unheard_s=1e9))
    flight = Flight("tcpin:127.0.0.1:0")
    port = flight.port
    idle: list[socket.socket] = []
    try:
        speaking = Tcp(port)
        speaking.heartbeat()
        assert speaking.name("HEARTBEAT")
        idle += [socket.create_connection(("127.0.0.1", port)) for _ in range(LIMITS.max_stations - 1)]
        assert until(lambda: len(flight.link.peers) == LIMITS.max_stations)
        # as if all had just come: nobody makes room, and the new one sees its connection closed
        with socket.create_connection(("127.0.0.1", port)) as refused:
            refused.settimeout(PATIENCE)
            assert refused.recv(1) == b""
        assert flight.link.refused["too many stations"] == 1
        monkeypatch.setattr(channel, "LIMITS", LIMITS._replace(unheard_s=0.05))
        time.sleep(0.1)
        late = Tcp(port)
        late.heartbeat()
        assert late.name("HEARTBEAT")
        assert len(flight.link.peers) == LIMITS.max_stations
        speaking.got.clear()
        assert speaking.name("HEARTBEAT")  # who speaks stays
        late.close()
        speaking.close()
    finally:
        for each in idle:
            each.close()
        flight.close()


def test_a_wrong_signature_is_said_once_in_a_while() -> None:
    bench = Bench(signing=Signing(b"k" * 32))
    told: list[str] = []
    bench.link.on_event = told.append
    desk = bench.station()
    foe = mav.MAVLink(None, srcSystem=255, srcComponent=190)
    foe.signing.secret_key = b"w" * 32
    foe.signing.sign_outgoing = True
    foe.signing.timestamp = int((time.time() - 1420070400.0) * 1e5)
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    desk.bytes(beat.pack(foe))
    bench.link.poll(bench.time)
    assert told == ["link: frames with a wrong signature refused: 1"]
    for _ in range(9):
        bench.time += 1.0
        desk.bytes(beat.pack(foe))
        desk.bytes(beat.pack(mav.MAVLink(None, 255, 190)))
        bench.link.poll(bench.time)
    assert told[1:] == ["link: frames without a signature refused: 1"]
    bench.time += 2.0
    bench.link.poll(bench.time)
    assert told[2:] == ["link: frames with a wrong signature refused: 9", "link: frames without a signature refused: 8"]
    bench.close()
