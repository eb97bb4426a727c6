"""The vehicle as a Gymnasium environment: ``gymnasium.make("hexjet_gym:HexJet-v0")``."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import chain
from math import acos, degrees, exp, pi, radians
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from cosim import Command, FlightError, InputError, Scenario, Stepper
from cosim.base.arrays import Array
from cosim.base.errors import nearest
from cosim.base.frames import conjugate, from_euler, multiply
from cosim.base.signals import AXES, Sample
from cosim.spec.vehicle import Vehicle

ACTS = ("actuators", "rates", "attitude")  # what an action commands
# Roll and pitch [rad] at an action of 1; chosen by us: three times the paper's doublet.
MAX_LEAN = pi / 6.0
MAX_CLIMB = 10.0  # height [m] at an action of 1
# Bounds of observations, which learning libraries need; chosen by us: beyond any flight that does not fail.
MAX_SPEED, MAX_HEIGHT = 200.0, 10_000.0  # m/s, m
# Errors [rad, m] that reduce the reward to 1/e; chosen by us: half of a doublet, half a metre.
ANGLE_SCALE, HEIGHT_SCALE = radians(5.0), 0.5


class Signal(NamedTuple):
    """Name, unit, frame, bounds and scale of one number of an observation or action."""

    name: str
    unit: str
    frame: str
    low: float
    high: float
    scale: float = 1.0  # SI units per unit of action


Reward = Callable[[Stepper, Sample, Command], float]
Vary = Callable[[Scenario, np.random.Generator], Scenario]


def time_on_target(flight: Stepper, sample: Sample, command: Command) -> float:
    """Return the default reward: the control step [s], reduced with distance from the command.

    ``dt exp(-(angle / ANGLE_SCALE)^2 - (height / HEIGHT_SCALE)^2)`` of the true state at the end of the step, and 0
    once the flight has failed: the sum over a flight is at most its seconds.

    Parameters
    ----------
    flight : Stepper
        At the end of the step: ``state``, ``measured``, ``ending``, ``scenario``.
    sample : Sample
        All that there is to see of the step.
    command : Command
        What the scenario asks for in it, whatever the action was.

    Returns
    -------
    float
        0 to the control step [s].
    """
    if flight.ending is not None and flight.ending.outcome != "completed":
        return 0.0
    turn = multiply(conjugate(from_euler(*command.attitude)), flight.state.attitude)
    angle, height = 2.0 * acos(min(abs(turn[0]), 1.0)), flight.state.altitude - command.altitude
    return flight.scenario.step_s * exp(-((angle / ANGLE_SCALE) ** 2) - (height / HEIGHT_SCALE) ** 2)


class HexJetEnv(gymnasium.Env[Array, Array]):  # type: ignore[misc]  # no types where it is not installed
    """Gymnasium environment: an episode is one flight, in which the scenario commands and the agent flies.

    An observation is what the sensors say, what is asked for, and what the actuators were told in the last steps: with
    engines that answer late the present alone does not say what comes.  ``observed`` and ``acted`` name every number of
    an observation and of an action, with unit, frame and bounds.  An episode is terminated where the flight crashes,
    diverges or fails, and truncated at the scenario's end; ``info`` has ``time_s``, and at the end ``outcome`` and
    ``reason``.

    Parameters
    ----------
    scenario : Scenario or str or Path
        Asks for attitude and height, and disturbs.
    act : str
        ``actuators``: throttles and tilts; ``rates``: body rates and collective, flown by the scenario's controller;
        ``attitude``: angles and height, flown by it.
    reward : callable
        From flight, sample and what is asked for to a number, once a control step; those of an action are summed.
    hold : int
        Control steps that an action is held.
    memory : int
        Control steps of which an observation has throttles and tilts, the last first.
    vary : callable or None
        From the scenario and a generator to what flies in the next episode.  The noise is another one in every episode,
        seeded by that generator, which ``reset(seed=...)`` seeds.
    render_mode : str or None
        ``ansi``: ``render()`` gives one line of text.

    Raises
    ------
    InputError
        For a scenario that asks for rates, a collective or a place, and as :func:`cosim.fly`.
    """

    metadata: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 250}  # noqa: RUF012  as Gymnasium has it

    def __init__(
        self,
        scenario: Scenario | str | Path = "roll-doublet",
        act: str = "actuators",
        reward: Reward = time_on_target,
        hold: int = 1,
        memory: int = 1,
        vary: Vary | None = None,
        render_mode: str | None = None,
    ) -> None:
        if act not in ACTS:
            raise InputError(f"act = {act!r}: {nearest(act, ACTS)}")
        for name, value in (("hold", hold), ("memory", memory)):
            if not isinstance(value, int) or value < 1:
                raise InputError(f"{name} = {value!r}: must be a whole number from 1")
        if render_mode not in (None, "ansi"):
            raise InputError(f"render_mode = {render_mode!r}: must be None or 'ansi'")
        self.render_mode = render_mode
        self._act, self._reward, self._hold, self._vary = act, reward, hold, vary
        self._scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        self.flight = Stepper(self._scenario, actuators=act == "actuators", log=False)
        _require_attitude_commands(self.flight)
        self.metadata = {**self.metadata, "render_fps": 1.0 / (hold * self._scenario.step_s)}
        self.acted, self.observed = self._list_actions(), self._list_observations(memory)
        self._scale = np.array([signal.scale for signal in self.acted])
        self.action_space, self.observation_space = _make_box(self.acted), _make_box(self.observed)
        self._low, self._high = np.array([[s.low, s.high] for s in self.observed]).T
        self._actuators: deque[tuple[float, ...]] = deque(maxlen=memory)

    def _list_actions(self) -> tuple[Signal, ...]:
        vehicle = self.flight.simulation.vehicle
        if self._act == "rates":
            limits = vehicle.control.attitude.rate_limit_rad_s
            rates = [
                Signal(f"rate_{name}", "rad/s", "body", -1.0, 1.0, most)
                for name, most in zip("pqr", limits, strict=True)
            ]
            return (*rates, Signal("collective", "throttle", "", 0.0, 1.0))
        if self._act == "attitude":
            scales = (MAX_LEAN, MAX_LEAN, pi)
            angles = [
                Signal(axis, "rad", "NED to body", -1.0, 1.0, most) for axis, most in zip(AXES, scales, strict=True)
            ]
            return (*angles, Signal("height_above_start", "m", "up", -1.0, 1.0, MAX_CLIMB))
        throttles = [Signal(f"throttle_{jet}", "throttle", "", 0.0, 1.0) for jet in range(1, len(vehicle.jets) + 1)]
        return (*throttles, *_list_servo_signals(vehicle, ""))

    def _list_observations(self, memory: int) -> tuple[Signal, ...]:
        vehicle = self.flight.simulation.vehicle
        rate, speed, height = 2.0 * radians(vehicle.limits.rate_deg_s), MAX_SPEED, MAX_HEIGHT
        signals = [
            *[Signal(f"rate_{name}", "rad/s", "body", -rate, rate) for name in "pqr"],
            *[Signal(f"attitude_{name}", "1", "body to NED", -1.0, 1.0) for name in "wxyz"],
            *[Signal(f"velocity_{name}", "m/s", "NED", -speed, speed) for name in ("north", "east", "down")],
            Signal("altitude", "m", "up", -height, height),
            *[Signal(f"{axis}_setpoint", "rad", "NED to body", -pi, pi) for axis in AXES],
            Signal("altitude_setpoint", "m", "up", -height, height),
        ]
        for back in range(1, memory + 1):
            jets = range(1, len(vehicle.jets) + 1)
            signals += [Signal(f"throttle_{jet}_before_{back}", "throttle", "", 0.0, 1.0) for jet in jets]
            servos = _list_servo_signals(vehicle, f"_before_{back}")
            signals += [
                signal._replace(low=signal.low * signal.scale, high=signal.high * signal.scale, scale=1.0)
                for signal in servos
            ]
        return tuple(signals)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start a new flight with other noise; there are no ``options``."""
        super().reset(seed=seed)
        noise = int(self.np_random.integers(2**31))
        scenario = self._scenario if self._vary is None else self._vary(self._scenario, self.np_random)
        for key in ("aircraft", "step_s"):
            if getattr(scenario, key) != getattr(self._scenario, key):
                raise InputError(
                    f"vary: {key} = {getattr(scenario, key)!r}: must stay {getattr(self._scenario, key)!r}"
                )
        self.flight.reset(noise, scenario)
        _require_attitude_commands(self.flight)
        simulation = self.flight.simulation
        initial = simulation.initial_throttle + (simulation.vehicle.rest if simulation.vehicle.ranges else ())
        self._actuators.extend([initial] * (self._actuators.maxlen or 0))
        self._start = self.flight.state.altitude
        self._last_observation = self._make_observation()
        return self._last_observation.copy(), {"time_s": 0.0}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action, clipped to its bounds, for the environment's number of control steps.

        Raises InputError for an action that is not finite, FlightError if the episode is over.
        """
        numbers = np.asarray(action, dtype=float)
        if numbers.shape != self._scale.shape or not np.isfinite(numbers).all():
            raise InputError(f"action = {numbers.tolist()}: must be {len(self._scale)} finite numbers")
        values = np.clip(numbers, self.action_space.low, self.action_space.high) * self._scale
        flight, total = self.flight, 0.0
        if flight.ending is not None:
            raise FlightError(f"the episode is over ({flight.ending.outcome}): reset begins another")
        for _ in range(self._hold):
            command = flight.command
            try:
                sample = self._fly_step(values.tolist(), command)
            except FlightError:  # a failed step has no sample
                break
            positions = sample.actuation.throttle + (sample.actuation.tilt if flight.simulation.vehicle.ranges else ())
            self._actuators.appendleft(positions)
            total += self._reward(flight, sample, command)
            if flight.ending is not None:
                break
        if flight.ending is None or flight.ending.outcome != "failed":
            self._last_observation = self._make_observation()
        info: dict[str, Any] = {"time_s": flight.time}
        if flight.ending is not None:
            info |= {"outcome": flight.ending.outcome, "reason": flight.ending.reason}
        over = flight.ending is not None
        truncated = over and info["outcome"] == "completed"
        return self._last_observation.copy(), total, over and not truncated, truncated, info

    def _fly_step(self, values: list[float], command: Command) -> Sample:
        flight = self.flight
        if self._act == "actuators":
            jets = len(flight.simulation.vehicle.jets)
            return flight.step(throttle=values[:jets], tilt=values[jets:] or None)
        x, y, z, last = values
        if self._act == "rates":
            return flight.step(Command(command.attitude, command.altitude, (x, y, z), last))
        return flight.step(Command((x, y, z), self._start + last))

    def _make_observation(self) -> Array:
        flight = self.flight
        measured, command = flight.measured, flight.command
        said = [*measured.rate, *measured.attitude, *measured.velocity, measured.altitude]
        values = [*said, *command.attitude, command.altitude, *chain.from_iterable(self._actuators)]
        return np.asarray(np.clip(np.array(values), self._low, self._high))

    def render(self) -> str | None:
        """Return one line: time, true angles, height and the last step's throttles; None without a render mode."""
        if self.render_mode is None:
            return None
        state = self.flight.state
        angles = ", ".join(f"{axis} {degrees(angle):z.1f}" for axis, angle in zip(AXES, state.euler, strict=True))
        jets = len(self.flight.simulation.vehicle.jets)
        throttles = " ".join(f"{value:.2f}" for value in self._actuators[0][:jets]) if self._actuators else "-"
        return f"{self.flight.time:.3f} s: {angles} deg, height {state.altitude:.2f} m, throttles {throttles}"

    def close(self) -> None:
        """Free engines and airframe; may be called twice."""
        self.flight.close()


