"""The fence that is drawn, and rally points: geometry against others, and in flight."""

from __future__ import annotations

import itertools
from math import hypot, sqrt

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_pilot_flight import Flight

from cosim.pilot import requests as rq
from cosim.pilot.fence import beyond, depth
from cosim.pilot.modes import LandedState, Mode
from cosim.pilot.requests import FenceUpload, FenceZone, RallyPoint, RallyUpload, ZoneKind

IN, OUT, CIRCLE, HOLE = ZoneKind
SQUARE = FenceZone(IN, ((-10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (10.0, -10.0)))
# a U that is open to the north
YOU = FenceZone(
    IN, ((0.0, 0.0), (30.0, 0.0), (30.0, 10.0), (10.0, 10.0), (10.0, 20.0), (30.0, 20.0), (30.0, 30.0), (0.0, 30.0))
)


@pytest.mark.parametrize(
    ("zone", "place", "distance"),
    [
        (SQUARE, (0.0, 0.0), 10.0),
        (SQUARE, (9.0, 3.0), 1.0),
        (SQUARE, (13.0, 14.0), -5.0),  # off the corner: 3, 4, 5
        (SQUARE, (0.0, -12.0), -2.0),
        (YOU, (20.0, 15.0), -5.0),  # in the opening
        (YOU, (5.0, 15.0), 5.0),
        (YOU, (29.0, 5.0), 1.0),
        (FenceZone(CIRCLE, ((3.0, 4.0),), 7.0), (0.0, 0.0), 2.0),
        (FenceZone(HOLE, ((3.0, 4.0),), 2.0), (0.0, 0.0), -3.0),
        (FenceZone(IN, ((0.0, 0.0), (0.0, 0.0), (1.0, 1.0))), (1.0, 0.0), -sqrt(0.5)),  # corners that coincide
    ],
)
def test_distances_by_hand(zone: FenceZone, place: tuple[float, float], distance: float) -> None:
    assert depth(zone, *place) == pytest.approx(distance, abs=1e-12)


coordinate = st.floats(-50.0, 50.0)


@settings(max_examples=200)
@given(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=7), coordinate, coordinate)
def test_inside_is_an_odd_winding(corners: list[tuple[float, float]], north: float, east: float) -> None:
    """The sign against the angles under which the edges are seen, an independent rule; the size against samples."""
    zone = FenceZone(IN, tuple(corners))
    distance = depth(zone, north, east)
    assume(abs(distance) > 1e-3)
    points = np.array([*corners, corners[0]]) - (north, east)
    angles = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    # an edge is seen under less than half a turn
    turns = np.sum((np.diff(np.arctan2(points[:, 1], points[:, 0])) + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * np.pi)
    assert len(angles) == len(points)
    assert (distance > 0.0) == (round(float(turns)) % 2 == 1)
    share = np.linspace(0.0, 1.0, 400)[:, None]
    nearest = min(float(np.min(np.hypot(*(a + share * (b - a)).T))) for a, b in itertools.pairwise(points))
    longest = max(float(np.hypot(*(b - a))) for a, b in itertools.pairwise(points))
    assert abs(distance) <= nearest + 1e-9
    assert nearest <= abs(distance) + longest / 399


def test_who_is_inside_one_zone_and_outside_all_holes_is_inside() -> None:
    far = FenceZone(CIRCLE, ((100.0, 0.0),), 5.0)
    hole = FenceZone(HOLE, ((0.0, 0.0),), 3.0)
    zones = (SQUARE, far, hole)
    assert beyond(zones, 5.0, 5.0) == (0.0, "")
    assert beyond(zones, 100.0, 4.0) == (0.0, "")
    assert beyond(zones, 14.0, 0.0) == (4.0, "4 m outside the zone to stay in")
    assert beyond(zones, 0.0, 1.0) == (2.0, "2 m inside zone 2, to stay out of")
    assert beyond((hole,), 50.0, 0.0) == (0.0, "")
    assert beyond((), 1e5, 0.0) == (0.0, "")


# --- in flight -------------------------------------------------------------------------------------------------------


def test_a_drawn_fence_is_kept_in_flight() -> None:
    """What is outside is refused before it is flown; who flies out by velocity is brought back."""
    with Flight() as flight:
        flight.fly(1.1)
        flight.ok(FenceUpload((SQUARE,)), rq.Arm(), rq.Takeoff(5.0))
        flight.fly(40.0, lambda: flight.pilot.mode is Mode.HOLD)
        answer = flight.ask(rq.Goto(15.0, 0.0))
        assert not answer.accepted
        assert "5 m outside the zone to stay in" in answer.text
        assert not flight.ask(rq.MissionUpload((rq.MissionItem(rq.ItemKind.WAYPOINT, 0.0, 20.0, 5.0),))).accepted
        assert not flight.ask(RallyUpload((RallyPoint(30.0, 0.0, 5.0),))).accepted
        # a fence that would be left at once is refused, and the old one stays
        there = FenceZone(IN, ((50.0, 50.0), (60.0, 50.0), (60.0, 60.0)))
        assert not flight.ask(FenceUpload((there,))).accepted
        assert flight.pilot.status.zones == (SQUARE,)
        out = rq.OffboardVelocity(3.0, 0.0, 0.0)
        flight.ok(out, rq.SetMode("OFFBOARD"))
        flight.fly(30.0, lambda: flight.pilot.mode is Mode.RTL, every=out)
        assert "outside the fence: 0 m outside the zone to stay in" in flight.pilot.messages[-1].text
        flight.fly(60.0, lambda: flight.pilot.landed is LandedState.ON_GROUND)
        assert flight.away(0.0, 0.0) < 1.5


def test_it_returns_to_the_rally_point_that_is_nearer_than_home() -> None:
    with Flight() as flight:
        flight.take_off(5.0)
        flight.ok(RallyUpload((RallyPoint(18.0, 4.0, 9.0), RallyPoint(-30.0, 0.0, 9.0))), rq.Goto(20.0, 0.0, 5.0))
        flight.fly(40.0, lambda: flight.away(20.0, 0.0) < 0.5)
        flight.ok(rq.ReturnHome())
        flight.fly(90.0, lambda: flight.pilot.landed is LandedState.ON_GROUND)
        assert flight.away(18.0, 4.0) < 1.0
        assert max(sample.state.altitude for sample in flight.samples) > 8.5  # not below the point's own height
        flight.ok(RallyUpload(()))
        assert flight.pilot.status.rally == ()


def test_a_mission_passes_what_it_left_out() -> None:
    items = (
        rq.MissionItem(rq.ItemKind.LEFT_OUT),
        rq.MissionItem(rq.ItemKind.TAKEOFF, altitude=4.0),
        rq.MissionItem(rq.ItemKind.LEFT_OUT),
        rq.MissionItem(rq.ItemKind.WAYPOINT, 6.0, 0.0, 4.0),
        rq.MissionItem(rq.ItemKind.LEFT_OUT),
        rq.MissionItem(rq.ItemKind.LAND),
        rq.MissionItem(rq.ItemKind.LEFT_OUT),
    )
    with Flight() as flight:
        flight.fly(1.1)
        flight.ok(rq.MissionUpload(items), rq.MissionStart(), rq.Arm())
        flight.fly(80.0, lambda: flight.pilot.landed is LandedState.ON_GROUND and flight.now > 10.0)
        north, east, _ = flight.samples[-1].state.position
        assert hypot(north - 6.0, east) < 1.0
