"""Missions over MAVLink: up, down, refused, interrupted, under loss; and the places of the items on the Earth."""

from __future__ import annotations

import re
from contextlib import closing
from math import cos, nan, radians
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mavlink_bench import TICK, Bench, StandInPeer, Station, refuse

from cosim.base.errors import InputError
from cosim.base.geodesy import Geodesy
from cosim.base.signals import ZERO3, Disturbance
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import Home, Mode
from cosim.groundstation.mavlink.services.items import PARAM5, Item, ItemError, to_item, to_mission_item
from cosim.groundstation.mavlink.services.missions import MissionService
from cosim.groundstation.mavlink.services.service import make_service_text
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.airframe import Airframe

PLACE = Geodesy(22.35, 113.59, 12.0)
HOME = 0.125
TO = (1, 1)
SEA, RELATIVE, NO_POSITION = 5, 6, 2  # MAV_FRAME_GLOBAL_INT, _GLOBAL_RELATIVE_ALT_INT, _MISSION
NOT_GIVEN = 2**31 - 1
ACCEPTED, ERROR, FRAME, UNSUPPORTED, NO_SPACE, INVALID = range(6)
P1, P2, P3, P4, P5, P6, P7, SEQUENCE, DENIED, CANCELLED = range(6, 16)
REQUESTS = ("MISSION_REQUEST_INT", "MISSION_REQUEST")


def at(north: float, east: float, up: float, frame: int = RELATIVE, command: int = 16, **params: float) -> Item:
    """An item at a place; ``up`` is what its frame says."""
    altitude = up + HOME if frame == RELATIVE else up - PLACE.ground
    latitude, longitude, _ = PLACE.to_geodetic(north, east, altitude)
    given = (*(params.get(f"p{i}", 0.0) for i in (1, 2, 3)), params.get("p4", nan))
    return Item(frame, command, given, round(1e7 * latitude), round(1e7 * longitude), up)


def do(command: int, *params: float, z: float = 0.0, frame: int = NO_POSITION) -> Item:
    """An item without a place."""
    return Item(frame, command, tuple([*params, 0.0, 0.0, 0.0, 0.0][:4]), 0, 0, z)


SQUARE = [
    do(22, 0, 0, 0, nan, z=10.0, frame=RELATIVE),
    at(20.0, 0.0, 10.0, p1=1.5, p2=2.0),
    do(178, 1.0, 4.0, -1.0),
    at(20.0, 20.0, 12.0, p4=90.0),
    do(93, 2.0),
    at(0.0, 20.0, 30.0, SEA),
    do(177, 1.0, 2.0),
    do(20),
]


class Vehicle:
    """A pilot that holds a mission, behind the service."""

    def __init__(self, **link: Any) -> None:
        self.bench = Bench(**link)
        self.items: tuple[rq.MissionItem, ...] = ()
        self.status: Any = SimpleNamespace(mode=Mode.HOLD, armed=False, home=Home(0.0, 0.0, HOME), zones=(), rally=())
        vars(self.status).update(mission_count=0, mission_current=0, mission_reached=-1, mission_done=False)
        self.service = MissionService(lambda: self.items, lambda: self.status, self.bench.ask, PLACE)
        self.bench.services.append(self.service)
        self.bench.pilot = self.pilot
        self.station = self.bench.station()
        self.bench.tick()

    def pilot(self, request: rq.Request) -> rq.Answer:
        if isinstance(request, rq.MissionUpload):
            self.items = request.items
        elif isinstance(request, rq.MissionClear):
            self.items = ()
        elif isinstance(request, rq.FenceUpload):
            self.status.zones = request.zones
        elif isinstance(request, rq.RallyUpload):
            self.status.rally = request.points
        elif isinstance(request, rq.MissionSetCurrent) and request.index >= len(self.items):
            return refuse(f"mission item {request.index}: there are {len(self.items)}")
        elif isinstance(request, rq.MissionSetCurrent):
            self.status.mission_current = request.index
        if self.status is not None:
            self.status.mission_count = len(self.items)
        return rq.Answer(True, rq.Result.ACCEPTED, "")


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle()


@pytest.fixture
def flown(vehicle: Vehicle) -> Vehicle:
    """A vehicle that has the square."""
    upload(vehicle.station, SQUARE)
    return vehicle


def send_item(station: Station, index: int, item: Item, old: bool = False, kind: int = 0) -> None:
    place = (item.x * 1e-7, item.y * 1e-7) if old else (item.x, item.y)
    name = "MISSION_ITEM" if old else "MISSION_ITEM_INT"
    station.send(name, *TO, index, item.frame, item.command, index == 0, 1, *item.params, *place, item.z, kind)


