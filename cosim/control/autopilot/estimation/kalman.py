"""The Kalman filter of all the autopilot's estimates: position, velocity, and the bias of a measured acceleration.

A state is complex, north + i east, where the motion is in the plane, and real otherwise.
"""

from __future__ import annotations

from collections import deque
from math import sqrt

from cosim.base.signals import Vector3


class Kalman:
    """Kalman filter of position ``p``, velocity ``v`` and bias ``u``, with readings that arrive late.

    The model is ``p' = v``, ``v' = a + r u + white``, ``u' = white``: ``a`` is held over a step, ``r`` (``turn``) is a
    sign, or the heading as a unit vector for a bias that turns with the vehicle.  Both axes of a plane share one
    covariance ``E[x conj(y)]``.  A reading of ``latency`` steps ago is compared with :attr:`delayed`; :meth:`shift`
    carries its correction forward to now, so that latency costs no accuracy.

    ``deviations``: of ``p``, ``v`` and ``u`` at the start.
    """

    def __init__(self, step: float, latency: int, deviations: Vector3) -> None:
        self._dt, self._latency, self._deviations = step, latency, deviations
        self.reset(0.0, 0.0)

    def reset(self, p: complex, v: complex) -> None:
        """Start at a position and a velocity, without bias."""
        self.p, self.v = p, v
        self.u: complex = 0.0
        self.turn: complex = 1.0
        pp, vv, uu = self._deviations
        self.pp, self.vv, self.uu = pp * pp, vv * vv, uu * uu
        self.pv: complex = 0.0
        self.pu: complex = 0.0
        self.vu: complex = 0.0
        self._past: deque[tuple[complex, complex]] = deque([(p, v)] * (self._latency + 1))

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of position and velocity, per axis."""
        return sqrt(self.pp), sqrt(self.vv)

    @property
    def delayed(self) -> tuple[complex, complex]:
        """Position and velocity at the instant of a measurement that arrives now."""
        return self._past[0]

    def predict(self, acceleration: complex, rests: bool = False) -> None:
        """Predict the state one step ahead under an acceleration; ``rests``: the vehicle stands and is not pushed."""
        dt = self._dt
        self.p += dt * (self.v + 0.5 * dt * acceleration)
        self.v += dt * acceleration
        if rests:
            self.v = self.u = 0.0
        self._past.append((self.p, self.v))
        self._past.popleft()

    def spread(self, T: float, turn: complex, noise: float, walk: float) -> None:
        """Propagate the covariance over ``T`` s: ``P = F P F* + Q`` with ``F = [[1, T, r T^2/2], [0, 1, r T], ...]``.

        ``noise`` is the spectral density of the acceleration, ``walk`` the variance that the bias gains.
        """
        s, half = T * turn, 0.5 * T * T * turn
        vp, up, uv = self.pv.conjugate(), self.pu.conjugate(), self.vu.conjugate()
        # F P; multiplying by the transpose of F follows.
        pp = self.pp + T * vp + half * up
        pv = self.pv + T * self.vv + half * uv
        pu = self.pu + T * self.vu + half * self.uu
        vv = self.vv + s * uv
        vu = self.vu + s * self.uu
        self.pp = (pp + T * pv + half.conjugate() * pu).real + noise * T**3 / 3.0
        self.pv = pv + s.conjugate() * pu + 0.5 * noise * T * T
        self.vv = (vv + s.conjugate() * vu).real + noise * T
        self.pu, self.vu = pu, vu
        self.uu += walk

    def take_reading(self, which: int, noise: float) -> tuple[complex, complex, complex]:
        """Reduce the covariance by a reading of ``p`` (0) or ``v`` (1) with a variance; return the gains."""
        # Row of the covariance for the reading's y: E[y conj(x)].
        row: tuple[complex, complex, complex]
        row = (self.pp, self.pv, self.pu) if which == 0 else (self.pv.conjugate(), self.vv, self.vu)
        total = row[which].real + noise
        kp, kv, ku = row[0].conjugate() / total, row[1].conjugate() / total, row[2].conjugate() / total
        self.pp -= (kp * row[0]).real
        self.vv -= (kv * row[1]).real
        self.uu -= (ku * row[2]).real
        self.pv -= kp * row[1]
        self.pu -= kp * row[2]
        self.vu -= kv * row[2]
        return kp, kv, ku

    def correct(self, which: int, error: complex, noise: float, latency: float | None = None) -> None:
        """Correct the state by a reading of ``p`` (0) or ``v`` (1) that is ``error`` above the estimate."""
        kp, kv, ku = self.take_reading(which, noise)
        self.shift(kp * error, kv * error, ku * error, latency)

    def shift(self, dp: complex, dv: complex, du: complex, latency: float | None = None) -> None:
        """Change the states from ``latency`` s ago to the present; None: the present one alone."""
        push, late, dt = self.turn * du, latency or 0.0, self._dt
        if latency is not None:
            for i, (p, v) in enumerate(self._past):
                t = i * dt if late else 0.0
                self._past[i] = (p + dp + t * (dv + 0.5 * t * push), v + dv + t * push)
        self.p += dp + late * (dv + 0.5 * late * push)
        self.v += dv + late * push
        self.u += du
