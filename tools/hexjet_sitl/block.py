"""An autopilot as the whole controller of a flight, and the time before it, when the vehicle is held in a stand."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import inf, radians
from typing import TYPE_CHECKING

import numpy as np

from cosim import FlightError, InputError
from cosim.base.frames import conjugate, rotate
from cosim.base.protocols import Applied
from cosim.base.signals import ZERO3, Actuation, Command, Measured, State, Unallocated
from cosim.laws import Belief
from cosim.simulation.controllers.recorded import COLUMNS, Row
from cosim.vehicle.sensors import SensorSuite
from hexjet_sitl.lockstep import ActuatorOutputs, Autopilot, SensorFrame, StickPositions
from hexjet_sitl.pilot import StickPilot

if TYPE_CHECKING:
    from cosim.spec.vehicle import Sensors


class StationarySensors:
    """The vehicle's own sensors while it stands still before the flight.

    They are those of the flight, with the same bias, filter, latency and size of noise: what an autopilot learns of
    them in the stand holds in the air, and nothing repeats, which it would take for a sensor that has died.  The noise
    is from a generator of its own, so that the flight's is as it is without.  ``state``: as the flight begins;
    ``gravity`` [m/s^2]: that of the place.  ``noisy``: as of the flight.
    """

    def __init__(self, sensors: Sensors, step: float, seed: int, noisy: bool, state: State, gravity: float) -> None:
        force = rotate(conjugate(state.attitude), (0.0, 0.0, -gravity))
        self._still = state._replace(rate=ZERO3, velocity=ZERO3, specific_force=force)
        noise_seed = int(np.random.SeedSequence(seed, spawn_key=(5,)).generate_state(1)[0])
        self._suite = SensorSuite(sensors, step, noise_seed, noisy)
        self._suite.reset(self._still)

    def sample(self) -> Measured:
        """Return the sensors' measurement at the end of the next step."""
        return self._suite.sample(self._still)


class AutopilotBlock:
    """Controller that exchanges one frame per update with an autopilot.

    The time of its ``timing`` passes between the autopilot's first frame and the flight's first step.  In it the
    vehicle stands in a stand as it begins the flight: level or not, still, on its engines of a flight that has begun;
    the autopilot calibrates and is armed.  ``rows``: what it answered in the flight, step by step.
    ``truth``: the true motion, for the autopilot's own log.  ``silent``: the sensors that are out.
    ``stand``: the sensors before the flight.
    With ``hands_off`` in the autopilot's set-up the pilot leaves the sticks alone, in the middle and without throttle,
    and arms nobody: a ground station does.
    """

    level = "controller"
    columns = COLUMNS

    def __init__(self, autopilot: Autopilot) -> None:
        self.autopilot, self.label, self._timing = autopilot, autopilot.name, autopilot.timing
        self._hands_off = autopilot.setup.hands_off
        self.rows: list[Row] = []
        self.shown: tuple[float, ...] = (0.0, 0.0)
        self._frames = 0
        self.truth: Callable[[], State] | None = None
        self.silent: Callable[[], Collection[str]] = tuple
        self.stand: StationarySensors | None = None

    def prepare(self, belief: Belief) -> None:
        """Build the stick pilot for the vehicle.  Raises InputError for a vehicle that no autopilot can fly."""
        vehicle = belief.vehicle
        if vehicle.hinges or vehicle.surfaces or any(jet.axis is not None for jet in vehicle.jets):
            raise InputError(
                f"{self.label}: {vehicle.name}: an autopilot is told of engines that push straight up, and of two "
                "tilting banks; not of hinges, surfaces and other axes"
            )
        self._belief = belief
        lean, turn = radians(self._timing.lean_deg), radians(self._timing.turn_deg_s)
        hold_from = self.autopilot.setup.hold_from_s
        hold_from = inf if hold_from is None else hold_from
        self._pilot = StickPilot(belief, lean, turn, hold_from, self._timing.stick_moves_heading)

    @property
    def start_s(self) -> float:
        """Time from the autopilot's first frame to the flight's first step, s."""
        return self._timing.before_s

    def reset(self) -> None:
        """Reset the stick pilot before the flight."""
        self._pilot.reset()

    def begin(self, measured: Measured) -> None:
        """Exchange frames with the started autopilot for the time before the flight.  Raises InputError or FlightError.

        ``measured``: at the start of the flight.  In the stand :attr:`stand` says what is measured.
        """
        if measured.specific_force[0] != measured.specific_force[0]:
            raise InputError(f"{self._belief.vehicle.name}: an autopilot needs vehicle.sensors.accelerometer")
        assert self.stand is not None
        timing, dt = self._timing, self._belief.step_s
        steps = round(timing.before_s / dt)
        arming, throttle = steps - round(timing.arming_s / dt), steps - round(timing.throttle_s / dt)
        answer = None
        for k in range(steps):
            sticks = StickPositions(throttle=self._pilot.hover if k >= throttle else 0.0, armed=k >= arming)
            answer = self._exchange_frame(self.stand.sample(), StickPositions() if self._hands_off else sticks, ())
        if not self._hands_off and (answer is None or not answer.armed):
            raise FlightError(f"{self.label} was not armed within {timing.before_s:g} s{timing.unarmed}")

    def update(self, command: Command, measured: Measured, applied: Applied) -> Actuation:
        """Exchange one step's frame with the autopilot.  Raises FlightError if it does not answer."""
        sticks = StickPositions() if self._hands_off else self._pilot.update(command, measured, applied.burnt)
        throttle, tilt, armed = self._exchange_frame(measured, sticks, applied.engines.spool_speed)
        self.shown = (1.0 if armed else 0.0, self._frames * self._belief.step_s)
        self.rows.append((throttle, tilt, self.shown))
        return Actuation(throttle, tilt, Unallocated())

    def _exchange_frame(self, measured: Measured, sticks: StickPositions, spool: tuple[float, ...]) -> ActuatorOutputs:
        frame = SensorFrame(
            self._frames * self._belief.step_s,
            measured.rate,
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
