"""Limits of a flight: what they are made from, exactly, and what they do to a verdict."""

from __future__ import annotations

import json
from math import exp, nan, pi, radians, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_tools import Hexjet
from flights import STEP, setup

from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.base.signals import AXES
from cosim.results.limits import (
    LIMITED,
    MAX_ALTERNATING_PERCENT,
    MAX_DRIFT_SPANS,
    MAX_FROUDE_SPEEDS,
    MAX_HEIGHT_SPANS,
    MAX_SATURATED_PERCENT,
    describe_exceedance,
    find_exceeded,
    height_lag,
    lean_motion,
    track_speed,
)
from cosim.results.metrics import metric_names
from cosim.results.report.flight import write_report
from cosim.results.run import open_run
from cosim.simulation.script.command_script import CommandScript
from cosim.spec.scenario import FlightLimits, Scenario

LAW = (0.8, 2.0, 1.0)
STILL = (np.zeros(1), np.zeros(1))
CALM = {"sensor_noise": False, "duration_s": 4.0, "expect": []}


def constant(value: float, seconds: float) -> np.ndarray:
    return np.full(round(seconds / STEP), value)


def test_every_key_limits_a_metric() -> None:
    assert {*LIMITED, "settling_s", "oscillation_rad"} == set(FlightLimits.model_fields)
    axes = {f"{axis}.{name}" for axis in AXES for name in ("settling_time_s", "oscillation_rad")}
    assert {*LIMITED.values(), *axes} <= set(metric_names())


def test_a_lean_explains_the_motion_of_a_uniform_acceleration() -> None:
    roll, seconds = radians(10.0), 3.0
    way, speed = lean_motion(constant(roll, seconds), constant(0.0, seconds), constant(1.2, seconds), STILL, STEP)
    a, n = GRAVITY * tan(roll), round(seconds / STEP)
    assert speed == pytest.approx(a * seconds)
    assert way == pytest.approx(0.5 * a * STEP**2 * n * (n + 1))  # the sum of a uniform acceleration's speeds


def test_leans_are_added_up_where_the_heading_points_them() -> None:
    """Rolled to the right while the nose points east is to the south; pitched down to the north is to the north."""
    level, quarter, none = constant(0.0, 2.0), constant(pi / 2, 2.0), np.zeros(1)
    gained = GRAVITY * tan(0.1) * 2.0
    for angles, before, after in (
        # braked from the first row on
        ((constant(0.1, 2.0), level, quarter), (np.array([gained]), none), GRAVITY * tan(0.1) * (2.0 - STEP)),
        ((level, constant(-0.1, 2.0), level), (np.ones(1), none), 1.0 + gained),
        ((level, level, level), (np.array([3.0]), np.array([4.0])), 5.0),
    ):
        _, speed = lean_motion(*angles, before, STEP) or (nan, nan)
        assert speed == pytest.approx(after)
    # without a commanded angle nothing is explained
    assert lean_motion(np.full(level.size, nan), level, level, STILL, STEP) is None
    assert lean_motion(*[np.zeros(0)] * 3, (np.zeros(0), np.zeros(0)), STEP) is None


def test_the_height_law_leaves_a_steps_size_and_a_ramps_rate_over_its_gain() -> None:
    step = np.concatenate((constant(10.0, 1.0), constant(13.0, 9.0)))
    assert height_lag(step, np.full(step.size, 10.0), LAW, STEP) == pytest.approx(3.0)
    t = STEP * np.arange(4000)
    for rate in (0.5, -0.5):
        # a first-order lag behind a ramp: rate / K (1 - exp(-K t)), to the step of the sum
        found = height_lag(10.0 + rate * t, np.full(t.size, 10.0), LAW, STEP)
        assert found == pytest.approx(0.5 / 0.8 * (1.0 - exp(-0.8 * t[-1])), abs=0.5 * STEP)
    # faster than it may climb it falls behind by the difference of the rates
    fast = height_lag(3.0 * t, np.zeros(t.size), LAW, STEP)
    assert fast == pytest.approx(2.0 / 0.8 + (3.0 - 2.0) * (t[-1] - 2.0 / 0.8) + 0.5 / 0.8, rel=0.2)
    assert fast > (3.0 - 2.0) * t[-1]
    assert height_lag(np.full(5, 12.0), np.full(5, 10.0), LAW, STEP) == 2.0
    assert height_lag(np.full(5, nan), np.full(5, 10.0), LAW, STEP) == 0.0
    # asked for anew: from where the vehicle is
    assert height_lag(np.array([10.0, nan, nan, 20.0]), np.array([10.0, 12.0, 15.0, 19.0]), LAW, STEP) == 1.0


def test_the_speed_of_a_track() -> None:
    assert track_speed(np.array([nan, 0.0, 0.03, 0.03]), np.array([nan, 0.0, 0.04, 0.04]), STEP) == pytest.approx(12.5)
    assert track_speed(np.array([nan]), np.array([nan]), STEP) == 0.0


