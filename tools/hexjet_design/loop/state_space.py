"""A closed channel in state space, step by step as it is flown: every delay is a state, the response in time exact.

One step of the loop is linear in what the loop remembers and in its two inputs, a set-point and a load at the plant's
input.  Each signal of the step is written as a row, its coefficients over states and inputs; rows add up like signals,
and what is to be remembered makes the transition

    x_k+1 = A x_k + B (set-point, load),  angle_k = C x_k,  command_k = (C_u, D_u)(x_k, set-point, load)

The blocks are those of :mod:`hexjet_design.loop.closed_loop`, which has the same loop by its frequency response.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.control.lead import lead_polynomials
from cosim.control.predictors.linear import companion, make_delayed_system
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.tuning import Tuning

SETPOINT, LOAD = 0, 1  # indices of the inputs


class Steps(NamedTuple):
    """Responses to unit steps, sample by sample from the instant of the step on."""

    angle: Array  # response to set-point, rad per rad
    command: Array  # response to set-point, command per rad
    load: Array  # angle per unit load, rad


class Space:
    """Closed loop of a channel and a tuning in state space."""

    def __init__(self, channel: Channel, tuning: Tuning) -> None:
        self.channel, self.tuning = channel, tuning
        self._plant = make_delayed_system(channel.identified or channel.actuator.model)
        self._late = self._plant.delay + channel.added_delay  # samples until a command acts
        self._between = self._plant.B.shape[1] > 1
        self._slots: dict[str, slice] = {}
        self._size = 0
        space = tuning.space()
        if space is None:
            raise InputError(f"controller {tuning.controller!r}: states no state space")
        self._predictor = space
        self._allocate_states(
            "sent", max(space.history_length, self._late + (1 if self._between else 0), 1)
        )  # newest command last
        self._allocate_states("plant", len(self._plant.A))
        if self._between:
            self._allocate_states("loaded", 1)
        if channel.identified is None:
            self._allocate_states("force", len(channel.rate_dynamics[0]) - 1)  # forces of previous steps
            self._allocate_states("rate", 1)
            self._allocate_states("gyro", max(1, channel.rate_latency + channel.rate_hold))
        else:
            self._allocate_states("rate", 1)
        self._allocate_states("angle", 1 + channel.angle_latency)
        if tuning.gains.i:
            self._allocate_states("integral", 1)
        self._allocate_states("slope", 1)
        self._allocate_states("before", 1)
        lead = tuning.lead and lead_polynomials(tuning.lead, channel.step)
        self._lead = (np.array(lead[0]), np.array(lead[1])) if lead else None
        if self._lead:
            self._allocate_states("lead", len(self._lead[1]) - 1)
        for name, size in space.states.items():
            self._allocate_states(name, size)
        rows = np.eye(self._size + 2)
        self._x = {name: rows[where] for name, where in self._slots.items()}
        self._r, self._w = rows[self._size + SETPOINT], rows[self._size + LOAD]
        self._next = np.zeros((self._size, self._size + 2))
        self.command: Array = self._step()
        n = self._size
        self.A, self.B = self._next[:, :n], self._next[:, n:]
        self.angle: Array = self._x["angle"][0][:n]

    def _allocate_states(self, name: str, n: int) -> None:
        self._slots[name] = slice(self._size, self._size + n)
        self._size += n

    def _store_next_states(self, name: str, rows: Array) -> None:
        self._next[self._slots[name]] = rows

    def _shift(self, name: str, newest: Array) -> None:
        """Put the newest value at the front of a delay line and drop the oldest."""
        line = self._x[name]
        self._store_next_states(name, np.vstack([newest[None, :], line[:-1]]))

    def _earlier_command(self, command: Array, samples: int) -> Array:
        """Return the command of ``samples`` steps before."""
        return command if samples == 0 else np.asarray(self._x["sent"][samples - 1])

    def _step(self) -> Array:
        """Compute one step: store the next state in ``_next`` and return the command."""
        channel, gains, x, T = self.channel, self.tuning.gains, self._x, self.channel.step
        measured = x["rate"][0]
        if channel.identified is None:
            line = x["gyro"][channel.rate_latency :]
            measured = line.sum(axis=0) / channel.rate_hold
        predicted = self._predictor.predicted(measured, x, self._store_next_states)
        error = self.tuning.angle_gain * (self._r - x["angle"][channel.angle_latency]) - predicted
        weight = T / (gains.d_filter_s + T)
        slope = x["slope"][0] + weight * ((predicted - x["before"][0]) / T - x["slope"][0])
        command = gains.p * error - gains.d * slope
        if gains.i:
            integral = x["integral"][0] + gains.i * T * error
            command = command + integral
            self._store_next_states("integral", integral)
        if self._lead:
            command = self._apply_lead(command)
        self._store_next_states("slope", slope)
        self._store_next_states("before", predicted)
        self._advance_plant(command)
        self._predictor.apply_command(command, x, self._store_next_states)
        self._shift("sent", command)
        return np.asarray(command)

    def _apply_lead(self, command: Array) -> Array:
        assert self._lead is not None
        numerator, denominator = self._lead
        A, B, C = companion(numerator[1:] - numerator[0] * denominator[1:], denominator)
        state = self._x["lead"]
        self._store_next_states("lead", A @ state + np.outer(B, command))
        return np.asarray(C @ state + numerator[0] * command)

    def _advance_plant(self, command: Array) -> None:
        """Advance the plant by the commands that reach it."""
        channel, plant, x, T = self.channel, self._plant, self._x, self.channel.step
        acting = self._earlier_command(command, self._late) + self._w
        entering = acting[None, :]
        if self._between:
            entering = np.vstack([acting, self._earlier_command(command, self._late + 1) + x["loaded"][0]])
            self._store_next_states("loaded", self._w)
        state = plant.A @ x["plant"] + plant.B @ entering
        self._store_next_states("plant", state)
        force, before = plant.C @ state, x["rate"][0]
        if channel.identified is None:
            (now, *late), pole = channel.rate_dynamics
            acting = now * force
            for k, weight in enumerate(late):
                acting = acting + weight * x["force"][k]
            rate = pole * before + channel.gain * T * acting
            self._shift("force", force)
            c = channel.gyro_pole
            self._shift("gyro", c * x["gyro"][0] + (1.0 - c) * rate)
        else:
            rate = force
        self._store_next_states("rate", rate)
        self._shift("angle", x["angle"][0] + 0.5 * T * (before + rate))

    def steps(self, samples: int) -> Steps:
        """Return the responses to a unit step of the set-point and of the load over ``samples`` samples.

        ``C A^(i + j m) B`` by doubling: powers up to ``m`` on the left, those of ``A^m`` on the right.
        """
        n = self._size
        # The inputs are appended as constant states.
        power = np.block([[self.A, self.B], [np.zeros((2, n)), np.eye(2)]])
        rows, columns = np.vstack([np.append(self.angle, [0.0, 0.0]), self.command]), np.eye(n + 2)[:, n:]
        count = wide = 1
        while count * count < samples:
            rows = np.vstack([rows, rows @ power])
            power = power @ power
            count *= 2
        while wide * count < samples:
            columns = np.hstack([columns, power @ columns])
            power = power @ power
            wide *= 2
        states = (rows.reshape(count * 2, n + 2) @ columns).reshape(count, 2, wide, 2)
        angle, command = states[:, 0], states[:, 1]
        # Here a load acts at once, which needs fewer states; the delay that it shares with commands is added after.
        load = np.concatenate([np.zeros(self._late), angle[..., LOAD].T.ravel()])
        return Steps(
            angle[..., SETPOINT].T.ravel()[:samples], command[..., SETPOINT].T.ravel()[:samples], load[:samples]
        )
