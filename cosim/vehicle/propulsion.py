"""Propulsion: from throttles and tilts to forces and moments on the airframe.

Engines with their wrappers (:mod:`cosim.engine.wrappers`), the servos that tilt them, the tank, and the effects beside
thrust (:mod:`cosim.vehicle.effects`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from typing import Any

from cosim.base.frames import conjugate, cross, rotate
from cosim.base.signals import NO_JETS, ZERO3, Actuation, Ambient, EngineOutput, PerJet, PerServo, State, Vector3
from cosim.engine.wrappers import EngineChain
from cosim.spec.vehicle import Hinge, Jet, Vehicle, layout_of
from cosim.vehicle.effects.effect import NO_OUTPUT, Effect, Load
from cosim.vehicle.effects.ground_effect import HotGas
from cosim.vehicle.servo import TiltServo, make_servos
from cosim.vehicle.tank import Tank


class Propulsion:
    """Engines, servos, tank and effects, between the actuators' commands and the airframe.

    ``jets`` as they stand on the vehicle that flies; ``effects``: what acts beside thrust, in order, of a vehicle that
    has any; ``air()``: static pressure [Pa] and temperature [K] where it is; ``hot_gas`` that engines swallow.
    After a step ``output``, ``tilt``, ``fuel`` and ``spool_moment`` say what the parts did over it; ``momentum`` of the
    rotors (kg m^2/s, body) and ``burnt`` (kg, of a full tank) act on the airframe.
    """

    def __init__(
        self,
        jets: Sequence[Jet],
        engines: EngineChain,
        servos: Sequence[TiltServo],
        effects: Sequence[Effect],
        tank: Tank | None,
        air: Callable[[], tuple[float, float]],
        hinges: Sequence[Hinge] = (),
        hot_gas: HotGas | None = None,
    ) -> None:
        self.engines = engines
        self.servos = list(servos)
        self.effects = list(effects)
        self.tank = tank
        self._hot_gas, self._air = hot_gas, air
        self._layout = layout_of(jets, hinges)
        self._jets = len(self._layout.stations)
        self._load = Load(self._layout)
        self._rest = tuple([servo.angle for servo in servos]) or (0.0, 0.0)
        self._wind = ZERO3
        self.gusts: list[Vector3] = []  # extra wind at each jet, m/s NED
        self._clear_state()

    def _clear_state(self) -> None:
        self.tilt = self._rest
        self.output = NO_OUTPUT
        self.fuel = nan  # fuel at the start of the step, kg
        self._load.clear()
        self._off = NO_JETS  # jets last commanded off

    @property
    def wants_ambient(self) -> bool:
        """Whether the engines depend on the air, so that :meth:`reset` needs the initial state."""
        return self.engines.wants_ambient

    @property
    def tilt(self) -> PerServo:
        return self._load.tilt

    @tilt.setter
    def tilt(self, angles: PerServo) -> None:
        self._load.set_tilt(angles)

    @property
    def momentum(self) -> Vector3:
        """Angular momentum of the rotors at the step's end, kg m^2/s, body."""
        return self._load.momentum

    @property
    def spool_moment(self) -> Any:
        """The moment of the rotors on the airframe, N m, body; NaN without rotors."""
        return self._load.spool_moment

    @property
    def burnt(self) -> float:
        """Fuel burnt since the tank was full, kg."""
        return self.tank.burnt if self.tank is not None else 0.0

    @property
    def remaining(self) -> float | None:
        """Fraction of a full tank that is on board; None without a tank."""
        return self.tank.remaining / self.tank.mass if self.tank is not None else None

    def refuel(self) -> None:
        """Fill the tank as at the start of a flight."""
        if self.tank is not None:
            self.tank.reset()

    def reset(self, throttle: PerJet, state: State | None, wind: Vector3, engines_off: bool = False) -> list[Vector3]:
        """Start with engines at rest at ``throttle``, jets upright, no fault; return the force at each jet [N, body].

        ``state`` is needed by engines that depend on the air; ``wind`` is that at the start [m/s, NED].
        """
        self._clear_state()
        self._wind = wind  # JSBSim has no wind before its first run
        for servo in self.servos:
            servo.reset()
        ambient = self.ambient(state, wind) if state is not None else None
        self.output = self.engines.reset(throttle, ambient)
        if engines_off:
            self._off = frozenset(range(self._jets))
            self.output = self.engines.shut_off_all()
        load = self._load
        load.begin_step(self.output, load.along_axes(self.output.thrust))
        for effect in self.effects:
            effect.start(load)
        return load.forces

    def step(self, k: int, actuation: Actuation, state: State) -> tuple[list[Vector3], Vector3]:
        """Advance step ``k``; return each jet's force [N, body] and an additional moment [N m, body].

        Thrust and tilt are those of the step's end.  Raises EngineError.
        """
        if actuation.off is not self._off:
            self._switch_engines(actuation.off)
        ambient = self.ambient(state, state.wind if k else self._wind) if self.engines.wants_ambient else None
        output = self.output = self.engines.step(k, actuation.throttle, ambient)
        if self.servos:
            commanded = actuation.tilt
            self.tilt = tuple([servo.update(commanded[i]) for i, servo in enumerate(self.servos)])
        if self.tank is not None:
            self.fuel = self.tank.remaining
            if self.tank.burn(output.fuel_flow) and self.tank.empty:
                for jet in range(self._jets):
                    self.engines.switch_engine(jet, False)
        load = self._load
        load.state, load.gusts = state, self.gusts
        load.begin_step(output, load.along_axes(output.thrust))
        for effect in self.effects:
            effect.add_to(load)
        return load.forces, load.moment

    def forces_at_rest(self, thrust: PerJet, tilt: PerServo) -> tuple[list[Vector3], Vector3]:
        """Return the force at each jet [N, body] and the further moment [N m, body] of thrusts with servos at rest."""
        load = Load(self._layout)
        load.set_tilt(tilt)
        load.begin_step(EngineOutput(thrust, (), (), ()), load.along_axes(thrust))
        for effect in self.effects:
            if effect.acts_at_rest:
                effect.add_to(load)
        return load.forces, load.moment

    def _switch_engines(self, off: frozenset[int]) -> None:
        """Switch engines off, and restart those that are no longer commanded off if there is fuel."""
        for jet in sorted(off - self._off):
            self.engines.switch_engine(jet, False)
        if self.tank is None or not self.tank.empty:
            for jet in sorted(self._off - off):
                self.engines.switch_engine(jet, True)
        self._off = off

    def ambient(self, state: State, wind: Vector3) -> Ambient:
        """Return the air at the engines: pressure and temperature, and the air speed into each intake.

        The intake moves with the vehicle's velocity and its rates; ``wind`` (m/s NED, gusts and turbulence included)
        is that at the vehicle, :attr:`gusts` what each engine has beyond it.
        """
        vx, vy, vz = state.velocity
        wx, wy, wz = wind
        u, v, w = rotate(conjugate(state.attitude), (vx - wx, vy - wy, vz - wz))
        axes, groups, positions = self._load.axes, self._layout.groups, self._load.positions
        rate, known = state.rate, -1
        along = by_x = by_y = by_z = 0.0
        speeds: list[float] = []
        for jet, group in enumerate(groups):
            # (velocity + rate x place) . axis = velocity . axis + place . (axis x rate)
            if group != known:
                known, axis = group, axes[group]
                along = u * axis[0] + v * axis[1] + w * axis[2]
                by_x, by_y, by_z = cross(axis, rate)
            x, y, z = positions[jet]
            speeds.append(along + by_x * x + by_y * y + by_z * z)
        if self.gusts:
            back = conjugate(state.attitude)
            for jet, gust in enumerate(self.gusts):
                a, b, c = rotate(back, gust)
                x, y, z = axes[groups[jet]]
                speeds[jet] -= a * x + b * y + c * z
        pressure, temperature = self._air()
        if self._hot_gas is not None:
            temperature += self._hot_gas.temperature_rise(state.altitude)
        return Ambient(pressure, temperature, tuple(speeds))

    def close(self) -> None:
        """Free the engines; may be called twice."""
        self.engines.close()


def make_propulsion(
    vehicle: Vehicle,
    flown: Vehicle,
    engines: EngineChain,
    effects: Sequence[Effect],
    air: Callable[[], tuple[float, float]],
    step: float,
    fuel: float,
) -> Propulsion:
    """Return the propulsion of a vehicle at the stations of the one that flies, with a fraction of a full tank."""
    ground = vehicle.ground_effect
    return Propulsion(
        flown.jets,
        engines,
        make_servos(vehicle, step),
        effects,
        Tank(vehicle.fuel.mass_kg, step, fuel) if vehicle.fuel else None,
        air,
        flown.hinges,
        HotGas(ground) if ground and ground.hot_gas else None,
    )
