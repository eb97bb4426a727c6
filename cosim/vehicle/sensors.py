"""The sensors of the controller: gyro, attitude, GNSS, barometer and accelerometer, with noise, bias, lag and latency.

The noise comes from a generator of its own, seeded by the scenario, so that a change elsewhere does not change it; the
accelerometer's from another one, so that what the other sensors give is the same with it as it was without, and the
constant biases that a flight draws from a third.
"""

from __future__ import annotations

from math import atan2, cos, exp, floor, hypot, sin, sqrt
from typing import Any, Final, Generic, TypeVar

import numpy as np

from cosim.base.frames import IDENTITY, multiply, normalize, rotate
from cosim.base.protocols import Sensors
from cosim.base.signals import ZERO3, Measured, Quaternion, State, Vector3
from cosim.spec.scenario import SensorBias, SensorDropout, SensorFault
from cosim.spec.vehicle import Sensors as SensorSettings
from cosim.vehicle._noise import Noise

T = TypeVar("T")  # type of a delayed value
Fix = tuple[Any, Any]  # vectors of position and velocity

# Steps drawn at once, and standard normal numbers per step: for all sensors but the accelerometer, and for that.
_DRAW_SHAPE, _FORCE_DRAW_SHAPE = (256, 13), (256, 3)
_MEASURED: Final = Measured  # direct access in compiled code


class Latency(Generic[T]):
    """Delays a value by a whole number of updates."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self._line: list[T] = []
        self._at = 0

    def reset(self, value: T) -> None:
        """Start as if ``value`` had always been the input."""
        self._line = [value] * self.samples
        self._at = 0

    def update(self, value: T) -> T:
        if self.samples == 0:
            return value
        line, at = self._line, self._at
        old = line[at]
        line[at] = value
        self._at = at + 1 if at + 1 < self.samples else 0
        return old


class LeanError:
    """Lean error of an AHRS, a complementary filter that takes specific force as vertical.

    The gyro carries the attitude on, and it is turned back about a horizontal axis to where the specific force is
    straight up, with the time constant ``tau``: of the angle between, ``1 - exp(-T/tau)`` in each step ``T``. The
    law is that of Mahony, Hamel and Pflimlin ("Nonlinear Complementary Filters on the Special Orthogonal Group",
    IEEE Trans. Automatic Control 53, 2008) with gain ``1/tau``, no integral term, and the angle in place of its
    sine. A horizontal acceleration ``a`` that lasts thus becomes a lean of ``atan(a/g)``, approached as ``1 -
    exp(-t/tau)``, and a gyro's bias ``b`` one of ``b tau``. The heading has no error: a magnetometer turns it back
    about the vertical, at once. No acceleration is refused for its size.

    The state is the rotation from the true attitude to the estimated one, in NED: a gyro without error keeps it.
    """

    def __init__(self, tau: float, step: float) -> None:
        self._dt = step
        self._filter_gain = 1.0 - exp(-step / tau)
        self.reset()

    def reset(self) -> None:
        """Align with the true attitude."""
        self._error: Quaternion = IDENTITY

    def update(self, attitude: Quaternion, gyro: Vector3, force: Vector3) -> Quaternion:
        """Return ``attitude`` with the lean error; ``gyro``: the gyro's error [rad/s, body]; ``force``: as measured."""
        dt, (p, q, r) = self._dt, gyro
        n, e, d = rotate(attitude, (0.5 * dt * p, 0.5 * dt * q, 0.5 * dt * r))
        error = normalize(multiply(self._error, (1.0, n, e, d)))
        x, y, z = force
        size = sqrt(x * x + y * y + z * z)
        if size > 0.0:  # in free fall only the gyro can be used
            n, e, d = rotate(multiply(error, attitude), (-x / size, -y / size, -z / size))
            across = hypot(n, e)
            if across > 0.0:
                half = 0.5 * self._filter_gain * atan2(across, d)
                sine = sin(half) / across
                error = multiply((cos(half), e * sine, -n * sine, 0.0), error)
        w, x, y, z = error
        # The attitude error without its rotation about the vertical.
        self._error = normalize((w * w + z * z, w * x + z * y, w * y - z * x, 0.0))
        return multiply(self._error, attitude)


