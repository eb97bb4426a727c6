"""A script that asks for places: the autopilot's law holds and reaches them; what does not fit is said in one line."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from cosim import fly
from cosim.base.errors import InputError
from cosim.control.autopilot.guidance.descent import height_limits, thrust_margins
from cosim.control.autopilot.guidance.tracker import Tracker
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import PilotSettings, load_vehicle

STEP = 0.004


def flown(*commands: dict[str, Any], seconds: float = 12.0, **changes: Any) -> Run:
    stated = {"sensor_noise": False, "duration_s": seconds, "expect": [], "command": list(commands)} | changes
    return fly(Scenario.load("hover").replace(**stated))


VEHICLE = load_vehicle("hexjet")[0]


@pytest.fixture
def settings() -> PilotSettings:
    assert VEHICLE.control.pilot is not None
    return VEHICLE.control.pilot


def row(seconds: float) -> int:
    return round(seconds / STEP)


def test_the_place_asked_for_is_the_trackers_to_the_bit(settings: PilotSettings) -> None:
    """From rest at a place that is known exactly, the set-point is that of the autopilot's tracker alone."""
    run = flown({"kind": "place", "start_s": 1.0, "north_m": 6.0, "east_m": -2.0, "speed_m_s": 2.0})
    log, first = run.log, row(1.0)
    assert np.isnan(log["north_setpoint_m"][:first]).all()
    tracker = Tracker(settings.acceleration_m_s2, settings.jerk_m_s3, STEP)
    # the estimate at the start of the command: what the vehicle did until then is within a millimetre of nothing
    tracker.start((0.0, 0.0), (0.0, 0.0))
    expected = np.array([tracker.towards((6.0, -2.0), 2.0).position for _ in range(log["time_s"].size - first)])
    asked = np.array([log["north_setpoint_m"], log["east_setpoint_m"]])
    np.testing.assert_allclose(asked[:, first:], expected.T, atol=5e-3)
    assert (log["north_m"][-1], log["east_m"][-1]) == pytest.approx((6.0, -2.0), abs=0.1)
    assert "position.drift_m" not in run.summary.limits
    assert run.summary.verdict == "completed, nothing checked"


def test_a_velocity_is_flown_and_a_place_after_it_is_where_it_stops() -> None:
    velocity = {"kind": "velocity", "start_s": 0.0, "north_m_s": 0.0, "east_m_s": 2.0}
    run = flown(velocity, {"kind": "place", "start_s": 8.0}, seconds=20.0)
    assert run.log["velocity_east_m_s"][row(7.9)] == pytest.approx(2.0, abs=0.1)
    # it stays where the set-point came to rest
    east = run.log["east_setpoint_m"]
    assert east[-1] == pytest.approx(east[row(14.0)], abs=0.02)
    assert run.log["east_m"][-1] == pytest.approx(east[-1], abs=0.1)
    assert run.summary.limits["speed.max_m_s"] > 2.0 + 3.9


def test_height_and_heading_are_those_of_the_other_commands() -> None:
    log = flown(
        {"kind": "place", "north_m": 3.0, "east_m": 0.0},
        {"kind": "ramp", "signal": "altitude_m", "start_s": 1.0, "amplitude": 3.0, "duration_s": 4.0},
        {"kind": "step", "signal": "yaw_deg", "start_s": 2.0, "amplitude": 90.0},
        seconds=16.0,
    ).log
    assert log["altitude_m"][-1] == pytest.approx(13.0, abs=0.1)
    assert degrees(log["yaw_rad"][-1]) == pytest.approx(90.0, abs=1.0)
    assert (log["north_m"][-1], log["east_m"][-1]) == pytest.approx((3.0, 0.0), abs=0.15)


def test_a_place_may_state_height_and_heading(settings: PilotSettings) -> None:
    """They go there within the autopilot's bounds, to the bit, and stay; until then, and unstated, they are the script's."""
    log = flown(
        {"kind": "step", "signal": "yaw_deg", "start_s": 0.0, "amplitude": 10.0},
        {"kind": "place", "start_s": 1.0, "north_m": 2.0, "east_m": 0.0, "altitude_m": 12.5},
        {"kind": "place", "start_s": 9.0, "north_m": 2.0, "east_m": 2.0},
        seconds=14.0,
    ).log
    gains, allocation, first = VEHICLE.control.altitude, VEHICLE.control.allocation, row(1.0)
    with build(Scenario.load("hover")) as simulation:
        hover, idle = simulation.cascade.allocator.hover, simulation.cascade.thrust_map.idle
    margins = thrust_margins(hover, idle, allocation.throttle_min, allocation.throttle_max)
    speed = max(settings.climb_m_s, settings.descent_m_s)
    limits = height_limits(gains.position_1_s, gains.velocity_1_s, speed, *margins)
    tracker = Tracker(limits.acceleration, limits.jerk, STEP)
    tracker.start((10.0, 0.0), (0.0, 0.0))
    expected = [tracker.towards((12.5, 0.0), settings.climb_m_s).position[0] for _ in range(log["time_s"].size - first)]
    np.testing.assert_array_equal(log["altitude_setpoint_m"], [10.0] * first + expected)
    assert log["altitude_m"][-1] == pytest.approx(12.5, abs=0.1)
    assert degrees(log["yaw_setpoint_rad"][-1]) == pytest.approx(10.0)
    assert log["east_m"][-1] == pytest.approx(2.0, abs=0.2)


