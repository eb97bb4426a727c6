"""Flight round a centre: a requested orbit, or a mission's circle."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin

from cosim.base.errors import InputError
from cosim.base.signals import Command
from cosim.control.autopilot.failsafes import FailsafeMonitor
from cosim.control.autopilot.geometry import Pair, wrap
from cosim.control.autopilot.guidance.course import MIN_HEIGHT_M, Course
from cosim.control.autopilot.requests import Orbit, OrbitYaw


class Circle:
    """Manoeuvre that circles round a centre, with a count of the turns."""

    def __init__(self, course: Course, watch: FailsafeMonitor) -> None:
        self._parameters, self._estimates, self._landmarks = course.parameters, course.estimates, course.landmarks
        self._course = course
        self._watch = watch
        self.reset()

    def reset(self) -> None:
        self.orbit: Orbit | None = None
        self._turned = 0.0  # angle flown around the centre, rad
        self._bearing: float | None = None  # rad, in the last step; None: before it

    def check_request(self, request: Orbit) -> tuple[Pair, float]:
        """Return centre and height of a requested orbit.  Raises InputError if it is not allowed."""
        limit = self._parameters.table["MPC_XY_VEL_MAX"]
        if request.speed is not None and not limit.least <= request.speed <= limit.most:
            raise InputError(f"orbit refused: speed {request.speed:g} m/s, from {limit.least:g} to {limit.most:g} m/s")
        here = self._estimates.fix.position
        centre = here if request.north is None or request.east is None else (request.north, request.east)
        altitude = request.altitude if request.altitude is not None else self._course.stop_height
        if altitude < self._landmarks.lowest_altitude:
            raise InputError(f"orbit refused: at least {MIN_HEIGHT_M:g} m above the ground are needed")
        if why := self.describe_outside(centre, request.radius, altitude):
            raise InputError(f"orbit refused: {why}")
        return centre, altitude

    def describe_outside(self, centre: Pair, radius: float, altitude: float, points: int = 36) -> str:
        """Return why one of the points of a circle is outside the fence; empty: none is."""
        for n in range(points):
            angle = 2.0 * pi * n / points
            north, east = centre[0] + radius * cos(angle), centre[1] + radius * sin(angle)
            if why := self._watch.describe_outside(north, east, altitude, self._landmarks.home):
                return why
        return ""

    def begin(self, orbit: Orbit, centre: Pair, altitude: float) -> None:
        """Start a circle, with no turn flown."""
        self.orbit = orbit
        self._course.aim(centre, altitude, self._estimates.euler[2])
        self._turned, self._bearing = 0.0, None

    @property
    def complete(self) -> bool:
        """Whether the requested turns have been flown."""
        return self.orbit is not None and 0.0 < 2.0 * pi * self.orbit.turns <= self._turned

    def fly(self) -> Command:
        """Return the command round the centre; turns count once the vehicle is on the circle."""
        orbit, course, (north, east) = self.orbit, self._course, self._estimates.fix.position
        assert orbit is not None
        assert course.position is not None
        assert course.height is not None
        guide = course.guide
        n, e = north - course.position[0], east - course.position[1]
        speed = orbit.speed if orbit.speed is not None else course.speed
        lean = guide.around(course.position, orbit.radius, speed, orbit.clockwise)
        height_setpoint = course.to_height(course.height)
        bearing = atan2(e, n)
        if orbit.yaw is OrbitYaw.CENTRE:
            heading = atan2(-e, -n)
        elif orbit.yaw is OrbitYaw.TANGENT:
            heading = wrap(bearing + (0.5 * pi if orbit.clockwise else -0.5 * pi))
        else:
            heading = course.heading if course.heading is not None else self._estimates.euler[2]
        command = guide.command(lean, height_setpoint, guide.to_yaw(heading))
        if self._bearing is not None:
            self._turned += wrap(bearing - self._bearing) * (1.0 if orbit.clockwise else -1.0)
        self._bearing = bearing if abs(hypot(n, e) - orbit.radius) < max(1.0, 0.1 * orbit.radius) else None
        return command