def test_beyond_is_above_and_is_told_with_both_figures() -> None:
    limits = {"position.drift_m": 10.0, "speed.max_m_s": 4.0, "effort.tilt_rad_s": pi, "fuel_burnt_kg": 1.0}
    flat = {"position.drift_m": 125.71, "speed.max_m_s": 4.0, "effort.tilt_rad_s": 2 * pi, "fuel_burnt_kg": None}
    found = find_exceeded(limits, flat)
    assert found == ["position.drift_m", "effort.tilt_rad_s"]
    assert [describe_exceedance(name, limits, flat) for name in found] == [
        "drift from the start 125.7 m, limit 10 m",
        "tilt activity 360 deg/s, limit 180 deg/s",
    ]


@pytest.mark.parametrize(
    ("aircraft", "engine", "span"), [("hexjet", "edf-as-flown", 0.4), ("hexjet-p220", "p220", None)]
)
def test_defaults_come_from_the_span(aircraft: str, engine: str, span: float | None) -> None:
    hover = Scenario.load("hover").replace(aircraft=aircraft, engine=engine, controller="baseline", **CALM)
    summary = fly(hover).summary
    span = span or 0.4 * (61.97 / 5.525) ** (1 / 3)  # lengths go with the cube root of the mass
    assert {name: most for name, most in summary.limits.items() if name.split(".")[0] not in AXES} == pytest.approx(
        {
            "altitude.max_abs_error_m": MAX_HEIGHT_SPANS * span,
            "position.drift_m": MAX_DRIFT_SPANS * span,
            "speed.max_m_s": MAX_FROUDE_SPEEDS * sqrt(GRAVITY * span),
            "effort.saturated_percent": MAX_SATURATED_PERCENT,
            "effort.alternating_percent": MAX_ALTERNATING_PERCENT,
        },
        rel=1e-3,
        abs=1e-6,
    )
    assert summary.verdict == "completed, nothing checked"
    assert summary.beyond == []


WINDY = Scenario.load("hover").replace(environment={"wind_ned_m_s": (0.0, 15.0, 0.0)})


def test_a_vehicle_that_the_wind_carries_away_did_not_hover() -> None:
    run = fly(WINDY)
    summary = run.summary
    drift = np.hypot(run.log["north_m"], run.log["east_m"]).max()
    assert drift > 100.0
    assert summary.position.drift_m == pytest.approx(drift)
    # its attitude and its height are as expected
    told = (summary.outcome, summary.verdict, summary.expectations_met, summary.succeeded)
    assert told == ("completed", "beyond limits", True, False)
    assert summary.exceeded[0] == f"drift from the start {drift:.4g} m, limit 10 m"


def test_a_vehicle_that_leaves_its_height_did_not_hold_it() -> None:
    absurd = {"control": {"rate": {"roll": {"p": 1e9}}}}
    summary = fly(Scenario.load("hover").replace(vehicle=absurd)).summary
    assert summary.outcome == "completed"
    assert set(summary.beyond) >= {"altitude.max_abs_error_m", "effort.saturated_percent"}


def test_a_scenario_widens_or_leaves_out_a_limit() -> None:
    summary = fly(WINDY.replace(limits={"drift_m": 200.0, "speed_m_s": False, "fuel_burnt_kg": 3.0})).summary
    assert summary.verdict == "as planned"
    assert (summary.limits["position.drift_m"], summary.limits["fuel_burnt_kg"]) == (200.0, 3.0)
    assert "speed.max_m_s" not in summary.limits
    assert fly(WINDY.replace(limits={"drift_m": 200.0, "speed_m_s": 9.0})).summary.beyond == ["speed.max_m_s"]


def test_body_rates_are_asked_for_nowhere() -> None:
    entry = {"kind": "step", "signal": "rate_p_deg_s", "start_s": 1.0, "amplitude": 1.0}
    limits = fly(Scenario.load("hover").replace(command=[entry], **CALM)).summary.limits
    assert set(limits) == {"altitude.max_abs_error_m", "effort.saturated_percent", "effort.alternating_percent"}


