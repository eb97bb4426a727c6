"""Links over real sockets of this machine, with pymavlink's own code at the other end."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from link_tools import Flight, Tcp, until
from mavlink_tools import Udp, command
from patience import PATIENCE, stretched
from pymavlink import mavutil

from cosim.base.errors import InputError
from cosim.control.autopilot.requests import Arm
from cosim.groundstation.mavlink.wire.dialect import mav
from cosim.groundstation.mavlink.wire.link import Link
from cosim.groundstation.mavlink.wire.peer import LIMITS as PEER
from cosim.groundstation.mavlink.wire.signing import Signing
from cosim.groundstation.mavlink.wire.tlog import TelemetryLog
from cosim.groundstation.mavlink.wire.transports.channel import LIMITS
from cosim.groundstation.mavlink.wire.transports.endpoint import default_urls, parse_endpoint

KEY = b"k" * 32


@pytest.fixture
def flight() -> Iterator[Callable[..., Flight]]:
    """Makes flights with these links, which are closed after the test without failures."""
    made: list[Flight] = []

    def make(*urls: str, **options: Any) -> Flight:
        made.append(Flight(*urls, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()
        assert not each.link.failures


@pytest.fixture
def station() -> Iterator[Callable[..., Any]]:
    """Makes stations, which are closed after the test."""
    made: list[Any] = []

    def make(*given: Any, kind: type = Udp, **options: Any) -> Any:
        made.append(kind(*given, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.mark.parametrize(
    ("url", "parts"),
    [
        ("udpout:127.0.0.1:14550", ("udpout", "127.0.0.1", 14550)),
        ("udpin://127.0.0.1:14560", ("udpin", "127.0.0.1", 14560)),
        ("tcpin::5760", ("tcpin", "127.0.0.1", 5760)),
        ("udpin:14560", ("udpin", "127.0.0.1", 14560)),
        ("tcp:localhost:5760", ("tcp", "127.0.0.1", 5760)),
        ("udpin:0.0.0.0:14560", ("udpin", "0.0.0.0", 14560)),
    ],
)
def test_urls_are_split_into_kind_host_and_port(url: str, parts: tuple[str, str, int]) -> None:
    assert parse_endpoint(url, public=True)[:3] == parts


def test_the_urls_of_a_vehicle() -> None:
    """One port of MAVSDK's a vehicle, as far as they go."""
    assert parse_endpoint("tcp:[::1]:5760").url == "tcp:[::1]:5760"
    ports = [[parse_endpoint(url).port for url in default_urls(n)] for n in (1, 2, 10, 11, 250)]
    assert ports == [[14550, port] for port in (14540, 14541, 14549, 14549, 14549)]


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("", "must be"),
        ("14550", "must be"),
        ("http:127.0.0.1:80", "must be"),
        ("udpout:127.0.0.1", "host is missing|port"),
        ("udpout:127.0.0.1:port", "port 'port'"),
        ("udpout:127.0.0.1:70000", "port '70000'"),
        ("udpout:127.0.0.1:-1", "port '-1'"),
        ("udpout:127.0.0.1:٣", "port '٣'"),
        ("udpout::14550", "host is missing"),
        ("udpout:127.0.0.1:0", "port 0"),
        ("tcp:127.0.0.1:0", "port 0"),
        ("udpin:0.0.0.0:14550", "allow it with public"),
        ("tcpin:0.0.0.0:5760", "allow it with public"),
        ("udpin:[::]:14550", "allow it with public"),
        ("tcpin:192.0.2.1:5760", "allow it with public"),
        ("udpout:no.such.host.invalid:14550", "not known"),
        ("serial:/dev/ttyUSB0:57600", "serial links left in version 0.3.0; use socat"),
    ],
)
def test_a_wrong_url_is_one_line(url: str, why: str) -> None:
    with pytest.raises(InputError, match=why) as caught:
        parse_endpoint(url)
    assert "\n" not in str(caught.value)
    assert repr(url) in str(caught.value)


