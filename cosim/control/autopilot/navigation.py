"""Velocity and position control on top of the attitude loop: estimate, set-point track, control law.

Horizontal, NED.  The lean commanded by the law is answered by the attitude loop; what the estimator predicts with is
the lean that is measured, so neither a limit of the lean nor a slow attitude loop winds anything up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from math import atan2, ceil, copysign, cos, hypot, inf, pi, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from cosim.base.constants import GRAVITY
from cosim.base.signals import Measured, Quaternion, Vector3
from cosim.control.autopilot.reckoning import Reckoning
from cosim.control.bumpless import Fade
from cosim.spec.vehicle import PositionGains, PositionSensor

Pair = tuple[float, float]

_LEAST_UPRIGHT = 0.5  # beyond a lean of 60 degrees the acceleration is no longer read off the attitude
_LEAST_POSITION_NOISE = 0.01  # m, m/s: a receiver stated as perfect is still not trusted beyond this
_LEAST_VELOCITY_NOISE = 0.001
_EPOCHS = 600  # after which the gains have settled: a minute at 10 Hz
_LONGEST_MEAN = 10.0  # s: a set-point that answers later than this is of no use to a pilot
_BRAKE_SHARE = 0.75  # of the acceleration is planned for braking, so that some is left to turn with


class Fix(NamedTuple):
    """Where the vehicle is thought to be, horizontally: m, m/s, m/s^2 of what attitude does not explain."""

    position: Pair
    velocity: Pair
    disturbance: Pair


class Estimator:
    """Position, velocity and the acceleration that the attitude does not explain, one Kalman filter per axis.

    The model per axis is ``p' = v``, ``v' = a + b + white``, ``b' = white``, with ``a = g tan(lean)`` from the measured
    attitude (thrust along the body's z axis that holds the weight).  A GNSS epoch is compared with the estimate of the
    step in which it was taken and its correction carried forward to now, so its latency costs no accuracy and no phase
    margin.  The gains are those of the sensors' stated noise and of ``acceleration_noise`` and ``disturbance_walk``,
    computed once; both axes share them.  ``noisy``: the receiver never says the same twice, standing or not.

    ``reckoning``: what stands in for the receiver where it has nothing new.  Without it the last ``b`` stays, with the
    drag of the speed at which it was learnt in it, and the velocity is soon another one than is thought.
    """

    def __init__(
        self,
        gains: PositionGains,
        sensor: PositionSensor,
        step: float,
        noisy: bool = False,
        reckoning: Reckoning | None = None,
    ) -> None:
        self._step = step
        self._noisy = noisy
        self._reckoning = reckoning
        self._period, self._latency = sensor.period_samples, sensor.latency_samples
        self._gains, self._deviations = _settling(gains, sensor, step)
        self.reset((0.0, 0.0))

    def reset(self, position: Pair) -> None:
        """At rest at ``position``, known as well as one epoch of the receiver knows it."""
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
        """Standard deviations of place [m] and velocity [m/s], per axis; infinite where nothing carries them on."""
        own = self._deviations[min(self._epoch, len(self._deviations) - 1)]
        if self.silent == 0.0:
            return own
        if self._reckoning is None:
            return inf, inf
        place, speed = self._reckoning.deviation
        return hypot(own[0], place), hypot(own[1], speed)

    @property
    def fix(self) -> Fix:
        """The estimate at the instant of the last update."""
        p, v, b = self._p, self._v, self._b
        return Fix((p[0], p[1]), (v[0], v[1]), (b[0], b[1]))

    def update(self, k: int, measured: Measured, still: bool, lean_deviation: float = 0.0) -> Fix:
        """The estimate at ``t_k``; ``still``: the vehicle stands, so it has no velocity and nothing pushes it.

        ``lean_deviation``: of the attitude beyond its sensor's noise, rad.
        """
        dt, reckoning = self._step, self._reckoning
        p, v, b = self._p, self._v, self._b
        lean = lean_acceleration(measured.attitude)
        if reckoning is not None:
            reckoning.carry(measured, (lean[0] + b[0], lean[1] + b[1]))
        for axis in (0, 1):
            a = lean[axis] + b[axis]
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
                reckoning.epoch(measured if fresh else None, still, lean_deviation)
            if fresh:
                self._correct((*measured.position[:2], *measured.velocity[:2]), still)
            elif reckoning is not None:
                self._correct(reckoning.then, still)
        return self.fix

    def _correct(self, fix: tuple[float, float, float, float], still: bool) -> None:
        """Take a place and a velocity, m and m/s, of ``latency`` samples ago."""
        gains = self._gains
        gain = gains[self._epoch] if self._epoch < len(gains) else gains[-1]
        self._epoch += 1
        then = self._past[0]
        p, v, b = self._p, self._v, self._b
        late = self._latency * self._step
        shifts = []
        for axis in (0, 1):
            off_p = fix[axis] - then[axis]
            off_v = fix[2 + axis] - then[2 + axis]
            dp = gain[0][0] * off_p + gain[0][1] * off_v
            dv = gain[1][0] * off_p + gain[1][1] * off_v
            db = gain[2][0] * off_p + gain[2][1] * off_v
            if still:
                dv = db = 0.0
            shifts.append((dp, dv, db))
            p[axis] += dp + late * (dv + 0.5 * late * db)
            v[axis] += dv + late * db
            b[axis] += db
        self._shift_past(shifts)

    def _shift_past(self, shifts: Sequence[Vector3]) -> None:
        """What is compared with the next epochs moves with the correction."""
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


def kalman_gains(gains: PositionGains, sensor: PositionSensor, step: float) -> list[list[list[float]]]:
    """Gains (3 x 2: position, velocity, disturbance by position, velocity) of each GNSS epoch, the last one for good.

    Time-varying from the first fix on: the noise of position is averaged away while the vehicle stands, instead of
    being carried along for the half minute that the settled filter needs.
    """
    return _settling(gains, sensor, step)[0]


@lru_cache
def _settling(
    gains: PositionGains, sensor: PositionSensor, step: float
) -> tuple[list[list[list[float]]], list[tuple[float, float]]]:
    """The gains of :func:`kalman_gains`, and after each number of epochs the deviations of position and velocity."""
    T = sensor.period_samples * step
    F = np.array([[1.0, T, 0.5 * T * T], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    qa, qb = gains.acceleration_noise_m_s15**2, gains.disturbance_walk_m_s25**2
    # integrals of the two white noises over the time between epochs
    Q = qa * np.array([[T**3 / 3, T**2 / 2, 0.0], [T**2 / 2, T, 0.0], [0.0, 0.0, 0.0]])
    Q += qb * np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
    H = np.eye(2, 3)
    noise = (
        max(sensor.position_noise_m, _LEAST_POSITION_NOISE) ** 2,
        max(sensor.velocity_noise_m_s, _LEAST_VELOCITY_NOISE) ** 2,
    )
    R = np.diag(noise)
    P = np.diag([noise[0], noise[1], 0.0])
    found, deviations = [], [(sqrt(noise[0]), sqrt(noise[1]))]
    for _ in range(_EPOCHS):
        P = F @ P @ F.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        P = (np.eye(3) - K @ H) @ P
        found.append([[float(x) for x in row] for row in K])
        deviations.append((float(sqrt(P[0, 0])), float(sqrt(P[1, 1]))))
    return found, deviations


class Track(NamedTuple):
    """One instant of the set-point: m, m/s, m/s^2, horizontal NED."""

    position: Pair
    velocity: Pair
    acceleration: Pair


class Tracker:
    """The set-point that the vehicle follows: bounded speed, acceleration and jerk, for any target at any time.

    A point runs ahead, with bounded acceleration towards the target's place or velocity; the set-point is its mean
    over ``acceleration / jerk`` seconds, which bounds the jerk and adds exactly that time (a mean of what does not
    overshoot does not overshoot).  From rest over a distance ``d`` it takes ``d / v + v / (2 a) + v / (2 a_b) + a / j``
    with braking at ``a_b = 0.75 a``, where ``v`` is reached.
    """

    def __init__(self, acceleration: float, jerk: float, step: float) -> None:
        self._step = step
        self.limit(acceleration, jerk)
        self.start((0.0, 0.0), (0.0, 0.0))

    def limit(self, acceleration: float, jerk: float) -> None:
        """New limits, m/s^2 and m/s^3; the mean's length changes at the next start."""
        self._a = acceleration * self._step  # m/s a step
        self._b = _BRAKE_SHARE * self._a
        self._count = max(1, ceil(min(acceleration / jerk, _LONGEST_MEAN) / self._step))

    def start(self, position: Pair, velocity: Pair) -> None:
        """The set-point goes on from here, at this velocity and without acceleration."""
        dt = self._step
        ahead = 0.5 * dt * (self._count - 1)
        # as if the point had always flown like this: then the mean of its past is where the set-point is
        self._p = [position[0] + ahead * velocity[0], position[1] + ahead * velocity[1]]
        self._v = [velocity[0], velocity[1]]
        n = self._count
        self._window: deque[tuple[float, float, float, float]] = deque(
            (
                self._p[0] - dt * j * velocity[0],
                self._p[1] - dt * j * velocity[1],
                velocity[0],
                velocity[1],
            )
            for j in range(n - 1, -1, -1)
        )
        self._sum = [sum(entry[i] for entry in self._window) for i in range(4)]
        self.track = Track(position, velocity, (0.0, 0.0))

    def towards(self, target: Pair, speed: float) -> Track:
        """One step towards a place, at most at ``speed`` m/s."""
        n, e = target[0] - self._p[0], target[1] - self._p[1]
        distance = hypot(n, e)
        if distance == 0.0:
            return self._move(0.0, 0.0)
        # the speed from which whole steps of braking end at the target
        unit = self._b * self._step
        share = min(speed, self._b * (sqrt(0.25 + 2.0 * distance / unit) - 0.5), distance / self._step) / distance
        return self._move(n * share, e * share)

    def at_velocity(self, velocity: Pair) -> Track:
        """One step towards a velocity, m/s."""
        return self._move(*velocity)

    @property
    def point(self) -> Pair:
        """Where the point is that runs ahead of the set-point."""
        return (self._p[0], self._p[1])

    def around(self, centre: Pair, radius: float, speed: float, clockwise: bool) -> Track:
        """One step along a circle, towards it first; ``clockwise`` as seen from above.

        The speed is at most that at which half of the acceleration holds the point on the circle: v^2 / R = a / 2.
        """
        n, e = self._p[0] - centre[0], self._p[1] - centre[1]
        distance = hypot(n, e)
        n, e = (n / distance, e / distance) if distance > 0.0 else (1.0, 0.0)
        speed = min(speed, sqrt(0.5 * self._a / self._step * radius))
        off = radius - distance
        # inwards or outwards no faster than a quarter of the acceleration brakes, the rest along the circle
        across = copysign(min(speed, sqrt(0.5 * self._a / self._step * abs(off)), abs(off) / self._step), off)
        along = sqrt(max(0.0, speed * speed - across * across)) * (1.0 if clockwise else -1.0)
        return self._move(across * n - along * e, across * e + along * n)

    @property
    def ahead(self) -> Pair:
        """Where the set-point would come to rest if it were stopped now."""
        vn, ve = self._v
        speed = hypot(vn, ve)
        # at_velocity stops with the full acceleration
        share = 0.5 * speed / self._a * self._step
        return (self._p[0] + vn * share, self._p[1] + ve * share)

    def _move(self, north: float, east: float) -> Track:
        v, p, dt = self._v, self._p, self._step
        dn, de = north - v[0], east - v[1]
        change = hypot(dn, de)
        if change > self._a:
            dn, de = dn * self._a / change, de * self._a / change
            v[0] += dn
            v[1] += de
        else:
            v[0], v[1] = north, east
        p[0] += dt * v[0]
        p[1] += dt * v[1]
        entry = (p[0], p[1], v[0], v[1])
        old = self._window.popleft()
        self._window.append(entry)
        total, n = self._sum, len(self._window)
        for i in range(4):
            total[i] += entry[i] - old[i]
        self.track = Track(
            (total[0] / n, total[1] / n),
            (total[2] / n, total[3] / n),
            ((v[0] - old[2]) / (n * dt), (v[1] - old[3]) / (n * dt)),
        )
        return self.track


class PositionController:
    """P on position, P on velocity, against the estimated disturbance: acceleration wanted, m/s^2 NED.

    ``a = a_track + K_v (v_track + K_p (p_track - p) - v) - b``.  ``b`` is the integral action: it comes from what the
    vehicle did with the lean that it had, so it cannot wind up at a limit.  ``K_p`` times the error is limited, and
    so is the whole, in length, to what ``lean`` gives.
    """

    def __init__(self, gains: PositionGains, step: float) -> None:
        self._step = step
        self._catch_up = gains.catch_up_m_s
        self._law = (gains.position_1_s, gains.velocity_1_s, gains.lean_rad)
        self.reset()

    def reset(self) -> None:
        """No change of gains is under way."""
        self._left: tuple[float, float, float] | None = None
        self._fades: tuple[Fade, ...] = ()

    def retune(self, position: float, velocity: float, lean: float) -> None:
        """Other gains from the next update on, without a bump: the difference in acceleration fades."""
        if self._left is None:
            self._left = self._law
        self._law = (position, velocity, lean)
        self._fades = self._fades or (Fade(self._step), Fade(self._step))

    def update(self, track: Track, fix: Fix) -> Pair:
        """Acceleration to lean for."""
        answer = self._answer(self._law, track, fix)
        if not self._fades:
            return answer
        n, e = (fade.update() for fade in self._fades)
        if self._left is not None:
            old = self._answer(self._left, track, fix)
            self._left = None
            n, e = old[0] + n - answer[0], old[1] + e - answer[1]
            for fade, value in zip(self._fades, (n, e), strict=True):
                fade.begin(value)
        return answer[0] + n, answer[1] + e

    def _answer(self, law: tuple[float, float, float], track: Track, fix: Fix) -> Pair:
        kp, kv, lean = law
        (tp, tv, ta), (p, v, b) = track, fix
        cn, ce = limited(kp * (tp[0] - p[0]), kp * (tp[1] - p[1]), self._catch_up)
        return limited(
            ta[0] + kv * (tv[0] + cn - v[0]) - b[0],
            ta[1] + kv * (tv[1] + ce - v[1]) - b[1],
            GRAVITY * tan(lean),
        )


def limited(north: float, east: float, most: float) -> Pair:
    """A vector shortened to the length ``most``."""
    size = hypot(north, east)
    return (north, east) if size <= most else (north * most / size, east * most / size)


def lean_acceleration(attitude: Quaternion) -> Pair:
    """Horizontal acceleration, m/s^2 NED, of thrust along the body's -z that holds the weight."""
    w, x, y, z = attitude
    upright = 1.0 - 2.0 * (x * x + y * y)
    if upright < _LEAST_UPRIGHT:
        upright = _LEAST_UPRIGHT
    scale = -2.0 * GRAVITY / upright
    return (scale * (x * z + w * y), scale * (y * z - w * x))


def lean_for(acceleration: Pair, yaw: float) -> Pair:
    """Roll and pitch (rad) at heading ``yaw`` whose :func:`lean_acceleration` is ``acceleration``."""
    c, s = cos(yaw), sin(yaw)
    forward = acceleration[0] * c + acceleration[1] * s
    right = acceleration[1] * c - acceleration[0] * s
    pitch = atan2(-forward, GRAVITY)
    return atan2(right * cos(pitch), GRAVITY), pitch


def wrap(angle: float) -> float:
    """An angle in [-pi, pi)."""
    return angle - 2.0 * pi * ((angle + pi) // (2.0 * pi))
