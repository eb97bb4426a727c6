"""Reaction of tilting banks on the body: to being turned, and to being moved if not balanced about their axis.

A bank stands at an angle ``a`` about the body's y axis, its thrust along ``e = (sin a, 0, -cos a)``.  Against the body
it turns at ``-a'`` about y and has the angular momentum ``h = -J a'`` there, with its moment of inertia ``J`` about the
tilt axis.  What turns it turns the body the other way:

    M = -h' - omega x h,        about y: + J a''

With its centre of gravity ``c`` from the axis along the thrust and a mass ``m``, ``S = m c``, it also pushes its axis:

    F = -S (a'' e_a - a'^2 e),  e_a = de/da

Both are Newton's and Euler's laws for a part that moves against the rest; of gimballed rocket engines the effect is
known as "tail wags dog".  Valid for banks that are light beside the vehicle: its centre of gravity and moments of
inertia stay those with the banks upright.

Angles are known at the ends of steps; ``a'`` is the mean over a step and ``a''`` its change from one step to the next,
so that the body has at every step exactly the momentum that the banks have not.
"""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.frames import jet_axis
from cosim.base.signals import Vector3
from cosim.spec.vehicle import Jet, Servo
from cosim.vehicle.effects.effect import Effect, Load


class Banks(Effect):
    """Reaction of a vehicle's left and right tilting bank on the body; ``step``: control step [s]."""

    def __init__(self, servo: Servo, jets: Sequence[Jet], step: float) -> None:
        self._step = step
        self._inertia = servo.bank_inertia_kg_m2
        self._imbalance = servo.bank_imbalance_kg_m
        self._on_left = tuple(jet.servo == "left" for jet in jets)
        self._left_jets = sum(self._on_left)
        self._right_jets = len(jets) - self._left_jets
        self.is_active = self._inertia > 0.0 or self._imbalance != 0.0
        self.reset()

    def reset(self) -> None:
        """Start with both banks at rest, thrust straight up."""
        self._angles = (0.0, 0.0)
        self._rates = (0.0, 0.0)

    def start(self, load: Load) -> None:
        self.reset()

    def add_to(self, load: Load) -> None:
        """Add the banks' forces at the jets' stations, and their moment."""
        step, inertia = self._step, self._inertia
        last_left, last_right = self._angles
        last_left_rate, last_right_rate = self._rates
        left, right = load.tilt
        left_rate, right_rate = (left - last_left) / step, (right - last_right) / step
        left_acceleration, right_acceleration = (
            (left_rate - last_left_rate) / step,
            (right_rate - last_right_rate) / step,
        )
        self._angles, self._rates = (left, right), (left_rate, right_rate)
        p, _, r = load.state.rate
        h = -inertia * (left_rate + right_rate)
        load.add_moment((r * h, inertia * (left_acceleration + right_acceleration), -p * h))
        if not self._imbalance:
            return
        left_x, left_z = self._bank_force(left, left_rate, left_acceleration, self._left_jets)
        right_x, right_z = self._bank_force(right, right_rate, right_acceleration, self._right_jets)
        forces: list[Vector3] = []
        for number, on_left in enumerate(self._on_left):
            x, y, z = load.forces[number]
            forces.append((x + left_x, y, z + left_z) if on_left else (x + right_x, y, z + right_z))
        load.forces = forces

    def _bank_force(self, angle: float, rate: float, acceleration: float, jets: int) -> tuple[float, float]:
        """Return a bank's force along x and z [N] at each of its stations: the sum acts at its middle."""
        x, _, z = jet_axis(angle)
        mass_moment = -self._imbalance / jets
        # With e = (sin a, 0, -cos a) the derivative is e_a = (cos a, 0, sin a).
        return mass_moment * (-z * acceleration - x * rate * rate), mass_moment * (x * acceleration - z * rate * rate)
