"""Lines that carry little, or nothing any more: what goes first, what is left out, and that the others go on."""

from __future__ import annotations

import os
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from typing import Any

import pytest
from link_tools import Flight, Tcp, until
from mavlink_tools import Bench, Desk, Udp, command
from patience import PATIENCE
from places import ROOT
from terminal import Terminal

from benchmarks import ground_station
from cosim.control.autopilot.requests import (
    Answer,
    LinkBack,
    LinkLost,
    Result,
)
from cosim.groundstation.mavlink.wire.dialect import mav, prepare_message
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.peer import TELEMETRY_FRACTION, Priority
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.transports import channel, serial_port
from cosim.groundstation.mavlink.wire.transports.channel import MOST_PEERS
from cosim.groundstation.mavlink.wire.transports.endpoint import parse_endpoint
from cosim.groundstation.mavlink.wire.transports.serial_port import SerialDevice
from cosim.results.report.marks import parts_of

LONGEST = 280  # bytes of a frame


class Wire:
    """A serial line: a driver that takes everything, and sends it at the line's speed; ``most``: what the driver holds."""

    def __init__(self, bench: Bench, baud: int, most: float = 1e9) -> None:
        self.bench, self.rate, self.most = bench, baud / 10.0, most
        self.frames: list[tuple[float, float, bytes]] = []  # handed over, arrived, frame
        self._free = bench.time
        bench.link._channels.append(self)  # type: ignore[arg-type]
        self.peer = bench.link.new_peer("wire", self._take, is_datagram=False, line=self.rate)
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

    def slow_down(self, rate: float) -> None:
        self.rate = rate

    def arrived(self, since: float = 0.0) -> list[tuple[float, Any]]:
        """What has come out at the other end, and when."""
        parser = mav.MAVLink(None)
        return [(at, parser.parse_char(data)) for _, at, data in self.frames if since < at <= self.bench.time + 1e-9]

    def send(self, message: Any) -> None:
        sender = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.bench.link.dispatch_frames(
            self.peer.feed(message.pack(sender), self.bench.time), self.peer, self.bench.time
        )


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


def rates(wire: Wire, since: float) -> Counter[str]:
    return Counter(message.get_type() for _, message in wire.arrived(since))


# --- telemetry fits the line -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [9600, 38400, 57600, 921600])
def test_telemetry_fits_the_line_and_comes_young(bench: Bench, baud: int) -> None:
    wire = Wire(bench, baud)
    run(bench, 5.0)
    since = bench.time
    run(bench, 20.0)
    carried = sum(len(data) for at, _, data in wire.frames if at > since) / 20.0
    assert carried < TELEMETRY_FRACTION * baud / 10.0 * 1.02  # and the heartbeat, which is not stretched
    late = [arrived - at for at, arrived, _ in wire.frames if at > since]
    assert max(late) <= 0.02 + LONGEST * 10.0 / baud + 1e-9
    found = rates(wire, since)
    assert found["HEARTBEAT"] == pytest.approx(20, abs=1)
    # all but the heartbeat by the same factor; 25 Hz and 10 Hz where there is room for everything
    stretch = wire.peer.stretch
    assert found["ATTITUDE"] == pytest.approx(500 / stretch, abs=2)
    assert found["GLOBAL_POSITION_INT"] == pytest.approx(200 / stretch, abs=2)
    assert (stretch == 1.0) == (baud == 921600)
    if stretch > 1.0:  # and no more than it must
        assert carried > TELEMETRY_FRACTION * baud / 10.0 / 1.1**2


def test_a_line_that_is_asked_for_more_stretches_everything(bench: Bench) -> None:
    wire = Wire(bench, 57600)
    other = Desk(bench, 250, 1)  # not on the line: gets what it always did
    run(bench, 5.0)
    before = wire.peer.stretch
    for number in (30, 31, 32, 33):
        wire.send(command(511, float(number), 10_000.0))
    run(bench, 5.0)
    assert wire.peer.stretch > 2.0 * before
    other.got.clear()
    run(bench, 4.0)
    assert len(other.named("ATTITUDE")) == pytest.approx(100, abs=1)
    wire.send(command(510, 30.0))
    since = bench.time
    run(bench, 1.0)
    (told,) = [m.interval_us for _, m in wire.arrived(since) if m.get_type() == "MESSAGE_INTERVAL"]
    assert told == round(10_000 * wire.peer.stretch)  # what it does, not what it was asked for


