"""The speed that the vehicle reaches against the wind with the lean that it may have."""

from __future__ import annotations

from math import hypot, radians, sqrt, tan

from cosim.base.constants import GRAVITY
from cosim.control.autopilot.estimation.wind import drag_limited_speed, estimate_wind
from cosim.control.autopilot.geometry import Pair
from cosim.control.autopilot.guidance.course import Course
from cosim.control.autopilot.guidance.tracker import BRAKE_FRACTION
from cosim.control.phases.wing import DENSITY_0
from cosim.spec.vehicle import Vehicle


class GroundSpeed:
    """Speed over the ground and time of a flight to a position, against the estimated wind.

    ``catch_up`` is the most speed [m/s] for an error of position.

    The wind is estimated while the vehicle flies or hovers steadily, and taken to blow against it on every way.
    """

    # Averaging time of the wind [s]: longer than gusts, and longer than the estimate's delay.
    mean_s = 10.0
    # A speed is steady if its change is below this fraction of HJ_ACC_HOR and its error below this limit [m/s].
    max_acceleration, max_error_m_s = 0.2, 1.0
    # Least ground speed [m/s]: slower than this the way home takes longer than any tank lasts.
    least_speed = 0.1

    def __init__(self, course: Course, vehicle: Vehicle, catch_up: float, step: float) -> None:
        self._course, self._vehicle, self._parameters = course, vehicle, course.parameters
        self._catch_up, self._weight_step = catch_up, step / self.mean_s
        # In hover each jet is assumed to carry the same weight; the intake drag of its air is part of the drag.
        self._thrust = [vehicle.mass_kg * GRAVITY / len(vehicle.jets)] * len(vehicle.jets)
        self.reset()

    def reset(self) -> None:
        """Discard the estimated wind."""
        self._north = self._east = self._weight = 0.0

    def update_wind(self) -> None:
        """Update the mean wind by one step in which the vehicle follows a steady set-point."""
        track, estimates = self._course.guide.track, self._course.estimates
        if track is None or not estimates.has_position:
            return
        fix = estimates.fix
        velocity_error = hypot(track.velocity[0] - fix.velocity[0], track.velocity[1] - fix.velocity[1])
        fastest = self.max_acceleration * self._parameters["HJ_ACC_HOR"]
        if velocity_error > self.max_error_m_s or hypot(*track.acceleration) > fastest:
            return
        wind = estimate_wind(self._vehicle, fix.disturbance, fix.velocity, estimates.euler, self._thrust, DENSITY_0)
        if wind is not None:
            self._north += self._weight_step * (wind[0] - self._north)
            self._east += self._weight_step * (wind[1] - self._east)
            self._weight += self._weight_step * (1.0 - self._weight)

    @property
    def wind(self) -> Pair:
        """The mean of the estimated wind [m/s], north and east; 0 before the first estimate."""
        return (self._north / self._weight, self._east / self._weight) if self._weight else (0.0, 0.0)

    @property
    def max_speed(self) -> float:
        """Largest ground speed [m/s] against the wind at a lean of HJ_LEAN_MAX.

        Where drag is not known, or a wing bears, it is the speed that the vehicle's file states.
        """
        lean = GRAVITY * tan(radians(self._parameters["HJ_LEAN_MAX"]))
        air = drag_limited_speed(self._vehicle, lean, self._thrust, DENSITY_0)
        if air is None:
            return self._parameters.table["MPC_XY_VEL_MAX"].default
        return max(self.least_speed, air - hypot(*self.wind))

    @property
    def speed(self) -> float:
        """Ground speed [m/s] on a long leg: the commanded one, or the largest possible."""
        return min(self._course.speed, self.max_speed)

    def travel_time(self, distance: float, speed: float) -> float:
        """Return the duration [s] of a flight over a distance [m] at a commanded speed [m/s], from rest to rest.

        The set-point speeds up with a and brakes with 3/4 a.  While it is faster than the vehicle can be, it gets
        ahead; from when it brakes the vehicle closes in on it at no more than ``catch_up``.
        """
        p, greatest = self._parameters, self.max_speed
        # Distance, in units of v^2 / a, that speeding up to v and braking from it take.
        ramps = 0.5 + 0.5 / BRAKE_FRACTION
        a, catch_up = p["HJ_ACC_HOR"], min(self._catch_up, greatest)
        top = min(speed, sqrt(distance * a / ramps))
        set_point_time = distance / top + ramps * top / a + a / p["HJ_JERK_HOR"]
        excess_speed = max(0.0, top - greatest)
        lag = ramps * excess_speed * excess_speed / a + excess_speed * max(0.0, distance / top - ramps * top / a)
        remaining = max(0.0, lag - catch_up * greatest / (BRAKE_FRACTION * a))
        return set_point_time + remaining / catch_up + 2.0 / max(p["HJ_VEL_P"], 0.1) + 1.0 / max(p["HJ_POS_P"], 0.1)
