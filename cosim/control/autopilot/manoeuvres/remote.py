"""Flight by sticks, or by the set-points of an OFFBOARD pilot."""

from __future__ import annotations

from math import cos, radians, sin

from cosim.base.frames import to_euler
from cosim.base.signals import Command
from cosim.control.autopilot.geometry import limit_length
from cosim.control.autopilot.guidance.course import LANDING_HEIGHT_M, Course
from cosim.control.autopilot.modes import DIRECT, STICK_MODES, Mode
from cosim.control.autopilot.requests import OffboardAttitude, OffboardPosition, OffboardVelocity, Sticks, quaternion_of
from cosim.spec.vehicle import AllocationLimits

Setpoint = OffboardAttitude | OffboardVelocity | OffboardPosition

_NEVER = -(10**9)  # a step long before the first one
_CENTRED = Sticks(0.0, 0.0, 0.0, 0.5)  # sticks released, half throttle


class RemoteControl:
    """Flight by the last sticks or the last set-point of a ground station, with their age.

    ``hover``: the collective of the sticks' centre; ``limits``: those of the collective.
    """

    # Throttle stick on the ground: below the first value engines idle, above the second it requests a take-off.
    off_throttle, up_throttle = 0.05, 0.6
    # Least climb rate [m/s] of a command that does not count as level.
    least_climb = 0.1

    def __init__(self, course: Course, limits: AllocationLimits, hover: float, step: float) -> None:
        self._parameters, self._estimates = course.parameters, course.estimates
        self._course = course
        self._limits = limits
        self._hover = hover
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Discard sticks and set-points."""
        self.sticks: Sticks | None = None
        self.setpoint: Setpoint | None = None
        self._sticks_at = self._setpoint_at = _NEVER

    def take(self, request: Sticks | Setpoint, k: int) -> None:
        """Store sticks or a set-point as the last ones, with the step of their arrival."""
        if isinstance(request, Sticks):
            self.sticks, self._sticks_at = request, k
        else:
            self.setpoint, self._setpoint_at = request, k

    def has_fresh_sticks(self, k: int) -> bool:
        return (k - self._sticks_at) * self._step <= self._parameters["HJ_STICK_TIME"]

    def has_fresh_setpoint(self, k: int) -> bool:
        return (k - self._setpoint_at) * self._step <= self._parameters["HJ_OFFB_TIME"]

    def commands_collective(self, mode: Mode) -> bool:
        """Return whether the collective itself is commanded, and not a height."""
        offboard = mode is Mode.OFFBOARD and isinstance(self.setpoint, OffboardAttitude)
        return offboard or mode in DIRECT

    def refusals(self, mode: Mode, k: int) -> list[str]:
        """Return why the vehicle may not be armed in a mode flown by sticks or set-points."""
        if mode is Mode.OFFBOARD and not self.has_fresh_setpoint(k):
            return ["mode OFFBOARD needs set-points, and there are none"]
        if mode in STICK_MODES and not self.has_fresh_sticks(k):
            return [f"mode {mode.value} needs sticks, and there are none"]
        if mode in DIRECT and self.sticks is not None and self.sticks.throttle > self.off_throttle:
            return ["the throttle stick is not down"]
        return []

    def needs_take_off(self, mode: Mode, k: int) -> bool:
        """Return whether the sticks or the set-point need the vehicle to leave the ground."""
        sticks, setpoint = self.sticks, self.setpoint
        if mode in STICK_MODES and sticks is not None and self.has_fresh_sticks(k):
            return sticks.throttle > (self.off_throttle if mode in DIRECT else self.up_throttle)
        if mode is Mode.OFFBOARD:
            if isinstance(setpoint, OffboardAttitude):
                return setpoint.thrust > self.off_throttle
            if isinstance(setpoint, OffboardVelocity):
                return setpoint.down < -self.least_climb
            if isinstance(setpoint, OffboardPosition):
                return -setpoint.down > self._estimates.altitude + LANDING_HEIGHT_M
        return False

    def fly(self, mode: Mode) -> Command:
        """Return the command for the last sticks or the last set-point."""
        if mode in STICK_MODES:
            return self._command_by_sticks(self.sticks or _CENTRED, mode)
        return self._course.fly() if self.setpoint is None else self._command_by_setpoint(self.setpoint)

    def _command_by_sticks(self, sticks: Sticks, mode: Mode) -> Command:
        course, parameters = self._course, self._parameters
        guide = course.guide
        yaw = guide.at_yaw_rate(_deflection(sticks.yaw) * radians(parameters["HJ_YAW_RATE"]))
        most = radians(parameters["HJ_STICK_LEAN"])
        lean = limit_length(sticks.roll * most, -sticks.pitch * most, most)
        if mode in DIRECT:
            return Command((*lean, yaw), self._estimates.altitude, None, self._stick_collective(sticks.throttle))
        if mode is Mode.POSCTL:
            heading, speed = self._estimates.euler[2], course.speed
            c, s = cos(heading), sin(heading)
            forward, right = limit_length(_deflection(sticks.pitch) * speed, _deflection(sticks.roll) * speed, speed)
            lean = guide.at_velocity((forward * c - right * s, forward * s + right * c))
        climb = _deflection(2.0 * sticks.throttle - 1.0)
        rate = climb * parameters["HJ_CLIMB_AUTO" if climb > 0.0 else "HJ_DESC_AUTO"]
        course.descending = rate < 0.0
        return guide.command(lean, guide.at_climb(rate), yaw)

    def _stick_collective(self, throttle: float) -> float:
        """Return the collective of a throttle stick: least at 0, hover at the centre, most at 1."""
        low, high = self._limits.throttle_min, self._limits.throttle_max
        if throttle < 0.5:
            return 2.0 * throttle * (self._hover - low) + low
        return self._hover + (2.0 * throttle - 1.0) * (high - self._hover)

    def _command_by_setpoint(self, setpoint: Setpoint) -> Command:
        course, parameters = self._course, self._parameters
        guide = course.guide
        if isinstance(setpoint, OffboardAttitude):
            quaternion = quaternion_of(setpoint)
            roll, pitch, yaw = self._estimates.euler if quaternion is None else to_euler(quaternion)
            roll, pitch = limit_length(roll, pitch, radians(parameters["HJ_STICK_LEAN"]))
            return Command((roll, pitch, yaw), self._estimates.altitude, setpoint.rates, setpoint.thrust)
        if isinstance(setpoint, OffboardPosition):
            return course.fly_to((setpoint.north, setpoint.east), -setpoint.down, setpoint.yaw)
        climb = min(parameters["HJ_SPEED_UP"], max(-parameters["HJ_SPEED_DN"], -setpoint.down))
        course.descending = climb < -self.least_climb
        lean = guide.at_velocity(limit_length(setpoint.north, setpoint.east, parameters["MPC_XY_VEL_MAX"]))
        yaw = guide.to_yaw(setpoint.yaw) if setpoint.yaw_rate is None else guide.at_yaw_rate(setpoint.yaw_rate)
        return guide.command(lean, guide.at_climb(climb), yaw)


def _deflection(stick: float, zone: float = 0.05) -> float:
    """Return a stick's deflection without its dead zone around the centre, still 1 at the end."""
    size = max(0.0, abs(stick) - zone) / (1.0 - zone)
    return size if stick > 0.0 else -size
