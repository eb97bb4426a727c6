"""A vehicle of hinges and engines that answer late, without one of its engines: hinges turn it and throttles carry it.

Throttles that were asked for moments would give them too late and pump the swing.  So two things are solved for in each
step, and a third while lift is missing, all by :class:`EffectivenessAllocator`:

Throttles ask for the lift in balance, with hinges within a part of their ranges, and for no moment.  Only while hinges
at their limits and the thrusts that will be there when a throttle has acted turn the vehicle on the wrong way are
throttles to balance it by themselves.

Hinges give the moments beside the thrusts that the engines *report*: they turn the vehicle at once, whatever engines
are still on their way to.  Roll and pitch together get as much as there is; their commands may run ahead of the servos,
which then move at their full rate.  What they leave is for yaw and, where hinges carry engines, then for lift, last for
pushing nowhere.

Hinges that carry engines turn lift away, and that has more than one solution: the engine across turned level, or the
two beside it.  No small step leads from one to the other, and the second gives less lift.  While the reported
thrusts cannot hold the weight in balance, the angles that come nearest to it are followed from step to step, searched
for at first with each of those hinges at either end, and no such hinge goes further from them than ``MAX_SWING_RAD``.

Surfaces stay at zero: how fast the air comes is not known.  The heading is not held, its turning is only stopped
(:meth:`cosim.control.attitude.AttitudeController.update_tilt_first`): to turn back costs lift.

What such hinges push aside the vehicle leans against: :attr:`HingedRecovery.lean` brings the reported force, whose
direction in the body is ``(X, Y, -L)``, to where the thrust of an even vehicle would point, by ``atan(-Y / L)`` of roll
and ``atan(X / L)`` of pitch, late by a lag and within a limit that is smaller once the weight is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2
from typing import Final, NamedTuple

from cosim.base.limits import clamp
from cosim.base.signals import ZERO3, Actuation, PerJet, Vector3
from cosim.control.allocation.effectiveness import (
    HORIZONTAL,
    MAX_FIRST,
    MAX_ITERATIONS,
    MAX_SWING_RAD,
    PRIORITIES,
    ROW_FORWARD,
    ROW_LIFT,
    ROW_PITCH,
    ROW_RIGHT,
    ROW_ROLL,
    ROW_YAW,
    TINY,
    AllocationModel,
    EffectivenessAllocator,
    SolverOptions,
)

# Lift deficit over weight from which hinges stay near the largest lift. Chosen by us: the altitude loop corrects 1 %.
MAX_LIFT_DEFICIT: Final = 0.01
# Rows of force and moment that hinges serve, highest priority first: hinges that carry engines, or deflect thrust.
ENGINE_HINGE_PRIORITIES: Final = ((ROW_ROLL, ROW_PITCH), (ROW_YAW,), (ROW_LIFT,), (ROW_FORWARD, ROW_RIGHT))
DEFLECTOR_PRIORITIES: Final = ((ROW_ROLL, ROW_PITCH), (ROW_YAW,))


class EngineLag(NamedTuple):
    """Delay of the engines and the control step, for the prediction of thrusts."""

    delay: float  # s from a throttle command to its effect
    step: float  # s, control step


class HingedRecovery(EffectivenessAllocator):
    """Allocator that after an engine loss turns the vehicle by hinges; while all run an EffectivenessAllocator."""

    def __init__(self, model: AllocationModel, lag: EngineLag) -> None:
        self._lag = lag
        self._carriers = [number for number, turn in enumerate(model.layout.turns) if turn.carries]
        self._turns: list[tuple[int, ...]] = [*(ENGINE_HINGE_PRIORITIES if self._carriers else DEFLECTOR_PRIORITIES)]
        super().__init__(model)

    def reset(self) -> None:
        self._reported: list[float] = []  # N; empty while all engines run
        self._rising = [0.0] * self._jets  # slopes of the reported thrusts, N/s
        self._carrying: list[float] = []  # thrusts and servos that balance lift
        self._lifting: list[float] = []  # servos of largest balanced lift, if any
        self._short = True  # thrusts as reported cannot carry weight
        self._turning_on = False  # turns against command, hinges at limits
        self.lean = (0.0, 0.0)  # rad, roll and pitch; see the module
        super().reset()

    @property
    def is_leaning(self) -> bool:
        """Whether the vehicle leans against its hinges' side force: an engine is out, and hinges carry engines."""
        return bool(self._reported) and bool(self._carriers)

    def observe(self, thrust: PerJet) -> None:
        """Store the ``thrust`` [N] that the engines report at the end of a step, and its slope."""
        if all(jet.gain > 0.0 for jet in self._health):
            return
        # A rotor that turns without fire reports a speed as if it had thrust.
        given = [
            0.0 if jet.gain == 0.0 and jet.fixed == 0.0 else f for f, jet in zip(thrust, self._health, strict=True)
        ]
        if self._reported:
            lag = self._lag
            # The time constant of the reports' slope is short against any jet.
            share = lag.step / (0.02 + lag.step)
            for i, (now, before) in enumerate(zip(given, self._reported, strict=True)):
                self._rising[i] += share * ((now - before) / lag.step - self._rising[i])
        else:
            self._carrying = self._hovers
        self._reported = given

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return throttles and servo angles; after an engine loss moments come from hinges, at the reported thrusts.

        What is told as missing of the lift is then what the balanced thrusts at rest miss of all that is asked of
        them, so that the height loop's integral waits until the engines have followed.
        """
        if not self._reported:
            return super().allocate(collective, torque, added)
        # Dynamic pressure from ground speed is wrong in wind, and useless where no heading is held.
        self.pressure = 0.0
        lift = self.total_thrust(collective)
        wanted = self._wrench(lift, torque, added)
        jets, servos = self._jets, self._last[self._jets :]
        self._carrying, short = self._balance_lift(lift)
        reach, stand = self._servo_limits, self._hovers[jets:]
        if self._short and self._carriers:
            self._short = self._lacks_lift(servos)
            if self._short:
                reach, stand = self._ranges_near(self._lifting), self._lifting
        turning, missing = self._solve_servos(wanted, servos, reach, stand, MAX_ITERATIONS, True)
        self._turning_on = self._turns_against_demand(wanted, missing, turning)
        if self._carriers:
            given, enough = lift - missing[ROW_LIFT], (1.0 - MAX_LIFT_DEFICIT) * self._weight
            if not self._short and given < min(lift, enough):
                self._short, self._lifting = True, turning
            self._update_lean(missing, given)
        missing[ROW_LIFT] = short[ROW_LIFT]
        return self._make_actuation([*self._carrying[:jets], *turning], missing)

    def allocate_forward(
        self, force: float, lift: float, pitch: float, torque: Vector3, tilts: Sequence[int]
    ) -> tuple[Actuation, float]:
        """Allocate as :meth:`EffectivenessAllocator.allocate_forward`; the next hover is solved from scratch."""
        self._short, self._lifting, self.lean = True, [], (0.0, 0.0)
        return super().allocate_forward(force, lift, pitch, torque, tilts)

    def _balance_lift(self, lift: float, balancing_share: float = 0.7) -> tuple[list[float], list[float]]:
        """Return [thrusts in N, then servo angles] that give a lift [N] in balance, and the wrench that is missing.

        The lift that reported thrusts lack is added to the demand, which halves the engines' lag.  ``balancing_share``:
        the fraction of the hinges' ranges to balance thrusts with; the rest turns the vehicle.
        """
        pushed = lift
        for thrust in self._reported:
            pushed -= thrust
        pushed += lift
        part = 0.0 if self._turning_on else balancing_share
        reach = [
            (effector.rest + part * (low - effector.rest), effector.rest + part * (high - effector.rest))
            for effector, (low, high) in zip(self._effectors, self._servo_limits, strict=True)
        ]
        wanted, stand = [0.0, 0.0, pushed, 0.0, 0.0, 0.0], self._hovers[self._jets :]
        options = SolverOptions(self._carrying, self._thrust_limits, [*PRIORITIES, *HORIZONTAL], reach, stand)
        return self._solve(wanted, lift, MAX_ITERATIONS, False, options)

    def _lacks_lift(self, servos: list[float], unbalanced: float = 100.0) -> bool:
        """Return whether the reported thrusts cannot balance the weight, and store the servo angles with the most lift.

        ``unbalanced``: the cost of missing roll and pitch against missing lift, where that is searched for.
        """
        rest, weight = self._neutral, [0.0, 0.0, self._weight, 0.0, 0.0, 0.0]
        starts, passes = [self._lifting], MAX_ITERATIONS
        if not self._lifting:
            starts, passes = [rest, servos], MAX_FIRST
            for number in self._carriers:
                starts += [[*rest[:number], end, *rest[number + 1 :]] for end in self._servo_limits[number]]
        found = [self._solve_servos(weight, start, self._servo_limits, rest, passes, False) for start in starts]
        norms, costs = self._norms, []
        for _, missing in found:
            turned = abs(missing[ROW_ROLL]) * norms[ROW_ROLL] + abs(missing[ROW_PITCH]) * norms[ROW_PITCH]
            costs.append(unbalanced * turned + abs(missing[ROW_LIFT]) * norms[ROW_LIFT])
        self._lifting, missing = found[costs.index(min(costs))]
        return missing[ROW_LIFT] * norms[ROW_LIFT] > MAX_LIFT_DEFICIT

    def _ranges_near(self, angles: Sequence[float]) -> list[tuple[float, float]]:
        """Return the servos' ranges [rad], for hinges that carry engines within ``MAX_SWING_RAD`` of these angles."""
        near = list(self._servo_limits)
        for number in self._carriers:
            low, high = near[number]
            near[number] = (
                max(low, angles[number] - MAX_SWING_RAD),
                min(high, angles[number] + MAX_SWING_RAD),
            )
        return near

    def _solve_servos(
        self,
        wanted: list[float],
        servos: Sequence[float],
        servo_limits: list[tuple[float, float]],
        neutral: list[float],
        passes: int,
        rated: bool,
    ) -> tuple[list[float], list[float]]:
        """Return the servo angles that give the wrench ``wanted`` at the reported thrusts, and its residual."""
        last, ends = [*self._reported, *servos], [(thrust, thrust) for thrust in self._reported]
        options = SolverOptions(last, ends, self._turns, servo_limits, neutral)
        found, missing = self._solve(wanted, wanted[ROW_LIFT], passes, rated, options)
        return found[self._jets :], missing

    def _turns_against_demand(self, wanted: Sequence[float], missing: Sequence[float], servos: Sequence[float]) -> bool:
        """Return whether saturated hinges and the coming thrusts turn the vehicle against the demand."""
        if all(-TINY <= missing[row] * self._norms[row] <= TINY for row in (ROW_ROLL, ROW_PITCH)):
            return False
        lag = self._lag
        coming = [max(0.0, f + lag.delay * up) for f, up in zip(self._reported, self._rising, strict=True)]
        moments, _ = self._solver.linear([*coming, *servos], self.pressure)
        return moments[ROW_ROLL] * wanted[ROW_ROLL] + moments[ROW_PITCH] * wanted[ROW_PITCH] <= 0.0

    def _update_lean(
        self, missing: Sequence[float], lift: float, lean_s: float = 0.1, max_rad: float = 0.2, held_rad: float = 0.1
    ) -> None:
        """Update :attr:`lean`, the roll and pitch [rad] that turn the thrust against the hinges' horizontal force.

        ``lean_s``: its time constant; hinges move as fast, and it is not to follow each.  ``max_rad``: at most while
        the reported thrusts cannot hold the weight; ``held_rad``: from then on, to touch down level.
        """
        share, (roll, pitch) = self._lag.step / (lean_s + self._lag.step), self.lean
        most = max_rad if self._short else held_rad
        to_roll = clamp(atan2(missing[ROW_RIGHT], lift), most)
        to_pitch = clamp(atan2(-missing[ROW_FORWARD], lift), most)
        self.lean = (roll + share * (to_roll - roll), pitch + share * (to_pitch - pitch))
