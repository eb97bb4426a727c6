"""Carried on without a receiver: against exact motion, against a Kalman filter of another make, against its deviations."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, from_euler, rotate
from cosim.base.signals import ZERO3, Measured
from cosim.control.autopilot.estimation.position import PositionEstimator
from cosim.spec.vehicle import Sensors, load_vehicle

STEP = 0.004
VEHICLE = load_vehicle("hexjet")[0]
SENSORS = VEHICLE.sensors
EVERY = SENSORS.gnss.period_samples
LATE = SENSORS.gnss.latency_samples


class DeadReckoning:
    """What predicts position and velocity beside the estimate by the lean."""

    def __init__(self, sensors: Sensors, step: float) -> None:
        gains = VEHICLE.control.position
        self.whole = PositionEstimator(gains, sensors, step, True, reckons=True)
        self.filter = self.whole.reckoning

    def predict(self, measured: Measured, by_lean: tuple[float, float]) -> None:
        self.whole._dead_reckon(measured, complex(*by_lean))

    def correct(self, fix: Measured | None, still: bool, lean: float) -> None:
        p, v = (0j, 0j) if fix is None else (complex(*fix.position[:2]), complex(*fix.velocity[:2]))
        self.whole._correct_reckoning(p, v, fix is not None, still, lean)


class Motion:
    """A vehicle with a given acceleration (held over a step), lean and heading: what its sensors say, step by step."""

    def __init__(self, off: tuple[float, float] = (0.0, 0.0), seed: int | None = None) -> None:
        self.p, self.v, self.k = np.zeros(2), np.zeros(2), 0
        self.bias = off  # m/s^2, body forward and right
        self.rng = None if seed is None else np.random.default_rng(seed)
        self.fixes = [(self.p.copy(), self.v.copy())]
        self.told: tuple[np.ndarray, np.ndarray] = (self.p.copy(), self.v.copy())

    def step(self, a: np.ndarray, yaw: float, receiver: bool = True) -> Measured:
        attitude = from_euler(0.05 * sin(0.3 * self.k * STEP), -0.1 * cos(0.2 * self.k * STEP), yaw)
        x, y, z = rotate(conjugate(attitude), (a[0], a[1], -GRAVITY))
        force = (x - self.bias[0], y - self.bias[1], z)
        if self.rng is not None:
            force = tuple(np.array(force) + SENSORS.accelerometer.noise_m_s2 * self.rng.standard_normal(3))
        self.p = self.p + STEP * (self.v + 0.5 * STEP * a)
        self.v = self.v + STEP * a
        self.k += 1
        self.fixes.append((self.p.copy(), self.v.copy()))
        if receiver and self.k > LATE and (self.k - LATE) % EVERY == 0:
            p, v = self.fixes[self.k - LATE]
            if self.rng is not None:
                p = p + SENSORS.gnss.position_noise_m * self.rng.standard_normal(2)
                v = v + SENSORS.gnss.velocity_noise_m_s * self.rng.standard_normal(2)
            self.told = (p, v)
        p, v = self.told
        return Measured(ZERO3, attitude, (*p, -10.0), (*v, 0.0), 10.0, force)


def wander(k: int) -> np.ndarray:
    t = k * STEP
    return np.array([1.2 * sin(0.5 * t), 0.8 * cos(0.35 * t)])


def test_with_perfect_sensors_it_is_the_motion_itself_whatever_the_heading() -> None:
    motion, one = Motion(), DeadReckoning(SENSORS, STEP)
    for k in range(5000):
        seen = motion.step(wander(k), 0.4 * k * STEP)
        one.predict(seen, (0.0, 0.0))
    assert one.filter.p == pytest.approx(complex(*motion.p), abs=1e-9)
    assert one.filter.v == pytest.approx(complex(*motion.v), abs=1e-9)


def test_what_the_accelerometer_is_off_by_is_learnt_while_it_turns_and_then_taken_away() -> None:
    """0.1 m/s^2 would be 3 m/s after half a minute."""
    motion, one = Motion(off=(0.1, -0.06)), DeadReckoning(SENSORS, STEP)
    for k in range(1, 12_500):
        one.whole.update(k, motion.step(wander(k), 0.2 * k * STEP, k <= 5000), False)
        if k == 5000:
            assert one.filter.u == pytest.approx(complex(0.1, -0.06), abs=2e-3)
    assert one.filter.v == pytest.approx(complex(*motion.v), abs=0.1)


def test_its_gains_are_those_of_a_kalman_filter_in_real_matrices() -> None:
    """Six real states, Joseph's form; a fix without latency, so that both compare with the same instant."""
    sensors = SENSORS.model_copy(update={"gnss": SENSORS.gnss.model_copy(update={"latency_samples": 0})})
    one = DeadReckoning(sensors, STEP)
    rng = np.random.default_rng(3)
    T = EVERY * STEP
    noise = STEP * (SENSORS.accelerometer.noise_m_s2**2 + (GRAVITY * SENSORS.attitude.noise_rad) ** 2)
    P = np.diag([0.3**2] * 2 + [0.02**2] * 2 + [0.2**2] * 2)
    R = np.diag([0.3**2] * 2 + [0.02**2] * 2)
    H = np.eye(4, 6)
    x, eye, zero = np.zeros(6), np.eye(2), np.zeros((2, 2))
    for n in range(1, 60):
        yaw = 0.3 * n * T
        turn = np.array([[cos(yaw), -sin(yaw)], [sin(yaw), cos(yaw)]])
        attitude = from_euler(0.0, 0.0, yaw)
        seen = Measured(ZERO3, attitude, ZERO3, ZERO3, 0.0, (0.0, 0.0, -GRAVITY))
        for _ in range(EVERY):
            one.predict(seen, (0.0, 0.0))
            u = turn @ x[4:]
            x[:2] += STEP * (x[2:4] + 0.5 * STEP * u)
            x[2:4] += STEP * u
        F = np.block([[eye, T * eye, 0.5 * T * T * turn], [zero, eye, T * turn], [zero, zero, eye]])
        a, b, c = noise * T**3 / 3, noise * T**2 / 2, noise * T
        Q = np.array([[a, b, 0.0], [b, c, 0.0], [0.0, 0.0, 1e-6 * T]])
        P = F @ P @ F.T + np.kron(Q, eye)
        z = np.concatenate([0.3 * rng.standard_normal(2), 0.02 * rng.standard_normal(2)])
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x = x + K @ (z - H @ x)
        P = (np.eye(6) - K @ H) @ P @ (np.eye(6) - K @ H).T + K @ R @ K.T
        one.correct(seen._replace(position=(z[0], z[1], 0.0), velocity=(z[2], z[3], 0.0)), False, 0.0)
        assert one.filter.deviation == pytest.approx(np.sqrt([P[0, 0], P[2, 2]]), rel=1e-9)
        expected = [complex(*x[i : i + 2]) for i in (0, 2, 4)]
        assert [one.filter.p, one.filter.v, one.filter.u] == pytest.approx(expected, abs=1e-9)


