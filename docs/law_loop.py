"""Any rate loop, closed around a channel step by step: its sensitivity, its errors and its noise, from its own answers.

A linear law needs to say nothing of itself.  It runs in the loop with the channel's exact difference equations, as it
flies, and impulses of the load, of the set-point and of the gyro's noise are answered.  A stable loop forgets them, so
their transforms are finite sums, exact to what is left at the end:

    S(z) = sum_k u_k z^-k,   u = load + command after an impulse of the load at the plant's input
    L = 1 / S - 1,           and with another delay of the plant L z^-e: the law is the same

A law that bends (limits, gains that fall with the error) is looked at around rest: the impulses are small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, exp, inf, log, pi

import numpy as np
from scipy.signal import lfilter

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.base.protocols import RateLoop
from cosim.base.signals import AXES, Vector3
from cosim.control.predictors.linear import cascade
from cosim.simulation.controllers.controller_file import STEP_RAD
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import WINDOW
from hexjet_design.loop.limit import tolerated_error
from hexjet_design.tune import SEED, UNSTABLE

SMALL = 1e-3  # rad, rad/s, and of the command: what the impulses are
FILTERS_S = (0.02, 0.1, 0.5)  # lags from which a set-point filter is searched, with half as much lead and with more
NO_OVERSHOOT = 0.005  # of a step: less is none
LOST = 1e3  # times the impulse: the loop runs away
DOUBLET = 2.0 * STEP_RAD  # its middle step, from one side to the other
HELD = 1000.0  # what the square of missing the peak sensitivity costs: it is then held to less than 1 %
FAR = 0.5  # square of missing it, beyond which nothing else is looked at
POPULATION, GENERATIONS, ROUNDS = 5, 24, 60  # of the search
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


@dataclass(frozen=True)
class SetpointFilter:
    """``(1 + lead s) / (1 + lag s)`` before a loop, held over a step, and the answer to a set-point behind it."""

    lead_s: float
    lag_s: float
    step_error: float  # as LawLoop has it
    overshoot: float
    step_peak: float

    @classmethod
    def of(cls, loop: LawLoop, lead_s: float, lag_s: float) -> SetpointFilter:
        """Return the filter with what the loop does behind it."""
        pole, ratio = exp(-loop.channel.step / lag_s), lead_s / lag_s
        numerator, denominator = [ratio, 1.0 - ratio - pole], [1.0, -pole]  # lead / lag at once, 1 at rest
        angle, command = (lfilter(numerator, denominator, each) for each in (loop.angle, loop.command))
        error = float(np.abs(1.0 - angle).sum()) * loop.channel.step
        return cls(lead_s, lag_s, error, max(0.0, float(angle.max()) - 1.0), float(np.abs(command).max()))

    @classmethod
    def best(cls, loop: LawLoop, room: float) -> SetpointFilter:
        """Return the one with the least step error that overshoots no more than the loop does without it.

        The steps of the roll doublet stay within ``room``, and the lag is a control step at least.
        """
        from scipy.optimize import minimize

        def cost(x: Array) -> float:
            each = cls.of(loop, *np.exp(x).tolist())
            missed = max(0.0, each.step_peak * DOUBLET / room - 1.0), max(0.0, each.overshoot / allowed - 1.0)
            short = max(0.0, log(loop.channel.step) - x[1])
            return log(each.step_error) + HELD * float(np.square([*missed, short]).sum())

        allowed = max(loop.overshoot, NO_OVERSHOOT)
        starts = [np.log([share * lag, lag]) for lag in FILTERS_S for share in (0.5, 1.5)]
        found = min((minimize(cost, x, method="Nelder-Mead") for x in starts), key=lambda each: float(each.fun))
        return cls.of(loop, *np.exp(found.x).tolist())


class LawLoop:
    """A channel closed with a rate law, as :class:`hexjet_design.loop.closed_loop.ClosedLoop` is with the built-in one.

    ``seconds``: how long impulses are followed; 0: as long as a design looks.  Raises ArithmeticError for a loop that
    runs away.
    """

    def __init__(self, channel: Channel, law: RateLoop, gain_1_s: float, seconds: float = 0.0) -> None:
        self.channel, self._law, self._gain = channel, law, gain_1_s
        self.samples = ceil((seconds or WINDOW * channel.slowness_s) / channel.step)
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

    def delays_within(self, peak: float, most: float) -> tuple[float, float]:
        """Errors of the delay, less and more, in quarters of a sample and up to ``most``, before the peak is higher.

        Beyond them the loop may still be stable: lobes of ``L`` that stay just below 1 make peaks and no poles.
        """
        less = tolerated_error(lambda error: self.with_delay(-error), peak, most)
        return -less, tolerated_error(self.with_delay, peak, most)

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

    # ---- in time

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

    def errors_within(self, seconds: float) -> tuple[float, float]:
        """Return :attr:`step_error` and :attr:`load_error` as integrated over the first ``seconds`` alone."""
        end = round(seconds / self.channel.step)
        step, load = np.abs(1.0 - self.angle[:end]), np.abs(np.cumsum(self._load.angle[:end]))
        return float(step.sum()) * self.channel.step, float(load.sum()) * self.channel.step

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


Loop = Callable[[Sequence[float]], LawLoop]


def both(loop: LawLoop) -> float:
    """``ln(step error) + ln(load error)``: a tenth of either counts alike.

    Grimholt and Skogestad, "Should we forget the Smith predictor?", IFAC PID 2018, take the mean of both integrated
    errors, each over its best; this is their geometric mean, which needs no best.
    """
    return log(loop.step_error) + log(loop.load_error)


def tune(
    loop: Loop,
    box: Sequence[tuple[float, float]],
    start: Sequence[float],
    sensitivity: float,
    noise: float,
    room: float,
) -> tuple[list[float], float]:
    """Parameters with the least of :func:`both` at a peak sensitivity, and that least.

    Differential evolution over the logarithms within ``box``, ``start`` among the first, then Nelder and Mead's
    simplex, with the peak sensitivity held at ``sensitivity``, ``noise`` of the command not exceeded, and the steps of
    the roll doublet within ``room``.  Deterministic.
    """
    from scipy.optimize import differential_evolution, minimize

    low, high = np.log(np.array(box, np.float64)).T

    def cost(x: Array) -> float:
        out = float(np.sum(np.maximum(x - high, 0.0) + np.maximum(low - x, 0.0)))
        try:
            candidate = loop([float(value) for value in np.exp(np.clip(x, low, high))])
            off = (candidate.peak_sensitivity / sensitivity - 1.0) ** 2
            if off > FAR:
                return float(UNSTABLE / 2.0 + off)
            off += (
                max(0.0, candidate.step_peak * DOUBLET / room - 1.0) ** 2 + max(0.0, candidate.noise / noise - 1.0) ** 2
            )
            return both(candidate) + HELD * off + out
        except (ArithmeticError, InputError, np.linalg.LinAlgError):
            return UNSTABLE

    x0 = np.clip(np.log(np.array(start, np.float64)), low, high)
    optimum = differential_evolution(
        cost, list(zip(low, high, strict=True)), popsize=POPULATION, maxiter=GENERATIONS, init="sobol", x0=x0,
        rng=np.random.default_rng(SEED), polish=False, tol=1e-4,
    )  # fmt: skip
    x = optimum.x
    for size in (0.1, 0.03):
        simplex = np.vstack([x, x + size * np.eye(len(x))])
        options = {"maxfev": ROUNDS, "xatol": 1e-4, "fatol": 1e-5, "initial_simplex": simplex}
        x = minimize(cost, x, method="Nelder-Mead", options=options).x
    return [float(value) for value in np.exp(np.clip(x, low, high))], cost(x)
