"""Metrics against closed forms and against responses worked out another way."""

from __future__ import annotations

from math import exp, nan, pi, sqrt
from typing import Any

import numpy as np
import pytest
from flights import STEP, samples, setup
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.signal import lti

from cosim.base.arrays import Array
from cosim.results import metrics as mt
from cosim.results import wording
from cosim.results.log.columns import NAMES
from cosim.results.log.recorder import MemorySink, Recorder
from cosim.results.summary import summarize
from cosim.spec.scenario import Range

OMEGA = 8.0


def unit_step(zeta: float, t: Array) -> Array:
    """The response of OMEGA^2 / (s^2 + 2 zeta OMEGA s + OMEGA^2), from scipy."""
    system = lti([OMEGA**2], [1.0, 2.0 * zeta * OMEGA, OMEGA**2])
    times, response = system.step(T=t)
    assert np.array_equal(times, t)
    return np.asarray(response)


def time(seconds: float) -> Array:
    return STEP * np.arange(round(seconds / STEP))


def of_axis(setpoint: Array, angle: Array, **rates: Any) -> mt.AxisMetrics:
    zero = np.zeros_like(setpoint)
    rate_setpoint, rate = rates.get("rate_setpoint", zero), rates.get("rate", zero)
    log = {"roll_setpoint_rad": setpoint, "roll_rad": angle, "rate_p_setpoint_rad_s": rate_setpoint}
    return mt._axis_metrics(log | {"rate_p_rad_s": rate}, "roll", "p", STEP)


def stepped(zeta: float, size: float, before_s: float = 0.5, after_s: float = 6.0) -> tuple[Array, Array]:
    """A set-point step after ``before_s`` and the response to it."""
    before = np.zeros(round(before_s / STEP))
    after = time(after_s)
    setpoint = np.concatenate((before, np.full(after.size, size)))
    return setpoint, np.concatenate((before, size * unit_step(zeta, after)))


@pytest.mark.parametrize("size", [0.1, -0.3])
@pytest.mark.parametrize("zeta", [0.15, 0.3, 0.5, 0.7])
def test_overshoot_of_a_second_order_system(zeta: float, size: float) -> None:
    exact = 100.0 * exp(-zeta * pi / sqrt(1.0 - zeta**2))
    found = of_axis(*stepped(zeta, size)).overshoot_percent
    # the peak lies at most half a row from the nearest one, and there y'' <= OMEGA^2 of the step
    missed = 100.0 * 0.5 * OMEGA**2 * (0.5 * STEP) ** 2
    assert exact - missed <= found <= exact + 1e-9


@pytest.mark.parametrize("zeta", [0.15, 0.3, 0.5, 0.7, 1.0])
def test_settling_of_a_second_order_system(zeta: float) -> None:
    fine = np.linspace(0.0, 6.0, 60_001)
    outside = np.flatnonzero(np.abs(unit_step(zeta, fine) - 1.0) > 0.05)[-1]

    def past_the_band(t: float) -> float:
        return float(abs(unit_step(zeta, np.array([0.0, t]))[1] - 1.0) - 0.05)

    exact = brentq(past_the_band, fine[outside], fine[outside + 1])
    found = of_axis(*stepped(zeta, 0.2)).settling_time_s
    assert exact <= found <= exact + STEP  # the first row after it


def test_no_overshoot_when_overdamped() -> None:
    found = of_axis(*stepped(1.0, 0.2))
    assert found.overshoot_percent == pytest.approx(0.0, abs=1e-9)


def test_a_response_that_never_settles_has_no_settling_time() -> None:
    setpoint, angle = stepped(0.02, 0.2, after_s=3.0)
    assert of_axis(setpoint, angle).settling_time_s is None
    pair = np.repeat([0.0, 0.1, 0.0], 500)
    late = pair.copy()
    late[-1] = 0.01  # the first step settles, the second does not
    assert of_axis(pair, late).settling_time_s is None
    assert mt.settling_time(np.array([1.0, 0.0, 0.06]), 1.0, STEP) is None
    assert mt.settling_time(np.array([1.0, 0.06, 0.05]), 1.0, STEP) == 2 * STEP
    assert mt.settling_time(np.array([0.05, 0.0]), -1.0, STEP) == 0.0
    assert mt.settling_time(np.array([1.0, 0.0, nan]), 1.0, STEP) is None


