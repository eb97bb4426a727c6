"""The set-point that moves to where the vehicle is sent: bounded speed, acceleration and jerk."""

from __future__ import annotations

from collections import deque
from math import ceil, copysign, hypot, sqrt
from typing import NamedTuple

from cosim.control.autopilot.geometry import Pair

# Fraction of the acceleration that braking is planned with, so that some is left for turning.
BRAKE_FRACTION = 0.75


class Track(NamedTuple):
    """Set-point at one instant: m, m/s, m/s^2, horizontal NED."""

    position: Pair
    velocity: Pair
    acceleration: Pair


class Tracker:
    """Set-point that moves to any target with bounded speed, acceleration and jerk.

    A point leads, with bounded acceleration towards the target's position or velocity; the set-point is its mean
    over ``acceleration / jerk`` seconds, which bounds the jerk and adds exactly that time (a mean of what does not
    overshoot does not overshoot).  From rest over a distance ``d`` it takes ``d / v + v / (2 a) + v / (2 a_b) + a / j``
    with braking at ``a_b = 0.75 a``, where ``v`` is reached.
    """

    def __init__(self, acceleration: float, jerk: float, step: float) -> None:
        self._step = step
        self.limit(acceleration, jerk)
        self.start((0.0, 0.0), (0.0, 0.0))

    def limit(self, acceleration: float, jerk: float, longest_s: float = 10.0) -> None:
        """Set new limits of acceleration [m/s^2] and jerk [m/s^3]; the averaging time changes at the next start.

        ``longest_s``: a set-point that answers later than this is of no use to a pilot.
        """
        self._a = acceleration * self._step  # m/s per step
        self._b = BRAKE_FRACTION * self._a
        self._count = max(1, ceil(min(acceleration / jerk, longest_s) / self._step))

    def start(self, position: Pair, velocity: Pair) -> None:
        """Start the set-point from this position, at this velocity and without acceleration."""
        dt = self._step
        lead = 0.5 * dt * (self._count - 1)
        # The point starts as if it had always moved like this, so that the mean of its past is the set-point.
        self._p = [position[0] + lead * velocity[0], position[1] + lead * velocity[1]]
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
        self._sum: list[float] = [float(sum(entry[i] for entry in self._window)) for i in range(4)]
        self.track = Track(position, velocity, (0.0, 0.0))

    def towards(self, target: Pair, speed: float) -> Track:
        """Move one step towards a position at up to ``speed`` m/s."""
        n, e = target[0] - self._p[0], target[1] - self._p[1]
        distance = hypot(n, e)
        if distance == 0.0:
            return self._move_at_velocity(0.0, 0.0)
        # The speed from which braking in whole steps ends at the target.
        unit = self._b * self._step
        braking = self._b * (sqrt(0.25 + 2.0 * distance / unit) - 0.5)
        scale = min(min(speed, braking), distance / self._step) / distance
        return self._move_at_velocity(n * scale, e * scale)

    def at_velocity(self, velocity: Pair) -> Track:
        """Move one step towards a velocity, m/s."""
        return self._move_at_velocity(velocity[0], velocity[1])

    @property
    def point(self) -> Pair:
        """The position of the point that leads the set-point."""
        return (self._p[0], self._p[1])

    def around(self, centre: Pair, radius: float, speed: float, clockwise: bool) -> Track:
        """Move one step towards and along a circle; ``clockwise`` seen from above.

        The speed is at most that at which half of the acceleration holds the point on the circle: v^2 / R = a / 2.
        """
        n, e = self._p[0] - centre[0], self._p[1] - centre[1]
        distance = hypot(n, e)
        n, e = (n / distance, e / distance) if distance > 0.0 else (1.0, 0.0)
        speed = min(speed, sqrt(0.5 * self._a / self._step * radius))
        radius_error = radius - distance
        # Towards the circle only as fast as a quarter of the acceleration can brake; the rest goes along the circle.
        across = copysign(
            min(speed, sqrt(0.5 * self._a / self._step * abs(radius_error)), abs(radius_error) / self._step),
            radius_error,
        )
        along = sqrt(max(0.0, speed * speed - across * across)) * (1.0 if clockwise else -1.0)
        return self._move_at_velocity(across * n - along * e, across * e + along * n)

    @property
    def stop_position(self) -> Pair:
        """Position at which the set-point would come to rest if stopped now."""
        vn, ve = self._v
        speed = hypot(vn, ve)
        # at_velocity stops with full acceleration, hence the scale
        scale = 0.5 * speed / self._a * self._step
        return (self._p[0] + vn * scale, self._p[1] + ve * scale)

    def _move_at_velocity(self, north: float, east: float) -> Track:
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
        old_pn, old_pe, old_vn, old_ve = self._window.popleft()
        self._window.append((p[0], p[1], v[0], v[1]))
        total, n = self._sum, float(len(self._window))
        pn = total[0] = total[0] + (p[0] - old_pn)
        pe = total[1] = total[1] + (p[1] - old_pe)
        vn = total[2] = total[2] + (v[0] - old_vn)
        ve = total[3] = total[3] + (v[1] - old_ve)
        acceleration = ((v[0] - old_vn) / (n * dt), (v[1] - old_ve) / (n * dt))
        self.track = Track((pn / n, pe / n), (vn / n, ve / n), acceleration)
        return self.track
