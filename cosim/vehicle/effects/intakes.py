"""Drag and damping by the air that the jets swallow, which is accelerated to the vehicle's speed."""

from __future__ import annotations

from collections.abc import Sequence
from math import pow  # the pow of floats, without objects

from cosim.base.frames import conjugate, cross, rotate
from cosim.base.signals import Vector3
from cosim.spec.vehicle import Airflow, Hinge, Jet, layout_of
from cosim.vehicle.effects.effect import Effect, Load


class _AirStream:
    """Air stream of one jet: mass flow ``kg_s`` at a thrust [N], exponent, positions of intake, exhaust and station."""

    def __init__(self, flow: Airflow, station: Vector3) -> None:
        self.kg_s, self.at_thrust, self.exponent = flow.kg_s, flow.at_thrust_n, flow.exponent
        self.intake, self.exhaust = flow.intake_m, flow.exhaust_m
        self.station = station


class IntakeDrag(Effect):
    """Momentum forces of the intake streams on the airframe.

    ``m`` is one engine's mass flow, ``v`` the velocity of the centre of gravity through the air, ``e`` the jet's tilted
    axis, ``r`` its station: air enters at ``r_i = r + a e`` and leaves at ``r_o = r + b e``,

        intake drag   -m v           at r_i,
        jet damping   -m omega x r_o  at r_o,

    both across the axis: what acts along it is the engine's, which knows its air speed.  ``m = m_0 (T / T_0)^b``; the
    air at rest in the engine is left out, a few grams.  ``flow`` is that of the jets that state none of their own.
    """

    def __init__(self, flow: Airflow | None, jets: Sequence[Jet], hinges: Sequence[Hinge] = ()) -> None:
        flows = [jet.airflow or flow for jet in jets]
        self._streams = [
            None if of is None else _AirStream(of, jet.position_m) for of, jet in zip(flows, jets, strict=True)
        ]
        self.is_active = any(stream is not None for stream in self._streams)
        self._layout = layout_of(jets, hinges)

    def add_to(self, load: Load) -> None:
        """Add the streams' forces at the stations, and their moments beyond r x F."""
        state, gusts, forces = load.state, load.gusts, load.forces
        vx, vy, vz = state.velocity
        wx, wy, wz = state.wind
        through_air = rotate(conjugate(state.attitude), (vx - wx, vy - wy, vz - wz))
        axes, groups = load.axes, self._layout.groups
        moves, positions, rate = self._layout.moves, load.positions, state.rate
        total: list[Vector3] = []
        moment_x = moment_y = moment_z = 0.0
        for i, newton in enumerate(load.output.thrust):
            stream = self._streams[i]
            if stream is None:
                total.append(forces[i])
                continue
            fx, fy, fz = forces[i]
            x, y, z = positions[i]
            e = axes[groups[i]]
            a, b = stream.intake, stream.exhaust
            flow = stream.kg_s * pow(newton / stream.at_thrust, stream.exponent) if newton > 0.0 else 0.0
            outlet = (x + b * e[0], y + b * e[1], z + b * e[2])
            air_velocity = through_air
            if gusts:
                gx, gy, gz = rotate(conjugate(state.attitude), gusts[i])
                air_velocity = (through_air[0] - gx, through_air[1] - gy, through_air[2] - gz)
            drag = _component_across(air_velocity, e, -flow)
            damping = _component_across(cross(rate, outlet), e, -flow)
            total.append((fx + drag[0] + damping[0], fy + drag[1] + damping[1], fz + drag[2] + damping[2]))
            # Both forces act at the station.
            push = (a * drag[0] + b * damping[0], a * drag[1] + b * damping[1], a * drag[2] + b * damping[2])
            couple_x, couple_y, couple_z = cross(e, push)
            moment_x, moment_y, moment_z = moment_x + couple_x, moment_y + couple_y, moment_z + couple_z
            if moves:  # stated position is with hinges at zero
                at_x, at_y, at_z = stream.station
                both = (drag[0] + damping[0], drag[1] + damping[1], drag[2] + damping[2])
                couple_x, couple_y, couple_z = cross((x - at_x, y - at_y, z - at_z), both)
                moment_x, moment_y, moment_z = moment_x + couple_x, moment_y + couple_y, moment_z + couple_z
        load.forces = total
        load.add_moment((moment_x, moment_y, moment_z))


def _component_across(vector: Vector3, axis: Vector3, factor: float) -> Vector3:
    """Return ``factor`` times the component of ``vector`` normal to the unit vector ``axis``."""
    x, y, z = vector
    along = x * axis[0] + y * axis[1] + z * axis[2]
    return (factor * (x - along * axis[0]), factor * (y - along * axis[1]), factor * (z - along * axis[2]))