def test_a_doublet_is_judged_by_each_of_its_steps() -> None:
    setpoint = np.repeat([0.0, 0.1, -0.1, 0.0], [100, 500, 500, 500])
    assert mt.find_steps(setpoint, setpoint, STEP) == [(100, 600, 0.1), (600, 1100, -0.2), (1100, 1600, 0.1)]
    angle = setpoint.copy()
    angle[150] += 0.02  # 20 % of 0.1
    angle[700] -= 0.05  # 25 % of 0.2
    angle[800] += 0.10  # the other way: not an overshoot, but not settled either
    angle[1120] += 0.01
    found = of_axis(setpoint, angle)
    assert found.overshoot_percent == pytest.approx(25.0)
    assert found.settling_time_s == pytest.approx((801 - 600) * STEP)


def test_overshoot_counts_in_the_direction_of_the_step() -> None:
    assert mt.overshoot(np.array([0.2, 0.0, -0.05]), 0.2) == pytest.approx(25.0)
    assert mt.overshoot(np.array([0.2, 0.0, -0.05]), -0.2) == pytest.approx(100.0)
    assert mt.overshoot(np.array([0.2, 0.1]), 0.2) == 0.0
    assert mt.overshoot(np.array([nan]), 0.2) is None


def test_a_start_away_from_the_setpoint_is_a_step() -> None:
    t = time(4.0)
    found = of_axis(np.zeros(t.size), 0.3 * (1.0 - unit_step(0.3, t)))
    assert found.commanded
    assert found.overshoot_percent == pytest.approx(100.0 * exp(-0.3 * pi / sqrt(1.0 - 0.09)), abs=0.02)
    still = of_axis(np.zeros(t.size), np.full(t.size, 1e-4))  # trim, not a command
    assert not still.commanded
    assert still.overshoot_percent is None


@pytest.mark.parametrize(
    "setpoint",
    [
        np.linspace(0.0, 0.2, 1000),  # ramp
        np.concatenate((np.zeros(500), np.linspace(0.0, 0.2, 100), np.full(500, 0.2))),
        0.1 * np.sin(np.arange(1000) * STEP),  # sweep
        np.repeat(np.sin(np.arange(40.0)), 25),  # sticks recorded at 10 Hz and held
        np.concatenate((np.full(500, nan), np.zeros(500))),  # the loop was replaced at first
    ],
)
def test_only_steps_have_overshoot_and_settling(setpoint: Array) -> None:
    found = of_axis(setpoint, np.zeros(setpoint.size))
    assert found.overshoot_percent is None
    assert found.settling_time_s is None
    assert found.rmse_rad is not None
    assert found.commanded == (not np.isnan(setpoint[0]))


def test_errors_of_a_known_signal() -> None:
    setpoint = np.full(1000, 0.1)
    angle = setpoint + 0.02 * np.where(np.arange(1000) % 2, 1.0, -1.0)
    angle[10] = setpoint[10] - 0.05
    found = of_axis(setpoint, angle, rate_setpoint=np.full(1000, 3.0), rate=np.zeros(1000))
    assert found.rmse_rad == pytest.approx(sqrt((999 * 0.02**2 + 0.05**2) / 1000))
    assert found.max_abs_error_rad == pytest.approx(0.05)
    assert found.rate_rmse_rad_s == pytest.approx(3.0)
    assert found.final_error_rad == pytest.approx(0.02)
    assert found.oscillation_rad == pytest.approx(0.02)


def test_an_offset_at_the_end_is_not_an_oscillation() -> None:
    found = of_axis(np.zeros(1000), np.full(1000, 0.3))
    assert found.final_error_rad == pytest.approx(0.3)
    assert found.oscillation_rad == pytest.approx(0.0, abs=1e-15)
    swinging = of_axis(np.zeros(1000), 0.1 * np.sin(2 * pi * 2.0 * time(4.0)))
    assert swinging.oscillation_rad == pytest.approx(0.1, rel=1e-3)  # the crest between two rows
    assert swinging.final_error_rad == pytest.approx(0.1 * 2 / pi, rel=1e-3)  # mean of |sin|, by rectangles