def test_a_port_that_is_taken_is_one_line() -> None:
    for kind, server in (("udpin", socket.SOCK_DGRAM), ("tcpin", socket.SOCK_STREAM)):
        with socket.socket(socket.AF_INET, server) as taken:
            taken.bind(("127.0.0.1", 0))
            if server == socket.SOCK_STREAM:
                taken.listen()
            port = taken.getsockname()[1]
            with pytest.raises(InputError, match=f"link {kind}:127.0.0.1:{port}: "):
                Link([parse_endpoint(f"{kind}:127.0.0.1:{port}")])


def test_udp_out_finds_a_station_that_only_listens(flight: Any, station: Any) -> None:
    ground = station()
    flown = flight(f"udpout:127.0.0.1:{ground.port}")
    beat = ground.name("HEARTBEAT")
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    ground.send(command(400, 1.0))
    ack = ground.name("COMMAND_ACK")
    assert (ack.command, ack.result) == (400, 0)
    assert ground.wait(lambda m: m.get_type() == "HEARTBEAT" and m.base_mode & 128)
    assert flown.pilot.asked == [Arm()]
    assert not [m for m in ground.got if m.get_type() == "BAD_DATA"]


def test_udp_out_takes_nothing_from_others(flight: Any, station: Any) -> None:
    ground, stranger = station(), station()
    flown = flight(f"udpout:127.0.0.1:{ground.port}")
    assert ground.name("HEARTBEAT")
    stranger.to = ground.to  # the vehicle's own port
    stranger.send(command(400, 1.0))
    assert until(lambda: flown.link.refused["stranger"])
    assert not flown.pilot.asked


def test_udp_in_learns_from_frames_that_are_right(flight: Any, station: Any) -> None:
    flown = flight("udpin:127.0.0.1:0")
    noisy = station(flown.port)
    for _ in range(20):
        noisy.write(b"\xfd\x09nothing of the kind" * 3)
    assert until(lambda: sum(flown.link.refused.values()) >= 20)
    assert flown.link.peers == []
    assert noisy.name("HEARTBEAT", 0.3) is None
    noisy.heartbeat()
    assert noisy.name("ATTITUDE")
    assert len(flown.link.peers) == 1


def test_several_stations_at_once(flight: Any, station: Any) -> None:
    listener = station()
    flown = flight("udpin:127.0.0.1:0", f"udpout:127.0.0.1:{listener.port}")
    ground = [station(flown.port, system=250 + i) for i in range(4)]
    for each in ground:
        each.heartbeat()
    for each in ground:
        assert each.name("HEARTBEAT")
        each.send(command(512, 148.0))
        assert each.name("COMMAND_ACK").target_system == each.mav.srcSystem
        assert each.name("AUTOPILOT_VERSION")
    assert listener.name("HEARTBEAT")
    assert len(flown.link.peers) == 5
    # each has a sequence without gaps
    for each in (listener, *ground):
        found = [m.get_seq() for m in each.got]
        assert [(b - a) % 256 for a, b in pairwise(found)] == [1] * (len(found) - 1)
    assert not [m for m in listener.got if m.get_type() == "COMMAND_ACK"]


