"""The target of a flight, and the commands that lead there."""

from __future__ import annotations

from math import hypot, inf

from cosim.base.signals import Command
from cosim.control.autopilot.estimation.estimator import Estimator
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.descent import descent_rate
from cosim.control.autopilot.guidance.guide import Guide
from cosim.control.autopilot.modes import Home
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.requests import RallyPoint

# Heights [m] of automatic flight chosen by us: large compared with GNSS noise, small compared with surroundings.
MIN_HEIGHT_M = 1.0  # above the ground, in automatic flight
LANDING_HEIGHT_M = 0.3  # a lower height command means to land
HEIGHT_OFF_M = 0.4  # error that completes climb or descent
ARRIVAL_M = 0.7  # distance that counts as arrival
MAX_ENTRY_M_S = 0.5  # faster vehicles do not begin a descent


class Landmarks:
    """Home, rally points, and the height of the ground at the last take-off."""

    def __init__(self) -> None:
        self.rally: tuple[RallyPoint, ...] = ()  # rally points, kept across flights
        self.reset(0.0)

    def reset(self, ground: float) -> None:
        """Start without a home, standing at the height ``ground`` [m]."""
        self.home: Home | None = None
        self.home_is_set = False  # True: a request has set home
        self.ground = ground  # ground height at the last take-off
        self.take_off_position: Pair | None = None  # position of the last take-off

    @property
    def home_altitude(self) -> float:
        return self.home.altitude if self.home is not None else 0.0

    @property
    def high_ground(self) -> float:
        """Highest possible ground, m, because height above ground is not measured."""
        return max(self.home_altitude, self.ground)

    @property
    def lowest_altitude(self) -> float:
        """The lowest height that automatic flight may fly to, m."""
        return min(self.home_altitude, self.ground) + MIN_HEIGHT_M

    def nearest(self, home: Home, position: Pair) -> Pair:
        """Return home, or a rally point that is nearer."""
        n, e = position
        positions = [(home.north, home.east), *((point.north, point.east) for point in self.rally)]
        return min(positions, key=lambda position: hypot(position[0] - n, position[1] - e))


