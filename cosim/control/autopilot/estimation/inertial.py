"""Attitude predicted by the gyro, and the gyro's bias, so that either sensor may fail.

While the attitude sensor works it is used as it is, and the gyro is compared with it.  When it stops or jumps, the
attitude is predicted from the gyro less its estimated bias; when the gyro stops, the rates are estimated from the
attitude.
"""

from __future__ import annotations

from collections import deque
from math import exp, sqrt

from cosim.base.frames import conjugate, multiply, normalize
from cosim.base.signals import ZERO3, Measured, Quaternion, Vector3
from cosim.spec.vehicle import Sensors

# Noise below which no sensor is trusted, whatever it states.
_LEAST_ANGLE_NOISE = 2e-4  # rad
_LEAST_RATE_NOISE = 0.002  # rad/s
# Chosen by us, with the reason.
_BIAS_WALK = 2e-5  # rad/s per root s: a MEMS gyro's zero (5 mdeg/s per K) while it warms by some K in a minute
_BIAS_AT_START = 0.01  # rad/s: calibrated while it stands
_BIAS_UNKNOWN = 0.3  # rad/s: 17 deg/s, when it turns out that the bias is not what it was
_QUICK = (
    30.0  # times the attitude gain: a rate loop is some four times as fast, and has a tenth of its own time to wait
)
_NOMINAL_GAIN = 3.5  # 1/s
_MEAN_S = 0.1  # s over which the disagreement is averaged
_SURPRISE = 8.0  # standard deviations of that mean
_LEAST_SURPRISE = 2e-3  # rad; what a manoeuvre's filters and sampling leave unexplained
_BETWEEN_S = 0.5  # s between two surprises
_JUMP = 0.02  # rad between two samples: the gyro saw nothing of it, and no noise of this sensor does it
_STOPPED = 5  # repeated samples while the other sensor moves
_BIASED = 0.02  # rad/s: four times the noise of a sample; the controllers would lean by less than a degree
_BIASED_S = 0.3