def test_a_doublet_that_does_not_settle_is_beyond_its_limits(tmp_path: Path) -> None:
    """63 % of overshoot, a degree of swing at the end: 40 samples of delay and a predictor that believes in 25."""
    late = Scenario.load("roll-doublet").replace(engine_parameters={"delay_samples": 40}, expect=[])
    run = fly(late)
    summary = run.summary
    assert summary.metrics["roll"].settling_time_s is None
    assert (summary.outcome, summary.verdict, summary.succeeded) == ("completed", "beyond limits", False)
    assert summary.beyond == ["roll.settling_time_s", "roll.oscillation_rad"]
    assert summary.exceeded[0] == "roll settling time none, not settled, limit 2.857 s"
    assert summary.limits["roll.oscillation_rad"] == pytest.approx(0.05 * radians(10.0))
    write_report(run, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text("utf-8")
    assert '<td class="unmet">not settled</td><td>≤ 2.857 s</td>' in page
    wide = fly(late.replace(limits={"settling_s": False, "oscillation_rad": radians(1.0)})).summary
    assert (wide.verdict, wide.beyond) == ("completed, nothing checked", [])
    assert "roll.settling_time_s" not in wide.limits


def test_a_hover_that_swings_is_beyond_its_limits() -> None:
    """At 46 samples of delay it comes to swing by 41 deg and is not lost in 40 s."""
    late = Scenario.load("hover").replace(engine_parameters={"delay_samples": 46}, duration_s=40.0)
    summary = fly(late).summary
    assert summary.outcome == "completed"
    assert summary.metrics["roll"].oscillation_rad == pytest.approx(radians(41.0), abs=radians(5.0))
    assert summary.beyond == ["roll.oscillation_rad"]
    assert summary.limits["roll.oscillation_rad"] == pytest.approx(6.0 * 0.001, rel=0.02)  # the attitude's noise


@pytest.mark.parametrize("noise", [False, True])
def test_a_tilt_that_alternates_at_every_step_is_beyond_its_limit(noise: bool) -> None:
    """Rate gains of pitch times 2.5, beyond the gain margin at half the control rate: no swing is to be seen."""
    gains = {"control": {"rate": {"pitch": {"p": 0.865, "i": 2.575, "d": 0.020175}}}}
    changes = {"vehicle": gains, "initial": {"rate_deg_s": (0.0, 0.5, 0.0)}, "duration_s": 6.0, "expect": []}
    hunting = Scenario.load("full-scale-hover").replace(sensor_noise=noise, **changes)
    run = fly(hunting)
    turned = np.diff(run.log["tilt_left_command_rad"][-250:])
    assert np.mean(turned[1:] * turned[:-1] < 0.0) > 0.95
    assert (run.summary.beyond, run.summary.succeeded) == (["effort.alternating_percent"], False)
    assert run.summary.effort.alternating_percent == pytest.approx(100.0, abs=1.0)
    assert fly(hunting.replace(limits={"alternating_percent": False})).summary.beyond == []


@pytest.mark.parametrize("name", ["fault-slow-spool", "fault-servo-jam"])
def test_a_scenario_that_expects_a_swing_says_so(name: str) -> None:
    """Their limits are widened for a reason: without that they would be beyond the default."""
    scenario = Scenario.load(name)
    assert fly(scenario).summary.verdict == "as planned"
    held = scenario.from_table(scenario.stated() | {"limits": {}}, scenario.folder, name)
    assert fly(held).summary.verdict == "beyond limits"


def test_a_failed_flight_is_not_completed_whatever_else() -> None:
    summary = fly(Scenario.load("roll-doublet").replace(controller="baseline")).summary
    assert (summary.outcome, summary.verdict, summary.succeeded) == ("diverged", "not completed", False)


def test_the_command_says_so_and_ends_with_1(hexjet: Hexjet, tmp_path: Path) -> None:
    wind = ["--set", "environment.wind_ned_m_s=[0.0,15.0,0.0]", "--set", "duration_s=8.0"]
    shown = hexjet("fly", "hover", *wind, "--out", "a")
    assert shown.status == 1
    assert "completed, flew 2000 steps; beyond limits" in shown.out
    assert "beyond its limit: drift from the start" in shown.out
    data = json.loads(hexjet("fly", "hover", *wind, "--json", "--out", "b").out)
    assert (data["verdict"], data["beyond"][0]) == ("beyond limits", "position.drift_m")
    drift = data["position"]["drift_m"]
    assert drift > data["limits"]["position.drift_m"]
    page = (tmp_path / "a" / "report.html").read_text()
    assert "beyond limits" in page
    assert f"{drift:.2f}" in page
    assert f"{drift:.2f}" in shown.out
    calm = hexjet("fly", "hover", "--set", "duration_s=2.0", "--out", "c").told
    assert "hover: completed, nothing checked; flew 500 steps" in calm
    assert "completed, nothing checked" in (tmp_path / "c" / "report.html").read_text()


NUMBER = r"limits\.drift_m = .*: must be a number of at least 0, or false for no limit"


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        *((f"drift_m={value}", NUMBER) for value in ("-1.0", "true", "'far'", "inf")),
        ("drift=3.0", r"limits\.drift.*drift_m"),
    ],
)
def test_a_limit_is_a_number_or_false(stated: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scenario.load("hover", [f"limits.{stated}"])


def test_a_summary_from_before_limits_is_still_read(tmp_path: Path) -> None:
    fly(Scenario.load("hover").replace(**CALM), tmp_path / "run")
    path = tmp_path / "run" / "summary.json"
    data: dict[str, Any] = json.loads(path.read_text())
    later = "verdict limits beyond position speed effort fuel_burnt_kg reach yardstick integration"
    for key in later.split():
        del data[key]
    del data["altitude"]["final_error_m"]
    path.write_text(json.dumps(data))
    old = open_run(tmp_path / "run").summary
    assert (old.verdict, old.integration, old.flat_metrics["position.drift_m"]) == (None, None, None)
    assert old.succeeded  # nothing was expected of it


def test_a_run_without_a_yardstick_has_no_limits() -> None:
    assert setup().yardstick is None
    assert CommandScript(Scenario.load("hover"), 10.0).at(0).place is None