def test_a_heading_is_turned_to_the_short_way_at_the_pilots_rate(settings: PilotSettings) -> None:
    places = ({"kind": "place", "start_s": 0.5, "yaw_deg": 350.0}, {"kind": "place", "start_s": 2.0, "altitude_m": 9.0})
    run = flown(*places, seconds=6.0)
    yaw, height = run.log["yaw_setpoint_rad"], run.log["altitude_setpoint_m"]
    turned = -settings.yaw_rate_rad_s * STEP * np.arange(1, 21)
    np.testing.assert_allclose(yaw[row(0.5) : row(0.5) + 20], turned, atol=1e-12)
    assert degrees(yaw[-1]) == pytest.approx(-10.0)
    assert degrees(run.log["yaw_rad"][-1]) == pytest.approx(-10.0, abs=1.0)
    assert height[-1] == pytest.approx(9.0, abs=1e-3)
    # down no faster than the autopilot goes
    assert -np.diff(height).min() <= settings.descent_m_s * STEP * (1.0 + 1e-9)
    assert run.summary.verdict == "completed, nothing checked"


def test_waypoints_follow_on_arrival_and_not_on_the_clock() -> None:
    """Each is flown to once the estimate has been within the radius of the one before for as long as that is held."""
    first_place = {"north_m": 2.0, "east_m": 0.0, "hold_s": 1.0}
    second_place = {"north_m": 2.0, "east_m": 1.5, "altitude_m": 10.5, "yaw_deg": 20.0}
    command = {"kind": "waypoints", "start_s": 0.5, "speed_m_s": 2.0, "radius_m": 0.4}
    command |= {"waypoint": [first_place, second_place]}
    run = flown(command, seconds=9.0)
    log = run.log
    left = log["waypoints_left"]
    assert [left[0], left[-1]] == [2.0, 0.0]
    first, second = (np.flatnonzero(np.diff(left) == -1.0) + 1).tolist()
    for at, north, east in ((first, 2.0, 0.0), (second, 2.0, 1.5)):
        before, now = np.hypot(log["north_m"][at - 1 : at + 1] - north, log["east_m"][at - 1 : at + 1] - east)
        assert now == pytest.approx(0.4, abs=0.02)  # the estimate is that close to the truth without noise
        assert before > now
    assert abs(log["altitude_m"][second] - 10.5) <= 0.4
    # held for a second, to the step
    assert np.flatnonzero(np.diff(log["yaw_setpoint_rad"]) != 0.0)[0] + 1 == first + row(1.0)
    assert degrees(log["yaw_rad"][-1]) == pytest.approx(20.0, abs=1.0)
    assert run.summary.flat_metrics["position.waypoints_left"] == 0.0
    assert flown(command, seconds=1.0).summary.flat_metrics["position.waypoints_left"] == 2.0


def test_a_velocity_may_climb_and_the_place_after_it_keeps_the_height_where_that_ends(settings: PilotSettings) -> None:
    log = flown(
        {"kind": "velocity", "start_s": 0.5, "climb_m_s": 1.0, "yaw_deg": 15.0},
        {"kind": "place", "start_s": 4.0},
        {"kind": "velocity", "start_s": 6.0, "climb_m_s": -50.0},
        seconds=7.5,
    ).log
    asked = log["altitude_setpoint_m"]
    # once the acceleration is over
    assert asked[row(4.0)] - asked[row(3.9)] == pytest.approx(0.1, rel=1e-4)
    assert asked[row(6.0)] > asked[row(4.0)] > 12.0
    np.testing.assert_allclose(np.diff(asked[row(5.8) : row(6.0)]), 0.0, atol=1e-6)
    # down no faster than the autopilot goes, whatever is asked for
    assert -np.diff(asked).min() <= settings.descent_m_s * STEP * (1.0 + 1e-9)
    assert degrees(log["yaw_rad"][-1]) == pytest.approx(15.0, abs=1.0)


ROWS = ((0.0, 0.0, 0.0, 10.0, 0.0), (3.0, 2.0, 0.5, 10.5, 10.0), (6.0, 4.0, -1.0, 10.0, 30.0))


