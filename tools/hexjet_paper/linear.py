"""One axis of a vehicle as a linear plant, closed with the flight software's own blocks.

``attitude P -> rate PID (+ predictor) -> added delay -> plant -> gyro``: the rate loop, the predictors and the delay
line are those that fly (:mod:`cosim.control`); only the plant is a transfer function, so that a run takes
milliseconds and every claim can be compared with a computed one.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf

import numpy as np
from numpy.typing import NDArray

from cosim import InputError
from cosim.base.protocols import Predictor
from cosim.loops import (
    PREDICTORS,
    DelayedModel,
    DelayLine,
    DoubleIntegratorObserver,
    PredictorSpec,
    PredictorTuning,
    RateAxis,
    RateGains,
    RateModel,
    StateModel,
    StatePredictor,
    rate_model,
)
from hexjet_paper import numbers

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Response = Callable[[Complex], Complex]  # function of ``z``, upper unit circle
Pair = tuple[Complex, Complex]
PairResponse = Callable[[Complex], Pair]  # predictor: ``P_y``, ``P_u`` of ``z``
Signal = Callable[[int], float]
MAX_RATE = 1e6  # rad/s, above which a run ends

# Name of the state predictor with the printed matrices, which have 1/3660 of the plant's gain.
STATE_AS_PRINTED = "state-as-printed"


def nothing(k: int) -> float:
    """Return 0 at every step ``k``: the signal that is always zero."""
    return 0.0


def clamp(value: float, most: float) -> float:
    """Return ``value`` limited to ``-most`` and ``most``."""
    return most if value > most else (-most if value < -most else value)


@dataclass(frozen=True)
class Plant:
    """Plant behind the added delay: ``gain * G_n(z) z^-extra``, where ``extra`` need not be whole.

    ``model.delay_samples`` is not part of it: the added delay belongs to the loop.
    """

    model: RateModel
    gain: float = 1.0  # factor on the printed gain
    extra_samples: float = 0.0  # delay unknown to the predictor


@dataclass(frozen=True)
class Axis:
    """All parameters of one attitude and rate loop on the linear plant.

    ``model`` is the predictor's, its ``delay_samples`` included; ``delay_samples`` is the delay that is really
    added.  ``knows_disturbance`` says on which side of the predictor's tap a disturbance of the command enters.
    """

    plant: Plant
    model: RateModel
    delay_samples: int
    controller: str
    gains: RateGains
    attitude_gain: float  # 1/s; 0: rate loop alone
    tuning: PredictorTuning
    rate_limit: float = inf  # rad/s, limit of the attitude loop
    command_limit: float = inf  # limit of the command, either way
    noise: float = 0.0  # rad/s, gyro, one standard deviation
    seed: int = 1
    knows_disturbance: bool = False

    @property
    def step(self) -> float:
        """Control step [s]."""
        return self.model.sample_time_s

    def with_delay(self, samples: int) -> Axis:
        """Return the loop with another added delay [samples], which the predictor knows."""
        model = self.model.model_copy(update={"delay_samples": float(samples)})
        return replace(self, delay_samples=samples, model=model)


@dataclass
class Record:
    """Signals of a run, one value per step at ``t_k``: rad, rad/s, and the command of the step."""

    step: float
    setpoint: array[float] = field(default_factory=lambda: array("d"))
    angle: array[float] = field(default_factory=lambda: array("d"))
    rate_setpoint: array[float] = field(default_factory=lambda: array("d"))
    rate: array[float] = field(default_factory=lambda: array("d"))
    predicted: array[float] = field(default_factory=lambda: array("d"))
    command: array[float] = field(default_factory=lambda: array("d"))
    disturbance: array[float] = field(default_factory=lambda: array("d"))


def _make_printed_predictor(model: RateModel, parameters: Mapping[str, float]) -> Predictor:
    observer = DoubleIntegratorObserver(parameters["observer_rad_s"], model.sample_time_s)
    state = StateModel(model)
    state.A, state.B = np.array(numbers.A_D), np.array(numbers.B_D)
    return StatePredictor(model, observer, state)


def predictor(controller: str) -> PredictorSpec:
    """Return a predictor's specification by name, also the paper's state predictor with its printed matrices.

    Raises InputError for an unknown name.
    """
    if controller == STATE_AS_PRINTED:
        return replace(PREDICTORS["state"], name=STATE_AS_PRINTED, make=_make_printed_predictor)
    if controller not in PREDICTORS:
        raise InputError(f"unknown controller {controller!r}; allowed: {', '.join([*PREDICTORS, STATE_AS_PRINTED])}")
    return PREDICTORS[controller]


class _DisturbanceInformedPredictor:
    """Predictor that gets the command with its disturbance, as if its tap lay behind the disturbance."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor
        self.added = 0.0

    def reset(self) -> None:
        self._predictor.reset()
        self.added = 0.0

    def update(self, measured: float, applied: float) -> float:
        return self._predictor.update(measured, applied + self.added)


