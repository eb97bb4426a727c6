"""A script that asks for places: the autopilot's law holds and reaches them; what does not fit is said in one line."""

from __future__ import annotations

from math import degrees
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import InputError
from cosim.control.autopilot.guidance.descent import height_limits, thrust_margins
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.flight import fly
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

STEP = 0.004


def flown(*commands: dict[str, Any], seconds: float = 12.0, **changes: Any) -> Run:
    stated = {"sensor_noise": False, "duration_s": seconds, "expect": [], "command": list(commands)} | changes
    return fly(Scenario.load("hover").replace(**stated))


def test_the_place_asked_for_is_the_trackers_to_the_bit() -> None:
    """From rest at a place that is known exactly, the set-point is that of the autopilot's tracker alone."""
    run = flown({"kind": "place", "start_s": 1.0, "north_m": 6.0, "east_m": -2.0, "speed_m_s": 2.0})
    settings = load_vehicle("hexjet")[0].control.pilot
    assert settings is not None
    first = round(1.0 / STEP)
    log = run.log
    assert np.isnan(log["north_setpoint_m"][:first]).all()
    tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, STEP)
    # the estimate at the start of the command: what the vehicle did until then is within a millimetre of nothing
    tracker.start((0.0, 0.0), (0.0, 0.0))
    expected = np.array([tracker.towards((6.0, -2.0), 2.0).position for _ in range(log["time_s"].size - first)])
    np.testing.assert_allclose(log["north_setpoint_m"][first:], expected[:, 0], atol=5e-3)
    np.testing.assert_allclose(log["east_setpoint_m"][first:], expected[:, 1], atol=5e-3)
    assert log["north_m"][-1] == pytest.approx(6.0, abs=0.1)
    assert log["east_m"][-1] == pytest.approx(-2.0, abs=0.1)
    assert "position.drift_m" not in run.summary.limits
    assert run.summary.verdict == "as planned"


def test_a_velocity_is_flown_and_a_place_after_it_is_where_it_stops() -> None:
    run = flown(
        {"kind": "velocity", "start_s": 0.0, "north_m_s": 0.0, "east_m_s": 2.0},
        {"kind": "place", "start_s": 8.0},
        seconds=20.0,
    )
    log = run.log
    assert log["velocity_east_m_s"][round(7.9 / STEP)] == pytest.approx(2.0, abs=0.1)
    # it stays where the set-point came to rest
    east = log["east_setpoint_m"]
    assert east[-1] == pytest.approx(east[round(14.0 / STEP)], abs=0.02)
    assert log["east_m"][-1] == pytest.approx(east[-1], abs=0.1)
    assert run.summary.limits["speed.max_m_s"] > 2.0 + 3.9


def test_height_and_heading_are_those_of_the_other_commands() -> None:
    run = flown(
        {"kind": "place", "north_m": 3.0, "east_m": 0.0},
        {"kind": "ramp", "signal": "altitude_m", "start_s": 1.0, "amplitude": 3.0, "duration_s": 4.0},
        {"kind": "step", "signal": "yaw_deg", "start_s": 2.0, "amplitude": 90.0},
        seconds=16.0,
    )
    log = run.log
    assert log["altitude_m"][-1] == pytest.approx(13.0, abs=0.1)
    assert degrees(log["yaw_rad"][-1]) == pytest.approx(90.0, abs=1.0)
    assert log["north_m"][-1] == pytest.approx(3.0, abs=0.15)
    assert log["east_m"][-1] == pytest.approx(0.0, abs=0.15)


def test_a_place_may_state_height_and_heading() -> None:
    """They go there within the autopilot's bounds, to the bit, and stay; until then, and unstated, they are the script's."""
    run = flown(
        {"kind": "step", "signal": "yaw_deg", "start_s": 0.0, "amplitude": 10.0},
        {"kind": "place", "start_s": 1.0, "north_m": 2.0, "east_m": 0.0, "altitude_m": 12.5},
        {"kind": "place", "start_s": 9.0, "north_m": 2.0, "east_m": 2.0},
        seconds=14.0,
    )
    vehicle, log, first = load_vehicle("hexjet")[0], run.log, round(1.0 / STEP)
    settings, gains, allocation = vehicle.control.pilot, vehicle.control.altitude, vehicle.control.allocation
    assert settings is not None
    with build(Scenario.load("hover")) as simulation:
        hover, idle = simulation.cascade.allocator.hover, simulation.cascade.thrust_map.idle
    margins = thrust_margins(hover, idle, allocation.throttle_min, allocation.throttle_max)
    speed = max(settings.climb_m_s, settings.descent_m_s)
    limits = height_limits(gains.position_1_s, gains.velocity_1_s, speed, *margins)
    tracker = Tracker(limits.acceleration, limits.jerk, STEP)
    tracker.start((10.0, 0.0), (0.0, 0.0))
    expected = [tracker.towards((12.5, 0.0), settings.climb_m_s).position[0] for _ in range(log["time_s"].size - first)]
    np.testing.assert_array_equal(log["altitude_setpoint_m"][:first], 10.0)
    np.testing.assert_array_equal(log["altitude_setpoint_m"][first:], expected)
    assert log["altitude_m"][-1] == pytest.approx(12.5, abs=0.1)
    assert degrees(log["yaw_setpoint_rad"][-1]) == pytest.approx(10.0)
    assert log["east_m"][-1] == pytest.approx(2.0, abs=0.2)


