"""The blocks of a flight that have several implementations, and what looks at a step or at a finished log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from cosim.base.protocols.records import Column, Diagnostics, EngineState, Report
from cosim.base.signals import (
    ZERO3,
    Actuation,
    Ambient,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    JetHealth,
    Measured,
    PerJet,
    PerServo,
    Sample,
    State,
    Vector3,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Pilot(Protocol):
    """First block of a step, which replaces the scenario's commands: guided script or autopilot."""

    @property
    def engines(self) -> EngineState:
        """State that the last update requires of the engines."""

    @property
    def seen(self) -> Measured:
        """Measurement that the controller gets after the last update: sensors or estimate."""

    def reset(self, measured: Measured) -> None:
        """Start a new flight at the measured state ``measured``."""

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """Return the command of step ``k``; called once a step, in order."""


class Controller(Protocol):
    """Computes actuator commands from command and measurement, as :class:`cosim.control.cascade.Cascade` does.

    Once a step, in this order: ``update``, then the engines and servos act, then ``watch``, then the log reads
    ``signals``.  It knows what the vehicle is stated to be, never what flies: no mismatch, no fault, no true state.
    """

    @property
    def signals(self) -> ControlSignals:
        """Control signals of the last update, for log and pilot; NaN if this controller has none."""

    @property
    def lost(self) -> tuple[int, ...]:
        """Jets, from 1, that count as failed; those that it shut off itself are not included."""

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """Diagnostics of the predictors of roll, pitch and yaw; NaN without one."""

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """Start a flight with ``burnt`` kg of fuel gone; return the initial throttles, 0 to 1."""

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Return the actuator commands for a step.

        The torques of ``injected`` are added where they say, ``torque_seen`` as part of what the controller knows of.
        Where ``engines`` is not FLY they idle or are off, and nothing is remembered of before.
        """

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Take the engine reports at the end of a step; return the fraction of its command that each jet delivers."""

    def forgive(self) -> None:
        """Clear all engine failures once all engines idle, because the vehicle was repaired."""


class Allocator(Protocol):
    """Maps demands of the loops to actuator commands.  Its only state is the plan around failed engines."""

    hover: float  # throttle at which the vehicle hovers
    rest: PerServo  # servo positions when nothing is demanded

    def trim(self, collective: float) -> PerJet:
        """Return the throttles that balance all moments at a collective (mean throttle), with servos at rest."""

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return the actuator commands for a collective, 0 to 1, and a torque; called once a step.

        ``torque`` is in throttle about roll, in rad of tilt about pitch and yaw; ``added`` is a disturbance of it that
        the loops do not know.  ``unallocated`` of the answer is exactly 0 where everything fits.
        """

    def replan(self, health: Sequence[JetHealth]) -> bool:
        """Allocate for engines of this health from the next step on; return False, unchanged, if that is impossible."""

    def reset(self) -> None:
        """Return to the allocation for healthy engines."""


class Engines(Protocol):
    """Engines of a vehicle: :class:`cosim.engine.EngineBank` with delays, faults and restarts around it."""

    wants_ambient: bool  # whether thrust depends on the air

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring the engines into equilibrium at ``throttle``; ``ambient`` None: still standard air at sea level."""

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance by step ``k`` with ``throttle`` and ``ambient`` held; None: the air of the step before."""

    def run_down(self, seconds: float) -> EngineOutput:
        """Let engines that were shut off right after the reset run down for ``seconds`` before step 0."""

    def set_run(self, index: int, on: bool) -> bool:
        """Switch one engine, from 0, off or on before the next step; return False if it has no port for that."""

    def close(self) -> None:
        """Free the engines; may be called twice."""


class Shows(Protocol):
    """Optional part of any block that adds columns to the log.

    Asked for it are pilot, disturbances, controller, engines and sensors, and what stands inside the built-in ones: the
    predictors of a :class:`cosim.control.cascade.Cascade`, each with its axis before the column's name.
    The columns come last in the log, with name, unit, frame and meaning, and go with it into CSV, ULog and page.
    """

    @property
    def columns(self) -> tuple[Column, ...]:
        """The block's log columns, constant over a flight and read at its start; names must be new in the log."""

    @property
    def shown(self) -> tuple[float, ...]:
        """Values of the block's log columns, read after each step in which it took part."""


def columns_of(block: object) -> tuple[Column, ...]:
    """Return the log columns that a block adds, empty if it adds none."""
    return tuple(getattr(block, "columns", ()))


class Sensors(Protocol):
    """Sensors for controller and pilot, with their filters, latencies and noise."""

    def reset(self, state: State) -> Measured:
        """Start a new flight with the same noise, from a state that was held long before."""

    def sample(self, state: State) -> Measured:
        """Return the measurement of the state at ``t_k+1``; called once a step, after the airframe."""


class Observer(Protocol):
    """Receives each step's sample after all blocks, without effect on the flight."""

    def observe(self, sample: Sample) -> None:
        """Receive the sample of a finished step, and once more the state that ended a flight early.

        Parameters
        ----------
        sample : Sample
            All that there is to see of the step.
        """


class Columns(Protocol):
    """Columns of a log by name, one float64 per step."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    def __getitem__(self, name: str) -> NDArray[np.float64]: ...


class Metric(Protocol):
    """Computes numbers from a finished log; a pure function, such as ``flight_metrics``."""

    def __call__(self, log: Columns, step_s: float, /) -> Any:
        """Return one number of a flight, or a record of them, None for what it cannot tell; called once, at its end.

        Parameters
        ----------
        log : Columns
            One float64 a step in every column.
        step_s : float
            The control step [s].
        """
