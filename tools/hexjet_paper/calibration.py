"""What the paper does not print, found from a few of the numbers that it does, and frozen.

Three stages, each with few unknowns and the printed numbers that hold them; what no printed number holds is chosen by
us and says so.  ``calibration.toml`` beside this file is the result; :func:`calibrate` makes it again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

from hexjet_paper import numbers
from hexjet_paper.experiments import Experiment, hexjet_ratios, linear, linear_run, quadrotor_axis
from hexjet_paper.frozen import FILE, Calibration, FittedNumber, Frozen
from hexjet_paper.linear import STATE_AS_PRINTED
from hexjet_paper.loops import LOW_END_HZ, gain_at, margins, open_loop, unstable_poles
from hexjet_paper.readings import DELAY_ONLY, READINGS, Reading, doublet_of, gain_pairs, reading_axis

START = Calibration(  # starting point of the fit
    p=0.05,
    i=0.08,
    d=0.0,
    attitude_gain_1_s=8.0,
    disturbance_each_s=0.12,
    observer_rad_s=200.0,
    payload_gain=1.1,
    hexjet_p=0.0175,
    hexjet_attitude_gain_1_s=3.5,
    corrected_p=0.0068,
    corrected_attitude_gain_1_s=0.86,
)


def _compute_margins(trial: Calibration) -> dict[str, float]:
    """Return the quadrotor's cut-off, margins and gain at the low end, of the baseline with 5 samples."""
    loop = quadrotor_axis(trial, "baseline", 5)
    loop_margins = margins(open_loop(loop), loop.step, points=800)
    prefix = "frequency.baseline."
    return {
        prefix + "cutoff": loop_margins.cutoff or 0.0,
        prefix + "phase_margin": loop_margins.phase_margin or 0.0,
        prefix + "gain_margin": loop_margins.gain_margin or 0.0,
        "frequency.dc_gain": gain_at(loop, LOW_END_HZ),
    }


def _compute_quadrotor_numbers(trial: Calibration) -> dict[str, float]:
    """Return the time constant, mean of baseline and Smith, and the errors under a disturbance with 5 samples.

    The state predictor runs with the matrices as printed: they are what the paper says it used.
    """
    run = linear(trial, noisy=False, is_whole=False)
    times = [run(Experiment("step", c, 5)).metrics.time_constant_s or 1.0 for c in ("baseline", "smith")]
    values = {"step.time_constant": sum(times) / len(times)}
    for printed, controller, payload in (
        ("disturbance-5.baseline", "baseline", False),
        ("disturbance-5.smith", "smith", False),
        ("disturbance-5.state", STATE_AS_PRINTED, False),
        ("disturbance-5-payload.state", STATE_AS_PRINTED, True),
    ):
        metrics = run(Experiment("disturbance", controller, 5, payload=payload)).metrics
        values |= {f"{printed}.rmse": metrics.rmse, f"{printed}.max": metrics.max}
    return values


def _compute_hexjet_ratios(trial: Calibration) -> dict[str, float]:
    return _compute_ratios(trial, DELAY_ONLY)


def _compute_corrected_ratios(trial: Calibration) -> dict[str, float]:
    return _compute_ratios(trial, READINGS["corrected"])


def _compute_ratios(trial: Calibration, reading: Reading) -> dict[str, float]:
    """Return both Hex-Jet ratios [%]; 0 for an unstable baseline, which has neither overshoot nor settling time."""
    gains = next(pair for pair in gain_pairs(reading, trial) if pair.name == "fitted")
    loops = {c: reading_axis(reading, gains, c, trial, noisy=False) for c in ("baseline", "smith")}
    if unstable_poles(loops["baseline"]):
        return {"hexjet.less_overshoot": 0.0, "hexjet.faster_settling": 0.0}
    a, b = (linear_run(doublet_of(reading, gains, c), loop, trial, is_whole=False).metrics for c, loop in loops.items())
    return hexjet_ratios(a.overshoot_percent, b.overshoot_percent, a.settling_s, b.settling_s)


class Stage(NamedTuple):
    """One stage of the fit: unknowns with their bounds, and the printed numbers with the scale of each residual."""

    name: str
    unknowns: dict[str, tuple[float, float]]
    answers: Callable[[Calibration], dict[str, float]]
    targets: dict[str, float]

    def cost(self, trial: Calibration) -> float:
        """Return the sum of the squared, scaled residuals of a trial."""
        values = self.answers(trial)
        return sum(((values[key] - numbers.value(key)) / scale) ** 2 for key, scale in self.targets.items())


