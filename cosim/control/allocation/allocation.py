"""Allocation: collective and three torque commands to throttles and tilts.

On tilting banks roll is differential throttle between the banks, pitch is both banks tilted alike, yaw is them tilted
apart.  What does not fit is refused and reported, in this order: roll is kept before collective (attitude before
height), pitch before yaw; a roll command beyond half the throttle range, or tilts beyond the servos' range, are cut.
On a multirotor all three are differential throttle, and roll and pitch are kept before yaw, yaw before collective.

For an engine that is lost, weak or stuck, the allocation of tilting banks is replanned (:mod:`.reallocation`): the same
commands then give the same force and moments as with all engines, as far as the remaining engines can.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any, Final

from cosim.base.errors import InputError
from cosim.base.limits import clamp, clip
from cosim.base.signals import AXES, NO_JETS, ZERO3, Actuation, JetHealth, PerJet, PerServo, Unallocated, Vector3
from cosim.control.allocation.reallocation import Plan, plan
from cosim.spec.vehicle import AllocationLimits, Jet

# Below this fraction of hover thrust tilts are not enlarged further.
MIN_HOVER_FRACTION: Final = 0.25
# A smaller change of throttle per collective counts as constant.
_MIN_SLOPE: Final = 1e-9
# Compiled code calls these directly, without a look-up by name.
_ACTUATION: Final = Actuation
_UNALLOCATED: Final = Unallocated


class TiltAllocator:
    """Throttles and tilts of a vehicle with two banks of jets.

    ``hover`` is the throttle at which the vehicle hovers: tilt commands are stated at hover thrust and are enlarged
    or reduced in inverse proportion to the collective, so that their moment stays the same.  ``idle`` is the thrust of
    a jet without throttle, over what full throttle adds to it.  ``lift``: how far a jet's throttle may go up in one
    allocation for collective beyond the plan's own, see :meth:`_remaining_collective`.
    Raises InputError where the banks leave no lever for roll or pitch.
    """

    rest: PerServo = (0.0, 0.0)

    def __init__(
        self,
        jets: Sequence[Jet],
        limits: AllocationLimits,
        tilt_range: float,
        hover: float,
        idle: float = 0.0,
        lift: float = inf,
    ) -> None:
        self._jets, self._limits, self._idle = jets, limits, idle
        self._plan: Plan | None = None
        self._lift = lift
        self._extra = 0.0  # collective added by the last allocation
        self._low, self._high = limits.throttle_min, limits.throttle_max
        self._range = tilt_range
        self.hover = hover
        for jet in jets:
            if jet.position_m[1] == 0.0 or (jet.position_m[1] > 0.0) != (jet.servo == "right"):
                raise InputError(
                    f"vehicle.jets: the {jet.servo} servo's jet at y = {jet.position_m[1]:g} m is not on its side"
                )
        self.left = tuple(jet.servo == "left" for jet in jets)
        lever = sum(jet.position_m[2] for jet in jets)
        if lever == 0.0:
            raise InputError(
                "vehicle.jets: with all jets at the height of the centre of gravity, tilting gives no pitch"
            )
        # A forward tilt pushes forward at z: nose up where the jets stand below the centre of gravity.
        self.pitch_sign = 1.0 if lever > 0.0 else -1.0
        self._lever = lever
        self._hover_thrust = hover + idle

    def reset(self) -> None:
        self._plan = None
        self._extra = 0.0

    def trim(self, collective: float) -> PerJet:
        """Return each jet's throttle for the collective alone: all are equal to it."""
        return (collective,) * len(self.left)

    def replan(self, health: Sequence[JetHealth]) -> bool:
        """Allocate for engines of this health from now on; return False, unchanged, if that is impossible."""
        new_plan = plan(self._jets, self._limits, self.hover, self._idle, health)
        if new_plan is None:
            return False
        self._plan = new_plan
        self._extra = 0.0
        return True

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return throttles and tilts for a collective and a torque command, and the part beyond the limits.

        ``collective`` in throttle; ``torque`` roll in throttle, pitch and yaw in rad of tilt at hover thrust; ``added``
        is a disturbance of the torque that the controller does not know: the residual is counted against the sum.
        """
        roll, pitch, yaw = torque
        x, y, z = added
        if x != 0.0 or y != 0.0 or z != 0.0:
            roll, pitch, yaw = roll + x, pitch + y, yaw + z
        if self._plan is not None:
            return self._allocate_plan(self._plan, collective, roll, pitch, yaw)
        low, high = self._low, self._high
        half = 0.5 * (high - low)
        r = clamp(roll, half)
        spread = r if r >= 0.0 else -r
        least, most = low + spread, high - spread
        c = clip(collective, least, most)
        left, right = c + r, c - r

        thrust_ratio = (c + self._idle) / self._hover_thrust
        if thrust_ratio < MIN_HOVER_FRACTION:
            thrust_ratio = MIN_HOVER_FRACTION
        # Where everything fits the residual must be exactly 0, without rounding: integrals stop at any residual.
        limit = self._range
        p = self.pitch_sign * pitch / thrust_ratio
        residual_pitch = residual_yaw = 0.0
        if p > limit or p < -limit:
            p = limit if p > 0.0 else -limit
            residual_pitch = pitch - self.pitch_sign * p * thrust_ratio
        room = limit - (p if p >= 0.0 else -p)
        y = yaw / thrust_ratio
        if y > room or y < -room:
            y = room if y > 0.0 else -room
            residual_yaw = yaw - y * thrust_ratio

        sides: tuple[Any, Any] = (right, left)  # shared objects, so compiled code is fast
        return _ACTUATION(
            tuple([sides[1] if on_left else sides[0] for on_left in self.left]),
            (p + y, p - y),
            _UNALLOCATED(roll - r, residual_pitch, residual_yaw, collective - c),
            NO_JETS,
        )

    def _allocate_plan(self, plan: Plan, collective: float, roll: float, pitch: float, yaw: float) -> Actuation:
        """Allocate with failed engines: the same priorities, with throttles by the plan's weights."""
        low, high = self._low, self._high
        least_roll, most_roll = plan.roll_range
        r = clip(roll, least_roll, most_roll)
        trims, rolls, ups, frees = plan.trim, plan.roll, plan.up, plan.free
        jets = range(len(trims))
        at_roll = [trims[i] + r * rolls[i] for i in jets]
        least, most = -inf, inf
        for i in jets:
            base, slope = at_roll[i], ups[i]
            if -_MIN_SLOPE <= slope <= _MIN_SLOPE:
                continue
            bottom, top = (low - base) / slope, (high - base) / slope
            if slope < 0.0:
                bottom, top = top, bottom
            least, most = (bottom if bottom > least else least), (top if top < most else most)
        up = collective - plan.centre
        # Rounding may make the lower bound exceed the upper one.
        above = clip(up, least, most)
        throttles = [at_roll[i] + above * ups[i] for i in jets]
        missing = up - above if up > most else 0.0
        extra = self._extra = self._remaining_collective(plan, throttles, missing)
        if extra > 0.0:
            throttles = [throttles[i] + extra * plan.boost[i] for i in jets]
        # Where everything fits the residual must be exactly 0.
        c = collective if up >= least and extra == missing else plan.centre + above + extra
        throttle = tuple([clip(throttles[i], low, high) if frees[i] else at_roll[i] for i in jets])

        thrust_ratio = max(MIN_HOVER_FRACTION, (c + self._idle) / self._hover_thrust)
        constant, per_up, per_roll, per_boost = plan.pitch
        pitch_residual = constant + above * per_up + r * per_roll + extra * per_boost
        # The tilt balances the pitch moment that the throttles leave.
        balance = -pitch_residual / (self._lever * max(MIN_HOVER_FRACTION, self._idle + c))
        tilt = self.pitch_sign * pitch / thrust_ratio + balance
        p = clamp(tilt, self._range)
        y = clamp(yaw / thrust_ratio, self._range - abs(p))
        return Actuation(
            throttle,
            (p + y, p - y),
            Unallocated(
                roll - r,
                0.0 if p == tilt else self.pitch_sign * (tilt - p) * thrust_ratio,
                0.0 if y == yaw / thrust_ratio else yaw - y * thrust_ratio,
                collective - c,
            ),
            NO_JETS,
        )

    def _remaining_collective(self, plan: Plan, throttles: list[float], missing: float) -> float:
        """Return the part of the collective ``missing`` beyond the plan's that engines at ``throttles`` can still give.

        It grows no faster than ``lift`` allows: engines that are all on their way up as fast as they go have none left
        between them to keep the vehicle level with, whatever their throttles say.
        """
        if missing <= 0.0:
            return 0.0
        room, steepest = missing, 0.0
        for slope, at in zip(plan.boost, throttles, strict=True):
            if slope > _MIN_SLOPE:
                room = min(room, (self._high - at) / slope)
                steepest = max(steepest, slope)
            elif slope < -_MIN_SLOPE:
                room = min(room, (self._low - at) / slope)
        if steepest == 0.0:
            return 0.0
        return max(0.0, min(room, self._extra + self._lift / steepest))


