"""Sensors and servos: closed forms for lag, latency and hold, statistics for the noise."""

from __future__ import annotations

from math import atan2, exp, sin, sqrt

import numpy as np
import pytest

from cosim.base import frames
from cosim.base.signals import ZERO3, Measured, State
from cosim.spec.vehicle import Sensors, Servo, load_vehicle
from cosim.vehicle._noise import Noise
from cosim.vehicle.sensors import Latency, SensorSuite
from cosim.vehicle.servo import TiltServo

STEP = 0.004
VEHICLE, _ = load_vehicle("hexjet")


def state(rate: float = 0.0, height: float = 10.0, north: float = 0.0) -> State:
    position, euler = (north, 0.0, -height), (0.1, -0.2, 0.3)
    attitude, force = frames.from_euler(*euler), (0.0, 0.0, -9.8)
    moving = (position, (1.0, 2.0, -3.0), attitude, euler, (rate, 0.0, -rate), force)
    return State(*moving, height, ZERO3, 5.5, False, False)


def suite(noisy: bool = False, seed: int = 1, **changes: dict[str, object]) -> SensorSuite:
    data = VEHICLE.sensors.model_dump()
    for sensor, values in changes.items():
        data[sensor] |= values
    return SensorSuite(Sensors.model_validate(data), STEP, seed, noisy)


def record(sensors: SensorSuite, states: list[State]) -> list[Measured]:
    sensors.reset(states[0])
    return [sensors.sample(s) for s in states]


def test_gyro_filter_is_the_exact_lag_of_a_held_rate() -> None:
    """1 - exp(-t / tau) at the samples."""
    sensors = suite()
    sensors.reset(state())
    ours = [sensors.sample(state(2.0)).rate[0] for _ in range(20)]
    assert ours == pytest.approx([2.0 * (1 - exp(-(n + 1) * STEP / 0.009)) for n in range(20)], rel=1e-12)


def test_without_filter_and_noise_the_truth_comes_through() -> None:
    sensors = suite(gyro={"filter_s": 0.0}, gnss={"period_samples": 1, "latency_samples": 0})
    truth = state(1.0)
    sensors.reset(state())
    seen = sensors.sample(truth)
    force = truth.specific_force
    assert seen == Measured(truth.rate, truth.attitude, truth.position, truth.velocity, truth.altitude, force)


def test_the_accelerometer_draws_its_noise_apart() -> None:
    """Stated noise and bias; and what the other sensors say is the same, whatever the accelerometer does."""
    quiet = suite(True, accelerometer={"noise_m_s2": 0.0, "bias_m_s2": (0.0, 0.0, 0.0)})
    loud = suite(True, accelerometer={"noise_m_s2": 0.5, "bias_m_s2": (0.1, 0.2, -0.3), "latency_samples": 1})
    states = [state()] * 4001
    one, other = record(quiet, states), record(loud, states)
    assert [each[:5] for each in one] == [each[:5] for each in other]
    felt = np.array([each.specific_force for each in other[1:]]) - np.array(states[0].specific_force)
    # the mean of 4000 draws is within 4 of its own deviations, and so is their deviation
    assert felt.mean(axis=0) == pytest.approx((0.1, 0.2, -0.3), abs=4 * 0.5 / sqrt(4000))
    assert felt.std(axis=0) == pytest.approx((0.5,) * 3, rel=4 / sqrt(8000))
    assert other[0].specific_force == states[0].specific_force


def test_latency_is_whole_samples() -> None:
    line: Latency[int] = Latency(3)
    line.reset(-1)
    assert [line.update(n) for n in range(6)] == [-1, -1, -1, 0, 1, 2]
    sensors = suite(gyro={"filter_s": 0.0, "latency_samples": 2}, barometer={"latency_samples": 1})
    seen = record(sensors, [state(float(n), 10.0 + n) for n in range(6)])
    assert [m.rate[0] for m in seen] == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]
    assert [m.altitude for m in seen] == [10.0, 10.0, 11.0, 12.0, 13.0, 14.0]