def upload(station: Station, items: list[Item], old: bool = False, kind: int = 0) -> int:
    """As MAVSDK and QGroundControl: the count until the first request, then what is asked for; the final result."""
    for _ in range(20):
        station.send("MISSION_COUNT", *TO, len(items), kind)
        answer = station.wait("MISSION_REQUEST_INT", "MISSION_ACK", seconds=0.5)
        if answer is not None:
            break
    for _ in range(50 * len(items) + 50):
        if answer is not None and answer.get_type() == "MISSION_ACK":
            return int(answer.type)
        if answer is not None:
            index = answer.seq
        send_item(station, index, items[index], old, kind)  # and again what was sent last, if nothing comes
        answer = station.wait("MISSION_REQUEST_INT", "MISSION_ACK", seconds=1.0)
    raise AssertionError("the upload does not end")


def download(station: Station, kind: int = 0) -> list[Any]:
    count = station.insist(("MISSION_REQUEST_LIST", *TO, kind), "MISSION_COUNT").count
    items = []
    for index in range(count):
        request = ("MISSION_REQUEST_INT", *TO, index, kind)
        items.append(station.insist(request, "MISSION_ITEM_INT", match=lambda m, i=index: m.seq == i))
    station.send("MISSION_ACK", *TO, ACCEPTED, 0)
    return items


def item_of(message: Any) -> Item:
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.frame, message.command, params, message.x, message.y, message.z)


def same(received: list[Any], items: list[Item]) -> bool:
    """Bit for bit what was sent; NaN is NaN."""
    exactly = [item._replace(params=pytest.approx(item.params, rel=0.0, abs=0.0, nan_ok=True)) for item in items]
    return [item_of(message) for message in received] == exactly


def test_an_uploaded_mission_is_flown_as_it_was_meant_and_comes_back_as_it_was_sent(vehicle: Vehicle) -> None:
    assert upload(vehicle.station, SQUARE) == ACCEPTED
    kinds = [item.kind for item in vehicle.items]
    assert kinds == [
        rq.ItemKind.TAKEOFF, rq.ItemKind.WAYPOINT, rq.ItemKind.SPEED, rq.ItemKind.WAYPOINT,
        rq.ItemKind.DELAY, rq.ItemKind.WAYPOINT, rq.ItemKind.JUMP, rq.ItemKind.RETURN,
    ]  # fmt: skip
    takeoff, first, speed, second, delay, third, jump, _ = vehicle.items
    assert takeoff.altitude == 10.0 + HOME
    assert (first.north, first.east, first.altitude) == pytest.approx((20.0, 0.0, 10.0 + HOME), abs=0.012)  # 1e-7 deg
    assert (first.hold_s, first.acceptance_m, first.yaw) == (1.5, 2.0, None)
    assert second.yaw == pytest.approx(radians(90.0))
    assert third.altitude == pytest.approx(30.0 - PLACE.ground)  # above the sea
    assert (speed.speed, delay.hold_s, jump.target, jump.repeat) == (4.0, 2.0, 1, 2)
    received = download(vehicle.station)
    assert same(received, SQUARE)
    assert [m.current for m in received] == [1] + [0] * 7


def test_a_jump_for_ever_is_taken_and_given_back(vehicle: Vehicle) -> None:
    items = [do(22, 0, 0, 0, nan, z=10.0, frame=RELATIVE), at(20.0, 0.0, 10.0), do(177, 1.0, -1.0)]
    assert upload(vehicle.station, items) == ACCEPTED
    assert (vehicle.items[2].target, vehicle.items[2].repeat) == (1, -1)
    assert same(download(vehicle.station), items)
    assert to_item(vehicle.items[2], PLACE).params[:2] == (1.0, -1.0)
    assert upload(vehicle.station, [at(20.0, 0.0, 10.0), do(177, 0.0, -2.0)]) != ACCEPTED


def test_a_place_far_away_is_refused_as_a_pilot_says_it(vehicle: Vehicle) -> None:
    far = Item(RELATIVE, 16, (0.0, 0.0, 0.0, nan), 650_000_000, 1_135_900_000, 10.0)
    assert upload(vehicle.station, [far]) == PARAM5
    texts = [message for message in vehicle.station.take() if message.get_type() == "STATUSTEXT"]
    said = "".join(text.text for text in sorted(texts, key=lambda text: text.chunk_seq))
    assert re.fullmatch(r"mission item 0 refused: 4,3\d\d km from home, 100 km at most", said)
    high = Item(RELATIVE, 16, (0.0, 0.0, 0.0, nan), round(1e7 * 22.35), round(1e7 * 113.59), 4e6)
    with pytest.raises(ItemError, match="4,000 km above the ground, 100 km at most"):
        to_mission_item(high, PLACE, 0.0)