def test_a_heading_is_turned_to_the_short_way_at_the_pilots_rate() -> None:
    run = flown(
        {"kind": "place", "start_s": 0.5, "yaw_deg": 350.0},
        {"kind": "place", "start_s": 2.0, "altitude_m": 9.0},
        seconds=6.0,
    )
    settings, yaw = load_vehicle("hexjet")[0].control.pilot, run.log["yaw_setpoint_rad"]
    assert settings is not None
    first = round(0.5 / STEP)
    turned = -settings.yaw_rate_rad_s * STEP * np.arange(1, 21)
    np.testing.assert_allclose(yaw[first : first + 20], turned, atol=1e-12)
    assert degrees(yaw[-1]) == pytest.approx(-10.0)
    assert degrees(run.log["yaw_rad"][-1]) == pytest.approx(-10.0, abs=1.0)
    assert run.log["altitude_setpoint_m"][-1] == pytest.approx(9.0, abs=1e-3)
    # down no faster than the autopilot goes
    assert -np.diff(run.log["altitude_setpoint_m"]).min() <= settings.descent_m_s * STEP * (1.0 + 1e-9)
    assert run.summary.verdict == "as planned"


def test_without_a_place_a_flight_is_what_it_was() -> None:
    with build(Scenario.load("hover")) as simulation:
        assert simulation.pilot is None


def test_the_same_twice() -> None:
    command = {"kind": "place", "north_m": 2.0, "east_m": 1.0}
    one, other = (flown(command, seconds=3.0, sensor_noise=True) for _ in range(2))
    for name in ("north_m", "roll_rad", "north_setpoint_m"):
        assert one.log[name].tobytes() == other.log[name].tobytes()


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        (
            [{"kind": "place"}, {"kind": "step", "signal": "roll_deg", "start_s": 1.0, "amplitude": 5.0}],
            r"roll_deg: a place needs the lean to itself",
        ),
        (
            [{"kind": "velocity"}, {"kind": "sticks", "file": "manual-sticks.csv"}],
            r"roll_deg, pitch_deg: a place needs the lean to itself",
        ),
        (
            [
                {"kind": "place", "altitude_m": 12.0},
                {"kind": "step", "signal": "altitude_m", "start_s": 1.0, "amplitude": 1.0},
            ],
            r"command: altitude_m: a place states altitude_m; one of them can ask for it",
        ),
        (
            [
                {"kind": "place", "altitude_m": 12.0},
                {"kind": "step", "signal": "collective", "start_s": 1.0, "amplitude": 0.5},
            ],
            r"command: collective: a place states altitude_m",
        ),
        (
            [
                {"kind": "place", "yaw_deg": 5.0},
                {"kind": "step", "signal": "yaw_deg", "start_s": 1.0, "amplitude": 1.0},
            ],
            r"command: yaw_deg: a place states yaw_deg",
        ),
        ([{"kind": "place", "altitude_m": -1.0}], r"command\.0\.altitude_m"),
        ([{"kind": "place", "yaw_deg": 400.0}], r"command\.0\.yaw_deg"),
        ([{"kind": "place"}, {"kind": "velocity"}], r"two places or velocities begin at the same step"),
        ([{"kind": "place", "start_s": 0.0013}], r"command\.0\.start_s = 0\.0013 s is not a whole number"),
        ([{"kind": "place", "north": 3.0}], r"command\.0\.north.*north_m"),
        ([{"kind": "place", "speed_m_s": 0.0}], r"command\.0\.speed_m_s"),
    ],
)
def test_what_does_not_fit_is_one_line(commands: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(InputError, match=message) as complaint, build(Scenario.load("hover").replace(command=commands)):
        pass
    assert "\n" not in str(complaint.value)
