"""The profile of measured sensors: its values in the measured columns, its precedence, its names, and nothing by default."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Scenario, fly
from cosim.base import frames
from cosim.base.errors import InputError
from cosim.base.signals import State
from cosim.campaign.study.keys import all_keys, with_values
from cosim.spec.vehicle import Sensors, load_vehicle
from cosim.spec.vehicle.sensor_profile import describe_profile, profile_names
from cosim.vehicle.sensors import SensorSuite

DOUBLET = Scenario.load("roll-doublet")
STEP = DOUBLET.step_s
SHORT = {"duration_s": 0.4, "command": [], "expect": []}
QUIET = {
    "gyro": {"filter_s": 0.0, "noise_rad_s": 0.0},
    "attitude": {"noise_rad": 0.0},
    "accelerometer": {"noise_m_s2": 0.0},
}
LATENCY_S, TAU_S = 0.012, 5.0
SIGMA_RAD_S, SIGMA_M_S2 = 0.0026, 0.049
LSB_RAD_S, LSB_M_S2 = np.radians(1.0) / 16.4, 9.80665 / 2048


def state(rate: float = 0.0) -> State:
    """10 m above the ground at some attitude, turning about roll and yaw."""
    euler = (0.1, -0.2, 0.3)
    at, speed, force = (0.0, 0.0, -10.0), (1.0, 2.0, -3.0), (0.0, 0.0, -9.8)
    turning = (rate, 0.0, -rate)
    return State(at, speed, frames.from_euler(*euler), euler, turning, force, 10.0, (0.0,) * 3, 5.5, False, False)


def flown(**changes: Any) -> Sensors:
    return DOUBLET.replace(**changes).resolved_vehicle()[0].sensors


def suite(sensors: Sensors, noisy: bool, seed: int = 1, changes: Mapping[str, Mapping[str, Any]] = {}) -> SensorSuite:
    data = sensors.model_dump()
    for sensor, values in changes.items():
        data[sensor] |= values
    return SensorSuite(Sensors.model_validate(data), STEP, seed, noisy)


def test_nothing_changes_without_it() -> None:
    """Not named and named ``stated`` is the aircraft's own, and the flight the same to the last bit."""
    own = load_vehicle("hexjet")[0].sensors
    assert flown() == flown(sensors="stated") == own
    assert own.gyro.bias_sigma_rad_s == own.gyro.resolution_rad_s == own.accelerometer.resolution_m_s2 == 0.0
    one, other = fly(DOUBLET.replace(**SHORT)), fly(DOUBLET.replace(sensors="stated", **SHORT))
    assert all(np.array_equal(one.log[name], other.log[name], equal_nan=True) for name in one.log)
    assert one.summary.sensors == other.summary.sensors == ""


def test_it_stands_over_the_aircraft_and_under_the_scenario() -> None:
    own, measured = flown(), flown(sensors="measured")
    assert measured.attitude.latency_samples == round(LATENCY_S / STEP)
    assert measured.attitude.ahrs_time_constant_s == TAU_S
    assert (measured.gyro.bias_sigma_rad_s, measured.accelerometer.bias_sigma_m_s2) == (SIGMA_RAD_S, SIGMA_M_S2)
    assert measured.gyro.resolution_rad_s == pytest.approx(LSB_RAD_S, rel=1e-6)
    assert measured.accelerometer.resolution_m_s2 == pytest.approx(LSB_M_S2, rel=1e-6)
    kept = ("filter_s", "noise_rad_s", "bias_rad_s", "latency_samples")
    assert all(getattr(measured.gyro, key) == getattr(own.gyro, key) for key in kept)
    assert (measured.gnss, measured.barometer) == (own.gnss, own.barometer)
    stated = {"sensors": {"attitude": {"ahrs_time_constant_s": 0.0}}}
    mine = flown(sensors="measured", vehicle=stated).attitude
    assert (mine.ahrs_time_constant_s, mine.latency_samples) == (0.0, 3)


def test_latency_is_the_same_time_at_another_step() -> None:
    quadrotor = Scenario.load("hover").replace(aircraft="quadrotor", engine="motor", sensors="measured", expect=[])
    assert quadrotor.step_s == 0.0025
    assert quadrotor.resolved_vehicle()[0].sensors.attitude.latency_samples == round(LATENCY_S / 0.0025) == 5


