"""Every failsafe to the ground: what crashed, ran on or took off again, flown; and the table that tells it."""

from __future__ import annotations

import dataclasses
import json
import re
from math import hypot, isnan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_tools import Hexjet
from failsafe_flights import Flight, again
from long_cases import long_after
from places import DOCS

from cosim.base.constants import GRAVITY
from cosim.base.protocols import EngineState
from cosim.base.storage.scratch import temporary
from cosim.campaign.run import fly_again
from cosim.campaign.store import open_campaign
from cosim.control.autopilot import requests as rq
from cosim.control.autopilot.modes import LandedState, Mode
from cosim.results.log.digest import log_digest
from cosim.results.report import marks
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle
from hexjet_prove.api.surveys import failsafes
from hexjet_prove.surveys import failsafe_flight
from hexjet_prove.surveys import failsafes as table
from hexjet_prove.surveys.failsafe_cases import Case, cases
from hexjet_prove.surveys.survey import load_subject
from hexjet_prove.surveys.tipping import tip_speed

HEXJETS = ("hexjet", "hexjet-p220")
AT_REST = 0.1  # of the speed that it had: nine tenths of it is gone when it touches
# Every vehicle that ships with an autopilot.
TABLED = ("hexjet", "hexjet-100", "hexjet-p220", "quadrotor", "octojet", "quadjet", "trijet", "jetwing")


def flown_case(scenario: Scenario, repeated: bool = False, **case: Any) -> Any:
    """What a flight of a survey's case, begun in the air, came to; ``repeated``: and from its folder again."""
    with temporary("failsafe-") as folder:
        pilot = failsafe_flight.FailsafeAutopilot(name="failsafes", **case)
        run, row = pilot.fly(scenario, Path(), folder / "run", page=False)
        if repeated:
            again(folder / "run" / "scenario.toml", log_digest(run.log))
    values = {name: float("nan") if value is None else value for name, value in row.items()}
    return SimpleNamespace(
        reason=run.reason, **{name.removeprefix(failsafe_flight.OWN): value for name, value in values.items()}
    )


def flown(
    name: str, aircraft: str = "hexjet", height: float = 3.0, wind: float = 0.0, speed: float = 0.0, **more: Any
) -> Any:
    """A flight that begins in the air; what tips the vehicle is the page's number, which the long tests measure."""
    subject = load_subject(aircraft)
    scenario = table.scenario_of(subject, table.default_controller(subject), height, wind)
    case = {"failsafe": name, "height_m": height, "speed_m_s": speed, "trip_m_s": tip_of(aircraft)}
    return flown_case(scenario, **case | more)


def tip_of(aircraft: str) -> float:
    text = marks.parts_of((DOCS / "tables/failsafes.md").read_text(encoding="utf-8"), "")[
        f"failsafes after a take-off, {aircraft}"
    ]
    return float(re.search(r"faster than ([\d.]+) m/s sideways", text)[1])  # type: ignore[index]


def landed_or_slid(aircraft: str, row: Any) -> str:
    """What a vehicle that came to rest on its legs is called, by how fast it moved sideways as it touched."""
    return "slid" if row.sideways_m_s > tip_of(aircraft) else "landed"


