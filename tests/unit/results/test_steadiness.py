"""Limits on settling, residual oscillation and alternating commands, from logs whose every row is known."""

from __future__ import annotations

from math import asin, hypot, pi, radians, sqrt
from typing import Any

import numpy as np
import pytest

from cosim.base.arrays import Array
from cosim.base.storage.cache import RecentCache
from cosim.results.limits import MAX_ALTERNATING_PERCENT, describe_exceedance, find_exceeded
from cosim.results.metrics import alternating_percent, settling_time
from cosim.results.steadiness import AxisLimitInputs, axis_limits, noise_floor, settling_limit

STEP, SPAN = 0.004, 0.4
AXIS = AxisLimitInputs(gain_1_s=2.5, noise_rad=0.001, rate_noise_rad_s=0.005)  # a step is to settle in 4 s
FLOOR = noise_floor(AXIS, STEP)


class Rows(dict[str, Array]):
    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self)


def flight(setpoint_deg: Array, angle_deg: Array | None = None, **others: Array) -> Rows:
    setpoint = np.radians(setpoint_deg)
    still = np.zeros(setpoint.size)
    angle = setpoint if angle_deg is None else np.radians(angle_deg)
    rows = {"roll_setpoint_rad": setpoint, "roll_rad": angle, "on_ground": still, "hull_contact": still}
    return Rows(rows | {f"wind_{way}_m_s": still for way in ("north", "east", "down")} | others)


def at(seconds: float) -> int:
    return round(seconds / STEP)


def step(size_deg: float, seconds: float = 10.0, start_s: float = 1.0) -> Array:
    return np.where(np.arange(at(seconds)) < at(start_s), 0.0, size_deg)


def response(size_deg: float, rate_1_s: float, seconds: float = 10.0) -> Array:
    t = STEP * np.arange(at(seconds)) - 1.0
    return np.where(t < 0.0, 0.0, size_deg * (1.0 - np.exp(-rate_1_s * np.maximum(t, 0.0))))


def limits(log: Rows, **stated: float | None) -> dict[str, float]:
    return axis_limits((AXIS,), log, STEP, SPAN, stated, RecentCache(8))


def test_the_noise_floor_is_what_the_sensors_noise_moves() -> None:
    assert noise_floor(AXIS, STEP) == pytest.approx(6.0 * hypot(0.001, 0.005 * sqrt(STEP / 5.0)))
    assert noise_floor(AxisLimitInputs(gain_1_s=2.5, noise_rad=0.0, rate_noise_rad_s=0.0), STEP) == 1e-3
    # what it states of the rate's noise: a first-order lag, driven by it
    noise, moved, sums = np.random.default_rng(1).normal(0.0, 0.005, 400_000), 0.0, 0.0
    for each in noise.tolist():
        moved += STEP * (each - 2.5 * moved)
        sums += moved * moved
    assert sqrt(sums / noise.size) == pytest.approx(0.005 * sqrt(STEP / 5.0), rel=0.05)


def test_a_step_is_to_settle_in_ten_time_constants() -> None:
    assert settling_limit(AXIS) == 4.0
    assert limits(flight(step(10.0), response(10.0, 1.0))) == pytest.approx(
        {"roll.settling_time_s": 4.0, "roll.oscillation_rad": radians(0.5)}
    )
    # too slow: ln 20 / 0.5 = 6 s; the limit is the same, the metric is not within it
    assert limits(flight(step(10.0), response(10.0, 0.5)))["roll.settling_time_s"] == 4.0


def behind(lag_s: float, delay_s: float, size_deg: float, seconds: float) -> Array:
    """Return the response of the attitude law through a lag or a delay, or both, to a step."""
    angle, rate, late = [0.0], 0.0, at(delay_s)
    for asked in step(size_deg, seconds).tolist()[1:]:
        wanted = AXIS.gain_1_s * (asked - (angle[-1 - late] if late < len(angle) else 0.0))
        rate = wanted if lag_s == 0.0 else rate + STEP / lag_s * (wanted - rate)
        angle.append(angle[-1] + STEP * rate)
    return np.array(angle)


