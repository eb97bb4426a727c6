"""What a law for one phase of a flight is, and what all of them share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from cosim.base.protocols import Allocator
from cosim.base.signals import (
    NO_JETS,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Command,
    Disturbance,
    Measured,
    Unallocated,
    Vector3,
)
from cosim.control.allocation.allocation import TiltAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.altitude import LEAST_UPRIGHT, AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.predictors.smith import DelayLine
from cosim.control.rate import RateController
from cosim.control.schedule import Scheduled

NOTHING_LEFT = Unallocated(0.0, 0.0, 0.0, 0.0)


class OwnRate(Protocol):
    """A rate loop of the user's in place of ours."""

    predicted: Vector3

    def reset(self) -> None: ...

    def update(self, setpoint: Vector3, measured: Vector3, unallocated: Unallocated) -> Vector3: ...

    def tell(self, added: Vector3) -> None: ...


class OwnAttitude(Protocol):
    """An attitude loop of the user's in place of ours."""

    def reset(self) -> None: ...

    def update(self, command: Command, measured: Measured) -> Vector3: ...


class Demand:
    """One step: what is asked for, what the loops and a law make of it, and what allocation left of that.

    ``torque``, ``collective`` and ``given`` of it, per engine, are what is shown of the step; ``unallocated`` is what
    the loops learn in the next one.
    """

    def __init__(self) -> None:
        self.command = Command(ZERO3, 0.0)
        self.measured = Measured(ZERO3, (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, 0.0)
        self.injected = Disturbance()
        self.idle = False  # the engines idle or are off
        self.burnt = 0.0  # kg of fuel
        self.rate_setpoint = UNKNOWN3
        self.torque = ZERO3
        self.collective = self.given = 0.0
        self.unallocated = NOTHING_LEFT

    @property
    def upright(self) -> float:
        """Cosine of the lean, but for what the height loop does not make up for."""
        _, x, y, _ = self.measured.attitude
        return max(LEAST_UPRIGHT, 1.0 - 2.0 * (x * x + y * y))


class Loops:
    """The loops and the allocation that the laws share.

    ``added_delay``: of the roll command, steps.  ``own_attitude`` and ``own_rate`` fly in place of the loop that they
    are named after.
    """

    def __init__(
        self,
        attitude: AttitudeController,
        rate: RateController,
        altitude: AltitudeController,
        allocator: Allocator,
        added_delay: int = 0,
        own_attitude: OwnAttitude | None = None,
        own_rate: OwnRate | None = None,
    ) -> None:
        self.attitude, self.rate, self.altitude = attitude, rate, altitude
        self.allocator: TiltAllocator | Allocator = allocator
        self.own_attitude, self.own_rate = own_attitude, own_rate
        self._added_delay = DelayLine(added_delay)

    def reset(self) -> None:
        """Nothing is remembered."""
        self.attitude.reset()
        self.altitude.reset()
        self.rate.reset()
        self._added_delay.reset()
        if self.own_attitude is not None:
            self.own_attitude.reset()
        if self.own_rate is not None:
            self.own_rate.reset()

    def steer(self, command: Command, measured: Measured) -> Vector3:
        """Return the body rates [rad/s] that lead to the attitude asked for."""
        own = self.own_attitude
        if own is None or command.rate is not None:
            return self.attitude.update(command, measured)
        return own.update(command, measured)

    def ask(self, step: Demand) -> None:
        """Put into the step the torque and the collective that lead to its set-points."""
        rate, unallocated = step.measured.rate, step.unallocated
        if self.own_rate is None:
            step.torque = self.rate.update(step.rate_setpoint, rate, unallocated)
        else:
            step.torque = self.own_rate.update(step.rate_setpoint, rate, unallocated)
        step.collective = self.altitude.update(step.command, step.measured, unallocated, step.burnt)

    @property
    def predicted(self) -> Vector3:
        """The body rates that the rate loop was fed with, rad/s."""
        return self.rate.predicted if self.own_rate is None else self.own_rate.predicted

    def inject(self, torque: Vector3, injected: Disturbance) -> Vector3:
        """Return the rate loop's output with what is added to it there, roll after the added delay; once a step."""
        roll, pitch, yaw = torque
        added = injected.torque_output
        if added != ZERO3:
            roll, pitch, yaw = roll + added[0], pitch + added[1], yaw + added[2]
        if injected.torque_seen != ZERO3:
            if self.own_rate is not None:
                self.own_rate.tell(injected.torque_seen)
            else:
                self.rate.tell(injected.torque_seen)
        return (self._added_delay.update(roll), pitch, yaw)

    def follow(self, at: Scheduled) -> None:
        """Use the gains and leads of a thrust level from the next step on."""
        roll, altitude = at.roll, at.altitude
        self.attitude.follow(roll.angle)
        self.rate.follow_roll(roll.p, roll.i, roll.d, roll.lead)
        self.altitude.follow(altitude.angle, altitude.p, altitude.i, altitude.lead)


class FlightLaw:
    """The law of one phase; as it stands that of hover, which flies where no other wants to."""

    def __init__(self, loops: Loops) -> None:
        self.loops = loops

    def reset(self) -> None:
        """Begin a flight."""

    def idle(self) -> None:
        """Give up what was under way: the engines idle or are off."""

    def leave(self) -> None:
        """Hand over: another law flies from this step on."""

    def wants(self, step: Demand) -> bool:
        """Return whether it is to fly this step; asked for in the order of the laws, up to the first that does."""
        return True

    def steer(self, step: Demand) -> Vector3:
        """Return the body rates [rad/s] that are asked for; shown of engines that idle too."""
        return self.loops.steer(step.command, step.measured)

    def update(self, step: Demand) -> Actuation:
        """Return shares of thrust and angles, and put into the step what became of torque and collective.

        The loops fly on under every law, and learn by ``unallocated`` what it did not give of theirs: so none finds
        them wound up when it hands over.
        """
        injected = step.injected
        torque = self.loops.inject(step.torque, injected)
        given = self.loops.allocator.allocate(step.collective, torque, injected.torque_command)
        step.unallocated = given.unallocated
        step.given = step.collective - given.unallocated.collective
        return given

    def lose(self, monitor: EngineMonitor, burnt: float) -> frozenset[int]:
        """Return the jets, from 0, that are to be shut off with an engine that the monitor newly takes for ill."""
        return NO_JETS

    def look(self, monitor: EngineMonitor) -> None:
        """Take what the engines reported at the end of a step."""


class Selector:
    """Which law flies."""

    def __init__(self, laws: Sequence[FlightLaw]) -> None:
        self.laws = list(laws)
        self._flying = self.laws[-1]

    def reset(self) -> None:
        """Begin a flight."""
        self._flying = self.laws[-1]
        for law in self.laws:
            law.idle()
            law.reset()

    def select(self, step: Demand) -> FlightLaw:
        """Return the first law that wants to fly the step; the one that flew until now leaves where it is another."""
        chosen = self.laws[-1]
        for law in self.laws:
            if law.wants(step):
                chosen = law
                break
        if chosen is not self._flying:
            self._flying.leave()
            self._flying = chosen
        return chosen

    def idle(self) -> None:
        """Give up what was under way in every law: the engines idle or are off."""
        for law in self.laws:
            law.idle()
