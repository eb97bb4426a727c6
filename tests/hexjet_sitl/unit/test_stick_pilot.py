"""The pilot at the sticks where the autopilot holds place and height by itself."""

from __future__ import annotations

from math import radians

import pytest

from cosim.base.errors import FlightError
from cosim.base.frames import from_euler
from cosim.base.signals import ZERO3, Command, Measured
from cosim.simulation.controllers.models import make_scenario_belief
from cosim.spec.scenario import Scenario
from hexjet_sitl.lockstep import MAX_STICKS_INTERVAL_S, StickPositions
from hexjet_sitl.pilot import MIN_STILL_S, StickPilot

HOVER = Scenario.load("hover")
LEAN, TURN = radians(35.0), radians(150.0)


def measured(altitude: float, heading: float = 0.0) -> Measured:
    return Measured(ZERO3, from_euler(0.0, 0.0, heading), ZERO3, ZERO3, altitude, (0.0, 0.0, -9.8))


def asked(altitude: float, roll: float = 0.0) -> Command:
    return Command((roll, 0.0, 0.0), altitude)


def test_it_lets_go_of_the_sticks_where_the_autopilot_holds_the_place() -> None:
    """From that second on, within the dead zone in which the autopilot holds height and heading too; beyond it asks."""
    pilot = StickPilot(make_scenario_belief(HOVER, {}), LEAN, TURN, hold_from=2.0 * HOVER.step_s)
    for _ in range(2):
        flown = pilot.update(asked(10.0, roll=0.1), measured(10.0), 0.0)
        assert not flown.holds_place
        assert flown.roll == pytest.approx(0.1 / LEAN)
    gain = HOVER.resolved_vehicle()[0].control.altitude.position_1_s
    near, far = 0.25 / gain, 0.9 / gain  # m: a climb of 0.25 m/s is within the zone, one of 0.9 is not
    held = StickPositions(throttle=0.5, armed=True, holds_place=True)
    assert pilot.update(asked(10.0 + near), measured(10.0, radians(2.0)), 0.0) == held
    assert pilot.update(asked(10.0 - far), measured(10.0), 0.0).throttle == pytest.approx(0.35)
    assert pilot.update(asked(30.0), measured(10.0), 0.0).throttle == 1.0
    assert pilot.update(asked(10.0), measured(10.0, radians(90.0)), 0.0).yaw < -0.1
    with pytest.raises(FlightError, match="where the autopilot holds the place its sticks command speed"):
        pilot.update(asked(10.0, roll=0.1), measured(10.0), 0.0)
    pilot.reset()
    assert not pilot.update(asked(10.0), measured(10.0), 0.0).holds_place


def test_it_turns_the_heading_that_the_autopilot_holds_and_not_the_vehicles() -> None:
    """Two loops around one error overshoot: here the vehicle does not follow yet, and the sticks go back all the same."""
    pilot = StickPilot(make_scenario_belief(HOVER, {}), LEAN, TURN, stick_moves_heading=True)
    wanted, held = radians(20.0), round(MAX_STICKS_INTERVAL_S / HOVER.step_s)
    command = Command((0.0, 0.0, wanted), 10.0)
    gain = HOVER.resolved_vehicle()[0].control.attitude.gain_1_s[2]
    turned = [pilot.update(command, measured(10.0), 0.0).yaw * TURN for _ in range(round(1.0 / gain / HOVER.step_s))]
    assert turned[0] == pytest.approx(gain * wanted)
    assert all(turned[k] == turned[k - k % held] for k in range(len(turned)))
    assert sum(turned) * HOVER.step_s == pytest.approx(0.63 * wanted, rel=0.08)
    # in the end the vehicle's own heading counts
    for _ in range(round(60.0 / HOVER.step_s)):
        stick = pilot.update(command, measured(10.0, wanted), 0.0).yaw
    assert stick == pytest.approx(0.0, abs=1e-6)
    pilot.reset()
    assert pilot.update(command, measured(10.0, wanted), 0.0).yaw == pytest.approx(0.0)


def test_it_disarms_no_vehicle_that_hovers() -> None:
    """Asked below the ground for long, a vehicle that an autopilot holds in the air is as still as one that stands."""
    still = round(2.0 * MIN_STILL_S / HOVER.step_s)
    span = HOVER.resolved_vehicle()[0].aero.span_m
    for height, disarmed in ((4.8, False), (1.1 * span, False), (0.9 * span, True)):
        pilot = StickPilot(make_scenario_belief(HOVER, {}), LEAN, TURN)
        flown = [pilot.update(asked(-2.0), measured(height), 0.0).armed for _ in range(still)]
        assert (flown[0], flown[-1]) == (True, not disarmed), height
