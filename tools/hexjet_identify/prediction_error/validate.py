"""A model flown with the command of a log, beside what happened."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import floor, inf, log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.api.call import FolderResult, Table, note_lines
from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.base.storage.files import one_line, read_json, write_files
from cosim.identify.page import Signals, draw_signals, judged_page
from cosim.identify.sweep.fit import Model as Continuous
from cosim.identify.sweep.result import MAX_MISFIT
from cosim.identify.verdict import NOT_EXPLAINED, NOT_TOLD, Judgement, judge_model, shared_record
from cosim.pages import Card, Page
from cosim.spec.vehicle import read_models
from hexjet_identify.engine_file import DEVIATIONS_95
from hexjet_identify.fit.estimate import estimate_at, solve
from hexjet_identify.fit.forms import Poles
from hexjet_identify.fit.problem import Problem
from hexjet_identify.logs import FlightLog, LogSignals, signals_of
from hexjet_identify.prediction_error.estimate import noise_only_deviance
from hexjet_identify.prediction_error.identify_log import MIN_DEVIANCE_FALL
from hexjet_identify.prediction_error.stretches import prepare

SIGNALS_TITLE = "Measured and modelled"
ERROR_TEXT = (
    "The model answers the command alone: what wind and noise did is in the error. Of an axis, which integrates, they "
    "add up over the flight, so that the fit of the change tells more than that of the whole."
)
# Horizon of the judged prediction [s]; the loops that a predictor serves are faster.
PREDICTION_S = 1.0
OTHER_FORM_TEXT = "no held model of a slow pole and lags, which hexjet identify writes; nothing else can be flown here"


@dataclass(frozen=True)
class StatedModel:
    """A model read from a file; its channels are empty if the file names none."""

    path: Path
    what: str
    signals: LogSignals
    form: Poles
    x: Array
    gain: float


class Refit(NamedTuple):
    """Gain and delay fitted anew to the log, the rest of the model kept, with half of their 95 % intervals."""

    gain: float  # over the model's
    gain_half: float
    delay: float  # s, less the model's
    delay_half: float

    @property
    def text(self) -> str:
        """Gain and delay with their bounds, as a sentence."""
        gain, delay = self.bounded
        return f"fitted to this log its gain is {gain} times as stated, and its delay {delay} ms off"

    @property
    def bounded(self) -> tuple[str, str]:
        """Gain and delay [ms] with their bounds, to the digits that these leave."""
        return _bounded(self.gain, self.gain_half), _bounded(1e3 * self.delay, 1e3 * self.delay_half)


def _bounded(value: float, half: float) -> str:
    places = max(0, 1 - floor(log10(half))) if 0.0 < half < inf else 3
    return f"{round(value, places) + 0.0:.{places}f} ±{half:.2g}"


@dataclass(frozen=True)
class Validation:
    """Comparison of a model's response with a log, by the log's commands.

    ``fit``: 1 less the error's standard deviation over the output's, 1 is perfect, 0 the mean; ``ahead``: the same of
    the change of the output over AHEAD_S.  ``nrmse``: of the simulation, over the output's standard deviation;
    ``theil``: its U, 0 is perfect, 1 useless.  ``again``: None where the log does not move enough.  ``signals``: times,
    command, output and model of each stretch.
    """

    model: StatedModel
    log: Path
    seconds: float
    step: float
    fit: float
    nrmse: float
    theil: float
    ahead: float
    again: Refit | None
    signals: tuple[tuple[Array, Array, Array, Array], ...]
    notes: tuple[str, ...]

    @property
    def judgement(self) -> Judgement:
        """The verdict: whether gain and delay, fitted anew to this log, agree with the model's.

        The gain to a tenth, as a sweep's form has to be, the delay to a tenth of delay and lags, a sample at least: not
        explained where the 95 % interval lies beyond that, not told where the gain's is wider than twice that.
        """
        again, compared = self.again, f"{self.seconds:.1f} s compared"
        if again is None:
            return Judgement(NOT_TOLD, (compared, "the output does not show the command"))
        evidence = (compared, again.text)
        least = max(MAX_MISFIT * self.model.form.total(self.model.x), self.step)
        off = abs(again.gain - 1.0) - again.gain_half > MAX_MISFIT or abs(again.delay) - again.delay_half > least
        if not off and again.gain_half > 2.0 * MAX_MISFIT:
            return Judgement(NOT_TOLD, evidence)
        return judge_model(not off, *evidence)

    @property
    def refused(self) -> list[str]:
        """Reasons not to use the model for the vehicle of this log; empty if there is none, or it is not told."""
        again, judgement = self.again, self.judgement
        return [f"not explained: {again.text}"] if again and judgement.verdict == NOT_EXPLAINED else []

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        model, signals = self.model, self.model.signals
        channels, units = (signals.command, signals.output), (signals.command_unit, signals.output_unit)
        again = self.again
        return {
            **shared_record(model.what, channels, units, self.judgement, self.refused, self.notes),
            "estimates": [
                {
                    "form": model.form.label,
                    "gain": model.gain,
                    **dict(zip(model.form.names, model.x.tolist(), strict=True)),
                }
            ],
            "model": str(model.path),
            "log": str(self.log),
            "what": model.what,
            "setpoint": signals.setpoint,
            "gain_fitted_anew": None if again is None else again.gain,
            "gain_fitted_anew_bound_95": None if again is None else again.gain_half,
            "delay_fitted_anew_by_s": None if again is None else again.delay,
            "delay_fitted_anew_bound_95_s": None if again is None else again.delay_half,
            "seconds": self.seconds,
            "fit": self.fit,
            "nrmse": self.nrmse,
            "theil_u": self.theil,
            "fit_of_changes": self.ahead,
            "changes_over_s": PREDICTION_S,
        }


def read_model(path: Path, axis: str | None = None) -> StatedModel:
    """Read ``identification.json`` of ``hexjet identify log`` or of an axis, its folder, or a model file of an axis.

    ``axis`` chooses from a model file of more than one.  Raises InputError.
    """
    file = path / "identification.json" if path.is_dir() else path
    if file.suffix.lower() == ".toml":
        return _read_model_file(file, axis)
    if not file.exists():
        raise InputError(f"{path}: no model here")
    data = read_json(file)
    try:
        if data.get("kind") == "axis" and (beside := file.parent / "model.toml").is_file():  # of a sweep
            return _read_model_file(beside, axis)
        best = data["estimates"][0]
        form = Poles(bool(data["engine"]), sum(name.startswith("lag") and name.endswith("_s") for name in best))
        wants = LogSignals(*(str(data[name]) for name in LogSignals._fields))
        x = np.array([float(best[name]) for name in form.names])
        return StatedModel(file, str(data["what"]), wants, form, x, float(best["gain"]))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(
            f"{file}: is no identification.json of hexjet identify log ({one_line(error)}); "
            "allowed: that file, its folder, a model file (.toml)"
        ) from error


def _read_model_file(file: Path, axis: str | None) -> StatedModel:
    """Read a model file, convert its sampled model to the continuous form; it names no channels of a log."""
    candidates = [
        (name, model) for models in read_models(file).values() for name, model in models.items() if axis in (None, name)
    ]
    if len(candidates) != 1:
        of = f" of {axis}" if axis else ""
        raise InputError(f"{file}: {len(candidates)} models{of}; say axis of one that is there")
    label, model = candidates[0]
    step = model.sample_time_s
    if model.pole_pairs or model.zero_pairs or not all(0.0 < pole <= 1.0 for pole in model.poles):
        raise InputError(f"{file}: {label}: {OTHER_FORM_TEXT}")
    rate, *fast = sorted(-np.log(pole) / step for pole in model.poles)
    if not all(pole > 0.0 for pole in fast) or not fast:
        raise InputError(f"{file}: {label}: {OTHER_FORM_TEXT}")
    lags = tuple(float(1.0 / pole) for pole in fast)
    unit = Continuous(1.0, float(rate), lags, model.delay_samples, step).discrete("")
    gain = model.gain / unit.gain
    if len(unit.zeros) != len(model.zeros) or not np.allclose(unit.zeros, sorted(model.zeros), rtol=1e-3, atol=1e-3):
        raise InputError(f"{file}: {label}: {OTHER_FORM_TEXT}")
    x = np.array([model.delay_samples * step, rate, *lags])
    return StatedModel(file, label, LogSignals("", ""), Poles(False, len(lags)), x, float(gain))


def validate(model: StatedModel, log: FlightLog, begin: float | None = None, end: float | None = None) -> Validation:
    """Simulate the model with the log's command; offset and initial state of each stretch are fitted.

    Raises InputError where the log has not the model's channels, or no stretch that can be used.
    """
    chosen = model.signals
    if not (log.has(chosen.command) and log.has(chosen.output)):
        chosen = signals_of(log, model.what)
        model = replace(model, signals=chosen)
    longest = max(2.0 * float(model.x[0]), 0.1)
    of_sums: list[str] = []
    command, output = log.signal(chosen.command, of_sums), log.signal(chosen.output, of_sums)
    prepared = prepare(command, output, longest, None, begin, end)
    problem, signals = prepared.problem(), []
    simulated = _simulate_log(problem, model)
    for stretch, span in zip(prepared.stretches, problem.spans, strict=True):
        commanded = stretch.command[np.searchsorted(stretch.command_times, stretch.times, side="right") - 1]
        signals.append((stretch.times, commanded, stretch.output, simulated[span]))
    fits = [(output, answer) for _, _, output, answer in signals]
    measured = np.concatenate([output - output.mean() for output, _ in fits])
    error = np.concatenate([output - answer for output, answer in fits])
    size = float(np.std(measured))
    if not size > 0.0:
        raise InputError(f"{log.path}: {chosen.output} does not move")
    lag = max(1, round(PREDICTION_S / prepared.working_step))
    changes = [(o[lag:] - o[:-lag], m[lag:] - m[:-lag]) for o, m in fits if len(o) > 2 * lag]
    moved = np.concatenate([o for o, _ in changes]) if changes else measured
    missed = np.concatenate([o - m for o, m in changes]) if changes else error
    rms = float(np.sqrt(np.mean(error**2)))
    model_rms = np.sqrt(np.mean(np.concatenate([m - m.mean() for _, m in fits]) ** 2))
    fit, theil = 1.0 - float(np.std(error)) / size, rms / (float(np.sqrt(np.mean(measured**2))) + float(model_rms))
    ahead = 1.0 - float(np.sqrt(np.mean(missed**2))) / float(np.sqrt(np.mean(moved**2)))
    again = _fit_anew(problem, model, problem.output - simulated, prepared.late)
    notes = (*log.remarks, *of_sums, *prepared.notes)
    return Validation(
        model, log.path, prepared.seconds, prepared.working_step, fit, rms / size, theil, ahead, again, tuple(signals),
        notes,
    )  # fmt: skip


def _fit_anew(problem: Problem, model: StatedModel, left: Array, late: float) -> Refit | None:
    """Fit gain and delay to the log; None where the command lowers the deviance by too little to tell.

    ``left``: what the model leaves over; ``late``: by how much the command may have moved before its row, s.
    """
    noise = problem.fit_noise(left, problem.best_order(left, model.form.without_pole(model.x)))
    kept = range(1, len(model.x))
    x, noise, _ = solve(problem, model.form, model.x, noise, kept)
    found = estimate_at(problem, model.form, x, noise, kept, round(model.form.total(x) / problem.step))
    gain, deviation = found.gain
    if not noise_only_deviance(problem, found) - found.deviance >= MIN_DEVIANCE_FALL or not deviation > 0.0:
        return None
    return Refit(
        gain / model.gain,
        DEVIATIONS_95 * deviation / abs(model.gain),
        found.delay - float(model.x[0]),
        DEVIATIONS_95 * found.deviation(0) + late,
    )


def _simulate_log(problem: Problem, model: StatedModel) -> Array:
    """Return the model's answer to the command, with the offsets and initial states that fit the output best."""
    columns = model.form.columns(problem, model.x)
    answer, others = model.gain * columns[:, 0], columns[:, 1:]
    offset = np.linalg.lstsq(others, problem.output - answer, rcond=1e-12)[0]
    return np.asarray(answer + others @ offset)


