"""Recovery of a vehicle that has lost engines: roll and height by feedback of the states of its slow engines.

With two of its engines gone the others have to speed up by half, which takes a jet a second, and in that second it
rolls and falls.  The leads of :mod:`cosim.control.lead` answer for a slow engine by what it was asked for; the
jump of a new plan, and most of what it cannot follow, they do not know.  Here the state of the engines is what they
report, and is fed back with that of the vehicle.  Roll moment ``M`` and lift ``F`` follow what is asked for
as the identified engine does, behind its delay ``d``:

    M'' = w^2 (M_c - M) - 2 zeta w M',   J p' = M,   phi' = p;     F'' likewise,   m v' = F cos(lean) - m g

Both are predicted over ``d``, with what was asked for meanwhile, and from there on all poles are equal:

    (s + a)^4 phi = 0,   a = 4 / (t_r + d);     (s + b)^3 (v - v_c) = 0,   b = 3 / (t_h + d)

``v_c`` is the climb rate that the altitude loop asks for.  Allocation keeps roll before lift, so lift has all that is
left, and at first that is everything.  Engines that are told to slow down by more than they can are all alike,
whatever is asked of them, and leave no roll: so lift never asks for less than a fraction of what they give.
"""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.constants import GRAVITY
from cosim.base.signals import PerJet
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.spec.vehicle import EngineLead, Vehicle


class _EngineResponse:
    """Response of the engines' total moment or lift to its command, predicted over their delay.

    ``slope_s``: time constant of the reports' slope, short against any jet.
    """

    def __init__(self, natural: float, damping: float, delay: int, step: float, slope_s: float = 0.02) -> None:
        self._square, self._twice = natural * natural, 2.0 * damping * natural
        self._delay, self._step = delay, step
        self._weight = step / (slope_s + step)
        self.reset(0.0, 0.0)

    def reset(self, value: float, command: float) -> None:
        """Start from the constant output ``value`` and the constant command ``command``."""
        self._value, self._slope = value, 0.0
        self._commands = [command] * self._delay
        self.predicted, self.slope = value, 0.0

    def observe(self, value: float) -> None:
        """Store the output that the engines report at the end of a step."""
        self._slope += self._weight * ((value - self._value) / self._step - self._slope)
        self._value = value

    def predict(self) -> list[float]:
        """Return the predicted outputs over the delay, and store the last output and its slope."""
        step, x, slope = self._step, self._value, self._slope
        course = []
        for command in self._commands:
            course.append(x)
            x, slope = x + step * slope, slope + step * (self._square * (command - x) - self._twice * slope)
        self.predicted, self.slope = x, slope
        return course

    def command_for(self, second_derivative: float) -> float:
        """Return the command that gives this second derivative when it takes effect."""
        return self.predicted + (self._twice * self.slope + second_derivative) / self._square

    def record_command(self, value: float) -> None:
        if self._delay:
            self._commands.append(value)
            del self._commands[0]