# --- sensors -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("aircraft", "height", "wind", "speed"),
    long_after(
        1,
        [
            ("hexjet-p220", 3.0, 0.0, 0.0),
            ("hexjet", 3.0, 0.0, 5.0),
            ("hexjet-p220", 3.0, 0.0, 5.0),
            *(
                ("hexjet", height, 0.0, speed)
                for height in (3.0, 10.0, 30.0)
                for speed in (0.0, 5.0)
                if height + speed != 8.0
            ),
            ("hexjet", 15.0, 0.0, 5.0),
            *(("hexjet-p220", height, 0.0, speed) for height in (10.0, 30.0) for speed in (0.0, 5.0)),
            *((aircraft, 10.0, 5.0, 0.0) for aircraft in HEXJETS),
            *((aircraft, 30.0, 10.0, 0.0) for aircraft in HEXJETS),
        ],
    ),
)
def test_losing_the_gnss_lands(aircraft: str, height: float, wind: float, speed: float) -> None:
    """It crashed at 2.3 to 17 m/s, holding and at 5 m/s: the climb rate was the receiver's and stood still with it."""
    row = flown("GNSS lost", aircraft, height, wind, speed)
    assert row.verdict == landed_or_slid(aircraft, row)
    assert row.reason == "position lost"
    # the last metres are flown at the landing's rate; more than that is what the legs touch with in wind
    vehicle = load_vehicle(aircraft)[0]
    assert row.touchdown_m_s < 2.0 * vehicle.control.pilot.land_m_s  # type: ignore[union-attr]
    assert row.sideways_m_s < (AT_REST * speed if speed else 1.0)
    # a jet's rotor has not quite run down after ten seconds
    assert row.thrust_n < 1e-3 * vehicle.mass_kg * GRAVITY


@pytest.mark.parametrize("aircraft", long_after(1, TABLED))
def test_losing_the_gnss_at_speed_stops_and_lands(aircraft: str) -> None:
    """It touched at 1.9 to 3.7 m/s sideways: the drag learnt at speed was taken for a push that went on at rest."""
    vehicle = load_vehicle(aircraft)[0]
    row = flown("GNSS lost", aircraft, 30.0 if aircraft == "hexjet-100" else 10.0, 0.0, 5.0)
    assert row.verdict == landed_or_slid(aircraft, row)
    assert row.reason == "position lost"
    assert row.sideways_m_s < AT_REST * 5.0
    # more than a second, in fixes 0.1 s apart, until it is noticed; then the way in which the set-point stops
    pilot = vehicle.control.pilot
    assert pilot is not None
    a, j = pilot.acceleration_m_s2, pilot.jerk_m_s3
    way = 5.0 * 1.2 + 5.0**2 / (2.0 * a) + 5.0 * a / (2.0 * j)
    assert row.drift_m == pytest.approx(way, abs=2.0)


def test_a_landing_begun_at_speed_and_low_comes_to_rest_before_it_touches() -> None:
    """From 3 m it would touch at 0.7 m/s: the turbines take longer to stop it than the descent takes."""
    with Flight("hexjet-p220") as flight:
        flight.ok(rq.Goto(1000.0, speed=5.0))
        flight.fly(10.0)
        flight.ok(rq.Land())
        speeds: list[float] = []
        flight.fly(
            60.0, lambda: speeds.append(flight.simulation.state.velocity[0]) or flight.simulation.state.on_ground
        )
        assert speeds[0] > 4.5
        assert abs(speeds[-1]) < 0.3


def gone(aircraft: str) -> float:
    """The critical sliding speed with all thrust gone: (m v h)^2 / (2 I) = m g (sqrt(h^2 + d^2) - h), along an axis."""
    vehicle = load_vehicle(aircraft)[0]
    legs = [contact.position_m for contact in vehicle.contacts if contact.kind == "leg"]
    h, d, jx, m = legs[0][2], abs(legs[0][1]), vehicle.inertia_kg_m2[0], vehicle.mass_kg
    return float((2.0 * GRAVITY * (hypot(h, d) - h) * (jx + m * (h * h + d * d)) / m) ** 0.5 / h)


def test_a_vehicle_on_fans_tips_where_the_energy_lifts_it_over_its_legs() -> None:
    """Thrust is gone within a tenth of a second: the flown speed is near that of the energy, legs that give above it."""
    assert 1.0 < tip_speed("hexjet", "edf-as-flown") / gone("hexjet") < 1.1


@pytest.mark.long
def test_turbines_that_still_carry_it_let_a_vehicle_tip_much_sooner() -> None:
    """Half a second after its throttles are closed hexjet-p220 has nearly nine tenths of its thrust."""
    assert tip_speed("hexjet-p220", "p220") == pytest.approx(0.47, abs=0.03)
    assert gone("hexjet-p220") > 1.0


