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
from cosim.base.frames import conjugate, rotate, to_euler
from cosim.base.limits import clamp
from cosim.base.protocols import Column
from cosim.base.signals import Actuation, Command, Measured, Unallocated, Vector3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.altitude import LEAST_UPRIGHT
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.spec.vehicle import WingControl

# kg/m^3, at sea level in the standard atmosphere (ISO 2533): what is known of the air without a sensor for it
DENSITY: Final = 1.225
AHEAD_M_S: Final = 2.0  # no further from the speed its set-point goes, which limits would leave behind; chosen by us
SLACK: Final = 0.005  # rad: nearer to the least angle of attack the wing is at its end
LEAST_PRESSURE: Final = 1e-3  # Pa: less than this carries nothing
# of the most angle of attack: no further does the nose lead; chosen by us, by flights in wind from behind: where lift
# is missing the height loop asks for more for good, which bends no path, and the nose would go up until the wing stalls
LEADING: Final = 0.25
STEEPEST: Final = 0.35  # rad, of the path that pitch follows; chosen by us, well beyond the climb of the height loop


def dynamic_pressure(measured: Measured) -> float:
    """Return Pa, of the speed ahead over the ground in still air of standard density; 0 backwards."""
    ahead = rotate(conjugate(measured.attitude), measured.velocity)[0]
    return 0.5 * DENSITY * ahead * ahead if ahead > 0.0 else 0.0


class WingTable(NamedTuple):
    """Lift, drag [m^2] and pitching moment [m^3] per Pa of dynamic pressure, surfaces at zero, over a corridor."""

    alpha: tuple[float, ...]  # rad, rising
    lift: tuple[float, ...]
    drag: tuple[float, ...]
    moment: tuple[float, ...]

    def at(self, alpha: float) -> tuple[float, float, float]:
        """Linear between the rows, held beyond them."""
        angles = self.alpha
        i = min(max(bisect_right(angles, alpha) - 1, 0), len(angles) - 2)
        share = min(max((alpha - angles[i]) / (angles[i + 1] - angles[i]), 0.0), 1.0)
        return (
            self.lift[i] + share * (self.lift[i + 1] - self.lift[i]),
            self.drag[i] + share * (self.drag[i + 1] - self.drag[i]),
            self.moment[i] + share * (self.moment[i + 1] - self.moment[i]),
        )

    def carrying(self, area: float) -> float:
        """Return the angle of attack [rad] with this lift area [m^2], or the nearest; lift rises with the angle."""
        for i in range(len(self.alpha) - 1):
            low, high = self.lift[i], self.lift[i + 1]
            if area <= high:
                share = 0.0 if area <= low else (area - low) / (high - low)
                return self.alpha[i] + share * (self.alpha[i + 1] - self.alpha[i])
        return self.alpha[-1]


class WingDemand(NamedTuple):
    """What jets, hinges and surfaces are to give: N along body x and up, N m about y."""

    ahead: float
    lift: float
    pitch: float


