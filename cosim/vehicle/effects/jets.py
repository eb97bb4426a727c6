"""Effects of jets beside their thrust.

They are the reaction of what turns in the jets, an engine's side force, and the moment of thrust that a hinge has
carried away from its station."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from operator import mul

from cosim.base.frames import cross
from cosim.base.layout import UP, Layout
from cosim.base.signals import ZERO3, Vector3
from cosim.vehicle.effects.effect import Effect, Load, add_forces, add_vectors


class JetReactions(Effect):
    """Effect of the rotors' drag torques on the frame, about the jets' axes: ``reactions`` [m] times thrust."""

    acts_at_rest = True

    def __init__(self, layout: Layout, reactions: Sequence[float]) -> None:
        self._layout, self._reactions = layout, tuple(reactions)
        self._straight_up = not layout.turns and all(station.axis == UP for station in layout.stations)

    def add_to(self, load: Load) -> None:
        thrust = load.output.thrust
        if self._straight_up:
            load.add_moment((0.0, 0.0, sum(map(mul, self._reactions, thrust))))
            return
        axes, groups = load.axes, self._layout.groups
        mx = my = mz = 0.0
        for jet, reaction in enumerate(self._reactions):
            x, y, z = axes[groups[jet]]
            size = -reaction * thrust[jet]
            mx, my, mz = mx + size * x, my + size * y, mz + size * z
        load.add_moment((mx, my, mz))


class EngineTorques(Effect):
    """Effect of torques that engines report, about the jets' axes, right-handed along thrust.

    ``outputs``: of each engine, of ``SIDE_LOADS`` in :mod:`cosim.engine.fmu.port_kinds`.
    """

    def __init__(self, layout: Layout, outputs: Sequence[AbstractSet[str]]) -> None:
        self._layout = layout
        self._give = [jet for jet, ports in enumerate(outputs) if "torque" in ports]

    def add_to(self, load: Load) -> None:
        axes, groups, torques = load.axes, self._layout.groups, load.output.torque
        moment = ZERO3
        for jet in self._give:
            x, y, z = axes[groups[jet]]
            torque = torques[jet]
            moment = add_vectors(moment, (torque * x, torque * y, torque * z))
        load.add_moment(moment)


class EngineSideForces(Effect):
    """Effect of forces that engines report across their thrust.

    The jet's frame is the body's, turned with the thrust by the least turn from straight up to the jet's axis and then
    by its hinges: on a bank at a tilt t thrust is along ``(sin t, 0, -cos t)``, forward ``(cos t, 0, sin t)``, right
    ``(0, 1, 0)``.  ``outputs`` as for :class:`EngineTorques`.
    """

    def __init__(self, layout: Layout, outputs: Sequence[AbstractSet[str]]) -> None:
        self._layout = layout
        self._give: list[tuple[bool, bool]] = [("force_forward" in ports, "force_right" in ports) for ports in outputs]

    def start(self, load: Load) -> None:
        self.add_to(load)

    def add_to(self, load: Load) -> None:
        frames, output = self._layout.frames(load.tilt), load.output
        across: list[Vector3] = []
        for jet, group in enumerate(self._layout.groups):
            _, (a, b, c), (d, e, f) = frames[group]
            has_forward, has_right = self._give[jet]
            forward = output.force_forward[jet] if has_forward else 0.0
            right = output.force_right[jet] if has_right else 0.0
            across.append((forward * a + right * d, forward * b + right * e, forward * c + right * f))
        load.forces, load.engine_forces = add_forces(load.forces, across), add_forces(load.engine_forces, across)


class CarriedJets(Effect):
    """Effect of hinges that carry jets away from their stations: the moment of the jets' forces."""

    acts_at_rest = True

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def add_to(self, load: Load) -> None:
        positions, places = load.positions, self._layout.rest_positions
        moment = ZERO3
        for jet, push in enumerate(load.engine_forces):
            x, y, z = positions[jet]
            at_x, at_y, at_z = places[jet]
            moment = add_vectors(moment, cross((x - at_x, y - at_y, z - at_z), push))
        load.add_moment(moment)