def test_a_text_that_fills_its_last_piece_is_ended() -> None:
    """Without a NUL a station waits for more; and no text of a service has a number of one of the vehicle's own."""
    (one,) = make_service_text("a" * 49, 4)
    assert one.id == 0
    two = make_service_text("a" * 100, 4)
    assert [piece.chunk_seq for piece in two] == [0, 1, 2]
    assert two[-1].text == ""
    assert two[0].id > 0x8000


@pytest.mark.parametrize("seed", range(5))
def test_up_and_down_with_a_fifth_of_the_frames_lost(seed: int) -> None:
    vehicle = Vehicle(loss=0.2, seed=seed)
    assert upload(vehicle.station, SQUARE) == ACCEPTED
    assert sum(isinstance(request, rq.MissionUpload) for request in vehicle.bench.asked) == 1
    assert len(vehicle.items) == len(SQUARE)
    assert same(download(vehicle.station), SQUARE)


def test_the_old_messages_in_degrees_work_too(vehicle: Vehicle) -> None:
    """To the metre: 32-bit degrees at 113 deg are 0.8 m apart."""
    old = [item._replace(frame={SEA: 0, RELATIVE: 3}.get(item.frame, item.frame)) for item in SQUARE]
    assert upload(vehicle.station, old, old=True) == ACCEPTED
    assert vehicle.items[1].north == pytest.approx(20.0, abs=1.0)
    vehicle.station.send("MISSION_REQUEST", *TO, 3, 0)
    item = vehicle.station.wait("MISSION_ITEM")
    latitude, longitude, _ = PLACE.to_geodetic(20.0, 20.0)
    assert (item.x, item.y) == pytest.approx((latitude, longitude), abs=1e-5)
    assert (item.frame, item.z) == (3, 12.0)


def test_a_mission_from_elsewhere_is_written_as_items_that_mean_the_same(flown: Vehicle) -> None:
    flown.items = (*flown.items[1:6], rq.MissionItem(rq.ItemKind.LAND, 5.0, 6.0), rq.MissionItem(rq.ItemKind.LAND))
    for message, item in zip(download(flown.station), flown.items, strict=True):
        again = to_mission_item(item_of(message), PLACE, 99.0)
        assert again.kind is item.kind
        if item.north is not None:
            assert (again.north, again.east) == pytest.approx((item.north, item.east), abs=0.012)
        if item.altitude is not None:
            assert again.altitude == pytest.approx(item.altitude, abs=1e-5)
        assert (again.hold_s, again.speed, again.target) == (item.hold_s, item.speed, item.target)
        assert again.yaw == pytest.approx(item.yaw) if item.yaw is not None else again.yaw is None


def test_loiter_items_are_flown_by_a_vehicle_that_hovers(vehicle: Vehicle) -> None:
    loiter = [
        at(20.0, 0.0, 10.0, command=17, p4=90.0),
        at(20.0, 0.0, 12.0, command=18, p1=2.0, p3=-8.0),  # to the left
        at(5.0, 6.0, 14.0, command=31, p1=1.0, p2=30.0),
        do(31, z=9.0, frame=RELATIVE),  # where it is
    ]
    assert upload(vehicle.station, loiter) == ACCEPTED
    stay, circle, there, here = vehicle.items
    assert [item.kind for item in vehicle.items] == [
        *(rq.ItemKind.STAY, rq.ItemKind.CIRCLE),
        *[rq.ItemKind.ALTITUDE] * 2,
    ]
    assert stay.yaw == pytest.approx(radians(90.0))
    assert (circle.turns, circle.radius, circle.clockwise) == (2.0, 8.0, False)
    assert [item.altitude for item in vehicle.items] == [height + HOME for height in (10.0, 12.0, 14.0, 9.0)]
    assert (there.north, there.east) == pytest.approx((5.0, 6.0), abs=0.012)
    assert here.north is None
    assert same(download(vehicle.station), loiter)
    # written anew, they mean the same
    for item in vehicle.items:
        again = to_mission_item(to_item(item, PLACE), PLACE, 99.0)
        for name in ("kind", "turns", "radius", "clockwise"):
            assert getattr(again, name) == getattr(item, name)
        assert again.altitude == pytest.approx(item.altitude, abs=1e-5)
        assert (again.north is None) is (item.north is None)


