"""The controller: attitude, rate and altitude loops over an allocation that plans around lost engines."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Final, cast

from cosim.base.constants import GRAVITY
from cosim.base.protocols import Allocator, Column, Diagnostics, EngineState, Predictor, Shows, columns_of
from cosim.base.signals import (
    ALL_WELL,
    AXES,
    NO_JETS,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Command,
    ControlSignals,
    Disturbance,
    EngineOutput,
    Measured,
    PerJet,
    Unallocated,
)
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.control.altitude import AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.phases.law import NOTHING_LEFT, Demand, FlightLaw, Loops, Selector
from cosim.control.rate import RateController
from cosim.control.schedule import GainSchedule
from cosim.spec.vehicle import Vehicle

# s from switching engines on to where they must run: chosen by us, longer than a jet takes to spool up to idle
_LONGEST_START: Final = 10.0
_FLY: Final = EngineState.FLY


class Cascade:
    """The built-in :class:`cosim.base.protocols.Controller`: the paper's cascade.

    The loops are its own to run and anybody's to look at; who tunes them in flight does so through their ``retune``.
    ``laws``: of the phases of flight, of which the first that wants to flies; the last is that of hover.
    """

    def __init__(
        self,
        loops: Loops,
        thrust_map: ThrustMap,
        monitor: EngineMonitor | None,
        schedule: GainSchedule | None,
        laws: Sequence[FlightLaw],
        vehicle: Vehicle,
        step: float,
    ) -> None:
        self.loops, self.thrust_map = loops, thrust_map
        self.monitor, self.schedule = monitor, schedule
        self.selector = Selector(laws)
        self._demand = Demand()
        self._mass, self._jets, self._step = vehicle.mass_kg, len(vehicle.jets), step
        self._low = vehicle.control.allocation.throttle_min
        self._every_jet = frozenset(range(self._jets))
        self._throttle: PerJet = ()
        self._shows: list[tuple[str, Predictor, tuple[Column, ...]]] = []  # the predictors that show of their own
        self._forget(0.0)

    @property
    def attitude(self) -> AttitudeController:
        """From attitude to rates."""
        return self.loops.attitude

    @attitude.setter
    def attitude(self, loop: AttitudeController) -> None:
        self.loops.attitude = loop

    @property
    def rate(self) -> RateController:
        """From rates to torque."""
        return self.loops.rate

    @property
    def altitude(self) -> AltitudeController:
        """From height to collective."""
        return self.loops.altitude

    @property
    def allocator(self) -> Allocator:
        """From torque and collective to throttles and angles."""
        return self.loops.allocator

    def _forget(self, burnt: float) -> None:
        self._demand.burnt, self._demand.unallocated = burnt, NOTHING_LEFT
        self.selector.reset()
        self.signals = ControlSignals(ZERO3, ZERO3, ZERO3, 0.0, 0.0)
        self._off = NO_JETS  # jets that are to be shut off
        self._across = NO_JETS  # those of them that a law shut off because others were lost
        self._engines_off = self._idles = self._forgiven = self._cold = False
        self._starting = 0.0  # s for which engines that were off may still be coming up

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """At rest; the throttles of the start.  See :class:`cosim.base.protocols.Controller`."""
        self._forget(burnt)
        loops = self.loops
        told = [
            (axis, predictor, columns_of(predictor))
            for axis, predictor in zip(AXES, loops.rate.predictors, strict=True)
        ]
        self._shows = [] if loops.own_rate is not None else [entry for entry in told if entry[2]]
        loops.allocator.reset()
        loops.reset()
        hover = loops.allocator.hover
        if burnt:
            hover = self.thrust_map.share((self._mass - burnt) * GRAVITY / self._jets)
        if self.schedule is not None:
            loops.follow(self.schedule.reset(hover))
        shares = (self._low,) * self._jets if on_ground else loops.allocator.trim(hover)
        throttle = self._throttle = self.thrust_map.throttle(shares)
        if self.monitor is not None:
            self.monitor.reset(throttle)
        return throttle

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Throttles and tilts of one step."""
        if engines is not _FLY or self._idles:
            self._switch(engines)
        step, loops = self._demand, self.loops
        step.command, step.measured, step.injected, step.idle = command, measured, injected, self._idles
        law = self.selector.select(step)
        step.rate_setpoint = law.steer(step)
        if self._idles:
            return self._idle(step)
        loops.ask(step)
        given = law.update(step)
        self.signals = ControlSignals(step.rate_setpoint, loops.predicted, step.torque, step.collective, step.given)
        return self._actuated(given, step.given)

    def _switch(self, engines: EngineState) -> None:
        """Engines off or on again as the pilot says; on again are all of them."""
        self._idles, off = engines is not _FLY, engines is EngineState.OFF
        if off != self._engines_off:
            self._off = self._every_jet if off else NO_JETS
        self._engines_off = off
        self._cold = engines is EngineState.START

    def _idle(self, step: Demand) -> Actuation:
        """Every engine at its least throttle, the hinges at rest, and loops that remember nothing when needed again."""
        loops, low = self.loops, self._low
        loops.reset()
        self.selector.idle()
        step.unallocated = Unallocated(0.0, 0.0, 0.0, -low)
        self.signals = ControlSignals(step.rate_setpoint, loops.rate.predicted, ZERO3, 0.0, low)
        return self._actuated(Actuation((low,) * self._jets, loops.allocator.rest, step.unallocated, NO_JETS), low)

    def _actuated(self, given: Actuation, share: float) -> Actuation:
        """Throttles that ask each engine for its share of the thrust; the gains of the next step follow ``share``."""
        if self.schedule is not None:
            scheduled = self.schedule.update(share)
            if scheduled is not None:
                self.loops.follow(scheduled)
        if not self.thrust_map.identity or self._off:
            given = Actuation(self.thrust_map.throttle(given.throttle), given.tilt, given.unallocated, self._off)
        self._throttle = given.throttle
        return given

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Judge the engines; what is found acts from the next step on."""
        self._demand.burnt = burnt
        health = ALL_WELL if self.monitor is None else self._judged(self.monitor, engines)
        if self._forgiven and self._idles:
            self._believe(engines)
        return health

    def _judged(self, monitor: EngineMonitor, engines: EngineOutput) -> PerJet:
        if self._engines_off or self._cold:
            # nothing can be told of engines that are off on purpose, nor of those that have yet to come up
            self._starting = _LONGEST_START
        elif self._starting > 0.0:
            self._starting -= self._step
            if monitor.started(self._throttle, engines):
                self._starting = 0.0
            monitor.resume(self._throttle)
        elif monitor.update(self._throttle, engines):
            for law in self.selector.laws:
                across = law.lose(monitor, self._demand.burnt)
                if across:
                    self._off, self._across = self._off | across, across
            self.loops.allocator.replan(monitor.health)
        for law in self.selector.laws:
            law.look(monitor)
        return monitor.gains

    def forgive(self) -> None:
        """As soon as all engines are back at idle, none is taken for lost any more."""
        self._forgiven = True

    def _believe(self, engines: EngineOutput) -> None:
        monitor = self.monitor
        if monitor is None or monitor.settled(self._throttle, engines):
            self._forgiven, self._across = False, NO_JETS
            if monitor is not None:
                monitor.reset(self._throttle)
            self.loops.allocator.reset()

    @property
    def lost(self) -> tuple[int, ...]:
        """The jets, from 1, that are taken for lost; not the one that was shut off on purpose."""
        gains: PerJet = () if self.monitor is None else self.monitor.gains
        return tuple([jet for jet, gain in enumerate(gains, 1) if gain < 1.0 and jet - 1 not in self._across])

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """As :attr:`RateController.diagnostics`; NaN under a rate loop of the user's."""
        return self.loops.rate.diagnostics if self.loops.own_rate is None else (UNKNOWN3, UNKNOWN3, UNKNOWN3)

    @property
    def columns(self) -> tuple[Column, ...]:
        """What predictors show, each with its axis before the name, then own loops and laws: see :class:`Shows`."""
        own = [column for block in self._own for column in columns_of(block)]
        return tuple(
            [column._replace(name=f"{axis}_{column.name}") for axis, _, columns in self._shows for column in columns]
            + own
        )

    @property
    def shown(self) -> tuple[float, ...]:
        """Their numbers; NaN of one whose place another has taken in flight."""
        answer: list[float] = []
        for axis, predictor, columns in self._shows:
            there = self.loops.rate.predictors[AXES.index(axis)] is predictor
            answer += cast(Shows, predictor).shown if there else (nan,) * len(columns)
        for block in self._own:
            if columns_of(block):
                answer += cast(Shows, block).shown
        return tuple(answer)

    @property
    def _own(self) -> list[object]:
        """What may show numbers of its own beside predictors."""
        return [self.loops.own_attitude, self.loops.own_rate, *self.selector.laws]