def test_what_touches_faster_sideways_has_not_landed() -> None:
    row = flown("GNSS lost", trip_m_s=0.0)
    assert row.verdict == "slid"
    assert 0.0 < row.sideways_m_s < 0.3
    assert row.margin_m_s == -row.sideways_m_s


@pytest.mark.parametrize(
    ("name", "aircraft", "height", "wind"),
    long_after(
        1,
        [
            ("barometer lost", "hexjet-p220", 3.0, 0.0),
            ("GNSS lost", "hexjet", 15.0, 5.0),
            ("attitude lost", "hexjet", 10.0, 10.0),
            ("gyro biased", "quadrotor", 3.0, 5.0),
            ("gyro lost", "hexjet-100", 3.0, 5.0),
            ("GNSS and barometer lost", "hexjet-p220", 10.0, 5.0),
            ("GNSS and attitude lost", "quadrotor", 10.0, 5.0),
            ("GNSS and gyro biased", "hexjet-100", 3.0, 10.0),
            ("GNSS and gyro lost", "hexjet", 3.0, 0.0),
        ],
    ),
)
def test_every_sensor_lands_alone_and_with_the_gnss(name: str, aircraft: str, height: float, wind: float) -> None:
    """Each once, over vehicles, heights and winds; the page has them all."""
    row = flown(name, aircraft, height, wind, repeated=True)
    vehicle = load_vehicle(aircraft)[0]
    assert row.verdict == landed_or_slid(aircraft, row)
    assert row.reason in name or row.reason == "position lost"
    assert row.touchdown_m_s < 2.0 * vehicle.control.pilot.land_m_s  # type: ignore[union-attr]
    assert row.thrust_n < 1e-3 * vehicle.mass_kg * GRAVITY


def test_nothing_disarms_in_the_air_whatever_the_sensors_say(tmp_path: Path) -> None:
    """GNSS and barometer stopped in a climb: where it thought to feel the ground it was at 67 m, and disarmed."""
    with Flight(height=10.0, recorded=True) as flight:
        flight.ok(rq.Goto(altitude=30.0))
        flight.fly(4.0)
        for sensor in ("gnss", "barometer"):
            flight.ok(rq.InjectFault("sensor_dropout", sensor=sensor))
        flight.fly(120.0, lambda: not flight.pilot.armed or flight.simulation.state.on_ground)
        assert flight.pilot.armed
        assert flight.simulation.state.on_ground
        flight.again(tmp_path)


# --- engines -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jet", long_after(1, range(1, 7)))
def test_with_any_engine_lost_the_landing_is_recognised_and_everything_is_off(jet: int) -> None:
    """Half of them stood armed for ever, the others gave 31 N disarmed: idle went through the plan."""
    row = flown(f"engine {jet} out", height=10.0, repeated=True)
    assert (row.verdict, row.reason) == ("landed", f"engine {jet} failed")
    assert row.touchdown_m_s < 1.0
    assert row.thrust_n == 0.0
    assert row.drift_m < 2.0


@pytest.mark.parametrize(
    ("aircraft", "jet"),
    long_after(1, [(aircraft, jet) for aircraft in ("hexjet-p220", "hexjet-100") for jet in range(1, 7)]),
)
def test_a_full_scale_vehicle_lands_with_any_engine_lost_and_knows_it(aircraft: str, jet: int) -> None:
    """It stood on running engines and slid 70 to 360 m, or was lost in the air; from 10 m it hit the ground at 4.4 m/s."""
    row = flown(f"engine {jet} out", aircraft, 10.0)
    vehicle = load_vehicle(aircraft)[0]
    assert (row.verdict, row.reason) == (landed_or_slid(aircraft, row), f"engine {jet} failed")
    assert row.touchdown_m_s < vehicle.limits.touchdown_m_s
    # a lean of 16 deg for the 1.15 s in which the catch is level again is 3.2 m/s, which velocity_1_s of 0.35 1/s brakes
    assert row.drift_m < 9.3
    # jets that have not quite run down
    assert row.thrust_n < 1e-3 * vehicle.mass_kg * GRAVITY