def test_gnss_is_sampled_and_held_and_late() -> None:
    sensors = suite(gnss={"period_samples": 3, "latency_samples": 1})
    seen = record(sensors, [state(north=float(n)) for n in range(1, 11)])
    assert [m.position[0] for m in seen] == [1, 1, 1, 3, 3, 3, 6, 6, 6, 9]


def test_noise_has_the_stated_size_and_no_mean() -> None:
    n = 20_000
    seen = record(suite(True, gyro={"filter_s": 0.0}, gnss={"period_samples": 1}), [state()] * n)[100:]
    sensors = VEHICLE.sensors
    pairs = [
        ([m.rate[1] for m in seen], sensors.gyro.noise_rad_s),
        ([m.altitude - 10.0 for m in seen], sensors.barometer.noise_m),
        ([m.position[0] for m in seen], sensors.gnss.position_noise_m),
        ([m.velocity[2] + 3.0 for m in seen], sensors.gnss.velocity_noise_m_s),
    ]
    truth = state().attitude
    error = [frames.multiply(frames.conjugate(truth), m.attitude) for m in seen]
    pairs += [([2.0 * q[axis] for q in error], sensors.attitude.noise_rad) for axis in (1, 2, 3)]
    for values, sigma in pairs:
        # 4 standard errors of the deviation and of the mean
        assert np.std(values) == pytest.approx(sigma, rel=4 / np.sqrt(2 * n))
        assert abs(np.mean(values)) < 4 * sigma / np.sqrt(n)


def test_bias_is_added_and_can_be_switched_off() -> None:
    biased = {
        "gyro": {"filter_s": 0.0, "noise_rad_s": 0.0, "bias_rad_s": (0.1, 0.0, 0.0)},
        "barometer": {"noise_m": 0.0, "bias_m": 2.0},
    }
    seen = record(suite(True, **biased), [state()] * 3)
    assert seen[2].rate[0] == pytest.approx(0.1)
    assert seen[2].altitude == pytest.approx(12.0)
    assert record(suite(False, **biased), [state()] * 3)[2].rate[0] == 0.0


def test_noise_follows_the_seed_alone() -> None:
    rates = [[m.rate for m in record(suite(True, seed), [state()] * 600)] for seed in (1, 1, 2)]
    assert rates[0] == rates[1]
    assert rates[0] != rates[2]


G = 9.80665


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"gyro": {"bias_sigma_rad_s": 0.01, "latency_samples": 2}, "attitude": {"bias_rad": (0.01, -0.02, 0.03)}},
        {"gnss": {"period_samples": 3, "latency_samples": 1}, "barometer": {"bias_m": 0.4, "latency_samples": 1}},
        {"gyro": {"filter_s": 0.0}, "accelerometer": {"bias_m_s2": (0.1, 0.2, -0.3), "latency_samples": 4}},
    ],
)
def test_all_at_once_is_one_after_the_other_to_the_last_bit(changes: dict[str, dict[str, object]]) -> None:
    at_once, each = suite(noisy=True, seed=7, **changes), suite(noisy=True, seed=7, **changes)
    assert at_once._noise is not None
    each._noise = None
    angles = np.random.default_rng(1).uniform(-1.0, 1.0, (600, 3)).tolist()
    states = [
        state(rate=roll, height=20.0 + pitch, north=yaw)._replace(attitude=frames.from_euler(roll, pitch, 3.0 * yaw))
        for roll, pitch, yaw in angles
    ]
    assert record(at_once, states) == record(each, states)
    assert record(at_once, states) == record(each, states)  # after a reset too


@pytest.mark.parametrize(
    "changes", [{"gyro": {"resolution_rad_s": 0.001}}, {"attitude": {"ahrs_time_constant_s": 5.0}}]
)
def test_sensors_with_more_than_noise_take_it_step_by_step(changes: dict[str, dict[str, object]]) -> None:
    assert suite(noisy=True, **changes)._noise is None
    assert suite(noisy=False)._noise is None


