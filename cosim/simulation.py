"""The step, the loop, and ``build``: the one place where the blocks are wired together."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, degrees, radians
from operator import mul
from typing import Literal, Protocol

from cosim.airframe import Airframe, standing_height
from cosim.commands import Commander
from cosim.config import nearest
from cosim.control.allocation import Allocator, RotorAllocator, TiltAllocator
from cosim.control.altitude import GRAVITY, AltitudeController
from cosim.control.attitude import AttitudeController
from cosim.control.choice import PREDICTORS
from cosim.control.predictor import DelayLine, NoPredictor, Predictor
from cosim.control.rate import RateController
from cosim.disturbances import Disturber
from cosim.engine import EngineBank, EngineSpec, load_engine
from cosim.errors import EngineError, FlightError, InputError
from cosim.frames import jet_axis
from cosim.ledger import LedgerRow, delay_ledger
from cosim.scenario import Scenario
from cosim.sensors import SensorSuite
from cosim.servo import TiltServo
from cosim.signals import AXES, ZERO3, Disturbance, Refused, Sample, State, Vector3
from cosim.vehicle import Limits, Vehicle, load_vehicle

_SERVOS = ("left", "right")

Outcome = Literal["completed", "crashed", "diverged", "failed"]


class Resettable(Protocol):
    """A block that can start again."""

    def reset(self) -> None: ...


class Observer(Protocol):
    """Looks at every step and touches nothing."""

    def observe(self, sample: Sample) -> None:
        """Called once a step, after it."""


@dataclass(frozen=True)
class Ending:
    """How a flight ended, and why, in words."""

    outcome: Outcome
    reason: str


class Simulation:
    """One flight: all blocks, wired by :func:`build`, and the instant they stand at."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        engine: EngineSpec,
        airframe: Airframe,
        engines: EngineBank,
        control: Control,
        ledger: list[LedgerRow],
    ) -> None:
        self.scenario = scenario
        self.vehicle = vehicle
        self.engine = engine
        self.ledger = ledger
        self.dt = scenario.step_s
        self.airframe = airframe
        self.engines = engines
        self.attitude = control.attitude
        self.altitude = control.altitude
        self.rate = control.rate
        self.allocator = control.allocator
        self.added_delay = DelayLine(scenario.added_delay_samples)
        self.servos = [TiltServo(vehicle.servo, self.dt) for _ in _SERVOS] if vehicle.servo else []
        self.sensors = SensorSuite(vehicle.sensors, self.dt, scenario.seed, scenario.sensor_noise)
        self._left = tuple(jet.servo == "left" for jet in vehicle.jets)
        self._reactions = tuple(jet.reaction_m for jet in vehicle.jets)
        self._reacting = any(self._reactions)
        self._height = standing_height(vehicle) if scenario.initial.on_ground else scenario.initial.altitude_m
        self.commander = Commander(scenario, self._height)
        self.disturber = Disturber(scenario)
        self.judge = Judge(vehicle.limits)
        self.reset()

    def reset(self) -> None:
        """Back to ``t = 0``: everything at rest, the engines settled at the throttle that holds the vehicle up."""
        self.k = 0
        self.refused = Refused()
        blocks: list[Resettable] = [self.attitude, self.altitude, self.rate, self.added_delay, *self.servos]
        for block in blocks:
            block.reset()
        limits = self.vehicle.control.allocation
        throttle = limits.throttle_min if self.scenario.initial.on_ground else self.allocator.hover
        thrust = self.engines.reset(throttle)
        self.judge.reset(self.scenario.initial.on_ground)
        self.state = self.airframe.reset(
            self.scenario.initial, self._jet_forces(thrust, (0.0, 0.0)), self.disturber.at(0).wind
        )
        self.measured = self.sensors.reset(self.state)

    def step(self) -> Sample:
        """One control step over ``[t_k, t_k+1)``, every input held; see docs/design.md."""
        k, state, measured = self.k, self.state, self.measured
        command = self.commander.at(k)
        disturbance = self.disturber.at(k)
        rate_setpoint = self.attitude.update(command, measured)
        torque = self.rate.update(rate_setpoint, measured.rate, self.refused)
        collective = self.altitude.update(command, measured, self.refused)
        late = self._delayed(torque, disturbance)
        actuation = self.allocator.allocate(collective, late, disturbance.torque_command)
        thrust = self.engines.step(k, actuation.throttle)
        tilt = self._tilt(actuation.tilt)
        self.state = self.airframe.step(self._jet_forces(thrust, tilt), disturbance, self._reaction(thrust))
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
            thrust,
            disturbance,
        )

    def _delayed(self, torque: Vector3, disturbance: Disturbance) -> Vector3:
        """The rate controller's output with what is added to it there, roll after the added delay."""
        roll, pitch, yaw = torque
        if disturbance.torque_output is not ZERO3:
            x, y, z = disturbance.torque_output
            roll, pitch, yaw = roll + x, pitch + y, yaw + z
            self.rate.tell(disturbance.torque_seen)
        return (self.added_delay.update(roll), pitch, yaw) if self.scenario.added_delay_samples else (roll, pitch, yaw)

    def _tilt(self, command: tuple[float, float]) -> tuple[float, float]:
        if not self.servos:
            return (0.0, 0.0)
        left, right = self.servos
        return (left.update(command[0]), right.update(command[1]))

    def _reaction(self, thrust: Sequence[float]) -> float:
        """Yaw moment of the rotors on the frame, N m."""
        return sum(map(mul, self._reactions, thrust)) if self._reacting else 0.0

    def _jet_forces(self, thrust: Sequence[float], tilt: tuple[float, float]) -> list[Vector3]:
        """Each jet's thrust along its own tilted axis: N, body."""
        left, right = tilt
        left_x, _, left_z = jet_axis(left)
        right_x, _, right_z = jet_axis(right)
        return [
            (t * left_x, 0.0, t * left_z) if on_left else (t * right_x, 0.0, t * right_z)
            for t, on_left in zip(thrust, self._left, strict=True)
        ]

    def run(self, observers: Iterable[Observer] = (), realtime_factor: float | None = None) -> Ending:
        """Fly to the end of the scenario, or to where the flight is over.

        ``realtime_factor`` paces the flight against an absolute clock; None flies as fast as it goes.
        """
        observe = [observer.observe for observer in observers]
        judge = self.judge
        pace = Pace(self.dt, realtime_factor) if realtime_factor else None
        for _ in range(self.scenario.steps - self.k):
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