def test_who_drifts_when_it_touches_does_not_trip() -> None:
    """Without GNSS and gyro it touches at 1 m/s sideways; on nearly its weight in thrust it hopped until it fell over."""
    row = flown("GNSS and gyro lost", "hexjet-100", 10.0, 10.0)
    assert row.verdict == landed_or_slid("hexjet-100", row)


def test_idle_does_not_go_through_the_plan_and_the_repair_is_believed() -> None:
    with Flight() as flight:
        flight.fly(1.0)
        flight.ok(rq.InjectFault("flame_out", (3,)))
        flight.fly(30.0, lambda: flight.pilot.landed is LandedState.ON_GROUND)
        assert flight.pilot.engines is EngineState.IDLE
        sample = flight.simulation.step()
        least = flight.simulation.vehicle.control.allocation.throttle_min
        assert set(sample.actuation.throttle) == {least}
        assert sample.actuation.tilt == (0.0, 0.0)
        flight.fly(2.1)
        assert not flight.pilot.armed
        assert flight.pilot.engines is EngineState.OFF
        assert flight.fly(1.0) == 0.0
        answer = flight.ask(rq.Arm())
        assert not answer.accepted
        assert "engine 3 failed" in answer.text
        flight.ok(rq.ClearFaults())
        flight.fly(0.5)
        flight.ok(rq.Arm(), rq.Takeoff(3.0))
        flight.fly(30.0, lambda: flight.pilot.mode is Mode.HOLD)
        assert flight.simulation.state.altitude > 2.0


@pytest.mark.parametrize("aircraft", ["jetwing", "quadjet"])
def test_a_loss_is_found_as_soon_after_a_take_off_as_in_a_long_hover(aircraft: str) -> None:
    """A spool-up widens what a healthy engine may give for a minute: the loss was found after 0.1 s and not 0.02 s."""
    with Flight(aircraft, initial={"on_ground": True}) as flight:
        flight.fly(1.1)
        flight.ok(rq.Arm(), rq.Takeoff(3.0))
        flight.fly(20.0, lambda: flight.pilot.mode is Mode.HOLD)
        flight.fly(3.0)
        flight.ok(rq.InjectFault("flame_out", (1,)))
        flight.fly(0.03, lambda: bool(flight.simulation.cascade.lost))


@pytest.mark.parametrize(
    ("jet", "hover"), [(1, 5.0), *(pytest.param(jet, 3.0 * jet, marks=pytest.mark.long) for jet in range(1, 5))]
)
def test_the_jetwing_lands_without_an_engine_soon_after_a_take_off(jet: int, hover: float) -> None:
    """From a take-off to 3 m five of six were lost without engine 1; begun in the air, trimmed, they landed."""
    with Flight("jetwing", initial={"on_ground": True}) as flight:
        flight.fly(1.1)
        flight.ok(rq.Arm(), rq.Takeoff(3.0))
        flight.fly(20.0, lambda: flight.pilot.mode is Mode.HOLD)
        flight.fly(hover)
        flight.ok(rq.InjectFault("flame_out", (jet,)))
        flight.fly(60.0, lambda: not flight.pilot.armed)
        assert flight.simulation.state.on_ground