def test_a_track_is_the_spline_through_its_rows(tmp_path: Path) -> None:
    """Set-points are those of another implementation of the spline; a place after it goes on from there."""
    text = "\n".join(["time_s,north_m,east_m,altitude_m,yaw_deg", *(",".join(map(str, line)) for line in ROWS)])
    (tmp_path / "track.csv").write_text(text)
    track = {"kind": "track", "start_s": 1.0, "file": str(tmp_path / "track.csv")}
    place = {"kind": "place", "start_s": 8.0, "north_m": 4.0, "east_m": -1.0}
    changes = {"sensor_noise": False, "duration_s": 10.0, "expect": [], "command": [track, place]}
    log, table = fly(Scenario.load("hover").replace(**changes), tmp_path / "run").log, np.array(ROWS)
    t = np.clip(log["time_s"] - 1.0, 0.0, 6.0)
    flying = slice(row(1.0), row(8.0))
    for number, name in ((1, "north_setpoint_m"), (2, "east_setpoint_m"), (3, "altitude_setpoint_m")):
        spline = make_interp_spline(table[:, 0], table[:, number], k=3, bc_type="clamped")
        np.testing.assert_allclose(log[name][flying], spline(t)[flying], atol=1e-9)
        assert log[name][-1] == pytest.approx(table[-1, number], abs=1e-6)
    heading = np.radians(np.interp(t, table[:, 0], table[:, 4]))
    np.testing.assert_allclose(log["yaw_setpoint_rad"][row(1.0) :], heading[row(1.0) :], atol=1e-9)
    assert np.hypot(log["north_m"][-1] - 4.0, log["east_m"][-1] + 1.0) < 0.1
    # the file is in the run's folder, and flies again from there
    with build(Scenario.load(tmp_path / "run" / "scenario.toml")) as simulation:
        assert simulation.pilot is not None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,north_m\n0,0\n", r"t\.csv: line 1: no column east_m; a track has time_s, north_m and east_m"),
        ("time_s,north_m,east_m\n0,0,0\n1,9,0\n", r"t\.csv: commands 54\.00 m/s\^2 at 0 s; .* 3\.57 m/s\^2 at most"),
    ],
)
def test_a_track_that_cannot_be_flown_is_one_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(text)
    command = [{"kind": "track", "file": str(tmp_path / "t.csv")}]
    with pytest.raises(InputError, match=message), build(Scenario.load("hover").replace(command=command)):
        pass


@pytest.mark.parametrize(("aircraft", "seconds"), [("quadrotor", 4.0), ("hexjet-100", 6.0), ("hexjet-p220", 6.0)])
def test_every_shipped_vehicle_holds_against_the_wind(aircraft: str, seconds: float) -> None:
    """It leans into 4 m/s of wind, and what carries it off has been caught by the end."""
    own = {"engine": load_vehicle(aircraft)[0].engine, "step_s": 0.0025 if aircraft == "quadrotor" else STEP}
    wind = {"environment": {"wind_ned_m_s": [4.0, 0.0, 0.0]}, "initial": {"altitude_m": 15.0}}
    place = {"kind": "place", "north_m": 0.0, "east_m": 0.0}
    run = flown(place, seconds=seconds, aircraft=aircraft, controller="baseline", **own, **wind)
    assert run.summary.verdict == "completed, nothing checked"
    assert run.log["pitch_rad"][-1] > 0.005
    north, speed = run.log["north_m"], run.log["velocity_north_m_s"]
    assert 0.0 < north[-1] < 2.0  # the air went there in half a second
    assert speed[-1] < 0.6 * speed.max()


def test_without_a_place_a_flight_is_what_it_was() -> None:
    with build(Scenario.load("hover")) as simulation:
        assert simulation.pilot is None


def test_a_placed_flight_repeats_bit_for_bit() -> None:
    command = {"kind": "place", "north_m": 2.0, "east_m": 1.0}
    one, other = (flown(command, seconds=3.0, sensor_noise=True) for _ in range(2))
    for name in ("north_m", "roll_rad", "north_setpoint_m"):
        assert one.log[name].tobytes() == other.log[name].tobytes()


PLACE = {"kind": "place"}


def step_of(signal: str, amplitude: float) -> dict[str, Any]:
    return {"kind": "step", "signal": signal, "start_s": 1.0, "amplitude": amplitude}


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        ([PLACE, step_of("roll_deg", 5.0)], r"roll_deg: a place needs the lean to itself"),
        (
            [PLACE | {"altitude_m": 12.0}, step_of("altitude_m", 1.0)],
            r"command: altitude_m: a place states altitude_m; one of them can ask for it",
        ),
        ([PLACE, {"kind": "velocity"}], r"two places, velocities, waypoints or tracks begin at the same step"),
        ([PLACE | {"start_s": 0.0013}], r"command\.0\.start_s = 0\.0013 s is not a whole number"),
        ([{"kind": "waypoints"}], r"command\.0\.waypoint is missing"),
        (
            [{"kind": "velocity", "climb_m_s": 1.0}, step_of("collective", 0.5)],
            r"command: collective: a velocity states climb_m_s",
        ),
    ],
)
def test_what_does_not_fit_is_one_line(commands: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(InputError, match=message) as complaint, build(Scenario.load("hover").replace(command=commands)):
        pass
    assert "\n" not in str(complaint.value)
