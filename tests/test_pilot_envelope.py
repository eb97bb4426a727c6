"""What may be asked of a vehicle is kept within what its engines can follow: leans, rates, descents, to the edges."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from math import acos, radians
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_pilot_flight import Flight

from cosim.catalogue import catalogue
from cosim.pilot import requests as rq
from cosim.pilot.shaper import AttitudeLimits, Shaper, angular_authority, attitude_limits, descent_for
from cosim.signals import Sample, Vector3
from cosim.vehicle import load_vehicle

# Every vehicle with an autopilot: with the predictor that a ground station finds, and with the one its gains are for.
FLOWN = (
    ("hexjet", "smith"),
    ("hexjet-100", "smith"),
    ("hexjet-100", "state-disturbance"),
    ("hexjet-p220", "smith"),
    ("hexjet-p220", "baseline"),
    ("quadrotor", "baseline"),
)
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
        flight.ending = simulation.judge.look(simulation.state, flight.now)
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


# --- the shaper --------------------------------------------------------------------------------------------------------

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


@given(st.floats(0.0, 500.0), st.floats(0.1, 20.0), st.floats(0.0, 5.0))
def test_a_descent_ends_where_it_must(height: float, braking: float, late: float) -> None:
    speed = descent_for(height, braking, late)
    assert speed * late + speed * speed / (2.0 * braking) == pytest.approx(height, rel=1e-6, abs=1e-9)


# --- flights -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("half", [0.25, 1.2])
@pytest.mark.parametrize(("aircraft", "controller"), FLOWN)
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
        assert all(sample.actuation.refused[:3] == (0.0, 0.0, 0.0) for sample in samples)
        assert max(abs(sample.state.altitude - 30.0) for sample in samples) < 1.0