# --- on the ground -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("aircraft", HEXJETS)
def test_disarming_is_obeyed_while_it_spools_up_and_it_starts_again(aircraft: str) -> None:
    """From idle, while the thrust grows, and from engines that are off: turbines start anew, and carry it up."""
    with Flight(aircraft, initial={"on_ground": True}) as flight:
        weight = flight.simulation.vehicle.mass_kg * GRAVITY
        flight.fly(1.1)
        flight.ok(rq.Arm(), rq.Takeoff(3.0))
        for seconds in (0.02, 1.5):
            # Engines that were off start first.
            flight.fly(30.0, lambda: flight.pilot.landed is LandedState.TAKING_OFF)
            flight.fly(seconds)
            flight.ok(rq.Disarm())
            # fans stop at once, a jet's rotor runs down
            assert flight.fly(1.0 if aircraft == "hexjet" else 8.0) < 1e-3 * weight
            assert flight.pilot.engines is EngineState.OFF
            assert flight.simulation.state.on_ground
            flight.ok(rq.Arm(), rq.Takeoff(3.0))
        flight.fly(30.0, lambda: flight.pilot.landed is LandedState.IN_AIR)
        assert not flight.ask(rq.Disarm()).accepted
        flight.fly(30.0, lambda: flight.pilot.mode is Mode.HOLD)
        assert flight.simulation.state.altitude > 2.5


def test_what_is_left_of_a_jet_ten_seconds_later_is_its_rotor_running_down() -> None:
    """thrust_left (1 + t / run_down)^-exponent of what it gave."""
    with Flight("hexjet-p220", initial={"on_ground": True}) as flight:
        law = flight.simulation.engine.flame_out
        assert law is not None
        left = law.thrust_left * (1.0 + failsafe_flight.DISARMED_S / law.half_speed_s) ** -law.exponent
        flight.fly(1.1)
        flight.ok(rq.Arm())
        idle = flight.fly(2.0)
        assert idle > 50.0
        flight.ok(rq.Disarm())
        # a step may lie between the request and the fire
        assert flight.fly(failsafe_flight.DISARMED_S) == pytest.approx(left * idle, rel=0.005)


@pytest.mark.parametrize(
    ("aircraft", "height", "lost"),
    long_after(1, [("hexjet", 3.0, True), ("hexjet", 3.0, False), ("hexjet-p220", 10.0, True)]),
)
def test_neither_hold_nor_disarm_takes_off_from_where_it_has_landed(
    aircraft: str, height: float, lost: bool, tmp_path: Path
) -> None:
    """HOLD, which a pause is, while the legs touch and the thrust is still there: it flew up a metre."""
    for request in (rq.Hold(), rq.Disarm()):
        with Flight(aircraft, height, recorded=True) as flight:
            flight.fly(1.0)
            if lost:
                flight.ok(rq.InjectFault("flame_out", (2,)))
            flight.ok(rq.Land())
            flight.fly(30.0, lambda: flight.simulation.state.on_ground)
            flight.fly(0.5 if isinstance(request, rq.Disarm) else 0.25)  # it bounces at first
            flight.ok(request)
            heights = []
            for _ in range(round(2.0 / flight.simulation.dt)):
                flight.fly(flight.simulation.dt)
                heights.append(flight.simulation.state.altitude)
            # jets that speed up when the legs touch push on for half a second, whatever is asked: a hop of a decimetre
            assert max(heights) < heights[0] + (0.1 if aircraft == "hexjet" else 0.2)
            assert flight.pilot.landed is LandedState.ON_GROUND
            assert flight.pilot.armed is (not isinstance(request, rq.Disarm))
            flight.again(tmp_path)


def test_a_leg_switch_that_is_stuck_neither_disarms_nor_stops_a_take_off() -> None:
    """It reports contact all the time; the thrust and the accelerometer do not."""
    with Flight(height=10.0) as flight:
        pilot = flight.pilot
        update = pilot.update
        pilot.update = lambda k, seen, report: update(k, seen, report._replace(legs=True))  # type: ignore[method-assign]
        flight.fly(6.0)
        assert pilot.armed
        assert pilot.engines is EngineState.FLY
        assert flight.simulation.state.altitude > 8.0
        flight.ok(rq.Land())
        flight.fly(60.0, lambda: not pilot.armed)
        assert flight.simulation.state.on_ground


