"""Horizontal position and velocity predicted from the accelerometer, for when the GNSS receiver has stopped.

Horizontal vectors are complex numbers here: north + i east.
"""

from __future__ import annotations

from collections import deque
from math import isnan, sqrt

from cosim.base.constants import GRAVITY
from cosim.base.signals import Measured, Quaternion, Vector3
from cosim.spec.vehicle import Sensors

# Noise below which no sensor is trusted, whatever it states.
_LEAST_POSITION_NOISE = 0.1  # m
_LEAST_VELOCITY_NOISE = 0.02  # m/s
_LEAST_FORCE_NOISE = 0.05  # m/s^2
# Chosen by us, with the reason.
_BIAS_AT_START = 0.2  # m/s^2: 10 mg of the accelerometer and 1 degree of the attitude, together
_BIAS_WALK = 0.001  # m/s^2 per root s: the zero of a MEMS accelerometer (0.15 mg/K) warmed by less than 1 K in a second
_UNFELT = 0.5  # m/s^2, constant over a second: what the lean does not explain, where nothing senses it
_STILL_RATE = 0.02  # m/s: the noise of standing still as a measurement


class DeadReckoning:
    """A Kalman filter of position ``p``, velocity ``v`` and the bias ``u`` of the sensed acceleration.

    The model is ``p' = v``, ``v' = a + r u + white``, ``u' = white`` with ``a`` the measured specific force turned
    upright by the attitude and ``r`` the heading as a unit vector: the accelerometer's bias, and gravity through an
    attitude that is off, turn with the vehicle.  What the accelerometer feels has the drag in it, so neither wind nor
    drag is part of the model, and nothing learnt at one speed is wrong at another.  While the receiver gives fixes
    they are compared with the estimate of the instant in which they were taken; without them ``p`` and ``v`` go on by
    themselves, and the deviations grow.  Both axes are alike, so one covariance, per axis, serves both.
    """

    def __init__(self, sensors: Sensors, step: float) -> None:
        self._dt = step
        gnss = sensors.gnss
        self._period, self._latency = gnss.period_samples * step, gnss.latency_samples
        self._position_noise = max(gnss.position_noise_m, _LEAST_POSITION_NOISE) ** 2
        self._velocity_noise = max(gnss.velocity_noise_m_s, _LEAST_VELOCITY_NOISE) ** 2
        force = max(sensors.accelerometer.noise_m_s2, _LEAST_FORCE_NOISE)
        # white from step to step: its spectral density is the variance times the step
        self._force_noise = step * (force**2 + (GRAVITY * sensors.attitude.noise_rad) ** 2)
        self.reset((0.0, 0.0))

    def reset(self, position: tuple[float, float]) -> None:
        """Start at rest at ``position``, with the deviation of one fix."""
        self._p, self._v, self._u = complex(*position), 0j, 0j
        self._r = 1.0 + 0j
        # covariance, Hermitian: E[x conj(y)]
        self._pp, self._vv, self._uu = self._position_noise, self._velocity_noise, _BIAS_AT_START**2
        self._pv = self._pu = self._vu = 0j
        self._lean_variance = 0.0
        self._felt = True
        self._past: deque[tuple[complex, complex]] = deque([(self._p, 0j)] * (self._latency + 1))

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of position [m] and velocity [m/s], per axis."""
        return sqrt(self._pp), sqrt(self._vv)

    @property
    def bias(self) -> complex:
        """What is added to the sensed acceleration, m/s^2, forward + i right."""
        return self._u

    @property
    def delayed(self) -> tuple[float, float, float, float]:
        """Position and velocity at the instant to which a fix that arrives now belongs."""
        p, v = self._past[0]
        return p.real, p.imag, v.real, v.imag

    def predict(self, measured: Measured, expected_acceleration: tuple[float, float]) -> None:
        """Predict one step; ``expected_acceleration``: by lean and push [m/s^2], used without an accelerometer."""
        force, dt = measured.specific_force, self._dt
        self._felt = not (isnan(force[0]) or isnan(force[1]) or isnan(force[2]))
        if self._felt:
            felt, self._r = _upright(measured.attitude, force)
            a = felt + self._r * self._u
        else:
            a = complex(*expected_acceleration)
        self._p += dt * (self._v + 0.5 * dt * a)
        self._v += dt * a
        self._past.append((self._p, self._v))
        self._past.popleft()

    def correct(self, fix: Measured | None, still: bool, lean: float) -> None:
        """Correct at the end of the time between two fixes; ``fix``: None where the receiver has nothing new.

        ``lean``: deviation of the attitude beyond its sensor's noise, rad; ``still``: the vehicle stands.
        """
        self._spread(lean * lean)
        if still:
            self._correct(1, -self._v, _STILL_RATE**2, 0.0)
        if fix is None:
            return
        latency = self._latency * self._dt
        p, v = self._past[0]
        self._correct(1, complex(*fix.velocity[:2]) - v, self._velocity_noise, latency)
        p, v = self._past[0]
        self._correct(0, complex(*fix.position[:2]) - p, self._position_noise, latency)

    def _spread(self, lean_variance: float) -> None:
        """Propagate the covariance from fix to fix: ``P = F P F* + Q`` with ``F = [[1, T, r T^2/2], ...]``."""
        T = self._period
        r, noise = (self._r, self._force_noise) if self._felt else (0j, _UNFELT**2)
        s, half = T * r, 0.5 * T * T * r
        vp, up, uv = self._pv.conjugate(), self._pu.conjugate(), self._vu.conjugate()
        # F P, and then times F*
        pp = self._pp + T * vp + half * up
        pv = self._pv + T * self._vv + half * uv
        pu = self._pu + T * self._vu + half * self._uu
        vv = self._vv + s * uv
        vu = self._vu + s * self._uu
        self._pp = (pp + T * pv + half.conjugate() * pu).real + noise * T**3 / 3.0
        self._pv = pv + s.conjugate() * pu + 0.5 * noise * T * T
        self._pu = pu
        self._vv = (vv + s.conjugate() * vu).real + noise * T
        self._vu = vu
        self._uu += _BIAS_WALK**2 * T + GRAVITY**2 * max(0.0, lean_variance - self._lean_variance)
        self._lean_variance = lean_variance

    def _correct(self, which: int, error: complex, noise: float, latency: float) -> None:
        """Take a measurement of ``p`` (0) or ``v`` (1), ``latency`` seconds ago, that is ``bias`` the estimate."""
        pv, pu, vu = self._pv, self._pu, self._vu
        column = (
            (complex(self._pp), pv.conjugate(), pu.conjugate())
            if which == 0
            else (pv, complex(self._vv), vu.conjugate())
        )
        total = column[which].real + noise
        kp, kv, ku = column[0] / total, column[1] / total, column[2] / total
        cp, cv, cu = (element.conjugate() for element in column)
        self._pp -= (kp * cp).real
        self._vv -= (kv * cv).real
        self._uu -= (ku * cu).real
        self._pv -= kp * cv
        self._pu -= kp * cu
        self._vu -= kv * cu
        dp, dv, du = kp * error, kv * error, ku * error
        push, dt = self._r * du, self._dt
        for i, (p, v) in enumerate(self._past):
            t = i * dt if latency else 0.0
            self._past[i] = (p + dp + t * (dv + 0.5 * t * push), v + dv + t * push)
        self._p += dp + latency * (dv + 0.5 * latency * push)
        self._v += dv + latency * push
        self._u += du


def _upright(attitude: Quaternion, force: Vector3) -> tuple[complex, complex]:
    """Return the horizontal part of a specific force, m/s^2 NED, and the heading as a unit vector."""
    w, x, y, z = attitude
    fx, fy, fz = force
    cosine, sine = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    felt = complex(
        cosine * fx + 2.0 * (x * y - w * z) * fy + 2.0 * (x * z + w * y) * fz,
        sine * fx + (1.0 - 2.0 * (x * x + z * z)) * fy + 2.0 * (y * z - w * x) * fz,
    )
    size = sqrt(cosine * cosine + sine * sine)
    return felt, complex(cosine / size, sine / size) if size > 0.0 else 1.0 + 0j
