"""Fuel and battery to the ground: the way down is begun while it can be flown, and what cannot is said or refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import pytest
from failsafe_flights import Flight

from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.guidance.descent import descent_for
from cosim.control.autopilot.modes import Mode
from cosim.control.autopilot.requests import MissionItem, Result

OVERRIDDEN = (Mode.RTL, Mode.LAND)


def texts(flight: Flight) -> list[str]:
    return [message.text for message in flight.pilot.messages]


def said(flight: Flight, part: str) -> bool:
    return any(part in text for text in texts(flight))


def airborne(aircraft: str, height: float, fuel: float, **changes: Any) -> Flight:
    return Flight(aircraft, height, initial={"altitude_m": height, "fuel": fuel}, **changes)


def land(flight: Flight, seconds: float) -> None:
    """To the ground and disarmed, within the limits of touch-down, with fuel left."""
    flight.fly(seconds, lambda: not flight.pilot.armed)
    assert flight.simulation.state.on_ground
    assert flight.pilot.status.remaining is not None
    assert flight.pilot.status.remaining > 0.0


@pytest.mark.parametrize(
    ("aircraft", "height", "fuel"),
    [
        ("hexjet-p220", 100.0, 0.21),
        *(
            pytest.param(aircraft, height, fuel, marks=pytest.mark.long)
            for aircraft, height, fuel in (
                ("hexjet-p220", 300.0, 0.45),
                ("hexjet-100", 100.0, 0.3),
                ("octojet", 300.0, 0.7),
                ("quadjet", 100.0, 0.3),
                ("trijet", 100.0, 0.55),
                ("jetwing", 100.0, 0.55),
            )
        ),
    ],
)
def test_the_way_down_is_begun_while_the_fuel_for_it_is_there(aircraft: str, height: float, fuel: float) -> None:
    """From 300 m hexjet-p220 landed at 8 % and fell the last 56 m with a dry tank, at 33 m/s."""
    with airborne(aircraft, height, fuel) as flight:
        flight.fly(300.0, lambda: flight.pilot.mode is not Mode.HOLD)
        assert flight.pilot.mode in OVERRIDDEN
        assert said(flight, "fuel for the way down: ") or said(flight, "energy low (20 %)")
        land(flight, 500.0)


def test_a_small_tank_is_known_by_how_fast_it_empties() -> None:
    """With 1.5 kg, 50 s of hover, the engines stopped at 0.46 m: 8 % were 4 s."""
    with Flight("hexjet-p220", initial={"on_ground": True}, vehicle={"fuel": {"mass_kg": 1.5}}) as flight:
        flight.fly(1.1)
        flight.ok(rq.Arm(), rq.Takeoff(10.0))
        land(flight, 100.0)
        assert said(flight, "fuel for the way down: ")


def hold_against(flight: Flight, times: int) -> Callable[[], bool]:
    """Ask for HOLD a second after it returns or lands by itself, so often; True when disarmed."""
    left, since = [times], [0]

    def look() -> bool:
        since[0] = since[0] + 1 if flight.pilot.mode in OVERRIDDEN else 0
        if left[0] and since[0] * flight.simulation.dt > 1.0:
            left[0] -= 1
            flight.ok(rq.Hold())
        return not flight.pilot.armed

    return look


def test_a_landing_that_is_taken_over_is_warned_of_and_begun_again_at_the_last_moment() -> None:
    """HOLD took over, nothing more was said until the engines stopped."""
    with airborne("hexjet-p220", 20.0, 0.09) as flight:
        flight.fly(300.0, hold_against(flight, 2))
        assert flight.simulation.state.on_ground
        assert flight.pilot.status.remaining
        assert said(flight, "landing taken over: fuel for the way down: 3 %, ")
        assert said(flight, "last fuel for the way down: ")


def test_engines_that_stop_for_want_of_fuel_say_so() -> None:
    with airborne("hexjet-p220", 10.0, 0.012) as flight:
        look = hold_against(flight, 9)
        flight.fly(30.0, lambda: look() or said(flight, "is gone"))
        assert flight.pilot.status.remaining == 0.0
        flight.fly(0.5, lambda: any("failed" in text and "fuel is gone" in text for text in texts(flight)))


@pytest.mark.parametrize("aircraft", ["hexjet", "quadrotor"])
def test_without_a_tank_and_a_stated_endurance_there_is_no_such_failsafe(aircraft: str) -> None:
    with Flight(aircraft, 300.0) as flight:
        flight.fly(2.0)
        assert flight.pilot.status.remaining is None
        assert flight.pilot.mode is Mode.HOLD
        # a battery is one where the station says for how long it lasts
        flight.ok(rq.SetParameter("HJ_ENDURANCE", 100.0))
        flight.fly(0.5, lambda: flight.pilot.mode in OVERRIDDEN)
        assert said(flight, "battery for the way down: ")


@pytest.mark.parametrize("height", [0.5, 3.0, 5.0, 40.0, 300.0])
@pytest.mark.parametrize("aircraft", ["hexjet", "hexjet-p220"])
def test_the_time_of_the_descent_is_that_of_its_profile(aircraft: str, height: float) -> None:
    """The sum of dh over the rate that the set-point may have, and what is added for its begin and its end."""
    with Flight(aircraft) as flight:
        pilot = flight.pilot
        p, limits = pilot.parameters, pilot._course.guide.limits
        end, slow, pieces = p["MPC_LAND_SPEED"], p["HJ_LAND_SLOW_H"], 20_000
        time = 0.0
        for n in range(pieces):
            h = height * (n + 0.5) / pieces
            rate = end if h < slow else min(p["HJ_DESC_AUTO"], descent_for(h - slow, limits.braking, limits.late, end))
            time += height / pieces / rate
        assert pilot.energy.down(height) - limits.late - 3.0 == pytest.approx(time, rel=2e-3)


@pytest.mark.parametrize("aircraft", ["hexjet-p220", "trijet"])
def test_what_is_asked_for_beyond_the_fuel_is_refused_or_said_with_the_numbers(aircraft: str) -> None:
    far = MissionItem("waypoint", 400.0, 0.0, 10.0)
    up, near = MissionItem("takeoff", altitude=400.0), MissionItem("waypoint", 5.0, 0.0, 10.0)
    with Flight(aircraft, initial={"on_ground": True, "fuel": 0.3}) as flight:
        flight.fly(1.1)
        flight.ok(rq.Arm())
        answer = flight.ask(rq.Takeoff(400.0))
        assert answer.result is Result.DENIED
        assert "take-off refused: 400 m: fuel for there and back with its margin: " in answer.text
        assert answer.text.endswith("30 % left")
        flight.ok(rq.MissionUpload((up, near)))
        answer = flight.ask(rq.MissionStart())
        assert answer.result is Result.DENIED
        assert "mission refused: item 0: fuel for there" in answer.text
        flight.ok(rq.MissionUpload((near, *itertools.repeat(far, 3))), rq.MissionStart())
        assert said(flight, "mission: it returns before item 1: fuel for there and back with its margin: ")


def test_a_place_in_the_air_that_the_fuel_does_not_do_for_is_said() -> None:
    with airborne("hexjet-p220", 10.0, 0.5) as flight:
        flight.fly(1.0)
        flight.ok(rq.Goto(20.0, 0.0))
        assert not said(flight, "goto")
        flight.ok(rq.Goto(20.0, 0.0, altitude=400.0))
        assert said(flight, "goto: fuel for there and back with its margin: ")