def rows(validation: Validation) -> list[tuple[str, str]]:
    """Return the rows of the table: each measure and its value as text."""
    lines = [
        ("fit of the simulation (1: perfect, 0: no better than its mean)", f"{validation.fit:.3f}"),
        ("NRMSE, over the output's standard deviation", f"{validation.nrmse:.3f}"),
        ("Theil's U (0: perfect, 1: useless)", f"{validation.theil:.3f}"),
        (f"fit of the change over {PREDICTION_S:g} s", f"{validation.ahead:.3f}"),
    ]
    if (again := validation.again) is not None:
        gain, delay = again.bounded
        lines += [("gain fitted to this log, times as stated", gain), ("delay fitted to this log, off by, ms", delay)]
    return lines


class ValidateResult(FolderResult):
    """Comparison of a model's response with a log, by the log's commands.

    ``write`` leaves ``validation.json`` and ``report.html``.

    Attributes
    ----------
    validation : Validation
        Everything.
    """

    def __init__(self, validation: Validation) -> None:
        self.validation = validation
        self.files = {}

    @property
    def verdict(self) -> str:
        """``explained``, ``not explained`` or ``not told``: whether gain and delay, fitted anew, are the model's."""
        return self.validation.judgement.verdict

    @property
    def explained(self) -> bool:
        """Whether the verdict is ``explained``."""
        return self.verdict == "explained"

    def _write(self, folder: Path) -> dict[str, Path]:
        paths = {"json": folder / "validation.json", "report": folder / "report.html"}
        write_files({paths["json"]: json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n"})
        page(self.validation).write(paths["report"])
        return paths

    def to_dict(self) -> dict[str, Any]:
        return self.validation.to_dict()

    def lines(self) -> list[str]:
        """Return the verdict, the evidence, and notes."""
        found = self.validation
        first = f"{self.verdict}: {found.model.what} of {found.model.path} beside {found.log}"
        return [first, *found.judgement.evidence, *note_lines(found.notes)]

    def tables(self) -> list[Table]:
        """Return the measures of how well it fits."""
        return [Table("", ("measure", "value"), rows(self.validation))]

    def _figures(self) -> Mapping[str, Any]:
        return page(self.validation).figures


def page(validation: Validation) -> Page:
    """Return the page of a comparison."""
    model, units = validation.model, (validation.model.signals.command_unit, validation.model.signals.output_unit)
    signals = [
        Signals(times, command, times, output, fit, output - fit) for times, command, output, fit in validation.signals
    ]
    compared = (
        f"{model.path}, flown with {model.signals.command}; {validation.seconds:.1f} s compared, every "
        f"{1e3 * validation.step:.3g} ms."
    )
    shown = Page(
        "validation",
        f"{model.what}: the model beside {validation.log.name}",
        [
            Card(SIGNALS_TITLE, figure="signals"),
            Card("How well it fits", ("measure", "value"), rows(validation), ERROR_TEXT),
        ],
        {"signals": draw_signals(signals, units)},
        summary=[compared],
        notes=validation.notes,
        source=str(validation.log),
    )
    return judged_page(validation.judgement, shown)
