"""What may be asked of a vehicle is kept within what its engines can follow: leans, rates, descents, to the edges."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from math import acos, degrees, hypot, radians
from typing import Any

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from long_cases import long_after
from pilot_flights import Flight

from cosim.api.listing import catalogue
from cosim.base.frames import from_euler
from cosim.base.signals import Sample, Vector3
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.guidance.descent import CollectiveFloor, descent_rate, height_limits, thrust_margins
from cosim.control.autopilot.guidance.shaper import AttitudeLimits, Shaper, angular_authority, attitude_limits
from cosim.control.autopilot.modes import LandedState
from cosim.spec.vehicle import load_vehicle

# Every vehicle with an autopilot: with the predictor that a ground station finds, and with the one its gains are for.
FLOWN = (
    ("hexjet", "smith"),
    ("hexjet-100", "smith"),
    ("hexjet-100", "state-disturbance"),
    ("hexjet-p220", "smith"),
    ("hexjet-p220", "baseline"),
    ("quadrotor", "baseline"),
    ("octojet", "smith"),
    ("octojet", "state-disturbance"),
    ("quadjet", "baseline"),
    ("trijet", "baseline"),
    ("jetwing", "baseline"),
)
OTHERS = ("octojet", "quadjet", "trijet", "jetwing")  # layouts of their own, whose pages say that they were flown here
# m, rad/s^2: height lost or gained in altitude mode, and torque refused.  Newton's passes of the allocation by
# effectiveness are counted: now and then they leave 1e-7 rad/s^2; a wing that is thrown to and fro lifts, and its page says so
HELD = {"jetwing": (4.5, 1e-3)}
OVER = 1.2  # of the lean that is asked for: the designs' own bound on the overshoot of a step


def in_the_air(aircraft: str, controller: str, height: float, **changes: Any) -> Flight:
    """Airborne and holding, with the vehicle's own engine."""
    step = {"step_s": 0.0025} if aircraft == "quadrotor" else {}
    return Flight(
        airborne=True,
        aircraft=aircraft,
        engine="edf-as-flown" if aircraft == "hexjet" else load_vehicle(aircraft)[0].engine,
        controller=controller,
        initial={"on_ground": False, "altitude_m": height},
        **step,
        **changes,
    )


def with_sticks(flight: Flight, seconds: float, sticks: Callable[[float], rq.Sticks]) -> list[Sample]:
    """Fly on with the sticks of each instant, 50 times a second; ends early where the flight does."""
    simulation, begun = flight.simulation, len(flight.samples)
    every = round(0.02 / simulation.dt)
    for n in range(round(seconds / simulation.dt)):
        if n % every == 0:
            flight.ok(sticks(n * simulation.dt))
        flight.samples.append(simulation.step())
        flight.ending = simulation.termination.check(simulation.state, flight.now)
        if flight.ending:
            break
    return flight.samples[begun:]


def lean(sample: Sample) -> float:
    """Angle between the thrust and the vertical, rad."""
    _, x, y, _ = sample.state.attitude
    return acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))


def square(t: float, half: float) -> float:
    return 1.0 if int(t / half) % 2 == 0 else -1.0


def test_every_vehicle_with_an_autopilot_is_flown_here() -> None:
    able = {
        name
        for name in (each["name"] for each in catalogue("aircraft"))
        if load_vehicle(name)[0].control.pilot is not None
    }
    assert able == {aircraft for aircraft, _ in FLOWN}


LIMITS = AttitudeLimits(1.2, 4.0, 28.0, 0.8, 2.4, 14.0)
DT = 0.004
ANGLES = st.floats(-0.7, 0.7)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(ANGLES, ANGLES, st.floats(-3.1, 3.1), st.integers(1, 300)), min_size=1, max_size=6))
def test_no_target_moves_the_set_point_beyond_its_limits(targets: list[tuple[float, float, float, int]]) -> None:
    """Rate, acceleration and jerk of the lean as a vector, and of the heading; rates by differences of the angles."""
    shaper = Shaper(LIMITS, DT)
    now: Vector3 = (0.0, 0.0, 0.0)
    given_ = [shaper.attitude((a, b, c), now) for a, b, c, steps in targets for _ in range(steps)]
    leans = [complex(a, b) for a, b, _ in given_]
    turns = [0.0]
    for (_, _, a), (_, _, b) in itertools.pairwise(given_):
        turns.append(turns[-1] + (b - a + 3.141592653589793) % 6.283185307179586 - 3.141592653589793)
    for track, most in ((leans, LIMITS[:3]), ([complex(x) for x in turns], LIMITS[3:])):
        moved: list[complex] = [x - track[0] for x in track]
        # the jerk is twice as much where the acceleration turns round
        for limit in (most[0], most[1], 2.0 * most[2]):
            moved = [(b - a) / DT for a, b in itertools.pairwise(moved)]
            # differences of rounded numbers
            assert max((abs(x) for x in moved), default=0.0) <= limit * (1.0 + 1e-6) + 1e-5 / DT