def test_a_router_in_front(flight: Any, station: Any) -> None:
    """Two stations behind one address, as a router has them: each gets the answers to what it asked."""
    flown = flight("udpin:127.0.0.1:0")
    inside, outside = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for each in (inside, outside):
        each.bind(("127.0.0.1", 0))
        each.settimeout(0.02)
    ended = threading.Event()
    known: set[tuple[str, int]] = set()

    def outwards() -> None:
        data, address = outside.recvfrom(4096)
        known.add(address)
        inside.sendto(data, ("127.0.0.1", flown.port))

    def inwards() -> None:
        data = inside.recv(4096)
        for address in tuple(known):
            outside.sendto(data, address)

    def carry(one: Callable[[], None]) -> None:
        while not ended.is_set():
            with suppress(TimeoutError):
                one()

    ways = [threading.Thread(target=carry, args=(way,), daemon=True) for way in (outwards, inwards)]
    for way in ways:
        way.start()
    ground = [station(outside.getsockname()[1], system=system) for system in (255, 77)]
    for each in ground:
        each.heartbeat()
    for each in ground:
        assert each.name("HEARTBEAT")
        each.send(command(512, 148.0))
        assert each.wait(lambda m, to=each.mav.srcSystem: m.get_type() == "COMMAND_ACK" and m.target_system == to)
        assert each.name("AUTOPILOT_VERSION")
    assert len(flown.link.peers) == 1
    ended.set()
    for way in ways:
        way.join()
    inside.close()
    outside.close()


def test_what_is_not_flown_is_refused_by_name(flight: Any, station: Any) -> None:
    ground = station(flight("udpin:127.0.0.1:0").port)
    ground.heartbeat()
    assert ground.name("HEARTBEAT")
    ground.send(command(176, 1.0, 4.0, 8.0))
    assert ground.name("COMMAND_ACK").result == mav.MAV_RESULT_UNSUPPORTED
    assert ground.wait(lambda m: m.get_type() == "STATUSTEXT" and "follow-me, is not known here" in m.text)
    none = [0.0] * 3
    ground.send(mav.MAVLink_follow_target_message(0, 3, 0, 0, 0.0, none, none, [1.0, 0, 0, 0], none, none, 0))
    assert ground.wait(lambda m: m.get_type() == "STATUSTEXT" and "follow-me is not flown here" in m.text)


def test_the_table_of_stations_is_bounded(flight: Any, station: Any) -> None:
    flown = flight("udpin:127.0.0.1:0")
    for _ in range(LIMITS.max_stations + 4):
        station(flown.port).heartbeat()
    assert until(lambda: flown.link.refused["too many stations"] == 4)
    assert len(flown.link.peers) == LIMITS.max_stations


FLOOD = """
import socket, sys
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
frame, to, sent = bytes.fromhex(sys.argv[1]), ("127.0.0.1", int(sys.argv[2])), 0
try:
    while True:
        out.sendto(frame, to)
        sent += 1
except KeyboardInterrupt:
    print(sent)
"""


def test_a_station_that_floods_does_not_disturb(flight: Any, station: Any) -> None:
    flown = flight("udpin:127.0.0.1:0")
    good = station(flown.port)
    good.heartbeat()
    assert good.name("HEARTBEAT")
    # the port is still nobody else's
    with pytest.raises(InputError, match="in use"):
        Link([parse_endpoint(f"udpin:127.0.0.1:{flown.port}")])
    frame = bytes(command(511, 30.0, 40_000.0).pack(mav.MAVLink(None, srcSystem=66, srcComponent=1)))
    began = time.monotonic()
    flooding = [sys.executable, "-c", FLOOD, frame.hex(), str(flown.port)]
    flood = subprocess.Popen(flooding, stdout=subprocess.PIPE, text=True)
    try:
        # a busy machine may be slow to flood; what is not read would fill the socket's buffer
        assert until(lambda: good.read() or flown.link.refused["flood"] > 0, 60.0)
        for _ in range(5):
            good.got.clear()
            good.send(command(512, 148.0))
            assert good.name("AUTOPILOT_VERSION", 5.0)
    finally:
        flood.send_signal(signal.SIGINT)
        sent = int(flood.communicate()[0])
    bad = max(flown.link.peers, key=lambda peer: peer.received)
    assert sent > bad.received
    assert bad.received < (time.monotonic() - began + 1.0) * PEER.frames_1_s + 100  # what it may, and the burst
    assert flown.worst < stretched(1.0)  # the stepping thread only hands over