# Stages of the fit in order. Scales of residuals are chosen by us: 2 % of the cut-off, 10 % of phase margin and table,
# more of the gain margin, where a sweep is weakest, and of the gain at the low end, printed as "approximately".
STAGES: list[Stage] = [
    Stage(
        "rate gains",
        {"p": (0.02, 0.12), "i": (0.0, 1.0), "d": (0.0, 0.002)},
        _compute_margins,
        {
            "frequency.baseline.cutoff": 0.1,
            "frequency.baseline.phase_margin": 2.3,
            "frequency.baseline.gain_margin": 1.0,
            "frequency.dc_gain": 2.0,
        },
    ),
    Stage(
        "attitude gain, disturbance, observer, payload",
        {
            "attitude_gain_1_s": (5.0, 9.5),
            "disturbance_each_s": (0.05, 0.2),
            "observer_rad_s": (100.0, 1500.0),
            "payload_gain": (0.7, 1.4),
        },
        _compute_quadrotor_numbers,
        {
            "step.time_constant": 0.012,
            "disturbance-5.baseline.rmse": 0.15,
            "disturbance-5.baseline.max": 0.7,
            "disturbance-5.smith.rmse": 0.095,
            "disturbance-5.smith.max": 0.47,
            "disturbance-5.state.rmse": 0.1,
            "disturbance-5.state.max": 0.6,
            "disturbance-5-payload.state.rmse": 0.13,
            "disturbance-5-payload.state.max": 0.72,
        },
    ),
    Stage(
        "Hex-Jet gains",
        {"hexjet_p": (0.014, 0.0195), "hexjet_attitude_gain_1_s": (2.3, 3.2)},
        _compute_hexjet_ratios,
        {"hexjet.less_overshoot": 4.0, "hexjet.faster_settling": 6.0},
    ),
    Stage(
        "Hex-Jet gains, turbojet's dynamics in the plant",
        {"corrected_p": (0.004, 0.01), "corrected_attitude_gain_1_s": (0.5, 1.2)},
        _compute_corrected_ratios,
        {"hexjet.less_overshoot": 4.0, "hexjet.faster_settling": 6.0},
    ),
]


def calibrate(start: Calibration = START, say: Callable[[str], None] = lambda line: None) -> Frozen:
    """Fit all stages in order and return the calibration; deterministic, about a minute.

    Parameters are rounded to four digits, the doublet's length to whole steps, so that the file is complete.
    """
    parameters = start
    used: list[FittedNumber] = []
    for stage in STAGES:
        say(stage.name)
        parameters = _fit_stage(stage, parameters)
        values = stage.answers(parameters)
        used += [
            FittedNumber(key=key, paper=numbers.value(key), ours=_digits(values[key], 6), scale=scale, stage=stage.name)
            for key, scale in stage.targets.items()
        ]
    return Frozen(parameters=parameters, used=used)


def _fit_stage(stage: Stage, base: Calibration) -> Calibration:
    """Fit a stage from points spread over the bounds, then by Nelder and Mead from the best three (scipy.optimize)."""
    from scipy.optimize import minimize

    keys = list(stage.unknowns)
    low, high = (np.array([bounds[n] for bounds in stage.unknowns.values()]) for n in (0, 1))

    def make_trial(x: Sequence[float]) -> Calibration:
        values = (low + np.clip(np.asarray(x), 0.0, 1.0) * (high - low)).tolist()
        return base.model_copy(update=dict(zip(keys, values, strict=True)))

    def cost(x: Sequence[float]) -> float:
        outside = float(np.sum(np.maximum(0.0, np.abs(np.asarray(x) - 0.5) - 0.5)))
        return stage.cost(make_trial(x)) + 100.0 * outside

    ends = []
    for point in sorted(_spread_points(len(keys)), key=cost)[:3]:
        corners = [point, *([v + (0.07 if n == m else 0.0) for n, v in enumerate(point)] for m in range(len(keys)))]
        options = {"initial_simplex": corners, "xatol": 1e-4, "fatol": 1e-5, "maxiter": 250}
        ends.append(minimize(cost, point, method="Nelder-Mead", options=options))
    return _round_parameters(make_trial(min(ends, key=lambda end: float(end.fun)).x), keys)


def _spread_points(unknowns: int, count: int = 300) -> list[list[float]]:
    """Return Halton's points in the unit cube, which are evenly spread and always the same."""

    def radical_inverse(n: int, base: int) -> float:
        value, digit_weight = 0.0, 1.0 / base
        while n:
            n, digit = divmod(n, base)
            value += digit * digit_weight
            digit_weight /= base
        return value

    return [[radical_inverse(n, base) for base in (2, 3, 5, 7)[:unknowns]] for n in range(1, count + 1)]


def _round_parameters(calibration: Calibration, keys: list[str]) -> Calibration:
    step = 1.0 / numbers.value("quadrotor.rate")
    values = {key: _digits(getattr(calibration, key), 4) for key in keys}
    if "disturbance_each_s" in values:
        values["disturbance_each_s"] = round(round(values["disturbance_each_s"] / step) * step, 6)
    return calibration.model_copy(update=values)


def _digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def write(frozen: Frozen, path: Path = FILE) -> None:
    """Write a frozen calibration as TOML."""
    head = "# Made by hexjet_paper.calibration.calibrate(); do not edit.  Units are in the class Calibration.\n\n"
    path.write_text(head + tomli_w.dumps(frozen.model_dump()), encoding="utf-8")
