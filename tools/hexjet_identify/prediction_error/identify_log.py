"""From a flight's log to a model with a delay: what was found, how sure it is, and what the flight lacked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.errors import NotIdentifiedError
from cosim.identify.sweep.fit import Model
from cosim.identify.verdict import Judgement, judge_model, shared_record
from cosim.spec.vehicle import RateModel
from hexjet_identify.engine_file import DEVIATIONS_95
from hexjet_identify.fit.estimate import Estimate, estimate_at, solve
from hexjet_identify.fit.forms import Poles
from hexjet_identify.fit.problem import Problem
from hexjet_identify.logs import Channel, FlightLog, LogSignals
from hexjet_identify.prediction_error.estimate import estimate_dict, identify_poles, noise_only_deviance
from hexjet_identify.prediction_error.stretches import Prepared, prepare

# Minimum fall of the deviance by the command; chance alone gives 10 once in 25 (four parameters).
MIN_DEVIANCE_FALL = 30.0
NO_NOISE = "the log has no noise: what is left over is rounding, and its tests and the bounds say nothing"


class Check(NamedTuple):
    """A test of the residuals: its p-value, and the share of their power that contradicts the model."""

    name: str
    p: float
    share: float

    @property
    def failed(self) -> bool:
        """Whether the residuals contradict the model by more than a chance of one in a thousand."""
        return self.p < 1e-3


@dataclass(frozen=True)
class LogIdentification:
    """The models that were identified from a log; ``estimates`` has the chosen form first.

    ``white``: what is left over of each row, made white, NaN where rows before it are lost.  ``coherence``: frequencies
    [Hz], and that of command with output; ``band_hz``: in which a command tells most of the delay, in this noise.
    """

    path: Path
    kind: str
    what: str
    signals: LogSignals
    prepared: Prepared
    problem: Problem
    estimates: tuple[Estimate, ...]
    checks: tuple[Check, ...]
    white: Array
    coherence: tuple[Array, Array]
    band_hz: tuple[float, float]
    notes: tuple[str, ...]

    @property
    def chosen(self) -> Estimate:
        """The estimate that goes into the model file."""
        return self.estimates[0]

    @property
    def delay_bounds(self) -> tuple[float, float]:
        """95 % bounds of the delay [s] by the richest form that was tried."""
        return bounds(self.estimates)

    @property
    def judgement(self) -> Judgement:
        """The verdict, always explained as others are refused, with the tests of the residuals as evidence."""
        tests = (f"{check.name}: p {check.p:.2g}, {100.0 * check.share:.2g} % of their power" for check in self.checks)
        return judge_model(True, f"{self.prepared.seconds:.1f} s used, {self.chosen.rows} equations", *tests)

    @property
    def engine(self) -> bool:
        """Whether the model is of an engine, and not of an axis."""
        return self.what.startswith("engine")

    def model(self, step: float) -> Model:
        """Return the chosen estimate as a model behind a hold of this step, s."""
        delay, rate, *lags = self.chosen.x.tolist()
        return Model(self.chosen.gain[0] * (rate if self.engine else 1.0), rate, tuple(lags), delay / step, step)

    def rate_model(self, step: float) -> RateModel:
        """Return the chosen estimate as a sampled model, as a predictor reads it."""
        low, high = self.delay_bounds
        return self.model(step).discrete(
            f"identified from {self.path.name} ({self.kind}): {self.signals.command} to {self.signals.output}, "
            f"{self.prepared.seconds:.1f} s, {self.chosen.form.label}, delay {1e3 * low:.1f} to {1e3 * high:.1f} ms"
        )

    def to_dict(self, step: float) -> dict[str, Any]:
        """Return everything but the signals, for JSON."""
        command, output, setpoint, *units = self.signals
        return {
            **shared_record(self.what, (command, output), (units[0], units[1]), self.judgement, [], self.notes),
            "setpoint": setpoint,
            "log": str(self.path),
            "kind": self.kind,
            "what": self.what,
            "engine": self.engine,
            "seconds": self.prepared.seconds,
            "stretches_s": [[float(s.command_times[0]), float(s.times[-1])] for s in self.prepared.stretches],
            "working_step_s": self.prepared.working_step,
            "longest_delay_s": self.prepared.longest_delay,
            "clocks": {"command": _clock_dict(self.prepared.command), "output": _clock_dict(self.prepared.output)},
            "delay_s": self.chosen.delay,
            "delay_bounds_95_s": list(self.delay_bounds),
            "estimates": [estimate_dict(estimate, self.prepared.working_step) for estimate in self.estimates],
            "checks": [check._asdict() | {"failed": check.failed} for check in self.checks],
            "tells_most_hz": list(self.band_hz),
            "discrete": self.rate_model(step).model_dump(),
        }


def identify_log(
    log: FlightLog,
    signal: str,
    signals: LogSignals,
    *,
    longest_delay: float = 0.4,
    step: float | None = None,
    begin: float | None = None,
    end: float | None = None,
    hold: Mapping[str, float] | None = None,
    lags: int | None = None,
) -> LogIdentification:
    """Identify command to output of a log; ``signal`` is an axis or begins with ``engine``.

    ``lags`` is the number of lags beside the pole (an axis: 1 or more); the better of two forms by Akaike's criterion
    where it is None.  Raises NotIdentifiedError where the log does not tell, which says
    why, and InputError for channels or stretches that cannot be used.
    """
    of_sums: list[str] = []
    command, output = log.signal(signals.command, of_sums), log.signal(signals.output, of_sums)
    prepared = prepare(command, output, longest_delay, step, begin, end)
    problem = prepared.problem()
    estimates = identify_poles(problem, signal.startswith("engine"), dict(hold or {}), lags)
    chosen = estimates[0]
    where = f"{log.path}: {signals.command} to {signals.output}"
    fall = noise_only_deviance(problem, chosen) - chosen.deviance
    _refuse(fall, estimates, prepared, where)
    notes = [*log.remarks, *of_sums, *prepared.notes, *_describe_doubts(chosen, problem)]
    white, use = _whiten_on_clock(problem, chosen)
    commanded = _held_on_clock(problem, None)
    asked = log.signal(signals.setpoint) if signals.setpoint else None
    checks = _test_residuals(problem, chosen, white, use, commanded, asked)
    if _has_noise(problem, chosen):
        # Fall of the whitened sum of squares by the command.
        explained = chosen.loss * float(np.expm1(fall / chosen.rows))
        together = _test_against("fed back", white, use, commanded, problem.step, first=0)
        if reason := _why_refused(chosen, checks, together, explained):
            raise NotIdentifiedError(f"{where}: {reason}")
        notes += _describe_failed_checks(checks)
    else:
        notes.append(NO_NOISE)
    band = _find_telling_band(chosen, problem.step)
    notes += _describe_next_flight(chosen, bounds(estimates), prepared, band)
    estimates = [_widen_for_late(estimate, prepared.late) for estimate in estimates]
    white = np.where(use, white, np.nan)[problem.grid]
    return LogIdentification(
        log.path, log.kind, signal, signals, prepared, problem, tuple(estimates), tuple(checks), white,
        _coherence(problem, commanded), band, tuple(notes),
    )  # fmt: skip


def _widen_for_late(estimate: Estimate, late: float) -> Estimate:
    """Return an estimate whose bounds allow for a command that changed up to ``late`` s before its row."""
    if not late or 0 in estimate.held:
        return estimate
    covariance = estimate.covariance.copy()
    covariance[0, 0] += (late / DEVIATIONS_95) ** 2
    low, high = estimate.delay_bounds
    return replace(estimate, covariance=covariance, delay_bounds=(low, high + late))


def bounds(estimates: Sequence[Estimate]) -> tuple[float, float]:
    """Return bounds of the delay [s] by the richest form, which contains the others."""
    return max(estimates, key=lambda estimate: len(estimate.x)).delay_bounds


def _refuse(fall: float, estimates: Sequence[Estimate], prepared: Prepared, where: str, widest: float = 0.6) -> None:
    """Raise NotIdentifiedError if the log does not determine the model, as if bounds span ``widest`` of the search."""
    chosen = estimates[0]
    if not fall >= MIN_DEVIANCE_FALL:
        raise NotIdentifiedError(
            f"{where}: the output does not show the command (it lowers the deviance by {fall:.1f}, "
            f"{MIN_DEVIANCE_FALL:g} are needed); fly doublets or a sweep on it, or look at other channels"
        )
    unknown = _name_undetermined(chosen)
    if unknown:
        raise NotIdentifiedError(
            f"{where}: this log does not tell {unknown}: the 95 % bounds exceed the value; fly doublets or a sweep, "
            "larger or longer, or state what is known by hold"
        )
    if 0 in chosen.held:
        return
    if chosen.delay > prepared.longest_delay - prepared.working_step:
        raise NotIdentifiedError(
            f"{where}: the delay is at the end of the search, {prepared.longest_delay:g} s; "
            "try a longer longest_delay_s, or the channels belong to different clocks"
        )
    low, high = bounds(estimates)
    if not high - low < widest * prepared.longest_delay:
        raise NotIdentifiedError(
            f"{where}: this log does not tell the delay: anything from {1e3 * low:.0f} to {1e3 * high:.0f} ms fits; "
            "fly doublets or a sweep, or state what is known: hold lag_s=..., lags 1"
        )


def _name_undetermined(chosen: Estimate) -> str:
    """Name gain, and delay with lags, where bounds exceed the value; their split may be unknown."""
    numbers = {"the gain": chosen.gain, "delay and lags together": chosen.total}
    return " and ".join(name for name, (value, one) in numbers.items() if not DEVIATIONS_95 * one <= abs(value))


def _describe_doubts(chosen: Estimate, problem: Problem, apart: float = 3.29) -> list[str]:
    """Return doubts: a negative gain, and halves of the log ``apart`` by so many deviations (p = 0.001)."""
    doubts = []
    if chosen.gain[0] < 0.0:
        doubts.append("the gain is negative: the output moves against the command")
    early = np.arange(len(problem.output)) < len(problem.output) // 2
    if 0 in chosen.held or len(early) < 4 * len(chosen.noise):
        return doubts
    ends = []
    for rows in (early, ~early):
        half = problem.at(rows)
        x, noise, _ = solve(half, chosen.form, chosen.x, chosen.noise, chosen.held)
        ends.append(estimate_at(half, chosen.form, x, noise, chosen.held))
    for name, values in (
        ("the gain", [half.gain for half in ends]),
        ("the sum of delay and lags", [half.total for half in ends]),
    ):
        (a, sa), (b, sb) = values
        if abs(a - b) > apart * np.hypot(sa, sb) > 0.0:
            doubts.append(
                f"{name} is not the same in the first half ({a:.4g}) and the second ({b:.4g}): "
                "what flew changed, and the bounds are too narrow"
            )
    return doubts


def _whiten_on_clock(problem: Problem, estimate: Estimate) -> tuple[Array, Flags]:
    """Return the whitened residual on an even clock, and where it is known."""
    use = problem.equations(len(estimate.noise))
    white = problem.on_grid(problem.whiten(estimate.residual, estimate.noise), use)
    return white, problem.on_grid(np.ones(use.sum()), use) > 0.0


def _test_residuals(
    problem: Problem,
    estimate: Estimate,
    white: Array,
    use: Flags,
    command: Array,
    setpoint: Channel | None,
    lags: int = 20,
) -> list[Check]:
    from scipy.stats import chi2

    power, count, total = float(white @ white), int(use.sum()), 0.0
    # Each term of the noise model made it white up to there.
    first = min(len(estimate.noise), 20) + 1
    for lag in range(first, first + lags):
        together = use[lag:] & use[:-lag]
        if together.any():
            r = float(white[lag:] @ white[:-lag]) / power
            total += r * r * count * count / max(int(together.sum()), 1)
    checks = [Check("residuals: white", float(chi2.sf(total, lags)), total / count)]
    checks.append(_test_against("residuals: free of the command", white, use, command, problem.step))
    if setpoint is not None:
        asked = _held_on_clock(problem, setpoint)
        checks.append(_test_against("residuals: free of the set-point", white, use, asked, problem.step))
    return checks


def _held_on_clock(problem: Problem, channel: Channel | None) -> Array:
    """Return the held command, or a channel, on the even clock, less its mean in each stretch, 0 between."""
    clock = np.zeros(int(problem.grid[-1]) + 1)
    for log, span in problem.parts:
        own = problem.grid[span]
        every = np.arange(own[0], own[-1] + 1)
        times, values = log.command_times, log.command
        if channel is not None:
            good = np.isfinite(channel.values) & np.isfinite(channel.times)
            times, values = channel.times[good], channel.values[good]
        row = np.clip(np.searchsorted(times, np.interp(every, own, log.times), side="right") - 1, 0, None)
        held = values[row] if values.size else np.zeros(len(every))
        clock[every] = held - held.mean()
    return clock


def _has_noise(problem: Problem, chosen: Estimate, rounding: float = 1e-6) -> bool:
    """Return whether the residual exceeds ``rounding``, a share of the output: tests of rounding say nothing."""
    return float(np.sqrt(chosen.loss / chosen.rows)) > rounding * float(np.std(problem.output))


def _why_refused(
    chosen: Estimate,
    checks: Sequence[Check],
    together: Check,
    explained: float,
    fed_back: float = 0.25,
    enough: float = 0.2,
) -> str:
    """Return why the residuals follow the command: the form, or a disturbance fed back; "" if they do not.

    A form that does not fit leaves a part of what the command did before, and it leaves the set-point too.  Where the
    command explains less than ``enough`` of what is left over, and of that more goes with the command of that time
    (``together``) than ``fed_back`` of what it explains at all, the loop feeds the disturbance back: the model of the
    noise is of finite order, and what it lacks is in command and residual alike.
    """

    def follow(check: Check, misfit: float = 0.02, small: float = 1e-3) -> bool:
        """Return whether a test failed by more than ``misfit`` of the residual, and ``small`` of what is explained."""
        return check.failed and check.share > misfit and check.share * chosen.loss > small * explained

    by_setpoint = any(check.failed for check in checks[2:])
    weak = explained <= enough * chosen.loss and together.share * chosen.loss > fed_back * explained
    if weak and not by_setpoint and follow(together):
        part = max(explained / chosen.loss, 1e-4)
        larger = max(2.0, (enough / part) ** 0.5)
        return (
            f"the disturbance is too large beside what the command does, which explains {100.0 * part:.1g} % as much "
            f"as is left over; the loop feeds it back into the command ({100.0 * together.share:.0f} % of what is left "
            f"over is in the command of that time); a stronger manoeuvre is needed: doublets or a sweep about "
            f"{larger:.0f} times as large, or calmer air"
        )
    if not follow(checks[1]):
        return ""
    return (
        f"no model of this form fits: {100.0 * checks[1].share:.0f} % of what is left over still follows the command; "
        "try lags, a known hold, a shorter longest_delay_s, or hexjet engine identify"
    )


def _test_against(
    name: str,
    white: Array,
    use: Flags,
    signal: Array,
    step: float,
    first: int = 1,
    lags: int = 12,
    seconds: float = 0.6,
) -> Check:
    """Regress the residuals on a signal's past, and test by F that this explains nothing.

    So many ``lags`` are spread over ``seconds`` from ``first`` steps before on: 1 at least for a test of the form,
    because what the command is at the time of a residual or after contains that very noise where a controller is at
    work, and would be found there whatever the form (Ljung, System Identification, 2nd ed., section 16.6).
    """
    from scipy.special import fdtrc

    by = [first + n * max(1, round(seconds / lags / step)) for n in range(lags)]
    late = [np.concatenate([np.zeros(n), signal[: len(signal) - n]]) for n in by]
    use = use.copy()
    use[: by[-1] + 1] = False
    matrix = np.stack([*late, np.ones(len(signal))], axis=1)[use]
    residual = white[use]
    size = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    size[size == 0.0] = 1.0
    solution, _, rank, _ = np.linalg.lstsq(matrix / size, residual, rcond=1e-8)
    power = float(residual @ residual)
    unexplained = residual - matrix @ (solution / size)
    explained = max(power - float(unexplained @ unexplained), 0.0)
    freedom = len(residual) - int(rank)
    if not power > 0.0 or freedom < 10 or rank < 1:
        return Check(name, 1.0, 0.0)
    ratio = (explained / int(rank)) / ((power - explained) / freedom)
    return Check(name, float(fdtrc(int(rank), freedom, ratio)), explained / power)


def _describe_failed_checks(checks: Sequence[Check]) -> list[str]:
    words = {
        "residuals: white": "what the model leaves over is not white: the bounds are too narrow",
        "residuals: free of the command": (
            "what the model leaves over still follows the command: the form does not fit the vehicle, and the "
            "bounds do not cover that"
        ),
        "residuals: free of the set-point": (
            "what the model leaves over still follows the set-point, which contains no noise: in the closed loop the "
            "estimate is biased"
        ),
    }
    return [
        f"{words[check.name]} (p {check.p:.1g}, {100.0 * check.share:.2g} % of the residuals' power)"
        for check in checks
        if check.failed
    ]


def information(estimate: Estimate, hertz: Array, step: float) -> Array:
    """Return the information on the delay in a command of unit power at each frequency: |w G A|^2 / power of e."""
    s, (_, rate, *lags) = 2j * np.pi * hertz, estimate.x.tolist()
    answer = estimate.gain[0] * (rate if isinstance(estimate.form, Poles) and estimate.form.is_engine else 1.0)
    answer = answer / (s + rate)
    for lag in lags:
        answer = answer / (lag * s + 1.0)
    whitening = np.polyval(np.concatenate([[1.0], -estimate.noise])[::-1], np.exp(-s * step))
    return np.asarray(np.abs(s * answer * whitening) ** 2 * estimate.rows / estimate.loss)


def _find_telling_band(estimate: Estimate, step: float, drop: float = 0.5) -> tuple[float, float]:
    """Return the band [Hz] in which the information on the delay is at least ``drop`` of its maximum."""
    hertz = np.geomspace(0.02, 0.45 / step, 400)
    density = information(estimate, hertz, step)
    peak = int(np.argmax(density))
    low = high = peak
    while low > 0 and density[low - 1] >= drop * density[peak]:
        low -= 1
    while high < len(density) - 1 and density[high + 1] >= drop * density[peak]:
        high += 1
    return float(hertz[low]), float(hertz[high])


def _describe_next_flight(
    estimate: Estimate, ends: tuple[float, float], prepared: Prepared, band: tuple[float, float], samples: float = 0.5
) -> list[str]:
    """Return which flight would determine the delay to ``samples`` samples, if its bounds are wider."""
    low, high = ends
    target = samples * prepared.working_step
    if 0 in estimate.held or high - low <= 2.0 * target:
        return []
    more = 0.5 * (high - low) / target
    return [
        f"to know the delay within {1e3 * target:.2g} ms fly {more:.2g} times the command, or {more * more:.2g} times "
        f"as long: doublets or a sweep; a command of {band[0]:.2g} to {band[1]:.2g} Hz tells most of it in this noise"
    ]


def _coherence(problem: Problem, command: Array) -> tuple[Array, Array]:
    """Return Hz and the coherence of command and output, by Welch's method over all stretches, gaps bridged."""
    from scipy.signal import coherence

    output = np.interp(np.arange(len(command)), problem.grid, problem.output)
    per = min(len(output) - 1, max(64, round(4.0 / problem.step)))
    hertz, value = coherence(np.diff(command), np.diff(output), 1.0 / problem.step, nperseg=per, detrend="constant")
    return np.asarray(hertz[1:]), np.asarray(value[1:])


def _clock_dict(clock: Any) -> dict[str, float | None]:
    record = {"lost" if name == "lost_fraction" else name: value for name, value in clock._asdict().items()}
    return {name: value if np.isfinite(value) else None for name, value in record.items()}