def test_a_lean_is_reached_in_the_time_of_the_closed_form_and_not_passed() -> None:
    shaper = Shaper(LIMITS, DT)
    D = 0.6
    time = D / 1.2 + 1.2 / (2 * 4.0) + 1.2 / (2 * 0.75 * 4.0) + 4.0 / 28.0
    reached = [shaper.attitude((D, 0.0, 0.0), (0.0, 0.0, 0.0))[0] for _ in range(round(1.5 * time / DT))]
    assert max(reached) <= D + 1e-12
    first = next(k for k, x in enumerate(reached) if x > D - 1e-9)
    assert first * DT == pytest.approx(time, abs=0.03)


def test_the_heading_goes_the_short_way_round() -> None:
    shaper = Shaper(LIMITS, DT)
    now: Vector3 = (0.0, 0.0, 3.0)
    seen = [shaper.attitude((0.0, 0.0, -3.0), now)[2] for _ in range(1000)]
    assert min(abs(yaw) for yaw in seen) > 2.99
    assert seen[-1] == pytest.approx(-3.0)


def test_rates_follow_within_the_same_limits() -> None:
    shaper = Shaper(LIMITS, DT)
    seen = [shaper.rate((5.0, 0.0, -5.0), (0.0, 0.0, 0.0)) for _ in range(500)]
    assert seen[0][0] <= 4.0 * DT
    assert seen[-1] == pytest.approx((1.2, 0.0, -0.8))
    # a lean that is asked for afterwards goes on at that rate from where the vehicle is
    assert shaper.attitude((0.3, 0.0, 0.0), (0.3, 0.0, 0.0))[0] == pytest.approx(0.3 + 1.2 * DT, abs=4.0 * DT * DT)


def test_the_limits_are_those_of_the_loop_or_of_the_torque_that_there_is() -> None:
    gain, plenty = (3.5, 5.0, 3.0), (100.0, 100.0, 100.0)
    limits = attitude_limits(gain, plenty, 0.35, 0.8, (3.8, 3.8, 2.0))
    assert limits[:3] == pytest.approx((3.5 * 0.35, 3.5**2 * 0.35, 3.5**3 * 0.35 / 0.5))
    assert limits[3:] == pytest.approx((0.8, 0.8 * 3.0, 0.8 * 9.0 / 0.5))
    short = attitude_limits(gain, (2.0, 100.0, 0.5), 0.35, 0.8, (1.0, 3.8, 0.4))
    assert (short.rate, short.acceleration, short.jerk) == pytest.approx((1.0, 2.0, 2.0 * 3.5 / 0.5))
    assert (short.yaw_rate, short.yaw_acceleration) == pytest.approx((0.4, 0.5))


def test_the_torque_that_there_is_follows_from_the_vehicle() -> None:
    """The identified roll response of the Hex-Jet: 433 rad/s^2 per throttle; a quarter of what hover leaves of it."""
    vehicle, _ = load_vehicle("hexjet")
    hover = 0.4514
    roll, pitch, yaw = angular_authority(vehicle, hover, 0.0, vehicle.control.attitude.gain_1_s)
    assert roll == pytest.approx(0.25 * (hover - 0.05) * 433.1, rel=1e-3)
    weight = 5.525 * 9.80665
    assert pitch == pytest.approx(0.25 * radians(30.0) * weight * 0.08 / 0.052 / (1.0 + 5.0 * 0.02))
    assert yaw == pytest.approx(0.25 * radians(30.0) * weight * 0.15 / 0.070 / (1.0 + 3.0 * 0.02))


