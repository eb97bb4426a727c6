"""What is left of fuel or battery, how fast it goes, and what the way down, or home and down, will take of it.

Shares are of the full tank or battery, times are s.  How fast it goes is measured in the air, from the gauge;
before that it is what the engines take in hover, or what ``HJ_ENDURANCE`` says.  The way down is reckoned at the
descent that will be flown: ``HJ_DESC_AUTO``, slower as the ground comes near, ``MPC_LAND_SPEED`` at the end, and never
faster than ``HJ_SPEED_DN``.
"""

from __future__ import annotations

from math import hypot, log

from cosim.base.protocols import Report
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.course import Course
from cosim.control.autopilot.guidance.descent import descent_for
from cosim.control.autopilot.guidance.headway import Headway

# Chosen by us, with the reason.
_MEASURED_S = 10.0  # over so long the burn is measured: what climbs and gusts change in it is gone by then
_KNOWN_S = 5.0  # in the air before what was measured stands for the hover's
_MOST = 0.05  # 1/s: a gauge that falls faster has been read anew; no tank is emptied within 20 s
_END_S = 3.0  # from the ground's touch until it stands, or from spooling up until it climbs


class Energy:
    """The account of fuel or battery, and what ways take of it; ``hover``: the collective at which it hovers."""

    def __init__(self, course: Course, headway: Headway, hover: float, step: float) -> None:
        self._course, self._parameters, self._places = course, course.parameters, course.places
        self._estimates, self.headway = course.estimates, headway
        self._hover, self._step = hover, step
        self.hovering: float | None = None  # share in a second of hover, of a full tank, by the engines
        self.reset()

    def reset(self) -> None:
        """Full, and nothing measured."""
        self.remaining: float | None = None
        self.name = "battery"
        self._spent = 0.0
        self._rate = self._weight = 0.0
        self.headway.reset()

    def consume(self, report: Report, running: bool, flying: bool) -> None:
        """Keep the account, in the air and on the ground; ``running``: the engines fly.

        A battery is emptied by the fans' power, which grows as thrust to 3/2 (momentum theory), relative to hover.
        """
        endurance, before = self._parameters["HJ_ENDURANCE"], self.remaining
        if report.remaining is not None:
            self.remaining, self.name = report.remaining, "fuel"
        elif endurance > 0.0:
            if running:
                self._spent += self._step * max(0.0, report.collective / self._hover) ** 1.5
            self.remaining = max(0.0, 1.0 - self._spent / endurance)
        else:
            self.remaining = None
        if flying and before is not None and self.remaining is not None:
            self._measure((before - self.remaining) / self._step)

    def _measure(self, rate: float) -> None:
        """One step of the mean of the burn."""
        if 0.0 <= rate <= _MOST:
            share = self._step / _MEASURED_S
            self._rate += share * (rate - self._rate)
            self._weight += share * (1.0 - self._weight)

    @property
    def burn(self) -> float:
        """Share that goes in a second, in the air; 0: not known."""
        if self._weight * _MEASURED_S > _KNOWN_S * (1.0 - 0.5 * _KNOWN_S / _MEASURED_S):
            return self._rate / self._weight
        endurance = self._parameters["HJ_ENDURANCE"]
        return self.hovering or (1.0 / endurance if endurance > 0.0 else 0.0)

    # --- how long ways take ----------------------------------------------------------------------------------------

    def down(self, height: float) -> float:
        """How long the descent from a height [m] above the ground to standing there takes."""
        p, limits = self._parameters, self._course.guide.limits
        most, slow = min(p["HJ_DESC_AUTO"], p["HJ_SPEED_DN"]), p["HJ_LAND_SLOW_H"]
        end = min(p["MPC_LAND_SPEED"], most)
        above = height - slow
        # braking within the height h: h = (v - e) t + (v^2 - e^2) / 2a, so dt = dh / v = (t / v + 1 / a) dv
        v = min(most, descent_for(above, limits.braking, limits.late, end))
        braking = (v - end) * limits.late + (v * v - end * end) / (2.0 * limits.braking)
        steady = max(0.0, above - braking) / v
        slowing = limits.late * log(v / end) + (v - end) / limits.braking
        return limits.late + steady + slowing + max(0.0, min(height, slow)) / end + _END_S

    def along(self, distance: float, climb: float) -> float:
        """How long it takes to a place so far away and so much higher, m; place and height change together."""
        p = self._parameters
        up, down = min(p["HJ_CLIMB_AUTO"], p["HJ_SPEED_UP"]), min(p["HJ_DESC_AUTO"], p["HJ_SPEED_DN"])
        rate = up if climb > 0.0 else down
        level = self.headway.along(distance) if distance > 0.0 else 0.0
        return max(level, abs(climb) / rate)

    def climbing(self, height: float) -> float:
        """How long a take-off to a height takes, from idle on."""
        return self._parameters["HJ_SPOOL_TIME"] + self._course.guide.limits.late + self.along(0.0, height) + _END_S

    def home(self, place: Pair, altitude: float) -> float:
        """How long the return from a place and an altitude takes, down to the ground."""
        to, height, near = self._course.way_back(place, altitude)
        if near:
            return self.down(altitude - self._ground)
        away = hypot(to[0] - place[0], to[1] - place[1])
        climb = self.along(0.0, max(0.0, height - altitude)) + self._course.guide.limits.late
        return climb + self.along(away, 0.0) + self.down(max(height, altitude) - self._ground)

    @property
    def _ground(self) -> float:
        """How low the ground may be."""
        places = self._places
        return min(places.home_altitude, places.ground)

    # --- what they take of the tank --------------------------------------------------------------------------------

    def needs(self) -> tuple[float, float]:
        """Shares that the way home and down, and the way down alone, take from here, without a margin."""
        altitude, place = self._estimates.altitude, self._estimates.fix.position
        burn = self.burn
        down = self.down(altitude - self._ground)
        home = self.home(place, altitude) if self._places.home is not None else down
        return burn * home, burn * down

    @property
    def margin(self) -> float:
        """Of a way home, as a share of what it takes."""
        return self._parameters["HJ_FUEL_MARGIN"] / 100.0

    @property
    def least(self) -> float:
        """Share at which it returns whatever the way takes."""
        return self._parameters["HJ_FUEL_LOW"] / 100.0

    def short_of(self, seconds: float, place: Pair, altitude: float) -> str:
        """Why what is left does not do for a way of ``seconds`` to a place and home from there; empty: it does."""
        if self.remaining is None or not self.burn:
            return ""
        need = self.burn * (seconds + (1.0 + self.margin) * self.home(place, altitude))
        if need <= self.remaining:
            return ""
        return (
            f"{self.name} for there and back with its margin: {100.0 * need:.0f} %, {100.0 * self.remaining:.0f} % left"
        )

    def short_of_climb(self, altitude: float) -> str:
        """Return why the energy is short of a take-off from here straight up to an altitude [m]; empty: it is not."""
        seconds = self.climbing(altitude - self._estimates.altitude)
        return self.short_of(seconds, self._estimates.fix.position, altitude)

    def short_of_place(self, place: Pair, altitude: float) -> str:
        """Return why the energy is short of a way from here to a position [m]; empty: it is not."""
        n, e = self._estimates.fix.position
        seconds = self.along(hypot(place[0] - n, place[1] - e), altitude - self._estimates.altitude)
        return self.short_of(seconds, place, altitude)
