"""Missions as stations write them, from the ground to the last item: a file of MAVProxy, landings on the way."""

from __future__ import annotations

from math import hypot

import pytest
from failsafe_flights import Flight
from long_cases import long_after

from cosim.base.geodesy import Geodesy
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import MissionItem
from cosim.groundstation.mavlink.services.items import Item, to_mission_item

# As MAVProxy and Mission Planner write it: item 0 is home, with its height of 0.
QGC_WPL = """QGC WPL 110
0	1	0	16	0	0	0	0	22.3500000	113.5900000	0.000000	1
1	0	3	22	0	0	0	0	0.0000000	0.0000000	8.000000	1
2	0	3	16	0	0	0	0	22.3500900	113.5900000	8.000000	1
3	0	3	16	0	0	0	0	22.3500900	113.5900970	8.000000	1
4	0	3	20	0	0	0	0	0.0000000	0.0000000	0.000000	1
"""
GEODESY = Geodesy(22.35, 113.59, 12.0)
LAND = MissionItem("land")
FLOWN = ("hexjet-p220", "hexjet", "hexjet-100", "quadrotor", "octojet", "quadjet", "trijet", "jetwing")


def read_waypoints(text: str) -> tuple[MissionItem, ...]:
    items = []
    for line in text.splitlines()[1:]:
        _, _, frame, command, *params, north, east, height, go_on = line.split("\t")
        at = round(1e7 * float(north)), round(1e7 * float(east)), float(height)
        p1, p2, p3, p4 = map(float, params)
        items.append(to_mission_item(Item(int(frame), int(command), (p1, p2, p3, p4), *at, int(go_on)), GEODESY, 0.0))
    return tuple(items)


def on_the_ground(aircraft: str) -> Flight:
    flight = Flight(aircraft, initial={"on_ground": True})
    flight.fly(1.1)
    return flight


def texts(flight: Flight) -> list[str]:
    return [message.text for message in flight.pilot.messages]


def begin(flight: Flight, *items: MissionItem) -> None:
    flight.ok(rq.MissionUpload(items), rq.Arm(), rq.MissionStart())


@pytest.mark.parametrize("aircraft", long_after(1, FLOWN))
def test_a_file_whose_first_item_is_home_is_flown_to_its_end(aircraft: str) -> None:
    """At that item hexjet-p220 lost its barometer on its legs, and jetwing stood there until its fuel was low."""
    with on_the_ground(aircraft) as flight:
        begin(flight, *read_waypoints(QGC_WPL))
        assert "mission item 0: below 1 m above the ground, flown at that height" in texts(flight)
        touched: list[float] = []

        def done() -> bool:
            if flight.pilot.landed is LandedState.IN_AIR and flight.simulation.state.on_ground:
                touched.append(hypot(*flight.simulation.state.position[:2]))
            return not flight.pilot.armed

        flight.fly(150.0, done)
        assert flight.pilot.mission.done
        assert max(touched, default=0.0) < 1.5  # nowhere but at home
        assert not any("lost" in text or "not flown" in text for text in texts(flight))
        assert flight.simulation.state.on_ground


@pytest.mark.parametrize(
    "pause", [(MissionItem("delay", hold_s=4.0), MissionItem("takeoff", altitude=2.5)), ()], ids=["delay", "waypoint"]
)
def test_a_landing_on_the_way_goes_on_as_the_list_says(pause: tuple[MissionItem, ...]) -> None:
    """It was disarmed at the first landing, two seconds after the touch, with the rest of the list unflown."""
    with on_the_ground("hexjet") as flight:
        begin(flight, MissionItem("takeoff", altitude=2.5), LAND, *pause, MissionItem("waypoint", 3.0, 0.0, 2.5), LAND)
        flight.fly(40.0, lambda: flight.pilot.mission.current == 2)
        stood = flight.simulation.k
        flight.fly(20.0, lambda: flight.pilot.landed is not LandedState.ON_GROUND)
        waited = (flight.simulation.k - stood) * flight.simulation.dt
        assert waited == pytest.approx(4.0 if pause else 0.0, abs=0.1)
        flight.fly(60.0, lambda: not flight.pilot.armed)
        assert flight.pilot.mission.done
        assert hypot(flight.simulation.state.position[0] - 3.0, flight.simulation.state.position[1]) < 1.0
        assert texts(flight).count("landed") == 2


def test_a_target_at_the_ground_is_a_landing() -> None:
    """Where its set-point was in the ground before it was there, it stood at hover thrust until the tank was empty."""
    with on_the_ground("jetwing") as flight:
        flight.ok(rq.Arm(), rq.Takeoff(1.0))
        flight.fly(30.0, lambda: flight.pilot.mode is Mode.HOLD)
        ground = rq.OffboardPosition(0.0, 0.0, 0.0)
        flight.ok(ground, rq.SetMode("OFFBOARD"))

        def stood() -> bool:
            if flight.simulation.k % 25 == 0:
                flight.ok(ground)
            return flight.pilot.landed is LandedState.ON_GROUND

        flight.fly(30.0, stood)


def test_engines_that_idled_at_the_start_start_again_when_armed_again() -> None:
    """The second take-off waited for no start, and ten seconds later every turbine counted as failed."""
    with on_the_ground("hexjet-100") as flight:
        flight.ok(rq.Arm(), rq.Disarm())
        flight.fly(0.1)
        flight.ok(rq.Arm(), rq.Takeoff(2.0))
        flight.fly(40.0, lambda: flight.pilot.landed is LandedState.IN_AIR)
        assert not flight.simulation.controller.lost
        assert [text for text in texts(flight) if "engine" in text] == ["the engines start", "all engines run"]