def test_heading_is_compared_around_the_circle() -> None:
    found = of_axis(np.full(500, pi - 0.01), np.full(500, -pi + 0.01))
    assert found.max_abs_error_rad == pytest.approx(0.02)
    steps = mt.find_steps(np.repeat([pi - 0.1, -pi + 0.1], 500), np.repeat([pi - 0.1, -pi + 0.1], 500), STEP)
    assert [step.size for step in steps] == [pytest.approx(0.2)]


@given(st.floats(-1e3, 1e3))
def test_wrapped_angles_are_the_same_angles(angle: float) -> None:
    wrapped = float(mt.wrap(np.array([angle]))[0])
    assert -pi < wrapped <= pi or angle == -pi
    # the argument's own rounding, magnified by nothing
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-12)
    if abs(angle) < pi:
        assert wrapped == angle


def test_rows_without_a_setpoint_do_not_count() -> None:
    setpoint = np.concatenate((np.full(300, nan), np.full(700, 0.2)))
    angle = np.concatenate((np.full(300, 9.0), np.full(700, 0.1)))
    assert of_axis(setpoint, angle).rmse_rad == pytest.approx(0.1)
    nothing = of_axis(np.full(10, nan), np.zeros(10), rate=np.full(10, 2.0))
    assert nothing.rmse_rad is nothing.max_abs_error_rad is nothing.final_error_rad is None
    assert nothing.rate_rmse_rad_s == pytest.approx(2.0)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_flights_of_next_to_nothing(rows: int) -> None:
    empty = np.zeros(rows)
    found = of_axis(empty, empty)
    assert found.rmse_rad == (0.0 if rows else None)
    assert found.overshoot_percent is None


def test_values_beyond_all_bounds_do_not_stop_the_metrics() -> None:
    wild = np.array([0.0, 1e200, nan, float("inf"), -1e300])
    found = of_axis(np.zeros(5), np.zeros(5), rate=wild)
    assert found.rate_rmse_rad_s == pytest.approx(1e300 / sqrt(3.0))  # three of the five are numbers
    assert mt.altitude_metrics(np.zeros(5), wild).max_abs_error_m == 1e300


def test_altitude_errors_skip_steps_without_a_set_point() -> None:
    found = mt.altitude_metrics(np.array([nan, 10.0, 10.0]), np.array([0.0, 13.0, 6.0]))
    assert found.rmse_m == pytest.approx(sqrt(12.5))
    assert found.max_abs_error_m == 4.0
    assert found.final_error_m == 4.0


def test_the_ground_carries_what_is_asked_to_be_lower() -> None:
    setpoint, altitude = np.array([1.0, 5.0, -3.0, -3.0]), np.array([0.5, 4.0, 1.0, 0.1])
    contact = np.array([True, False, False, True])
    found = mt.altitude_metrics(setpoint, altitude, contact)
    # below on the ground counts, above in the air counts, above on the ground does not
    assert found.rmse_m == pytest.approx(sqrt((0.5**2 + 1.0 + 16.0) / 4.0))
    assert found.max_abs_error_m == 4.0
    assert found.final_error_m == 0.0


class Made(dict[str, Array]):
    """A log of made-up columns; what is not made is 0, health 1 and what may be missing NaN."""

    rows = 0

    def __missing__(self, name: str) -> Array:
        if name.startswith("health_"):
            return np.ones(self.rows)
        return np.full(
            self.rows, nan if name in mt.POSITION_SETPOINT or name.startswith(("fuel_", "altitude_set")) else 0.0
        )

    @property
    def columns(self) -> tuple[str, ...]:
        return NAMES


def made(rows: int, **columns: Array) -> Made:
    log = Made({name: np.asarray(values, dtype=float) for name, values in columns.items()})
    log.rows = rows
    return log


