"""Off the ground and back onto it: spooling up, the climb, contact, and the thrust taken away."""

from __future__ import annotations

from cosim.base.errors import InputError
from cosim.base.protocols import Report
from cosim.base.signals import Command
from cosim.control.autopilot.failsafes import Watch
from cosim.control.autopilot.guidance.course import LOWEST_M, REACHED_M, Course
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import Home

# Chosen by us, with the reason.
_LIFT_M = 0.3  # above the ground with no leg in contact is in the air
_CLEAR_M = 1.0  # above the ground by three deviations more than this is in the air, whatever the legs say
_LIFT_S = 10.0  # after spooling up without leaving the ground, the take-off is given up
_DOUBTED_S = 1.0  # contact that neither height nor weight bears out, for so long: the switch is broken
_SETTLE_S = 0.7  # from contact to idle


class TakeOff:
    """From idle to a height: thrust up to that of hover, then a climb, level until the legs are free.

    ``hover``: the collective at which it hovers; ``least``: that of the engines at idle.
    """

    def __init__(self, course: Course, hover: float, least: float, step: float) -> None:
        self._parameters, self._estimates, self._places = course.parameters, course.estimates, course.places
        self._course = course
        self._hover, self._least = hover, least
        self._step = step
        self.reset()

    def reset(self) -> None:
        """None is asked for."""
        self.height: float | None = None  # above home

    def asked(self, height: float | None, watch: Watch) -> float:
        """Return the height [m] above home to climb to; None: the parameter's.  Raises InputError if it may not."""
        estimates, places = self._estimates, self._places
        height = height if height is not None else self._parameters["MIS_TAKEOFF_ALT"]
        if height < LOWEST_M:
            raise InputError(f"take-off refused: {height:g} m, at least {LOWEST_M:g} m above home are needed")
        home = places.home or Home(*estimates.fix.position, estimates.altitude)
        if home.altitude + height < estimates.altitude + _LIFT_M:
            below = estimates.altitude - home.altitude
            raise InputError(f"take-off refused: {height:g} m above home, and it stands {below:.1f} m above it")
        if why := watch.outside(*estimates.fix.position, home.altitude + height, home):
            raise InputError(f"take-off refused: {why}")
        if why := watch.energy.short_of_climb(home.altitude + height):
            raise InputError(f"take-off refused: {height:g} m: {why}")
        return height

    def leave(self, k: int) -> None:
        """Begin the take-off from the present position, which is the ground's."""
        self._places.ground = self._estimates.altitude
        self._places.left = self._estimates.fix.position
        self._course.guide.reset()
        self._course.begin(k)

    def rise(self, steps: int) -> Command | None:
        """Return the command so many steps after the beginning; None: the vehicle does not leave the ground."""
        guide, since = self._course.guide, steps * self._step
        spool = self._parameters["HJ_SPOOL_TIME"]
        if since > spool + _LIFT_S:
            return None
        yaw = guide.to_yaw(None)
        if since < spool:
            collective = self._least + (self._hover - self._least) * since / spool
            return Command((0.0, 0.0, yaw), self._estimates.altitude, None, collective)
        return guide.command((0.0, 0.0), guide.at_climb(self._parameters["HJ_CLIMB_AUTO"]), yaw)

    def climb(self) -> Command:
        """In the air: to the height that was asked for, above where it has left."""
        course, places = self._course, self._places
        if course.height is None:
            to = self.height if self.height is not None else self._parameters["MIS_TAKEOFF_ALT"]
            course.aim(places.left, places.home_altitude + to, None)
        return course.to(course.place, course.height, None)

    @property
    def complete(self) -> bool:
        """That height is reached."""
        height = self._course.height
        return height is not None and abs(self._estimates.altitude - height) < REACHED_M


class Landing:
    """Whether it has touched the ground, and the thrust that goes when it has.

    The legs' contact is a :class:`Touchdown`'s to judge; where there can be ground at all is known here.
    """

    def __init__(self, course: Course, touchdown: Touchdown, hover: float, least: float, step: float) -> None:
        self._estimates, self._places = course.estimates, course.places
        self._course = course
        self.touchdown = touchdown
        self._hover, self._least = hover, least
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Forget the last flight."""
        self.touchdown.reset()
        self._doubted = 0.0  # s for which the legs have reported a ground that cannot be there
        self.abort()

    def abort(self) -> None:
        """Something else is flown."""
        self.collective: float | None = None  # while the thrust is taken away
        self.disarms = False  # as soon as it stands

    def look(self, report: Report, sure: bool) -> None:
        """One step of the legs and what is felt; ``sure``: it is off the ground, and not about to touch it."""
        estimates, descending = self._estimates, self._course.descending
        self.touchdown.update(estimates.now.velocity[2], estimates.senses.lift, report, descending, sure)

    @property
    def lifted(self) -> bool:
        """In the air for certain, where it has just been on the ground."""
        above = self._estimates.altitude - self._places.ground
        clear = above - 3.0 * self._estimates.altitude_deviation > _CLEAR_M
        return clear or (self.touchdown.off and above > _LIFT_M)

    def lift_off(self) -> None:
        """In the air: the legs are asked anew; those that still report the ground are broken."""
        stuck = not self.touchdown.off
        self.touchdown.reset()
        self.touchdown.switch_failed = stuck

    @property
    def unlifted(self) -> bool:
        """While taking off: still on the ground."""
        return not self.touchdown.off and self._estimates.altitude < self._places.ground + _LIFT_M

    @property
    def weighs(self) -> bool:
        """On the ground by more than the switch's word."""
        return self.touchdown.touching and self.touchdown.carried

    def touched(self) -> bool:
        """Return whether the legs report the ground where it can be: by the height, or where they carry weight.

        A vehicle that drifts, or comes down fast, hops from leg to leg on nearly its own weight in thrust until it
        trips: the thrust has to go before a contact lasts, so a touch of a moment ago counts as low as this.
        """
        touchdown, low = self.touchdown, self._low
        if not touchdown.touching or low or touchdown.carried:
            self._doubted = 0.0
            return touchdown.touching or (low and touchdown.bouncing and not touchdown.switch_failed)
        self._doubted += self._step
        return False

    def disbelieves(self) -> bool:
        """Return True once, when the switch has reported too long a ground that cannot be there and is ignored."""
        if self._doubted <= _DOUBTED_S or self.touchdown.switch_failed:
            return False
        self.touchdown.switch_failed = True
        return True

    @property
    def _low(self) -> bool:
        """As low as where it took off, as far as the height is known."""
        estimates = self._estimates
        return estimates.altitude - 3.0 * estimates.altitude_deviation < self._places.ground + _LIFT_M

    def settle(self, collective: float) -> Command:
        """On the ground: take the thrust away, from this collective on."""
        self._course.descending = True
        self.collective = max(self._least, collective - self._step * self._hover / _SETTLE_S)
        yaw = self._course.guide.to_yaw(None)
        return Command((0.0, 0.0, yaw), self._estimates.altitude, None, self.collective)

    @property
    def settled(self) -> bool:
        """The thrust is gone and it stands."""
        stands = self.touchdown.standing or self.touchdown.borne
        return self.collective is not None and self.collective <= self._least and stands
