"""Flight ahead of a vehicle with a wing, from hover to its wing and back, in one law without modes.

What is asked for is a speed ahead; its set-point ``V_r`` goes there no faster than stated, and

    F_h = m (dV_r/dt + k (V_r - V) + integral),        F_v = what the height loop asks for

are the force along the heading and the one up that the vehicle needs.  The attitude asked for has the wing carry
``F_v`` where it can, ``theta = gamma + alpha`` with alpha that at which the wing's lift is ``F_v``, within a corridor
that opens with the speed.  Where ``F_v`` bends the path by ``(F_v / m - g) / V`` the attitude asked for leads by that
times what attitude and rates follow late, else alpha would be short by it; by a quarter of the most alpha at most.  At
that angle the wing gives lift L, drag D and a pitching moment M, by its own model at the speed of still air, and
allocation asks jets, hinges and surfaces for the rest,

    f = F_h + D cos(gamma) + L sin(gamma),    g = F_v - L cos(gamma) + D sin(gamma)    along the heading and up, that is
    f cos(theta) + g sin(theta)    ahead and    (g cos(theta) - f sin(theta)) / cos(phi)    up in body axes,

and the moment ``-M`` beside that of the rate loop: thrust turns ahead as the wing takes over and stands up again as it
leaves off.  It is the inversion of a known model that is closed by integrals (Stevens, Lewis and Johnson, "Aircraft
Control and Simulation", 3rd ed., 2016, section 5.8), applied to forces.  The model is asked at the angle that is
wanted, not at the one that is flown: else engines, which answer late, would run after every gust, and the wing's own
stability would be cancelled.  A bank works against drift to the side.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import atan2, cos, sin
from typing import Final, NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, heading_of, rotate, to_euler
from cosim.base.limits import clamp
from cosim.base.protocols import Column
from cosim.base.signals import Actuation, Command, Measured, Unallocated, Vector3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.altitude import MIN_UPRIGHT
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.spec.vehicle import WingControl

# Density at sea level [kg/m^3], standard atmosphere (ISO 2533), because there is no sensor for density.
DENSITY_0: Final = 1.225
# The nose leads by at most this fraction of the largest angle of attack. Chosen by us by flights in tailwind: missing
# lift raises the height loop's demand for good, which bends no path, and the nose would rise to a stall.
MAX_LEAD_FRACTION: Final = 0.25


def dynamic_pressure(measured: Measured) -> float:
    """Return the dynamic pressure [Pa] of the speed ahead over the ground, in still standard air; 0 backwards."""
    ahead = rotate(conjugate(measured.attitude), measured.velocity)[0]
    return 0.5 * DENSITY_0 * ahead * ahead if ahead > 0.0 else 0.0


def speeds(measured: Measured) -> tuple[float, float]:
    """Return the speeds over the ground [m/s] along the heading and to its right."""
    yaw = heading_of(measured.attitude)
    north, east, _ = measured.velocity
    return north * cos(yaw) + east * sin(yaw), east * cos(yaw) - north * sin(yaw)


class WingTable(NamedTuple):
    """Lift, drag [m^2] and pitching moment [m^3] per Pa of dynamic pressure, surfaces at zero, over a corridor."""

    alpha: tuple[float, ...]  # rad, ascending
    lift: tuple[float, ...]
    drag: tuple[float, ...]
    moment: tuple[float, ...]

    def at(self, alpha: float) -> tuple[float, float, float]:
        """Return lift, drag and moment at an angle of attack [rad]: linear between the rows, constant beyond them."""
        angles = self.alpha
        i = min(max(bisect_right(angles, alpha) - 1, 0), len(angles) - 2)
        fraction = min(max((alpha - angles[i]) / (angles[i + 1] - angles[i]), 0.0), 1.0)
        return (
            self.lift[i] + fraction * (self.lift[i + 1] - self.lift[i]),
            self.drag[i] + fraction * (self.drag[i + 1] - self.drag[i]),
            self.moment[i] + fraction * (self.moment[i + 1] - self.moment[i]),
        )

    def angle_for(self, area: float) -> float:
        """Return the angle of attack [rad] with this lift area [m^2], or the nearest; lift rises with the angle."""
        for i in range(len(self.alpha) - 1):
            low, high = self.lift[i], self.lift[i + 1]
            if area <= high:
                fraction = 0.0 if area <= low else (area - low) / (high - low)
                return self.alpha[i] + fraction * (self.alpha[i + 1] - self.alpha[i])
        return self.alpha[-1]


class WingDemand(NamedTuple):
    """The demand on jets, hinges and surfaces: N along body x and up, N m about y."""

    ahead: float
    lift: float
    pitch: float


class WingFlight(FlightLaw):
    """Flight law of forward flight, in which a wing carries more of the weight the faster the vehicle flies.

    ``table``: of the wing's model; ``tilts``: the servos that turn thrust ahead, from 0; ``lag``: of the attitude
    behind its set-point [s].
    """

    def __init__(
        self,
        loops: Loops,
        allocator: EffectivenessAllocator,
        settings: WingControl,
        table: WingTable,
        tilts: Sequence[int],
        mass: float,
        step: float,
        lag: float,
    ) -> None:
        super().__init__(loops)
        self._allocator = allocator
        self._table, self._mass, self._step, self._lag = table, mass, step, lag
        # Plain numbers: a step reads them faster than a model's fields.
        self._limits = (settings.acceleration_m_s2, settings.braking_m_s2)
        self._integral_gain, self._integral_limit = settings.integral_1_s2, settings.integral_limit_m_s2
        self._gain, self._open = settings.velocity_1_s, settings.open_m_s
        self._alpha_lag, self._alphas = settings.alpha_filter_s, settings.alpha_rad
        self._aside_gain, self._most_bank = settings.aside_1_s, settings.bank_rad
        self.tilts = list(tilts)
        self.reset()

    def reset(self) -> None:
        self.is_flying = False
        self._integral = 0.0
        self._setpoint = 0.0
        self._alpha = 0.0
        self._vertical = self._mass * GRAVITY
        self._missing_ahead = self._pressure = 0.0
        self._speed = self._acceleration = self._path = self._lift = 0.0

    def leave(self) -> None:
        self.is_flying = False
        self._lift = 0.0

    def applies(self, demand: Demand) -> bool:
        """Return whether a forward speed is commanded, and neither rates nor a collective."""
        command = demand.command
        return command.ahead is not None and command.rate is None and command.collective is None and not demand.is_idle

    def is_slow(self, demand: Demand, has_stopped: bool) -> bool:
        """Return whether the commanded and actual speed are below the speed of the full corridor.

        ``has_stopped``: it was so a step ago, and remains so for as long as no more speed is asked for.
        """
        ahead = demand.command.ahead
        if ahead is None or ahead >= self._open:
            return False
        return has_stopped or speeds(demand.measured)[0] < self._open

    def steer(self, demand: Demand) -> Vector3:
        """Return the body rate set-point [rad/s] towards the attitude that the wing needs for the speed."""
        if demand.command.ahead is not None:
            demand.command = self.attitude(demand.command, demand.command.ahead, demand.measured)
        return super().steer(demand)

    def update(self, demand: Demand) -> Actuation:
        """Update as :meth:`FlightLaw.update`, with a part of the force carried by the wing."""
        allocator, injected, measured = self._allocator, demand.injected, demand.measured
        if not allocator.surfaces:
            return super().update(demand)
        allocator.pressure = dynamic_pressure(measured)
        # The height loop's output as an upward force: undo its division by the cosine of the lean.
        remainder = self.actuator_demand(
            allocator.total_thrust(demand.collective) * demand.upright, measured, demand.burnt
        )
        (roll, pitch, yaw), (a, b, c) = self.loops.inject(demand.torque, injected), injected.torque_command
        torque = (roll + a, pitch + b, yaw + c)
        actuation, missing_ahead = allocator.allocate_forward(
            remainder.ahead, remainder.lift, remainder.pitch, torque, self.tilts
        )
        demand.unallocated = self.report_residual(missing_ahead, actuation.unallocated)
        demand.allocated = demand.collective - actuation.unallocated.collective
        return actuation

    def attitude(
        self,
        command: Command,
        speed_setpoint: float,
        measured: Measured,
        max_lead_m_s: float = 2.0,
        steepest_rad: float = 0.35,
        least_pressure: float = 1e-3,
    ) -> Command:
        """Return the command with the attitude for a speed ahead [m/s]; called once a step, before the loops.

        ``max_lead_m_s``: of the set-point over the speed, else at a limit it would run away; ``steepest_rad``: the path
        that pitch follows, well beyond the climb of the height loop; ``least_pressure``: less [Pa] carries nothing.
        """
        step, open_speed = self._step, self._open
        speeding, braking = self._limits
        speed, side_speed = speeds(measured)
        down = measured.velocity[2]
        if not self.is_flying:
            self.is_flying, self._integral, self._setpoint, self._alpha = True, 0.0, speed, 0.0
            self._missing_ahead = 0.0
        previous = self._setpoint
        speeds_up = speed_setpoint * previous >= 0.0 and abs(speed_setpoint) > abs(previous)
        limit = speeding if speeds_up else braking
        self._setpoint = speed + clamp(previous + clamp(speed_setpoint - previous, limit * step) - speed, max_lead_m_s)
        error = self._setpoint - speed
        if self._missing_ahead * error <= 0.0:
            integral = self._integral + self._integral_gain * step * error
            self._integral = clamp(integral, self._integral_limit)
        acceleration = clamp((self._setpoint - previous) / step, limit)
        self._acceleration = acceleration + self._gain * error + self._integral
        self._speed = speed
        opening = clamp(max(speed, 0.0) / open_speed, 1.0)
        self._pressure = 0.5 * DENSITY_0 * speed * speed
        alpha = opening * self._table.angle_for(self._vertical / max(self._pressure, least_pressure))
        self._alpha += step / (self._alpha_lag + step) * (alpha - self._alpha)
        self._path = path = opening * clamp(atan2(-down, max(speed, open_speed)), steepest_rad)
        # A path that bends turns the nose too, and attitude follows late. The angle of attack missing until then would
        # cost lift, at 25 m/s more than half of what the height loop commands.
        bend = opening * (self._vertical / self._mass - GRAVITY) / max(speed, open_speed)
        path += clamp(self._lag * bend, MAX_LEAD_FRACTION * self._alphas[1])
        roll, pitch, heading = command.attitude
        bank = clamp(self._aside_gain * side_speed / GRAVITY, self._most_bank)
        attitude = (roll - bank, pitch + path + self._alpha, heading)
        return Command(attitude, command.altitude, command.rate, command.collective, command.place, command.ahead)

    def actuator_demand(self, vertical: float, measured: Measured, burnt: float) -> WingDemand:
        """Return the demand on jets, hinges and surfaces for an upward force ``vertical`` [N], less the wing's."""
        roll, pitch, _ = to_euler(measured.attitude)
        lift, drag, moment = (self._pressure * coefficient for coefficient in self._table.at(self._alpha))
        self._lift = lift
        c, s = cos(self._path), sin(self._path)
        ahead = (self._mass - burnt) * self._acceleration + drag * c + lift * s
        up = vertical - lift * c + drag * s
        c, s = cos(pitch), sin(pitch)
        along = ahead * c + up * s
        self._vertical = vertical - max(0.0, along) * s  # the thrust of a raised nose adds lift
        return WingDemand(along, (up * c - ahead * s) / max(MIN_UPRIGHT, cos(roll)), -moment)

    def report_residual(self, ahead: float, unallocated: Unallocated, margin: float = 0.005) -> Unallocated:
        """Return the allocation residual for the loops' integrals, and store that of the forward force [N].

        Jets that cannot push down are no limit of the height loop while the wing can still lift less: as long as it
        stands by ``margin`` [rad] above its least angle of attack.
        """
        self._missing_ahead = ahead
        least = self._alphas[0]
        if unallocated.collective < 0.0 and self._alpha > least + margin:
            return Unallocated(unallocated.roll, unallocated.pitch, unallocated.yaw, 0.0)
        return unallocated

    @property
    def columns(self) -> tuple[Column, ...]:
        """Log columns; see :class:`cosim.base.protocols.Shows`."""
        return (
            Column("ahead_setpoint_m_s", "m/s", "heading", "speed ahead that the law for the wing flies to now"),
            Column("ahead_m_s", "m/s", "heading", "speed ahead over the ground, as measured"),
            Column("wing_alpha_rad", "rad", "body", "angle of attack commanded by the wing law"),
            Column("wing_lift_N", "N", "", "lift of the wing that the law counts on; 0: another law flies"),
        )

    @property
    def shown(self) -> tuple[float, ...]:
        """Values of :attr:`columns`."""
        return (self._setpoint, self._speed, self._alpha, self._lift)