@pytest.mark.parametrize("aircraft", long_after(1, ["hexjet-p220", "hexjet"]))
def test_a_leg_switch_that_sticks_in_the_air_takes_no_thrust_away(aircraft: str) -> None:
    """In a hover on turbines there is no time to find out by falling."""
    with Flight(aircraft, height=10.0) as flight:
        pilot = flight.pilot
        flight.fly(3.0)
        update = pilot.update
        pilot.update = lambda k, seen, report: update(k, seen, report._replace(legs=True))  # type: ignore[method-assign]
        heights = []
        for _ in range(60):
            flight.fly(0.1)
            heights.append(flight.simulation.state.altitude)
        assert pilot.armed
        assert pilot.landed is LandedState.IN_AIR
        assert min(heights) > 9.0
        assert any("switch is ignored" in message.text for message in pilot.messages)
        flight.ok(rq.Land())
        sinking: list[float] = []
        flight.fly(60.0, lambda: sinking.append(flight.simulation.state.velocity[2]) or not pilot.armed)
        assert flight.simulation.state.on_ground
        assert not pilot.armed
        assert max(sinking) < flight.simulation.vehicle.limits.touchdown_m_s


# --- where it holds ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wind", "turbulence", "furthest"),
    [pytest.param(8.0, 3, 6.0, id="with turbulence"), pytest.param(5.0, 0, 3.0, id="steady", marks=pytest.mark.long)],
)
def test_a_full_scale_vehicle_holds_in_wind(wind: float, turbulence: int, furthest: float) -> None:
    """Blown off while it learns a wind that it begins in, by 8.4 and 15.9 m once; back within a waypoint's radius."""
    environment = {
        "wind_ned_m_s": [0.0, wind, 0.0], "turbulence_wind_m_s": wind if turbulence else 0.0,
        "turbulence_severity": turbulence,
    }  # fmt: skip
    away = []
    with Flight("hexjet-p220", 10.0, environment=environment) as flight:
        for _ in range(300):
            flight.fly(0.1)
            away.append(hypot(*flight.simulation.state.position[:2]))
            assert abs(flight.simulation.state.altitude - 10.0) < failsafe_flight.MAX_HOLD_HEIGHT_ERROR_M
    assert max(away) < furthest
    assert max(away[200:]) < failsafe_flight.MAX_HOLD_RADIUS_M


@pytest.mark.parametrize("aircraft", HEXJETS)
def test_hold_and_land_are_flown_the_same_wherever_home_is(aircraft: str) -> None:
    """It climbed to a metre above a home at 60 m, crept upwards when HOLD was asked for again and again, and touched
    at twice the speed where home was below the ground."""
    with Flight(aircraft, 10.0) as flight:
        state = lambda: flight.simulation.state  # noqa: E731
        flight.fly(1.0)
        flight.ok(rq.Goto(2.0, 0.0))
        flight.fly(2.0)
        flight.ok(rq.SetHome(0.0, 0.0, 60.0))
        for _ in range(450):
            flight.ok(rq.Hold())
            flight.fly(0.02)
            assert abs(state().altitude - 10.0) < 0.15
        assert flight.pilot.mode is Mode.HOLD
        flight.ok(rq.SetHome(0.0, 0.0, -30.0), rq.Land())
        sinking: list[float] = []
        flight.fly(60.0, lambda: sinking.append(state().velocity[2]) or state().on_ground)
        land = flight.simulation.vehicle.control.pilot.land_m_s  # type: ignore[union-attr]
        assert sinking[-2] < 1.4 * land


