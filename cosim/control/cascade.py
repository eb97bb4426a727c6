"""The controller: attitude, rate and altitude loops over an allocation that is replanned around lost engines."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Final, cast

from cosim.base.constants import GRAVITY
from cosim.base.protocols import Allocator, Column, Diagnostics, EngineState, Predictor, Shows, columns_of
from cosim.base.signals import (
    ALL_HEALTHY,
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
from cosim.control.phases.law import FULLY_ALLOCATED, Demand, FlightLaw, Loops, Selector
from cosim.control.rate import RateController
from cosim.control.schedule import GainSchedule
from cosim.spec.vehicle import Vehicle

_FLY: Final = EngineState.FLY  # direct access in compiled code
_SIGNALS: Final = ControlSignals  # direct access in compiled code


class Cascade:
    """The built-in :class:`cosim.base.protocols.Controller`: the paper's cascade.

    The loops are read-only for callers; their gains change in flight through ``retune``.  ``laws``: of the phases of
    flight, of which the first that wants to flies; the last is that of hover.  ``lost``: the jets, from 1, that are
    considered lost; not the one that was shut off on purpose.
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
        self._predictor_columns: list[
            tuple[str, Predictor, tuple[Column, ...]]
        ] = []  # names of the predictors' log columns
        self._shown_blocks = self._find_shown_blocks()
        self._clear_state(0.0)

    @property
    def attitude(self) -> AttitudeController:
        """The loop from attitude to body rates."""
        return self.loops.attitude

    @attitude.setter
    def attitude(self, loop: AttitudeController) -> None:
        self.loops.attitude = loop

    @property
    def rate(self) -> RateController:
        """The loop from body rates to torque."""
        return self.loops.rate

    @property
    def altitude(self) -> AltitudeController:
        """The loop from height to collective."""
        return self.loops.altitude

    @property
    def allocator(self) -> Allocator:
        """The allocator from torque and collective to throttles and angles."""
        return self.loops.allocator

    def _clear_state(self, burnt: float) -> None:
        self._demand.burnt, self._demand.unallocated = burnt, FULLY_ALLOCATED
        self.selector.reset()
        self.signals = ControlSignals(ZERO3, ZERO3, ZERO3, 0.0, 0.0)
        self._off = NO_JETS  # jets commanded off
        self._shut_by_law = NO_JETS  # shut off because another jet failed
        self.lost: tuple[int, ...] = ()
        self._engines_off = self._is_idle = self._clears_losses = self._is_cold = False
        self._starting = 0.0  # s left until restarted engines run

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """Start a flight at rest and return its first throttles.  See :class:`cosim.base.protocols.Controller`."""
        self._clear_state(burnt)
        loops = self.loops
        columns = [
            (axis, predictor, columns_of(predictor))
            for axis, predictor in zip(AXES, loops.rate.predictors, strict=True)
        ]
        self._predictor_columns = [] if loops.custom_rate is not None else [entry for entry in columns if entry[2]]
        self._shown_blocks = self._find_shown_blocks()
        loops.allocator.reset()
        loops.reset()
        hover = loops.allocator.hover
        if burnt:
            hover = self.thrust_map.fraction((self._mass - burnt) * GRAVITY / self._jets)
        if self.schedule is not None:
            loops.apply_schedule(self.schedule.reset(hover))
        fractions = (self._low,) * self._jets if on_ground else loops.allocator.trim(hover)
        throttle = self._throttle = self.thrust_map.throttle(fractions)
        if self.monitor is not None:
            self.monitor.reset(throttle)
        return throttle

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Return the throttles and tilts of one step."""
        if engines is not _FLY or self._is_idle:
            self._switch(engines)
        demand, loops = self._demand, self.loops
        demand.command, demand.measured, demand.injected, demand.is_idle = command, measured, injected, self._is_idle
        law = self.selector.select(demand)
        demand.rate_setpoint = law.steer(demand)
        if self._is_idle:
            return self._idle(demand)
        loops.update(demand)
        actuation = law.update(demand)
        self.signals = _SIGNALS(
            demand.rate_setpoint, loops.predicted, demand.torque, demand.collective, demand.allocated
        )
        return self._actuate(actuation, demand.allocated)

    def _switch(self, engines: EngineState) -> None:
        """Switch all engines off, to idle or on, as the pilot commands."""
        self._is_idle, off = engines is not _FLY, engines is EngineState.OFF
        if off != self._engines_off:
            self._off = self._every_jet if off else NO_JETS
        self._engines_off = off
        self._is_cold = engines is EngineState.START

    def _idle(self, demand: Demand) -> Actuation:
        """Return the least throttle for every engine and hinges at rest, and reset the loops."""
        loops, low = self.loops, self._low
        loops.reset()
        self.selector.idle()
        demand.unallocated = Unallocated(0.0, 0.0, 0.0, -low)
        self.signals = ControlSignals(demand.rate_setpoint, loops.rate.predicted, ZERO3, 0.0, low)
        return self._actuate(Actuation((low,) * self._jets, loops.allocator.rest, demand.unallocated, NO_JETS), low)

    def _actuate(self, actuation: Actuation, fraction: float) -> Actuation:
        """Return thrust fractions converted to throttles, and schedule the next gains by their mean ``fraction``."""
        if self.schedule is not None:
            scheduled = self.schedule.update(fraction)
            if scheduled is not None:
                self.loops.apply_schedule(scheduled)
        if not self.thrust_map.identity or self._off:
            actuation = Actuation(
                self.thrust_map.throttle(actuation.throttle), actuation.tilt, actuation.unallocated, self._off
            )
        self._throttle = actuation.throttle
        return actuation

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Monitor the engines; a failure acts from the next step on."""
        self._demand.burnt = burnt
        health = ALL_HEALTHY if self.monitor is None else self._update_monitor(self.monitor, engines)
        if self._clears_losses and self._is_idle:
            self._clear_losses(engines)
        return health

    def _update_monitor(self, monitor: EngineMonitor, engines: EngineOutput, longest_start_s: float = 10.0) -> PerJet:
        """Update the monitor, and return each engine's fraction of its thrust; starts take 10 s at most."""
        if self._engines_off or self._is_cold:
            # Engines that are off on purpose, or have yet to start, cannot be monitored.
            self._starting = longest_start_s
        elif self._starting > 0.0:
            self._starting -= self._step
            if monitor.have_started(self._throttle, engines):
                self._starting = 0.0
            monitor.resume(self._throttle)
        elif monitor.update(self._throttle, engines):
            for law in self.selector.laws:
                shut = law.handle_loss(monitor, self._demand.burnt)
                if shut:
                    self._off, self._shut_by_law = self._off | shut, shut
            self.loops.allocator.replan(monitor.health)
            self.lost = self._find_failed_jets(monitor)
        for law in self.selector.laws:
            law.observe(monitor)
        return monitor.gains

    def forgive(self) -> None:
        """Count all engines as healthy again, as soon as they are back at idle."""
        self._clears_losses = True

    def _clear_losses(self, engines: EngineOutput) -> None:
        monitor = self.monitor
        if monitor is None or monitor.have_settled(self._throttle, engines):
            self._clears_losses, self._shut_by_law = False, NO_JETS
            if monitor is not None:
                monitor.reset(self._throttle)
            self.lost = ()
            self.loops.allocator.reset()

    def _find_failed_jets(self, monitor: EngineMonitor) -> tuple[int, ...]:
        gains = enumerate(monitor.gains, 1)
        return tuple([jet for jet, gain in gains if gain < 1.0 and jet - 1 not in self._shut_by_law])

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """The diagnostics of :attr:`RateController.diagnostics`; NaN under a custom rate loop."""
        return self.loops.rate.diagnostics if self.loops.custom_rate is None else (UNKNOWN3, UNKNOWN3, UNKNOWN3)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Log columns of predictors, with their axis, then of user's loops and flight laws: see :class:`Shows`."""
        others = [column for block in self._shown_blocks for column in columns_of(block)]
        return tuple(
            [
                column._replace(name=f"{axis}_{column.name}")
                for axis, _, columns in self._predictor_columns
                for column in columns
            ]
            + others
        )

    @property
    def shown(self) -> tuple[float, ...]:
        """The values for :attr:`columns`; NaN for a predictor that was replaced in flight."""
        values: list[float] = []
        for axis, predictor, columns in self._predictor_columns:
            is_active = self.loops.rate.predictors[AXES.index(axis)] is predictor
            values += cast(Shows, predictor).shown if is_active else (nan,) * len(columns)
        for block in self._shown_blocks:
            values += block.shown
        return tuple(values)

    def _find_shown_blocks(self) -> list[Shows]:
        """Return the blocks other than predictors that have log columns."""
        blocks: list[object] = [self.loops.custom_attitude, self.loops.custom_rate, *self.selector.laws]
        return [cast(Shows, block) for block in blocks if columns_of(block)]
