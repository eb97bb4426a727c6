"""Return: up, home or to the rally point that is nearer, down."""

from __future__ import annotations

from math import hypot

from cosim.base.signals import Command
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.course import ARRIVAL_M, HEIGHT_OFF_M, MAX_ENTRY_M_S, Course

_CLIMB, _CRUISE, _DESCENT = range(3)  # phases of the return


class ReturnFlight:
    """The return to home or to a nearer rally point."""

    def __init__(self, course: Course) -> None:
        self._estimates = course.estimates
        self._course = course
        self.reset()

    def reset(self) -> None:
        self._phase = _CLIMB
        self._to: Pair | None = None  # landing place: home or a rally point

    def fly(self) -> Command:
        """Return the command of the next step home; the first step chooses the destination."""
        course, estimates = self._course, self._estimates
        if self._to is None or course.height is None:
            # Do not return at a speed that was set for another leg: fuel is planned for the cruise speed.
            course.cruise = None
            self._to, course.height, near = course.plan_return(estimates.fix.position, course.stop_height)
            self._phase = _CRUISE if near else _CLIMB
        position = self._to
        distance = course.distance_to(position)
        if self._phase == _CLIMB and estimates.altitude > course.height - HEIGHT_OFF_M:
            self._phase = _CRUISE
        if self._phase == _CRUISE and distance < ARRIVAL_M and hypot(*estimates.fix.velocity) < MAX_ENTRY_M_S:
            self._phase = _DESCENT
        if self._phase == _DESCENT:
            return course.descend(position)
        return course.fly_to(None if self._phase == _CLIMB else position, course.height, course.heading)