class Course:
    """Target position, height and heading of automatic flight, and the :class:`Guide` that flies to them."""

    def __init__(self, parameters: Parameters, estimates: Estimator, landmarks: Landmarks, guide: Guide) -> None:
        self.parameters = parameters
        self.estimates = estimates
        self.landmarks = landmarks
        self.guide = guide
        self.reset()

    def reset(self) -> None:
        """Stop at the present position."""
        self.cruise: float | None = None  # m/s; None: as the parameter says
        self.descending = self.landing = self._is_pushed = False
        self.aim(None, None, None)
        self.guide.reset()

    def aim(self, position: Pair | None, height: float | None, heading: float | None) -> None:
        """Set the target; None: the position where the vehicle comes to rest, no height yet, the present heading."""
        self.position, self.height, self.heading = position, height, heading

    def begin(self, k: int, is_spinning: bool = False, is_pushed: bool = False) -> None:
        """Update the guide to step ``k``, before commands are computed.

        ``is_spinning``: no heading is held; ``is_pushed``: hinges may push the vehicle aside, so its own speed counts.
        """
        estimates = self.estimates
        self._is_pushed = is_pushed
        self.guide.begin(k, estimates.now, estimates.euler[2], estimates.fix, self._allowed_sink(), is_spinning)

    @property
    def speed(self) -> float:
        """The horizontal speed of automatic flight, m/s."""
        return self.cruise if self.cruise is not None else self.parameters["MPC_XY_VEL_MAX"]

    @property
    def stop_height(self) -> float:
        """Height [m] at which vertical motion would end now, not below the minimum."""
        measured = self.estimates.measured
        if measured is None:
            return 0.0
        stop = measured.altitude - measured.velocity[2] / max(self.parameters["HJ_ALT_P"], 0.1)
        if self.guide.holds_height:
            stop = self.guide.stop_height
        return max(stop, min(measured.altitude, self.landmarks.ground + MIN_HEIGHT_M))

    def distance_to(self, position: Pair) -> float:
        """Return the horizontal distance from the estimated to another position [m]."""
        n, e = self.estimates.fix.position
        return hypot(position[0] - n, position[1] - e)

    def plan_return(self, position: Pair, altitude: float) -> tuple[Pair, float, bool]:
        """Return the landing place, flight height and whether it is near, for a return from here."""
        landmarks = self.landmarks
        home = landmarks.home or Home(*position, landmarks.home_altitude)
        target = landmarks.nearest(home, position)
        # Distance from home [m] within which the vehicle lands without climbing or flying there.
        if hypot(target[0] - position[0], target[1] - position[1]) < 2.0:
            return target, altitude, True
        height = home.altitude + self.parameters["RTL_RETURN_ALT"]
        rally = (point.altitude for point in landmarks.rally if (point.north, point.east) == target)
        return target, max([altitude, height, *rally]), False

    def fly(self) -> Command:
        return self.fly_to(self.position, self.height, self.heading)

    def fly_to(self, position: Pair | None, altitude: float | None, yaw: float | None) -> Command:
        """Return the command to a position, height and heading; None: stop, stop climbing, keep the heading."""
        guide = self.guide
        lean = guide.towards(position, self.speed) if position is not None else guide.at_velocity((0.0, 0.0))
        height_setpoint = guide.at_climb(0.0) if altitude is None else self.to_height(altitude)
        return guide.command(lean, height_setpoint, guide.to_yaw(yaw))

    def to_height(self, altitude: float) -> float:
        """Return the height set-point [m] on the way to ``altitude`` [m]."""
        parameters = self.parameters
        height_setpoint = self.guide.to_height(altitude, parameters["HJ_CLIMB_AUTO"], parameters["HJ_DESC_AUTO"])
        # The set-point may be at or below the ground before the vehicle is there.
        self.descending = altitude < max(height_setpoint, self.landmarks.ground + LANDING_HEIGHT_M)
        return height_setpoint

    def descend(self, position: Pair | None = None) -> Command:
        self.landing = self.descending = True
        guide = self.guide
        lean = guide.towards(position, self.speed) if position else guide.at_velocity((0.0, 0.0))
        rate = min(self.parameters["HJ_DESC_AUTO"], self._sink_while_braking())
        return guide.command(lean, guide.at_climb(-rate), guide.to_yaw(self.heading))

    def _sink_while_braking(self) -> float:
        """Return the highest rate of descent [m/s] that does not touch down before the vehicle is at rest sideways.

        The set-point brakes for ``v / a + a / j``, and the vehicle follows it with ``1 / K_v``, twice that to be slow.
        A vehicle that was carried aside may be far from following: its own speed counts where it is the greater.
        """
        track, p = self.guide.track, self.parameters
        speed = 0.0 if track is None else hypot(*track.velocity)
        if self._is_pushed:
            speed = max(speed, hypot(*self.estimates.fix.velocity))
        if speed < MAX_ENTRY_M_S:
            return inf
        time = speed / p["HJ_ACC_HOR"] + p["HJ_ACC_HOR"] / p["HJ_JERK_HOR"] + 2.0 / max(p["HJ_VEL_P"], 0.1)
        return max(0.0, self.estimates.altitude - self.landmarks.high_ground) / time

    def _allowed_sink(self) -> float:
        """Return the highest rate of descent [m/s] at the estimated height, where the height is controlled."""
        p, limits, estimates = self.parameters, self.guide.limits, self.estimates
        above = estimates.altitude - 2.0 * estimates.altitude_deviation - self.landmarks.high_ground
        return descent_rate(above - p["HJ_LAND_SLOW_H"], limits.braking, limits.response_time, p["MPC_LAND_SPEED"])