def test_the_deviations_are_those_of_the_errors() -> None:
    """Sixteen flights, 20 s with and 30 s without fixes; the walk of the bias is not flown, so it may be surer than it says."""
    errors: list[tuple[float, float]] = []
    for seed in range(16):
        motion, one = Motion(off=(0.05, 0.03), seed=seed), DeadReckoning(SENSORS, STEP)
        for k in range(1, 12_501):
            one.whole.update(k, motion.step(wander(k), 0.0, k <= 5000), False)
        places = motion.p - [one.filter.p.real, one.filter.p.imag]
        speeds = motion.v - [one.filter.v.real, one.filter.v.imag]
        errors += list(zip(places.tolist(), speeds.tolist(), strict=True))
    place, speed = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.2 * one.filter.deviation[0] < place < one.filter.deviation[0]
    assert 0.2 * one.filter.deviation[1] < speed < one.filter.deviation[1]
    assert one.filter.deviation[1] < 0.2


def test_who_stands_knows_that_it_does_not_move() -> None:
    motion, one = Motion(off=(0.1, 0.0)), DeadReckoning(SENSORS, STEP)
    for k in range(1, 5000):
        one.whole.update(k, motion.step(np.zeros(2), 0.0, False), still=True)
    assert one.filter.deviation[1] < 0.02
    assert abs(one.filter.v) < 0.02
    assert one.filter.u == pytest.approx(0.1, abs=5e-3)