def test_a_tcp_server_serves_two_and_outlives_one(flight: Any, station: Any) -> None:
    flown = flight("tcpin:127.0.0.1:0")
    one, two = station(flown.port, kind=Tcp), station(flown.port, kind=Tcp)
    for each in (one, two):
        assert each.name("HEARTBEAT")
        raw = bytes(command(20).pack(each.mav))
        each.write(raw[:7])
        time.sleep(0.02)
        each.write(raw[7:] + raw[:3])
        assert each.name("COMMAND_ACK").result == 0
    one.close()
    assert until(lambda: len(flown.link.peers) == 1)
    two.got.clear()
    assert two.name("ATTITUDE")


def test_tcp_client_tries_again(flight: Any) -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        flight(f"tcp:127.0.0.1:{server.getsockname()[1]}")  # nobody listens yet
        time.sleep(0.1)
        server.listen()
        server.settimeout(PATIENCE)
        for _ in range(2):  # and again after it was lost
            connection, _ = server.accept()
            connection.settimeout(PATIENCE)
            other = mav.MAVLink(None)
            other.robust_parsing = True
            assert other.parse_buffer(connection.recv(4096))
            connection.close()


def test_with_a_key_only_who_has_it_is_heard(flight: Any, station: Any) -> None:
    flown = flight("udpin:127.0.0.1:0", signing=Signing(KEY))
    friend, foe, plain = station(flown.port, key=KEY), station(flown.port, key=b"w" * 32), station(flown.port)
    refused, asked = flown.link.refused, flown.pilot.asked
    for each in (foe, plain):
        each.heartbeat()
        each.send(command(400, 1.0))
    assert until(lambda: refused["signature"] == 2 and refused["unsigned"] == 2)
    assert flown.link.peers == []
    friend.heartbeat()
    friend.send(command(400, 1.0))
    ack = friend.name("COMMAND_ACK")
    assert ack.result == 0
    assert ack.get_signed()
    assert asked == [Arm()]
    # recorded and played again by somebody else
    tape = bytes(command(400, 0.0).pack(friend.mav))
    friend.write(tape)
    assert until(lambda: len(asked) == 2)
    plain.write(tape)
    assert until(lambda: refused["replay"] == 1)
    assert len(asked) == 2


def test_the_log_has_every_message_once(station: Any, tmp_path: Path) -> None:
    path = tmp_path / "telemetry.tlog"
    one, two = station(), station(system=245)

    def twenty(station: Udp) -> bool:
        station.read()
        return sum(message.get_type() == "ATTITUDE" for message in station.got) >= 20

    flight = Flight(f"udpout:127.0.0.1:{one.port}", f"udpout:127.0.0.1:{two.port}", log=TelemetryLog(path))
    for each in (one, two):
        assert each.name("HEARTBEAT")
        each.send(command(20))
        assert each.name("COMMAND_ACK")
    for each in (one, two):
        assert until(partial(twenty, each), PATIENCE)
    flight.close()
    assert not flight.link.failures
    log = mavutil.mavlink_connection(str(path), dialect="all", robust_parsing=True)
    found = list(iter(log.recv_msg, None))
    log.close()
    ours = [m for m in found if m.get_srcSystem() == 1]
    attitudes = [(m.time_boot_ms, m.get_seq()) for m in ours if m.get_type() == "ATTITUDE"]
    assert len(attitudes) >= 20
    assert len(set(attitudes)) == len(attitudes)  # two stations, one line
    times = [time for time, _ in attitudes]
    assert times == sorted(times)  # the same twice where no step came between on a busy machine
    assert len([m for m in ours if m.get_type() == "COMMAND_ACK"]) == 2
    assert [m.get_srcSystem() for m in found if m.get_type() == "COMMAND_LONG"] == [255, 245]
    assert not [m for m in found if m.get_type() == "BAD_DATA"]


def test_closing_twice_and_without_starting() -> None:
    link = Link([parse_endpoint("udpin:127.0.0.1:0"), parse_endpoint("tcpin:127.0.0.1:0")])
    link.close()
    link.close()
