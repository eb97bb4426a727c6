"""Any rate loop, closed around a channel step by step: its sensitivity, its errors and its noise, from its own answers.

A linear law needs to say nothing of itself.  It runs in the loop with the channel's exact difference equations, as it
flies, and impulses of the load, of the set-point and of the gyro's noise are answered.  A stable loop forgets them, so
their transforms are finite sums, exact to what is left at the end:

    S(z) = sum_k u_k z^-k,   u = load + command after an impulse of the load at the plant's input
    L = 1 / S - 1,           and with another delay of the plant L z^-e: the law is the same

A law that bends (limits, gains that fall with the error) is looked at around rest: the impulses are small.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf, pi

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.base.protocols import RateLoop
from cosim.base.signals import AXES, Vector3
from cosim.control.predictors.linear import cascade
from cosim.engine import load_engine
from cosim.spec.scenario import Scenario
from hexjet_design import design as make
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels
from hexjet_design.loop.closed_loop import WINDOW_TIME_SCALES

SMALL = 1e-3  # rad, rad/s, and of the command: what the impulses are
LOST = 1e3  # times the impulse: the loop runs away
POINTS = 1 << 16  # of the upper half of the unit circle


def _alone(value: float, index: int) -> Vector3:
    """A vector with one number in it."""
    return (value if index == 0 else 0.0, value if index == 1 else 0.0, value if index == 2 else 0.0)


@dataclass(frozen=True)
class Record:
    """Sample by sample: what acts on the plant's input, and the angle."""

    command: Array
    angle: Array


def run(channel: Channel, law: RateLoop, gain_1_s: float, samples: int, setpoint: float = 0.0, load: float = 0.0,
        noise: float = 0.0) -> Record:  # fmt: skip
    """The loop after impulses at step 0, closed by an attitude loop of ``gain_1_s`` around the rate loop.

    Raises InputError for a channel that has no difference equation of whole steps.
    """
    model = channel.actuator.model
    late = int(model.delay_samples) + channel.added_delay
    if channel.identified is not None or model.delay_samples != int(model.delay_samples) or channel.rate_hold != 1:
        raise InputError(f"{channel.name}: a loop step by step needs an engine's delay of whole steps")
    a, b, c = (part.tolist() for part in cascade(model))
    order = range(len(b))
    (now, before, earlier), pole = channel.rate_dynamics
    push, smooth, T = channel.gain * channel.step, channel.gyro_pole, channel.step
    index = AXES.index(channel.name)
    sent = [0.0] * late
    x = [0.0] * len(b)
    force0 = force1 = rate = 0.0
    gyro, angle = [0.0] * (channel.rate_latency + 1), [0.0] * (channel.angle_latency + 1)
    commands, angles = np.zeros(samples), np.zeros(samples)
    asked: Vector3 = (0.0, 0.0, 0.0)
    law.reset()
    for k in range(samples):
        angles[k] = angle[0]
        rate_setpoint = _alone(gain_1_s * (setpoint - angle[-1]), index)
        asked = law.update(rate_setpoint, _alone(gyro[-1], index), asked)
        acting = asked[index] + load
        setpoint = load = 0.0
        commands[k] = acting
        if not abs(acting) < LOST * SMALL:
            raise ArithmeticError("the loop is unstable")
        sent.append(acting)
        entering = sent.pop(0)
        x = [sum([a[i][j] * x[j] for j in order]) + b[i] * entering for i in order]
        force = sum([c[i] * x[i] for i in order])
        last = rate
        rate = pole * rate + push * (now * force + before * force0 + earlier * force1)
        force0, force1 = force, force0
        gyro = [smooth * gyro[0] + (1.0 - smooth) * (rate + noise), *gyro[:-1]]
        noise = 0.0
        angle = [angle[0] + 0.5 * T * (last + rate), *angle[:-1]]
    return Record(commands, angles)