@settings(deadline=None)
@given(st.floats(0.0, 500.0), st.floats(0.1, 20.0), st.floats(0.0, 5.0), st.floats(0.0, 2.0))
def test_a_descent_slows_down_where_it_must(height: float, braking: float, late: float, end: float) -> None:
    speed = descent_rate(height, braking, late, end)
    way = (speed - end) * late + (speed * speed - end * end) / (2.0 * braking)
    assert way == pytest.approx(height, rel=1e-6, abs=1e-9)
    assert descent_rate(-1.0, braking, late, end) == pytest.approx(end)


def test_the_height_moves_as_the_thrust_and_its_loop_allow() -> None:
    up, down = thrust_margins(0.45, 0.05, 0.05, 1.0)
    assert (up, down) == pytest.approx((9.80665 * 0.55 / 0.5, 9.80665 * 0.4 / 0.5))
    slow = height_limits(0.5, 0.8, 1.5, up, down)
    assert slow == pytest.approx((1.2, 1.2 * 0.8 / 0.5, 0.9, 2.0 + 1.25 / 0.8))
    assert height_limits(0.5, 10.0, 1.5, up, down).acceleration == pytest.approx(0.25 * down)


@pytest.mark.parametrize(
    ("answer", "weight"), long_after(2, [(answer, weight) for answer in (0.13, 1.0, 3.0) for weight in (0.7, 1.0)])
)
def test_a_fall_is_caught_before_the_ground(answer: float, weight: float) -> None:
    """A point mass behind an engine with a lag, its throttle let go: it comes down, and slowly.

    ``weight`` is what the floor does not know of: it is told 1.  With a lag of seconds two to three times the speed for
    the ground is what is left at it.
    """
    hover, dt, end = 0.4, 0.004, 0.5
    floor = CollectiveFloor(hover, 0.05, 0.05, 1.0, answer, answer, dt)
    floor.restart_at(hover)
    height, sink, given_ = 60.0, 0.0, hover
    for _ in range(100_000):
        collective = floor.apply(0.05, height, sink, end, 1.0, 1.0)
        given_ += dt / answer * (collective - given_)
        sink += dt * 9.80665 * (1.0 - (given_ + 0.05) / (0.45 * weight))
        height -= dt * sink
        if height <= 0.0:
            break
    assert height <= 0.0
    assert 0.0 < sink < 3.0 * end


@pytest.mark.parametrize(
    ("aircraft", "controller", "half"), long_after(1, [(*flown, half) for flown in FLOWN for half in (0.25, 1.2)])
)
def test_full_reversals_of_all_sticks_lose_no_vehicle(aircraft: str, controller: str, half: float) -> None:
    """In altitude mode: the lean stays at the stick's, the height is held, no torque command reaches its stop."""
    with in_the_air(aircraft, controller, 30.0) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("ALTCTL"))

        def sticks(t: float) -> rq.Sticks:
            s = square(t, half)
            return rq.Sticks(s, s, s, 0.5)

        samples = with_sticks(flight, 16.0, sticks)
        assert flight.ending is None
        assert max(map(lean, samples)) < OVER * most
        usual = 1e-6 if flight.simulation.vehicle.allocation == "effectiveness" else 0.0
        height, rest = HELD.get(aircraft, (1.0, usual))
        assert max(abs(each) for sample in samples for each in sample.actuation.unallocated[:3]) <= rest
        assert max(abs(sample.state.altitude - 30.0) for sample in samples) < height


@pytest.mark.parametrize(
    ("aircraft", "controller"), long_after(1, [each for each in FLOWN if each[0] in OTHERS and each[1] != "smith"])
)
def test_a_full_reversal_turns_the_other_layouts_round(aircraft: str, controller: str) -> None:
    """What the long ones go on with: there and back once, in STABILIZED, the throttle from stop to stop."""
    with in_the_air(aircraft, controller, 60.0, substeps=1) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
        s = [rq.Sticks(x, x, x, 0.5 + 0.5 * x) for x in (-1.0, 1.0)]
        samples = with_sticks(flight, 2.4, lambda t: s[int(t / 1.2) % 2])
        assert flight.ending is None
        assert max(map(lean, samples)) < OVER * most