def _list_servo_signals(vehicle: Vehicle, ending: str) -> list[Signal]:
    """Return the signals of tilts and deflections, each normalised by the farther end of its range."""
    turning = len(vehicle.actuators) - len(vehicle.surfaces)
    signals = []
    for n, (low, high) in enumerate(vehicle.ranges):
        kind, unit, frame = ("tilt", "rad", "body") if n < turning else ("deflection", "1", "")
        most = max(-low, high)
        signals.append(Signal(f"{kind}_{vehicle.actuators[n]}{ending}", unit, frame, low / most, high / most, most))
    return signals


def _require_attitude_commands(flight: Stepper) -> None:
    """Close the flight and raise InputError if its scenario commands other than attitude and height."""
    simulation = flight.simulation
    others = [name for name in simulation.command_script.signals if name == "collective" or name.startswith("rate_")]
    if simulation.pilot is not None or others:
        flight.close()
        raise InputError(
            f"scenario {flight.scenario.name}: commands {others[0] if others else 'a place'}; an environment takes one "
            "that commands attitude and height"
        )


def _make_box(signals: tuple[Signal, ...]) -> gymnasium.spaces.Box:
    low, high = (np.array([getattr(signal, end) for signal in signals]) for end in ("low", "high"))
    return gymnasium.spaces.Box(low, high, dtype=np.float64)
