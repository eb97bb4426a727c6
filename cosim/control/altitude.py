"""Altitude hold: height to climb rate to collective, with the hover throttle fed forward."""

from __future__ import annotations

from collections.abc import Callable

from cosim.signals import Command, Measured, Refused
from cosim.vehicle import AltitudeGains

GRAVITY = 9.80665  # m/s^2, standard
_LEAST_UPRIGHT = 0.5  # thrust is not raised further for a lean beyond 60 degrees


class AltitudeController:
    """P from height to climb rate, PI from climb rate to vertical acceleration, then thrust against gravity and lean.

    ``mass`` kg; ``throttle_for(thrust)`` is the collective that gives a total thrust [N] at rest.
    """

    def __init__(self, gains: AltitudeGains, mass: float, throttle_for: Callable[[float], float], step: float) -> None:
        self._position = gains.position_1_s
        self._up, self._down = gains.climb_limit_m_s, -gains.descent_limit_m_s
        self._velocity = gains.velocity_1_s
        self._limit = gains.integral_limit_m_s2
        self._mass = mass
        self._throttle_for = throttle_for
        self._i = gains.integral_1_s2 * step
        self.reset()

    def reset(self) -> None:
        """No integral."""
        self._integral = 0.0

    def update(self, command: Command, measured: Measured, refused: Refused) -> float:
        """Collective: the mean throttle."""
        if command.collective is not None:
            return command.collective
        climb = self._position * (command.altitude - measured.altitude)
        climb = self._up if climb > self._up else (self._down if climb < self._down else climb)
        error = climb + measured.velocity[2]
        if refused.collective * error <= 0.0:
            limit = self._limit
            integral = self._integral + self._i * error
            self._integral = limit if integral > limit else (-limit if integral < -limit else integral)
        _, x, y, _ = measured.attitude
        upright = 1.0 - 2.0 * (x * x + y * y)
        if upright < _LEAST_UPRIGHT:
            upright = _LEAST_UPRIGHT
        acceleration = GRAVITY + self._velocity * error + self._integral
        return self._throttle_for(self._mass * acceleration / upright)
