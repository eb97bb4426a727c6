"""Gyroscopic moments of the engines' rotors on the airframe."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import InputError
from cosim.base.frames import cross
from cosim.base.signals import PerJet, PerServo, Vector3
from cosim.engine import EngineSpec
from cosim.spec.vehicle import Hinge, Jet, layout_of
from cosim.vehicle.effects.effect import Effect, Load


class RotorDynamics(Effect):
    """Effect of the angular momentum of all rotors against the airframe, and of its change from step to step.

    ``H = sum s J w e``: spin s of the station, inertia J and speed w of its engine, e the jet's tilted axis.  On the
    airframe acts ``M = -dH/dt - omega x H``, where dH/dt is taken in the body frame and contains both the spools'
    acceleration and the turning of the axes with the tilt.  ``inertia_kg_m2`` of the vehicle contains the rotors, as if
    they stood still, and w is what a sensor on the engine's case counts: nothing else is owed to them.

    Discretised: H is held over a step at its value at the step's end, like the thrust, and dH/dt is the difference
    from the step before, so that the impulse on the airframe is exact.  The airframe adds ``-omega x H`` itself.
    """

    def __init__(
        self, jets: Sequence[Jet], engines: Sequence[EngineSpec], step: float, hinges: Sequence[Hinge] = ()
    ) -> None:
        for number, (jet, engine) in enumerate(zip(jets, engines, strict=True), 1):
            if jet.spin and engine.rotor_inertia and not engine.has_port("spool_speed"):
                raise InputError(
                    f"engine {engine.name} at station {number}: its rotor's inertia is stated, but it has no output "
                    "spool_speed; leave out one or map the other"
                )
        inertia = [jet.spin * engine.rotor_inertia for jet, engine in zip(jets, engines, strict=True)]
        self._layout = layout_of(jets, hinges)
        self._rest = tuple([hinge.rest_rad for hinge in hinges]) or (0.0, 0.0)
        # For each group of jets that turn together: its number and its rotors.
        self._groups: list[tuple[int, list[tuple[int, float]]]] = []
        for group in range(max(self._layout.groups) + 1):
            turning = [
                (i, inertia[i]) for i, number in enumerate(self._layout.groups) if number == group and inertia[i]
            ]
            if turning:
                self._groups.append((group, turning))
        self.is_active = bool(self._groups)
        self._step = step
        self.momentum: Vector3 = (0.0, 0.0, 0.0)  # of all rotors, kg m^2/s, body

    def start(self, load: Load) -> None:
        self.reset(load.output.spool_speed)
        load.momentum = self.momentum

    def add_to(self, load: Load) -> None:
        """Add ``-dH/dt`` to the load, and store momentum and whole moment for airframe and log."""
        change = self._momentum_rate(load.output.spool_speed, load.axes)
        load.momentum = self.momentum
        load.spool_moment = self.moment(change, load.state.rate)
        load.add_moment(change)

    def reset(self, speeds: PerJet) -> None:
        """Start with the rotors turning at ``speeds`` [rad/s], hinges at rest."""
        self.momentum = self._total_momentum(speeds, self._layout.axes(self._rest))

    def update(self, speeds: PerJet, tilt: PerServo) -> Vector3:
        """Return ``-dH/dt`` [N m, body] for the speeds [rad/s] and tilts [rad] at the end of the step."""
        return self._momentum_rate(speeds, self._layout.axes(tilt))

    def _momentum_rate(self, speeds: PerJet, axes: Sequence[Vector3]) -> Vector3:
        """Return ``-dH/dt`` [N m, body] for the speeds [rad/s] and thrust axes at the end of the step."""
        x, y, z = self.momentum
        self.momentum = a, b, c = self._total_momentum(speeds, axes)
        step = self._step
        return ((x - a) / step, (y - b) / step, (z - c) / step)

    def moment(self, reaction: Vector3, rate: Vector3) -> Vector3:
        """Return the moment [N m]: ``reaction`` of :meth:`update` less ``omega x H`` at body rates ``rate`` [rad/s]."""
        x, y, z = cross(rate, self.momentum)
        return (reaction[0] - x, reaction[1] - y, reaction[2] - z)

    def _total_momentum(self, speeds: PerJet, axes: Sequence[Vector3]) -> Vector3:
        x = y = z = 0.0
        for group, rotors in self._groups:
            momentum = 0.0
            for i, inertia in rotors:
                momentum += inertia * speeds[i]
            ax, ay, az = axes[group]
            x, y, z = x + momentum * ax, y + momentum * ay, z + momentum * az
        return (x, y, z)
