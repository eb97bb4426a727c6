"""A flight that a program steps: one control step at a time, back to its start, and back to an earlier step.

The state of a flight cannot be copied: JSBSim has no way to set the derivatives that its integrators remember, the
filters and the generator of its turbulence, nor the friction forces of its contacts; many FMUs do not give their state;
and a user-supplied block may keep its own anywhere.  But a flight is a function of its scenario and of its inputs, to
the last bit.  So a snapshot is the inputs, and going back to it is flying there again.  That costs the time of the
steps up to it, needs nothing of any block that the flight does not need already, and is checked: the state at the end
must be that of the snapshot, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.protocols import Applied
from cosim.base.signals import Actuation, Command, Measured, PerJet, PerServo, Sample, State, Unallocated
from cosim.flight import name_controller, record
from cosim.results.run import Run
from cosim.simulation.build import build
from cosim.simulation.controllers.source import IN_MEMORY_PREFIX, Source
from cosim.simulation.ending import Ending
from cosim.spec.scenario import Scenario


class Inputs(NamedTuple):
    """Inputs that a program holds from step ``k`` on."""

    k: int
    command: Command | None  # None: the scenario's command
    throttle: PerJet | None = None  # None: the controller's throttles
    tilt: PerServo | None = None


@dataclass(frozen=True)
class Snapshot:
    """State of a flight at one step, to return to; it can be pickled and restored in another process.

    ``k`` is the step that comes next and ``given`` what a program gave up to there, in order.  ``flight`` is the
    SHA-256 of what flies, ``there`` that of the motion, the measurement and the engines' reports at that step.
    """

    flight: str
    seed: int
    k: int
    given: tuple[Inputs, ...]
    there: str


class _ManualController:
    """Controller that passes on the throttles and tilts that a program sets."""

    level = "controller"

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Clear the throttles and tilts set by a program."""
        self.throttle: PerJet | None = None
        self.tilt: PerServo | None = None

    def update(self, command: Command, measured: Measured, applied: Applied) -> Actuation:
        return Actuation(self.throttle or applied.throttle, self.tilt or applied.tilt, Unallocated())


