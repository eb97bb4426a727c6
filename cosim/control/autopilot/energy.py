"""Fuel or battery that remains, its consumption, and what the way down, or home and down, will take of it.

Fractions are of the full tank or battery, times are s.  The consumption is measured in the air, from the gauge;
before that it is that of the engines in hover, or what ``HJ_ENDURANCE`` says.  The way down is estimated for the
descent that will be flown: ``HJ_DESC_AUTO``, slower as the ground comes near, ``MPC_LAND_SPEED`` at the end, and never
faster than ``HJ_SPEED_DN``.
"""

from __future__ import annotations

from math import hypot, log

from cosim.base.protocols import Report
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.course import MAX_ENTRY_M_S, Course
from cosim.control.autopilot.guidance.descent import descent_rate
from cosim.control.autopilot.guidance.ground_speed import GroundSpeed


class Energy:
    """Remaining fuel or battery, and the energy that flights to positions need.

    ``hover``: the collective at which the vehicle hovers."""

    # Averaging time of the fuel flow [s], longer than climbs and gusts, and time in the air before the mean is used.
    mean_s, settling_s = 10.0, 5.0
    # Largest burn rate [1/s]: a fuel gauge that falls faster was reset, as no tank is emptied within 20 s.
    max_burn = 0.05
    # Time [s] from touchdown until the vehicle stands, or from spooling up until it climbs.
    end_s = 3.0

    def __init__(self, course: Course, ground_speed: GroundSpeed, hover: float, step: float) -> None:
        self._course, self._parameters, self._landmarks = course, course.parameters, course.landmarks
        self._estimates, self.ground_speed = course.estimates, ground_speed
        self._hover, self._step = hover, step
        self.hover_burn: float | None = None  # 1/s of a full tank, from the engines
        self.reset()

    def reset(self) -> None:
        """Start with a full tank and no measurement."""
        self.remaining: float | None = None
        self.name = "battery"
        self._spent = 0.0
        self._rate = self._weight = 0.0
        self.ground_speed.reset()

    def consume(self, report: Report, running: bool, flying: bool) -> None:
        """Update the remaining energy; ``running``: the engines run.

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
            rate = (before - self.remaining) / self._step
            if 0.0 <= rate <= self.max_burn:
                weight = self._step / self.mean_s
                self._rate += weight * (rate - self._rate)
                self._weight += weight * (1.0 - self._weight)

    @property
    def burn(self) -> float:
        """Fraction of the tank used per second in the air; 0: unknown."""
        if self._weight * self.mean_s > self.settling_s * (1.0 - 0.5 * self.settling_s / self.mean_s):
            return self._rate / self._weight
        endurance = self._parameters["HJ_ENDURANCE"]
        return self.hover_burn or (1.0 / endurance if endurance > 0.0 else 0.0)

    def descent_time(self, height: float) -> float:
        """Return the duration of a descent from a height [m] until standing."""
        p, limits = self._parameters, self._course.guide.limits
        fastest, slow = min(p["HJ_DESC_AUTO"], p["HJ_SPEED_DN"]), p["HJ_LAND_SLOW_H"]
        end = min(p["MPC_LAND_SPEED"], fastest)
        above = height - slow
        # Braking within h from speed v to e: h = (v - e) t + (v^2 - e^2) / 2a, so dt = dh / v = (t / v + 1 / a) dv.
        v = min(fastest, descent_rate(above, limits.braking, limits.response_time, end))
        braking = (v - end) * limits.response_time + (v * v - end * end) / (2.0 * limits.braking)
        steady = max(0.0, above - braking) / v
        slowing = limits.response_time * log(v / end) + (v - end) / limits.braking
        return limits.response_time + steady + slowing + max(0.0, min(height, slow)) / end + self.end_s

    def travel_time(self, distance: float, climb: float, speed: float | None = None) -> float:
        """Return the duration [s] of a flight over a distance and a height difference [m], flown at the same time.

        ``speed``: horizontal, m/s; None: that of automatic flight.
        """
        p = self._parameters
        up, down = min(p["HJ_CLIMB_AUTO"], p["HJ_SPEED_UP"]), min(p["HJ_DESC_AUTO"], p["HJ_SPEED_DN"])
        rate = up if climb > 0.0 else down
        level = self.ground_speed.travel_time(distance, speed or self._course.speed) if distance > 0.0 else 0.0
        return max(level, abs(climb) / rate)

    def climb_time(self, height: float) -> float:
        """Return the duration of a take-off from idle to a height."""
        return (
            self._parameters["HJ_SPOOL_TIME"]
            + self._course.guide.limits.response_time
            + self.travel_time(0.0, height)
            + self.end_s
        )

    def return_time(self, position: Pair, altitude: float) -> float:
        """Return the duration [s] of the return from rest at a position and an altitude, down to the ground."""
        target, height, near = self._course.plan_return(position, altitude)
        if near:
            return self.descent_time(altitude - self._lowest_ground)
        away = hypot(target[0] - position[0], target[1] - position[1])
        climb = self.travel_time(0.0, max(0.0, height - altitude)) + self._course.guide.limits.response_time
        level = self.travel_time(away, 0.0, self._parameters["MPC_XY_VEL_MAX"])
        return climb + level + self.descent_time(max(height, altitude) - self._lowest_ground)

    @property
    def _lowest_ground(self) -> float:
        """The lowest possible height of the ground, m."""
        landmarks = self._landmarks
        return min(landmarks.home_altitude, landmarks.ground)

    def needed_fractions(self) -> tuple[float, float]:
        """Return the fractions of a full tank needed for the return and for a landing here, without margins.

        The way home begins where the vehicle comes to rest.
        """
        altitude, burn = self._estimates.altitude, self.burn
        descent = self.descent_time(altitude - self._lowest_ground)
        if self._landmarks.home is None:
            return burn * descent, burn * descent
        position, seconds = self._stopping_point()
        return burn * (seconds + self.return_time(position, altitude)), burn * descent

    def _stopping_point(self) -> tuple[Pair, float]:
        """Return where and after how long [s] the vehicle comes to rest if it stops now."""
        p, fix = self._parameters, self._estimates.fix
        (north, east), (vn, ve), speed = fix.position, fix.velocity, hypot(*fix.velocity)
        if speed < MAX_ENTRY_M_S:
            return fix.position, 0.0
        braking, rounding = speed / p["HJ_ACC_HOR"], p["HJ_ACC_HOR"] / p["HJ_JERK_HOR"]
        seconds = braking + rounding
        return (north + 0.5 * seconds * vn, east + 0.5 * seconds * ve), seconds

    @property
    def margin(self) -> float:
        """Energy margin of the return, as a fraction of what it needs."""
        return self._parameters["HJ_FUEL_MARGIN"] / 100.0

    @property
    def floor(self) -> float:
        """Remaining fraction of a full tank at which the vehicle returns in any case."""
        return self._parameters["HJ_FUEL_LOW"] / 100.0

    def describe_shortage(self, seconds: float, position: Pair, altitude: float) -> str:
        """Return why energy does not suffice to fly for ``seconds`` to a position and then home, or an empty string."""
        if self.remaining is None or not self.burn:
            return ""
        need = self.burn * (seconds + (1.0 + self.margin) * self.return_time(position, altitude))
        if need <= self.remaining:
            return ""
        return (
            f"{self.name} for there and back with its margin: {100.0 * need:.0f} %, {100.0 * self.remaining:.0f} % left"
        )

    def describe_climb_shortage(self, altitude: float) -> str:
        """Return why energy does not suffice for a vertical take-off to an altitude [m]; empty: it does."""
        seconds = self.climb_time(altitude - self._estimates.altitude)
        return self.describe_shortage(seconds, self._estimates.fix.position, altitude)

    def describe_way_shortage(self, position: Pair, altitude: float) -> str:
        """Return why energy does not suffice for a flight from here to a position; empty: it does."""
        n, e = self._estimates.fix.position
        seconds = self.travel_time(hypot(position[0] - n, position[1] - e), altitude - self._estimates.altitude)
        return self.describe_shortage(seconds, position, altitude)
