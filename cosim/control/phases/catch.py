"""Catching a vehicle that has lost engines: roll and height from one account of what slow engines will still do.

With two of its engines gone the others have to speed up by half, which takes a jet a second, and in that second it
rolls and falls.  The leads of :mod:`cosim.control.lead` answer for a slow engine by what it was asked for; what a new
plan asks of it all at once, and most of what it cannot follow, they do not know.  Here the state of the engines is
what they report, and is fed back with that of the vehicle.  Roll moment ``M`` and lift ``F`` follow what is asked for
as the identified engine does, behind its delay ``d``:

    M'' = w^2 (M_c - M) - 2 zeta w M',   J p' = M,   phi' = p;     F'' likewise,   m v' = F cos(lean) - m g

Both are looked at ``d`` ahead, with what was asked for meanwhile, and from there on all poles stand in one place:

    (s + a)^4 phi = 0,   a = 4 / (t_r + d);     (s + b)^3 (v - v_c) = 0,   b = 3 / (t_h + d)

``v_c`` is the climb rate that the altitude loop asks for.  Allocation keeps roll before lift, so lift has all that is
left, and at first that is everything.  Engines that are told to slow down by more than they can are all alike,
whatever is asked of them, and leave no roll: so lift never asks for less than a share of what they give.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cosim.base.constants import GRAVITY
from cosim.base.signals import PerJet
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.spec.vehicle import EngineLead, Vehicle

# s behind the delay until it is level, and until it climbs as asked for: sums of the time constants.  Chosen by us:
# shorter, and jets at their limits roll it over; longer, and the lean takes it aside faster than it may touch
_LEVEL_S: Final = 1.15
_CAUGHT_S: Final = 0.9
_SLOPE_S: Final = 0.02  # time constant of the reports' slope; chosen by us: short against any jet
# of what the engines give, the least that lift asks for; chosen by us: turbine-100 slows no faster for a step down by
# more than eight tenths, and roll has to find it slower on one side than on the other
_LEAST_LIFT: Final = 0.7
# caught, and the usual loops' again; chosen by us: they were designed for less than this
_CLIMB: Final = 0.3  # m/s off
_UPRIGHT: Final = 0.995  # cosine of the lean: 6 deg
_ROLL: Final = 0.15  # rad/s
_LIFT: Final = 0.03  # of the weight, between lift and weight


class _Answer:
    """What the engines give of one quantity, and will when what they were told has reached them."""

    def __init__(self, natural: float, damping: float, delay: int, step: float) -> None:
        self._square, self._twice = natural * natural, 2.0 * damping * natural
        self._delay, self._step = delay, step
        self._share = step / (_SLOPE_S + step)
        self.reset(0.0, 0.0)

    def reset(self, given: float, asked: float) -> None:
        """``given`` now and for some time, ``asked`` for until now."""
        self._given, self._slope = given, 0.0
        self._asked = [asked] * self._delay
        self.ahead, self.rising = given, 0.0

    def look(self, given: float) -> None:
        """Take what the engines report at the end of a step."""
        self._slope += self._share * ((given - self._given) / self._step - self._slope)
        self._given = given

    def foresee(self) -> list[float]:
        """Return what will be given over the delay; keep what is given at its end, and how fast it rises."""
        step, x, slope = self._step, self._given, self._slope
        course = []
        for asked in self._asked:
            course.append(x)
            x, slope = x + step * slope, slope + step * (self._square * (asked - x) - self._twice * slope)
        self.ahead, self.rising = x, slope
        return course

    def ask(self, bend: float) -> float:
        """Return the command with which, when it arrives, what is given has the second derivative ``bend``."""
        return self.ahead + (self._twice * self.rising + bend) / self._square

    def asked(self, value: float) -> None:
        """Remember what was commanded in the end."""
        if self._delay:
            self._asked.append(value)
            del self._asked[0]


class Catch:
    """Roll and collective while engines are lost and their thrust is not yet made up for; see the module's text.

    ``delay``: of the engines [s].  Raises ValueError where the lead is of another form than the engine stated above.
    """

    def __init__(self, vehicle: Vehicle, thrust_map: ThrustMap, lead: EngineLead, delay: float, step: float) -> None:
        if lead.damping is None:
            raise ValueError("the catch needs an engine of second order")
        steps = round(delay / step)
        self._roll = _Answer(lead.natural_rad_s, lead.damping, steps, step)
        self._lift = _Answer(lead.natural_rad_s, lead.damping, steps, step)
        self._levers = tuple([-jet.position_m[1] for jet in vehicle.jets])
        self._inertia = vehicle.inertia_kg_m2[0]
        self._low = thrust_map.low * len(self._levers)
        self._span = thrust_map.span * len(self._levers)  # N per collective
        whole = 0.0
        for lever in self._levers:
            whole += lever if lever >= 0.0 else -lever
        self._moment = thrust_map.span * whole  # N m per unit of roll
        self._step = step
        self._a, self._b = 4.0 / (_LEVEL_S + steps * step), 3.0 / (_CAUGHT_S + steps * step)
        self.caught = False

    def reset(self, thrust: PerJet, used: Sequence[float], weight: float) -> None:
        """Engines were lost, of which ``used`` is 0, and all gave the ``weight`` until now [N]; as :meth:`look`."""
        self._roll.reset(self._moment_of(thrust), 0.0)
        self._lift.reset(self._lift_of(thrust, used), weight)
        self.caught = False

    def look(self, thrust: PerJet, used: Sequence[float]) -> None:
        """Take the ``thrust`` [N] that the engines' reports at the end of a step stand for."""
        self._roll.look(self._moment_of(thrust))
        self._lift.look(self._lift_of(thrust, used))

    def _moment_of(self, thrust: PerJet) -> float:
        """[N m], with the lost ones: until both have run down the one that went out last gives more.

        It is less than their speed stands for, as they have no fire; how much less is not known.
        """
        moment = 0.0
        for i, lever in enumerate(self._levers):
            moment += lever * thrust[i]
        return moment

    def _lift_of(self, thrust: PerJet, used: Sequence[float]) -> float:
        """[N], without those that are lost."""
        lift = 0.0
        for i, gain in enumerate(used):
            lift += thrust[i] if gain > 0.0 else 0.0
        return lift

    def update(
        self, lean: float, rate: float, climb: float, wanted: float, upright: float, mass: float
    ) -> tuple[float, float]:
        """Roll command and collective.

        ``lean``: about the roll axis, from what is asked for [rad]; ``rate``: of roll [rad/s]; ``climb`` and what is
        ``wanted`` of it [m/s]; ``upright``: cosine of the lean; ``mass`` [kg].
        """
        step, inertia, roll, lift = self._step, self._inertia, self._roll, self._lift
        off = climb - wanted
        balance = mass * GRAVITY / upright
        self.caught = (
            -_CLIMB < off < _CLIMB
            and upright > _UPRIGHT
            and -_ROLL < rate < _ROLL
            and -_LIFT * balance < lift.ahead - balance < _LIFT * balance
        )
        for moment, force in zip(roll.foresee(), lift.foresee(), strict=True):
            lean += step * rate
            rate += step * moment / inertia
            off += step * (force * upright / mass - GRAVITY)
        a, b = self._a, self._b
        moment = roll.ask(
            -(4.0 * a * roll.rising + 6.0 * a * a * roll.ahead + inertia * (4.0 * a**3 * rate + a**4 * lean))
        )
        force = lift.ask(-(3.0 * b * lift.rising + 3.0 * b * b * (lift.ahead - balance) + b**3 * mass * off / upright))
        return moment / self._moment, max(self.least, (force - self._low) / self._span)

    @property
    def least(self) -> float:
        """The least collective that leaves roll something."""
        return (_LEAST_LIFT * self._lift.ahead - self._low) / self._span

    def asked(self, roll: float, collective: float) -> None:
        """Remember what the engines were commanded in the end."""
        self._roll.asked(self._moment * roll)
        self._lift.asked(self._low + self._span * collective)
