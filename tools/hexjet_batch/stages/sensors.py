"""The sensors over a batch: the noise of :class:`cosim.vehicle.sensors.SensorSuite`, drawn by the same generators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from hexjet_batch.numbers import Numbers, is_absent
from hexjet_batch.stages.airframe import Motion
from hexjet_batch.stages.delays import make_ring, push
from hexjet_batch.stages.rotations import Quaternion, Vector, add, multiply, rotate


class Measured(NamedTuple):
    """Values measured for the controller: body rates, attitude, velocity [NED] and height above the ground."""

    rate: Vector
    attitude: Quaternion
    velocity: Vector
    altitude: Any


class SensorState(NamedTuple):
    """State of the sensors: filtered rate, last fix, error of the lean, and values that are delayed."""

    rate: Vector
    fix: Vector
    lean: Quaternion
    rings: tuple[Any, ...]


class Noise:
    """The standard normals of every flight: rows of step ``k`` are those that its own sensors draw then.

    A step takes 13: of gyro, attitude, position and velocity three each, of the height one; then, of sensors with an
    AHRS, three of the accelerometer, by a generator of their own.  ``most``: steps of flights drawn at once.
    """

    def __init__(self, seeds: Sequence[int], with_force: bool, most: int = 2**17) -> None:
        self._sets, self._block = [], max(4, min(64, most // len(seeds)))
        for key, draws in enumerate((13, 3) if with_force else (13,)):
            generators = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,))) for seed in seeds]
            shape = self._block, draws, len(seeds)
            self._sets.append((generators, np.empty((len(seeds), self._block * draws)), np.empty(shape)))

    def at(self, k: int, together: int = 64) -> Array:
        """Return the draws of step ``k``, which must be the next; ``together``: flights that stay in the cache."""
        row = k % self._block
        if row == 0:
            for generators, values, block in self._sets:
                for generator, flight in zip(generators, values, strict=True):
                    generator.standard_normal(out=flight)
                by_step = values.reshape(len(values), *block.shape[:2])
                for first in range(0, len(values), together):
                    block[:, :, first : first + together] = by_step[first : first + together].transpose(1, 2, 0)
        parts = [block[row] for _, _, block in self._sets]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def fade(step: float, lag: Any, xp: Any) -> Any:
    """Return the share of a first-order lag [s] that is made up in a step, 1 without a lag."""
    if isinstance(lag, (int, float)):
        # The exponential of one flight is that of many.
        return 1.0 - float(np.exp(-step / lag)) if lag > 0.0 else 1.0
    return xp.where(lag > 0.0, 1.0 - xp.exp(-step / xp.where(lag > 0.0, lag, 1.0)), 1.0)


def start_sensors(n: Numbers, s: Motion, altitude: Any) -> tuple[SensorState, Measured]:
    """Return sensors settled at this state, and the values that they measure."""
    zero = 0.0 * altitude
    told = Measured(s.rate, s.attitude, s.velocity, altitude)
    values = (s.rate, s.attitude, s.velocity, (altitude,))
    rings = tuple(make_ring(late, n.xp.stack(value), n.xp) for late, value in zip(_latencies(n), values, strict=True))
    return SensorState(s.rate, s.velocity, (zero + 1.0, zero, zero, zero), rings), told


def _latencies(n: Numbers) -> list[Any]:
    sensors = n.sensors
    return [part.latency_samples for part in (sensors.gyro, sensors.attitude, sensors.gnss, sensors.barometer)]


def sample(n: Numbers, s: SensorState, k: Any, true: Motion, altitude: Any, draws: Any) -> tuple[SensorState, Measured]:
    """Return the sensors after step ``k`` and the values measured at its end; ``draws`` None: no noise."""
    xp, sensors, noisy = n.xp, n.sensors, draws is not None
    gyro, ahrs = sensors.gyro, sensors.attitude
    seen, attitude, lean = true.rate, true.attitude, s.lean
    if noisy:
        seen = add(add(seen, draws[0:3], gyro.noise_rad_s), gyro.bias_rad_s)
    if not is_absent(gyro.resolution_rad_s):
        seen = _quantise(seen, gyro.resolution_rad_s, xp)
    if not is_absent(ahrs.ahrs_time_constant_s):
        lean = _lean_error(n, lean, true, add(seen, true.rate, -1.0), draws)
        attitude = multiply(lean, attitude)
    fix = true.velocity
    if noisy:
        turn = add(tuple(0.5 * part for part in ahrs.bias_rad), draws[3:6], 0.5 * ahrs.noise_rad)
        attitude = _to_unit_quaternion(multiply(attitude, (1.0, *turn)), xp)
        altitude = altitude + sensors.barometer.noise_m * draws[12] + sensors.barometer.bias_m
        fix = add(fix, draws[9:12], sensors.gnss.velocity_noise_m_s)
    is_new = (k + 1) % sensors.gnss.period_samples == 0
    if is_new is not True:
        fix = s.fix if is_new is False else tuple(xp.where(is_new, a, b) for a, b in zip(fix, s.fix, strict=True))
    filtered = add(s.rate, add(seen, s.rate, -1.0), fade(n.step, gyro.filter_s, xp))
    values: list[Any] = [filtered, attitude, fix, (altitude,)]
    rings = list(s.rings)
    for i, late in enumerate(_latencies(n)):
        if rings[i] is not None:
            rings[i], values[i] = push(rings[i], k, late, xp.stack(values[i]), xp)
    told = Measured(tuple(values[0]), tuple(values[1]), tuple(values[2]), values[3][0])
    return SensorState(filtered, fix, lean, tuple(rings)), told


def _quantise(vector: Vector, resolution: Any, xp: Any) -> Vector:
    return tuple(resolution * xp.floor(value / resolution + 0.5) for value in vector)


def _lean_error(n: Numbers, error: Quaternion, true: Motion, gyro: Vector, draws: Any) -> Quaternion:
    """Return the next error of an AHRS's lean: :class:`cosim.vehicle.sensors.LeanError`.

    ``gyro``: its error [rad/s, body]; the accelerometer feels the specific force with its noise and bias.
    """
    xp, accelerometer, force = n.xp, n.sensors.accelerometer, true.force
    if draws is not None:
        force = add(add(force, draws[13:16], accelerometer.noise_m_s2), accelerometer.bias_m_s2)
    if not is_absent(accelerometer.resolution_m_s2):
        force = _quantise(force, accelerometer.resolution_m_s2, xp)
    turn = tuple(0.5 * n.step * part for part in gyro)
    error = _to_unit_quaternion(multiply(error, (1.0, *rotate(true.attitude, turn))), xp)
    x, y, z = force
    size = xp.sqrt(x * x + y * y + z * z)
    size = xp.where(size > 0.0, size, 1.0)
    north, east, down = rotate(multiply(error, true.attitude), (-x / size, -y / size, -z / size))
    across = xp.sqrt(north * north + east * east)
    half = 0.5 * fade(n.step, n.sensors.attitude.ahrs_time_constant_s, xp) * xp.atan2(across, down)
    sine = xp.sin(half) / xp.where(across > 0.0, across, 1.0)
    w, x, y, z = multiply((xp.cos(half), east * sine, -north * sine, 0.0), error)
    # Without its rotation about down.
    return _to_unit_quaternion((w * w + z * z, w * x + z * y, w * y - z * x, 0.0 * w), xp)


def _to_unit_quaternion(q: Quaternion, xp: Any) -> Quaternion:
    w, x, y, z = q
    scale = 1.0 / xp.sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)