def test_an_attitude_that_gets_worse_makes_it_less_sure_and_none_is_as_good_as_the_lean() -> None:
    motion, one, two = Motion(), DeadReckoning(SENSORS, STEP), DeadReckoning(SENSORS, STEP)
    for k in range(1, 2500):
        seen = motion.step(np.zeros(2), 0.0, False)
        one.predict(seen, (0.0, 0.0))
        two.predict(seen._replace(specific_force=(float("nan"),) * 3), (0.3, 0.0))
        if k % EVERY == 0:
            one.correct(None, False, 1e-3 * k * STEP)
            two.correct(None, False, 0.0)
    level = DeadReckoning(SENSORS, STEP)
    for k in range(1, 2500):
        level.predict(seen, (0.0, 0.0))
        if k % EVERY == 0:
            level.correct(None, False, 0.0)
    # a lean deviation c t adds (g c)^2 2 t dt to the variance of the push at t, which is a speed for T - t from there on
    # (the time between two fixes, a hundredth of it all, enters to the fourth power)
    added = one.filter.deviation[1] ** 2 - level.filter.deviation[1] ** 2
    assert added == pytest.approx((GRAVITY * 1e-3) ** 2 * (2500 * STEP) ** 4 / 6.0, rel=0.08)
    # without an accelerometer what the lean explains is what it goes by
    assert two.filter.v.real == pytest.approx(0.3 * 2499 * STEP)
    assert two.filter.deviation[1] > 1.0


def test_the_drag_learnt_at_speed_is_no_push_at_rest() -> None:
    """A linear drag, known to no one, while the receiver stops at speed and the vehicle is braked by its lean.
    With the last push kept the velocity comes out wrong by what braking took of the drag; reckoned it does not."""
    gains = VEHICLE.control.position
    speed, drag = 5.0, 0.04
    for reckons, most in ((False, None), (True, 0.05)):
        estimator = PositionEstimator(gains, SENSORS, STEP, True, reckons)
        v = p = 0.0
        told, past = (0.0, 0.0), [(0.0, 0.0)]
        for k in range(1, 10_000):
            wanted = speed if k < 5000 else 0.0
            lean = min(1.0, max(-1.0, wanted - v)) + drag * v
            a = lean - drag * v
            attitude = from_euler(0.0, -np.arctan2(lean, GRAVITY), 0.0)
            # along the thrust that holds the weight, and the drag
            force = rotate(conjugate(attitude), (a, 0.0, -GRAVITY))
            p, v = p + STEP * (v + 0.5 * STEP * a), v + STEP * a
            past.append((p, v))
            if k < 5000 and k > LATE and (k - LATE) % EVERY == 0:
                told = past[k - LATE]
            estimator.update(k, Measured(ZERO3, attitude, (told[0], 0.0, 0.0), (told[1], 0.0, 0.0), 0.0, force), False)
        wrong = abs(estimator.fix.velocity[0] - v)
        if most is None:
            assert wrong > 1.0
        else:
            assert wrong < most
            assert estimator.fix.disturbance[0] == pytest.approx(0.0, abs=0.02)