class Pace:
    """Absolute pacing: step ``k`` ends no sooner than ``k dt / factor`` after the start."""

    def __init__(self, step: float, factor: float) -> None:
        self._step = step / factor
        self._start = time.perf_counter()
        self.missed = 0

    def wait(self, k: int) -> None:
        """Sleep until step ``k`` is due; count it as missed if that is past by more than a step."""
        left = self._start + k * self._step - time.perf_counter()
        if left > 0.0:
            time.sleep(left)
        elif left < -self._step:
            self.missed += 1


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


def throttle_map(engine: EngineSpec) -> Callable[[float], float]:
    """Thrust of one engine at rest [N] to throttle: its measured static curve, inverted, linear between points.

    Raises InputError if the thrust does not grow with the throttle.
    """
    throttles, thrusts = engine.curve.throttle, engine.curve.thrust
    if any(b <= a for a, b in pairwise(thrusts)):
        raise InputError(f"engine {engine.name}: its thrust at rest does not grow with the throttle")

    slopes = [(v - u) / (b - a) for (u, v), (a, b) in zip(pairwise(throttles), pairwise(thrusts), strict=True)]
    inner = thrusts[1:-1]

    def throttle(thrust: float) -> float:
        i = bisect_left(inner, thrust)
        return throttles[i] + slopes[i] * (thrust - thrusts[i])

    return throttle


def build(scenario: Scenario) -> Simulation:
    """Wire a flight.

    Raises InputError for anything in the scenario, the vehicle, the engine or the controller that does not fit.
    """
    if scenario.controller not in PREDICTORS:
        raise InputError(f"unknown controller {scenario.controller!r}; {nearest(scenario.controller, PREDICTORS)}")
    scenario.count(scenario.duration_s, "duration_s")
    vehicle, folder = load_vehicle(scenario.aircraft, scenario.vehicle, f"scenario {scenario.name}: vehicle")
    engine = load_engine(_engine_from(scenario), scenario.engine_parameters, scenario.step_s)
    control = _control(scenario, vehicle, engine)
    airframe = Airframe(vehicle, folder, scenario.environment, scenario.step_s, scenario.substeps, scenario.seed)
    try:
        engines = EngineBank(engine, len(vehicle.jets), scenario.step_s)
        return Simulation(
            scenario, vehicle, engine, airframe, engines, control, delay_ledger(scenario, vehicle, engine)
        )
    except BaseException:
        airframe.close()
        raise


def _engine_from(scenario: Scenario) -> str:
    """The engine's name, or its file seen from the scenario's folder."""
    engine = scenario.engine
    return str(scenario.folder / engine) if engine.lower().endswith(".fmu") or "/" in engine else engine


def _control(scenario: Scenario, vehicle: Vehicle, engine: EngineSpec) -> Control:
    step = scenario.step_s
    gains = vehicle.control
    single = throttle_map(engine)
    jets = len(vehicle.jets)
    hover = single(vehicle.mass_kg * GRAVITY / jets)
    if not gains.allocation.throttle_min < hover < gains.allocation.throttle_max:
        raise InputError(
            f"engine {engine.name}: {vehicle.name} ({vehicle.mass_kg:g} kg) would hover at throttle {hover:.2f}, "
            f"outside {gains.allocation.throttle_min:g} to {gains.allocation.throttle_max:g}"
        )
    return Control(
        AttitudeController(gains.attitude),
        AltitudeController(gains.altitude, vehicle.mass_kg, lambda total: single(total / jets), step),
        RateController(
            (gains.rate.roll, gains.rate.pitch, gains.rate.yaw), predictors(scenario, vehicle, engine), step
        ),
        TiltAllocator(vehicle.jets, gains.allocation, vehicle.servo.range_rad, hover)
        if vehicle.servo
        else RotorAllocator(vehicle.jets, gains.allocation, hover),
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