def test_drift_is_the_distance_from_the_start_and_speed_is_that_over_the_ground() -> None:
    t = time(10.0)
    log = made(
        t.size,
        north_m=100.0 + 3.0 * np.sin(0.5 * pi * t),  # out and back, and out the other way
        east_m=-50.0 + 4.0 * np.sin(0.5 * pi * t),
        velocity_north_m_s=3.0 * t / t[-1],
        velocity_east_m_s=-4.0 * t / t[-1],
    )
    found = mt.flight_metrics(log, STEP)
    assert found.position.drift_m == pytest.approx(5.0)
    assert found.position.final_drift_m == pytest.approx(5.0 * abs(np.sin(0.5 * pi * t[-1])))
    assert found.position.rmse_m is found.position.max_abs_error_m is found.position.final_error_m is None
    assert found.speed.max_m_s == found.speed.final_m_s == pytest.approx(5.0)


def test_the_place_asked_for_is_what_position_errors_are_from() -> None:
    log = made(
        4, north_m=[0, 3, 3, 6], east_m=[0, 4, 4, 8], north_setpoint_m=[nan, 0, 3, 6], east_setpoint_m=[nan, 0, 4, 7]
    )
    found = mt.flight_metrics(log, STEP).position
    assert (found.drift_m, found.final_drift_m) == (10.0, 10.0)
    assert (found.max_abs_error_m, found.final_error_m) == (5.0, 1.0)
    assert found.rmse_m == pytest.approx(sqrt(26.0 / 3.0))


def test_saturation_is_what_was_refused_or_stands_at_its_end() -> None:
    reach = mt.Reach(throttle=((0.05, 1.0),) * 6, tilt_rad=0.5)
    log = made(
        8,
        **{f"throttle_{jet}": np.full(8, 0.5) for jet in range(1, 7)},
        on_ground=[1, 0, 0, 0, 0, 0, 0, 0],
        refused_pitch=[1, 0, -1e-12, 0, 0, 0, 0, 0],
        tilt_right_command_rad=[0, 0, 0, -0.5, 0.499, 0, 0, 0],
    )
    log["throttle_2"] = np.array([0.05, 0.5, 0.5, 0.5, 0.5, 0.05, 0.999, 0.06])
    log["throttle_6"] = np.array([0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 0.05])
    log["health_6"] = np.array([1, 1, 1, 1, 1, 1, 1, 0.0])  # given up: its throttle is closed for that
    assert mt.saturation(log, reach).tolist() == [True, False, True, True, False, True, True, False]
    assert mt.flight_metrics(log, STEP, reach).effort.saturated_percent == pytest.approx(100.0 * 4 / 7)
    assert mt.saturation(log, None).tolist() == [True, False, True] + 5 * [False]
    standing = made(3, on_ground=[1, 1, 1], refused_roll=[1, 1, 1])
    assert mt.flight_metrics(standing, STEP, reach).effort.saturated_percent is None


def test_activity_is_the_way_of_a_command_per_second() -> None:
    t = time(12.0)
    sine = 0.3 * np.sin(2.0 * pi * 0.25 * t)  # a crest and a trough in 4 s, each on a row: 4 times 0.3
    to_the_last_row = 0.3 * 12.0 - 0.3 * abs(np.sin(2.0 * pi * 0.25 * (t[-1] - 12.0)))
    assert mt.activity([sine], STEP) == pytest.approx(to_the_last_row / t[-1])
    assert mt.activity([sine, np.zeros(t.size), np.full(t.size, nan)], STEP) == pytest.approx(
        to_the_last_row / t[-1] / 2
    )
    assert mt.activity([np.zeros(1)], STEP) is mt.activity([], STEP) is None
    ramp = np.linspace(0.0, 1.0, 251)
    log = made(251, throttle_1=ramp, tilt_left_command_rad=-ramp)
    effort = mt.flight_metrics(log, STEP).effort
    assert effort.saturated_percent == 0.0
    assert effort.throttle_1_s == pytest.approx(1.0 / 6.0)
    assert effort.tilt_rad_s == pytest.approx(0.5)


def test_fuel_burnt_is_what_left_the_tank_or_what_the_engines_say() -> None:
    flow = np.array([0.1, 0.2, 0.3, 9.9])  # the last acts after the last row
    left = 5.0 - np.concatenate(([0.0], np.cumsum(2.0 * flow[:-1] * STEP)))
    assert mt.fuel_burnt(left, [flow, flow], STEP) == pytest.approx(1.2 * STEP)
    assert mt.fuel_burnt(np.full(4, nan), [flow, flow, np.full(4, nan)], STEP) == pytest.approx(1.2 * STEP)
    assert mt.fuel_burnt(np.full(4, nan), [np.full(4, nan)], STEP) is None
    assert mt.fuel_burnt(np.full(4, 2.0), [np.full(4, nan)], STEP) is None  # a tank that nobody reports to stays full
    assert mt.fuel_burnt(np.zeros(0), [], STEP) is None


