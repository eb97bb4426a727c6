"""One flight: the step, in which its blocks come one after the other, and the loop around it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple, cast

from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.protocols import Column, Controller, EngineState, Observer, Pilot, Report, Shows, columns_of
from cosim.base.signals import ZERO3, Actuation, Command, Disturbance, Measured, PerJet, Sample, State
from cosim.control.cascade import Cascade
from cosim.engine import EngineSpec
from cosim.simulation.controllers.external_controller import ExternalController
from cosim.simulation.controllers.source import Source
from cosim.simulation.delay_ledger import LedgerRow
from cosim.simulation.ending import Ending, TerminationCheck
from cosim.simulation.pacing import Pace
from cosim.simulation.plugins import Plugins
from cosim.simulation.script.command_script import CommandScript
from cosim.simulation.script.disturbance_script import DisturbanceScript
from cosim.simulation.script.fault_schedule import FaultSchedule
from cosim.simulation.script.wind import FieldWind
from cosim.spec.scenario import Fault, Scenario
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.propulsion import Propulsion
from cosim.vehicle.sensors import FaultySensors

_FLY: Final = EngineState.FLY  # direct access in compiled code
_OFF: Final = EngineState.OFF
_IDLE: Final = EngineState.IDLE
_START: Final = EngineState.START
_NO_SIGNALS: Final[tuple[float, ...]] = ()  # shared empty tuple
_SAMPLE: Final = Sample  # direct access in compiled code

Between = Callable[[int], Ending | None]  # called with the number of the next step


class Blocks(NamedTuple):
    """Blocks of a flight, with its constant data.

    ``specs``: the scenario's engine, then the one at each station; ``plugged``: a controller from outside, which flies
    in place of the cascade if it is a whole one; ``plugins``: the user's blocks beside that.
    """

    scenario: Scenario
    vehicle: Vehicle
    specs: Sequence[EngineSpec]
    ledger: list[LedgerRow]
    command_script: CommandScript
    pilot: Pilot | None
    disturbances: DisturbanceScript
    cascade: Cascade
    propulsion: Propulsion
    airframe: Airframe
    sensors: FaultySensors
    faults: FaultSchedule
    termination: TerminationCheck
    plugged: ExternalController | None
    plugins: Plugins
    wind: FieldWind | None


class Simulation:
    """One flight: blocks from :func:`cosim.simulation.build.build`, and the present time.

    In flight no block is exchanged for another: what a fault changes it changes inside.
    """

    def __init__(self, blocks: Blocks) -> None:
        plugged = self._plugged = blocks.plugged
        whole: Controller | None = None if plugged is None else plugged.whole
        self.controller_source: Source | None = None if plugged is None else plugged.source
        # Annotated with the built-in blocks, because compiled code calls methods of a known class directly.
        self.controller: Cascade | Controller = blocks.cascade if whole is None else whole
        self.replaced_cascade = None if whole is None else blocks.cascade  # cascade that a whole controller replaces
        self.disturbances = blocks.disturbances
        self.plugins, self._field = blocks.plugins, blocks.wind
        self.scenario, self.vehicle, self.ledger = blocks.scenario, blocks.vehicle, blocks.ledger
        self.engine, *self.stations = blocks.specs
        self.dt = blocks.scenario.step_s
        self.command_script, self.pilot, self.propulsion = blocks.command_script, blocks.pilot, blocks.propulsion
        self.airframe, self.sensors, self.faults = blocks.airframe, blocks.sensors, blocks.faults
        self.termination = blocks.termination
        self._all_engines = tuple(range(1, len(blocks.vehicle.jets) + 1))
        self.reset()

    def reset(self) -> None:
        """Reset the flight to ``t = 0``: at rest, with engines settled at the throttle that holds the vehicle.

        Faults that were given by command are forgotten.
        """
        self.k = 0
        self.faults.reset()
        propulsion, airframe, initial = self.propulsion, self.airframe, self.scenario.initial
        wind = self.disturbances.at(0).wind
        if self._field is not None:
            wind = self._field.reset(wind)
            propulsion.gusts = []
        propulsion.refuel()
        self.initial_throttle = throttle = self.controller.reset(initial.on_ground, propulsion.burnt)
        # Thrust depends on the air at the start, which is known only after the airframe's reset: reset twice.
        at_rest = airframe.reset(initial, [ZERO3] * len(throttle), wind) if propulsion.wants_ambient else None
        # The engines are off until the autopilot is armed, and again whenever it has switched them off.
        self._engines_were_off = self._engines_restart = initial.engines == "off"
        forces = propulsion.reset(throttle, at_rest, wind, self._engines_were_off)
        self.state = airframe.reset(initial, forces, wind, propulsion.momentum, propulsion.burnt)
        self.measured = self.sensors.reset(self.state)
        self.termination.reset(initial.on_ground)
        if self.pilot is not None:
            self.pilot.reset(self.measured)
        # Columns of blocks are fixed here for the whole flight.
        blocks = (self.pilot, self.disturbances, self.controller, propulsion.engines.bank, self.sensors.inner)
        self._logged_blocks = [(cast(Shows, block), columns_of(block)) for block in blocks if columns_of(block)]

    def step(self, command: Command | None = None) -> Sample:
        """Advance one control step over ``[t_k, t_k+1)`` with inputs held; see docs/design.md.

        ``command``: in place of that of the script, or of the pilot, who is not asked in this step.
        """
        k, state, measured, propulsion = self.k, self.state, self.measured, self.propulsion
        self.faults.update(k, measured)
        command, seen, engines = self._command(k, command)
        disturbance = self._disturbance(k)
        actuation = self.controller.update(command, seen, disturbance, engines)
        forces, moment = propulsion.step(k, actuation, state)
        health = self.controller.watch(propulsion.output, propulsion.burnt)
        self.airframe.prepare_step(propulsion.momentum, propulsion.burnt, propulsion.tilt)
        self.state = self.airframe.step(forces, disturbance, moment)
        self.measured = self.sensors.sample(self.state)
        self.k += 1
        return self._make_sample(k, command, state, measured, actuation, disturbance, health)

    def _command(self, k: int, override: Command | None) -> tuple[Command, Measured, EngineState]:
        """Return the command, the measurement for the controller, and the engine state."""
        pilot, measured, engines = self.pilot, self.measured, _FLY
        if override is not None:
            command = override
        elif pilot is None:
            command = self.command_script.at(k)
        else:
            controller = self.controller
            starting = self._find_restarting_engines(pilot)
            report = Report(
                self.state.on_ground,
                controller.signals.allocated,
                controller.lost,
                self.propulsion.remaining,
                starting,
            )
            command = pilot.update(k, measured, report)
            measured, engines = pilot.seen, pilot.engines
            if starting and engines is _IDLE:
                engines = _START
        return command, measured, engines

    def _find_restarting_engines(self, pilot: Pilot) -> tuple[int, ...]:
        """Return the engines, counted from 1, that the pilot has switched on and that do not run yet."""
        off, self._engines_were_off = self._engines_were_off, pilot.engines is _OFF
        # Engines are running once they reach their thrust at the start, which is idle thrust only on the ground.
        self._engines_restart |= self._engines_were_off and self.scenario.initial.on_ground
        if self._engines_were_off or not self._engines_restart:
            return ()
        return self._all_engines if off else self.propulsion.engines.restarting_engines

    def _disturbance(self, k: int) -> Disturbance:
        """Return the disturbance of step ``k``: external ones including wind, and signals added in the controller."""
        disturbance = self.disturbances.at(k)
        if self._field is not None:
            disturbance = self._field.add_wind(k, self.state, disturbance)
            self.propulsion.gusts = self._field.at_jets
        return disturbance

    def _make_sample(
        self,
        k: int,
        command: Command,
        state: State,
        measured: Measured,
        actuation: Actuation,
        disturbance: Disturbance,
        health: PerJet,
    ) -> Sample:
        propulsion = self.propulsion
        return _SAMPLE(
            k,
            k * self.dt,
            command,
            state,
            measured,
            self.controller.signals,
            actuation,
            propulsion.tilt,
            propulsion.output,
            disturbance,
            propulsion.fuel,
            propulsion.spool_moment,
            self.faults.flags,
            health,
            self._block_signals() if self._logged_blocks else _NO_SIGNALS,
        )

    def _block_signals(self) -> tuple[float, ...]:
        """Return the values of the blocks' log columns.  Raises FlightError for a wrong number of them."""
        signals: list[float] = []
        for block, columns in self._logged_blocks:
            shown = block.shown
            if len(shown) != len(columns):
                raise FlightError(f"{type(block).__name__} shows {len(shown)} numbers for {len(columns)} columns")
            signals.extend(shown)
        return tuple(signals)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Log columns of the blocks, in the order of :attr:`Sample.own`; fixed at reset."""
        return tuple([column for _, columns in self._logged_blocks for column in columns])

    @property
    def cascade(self) -> Cascade:
        """Built-in controller, for tuning and analysis.  Raises InputError if another controller flies."""
        if not isinstance(self.controller, Cascade):
            raise InputError(f"{type(self.controller).__name__} flies, and has not the parts of the built-in cascade")
        return self.controller

    @property
    def flown_scenario(self) -> Scenario:
        """Scenario with the actual faults, commanded ones included, to fly it again."""
        if not self.faults.commanded:
            return self.scenario
        faults = [fault.model_dump(mode="json", exclude_none=True) for fault in self.faults.flown_faults]
        return self.scenario.replace(fault=faults, monitor=self.scenario.monitored)

    def inject(self, fault: Fault) -> None:
        """Start ``fault`` at the next step, whatever its ``start_s``; :attr:`flown_scenario` includes it.

        Whether engines are watched was settled before the flight: see ``monitor`` of the scenario.  Raises InputError
        as for a scenario's fault.
        """
        self.faults.inject(fault, self.k)

    def clear_faults(self) -> None:
        """End all active faults at the next step; later ones stay.

        The vehicle is repaired: an engine that was taken for lost is believed again as soon as all stand idle.
        """
        self.controller.forgive()
        self.faults.clear(self.k)

    def run(
        self, observers: Iterable[Observer] = (), pace: Pace | None = None, between: Between | None = None
    ) -> Ending:
        """Fly to the end of the scenario or of the flight.

        Without a ``pace`` it flies as fast as it goes.  ``between`` is called before every step: there the pilot is
        asked things, and the flight ended.
        """
        observe = [observer.observe for observer in observers]
        if pace:
            pace.start(self.k)
        for _ in range(self.scenario.steps - self.k):
            if between:
                ending = between(self.k)
                if ending:
                    return ending
            try:
                sample = self.step()
            except FlightError as error:
                return self.make_failure(error)
            except ArithmeticError as error:  # a gain or a speed has diverged
                return self.make_failure(FlightError(f"a number is out of range: {error}"))
            for look in observe:
                look(sample)
            ending = self.check_end(sample, observe)
            if ending:
                return ending
            if pace:
                pace.wait(self.k)
        late = f", {pace.missed} of them late" if pace and pace.missed else ""
        return Ending("completed", f"flew {self.k} steps{late}")

    def make_failure(self, error: FlightError) -> Ending:
        """Return the ending "failed" for an error in this step; engine errors state their own time."""
        when = "" if isinstance(error, EngineError) else f" at step {self.k} ({self.k * self.dt:.3f} s)"
        return Ending("failed", f"{error}{when}")

    def check_end(self, sample: Sample, observe: Iterable[Callable[[Sample], None]]) -> Ending | None:
        """Return the ending, if the flight is over after the step of ``sample``.

        The observers then get one more sample, of the state that ended the flight and what acted until then.
        """
        ending = self.termination.check(self.state, self.k * self.dt)
        if ending:
            last = sample._replace(k=self.k, time=self.k * self.dt, state=self.state, measured=self.measured)
            for look in observe:
                look(last)
        return ending

    def check_repeatable(self) -> bool | None:
        """Whether an external controller repeats its answers; None: there is none."""
        return None if self._plugged is None else self._plugged.check_repeatable()

    def close(self) -> None:
        """Free engines, airframe and external controller; may be called twice."""
        if self._plugged is not None:
            self._plugged.close()
        self.propulsion.close()
        self.airframe.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