class Recovery:
    """Roll and collective control after an engine loss, until reallocation has taken effect.

    ``delay``: of the engines [s].  ``level_s`` and ``climb_s`` [s]: behind the delay until it is level, and until it
    climbs as asked for, sums of the time constants; shorter, and jets at their limits roll it over; longer, and the
    lean takes it aside faster than it may touch.
    Raises ValueError where the lead is of another form than the engine stated above.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        thrust_map: ThrustMap,
        lead: EngineLead,
        delay: float,
        step: float,
        level_s: float = 1.15,
        climb_s: float = 0.9,
    ) -> None:
        if lead.damping is None:
            raise ValueError("the catch needs an engine of second order")
        steps = round(delay / step)
        self._roll = _EngineResponse(lead.natural_rad_s, lead.damping, steps, step)
        self._lift = _EngineResponse(lead.natural_rad_s, lead.damping, steps, step)
        self._levers = tuple([-jet.position_m[1] for jet in vehicle.jets])
        self._inertia = vehicle.inertia_kg_m2[0]
        self._low = thrust_map.low * len(self._levers)
        self._span = thrust_map.span * len(self._levers)  # lift per unit of collective, N
        total_lever = 0.0
        for lever in self._levers:
            total_lever += lever if lever >= 0.0 else -lever
        self._moment = thrust_map.span * total_lever  # moment per unit of roll command, N m
        self._step = step
        self._a, self._b = 4.0 / (level_s + steps * step), 3.0 / (climb_s + steps * step)
        self.is_complete = False

    def reset(self, thrust: PerJet, gains: Sequence[float], weight: float) -> None:
        """Begin at a loss: ``gains`` of failed engines are 0, ``weight`` is the lift demanded so far [N].

        ``thrust`` is as for :meth:`observe`.
        """
        self._roll.reset(self._moment_of(thrust), 0.0)
        self._lift.reset(self._lift_of(thrust, gains), weight)
        self.is_complete = False

    def observe(self, thrust: PerJet, gains: Sequence[float]) -> None:
        """Store each engine's thrust [N] from its report at the end of a step."""
        self._roll.observe(self._moment_of(thrust))
        self._lift.observe(self._lift_of(thrust, gains))

    def _moment_of(self, thrust: PerJet) -> float:
        """Return the roll moment [N m], including the failing engines' remaining thrust.

        It is less than their speed stands for, as they have no fire; how much less is not known.
        """
        moment = 0.0
        for i, lever in enumerate(self._levers):
            moment += lever * thrust[i]
        return moment

    def _lift_of(self, thrust: PerJet, gains: Sequence[float]) -> float:
        """Return the lift [N] without that of lost engines."""
        lift = 0.0
        for i, gain in enumerate(gains):
            lift += thrust[i] if gain > 0.0 else 0.0
        return lift

    def update(
        self, lean: float, rate: float, climb: float, climb_setpoint: float, upright: float, mass: float
    ) -> tuple[float, float]:
        """Return the roll command and the collective.

        ``lean``: about the roll axis, from its set-point [rad]; ``rate``: of roll [rad/s]; ``climb`` and
        ``climb_setpoint`` [m/s]; ``upright``: cosine of the lean; ``mass`` [kg].
        """
        step, inertia, roll, lift = self._step, self._inertia, self._roll, self._lift
        climb_error = climb - climb_setpoint
        balance = mass * GRAVITY / upright
        # The normal loops take over within 0.3 m/s of climb, 6 deg of lean, 0.15 rad/s and 3 % of lift: they were
        # designed for smaller deviations.
        self.is_complete = (
            -0.3 < climb_error < 0.3
            and upright > 0.995
            and -0.15 < rate < 0.15
            and -0.03 * balance < lift.predicted - balance < 0.03 * balance
        )
        for moment, force in zip(roll.predict(), lift.predict(), strict=True):
            lean += step * rate
            rate += step * moment / inertia
            climb_error += step * (force * upright / mass - GRAVITY)
        a, b = self._a, self._b
        moment = roll.command_for(
            -(4.0 * a * roll.slope + 6.0 * a * a * roll.predicted + inertia * (4.0 * a**3 * rate + a**4 * lean))
        )
        force = lift.command_for(
            -(3.0 * b * lift.slope + 3.0 * b * b * (lift.predicted - balance) + b**3 * mass * climb_error / upright)
        )
        return moment / self._moment, max(self.least_collective, (force - self._low) / self._span)

    @property
    def least_collective(self) -> float:
        """Smallest collective that leaves room for roll: 0.7 of the available thrust.

        turbine-100 slows no faster for a step down by more than eight tenths, and roll has to find it slower on one
        side than on the other.
        """
        return (0.7 * self._lift.predicted - self._low) / self._span

    def record_command(self, roll: float, collective: float) -> None:
        """Store the commands that were allocated."""
        self._roll.record_command(self._moment * roll)
        self._lift.record_command(self._low + self._span * collective)
