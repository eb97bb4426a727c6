"""The fence that is drawn, rally points and circles, in flight."""

from __future__ import annotations

from math import atan2, hypot, pi

import numpy as np
import pytest
from long_cases import long_after
from pilot_flights import Flight

from cosim.base.signals import State
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.geometry import wrap
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import FenceUpload, FenceZone, RallyPoint, RallyUpload, ZoneKind

IN, OUT, CIRCLE, HOLE = ZoneKind
SQUARE = FenceZone(IN, ((-10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (10.0, -10.0)))


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


@pytest.mark.parametrize("yaw", long_after(1, rq.OrbitYaw))
def test_an_orbit_is_flown(yaw: rq.OrbitYaw) -> None:
    with Flight() as flight:
        flight.take_off(6.0)
        flight.ok(rq.Orbit(8.0, True, 2.0, 10.0, 0.0, 7.0, yaw, 1.0))
        assert flight.pilot.status.orbit is not None
        begin = len(flight.samples)
        flight.fly(90.0, lambda: flight.pilot.mode is Mode.HOLD)
        assert "orbit complete" in [message.text for message in flight.pilot.messages]
        flown = [sample.state for sample in flight.samples[begin:]]
        on = [state for state in flown if abs(hypot(state.position[0] - 10.0, state.position[1]) - 8.0) < 0.5]
        assert len(on) * flight.simulation.dt > 20.0  # 2 pi 8 m at 2 m/s are 25 s
        assert on[-1].altitude == pytest.approx(7.0, abs=0.3)
        n, e, heading = flown[-1].position[0] - 10.0, flown[-1].position[1], flown[-1].euler[2]
        bearing = atan2(e, n)
        wanted = {rq.OrbitYaw.CENTRE: bearing + pi, rq.OrbitYaw.TANGENT: bearing + 0.5 * pi, rq.OrbitYaw.AS_IT_IS: 0.0}
        assert abs(wrap(heading - wanted[yaw])) < 0.35
        assert flight.pilot.status.orbit is None


def test_a_mission_circles_changes_its_height_and_stays() -> None:
    """Loiter in turns, to an altitude here and elsewhere, and for good, after which only another item goes on."""
    kinds = rq.ItemKind
    items = (
        rq.MissionItem(kinds.TAKEOFF, altitude=3.0),
        rq.MissionItem(kinds.CIRCLE, 4.0, 0.0, 3.0, radius=4.0, clockwise=False, turns=1.0),
        rq.MissionItem(kinds.DELAY, hold_s=4.0),
        rq.MissionItem(kinds.ALTITUDE, altitude=5.0),
        rq.MissionItem(kinds.ALTITUDE, 3.0, 3.0, 4.0),
        rq.MissionItem(kinds.STAY, 0.0, 3.0, 4.0),
        rq.MissionItem(kinds.LAND),
    )
    with Flight() as flight:
        pilot, simulation = flight.pilot, flight.simulation
        flight.fly(1.1)
        flight.ok(rq.MissionUpload(items), rq.MissionStart(), rq.Arm())

        def fly_to(item: int) -> list[State]:
            begin = len(flight.samples)
            flight.fly(60.0, lambda: pilot.mission.current == item)
            return [sample.state for sample in flight.samples[begin:]]

        fly_to(1)
        round_it = fly_to(2)
        bearings = np.unwrap([atan2(state.position[1], state.position[0] - 4.0) for state in round_it])
        # it begins on the circle; the turn counts from where it is within a metre of it
        assert bearings[-1] - bearings[0] == pytest.approx(-2.0 * pi, abs=0.8)
        assert np.median([hypot(s.position[0] - 4.0, s.position[1]) for s in round_it]) == pytest.approx(4.0, abs=0.3)
        fly_to(3)
        assert flight.away(4.0, 0.0) > 3.0  # it stops on the circle, and does not go to its centre
        climb = fly_to(4)
        assert climb[-1].altitude == pytest.approx(5.0, abs=0.5)
        assert flight.away(*climb[0].position[:2]) < 2.0  # it stops first, from what the circle allows
        down = fly_to(5)
        # first there, at the height that it had, then down
        far = [s for s in down if hypot(s.position[0] - 3.0, s.position[1] - 3.0) > 2.0]
        assert far
        assert min(state.altitude for state in far) > 4.5
        assert down[-1].altitude == pytest.approx(4.0, abs=0.5)
        flight.fly(15.0)
        assert pilot.mission.current == 5
        assert pilot.mode is Mode.MISSION
        assert flight.away(0.0, 3.0) < 0.5
        flight.ok(rq.MissionSetCurrent(6))
        flight.fly(40.0, lambda: pilot.landed is LandedState.ON_GROUND)
        assert simulation.state.altitude < 0.5