@pytest.mark.parametrize("last", [("MISSION_COUNT", *TO, 0, 0), ("MISSION_CLEAR_ALL", *TO, 0)])
def test_an_empty_upload_and_clear_all_empty_the_mission(flown: Vehicle, last: tuple[Any, ...]) -> None:
    flown.station.take()
    flown.station.send(*last)
    ack = flown.station.wait("MISSION_ACK")
    assert (ack.type, ack.target_system, ack.target_component) == (ACCEPTED, 255, 190)
    assert flown.items == ()
    assert download(flown.station) == []


BAD = [
    (at(0, 0, 10, p1=-1.0), P1),
    (at(0, 0, 10, p1=float("inf")), P1),
    (at(0, 0, 10, p1=1e6), P1),
    (at(0, 0, 10, p2=-1.0), P2),
    (at(0, 0, 10, p4=400.0), P4),
    (at(0, 0, 10)._replace(z=nan), P7),
    (at(0, 0, 10)._replace(z=1e9), P7),
    (at(0, 0, 10)._replace(x=900_000_001), P5),
    (at(0, 0, 10)._replace(y=-1_800_000_001), P6),
    (at(0, 0, 10)._replace(x=0, y=0), P5),  # 2000 km away
    (at(0, 0, 10)._replace(x=NOT_GIVEN, y=NOT_GIVEN), P5),
    (at(0, 0, 10)._replace(frame=NO_POSITION), FRAME),
    (at(0, 0, 10)._replace(frame=1), FRAME),  # local NED
    (at(0, 0, 10)._replace(frame=11), FRAME),  # above the terrain
    (at(0, 0, 10)._replace(frame=255), FRAME),
    (do(22, z=10.0), FRAME),
    (do(93, -1.0), P1),
    (do(93, nan), P1),
    (do(178, 2.0, 5.0), P1),  # climb rate
    (do(178, 1.0, -1.0), P2),
    (do(178, 1.0, nan), P2),
    (do(177, 0.5, 1.0), P1),
    (do(177, nan, 1.0), P1),
    (do(177, -1.0, 1.0), P1),  # an item has no number below 0
    (do(177, 0.0, -2.0), P2),
    (do(177, 0.0, 0.5), P2),
    (do(177, 0.0, 1e9), P2),
    (do(17), FRAME),  # loiter without end, nowhere
    (at(0, 0, 10, command=18, p1=0.0, p3=5.0), P1),  # no turns
    (at(0, 0, 10, command=18, p1=1e6, p3=5.0), P1),
    (at(0, 0, 10, command=18, p1=1.0, p3=0.0), P3),  # no radius
    (at(0, 0, 10, command=18, p1=1.0, p3=nan), P3),
    (at(0, 0, 10, command=18, p1=1.0, p3=1e6), P3),
    (at(0, 0, 10, command=31)._replace(z=nan), P7),
    (do(211, 1.0, 1.0), UNSUPPORTED),  # open a gripper
    (do(65535), UNSUPPORTED),
]


@pytest.mark.parametrize(("item", "code"), BAD)
def test_an_item_that_cannot_be_flown_is_refused_with_its_reason(flown: Vehicle, item: Item, code: int) -> None:
    before, asked = flown.items, len(flown.bench.asked)
    assert upload(flown.station, [SQUARE[0], item, SQUARE[1]]) == code
    text = flown.station.wait("STATUSTEXT")
    assert text.text.startswith("mission item 1 refused: ")
    assert flown.items is before
    assert len(flown.bench.asked) == asked
    assert not flown.service.is_busy


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (("MISSION_REQUEST_LIST", *TO, 77), UNSUPPORTED),
        (("MISSION_CLEAR_ALL", *TO, 77), UNSUPPORTED),
        (("MISSION_REQUEST_LIST", *TO, 255), UNSUPPORTED),
        (("MISSION_COUNT", *TO, 3, 255), UNSUPPORTED),
        (("MISSION_WRITE_PARTIAL_LIST", *TO, 0, 1, 0), UNSUPPORTED),
        (("MISSION_REQUEST_PARTIAL_LIST", *TO, -5, -1, 0), UNSUPPORTED),
        (("MISSION_COUNT", *TO, 1001, 0), NO_SPACE),
        (("MISSION_COUNT", *TO, 65535, 0), NO_SPACE),
        *(((name, *TO, index, 0), SEQUENCE) for name in REQUESTS for index in (8, 65535)),
    ],
)
def test_what_is_unknown_not_there_or_too_much_has_its_code(flown: Vehicle, message: tuple[Any], code: int) -> None:
    flown.station.send(*message)
    assert flown.station.wait("MISSION_ACK").type == code
    assert [type(request) for request in flown.bench.asked] == [rq.MissionUpload]
    assert not flown.service.is_busy


