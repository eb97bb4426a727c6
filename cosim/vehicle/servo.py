"""The two tilt servos."""

from __future__ import annotations

from math import exp

from cosim.base.limits import clamp
from cosim.spec.vehicle import Servo


class TiltServo:
    """First-order lag towards the limited command, with the rate limited: exact between samples while it is not.

    ``a' = (clip(command, +-range) - a) / lag``, ``|a'| <= rate_limit``; the command is held over the step.
    """

    def __init__(self, servo: Servo, step: float) -> None:
        self._range = servo.range_rad
        self._most = servo.rate_limit_rad_s * step
        self._share = 1.0 - exp(-step / servo.lag_s) if servo.lag_s > 0.0 else 1.0
        self._at: float | None = None  # rad, where a jam runs to; None: nowhere
        self.reset()

    def reset(self, angle: float = 0.0) -> None:
        """Stand at ``angle`` rad, free."""
        self.angle = angle
        self.free()

    def jam(self, angle: float | None) -> None:
        """From the next step on stay where it stands, or run to ``angle`` (rad) in its own way and stay there."""
        self._jammed, self._at = True, angle

    def free(self) -> None:
        """Go on from where it stands, as commanded."""
        self._jammed = False

    def update(self, command: float) -> float:
        """Angle (rad) at the end of the step in which ``command`` (rad) is held."""
        if self._jammed:
            if self._at is None:
                return self.angle
            command = self._at
        limit = self._range
        target = clamp(command, limit)
        move = self._share * (target - self.angle)
        most = self._most
        self.angle += clamp(move, most)
        return self.angle
