"""The paper's experiments: what is commanded, on which loop, and what is read from the record.

An experiment is the same whatever flies it.  A *fidelity* is a function from an experiment to its result:
:func:`linear` here, the six-degree-of-freedom co-simulation beside it.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, radians
from typing import Literal

import numpy as np

from cosim import load_vehicle
from cosim.loops import PredictorTuning, RateGains, overshoot, settling_time
from hexjet_paper import numbers
from hexjet_paper.frozen import Calibration
from hexjet_paper.linear import STATE_AS_PRINTED, Array, Axis, Plant, Signal, doublet, nothing, simulate
from hexjet_paper.numbers import Record

Kind = Literal["step", "disturbance", "hexjet-doublet"]
Gains = Literal["calibrated", "vehicle"]

CONTROLLERS = ("baseline", "smith", "state", STATE_AS_PRINTED, "filtered-smith", "state-model", "state-disturbance")
COMPARED = ("baseline", "smith", "state", STATE_AS_PRINTED)  # the paper's controllers

# Length [s] of either half of the Hex-Jet's doublet, and of the run; the paper states neither. At the vehicle's gains
# as in scenario roll-doublet; at calibrated ones long enough for the baseline to settle, whose settling is printed.
HEXJET_LENGTHS: dict[Gains, tuple[float, float]] = {"vehicle": (3.0, 12.0), "calibrated": (6.0, 22.0)}
PAYLOAD_POSITION_M = [0.0, 0.0, 0.03]  # body, below the frame; chosen by us


@dataclass(frozen=True)
class Experiment:
    """One run of the paper; ``name`` is the key of its numbers in :data:`hexjet_paper.numbers.PRINTED`."""

    kind: Kind
    controller: str
    delay_samples: int
    payload: bool = False
    gains: Gains = "calibrated"  # which gains of the Hex-Jet
    unseen: bool = False  # disturbance unknown to the predictor
    stretch: float = 1.0  # factor on all lengths of time

    @property
    def name(self) -> str:
        if self.kind == "hexjet-doublet":
            return f"{self.kind}{'-calibrated' if self.gains == 'calibrated' else ''}.{self.controller}"
        condition = ("-payload" if self.payload else "") + ("-unseen" if self.unseen else "")
        return f"{self.kind}-{self.delay_samples}{condition}.{self.controller}"

    @property
    def step(self) -> float:
        """Control step [s]."""
        return numbers.value("hexjet.step") if self.kind == "hexjet-doublet" else 1.0 / numbers.value("quadrotor.rate")

    @property
    def start(self) -> float:
        """Time of the doublet's first edge [s]."""
        return 1.0 if self.kind == "hexjet-doublet" else numbers.value("step.start")

    def half_length(self, calibration: Calibration) -> float:
        """Return the length of either half of the doublet [s]."""
        if self.kind == "disturbance":
            return calibration.disturbance_each_s
        hexjet = self.kind == "hexjet-doublet"
        return self.stretch * HEXJET_LENGTHS[self.gains][0] if hexjet else numbers.value("step.each")

    @property
    def record(self) -> float:
        """Length of the evaluated record [s]."""
        return self.run if self.kind == "hexjet-doublet" else numbers.value("step.record")

    @property
    def run(self) -> float:
        """Length of the whole run [s]."""
        # The paper's record is 2 s; flying on to 6 s shows whether an oscillation grows.
        return self.stretch * HEXJET_LENGTHS[self.gains][1] if self.kind == "hexjet-doublet" else 6.0

    @property
    def amplitude(self) -> float:
        """Amplitude of the doublet: rad, or the command's unit for a disturbance."""
        if self.kind == "disturbance":
            return numbers.value("disturbance.amplitude")
        return radians(numbers.value("hexjet.amplitude" if self.kind == "hexjet-doublet" else "step.amplitude"))

    def signal(self, calibration: Calibration) -> Signal:
        """Return the doublet as a function of the control step's number."""
        return doublet(self.amplitude, self.start, self.half_length(calibration), self.step)


class Metrics(Record):
    """Metrics of a record: of the angle for commanded doublets, of the rate for disturbances."""

    stable: bool
    rmse: float  # rad or rad/s, over the record
    max: float  # rad or rad/s, largest error
    overshoot_percent: float | None = None  # largest of the three steps
    settling_s: float | None = None  # longest, to 5 %; None if one never does
    time_constant_s: float | None = None  # to 63.2 % of the first step
    late_rmse: float | None = None  # rad, from the set-point 20 samples ago


@dataclass(frozen=True)
class Result:
    """An experiment's metrics and time series with one value per step."""

    experiment: Experiment
    metrics: Metrics
    time: list[float]
    setpoint: list[float]  # rad
    angle: list[float]  # rad
    rate: list[float]  # rad/s
    command: list[float]


