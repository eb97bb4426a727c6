"""Flight of a quadrotor without one of its rotors, by :mod:`cosim.control.phases.reduced_attitude`."""

from __future__ import annotations

from cosim.base.signals import NO_JETS, ZERO3, Actuation, JetHealth, Unallocated
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.control.phases.reduced_attitude import ReducedAttitude


class SpunFlight(FlightLaw):
    """The direction of thrust and no heading, as soon as one rotor is lost; whoever asks for rates gets it upright."""

    def __init__(self, loops: Loops, reduced: ReducedAttitude, thrust_map: ThrustMap, rotors: int) -> None:
        super().__init__(loops)
        self._reduced, self._map, self._rotors = reduced, thrust_map, rotors

    def idle(self) -> None:
        self._reduced.end()

    def wants(self, step: Demand) -> bool:
        return self._reduced.flies

    def update(self, step: Demand) -> Actuation:
        """As :meth:`FlightLaw.update`; the loops learn that nothing of their torque was given."""
        loops, every, thrust_map, command = self.loops, self._rotors, self._map, step.command
        upright = command if command.rate is None else command._replace(attitude=ZERO3)
        total = every * (thrust_map.low + thrust_map.span * step.collective)
        (roll, pitch, yaw), unknown = loops.inject(ZERO3, step.injected), step.injected.torque_command
        added = (roll + unknown[0], pitch + unknown[1], yaw + unknown[2])
        wanted = loops.attitude.direction(upright, step.measured)
        throttle, thrust = self._reduced.update(wanted, step.measured.rate, total, added)
        step.given = (thrust / every - thrust_map.low) / thrust_map.span
        torque, step.torque = step.torque, ZERO3
        step.unallocated = Unallocated(torque[0], torque[1], torque[2], step.collective - step.given)
        return Actuation(throttle, loops.allocator.rest, step.unallocated, NO_JETS)

    def lose(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Begin with the first rotor that is lost."""
        lost = [i for i, health in enumerate(monitor.health) if health == JetHealth(0.0)]
        if len(lost) == 1 and not self._reduced.flies:
            self._reduced.begin(lost[0], monitor.reported, monitor.asked)
        return NO_JETS

    def look(self, monitor: EngineMonitor) -> None:
        if self._reduced.flies:
            self._reduced.look(monitor.reported)