def test_signed_telemetry_fits_too() -> None:
    bench = Bench(signing=Signing(b"k" * 32))
    wire = Wire(bench, 57600)
    run(bench, 10.0)
    since = bench.time
    run(bench, 20.0)
    assert sum(len(data) for at, _, data in wire.frames if at > since) / 20.0 < TELEMETRY_FRACTION * 5760.0 * 1.02
    bench.close()


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
    wire.peer.stretched_at = 1e9  # more telemetry than fits
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
    assert len(desk.named("EFI_STATUS")) == 6  # of all engines
    names = [message.get_type() for message in desk.got]
    assert names.index("COMMAND_ACK") <= 4  # after what was begun and two or three heartbeats
    assert desk.peer.waiting_bytes == 0
    sequence = [m.get_seq() for m in desk.got]
    assert [(b - a) % 256 for a, b in pairwise(sequence)] == [1] * (len(sequence) - 1)


def test_a_line_that_carries_less_than_it_says_is_slowed_down_and_comes_back(bench: Bench) -> None:
    """A radio behind a port of 57,600 baud that sends 1,500 bytes a second, and has 1 kB of buffer."""
    wire = Wire(bench, 57600, most=1000)
    run(bench, 5.0)
    full = wire.peer.stretch
    wire.slow_down(1500.0)
    run(bench, 20.0)
    assert wire.peer.stretch > 1.5 * full
    since = bench.time
    run(bench, 10.0)
    found = rates(wire, since)
    assert found["HEARTBEAT"] == pytest.approx(10, abs=2)
    assert found["ATTITUDE"] > 10  # 1 Hz at least
    wire.slow_down(5760.0)
    run(bench, 40.0)
    assert wire.peer.stretch < full * 1.11  # one step of a tenth, within which it stays as it is


def test_a_radio_that_says_that_its_buffer_is_full_is_believed(bench: Bench) -> None:
    wire = Wire(bench, 57600)
    run(bench, 5.0)
    full = wire.peer.stretch
    status = mav.MAVLink_radio_status_message(100, 100, 10, 40, 40, 0, 0)
    radio = mav.MAVLink(None, srcSystem=51, srcComponent=68)
    for _ in range(5):
        bench.link.dispatch_frames(wire.peer.feed(status.pack(radio), bench.time), wire.peer, bench.time)
        run(bench, 1.0)
    assert wire.peer.stretch > 2.0 * full
    run(bench, 30.0)
    assert wire.peer.stretch < full * 1.11  # one step of a tenth, within which it stays as it is


def test_a_radio_has_no_key_and_is_believed_on_a_line_alone() -> None:
    bench = Bench(signing=Signing(b"k" * 32))
    wire, desk = Wire(bench, 57600), bench.station()
    low = mav.MAVLink_radio_status_message(100, 100, 0, 40, 40, 0, 0).pack(mav.MAVLink(None, 51, 68))
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav.MAVLink(None, 51, 68))
    free = wire.peer.line
    assert free is not None
    for peer in (wire.peer, desk.peer):
        bench.link.dispatch_frames(peer.feed(low, bench.time), peer, bench.time)
    assert dict(bench.link.refused) == {"unsigned": 1}  # the datagram
    run(bench, 1.1)
    assert free.health == 0.75
    bench.link.dispatch_frames(wire.peer.feed(beat, bench.time), wire.peer, bench.time)
    assert bench.link.refused["unsigned"] == 2
    assert not bench.vehicle.stations
    bench.close()


def test_answers_that_nobody_takes_are_bounded(bench: Bench) -> None:
    wire = Wire(bench, 57600, most=0)
    ack = prepare_message(mav.MAVLink_command_ack_message(20, 0))
    sent = 0
    while wire.peer.send(ack):
        sent += 1
        assert sent < 10_000
    assert wire.peer.waiting_bytes < 10.0 * 5760.0 + 1000  # ten seconds of the line
    assert wire.peer.dropped == 1


