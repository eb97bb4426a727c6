"""The autopilot's estimates of its own motion: from the sensors where they work, from the others where they do not.

Faults are not reported to it; it detects them in its sensors' readings.  One that repeats itself to the last bit while
another moves has stopped, one that contradicts the others is implausible.
"""

from __future__ import annotations

from collections import deque
from math import exp, inf, nan, radians, sqrt
from typing import NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, multiply, normalize, rotate, to_euler
from cosim.base.signals import ZERO3, Measured, Quaternion, Vector3
from cosim.control.autopilot.estimation.kalman import Kalman
from cosim.control.autopilot.estimation.position import BIAS_WALK, STANDING_NOISE, PositionEstimator, trusted_noise
from cosim.spec.vehicle import PositionGains, Sensors

# Least noise that is assumed of the attitude sensor [rad], the gyro [rad/s] and the barometer [m].
_MIN_NOISE = (2e-4, 0.002, 0.01)
# Standard deviations of the gyro's bias [rad/s], chosen by us as are the following: after calibration at rest, and
# after the bias has turned out to have changed, 17 deg/s.
_GYRO_BIAS_AT_START, _GYRO_BIAS_UNKNOWN = 0.01, 0.3
# The gyro's bias has changed if the difference between gyro and attitude, averaged over this time, exceeds this many
# standard deviations of the mean and this angle, which filters and sampling cause in a manoeuvre; a change is detected
# again after this time at the earliest.
_ERROR_MEAN_S, _MAX_ERROR_SIGMAS, _MAX_ERROR_RAD, _MIN_BETWEEN_S = 0.1, 8.0, 2e-3, 0.5
# Number of repeated samples, while the other sensor's change, after which a gyro or attitude sensor has failed.
_MAX_REPEATS = 5
# A gyro counts as biased after this time [s] above this bias [rad/s]: four times the noise of a sample; at less the
# controllers lean by less than a degree.
_MAX_GYRO_BIAS, _MIN_BIASED_S = 0.02, 0.3
# Bias of the accelerometer [m/s^2]: standard deviation at the start, 10 mg, more than remains after calibration, and
# largest estimate.
_FORCE_BIAS_AT_START, _MAX_FORCE_BIAS = 0.1, 0.5
# Largest squared normalised error of a reading that is used: five standard deviations, by chance once in 1.7 million.
_MAX_SQUARED_ERROR = 25.0
# Times [s] without new values after which a barometer or accelerometer has stopped, and a GNSS receiver.
_MAX_REPEATED_S, _MAX_SILENCE_S = 0.1, 1.0
# Times [s] of contradiction after which a barometer is not used, and of agreement after which it is used again.
_MAX_IMPLAUSIBLE_S, _MIN_AGREEMENT_S = 0.5, 1.0
# Largest standard deviation of a reliable lean [rad]: with this error a twelfth of the weight pushes sideways.
MAX_LEAN_DEVIATION = radians(5.0)


class EstimateQuality(NamedTuple):
    """How reliable the autopilot's estimates are.

    ``position`` and ``height`` are valid where a sensor measures them; ``speed``, ``climb`` and ``attitude`` where
    their standard deviation is below 1 m/s and 5 degrees, measured or predicted.  ``gyro`` to ``attitude_sensor``
    are the trusted sensors.  The rest are the standard deviations: m and m/s per axis, m, m/s, rad.
    """

    position: bool = True
    speed: bool = True
    height: bool = True
    climb: bool = True
    attitude: bool = True
    gyro: bool = True
    accelerometer: bool = True
    barometer: bool = True
    gnss: bool = True
    attitude_sensor: bool = True
    position_m: float = nan
    speed_m_s: float = nan
    height_m: float = nan
    climb_m_s: float = nan
    attitude_rad: float = nan