def test_without_a_mission_there_is_no_item_and_without_an_upload_none_is_taken(vehicle: Vehicle) -> None:
    for name in REQUESTS:
        vehicle.station.send(name, *TO, 0, 0)
        assert vehicle.station.wait("MISSION_ACK").type == SEQUENCE
    send_item(vehicle.station, 0, SQUARE[0])
    assert vehicle.station.wait("MISSION_ACK").type == ERROR
    assert vehicle.items == ()


def test_the_pilots_refusal_is_the_end_of_the_upload(vehicle: Vehicle) -> None:
    assert upload(vehicle.station, [SQUARE[1], do(177, 5.0, 1.0)]) == P1  # a jump to nowhere does not come so far
    assert not vehicle.bench.asked
    vehicle.station.take()
    vehicle.bench.pilot = lambda request: refuse("upload refused: the mission is being flown")
    assert upload(vehicle.station, SQUARE) == DENIED
    assert vehicle.station.wait("STATUSTEXT").text == "upload refused: the mission is being flown"
    vehicle.bench.pilot = lambda request: refuse("no answer", rq.Result.FAILED)
    assert upload(vehicle.station, SQUARE) == ERROR


def test_a_place_high_up_and_far_away_is_where_it_is() -> None:
    """At 3 km above and 10 km away the verticals have drifted apart by 5 m; 1e-7 deg are 12 mm."""
    flown = to_mission_item(at(10_000.0, 8000.0, 3000.0), PLACE, HOME)
    assert (flown.north, flown.east) == pytest.approx((10_000.0, 8000.0), abs=0.012)


@given(
    command=st.sampled_from([16, 19, 20, 21, 22, 93, 177, 178, 0, 5, 300]),
    frame=st.integers(0, 255),
    params=st.tuples(*[st.floats(width=32)] * 4),
    x=st.integers(-(2**31), 2**31 - 1),
    y=st.integers(-(2**31), 2**31 - 1),
    z=st.floats(width=32),
    home=st.floats(-1000.0, 1000.0),
)
def test_no_item_is_a_surprise(command: int, frame: int, params: tuple, x: int, y: int, z: float, home: float) -> None:
    """Any item is flown or refused with a code that MAVLink has."""
    code = None
    try:
        flown = to_mission_item(Item(frame, command, params, x, y, z), PLACE, home)
    except ItemError as error:
        code = error.code
    if code is None:
        assert to_item(flown, PLACE).command in (command, 16)
    else:
        assert INVALID <= code <= P7 or code in (FRAME, UNSUPPORTED)


def test_the_vehicle_asks_again_and_gives_up_in_the_end(flown: Vehicle) -> None:
    """Every quarter of a second; after five without an item the upload is over and the old mission stays."""
    before = flown.items
    flown.station.take()
    flown.station.send("MISSION_COUNT", *TO, 3, 0)
    flown.bench.tick(4.9)
    requests = flown.station.take("MISSION_REQUEST_INT")
    assert {m.seq for m in requests} == {0}
    assert len(requests) == pytest.approx(4.9 / (0.25 + TICK) + 1, abs=2)
    flown.bench.tick(0.2)
    assert [m.type for m in flown.station.take("MISSION_ACK")] == [CANCELLED]
    assert not flown.service.is_busy
    assert flown.items is before


def test_items_out_of_order_twice_or_beyond_the_end_do_no_harm(vehicle: Vehicle) -> None:
    station = vehicle.station
    station.send("MISSION_COUNT", *TO, 3, 0)
    for index in (1, 2, 3, 65535, 0, 0, 0, 2, 1, 1, 0, 2, 2):
        send_item(station, index, at(float(index % 10), 0.0, 10.0))
    vehicle.bench.tick(0.1)
    assert [round(item.north or 0.0) for item in vehicle.items] == [0, 1, 2]
    assert [m.seq for m in station.take("MISSION_REQUEST_INT")] == [0, 1, 2]
    (ack,) = station.take("MISSION_ACK")
    assert ack.type == ACCEPTED


def test_a_lost_acknowledgement_is_sent_again_for_the_last_item(flown: Vehicle) -> None:
    asked = len(flown.bench.asked)
    send_item(flown.station, 7, SQUARE[7])
    assert flown.station.wait("MISSION_ACK").type == ACCEPTED
    send_item(flown.station, 3, SQUARE[3])  # but an item of no upload is none
    assert flown.station.wait("MISSION_ACK").type == ERROR
    assert len(flown.bench.asked) == asked


