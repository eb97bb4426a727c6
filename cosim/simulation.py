"""The step, the loop, and ``build``: the one place where the blocks are wired together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import cos, degrees, hypot, inf, nan, radians
from operator import mul
from typing import Literal, Protocol

from cosim.airflow import Airstreams
from cosim.airframe import Airframe, start_height
from cosim.atmosphere import standard_air
from cosim.banks import Banks
from cosim.commands import Commander
from cosim.config import nearest
from cosim.control.allocation import Allocator, RotorAllocator, TiltAllocator
from cosim.control.altitude import GRAVITY, AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.choice import PREDICTORS
from cosim.control.lead import Lead
from cosim.control.monitor import EngineMonitor
from cosim.control.predictor import DelayLine, NoPredictor, Predictor
from cosim.control.rate import RateController
from cosim.control.replan import get_ready
from cosim.control.schedule import GainSchedule, Scheduled
from cosim.control.thrust import StaticCurve, ThrustMap
from cosim.disturbances import Disturber
from cosim.engine import Air, EngineBank, EngineSpec, load_engine
from cosim.errors import EngineError, FlightError, InputError
from cosim.faults import SERVOS, Engines, Faults, Sensing, Servo
from cosim.frames import conjugate, cross, jet_axis, rotate
from cosim.fuel import Tank
from cosim.ground_effect import GroundJets
from cosim.ledger import LedgerRow, delay_ledger
from cosim.mismatch import as_flown, engines_as_flown
from cosim.pace import Pace
from cosim.pilot.modes import EngineState, Report
from cosim.placed import PlacePilot, flies_to_places
from cosim.reference import engine_reference
from cosim.scenario import Fault, Scenario, Station, is_file
from cosim.sensors import SensorSuite
from cosim.servo import TiltServo
from cosim.shutoff import Shutoff
from cosim.signals import (
    ALL_WELL,
    AXES,
    UNKNOWN3,
    ZERO3,
    Actuation,
    Ambient,
    Command,
    Disturbance,
    EngineOutput,
    JetHealth,
    Measured,
    PerJet,
    Refused,
    Sample,
    State,
    Vector3,
)
from cosim.spools import Spools
from cosim.vehicle import Limits, Vehicle, load_vehicle

# s from switching engines on to where they must run: chosen by us, longer than a jet takes to spool up to idle
_LONGEST_START = 10.0

Outcome = Literal["completed", "crashed", "diverged", "failed"]


class Resettable(Protocol):
    """A block that can start again."""

    def reset(self) -> None: ...


class Pilot(Protocol):
    """Flies in place of the scenario's commands; see :mod:`cosim.piloted`, and :mod:`cosim.placed` for scripts."""

    @property
    def engines(self) -> EngineState:
        """What the engines do with the command of the last update."""

    @property
    def seen(self) -> Measured:
        """What the loops fly the step of the last update with: the sensors, or what stands in for them."""

    def reset(self, measured: Measured) -> None: ...

    def update(self, k: int, measured: Measured, report: Report) -> Command:
        """The command of step ``k``."""


class Observer(Protocol):
    """Looks at every step and touches nothing."""

    def observe(self, sample: Sample) -> None:
        """Called once a step, after it."""


@dataclass(frozen=True)
class Ending:
    """How a flight ended, and why, in words."""

    outcome: Outcome
    reason: str


Between = Callable[[int], Ending | None]  # gets the number of the step to come