@pytest.mark.parametrize(("up", "speed"), [(1.0, 8.0), (-1.0, 5.0)])
@pytest.mark.parametrize(("aircraft", "controller"), long_after(1, sorted(FLOWN, key=lambda each: each[0] != "trijet")))
def test_height_control_takes_over_a_fast_climb_or_fall(
    aircraft: str, controller: str, up: float, speed: float
) -> None:
    """Its loop alone would command all engines to an end of their range at once: four vehicles of turbines were lost."""
    with in_the_air(aircraft, controller, 60.0, substeps=1) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
        for _ in range(40):
            samples = with_sticks(flight, 0.1, lambda t: rq.Sticks(0.0, 0.0, 0.0, 0.5 + 0.5 * up))
            if abs(samples[-1].state.velocity[2]) >= speed:
                break
        assert abs(samples[-1].state.velocity[2]) > 2.0
        flight.ok(rq.SetMode("ALTCTL"))
        samples = with_sticks(flight, 12.0, lambda t: rq.Sticks(0.0, 0.0, 0.0, 0.5))
        assert flight.ending is None
        assert max(map(lean, samples)) < most
        assert abs(samples[-1].state.velocity[2]) < 2.0


@pytest.mark.parametrize(("engine", "past"), [("edf", 6.0), ("edf-as-flown", 2.0)])
def test_a_lift_fan_quicker_than_the_turbojets_behind_pitches_the_vehicle(engine: str, past: float) -> None:
    """The trijet's sticks at their stops, its throttle let go: by so much the lean passes that of the stick."""
    with in_the_air("trijet", "baseline", 150.0, substeps=1, stations={"3": {"engine": engine}}) as flight:
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
        samples = with_sticks(flight, 2.6, lambda t: rq.Sticks(-1.0, -1.0, -1.0, 0.0))
        assert flight.ending is None
        assert degrees(max(map(lean, samples))) - 20.0 == pytest.approx(past, abs=0.5)


HALF = st.sampled_from([-1.0, 0.0, 1.0]) | st.floats(-1.0, 1.0)
PATTERN = st.lists(st.tuples(HALF, HALF, HALF, HALF, st.floats(0.1, 3.0)), min_size=2, max_size=8)


def sticks_of(pattern: list[tuple[float, float, float, float, float]], level: bool) -> Callable[[float], rq.Sticks]:
    """The pattern over and over; ``level``: its throttle alone."""

    def sticks(t: float) -> rq.Sticks:
        t %= sum(each[4] for each in pattern)
        for roll, pitch, yaw, up, seconds in pattern:
            if t < seconds:
                return (
                    rq.Sticks(0.0, 0.0, 0.0, 0.5 + 0.5 * up) if level else rq.Sticks(roll, pitch, yaw, 0.5 + 0.5 * up)
                )
            t -= seconds
        return rq.Sticks(0.0, 0.0, 0.0, 0.5)

    return sticks


@pytest.mark.parametrize(
    ("aircraft", "controller", "mode"),
    long_after(1, [(*flown, mode) for flown in FLOWN for mode in ("STABILIZED", "ALTCTL", "POSCTL")]),
)
@settings(deadline=None, max_examples=4, derandomize=True, phases=(Phase.explicit, Phase.generate))
@given(pattern=PATTERN)
def test_no_pattern_of_the_sticks_loses_a_vehicle(
    aircraft: str, controller: str, mode: str, pattern: list[tuple[float, float, float, float, float]]
) -> None:
    """With one JSBSim run a step, far from the ground: the forces then act half a step later than with four, and twice
    the patterns are flown in the time."""
    with in_the_air(aircraft, controller, 150.0, substeps=1) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode(mode))
        samples = with_sticks(flight, 6.0, sticks_of(pattern, level=False))
        assert flight.ending is None
        assert max(map(lean, samples)) < OVER * most


@pytest.mark.parametrize(
    ("aircraft", "controller", "mode"),
    long_after(2, [(*flown, mode) for flown in FLOWN for mode in ("ALTCTL", "STABILIZED")]),
)
@settings(deadline=None, max_examples=2, derandomize=True, phases=(Phase.explicit, Phase.generate))
@given(pattern=PATTERN)
def test_no_throttle_hits_the_ground(
    aircraft: str, controller: str, mode: str, pattern: list[tuple[float, float, float, float, float]]
) -> None:
    """First any pattern of the throttle near the ground, then all the way down.

    Height controlled: never faster than one and a half times the speed of a landing.  By throttle: never faster than
    the legs stand.
    """
    with in_the_air(aircraft, controller, 8.0) as flight:
        vehicle = flight.simulation.vehicle
        land, legs = vehicle.control.pilot.land_m_s, vehicle.limits.touchdown_m_s  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode(mode))
        with_sticks(flight, 6.0, sticks_of(pattern, level=True))
        with_sticks(flight, 6.0, lambda t: rq.Sticks(0.0, 0.0, 0.0, 0.0))
        assert flight.ending is None
        assert flight.descent(0) < (1.5 * land if mode == "ALTCTL" else legs)


