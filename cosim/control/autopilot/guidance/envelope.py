"""Limits of commands to what the vehicle can follow: attitude and rates, the height, and a fall."""

from __future__ import annotations

from math import radians

from cosim.base.frames import upright
from cosim.base.limits import clip
from cosim.base.signals import AXES, Command
from cosim.control.autopilot.estimation.estimator import Estimator
from cosim.control.autopilot.guidance.descent import CollectiveFloor, HeightLimits, height_limits, thrust_margins
from cosim.control.autopilot.guidance.guide import Guide
from cosim.control.autopilot.guidance.shaper import AttitudeLimits, Shaper, angular_authority, attitude_limits
from cosim.control.autopilot.parameters import Parameters
from cosim.spec.vehicle import Vehicle

_ATTITUDE_PARAMETERS = ("HJ_ATT_", "HJ_RLIM_", "HJ_STICK_LEAN", "HJ_YAW_RATE")  # parameters that set attitude limits
_HEIGHT_PARAMETERS = ("HJ_ALT_P", "HJ_CLIMB_P", "HJ_CLIMB_AUTO", "HJ_DESC_AUTO")  # parameters that set height limits


class Envelope:
    """Limits commands to those that the vehicle can follow.

    Every command passes a :class:`Shaper`; a collective by stick or set-point passes a :class:`CollectiveFloor`.

    ``hover``: the collective at which the vehicle hovers; ``idle``: thrust of an engine without throttle, as a fraction
    of what full throttle adds to it; ``answer``: delay and lag [s] with which the thrust answers, about hover and the
    longest.
    """

    # Climb rate [m/s] that counts as rest: the altitude loop answers it with 1/50 of the weight, 1/100 of throttle.
    max_rest_climb = 0.25
    # Difference of throttle from hover that a pilot meets by hand; a step of this size tips no vehicle.
    near_hover = 0.1

    def __init__(
        self,
        vehicle: Vehicle,
        hover: float,
        idle: float,
        answer: tuple[float, float],
        parameters: Parameters,
        estimates: Estimator,
        step: float,
    ) -> None:
        limits = vehicle.control.allocation
        self._vehicle, self._hover, self._idle = vehicle, hover, idle
        self._least, self._most = limits.throttle_min, limits.throttle_max
        self._parameters = parameters
        self._estimates = estimates
        self.shaper = Shaper(self.attitude_limits(), step)
        self.floor = CollectiveFloor(hover, idle, self._least, self._most, *answer, step)

    def reset(self, airborne: bool) -> None:
        """Start without a command."""
        self.shaper.reset()
        self.restart_at(self._hover if airborne else self._least)

    def restart_at(self, collective: float) -> None:
        """Restart at the collective of the height control, when that ends."""
        self.floor.restart_at(collective)
        self._is_by_stick = self._is_braking = False

    def attitude_limits(self) -> AttitudeLimits:
        """Return the attitude and rate limits that the loops can follow with the present gains."""
        p = self._parameters
        gain = [p[f"HJ_ATT_{axis.upper()}"] for axis in AXES]
        most = [radians(p[f"HJ_RLIM_{axis.upper()}"]) for axis in AXES]
        authority = angular_authority(self._vehicle, self._hover, self._idle, gain)
        return attitude_limits(gain, authority, radians(p["HJ_STICK_LEAN"]), radians(p["HJ_YAW_RATE"]), most)

    def height_limits(self) -> HeightLimits:
        """Return the limits of the height set-point's motion with the present gains."""
        p = self._parameters
        speed = max(p["HJ_CLIMB_AUTO"], p["HJ_DESC_AUTO"])
        margins = thrust_margins(self._hover, self._idle, self._least, self._most)
        return height_limits(p["HJ_ALT_P"], p["HJ_CLIMB_P"], speed, *margins)

    def update_limits(self, name: str, guide: Guide) -> None:
        """Recompute the limits that depend on a changed parameter."""
        if name.startswith(_ATTITUDE_PARAMETERS):
            self.shaper.limit(self.attitude_limits())
        if name in _HEIGHT_PARAMETERS:
            guide.limit(self.height_limits())

    def shape(self, command: Command) -> Command:
        """Return the command with an attitude, or body rates, that the loops can follow."""
        euler = self._estimates.euler
        if command.rate is not None:
            return command._replace(rate=self.shaper.rate(command.rate, euler))
        return command._replace(attitude=self.shaper.attitude(command.attitude, euler))

    def limit_fall(self, collective: float, ground: float, remaining: float | None) -> float:
        """Return the requested collective, or the larger one that avoids the ground at the height ``ground`` [m].

        ``remaining``: fraction of the fuel; None: the vehicle has none, or it is not known.
        """
        self._is_by_stick, self._is_braking = True, False
        return self._apply_floor(collective, ground, remaining)

    def slow_down(self, ground: float, remaining: float | None) -> float | None:
        """Return the collective that brings a fast climb or fall to rest before the height loop takes over.

        A pilot's throttle may have led there, or stand far from that of hover.  The loop itself would answer with the
        least or the most throttle at once: turbines that are all at idle take seconds to come back, and until then
        nothing keeps the vehicle level; engines that are not alike pitch it on their way.  So half of the thrust's
        margin ends a climb, and no collective moves faster than :class:`CollectiveFloor` lets it.

        None: the loop has it, which it keeps until a collective has been commanded again.
        """
        if not (self._is_by_stick or self._is_braking):
            return None
        p, climb, lean = self._parameters, -self._estimates.now.velocity[2], upright(self._estimates.now.attitude)
        weight = self._weight_fraction(remaining)
        wanted = self.floor.collective_for(-p["HJ_CLIMB_P"] * climb, lean, weight)
        given = self._apply_floor(wanted, ground, remaining)
        if self._is_by_stick:
            is_fast = abs(climb - clip(climb, -p["HJ_SPEED_DN"], p["HJ_SPEED_UP"])) > self.max_rest_climb
            is_far = abs(given - self.floor.collective_for(0.0, lean, weight)) > self.near_hover
            self._is_by_stick, self._is_braking = False, is_fast or is_far
        else:
            self._is_braking = abs(climb) > self.max_rest_climb or given != wanted
        return given if self._is_braking else None

    def _apply_floor(self, collective: float, ground: float, remaining: float | None) -> float:
        measured = self._estimates.now
        return self.floor.apply(
            collective,
            measured.altitude - ground,
            measured.velocity[2],
            self._parameters["MPC_LAND_SPEED"],
            upright(measured.attitude),
            self._weight_fraction(remaining),
        )

    def _weight_fraction(self, remaining: float | None) -> float:
        """Return the weight as a fraction of that at the start."""
        fuel = self._vehicle.fuel
        if fuel is None or remaining is None:
            return 1.0
        return 1.0 - fuel.mass_kg * (1.0 - remaining) / self._vehicle.mass_kg