@pytest.mark.parametrize(("lag_s", "delay_s", "percent"), [(0.8, 0.0, 30.0), (0.0, 0.42, 55.0)])
def test_who_overshoots_by_as_much_has_not_settled(lag_s: float, delay_s: float, percent: float) -> None:
    """Why overshoot has no limit of its own: with a lag and with a delay alone, from there on up to instability."""
    for more in (1.0, 1.15, 1.3):
        angle = behind(more * lag_s, more * delay_s, 10.0, 30.0)
        assert percent < 100.0 * (angle.max() / 10.0 - 1.0)
        setpoint = step(10.0, 30.0)
        found = settling_time(np.radians(setpoint - angle)[at(1.0) :], radians(10.0), STEP)
        assert limits(flight(setpoint, angle))["roll.settling_time_s"] == 4.0
        assert found is None or found > 4.0


def test_a_step_that_is_too_short_to_settle_tells_nothing_and_hides_nothing() -> None:
    """A short step, then one that has the time: whether it settles is what counts."""
    setpoint = np.concatenate((step(10.0, 2.0), np.full(at(8.0), 0.0)))
    t = STEP * np.arange(at(8.0))
    first = response(10.0, 1.0, 2.0)
    assert "roll.settling_time_s" not in limits(flight(step(10.0, 4.0), response(10.0, 1.0, 4.0)))
    good = np.concatenate((first, first[-1] * np.exp(-2.0 * t)))
    assert "roll.settling_time_s" not in limits(flight(setpoint, good))  # the metric is none: the first has not settled
    bad = np.concatenate((first, first[-1] * np.exp(-0.1 * t)))
    assert limits(flight(setpoint, bad))["roll.settling_time_s"] == 4.0


def test_a_small_step_is_settled_within_the_noise() -> None:
    swing = 0.8 * np.degrees(FLOOR) * np.sin(2 * pi * 2.0 * STEP * np.arange(at(10.0)))
    assert "roll.settling_time_s" not in limits(flight(step(1.0), step(1.0) + swing))
    assert "roll.settling_time_s" in limits(flight(step(1.0), step(1.0) + 2.0 * swing))


def test_a_set_point_that_moved_has_its_range_beside_the_share() -> None:
    held = np.zeros(at(10.0))
    assert limits(flight(held)) == pytest.approx({"roll.oscillation_rad": FLOOR})
    early, late = step(10.0, start_s=4.9), step(10.0, start_s=5.1)  # 4 s to settle, and the last second
    assert limits(flight(early))["roll.oscillation_rad"] == pytest.approx(radians(0.5))
    left = 10.0 * 0.05 ** (3.9 / 4.0)  # deg: 5 % of it after the 4 s that it is to settle in
    assert limits(flight(late))["roll.oscillation_rad"] == pytest.approx(radians(0.5 + left), rel=2e-3)
    last = step(10.0, start_s=9.1)  # within the last second
    assert limits(flight(last))["roll.oscillation_rad"] == pytest.approx(radians(10.5))
    turning = np.linspace(0.0, 360.0, at(10.0))  # a heading goes round: half of it in 5 s
    wrapped = (turning + 180.0) % 360.0 - 180.0
    assert limits(flight(wrapped))["roll.oscillation_rad"] == pytest.approx(FLOOR + pi, rel=2e-3)


def test_a_swing_after_a_short_last_step_is_beyond() -> None:
    """Each side of a doublet is held for 2 s, too short to settle, and the axis swings by half of it to the end."""
    setpoint = np.concatenate((step(10.0, 3.0), np.full(at(2.0), -10.0), np.zeros(at(3.0))))
    swing = 5.0 * np.sin(2 * pi * STEP * np.arange(setpoint.size))
    most = limits(flight(setpoint, setpoint + swing))["roll.oscillation_rad"]
    assert radians(0.5) < most < radians(5.0)


def changed(start_s: float, by: float) -> Array:
    return np.where(np.arange(at(10.0)) < at(start_s), 0.0, by)


