"""The servos of banks, hinges and surfaces."""

from __future__ import annotations

from math import exp

from cosim.base.constants import SERVOS
from cosim.base.limits import clamp, clip
from cosim.spec.vehicle import Hinge, Servo, Surface, Vehicle


class TiltServo:
    """Servo: a first-order lag towards the limited command with limited rate, exact between samples unless limited.

    ``a' = (clip(command, range) - a) / lag``, ``|a'| <= rate_limit``; the command is held over the step.
    """

    def __init__(self, servo: Servo | Hinge | Surface, step: float) -> None:
        self._rest = 0.0
        if isinstance(servo, Surface):
            self._low, self._high = servo.range
            self._most_change = servo.rate_limit_1_s * step
        else:
            self._most_change = servo.rate_limit_rad_s * step
            if isinstance(servo, Hinge):
                self._low, self._high = servo.angle_limits
                self._rest = servo.rest_rad
            else:
                self._low, self._high = -servo.range_rad, servo.range_rad
        self._filter_gain = 1.0 - exp(-step / servo.lag_s) if servo.lag_s > 0.0 else 1.0
        self._jam_angle: float | None = None  # rad; None: jams where it is
        self.reset()

    def reset(self, angle: float | None = None) -> None:
        """Start at ``angle``, by default that at rest, without a jam."""
        self.angle = self._rest if angle is None else angle
        self.release()

    def jam(self, angle: float | None) -> None:
        """Jam the servo from the next step on: it stays, or moves to ``angle`` [rad] at full rate and stays."""
        self._is_jammed, self._jam_angle = True, angle

    def release(self) -> None:
        """End a jam; the servo follows commands from its present angle."""
        self._is_jammed = False

    def update(self, command: float) -> float:
        """Return the angle (rad) at the end of a step with ``command`` (rad) held."""
        if self._is_jammed:
            if self._jam_angle is None:
                return self.angle
            command = self._jam_angle
        target = clip(command, self._low, self._high)
        self.angle += clamp(self._filter_gain * (target - self.angle), self._most_change)
        return self.angle


def make_servos(vehicle: Vehicle, step: float) -> list[TiltServo]:
    """Return the servos of banks, hinges and surfaces, in the order of the commands to them."""
    servos = [TiltServo(vehicle.servo, step) for _ in SERVOS] if vehicle.servo else []
    servos += [TiltServo(hinge, step) for hinge in vehicle.hinges]
    return servos + [TiltServo(surface, step) for surface in vehicle.surfaces]
