"""What the paper does not print, found from a few of the numbers that it does, and frozen.

Six stages, each with few unknowns and the printed numbers that hold them; what no printed number holds is chosen by us
and says so.  ``calibration.toml`` beside this file is the result; :func:`calibrate` makes it again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from cosim.config import Model, read_toml, validate
from cosim.paper import numbers

FILE = Path(__file__).with_name("calibration.toml")


class Calibration(BaseModel):
    """The unknowns of the paper."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # quadrotor, found
    p: float  # command per rad/s
    i: float  # command per rad
    d: float  # command per rad/s^2
    attitude_gain_1_s: float
    disturbance_each_s: float  # length of either half of the disturbance doublet
    observer_rad_s: float  # both poles of the double-integrator observer
    payload_gain: float  # of the plant's gain, with 230 g more
    # Hex-Jet, found; rate integral in proportion to vehicle.toml
    hexjet_p: float
    hexjet_attitude_gain_1_s: float
    # chosen
    predictor_sees_disturbance: bool = True  # it enters before the predictor's tap; see the claims
    extra_delay_samples: float = 0.0  # nothing printed asks for any that it could be told from d
    d_filter_s: float = 0.0053  # PX4's 30 Hz
    gyro_noise_rad_s: float = 0.02  # small MEMS gyro at 400 Hz; no printed number tells it
    filter_s: float = 0.05  # filtered Smith
    model_observer_rad_s: float = 60.0
    disturbance_observer_rad_s: float = 40.0


class Used(Model):
    """A printed number that the calibration was fitted to, and what came of it."""

    key: str
    paper: float
    ours: float
    scale: float  # the residual is (ours - paper) / scale
    stage: str


class Frozen(Model):
    """The file: unknowns, the numbers that were used, and how they were met."""

    parameters: Calibration
    used: list[Used]


START = Calibration(
    p=0.05,
    i=0.08,
    d=0.0,
    attitude_gain_1_s=8.0,
    disturbance_each_s=0.12,
    observer_rad_s=200.0,
    payload_gain=1.1,
    hexjet_p=0.0175,
    hexjet_attitude_gain_1_s=3.5,
)

Answers = Callable[[Calibration], dict[str, float]]


def load(path: Path = FILE) -> Frozen:
    """The frozen calibration.  Raises InputError for a file that does not fit."""
    return validate(Frozen, read_toml(path), str(path))


def _margins(trial: Calibration) -> dict[str, float]:
    from cosim.paper.experiments import quadrotor_axis
    from cosim.paper.claims import LOW_END_HZ, gain_at
    from cosim.paper.loops import margins, open_loop

    loop = quadrotor_axis(trial, "baseline", 5)
    found = margins(open_loop(loop), loop.step, points=800)
    prefix = "frequency.baseline."
    return {
        prefix + "cutoff": found.cutoff or 0.0,
        prefix + "phase_margin": found.phase_margin or 0.0,
        prefix + "gain_margin": found.gain_margin or 0.0,
        "frequency.dc_gain": gain_at(loop, LOW_END_HZ),
    }


def _time_constant(trial: Calibration) -> dict[str, float]:
    """The mean of baseline and Smith: the paper gives one number for all controllers."""
    from cosim.paper.experiments import Experiment, linear

    run = linear(trial, noisy=False)
    times = [
        run(Experiment("step", controller, 5)).metrics.time_constant_s or 1.0 for controller in ("baseline", "smith")
    ]
    return {"step.time_constant": sum(times) / len(times)}


def _disturbance(trial: Calibration, names: Iterable[tuple[str, str, bool]]) -> dict[str, float]:
    from cosim.paper.experiments import Experiment, linear

    run = linear(trial, noisy=False)
    found: dict[str, float] = {}
    for printed, controller, payload in names:
        metrics = run(Experiment("disturbance", controller, 5, payload=payload)).metrics
        found |= {f"{printed}.rmse": metrics.rmse, f"{printed}.max": metrics.max}
    return found


def _hexjet(trial: Calibration) -> dict[str, float]:
    from cosim.paper.experiments import Experiment, linear

    run = linear(trial, noisy=False)
    a, b = (
        run(Experiment("hexjet-doublet", controller, 25, gains="calibrated")).metrics
        for controller in ("baseline", "smith")
    )
    return hexjet_ratios(a.overshoot_percent, b.overshoot_percent, a.settling_s, b.settling_s)


def hexjet_ratios(
    overshoot: float | None, smith_overshoot: float | None, settling: float | None, smith_settling: float | None
) -> dict[str, float]:
    """How much less overshoot and how much faster settling Smith's predictor gives, in percent."""
    less = 100.0 * (1.0 - (smith_overshoot or 0.0) / overshoot) if overshoot else 0.0
    faster = 100.0 * (1.0 - smith_settling / settling) if settling and smith_settling else 100.0
    return {"hexjet.less_overshoot": less, "hexjet.faster_settling": faster}


def _baseline(trial: Calibration) -> dict[str, float]:
    return _time_constant(trial) | _disturbance(trial, [("disturbance-5.baseline", "baseline", False)])