def test_two_stations_cannot_upload_at_once(vehicle: Vehicle) -> None:
    other = vehicle.bench.station(245)
    vehicle.station.send("MISSION_COUNT", *TO, 1, 0)
    other.send("MISSION_COUNT", *TO, 1, 0)
    send_item(other, 0, at(99.0, 0.0, 10.0))
    assert [m.type for m in other.take("MISSION_ACK")] == [ERROR, ERROR]
    send_item(vehicle.station, 0, at(7.0, 0.0, 10.0))
    vehicle.bench.tick(0.1)
    assert round(vehicle.items[0].north or 0.0) == 7
    assert upload(other, SQUARE) == ACCEPTED


def test_an_upload_that_its_sender_gives_up_is_over_but_nobody_elses(vehicle: Vehicle) -> None:
    other = vehicle.bench.station(245)
    vehicle.station.send("MISSION_COUNT", *TO, 2, 0)
    other.send("MISSION_ACK", *TO, CANCELLED, 0)
    assert vehicle.service.is_busy
    vehicle.station.send("MISSION_ACK", *TO, CANCELLED, 0)
    assert not vehicle.service.is_busy
    vehicle.station.send("MISSION_COUNT", *TO, 2, 0)
    vehicle.service.forget(StandInPeer("somebody"))
    assert vehicle.service.is_busy
    vehicle.service.forget(vehicle.station.peer)
    assert not vehicle.service.is_busy


def test_a_count_that_comes_again_begins_again(vehicle: Vehicle) -> None:
    station = vehicle.station
    station.send("MISSION_COUNT", *TO, 3, 0)
    send_item(station, 0, at(1.0, 0.0, 10.0))
    station.take()
    station.send("MISSION_COUNT", *TO, 2, 0)
    assert station.wait("MISSION_REQUEST_INT").seq == 0
    assert upload(station, SQUARE[:2]) == ACCEPTED
    assert len(vehicle.items) == 2


CORNERS = [(40.0, -40.0), (40.0, 60.0), (-40.0, 60.0), (-40.0, -40.0)]
FENCE = [
    *(at(n, e, 0.0, command=5001, p1=4.0) for n, e in CORNERS),
    at(10.0, 10.0, 0.0, command=5004, p1=5.0),
    *(at(n + 100.0, e, 0.0, command=5002, p1=3.0) for n, e in CORNERS[:3]),
]
POINTS = [at(20.0, 30.0, 15.0, command=5100), at(-20.0, 0.0, 40.0, SEA, command=5100)]


def test_a_fence_travels_both_ways(flown: Vehicle) -> None:
    before = flown.items
    assert upload(flown.station, FENCE, kind=1) == ACCEPTED
    polygon, circle, other = flown.status.zones
    assert polygon.kind is rq.ZoneKind.STAY_IN_POLYGON
    assert [pytest.approx(corner, abs=0.02) for corner in CORNERS] == list(polygon.points)  # 1e-7 deg are 1 cm
    assert (circle.kind, circle.radius) == (rq.ZoneKind.STAY_OUT_OF_CIRCLE, 5.0)
    assert (other.kind, len(other.points)) == (rq.ZoneKind.STAY_OUT_OF_POLYGON, 3)
    back = download(flown.station, 1)
    assert [(m.command, m.param1, m.mission_type) for m in back] == [(i.command, i.params[0], 1) for i in FENCE]
    # a hundredth of a second of arc there and back
    assert all(abs(m.x - i.x) <= 1 and abs(m.y - i.y) <= 1 for m, i in zip(back, FENCE, strict=True))
    assert flown.items is before
    flown.station.send("MISSION_CLEAR_ALL", *TO, 1)
    assert flown.station.wait("MISSION_ACK").mission_type == 1
    assert flown.status.zones == ()
    assert flown.items is before


def test_rally_points_travel_both_ways(vehicle: Vehicle) -> None:
    assert upload(vehicle.station, POINTS, kind=2) == ACCEPTED
    assert [point.altitude for point in vehicle.status.rally] == pytest.approx([15.0 + HOME, 40.0 - PLACE.ground])
    back = download(vehicle.station, 2)
    assert [m.command for m in back] == [5100, 5100]
    assert [m.z for m in back] == pytest.approx([15.0 + HOME + PLACE.ground, 40.0], abs=1e-5)
    vehicle.station.send("MISSION_COUNT", *TO, 0, 2)
    assert vehicle.station.wait("MISSION_ACK").type == ACCEPTED
    assert vehicle.status.rally == ()


def test_all_lists_are_cleared_at_once(flown: Vehicle) -> None:
    upload(flown.station, FENCE, kind=1)
    upload(flown.station, POINTS, kind=2)
    flown.station.take()
    flown.station.send("MISSION_CLEAR_ALL", *TO, 255)
    ack = flown.station.wait("MISSION_ACK")
    assert (ack.type, ack.mission_type) == (ACCEPTED, 255)
    assert (flown.items, flown.status.zones, flown.status.rally) == ((), (), ())
    assert flown.station.wait("MISSION_ACK", seconds=0.5) is None  # one is enough