# --- a port that takes nothing ---------------------------------------------------------------------------------------


def drain(station: Udp) -> None:
    """Throw away what a station has not read: a full buffer would take no answer."""
    station.socket.setblocking(False)
    with suppress(BlockingIOError):
        while station.socket.recv(65536):
            pass
    station.socket.settimeout(0.05)
    station.got.clear()


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    pytest.importorskip("serial")
    made = Terminal()
    yield made
    made.close()


def test_a_port_that_is_full_takes_nothing_and_does_not_spin(terminal: Terminal, monkeypatch: Any) -> None:
    """The system still moves what it took to the reader's side: there may be room again for a moment after a refusal."""
    port = SerialDevice(terminal.device, 57600)
    attempts: list[int] = []  # what the system took at each
    write = os.write

    def counted(number: int, data: bytes) -> int:
        attempts.append(0)
        attempts[-1] = write(number, data)
        return attempts[-1]

    monkeypatch.setattr(serial_port.os, "write", counted)
    refused = 0  # in a row

    def full() -> bool:
        nonlocal refused
        attempts.clear()
        taken = port.write(b"x" * 250)
        assert len(attempts) <= 1  # whatever comes of it
        assert sum(attempts) == taken
        refused = 0 if taken else refused + 1
        return refused == 10

    assert until(full, 60.0)
    port.close()


def test_a_port_that_stops_draining_is_dropped_and_taken_up_again(terminal: Terminal, monkeypatch: Any) -> None:
    """Beside UDP and TCP, which are answered all the time."""
    for module in (channel, serial_port):
        monkeypatch.setattr(module, "STALL", 0.5)
    flight = Flight(terminal.url, "udpin:127.0.0.1:0", "tcpin:127.0.0.1:0")
    serial, udp, tcp = flight.link._channels[0], Udp(flight.link.ports[1]), Tcp(flight.link.ports[2])
    others = (udp, tcp)
    try:
        udp.heartbeat()
        for number in (30, 31, 32, 33, 331, 291):
            os.write(terminal.file, command(511, float(number), 4000.0).pack(mav.MAVLink(None, 255, 190)))
        # nobody reads it: the first peer goes, and so do those that are tried after it
        first, asked = serial.peers[0], flight.steps * 4
        assert until(lambda: [drain(other) for other in others] and first not in serial.peers, 60.0)
        assert flight.link.refused["stuck"] >= 1
        for station in others:
            drain(station)
            station.send(command(512, 148.0))
            assert station.name("COMMAND_ACK", 30.0)
            assert station.name("AUTOPILOT_VERSION", 30.0)
        assert flight.link.events[0].endswith("is dropped: it has taken nothing for 0.5 s")
        # read again: what comes is new
        parser = mav.MAVLink(None)
        parser.robust_parsing = True
        found: list[Any] = []

        def alive() -> bool:
            found.extend(m for m in parser.parse_buffer(terminal.read()) or [] if m.get_type() == "ATTITUDE")
            return any("carries again" in line for line in flight.link.events)

        assert until(alive, 60.0)
        assert until(lambda: alive() and len(found) > 3, 30.0)
        # what the other end had in its own input queue comes first; then what is from after the drop
        assert found[-1].time_boot_ms > asked + 500
        assert [line for line in flight.link.events if "dropped" in line] == [flight.link.events[0]]  # said once
    finally:
        flight.close()
        for station in others:
            station.close()
    assert not flight.link.failures


def test_a_connection_that_takes_nothing_is_dropped_and_told_of(monkeypatch: Any) -> None:
    monkeypatch.setattr(channel, "STALL", 0.5)
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


def test_a_port_that_goes_away_is_taken_up_again(monkeypatch: Any, tmp_path: Any) -> None:
    """As a plug that is pulled: the device is another one when it comes back."""
    pytest.importorskip("serial")
    one, two = Terminal(), Terminal()
    name = tmp_path / "radio"
    name.symlink_to(one.device)
    flight = Flight(f"serial:{name}:57600", "udpin:127.0.0.1:0")
    try:
        assert until(lambda: bool(one.read()))
        name.unlink()
        one.close()
        assert until(lambda: bool(flight.link.events))  # said in the link's thread, after the peer is gone
        assert "is dropped" in flight.link.events[0]
        assert not flight.link._channels[0].peers
        name.symlink_to(two.device)
        assert until(lambda: bool(two.read()), 10.0)
        assert len(flight.link._channels[0].peers) == 1
    finally:
        flight.close()
        two.close()
    assert not flight.link.failures