class Simulation:
    """One flight: all blocks, wired by :func:`build`, and the instant they stand at."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        specs: Sequence[EngineSpec],
        airframe: Airframe,
        engines: Engines,
        spools: Spools,
        control: Control,
        ledger: list[LedgerRow],
    ) -> None:
        self.scenario = scenario
        self.vehicle = vehicle
        self.engine, *self.stations = specs  # the scenario's engine, and the one at each station
        self.ledger = ledger
        self.dt = scenario.step_s
        self.airframe = airframe
        self.engines = engines
        laws = [station.flame_out for station in self.stations]
        self.shutoff = shutoff = Shutoff(engines, laws, scenario.step_s)
        self.attitude = control.attitude
        self.altitude = control.altitude
        self.rate = control.rate
        self.allocator = control.allocator
        self.thrust_map = control.thrust_map
        self.added_delay = DelayLine(scenario.added_delay_samples)
        servos = [TiltServo(vehicle.servo, self.dt) for _ in SERVOS] if vehicle.servo else []
        self.servos: list[Servo] = [*servos]
        self.sensors: Sensing = SensorSuite(vehicle.sensors, self.dt, scenario.seed, scenario.sensor_noise)
        self.monitor = control.monitor
        settings = vehicle.control.monitor
        self._opposite = opposites(vehicle) if settings is not None and settings.shut_opposite else ()
        self.schedule = control.schedule
        self.faults = Faults(
            scenario,
            engines,
            servos,
            self.sensors,
            laws,
            # not holding the simulation: what is closed is then freed at once, and JSBSim is a megabyte
            lambda jet: engine_reference(specs[jet + 1], scenario.step_s).lag,
            lambda: shutoff.off,
        )
        self._stated = scenario
        flown = as_flown(vehicle, scenario.mismatch)
        self._left = tuple(jet.servo == "left" for jet in vehicle.jets)
        places: list[Vector3] = [jet.position_m for jet in flown.jets]
        self._intakes: list[tuple[bool, Vector3]] = list(zip(self._left, places, strict=True))
        self._reactions = tuple(jet.reaction_m for jet in vehicle.jets)
        self._reacting = any(self._reactions)
        self.spools = spools if spools.any else None
        self.tank = Tank(vehicle.fuel.mass_kg, self.dt, scenario.initial.fuel) if vehicle.fuel else None
        banks = Banks(vehicle.servo, vehicle.jets, self.dt) if vehicle.servo else None
        self.banks = banks if banks is not None and banks.any else None
        self.streams = Airstreams(vehicle.airflow, flown.jets) if vehicle.airflow else None
        ground = vehicle.ground_effect
        near = GroundJets(ground, flown.jets) if ground else None
        self.suckdown = near if near is not None and near.suckdown else None
        self.hot_gas = near if near is not None and near.hot_gas else None
        self._height = start_height(flown, scenario.initial)
        self.commander = Commander(scenario, self._height)
        self.pilot: Pilot | None = None
        self.disturber = Disturber(scenario)
        self.judge = Judge(vehicle.limits)
        self.reset()

    def reset(self) -> None:
        """Back to ``t = 0``: everything at rest, the engines settled at the throttle that holds the vehicle up.

        Faults that were given by command are forgotten.
        """
        self.k = 0
        self.refused = Refused()
        self.scenario = self._stated
        self.faults.reset(self.scenario.fault)
        self._use_faulty()
        self.allocator.reset()
        blocks: list[Resettable] = [self.attitude, self.altitude, self.rate, self.added_delay, *self.servos]
        for block in blocks:
            block.reset()
        limits = self.vehicle.control.allocation
        burnt = 0.0
        if self.tank:
            self.tank.reset()
            burnt = self.tank.burnt
        hover = self.allocator.hover
        if burnt:
            hover = self.thrust_map.share((self.vehicle.mass_kg - burnt) * GRAVITY / len(self._left))
        share = limits.throttle_min if self.scenario.initial.on_ground else hover
        if self.schedule is not None:
            self._schedule(self.schedule.reset(hover))
        initial, wind = self.scenario.initial, self.disturber.at(0).wind
        self._standing = (0.0, 0.0)  # the servos
        if self.banks is not None:
            self.banks.reset()
        ambient = None
        self._airy = self.engines.wants_ambient
        if self._airy:
            # the air at the start is known once the airframe stands there, the thrust only in that air
            ambient = self._ambient(self.airframe.reset(initial, [ZERO3] * len(self._left), wind))
        throttle = self.thrust_map.throttle((share,) * len(self._left))
        delivered = self.engines.reset(throttle, ambient)
        if self.monitor is not None:
            self.monitor.reset(throttle)
        self.shutoff.reset()
        momentum = None
        if self.spools:
            self.spools.reset(delivered.spool_speed)
            momentum = self.spools.momentum
        self.judge.reset(initial.on_ground)
        self.state = self.airframe.reset(initial, self._jet_forces(delivered.thrust, (0.0, 0.0)), wind, momentum, burnt)
        self.measured = self.sensors.reset(self.state)
        self._collective = 0.0
        self._stopped = self._forgiven = False
        self._starting = 0.0  # s for which engines that were off may still be coming up
        self._across = -1  # the engine that was shut off because the one opposite was lost, from 0
        if self.pilot is not None:
            self.pilot.reset(self.measured)

    def step(self) -> Sample:
        """One control step over ``[t_k, t_k+1)``, every input held; see docs/design.md."""
        k, state, measured = self.k, self.state, self.measured
        if k >= self.faults.next:
            self._change_faults(k)
        pilot = self.pilot
        command = self.commander.at(k) if pilot is None else self._ask(pilot, k)
        seen = measured if pilot is None else pilot.seen
        disturbance = self.disturber.at(k)
        rate_setpoint = self.attitude.update(command, seen)
        torque = self.rate.update(rate_setpoint, seen.rate, self.refused)
        burnt = self.tank.burnt if self.tank is not None else 0.0
        collective = self.altitude.update(command, seen, self.refused, burnt)
        if pilot is not None and pilot.engines is not EngineState.FLY:
            torque, collective = self._stand()
            actuation = self._idle()
        else:
            actuation = self._allocate(collective, self._delayed(torque, disturbance), disturbance)
        if self.schedule is not None:
            scheduled = self.schedule.update(self._collective)
            if scheduled is not None:
                self._schedule(scheduled)
        engines = self._drive(k, actuation.throttle, state)
        health = self._watch(actuation.throttle, engines) if self.monitor is not None else ALL_WELL
        if self._forgiven and pilot is not None and pilot.engines is not EngineState.FLY:
            self._forgive(actuation.throttle, engines)
        tilt = self._standing = self._tilt(actuation.tilt)
        fuel = self._burn(engines.fuel_flow) if self.tank is not None else nan
        moment, spool_moment = self._rotor_moment(engines, tilt, state)
        forces = self._jet_forces(engines.thrust, tilt)
        if self.suckdown is not None:  # of the thrust alone
            forces, (x, y, z) = self.suckdown.act(forces, state)
            moment = (moment[0] + x, moment[1] + y, moment[2] + z)
        if self.streams is not None:
            forces, (x, y, z) = self.streams.act(forces, engines.thrust, tilt, state)
            moment = (moment[0] + x, moment[1] + y, moment[2] + z)
        if self.banks is not None:
            forces, (x, y, z) = self.banks.act(forces, tilt, state.rate)
            moment = (moment[0] + x, moment[1] + y, moment[2] + z)
        self.state = self.airframe.step(forces, disturbance, moment)
        self.measured = self.sensors.sample(self.state)
        self.refused = actuation.refused
        self.k = k + 1
        return Sample(
            k,
            k * self.dt,
            command,
            state,
            measured,
            rate_setpoint,
            self.rate.predicted,
            torque,
            collective,
            actuation,
            tilt,
            engines,
            disturbance,
            fuel,
            spool_moment,
            self.faults.flags,
            health,
        )

    def _ask(self, pilot: Pilot, k: int) -> Command:
        """The pilot's command for step ``k``, and the engines off or on as it says."""
        lost: tuple[int, ...] = ()
        if self.monitor is not None and self.monitor.gains != ALL_WELL[: len(self._left)]:
            off = self._across  # on purpose
            lost = tuple(jet for jet, gain in enumerate(self.monitor.gains, 1) if gain < 1.0 and jet - 1 != off)
        tank, fuel = self.tank, self.vehicle.fuel
        remaining = tank.left / fuel.mass_kg if tank and fuel else None
        command = pilot.update(k, self.measured, Report(self.state.on_ground, self._collective, lost, remaining))
        stopped = pilot.engines is EngineState.OFF
        if stopped and not self._stopped:
            self.shutoff.all_off()
        elif self._stopped and not stopped and not (tank and tank.empty):
            # an engine that has a fault of its own stays what the fault makes of it
            for jet in range(len(self._left)):
                if not self.faults.flags[jet]:
                    self.shutoff.set(jet, True)
        self._stopped = stopped
        return command

    def _stand(self) -> tuple[Vector3, float]:
        """Least throttle and no torque, with loops that remember nothing when they are needed again."""
        for block in (self.attitude, self.rate, self.altitude):
            block.reset()
        self.added_delay.reset()
        return ZERO3, 0.0

    def _idle(self) -> Actuation:
        """Every engine at its least throttle, the banks upright, whatever has been planned around a lost engine."""
        low = self.vehicle.control.allocation.throttle_min
        self._collective = low
        throttle = (low,) * len(self._left)
        return Actuation(self.thrust_map.throttle(throttle), (0.0, 0.0), Refused(0.0, 0.0, 0.0, -low))

    def _forgive(self, throttle: PerJet, engines: EngineOutput) -> None:
        """Once all engines are back at idle after a repair, take none for lost any more."""
        monitor = self.monitor
        if monitor is None or monitor.settled(throttle, engines):
            self._forgiven, self._across = False, -1
            if monitor is not None:
                monitor.reset(throttle)
            self.allocator.reset()

    def inject(self, fault: Fault) -> None:
        """Let ``fault`` begin at the next step, whatever its ``start_s``.

        :attr:`scenario` states it from there on, so that the flight can be flown again.  Whether engines are watched
        was settled before the flight: see ``monitor`` of the scenario.  Raises InputError as for a scenario's fault.
        """
        self._state_faults(self.faults.inject(fault, self.k))

    def clear_faults(self) -> None:
        """Let every fault that acts end at the next step; those still to come stay.

        The vehicle is repaired: an engine that the monitor took for lost is believed again as soon as all stand idle.
        """
        self._forgiven = True
        self._state_faults(self.faults.clear(self.k))

    def _state_faults(self, faults: Sequence[Fault]) -> None:
        stated = [fault.model_dump(mode="json", exclude_none=True) for fault in faults]
        self.scenario = self.scenario.replace(fault=stated, monitor=self.monitor is not None)

    def _change_faults(self, k: int) -> None:
        self.faults.change(k, self.measured)
        self._use_faulty()

    def _use_faulty(self) -> None:
        self.engines, self.servos, self.sensors = self.faults.engines, self.faults.servos, self.faults.sensors

    def _schedule(self, at: Scheduled) -> None:
        """The gains and leads of the thrust level from the next step on."""
        roll, altitude = at.roll, at.altitude
        self.attitude.follow(roll.angle)
        self.rate.follow_roll(roll.p, roll.i, roll.d, roll.lead)
        self.altitude.follow(altitude.angle, altitude.p, altitude.i, altitude.lead)

    def _watch(self, throttle: PerJet, engines: EngineOutput) -> PerJet:
        """Let the monitor look at the engines, and allocate around those it has given up from the next step on."""
        assert self.monitor is not None
        if self._stopped:
            # nothing can be told of engines that are off on purpose, nor of those that have yet to come up
            self._starting = _LONGEST_START
            return self.monitor.gains
        if self._starting > 0.0:
            self._starting -= self.dt
            if self.monitor.started(throttle, engines):
                self._starting = 0.0
            self.monitor.resume(throttle)
            return self.monitor.gains
        if self.monitor.update(throttle, engines):
            if self._opposite:
                self._shut_opposite(self.monitor)
            self.allocator.replan(self.monitor.health)
        return self.monitor.gains

    def _shut_opposite(self, monitor: EngineMonitor) -> None:
        """With the first engine lost shut off the one across: its thrust goes the same way, and the moment with it."""
        ill = [i for i, gain in enumerate(monitor.gains) if gain < 1.0]
        if len(ill) == 1 and monitor.health[ill[0]] == JetHealth(0.0):
            other = self._opposite[ill[0]]
            self._across = other
            self.shutoff.set(other, False)
            monitor.give_up(other)

    def _delayed(self, torque: Vector3, disturbance: Disturbance) -> Vector3:
        """The rate controller's output with what is added to it there, roll after the added delay."""
        roll, pitch, yaw = torque
        added = disturbance.torque_output
        if added != ZERO3:
            roll, pitch, yaw = roll + added[0], pitch + added[1], yaw + added[2]
        if disturbance.torque_seen != ZERO3:
            self.rate.tell(disturbance.torque_seen)
        return (self.added_delay.update(roll), pitch, yaw)

    def _allocate(self, collective: float, torque: Vector3, disturbance: Disturbance) -> Actuation:
        """What reaches the actuators: throttles that ask each engine for its share of the thrust, and tilts."""
        given = self.allocator.allocate(collective, torque, disturbance.torque_command)
        self._collective = collective - given.refused.collective
        if self.thrust_map.identity:
            return given
        return Actuation(self.thrust_map.throttle(given.throttle), given.tilt, given.refused)

    def _drive(self, k: int, throttle: PerJet, state: State) -> EngineOutput:
        """The engines over step ``k``, in the air at its beginning."""
        ambient = self._ambient(state) if self._airy else None
        return self.shutoff.delivered(self.engines.step(k, self.shutoff.throttle(throttle), ambient))

    def _tilt(self, command: tuple[float, float]) -> tuple[float, float]:
        if not self.servos:
            return (0.0, 0.0)
        servos = self.servos
        return (servos[0].update(command[0]), servos[1].update(command[1]))

    def _ambient(self, state: State) -> Ambient:
        """The air at the engines: the vehicle's, and what blows into each intake along its jet.

        The intake moves with the vehicle's velocity and its rates; wind, gust and turbulence are those at the vehicle.
        """
        vx, vy, vz = state.velocity
        # JSBSim knows of no wind before its first run
        wx, wy, wz = state.wind if self.k else self.disturber.at(0).wind
        u, v, w = rotate(conjugate(state.attitude), (vx - wx, vy - wy, vz - wz))
        banks: list[tuple[float, Vector3]] = []
        for tilt in self._standing:
            x, y, z = axis = jet_axis(tilt)
            banks.append((u * x + v * y + w * z, cross(axis, state.rate)))
        left, right = banks
        speeds: list[float] = []
        for on_left, (x, y, z) in self._intakes:
            # (velocity + rate x place) . axis = velocity . axis + place . (axis x rate)
            along, (by_x, by_y, by_z) = left if on_left else right
            speeds.append(along + by_x * x + by_y * y + by_z * z)
        pressure, temperature = self.airframe.air()
        if self.hot_gas is not None:
            temperature += self.hot_gas.rise(state.altitude)
        return Ambient(pressure, temperature, tuple(speeds))

    def _rotor_moment(self, engines: EngineOutput, tilt: tuple[float, float], state: State) -> tuple[Vector3, Vector3]:
        """Moment of the rotors on the frame, N m: what the airframe is to be given, and all that is the spools'."""
        reaction = sum(map(mul, self._reactions, engines.thrust)) if self._reacting else 0.0
        if self.spools is None:
            return ((0.0, 0.0, reaction) if self._reacting else ZERO3), UNKNOWN3
        x, y, z = change = self.spools.update(engines.spool_speed, tilt)
        self.airframe.set_momentum(self.spools.momentum)
        return (x, y, z + reaction), self.spools.moment(change, state.rate)

    def _burn(self, flows: PerJet) -> float:
        """Burn a step's fuel, and shut all engines off when there is none left; kg on board at the step's beginning."""
        assert self.tank is not None
        left = self.tank.left
        if self.tank.burn(flows):
            self.airframe.burn(self.tank.burnt)
            if self.tank.empty:
                self.shutoff.all_off()
        return left

    def _jet_forces(self, thrust: PerJet, tilt: tuple[float, float]) -> list[Vector3]:
        """Each jet's thrust along its own tilted axis: N, body."""
        left, right = tilt
        left_x, _, left_z = jet_axis(left)
        right_x, _, right_z = jet_axis(right)
        return [
            (thrust[jet] * left_x, 0.0, thrust[jet] * left_z)
            if on_left
            else (thrust[jet] * right_x, 0.0, thrust[jet] * right_z)
            for jet, on_left in enumerate(self._left)
        ]

    def run(
        self, observers: Iterable[Observer] = (), pace: Pace | None = None, between: Between | None = None
    ) -> Ending:
        """Fly to the end of the scenario, or to where the flight is over.

        Without a ``pace`` it flies as fast as it goes.  ``between`` is called before every step: there the pilot is
        asked things, and the flight ended.
        """
        observe = [observer.observe for observer in observers]
        judge = self.judge
        if pace:
            pace.start(self.k)
        for _ in range(self.scenario.steps - self.k):
            if between:
                asked = between(self.k)
                if asked:
                    return asked
            try:
                sample = self.step()
            except EngineError as error:
                return Ending("failed", str(error))
            except FlightError as error:
                return Ending("failed", f"{error} at step {self.k} ({self.k * self.dt:.3f} s)")
            for look in observe:
                look(sample)
            ending = judge.look(self.state, self.k * self.dt)
            if ending:
                # the log ends with the state that ended the flight, beside what acted until then
                last = sample._replace(k=self.k, time=self.k * self.dt, state=self.state, measured=self.measured)
                for look in observe:
                    look(last)
                return ending
            if pace:
                pace.wait(self.k)
        late = f", {pace.missed} of them late" if pace and pace.missed else ""
        return Ending("completed", f"flew {self.k} steps{late}")

    def close(self) -> None:
        """Free the engines and the airframe; may be called twice."""
        self.engines.close()
        self.airframe.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Judge:
    """Decides when a flight is over before its time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._least_upright = cos(radians(limits.tilt_deg))
        self._most_rate = radians(limits.rate_deg_s)
        self.reset(on_ground=False)

    def reset(self, on_ground: bool) -> None:
        """A new flight; ``on_ground``: it starts standing."""
        self._was_on_ground = on_ground
        self._descent = 0.0

    def look(self, state: State, now: float) -> Ending | None:
        """The ending, if ``state`` at ``now`` [s] is one."""
        _, x, y, _ = state.attitude
        p, q, r = state.rate
        most = self._most_rate
        if state.hull_contact:
            return Ending("crashed", f"the hull touched the ground at {now:.3f} s ({_lean(state)})")
        limits = self._limits
        if state.on_ground and not self._was_on_ground and self._descent > limits.touchdown_m_s:
            return Ending("crashed", f"hit the ground at {self._descent:.1f} m/s at {now:.3f} s ({_lean(state)})")
        self._was_on_ground = state.on_ground
        self._descent = state.velocity[2]
        if 1.0 - 2.0 * (x * x + y * y) < self._least_upright:
            return Ending("diverged", f"leaned past {limits.tilt_deg:g} deg at {now:.3f} s ({_lean(state)})")
        if not (-most < p < most and -most < q < most and -most < r < most):
            return Ending("diverged", f"turned faster than {limits.rate_deg_s:g} deg/s at {now:.3f} s ({_lean(state)})")
        return None


def _lean(state: State) -> str:
    return ", ".join(f"{axis} {degrees(angle):.0f} deg" for axis, angle in zip(AXES, state.euler, strict=True))


@dataclass(frozen=True)
class Control:
    """The blocks between the measurement and the actuators."""

    attitude: AttitudeController
    altitude: AltitudeController
    rate: RateController
    allocator: Allocator
    thrust_map: ThrustMap
    monitor: EngineMonitor | None
    schedule: GainSchedule | None


def build(scenario: Scenario) -> Simulation:
    """Wire a flight.

    Raises InputError for anything in the scenario, the vehicle, the engine or the controller that does not fit.
    """
    if scenario.controller not in PREDICTORS:
        raise InputError(f"unknown controller {scenario.controller!r}; {nearest(scenario.controller, PREDICTORS)}")
    scenario.count(scenario.duration_s, "duration_s")
    vehicle, folder = load_vehicle(scenario.aircraft, scenario.vehicle, f"scenario {scenario.name}: vehicle")
    engine, *stations = specs = _engines(scenario, vehicle)
    spools = Spools(vehicle.jets, stations, scenario.step_s)
    control = _control(scenario, vehicle, engine, stations)
    flown, jets = as_flown(vehicle, scenario.mismatch), len(vehicle.jets)
    airframe = Airframe(
        flown, folder, scenario.environment, scenario.step_s, scenario.substeps, scenario.seed, spools.any
    )
    engines: Engines | None = None
    try:
        engines = EngineBank(stations, jets, scenario.step_s)
        engines = engines_as_flown(engines, scenario.mismatch, jets)
        ledger = delay_ledger(scenario, vehicle, stations)
        simulation = Simulation(scenario, vehicle, specs, airframe, engines, spools, control, ledger)
        if flies_to_places(scenario):
            hover, idle = simulation.allocator.hover, simulation.thrust_map.idle
            simulation.pilot = PlacePilot(scenario, vehicle, simulation.commander, hover, idle)
            simulation.pilot.reset(simulation.measured)
        return simulation
    except BaseException:
        if engines is not None:
            engines.close()
        airframe.close()
        raise


def _engines(scenario: Scenario, vehicle: Vehicle) -> list[EngineSpec]:
    """The scenario's engine, then the one at each station; each engine with its parameters is measured once.

    They are measured in the still air at the height where the flight starts.
    """
    jets = len(vehicle.jets)
    air = Air(*standard_air(scenario.environment.ground_m + start_height(vehicle, scenario.initial)), 0.0)
    for number in scenario.stations:
        if int(number) > jets:
            where = f"scenario {scenario.name}: stations.{number}"
            raise InputError(f"{where}: {scenario.aircraft} has stations 1 to {jets}")
    known: dict[tuple[str, frozenset[tuple[str, float]]], EngineSpec] = {}

    def load(engine: str, parameters: dict[str, float]) -> EngineSpec:
        key = engine, frozenset(parameters.items())
        if key not in known:
            # a file is seen from the scenario's folder
            source = str(scenario.folder / engine) if is_file(engine) else engine
            unchecked = scenario.engine_unchecked
            known[key] = load_engine(source, parameters, scenario.step_s, unchecked=unchecked, air=air)
        return known[key]

    def at(station: Station) -> EngineSpec:
        if station.engine is None:
            return load(scenario.engine, {**scenario.engine_parameters, **station.parameters})
        return load(station.engine, station.parameters)

    engine = load(scenario.engine, scenario.engine_parameters)
    stations = [scenario.stations.get(str(number)) for number in range(1, jets + 1)]  # type: ignore[call-overload]
    return [engine, *(engine if station is None else at(station) for station in stations)]


def _control(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec, stations: Sequence[EngineSpec]) -> Control:
    step = scenario.step_s
    gains = vehicle.control
    curves = {id(each): StaticCurve(each.name, *each.curve) for each in (engine, *stations)}
    thrust_map = ThrustMap(curves[id(engine)], [curves[id(each)] for each in stations])
    jets = len(vehicle.jets)
    hover = thrust_map.share(vehicle.mass_kg * GRAVITY / jets)
    if not gains.allocation.throttle_min < hover < gains.allocation.throttle_max:
        raise InputError(
            f"engine {engine.name}: {vehicle.name} ({vehicle.mass_kg:g} kg) would hover at throttle {hover:.2f}, "
            f"outside {gains.allocation.throttle_min:g} to {gains.allocation.throttle_max:g}"
        )
    _need_lift(vehicle, stations)
    return Control(
        AttitudeController(gains.attitude),
        AltitudeController(
            gains.altitude,
            vehicle.mass_kg,
            lambda total: thrust_map.share(total / jets),
            step,
            _lead(vehicle, "altitude", step),
        ),
        RateController(
            (gains.rate.roll, gains.rate.pitch, gains.rate.yaw),
            predictors(scenario, vehicle, engine),
            step,
            [_lead(vehicle, axis, step) for axis in AXES],
        ),
        TiltAllocator(
            vehicle.jets,
            gains.allocation,
            vehicle.servo.range_rad,
            hover,
            thrust_map.idle,
            _lift(scenario, vehicle, stations) if scenario.monitored else inf,
        )
        if vehicle.servo
        else RotorAllocator(vehicle.jets, gains.allocation, hover),
        thrust_map,
        _monitor(scenario, vehicle, stations) if scenario.monitored else None,
        GainSchedule(gains.schedule, gains.lead, step) if gains.schedule else None,
    )


def _lift(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> float:
    """How far a throttle may go up in a step for the height that is lost with an engine.

    From least to most in no less than the longest lag of the engines: told to go faster they are at the limit of their
    acceleration, all alike, and what roll asks for between them is lost.
    """
    limits, step = vehicle.control.allocation, scenario.step_s
    longest = max(engine_reference(spec, step).longest for spec in stations)
    return (limits.throttle_max - limits.throttle_min) * step / max(longest, step)


def opposites(vehicle: Vehicle) -> tuple[int, ...]:
    """For every jet, from 0, the one across the centre of gravity.  Raises InputError if one has none."""
    places = [jet.position_m for jet in vehicle.jets]
    found = []
    for number, (x, y, _) in enumerate(places, 1):
        across = [i for i, (a, b, _) in enumerate(places) if hypot(a + x, b + y) < 1e-3 * hypot(x, y)]
        if len(across) != 1:
            raise InputError(f"{vehicle.name}: control.monitor.shut_opposite: no jet stands opposite jet {number}")
        found.append(across[0])
    return tuple(found)


def _lead(vehicle: Vehicle, command: str, step: float) -> Lead | None:
    stated = getattr(vehicle.control.lead, command, None)
    return Lead(stated, step) if stated else None


def _need_lift(vehicle: Vehicle, stations: Sequence[EngineSpec]) -> None:
    """Refuse stations whose engines cannot carry the vehicle together, whatever the scenario's engine could."""
    weight, most = vehicle.mass_kg * GRAVITY, sum(each.curve.thrust[-1] for each in stations)
    if most <= weight:
        raise InputError(
            f"stations: the engines give at most {most:.1f} N together; {vehicle.name} ({vehicle.mass_kg:g} kg) "
            f"weighs {weight:.1f} N"
        )


