"""From what a mode wants (a place, a velocity, a height, a heading) to the command of one step, without jumps."""

from __future__ import annotations

from math import pi

from cosim.pilot.navigation import Fix, Pair, PositionController, Track, Tracker, lean_for, wrap
from cosim.pilot.parameters import Parameters
from cosim.signals import Command, Measured

_LEAD = 1.0  # m that the height asked for may be ahead of the vehicle beyond what its climb rate needs


class Guide:
    """Keeps the set-points of position, height and heading; each starts from where the vehicle is.

    A set-point that was not used in the step before is taken up from the present state, so that changing modes does
    not step the command of anything but the acceleration.
    """

    def __init__(self, tracker: Tracker, position: PositionController, parameters: Parameters, step: float) -> None:
        self.tracker = tracker
        self._position = position
        self._parameters = parameters
        self._step = step
        self.reset()

    def reset(self) -> None:
        """No set-point is in use."""
        self._k = -1
        self._tracked = self._held = self._aimed = -2
        self.altitude = self.yaw = 0.0
        self._position.reset()

    def begin(self, k: int, measured: Measured, yaw: float, fix: Fix) -> None:
        """The instant for the calls that follow."""
        self._k = k
        self._measured = measured
        self._yaw = yaw
        self._fix = fix

    def towards(self, place: Pair, speed: float) -> Pair:
        """Roll and pitch (rad) that fly to a place."""
        self._take_up_track()
        return self._lean(self.tracker.towards(place, speed))

    def around(self, centre: Pair, radius: float, speed: float, clockwise: bool) -> Pair:
        """Roll and pitch (rad) that fly round a centre."""
        self._take_up_track()
        return self._lean(self.tracker.around(centre, radius, speed, clockwise))

    def at_velocity(self, velocity: Pair) -> Pair:
        """Roll and pitch (rad) that fly at a velocity."""
        self._take_up_track()
        return self._lean(self.tracker.at_velocity(velocity))

    def to_height(self, altitude: float, up: float, down: float) -> float:
        """The height asked for, on its way to ``altitude`` at these rates."""
        self._take_up_height()
        dt = self._step
        off = altitude - self.altitude
        return self._raise(min(max(off, -down * dt), up * dt))

    def at_climb(self, rate: float) -> float:
        """The height asked for, moving at ``rate``."""
        self._take_up_height()
        return self._raise(rate * self._step)

    def to_yaw(self, yaw: float | None) -> float:
        """The heading asked for, on its way to ``yaw`` the short way round; None stays."""
        self._take_up_yaw()
        if yaw is not None:
            most = self._parameters["HJ_YAW_RATE"] * pi / 180.0 * self._step
            self.yaw = wrap(self.yaw + min(max(wrap(yaw - self.yaw), -most), most))
        return self.yaw

    def at_turn(self, rate: float) -> float:
        """The heading asked for, turning at ``rate``, never more than a radian ahead of the vehicle."""
        self._take_up_yaw()
        ahead = wrap(self.yaw + rate * self._step - self._yaw)
        self.yaw = wrap(self._yaw + min(max(ahead, -1.0), 1.0))
        return self.yaw

    def command(self, lean: Pair, altitude: float, yaw: float) -> Command:
        """Everything by closed loops."""
        track = self.track
        return Command((lean[0], lean[1], yaw), altitude, place=None if track is None else track.position)

    @property
    def track(self) -> Track | None:
        """The set-point of position, where one is in use."""
        return self.tracker.track if self._tracked == self._k else None

    @property
    def holds_height(self) -> bool:
        return self._held == self._k

    def _lean(self, track: Track) -> Pair:
        return lean_for(self._position.update(track, self._fix), self._yaw)

    def _take_up_track(self) -> None:
        if self._tracked not in (self._k, self._k - 1):
            self.tracker.start(self._fix.position, self._fix.velocity)
        self._tracked = self._k

    def _take_up_height(self) -> None:
        if self._held not in (self._k, self._k - 1):
            # where the law asks for the climb rate that there is
            self.altitude = self._measured.altitude - self._measured.velocity[2] / self._gain()
        self._held = self._k

    def _take_up_yaw(self) -> None:
        if self._aimed not in (self._k, self._k - 1):
            self.yaw = self._yaw
        self._aimed = self._k

    def _raise(self, change: float) -> float:
        lead = abs(change) / self._step / self._gain() + _LEAD
        here = self._measured.altitude
        wanted = self.altitude + change
        if abs(wanted - here) > lead and (wanted - here) * change > 0.0:
            # the vehicle does not follow: wait for it
            return self.altitude
        self.altitude = wanted
        return wanted

    def _gain(self) -> float:
        return max(self._parameters["HJ_ALT_P"], 0.1)
