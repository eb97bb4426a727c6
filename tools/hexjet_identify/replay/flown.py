"""The model of a vehicle, driven by recorded commands: engines over the whole log, the airframe window by window.

What an engine does is stable and follows from its commands: the engines, the servos and the effects beside thrust run
through the whole log once, with the recorded motion around them.  Where the vehicle goes is not stable: the airframe
is started anew at the beginning of each window, from the recorded state there (multiple shooting).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.frames import from_euler
from cosim.base.signals import ZERO3, Actuation, Disturbance, PerJet, State, Unallocated, Vector3
from cosim.engine import EngineSpec
from cosim.simulation.build import build
from cosim.simulation.script.mismatch import apply_mismatch
from cosim.spec.scenario import Initial, Mismatch, Scenario
from cosim.spec.vehicle import Sensors, Vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.sensors import SensorSuite
from hexjet_identify.replay.recorded import RecordedFlight

# Windows are flown at least this high: the ground is no part of the model.
MIN_HEIGHT_M: Final = 5.0


class Window(NamedTuple):
    """Rows ``first`` to ``last`` of a recorded flight: the model starts at the first and is compared up to the last."""

    first: int
    last: int


@dataclass(frozen=True)
class Change:
    """Changes of a vehicle against what its files state.

    ``inertia`` about x, y, z, ``mass``, ``thrust`` of all engines and ``jets`` (of a jet, from 0) are factors;
    ``centre`` is added to the centre of gravity [m, body], ``parameters`` replace those of the engines.  ``engines_s``,
    ``servos_s`` (surfaces too) and ``sensors_s`` (gyro, accelerometer, attitude) are added to delays, ``servo_lag_s``
    to the lag of servos and hinges.  ``order`` has the jet, from 0, whose command each jet gets.
    """

    inertia: Vector3 = (1.0, 1.0, 1.0)
    mass: float = 1.0
    thrust: float = 1.0
    jets: Mapping[int, float] = field(default_factory=dict)
    centre: Vector3 = ZERO3
    engines_s: float = 0.0
    servos_s: float = 0.0
    sensors_s: Vector3 = ZERO3
    servo_lag_s: float = 0.0
    order: tuple[int, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)


class Loads(NamedTuple):
    """Loads on the airframe at each step: ``forces`` (n, jets, 3) [N] and ``moments`` (n, 3) [N m], body axes.

    ``momentum`` (n, 3) of the rotors, kg m^2/s; ``burnt`` (n,) fuel, kg; ``tilt`` (n, servos).
    """

    forces: Array
    moments: Array
    momentum: Array
    burnt: Array
    tilt: Array


class Starts(NamedTuple):
    """Initial ``rate`` and ``angles`` of each window, and its constant ``moment``; (w, 3) each.

    rad/s, rad, and N m about the body's axes: what the engines do not make of what turns the vehicle.
    """

    rate: Array
    angles: Array
    moment: Array


class ModelOutput(NamedTuple):
    """Output of the model's sensors at the flight's rows, NaN outside the windows.

    ``rate`` rad/s, ``force`` m/s^2, ``angles`` rad, ``velocity`` m/s NED; (n, 3) each.
    """

    rate: Array
    force: Array
    angles: Array
    velocity: Array


class Model:
    """A vehicle with its engines, as a scenario states it, open for changes.

    Raises InputError for a scenario that cannot be built.
    """

    def __init__(self, scenario: Scenario, kept_loads: int = 4) -> None:
        self.scenario = scenario.replace(sensor_noise=False, expect=[])
        self.vehicle, self._folder = self.scenario.resolved_vehicle()
        self._sensors = _without_resolution(self.vehicle.sensors)
        self._flown_vehicle = apply_mismatch(self.vehicle, self.scenario.mismatch)
        # A fit needs the loads of the stated vehicle and of a few values of one number in turn.
        self._load = lru_cache(kept_loads)(self._run_engines)
        # Set when the engines have run.
        self.engine: EngineSpec | None = None

    def loads(self, flight: RecordedFlight, change: Change) -> Loads:
        """Return the loads that engines, servos and effects make of the commands of a flight."""
        parameters = tuple(sorted(change.parameters.items()))
        return self._load(flight, parameters, change.engines_s, change.servos_s, change.servo_lag_s)

    def _run_engines(
        self,
        flight: RecordedFlight,
        parameters: tuple[tuple[str, float], ...],
        engines_s: float,
        servos_s: float,
        servo_lag_s: float,
    ) -> Loads:
        scenario = self.scenario
        if parameters:
            scenario = scenario.replace(mismatch={"engine_parameters": dict(parameters)})
        if servo_lag_s:
            scenario = scenario.replace(vehicle=_slower_servos(self.vehicle, servo_lag_s))
        with build(scenario) as simulation:
            self.engine = self.engine or simulation.engine
            propulsion = simulation.propulsion
            throttle = delay_rows(flight.throttle, engines_s / flight.step)
            commands: list[PerJet] = [tuple(row) for row in throttle.tolist()]
            tilts = [tuple(row) for row in delay_rows(flight.tilt, servos_s / flight.step).tolist()]
            states = recorded_states(flight, self.vehicle)
            propulsion.refuel()
            propulsion.reset(commands[0], states[0], ZERO3)
            rows = []
            for k, (command, tilt, state) in enumerate(zip(commands, tilts, states, strict=True)):
                action = Actuation(command, tilt or propulsion.tilt, Unallocated())
                forces, moment = propulsion.step(k, action, state)
                rows.append((forces, moment, propulsion.momentum, propulsion.burnt, propulsion.tilt))
            return Loads(*(np.array(values, float) for values in zip(*rows, strict=True)))

    def fly(
        self,
        flight: RecordedFlight,
        windows: Sequence[Window],
        starts: Starts,
        change: Change | None = None,
        wind: Vector3 = ZERO3,
    ) -> ModelOutput:
        """Fly the windows from ``starts`` in a ``wind`` [m/s, NED].  Raises FlightError where JSBSim stops."""
        change = change or Change()
        acting = _apply_thrust_changes(self.loads(flight, change), change, self.vehicle)
        scenario = self.scenario
        vehicle = changed_vehicle(self._flown_vehicle, change)
        rotors = bool(np.any(acting.momentum))
        airframe = Airframe(
            vehicle, self._folder, scenario.environment, flight.step, scenario.substeps, scenario.seed, rotors
        )
        sensors = SensorSuite(self._sensors, flight.step, scenario.seed, noisy=False)
        try:
            windowed = _WindowFlight(airframe, sensors, flight, acting)
            for window, rate, angles, moment in zip(windows, *starts, strict=True):
                x, y, z = moment.tolist()
                windowed.fly(window, rate, angles, Disturbance(moment=(x, y, z), wind=wind))
        finally:
            airframe.close()
        return windowed.flown


def _without_resolution(sensors: Sensors) -> Sensors:
    """Return sensors without rounding, which would hide small changes of the vehicle."""
    gyro = sensors.gyro.model_copy(update={"resolution_rad_s": 0.0})
    accelerometer = sensors.accelerometer.model_copy(update={"resolution_m_s2": 0.0})
    return sensors.model_copy(update={"gyro": gyro, "accelerometer": accelerometer})


def changed_vehicle(vehicle: Vehicle, change: Change) -> Vehicle:
    """Return the vehicle with another mass, centre of gravity and inertia."""
    if any(change.centre):
        vehicle = apply_mismatch(vehicle, Mismatch(centre_m=change.centre))
    inertia = tuple(factor * value for factor, value in zip(change.inertia, vehicle.inertia_kg_m2, strict=True))
    return vehicle.model_copy(update={"inertia_kg_m2": inertia, "mass_kg": change.mass * vehicle.mass_kg})


def _slower_servos(vehicle: Vehicle, more: float) -> dict[str, Any]:
    """Return the settings of a vehicle whose servos and hinges have ``more`` lag [s]."""
    if vehicle.servo is not None:
        return {"servo": {"lag_s": max(vehicle.servo.lag_s + more, 0.0)}}
    hinges = [
        hinge.model_dump(exclude_unset=True) | {"lag_s": max(hinge.lag_s + more, 0.0)} for hinge in vehicle.hinges
    ]
    return {"hinges": hinges}


def recorded_states(flight: RecordedFlight, vehicle: Vehicle) -> list[State]:
    """Return the recorded motion as states, the surroundings of engines and effects."""
    signals = (flight.angles, flight.velocity, flight.rate, flight.force)
    rows = (map(tuple, np.nan_to_num(values).tolist()) for values in signals)
    return [
        State((0.0, 0.0, -up), v, from_euler(*euler), euler, omega, f, up, ZERO3, vehicle.mass_kg, False, False)
        for up, euler, v, omega, f in zip(_flying_height(flight.altitude).tolist(), *rows, strict=True)
    ]


def _flying_height(altitude: Array, unknown_m: float = 30.0) -> Array:
    """Return the heights [m] to fly at, at least MIN_HEIGHT_M, or ``unknown_m``."""
    return np.where(np.isfinite(altitude), np.maximum(altitude, MIN_HEIGHT_M), unknown_m)


def _apply_thrust_changes(loads: Loads, change: Change, vehicle: Vehicle) -> Loads:
    """Return loads with other thrusts of all or some jets, in another order; the engines need not run again."""
    factors = np.array([change.thrust * change.jets.get(jet, 1.0) for jet in range(len(vehicle.jets))])
    if not change.order and np.all(factors == 1.0):
        return loads
    thrust = np.linalg.norm(loads.forces, axis=2)
    axes = loads.forces / np.maximum(thrust, 1e-12)[:, :, None]
    other = factors * (thrust[:, list(change.order)] if change.order else thrust)
    reactions = -np.array([jet.reaction_m for jet in vehicle.jets]) * (other - thrust)
    moments = loads.moments + np.einsum("kj,kjc->kc", reactions, axes)
    return loads._replace(forces=other[:, :, None] * axes, moments=moments)


def delay_rows(values: Array, steps: float, axis: int = 0) -> Array:
    """Return values delayed by ``steps`` rows, interpolated linearly, with the end values held."""
    if not steps or not values.size:
        return values
    count = values.shape[axis]
    rows = np.clip(np.arange(float(count)) - steps, 0.0, count - 1.0)
    before = np.minimum(rows.astype(int), count - 2)
    part = np.expand_dims(rows - before, tuple(range(1, values.ndim - axis)))
    return np.asarray((1.0 - part) * values.take(before, axis) + part * values.take(before + 1, axis))


class _WindowFlight:
    """The airframe and its sensors, flown through one window after the other."""

    def __init__(self, airframe: Airframe, sensors: SensorSuite, flight: RecordedFlight, loads: Loads) -> None:
        self._airframe, self._sensors = airframe, sensors
        self._flight, self._loads = flight, loads
        self.flown = ModelOutput(*(np.full((len(flight.times), 3), np.nan) for _ in ModelOutput._fields))

    def fly(self, window: Window, rate: Array, angles: Array, disturbance: Disturbance) -> None:
        """Fly a window from ``rate`` [rad/s] and ``angles`` [rad]; velocity and height start as recorded."""
        airframe, sensors, flown = self._airframe, self._sensors, self.flown
        self._start_window(window.first, rate, angles, disturbance.wind)
        rows = slice(window.first, window.last)
        loads = zip(*(values[rows].tolist() for values in self._loads), strict=True)
        for row, (forces, moment, momentum, burnt, tilt) in enumerate(loads, start=window.first + 1):
            airframe.prepare_step(tuple(momentum), burnt, tuple(tilt))
            state = airframe.step([tuple(force) for force in forces], disturbance, tuple(moment))
            measured = sensors.reset(state) if row == window.first + 1 else sensors.sample(state)
            flown.rate[row], flown.force[row] = measured.rate, measured.specific_force
            flown.angles[row], flown.velocity[row] = state.euler, state.velocity

    def _start_window(self, row: int, rate: Array, angles: Array, wind: Vector3) -> None:
        flight, loads, before = self._flight, self._loads, max(row - 1, 0)
        velocity = flight.velocity[row]
        initial = Initial.model_construct(
            altitude_m=float(_flying_height(flight.altitude[row])),
            attitude_deg=tuple(np.degrees(angles).tolist()),
            velocity_ned_m_s=tuple(velocity.tolist()) if np.isfinite(velocity).all() else ZERO3,
            rate_deg_s=tuple(np.degrees(rate).tolist()),
        )
        forces: list[Vector3] = [(x, y, z) for x, y, z in loads.forces[before].tolist()]
        x, y, z = loads.momentum[before].tolist()
        momentum = (x, y, z) if x or y or z else None
        self._airframe.reset(initial, forces, wind, momentum, float(loads.burnt[before]))