@pytest.mark.parametrize(
    "yaw", [pytest.param(1.0, id="all axes"), pytest.param(0.0, id="no yaw", marks=pytest.mark.long)]
)
def test_a_minute_of_full_reversals_keeps_the_full_scale_vehicle(yaw: float) -> None:
    """Roll and pitch from stop to stop every quarter of a second leaned it past 80 deg after 13 to 59 s."""
    with Flight("hexjet-p220", 30.0) as flight:
        most = flight.simulation.vehicle.control.pilot.stick_lean_rad  # type: ignore[union-attr]
        flight.ok(rq.Sticks(0.0, 0.0, 0.0, 0.5), rq.SetMode("ALTCTL"))
        for quarter in range(248):
            s = 1.0 if quarter % 2 else -1.0
            flight.ok(rq.Sticks(s, s, yaw * s, 0.5))
            flight.fly(0.25)
            roll, pitch, _ = flight.simulation.state.euler
            assert hypot(roll, pitch) < 1.2 * most
            assert abs(flight.simulation.state.altitude - 30.0) < 1.0
        assert flight.pilot.mode is Mode.ALTCTL


# --- the table -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("aircraft", "wind"), [("hexjet", 0.0), ("hexjet-p220", 10.0)])
def test_who_holds_is_where_and_as_high_as_it_was_to_hold(aircraft: str, wind: float) -> None:
    row = flown("set-points lost", aircraft, 10.0, wind)
    assert row.verdict == "holds"
    # it held at north 0, east 0; the place and the height are the set-point's, measured through the sensors
    assert row.off_m < failsafe_flight.MAX_HOLD_RADIUS_M
    assert abs(row.height_off_m) < failsafe_flight.MAX_HOLD_HEIGHT_ERROR_M
    assert 0.0 < row.margin_m <= failsafe_flight.MAX_HOLD_HEIGHT_ERROR_M
    assert isnan(row.margin_m_s)