class SensorSuite:
    """All sensors of the vehicle, sampled once a control step.

    The gyro's filter is ``y += (1 - exp(-T/tau)) (rate - y)``: pole ``a = exp(-T/tau)``, a delay of ``a / (1 - a)``
    samples at rest.  A value is rounded to the sensor's resolution with its noise and bias in it, before the filter.
    ``noisy`` False leaves filter, latency, hold and resolution, and takes away noise and bias.
    """

    def __init__(self, sensors: SensorSettings, step: float, seed: int, noisy: bool) -> None:
        self._noisy = noisy
        self._seed = seed
        gyro, attitude, gnss, barometer = sensors.gyro, sensors.attitude, sensors.gnss, sensors.barometer
        self._filter_gain = 1.0 - exp(-step / gyro.filter_s) if gyro.filter_s > 0.0 else 1.0
        on = 1.0 if noisy else 0.0
        self._gyro_noise = gyro.noise_rad_s * on
        # Biases have a random stream of their own; keys 0 and 1 are those of noise.
        drawn = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6,))).standard_normal(6).tolist()
        self._gyro_bias = _draw_bias(gyro.bias_rad_s, gyro.bias_sigma_rad_s, drawn[:3], on)
        self._gyro_resolution = gyro.resolution_rad_s
        self._attitude_noise = attitude.noise_rad * on
        self._attitude_bias = _scale(attitude.bias_rad, on)
        tau = attitude.ahrs_time_constant_s
        self._lean = LeanError(tau, step) if tau > 0.0 else None
        self._position_noise = gnss.position_noise_m * on
        self._velocity_noise = gnss.velocity_noise_m_s * on
        self._height_noise = barometer.noise_m * on
        self._height_bias = barometer.bias_m * on
        self._period = gnss.period_samples
        self._gyro_line: Latency[Any] = Latency(gyro.latency_samples)
        self._attitude_line: Latency[Any] = Latency(attitude.latency_samples)
        self._gnss_line: Latency[Any] = Latency(gnss.latency_samples)
        self._height_line: Latency[Any] = Latency(barometer.latency_samples)
        self._has_latency = gyro.latency_samples + attitude.latency_samples + barometer.latency_samples > 0
        accelerometer = sensors.accelerometer
        self._force_noise = accelerometer.noise_m_s2 * on
        self._force_bias = _draw_bias(accelerometer.bias_m_s2, accelerometer.bias_sigma_m_s2, drawn[3:], on)
        self._force_resolution = accelerometer.resolution_m_s2
        self._force_line: Latency[Any] = Latency(accelerometer.latency_samples)
        plain = noisy and self._lean is None and not (self._gyro_resolution > 0.0 or self._force_resolution > 0.0)
        self._noise = self._make_noise() if plain else None  # draws all noise in one call if it can
        self._draws: list[list[float]] = []
        self._force_draws: list[list[float]] = []

    def _make_noise(self) -> Any:
        return Noise(
            (self._gyro_noise, self._gyro_bias),
            (self._attitude_noise, self._attitude_bias),
            (self._position_noise, self._velocity_noise),
            (self._height_noise, self._height_bias),
            (self._force_noise, self._force_bias),
            self._filter_gain,
        )

    def reset(self, state: State) -> Measured:
        """Restart as if the vehicle had always been in ``state``; the same noise follows."""
        self._rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(0,)))
        self._force_rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(1,)))
        self._draws, self._force_draws = [], []
        self._left = 0
        self._count = 0
        self._rate: Any = state.rate
        self._fix: Any = (state.position, state.velocity)
        self._gyro_line.reset(state.rate)
        self._attitude_line.reset(state.attitude)
        self._gnss_line.reset(self._fix)
        self._height_line.reset(state.altitude)
        force = state.specific_force
        self._force_line.reset(force)
        if self._lean:
            self._lean.reset()
        return Measured(state.rate, state.attitude, state.position, state.velocity, state.altitude, force)

    def sample(self, state: State) -> Measured:
        """Return the measurements at the end of a step, from the true ``state`` there."""
        self._count += 1
        new_fix = self._count % self._period == 0
        if self._noise is not None:
            return self._sample_at_once(self._noise, state, new_fix)
        p, q, r = state.rate
        attitude = state.attitude
        altitude = state.altitude
        force = state.specific_force
        position, velocity = state.position, state.velocity
        gyro_error = ZERO3
        n: list[float] = []
        if self._noisy:
            m = _draw_normals(self._force_draws, self._force_rng, _FORCE_DRAW_SHAPE)
            s = self._force_noise
            x, y, z = force
            bx, by, bz = self._force_bias
            force = (x + s * m[0] + bx, y + s * m[1] + by, z + s * m[2] + bz)
            n = _draw_normals(self._draws, self._rng, _DRAW_SHAPE)
            s = self._gyro_noise
            bp, bq, br = self._gyro_bias
            gyro_error = (s * n[0] + bp, s * n[1] + bq, s * n[2] + br)
            p += gyro_error[0]
            q += gyro_error[1]
            r += gyro_error[2]
        if self._force_resolution > 0.0:
            force = _quantise(force, self._force_resolution)
        if self._gyro_resolution > 0.0:
            p, q, r = _quantise((p, q, r), self._gyro_resolution)
            gyro_error = (p - state.rate[0], q - state.rate[1], r - state.rate[2])
        if self._lean:
            attitude = self._lean.update(attitude, gyro_error, force)
        if self._noisy:
            s = 0.5 * self._attitude_noise
            ax, ay, az = self._attitude_bias
            attitude = normalize(
                multiply(attitude, (1.0, s * n[3] + 0.5 * ax, s * n[4] + 0.5 * ay, s * n[5] + 0.5 * az))
            )
            altitude += self._height_noise * n[12] + self._height_bias
            if new_fix:
                s, t = self._position_noise, self._velocity_noise
                x, y, z = position
                u, v, w = velocity
                position = (x + s * n[6], y + s * n[7], z + s * n[8])
                velocity = (u + t * n[9], v + t * n[10], w + t * n[11])
        filtered: Vector3 = self._rate
        fp, fq, fr = filtered
        gain = self._filter_gain
        self._rate = rate = (fp + gain * (p - fp), fq + gain * (q - fq), fr + gain * (r - fr))
        if new_fix:
            self._fix = (position, velocity)
        return self._apply_latencies(rate, attitude, altitude, force)

    def _sample_at_once(self, noise: Any, state: State, new_fix: bool) -> Measured:
        """Return the measurements of sensors that have only noise and filter, computed in one call."""
        if not self._left:
            self._left = _DRAW_SHAPE[0]
            noise.fill(self._rng.standard_normal(_DRAW_SHAPE), self._force_rng.standard_normal(_FORCE_DRAW_SHAPE))
        self._left -= 1
        answer: tuple[Any, Any, Any, Any, Any, Any] = noise.sample(state, self._rate, new_fix)
        self._rate = answer[0]
        if new_fix:
            self._fix = (answer[2], answer[3])
        return self._apply_latencies(answer[0], answer[1], answer[4], answer[5])

    def _apply_latencies(self, rate: Any, attitude: Any, altitude: Any, force: Any) -> Measured:
        """Return the measurements after each sensor's latency."""
        if self._has_latency:
            rate = self._gyro_line.update(rate)
            attitude = self._attitude_line.update(attitude)
            altitude = self._height_line.update(altitude)
        fix: tuple[Any, Any] = self._gnss_line.update(self._fix)
        return _MEASURED(rate, attitude, fix[0], fix[1], altitude, self._force_line.update(force))


