"""Horizontal position and velocity from the GNSS receiver and the lean, NED.

The estimate is predicted with the measured lean, so neither a limit of the lean nor a slow attitude loop winds
anything up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import hypot, inf
from typing import NamedTuple

from cosim.base._records import quick
from cosim.base.signals import Measured, Vector3
from cosim.control.autopilot.estimation.dead_reckoning import DeadReckoning
from cosim.control.autopilot.estimation.position_gains import settling_gains
from cosim.control.autopilot.geometry import Pair, lean_acceleration
from cosim.spec.vehicle import PositionGains, PositionSensor


@quick
class Fix(NamedTuple):
    """The estimated horizontal position, velocity, and acceleration that attitude does not explain: m, m/s, m/s^2."""

    position: Pair
    velocity: Pair
    disturbance: Pair


class Estimator:
    """Position, velocity and the acceleration that the attitude does not explain, one Kalman filter per axis.

    The model per axis is ``p' = v``, ``v' = a + b + white``, ``b' = white``, with ``a = g tan(lean)`` from the measured
    attitude (thrust along the body's z axis that holds the weight).  A GNSS epoch is compared with the estimate of the
    step in which it was taken and its correction carried forward to now, so its latency costs no accuracy and no phase
    margin.  The gains are those of the sensors' stated noise and of ``acceleration_noise`` and ``disturbance_walk``,
    computed once; both axes share them.  ``noisy``: the receiver never repeats a fix, standing or not.

    ``reckoning`` replaces the receiver where it has nothing new.  Without it the last ``b`` stays, which contains the
    drag of the speed at which it was estimated, and the velocity is soon wrong.
    """

    def __init__(
        self,
        gains: PositionGains,
        sensor: PositionSensor,
        step: float,
        noisy: bool = False,
        reckoning: DeadReckoning | None = None,
    ) -> None:
        self._step = step
        self._noisy = noisy
        self._reckoning = reckoning
        self._period, self._latency = sensor.period_samples, sensor.latency_samples
        self._gains, self._deviations = settling_gains(gains, sensor, step)
        self.reset((0.0, 0.0))

    def reset(self, position: Pair) -> None:
        """Start at rest at ``position``, with the deviation of one epoch of the receiver."""
        self._epoch = 0
        self._last: tuple[float, ...] = ()
        self.silent = 0.0  # s without a new fix
        self._p = list(position)
        self._v = [0.0, 0.0]
        self._b = [0.0, 0.0]
        entry = (*position, 0.0, 0.0)
        self._past: deque[tuple[float, float, float, float]] = deque([entry] * (self._latency + 1))
        if self._reckoning is not None:
            self._reckoning.reset(position)

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of position [m] and velocity [m/s], per axis; infinite where nothing predicts them."""
        fix_deviation = self._deviations[min(self._epoch, len(self._deviations) - 1)]
        if self.silent == 0.0:
            return fix_deviation
        if self._reckoning is None:
            return inf, inf
        position_deviation, velocity_deviation = self._reckoning.deviation
        return hypot(fix_deviation[0], position_deviation), hypot(fix_deviation[1], velocity_deviation)

    @property
    def fix(self) -> Fix:
        """The estimate at the instant of the last update."""
        p, v, b = self._p, self._v, self._b
        return Fix((p[0], p[1]), (v[0], v[1]), (b[0], b[1]))

    def update(
        self, k: int, measured: Measured, still: bool, lean_deviation: float = 0.0, is_pushed: bool = False
    ) -> Fix:
        """Return the estimate at ``t_k``; ``still``: the vehicle stands, so it has no velocity and nothing pushes it.

        ``lean_deviation``: of the attitude beyond its sensor's noise, rad; ``is_pushed``: by its own thrust, so that
        the estimated disturbance stays as it is.
        """
        dt, reckoning = self._step, self._reckoning
        p, v, b = self._p, self._v, self._b
        lean = lean_acceleration(measured.attitude)
        if reckoning is not None:
            reckoning.predict(measured, (lean[0] + b[0], lean[1] + b[1]))
        for axis, felt in enumerate([lean[0], lean[1]]):
            a = felt + b[axis]
            p[axis] += dt * (v[axis] + 0.5 * dt * a)
            v[axis] += dt * a
            if still:
                v[axis] = b[axis] = 0.0
        past = self._past
        past.append((p[0], p[1], v[0], v[1]))
        past.popleft()
        if k > self._latency and (k - self._latency) % self._period == 0:
            # a receiver that has nothing new repeats itself to the last bit
            fix = (*measured.position, *measured.velocity[:2])
            fresh = fix != self._last or (still and not self._noisy)
            self.silent = 0.0 if fresh else self.silent + self._period * dt
            self._last = fix
            if reckoning is not None:
                reckoning.correct(measured if fresh else None, still, lean_deviation)
            if fresh:
                self._correct((*measured.position[:2], *measured.velocity[:2]), still, is_pushed)
            elif reckoning is not None:
                self._correct(reckoning.delayed, still, is_pushed)
        return self.fix

    def _correct(self, fix: tuple[float, float, float, float], still: bool, is_pushed: bool) -> None:
        """Correct by a position [m] and a velocity [m/s] of ``latency`` samples ago."""
        gains = self._gains
        gain = gains[self._epoch] if self._epoch < len(gains) else gains[-1]
        self._epoch += 1
        then = self._past[0]
        p, v, b = self._p, self._v, self._b
        latency = self._latency * self._step
        shifts = []
        for axis in (0, 1):
            off_p = fix[axis] - then[axis]
            off_v = fix[2 + axis] - then[2 + axis]
            dp = gain[0][0] * off_p + gain[0][1] * off_v
            dv = gain[1][0] * off_p + gain[1][1] * off_v
            db = gain[2][0] * off_p + gain[2][1] * off_v
            if still:
                dv = db = 0.0
            elif is_pushed:
                db = 0.0
            shifts.append((dp, dv, db))
            p[axis] += dp + latency * (dv + 0.5 * latency * db)
            v[axis] += dv + latency * db
            b[axis] += db
        self._shift_past(shifts)

    def _shift_past(self, shifts: Sequence[Vector3]) -> None:
        """Shift the past estimates, which the next epochs are compared with, by the correction."""
        (pn, vn, bn), (pe, ve, be) = shifts
        step = self._step
        for i, (n, e, un, ue) in enumerate(self._past):
            t = i * step
            self._past[i] = (
                n + pn + t * (vn + 0.5 * t * bn),
                e + pe + t * (ve + 0.5 * t * be),
                un + vn + t * bn,
                ue + ve + t * be,
            )