@pytest.mark.parametrize("moved", [rq.Goto(4.0, 0.0), rq.Goto(altitude=4.0)])
def test_who_is_in_hold_elsewhere_does_not_hold(moved: rq.Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place or a height that jumps when HOLD begins: the mode alone would say that all is well."""
    monkeypatch.setattr(failsafe_flight, "MAX_HOLD_S", 12.0)
    elsewhere = Case("elsewhere", (), (moved,), True)
    monkeypatch.setattr(failsafe_flight, "cases", lambda vehicle: [elsewhere])
    row = flown("elsewhere")
    assert row.verdict == "flies on"
    assert max(row.off_m, abs(row.height_off_m)) > 0.9
    assert row.margin_m < 0.0


def test_the_command_flies_a_campaign_that_goes_on_and_flies_again(tmp_path: Path, hexjet: Hexjet) -> None:
    asked = (
        "faults", "--autopilot", "--kind", "sticks", "--height", "3", "--wind", "0", "--workers", "1", "--flights", "2",
    )  # fmt: skip
    out = str(tmp_path / "out")
    done = hexjet(*asked, "--json", "--out", out)
    assert done.status == 0, done.err
    rows = json.loads(done.out)["rows"]
    assert [(row["failsafe"], row["verdict"], row["thrust_n"]) for row in rows] == [("sticks lost", "holds", None)] * 2
    # at moments of their own, which the seed draws
    assert len({row["hover_s"] for row in rows}) == 2
    begun = (tmp_path / "out" / "flights").stat().st_mtime_ns
    assert json.loads(hexjet(*asked, "--json", "--out", out).out)["rows"] == rows
    assert (tmp_path / "out" / "flights").stat().st_mtime_ns == begun
    assert fly_again(open_campaign(out), 1, tmp_path / "again").same
    again(tmp_path / "again" / "scenario.toml", rows[1]["log_sha256"])


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--failsafe", "rain"], "no failsafe begins with 'rain'; there are: GNSS lost, barometer lost"),
        (["--height", "0.2"], "height 0.2 m: must be from 1 to 1000 m"),
        (["--wind", "-1"], "wind -1 m/s: must be from 0 to 50 m/s"),
        (["--moving", "-1"], "speed -1 m/s: must be from 0 to 20 m/s"),
        (["--aircraft", "zeppelin"], "unknown aircraft 'zeppelin'"),
    ],
)
def test_wrong_input_is_one_line(options: list[str], complaint: str, hexjet: Hexjet) -> None:
    done = hexjet("faults", "--autopilot", *options)
    assert done.status == 2
    assert complaint in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert done.out == ""


def test_what_is_drawn_is_the_same_again_and_other_for_every_flight() -> None:
    """The moment, the noise and the tank: of the vehicle, the failsafe, the start, the number and the seed."""
    vehicle = load_vehicle("hexjet-p220")[0]
    conditions = table.Conditions(heights=(30.0,), winds=(0.0, 10.0), flights=4)
    lost, fuel = (
        next(each for each in cases(vehicle) if each.name == name) for name in ("GNSS lost", "fuel runs down")
    )
    assert [(*start, number) for start, number in conditions.starts(lost)] == [
        *((30.0, wind, 0.0, number) for number, wind in enumerate((0.0, 10.0, 0.0, 10.0), 1)),
        *((30.0, 0.0, 5.0, number) for number in range(1, 5)),
    ]
    tall = [start.height for start, number in table.Conditions(flights=2).starts(fuel)]
    assert tall == [3.0, 3.0, 10.0, 10.0, 30.0, 30.0, 100.0, 300.0]
    with Flight("hexjet-p220") as flight:
        energy = flight.pilot.energy

        def drawn(number: int, seed: int = 0) -> tuple[dict[str, Any], dict[str, Any]]:
            planned = table.PlannedFlight(fuel, table.Start(30.0, 0.0), number)
            return table.draw_flight(planned, vehicle, energy, seed)

        assert drawn(1) == drawn(1)
        several = [drawn(number) for number in range(1, 9)] + [drawn(1, seed=1)]
        assert len({settings["seed"] for settings, _ in several}) == 9
        low, high = table.HOVER_RANGE_S
        hovers = [pilot["hover_s"] for _, pilot in several]
        assert all(low <= hover <= high for hover in hovers)
        assert len(set(hovers)) > 4
        for (settings, _), hover in zip(several, hovers, strict=True):
            # a fifth of the tank, which is more than the way down from there takes, is left at the end of the hover
            up = energy.burn * (energy.climb_time(30.0) + hover)
            assert settings["initial"]["fuel"] - up == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("aircraft", "height"), [("hexjet", 3.0), *(pytest.param(each, 10.0, marks=pytest.mark.long) for each in TABLED)]
)
def test_fuel_that_runs_down_after_a_take_off_brings_the_vehicle_home(
    aircraft: str, height: float, tmp_path: Path
) -> None:
    """The tank as it burns, not a raised threshold; a battery where there is no tank."""
    asked: dict[str, Any] = {"kinds": ["fuel"], "heights": [height], "winds": [0.0], "flights": 1, "workers": 1}
    survey = failsafes(aircraft, out=tmp_path / "out", **asked).survey
    (row,) = survey.rows
    assert row.verdict == "landed"
    assert "for the way down: " in row.reason or "energy low (20 %)" in row.reason
    assert row.touchdown_m_s < load_vehicle(aircraft)[0].limits.touchdown_m_s
    assert row.sideways_m_s < survey.trip_m_s


def test_a_cell_of_several_flights_tells_how_many_landed_and_the_worst() -> None:
    base = table.Row(
        "engine 1 out", 3.0, 0.0, 0.0, "landed", 0.5, 0.3, 0.1, 5.0, 1.0, "", *[float("nan")] * 2, "", 1, 4.0
    )
    rows = [
        base,
        dataclasses.replace(base, touchdown_m_s=0.7, thrust_n=float("nan"), number=2),
        dataclasses.replace(base, verdict="slid", sideways_m_s=2.5, wind_m_s=10.0, number=3),
    ]
    assert table.format_cell(rows) == "2 of 3 landed, 1 of 3 slid (wind 10 m/s), 0.70 m/s, sideways 2.50 m/s, 0.1 N"
