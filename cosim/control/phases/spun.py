"""Flight of a quadrotor without one of its rotors, by :mod:`cosim.control.phases.reduced_attitude`."""

from __future__ import annotations

from cosim.base.signals import NO_JETS, ZERO3, Actuation, JetHealth, Unallocated
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.control.phases.reduced_attitude import ReducedAttitude


class SpunFlight(FlightLaw):
    """Thrust direction control without heading after one rotor failed; rate commands mean upright."""

    def __init__(self, loops: Loops, reduced: ReducedAttitude, thrust_map: ThrustMap, rotors: int) -> None:
        super().__init__(loops)
        self._reduced, self._map, self._rotors = reduced, thrust_map, rotors

    def idle(self) -> None:
        self._reduced.end()

    def applies(self, demand: Demand) -> bool:
        return self._reduced.is_flying

    def update(self, demand: Demand) -> Actuation:
        """Update as :meth:`FlightLaw.update`; the loops get all of their torque as residual."""
        loops, rotors, thrust_map, command = self.loops, self._rotors, self._map, demand.command
        upright = command if command.rate is None else command._replace(attitude=ZERO3)
        total = rotors * (thrust_map.low + thrust_map.span * demand.collective)
        (roll, pitch, yaw), disturbance = loops.inject(ZERO3, demand.injected), demand.injected.torque_command
        added_torque = (roll + disturbance[0], pitch + disturbance[1], yaw + disturbance[2])
        direction = loops.attitude.direction(upright, demand.measured)
        throttle, thrust = self._reduced.update(direction, demand.measured.rate, total, added_torque)
        demand.allocated = (thrust / rotors - thrust_map.low) / thrust_map.span
        torque, demand.torque = demand.torque, ZERO3
        demand.unallocated = Unallocated(torque[0], torque[1], torque[2], demand.collective - demand.allocated)
        return Actuation(throttle, loops.allocator.rest, demand.unallocated, NO_JETS)

    def handle_loss(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Begin the spinning flight when the first rotor fails; shut off no other."""
        failed = [i for i, health in enumerate(monitor.health) if health == JetHealth(0.0)]
        if len(failed) == 1 and not self._reduced.is_flying:
            self._reduced.begin(failed[0], monitor.reported_thrust, monitor.commanded_thrust)
        return NO_JETS

    def observe(self, monitor: EngineMonitor) -> None:
        if self._reduced.is_flying:
            self._reduced.observe(monitor.reported_thrust)
