"""A closed channel in state space, step by step as it is flown: every delay is a state, the response in time exact.

One step of the loop is linear in what the loop remembers and in its two inputs, a set-point and a load at the plant's
input.  Each signal of the step is written as a row, its coefficients over states and inputs; rows add up like signals,
and what is to be remembered makes the transition

    x_k+1 = A x_k + B (set-point, load),  angle_k = C x_k,  command_k = (C_u, D_u)(x_k, set-point, load)

The blocks are those of :mod:`cosim.design.closed_loop`, which has the same loop by its response on the unit circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cosim.base.errors import InputError
from cosim.base.toml import nearest
from cosim.control.lead import lead_polynomials
from cosim.control.predictors.smith import robustness_filter
from cosim.control.predictors.state import Modes, modal_observer
from cosim.design.channel import Channel
from cosim.design.frequency import Array
from cosim.design.tuning import CANDIDATES, Tuning
from cosim.spec.vehicle import RateModel

SETPOINT, LOAD = 0, 1  # the inputs


class Steps(NamedTuple):
    """Sample by sample from the instant of a unit step on."""

    angle: Array  # of the set-point, rad per rad
    command: Array  # of the set-point, its unit per rad
    load: Array  # angle after a step of load, rad per unit of the command


@dataclass(frozen=True)
class Part:
    """``x' = A x + B v``, ``y' = C x'`` of the inputs ``v``, with a delay of whole samples before it.

    A delay of ``n + f`` samples has two inputs, of ``n`` and of ``n + 1`` samples ago.
    """

    A: Array
    B: Array  # one column an input
    C: Array
    delay: int


def part(model: RateModel) -> Part:
    """A sampled response with its delay; mode by mode where the delay is not whole."""
    whole = int(model.delay_samples)
    if model.delay_samples == whole:
        A, B, C = cascade(model)
        return Part(A, B[:, None], C, whole)
    modes = Modes(model)
    shares = np.array(modes.shares)
    A, B, C = _real(np.diag(modes.poles), np.stack([shares, 1.0 - shares], axis=1), np.array(modes.residues))
    return Part(A, B, C, whole)


def cascade(model: RateModel) -> tuple[Array, Array, Array]:
    """``x_k+1 = A x_k + B u_k``, ``y_k = C x_k`` of a response without its delay: poles and zeros in a row.

    One polynomial of six poles that are all but 1 would lose most digits.
    """
    zeros, sections = [*model.all_zeros], []
    for pole in sorted((complex(p) for p in model.all_poles), key=abs):
        if pole.imag < 0.0:
            continue
        order = 2 if pole.imag else 1
        taken = [zeros.pop() for _ in range(min(order, len(zeros)))]
        if len(taken) == 1 and isinstance(taken[0], complex) and taken[0].imag:
            zeros.append(taken.pop())  # its other half would be left alone
        sections.append(_section(pole, np.real(np.poly(taken)) if taken else np.array([1.0])))
    if zeros:
        raise InputError(f"identified model: more pairs of zeros ({model.zero_pairs}) than pairs of poles take")
    A, B, C, D = sections[0]
    for a, b, c, d in sections[1:]:
        A = np.block([[A, np.zeros((len(A), len(a)))], [np.outer(b, C), a]])
        B, C, D = np.concatenate([B, b * D]), np.concatenate([d * C, c]), d * D
    return A, B, model.gain * C


def _section(pole: complex, over: Array) -> tuple[Array, Array, Array, float]:
    """A real pole, or a pair of which ``pole`` is one, below a polynomial of at most its order."""
    re, im = pole.real, pole.imag
    size = abs(1.0 - pole) or 1.0  # the state is then as large as what comes in
    if not im:
        through = over[0] if len(over) == 2 else 0.0
        rest = over[-1] + through * re
        return np.array([[re]]), np.array([size]), np.array([rest / size]), float(through)
    under = np.array([1.0, -2.0 * re, re * re + im * im])
    over = np.concatenate([np.zeros(3 - len(over)), over])
    through = over[0]
    one, nought = over[1:] - through * under[1:]
    C = np.array([(nought + one * re) / im, one]) / size
    return np.array([[re, im], [-im, re]]), np.array([0.0, size]), C, float(through)


def _companion(over: Array, under: Array) -> tuple[Array, Array, Array]:
    """A strictly proper fraction of low order."""
    n = len(under) - 1
    A = np.eye(n, k=-1)
    A[0] = -under[1:]
    C = np.zeros(n)
    C[n - len(over) :] = over
    return A, np.eye(n)[:, 0], C


def _real(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    """Real and imaginary part in place of two conjugate states that follow each other."""
    n = len(A)
    change = np.eye(n, dtype=complex)
    i = 0
    while i < n:
        if i + 1 < n and A[i, i].imag:
            change[i : i + 2, i : i + 2] = [[0.5, 0.5], [-0.5j, 0.5j]]
            i += 1
        i += 1
    back = np.linalg.inv(change)
    return np.real(change @ A @ back), np.real(change @ B), np.real(C @ back)


class Space:
    """The loop of a channel and a tuning."""

    def __init__(self, channel: Channel, tuning: Tuning) -> None:
        self.channel, self.tuning = channel, tuning
        self._plant = part(channel.identified or channel.actuator.model)
        self._late = self._plant.delay + channel.added_delay  # samples until a command acts
        self._between = self._plant.B.shape[1] > 1
        self._slots: dict[str, slice] = {}
        self._size = 0
        believes = int(tuning.model.delay_samples) + 2 if tuning.controller != "baseline" else 1
        self._slot("sent", max(believes, self._late + (1 if self._between else 0), 1))  # the last command first
        self._slot("plant", len(self._plant.A))
        if self._between:
            self._slot("loaded", 1)
        if channel.identified is None:
            self._slot("force", 2)  # of the last two steps
            self._slot("rate", 1)
            self._slot("gyro", max(1, channel.rate_latency + channel.rate_hold))
        else:
            self._slot("rate", 1)
        self._slot("angle", 1 + channel.angle_latency)
        if tuning.gains.i:
            self._slot("integral", 1)
        self._slot("slope", 1)
        self._slot("before", 1)
        lead = tuning.lead and lead_polynomials(tuning.lead, channel.step)
        self._lead = (np.array(lead[0]), np.array(lead[1])) if lead else None
        if self._lead:
            self._slot("lead", len(self._lead[1]) - 1)
        self._predictor_slots()
        rows = np.eye(self._size + 2)
        self._x = {name: rows[where] for name, where in self._slots.items()}
        self._r, self._w = rows[self._size + SETPOINT], rows[self._size + LOAD]
        self._next = np.zeros((self._size, self._size + 2))
        self.command: Array = self._step()
        n = self._size
        self.A, self.B = self._next[:, :n], self._next[:, n:]
        self.angle: Array = self._x["angle"][0][:n]

    def _slot(self, name: str, n: int) -> None:
        self._slots[name] = slice(self._size, self._size + n)
        self._size += n

    def _keep(self, name: str, rows: Array) -> None:
        self._next[self._slots[name]] = rows

    def _shift(self, name: str, newest: Array) -> None:
        """A line of what was, the newest first."""
        line = self._x[name]
        self._keep(name, np.vstack([newest[None, :], line[:-1]]))

    def _ago(self, command: Array, samples: int) -> Array:
        """The command of so many steps ago."""
        return command if samples == 0 else np.asarray(self._x["sent"][samples - 1])

    def _step(self) -> Array:
        """One step: what is remembered after it goes to ``_next``; the command is returned."""
        channel, gains, x, T = self.channel, self.tuning.gains, self._x, self.channel.step
        measured = x["rate"][0]
        if channel.identified is None:
            line = x["gyro"][channel.rate_latency :]
            measured = line.sum(axis=0) / channel.rate_hold
        predicted = self._predicted(measured)
        error = self.tuning.angle_gain * (self._r - x["angle"][channel.angle_latency]) - predicted
        share = T / (gains.d_filter_s + T)
        slope = x["slope"][0] + share * ((predicted - x["before"][0]) / T - x["slope"][0])
        command = gains.p * error - gains.d * slope
        if gains.i:
            integral = x["integral"][0] + gains.i * T * error
            command = command + integral
            self._keep("integral", integral)
        if self._lead:
            command = self._led(command)
        self._keep("slope", slope)
        self._keep("before", predicted)
        self._fly(command)
        self._believe(command)
        self._shift("sent", command)
        return np.asarray(command)

    def _led(self, wanted: Array) -> Array:
        assert self._lead is not None
        over, under = self._lead
        A, B, C = _companion(over[1:] - over[0] * under[1:], under)
        state = self._x["lead"]
        self._keep("lead", A @ state + np.outer(B, wanted))
        return np.asarray(C @ state + over[0] * wanted)

    def _fly(self, command: Array) -> None:
        """The plant over the step."""
        channel, plant, x, T = self.channel, self._plant, self._x, self.channel.step
        acting = self._ago(command, self._late) + self._w
        entering = acting[None, :]
        if self._between:
            entering = np.vstack([acting, self._ago(command, self._late + 1) + x["loaded"][0]])
            self._keep("loaded", self._w)
        state = plant.A @ x["plant"] + plant.B @ entering
        self._keep("plant", state)
        force, before = plant.C @ state, x["rate"][0]
        if channel.identified is None:
            (now, late, later), pole = channel.turning
            acting = now * force + late * x["force"][0] + later * x["force"][1]
            rate = pole * before + channel.gain * T * acting
            self._shift("force", force)
            c = channel.gyro_pole
            self._shift("gyro", c * x["gyro"][0] + (1.0 - c) * rate)
        else:
            rate = force
        self._keep("rate", rate)
        self._shift("angle", x["angle"][0] + 0.5 * T * (before + rate))

    # ---- the predictor

    def _predictor_slots(self) -> None:
        name, model = self.tuning.controller, self.tuning.model
        if name not in CANDIDATES:
            raise InputError(f"controller {name!r}: {nearest(name, CANDIDATES)}")
        if name in ("smith", "filtered-smith"):
            self._now, self._then = cascade(model), part(model)
            self._slot("now", len(self._now[0]))
            self._slot("then", len(self._then.A))
            if name == "filtered-smith":
                over, under = robustness_filter(model, self.tuning.predictor.filter_s)
                self._filter = (np.array(over), np.array(under))
                self._slot("filter", len(under) - 1)
        elif name != "baseline":
            self._modal_slots(model, name == "state-disturbance")

    def _modal_slots(self, model: RateModel, disturbance: bool) -> None:
        modes = Modes(model)
        tuning = self.tuning.predictor
        bandwidth = tuning.disturbance_observer_rad_s if disturbance else tuning.model_observer_rad_s
        F, gain = modal_observer(modes, bandwidth, model.sample_time_s, disturbance)
        n = len(modes.poles)
        size = n + 1 if disturbance else n
        shares = np.zeros((size, 2), complex)
        shares[:n, 0] = modes.shares
        shares[:n, 1] = 1.0 - shares[:n, 0]
        seen, ahead = np.zeros(size, complex), np.zeros(size, complex)
        seen[:n], ahead[:n] = modes.residues, modes.ahead()
        if disturbance:
            ahead[n] = modes.gathered()
        entering = np.concatenate([shares, np.asarray(gain)[:, None]], axis=1)
        A, B, C = _real(F, entering, np.vstack([seen, ahead]))
        self._observer = (A, B[:, :2], B[:, 2], C[0], C[1])
        whole, f = modes.whole, modes.delay - modes.whole
        poles, residues = np.array(modes.poles), np.array(modes.residues)
        # newest first: one a whole step, then over the fraction
        on_the_way = [np.sum(residues * poles**j).real for j in range(whole)]
        part_of = np.array([f if p == 1.0 else (p**f - 1.0) / (p - 1.0) for p in modes.poles])
        on_the_way.append(np.sum(residues * poles**whole * part_of).real)
        self._on_the_way = np.array(on_the_way)
        self._slot("observer", size)

    def _predicted(self, measured: Array) -> Array:
        name, x = self.tuning.controller, self._x
        if name == "baseline":
            return measured
        if name in ("smith", "filtered-smith"):
            now = self._now[2] @ x["now"]
            off = measured - self._then.C @ x["then"]
            if name == "filtered-smith":
                over, under = self._filter
                A, B, C = _companion(over[1:] - over[0] * under[1:], under)
                self._keep("filter", A @ x["filter"] + np.outer(B, off))
                off = C @ x["filter"] + over[0] * off
            return np.asarray(now + off)
        A, B, gain, seen, ahead = self._observer
        sent, whole = x["sent"], len(self._on_the_way) - 1
        state = A @ x["observer"] + B @ sent[whole : whole + 2]
        state = state + np.outer(gain, measured - seen @ state)
        self._keep("observer", state)
        return np.asarray(ahead @ state + self._on_the_way @ sent[: whole + 1])

    def _believe(self, command: Array) -> None:
        """What the models inside a Smith predictor make of the command."""
        if self.tuning.controller not in ("smith", "filtered-smith"):
            return
        A, B, _ = self._now
        self._keep("now", A @ self._x["now"] + np.outer(B, command))
        then = self._then
        entering = [self._ago(command, then.delay + k) for k in range(then.B.shape[1])]
        self._keep("then", then.A @ self._x["then"] + then.B @ np.vstack(entering))

    # ---- in time

    def steps(self, samples: int) -> Steps:
        """The answers to a unit step of the set-point and of the load over so many samples.

        ``C A^(i + j m) B`` by doubling: powers up to ``m`` on the left, those of ``A^m`` on the right.
        """
        n = self._size
        # the inputs are states that stay what they are
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
        found = (rows.reshape(count * 2, n + 2) @ columns).reshape(count, 2, wide, 2)
        angle, command = found[:, 0], found[:, 1]
        # a load at the plant's input comes as late as a command; the transition has it act at once, with fewer states
        load = np.concatenate([np.zeros(self._late), angle[..., LOAD].T.ravel()])
        return Steps(
            angle[..., SETPOINT].T.ravel()[:samples], command[..., SETPOINT].T.ravel()[:samples], load[:samples]
        )
