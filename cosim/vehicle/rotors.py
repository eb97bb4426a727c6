"""What the spinning rotors of the engines do to the airframe."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import InputError
from cosim.base.frames import cross, jet_axis
from cosim.base.signals import PerJet, Vector3
from cosim.engine import EngineSpec
from cosim.spec.vehicle import Jet


class RotorDynamics:
    """The angular momentum of all rotors against the airframe, and its change from step to step.

    ``H = sum s J w e``: spin s of the station, inertia J and speed w of its engine, e the jet's tilted axis.  On the
    airframe acts ``M = -dH/dt - omega x H``, where dH/dt is taken in the body frame and contains both the spools'
    acceleration and the turning of the axes with the tilt.  ``inertia_kg_m2`` of the vehicle contains the rotors, as if
    they stood still, and w is what a sensor on the engine's case counts: nothing else is owed to them.

    Discretised: H is held over a step at its value at the step's end, like the thrust, and dH/dt is the difference
    from the step before, so that the impulse on the airframe is exact.  The airframe adds ``-omega x H`` itself.
    """

    def __init__(self, jets: Sequence[Jet], engines: Sequence[EngineSpec], step: float) -> None:
        for number, (jet, engine) in enumerate(zip(jets, engines, strict=True), 1):
            if jet.spin and engine.rotor_inertia and not engine.has("spool_speed"):
                raise InputError(
                    f"engine {engine.name} at station {number}: its rotor's inertia is stated, but it has no output "
                    "spool_speed; leave out one or map the other"
                )
        inertia = [jet.spin * engine.rotor_inertia for jet, engine in zip(jets, engines, strict=True)]
        turning = [(i, jet.servo == "left") for i, jet in enumerate(jets) if inertia[i]]
        self._left: list[tuple[int, float]] = [(i, inertia[i]) for i, on_left in turning if on_left]
        self._right: list[tuple[int, float]] = [(i, inertia[i]) for i, on_left in turning if not on_left]
        self.any = bool(self._left or self._right)
        self._step = step
        self.momentum: Vector3 = (0.0, 0.0, 0.0)  # kg m^2/s, body

    def reset(self, speeds: PerJet) -> None:
        """The rotors turn at ``speeds`` [rad/s], jets upright."""
        self.momentum = self._sum(speeds, (0.0, 0.0))

    def update(self, speeds: PerJet, tilt: tuple[float, float]) -> Vector3:
        """``-dH/dt`` [N m], body, for the speeds [rad/s] and tilts [rad] at the end of the step."""
        x, y, z = self.momentum
        self.momentum = a, b, c = self._sum(speeds, tilt)
        step = self._step
        return ((x - a) / step, (y - b) / step, (z - c) / step)

    def moment(self, reaction: Vector3, rate: Vector3) -> Vector3:
        """The whole moment [N m]: ``reaction`` of :meth:`update` less ``omega x H`` at body rates ``rate`` [rad/s]."""
        x, y, z = cross(rate, self.momentum)
        return (reaction[0] - x, reaction[1] - y, reaction[2] - z)

    def _sum(self, speeds: PerJet, tilt: tuple[float, float]) -> Vector3:
        left = right = 0.0
        for i, inertia in self._left:
            left += inertia * speeds[i]
        for i, inertia in self._right:
            right += inertia * speeds[i]
        left_x, _, left_z = jet_axis(tilt[0])
        right_x, _, right_z = jet_axis(tilt[1])
        return (left * left_x + right * right_x, 0.0, left * left_z + right * right_z)
