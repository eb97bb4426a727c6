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

from cosim.base.frames import cross
from cosim.base.layout import rotate_about
from cosim.base.signals import ZERO3, PerServo, Vector3
from cosim.spec.vehicle import Hinge, Jet, layout_of
from cosim.vehicle.effects.effect import Effect, Load, add_vectors


class HingeReactions(Effect):
    """The hinges of a vehicle whose parts have mass or inertia.

    ``step``: control step, s.
    """

    def __init__(self, hinges: Sequence[Hinge], jets: Sequence[Jet], step: float) -> None:
        self._step = step
        self._force_point: Vector3 = jets[0].position_m
        layout = layout_of(jets, hinges)
        self._rest = [hinge.rest_rad for hinge in hinges]
        self._inertia = [hinge.inertia_kg_m2 for hinge in hinges]
        self._mass = [hinge.mass_kg for hinge in hinges]
        self._axes: list[Vector3] = [hinge.axis for hinge in hinges]
        self._feet: list[Vector3] = []
        self._arms: list[Vector3] = []
        for hinge in hinges:
            px, py, pz = hinge.position_m
            cx, cy, cz = hinge.centre_m or hinge.position_m
            x, y, z = hinge.axis
            along = (cx - px) * x + (cy - py) * y + (cz - pz) * z
            foot = (px + along * x, py + along * y, pz + along * z)
            self._feet.append(foot)
            self._arms.append((cx - foot[0], cy - foot[1], cz - foot[2]))
        # the hinges that a hinge stands on: those that carry one of its jets and are stated before it
        self._outer: list[list[int]] = []
        for number, turn in enumerate(layout.turns):
            jets_moved = {*turn.carries, *turn.deflects}
            self._outer.append([k for k in range(number) if jets_moved & set(layout.turns[k].carries)])
        self._points: list[Vector3] = [hinge.position_m for hinge in hinges]
        self.is_active = any(self._inertia) or any(self._mass)
        self.reset()

    def reset(self) -> None:
        """Start with all hinges at rest."""
        self._angles = list(self._rest)
        self._rates = [0.0] * len(self._rest)

    def start(self, load: Load) -> None:
        self.reset()

    def act(self, load: Load) -> None:
        push, moment = self.reaction(load.tilt, load.state.rate)
        forces = load.forces
        load.forces = [add_vectors(forces[0], push), *forces[1:]]
        load.add_moment(moment)

    def reaction(self, tilt: PerServo, rate: Vector3) -> tuple[Vector3, Vector3]:
        """Return the force [N, body, handed over at the first jet's station] and the moment beside it [N m, body].

        ``tilt``: where the servos stand at the end of the step, rad; ``rate``: the body's, rad/s.
        """
        step = self._step
        force = moment = ZERO3
        for number, inertia in enumerate(self._inertia):
            last_angle, last_speed = self._angles[number], self._rates[number]
            now = tilt[number]
            speed = (now - last_angle) / step
            acceleration = (speed - last_speed) / step
            self._angles[number], self._rates[number] = now, speed
            if speed == 0.0 and acceleration == 0.0:
                continue
            mass = self._mass[number]
            axis, foot = self._axes[number], self._feet[number]
            arm = rotate_about(axis, now, self._arms[number])
            for outer in reversed(self._outer[number]):
                about, point, angle = self._axes[outer], self._points[outer], tilt[outer]
                axis, arm = rotate_about(about, angle, axis), rotate_about(about, angle, arm)
                x, y, z = rotate_about(about, angle, (foot[0] - point[0], foot[1] - point[1], foot[2] - point[2]))
                foot = (point[0] + x, point[1] + y, point[2] + z)
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