class Estimator:
    """Estimator of attitude and rates, height and climb rate, position and velocity from the sensors that work.

    Where all sensors work, attitude and horizontal position are the sensors' own; rates are the gyro's less its bias;
    height and climb rate are always estimates.

    *Attitude.*  ``theta' = rate - bias + white``, ``bias' = white`` about each axis, with one covariance and the rate
    before the gyro's own filter, ``r_k = (y_k - (1 - s) y_{k-1}) / s``; the attitude sensor measures ``theta``.  Where
    the mean disagreement exceeds what noise explains, the bias has changed: its variance is set up, and the new one is
    found in a fraction of a second.  Without the sensor the attitude goes on by the gyro; without a gyro the rate is
    found from the attitude, as quickly as the attitude loop needs it.

    *Height.*  ``h' = v``, ``v' = a - b + white``, ``b' = white``, up positive, with ``a`` the specific force turned
    upright, less gravity.  The barometer is compared every step, GNSS velocity every epoch with the estimate of the
    instant at which it was taken, GNSS height only while there is no barometer, shifted by what the two were apart
    before.  While the vehicle stands, ``v = 0`` is a reading too; while its legs touch the ground with engines that
    fly, the specific force has the noise of the contact.

    *Position.*  :class:`PositionEstimator`.

    ``gain``: of the attitude loop, 1/s, the slowest of roll and pitch.  ``noisy``: the sensors have their noise, by
    which a receiver that has stopped is told from one that stands.
    """

    def __init__(self, sensors: Sensors, gains: PositionGains, step: float, gain: float, noisy: bool) -> None:
        gyro, attitude, gnss = sensors.gyro, sensors.attitude, sensors.gnss
        self._dt = step
        self._filter_gain = 1.0 - exp(-step / gyro.filter_s) if gyro.filter_s > 0.0 else 1.0
        self._attitude_latency = max(0, attitude.latency_samples - gyro.latency_samples)
        angle_noise = max(attitude.noise_rad, _MIN_NOISE[0])
        self._angle_noise = angle_noise**2
        self._rate_noise = max(gyro.noise_rad_s, _MIN_NOISE[1]) ** 2
        # Two integrators behind white noise: the bandwidth squared is walk over measurement noise. A rate loop is some
        # four times as fast as the attitude gain; thirty times that gain delays it by a tenth of its time.
        self._rate_walk = (30.0 * gain) ** 2 * sqrt(self._angle_noise * step)
        self._angle = Kalman(step, 0, (0.0, angle_noise, _GYRO_BIAS_AT_START))
        self._period, self._latency = gnss.period_samples, gnss.latency_samples
        height_noise = max(sensors.barometer.noise_m, _MIN_NOISE[2])
        position_noise, velocity_noise, force_noise = trusted_noise(sensors)
        self._height_noise, self._velocity_noise = height_noise**2, velocity_noise**2
        self._position_noise, self._force_noise = position_noise**2, force_noise**2
        self.vertical = Kalman(step, self._latency, (height_noise, velocity_noise, _FORCE_BIAS_AT_START))
        noisy = noisy and max(gnss.position_noise_m, gnss.velocity_noise_m_s) > 0.0
        self._position = PositionEstimator(gains, sensors, step, noisy, reckons=True)
        self.reset(None)

    def reset(self, measured: Measured | None) -> None:
        """Start as if at rest in the measured state; None: at the first measurement."""
        # Measurement that the loops fly with.
        self.measured = measured
        self.euler: Vector3 = ZERO3 if measured is None else to_euler(measured.attitude)
        self._attitude: Quaternion = (1.0, 0.0, 0.0, 0.0) if measured is None else measured.attitude
        self._last_attitude = self._attitude
        self._past: deque[Quaternion] = deque([self._attitude] * (self._attitude_latency + 1))
        self._last_rate = self._raw_rate = ZERO3 if measured is None else measured.rate
        self.gyro_bias: Vector3 = ZERO3
        self._angle.reset(0.0, 0.0)
        self._mean = self._last_error = ZERO3
        self._quiet_s = self._biased_s = 0.0
        self._has_jumped = self._gyro_has_failed = False
        self._rate_repeats = self._attitude_repeats = 0
        if measured is None:
            self.vertical.reset(0.0, 0.0)
        else:
            self.vertical.reset(measured.altitude, -measured.velocity[2])
            self._position.reset((measured.position[0], measured.position[1]))
        # The gyro's bias changes too little within the receiver's latency to matter.
        self.vertical.turn = 0.0
        self.fix = self._position.fix
        self._last_force: Vector3 | None = None
        self._last_altitude = inf
        self._last_fix: tuple[float, float] | None = None
        self._force_age = self._height_age = self._fix_age = 0.0
        self._refusal_s = self._agreement_s = self._fix_refusal_s = 0.0
        self._is_implausible = self._is_handed_over = False
        self._offset, self._epochs = 0.0, 0
        # m/s^2: upward specific force as last measured.
        self._lift = GRAVITY

    def update(
        self,
        k: int,
        measured: Measured,
        still: bool,
        is_grounded: bool = False,
        is_pushed: bool = False,
        has_contact: bool = False,
    ) -> Measured:
        """Return the estimate for step ``k``; ``still``: it stands; ``is_grounded``: it has not lifted off.

        ``is_pushed``: see :meth:`PositionEstimator.update`.  ``has_contact``: its legs touch the ground.
        """
        if self.measured is None:
            self.reset(measured)
        attitude, rate = self._update_attitude(measured, still)
        self._update_height(k, measured, attitude, still, has_contact)
        north, east, _ = measured.velocity
        velocity = (north, east, -self.vertical.v.real)
        position, height = measured.position, self.vertical.p.real
        self.measured = measured = Measured(rate, attitude, position, velocity, height, measured.specific_force)
        self.euler = to_euler(attitude)
        lean_deviation = 0.0 if self.has_attitude else sqrt(self._angle.vv)
        self.fix = self._position.update(k, measured, is_grounded, lean_deviation, is_pushed)
        return measured

    @property
    def now(self) -> Measured:
        """The present measurements, sensed or estimated, that the loops fly with."""
        assert self.measured is not None
        return self.measured

    @property
    def altitude(self) -> float:
        """The height above the origin, m."""
        return self.measured.altitude if self.measured is not None else 0.0

    @property
    def altitude_deviation(self) -> float:
        """The standard deviation of the height, m."""
        return sqrt(self.vertical.pp)

    @property
    def lift(self) -> float | None:
        """Specific force upwards divided by gravity; None without an accelerometer."""
        return (self._lift + self.vertical.u.real) / GRAVITY if self.has_force else None

    @property
    def has_attitude(self) -> bool:
        return self._attitude_repeats < _MAX_REPEATS and not self._has_jumped

    @property
    def has_rate(self) -> bool:
        """Whether the gyro is trusted, bias or not."""
        return self._rate_repeats < _MAX_REPEATS

    @property
    def is_biased(self) -> bool:
        """Whether the gyro's bias matters."""
        return self._biased_s >= _MIN_BIASED_S

    @property
    def has_height(self) -> bool:
        return self._height_age < _MAX_REPEATED_S and not self._is_implausible

    @property
    def has_fix(self) -> bool:
        """Whether GNSS gives new fixes that agree with the climb rate."""
        return self._fix_age < _MAX_SILENCE_S and self._fix_refusal_s < _MAX_SILENCE_S

    @property
    def has_force(self) -> bool:
        return self._force_age < _MAX_REPEATED_S

    @property
    def has_position(self) -> bool:
        """Whether GNSS fixes arrive."""
        # Dead reckoning by the lean alone drifts half a metre in the first second for each degree of error.
        return self._position.silent <= 1.0

    @property
    def failures(self) -> tuple[str, ...]:
        """Failed sensors in words, except the GNSS receiver."""
        failures = (
            ("attitude lost", not self.has_attitude),
            ("gyro lost", not self.has_rate),
            ("gyro biased", self.has_rate and self.is_biased),
            ("barometer lost", not self.has_height),
        )
        return tuple(text for text, has_failed in failures if has_failed)

    @property
    def quality(self) -> EstimateQuality:
        (position_deviation, speed), (height, climb) = self._position.deviation, self.vertical.deviation
        lean, has_position = sqrt(self._angle.vv), self.has_position
        # m/s, one standard deviation: a less certain speed is not reported as valid, as PX4's COM_VEL_FS_EVH does.
        sure = 1.0
        return EstimateQuality(
            has_position,
            has_position or speed < sure,
            self.has_height or self.has_fix,
            climb < sure,
            self.has_attitude or lean < MAX_LEAN_DEVIATION,
            self.has_rate and not self.is_biased,
            self.has_force,
            self.has_height,
            has_position,
            self.has_attitude,
            position_deviation,
            speed,
            height,
            climb,
            lean,
        )

    def _update_attitude(self, measured: Measured, still: bool) -> tuple[Quaternion, Vector3]:
        """Return attitude and body rates at this sample; while the vehicle stands, sensors may repeat themselves."""
        new_rate, new_attitude = measured.rate != self._last_rate, measured.attitude != self._last_attitude
        self._rate_repeats = 0 if new_rate or still else self._rate_repeats + (1 if new_attitude else 0)
        self._attitude_repeats = 0 if new_attitude or still else self._attitude_repeats + (1 if new_rate else 0)
        self._last_attitude = measured.attitude
        self._predict_attitude(measured.rate)
        if self._attitude_repeats == 0:
            self._correct_attitude(measured.attitude)
        is_biased = self.has_rate and _largest_magnitude(self.gyro_bias) > _MAX_GYRO_BIAS
        self._biased_s = self._biased_s + self._dt if is_biased else 0.0
        attitude = measured.attitude if self.has_attitude else self._attitude
        return attitude, _add_scaled(measured.rate if self.has_rate else ZERO3, self.gyro_bias, -1.0)

    def _predict_attitude(self, rate: Vector3, bias_walk: float = 2e-5) -> None:
        """Predict the attitude one step ahead by the gyro; without one the bias is minus the rate, and changes quickly.

        ``bias_walk``: rad/s per root s, a MEMS gyro's zero (5 mdeg/s per K) that warms by some K in a minute.
        """
        dt, has_rate, angle, raw = self._dt, self.has_rate, self._angle, ZERO3
        if has_rate:
            raw = _scale(_add_scaled(rate, self._last_rate, self._filter_gain - 1.0), 1.0 / self._filter_gain)
        if has_rate is self._gyro_has_failed:
            # Without a gyro the bias is minus the rate: convert it when it stops, start from 0 when it works again.
            self.gyro_bias = ZERO3 if has_rate else _add_scaled(self.gyro_bias, self._raw_rate, -1.0)
            angle.uu = _GYRO_BIAS_UNKNOWN**2
            if not has_rate:
                angle.vu = 0.0
        self._gyro_has_failed = not has_rate
        # Mean of the rates at both ends of the step, less the bias.
        mean = _scale(_add_scaled(self._raw_rate, raw), 0.5) if has_rate else ZERO3
        x, y, z = _scale(_add_scaled(mean, self.gyro_bias, -1.0), 0.5 * dt)
        self._last_rate, self._raw_rate = rate, raw
        self._attitude = normalize(multiply(self._attitude, (1.0, x, y, z)))
        self._past.append(self._attitude)
        self._past.popleft()
        walk = bias_walk if has_rate else self._rate_walk
        angle.spread(dt, -1.0, self._rate_noise * dt if has_rate else 0.0, walk * walk * dt)

    def _correct_attitude(self, attitude: Quaternion, max_jump: float = 0.02) -> None:
        """Correct attitude and gyro bias by the attitude sensor's difference from the prediction for the same instant.

        ``max_jump``: rad between two samples that the gyro saw nothing of; no noise of the sensor does it.
        """
        w, x, y, z = multiply(conjugate(self._past[0]), attitude)
        error = _scale((x, y, z), 2.0 if w >= 0.0 else -2.0)
        total = self._angle.vv + self._angle_noise
        if self._has_jumped:
            self._has_jumped = _largest_magnitude(error) > 5.0 * sqrt(total)
            self._last_error = error
            if self._has_jumped:
                return
        jump = _largest_magnitude(_add_scaled(error, self._last_error, -1.0))
        if jump > max(max_jump, 10.0 * sqrt(2.0 * self._angle_noise)) and self.has_rate:
            self._has_jumped = True
            return
        self._detect_new_bias(error, total)
        _, angle_gain, bias_gain = self._angle.take_reading(1, self._angle_noise)
        x, y, z = _scale(error, 0.5 * angle_gain.real)
        self._past = deque([normalize(multiply(past, (1.0, x, y, z))) for past in self._past])
        self._attitude = self._past[-1]
        self._last_error = _scale(error, 1.0 - angle_gain.real)
        self.gyro_bias = _add_scaled(self.gyro_bias, error, bias_gain.real)

    def _detect_new_bias(self, error: Vector3, total: float) -> None:
        """Increase the covariance of the gyro's bias if the mean error shows that the bias has changed."""
        gain = self._dt / _ERROR_MEAN_S
        self._mean = _add_scaled(self._mean, _add_scaled(error, self._mean, -1.0), gain)
        self._quiet_s = max(0.0, self._quiet_s - self._dt)
        bound = max(_MAX_ERROR_RAD, _MAX_ERROR_SIGMAS * sqrt(0.5 * gain * total))
        if self._quiet_s == 0.0 and _largest_magnitude(self._mean) > bound:
            self._angle.uu = max(self._angle.uu, _GYRO_BIAS_UNKNOWN**2)
            self._quiet_s = _MIN_BETWEEN_S

    def _update_height(self, k: int, measured: Measured, attitude: Quaternion, still: bool, has_contact: bool) -> None:
        is_new = self._check_repeats(measured, still)
        self._predict_height(attitude, measured.specific_force, has_contact and not still)
        if still:
            self._correct_height(1, -self.vertical.v, STANDING_NOISE**2)
        self._correct_by_barometer(measured.altitude, is_new or still)
        if k > self._latency and (k - self._latency) % self._period == 0:
            self._correct_by_gnss(-measured.position[2], -measured.velocity[2], still)

    def _check_repeats(self, measured: Measured, still: bool) -> bool:
        """Detect sensors that repeat while others change; return whether the barometer's reading is new."""
        dt, force = self._dt, measured.specific_force
        felt = force == force and force[2] == force[2]
        new_force = felt and force != self._last_force
        new_height = measured.altitude != self._last_altitude
        first = self._last_force is None
        self._last_force, self._last_altitude = force, measured.altitude
        if new_force or (felt and (first or still)):
            self._force_age = 0.0
        elif new_height or not felt:
            self._force_age += dt
        if new_height or still:
            self._height_age = 0.0
        elif new_force:
            self._height_age += dt
        # Without motion constant readings do not show that a sensor has failed.
        return new_height or not new_force

    def _predict_height(
        self, attitude: Quaternion, force: Vector3, has_contact: bool, unsensed: float = 3.0, contact_noise: float = 2.0
    ) -> None:
        """Predict height and climb rate one step ahead.  ``unsensed``: deviation of an unmeasured acceleration [m/s^2].

        ``contact_noise``: m/s^2, by which the forces of stiff legs change within a step.
        """
        dt, vertical = self._dt, self.vertical
        if self.has_force and force[2] == force[2]:
            self._lift = -rotate(attitude, force)[2]
            acceleration = self._lift - GRAVITY + vertical.u.real
            noise = dt * (max(self._force_noise, contact_noise**2) if has_contact else self._force_noise)
        else:
            # An unmeasured acceleration is constant over about a second, not white from step to step.
            self._lift, acceleration, noise = GRAVITY, 0.0, unsensed**2
        vertical.predict(acceleration)
        vertical.spread(dt, 1.0, noise, BIAS_WALK**2 * dt)

    def _correct_height(self, which: int, error: complex, noise: float, latency: float | None = None) -> None:
        """Correct height and climb rate by the error of a height (0) or climb rate (1) that is ``latency`` s old."""
        self.vertical.correct(which, error, noise, latency)
        self.vertical.u = max(-_MAX_FORCE_BIAS, min(_MAX_FORCE_BIAS, self.vertical.u.real))

    def _correct_by_barometer(self, altitude: float, is_new: bool) -> None:
        error = altitude - self.vertical.p.real
        if not is_new or self._height_age >= _MAX_REPEATED_S:
            self._agreement_s = 0.0
            return
        if error * error > _MAX_SQUARED_ERROR * (self.vertical.pp + self._height_noise):
            self._agreement_s = 0.0
            self._refusal_s += self._dt
            self._is_implausible = self._is_implausible or self._refusal_s >= _MAX_IMPLAUSIBLE_S
            return
        self._refusal_s = 0.0
        self._agreement_s += self._dt
        self._is_implausible = self._is_implausible and self._agreement_s < _MIN_AGREEMENT_S
        if not self._is_implausible:
            self._correct_height(0, error, self._height_noise)

    def _correct_by_gnss(self, height: float, rate: float, still: bool, offset_epochs: int = 300) -> None:
        """Correct by a GNSS fix: always velocity, and height without a barometer.

        ``offset_epochs``: over so many, half a minute, the receiver's height is compared with the barometer's.
        """
        vertical, latency = self.vertical, self._latency * self._dt
        fresh = still or (height, rate) != self._last_fix
        self._last_fix = (height, rate)
        between = self._period * self._dt
        self._fix_age = 0.0 if fresh else self._fix_age + between
        if not fresh:
            return
        error = rate - vertical.delayed[1].real
        if error * error > _MAX_SQUARED_ERROR * (vertical.vv + self._velocity_noise):
            self._fix_refusal_s += between
            if self._fix_refusal_s < _MAX_SILENCE_S or self.has_height:
                return
            # No other height sensor is left: use this one again, as uncertain as one reading.
            vertical.pv = vertical.vu = 0.0
            vertical.vv += error * error
        self._fix_refusal_s = 0.0
        self._correct_height(1, error, self._velocity_noise, latency)
        apart = height - vertical.delayed[0].real
        if self.has_height:
            self._epochs = min(self._epochs + 1, offset_epochs)
            self._offset += (apart - self._offset) / self._epochs
            self._is_handed_over = False
        elif self._epochs:
            if not self._is_handed_over:
                # The receiver's height is as uncertain as its comparison with the barometer.
                vertical.pp += self._position_noise / self._epochs
                self._is_handed_over = True
            self._correct_height(0, apart - self._offset, self._position_noise, latency)


def _add_scaled(a: Vector3, b: Vector3, factor: float = 1.0) -> Vector3:
    """Return ``a + factor b``."""
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


def _scale(a: Vector3, factor: float) -> Vector3:
    return (factor * a[0], factor * a[1], factor * a[2])


def _largest_magnitude(a: Vector3) -> float:
    return max(abs(a[0]), abs(a[1]), abs(a[2]))
