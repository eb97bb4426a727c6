"""Flight without two engines across from each other: the second is shut off because the first is lost."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.constants import GRAVITY
from cosim.base.signals import NO_JETS, Actuation, JetHealth, Unallocated
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.phases.catch import Catch
from cosim.control.phases.law import Demand, FlightLaw, Loops


class ShutOpposite(FlightLaw):
    """With the first engine lost shut off the one across: its thrust goes the same way, and the moment with it.

    ``opposites``: for every jet, from 0, the one across; ``catch`` flies from then on until the thrust is made up for,
    where there is one; ``mass`` [kg] of the vehicle, tank full.
    """

    def __init__(self, loops: Loops, opposites: Sequence[int], catch: Catch | None, mass: float) -> None:
        super().__init__(loops)
        self._opposites, self._catch, self._mass = list(opposites), catch, mass
        self._catching = False  # an engine is lost, and what that leaves is not yet in balance

    def idle(self) -> None:
        self._catching = False

    def wants(self, step: Demand) -> bool:
        return self._catching and step.command.rate is None

    def update(self, step: Demand) -> Actuation:
        """As :meth:`FlightLaw.update`, roll and collective by the catch; the loops learn that theirs were not given."""
        loops, catch, command, measured = self.loops, self._catch, step.command, step.measured
        assert catch is not None
        climb = 0.0 if command.collective is not None else loops.altitude.climb(command.altitude - measured.altitude)
        roll, collective = catch.update(
            -loops.attitude.error(command, measured)[0],
            measured.rate[0],
            -measured.velocity[2],
            climb,
            step.upright,
            self._mass - step.burnt,
        )
        if command.collective is not None:
            collective = max(catch.least, command.collective)
        elif catch.caught:
            self._catching = False
        torque, usual, injected = step.torque, step.collective, step.injected
        step.torque, step.collective = (roll, torque[1], torque[2]), collective
        given = loops.allocator.allocate(collective, loops.inject(step.torque, injected), injected.torque_command)
        left = given.unallocated
        catch.asked(roll - left.roll, collective - left.collective)
        step.given = collective - left.collective
        step.unallocated = Unallocated(torque[0] - (roll - left.roll), left.pitch, left.yaw, usual - step.given)
        return given

    def lose(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Give up the engine across the first one that is lost, and begin the catch."""
        ill = [i for i, gain in enumerate(monitor.gains) if gain < 1.0]
        if len(ill) != 1 or monitor.health[ill[0]] != JetHealth(0.0):
            return NO_JETS
        across = self._opposites[ill[0]]
        monitor.give_up(across)
        if self._catch is not None:
            self._catching = True
            self._catch.reset(monitor.reported, monitor.gains, (self._mass - burnt) * GRAVITY)
        return frozenset([across])

    def look(self, monitor: EngineMonitor) -> None:
        if self._catching and self._catch is not None:
            self._catch.look(monitor.reported, monitor.gains)