class LawLoop:
    """A channel closed with a rate law, as :class:`hexjet_design.loop.closed_loop.ClosedLoop` is with the built-in one.

    ``seconds``: how long impulses are followed; 0: as long as a design looks.  Raises ArithmeticError for a loop that
    runs away.
    """

    def __init__(self, channel: Channel, law: RateLoop, gain_1_s: float, seconds: float = 0.0) -> None:
        self.channel, self._law, self._gain = channel, law, gain_1_s
        self.samples = ceil((seconds or WINDOW_TIME_SCALES * channel.slowness_s) / channel.step)
        self._load = self._run(load=SMALL)

    def _run(self, **impulse: float) -> Record:
        response = run(self.channel, self._law, self._gain, self.samples, **impulse)
        return Record(response.command / SMALL, response.angle / SMALL)

    @cached_property
    def _set(self) -> Record:
        return self._run(setpoint=SMALL)

    @cached_property
    def theta(self) -> Array:
        """Points of the upper half of the unit circle, rad per sample."""
        return np.linspace(0.0, pi, POINTS + 1)

    @cached_property
    def sensitivity(self) -> Complex:
        """``S`` at :attr:`theta`."""
        return np.asarray(np.fft.rfft(self._load.command, 2 * POINTS))

    @property
    def peak_sensitivity(self) -> float:
        """``max |S|``."""
        return float(np.abs(self.sensitivity).max())

    @cached_property
    def open_loop(self) -> Complex:
        """``L`` at :attr:`theta`, without 0, where an integrator has none."""
        return np.asarray(1.0 / self.sensitivity[1:] - 1.0)

    def with_delay(self, samples: float) -> float | None:
        """Peak sensitivity with so many samples more of delay in the plant; None where that is unstable."""
        low, high = self.delay_margins
        if not low < samples < high:
            return None
        return float(np.abs(1.0 / (1.0 + self.open_loop * np.exp(-1j * self.theta[1:] * samples))).max())

    @cached_property
    def delay_margins(self) -> tuple[float, float]:
        """The delays less and more, in samples, at which a pole comes to the unit circle.

        Where ``|L| = 1`` at an angle ``theta``: ``arg(-1 / L) = -theta e``, the nearest either way.
        """
        size, angle = np.abs(self.open_loop), np.angle(-self.open_loop)
        less, more = -inf, inf
        for k in np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) <= 0.0):
            share = (1.0 - size[k]) / (size[k + 1] - size[k]) if size[k + 1] != size[k] else 0.0
            theta = self.theta[1 + k] + share * (self.theta[2 + k] - self.theta[1 + k])
            turn = angle[k + 1] - angle[k]
            at = angle[k] + share * (turn - 2.0 * pi * round(turn / (2.0 * pi)))
            at = at % (2.0 * pi)
            more, less = min(more, at / theta), max(less, (at - 2.0 * pi) / theta)
        return float(less), float(more)

    @property
    def gain_margins(self) -> tuple[float, float]:
        """Gains of the plant, as factors, between which the loop stays stable; 0 and infinite where there is no end."""
        L = self.open_loop
        low, high = 0.0, inf
        for k in np.flatnonzero(np.sign(L.imag[:-1]) != np.sign(L.imag[1:])):
            share = L.imag[k] / (L.imag[k] - L.imag[k + 1])
            real = float(L.real[k] + share * (L.real[k + 1] - L.real[k]))
            if real < 0.0:
                factor = -1.0 / real
                low, high = (max(low, factor), high) if factor < 1.0 else (low, min(high, factor))
        return low, high

    @property
    def angle(self) -> Array:
        """Of a unit step of the set-point, rad per rad."""
        return np.cumsum(self._set.angle)

    @property
    def command(self) -> Array:
        """The command after a unit step of the set-point."""
        return np.cumsum(self._set.command)

    @property
    def step_error(self) -> float:
        """Integrated absolute error after it, rad s per rad."""
        return float(np.abs(1.0 - self.angle).sum()) * self.channel.step

    @property
    def overshoot(self) -> float:
        """Share of a step by which the angle goes beyond it."""
        return max(0.0, float(self.angle.max()) - 1.0)

    @property
    def load_error(self) -> float:
        """Integrated absolute error of the angle after a unit step of load, rad s per unit of the command."""
        return float(np.abs(np.cumsum(self._load.angle)).sum()) * self.channel.step

    @property
    def load_left(self) -> float:
        """Angle that a unit of load leaves, at the end of what is looked at."""
        return float(self._load.angle.sum())

    @property
    def step_peak(self) -> float:
        """Largest command that a unit step of the set-point asks for."""
        return float(np.abs(self.command).max())

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the command that the sensors' noise makes, in its unit: Parseval's sum."""
        of_gyro = float(np.square(self._run(noise=SMALL).command).sum())
        of_angle = float(np.square(self._set.command).sum())
        channel = self.channel
        return float(np.sqrt(channel.rate_noise**2 * of_gyro + channel.angle_noise**2 * of_angle))


def roll() -> Channel:
    """The roll axis of the Hex-Jet as flown."""
    scenario = Scenario.load("roll-doublet")
    vehicle, _ = scenario.resolved_vehicle()
    spec = load_engine(scenario.engine, scenario.engine_parameters, scenario.step_s)
    found = make.identify_hover(scenario, vehicle, spec, None)
    return channels(scenario, vehicle, spec, Actuator.of(spec.name, make.make_dynamics(found)))["roll"]
