"""Height and climb rate from accelerometer, barometer and GNSS, with their standard deviations.

Up is positive here.  The :class:`VerticalEstimator` detects which of its sensors have failed: one that repeats itself
to the last bit while another moves has stopped, one that contradicts the others is implausible.
"""

from __future__ import annotations

from collections import deque
from math import inf, sqrt

from cosim.base.constants import GRAVITY
from cosim.base.signals import Measured, Quaternion, Vector3
from cosim.spec.vehicle import Sensors

# Noise below which no sensor is trusted, whatever it states.
_LEAST_HEIGHT_NOISE = 0.01  # m
_LEAST_VELOCITY_NOISE = 0.02  # m/s
_LEAST_POSITION_NOISE = 0.1  # m
_LEAST_FORCE_NOISE = 0.05  # m/s^2
# Chosen by us, with the reason.
_BIAS_WALK = 0.001  # m/s^2 per root s: the zero of a MEMS accelerometer (0.15 mg/K) warmed by less than 1 K in a second
_BIAS_AT_START = 0.1  # m/s^2: 10 mg, more than is left after any calibration
_MOST_BIAS = 0.5  # m/s^2
_UNFELT = 3.0  # m/s^2: without an accelerometer any acceleration of a flight is possible
_STILL_RATE = 0.02  # m/s: the noise of standing still as a measurement
_GATE = 25.0  # squared normalised error: five standard deviations, passed by chance once in 1.7 million
# m/s^2: forces of stiff legs change by as much within a step, so that their samples are off by it.
_CONTACT_FORCE_NOISE = 2.0
_FAILED_S = 0.1  # without news for so long a barometer or accelerometer has stopped
_IMPLAUSIBLE_S = 0.5  # contradicted for so long it is not trusted
_AGREEMENT_S = 1.0  # in agreement for so long it is trusted again
_SILENT_S = 1.0  # a receiver without news for so long has stopped
_OFFSET_EPOCHS = 300  # half a minute over which the receiver's height is compared with the barometer's


