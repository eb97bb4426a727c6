"""The two tilt servos."""

from __future__ import annotations

from math import exp

from cosim.vehicle import Servo


class TiltServo:
    """First-order lag towards the limited command, with the rate limited: exact between samples while it is not.

    ``a' = (clip(command, +-range) - a) / lag``, ``|a'| <= rate_limit``; the command is held over the step.
    """

    def __init__(self, servo: Servo, step: float) -> None:
        self._range = servo.range_rad
        self._most = servo.rate_limit_rad_s * step
        self._share = 1.0 - exp(-step / servo.lag_s) if servo.lag_s > 0.0 else 1.0
        self.angle = 0.0

    def reset(self, angle: float = 0.0) -> None:
        """Stand at ``angle`` rad."""
        self.angle = angle

    def update(self, command: float) -> float:
        """Angle (rad) at the end of the step in which ``command`` (rad) is held."""
        limit = self._range
        target = limit if command > limit else (-limit if command < -limit else command)
        move = self._share * (target - self.angle)
        most = self._most
        self.angle += most if move > most else (-most if move < -most else move)
        return self.angle
