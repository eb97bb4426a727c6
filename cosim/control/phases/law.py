"""The laws for the phases of a flight: their base class, the loops that they share, and their selection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from cosim.base.frames import upright
from cosim.base.protocols import Allocator, AttitudeLoop
from cosim.base.signals import NO_JETS, UNKNOWN3, ZERO3, Actuation, Command, Disturbance, Measured, Unallocated, Vector3
from cosim.control.allocation.allocation import TiltAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.altitude import MIN_UPRIGHT, AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.predictors.smith import DelayLine
from cosim.control.rate import RateController
from cosim.control.schedule import Scheduled

FULLY_ALLOCATED = Unallocated(0.0, 0.0, 0.0, 0.0)  # nothing was left unallocated


class CustomRate(Protocol):
    """A user's rate loop with the interface of the built-in one."""

    predicted: Vector3

    def reset(self) -> None: ...

    def update(self, setpoint: Vector3, measured: Vector3, unallocated: Unallocated) -> Vector3: ...

    def add_to_command(self, added: Vector3) -> None: ...


class Demand:
    """Demand of one step: command, loop outputs and allocation residual.

    ``torque``, ``collective`` and ``allocated``, the part of it per engine that was allocated, go into the log;
    ``unallocated`` is what the loops learn in the next step.
    """

    def __init__(self) -> None:
        self.command = Command(ZERO3, 0.0)
        self.measured = Measured(ZERO3, (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, 0.0)
        self.injected = Disturbance()
        self.is_idle = False  # the engines idle or are off
        self.burnt = 0.0  # fuel burnt, kg
        self.rate_setpoint = UNKNOWN3
        self.torque = ZERO3
        self.collective = self.allocated = 0.0
        self.unallocated = FULLY_ALLOCATED

    @property
    def upright(self) -> float:
        """Cosine of the lean, limited to that for which the height loop compensates."""
        return max(MIN_UPRIGHT, upright(self.measured.attitude))


class Loops:
    """Control loops and allocation that all flight laws share.

    ``added_delay``: of the roll command, steps.  ``custom_attitude`` and ``custom_rate`` replace the loop of that name.
    """

    def __init__(
        self,
        attitude: AttitudeController,
        rate: RateController,
        altitude: AltitudeController,
        allocator: Allocator,
        added_delay: int = 0,
        custom_attitude: AttitudeLoop | None = None,
        custom_rate: CustomRate | None = None,
    ) -> None:
        self.attitude, self.rate, self.altitude = attitude, rate, altitude
        self.allocator: TiltAllocator | Allocator = allocator
        self.custom_attitude, self.custom_rate = custom_attitude, custom_rate
        self._added_delay = DelayLine(added_delay)

    def reset(self) -> None:
        self.attitude.reset()
        self.altitude.reset()
        self.rate.reset()
        self._added_delay.reset()
        if self.custom_attitude is not None:
            self.custom_attitude.reset()
        if self.custom_rate is not None:
            self.custom_rate.reset()

    def steer(self, command: Command, measured: Measured) -> Vector3:
        """Return the body rate set-point [rad/s] towards the commanded attitude."""
        custom = self.custom_attitude
        if custom is None or command.rate is not None:
            return self.attitude.update(command, measured)
        return custom.update(command, measured)

    def update(self, demand: Demand) -> None:
        """Update rate and height loop, and store their torque and collective in the demand."""
        rate, unallocated = demand.measured.rate, demand.unallocated
        if self.custom_rate is None:
            demand.torque = self.rate.update(demand.rate_setpoint, rate, unallocated)
        else:
            demand.torque = self.custom_rate.update(demand.rate_setpoint, rate, unallocated)
        demand.collective = self.altitude.update(demand.command, demand.measured, unallocated, demand.burnt)

    @property
    def predicted(self) -> Vector3:
        """The measured or predicted body rates [rad/s] that the rate loop was fed with."""
        return self.rate.predicted if self.custom_rate is None else self.custom_rate.predicted

    def inject(self, torque: Vector3, injected: Disturbance) -> Vector3:
        """Return the rate loop's output with injected signals, roll after its added delay; called once a step."""
        roll, pitch, yaw = torque
        x, y, z = injected.torque_output
        if x != 0.0 or y != 0.0 or z != 0.0:
            roll, pitch, yaw = roll + x, pitch + y, yaw + z
        x, y, z = seen = injected.torque_seen
        if x != 0.0 or y != 0.0 or z != 0.0:
            if self.custom_rate is not None:
                self.custom_rate.add_to_command(seen)
            else:
                self.rate.add_to_command(seen)
        return (self._added_delay.update(roll), pitch, yaw)

    def apply_schedule(self, scheduled: Scheduled) -> None:
        """Use the gains and leads of a thrust level from the next step on."""
        roll, altitude = scheduled.roll, scheduled.altitude
        self.attitude.scale_gains(roll.angle)
        self.rate.scale_roll_gains(roll.p, roll.i, roll.d, roll.lead)
        self.altitude.scale_gains(altitude.angle, altitude.p, altitude.i, altitude.lead)


class FlightLaw:
    """Law of one flight phase; this base class is hover, used if no other law applies."""

    def __init__(self, loops: Loops) -> None:
        self.loops = loops

    def reset(self) -> None:
        """Begin a flight."""

    def idle(self) -> None:
        """Abort the manoeuvre, because the engines idle or are off."""

    def leave(self) -> None:
        """Do nothing in this base; called on the law that flew until now when another law flies from this step on."""

    def applies(self, demand: Demand) -> bool:
        """Return whether the law is to fly this step; the first law that applies flies."""
        return True

    def steer(self, demand: Demand) -> Vector3:
        """Return the body rate set-point [rad/s]; called while the engines idle too, for the log."""
        return self.loops.steer(demand.command, demand.measured)

    def update(self, demand: Demand) -> Actuation:
        """Return thrust fractions and angles, and store in the demand what was allocated of torque and collective.

        The loops run under every law, and learn from ``unallocated`` which part of their outputs it did not use, so
        that they are not wound up when it hands over.
        """
        injected = demand.injected
        torque = self.loops.inject(demand.torque, injected)
        actuation = self.loops.allocator.allocate(demand.collective, torque, injected.torque_command)
        demand.unallocated = actuation.unallocated
        demand.allocated = demand.collective - actuation.unallocated.collective
        return actuation

    def handle_loss(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Return the jets, from 0, to shut off because of an engine that the monitor has just found failed."""
        return NO_JETS

    def observe(self, monitor: EngineMonitor) -> None:
        """Observe the engines' reports at the end of a step."""


class Selector:
    """Selects the flight law of each step, the first that applies."""

    def __init__(self, laws: Sequence[FlightLaw]) -> None:
        self.laws = list(laws)
        self._flying = self.laws[-1]

    def reset(self) -> None:
        self._flying = self.laws[-1]
        for law in self.laws:
            law.idle()
            law.reset()

    def select(self, demand: Demand) -> FlightLaw:
        """Return the first law that applies, after telling the previous one to leave."""
        chosen = self.laws[-1]
        for law in self.laws:
            if law.applies(demand):
                chosen = law
                break
        if chosen is not self._flying:
            self._flying.leave()
            self._flying = chosen
        return chosen

    def idle(self) -> None:
        """Abort all manoeuvres, because the engines idle or are off."""
        for law in self.laws:
            law.idle()
