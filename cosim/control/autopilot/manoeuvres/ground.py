"""Off the ground and back onto it: spooling up, the climb, contact, and the thrust taken away."""

from __future__ import annotations

from cosim.base.errors import InputError
from cosim.base.protocols import Report
from cosim.base.signals import Command
from cosim.control.autopilot.failsafes import FailsafeMonitor
from cosim.control.autopilot.guidance.course import HEIGHT_OFF_M, MIN_HEIGHT_M, Course
from cosim.control.autopilot.manoeuvres.touchdown import Touchdown
from cosim.control.autopilot.modes import Home

# Height above the ground from which a vehicle without leg contact flies, chosen by us above the height noise.
_MIN_LIFT_OFF_M = 0.3


class TakeOff:
    """Take-off from idle to a height: thrust rises to that of hover, then a climb, level until the legs are free.

    ``hover``: the collective at which it hovers; ``idle``: that of the engines at idle.
    """

    # Time [s] after spooling up at which a take-off that has not left the ground is abandoned.
    give_up_s = 10.0

    def __init__(self, course: Course, hover: float, idle: float, step: float) -> None:
        self._parameters, self._estimates, self._landmarks = course.parameters, course.estimates, course.landmarks
        self._course = course
        self._hover, self._idle = hover, idle
        self._step = step
        self.reset()

    def reset(self) -> None:
        self.height: float | None = None  # requested height, m above home

    def check_height(self, height: float | None, watch: FailsafeMonitor) -> float:
        """Return the height [m] above home to climb to; None: the parameter's.  Raises InputError if not allowed."""
        estimates, landmarks = self._estimates, self._landmarks
        height = height if height is not None else self._parameters["MIS_TAKEOFF_ALT"]
        if height < MIN_HEIGHT_M:
            raise InputError(f"take-off refused: {height:g} m, at least {MIN_HEIGHT_M:g} m above home are needed")
        home = landmarks.home or Home(*estimates.fix.position, estimates.altitude)
        if home.altitude + height < estimates.altitude + _MIN_LIFT_OFF_M:
            below = estimates.altitude - home.altitude
            raise InputError(f"take-off refused: {height:g} m above home, and it stands {below:.1f} m above it")
        if why := watch.describe_outside(*estimates.fix.position, home.altitude + height, home):
            raise InputError(f"take-off refused: {why}")
        if why := watch.energy.describe_climb_shortage(home.altitude + height):
            raise InputError(f"take-off refused: {height:g} m: {why}")
        return height

    def begin(self, k: int) -> None:
        self._landmarks.ground = self._estimates.altitude
        self._landmarks.take_off_position = self._estimates.fix.position
        self._course.guide.reset()
        self._course.begin(k)

    def rise(self, steps: int) -> Command | None:
        """Return the command ``steps`` steps after the beginning; None: the vehicle does not leave the ground."""
        guide, since = self._course.guide, steps * self._step
        spool = self._parameters["HJ_SPOOL_TIME"]
        if since > spool + self.give_up_s:
            return None
        yaw = guide.to_yaw(None)
        if since < spool:
            collective = self._idle + (self._hover - self._idle) * since / spool
            return Command((0.0, 0.0, yaw), self._estimates.altitude, None, collective)
        return guide.command((0.0, 0.0), guide.at_climb(self._parameters["HJ_CLIMB_AUTO"]), yaw)

    def climb(self) -> Command:
        """Return the command in the air: to the requested height, above the take-off position."""
        course, landmarks = self._course, self._landmarks
        if course.height is None:
            to = self.height if self.height is not None else self._parameters["MIS_TAKEOFF_ALT"]
            course.aim(landmarks.take_off_position, landmarks.home_altitude + to, None)
        return course.fly_to(course.position, course.height, None)

    @property
    def complete(self) -> bool:
        """Whether the requested height is reached."""
        height = self._course.height
        return height is not None and abs(self._estimates.altitude - height) < HEIGHT_OFF_M


