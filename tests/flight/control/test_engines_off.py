"""Engines are off until the vehicle is armed, come up before it leaves the ground, and may be started again."""

from __future__ import annotations

from math import hypot
from typing import Any

import pytest
from pilot_flights import Flight

from cosim.base.errors import InputError
from cosim.base.protocols import EngineState
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.estimation.wind import estimate_wind
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.spec.scenario import Scenario


class Waiting(Flight):
    """A vehicle as a ground station finds it."""

    def __init__(self, **changes: Any) -> None:
        super().__init__(requests="requests.jsonl", initial={"on_ground": True, "engines": "off"}, **changes)

    def said(self) -> list[str]:
        return [message.text for message in self.pilot.messages]

    def thrust(self) -> tuple[float, ...]:
        return self.samples[-1].engines.thrust


@pytest.mark.parametrize(
    ("aircraft", "engine", "idle_n", "seconds"),
    [("hexjet", "edf-as-flown", 1.0, 0.4), pytest.param("octojet", "turbine-100", 7.1, 60.0, marks=pytest.mark.long)],
)
def test_off_until_armed_and_again_after_a_landing(aircraft: str, engine: str, idle_n: float, seconds: float) -> None:
    """A fan is up after its delay and lag, a turbine after its start: the take-off waits for it, twice."""
    controller = "smith" if aircraft == "hexjet" else "baseline"
    with Waiting(aircraft=aircraft, engine=engine, controller=controller) as flight:
        pilot = flight.pilot
        flight.fly(1.2)
        assert pilot.engines is EngineState.OFF
        # a turbine has run down for a minute before
        assert max(newton for sample in flight.samples for newton in sample.engines.thrust) < 1e-6 * idle_n
        assert pilot.refusals() == ()
        for _ in range(2):
            flight.ok(rq.Arm(), rq.Takeoff(4.0))
            flight.fly(seconds, lambda: flight.said()[-1] == "all engines run")
            assert "the engines start" in flight.said()
            # nothing left the ground, and no engine was asked for more than it idles with, before all were up
            assert (
                max(sample.state.altitude for sample in flight.samples[-50:]) < flight.samples[0].state.altitude + 0.01
            )
            assert flight.thrust() == pytest.approx((idle_n,) * len(flight.thrust()), rel=0.15)
            flight.fly(60.0, lambda: pilot.mode is Mode.HOLD)
            assert pilot.landed is LandedState.IN_AIR
            flight.ok(rq.Land())
            flight.fly(60.0, lambda: not pilot.armed)
            assert pilot.engines is EngineState.OFF
            flight.fly(8.0)
            assert max(flight.thrust()) < 0.01 * idle_n


def test_who_stands_armed_is_not_disarmed_while_the_engines_start() -> None:
    """The wait begins when all engines run; who is disarmed meanwhile is not told that they do."""
    with Waiting(aircraft="octojet", engine="turbine-100", controller="baseline") as flight:
        flight.fly(1.2)
        flight.ok(rq.SetParameter("HJ_DISARM_IDLE", 5.0), rq.Arm())
        flight.fly(60.0, lambda: "all engines run" in flight.said())
        up = flight.now
        assert up > 10.0
        flight.fly(10.0, lambda: not flight.pilot.armed)
        assert flight.now - up == pytest.approx(5.0, abs=0.01)
        flight.ok(rq.Arm())
        flight.fly(2.0)
        flight.ok(rq.Disarm())
        flight.fly(2.0)
        assert flight.said().count("all engines run") == 1
        assert flight.said()[-1] == "disarmed"


@pytest.mark.long
def test_an_engine_that_fails_while_it_starts_is_no_reason_to_wait_for_ever() -> None:
    """After two minutes the engine is left to the monitor, which reports it."""
    with Waiting(
        aircraft="octojet", engine="turbine-100", controller="baseline", monitor=True, duration_s=400.0
    ) as flight:
        flight.fly(1.2)
        flight.ok(rq.SetParameter("SYS_FAILURE_EN", 1.0), rq.SetParameter("HJ_DISARM_IDLE", 0.0), rq.Arm())
        flight.fly(1.0)
        flight.ok(rq.InjectFault("flame_out", (1,)))
        flight.fly(135.0)
        assert flight.pilot.armed
        assert "all engines run" in flight.said()
        assert not flight.ask(rq.Takeoff(4.0)).accepted


def test_a_scenario_without_an_autopilot_cannot_leave_its_engines_off() -> None:
    for initial in ({"on_ground": True, "engines": "off"}, {"engines": "off"}):
        with pytest.raises(InputError, match=r'initial\.engines = "off": only on the ground, and with an autopilot'):
            Scenario.load("hover").replace(initial=initial)


@pytest.mark.parametrize(
    ("aircraft", "engine", "wind"), [("hexjet", "edf-as-flown", 5.0), ("hexjet-p220", "p220", 8.0)]
)
def test_the_wind_is_estimated_from_what_pushes(aircraft: str, engine: str, wind: float) -> None:
    """After the time in which the push is learnt it is the true wind, to the receiver's and the mass's doubt."""
    air = {"wind_ned_m_s": (0.6 * wind, -0.8 * wind, 0.0)}
    controller = "smith" if aircraft == "hexjet" else "baseline"
    with Flight(airborne=True, aircraft=aircraft, engine=engine, controller=controller, environment=air) as flight:
        vehicle = flight.simulation.vehicle
        flight.ok(rq.Hold())
        flight.fly(2.0)
        early = _estimate(flight)
        flight.fly(30.0)
        assert hypot(early[0] - 0.6 * wind, early[1] + 0.8 * wind) > 0.3 * wind  # nobody told it
        late = _estimate(flight)
        assert hypot(late[0] - 0.6 * wind, late[1] + 0.8 * wind) < 0.12 * wind
        assert (
            estimate_wind(vehicle, (0.0, 0.0), (1.0, 0.0), (0.0, 0.0, 0.0), flight.samples[-1].engines.thrust, 1.2)
            is None
        )


def _estimate(flight: Flight) -> tuple[float, float]:
    fix, thrust = flight.pilot.status.fix, flight.samples[-1].engines.thrust
    wind = estimate_wind(flight.simulation.vehicle, fix.disturbance, fix.velocity, (0.0, 0.0, 0.0), thrust, 1.225)
    assert wind is not None
    return wind
