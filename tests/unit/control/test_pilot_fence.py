"""The fence that is drawn, rally points and circles: geometry against others, and what is refused."""

from __future__ import annotations

import itertools
from dataclasses import replace
from math import hypot, sqrt

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from pilot_flights import Flight

from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.fence import edge_distance, measure_excess
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.requests import FenceUpload, FenceZone, ZoneKind

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
def test_distances_to_a_fence_are_as_by_hand(zone: FenceZone, place: tuple[float, float], distance: float) -> None:
    assert edge_distance(zone, *place) == pytest.approx(distance, abs=1e-12)


coordinate = st.floats(-50.0, 50.0)


@settings(max_examples=200)
@given(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=7), coordinate, coordinate)
@example([(32.87522405871954, 0.0)] * 3, -50.0, 48.07809698266905)  # no edge has a length
def test_inside_is_an_odd_winding(corners: list[tuple[float, float]], north: float, east: float) -> None:
    """The sign against the angles under which the edges are seen, an independent rule; the size against samples."""
    zone = FenceZone(IN, tuple(corners))
    distance = edge_distance(zone, north, east)
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
    assert nearest <= abs(distance) + longest / 399 + 1e-9


def test_who_is_inside_one_zone_and_outside_all_holes_is_inside() -> None:
    far = FenceZone(CIRCLE, ((100.0, 0.0),), 5.0)
    hole = FenceZone(HOLE, ((0.0, 0.0),), 3.0)
    zones = (SQUARE, far, hole)
    assert measure_excess(zones, 5.0, 5.0) == (0.0, "")
    assert measure_excess(zones, 100.0, 4.0) == (0.0, "")
    assert measure_excess(zones, 14.0, 0.0) == (4.0, "4 m outside the zone to stay in")
    assert measure_excess(zones, 0.0, 1.0) == (2.0, "2 m inside zone 2, to stay out of")
    assert measure_excess((hole,), 50.0, 0.0) == (0.0, "")
    assert measure_excess((), 1e5, 0.0) == (0.0, "")


@pytest.mark.parametrize("start", [(0.0, 0.0), (12.0, 0.0), (-40.0, 25.0), (5.0, 6.0)])
@pytest.mark.parametrize("clockwise", [True, False])
def test_a_set_point_on_a_circle(start: tuple[float, float], clockwise: bool) -> None:
    """From anywhere to the circle without passing it, then along it at the speed asked for."""
    tracker = Tracker(2.0, 4.0, 0.004)
    tracker.start(start, (0.0, 0.0))
    centre, radius, speed = (5.0, 6.0), 10.0, 2.5
    tracks = [tracker.around(centre, radius, speed, clockwise) for _ in range(round(60.0 / 0.004))]
    away = np.array([hypot(t.position[0] - centre[0], t.position[1] - centre[1]) for t in tracks])
    first = hypot(start[0] - centre[0], start[1] - centre[1])
    assert np.all(away <= max(first, radius) + 0.6)
    assert np.all(away >= min(first, radius) - 0.6)
    late = tracks[-4000:]
    # the mean over 0.5 s cuts the corner: sin(x) / x with x = 0.25 s 0.25 rad/s
    assert away[-4000:] == pytest.approx(radius, abs=0.05)
    assert [hypot(*t.velocity) for t in late] == pytest.approx([speed] * 4000, abs=0.02)
    assert [hypot(*t.acceleration) for t in late] == pytest.approx([speed**2 / radius] * 4000, abs=0.02)
    n, e = late[-1].position[0] - centre[0], late[-1].position[1] - centre[1]
    turning = n * late[-1].velocity[1] - e * late[-1].velocity[0]
    assert (turning > 0.0) is clockwise  # north to east is to the right


def test_a_small_circle_is_flown_slower() -> None:
    """Half of the acceleration is left for what is off: v^2 / R = a / 2."""
    tracker = Tracker(2.0, 4.0, 0.004)
    tracker.start((2.0, 0.0), (0.0, 0.0))
    tracks = [tracker.around((0.0, 0.0), 2.0, 9.0, True) for _ in range(8000)]
    # the mean over 0.5 s: x = 0.25 s sqrt(1 / 2) rad/s
    assert hypot(*tracks[-1].velocity) == pytest.approx(sqrt(2.0), rel=0.01)


def test_a_circle_of_a_mission_that_leaves_the_fence_is_refused() -> None:
    inside = rq.MissionItem(rq.ItemKind.CIRCLE, 0.0, 0.0, 5.0, radius=9.0)
    with Flight() as flight:
        flight.fly(1.1)
        flight.ok(FenceUpload((SQUARE,)), rq.MissionUpload((inside,)))
        answer = flight.ask(rq.MissionUpload((inside, replace(inside, north=5.0))))
        assert "mission item 1 refused: 4 m outside" in answer.text


def test_orbits_that_cannot_be_flown_are_refused() -> None:
    with Flight() as flight:
        flight.fly(1.1)
        assert "on the ground" in flight.ask(rq.Orbit(5.0)).text
        flight.take_off(5.0)
        flight.ok(FenceUpload((SQUARE,)))
        assert "orbit refused: 5 m outside" in flight.ask(rq.Orbit(15.0)).text
        assert "m/s" in flight.ask(rq.Orbit(5.0, speed=99.0)).text
        assert "above the ground" in flight.ask(rq.Orbit(5.0, altitude=0.2)).text
        assert not flight.ask(rq.SetMode("ORBIT")).accepted
        assert flight.pilot.mode is Mode.HOLD
