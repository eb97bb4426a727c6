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
for at first with each of those hinges at either end, and no such hinge goes further from them than ``MAX_SWING``.

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
    FORWARD,
    HORIZONTAL,
    LEVELS,
    LIFT,
    MAX_FIRST,
    MAX_ITERATIONS,
    MAX_SWING,
    PITCH,
    RIGHT,
    ROLL,
    TINY,
    YAW,
    AllocationModel,
    EffectivenessAllocator,
    SolverOptions,
)

# Lift deficit over weight from which hinges stay close to the largest lift. Chosen by us: the altitude loop corrects 1
# %.
MAX_LIFT_DEFICIT: Final = 0.01
# Rows that hinges serve at reported thrusts: where they carry engines, and where they only deflect thrust.
TURNING: Final = ((ROLL, PITCH), (YAW,), (LIFT,), (FORWARD, RIGHT))
DEFLECTING: Final = ((ROLL, PITCH), (YAW,))


class EngineLag(NamedTuple):
    """Delay of the engines, and the control step."""

    delay: float  # s from a throttle command to its effect
    step: float  # s, control step


class HingedRecovery(EffectivenessAllocator):
    """Like :class:`EffectivenessAllocator` while all engines run; with one out see the module's text.

    ``lag``: of the engines.
    """

    def __init__(self, model: AllocationModel, lag: EngineLag) -> None:
        self._lag = lag
        self._carriers = [number for number, turn in enumerate(model.layout.turns) if turn.carries]
        self._turns: list[tuple[int, ...]] = [*(TURNING if self._carriers else DEFLECTING)]
        super().__init__(model)

    def reset(self) -> None:
        """Start with all engines healthy and hinges at rest."""
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
        """Whether it leans against the force of its hinges: with an engine out whose hinge carries engines."""
        return bool(self._reported) and bool(self._carriers)

    def observe(self, thrust: PerJet) -> None:
        """Take the ``thrust`` [N] reported by the engines at the end of a step."""
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
        """Allocate as :meth:`EffectivenessAllocator.allocate`; without an engine see the module's text.

        What is told as missing of the lift is then what the balanced thrusts at rest miss of all that is asked of
        them, so that the height loop's integral waits until the engines have followed.
        """
        if not self._reported:
            return super().allocate(collective, torque, added)
        # Dynamic pressure from ground speed is wrong in wind, and useless where no heading is held.
        self.pressure = 0.0
        lift = self.total_thrust(collective)
        wanted = self._wanted(lift, torque, added)
        jets, servos = self._jets, self._last[self._jets :]
        self._carrying, short = self._carried(lift)
        reach, stand = self._servo_limits, self._hovers[jets:]
        if self._short and self._carriers:
            self._short = self._lifts(servos)
            if self._short:
                reach, stand = self._near(self._lifting), self._lifting
        turning, missing = self._beside(wanted, servos, reach, stand, MAX_ITERATIONS, True)
        self._turning_on = self._turns_on(wanted, missing, turning)
        if self._carriers:
            given, enough = lift - missing[LIFT], (1.0 - MAX_LIFT_DEFICIT) * self._weight
            if not self._short and given < min(lift, enough):
                self._short, self._lifting = True, turning
            self._lean(missing, given)
        missing[LIFT] = short[LIFT]
        return self._actuation([*self._carrying[:jets], *turning], missing)

    def allocate_forward(
        self, force: float, lift: float, pitch: float, torque: Vector3, tilts: Sequence[int]
    ) -> tuple[Actuation, float]:
        """Allocate as :meth:`EffectivenessAllocator.allocate_forward`; the next hover is solved from scratch."""
        self._short, self._lifting, self.lean = True, [], (0.0, 0.0)
        return super().allocate_forward(force, lift, pitch, torque, tilts)

    def _carried(self, lift: float, trimmed: float = 0.7) -> tuple[list[float], list[float]]:
        """Return thrusts [N] and servos for the lift in balance, and the residual; see the module's text.

        The lift that reported thrusts lack is added to the demand, which halves the engines' lag.  ``trimmed``: the
        fraction of the hinges' ranges to balance thrusts with; the rest turns the vehicle.
        """
        pushed = lift
        for thrust in self._reported:
            pushed -= thrust
        pushed += lift
        part = 0.0 if self._turning_on else trimmed
        reach = [
            (effector.rest + part * (low - effector.rest), effector.rest + part * (high - effector.rest))
            for effector, (low, high) in zip(self._effectors, self._servo_limits, strict=True)
        ]
        wanted, stand = [0.0, 0.0, pushed, 0.0, 0.0, 0.0], self._hovers[self._jets :]
        options = SolverOptions(self._carrying, self._thrust_limits, [*LEVELS, *HORIZONTAL], reach, stand)
        return self._solve(wanted, lift, MAX_ITERATIONS, False, options)

    def _lifts(self, servos: list[float], unbalanced: float = 100.0) -> bool:
        """Return whether the reported thrusts cannot hold the weight in balance; then hinges follow the most lift.

        ``unbalanced``: the cost of missing roll and pitch against missing lift, where that is searched for.
        """
        rest, weight = self._neutral, [0.0, 0.0, self._weight, 0.0, 0.0, 0.0]
        starts, passes = [self._lifting], MAX_ITERATIONS
        if not self._lifting:
            starts, passes = [rest, servos], MAX_FIRST
            for number in self._carriers:
                starts += [[*rest[:number], end, *rest[number + 1 :]] for end in self._servo_limits[number]]
        found = [self._beside(weight, start, self._servo_limits, rest, passes, False) for start in starts]
        norms, costs = self._norms, []
        for _, missing in found:
            turned = abs(missing[ROLL]) * norms[ROLL] + abs(missing[PITCH]) * norms[PITCH]
            costs.append(unbalanced * turned + abs(missing[LIFT]) * norms[LIFT])
        self._lifting, missing = found[costs.index(min(costs))]
        return missing[LIFT] * norms[LIFT] > MAX_LIFT_DEFICIT

    def _near(self, angles: Sequence[float]) -> list[tuple[float, float]]:
        """Return the servos' ranges [rad], for hinges that carry engines within ``MAX_SWING`` of these angles."""
        near = list(self._servo_limits)
        for number in self._carriers:
            low, high = near[number]
            near[number] = (
                max(low, angles[number] - MAX_SWING),
                min(high, angles[number] + MAX_SWING),
            )
        return near

    def _beside(
        self,
        wanted: list[float],
        servos: Sequence[float],
        servo_limits: list[tuple[float, float]],
        neutral: list[float],
        passes: int,
        rated: bool,
    ) -> tuple[list[float], list[float]]:
        """Return servos for the reported thrusts, searched from ``servos``, and the residual of ``wanted``."""
        last, ends = [*self._reported, *servos], [(thrust, thrust) for thrust in self._reported]
        options = SolverOptions(last, ends, self._turns, servo_limits, neutral)
        found, missing = self._solve(wanted, wanted[LIFT], passes, rated, options)
        return found[self._jets :], missing

    def _turns_on(self, wanted: Sequence[float], missing: Sequence[float], servos: Sequence[float]) -> bool:
        """Return whether saturated hinges and the coming thrusts turn the vehicle against the demand."""
        if all(-TINY <= missing[row] * self._norms[row] <= TINY for row in (ROLL, PITCH)):
            return False
        lag = self._lag
        coming = [max(0.0, f + lag.delay * up) for f, up in zip(self._reported, self._rising, strict=True)]
        moments, _ = self._solver.linear([*coming, *servos], self.pressure)
        return moments[ROLL] * wanted[ROLL] + moments[PITCH] * wanted[PITCH] <= 0.0

    def _lean(
        self, missing: Sequence[float], lift: float, lean_s: float = 0.1, max_rad: float = 0.2, held_rad: float = 0.1
    ) -> None:
        """Update :attr:`lean` for the horizontal force that is missing or excessive, and a lift [N].

        ``lean_s``: its time constant; hinges move as fast, and it is not to follow each.  ``max_rad``: at most while
        the reported thrusts cannot hold the weight; ``held_rad``: from then on, to touch down level.
        """
        share, (roll, pitch) = self._lag.step / (lean_s + self._lag.step), self.lean
        most = max_rad if self._short else held_rad
        to_roll = clamp(atan2(missing[RIGHT], lift), most)
        to_pitch = clamp(atan2(-missing[FORWARD], lift), most)
        self.lean = (roll + share * (to_roll - roll), pitch + share * (to_pitch - pitch))
