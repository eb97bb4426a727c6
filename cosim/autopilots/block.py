"""An autopilot as the whole controller of a flight, and the time before it, when the vehicle is held in a stand."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import inf, radians

import numpy as np

from cosim.autopilots.lockstep import ActuatorOutputs, Autopilot, SensorFrame, StartTiming, StickPositions
from cosim.autopilots.pilot import StickPilot
from cosim.autopilots.stand import StationarySensors
from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Applied, EngineState
from cosim.base.signals import ZERO3, Actuation, Command, Disturbance, Measured, State, Unallocated, Vector3
from cosim.control.allocation.reallocation import command_to_torque
from cosim.control.belief import Belief
from cosim.control.cascade import Cascade
from cosim.simulation.controllers.recorded import COLUMNS, Row


class ExternalRateLoop:
    """A rate loop around an autopilot whose own loop is P alone, so that its answer states its rate set-point.

    ``cascade``: whose rate loop and allocation fly.  ``gain``: of the autopilot's P about each axis, throttle or rad of
    tilt per rad/s.  Its answer is that gain times its set-point less its gyro, at the collective that the mean of its
    throttles is.  ``has_gyro``: its gyro is the vehicle's, which its estimator needs; else its gyro
    reads zero.  Raises InputError for an allocation without torques.
    """

    def __init__(self, cascade: Cascade, gain: Vector3, has_gyro: bool = False) -> None:
        self._cascade, self._gain, self._has_gyro = cascade, gain, has_gyro
        self.rate_setpoint = ZERO3  # last rate set-point of the autopilot, rad/s
        self._jets = len(cascade.reset(False, 0.0))
        self._torques = np.array(command_to_torque(self._jets, cascade.allocator))
        self._fractions = np.linspace(0.0, 1.0, 2001)
        self._throttles = [
            cascade.thrust_map.throttle((float(fraction),) * self._jets)[0] for fraction in self._fractions
        ]

    def select_gyro(self, rate: Vector3) -> Vector3:
        """Return what the autopilot's gyro is given for a measured rate [rad/s]."""
        return rate if self._has_gyro else ZERO3

    def compute_outputs(self, request: ActuatorOutputs, measured: Measured) -> ActuatorOutputs:
        """Return the actuator commands of the outside rate loop for an autopilot's answer."""
        torque = self._torques @ np.array([*request.throttle, *request.tilt])
        roll, pitch, yaw = torque / self._gain + self.select_gyro(measured.rate)
        collective = float(np.interp(sum(request.throttle) / self._jets, self._throttles, self._fractions))
        self.rate_setpoint = (float(roll), float(pitch), float(yaw))
        command = Command(ZERO3, 0.0, self.rate_setpoint, collective)
        engines = EngineState.FLY if request.armed else EngineState.IDLE
        actuation = self._cascade.update(command, measured, Disturbance(), engines)
        left, right = actuation.tilt
        return ActuatorOutputs(actuation.throttle, (left, right), True) if request.armed else request


class AutopilotBlock:
    """A controller of the level ``controller`` whose every update is one frame to an autopilot, and its answer to that.

    The time of ``handling`` passes between the autopilot's first frame and the flight's first step.  In it the vehicle
    stands in a stand as it begins the flight: level or not, still, on its engines of a flight that has begun; the
    autopilot calibrates and is armed.  ``rows``: what it answered in the flight, step by step.
    ``truth``: the true motion, for the autopilot's own log.  ``silent``: the sensors that are out.
    ``stand``: the sensors before the flight.
    ``rates``: flies in the place of its rate loop.  ``hold_from``: second of the flight from which it holds its place.
    """

    level = "controller"
    columns = COLUMNS

    def __init__(
        self,
        autopilot: Autopilot,
        label: str,
        handling: StartTiming,
        rates: ExternalRateLoop | None = None,
        hold_from: float = inf,
    ) -> None:
        self.autopilot, self.label, self._handling, self.rates = autopilot, label, handling, rates
        self._hold_from = hold_from
        self.rows: list[Row] = []
        self.shown: tuple[float, ...] = (0.0, 0.0)
        self._frames = 0
        self.truth: Callable[[], State] | None = None
        self.silent: Callable[[], Collection[str]] = tuple
        self.stand: StationarySensors | None = None

    def prepare(self, belief: Belief) -> None:
        """See :class:`cosim.base.protocols.RateLoop`.  Raises InputError for a vehicle that is not told to them."""
        vehicle = belief.vehicle
        if vehicle.hinges or vehicle.surfaces or any(jet.axis is not None for jet in vehicle.jets):
            raise InputError(
                f"{self.label}: {vehicle.name}: an autopilot is told of engines that push straight up, and of two "
                "tilting banks; not of hinges, surfaces and other axes"
            )
        self._belief = belief
        lean, turn = radians(self._handling.lean_deg), radians(self._handling.turn_deg_s)
        self._pilot = StickPilot(belief, lean, turn, self._hold_from, self._handling.turns_target)

    @property
    def start_s(self) -> float:
        """Time from the autopilot's first frame to the flight's first step, s."""
        return self._handling.before_s

    def reset(self) -> None:
        """Reset the stick pilot before the flight."""
        self._pilot.reset()

    def begin(self, measured: Measured) -> None:
        """Let the autopilot, which has begun, live through the time before.  Raises InputError or FlightError.

        ``measured``: at the start of the flight.  In the stand :attr:`stand` says what is measured.
        """
        if measured.specific_force[0] != measured.specific_force[0]:
            raise InputError(f"{self._belief.vehicle.name}: an autopilot needs vehicle.sensors.accelerometer")
        assert self.stand is not None
        handling, dt = self._handling, self._belief.step_s
        steps = round(handling.before_s / dt)
        arming, throttle = steps - round(handling.arming_s / dt), steps - round(handling.throttle_s / dt)
        answer = None
        for k in range(steps):
            sticks = StickPositions(throttle=self._pilot.hover if k >= throttle else 0.0, armed=k >= arming)
            answer = self._exchange(self.stand.sample(), sticks, ())
        if answer is None or not answer.armed:
            raise FlightError(f"{self.label} was not armed within {handling.before_s:g} s{handling.unarmed}")

    def update(self, command: Command, measured: Measured, applied: Applied) -> Actuation:
        """Exchange one step with the autopilot.  Raises FlightError where it does not answer."""
        sticks = self._pilot.update(command, measured, applied.burnt)
        answer = self._exchange(measured, sticks, applied.engines.spool_speed)
        throttle, tilt, armed = answer if self.rates is None else self.rates.compute_outputs(answer, measured)
        self.shown = (1.0 if armed else 0.0, self._frames * self._belief.step_s)
        self.rows.append((throttle, tilt, self.shown))
        return Actuation(throttle, tilt, Unallocated())

    def _exchange(self, measured: Measured, sticks: StickPositions, spool: tuple[float, ...]) -> ActuatorOutputs:
        frame = SensorFrame(
            self._frames * self._belief.step_s,
            measured.rate if self.rates is None else self.rates.select_gyro(measured.rate),
            measured.specific_force,
            measured.attitude,
            measured.position,
            measured.velocity,
            measured.altitude,
            sticks,
            spool,
            None if self.truth is None else self.truth(),
            self.silent(),
        )
        answer = self.autopilot.exchange(frame)
        self._frames += 1
        return answer