Fidelity = Callable[[Experiment], Result]


def experiments() -> list[Experiment]:
    """Return all single-axis experiments of the paper, and some more that explain them."""
    quadrotor: list[Experiment] = []
    for controller in CONTROLLERS:
        quadrotor += [Experiment("step", controller, delay) for delay in (5, 10, 25)]
        quadrotor += [Experiment("disturbance", controller, delay) for delay in (5, 10)]
        quadrotor += [Experiment("step", controller, delay, payload=True) for delay in (5, 10)]
        quadrotor += [Experiment("disturbance", controller, 5, payload=True)]
        quadrotor += [Experiment("disturbance", controller, delay, unseen=True) for delay in (5, 10)]
    hexjet = [
        Experiment("hexjet-doublet", controller, 25, gains=gains)
        for gains in ("vehicle", "calibrated")
        for controller in ("baseline", "smith", "filtered-smith")
    ]
    return quadrotor + hexjet


def axis(experiment: Experiment, calibration: Calibration, noisy: bool = True) -> Axis:
    """Return the loop of an experiment on the linear plant."""
    if experiment.kind == "hexjet-doublet":
        return hexjet_axis(calibration, experiment.controller, experiment.gains, noisy)
    loop = quadrotor_axis(calibration, experiment.controller, experiment.delay_samples, noisy)
    if experiment.payload:
        loop = replace(loop, plant=replace(loop.plant, gain=calibration.payload_gain))
    return replace(loop, knows_disturbance=False) if experiment.unseen else loop


def quadrotor_axis(calibration: Calibration, controller: str, delay: int, noisy: bool = True) -> Axis:
    """Return the quadrotor's roll loop at the calibrated gains."""
    model = numbers.quadrotor_model(float(delay))
    return Axis(
        plant=Plant(model),
        model=model,
        delay_samples=delay,
        controller=controller,
        gains=RateGains(
            p=calibration.p,
            i=calibration.i,
            d=calibration.d,
            d_filter_s=calibration.d_filter_s,
            integral_limit=1.0,
        ),
        attitude_gain=calibration.attitude_gain_1_s,
        tuning=PredictorTuning(
            filter_s=calibration.filter_s,
            observer_rad_s=calibration.observer_rad_s,
            model_observer_rad_s=calibration.model_observer_rad_s,
            disturbance_observer_rad_s=calibration.disturbance_observer_rad_s,
        ),
        command_limit=1.0,  # PX4's normalised torque
        noise=calibration.gyro_noise_rad_s if noisy else 0.0,
        knows_disturbance=calibration.predictor_sees_disturbance,
    )


def flight_payload_gain() -> float:
    """Return the factor by which the payload changes the plant's gain in flight: ``J_xx`` without over with it.

    ``J = J_0 + m M / (m + M) h^2``: two bodies a height ``h`` apart, about their common centre of gravity.
    """
    vehicle, _ = load_vehicle("quadrotor")
    payload, inertia = numbers.value("quadrotor.payload"), vehicle.inertia_kg_m2[0]
    shared = vehicle.mass_kg * payload / (vehicle.mass_kg + payload)
    return inertia / (inertia + shared * PAYLOAD_POSITION_M[2] ** 2)


def hexjet_axis(calibration: Calibration, controller: str, gains: Gains, noisy: bool = True) -> Axis:
    """Return the Hex-Jet's roll loop, at the gains of its ``vehicle.toml`` or those fitted to the printed ratios."""
    vehicle, _ = load_vehicle("hexjet")
    rate, attitude = vehicle.control.rate.roll, vehicle.control.attitude.gain_1_s[0]
    if gains == "calibrated":
        integral_ratio = rate.i / rate.p
        rate = rate.model_copy(update={"p": calibration.hexjet_p, "i": integral_ratio * calibration.hexjet_p})
        attitude = calibration.hexjet_attitude_gain_1_s
    model = numbers.roll_model()
    return Axis(
        plant=Plant(model),
        model=model,
        delay_samples=25,
        controller=controller,
        gains=rate,
        attitude_gain=attitude,
        tuning=vehicle.control.predictor,
        rate_limit=vehicle.control.attitude.rate_limit_rad_s[0],
        command_limit=0.5 * (vehicle.control.allocation.throttle_max - vehicle.control.allocation.throttle_min),
        noise=vehicle.sensors.gyro.noise_rad_s if noisy else 0.0,
    )


def linear(calibration: Calibration, noisy: bool = True, is_whole: bool = True) -> Fidelity:
    """Return a function that runs experiments on the linear plant; not ``is_whole``: the record only, no stability."""

    return lambda experiment: linear_run(experiment, axis(experiment, calibration, noisy), calibration, is_whole)


