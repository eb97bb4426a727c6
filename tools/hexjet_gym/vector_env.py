"""The vehicle as a Gymnasium environment of many flights at once: ``HexJetVectorEnv``."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from cosim import InputError, Scenario
from cosim.base.arrays import Array, Flags
from hexjet_batch.fly import is_within, prepare
from hexjet_batch.make import read_flight
from hexjet_batch.stages.rotations import from_euler
from hexjet_batch.stages.step import altitude_of, hold_up, start, step
from hexjet_gym.env import ANGLE_SCALE, HEIGHT_SCALE, HexJetEnv, Vary


class HexJetVectorEnv(gymnasium.vector.VectorEnv[Array, Array, Array]):  # type: ignore[misc]  # as in env
    """Flights of :class:`hexjet_gym.HexJetEnv` on arrays, with its observations, actions, seeds and default reward.

    All flights of an episode end together, at the scenario's end, and the step after begins the next episode.  One that
    was lost before stays where that was, with a reward of 0, and is terminated then; the others are truncated.

    ``num_envs``: flights; the other parameters are those of ``HexJetEnv``, but for actuators as actions.

    Raises
    ------
    InputError
        For what a batch does not cover, and as ``HexJetEnv``.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}  # noqa: RUF012  as Gymnasium has it

    def __init__(
        self,
        num_envs: int,
        scenario: Scenario | str | Path = "roll-doublet",
        act: str = "rates",
        hold: int = 1,
        memory: int = 1,
        vary: Vary | None = None,
    ) -> None:
        if num_envs < 1:
            raise InputError(f"num_envs = {num_envs}: at least 1")
        if act == "actuators":
            raise InputError("act = 'actuators': a batch takes rates or attitude; gymnasium.make_vec has it")
        self._scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        read_flight(self._scenario)
        single = HexJetEnv(self._scenario, act, hold=hold, memory=memory)
        single.close()
        self.num_envs, self._act, self._hold, self._vary = num_envs, act, hold, vary
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        batch = gymnasium.vector.utils.batch_space
        self.observation_space = batch(single.observation_space, num_envs)
        self.action_space = batch(single.action_space, num_envs)
        self._scale = np.array([signal.scale for signal in single.acted])
        self._actuators: deque[Array] = deque(maxlen=memory)
        self._seeds: list[np.random.Generator] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new flights, of other noise; flight N has the seed ``seed + N``.  ``options`` has nothing to choose."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + n for n in range(self.num_envs)]
        if seed is not None or not self._seeds:
            self._seeds = [gymnasium.utils.seeding.np_random(each)[0] for each in seeds]
        noise = [int(generator.integers(2**31)) for generator in self._seeds]
        flown = [self._scenario if self._vary is None else self._vary(self._scenario, each) for each in self._seeds]
        scenarios = [each.model_copy(update={"seed": seed}) for each, seed in zip(flown, noise, strict=True)]
        self._n, self._script, self._noise, self._height, self._lowest, self._limits, motion = prepare(scenarios)
        self._k, self._last, self._lost = 0, scenarios[0].steps, np.zeros(self.num_envs, dtype=np.bool_)
        self._asked, self._inputs = self._script.at(0)
        self._state = start(self._n, motion, self._height, self._inputs)
        tilt = None if self._n.servo is None else (0.0, 0.0)
        first = self._positions(hold_up(self._n, self._state.burnt)[1], tilt)
        self._actuators.extend([first] * (self._actuators.maxlen or 0))
        self._seen = self._observation()
        return self._seen.copy(), {"time_s": np.zeros(self.num_envs)}

    def step(self, actions: Array) -> tuple[Array, Array, Flags, Flags, dict[str, Any]]:
        """Hold an action for each flight; of what is beyond its bounds the bound.  Raises InputError for no numbers."""
        none = np.zeros(self.num_envs, dtype=np.bool_)
        if self._k >= self._last:
            observation, info = self.reset()
            return observation, np.zeros(self.num_envs), none, none.copy(), info
        numbers = np.asarray(actions, dtype=float)
        if numbers.shape != self.action_space.shape or not np.isfinite(numbers).all():
            raise InputError(f"actions: must be finite numbers of shape {self.action_space.shape}")
        values = (np.clip(numbers, self.action_space.low, self.action_space.high) * self._scale).T
        total = np.zeros(self.num_envs)
        with np.errstate(all="ignore"):  # lost flights go on to infinity
            for _ in range(min(self._hold, self._last - self._k)):
                total += self._fly(values)
        is_over = np.full(self.num_envs, self._k >= self._last)
        info = {"time_s": np.full(self.num_envs, self._k * self._n.step)}
        self._seen = np.where(self._lost[:, None], self._seen, self._observation())
        return self._seen.copy(), total, is_over & self._lost, is_over & ~self._lost, info

    def _fly(self, values: Array) -> Array:
        """Fly a step, and return the reward of each flight."""
        inputs, asked = self._inputs, self._asked
        x, y, z, last = values
        if self._act == "rates":
            inputs = inputs._replace(rate=(x, y, z), collective=last)
        else:
            inputs = inputs._replace(setpoint=from_euler(x, y, z, np), altitude=self._height + last)
        if self._noise is not None:
            inputs = inputs._replace(draws=self._noise.at(self._k))
        moved, outputs = step(self._n, self._state, inputs)
        altitude = altitude_of(moved)
        sound = is_within(self._limits, moved.motion) & (altitude > self._lowest)
        self._lost |= ~sound | np.any(np.atleast_2d(outputs.report.out) > 0.0, axis=0)
        self._state = moved
        self._actuators.appendleft(self._positions(outputs.throttle, outputs.tilt_command))
        self._k += 1
        along = sum(a * b for a, b in zip(self._inputs.setpoint, moved.motion.attitude, strict=True))
        angle, height = 2.0 * np.arccos(np.minimum(abs(along), 1.0)), altitude - asked.altitude
        self._asked, self._inputs = self._script.at(self._k)
        reward = self._n.step * np.exp(-((angle / ANGLE_SCALE) ** 2) - (height / HEIGHT_SCALE) ** 2)
        return np.where(self._lost, 0.0, reward)

    def _positions(self, throttle: Any, tilt: Any) -> Array:
        """Return what the actuators are told, as an observation has it: a row for each throttle and tilt."""
        rows = [throttle[channel] for channel in self._n.jets.channels] + list(tilt or ())
        return np.array([np.broadcast_to(row, self.num_envs) for row in rows])

    def _observation(self) -> Array:
        told, command = self._state.measured, self._asked
        values = [*told.rate, *told.attitude, *told.velocity, told.altitude, *command.attitude, command.altitude]
        rows = [np.broadcast_to(value, self.num_envs) for value in values]
        table = np.concatenate([np.array(rows), *self._actuators]).T
        return np.asarray(np.clip(table, self.observation_space.low, self.observation_space.high))