def _monitor(scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> EngineMonitor:
    settings, limits = vehicle.control.monitor, vehicle.control.allocation
    if settings is None:
        raise InputError(
            f"scenario {scenario.name}: {vehicle.name} has no [control.monitor] to watch its engines with; "
            "state it, or set monitor = false"
        )
    get_ready()
    known = {key: engine_reference(spec, scenario.step_s) for key, spec in {id(s): s for s in stations}.items()}
    return EngineMonitor(
        settings,
        [known[id(spec)] for spec in stations],
        vehicle.mass_kg * GRAVITY / len(stations),
        (limits.throttle_min, limits.throttle_max),
        scenario.step_s,
    )


def predictors(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> list[Predictor]:
    """One predictor per axis: the controller's where the vehicle has an identified model for this engine, else none."""
    if scenario.controller == "baseline":
        return [NoPredictor() for _ in AXES]
    models = vehicle.identified.get(engine.family, {})
    if not models:
        raise InputError(
            f"controller {scenario.controller!r} needs an identified model of {vehicle.name} with engine "
            f"{engine.family!r}; there are models for: {', '.join(sorted(vehicle.identified))} "
            "(or fly --controller baseline)"
        )
    found: list[Predictor] = []
    for axis in AXES:
        model = models.get(axis)  # type: ignore[call-overload]
        if model is not None and abs(model.sample_time_s - scenario.step_s) > 1e-9:
            raise InputError(
                f"vehicle.identified.{engine.family}.{axis}: the model's sample time {model.sample_time_s:g} s is not "
                f"the scenario's step {scenario.step_s:g} s"
            )
        make = PREDICTORS[scenario.controller]
        if model is not None and axis == "roll" and scenario.added_delay_samples:
            # the controller adds this delay itself, so its predictor knows of it
            delay = model.delay_samples + scenario.added_delay_samples
            model = model.model_copy(update={"delay_samples": delay})
        found.append(make(model, vehicle.control.predictor) if model is not None else NoPredictor())
    return found