class FaultySensors:
    """Sensors with faults: a bias is added, a dropout repeats the last value.

    The bias of the attitude is a small rotation about the body axes; of the GNSS, of position and of velocity.
    ``silent``: the sensors of which the last sample only repeats what they said before.
    """

    def __init__(self, sensors: Sensors) -> None:
        self.inner: SensorSuite | Sensors = sensors  # sensors without the fault
        self._faults: list[tuple[SensorFault, Measured]] = []
        self.silent: tuple[str, ...] = ()

    def begin(self, fault: SensorFault, last: Measured) -> None:
        """Begin ``fault`` at the next sample; ``last`` is the previous one."""
        self._faults.append((fault, last))

    def end(self, fault: SensorFault) -> None:
        self._faults = [entry for entry in self._faults if entry[0] is not fault]

    def reset(self, state: State) -> Measured:
        self._faults, self.silent = [], ()
        return self.inner.reset(state)

    def sample(self, state: State) -> Measured:
        measured = self.inner.sample(state)
        self.silent = tuple([fault.sensor for fault, _ in self._faults if isinstance(fault, SensorDropout)])
        for fault, last in self._faults:
            measured = (
                _repeat(measured, fault.sensor, last) if isinstance(fault, SensorDropout) else _offset(measured, fault)
            )
        return measured


def _draw_normals(draws: list[list[float]], generator: Any, shape: tuple[int, int]) -> list[float]:
    """Return the standard normal numbers of the next step; many steps are drawn at once."""
    if not draws:
        draws.extend(reversed(generator.standard_normal(shape).tolist()))
    return draws.pop()


def _repeat(measured: Measured, sensor: str, last: Measured) -> Measured:
    """Return the measurement with one sensor's values replaced by its last ones."""
    if sensor == "gyro":
        return measured._replace(rate=last.rate)
    if sensor == "attitude":
        return measured._replace(attitude=last.attitude)
    if sensor == "gnss":
        return measured._replace(position=last.position, velocity=last.velocity)
    return measured._replace(altitude=last.altitude)


def _offset(measured: Measured, fault: SensorBias) -> Measured:
    x, y, z = fault.vector
    if fault.sensor == "gyro":
        return measured._replace(rate=_add(measured.rate, fault.vector))
    if fault.sensor == "attitude":
        turned = normalize(multiply(measured.attitude, (1.0, 0.5 * x, 0.5 * y, 0.5 * z)))
        return measured._replace(attitude=turned)
    if fault.sensor == "gnss":
        return measured._replace(
            position=_add(measured.position, fault.vector), velocity=_add(measured.velocity, fault.velocity_bias)
        )
    return measured._replace(altitude=measured.altitude + x)


def _add(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _scale(vector: Vector3, factor: float) -> Vector3:
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)


def _draw_bias(bias: Vector3, sigma: float, draws: list[float], factor: float) -> Vector3:
    """Return the stated bias plus a drawn part; exactly the stated one if ``sigma`` is 0."""
    return _add(_scale(bias, factor), _scale((draws[0], draws[1], draws[2]), sigma * factor))


def _quantise(vector: Vector3, resolution: float) -> Vector3:
    """Return the nearest whole multiples of the resolution, as an analogue-to-digital converter does."""
    return (
        resolution * floor(vector[0] / resolution + 0.5),
        resolution * floor(vector[1] / resolution + 0.5),
        resolution * floor(vector[2] / resolution + 0.5),
    )
