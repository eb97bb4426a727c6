"""The autopilot in six degrees of freedom: take-off to landing, wind, mission, sticks, set-points, failures."""

from __future__ import annotations

import itertools
from math import hypot, radians

import pytest
from long_cases import long_after
from pilot_flights import Flight

from cosim.base.errors import InputError
from cosim.base.frames import from_euler
from cosim.base.protocols import EngineState
from cosim.base.signals import Sample
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.control.autopilot.requests import MissionItem
from cosim.simulation.autopilot_setup import attach_autopilot, make_fault
from cosim.simulation.build import build
from cosim.spec.scenario import Fault, FlameOut, Scenario, SensorBias
from cosim.spec.vehicle import load_vehicle

STANDING = 0.125


def test_from_the_ground_to_a_place_and_back() -> None:
    """Take-off to 10 m, 30 m to the east (the late roll axis), hold, return, land, disarm."""
    with Flight() as flight:
        pilot, simulation = flight.pilot, flight.simulation
        assert pilot.engines is EngineState.IDLE
        flight.take_off(10.0)
        assert [flight.samples[k].state.on_ground for k in (0, -1)] == [True, False]
        assert simulation.state.altitude == pytest.approx(10.0 + STANDING, abs=0.5)
        flight.fly(3.0)
        assert simulation.state.altitude == pytest.approx(10.0 + STANDING, abs=0.2)
        # the receiver's 0.3 m, averaged for some seconds, is what home and places are off by
        assert flight.away(0.0, 0.0) < 0.4
        begun = len(flight.samples)
        flight.ok(rq.Goto(0.0, 30.0))
        # d/v + v/2a + v/2b + a/j of the set-point, and a second for the vehicle to follow
        flight.fly(30 / 4.0 + 4.0 / 3.0 + 4.0 / 2.25 + 1.0 + 1.0)
        assert flight.away(0.0, 30.0) < 0.6
        flight.fly(4.0)
        assert flight.away(0.0, 30.0) < 0.4
        states = [sample.state for sample in flight.samples[begun:]]
        assert max(state.position[1] for state in states) < 30.0 + 0.5
        assert max(hypot(*state.velocity[:2]) for state in states) < 4.0 * 1.15
        assert radians(8.0) < max(abs(state.euler[0]) for state in states) < radians(16.0)
        flight.ok(rq.SetParameter("HJ_DESC_AUTO", 2.0), rq.SetParameter("HJ_SPEED_DN", 2.0))
        flight.ok(rq.ReturnHome())
        back = len(flight.samples)
        flight.fly(60.0, lambda: pilot.landed is LandedState.ON_GROUND)
        assert max(sample.state.altitude for sample in flight.samples[back:]) == pytest.approx(15.0 + STANDING, abs=0.5)
        assert (pilot.armed, pilot.engines) == (True, EngineState.IDLE)
        flight.fly(2.1)
        assert (pilot.armed, pilot.mode, flight.ending) == (False, Mode.HOLD, None)
        assert flight.away(0.0, 0.0) < 0.7
        assert 0.2 < flight.descent(back) < 0.8
        # standing: least throttle, and nothing turns the tilts
        assert set(flight.samples[-1].actuation.throttle) == {simulation.vehicle.control.allocation.throttle_min}
        assert flight.samples[-1].actuation.tilt == (0.0, 0.0)


@pytest.mark.parametrize("aircraft", long_after(1, ["hexjet-p220", "hexjet-100"]))
def test_the_larger_ones_take_off_and_hold(aircraft: str) -> None:
    """As they come: their own engine, their own gains."""
    with Flight(aircraft=aircraft, engine=load_vehicle(aircraft)[0].engine) as flight:
        begin = flight.simulation.state.altitude
        flight.take_off(5.0)
        flight.fly(6.0)
        assert flight.ending is None
        assert flight.simulation.state.altitude == pytest.approx(begin + 5.0, abs=0.7)
        # the receiver's 0.3 m, that home is off by, and what it drifts before the slow law has taken hold
        assert flight.away(0.0, 0.0) < 1.0