class Landing:
    """Detects the ground and removes the thrust there.

    :class:`Touchdown` evaluates the legs' contact; this class checks it against the height.
    """

    # Height [m] above the ground; three standard deviations above it is in the air, whatever the legs report.
    clear_m = 1.0
    # Time [s] of contact that neither height nor weight confirms, which a broken switch reports; time to idle thrust.
    max_doubt_s, settle_s = 1.0, 0.7

    def __init__(self, course: Course, touchdown: Touchdown, hover: float, idle: float, step: float) -> None:
        self._estimates, self._landmarks = course.estimates, course.landmarks
        self._course = course
        self.touchdown = touchdown
        self._hover, self._idle = hover, idle
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Start a flight without contact in doubt."""
        self.touchdown.reset()
        self._doubt_s = 0.0  # s of contact that cannot be real
        self.abort()

    def abort(self) -> None:
        """End the landing, because another manoeuvre is flown."""
        self.collective: float | None = None  # collective while reduced on touchdown
        self.disarms = False  # whether to disarm once it stands

    def update(self, report: Report, sure: bool) -> None:
        """Update the contact by one step; ``sure``: the vehicle is clearly in the air."""
        estimates, descending = self._estimates, self._course.descending
        self.touchdown.update(estimates.now.velocity[2], estimates.lift, report, descending, sure)

    @property
    def has_lifted(self) -> bool:
        """Whether the vehicle, which has just been on the ground, is in the air for certain."""
        above = self._estimates.altitude - self._landmarks.ground
        clear = above - 3.0 * self._estimates.altitude_deviation > self.clear_m
        return clear or (self.touchdown.is_off_ground and above > _MIN_LIFT_OFF_M)

    def lift_off(self) -> None:
        """Begin the flight with the leg switch trusted, unless it still reports contact."""
        stuck = not self.touchdown.is_off_ground
        self.touchdown.reset()
        self.touchdown.switch_failed = stuck

    @property
    def is_still_grounded(self) -> bool:
        """Whether a vehicle that takes off is still on the ground."""
        return not self.touchdown.is_off_ground and self._estimates.altitude < self._landmarks.ground + _MIN_LIFT_OFF_M

    @property
    def has_weight_on_legs(self) -> bool:
        """Whether the vehicle is on the ground by the switch and by its weight."""
        return self.touchdown.is_touching and self.touchdown.carries_weight

    def detect_contact(self) -> bool:
        """Return whether the legs report contact, if height or weight confirm it.

        A vehicle that drifts, or comes down fast, hops from leg to leg on nearly its own weight in thrust until it
        trips: the thrust has to go before a contact lasts, so a touch of a moment ago counts as low as this.
        """
        touchdown, low = self.touchdown, self._may_be_grounded
        if not touchdown.is_touching or low or touchdown.carries_weight:
            self._doubt_s = 0.0
            return touchdown.is_touching or (low and touchdown.is_bouncing and not touchdown.switch_failed)
        self._doubt_s += self._step
        return False

    def reject_switch(self) -> bool:
        """Return True once, when the switch has reported too long a ground that cannot be there and is ignored."""
        if self._doubt_s <= self.max_doubt_s or self.touchdown.switch_failed:
            return False
        self.touchdown.switch_failed = True
        return True

    @property
    def _may_be_grounded(self) -> bool:
        """Whether the vehicle may be as low as at its take-off, given the uncertainty of height."""
        estimates = self._estimates
        return estimates.altitude - 3.0 * estimates.altitude_deviation < self._landmarks.ground + _MIN_LIFT_OFF_M

    def settle(self, collective: float) -> Command:
        """Return the command that reduces the thrust to idle, one step on from ``collective``."""
        self._course.descending = True
        self.collective = max(self._idle, collective - self._step * self._hover / self.settle_s)
        yaw = self._course.guide.to_yaw(None)
        return Command((0.0, 0.0, yaw), self._estimates.altitude, None, self.collective)

    @property
    def has_settled(self) -> bool:
        """Whether thrust is off and the vehicle stands."""
        stands = self.touchdown.is_standing or self.touchdown.legs_bear_weight
        return self.collective is not None and self.collective <= self._idle and stands
