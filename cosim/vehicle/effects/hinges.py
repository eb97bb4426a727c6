"""Reaction of turning hinges on the body, about any axis at any position.

It is that of the banks (:mod:`cosim.vehicle.effects.banks`) in general.

A hinge stands at an angle ``a`` about its axis ``n``, as it stands on what it is on.  What turns with it has the moment
of inertia ``J`` about that axis, the mass ``m`` and its centre at ``d`` from it, square to it.  By Newton's and Euler's
laws for a part that moves against the rest, it acts on the body with

    M = -J a'' n - omega x (J a' n)            beside
    F = -m (a'' n x d - a'^2 d)                at the foot of d on the axis.

Valid for parts that are light beside the vehicle, as its centre of gravity and inertia stay those with the hinges at
zero, and without products of inertia about that foot.  Of hinges in a chain each is taken for itself: what the turning
of the outer one does to the inner is in the outer one's inertia, the product of both rates is left out.

Angles are known at the ends of steps; ``a'`` is the mean over a step and ``a''`` its change from one step to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

from cosim.base.frames import cross
from cosim.base.layout import rotate_by
from cosim.base.signals import ZERO3, PerServo, Vector3
from cosim.spec.vehicle import Hinge, Jet, layout_of
from cosim.vehicle.effects.effect import Effect, Load, add_vectors


class _TurnedMass:
    """Mass that a hinge turns; ``angle``, ``speed`` and ``acceleration`` are those at the end of a step."""

    def __init__(self, hinge: Hinge, number: int) -> None:
        self.number = number
        self.inertia, self.mass = hinge.inertia_kg_m2, hinge.mass_kg
        self.rest = hinge.rest_rad
        px, py, pz = self.point = hinge.position_m
        cx, cy, cz = hinge.centre_m or hinge.position_m
        x, y, z = self.axis = hinge.axis
        along = (cx - px) * x + (cy - py) * y + (cz - pz) * z
        fx, fy, fz = self.foot = (px + along * x, py + along * y, pz + along * z)
        self.arm: Vector3 = (cx - fx, cy - fy, cz - fz)
        self.outer: list[_TurnedMass] = []  # hinges between this one and the body
        self.reset()

    def reset(self) -> None:
        self.angle = self.rest
        self.speed = self.acceleration = 0.0
        self.cosine = self.sine = 0.0

    def turn(self, angle: float, step: float) -> None:
        """Turn to an angle [rad] within a step [s]."""
        speed = (angle - self.angle) / step
        self.acceleration = (speed - self.speed) / step
        self.angle, self.speed = angle, speed
        self.cosine, self.sine = cos(angle), sin(angle)

    def rotate(self, vector: Vector3) -> Vector3:
        """Return a vector turned by the hinge's angle."""
        return rotate_by(self.axis, self.cosine, self.sine, vector)


class HingeReactions(Effect):
    """Reactions of hinges whose parts have mass or inertia; ``step``: control step [s]."""

    def __init__(self, hinges: Sequence[Hinge], jets: Sequence[Jet], step: float) -> None:
        self._step = step
        self._force_point: Vector3 = jets[0].position_m
        turns = layout_of(jets, hinges).turns
        self._parts = [_TurnedMass(hinge, number) for number, hinge in enumerate(hinges)]
        # A hinge is mounted on those before it that carry one of its jets.
        for part in self._parts:
            jets_moved = {*turns[part.number].carries, *turns[part.number].deflects}
            before = reversed(self._parts[: part.number])
            part.outer = [other for other in before if jets_moved & set(turns[other.number].carries)]
        self.is_active = any(part.inertia or part.mass for part in self._parts)

    def reset(self) -> None:
        for part in self._parts:
            part.reset()

    def start(self, load: Load) -> None:
        self.reset()

    def add_to(self, load: Load) -> None:
        push, moment = self.reaction(load.tilt, load.state.rate)
        forces = load.forces
        load.forces = [add_vectors(forces[0], push), *forces[1:]]
        load.add_moment(moment)

    def reaction(self, tilt: PerServo, rate: Vector3) -> tuple[Vector3, Vector3]:
        """Return the force [N, body, applied at the first station] and additional moment [N m, body].

        ``tilt``: where the servos stand at the end of the step, rad; ``rate``: the body's, rad/s.
        """
        force = moment = ZERO3
        for part in self._parts:
            part.turn(tilt[part.number], self._step)
            speed, acceleration = part.speed, part.acceleration
            if speed == 0.0 and acceleration == 0.0:
                continue
            mass, inertia = part.mass, part.inertia
            axis, foot, arm = part.axis, part.foot, part.rotate(part.arm)
            for outer in part.outer:
                axis, arm = outer.rotate(axis), outer.rotate(arm)
                px, py, pz = outer.point
                x, y, z = outer.rotate((foot[0] - px, foot[1] - py, foot[2] - pz))
                foot = (px + x, py + y, pz + z)
            x, y, z = axis
            momentum = inertia * speed
            wx, wy, wz = cross(rate, (momentum * x, momentum * y, momentum * z))
            reaction_torque = -inertia * acceleration
            mx, my, mz = reaction_torque * x - wx, reaction_torque * y - wy, reaction_torque * z - wz
            if mass:
                ax, ay, az = cross(axis, arm)
                square = speed * speed
                push = (
                    -mass * (acceleration * ax - square * arm[0]),
                    -mass * (acceleration * ay - square * arm[1]),
                    -mass * (acceleration * az - square * arm[2]),
                )
                hx, hy, hz = self._force_point
                lx, ly, lz = cross((foot[0] - hx, foot[1] - hy, foot[2] - hz), push)
                mx, my, mz = mx + lx, my + ly, mz + lz
                force = (force[0] + push[0], force[1] + push[1], force[2] + push[2])
            moment = (moment[0] + mx, moment[1] + my, moment[2] + mz)
        return force, moment