def test_it_takes_off_holds_and_lands_in_8_m_s_of_wind() -> None:
    """Drag of 0.5 rho A V^2 / m = 0.36 m/s^2 from the moment the legs are free, on the late axis."""
    with Flight(environment={"wind_ned_m_s": [0.0, 8.0, 0.0]}) as flight:
        flight.take_off(4.0)
        flight.fly(12.0)
        away = [hypot(*sample.state.position[:2]) for sample in flight.samples]
        assert 0.3 < max(away) < 1.5
        start = len(flight.samples)
        flight.fly(6.0)
        assert max(hypot(*sample.state.position[:2]) for sample in flight.samples[start:]) < 0.8
        assert all(hypot(*sample.state.velocity[:2]) < 0.2 for sample in flight.samples[start:])
        # it leans into the wind just as the drag asks
        push = 0.5 * 1.2 * 0.052 * 64.0 / 5.525
        assert flight.simulation.state.euler[0] == pytest.approx(-push / 9.80665, abs=radians(0.5))
        assert flight.pilot.status.fix.disturbance[1] == pytest.approx(push, rel=0.2)
        flight.ok(rq.Land())
        flight.fly(20.0, lambda: flight.pilot.landed is LandedState.ON_GROUND)
        assert flight.descent(start) < 0.8
        assert hypot(*flight.simulation.state.position[:2]) < 1.0
        assert flight.ending is None


MISSION = (
    MissionItem("takeoff", altitude=5.0),
    MissionItem("waypoint", 8.0, 0.0, 5.0),
    MissionItem("waypoint", 8.0, 8.0, 6.0, hold_s=1.0),
    MissionItem("speed", speed=2.0),
    MissionItem("waypoint", 0.0, 8.0, 6.0, yaw=1.0),
    MissionItem("waypoint", 0.0, 0.0, 4.0),
    MissionItem("land"),
)


def test_a_mission_of_four_waypoints() -> None:
    with Flight() as flight:
        pilot = flight.pilot
        flight.fly(1.1)
        flight.ok(rq.MissionUpload(MISSION), rq.MissionStart(), rq.Arm())
        reached: dict[int, tuple[float, float, float]] = {}

        def done() -> bool:
            x, y, _ = flight.simulation.state.position
            reached.setdefault(pilot.mission.reached, (x, y, flight.simulation.state.altitude))
            return not pilot.armed

        flight.fly(90.0, done)
        assert list(reached) == [-1, 0, 1, 3, 4, 5, 6]  # the change of speed is over at once
        for index, item in enumerate(MISSION):
            if item.north is not None and item.east is not None and item.altitude is not None:
                x, y, z = reached[index if index != 2 else 3]
                assert hypot(x - item.north, y - item.east) < 1.5 + 0.5
                assert z == pytest.approx(item.altitude, abs=0.6)
        assert flight.away(0.0, 0.0) < 0.8
        assert pilot.status.mission_done
        assert flight.descent(0) < 0.8
        assert flight.ending is None


def test_a_mission_returns_home_and_not_to_where_the_flight_began() -> None:
    """At the height of a return; a second one as well, which does not go where the first has been."""
    with Flight(airborne=True) as flight:
        pilot = flight.pilot
        back = (MissionItem("waypoint", 5.0, 0.0, 10.0), MissionItem("return"))
        flight.ok(rq.SetParameter("RTL_RETURN_ALT", 12.0), rq.SetParameter("HJ_DESC_AUTO", 2.0))
        for north, east in ((12.0, 4.0), (0.0, -6.0)):
            begun = len(flight.samples)
            flight.ok(rq.SetHome(north, east, 0.0), rq.MissionUpload(back), rq.MissionStart())
            flight.fly(60.0, lambda: pilot.mission.current == 1)
            flight.fly(60.0, lambda: flight.simulation.state.altitude < 5.0)
            assert flight.away(north, east) < 1.0
            highest = max(sample.state.altitude for sample in flight.samples[begun:])
            assert highest == pytest.approx(12.0, abs=0.6)
            flight.ok(rq.Hold())


def test_the_same_requests_at_the_same_steps_are_the_same_flight() -> None:
    """To the last bit, with noise, turbulence, a parameter, a predictor and a fault changed on the way."""
    rough = {"turbulence_severity": 3, "turbulence_wind_m_s": 5.0, "wind_ned_m_s": [3.0, 0.0, 0.0]}

    def run() -> list[Sample]:
        with Flight(airborne=True, monitor=True, environment=rough) as flight:
            flight.ok(rq.Goto(10.0, 5.0, 11.0, 1.0))
            flight.fly(2.0)
            flight.ok(rq.SetParameter("HJ_VEL_P", 0.8), rq.SetParameter("HJ_PRED_TYPE", 2))
            flight.fly(1.0)
            flight.ok(rq.SetParameter("SYS_FAILURE_EN", 1), rq.InjectFault("thrust_loss", (3,), amount=0.1))
            flight.fly(1.0)
            return flight.samples

    first, second = run(), run()
    assert repr(first) == repr(second)
    assert len({sample.actuation.throttle for sample in first}) > 900