class Stepper:
    """Flight that a program advances step by step.

    It ends as every flight does, crashed, diverged, failed or at the scenario's end; then it can be reset, restored,
    made a run of, and not stepped.  A context manager, which frees engines and airframe.

    >>> with Stepper("hover") as flight:
    ...     thrust = flight.step().thrust

    Parameters
    ----------
    scenario : Scenario or str or Path
        As for :func:`cosim.fly`; its commands are what is asked for where :meth:`step` is given none.
    controller : str or Path or object or None
        As for :func:`cosim.fly`.
    actuators : bool
        Nobody controls: throttles and tilts are given by hand.
    log : bool
        Whether steps are recorded, for :meth:`run`.

    Attributes
    ----------
    ending : Ending or None
        How and why the flight ended; None: it has not.
    simulation : Simulation
        What flies; of what is changed in it from outside no snapshot knows.

    Raises
    ------
    InputError
        As :func:`cosim.fly`; also for a scenario that an autopilot flies.
    """

    def __init__(
        self, scenario: Scenario | str | Path, *, controller: Any = None, actuators: bool = False, log: bool = True
    ) -> None:
        self._manual = _ManualController() if actuators else None
        if actuators and controller is not None:
            raise InputError(
                "actuators = True: throttles and tilts are given by hand, so there is no controller to name"
            )
        scenario, self._source = name_controller(scenario, controller)
        _refuse_autopilot(scenario)
        if self._manual is not None:
            manual, name = self._manual, f"{IN_MEMORY_PREFIX}by hand"
            self._source = Source(name, "controller", lambda: manual, {}, is_copied=False)
            scenario = scenario.replace(controller=name)
        self._scenario, self._log = scenario, log
        self.simulation = build(scenario, self._source)
        self._begin_recording()

    def _begin_recording(self) -> None:
        """Begin log, observers and input history of a flight that is built already."""
        self.ending: Ending | None = None
        self._given: list[Inputs] = []
        self._steps_by_hand = 0
        self._observers = self.simulation.plugins.observers
        self._recording = record(self.simulation, None) if self._log else None

    @property
    def scenario(self) -> Scenario:
        """Scenario with the seed of the last reset."""
        return self._scenario

    @property
    def k(self) -> int:
        """Number of the next step."""
        return self.simulation.k

    @property
    def time(self) -> float:
        """Time at the start of the next step [s]."""
        return self.simulation.k * self.simulation.dt

    @property
    def state(self) -> State:
        """True motion at the start of the next step."""
        return self.simulation.state

    @property
    def measured(self) -> Measured:
        """Measurement at the start of the next step."""
        return self.simulation.measured

    @property
    def command(self) -> Command:
        """Scenario's command for the next step; places and velocities are left to its pilot."""
        return self.simulation.command_script.at(self.simulation.k)

    def step(
        self,
        command: Command | None = None,
        throttle: Sequence[float] | None = None,
        tilt: Sequence[float] | None = None,
    ) -> Sample:
        """Fly one control step with inputs held.

        >>> with Stepper("hover") as flight:
        ...     for _ in range(250):
        ...         sample = flight.step(Command((0.1, 0.0, 0.0), 10.0))
        ...     flight.time
        1.0

        Parameters
        ----------
        command : Command or None
            What is asked for: angles [rad] and height [m], or body rates [rad/s] and collective [throttle] in their
            place; None: what the scenario asks for.
        throttle : sequence of float or None
            By hand, 0 to 1 per jet, jet 1 first; None: as before.
        tilt : sequence of float or None
            By hand, left and right servo [rad], or one a hinge and a surface; None: as before.

        Returns
        -------
        Sample
            All that there is to see of the step; the motion in it is that at its beginning.

        Raises
        ------
        FlightError
            If the flight is over, and where something fails in this step, which ends it.
        InputError
            For what is no command, and for throttles and tilts where a controller flies.
        """
        if self.ending is not None:
            raise FlightError(f"the flight is over ({self.ending.outcome}: {self.ending.reason}); reset or restore it")
        if command is not None:
            command = _parse_command(command)
        if throttle is not None or tilt is not None:
            self._set_actuators(throttle, tilt)
        manual = self._manual
        given = Inputs(self.k, command) if manual is None else Inputs(self.k, command, manual.throttle, manual.tilt)
        if given[1:] != (self._given[-1][1:] if self._given else (None, None, None)):
            self._given.append(given)
        return self._advance(command)

    def _set_actuators(self, throttle: Sequence[float] | None, tilt: Sequence[float] | None) -> None:
        if self._manual is None:
            raise InputError("throttle, tilt: a controller flies; Stepper(..., actuators=True) gives them by hand")
        if throttle is not None:
            throttles = _to_floats(throttle, len(self.simulation.vehicle.jets), "throttle")
            for number, value in enumerate(throttles, 1):
                if not 0.0 <= value <= 1.0:
                    raise InputError(f"throttle {number} = {value:g}: must be from 0 to 1")
            self._manual.throttle = throttles
        if tilt is not None:
            self._manual.tilt = _to_floats(tilt, len(self.simulation.vehicle.actuators), "tilt")

    def _advance(self, command: Command | None) -> Sample:
        simulation = self.simulation
        try:
            sample = simulation.step(command)
        except FlightError as error:
            self.ending = simulation.make_failure(error)
            if isinstance(error, EngineError):
                raise
            raise FlightError(self.ending.reason) from error
        self._steps_by_hand += command is not None or self._manual is not None
        self._observe(sample)
        self.ending = simulation.check_end(sample, [self._observe])
        if self.ending is None and self.k >= self._scenario.steps:
            self.ending = Ending("completed", f"flew {self.k} steps")
        return sample

    def _observe(self, sample: Sample) -> None:
        """Pass a step to the log and to the scenario's observers."""
        if self._recording is not None:
            self._recording.observe(sample)
        try:
            for observer in self.simulation.plugins.observers:
                observer.observe(sample)
        except FlightError as error:
            self.ending = Ending("failed", str(error))
            raise

    def _close_flight(self) -> None:
        observers, self._observers = self._observers, ()
        try:
            for observer in observers:
                if hasattr(observer, "close"):
                    observer.close()
        finally:
            self.simulation.close()

    def reset(self, seed: int | None = None, scenario: Scenario | None = None) -> Measured:
        """Return to ``t = 0`` and return what the sensors measure there.

        Parameters
        ----------
        seed : int or None
            In place of the scenario's; None: the noise is that of before.
        scenario : Scenario or None
            To fly from here on, with the same controller; None: that of before.

        Raises
        ------
        InputError
            If the scenario cannot be flown; the flight stays where it is.
        """
        next_scenario = self._scenario if scenario is None else scenario.replace(controller=self._scenario.controller)
        if seed is not None and seed != next_scenario.seed:
            next_scenario = next_scenario.replace(seed=seed)
        _refuse_autopilot(next_scenario)
        broken = self.ending is not None and self.ending.outcome == "failed"
        if next_scenario is not self._scenario or broken or self._observers:  # observers belong to one flight
            simulation = build(next_scenario, self._source)
            self._close_flight()
            self.simulation, self._scenario = simulation, next_scenario
        else:
            self.simulation.reset()
        self._begin_recording()
        return self.measured

    def snapshot(self) -> Snapshot:
        """Return a snapshot of this step, to which the flight can return.

        Raises
        ------
        FlightError
            Where the flight is over.
        """
        if self.ending is not None:
            raise FlightError(f"the flight is over ({self.ending.outcome}); a snapshot is of one that is under way")
        return Snapshot(self._flight_hash(), self._scenario.seed, self.k, tuple(self._given), self._state_hash())

    def restore(self, snapshot: Snapshot) -> Measured:
        """Fly again to a snapshot's step with the same inputs, and return what the sensors measure there.

        >>> with Stepper("hover") as flight:
        ...     start, first = flight.snapshot(), flight.step()
        ...     _ = flight.restore(start)
        ...     flight.step().thrust == first.thrust
        True

        Parameters
        ----------
        snapshot : Snapshot
            Of this scenario, aircraft, engine and controller, of this or another process.

        Raises
        ------
        InputError
            If it is one of another flight.
        FlightError
            If the way there is not the same again, so that this is another place: an engine or a controller answers
            otherwise when it is asked the same.  The flight is over then.
        """
        if snapshot.flight != self._flight_hash():
            raise InputError(
                f"snapshot: is of another flight than {self._scenario.name} with {self._scenario.controller} and these "
                "files of aircraft and engines"
            )
        self.reset(snapshot.seed)
        changes = {step.k: step for step in snapshot.given}
        command = None
        while self.k < snapshot.k and self.ending is None:
            if self.k in changes:
                _, command, throttle, tilt = changes[self.k]
                if self._manual is not None:
                    self._manual.throttle, self._manual.tilt = throttle, tilt
            self._advance(command)
        self._given = list(snapshot.given)
        if self.k != snapshot.k or self._state_hash() != snapshot.there:
            self.ending = Ending("failed", f"this flight does not repeat: at step {snapshot.k} it is at another place")
            why = "an engine or a controller answers otherwise when it is asked the same"
            raise FlightError(f"{self.ending.reason} than it was; {why}")
        return self.measured

    def _state_hash(self) -> str:
        simulation = self.simulation
        values = simulation.state, simulation.measured, simulation.propulsion.output, simulation.controller.signals
        return sha256(repr(values).encode()).hexdigest()

    def _flight_hash(self) -> str:
        simulation, source = self.simulation, self._source or self.simulation.controller_source
        parts = (
            self._scenario.model_copy(update={"seed": 0}).model_dump_json(),
            simulation.airframe.sha256,
            *[spec.sha256 for spec in simulation.stations],
            "" if source is None else source.sha256,
            *[plugin.sha256 for plugins in simulation.plugins.sources.values() for plugin in plugins],
        )
        return sha256("\n".join(parts).encode()).hexdigest()

    def run(self) -> Run:
        """End the flight here and return its run; ``summary.by_hand`` counts the steps with a program's inputs.

        >>> with Stepper("hover") as flight:
        ...     _ = flight.step()
        ...     flight.run().summary.steps
        1

        Raises
        ------
        InputError
            Without a log.
        """
        if self._recording is None:
            raise InputError("log = False: nothing was recorded")
        self._recording.note_steps(self.k, self._steps_by_hand)
        ending = self.ending or Ending("completed", f"stepped by a program to {self.time:.3f} s")
        return self._recording.finish(ending.outcome, ending.reason)

    def close(self) -> None:
        """Free engines, airframe, controller and observers; may be called twice."""
        self._close_flight()

    def __enter__(self) -> Stepper:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _refuse_autopilot(scenario: Scenario) -> None:
    if scenario.requests is not None:
        raise InputError(f"scenario {scenario.name}: requests: an autopilot flies it, and is not stepped by hand")


def _to_floats(values: Sequence[float], count: int, what: str) -> tuple[float, ...]:
    """Return ``count`` finite numbers.  Raises InputError that names ``what``."""
    try:
        numbers = tuple([float(value) for value in values])
    except (TypeError, ValueError):
        raise InputError(f"{what} = {values!r}: must be {count} numbers") from None
    if len(numbers) != count or not all(isfinite(value) for value in numbers):
        raise InputError(f"{what} = {numbers}: must be {count} finite numbers")
    return numbers


def _parse_command(command: Any) -> Command:
    """Return the command with its values as finite floats.  Raises InputError."""
    if not isinstance(command, Command):
        raise InputError(f"command: {type(command).__name__}: must be a cosim.Command")
    roll, pitch, yaw = _to_floats(command.attitude, 3, "command.attitude")
    rate = None
    if command.rate is not None:
        p, q, r = _to_floats(command.rate, 3, "command.rate")
        rate = (p, q, r)
    (altitude,) = _to_floats((command.altitude,), 1, "command.altitude")
    collective = None if command.collective is None else _to_floats((command.collective,), 1, "command.collective")[0]
    return Command((roll, pitch, yaw), altitude, rate, collective, command.place)
