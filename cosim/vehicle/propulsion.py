"""Propulsion: from throttles and tilts to forces and moments on the airframe.

Engines with all that stands around them (:mod:`cosim.engine.wrappers`), the servos that tilt them, their rotors, their
intakes, the tank, the banks' reaction and what the ground does to the jets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from math import nan
from operator import mul
from typing import Any

from cosim.base.frames import (
    conjugate,
    cross,
    rotate,
)
from cosim.base.layout import UP
from cosim.base.signals import (
    NO_JETS,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Ambient,
    EngineOutput,
    PerJet,
    PerServo,
    State,
    Vector3,
)
from cosim.engine.wrappers import EngineChain
from cosim.spec.vehicle import Hinge, Jet, layout_of
from cosim.vehicle.parts.banks import Banks
from cosim.vehicle.parts.ground_effect import GroundJets
from cosim.vehicle.parts.hinges import HingeReactions
from cosim.vehicle.parts.intakes import IntakeDrag
from cosim.vehicle.parts.rotors import RotorDynamics
from cosim.vehicle.parts.servo import TiltServo
from cosim.vehicle.parts.tank import Tank


class Propulsion:
    """Everything between the actuators' commands and the airframe; a part that the vehicle has not is None.

    ``jets`` as they stand on the vehicle that flies; ``air()``: static pressure [Pa] and temperature [K] where it is.
    ``aside``: of each engine what it gives beside its thrust, of ``ASIDE`` in :mod:`cosim.engine.fmu.port_kinds`.
    An engine that gives a torque has no other reaction: ``reaction_m`` of its jet does not act.
    After a step ``output``, ``tilt``, ``fuel`` and ``spool_moment`` say what the parts did over it; ``momentum`` of the
    rotors (kg m^2/s, body) and ``burnt`` (kg, of a full tank) are the airframe's to carry.
    """

    def __init__(
        self,
        jets: Sequence[Jet],
        engines: EngineChain,
        servos: Sequence[TiltServo],
        rotors: RotorDynamics | None,
        tank: Tank | None,
        banks: Banks | None,
        streams: IntakeDrag | None,
        ground: GroundJets | None,
        air: Callable[[], tuple[float, float]],
        hinges: Sequence[Hinge] = (),
        reactions: HingeReactions | None = None,
        aside: Sequence[AbstractSet[str]] = (),
    ) -> None:
        self.engines = engines
        self.servos = list(servos)
        self.rotors, self.tank, self.banks, self.streams = rotors, tank, banks, streams
        self._suckdown = ground if ground is not None and ground.suckdown else None
        self._hot_gas = ground if ground is not None and ground.hot_gas else None
        self._air = air
        self._layout = layout_of(jets, hinges)
        self._jets = len(self._layout.stations)
        self._places: list[Vector3] = [jet.position_m for jet in jets]
        self._aside = bool(aside)
        self._gives: list[tuple[bool, bool, bool]] = [
            ("force_forward" in outputs, "force_right" in outputs, "torque" in outputs) for outputs in aside
        ]
        self._reactions = tuple(
            0.0 if aside and "torque" in aside[index] else jet.reaction_m for index, jet in enumerate(jets)
        )
        self._reacting = any(self._reactions)
        self._straight_up = not self._layout.turns and all(station.axis == UP for station in self._layout.stations)
        self._hinges = reactions
        self._rest = tuple([servo.angle for servo in servos]) or (0.0, 0.0)
        self._wind = ZERO3
        self.gusts: list[Vector3] = []  # m/s NED, of the wind at each jet beyond that at the vehicle; none: it is one
        self._forget()

    def _forget(self) -> None:
        self.tilt = self._rest  # where the servos stand
        self.output = EngineOutput((), (), (), ())
        self.fuel = nan  # kg on board at the step's beginning
        self.momentum = ZERO3
        self.spool_moment: Any = UNKNOWN3  # a vector, kept as the object that goes into the log
        self._off = NO_JETS  # as last asked for

    @property
    def wants_ambient(self) -> bool:
        """The air around the engines changes what they give: :meth:`reset` is to be told where the vehicle stands."""
        return self.engines.wants_ambient

    @property
    def burnt(self) -> float:
        """Fuel that is gone from a full tank, kg."""
        return self.tank.burnt if self.tank is not None else 0.0

    @property
    def remaining(self) -> float | None:
        """Share of a full tank that is on board; None without one."""
        return self.tank.left / self.tank.mass if self.tank is not None else None

    def refuel(self) -> None:
        """As at the start of a flight."""
        if self.tank is not None:
            self.tank.reset()

    def reset(self, throttle: PerJet, state: State | None, wind: Vector3, off: bool = False) -> list[Vector3]:
        """Engines at rest at ``throttle``, jets upright, nothing faulty: the forces, N, body, at each jet's station.

        ``state`` for engines that want to know the air; ``wind`` at the start, m/s NED; ``off``: no engine runs.
        """
        self._forget()
        self._wind = wind  # JSBSim knows of none before its first run
        for servo in self.servos:
            servo.reset()
        if self.banks is not None:
            self.banks.reset()
        if self._hinges is not None:
            self._hinges.reset()
        ambient = self.ambient(state, wind) if state is not None else None
        self.output = self.engines.reset(throttle, ambient)
        if off:
            self._off = frozenset(range(self._jets))
            self.output = self.engines.stop()
        if self.rotors is not None:
            self.rotors.reset(self.output.spool_speed)
            self.momentum = self.rotors.momentum
        forces = self.forces(self.output.thrust, self.tilt)
        if self._aside:
            across, _ = self.beside(self.output, self.tilt)
            forces = [_plus(force, more) for force, more in zip(forces, across, strict=True)]
        return forces

    def step(self, k: int, actuation: Actuation, state: State) -> tuple[list[Vector3], Vector3]:
        """Over step ``k`` from ``state``: a force at each jet's station [N, body] and a moment beside them [N m, body].

        Thrust and tilt are those of the step's end.  Raises EngineError.
        """
        if actuation.off is not self._off:
            self._switch(actuation.off)
        ambient = self.ambient(state, state.wind if k else self._wind) if self.engines.wants_ambient else None
        output = self.output = self.engines.step(k, actuation.throttle, ambient)
        if self.servos:
            commanded = actuation.tilt
            self.tilt = tuple([servo.update(commanded[i]) for i, servo in enumerate(self.servos)])
        tilt = self.tilt
        if self.tank is not None:
            self._burn(self.tank, output.fuel_flow)
        moment = ZERO3
        if self._reacting:
            moment = self._reaction(output.thrust, tilt)
        if self.rotors is not None:
            change = self.rotors.update(output.spool_speed, tilt)
            self.momentum = self.rotors.momentum
            self.spool_moment = self.rotors.moment(change, state.rate)
            moment = _plus(change, moment)
        forces = self.forces(output.thrust, tilt)
        if self._aside:
            # across a jet as it stands; where the ground's suction is of the thrust alone, it is so of what is along it
            across, torque = self.beside(output, tilt)
            moment = _plus(moment, torque)
        if self._suckdown is not None:  # of the thrust alone
            forces, more = self._suckdown.act(forces, state)
            moment = _plus(moment, more)
        if self._aside:
            forces = [_plus(force, more) for force, more in zip(forces, across, strict=True)]
        if self.streams is not None:
            forces, more = self.streams.act(forces, output.thrust, tilt, state, self.gusts)
            moment = _plus(moment, more)
        if self.banks is not None:
            forces, more = self.banks.act(forces, tilt, state.rate)
            moment = _plus(moment, more)
        if self._layout.moves:
            pushes = self.forces(output.thrust, tilt)
            if self._aside:
                pushes = [_plus(force, more) for force, more in zip(pushes, across, strict=True)]
            moment = _plus(moment, self._carried(pushes, tilt))
        if self._hinges is not None:
            push, more = self._hinges.act(tilt, state.rate)
            x, y, z = forces[0]
            forces[0] = (x + push[0], y + push[1], z + push[2])
            moment = _plus(moment, more)
        return forces, moment

    def _reaction(self, thrust: PerJet, tilt: PerServo) -> Vector3:
        """What the rotors' drag turns the frame with, about the jets' own axes."""
        if self._straight_up:
            return (0.0, 0.0, sum(map(mul, self._reactions, thrust)))
        axes, groups = self._layout.axes(tilt), self._layout.groups
        mx = my = mz = 0.0
        for jet, reaction in enumerate(self._reactions):
            x, y, z = axes[groups[jet]]
            size = -reaction * thrust[jet]
            mx, my, mz = mx + size * x, my + size * y, mz + size * z
        return (mx, my, mz)

    def standing(self, thrust: PerJet, tilt: PerServo) -> tuple[list[Vector3], Vector3]:
        """What thrusts do with the servos standing: a force at each jet's station, and the moment beside them."""
        forces = self.forces(thrust, tilt)
        moment = self._reaction(thrust, tilt) if self._reacting else ZERO3
        return forces, _plus(moment, self._carried(forces, tilt)) if self._layout.moves else moment

    def _carried(self, pushes: Sequence[Vector3], tilt: PerServo) -> Vector3:
        """What forces have in moment because hinges carry their jets away from the stations where they are handed
        over."""
        standing = self._layout.standing(tilt)
        moment = ZERO3
        for jet, push in enumerate(pushes):
            x, y, z = standing[jet]
            at_x, at_y, at_z = self._places[jet]
            moment = _plus(moment, cross((x - at_x, y - at_y, z - at_z), push))
        return moment

    def _switch(self, off: frozenset[int]) -> None:
        """Shut off what is to be off, and let what no longer is run again, where there is fuel."""
        for jet in sorted(off - self._off):
            self.engines.switch(jet, False)
        if self.tank is None or not self.tank.empty:
            for jet in sorted(self._off - off):
                self.engines.switch(jet, True)
        self._off = off

    def _burn(self, tank: Tank, flows: PerJet) -> None:
        """Burn a step's fuel, and shut all engines off when there is none left."""
        self.fuel = tank.left
        if tank.burn(flows) and tank.empty:
            for jet in range(self._jets):
                self.engines.switch(jet, False)

    def forces(self, thrust: PerJet, tilt: PerServo) -> list[Vector3]:
        """Each jet's thrust along its own turned axis: N, body."""
        layout = self._layout
        answer = [ZERO3] * self._jets
        for group, jets in enumerate(layout.members):
            x, y, z = layout.axis(group, tilt)
            for jet in jets:
                newton = thrust[jet]
                answer[jet] = (newton * x, newton * y, newton * z)
        return answer

    def beside(self, output: EngineOutput, tilt: PerServo) -> tuple[list[Vector3], Vector3]:
        """What the engines do beside their thrust: a force at each jet's station [N, body], and a moment [N m, body].

        The jet's frame is the body's, turned with the thrust by the least turn from straight up to the jet's axis and
        then by its hinges: on a bank at a tilt t thrust is along ``(sin t, 0, -cos t)``, forward
        ``(cos t, 0, sin t)``, right ``(0, 1, 0)``; the torque is about the thrust.
        """
        frames = self._layout.frames(tilt)
        forces: list[Vector3] = []
        moment = ZERO3
        for jet, group in enumerate(self._layout.groups):
            (x, y, z), (a, b, c), (d, e, f) = frames[group]
            has_forward, has_right, has_torque = self._gives[jet]
            forward = output.force_forward[jet] if has_forward else 0.0
            right = output.force_right[jet] if has_right else 0.0
            forces.append((forward * a + right * d, forward * b + right * e, forward * c + right * f))
            if has_torque:
                torque = output.torque[jet]
                moment = _plus(moment, (torque * x, torque * y, torque * z))
        return forces, moment

    def ambient(self, state: State, wind: Vector3) -> Ambient:
        """The air at the engines: the vehicle's, and what blows into each intake along its jet as it stands.

        The intake moves with the vehicle's velocity and its rates; ``wind`` (m/s NED, gusts and turbulence included)
        is that at the vehicle, :attr:`gusts` what each engine has beyond it.
        """
        vx, vy, vz = state.velocity
        wx, wy, wz = wind
        u, v, w = rotate(conjugate(state.attitude), (vx - wx, vy - wy, vz - wz))
        kinds: list[tuple[float, Vector3]] = []
        axes, groups, standing = self._layout.axes(self.tilt), self._layout.groups, self._layout.standing(self.tilt)
        for axis in axes:
            x, y, z = axis
            kinds.append((u * x + v * y + w * z, cross(axis, state.rate)))
        speeds: list[float] = []
        for jet, group in enumerate(groups):
            # (velocity + rate x place) . axis = velocity . axis + place . (axis x rate)
            along, (by_x, by_y, by_z) = kinds[group]
            x, y, z = standing[jet]
            speeds.append(along + by_x * x + by_y * y + by_z * z)
        if self.gusts:
            back = conjugate(state.attitude)
            for jet, gust in enumerate(self.gusts):
                a, b, c = rotate(back, gust)
                x, y, z = axes[groups[jet]]
                speeds[jet] -= a * x + b * y + c * z
        pressure, temperature = self._air()
        if self._hot_gas is not None:
            temperature += self._hot_gas.rise(state.altitude)
        return Ambient(pressure, temperature, tuple(speeds))

    def close(self) -> None:
        """Free the engines; may be called twice."""
        self.engines.close()


def _plus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
