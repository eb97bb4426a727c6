"""Hover of vehicles with hinges and surfaces."""

from __future__ import annotations

from cosim.base.signals import Actuation, Vector3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.hinged_catch import HingedCatch
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.control.phases.wing import dynamic_pressure


class SurfaceHover(FlightLaw):
    """Hover with surfaces, which turn the vehicle by the air that comes from ahead."""

    def __init__(self, loops: Loops, allocator: EffectivenessAllocator) -> None:
        super().__init__(loops)
        self._allocator = allocator

    def update(self, step: Demand) -> Actuation:
        """As :meth:`FlightLaw.update`, with the pressure of the speed over the ground."""
        self._allocator.pressure = dynamic_pressure(step.measured)
        return super().update(step)


class HingedLean(FlightLaw):
    """Hover without an engine on hinges that carry engines: it leans against what they push aside.

    The allocator's pressure is left alone: :meth:`HingedCatch.allocate` takes it for zero while an engine is out.
    """

    def __init__(self, loops: Loops, allocator: HingedCatch) -> None:
        super().__init__(loops)
        self._allocator = allocator

    def wants(self, step: Demand) -> bool:
        return self._allocator.leans and self.loops.own_attitude is None

    def steer(self, step: Demand) -> Vector3:
        """Return rates to the thrust's direction first; the heading only stops turning."""
        return self.loops.attitude.thrust_first(step.command, step.measured, self._allocator.lean)

    def look(self, monitor: EngineMonitor) -> None:
        self._allocator.look(monitor.reported)