def test_the_autopilot_starts_again_as_it_began() -> None:
    """Reset gives the same flight; the pilot's log, not its memory, carries what was asked."""
    with Flight(airborne=True) as flight:
        flight.ok(rq.Goto(10.0, 5.0, 11.0))
        flight.fly(1.0)
        first = flight.samples
        flight.samples = []
        flight.simulation.reset()
        flight.ok(rq.Goto(10.0, 5.0, 11.0))
        flight.fly(1.0)
        assert repr(flight.samples) == repr(first)


def test_sticks_take_off_fly_and_land() -> None:
    with Flight() as flight:
        pilot = flight.pilot
        low = rq.Sticks(0.0, 0.0, 0.0, 0.0)
        flight.fly(1.1, every=low)
        flight.ok(rq.SetMode("POSCTL"), rq.Arm())
        flight.fly(0.5, every=low)
        assert pilot.landed is LandedState.ON_GROUND
        flight.fly(5.0, every=rq.Sticks(0.0, 0.0, 0.0, 1.0))
        assert pilot.landed is LandedState.IN_AIR
        # half a stick to the right is half the speed to the east, at a constant height
        flight.fly(4.0, every=rq.Sticks(0.5, 0.0, 0.0, 0.5))
        north, east, _ = flight.simulation.state.velocity
        # less the dead middle of the stick
        assert (north, east) == pytest.approx((0.0, 4.0 * 0.45 / 0.95), abs=0.3)
        height = flight.simulation.state.altitude
        flight.fly(4.0, every=rq.Sticks(0.0, 0.0, 0.0, 0.5))
        stopped = flight.simulation.state.position
        assert hypot(*flight.simulation.state.velocity[:2]) < 0.3
        assert flight.simulation.state.altitude == pytest.approx(height, abs=0.6)
        start = len(flight.samples)
        flight.fly(20.0, lambda: pilot.landed is LandedState.ON_GROUND, every=low)
        assert flight.descent(start) < 0.8
        assert flight.away(stopped[0], stopped[1]) < 0.6
        flight.fly(2.1, every=low)
        assert not pilot.armed


def test_setpoints_from_outside() -> None:
    """Velocity, then a place, then an attitude, each as a companion computer would send it."""
    with Flight(airborne=True) as flight:
        east = rq.OffboardVelocity(0.0, 2.0, -0.5)
        flight.ok(east, rq.SetMode("OFFBOARD"))
        flight.fly(5.0, every=east)
        state = flight.simulation.state
        assert state.velocity == pytest.approx((0.0, 2.0, -0.5), abs=0.25)
        place = rq.OffboardPosition(3.0, state.position[1], -12.0, 0.5)
        flight.fly(8.0, every=place)
        state = flight.simulation.state
        assert (*state.position[:2], state.altitude) == pytest.approx((3.0, place.east, 12.0), abs=0.6)
        assert state.euler[2] == pytest.approx(0.5, abs=0.02)
        attitude = rq.OffboardAttitude(from_euler(0.1, 0.0, 0.5), None, flight.simulation.cascade.allocator.hover)
        flight.fly(2.0, every=attitude)
        assert flight.simulation.state.euler == pytest.approx((0.1, 0.0, 0.5), abs=0.03)
        assert flight.pilot.mode is Mode.OFFBOARD


def test_a_mission_climbs_before_it_leaves() -> None:
    """Without a take-off item the first waypoint's height, or that of a take-off, comes first."""
    with Flight() as flight:
        flight.fly(1.1)
        flight.ok(rq.SetParameter("MIS_TAKEOFF_ALT", 6.0))
        flight.ok(rq.MissionUpload((MissionItem("waypoint", 20.0, 0.0, 8.0),)), rq.MissionStart(), rq.Arm())
        flight.fly(15.0, lambda: flight.simulation.state.position[0] > 1.0)
        assert flight.simulation.state.altitude > 5.5


