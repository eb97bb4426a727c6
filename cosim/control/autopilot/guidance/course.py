"""Where the vehicle flies to or stays, and the commands that bring it there."""

from __future__ import annotations

from math import hypot, inf

from cosim.base.signals import Command
from cosim.control.autopilot.estimation.estimates import Estimates
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.descent import descent_for
from cosim.control.autopilot.guidance.guide import Guide
from cosim.control.autopilot.modes import Home
from cosim.control.autopilot.parameters import Parameters
from cosim.control.autopilot.requests import RallyPoint

# Chosen by us, with the reason.
LOWEST_M = 1.0  # above the ground: nothing flies there by itself, and a stop ends no lower
REACHED_M = 0.4  # of height; a take-off or climb is over, or a waypoint's height is reached
ABOVE_M = 0.7  # from home and slower than 0.5 m/s: the descent begins
SLOW = 0.5  # m/s
_NEAR_M = 2.0  # from home: no climb and no flight is needed to land there


class Places:
    """The places that the vehicle knows: home, rally points, and the ground where it last took off."""

    def __init__(self) -> None:
        self.rally: tuple[RallyPoint, ...] = ()  # they stay from flight to flight
        self.reset(0.0)

    def reset(self, ground: float) -> None:
        """No home yet, standing at the height ``ground`` [m]."""
        self.home: Home | None = None
        self.home_given = False  # by a request
        self.ground = ground  # height on its legs where it last took off
        self.left: Pair | None = None  # where that was

    @property
    def home_altitude(self) -> float:
        return self.home.altitude if self.home is not None else 0.0

    @property
    def high_ground(self) -> float:
        """Where the ground may be: there is no sensor for the height above it."""
        return max(self.home_altitude, self.ground)

    @property
    def lowest(self) -> float:
        """The least height that may be flown to by itself."""
        return min(self.home_altitude, self.ground) + LOWEST_M

    def nearest(self, home: Home, place: Pair) -> Pair:
        """Home, or the rally point that is nearer."""
        n, e = place
        places = [(home.north, home.east), *((point.north, point.east) for point in self.rally)]
        return min(places, key=lambda place: hypot(place[0] - n, place[1] - e))


class Course:
    """The place, height and heading that it flies to or keeps, and the law that does it: one :class:`Guide`."""

    def __init__(self, parameters: Parameters, estimates: Estimates, places: Places, guide: Guide) -> None:
        self.parameters = parameters
        self.estimates = estimates
        self.places = places
        self.guide = guide
        self.reset()

    def reset(self) -> None:
        """Stop where the vehicle is."""
        self.cruise: float | None = None  # horizontal speed that was asked for, m/s; None: the parameter's
        self.descending = self.landing = self._carried = False
        self.aim(None, None, None)
        self.guide.reset()

    def aim(self, place: Pair | None, height: float | None, heading: float | None) -> None:
        """``place``: None, where it comes to rest; ``height``: None, not known yet; ``heading``: None, as it is."""
        self.place, self.height, self.heading = place, height, heading

    def begin(self, k: int, spins: bool = False, carried: bool = False) -> None:
        """Set the instant for the commands that follow.

        ``spins``: no heading is held; ``carried``: hinges may carry it aside, so that its own speed counts.
        """
        estimates = self.estimates
        self._carried = carried
        self.guide.begin(k, estimates.now, estimates.euler[2], estimates.fix, self._sink_allowed(), spins)

    @property
    def speed(self) -> float:
        """The horizontal speed of automatic flight, m/s."""
        return self.cruise if self.cruise is not None else self.parameters["MPC_XY_VEL_MAX"]

    @property
    def stop_height(self) -> float:
        """Where it comes to rest if climbing or sinking ends now: not nearer to the ground than it must."""
        measured = self.estimates.measured
        if measured is None:
            return 0.0
        stop = measured.altitude - measured.velocity[2] / max(self.parameters["HJ_ALT_P"], 0.1)
        if self.guide.holds_height:
            stop = self.guide.rest
        return max(stop, min(measured.altitude, self.places.ground + LOWEST_M))

    def away(self, place: Pair) -> float:
        """Distance of a place, m."""
        n, e = self.estimates.fix.position
        return hypot(place[0] - n, place[1] - e)

    def way_back(self, place: Pair, altitude: float) -> tuple[Pair, float, bool]:
        """Where the return from a place at an altitude lands, the height to fly there at, and whether it is there."""
        places = self.places
        home = places.home or Home(*place, places.home_altitude)
        to = places.nearest(home, place)
        if hypot(to[0] - place[0], to[1] - place[1]) < _NEAR_M:
            return to, altitude, True
        height = home.altitude + self.parameters["RTL_RETURN_ALT"]
        return to, max([altitude, height, *(p.altitude for p in places.rally if (p.north, p.east) == to)]), False

    def fly(self) -> Command:
        """To where it is aimed."""
        return self.to(self.place, self.height, self.heading)

    def to(self, place: Pair | None, altitude: float | None, yaw: float | None) -> Command:
        """To a place (None: stop) at a height (None: where climbing or sinking stops), with a heading (None: as is)."""
        guide = self.guide
        lean = guide.towards(place, self.speed) if place is not None else guide.at_velocity((0.0, 0.0))
        held = guide.at_climb(0.0) if altitude is None else self.to_height(altitude)
        return guide.command(lean, held, guide.to_yaw(yaw))

    def to_height(self, altitude: float) -> float:
        """Return the height set-point [m] on the way to ``altitude`` [m]."""
        parameters = self.parameters
        held = self.guide.to_height(altitude, parameters["HJ_CLIMB_AUTO"], parameters["HJ_DESC_AUTO"])
        self.descending = altitude < held
        return held

    def descend(self, place: Pair | None = None) -> Command:
        """Down to the ground where it is, or at ``place``."""
        self.landing = self.descending = True
        guide = self.guide
        lean = guide.towards(place, self.speed) if place else guide.at_velocity((0.0, 0.0))
        rate = min(self.parameters["HJ_DESC_AUTO"], self._sink_while_braking())
        return guide.command(lean, guide.at_climb(-rate), guide.to_yaw(self.heading))

    def _sink_while_braking(self) -> float:
        """Return the highest rate of descent [m/s] that does not touch down before the vehicle is at rest sideways.

        The set-point brakes for ``v / a + a / j``, and the vehicle follows it with ``1 / K_v``, twice that to be slow.
        A vehicle that was carried aside may be far from following: its own speed counts where it is the greater.
        """
        track, p = self.guide.track, self.parameters
        speed = 0.0 if track is None else hypot(*track.velocity)
        if self._carried:
            speed = max(speed, hypot(*self.estimates.fix.velocity))
        if speed < SLOW:
            return inf
        left = speed / p["HJ_ACC_HOR"] + p["HJ_ACC_HOR"] / p["HJ_JERK_HOR"] + 2.0 / max(p["HJ_VEL_P"], 0.1)
        return max(0.0, self.estimates.altitude - self.places.high_ground) / left

    def _sink_allowed(self) -> float:
        """Return the highest rate of descent [m/s] at the estimated height, where the height is controlled."""
        p, limits, estimates = self.parameters, self.guide.limits, self.estimates
        above = estimates.altitude - 2.0 * estimates.altitude_deviation - self.places.high_ground
        return descent_for(above - p["HJ_LAND_SLOW_H"], limits.braking, limits.late, p["MPC_LAND_SPEED"])
