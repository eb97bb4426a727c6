"""The controller: attitude, rate and altitude loops over an allocation that plans around lost engines."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from typing import Final, Protocol, cast

from cosim.base.constants import GRAVITY
from cosim.base.frames import conjugate, rotate
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
    JetHealth,
    Measured,
    PerJet,
    Unallocated,
    Vector3,
)
from cosim.control.allocation.allocation import TiltAllocator
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.control.allocation.engine_monitor import EngineMonitor
from cosim.control.allocation.hinged_catch import HingedCatch
from cosim.control.allocation.thrust_map import ThrustMap
from cosim.control.altitude import LEAST_UPRIGHT, AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.catch import Catch
from cosim.control.predictors.smith import DelayLine
from cosim.control.rate import RateController
from cosim.control.reduced_attitude import ReducedAttitude
from cosim.control.schedule import GainSchedule, Scheduled
from cosim.control.wing import DENSITY, WingFlight
from cosim.spec.vehicle import Vehicle

# s from switching engines on to where they must run: chosen by us, longer than a jet takes to spool up to idle
_LONGEST_START: Final = 10.0
_FLY: Final = EngineState.FLY


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


class Cascade:
    """The built-in :class:`cosim.base.protocols.Controller`: the paper's cascade.

    The parts are its own to run and anybody's to look at; who tunes them in flight does so through their ``retune``.
    ``added_delay``: of the roll command, steps; ``opposites``: for every jet, from 0, the one that is to be shut off
    with it, none where empty; ``catch`` flies from then on until the thrust is made up for.  ``reduced`` flies as soon
    as one of four rotors is lost.  ``own_attitude`` and ``own_rate`` fly in place of the loop that they are named
    after.
    """

    def __init__(
        self,
        attitude: AttitudeController,
        rate: RateController,
        altitude: AltitudeController,
        allocator: Allocator,
        thrust_map: ThrustMap,
        monitor: EngineMonitor | None,
        schedule: GainSchedule | None,
        vehicle: Vehicle,
        added_delay: int,
        opposites: Sequence[int],
        step: float,
        own_attitude: OwnAttitude | None = None,
        own_rate: OwnRate | None = None,
        catch: Catch | None = None,
        reduced: ReducedAttitude | None = None,
        wing: WingFlight | None = None,
    ) -> None:
        self.own_attitude, self.own_rate = own_attitude, own_rate
        self.attitude, self.rate, self.altitude = attitude, rate, altitude
        self.allocator: TiltAllocator | Allocator = allocator
        self.thrust_map = thrust_map
        self.monitor, self.schedule = monitor, schedule
        self._catch, self._reduced, self._wing = catch, reduced, wing
        self._added_delay = DelayLine(added_delay)
        self._mass, self._jets, self._step = vehicle.mass_kg, len(vehicle.jets), step
        self._low = vehicle.control.allocation.throttle_min
        self._opposites = list(opposites)
        self._winged = allocator if isinstance(allocator, EffectivenessAllocator) and allocator.surfaces else None
        self._hinged = allocator if isinstance(allocator, HingedCatch) else None
        self._every_jet = frozenset(range(self._jets))
        self._throttle: PerJet = ()
        self._shows: list[tuple[str, Predictor, tuple[Column, ...]]] = []  # the predictors that show of their own
        self._forget(0.0)

    def _forget(self, burnt: float) -> None:
        self._burnt = burnt
        if self._reduced is not None:
            self._reduced.end()
        if self._wing is not None:
            self._wing.reset()
        self._unallocated = Unallocated(0.0, 0.0, 0.0, 0.0)
        self.signals = ControlSignals(ZERO3, ZERO3, ZERO3, 0.0, 0.0)
        self._off = NO_JETS  # jets that are to be shut off
        self._across = -1  # the one that was shut off because its opposite was lost, from 0
        self._engines_off = self._idles = self._forgiven = self._cold = False
        self._catching = False  # an engine is lost, and what that leaves is not yet in balance
        self._starting = 0.0  # s for which engines that were off may still be coming up

    def reset(self, on_ground: bool, burnt: float) -> PerJet:
        """At rest; the throttles of the start.  See :class:`cosim.base.protocols.Controller`."""
        self._forget(burnt)
        told = [
            (axis, predictor, columns_of(predictor)) for axis, predictor in zip(AXES, self.rate.predictors, strict=True)
        ]
        self._shows = [] if self.own_rate is not None else [entry for entry in told if entry[2]]
        self.allocator.reset()
        self._reset_loops()
        hover = self.allocator.hover
        if burnt:
            hover = self.thrust_map.share((self._mass - burnt) * GRAVITY / self._jets)
        if self.schedule is not None:
            self._follow(self.schedule.reset(hover))
        shares = (self._low,) * self._jets if on_ground else self.allocator.trim(hover)
        throttle = self._throttle = self.thrust_map.throttle(shares)
        if self.monitor is not None:
            self.monitor.reset(throttle)
        return throttle

    def _reset_loops(self) -> None:
        self.attitude.reset()
        self.altitude.reset()
        self.rate.reset()
        self._added_delay.reset()
        if self.own_attitude is not None:
            self.own_attitude.reset()
        if self.own_rate is not None:
            self.own_rate.reset()

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Throttles and tilts of one step."""
        if engines is not _FLY or self._idles:
            self._switch(engines)
        hinged, wing = self._hinged, self._wing
        if wing is not None:
            command = self._on_the_wing(wing, command, measured)
        own_attitude, own_rate = self.own_attitude, self.own_rate
        if hinged is not None and hinged.leans and own_attitude is None and (wing is None or not wing.flies):
            rate_setpoint = self.attitude.thrust_first(command, measured, hinged.lean)
        elif own_attitude is None or command.rate is not None:
            rate_setpoint = self.attitude.update(command, measured)
        else:
            rate_setpoint = own_attitude.update(command, measured)
        if self._idles:
            return self._idle(rate_setpoint)
        if own_rate is None:
            torque = self.rate.update(rate_setpoint, measured.rate, self._unallocated)
        else:
            torque = own_rate.update(rate_setpoint, measured.rate, self._unallocated)
        collective = self.altitude.update(command, measured, self._unallocated, self._burnt)
        if self._reduced is not None and self._reduced.flies:
            return self._spun(self._reduced, command, measured, injected, rate_setpoint, torque, collective)
        if self._catching and self._catch is not None and command.rate is None:
            return self._caught(self._catch, command, measured, injected, rate_setpoint, torque, collective)
        if self._winged is not None:
            self._winged.pressure = _dynamic_pressure(measured)
            if wing is not None and wing.flies:
                return self._ahead(wing, self._winged, measured, injected, rate_setpoint, torque, collective)
        given = self.allocator.allocate(collective, self._injected(torque, injected), injected.torque_command)
        self._unallocated = given.unallocated
        return self._actuated(given, self._share(given, rate_setpoint, torque, collective))

    def _share(self, given: Actuation, rate_setpoint: Vector3, torque: Vector3, collective: float) -> float:
        """The collective that allocation gave, shown with what the loops asked for."""
        share = collective - given.unallocated.collective
        predicted = self.rate.predicted if self.own_rate is None else self.own_rate.predicted
        self.signals = ControlSignals(rate_setpoint, predicted, torque, collective, share)
        return share

    def _on_the_wing(self, wing: WingFlight, command: Command, measured: Measured) -> Command:
        """Where a speed ahead is asked for, with the attitude that the wing needs for it."""
        if command.ahead is None or command.rate is not None or command.collective is not None or self._idles:
            wing.end()
            return command
        return wing.attitude(command, command.ahead, measured)

    def _ahead(
        self,
        wing: WingFlight,
        allocator: EffectivenessAllocator,
        measured: Measured,
        injected: Disturbance,
        rate_setpoint: Vector3,
        torque: Vector3,
        collective: float,
    ) -> Actuation:
        """Forces along and up of which the wing carries its part; see :mod:`cosim.control.wing`."""
        _, x, y, _ = measured.attitude
        upright = max(LEAST_UPRIGHT, 1.0 - 2.0 * (x * x + y * y))
        # of the height loop as a force up: it divides by how upright the thrust stands, which here is turned as wanted
        demand = wing.demand(allocator.force(collective) * upright, measured, self._burnt)
        (roll, pitch, yaw), (a, b, c) = self._injected(torque, injected), injected.torque_command
        asked = (roll + a, pitch + b, yaw + c)
        given, missing = allocator.ahead(demand.ahead, demand.lift, demand.pitch, asked, wing.tilts)
        self._unallocated = wing.refused(missing, given.unallocated)
        return self._actuated(given, self._share(given, rate_setpoint, torque, collective))

    def _caught(
        self,
        catch: Catch,
        command: Command,
        measured: Measured,
        injected: Disturbance,
        rate_setpoint: Vector3,
        torque: Vector3,
        usual: float,
    ) -> Actuation:
        """Roll and collective by the catch; the usual loops are told that allocation refused the rest of theirs."""
        _, x, y, _ = measured.attitude
        upright = max(LEAST_UPRIGHT, 1.0 - 2.0 * (x * x + y * y))
        climb = 0.0 if command.collective is not None else self.altitude.climb(command.altitude - measured.altitude)
        roll, collective = catch.update(
            -self.attitude.error(command, measured)[0],
            measured.rate[0],
            -measured.velocity[2],
            climb,
            upright,
            self._mass - self._burnt,
        )
        if command.collective is not None:
            collective = max(catch.least, command.collective)
        elif catch.caught:
            self._catching = False
        asked = (roll, torque[1], torque[2])
        given = self.allocator.allocate(collective, self._injected(asked, injected), injected.torque_command)
        left = given.unallocated
        catch.asked(roll - left.roll, collective - left.collective)
        share = collective - left.collective
        self._unallocated = Unallocated(torque[0] - (roll - left.roll), left.pitch, left.yaw, usual - share)
        self.signals = ControlSignals(rate_setpoint, self.rate.predicted, asked, collective, share)
        return self._actuated(given, share)

    def _spun(
        self,
        reduced: ReducedAttitude,
        command: Command,
        measured: Measured,
        injected: Disturbance,
        rate_setpoint: Vector3,
        torque: Vector3,
        collective: float,
    ) -> Actuation:
        """The direction of thrust and no heading; whoever asks for rates gets it upright.  The usual loops wait."""
        upright = command if command.rate is None else command._replace(attitude=ZERO3)
        every, thrust_map = self._jets, self.thrust_map
        total = every * (thrust_map.low + thrust_map.span * collective)
        (roll, pitch, yaw), unknown = self._injected(ZERO3, injected), injected.torque_command
        added = (roll + unknown[0], pitch + unknown[1], yaw + unknown[2])
        throttle, given = reduced.update(self.attitude.direction(upright, measured), measured.rate, total, added)
        share = (given / every - thrust_map.low) / thrust_map.span
        self._unallocated = Unallocated(torque[0], torque[1], torque[2], collective - share)
        self.signals = ControlSignals(rate_setpoint, self.rate.predicted, ZERO3, collective, share)
        return self._actuated(Actuation(throttle, self.allocator.rest, self._unallocated, NO_JETS), share)

    def _switch(self, engines: EngineState) -> None:
        """Engines off or on again as the pilot says; on again are all of them."""
        self._idles, off = engines is not _FLY, engines is EngineState.OFF
        if off != self._engines_off:
            self._off = self._every_jet if off else NO_JETS
        self._engines_off = off
        self._cold = engines is EngineState.START

    def _idle(self, rate_setpoint: Vector3) -> Actuation:
        """Every engine at its least throttle, the hinges at rest, and loops that remember nothing when needed again."""
        self._reset_loops()
        self._catching = False
        if self._reduced is not None:
            self._reduced.end()
        low = self._low
        self._unallocated = Unallocated(0.0, 0.0, 0.0, -low)
        self.signals = ControlSignals(rate_setpoint, self.rate.predicted, ZERO3, 0.0, low)
        return self._actuated(Actuation((low,) * self._jets, self.allocator.rest, self._unallocated, NO_JETS), low)

    def _injected(self, torque: Vector3, injected: Disturbance) -> Vector3:
        """The rate loop's output with what is added to it there, roll after the added delay."""
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

    def _actuated(self, given: Actuation, share: float) -> Actuation:
        """Throttles that ask each engine for its share of the thrust; the gains of the next step follow ``share``."""
        if self.schedule is not None:
            scheduled = self.schedule.update(share)
            if scheduled is not None:
                self._follow(scheduled)
        if not self.thrust_map.identity or self._off:
            given = Actuation(self.thrust_map.throttle(given.throttle), given.tilt, given.unallocated, self._off)
        self._throttle = given.throttle
        return given

    def _follow(self, at: Scheduled) -> None:
        """The gains and leads of the thrust level from the next step on."""
        roll, altitude = at.roll, at.altitude
        self.attitude.follow(roll.angle)
        self.rate.follow_roll(roll.p, roll.i, roll.d, roll.lead)
        self.altitude.follow(altitude.angle, altitude.p, altitude.i, altitude.lead)

    def watch(self, engines: EngineOutput, burnt: float) -> PerJet:
        """Judge the engines; what is found acts from the next step on."""
        self._burnt = burnt
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
            if self._reduced is not None:
                self._spin(self._reduced, monitor)
            elif self._opposites:
                self._shut_opposite(monitor)
            self.allocator.replan(monitor.health)
        if self._hinged is not None:
            self._hinged.look(monitor.reported)
        if self._catching and self._catch is not None:
            self._catch.look(monitor.reported, monitor.gains)
        if self._reduced is not None and self._reduced.flies:
            self._reduced.look(monitor.reported)
        return monitor.gains

    def _shut_opposite(self, monitor: EngineMonitor) -> None:
        """With the first engine lost shut off the one across: its thrust goes the same way, and the moment with it."""
        ill = [i for i, gain in enumerate(monitor.gains) if gain < 1.0]
        if len(ill) == 1 and monitor.health[ill[0]] == JetHealth(0.0):
            self._across = self._opposites[ill[0]]
            self._off = self._off | {self._across}
            monitor.give_up(self._across)
            if self._catch is not None:
                self._catching = True
                self._catch.reset(monitor.reported, monitor.gains, (self._mass - self._burnt) * GRAVITY)

    def _spin(self, reduced: ReducedAttitude, monitor: EngineMonitor) -> None:
        """With the first rotor lost hold the direction of thrust alone."""
        lost = [i for i, health in enumerate(monitor.health) if health == JetHealth(0.0)]
        if len(lost) == 1 and not reduced.flies:
            reduced.begin(lost[0], monitor.reported, monitor.asked)

    def forgive(self) -> None:
        """As soon as all engines are back at idle, none is taken for lost any more."""
        self._forgiven = True

    def _believe(self, engines: EngineOutput) -> None:
        monitor = self.monitor
        if monitor is None or monitor.settled(self._throttle, engines):
            self._forgiven, self._across = False, -1
            if monitor is not None:
                monitor.reset(self._throttle)
            self.allocator.reset()

    @property
    def lost(self) -> tuple[int, ...]:
        """The jets, from 1, that are taken for lost; not the one that was shut off on purpose."""
        gains: PerJet = () if self.monitor is None else self.monitor.gains
        return tuple([jet for jet, gain in enumerate(gains, 1) if gain < 1.0 and jet - 1 != self._across])

    @property
    def diagnostics(self) -> tuple[Diagnostics, Diagnostics, Diagnostics]:
        """As :attr:`RateController.diagnostics`; NaN under a rate loop of the user's."""
        return self.rate.diagnostics if self.own_rate is None else (UNKNOWN3, UNKNOWN3, UNKNOWN3)

    @property
    def columns(self) -> tuple[Column, ...]:
        """What predictors show of their own, each with its axis before the name, and own loops: see :class:`Shows`."""
        own = [*columns_of(self.own_attitude), *columns_of(self.own_rate), *columns_of(self._wing)]
        return tuple(
            [column._replace(name=f"{axis}_{column.name}") for axis, _, columns in self._shows for column in columns]
            + own
        )

    @property
    def shown(self) -> tuple[float, ...]:
        """Their numbers; NaN of one whose place another has taken in flight."""
        answer: list[float] = []
        for axis, predictor, columns in self._shows:
            there = self.rate.predictors[AXES.index(axis)] is predictor
            answer += cast(Shows, predictor).shown if there else (nan,) * len(columns)
        for block in (self.own_attitude, self.own_rate, self._wing):
            if columns_of(block):
                answer += cast(Shows, block).shown
        return tuple(answer)


def _dynamic_pressure(measured: Measured) -> float:
    """Pa, of the speed ahead over the ground in still air of standard density; 0 backwards."""
    ahead = rotate(conjugate(measured.attitude), measured.velocity)[0]
    return 0.5 * DENSITY * ahead * ahead if ahead > 0.0 else 0.0