def test_a_link_that_fails_does_not_stop_the_others(bench: Bench) -> None:
    class Broken:
        peers: tuple[Any, ...] = ()

        def poll(self, now: float) -> None:
            raise RuntimeError("broken")

        def close(self) -> None:
            pass

    bench.link._channels.append(Broken())  # type: ignore[arg-type]
    desk = bench.station()
    run(bench, 2.0)
    assert len(desk.named("ATTITUDE")) == pytest.approx(50, abs=1)
    assert bench.link.failures["RuntimeError: broken"] > 100
    assert list(bench.link.events) == ["RuntimeError: broken: 1"]  # said, and not each time
    bench.link.failures.clear()


# --- who is there ----------------------------------------------------------------------------------------------------


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


def test_the_last_station_is_missed_when_a_table_was_full(bench: Bench) -> None:
    bench.pilot.answers[LinkLost] = Answer(True, Result.ACCEPTED, "")
    desk = bench.station()
    beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for number in range(100):
        desk.bytes(beat.pack(mav.MAVLink(None, srcSystem=2 + number, srcComponent=1)))
    bench.step(3.4)
    assert not bench.pilot.asked
    bench.step(0.2)
    assert [type(r) for r in bench.pilot.asked] == [LinkLost]


def test_idle_connections_make_room_for_a_new_one(monkeypatch: Any) -> None:
    monkeypatch.setattr(channel, "UNHEARD", 1e9)
    flight = Flight("tcpin:127.0.0.1:0")
    port = flight.port
    idle: list[socket.socket] = []
    try:
        speaking = Tcp(port)
        speaking.heartbeat()
        assert speaking.name("HEARTBEAT")
        idle += [socket.create_connection(("127.0.0.1", port)) for _ in range(MOST_PEERS - 1)]
        assert until(lambda: len(flight.link.peers) == MOST_PEERS)
        # as if all had just come: nobody makes room, and the new one sees its connection closed
        with socket.create_connection(("127.0.0.1", port)) as refused:
            refused.settimeout(PATIENCE)
            assert refused.recv(1) == b""
        assert flight.link.refused["too many stations"] == 1
        monkeypatch.setattr(channel, "UNHEARD", 0.05)
        time.sleep(0.1)
        late = Tcp(port)
        late.heartbeat()
        assert late.name("HEARTBEAT")
        assert len(flight.link.peers) == MOST_PEERS
        speaking.got.clear()
        assert speaking.name("HEARTBEAT")  # who speaks stays
        late.close()
        speaking.close()
    finally:
        for each in idle:
            each.close()
        flight.close()


# --- what is refused is said -----------------------------------------------------------------------------------------


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


def test_a_port_opens_and_closes_twice() -> None:
    pytest.importorskip("serial")
    made = Terminal()
    for _ in range(2):
        link = Link([parse_endpoint(made.url)])
        link.close()
        link.close()
    made.close()


def test_docs_ground_station_md_states_what_a_line_carries() -> None:
    """A row of the table in docs/ground-station.md, made again: the clock is counted, so it is the same everywhere."""
    root = ROOT
    page = parts_of((root / "docs" / "ground-station.md").read_text(encoding="utf-8"), "docs/ground-station.md")
    (row,) = [line for line in page["lines"].splitlines() if line.startswith("| 57600 |")]
    told = [float(cell) for cell in row.strip("| ").split(" | ")]
    rates, carried, late = ground_station.line(57600)
    assert told[1] == 5760
    assert told[2] == pytest.approx(carried, abs=0.5)
    # two digits are written
    assert told[3:8] == pytest.approx([rates[name] for name in ground_station.COUNTED], rel=0.05)
    assert told[8] == pytest.approx(max(late), abs=0.006)
    assert max(late) < 0.2