def test_gains_and_predictor_change_in_hover_without_a_bump() -> None:
    """The torque commands move by no more in the step of the change than noise moves them in any other."""
    changes = {"HJ_PRED_DELAY": 28.0, "HJ_ROLL_P": 0.015, "HJ_ATT_ROLL": 3.0, "HJ_PITCH_P": 0.2, "HJ_VEL_P": 0.7}
    with Flight(airborne=True) as flight:
        flight.ok(rq.Goto(5.0, 5.0))
        flight.fly(2.0)
        quiet = len(flight.samples)
        flight.fly(1.0)

        def jumps(samples: list[Sample]) -> list[float]:
            pairs = itertools.pairwise(samples)
            return [max(abs(b - a) for a, b in zip(p.control.torque, q.control.torque, strict=True)) for p, q in pairs]

        usual = max(jumps(flight.samples[quiet:]))
        for name, value in (("HJ_PRED_TYPE", 2), *changes.items(), ("HJ_PRED_TYPE", 5)):
            at = len(flight.samples)
            flight.ok(rq.SetParameter(name, value))
            flight.fly(0.2)
            assert jumps(flight.samples[at - 1 : at + 2])[0] <= 1.2 * usual, name
        assert flight.ending is None


@pytest.mark.long
def test_the_quadrotor_flies_as_well() -> None:
    """Another vehicle, another step, no model for a predictor's delay to matter."""
    with Flight(aircraft="quadrotor", engine="motor", controller="baseline", step_s=0.0025) as flight:
        flight.take_off(3.0)
        flight.ok(rq.Goto(0.0, 6.0))
        flight.fly(9.0)
        assert flight.away(0.0, 6.0) < 0.5
        assert max(sample.state.position[1] for sample in flight.samples) < 6.6
        flight.ok(rq.Land())
        flight.fly(15.0, lambda: flight.pilot.landed is LandedState.ON_GROUND)
        assert flight.ending is None


@pytest.mark.parametrize(
    ("asked", "fault"),
    [
        (
            rq.InjectFault("flame_out", (2, 3), duration_s=4.0),
            FlameOut(kind="flame_out", start_s=0.0, duration_s=4.0, jet=[2, 3]),
        ),
        (
            rq.InjectFault("sensor_bias", sensor="barometer", amount=2.0),
            SensorBias(kind="sensor_bias", start_s=0.0, sensor="barometer", bias=[2.0]),
        ),
        (
            rq.InjectFault("sensor_bias", sensor="gyro", vector=(0.1, 0.0, 0.0)),
            SensorBias(kind="sensor_bias", start_s=0.0, sensor="gyro", bias=[0.1, 0.0, 0.0]),
        ),
    ],
)
def test_faults_by_request_are_the_scenarios_own(asked: rq.InjectFault, fault: Fault) -> None:
    assert make_fault(asked) == fault


@pytest.mark.parametrize(
    ("request_", "complaint"),
    [
        (rq.InjectFault("melt"), "fault 'melt': must be one of delay_growth, flame_out"),
        (rq.InjectFault("flame_out"), "fault flame_out: jet is missing"),
        (rq.InjectFault("flame_out", (17,)), "fault flame_out: jet.0 = 17"),
        (rq.InjectFault("flame_out", (1,), amount=1.0), "fault flame_out: it has no amount"),
        (rq.InjectFault("thrust_loss", (1,), amount=2.0), "fault thrust_loss: share = 2.0"),
    ],
)
def test_faults_that_there_are_not(request_: rq.InjectFault, complaint: str) -> None:
    with pytest.raises(InputError) as refusal:
        make_fault(request_)
    assert str(refusal.value).startswith(complaint)


def test_a_vehicle_without_gains_for_it_is_refused() -> None:
    scenario = Scenario.load("hover")
    with build(scenario) as simulation:
        control = simulation.vehicle.control.model_copy(update={"position": None})
        simulation.vehicle = simulation.vehicle.model_copy(update={"control": control})
        with pytest.raises(InputError, match=r"vehicle.control.position is missing: hexjet cannot be flown"):
            attach_autopilot(simulation)


def test_gains_too_fast_for_the_attitude_loop_are_refused() -> None:
    """A vehicle with slow engines needs its own; half the attitude gain leaves no phase to speak of."""
    gains = {"control": {"position": {"velocity_1_s": 1.75}}}
    with build(Scenario.load("hover").replace(vehicle=gains)) as simulation:
        with pytest.raises(InputError, match=r"too fast for hexjet, whose attitude gain is 3.5 1/s: at most 1.4"):
            attach_autopilot(simulation)
        assert simulation.pilot is None
