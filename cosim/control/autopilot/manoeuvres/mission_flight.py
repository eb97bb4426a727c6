"""The flight of a mission: the target of each item, and when it is done."""

from __future__ import annotations

from math import hypot, pi

from cosim.base.errors import InputError
from cosim.base.signals import Command
from cosim.control.autopilot.energy import Energy
from cosim.control.autopilot.failsafes import FailsafeMonitor
from cosim.control.autopilot.guidance.course import ARRIVAL_M, HEIGHT_OFF_M, MIN_HEIGHT_M, Course
from cosim.control.autopilot.manoeuvres.circle import Circle
from cosim.control.autopilot.manoeuvres.mission import Mission, find_endless_jump
from cosim.control.autopilot.manoeuvres.return_flight import ReturnFlight
from cosim.control.autopilot.requests import ItemKind, MissionItem, MissionUpload, Orbit


class MissionFlight:
    """Flies the items of :attr:`mission`; circle and return have classes of their own."""

    def __init__(self, course: Course, circle: Circle, return_flight: ReturnFlight, step: float) -> None:
        self.mission = Mission()
        self._parameters, self._estimates, self._landmarks = course.parameters, course.estimates, course.landmarks
        self._course = course
        self._circle = circle
        self._return_flight = return_flight
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Start a flight, and keep the mission."""
        self._climb_to: float | None = None  # m, altitude before leaving the take-off
        self.abort()

    def abort(self) -> None:
        """End the present item."""
        self._is_in_position = False  # has reached the place to climb or land

    def load(self, request: MissionUpload, watch: FailsafeMonitor) -> str:
        """Load another mission and return a warning on items at the ground; empty: none.

        Raises InputError where an item is outside the fence or jumps on the spot for ever.
        """
        if (jump := find_endless_jump(request.items)) is not None:
            raise InputError(f"mission item {jump} refused: it jumps for ever, and nothing is flown on the way")
        for index, item in enumerate(request.items):
            if item.north is not None and item.east is not None:
                height = item.altitude if item.altitude is not None else self._estimates.altitude
                if item.kind is ItemKind.CIRCLE and item.radius is not None:
                    why = self._circle.describe_outside((item.north, item.east), item.radius, height)
                else:
                    why = watch.describe_outside(item.north, item.east, height, self._landmarks.home)
                if why:
                    raise InputError(f"mission item {index} refused: {why}")
        self.mission.load(request.items)
        low = ", ".join(str(i) for i, item in enumerate(request.items) if self._altitude_of(item) != item.altitude)
        return f"mission item {low}: below {MIN_HEIGHT_M:g} m above the ground, flown at that height" if low else ""

    def _altitude_of(self, item: MissionItem) -> float | None:
        """Return the altitude [m] of an item: its own, or the minimum of automatic flight."""
        return None if item.altitude is None else max(item.altitude, self._landmarks.lowest_altitude)

    def find_shortage(self, energy: Energy, max_items: int = 1000) -> tuple[int, str]:
        """Return the first item that fuel or battery do not suffice for, with the reason; empty: none.

        Estimated from here for so many items, jumps included.  Speeds that items ask for are left out, and what ends
        only on request ends at once.
        """
        mission = Mission()
        mission.load(self.mission.items)
        mission.restart(self.mission.current)
        position, altitude, seconds = self._estimates.fix.position, self._estimates.altitude, 0.0
        item = mission.skip_jumps()
        for _ in range(max_items):
            if item is None or item.kind in (ItemKind.LAND, ItemKind.RETURN):
                break
            target = (item.north, item.east) if item.north is not None and item.east is not None else position
            height = item.altitude if item.altitude is not None else altitude
            seconds += (
                energy.travel_time(hypot(target[0] - position[0], target[1] - position[1]), height - altitude)
                + item.hold_s
            )
            if item.kind is ItemKind.CIRCLE and item.radius is not None:
                seconds += 2.0 * pi * item.radius * item.turns / energy.ground_speed.speed
            position, altitude = target, height
            if why := energy.describe_shortage(seconds, position, altitude):
                return mission.current, why
            item = mission.advance()
        return 0, ""

    @property
    def waits_on_ground(self) -> bool:
        """Whether the present item keeps a landed vehicle on the ground: a pause, or a finished landing."""
        return self.mission.item is not None and self.mission.item.kind in (ItemKind.DELAY, ItemKind.LAND)

    def stay_on_ground(self, k: int) -> None:
        """Wait one step on the ground for the present item, and advance when it is done."""
        item = self.mission.item
        if item is not None and (item.kind is ItemKind.LAND or self._is_done(item, k)):
            self.advance(flying=False)

    def leave_ground(self, flown: bool) -> None:
        """Prepare for take-off; ``flown``: the mission is flown, which climbs first unless its item says how."""
        item = self.mission.item
        self._climb_to = None
        if flown and item is not None and item.kind is not ItemKind.TAKEOFF:
            height = self._landmarks.home_altitude + self._parameters["MIS_TAKEOFF_ALT"]
            altitude = self._altitude_of(item)
            self._climb_to = height if altitude is None else min(height, altitude)

    def advance(self, flying: bool) -> None:
        """Advance from the present item, which is done."""
        self.mission.advance()
        self.begin(flying)

    def begin(self, flying: bool) -> None:
        """Set the target to the present item; items that need no flight are done at once."""
        item = self._set_speeds()
        if item is None:
            return
        self.abort()
        course, altitude = self._course, self._altitude_of(item)
        position = (item.north, item.east) if item.north is not None and item.east is not None else None
        if item.kind in (ItemKind.WAYPOINT, ItemKind.STAY):
            course.aim(position, altitude, item.yaw)
        elif item.kind is ItemKind.CIRCLE and position is not None and altitude is not None:
            radius = item.radius or 1.0
            self._circle.begin(Orbit(radius, item.clockwise, turns=item.turns), position, altitude)
        elif item.kind is ItemKind.ALTITUDE:
            course.aim(position, None, None)
        elif item.kind is ItemKind.TAKEOFF:
            if altitude is not None and flying:
                altitude = max(altitude, course.stop_height)
            course.aim(None if flying else self._estimates.fix.position, altitude, item.yaw)
        elif item.kind is ItemKind.LAND:
            course.aim(position, course.height, item.yaw)
        elif item.kind is ItemKind.RETURN:
            course.aim(None, None, None)
            self._return_flight.reset()

    def _set_speeds(self) -> MissionItem | None:
        """Apply the speed items before the next flown item and return that; None: there is none."""
        for _ in range(len(self.mission.items) + 1):
            item = self.mission.skip_jumps()
            if item is None or item.kind is not ItemKind.SPEED:
                return item
            self._course.cruise = item.speed
            self.mission.advance()
        return None

    def fly(self, k: int) -> Command | None:
        """Return the command of the next step of the present item; None where the mission is done."""
        item, course = self.mission.item, self._course
        if item is None:
            return None
        if self._climb_to is not None and self._estimates.altitude < self._climb_to - HEIGHT_OFF_M:
            return course.fly_to(None, self._climb_to, None)
        self._climb_to = None
        if item.kind is ItemKind.LAND:
            self._is_in_position = (
                self._is_in_position or course.position is None or course.distance_to(course.position) <= ARRIVAL_M
            )
            if self._is_in_position:
                return course.descend(course.position)
        elif item.kind is ItemKind.RETURN:
            return self._return_flight.fly()
        elif item.kind is ItemKind.CIRCLE:
            return self._fly_circle()
        elif item.kind is ItemKind.ALTITUDE and not self._is_in_position:
            self._change_height(item)
        elif self._is_done(item, k):
            self.advance(flying=True)
        if course.height is None:
            course.height = course.stop_height
        return course.fly()

    def _change_height(self, item: MissionItem) -> None:
        """Set the target to the item's altitude once its position is reached."""
        course = self._course
        if course.position is None or course.distance_to(course.position) <= self._parameters["HJ_ACC_RADIUS"]:
            self._is_in_position, course.height = True, self._altitude_of(item)

    def _fly_circle(self) -> Command:
        """Return the command of the next step of the circle, and advance when it is complete."""
        command = self._circle.fly()
        if self._circle.complete:
            # An item without a position starts from here, not from the circle's centre.
            self._course.aim(None, self._course.height, None)
            self.advance(flying=True)
        return command

    def _is_done(self, item: MissionItem, k: int) -> bool:
        """Return whether the item is done; waiting begins when its position is reached."""
        if item.kind is ItemKind.STAY:
            return False
        place = self._course.position
        if item.kind is not ItemKind.DELAY:
            altitude = self._altitude_of(item)
            height_error = 0.0 if altitude is None else self._estimates.altitude - altitude
            if height_error < -HEIGHT_OFF_M or (height_error > HEIGHT_OFF_M and item.kind is not ItemKind.TAKEOFF):
                return False
            if item.kind is ItemKind.WAYPOINT and place is not None:
                radius = item.acceptance_m or self._parameters["HJ_ACC_RADIUS"]
                if self.mission.since < 0 and self._course.distance_to(place) > radius:
                    return False
        if self.mission.since < 0:
            self.mission.since = k
        return (k - self.mission.since) * self._step >= item.hold_s
