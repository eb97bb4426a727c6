"""Return: up, home or to the rally point that is nearer, down."""

from __future__ import annotations

from math import hypot

from cosim.base.signals import Command
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.course import ABOVE_M, REACHED_M, SLOW, Course
from cosim.control.autopilot.modes import Home

_NEAR_M = 2.0  # from home: no climb and no flight is needed to land here; chosen by us
_CLIMB, _CRUISE, _DESCENT = range(3)


class Homeward:
    """The way back."""

    def __init__(self, course: Course) -> None:
        self._parameters, self._estimates, self._places = course.parameters, course.estimates, course.places
        self._course = course
        self.reset()

    def reset(self) -> None:
        """Not begun."""
        self._phase = _CLIMB
        self._to: Pair | None = None  # where it lands

    def fly(self) -> Command:
        """The next step of it; where it ends is chosen at the first."""
        course, estimates, places = self._course, self._estimates, self._places
        home = places.home or Home(*estimates.fix.position, places.home_altitude)
        begins = self._to is None
        place = self._to = self._to or places.nearest(home, estimates.fix.position)
        away = course.away(place)
        if begins or course.height is None:
            near = away < _NEAR_M
            height = home.altitude + self._parameters["RTL_RETURN_ALT"]
            height = max([height, *(p.altitude for p in places.rally if (p.north, p.east) == place)])
            course.height = course.stop_height if near else max(course.stop_height, height)
            self._phase = _CRUISE if near else _CLIMB
        if self._phase == _CLIMB and estimates.altitude > course.height - REACHED_M:
            self._phase = _CRUISE
        if self._phase == _CRUISE and away < ABOVE_M and hypot(*estimates.fix.velocity) < SLOW:
            self._phase = _DESCENT
        if self._phase == _DESCENT:
            return course.descend(place)
        return course.to(None if self._phase == _CLIMB else place, course.height, course.heading)