class VerticalEstimator:
    """A Kalman filter of height ``h``, climb rate ``v`` and the accelerometer's vertical bias ``b``.

    The model is ``h' = v``, ``v' = a - b + white``, ``b' = white`` with ``a`` the measured specific force turned
    upright by the attitude, less gravity, held over a step.  The barometer is compared every step, GNSS velocity at
    every epoch with the estimate of the instant at which it was taken; GNSS height only while there is no barometer,
    shifted by what the two were apart before.  A reading further than five standard deviations off is left out.  While
    the vehicle is known to stand, ``v = 0`` is a measurement too.  While its legs touch the ground with engines that
    fly, the specific force has the noise of the contact.

    ``deviation`` is the filter's own: it grows while sensors are missing.
    """

    def __init__(self, sensors: Sensors, step: float) -> None:
        self._dt = step
        gnss = sensors.gnss
        self._period, self._latency = gnss.period_samples, gnss.latency_samples
        self._height_noise = max(sensors.barometer.noise_m, _LEAST_HEIGHT_NOISE) ** 2
        self._velocity_noise = max(gnss.velocity_noise_m_s, _LEAST_VELOCITY_NOISE) ** 2
        self._position_noise = max(gnss.position_noise_m, _LEAST_POSITION_NOISE) ** 2
        self._force_noise = max(sensors.accelerometer.noise_m_s2, _LEAST_FORCE_NOISE) ** 2
        self._contact_noise = max(self._force_noise, _CONTACT_FORCE_NOISE**2)
        self.reset(0.0, 0.0)

    def reset(self, height: float, rate: float) -> None:
        """Start at ``height``, climbing at ``rate``, with the deviations of one reading; all sensors work."""
        self._h, self._v, self._b = height, rate, 0.0
        self._hh, self._hv, self._hb = self._height_noise, 0.0, 0.0
        self._vv, self._vb, self._bb = self._velocity_noise, 0.0, _BIAS_AT_START**2
        self._past: deque[tuple[float, float]] = deque([(height, rate)] * (self._latency + 1))
        self._last_force: Vector3 | None = None
        self._last_altitude = inf
        self._last_fix: tuple[float, float] | None = None
        self._force_age = self._height_age = self._fix_age = 0.0
        self._refusal_s = self._agreement_s = self._fix_refusal_s = 0.0
        self._implausible = False
        self._offset, self._epochs = 0.0, 0
        self.lift = GRAVITY  # m/s^2: the specific force upwards, as last felt
        self._is_handed_over = False

    # --- what it says ------------------------------------------------------------------------------------------------

    @property
    def height(self) -> float:
        """The height, m, as the barometer counts."""
        return self._h

    @property
    def rate(self) -> float:
        """The climb rate, m/s."""
        return self._v

    @property
    def bias(self) -> float:
        """The accelerometer's bias, m/s^2, upwards."""
        return self._b

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of height [m] and climb rate [m/s]."""
        return sqrt(self._hh), sqrt(self._vv)

    @property
    def covariance(self) -> tuple[Vector3, Vector3, Vector3]:
        """The covariance of height, climb rate and bias."""
        return (
            (self._hh, self._hv, self._hb),
            (self._hv, self._vv, self._vb),
            (self._hb, self._vb, self._bb),
        )

    @property
    def has_height(self) -> bool:
        """Whether the barometer is trusted."""
        return self._height_age < _FAILED_S and not self._implausible

    @property
    def has_fix(self) -> bool:
        """Whether GNSS gives new fixes that are trusted."""
        return self._fix_age < _SILENT_S and self._fix_refusal_s < _SILENT_S

    @property
    def has_force(self) -> bool:
        """Whether the accelerometer is trusted."""
        return self._force_age < _FAILED_S

    # --- one step ----------------------------------------------------------------------------------------------------

    def update(self, k: int, measured: Measured, attitude: Quaternion, still: bool, has_contact: bool = False) -> None:
        """Update the estimate at ``t_k``; ``attitude`` body to NED, ``still``: it stands, ``has_contact``: on legs."""
        is_new = self._check_repeats(measured, still)
        self._predict(attitude, measured.specific_force, has_contact and not still)
        self._past.append((self._h, self._v))
        self._past.popleft()
        if still:
            self._correct(1, -self._v, _STILL_RATE**2)
        self._barometer(measured, is_new or still)
        if k > self._latency and (k - self._latency) % self._period == 0:
            self._receiver(measured, still)

    def _check_repeats(self, measured: Measured, still: bool) -> bool:
        """Note which sensors repeat themselves while another moves; return whether the barometer's reading is new."""
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
        # Where nothing moves, no sensor can be said to have stopped.
        return new_height or not new_force

    def _predict(self, attitude: Quaternion, force: Vector3, has_contact: bool) -> None:
        dt = self._dt
        if self.has_force and force[2] == force[2]:
            w, x, y, z = attitude
            down = 2.0 * ((x * z - w * y) * force[0] + (y * z + w * x) * force[1] + (0.5 - x * x - y * y) * force[2])
            self.lift = -down
            a, noise = -down - GRAVITY - self._b, self._contact_noise if has_contact else self._force_noise
        else:
            # constant over a second, not white from step to step
            a, noise = 0.0, _UNFELT**2 / dt
            self.lift = GRAVITY
        half = 0.5 * dt * dt
        self._h += dt * self._v + half * a
        self._v += dt * a
        hh, hv, hb, vv, vb, bb = self._hh, self._hv, self._hb, self._vv, self._vb, self._bb
        # F P F' with F = [[1, dt, -dt^2/2], [0, 1, -dt], [0, 0, 1]], in two factors
        nhh = hh + dt * hv - half * hb
        nhv = hv + dt * vv - half * vb
        nhb = hb + dt * vb - half * bb
        nvv = vv - dt * vb
        nvb = vb - dt * bb
        self._hh = nhh + dt * nhv - half * nhb + half * half * noise
        self._hv = nhv - dt * nhb + half * dt * noise
        self._hb = nhb
        self._vv = nvv - dt * nvb + dt * dt * noise
        self._vb = nvb
        self._bb = bb + _BIAS_WALK**2 * dt

    def _correct(self, which: int, error: float, noise: float) -> tuple[float, float]:
        """Correct by a measurement of ``h`` (0) or ``v`` (1) that differs by ``error``; return the changes of both."""
        hh, hv, hb, vv, vb, bb = self._hh, self._hv, self._hb, self._vv, self._vb, self._bb
        row = (hh, hv, hb) if which == 0 else (hv, vv, vb)
        total = row[which] + noise
        kh, kv, kb = row[0] / total, row[1] / total, row[2] / total
        self._h += kh * error
        self._v += kv * error
        self._b = max(-_MOST_BIAS, min(_MOST_BIAS, self._b + kb * error))
        self._hh, self._hv, self._hb = hh - kh * row[0], hv - kh * row[1], hb - kh * row[2]
        self._vv, self._vb, self._bb = vv - kv * row[1], vb - kv * row[2], bb - kb * row[2]
        return kh * error, kv * error

    def _barometer(self, measured: Measured, is_new: bool) -> None:
        dt, error = self._dt, measured.altitude - self._h
        if not is_new or self._height_age >= _FAILED_S:
            self._agreement_s = 0.0
            return
        if error * error > _GATE * (self._hh + self._height_noise):
            self._agreement_s = 0.0
            self._refusal_s += dt
            if self._refusal_s >= _IMPLAUSIBLE_S:
                self._implausible = True
            return
        self._refusal_s = 0.0
        self._agreement_s += dt
        if self._implausible and self._agreement_s >= _AGREEMENT_S:
            self._implausible = False
        if not self._implausible:
            self._correct(0, error, self._height_noise)

    def _receiver(self, measured: Measured, still: bool) -> None:
        """Correct by a GNSS epoch: velocity always, height where there is no barometer."""
        height, rate = -measured.position[2], -measured.velocity[2]
        fresh = still or (height, rate) != self._last_fix
        self._last_fix = (height, rate)
        between = self._period * self._dt
        self._fix_age = 0.0 if fresh else self._fix_age + between
        if not fresh:
            return
        then_h, then_v = self._past[0]
        error = rate - then_v
        if error * error > _GATE * (self._vv + self._velocity_noise):
            self._fix_refusal_s += between
            if self._fix_refusal_s < _SILENT_S or self.has_height:
                return
            # No other sensor is left: use it again, with the deviation of one reading.
            self._hv = self._vb = 0.0
            self._vv += error * error
        self._fix_refusal_s = 0.0
        dh, dv = self._correct(1, error, self._velocity_noise)
        apart = height - (then_h + dh)
        if self.has_height:
            self._epochs = min(self._epochs + 1, _OFFSET_EPOCHS)
            self._offset += (apart - self._offset) / self._epochs
            self._is_handed_over = False
        elif self._epochs:
            if not self._is_handed_over:
                # The receiver's height has the uncertainty of its comparison with the barometer.
                self._hh += self._position_noise / self._epochs
                self._is_handed_over = True
            height_change, rate_change = self._correct(0, apart - self._offset, self._position_noise)
            dh, dv = dh + height_change, dv + rate_change
        latency = self._latency * self._dt
        self._h += latency * dv
        self._shift(dh, dv)

    def _shift(self, dh: float, dv: float) -> None:
        """Shift the past estimates, which the next epochs are compared with, by the correction."""
        dt = self._dt
        for i, (h, v) in enumerate(self._past):
            self._past[i] = (h + dh + i * dt * dv, v + dv)