def test_an_empty_log_has_empty_metrics() -> None:
    nothing = mt.flight_metrics(made(0), STEP)
    assert (nothing.position, nothing.speed, nothing.effort) == (
        mt.PositionMetrics(),
        mt.SpeedMetrics(),
        mt.EffortMetrics(),
    )


def test_touchdown_is_the_descent_before_the_first_contact_after_a_flight() -> None:
    stand, hop, fly, land = 100, 150, 400, 100
    contact = np.repeat([True, False, True, False, True, False, True], [stand, hop, 5, fly, 3, 200, land])
    altitude = np.full(contact.size, 0.13)
    altitude[stand : stand + hop] += 0.15  # a hop at take-off
    altitude[stand + hop + 5 : stand + hop + 5 + fly] += np.linspace(0.0, 0.4, fly) * np.linspace(4.0, 0.0, fly)
    down = np.linspace(-1.0, 1.0, contact.size)
    landing = stand + hop + 5 + fly
    down[landing - 1] = 0.7
    assert mt.touchdown(contact, altitude, down) == 0.7
    assert mt.touchdown(contact[:landing], altitude[:landing], down[:landing]) is None  # still flying
    assert mt.touchdown(np.ones(50, bool), altitude[:50], down[:50]) is None  # never left
    fall = np.linspace(2.0, 0.1, 205)
    assert mt.touchdown(np.repeat([False, True], [200, 5]), fall, fall) == fall[199]  # began in the air
    assert mt.touchdown(np.zeros(0, bool), np.zeros(0), np.zeros(0)) is None


def test_missed_expectations_are_named() -> None:
    flat = {"roll.overshoot_percent": 41.25, "roll.settling_time_s": None, "altitude.rmse_m": 0.5}
    assert mt.check_expectations(flat, {"roll.overshoot_percent": Range(min=41.25, max=41.25)}) == []
    assert mt.check_expectations(flat, {"roll.overshoot_percent": Range(max=25.0)}) == [
        "roll.overshoot_percent = 41.25, expected at most 25"
    ]
    assert mt.check_expectations(flat, {"altitude.rmse_m": Range(min=1.0), "roll.settling_time_s": Range(max=2.0)}) == [
        "altitude.rmse_m = 0.5, expected at least 1",
        "roll.settling_time_s: this flight has none, expected at most 2",
    ]
    assert mt.check_expectations(flat, {"roll.overshoot": Range(min=1.0, max=2.0)}) == [
        "unknown metric 'roll.overshoot'; did you mean 'roll.overshoot_percent'? "
        "allowed: altitude.rmse_m, roll.overshoot_percent, roll.settling_time_s"
    ]


def test_every_metric_has_a_name_for_expectations() -> None:
    sink = MemorySink()
    recorder = Recorder(STEP, sink)
    for sample in samples(2000):
        recorder.observe(sample)
    recorder.flush()
    metrics = mt.flight_metrics(sink.log(), STEP)
    assert tuple(mt.flatten(metrics)) == mt.metric_names()
    assert wording.DIGITS.keys() == set(mt.metric_names())
    assert mt.flatten(metrics)["roll.rmse_rad"] == metrics.axes["roll"].rmse_rad
    assert mt.flatten(metrics)["altitude.rmse_m"] == metrics.altitude.rmse_m
    assert summarize(setup(), sink.log(), "completed", "", 1.0).flat_metrics == mt.flatten(metrics)
    roll, pitch = metrics.axes["roll"], metrics.axes["pitch"]
    assert roll.commanded
    assert not pitch.commanded
    # the made-up flight answers with zeta 0.4, each step from rest: the last step's overshoot is that of the textbook
    assert roll.overshoot_percent == pytest.approx(100.0 * exp(-0.4 * pi / sqrt(0.84)), abs=0.2)