class WingFlight(FlightLaw):
    """Flight on the wing; see the module's text.

    ``table`` is the model's; ``tilts``: the servos that turn thrust ahead, from 0; ``late``: by how much the attitude
    follows its set-point late [s].
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
        late: float,
    ) -> None:
        super().__init__(loops)
        self._allocator = allocator
        self._settings, self._table, self._mass, self._step, self._late = settings, table, mass, step, late
        self.tilts = list(tilts)
        self.reset()

    def reset(self) -> None:
        """Nobody has asked for a speed yet."""
        self.flies = False
        self._integral = 0.0
        self._setpoint = 0.0
        self._alpha = 0.0
        self._vertical = self._mass * GRAVITY
        self._refused = self._pressure = 0.0
        self._speed = self._acceleration = self._path = self._lift = 0.0

    def leave(self) -> None:
        self.flies = False
        self._lift = 0.0

    def wants(self, step: Demand) -> bool:
        """Return whether a speed ahead is asked for, and neither rates nor a collective."""
        command = step.command
        return command.ahead is not None and command.rate is None and command.collective is None and not step.idle

    def steer(self, step: Demand) -> Vector3:
        """Return rates to the attitude that the wing needs for the speed."""
        if step.command.ahead is not None:
            step.command = self.attitude(step.command, step.command.ahead, step.measured)
        return super().steer(step)

    def update(self, step: Demand) -> Actuation:
        """As :meth:`FlightLaw.update`, forces along and up of which the wing carries its part."""
        allocator, injected, measured = self._allocator, step.injected, step.measured
        if not allocator.surfaces:
            return super().update(step)
        allocator.pressure = dynamic_pressure(measured)
        # of the height loop as a force up: it divides by how upright the thrust stands, which here is turned as wanted
        demand = self.demand(allocator.force(step.collective) * step.upright, measured, step.burnt)
        (roll, pitch, yaw), (a, b, c) = self.loops.inject(step.torque, injected), injected.torque_command
        asked = (roll + a, pitch + b, yaw + c)
        given, missing = allocator.ahead(demand.ahead, demand.lift, demand.pitch, asked, self.tilts)
        step.unallocated = self.refused(missing, given.unallocated)
        step.given = step.collective - given.unallocated.collective
        return given

    def attitude(self, command: Command, asked: float, measured: Measured) -> Command:
        """Return the command with the attitude for a speed ahead of ``asked`` m/s; once a step, before the loops."""
        settings, step = self._settings, self._step
        _, _, yaw = to_euler(measured.attitude)
        north, east, down = measured.velocity
        speed = north * cos(yaw) + east * sin(yaw)
        aside = east * cos(yaw) - north * sin(yaw)
        if not self.flies:
            self.flies, self._integral, self._setpoint, self._alpha = True, 0.0, speed, 0.0
            self._refused = 0.0
        before = self._setpoint
        faster = asked * before >= 0.0 and abs(asked) > abs(before)
        most = settings.acceleration_m_s2 if faster else settings.braking_m_s2
        self._setpoint = speed + clamp(before + clamp(asked - before, most * step) - speed, AHEAD_M_S)
        error = self._setpoint - speed
        if self._refused * error <= 0.0:
            integral = self._integral + settings.integral_1_s2 * step * error
            self._integral = clamp(integral, settings.integral_limit_m_s2)
        planned = clamp((self._setpoint - before) / step, most)
        self._acceleration = planned + settings.velocity_1_s * error + self._integral
        self._speed = speed
        opened = clamp(max(speed, 0.0) / settings.open_m_s, 1.0)
        self._pressure = 0.5 * DENSITY * speed * speed
        alpha = opened * self._table.carrying(self._vertical / max(self._pressure, LEAST_PRESSURE))
        self._alpha += step / (settings.alpha_filter_s + step) * (alpha - self._alpha)
        self._path = path = opened * clamp(atan2(-down, max(speed, settings.open_m_s)), STEEPEST)
        # what bends the path turns the nose as well, and the attitude follows late: what is lost of alpha till then
        # would be lost of the lift, more than half of what the height loop asks for at 25 m/s
        bend = opened * (self._vertical / self._mass - GRAVITY) / max(speed, settings.open_m_s)
        path += clamp(self._late * bend, LEADING * settings.alpha_rad[1])
        roll, pitch, heading = command.attitude
        bank = clamp(settings.aside_1_s * aside / GRAVITY, settings.bank_rad)
        return command._replace(attitude=(roll - bank, pitch + path + self._alpha, heading))

    def demand(self, vertical: float, measured: Measured, burnt: float) -> WingDemand:
        """Return what is left for jets, hinges and surfaces where ``vertical`` N are needed up."""
        roll, pitch, _ = to_euler(measured.attitude)
        lift, drag, moment = (self._pressure * coefficient for coefficient in self._table.at(self._alpha))
        self._lift = lift
        c, s = cos(self._path), sin(self._path)
        ahead = (self._mass - burnt) * self._acceleration + drag * c + lift * s
        up = vertical - lift * c + drag * s
        c, s = cos(pitch), sin(pitch)
        along = ahead * c + up * s
        self._vertical = vertical - max(0.0, along) * s  # thrust along the body lifts where the nose is up
        return WingDemand(along, (up * c - ahead * s) / max(LEAST_UPRIGHT, cos(roll)), -moment)

    def refused(self, ahead: float, others: Unallocated) -> Unallocated:
        """Return the allocation residual as the loops are to know it, and keep that of the force ahead [N].

        Jets that cannot push down are no limit of the height loop while the wing can still lift less.
        """
        self._refused = ahead
        least = self._settings.alpha_rad[0]
        return others._replace(collective=0.0) if others.collective < 0.0 and self._alpha > least + SLACK else others

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is shown; see :class:`cosim.base.protocols.Shows`."""
        return (
            Column("ahead_setpoint_m_s", "m/s", "heading", "speed ahead that the law for the wing flies to now"),
            Column("ahead_m_s", "m/s", "heading", "speed ahead over the ground, as measured"),
            Column("wing_alpha_rad", "rad", "body", "angle of attack that the law for the wing asks for"),
            Column("wing_lift_N", "N", "", "lift of the wing that the law counts on; 0: another law flies"),
        )

    @property
    def shown(self) -> tuple[float, ...]:
        """See :attr:`columns`."""
        return (self._setpoint, self._speed, self._alpha, self._lift)