def linear_run(experiment: Experiment, loop: Axis, calibration: Calibration, is_whole: bool = True) -> Result:
    """Run an experiment on a given loop of the linear plant; ``is_whole`` as in :func:`linear`."""
    signal = experiment.signal(calibration)
    steps = round((experiment.run if is_whole else experiment.record) / experiment.step)
    disturbed = experiment.kind == "disturbance"
    record = simulate(
        loop,
        steps,
        setpoint=nothing if disturbed else signal,
        disturbance=signal if disturbed else nothing,
    )
    return result(experiment, calibration, record.setpoint, record.angle, record.rate, record.command)


def result(
    experiment: Experiment,
    calibration: Calibration,
    setpoint: Sequence[float] | array[float],
    angle: Sequence[float] | array[float],
    rate: Sequence[float] | array[float],
    command: Sequence[float] | array[float],
) -> Result:
    """Return metrics and series of a run from one value per step since its start [rad, rad/s].

    A run that ended before ``experiment.run`` counts as unstable.
    """
    step, width = experiment.step, experiment.half_length(calibration)
    reference, is_angle, is_rate = np.array(setpoint), np.array(angle), np.array(rate)
    rows = round(experiment.record / step)
    error = (is_rate if experiment.kind == "disturbance" else reference - is_angle)[:rows]
    is_whole = len(is_rate) >= round(experiment.run / step)
    settles = is_whole and not swings(is_rate, step, experiment.start + 2.0 * width, experiment.stretch)
    edges = [round((experiment.start + n * width) / step) for n in range(3)]
    commanded = experiment.kind != "disturbance" and len(error) == rows
    overshoots, times = _score_steps(reference[:rows], is_angle[:rows], edges, step) if commanded else ([], [])
    return Result(
        experiment,
        Metrics(
            stable=settles,
            rmse=float(np.sqrt(np.mean(np.square(error)))),
            max=float(np.max(np.abs(error))),
            overshoot_percent=max(overshoots) if overshoots else None,
            settling_s=max((t for t in times if t is not None), default=None) if None not in times else None,
            time_constant_s=_time_constant(is_angle, edges[0], edges[1], step) if commanded else None,
            late_rmse=_compute_late_rmse(reference[:rows], is_angle[:rows]) if commanded else None,
        ),
        time=[k * step for k in range(len(error))],
        setpoint=reference[:rows].tolist(),
        angle=is_angle[:rows].tolist(),
        rate=is_rate[:rows].tolist(),
        command=np.array(command)[:rows].tolist(),
    )


def swings(rate: Array, step: float, last_edge: float, window: float = 1.0) -> bool:
    """Return whether the rate still oscillates at the end as much as right after the last edge."""
    samples = round(window / step)
    after = round(last_edge / step)
    before, end = np.std(rate[after : after + samples]), np.std(rate[-samples:])
    # A standard deviation below 0.05 rad/s counts as noise.
    return not isfinite(float(end)) or bool(end > 0.05 and end > 0.9 * before)


def _score_steps(command: Array, angle: Array, edges: list[int], step: float) -> tuple[list[float], list[float | None]]:
    overshoots: list[float] = []
    times: list[float | None] = []
    for first, end in zip(edges, [*edges[1:], len(command)], strict=True):
        size = float(command[first] - command[first - 1])
        error = command[first:end] - angle[first:end]
        overshoots.append(overshoot(error, size) or 0.0)
        times.append(settling_time(error, size, step))
    return overshoots, times


def _compute_late_rmse(command: Array, angle: Array, samples: int = 20) -> float:
    late = np.concatenate([np.full(samples, angle[0]), angle[:-samples]])
    return float(np.sqrt(np.mean(np.square(command - late))))


def _time_constant(angle: Array, first: int, end: int, step: float) -> float | None:
    """Return the time from the first edge to 63.2 % of its step [s], interpolated; None if not reached."""
    size = radians(numbers.value("step.amplitude")) if step == 1.0 / numbers.value("quadrotor.rate") else inf
    level = (1.0 - float(np.exp(-1.0))) * size
    past = np.flatnonzero(angle[first:end] >= level)
    if not past.size or past[0] == 0:
        return None
    k = first + int(past[0])
    fraction = (level - angle[k - 1]) / (angle[k] - angle[k - 1])
    return float((k - 1 - first + fraction) * step)


def hexjet_ratios(
    overshoot: float | None, smith_overshoot: float | None, settling: float | None, smith_settling: float | None
) -> dict[str, float]:
    """Return how much less overshoot, and how much faster settling, Smith's predictor gives [%]."""
    less = 100.0 * (1.0 - (smith_overshoot or 0.0) / overshoot) if overshoot else 0.0
    # If the baseline has not settled by the next edge, there is no ratio.
    faster = 100.0 * (1.0 - smith_settling / settling) if settling and smith_settling else 0.0
    return {"hexjet.less_overshoot": less, "hexjet.faster_settling": faster}