def _state(trial: Calibration) -> dict[str, float]:
    return _disturbance(trial, [("disturbance-5.state", "state-as-printed", False)])


def _payload(trial: Calibration) -> dict[str, float]:
    return _disturbance(trial, [("disturbance-5-payload.state", "state-as-printed", True)])


# stage, unknowns with their bounds and scale of search, and the numbers that are used with the scale of their residual
# (chosen by us: 2 % of the cut-off, 10 % of the phase margin; the gain margin lies where the sweep is weakest, and the
# gain at the low end is printed as "approximately" and without its frequency)
STAGES: list[tuple[str, dict[str, tuple[float, float]], Answers, dict[str, float]]] = [
    (
        "rate gains",
        {"p": (0.02, 0.12), "i": (0.0, 1.0), "d": (0.0, 0.002)},
        _margins,
        {
            "frequency.baseline.cutoff": 0.1,
            "frequency.baseline.phase_margin": 2.3,
            "frequency.baseline.gain_margin": 1.0,
            "frequency.dc_gain": 2.0,
        },
    ),
    (
        "attitude gain and length of the disturbance",
        {"attitude_gain_1_s": (4.0, 9.5), "disturbance_each_s": (0.05, 0.2)},
        _baseline,
        {"step.time_constant": 0.012, "disturbance-5.baseline.rmse": 0.15, "disturbance-5.baseline.max": 0.7},
    ),
    (
        "observer",
        {"observer_rad_s": (120.0, 2000.0)},
        _state,
        {"disturbance-5.state.rmse": 0.1, "disturbance-5.state.max": 0.6},
    ),
    (
        "payload",
        {"payload_gain": (0.5, 1.5)},
        _payload,
        {"disturbance-5-payload.state.rmse": 0.13, "disturbance-5-payload.state.max": 0.72},
    ),
    (
        "Hex-Jet gains",
        {"hexjet_p": (0.012, 0.0195), "hexjet_attitude_gain_1_s": (2.4, 4.0)},
        _hexjet,
        {"hexjet.less_overshoot": 4.0, "hexjet.faster_settling": 6.0},
    ),
]


def calibrate(start: Calibration = START, say: Callable[[str], None] = lambda line: None) -> Frozen:
    """Fit stage after stage: a grid over the bounds, then Nelder and Mead from its best point (scipy.optimize).

    Deterministic, about a minute.  Parameters are rounded to four digits, the doublet's length to whole steps, so
    that the file says all there is.
    """
    from scipy.optimize import minimize

    found = start
    used: list[Used] = []
    for stage, unknowns, model, targets in STAGES:
        say(stage)
        keys = list(unknowns)
        low = np.array([bounds[0] for bounds in unknowns.values()])
        span = np.array([bounds[1] for bounds in unknowns.values()]) - low

        def trial(x: Sequence[float], keys: list[str] = keys, base: Calibration = found) -> Calibration:
            values = low + np.clip(np.asarray(x), 0.0, 1.0) * span  # noqa: B023
            return base.model_copy(update=dict(zip(keys, (float(v) for v in values), strict=True)))

        def cost(x: Sequence[float]) -> float:
            answers = model(trial(x))  # noqa: B023
            outside = float(np.sum(np.maximum(0.0, np.abs(np.asarray(x) - 0.5) - 0.5)))
            return outside * 100.0 + sum(
                ((answers[key] - numbers.value(key)) / scale) ** 2
                for key, scale in targets.items()  # noqa: B023
            )

        per_axis = {1: 25, 2: 9, 3: 7}[len(keys)]
        points = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, per_axis)] * len(keys)), axis=-1).reshape(-1, len(keys))
        best = min(points.tolist(), key=cost)
        spread = 0.5 / per_axis
        corners = [best] + [[v + (spread if n == m else 0.0) for n, v in enumerate(best)] for m in range(len(keys))]
        options = {"initial_simplex": corners, "xatol": 1e-4, "fatol": 1e-5, "maxiter": 200}
        solution = minimize(cost, best, method="Nelder-Mead", options=options)
        found = _rounded(trial(solution.x), keys)
        answers = model(found)
        used += [
            Used(key=key, paper=numbers.value(key), ours=_digits(answers[key], 6), scale=scale, stage=stage)
            for key, scale in targets.items()
        ]
    return Frozen(parameters=found, used=used)


def _rounded(found: Calibration, keys: list[str]) -> Calibration:
    step = 1.0 / numbers.value("quadrotor.rate")
    values = {key: _digits(getattr(found, key), 4) for key in keys}
    if "disturbance_each_s" in values:
        values["disturbance_each_s"] = round(round(values["disturbance_each_s"] / step) * step, 6)
    return found.model_copy(update=values)


def _digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def write(frozen: Frozen, path: Path = FILE) -> None:
    """Freeze a calibration."""
    import tomli_w

    head = "# Made by cosim.paper.calibration.calibrate(); do not edit.  Units are in the class Calibration.\n\n"
    path.write_text(head + tomli_w.dumps(frozen.model_dump()), encoding="utf-8")
