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
    """Flies in place of the scenario's commands, the first block of a step: guided script or autopilot."""

    @property
    def engines(self) -> EngineState:
        """What the engines do with the command of the last update."""

    @property
    def seen(self) -> Measured:
        """What the controller flies the step of the last update with: the sensors, or what stands in for them."""

    def reset(self, measured: Measured) -> None:
        """Start a new flight where the sensors read ``measured``."""

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """Return the command of step ``k``; called once a step, in order."""


class Controller(Protocol):
    """From the command and the measurement to the actuators, as :class:`cosim.control.cascade.Cascade` does.

    Once a step, in this order: ``update``, then the engines and servos act, then ``watch``, then the log reads
    ``signals``.  It knows what the vehicle is stated to be, never what flies: no mismatch, no fault, no true state.
    """

    @property
    def signals(self) -> ControlSignals:
        """The signals of the last update, for the log and the pilot; NaN where this controller has none."""

    @property
    def lost(self) -> tuple[int, ...]:
        """The jets, from 1, that it takes for lost; not those that it shut off itself."""

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """What is to be seen of the predictors of roll, pitch and yaw; NaN where there is none."""

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """Start a flight with ``burnt`` kg of fuel gone; return the throttles, 0 to 1, at which the engines stand."""

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Return what the actuators are to do over a step.

        The torques of ``injected`` are added where they say, ``torque_seen`` as part of what the controller knows of.
        Where ``engines`` is not FLY they idle or are off, and nothing is remembered of before.
        """

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Take the reports at the end of a step; return the share of its command that each jet gives, 0 to 1."""

    def forgive(self) -> None:
        """Trust every engine again as soon as all stand idle: the vehicle is repaired."""


class Allocator(Protocol):
    """Turns what the loops ask for into what the actuators can do.  It keeps its plan around lost engines, no more."""

    hover: float  # throttle at which the vehicle hovers
    rest: PerServo  # servo positions when nothing is demanded

    def trim(self, collective: float) -> PerJet:
        """Return the balanced throttles of the jets, with nothing asked of the servos."""

    def allocate(self, collective: float, torque: Vector3, added: Vector3 = ZERO3) -> Actuation:
        """Return what can be given of a collective, 0 to 1, and a torque; once a step.

        ``torque`` is in throttle about roll, in rad of tilt about pitch and yaw; ``added`` is a disturbance of it that
        the loops do not know.  ``unallocated`` of the answer is exactly 0 where everything fits.
        """

    def replan(self, health: Sequence[JetHealth]) -> bool:
        """Allocate for engines in this health from the next step on; False: that cannot be, and all is as before."""

    def reset(self) -> None:
        """Return to the allocation for healthy engines."""


class Engines(Protocol):
    """The engines of a vehicle: :class:`cosim.engine.EngineBank`, and what stands before and behind it."""

    wants_ambient: bool  # their thrust depends on the air

    def reset(self, throttle: float | Sequence[float], ambient: Ambient | None = None) -> EngineOutput:
        """Bring the engines into equilibrium at throttles and in air; None: standard air at sea level, still."""

    def step(self, k: int, throttle: PerJet, ambient: Ambient | None = None) -> EngineOutput:
        """Advance by step ``k``, throttles and air held over it; None: the air as before."""

    def run_down(self, seconds: float) -> EngineOutput:
        """Let engines that were shut off right after the reset turn on without fuel, before step 0."""

    def set_run(self, index: int, on: bool) -> bool:
        """Shut one engine, from 0, off or on again before the next step; False: it has no port for that."""

    def close(self) -> None:
        """Free them; may be called twice."""


class Shows(Protocol):
    """What any block may be beside its own protocol: one that shows numbers of its own in the log.

    Asked for it are pilot, disturbances, controller, engines and sensors, and what stands inside the built-in ones: the
    predictors of a :class:`cosim.control.cascade.Cascade`, each with its axis before the column's name.
    The columns come last in the log, with name, unit, frame and meaning, and go with it into CSV, ULog and page.
    """

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is shown; the same for a whole flight, and read at its beginning.  No name that the log has already."""

    @property
    def shown(self) -> tuple[float, ...]:
        """The numbers, one for each column and in their order, once after every step that the block took part in."""


def columns_of(block: object) -> tuple[Column, ...]:
    """Return the columns of its own that a block shows in the log; none where it shows none."""
    return tuple(getattr(block, "columns", ()))


class Sensors(Protocol):
    """What the controller and the pilot are told of the motion.  Filters, latencies and noise are its to keep."""

    def reset(self, state: State) -> Measured:
        """Start a new flight, with the same noise again, from a state that has been forever."""

    def sample(self, state: State) -> Measured:
        """Return what is measured of the state at ``t_k+1``; called once a step, after the airframe."""


class Observer(Protocol):
    """Looks at every step and touches nothing; the last of a step."""

    def observe(self, sample: Sample) -> None:
        """Look at a step after it; once more at the state that ended a flight before its time.

        Parameters
        ----------
        sample : Sample
            All that there is to see of the step.
        """


class Columns(Protocol):
    """The columns of a log by name, one float64 a step."""

    @property
    def columns(self) -> tuple[str, ...]: ...

    def __getitem__(self, name: str) -> NDArray[np.float64]: ...


class Metric(Protocol):
    """What a finished log says in numbers, once after the flight: a pure function, such as ``flight_metrics``."""

    def __call__(self, log: Columns, step_s: float, /) -> Any:
        """Evaluate the log of a flight; called once, when it is over.

        Parameters
        ----------
        log : Columns
            One float64 a step in every column.
        step_s : float
            The control step [s].

        Returns
        -------
        Any
            One number, or a record of them; None for what this flight cannot tell.
        """