@pytest.mark.parametrize(
    ("name", "by", "counts"),
    [
        ("wind_east_m_s", 0.2, True),
        ("wind_east_m_s", 0.05, False),
        ("disturbance_moment_x_N_m", 1e-3, True),
        ("payload_kg", 0.1, True),
        ("fault_jet_1", 1.0, True),
        ("on_ground", 1.0, True),
        ("throttle_1", 0.5, False),
    ],
)
def test_what_acts_anew_at_the_end_disturbs_it(name: str, by: float, counts: bool) -> None:
    level = np.zeros(at(10.0))
    most = limits(flight(level, **{name: changed(6.0, by)})).get("roll.oscillation_rad")
    blown = radians(10.0) if name.startswith("wind") else None  # the wind does not explain any swing
    assert most == (pytest.approx(blown if counts else FLOOR) if blown or not counts else None)
    if name != "on_ground":  # it stands from then on
        assert "roll.oscillation_rad" in limits(flight(level, **{name: changed(3.0, by)}))
    log = flight(step(10.0), response(10.0, 0.5), **{name: changed(2.0, by)})
    assert ("roll.settling_time_s" in limits(log)) != counts
    stated = limits(log, settling_s=3.0, oscillation_rad=0.2)  # what a scenario states holds whatever acts
    assert stated == {"roll.settling_time_s": 3.0, "roll.oscillation_rad": 0.2}
    assert limits(log, settling_s=None, oscillation_rad=None) == {}


def test_an_axis_without_a_set_point_and_a_short_flight_have_none() -> None:
    assert limits(flight(np.full(at(10.0), np.nan), np.zeros(at(10.0)))) == {}
    assert limits(flight(np.zeros(at(4.9)))) == {}
    assert axis_limits((), flight(np.zeros(at(10.0))), STEP, SPAN, {}, RecentCache(8)) == {}
    idle = AxisLimitInputs(gain_1_s=0.0, noise_rad=0.001, rate_noise_rad_s=0.005)
    assert axis_limits((idle,), flight(step(10.0)), STEP, SPAN, {}, RecentCache(8)) == {}


def test_none_is_beyond_where_a_step_could_have_settled() -> None:
    flat: dict[str, float | None] = {"roll.settling_time_s": None, "position.drift_m": None}
    most = {"roll.settling_time_s": 4.0, "position.drift_m": 10.0}
    assert find_exceeded(most, flat) == ["roll.settling_time_s"]
    assert describe_exceedance("roll.settling_time_s", most, flat) == "roll settling time none, not settled, limit 4 s"
    assert find_exceeded(most, {"roll.settling_time_s": 4.0, "position.drift_m": 10.0}) == []


def share(*commands: Array, least: float = -1.0, most: float = 1.0) -> float | None:
    return alternating_percent([(each, least, most) for each in commands], STEP)


def test_a_command_that_turns_back_at_every_step_comes_to_100() -> None:
    k = np.arange(2500)
    hunting = np.where((k >= 1000) & (k < 1300), 0.05 * (-1.0) ** k, 0.0)  # for 1.2 s, by 5 % of the range
    assert share(hunting) == 100.0
    assert share(np.zeros(2500), hunting, 0.1 * np.sin(0.01 * k)) == 100.0
    assert share(0.9 * 0.01 / 0.05 * hunting) == 0.0  # steps of 0.9 % of the range
    turns = share(0.9 * np.sin(2 * pi * 20.0 * STEP * k))  # 40 a second of 250 steps, less those at a blunt top
    assert turns is not None
    assert 0.0 < turns <= 16.0


def test_noise_does_not_reach_the_limit_however_strong() -> None:
    """Three numbers in any order: the middle one is an extreme in 4 of 6.  And of differences, 73 %."""
    rng = np.random.default_rng(2)
    noise = rng.normal(0.0, 0.5, 60 * 250 + 1)
    for command, mean in ((noise, 2 / 3), (np.diff(noise), 0.5 + asin(2 / 3) / pi)):
        turns = np.diff(command)
        assert np.mean(turns[1:] * turns[:-1] < 0.0) == pytest.approx(mean, abs=0.01)
        worst = share(command)
        assert worst is not None
        assert 100.0 * mean - 5.0 < worst < MAX_ALTERNATING_PERCENT - 4.0


def test_alternation_is_not_told_without_a_second_or_a_range() -> None:
    known: Any = np.zeros(2500)
    assert share() is None
    assert share(known[:200]) is None
    assert share(known, least=1.0, most=1.0) is None
    assert share(np.full(2500, np.nan)) is None
    assert share(known) == 0.0