@pytest.mark.parametrize(
    ("kind", "items", "code", "text"),
    [
        (1, [at(0.0, 0.0, 0.0)], UNSUPPORTED, "fence item 0 refused: command 16 is not one of a fence"),
        (1, [at(0.0, 0.0, 0.0, command=5003, p1=0.0)], P1, "radius 0: more than 0 m is needed"),
        (1, [at(n, e, 0.0, command=5001, p1=nan) for n, e in CORNERS], P1, "nan corners: a whole number is needed"),
        (1, [at(n, e, 0.0, command=5002, p1=3.5) for n, e in CORNERS], P1, "3.5 corners: a whole number is needed"),
        (1, FENCE[:3], P1, "fence refused: item 2: a polygon of 4 corners ends after 3"),
        (1, [FENCE[0], FENCE[4]], P1, "a polygon of 4 corners ends after 1"),
        (1, [at(n, 0.0, 0.0, command=5001, p1=2.0) for n in (0.0, 9.0)], P1, "2 corners, a polygon has 3 to"),
        (2, [at(0.0, 0.0, 9.0)], UNSUPPORTED, "rally item 0 refused: command 16 is no rally point"),
        (2, [at(0.0, 0.0, 9.0, frame=8, command=5100)], FRAME, "frame 8 is not known here"),
    ],
)
def test_what_is_no_fence_and_no_rally_is_refused(
    vehicle: Vehicle, kind: int, items: list[Item], code: int, text: str
) -> None:
    assert upload(vehicle.station, items, kind=kind) == code
    assert text in said(vehicle)
    assert (vehicle.status.zones, vehicle.status.rally) == ((), ())


def test_an_item_of_another_list_is_none_of_this_upload(vehicle: Vehicle) -> None:
    vehicle.station.send("MISSION_COUNT", *TO, 8, 1)
    assert vehicle.station.wait("MISSION_REQUEST_INT").mission_type == 1
    send_item(vehicle.station, 0, SQUARE[0], kind=0)
    assert vehicle.station.wait("MISSION_ACK").type == ERROR
    assert upload(vehicle.station, FENCE, kind=1) == ACCEPTED


def test_a_mission_with_a_camera_flies_the_rest_and_says_what_it_left_out(vehicle: Vehicle) -> None:
    survey = [SQUARE[0], do(206, 25.0), *SQUARE[1:4], do(195), do(2000, 0.0, 1.0), do(206, 0.0), SQUARE[7]]
    assert upload(vehicle.station, survey) == ACCEPTED
    kinds = [item.kind for item in vehicle.items]
    assert kinds.count(rq.ItemKind.LEFT_OUT) == 4
    assert len(kinds) == len(survey)  # every other keeps its number
    text = "4 items left out, no such payload: DO_SET_CAM_TRIGG_DIST, DO_SET_ROI_LOCATION, IMAGE_START_CAPTURE"
    assert text in said(vehicle)
    assert [m.command for m in download(vehicle.station)] == [item.command for item in survey]


def said(vehicle: Vehicle) -> str:
    """The status texts so far, parts of one put together."""
    vehicle.bench.tick(0.05)
    return "".join(m.text for m in vehicle.station.take("STATUSTEXT"))


def test_the_current_item_is_told_when_it_changes_and_every_second(vehicle: Vehicle) -> None:
    station = vehicle.station
    (first,) = station.take("MISSION_CURRENT")
    assert (first.seq, first.total, first.mission_state) == (0, 65535, 1)  # no mission
    upload(station, SQUARE)
    vehicle.bench.tick()
    assert station.take("MISSION_CURRENT")[-1].mission_state == 2  # not begun
    station.send("MISSION_SET_CURRENT", *TO, 3)
    vehicle.bench.tick(0.05)
    current = station.take("MISSION_CURRENT")[-1]
    assert (current.seq, current.total, current.mission_state) == (3, 8, 4)  # begun, not being flown
    vehicle.status.mode, vehicle.status.armed = Mode.MISSION, True
    vehicle.bench.tick(3.0)
    told = station.take("MISSION_CURRENT")
    assert {m.mission_state for m in told} == {3}
    assert len(told) == pytest.approx(4, abs=1)
    vehicle.status.mission_done, vehicle.status.mission_current = True, 8
    vehicle.bench.tick(0.05)
    assert [(m.seq, m.mission_state) for m in station.take("MISSION_CURRENT")] == [(7, 5)]