@pytest.mark.parametrize(("aircraft", "controller"), long_after(1, FLOWN))
def test_the_throttle_let_go_at_a_height_is_caught(aircraft: str, controller: str) -> None:
    """In STABILIZED, from 40 m with the throttle at its stop; it lands, and is found to have landed."""
    with in_the_air(aircraft, controller, 40.0) as flight:
        limit = flight.simulation.vehicle.limits.touchdown_m_s
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
        with_sticks(flight, 45.0, lambda t: rq.Sticks(0.0, 0.0, 0.0, 0.0))
        assert flight.ending is None
        assert flight.pilot.landed is LandedState.ON_GROUND
        assert 0.0 < flight.descent(0) < 0.5 * limit


def test_reversals_of_the_throttle_do_not_hit_the_ground() -> None:
    """The scaled Hex-Jet in STABILIZED, from stop to stop: without the floor it touched at 6 m/s."""
    for half in (1.0, 5.0):
        with in_the_air("hexjet", "smith", 10.0) as flight:
            flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
            with_sticks(flight, 20.0, lambda t, half=half: rq.Sticks(0.0, 0.0, 0.0, 0.5 - 0.5 * square(t, half)))
            assert flight.ending is None
            assert flight.descent(0) < 1.0


@pytest.mark.parametrize(("aircraft", "controller"), long_after(1, FLOWN))
def test_set_points_from_outside_are_bounded_too(aircraft: str, controller: str) -> None:
    """Attitudes, velocities, places and rates that jump from one end to the other."""
    with in_the_air(aircraft, controller, 60.0) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]

        def wanted(kind: str, s: float) -> Any:
            if kind == "attitude":
                return rq.OffboardAttitude(from_euler(s, s, s), None, 0.42)
            if kind == "velocity":
                return rq.OffboardVelocity(9.0 * s, -9.0 * s, 5.0 * s, None, s)
            return rq.OffboardPosition(100.0 * s, 50.0 * s, -60.0, s)

        for kind in ("velocity", "position", "attitude"):
            flight.ok(wanted(kind, 1.0), rq.SetMode("OFFBOARD"))
            begun = len(flight.samples)
            for n in range(12):
                flight.fly(0.5, every=wanted(kind, 1.0 if n % 2 else -1.0))
                assert flight.ending is None
            assert max(map(lean, flight.samples[begun:])) < OVER * most


@pytest.mark.long
def test_the_full_scale_vehicle_holds_its_place_in_a_wind_that_it_did_not_know_of() -> None:
    """A push of 5 m/s from one step to the next; see the aircraft's README for what is attainable."""
    with in_the_air("hexjet-p220", "baseline", 20.0, environment={"wind_ned_m_s": [0.0, 5.0, 0.0]}) as flight:
        flight.fly(30.0)
        away = [hypot(*sample.state.position[:2]) for sample in flight.samples]
        assert max(away) < 2.6
        assert max(away[-1000:]) < 0.5


def test_the_full_scale_vehicle_takes_off_in_wind_and_comes_to_hold_above_its_place() -> None:
    wind = {"environment": {"wind_ned_m_s": [0.0, 8.0, 0.0]}}
    with Flight(aircraft="hexjet-p220", engine="p220", controller="baseline", **wind) as flight:
        flight.take_off(5.0)
        # two time constants of the position's loop, 1 / 0.14 s
        flight.fly(15.0)
        assert max(hypot(*sample.state.position[:2]) for sample in flight.samples) < 3.2
        assert flight.away(0.0, 0.0) < 1.0


def test_the_same_sticks_are_the_same_flight() -> None:
    """To the last bit, through the shaper, the floor under the collective and back to a controlled height."""

    def run() -> list[Sample]:
        with in_the_air("hexjet-p220", "baseline", 12.0) as flight:
            flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("STABILIZED"))
            with_sticks(flight, 2.0, lambda t: rq.Sticks(square(t, 0.3), 0.5, -1.0, 0.0))
            flight.ok(rq.SetMode("ALTCTL"))
            with_sticks(flight, 1.0, lambda t: rq.Sticks(0.0, 1.0, 0.0, 1.0))
            return flight.samples

    assert repr(run()) == repr(run())