def test_wrong_draws_and_states_are_refused() -> None:
    noise = Noise((0.1, ZERO3), (0.1, ZERO3), (0.1, 0.1), (0.1, 0.0), (0.1, ZERO3), 0.5)
    with pytest.raises(TypeError, match="while there are draws"):
        noise.sample(state(), ZERO3, True)
    with pytest.raises(ValueError, match="float64 of 13 columns"):
        noise.fill(np.zeros((2, 12)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="as many rows"):
        noise.fill(np.zeros((2, 13)), np.zeros((3, 3)))
    noise.fill(np.zeros((1, 13)), np.zeros((1, 3)))
    with pytest.raises(TypeError, match="takes a state"):
        noise.sample((1.0, 2.0), ZERO3, True)
    with pytest.raises(TypeError, match="not 3 floats"):
        noise.sample(state(), (0.0, 0.0), True)
    noise.sample(state(), ZERO3, True)
    with pytest.raises(TypeError, match="while there are draws"):
        noise.sample(state(), ZERO3, True)


def moving(acceleration: tuple[float, float, float], euler: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> State:
    """With this acceleration, m/s^2, NED, at this attitude; the rates are none."""
    attitude = frames.from_euler(*euler)
    north, east, down = acceleration
    force = frames.rotate(frames.conjugate(attitude), (north, east, down - G))
    return state()._replace(attitude=attitude, euler=euler, rate=(0.0,) * 3, specific_force=force)


def lean_error(measured: Measured, truth: State) -> tuple[float, float, float]:
    """The rotation vector, rad, NED, from the true attitude to the measured one."""
    w, *axis = frames.multiply(measured.attitude, frames.conjugate(truth.attitude))
    size = sqrt(sum(part * part for part in axis))
    angle = 2.0 * atan2(size, w)
    x, y, z = (part / size * angle if size else 0.0 for part in axis)
    return (x, y, z)


@pytest.mark.parametrize("euler", [(0.0, 0.0, 0.0), (0.3, -0.2, 2.0)])
@pytest.mark.parametrize(("north", "east"), [(3.0, 0.0), (0.0, -2.0), (1.5, 4.0)])
def test_a_lasting_acceleration_becomes_a_lean(north: float, east: float, euler: tuple[float, float, float]) -> None:
    """atan(a/g) (1 - exp(-t/tau)) about the horizontal axis across it, whatever the attitude: exact at the samples."""
    tau = 0.5
    sensors = suite(attitude={"ahrs_time_constant_s": tau})
    truth = moving((north, east, 0.0), euler)
    a = sqrt(north * north + east * east)
    for n, seen in enumerate(record(sensors, [truth] * 2000), 1):
        lean = atan2(a, G) * (1.0 - exp(-n * STEP / tau))
        # forward is taken for nose up, to the right for the right wing down: about (-east, north, 0)
        assert lean_error(seen, truth) == pytest.approx((-east / a * lean, north / a * lean, 0.0), abs=1e-9)
    assert lean == pytest.approx(atan2(a, G), rel=1e-6)


def test_no_acceleration_no_error() -> None:
    """Turning about all axes without acceleration, and climbing harder: the vertical stays where it is."""
    sensors = suite(attitude={"ahrs_time_constant_s": 0.2})
    states = [moving((0.0, 0.0, -2.0), (0.5 * sin(0.01 * n), 0.3 * sin(0.02 * n), 0.003 * n)) for n in range(1000)]
    for seen, truth in zip(record(sensors, states), states, strict=True):
        assert lean_error(seen, truth) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("bias", [(0.01, -0.02, 0.0), (0.0, 0.0, 0.05), (0.01, -0.02, 0.05)])
def test_a_bias_of_the_gyro_leans_and_leaves_the_heading(bias: tuple[float, float, float]) -> None:
    """b tau: of a first-order lag driven by b T a step, b T (1 - s) / s with s = 1 - exp(-T / tau).
    The magnetometer turns the estimate, lean included, back about the vertical by what the bias in yaw has turned it, so
    the error e = x + i y obeys e' = b - e / tau - i b_z e."""
    quiet = {"noise_rad": 0.0, "bias_rad": (0.0, 0.0, 0.0)}
    sensors = suite(
        True,
        gyro={"noise_rad_s": 0.0, "bias_rad_s": bias},
        accelerometer={"noise_m_s2": 0.0, "bias_m_s2": (0.0, 0.0, 0.0)},
        attitude={**quiet, "ahrs_time_constant_s": 2.0},
    )
    truth = moving((0.0, 0.0, 0.0))
    found = lean_error(record(sensors, [truth] * 10_000)[-1], truth)
    s = 1.0 - exp(-STEP / 2.0)
    held = STEP * (1.0 - s) / s
    assert held == pytest.approx(2.0, rel=2e-3)
    lean = complex(bias[0], bias[1]) / (1.0 / held + 1j * bias[2])
    # of second order in the lean, and a step in the time constant
    assert found == pytest.approx((lean.real, lean.imag, 0.0), abs=0.045 * (0.045**2 + STEP / 2.0 * 0.1))
    if not (bias[0] or bias[1]):
        assert found == (0.0, 0.0, 0.0)


def test_a_bias_of_the_accelerometer_leans() -> None:
    sensors = suite(
        True,
        gyro={"noise_rad_s": 0.0},
        accelerometer={"noise_m_s2": 0.0, "bias_m_s2": (0.0, 0.05, 0.0)},
        attitude={"noise_rad": 0.0, "ahrs_time_constant_s": 0.5},
    )
    truth = moving((0.0, 0.0, 0.0))
    assert lean_error(record(sensors, [truth] * 3000)[-1], truth) == pytest.approx(
        (-atan2(0.05, G), 0.0, 0.0), abs=1e-9
    )


def test_in_free_fall_the_gyro_is_alone() -> None:
    sensors = suite(attitude={"ahrs_time_constant_s": 0.5})
    truth = moving((2.0, 0.0, 0.0))
    falling = truth._replace(specific_force=(0.0, 0.0, 0.0))
    seen = record(sensors, [truth] * 100 + [falling] * 100)
    assert lean_error(seen[99], truth)[1] > 0.1
    assert seen[100].attitude == pytest.approx(seen[99].attitude, abs=1e-12)
    assert seen[-1].attitude == pytest.approx(seen[99].attitude, abs=1e-12)


def test_without_the_time_constant_the_lean_is_the_true_one() -> None:
    """Zero is the default; a second reset forgets."""
    states = [moving((3.0, 1.0, 0.0), (0.1, 0.0, 0.0))] * 300
    assert record(suite(True, attitude={"ahrs_time_constant_s": 0.0}), states) == record(suite(True), states)
    sensors = suite(attitude={"ahrs_time_constant_s": 1.0})
    assert record(sensors, states) == record(sensors, states)
    with pytest.raises(ValueError, match="ahrs_time_constant_s"):
        suite(attitude={"ahrs_time_constant_s": -1.0})


def test_servo_is_the_exact_lag_of_a_held_command() -> None:
    servo = TiltServo(Servo(lag_s=0.02, rate_limit_rad_s=100.0, range_rad=0.5), STEP)
    ours = [servo.update(0.3) for _ in range(20)]
    assert ours == pytest.approx([0.3 * (1 - exp(-(n + 1) * STEP / 0.02)) for n in range(20)], rel=1e-12)


def test_servo_limits_rate_and_range() -> None:
    servo = TiltServo(Servo(lag_s=0.0, rate_limit_rad_s=10.0, range_rad=0.1), STEP)
    assert [servo.update(9.0) for _ in range(4)] == pytest.approx([0.04, 0.08, 0.1, 0.1])
    assert [servo.update(-9.0) for _ in range(6)] == pytest.approx([0.06, 0.02, -0.02, -0.06, -0.1, -0.1])
    servo.reset(0.05)
    assert servo.angle == 0.05
