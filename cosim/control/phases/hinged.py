"""Hover of vehicles with hinges and surfaces."""

from __future__ import annotations

from cosim.base.signals import Actuation, Vector3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.hinged_recovery import HingedRecovery
from cosim.control.phases.law import Demand, FlightLaw, Loops
from cosim.control.phases.wing import WingFlight, dynamic_pressure


class SurfaceHover(FlightLaw):
    """Hover with control surfaces, which act in forward speed."""

    def __init__(self, loops: Loops, allocator: EffectivenessAllocator) -> None:
        super().__init__(loops)
        self._allocator = allocator

    def update(self, demand: Demand) -> Actuation:
        """Update as :meth:`FlightLaw.update`, with the dynamic pressure of the speed over the ground."""
        self._allocator.pressure = dynamic_pressure(demand.measured)
        return super().update(demand)


class HingedLean(FlightLaw):
    """Hover with an engine out, in which the vehicle leans against the side force of hinges that carry engines.

    The allocator's pressure stays as it is: :meth:`HingedRecovery.allocate` assumes zero while an engine is lost.

    ``wing``: the law that flies ahead on the wing, None without one.  It keeps the flight until the vehicle is slower
    than the speed from which on the wing carries, and gets it back with a set-point beyond that speed.
    """

    def __init__(self, loops: Loops, allocator: HingedRecovery, wing: WingFlight | None = None) -> None:
        super().__init__(loops)
        self._allocator, self._wing = allocator, wing
        self._has_stopped = False

    def reset(self) -> None:
        self._has_stopped = False

    def applies(self, demand: Demand) -> bool:
        if not self._allocator.is_leaning or self.loops.custom_attitude is not None:
            return False
        wing = self._wing
        if wing is None or not wing.applies(demand):
            return True
        self._has_stopped = wing.is_slow(demand, self._has_stopped)
        return self._has_stopped

    def steer(self, demand: Demand) -> Vector3:
        """Return the body rates [rad/s] to the thrust's direction first; the heading only stops turning."""
        return self.loops.attitude.update_tilt_first(demand.command, demand.measured, self._allocator.lean)

    def observe(self, monitor: EngineMonitor) -> None:
        self._allocator.observe(monitor.reported_thrust)