class RotorAllocator:
    """Allocation for a multirotor whose rotors point straight up.

    Torque commands are in throttle: a unit of roll adds one to the rotors on the left and takes one from those on
    the right; pitch does so front and rear, yaw by the sense of rotation.  ``hover``: the throttle of hover.

    It does not plan around a lost rotor: without one of four there is no level hover at all, and without it and the
    opposite one (both turn the same way) there is one only while the vehicle spins, which is flown without this
    (:mod:`cosim.control.phases.reduced_attitude`).
    Raises InputError where the rotors give no moment about an axis.
    """

    rest: PerServo = (0.0, 0.0)

    def __init__(self, jets: Sequence[Jet], limits: AllocationLimits, hover: float) -> None:
        self._low, self._high = limits.throttle_min, limits.throttle_max
        self.hover = hover
        self.signs = tuple((-_sign(jet.position_m[1]), _sign(jet.position_m[0]), _sign(jet.reaction_m)) for jet in jets)
        for index, axis in enumerate(AXES):
            signs = [sign[index] for sign in self.signs]
            if not (max(signs) > 0.0 > min(signs)):
                raise InputError(f"vehicle.jets: the rotors give no {axis} moment both ways")

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def trim(self, collective: float) -> PerJet:
        """Return each jet's throttle for the collective alone: all are equal to it."""
        return (collective,) * len(self.signs)

    def replan(self, health: Sequence[JetHealth]) -> bool:
        """Return False: this allocation is for healthy engines alone."""
        return False

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return throttles for four commands in throttle; ``added`` as for :class:`TiltAllocator`."""
        roll, pitch, yaw = torque
        if added != ZERO3:
            roll, pitch, yaw = roll + added[0], pitch + added[1], yaw + added[2]
        low, high = self._low, self._high
        room = 0.5 * (high - low)
        spread = abs(roll) + abs(pitch)
        scale = room / spread if spread > room else 1.0
        r, p = roll * scale, pitch * scale
        room_for_yaw = room - min(spread, room)
        y = clamp(yaw, room_for_yaw)
        span = abs(r) + abs(p) + abs(y)
        least, most = low + span, high - span
        # Rounding may make the lower bound exceed the upper one.
        c = clip(collective, least, most)
        return Actuation(
            tuple([min(high, max(low, c + a * r + b * p + d * y)) for a, b, d in self.signs]),
            (0.0, 0.0),
            Unallocated(roll - r, pitch - p, yaw - y, collective - c),
            NO_JETS,
        )


def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