def test_attitude_comes_late() -> None:
    sensors = suite(flown(sensors="measured"), False, changes={"attitude": {"ahrs_time_constant_s": 0.0}})
    turning = [state()._replace(attitude=frames.from_euler(0.01 * n, 0.0, 0.0)) for n in range(8)]
    sensors.reset(turning[0])
    seen = [sensors.sample(each).attitude for each in turning]
    assert seen == [turning[max(0, n - 3)].attitude for n in range(8)]


@pytest.mark.parametrize("rate", [0.0, 0.7 * LSB_RAD_S, 1.0, -0.123456])
def test_gyro_and_accelerometer_give_whole_steps(rate: float) -> None:
    """The nearest whole multiples, with noise off too; the filter is behind them."""
    measured = flown(sensors="measured")
    sensors = suite(measured, False, changes={"gyro": {"filter_s": 0.0}})
    sensors.reset(state())
    seen, truth = sensors.sample(state(rate)), state(rate)
    for values, true, step in (
        (seen.rate, truth.rate, measured.gyro.resolution_rad_s),
        (seen.specific_force, truth.specific_force, measured.accelerometer.resolution_m_s2),
    ):
        assert values == pytest.approx([step * np.floor(each / step + 0.5) for each in true], abs=1e-15)
        assert all(abs(one - other) <= step / 2 + 1e-12 for one, other in zip(values, true, strict=True))


def test_bias_is_one_constant_a_flight_from_its_seed() -> None:
    """Of the stated deviation over seeds, none with noise off, the same again, and other sensors' noise as before."""
    measured = flown(sensors="measured")
    exact = {**QUIET, "gyro": {**QUIET["gyro"], "resolution_rad_s": 0.0}}
    exact["accelerometer"] = {**QUIET["accelerometer"], "resolution_m_s2": 0.0}
    still = state()._replace(rate=(0.0, 0.0, 0.0), specific_force=(0.0, 0.0, 0.0))
    rates, forces = [], []
    for seed in range(400):
        sensors = suite(measured, True, seed, exact)
        sensors.reset(still)
        first, later = sensors.sample(still), sensors.sample(still)
        assert first.rate == later.rate
        rates.append(first.rate)
        forces.append(first.specific_force)
    for values, sigma in ((rates, SIGMA_RAD_S), (forces, SIGMA_M_S2)):
        drawn = np.ravel(values)
        assert np.std(drawn) == pytest.approx(sigma, rel=4 / np.sqrt(2 * drawn.size))  # 4 standard errors
        assert abs(np.mean(drawn)) < 4 * sigma / np.sqrt(drawn.size)
    again, silent = suite(measured, True, 7, exact), suite(measured, False, 7, exact)
    again.reset(still)
    silent.reset(still)
    assert again.sample(still).rate == rates[7]
    assert silent.sample(still).rate == (0.0, 0.0, 0.0)
    plain, biased = suite(flown(), True), suite(flown(), True, changes={"gyro": {"bias_sigma_rad_s": 0.1}})
    assert plain.reset(still) == biased.reset(still)
    one, other = plain.sample(still), biased.sample(still)
    assert one.rate != other.rate
    assert (one.attitude, one.altitude, one.position) == (other.attitude, other.altitude, other.position)


def test_a_run_says_which_sensors_and_flies_again(tmp_path: Path) -> None:
    run = fly(DOUBLET.replace(sensors="measured", **SHORT), out=tmp_path / "run")
    assert run.summary.sensors == describe_profile("measured")
    assert run.summary.sensors.startswith("measured (sensors.toml ")
    assert run.summary.sensors in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    again = fly(Scenario.load(tmp_path / "run" / "scenario.toml"))
    assert all(np.array_equal(run.log[name], again.log[name], equal_nan=True) for name in run.log)
    with pytest.raises(InputError, match=r"sensors: the file itself states gyro\.bias_sigma_rad_s"):
        Scenario.load(tmp_path / "run" / "scenario.toml", ["sensors=stated"])


def test_a_wrong_name_is_told_with_the_right_ones() -> None:
    assert profile_names() == ["stated", "measured"]
    with pytest.raises(InputError, match=r"sensors mesured: must be stated, measured, FILE\.py:Name, "):
        fly(DOUBLET.replace(sensors="mesured", **SHORT))


def test_a_study_varies_the_sensor_profile() -> None:
    key = next(key for key in all_keys(DOUBLET) if key.path == "sensors")
    assert (key.nominal, key.choices) == ("stated", ("stated", "measured"))
    assert with_values(DOUBLET, {"sensors": "measured"}).resolved_vehicle()[0].sensors == flown(sensors="measured")