class InertialEstimator:
    """Small errors of attitude and gyro bias, one Kalman filter of two states for each axis, sharing its covariance.

    ``theta' = rate - bias + white``, ``bias' = white``, with the rate before the gyro's own filter recovered from two
    samples: ``r_k = (y_k - (1 - s) y_{k-1}) / s``.  The attitude sensor measures ``theta``.  If the mean disagreement
    leaves what noise explains, the bias has changed: its variance is set up, and the new one is found in a fraction of
    a second.  Without a gyro the rate is found from the attitude, as quickly as the attitude loop, of ``gain`` [1/s],
    needs it.
    """

    def __init__(self, sensors: Sensors, step: float, gain: float = _NOMINAL_GAIN) -> None:
        self._dt = step
        gyro, attitude = sensors.gyro, sensors.attitude
        self._filter_gain = 1.0 - exp(-step / gyro.filter_s) if gyro.filter_s > 0.0 else 1.0
        self._latency = max(0, attitude.latency_samples - gyro.latency_samples)
        self._angle_noise = max(attitude.noise_rad, _LEAST_ANGLE_NOISE) ** 2
        self._rate_noise = max(gyro.noise_rad_s, _LEAST_RATE_NOISE) ** 2
        self._mean_gain = step / _MEAN_S
        # of two integrators behind white noise: the filter's bandwidth squared is walk over measurement noise
        self._turning = (_QUICK * gain) ** 2 * sqrt(self._angle_noise * step)
        self.reset(None)

    def reset(self, measured: Measured | None) -> None:
        """Start at the ``measured`` attitude, with both sensors working and no bias."""
        self._q: Quaternion = (1.0, 0.0, 0.0, 0.0) if measured is None else measured.attitude
        self.bias: Vector3 = ZERO3
        self._aa, self._ab, self._bb = self._angle_noise, 0.0, _BIAS_AT_START**2
        self._last_rate = self._raw = ZERO3 if measured is None else measured.rate
        self._last_attitude = self._q
        self._past: deque[Quaternion] = deque([self._q] * (self._latency + 1))
        self._mean = self._before = ZERO3
        self._quiet = 0.0  # s in which surprises are ignored
        self._has_jumped = False
        self._rate_repeats = self._attitude_repeats = 0
        self._biased_for = 0.0
        self._gyro_has_failed = False

    @property
    def has_attitude(self) -> bool:
        """Whether the attitude sensor is trusted."""
        return self._attitude_repeats < _STOPPED and not self._has_jumped

    @property
    def has_rate(self) -> bool:
        """Whether the gyro is trusted, bias or not."""
        return self._rate_repeats < _STOPPED

    @property
    def is_biased(self) -> bool:
        """Whether the gyro's bias matters."""
        return self._biased_for >= _BIASED_S

    @property
    def deviation(self) -> float:
        """Standard deviation of the attitude, rad on each axis."""
        return sqrt(self._aa)

    def update(self, measured: Measured, still: bool) -> tuple[Quaternion, Vector3]:
        """Return attitude and body rates at this sample; ``still``: the vehicle stands, so that sensors may repeat."""
        new_rate, new_attitude = measured.rate != self._last_rate, measured.attitude != self._last_attitude
        self._rate_repeats = 0 if new_rate or still else self._rate_repeats + (1 if new_attitude else 0)
        self._attitude_repeats = 0 if new_attitude or still else self._attitude_repeats + (1 if new_rate else 0)
        self._last_attitude = measured.attitude
        self._turn(measured.rate)
        if self._attitude_repeats == 0:
            self._compare(measured.attitude)
        b = self.bias
        is_biased = self.has_rate and max(abs(b[0]), abs(b[1]), abs(b[2])) > _BIASED
        self._biased_for = self._biased_for + self._dt if is_biased else 0.0
        attitude = measured.attitude if self.has_attitude else self._q
        if not self.has_rate:
            return attitude, (-b[0], -b[1], -b[2])
        p, q, r = measured.rate
        return attitude, (p - b[0], q - b[1], r - b[2])

    def _turn(self, rate: Vector3) -> None:
        """Predict one step by the gyro; without one the bias is minus the rate, and may change quickly."""
        dt, b = self._dt, self.bias
        if self.has_rate:
            gain, last = self._filter_gain, self._last_rate
            rest = 1.0 - gain
            raw = (
                (rate[0] - rest * last[0]) / gain,
                (rate[1] - rest * last[1]) / gain,
                (rate[2] - rest * last[2]) / gain,
            )
            walk = _BIAS_WALK
            if self._gyro_has_failed:
                # The bias was minus the rate; the gyro works again.
                self.bias = b = ZERO3
                self._bb = _BIAS_UNKNOWN**2
        else:
            raw, walk = ZERO3, self._turning
            if not self._gyro_has_failed:
                self.bias = b = (b[0] - self._raw[0], b[1] - self._raw[1], b[2] - self._raw[2])
                self._bb, self._ab = _BIAS_UNKNOWN**2, 0.0
        self._gyro_has_failed = not self.has_rate
        half = 0.25 * dt  # of the sum of both ends, as half angles
        old = self._raw if self.has_rate else ZERO3
        x = half * (old[0] + raw[0]) - 0.5 * dt * b[0]
        y = half * (old[1] + raw[1]) - 0.5 * dt * b[1]
        z = half * (old[2] + raw[2]) - 0.5 * dt * b[2]
        self._last_rate, self._raw = rate, raw
        self._q = normalize(multiply(self._q, (1.0, x, y, z)))
        self._past.append(self._q)
        self._past.popleft()
        noise = self._rate_noise * dt * dt if self.has_rate else 0.0
        self._aa += -2.0 * dt * self._ab + dt * dt * self._bb + noise
        self._ab -= dt * self._bb
        self._bb += walk * walk * dt

    def _compare(self, attitude: Quaternion) -> None:
        """Correct attitude and bias by the sensor's attitude less the gyro's of the same instant."""
        w, x, y, z = multiply(conjugate(self._past[0]), attitude)
        sign = 2.0 if w >= 0.0 else -2.0
        e = (sign * x, sign * y, sign * z)
        total = self._aa + self._angle_noise
        size = max(abs(e[0]), abs(e[1]), abs(e[2]))
        if self._has_jumped:
            self._has_jumped = size > 5.0 * sqrt(total)
            self._before = e
            if self._has_jumped:
                return
        c = self._before
        jump = max(abs(e[0] - c[0]), abs(e[1] - c[1]), abs(e[2] - c[2]))
        if jump > max(_JUMP, 10.0 * sqrt(2.0 * self._angle_noise)) and self.has_rate:
            self._has_jumped = True
            return
        self._surprise(e, total)
        ka, kb = self._aa / total, self._ab / total
        self._q = normalize(multiply(self._q, (1.0, 0.5 * ka * e[0], 0.5 * ka * e[1], 0.5 * ka * e[2])))
        if self._latency:
            half = 0.5 * ka
            turn = (1.0, half * e[0], half * e[1], half * e[2])
            self._past = deque(normalize(multiply(attitude, turn)) for attitude in self._past)
        else:
            self._past[0] = self._q
        rest = 1.0 - ka
        self._before = (rest * e[0], rest * e[1], rest * e[2])
        b = self.bias
        self.bias = (b[0] + kb * e[0], b[1] + kb * e[1], b[2] + kb * e[2])
        aa, ab = self._aa, self._ab
        self._aa, self._ab, self._bb = aa - ka * aa, ab - ka * ab, self._bb - kb * ab

    def _surprise(self, e: Vector3, total: float) -> None:
        """Open the bias covariance where the mean innovation says that the bias is not what it was."""
        gain, m = self._mean_gain, self._mean
        self._mean = m = (m[0] + gain * (e[0] - m[0]), m[1] + gain * (e[1] - m[1]), m[2] + gain * (e[2] - m[2]))
        self._quiet = max(0.0, self._quiet - self._dt)
        bound = max(_LEAST_SURPRISE, _SURPRISE * sqrt(0.5 * gain * total))
        if self._quiet == 0.0 and max(abs(m[0]), abs(m[1]), abs(m[2])) > bound:
            self._bb = max(self._bb, _BIAS_UNKNOWN**2)
            self._quiet = _BETWEEN_S
