"""Altitude hold: height to climb rate to collective, with the hover throttle fed forward."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cosim.base.constants import GRAVITY
from cosim.base.frames import upright
from cosim.base.limits import clamp, clip
from cosim.base.signals import Command, Measured, Unallocated
from cosim.control.bumpless import Fade
from cosim.control.lead import Lead
from cosim.spec.vehicle import AltitudeGains, EngineLead

# Least cosine of the lean for which thrust is raised to hold height: 60 degrees.
MIN_UPRIGHT: Final = 0.5


class AltitudeController:
    """P from height to climb rate, PI from climb rate to vertical acceleration, then thrust against gravity and lean.

    ``mass`` kg, tank full; ``throttle_for(thrust)`` is the collective that gives a total thrust [N] at rest; a ``lead``
    stands behind it.
    """

    def __init__(
        self,
        gains: AltitudeGains,
        mass: float,
        throttle_for: Callable[[float], float],
        step: float,
        lead: Lead | None = None,
    ) -> None:
        self._step = step
        self._lead = lead
        self._factors = (1.0, 1.0, 1.0)
        self._set_gains(gains)
        self._mass = mass
        self._throttle_for = throttle_for
        self.reset()

    def _set_gains(self, gains: AltitudeGains) -> None:
        self._gains = gains
        position, velocity, integral = self._factors
        self._position = position * gains.position_1_s
        self._up, self._down = gains.climb_limit_m_s, -gains.descent_limit_m_s
        self._velocity = velocity * gains.velocity_1_s
        self._limit = gains.integral_limit_m_s2
        self._i = integral * (gains.integral_1_s2 * self._step)

    def scale_gains(self, position: float, velocity: float, integral: float, lead: EngineLead | None) -> None:
        """Scale the nominal gains from the next step on, and set the lead: see :mod:`cosim.control.schedule`."""
        self._factors = (position, velocity, integral)
        self._set_gains(self._gains)
        if lead is not None and self._lead is not None:
            self._lead.set_poles(lead)

    def reset(self) -> None:
        self._integral = 0.0
        self._started = False
        self._old_gains: AltitudeGains | None = None
        self._fade: Fade | None = None

    def retune(self, gains: AltitudeGains) -> None:
        """Change the gains at the next update without a jump: the difference in commanded acceleration fades."""
        if self._old_gains is None:
            self._old_gains = self._gains
        self._set_gains(gains)
        self._fade = self._fade or Fade(self._step)

    def update(self, command: Command, measured: Measured, unallocated: Unallocated, burnt: float = 0.0) -> float:
        """Return the collective, the mean throttle.  ``burnt``: fuel [kg], the integral of the reported flows."""
        if command.collective is not None:
            self._started = False
            return command.collective
        height_error = command.altitude - measured.altitude
        error = self.climb(height_error) + measured.velocity[2]
        if unallocated.collective * error <= 0.0:
            limit = self._limit
            integral = self._integral + self._i * error
            self._integral = clamp(integral, limit)
        cosine = upright(measured.attitude)
        if cosine < MIN_UPRIGHT:
            cosine = MIN_UPRIGHT
        acceleration = GRAVITY + self._velocity * error + self._integral
        if self._fade is not None:
            acceleration += self._fade_change(self._fade, height_error, measured.velocity[2], acceleration)
        throttle = self._throttle_for((self._mass - burnt) * acceleration / cosine)
        lead = self._lead
        if lead is None:
            return throttle
        # The lead is initialised when height control begins.
        residual = unallocated.collective if self._started else 0.0
        if not self._started:
            lead.settle(throttle)
        self._started = True
        return lead.update(throttle, residual)

    def climb(self, height_error: float) -> float:
        """Return the commanded climb rate [m/s] at ``height_error`` metres below the set-point."""
        return clip(self._position * height_error, self._down, self._up)

    def _fade_change(self, fade: Fade, height_error: float, sink: float, new: float) -> float:
        """Return the fading difference of the old gains' acceleration to the ``new`` one; the integral is common."""
        rest = fade.update()
        if self._old_gains is None:
            return rest
        old = self._old_gains
        self._old_gains = None
        position, velocity, _ = self._factors
        climb = max(-old.descent_limit_m_s, min(old.climb_limit_m_s, position * old.position_1_s * height_error))
        difference = GRAVITY + velocity * old.velocity_1_s * (climb + sink) + self._integral + rest - new
        fade.begin(difference)
        return difference
