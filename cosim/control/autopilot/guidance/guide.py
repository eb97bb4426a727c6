"""From the target of a mode (position, velocity, height, heading) to the command of one step, without jumps."""

from __future__ import annotations

from math import inf, pi

from cosim.base.limits import clamp
from cosim.base.signals import Command, Measured
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.geometry import Pair, lean_from_acceleration, wrap
from cosim.control.autopilot.guidance.descent import HeightLimits
from cosim.control.autopilot.guidance.position_control import PositionController
from cosim.control.autopilot.guidance.tracker import Track, Tracker
from cosim.control.autopilot.parameters import Parameters


class Guide:
    """Moves the set-points of position, height and heading, each of which begins at the vehicle's state.

    A set-point that was not used in the step before is taken up from the present state, so that changing modes does
    not step the command of anything but the acceleration.
    """

    # Largest lead [m] of the height set-point over the vehicle beyond what its climb rate needs.
    max_lead = 1.0

    def __init__(
        self, tracker: Tracker, position: PositionController, parameters: Parameters, limits: HeightLimits, step: float
    ) -> None:
        self.tracker = tracker
        self.limits = limits
        self._height = Tracker(limits.acceleration, limits.jerk, step)
        self._position = position
        self._parameters = parameters
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Discard all set-points."""
        self._k = -1
        self._track_step = self._height_step = self._yaw_step = -2
        self.altitude = self.yaw = self._climb = 0.0
        self._position.reset()

    def restart_height(self) -> None:
        """Restart the height set-point at the vehicle's height and climb rate in the next step."""
        self._height_step = -2

    def limit(self, limits: HeightLimits) -> None:
        """Change the height limits; the set-point continues."""
        self.limits = limits
        self._height.limit(limits.acceleration, limits.jerk)
        track = self._height.track
        self._height.start(track.position, track.velocity)

    def begin(
        self, k: int, measured: Measured, yaw: float, fix: Fix, max_sink: float = inf, is_spinning: bool = False
    ) -> None:
        """Store the state of step ``k`` for the commands; ``max_sink``: highest rate of descent [m/s] of a set-point.

        With ``is_spinning`` no heading is held: the lean is computed for the commanded heading, so it changes steadily.
        """
        self._yaw = self.yaw if is_spinning and self._yaw_step == self._k else yaw
        self._k = k
        self._measured = measured
        self._fix = fix
        self._max_sink = max_sink

    def towards(self, target: Pair, speed: float) -> Pair:
        """Return the roll and pitch [rad] that fly to a position."""
        self._start_track()
        return self._lean_to_follow(self.tracker.towards(target, speed))

    def around(self, centre: Pair, radius: float, speed: float, clockwise: bool) -> Pair:
        """Return the roll and pitch [rad] that fly round a centre."""
        self._start_track()
        return self._lean_to_follow(self.tracker.around(centre, radius, speed, clockwise))

    def at_velocity(self, velocity: Pair) -> Pair:
        """Return the roll and pitch [rad] that fly at a velocity."""
        self._start_track()
        return self._lean_to_follow(self.tracker.at_velocity(velocity))

    def to_height(self, altitude: float, up: float, down: float) -> float:
        """Return the height set-point [m] on its way to ``altitude`` [m] at these rates [m/s] at most."""
        self._start_height()
        height_error = altitude - self.altitude
        if self._stops_to_wait(height_error):
            return self.altitude
        speed = up if height_error > 0.0 else min(down, self._max_sink)
        return self._store_height(self._height.towards((altitude, 0.0), speed))

    def at_climb(self, rate: float) -> float:
        """Return the height set-point [m], moving at ``rate`` [m/s]."""
        self._start_height()
        rate = max(rate, -self._max_sink)
        if self._stops_to_wait(rate):
            return self.altitude
        return self._store_height(self._height.at_velocity((rate, 0.0)))

    def to_yaw(self, yaw: float | None) -> float:
        """Return the heading set-point [rad] on its way to ``yaw`` the short way round; None: keep the heading."""
        self._start_yaw()
        if yaw is not None:
            most = self._parameters["HJ_YAW_RATE"] * pi / 180.0 * self._step
            self.yaw = wrap(self.yaw + clamp(wrap(yaw - self.yaw), most))
        return self.yaw

    def at_yaw_rate(self, rate: float) -> float:
        """Return the heading set-point [rad], turning at ``rate`` [rad/s], at most a radian ahead of the vehicle."""
        self._start_yaw()
        ahead = wrap(self.yaw + rate * self._step - self._yaw)
        self.yaw = wrap(self._yaw + clamp(ahead, 1.0))
        return self.yaw

    def command(self, lean: Pair, altitude: float, yaw: float) -> Command:
        """Return the command with set-points of attitude [rad] and height [m]."""
        track = self.track
        return Command((lean[0], lean[1], yaw), altitude, place=None if track is None else track.position)

    @property
    def track(self) -> Track | None:
        """The set-point of position; None if none is active."""
        return self.tracker.track if self._track_step == self._k else None

    @property
    def holds_height(self) -> bool:
        return self._height_step == self._k

    @property
    def stop_height(self) -> float:
        """Height [m] at which the set-point would come to rest if stopped now."""
        return self._height.stop_position[0]

    def _lean_to_follow(self, track: Track) -> Pair:
        return lean_from_acceleration(self._position.update(track, self._fix), self._yaw)

    def _start_track(self) -> None:
        if self._track_step not in (self._k, self._k - 1):
            self.tracker.start(self._fix.position, self._fix.velocity)
        self._track_step = self._k

    def _start_height(self) -> None:
        if self._height_step not in (self._k, self._k - 1):
            # The loop's own limits are these: they stop a fall, whatever the set-point.
            up, down = self._parameters["HJ_SPEED_UP"], self._parameters["HJ_SPEED_DN"]
            self._climb = min(max(-self._measured.velocity[2], -down), up)
            # At this height set-point the law commands the present climb rate.
            self.altitude = self._measured.altitude + self._climb / self._height_gain()
            self._height.start((self.altitude, 0.0), (self._climb, 0.0))
        self._height_step = self._k

    def _start_yaw(self) -> None:
        if self._yaw_step not in (self._k, self._k - 1):
            self.yaw = self._yaw
        self._yaw_step = self._k

    def _stops_to_wait(self, change: float) -> bool:
        """Stop the height set-point and return True if the vehicle lags too far behind it."""
        ahead = self.altitude - self._measured.altitude
        if abs(ahead) < self.max_lead + abs(self._climb) / self._height_gain() or ahead * change <= 0.0:
            return False
        self._climb = 0.0
        self._height.start((self.altitude, 0.0), (0.0, 0.0))
        return True

    def _store_height(self, track: Track) -> float:
        self.altitude, self._climb = track.position[0], track.velocity[0]
        return self.altitude

    def _height_gain(self) -> float:
        return max(self._parameters["HJ_ALT_P"], 0.1)