def simulate(
    axis: Axis,
    steps: int,
    setpoint: Signal = nothing,
    disturbance: Signal = nothing,
    rate_setpoint: Signal = nothing,
) -> Record:
    """Run the loop from rest and return its signals.

    ``setpoint``: attitude [rad]; ``disturbance`` is added to the command, ``rate_setpoint`` [rad/s] to the rate's.
    ``r_k = limit(K (phi_sp - phi_k)) + r_added``; ``u_k`` from :class:`cosim.control.rate.RateAxis`;
    ``y_k+1 = plant(z^-d (u_k + w_k))``; ``phi_k+1 = phi_k + T/2 (y_k + y_k+1)``; the gyro adds white noise to ``y``.
    The run ends early once the rate exceeds :data:`MAX_RATE`.
    """
    tap = _DisturbanceInformedPredictor(predictor(axis.controller).predictor(axis.model, axis.tuning))
    rate_loop = RateAxis(axis.gains, tap, axis.step)
    line = DelayLine(axis.delay_samples)
    plant = _make_plant_update(axis.plant)
    noise = _draw_noise(axis.seed, steps)
    gain, limit, most, sigma = axis.plant.gain, axis.rate_limit, axis.command_limit, axis.noise
    k_att, half, knows = axis.attitude_gain, 0.5 * axis.step, axis.knows_disturbance
    record = Record(axis.step)
    angle = rate = refused = 0.0
    for k in range(steps):
        command = setpoint(k)
        r = k_att * (command - angle)
        r = clamp(r, limit) + rate_setpoint(k)
        demand = rate_loop.update(r, rate + sigma * noise[k], refused)
        u = clamp(demand, most)
        refused = demand - u
        w = disturbance(k)
        record.setpoint.append(command)
        record.angle.append(angle)
        record.rate_setpoint.append(r)
        record.rate.append(rate)
        record.predicted.append(rate_loop.predicted)
        record.command.append(u)
        record.disturbance.append(w)
        if knows:
            tap.added = w
        after = plant(line.update(u + w)) * gain
        angle += half * (rate + after)
        rate = after
        if not -MAX_RATE < rate < MAX_RATE:
            break
    return record


def _make_plant_update(plant: Plant) -> Callable[[float], float]:
    if not plant.extra_samples:
        return rate_model(plant.model).update
    return DelayedModel(plant.model.model_copy(update={"delay_samples": plant.extra_samples})).update


@lru_cache(maxsize=8)
def _draw_noise(seed: int, steps: int) -> list[float]:
    values: list[float] = np.random.default_rng(seed).standard_normal(steps).tolist()
    return values


def doublet(amplitude: float, start: float, width: float, step: float) -> Signal:
    """Return a signal of ``amplitude`` for ``width`` [s] from ``start`` [s], as long of its negative, then 0.

    A step with an edge inside has its mean value, so that the integral is right for any length.
    """
    edges = [t / step for t in (start, start + width, start + 2.0 * width)]

    def is_after(edge: float, k: int) -> float:
        # This is the fraction of step k after the edge; 1e-9 is for lengths that are no binary fractions.
        part = k + 1.0 - edge
        return 0.0 if part < 1e-9 else (1.0 if part > 1.0 - 1e-9 else part)

    return lambda k: amplitude * (is_after(edges[0], k) - 2.0 * is_after(edges[1], k) + is_after(edges[2], k))