def test_who_sets_the_current_item_hears_it_at_once_also_when_it_is_the_same(vehicle: Vehicle) -> None:
    """MAVSDK sends again at each MISSION_CURRENT that is another, so none of before may be sent for an answer."""
    station = vehicle.station
    upload(station, SQUARE)
    vehicle.bench.tick(0.1)
    for index in (3, 3, 0, 0):
        station.take()
        station.send("MISSION_SET_CURRENT", *TO, index)
        vehicle.bench.tick(0.03)
        assert [m.seq for m in station.take("MISSION_CURRENT")] == [index]


@pytest.mark.parametrize("index", [8, 10_000, 65535])
def test_a_current_item_that_is_not_there_is_refused_with_a_line(flown: Vehicle, index: int) -> None:
    flown.station.send("MISSION_SET_CURRENT", *TO, index)
    assert "there are 8" in flown.station.wait("STATUSTEXT").text
    assert flown.status.mission_current == 0


def test_a_reached_item_is_told_three_times(flown: Vehicle) -> None:
    """Nobody acknowledges it, and MAVSDK waits for the last one."""
    for reached in (0, 1):
        flown.status.mission_reached = reached
        flown.bench.tick(6.0)
        assert [m.seq for m in flown.station.take("MISSION_ITEM_REACHED")] == [reached] * 3
    upload(flown.station, SQUARE)  # a new mission, while the state of the old one is still there
    flown.bench.tick(1.0)
    flown.status.mission_reached = -1
    flown.bench.tick(3.0)
    assert not flown.station.take("MISSION_ITEM_REACHED")


def test_nothing_is_told_before_the_first_step(vehicle: Vehicle) -> None:
    vehicle.station.take()
    vehicle.status = None
    vehicle.bench.tick(3.0)
    assert not vehicle.station.take()
    assert upload(vehicle.station, SQUARE) == ACCEPTED


@pytest.mark.parametrize(
    ("latitude", "longitude", "ground"), [(22.35, 113.59, 0.0), (-60.0, -120.0, 1200.0), (80.0, 179.99, 0.0)]
)
def test_the_map_shows_the_vehicle_where_jsbsim_has_it(latitude: float, longitude: float, ground: float) -> None:
    """Against JSBSim's own latitude and longitude along an arc of 9 km; 1e-6 m is forty times what was seen."""
    free = {"aero": {"drag_area_m2": [0.0, 0.0, 0.0], "damping_n_m_s": [0.0, 0.0, 0.0]}}
    vehicle, folder = load_vehicle("hexjet", free)
    environment = Environment(latitude_deg=latitude, longitude_deg=longitude, ground_m=ground)
    with closing(Airframe(vehicle, folder, environment, 0.1, 1, 1)) as frame:
        place = Geodesy(latitude, longitude, ground)
        state = frame.reset(Initial(altitude_m=4000.0, velocity_ned_m_s=(250.0, 300.0, -100.0)), [ZERO3] * 6, ZERO3)
        for _ in range(240):
            state = frame.step([ZERO3] * 6, Disturbance())
        north, east, _ = state.position
        assert north > 5000.0
        there = frame.latitude_longitude_deg()
        assert place.to_geodetic(north, east, state.altitude)[:2] == pytest.approx(there, abs=1e-11)  # deg: 1e-6 m
        back = place.to_local(*there, ground + state.altitude)
        assert back == pytest.approx((north, east, state.altitude), abs=1e-6)


@given(st.floats(-89, 89), st.floats(-180, 180), st.floats(-5e4, 5e4), st.floats(-5e4, 5e4), st.floats(-100, 1e4))
def test_there_and_back_is_the_same_place(latitude: float, longitude: float, n: float, e: float, h: float) -> None:
    """To 1e-7 m, what is left of 64-bit metres of the Earth's radius after some arithmetic."""
    place = Geodesy(latitude, longitude, 30.0)
    assert place.to_local(*place.to_geodetic(n, e, h)) == pytest.approx((n, e, h), abs=1e-7)


def test_a_degree_is_as_long_as_the_ellipsoid_says() -> None:
    """At the equator 111319.49 m to the east (a pi / 180); 1e-7 deg of a mission item are 11 mm."""
    place = Geodesy(0.0, 0.0)
    north, east, _ = place.to_local(0.0, 1e-3)
    assert (north, east) == pytest.approx((0.0, 111.31949), abs=1e-5)
    assert Geodesy(60.0, 0.0).to_local(60.0, 1e-3)[1] == pytest.approx(111.31949 * cos(radians(60.0)), rel=0.003)


@pytest.mark.parametrize("place", [(90.0, 0.0), (0.0, 181.0), (nan, 0.0)])
def test_no_flight_begins_at_a_pole_or_off_the_map(place: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="latitude"):
        Geodesy(*place)
