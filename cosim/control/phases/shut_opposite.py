"""Flight without two engines across from each other: the second is shut off because the first is lost."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.constants import GRAVITY
from cosim.base.signals import NO_JETS, Actuation, JetHealth, Unallocated
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.control.phases.recovery import Recovery


class ShutOpposite(FlightLaw):
    """Flight law that shuts off the engine opposite to the first failed one, and flies with the others.

    ``opposites``: for every jet, from 0, the opposite one; ``recovery`` flies until the thrust is made up for, where
    there is one; ``mass`` [kg] of the vehicle, tank full.
    """

    def __init__(self, loops: Loops, opposites: Sequence[int], recovery: Recovery | None, mass: float) -> None:
        super().__init__(loops)
        self._opposites, self._recovery, self._mass = list(opposites), recovery, mass
        self._is_recovering = False

    def idle(self) -> None:
        self._is_recovering = False

    def applies(self, demand: Demand) -> bool:
        return self._is_recovering and demand.command.rate is None

    def update(self, demand: Demand) -> Actuation:
        """Update as :meth:`FlightLaw.update`, with the recovery's roll and collective."""
        loops, recovery, command, measured = self.loops, self._recovery, demand.command, demand.measured
        assert recovery is not None
        climb = 0.0 if command.collective is not None else loops.altitude.climb(command.altitude - measured.altitude)
        roll, collective = recovery.update(
            -loops.attitude.error(command, measured)[0],
            measured.rate[0],
            -measured.velocity[2],
            climb,
            demand.upright,
            self._mass - demand.burnt,
        )
        if command.collective is not None:
            collective = max(recovery.least_collective, command.collective)
        elif recovery.is_complete:
            self._is_recovering = False
        torque, nominal, injected = demand.torque, demand.collective, demand.injected
        demand.torque, demand.collective = (roll, torque[1], torque[2]), collective
        actuation = loops.allocator.allocate(collective, loops.inject(demand.torque, injected), injected.torque_command)
        residual = actuation.unallocated
        recovery.record_command(roll - residual.roll, collective - residual.collective)
        demand.allocated = collective - residual.collective
        demand.unallocated = Unallocated(
            torque[0] - (roll - residual.roll), residual.pitch, residual.yaw, nominal - demand.allocated
        )
        return actuation

    def handle_loss(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Return the engine opposite to the first failed one, and begin the recovery."""
        failed = [i for i, gain in enumerate(monitor.gains) if gain < 1.0]
        if len(failed) != 1 or monitor.health[failed[0]] != JetHealth(0.0):
            return NO_JETS
        opposite = self._opposites[failed[0]]
        monitor.mark_shut_off(opposite)
        if self._recovery is not None:
            self._is_recovering = True
            self._recovery.reset(monitor.reported_thrust, monitor.gains, (self._mass - burnt) * GRAVITY)
        return frozenset([opposite])

    def observe(self, monitor: EngineMonitor) -> None:
        if self._is_recovering and self._recovery is not None:
            self._recovery.observe(monitor.reported_thrust, monitor.gains)
