"""What an identification came to: as JSON, as the model file of a predictor, as a page."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError, NotIdentifiedError
from cosim.identify.sweep.fit import MIN_COHERENCE, Fit
from cosim.identify.sweep.response import FrequencyResponse, shortest_record
from cosim.identify.verdict import NOT_TOLD, Judgement, judge_model, shared_record
from cosim.spec.vehicle import RateModel

# Factors on the band's lowest and highest frequency that give the chirp's range.
CHIRP_MARGIN = (0.7, 1.2)
MAX_SWEEP_S = 3600.0  # duration of the longest sweep
# Largest rms of |ln(model / response)|, 10 % or 6 deg, with which a model is accepted.
MAX_MISFIT = 0.1
# A delay counts as known if its 95 % bound [samples] is at most its value, or at most this.
KNOWN_DELAY_BOUND = 1.0
# A model's total delay may differ from the delay ledger's by the larger of this fraction and these samples.
LEDGER_SHARE, LEDGER_SAMPLES = 0.1, 1.0


@dataclass(frozen=True)
class Sweep:
    """Exponential chirp, slightly wider than the band of interest."""

    from_hz: float
    to_hz: float
    amplitude: float
    duration_s: float

    def chirp_hz(self, step: float) -> tuple[float, float]:
        """Return the chirp's first and last frequency, Hz, below the Nyquist frequency."""
        return CHIRP_MARGIN[0] * self.from_hz, min(CHIRP_MARGIN[1] * self.to_hz, 0.49 / step)


@dataclass(frozen=True)
class Identification:
    """Response of one output to one input, and the fitted models, the chosen one first."""

    kind: str  # "engine" or "axis"
    subject: str  # name of the engine or aircraft
    engine: str  # engine that the model belongs to
    channel: str  # "throttle to thrust", or the axis
    command_unit: str
    output_unit: str
    sweep: Sweep
    response: FrequencyResponse
    fits: tuple[Fit, ...]
    source: str
    ledger_samples: float | None  # low-frequency delay in the delay ledger
    reference: RateModel | None  # model that the aircraft states
    notes: tuple[str, ...]
    engine_sha256: str = ""  # EngineSpec.fingerprint
    no_ledger: str = ""  # why the delay ledger has no sum

    @property
    def chosen(self) -> Fit:
        """Fit that is written into the model file."""
        return self.fits[0]

    @property
    def refused(self) -> list[str]:
        """Reasons why the chosen fit must not be used, one line each; empty: usable."""
        return why_refused(self.chosen, self.kind == "engine")

    @property
    def judgement(self) -> Judgement:
        """Judgement whether the chosen form explains the response; undecided if its parameters are not determined."""
        misfit, points = self.chosen.misfit, len(self.response.hertz)
        evidence = (
            f"{self.chosen.label}: {100.0 * misfit:.2g} % off the response at {points} points, coherence at least "
            f"{self.response.coherence.min():.3g}"
        )
        if misfit <= MAX_MISFIT and self.refused:
            return Judgement(NOT_TOLD, (evidence,))
        return judge_model(misfit <= MAX_MISFIT, evidence)

    @property
    def model(self) -> RateModel:
        """The chosen model in the form that predictors use."""
        model = self.chosen.model.discrete(self.source)
        return model.model_copy(update={"engine_sha256": self.engine_sha256}) if self.kind == "axis" else model

    def reference_deviation(self) -> tuple[float, float] | None:
        """Return the largest deviation [dB, deg] of the aircraft's stated model from the coherent response, or None."""
        if self.reference is None:
            return None
        use = self.response.coherence >= MIN_COHERENCE
        error = np.log(rate_response(self.reference, self.response.hertz[use]) / self.response.value[use])
        return float(np.abs(error.real).max() * 20.0 / np.log(10.0)), float(np.degrees(np.abs(error.imag).max()))

    def to_dict(self) -> dict[str, Any]:
        """Return the identification without the response's points, for JSON."""
        deviation = self.reference_deviation()
        fits = [fit_dict(fit, self.source, self.kind == "engine") for fit in self.fits]
        channels = (
            tuple(self.channel.split(" to "))
            if self.kind == "engine"
            else (f"{self.channel} command", f"{self.channel} rate")
        )
        units = self.command_unit, self.output_unit
        return {
            **shared_record(self.subject, (channels[0], channels[-1]), units, self.judgement, self.refused, self.notes),
            "kind": self.kind,
            "engine": self.engine,
            "channel": self.channel,
            "sample_time_s": self.response.step,
            "sweep": vars(self.sweep),
            "points": len(self.response.hertz),
            "coherence_min": float(self.response.coherence.min()),
            "coherence_median": float(np.median(self.response.coherence)),
            "estimates": fits,
            "fits": fits,  # name in earlier versions
            "ledger_samples": self.ledger_samples,
            "no_ledger": self.no_ledger or None,
            "reference": None
            if self.reference is None or deviation is None
            else self.reference.model_dump() | {"worst_db": deviation[0], "worst_deg": deviation[1]},
        }

    def model_table(self) -> dict[str, Any]:
        """Return the table of the model file: ``identified.<engine>.<axis>``."""
        return {"identified": {self.engine: {self.channel: self.model.model_dump()}}}


def fit_dict(fit: Fit, source: str, engine: bool) -> dict[str, Any]:
    """Return a fit for JSON: continuous parameters with their bounds, the discrete form, and the misfit."""
    model = fit.model
    values: dict[str, Any] = dict(fit.values)
    axis = {} if engine else {"low_frequency_delay_samples": low_frequency_delay(fit)}
    axis |= {} if engine else {"low_frequency_delay_bound_95_samples": fit.all_delay_half}
    if engine and model.rate > 0.0:
        slow = 1.0 / model.rate
        values |= {"time_constant_s": slow, "gain_at_rest": model.gain * slow}
    return {
        "form": fit.label,
        "label": fit.label,
        "continuous": values | {"delay_s": model.delay_samples * model.step},
        "bounds_95": {name: list(ends) for name, ends in fit.bounds.items()},
        "held": list(fit.fixed),
        "discrete": model.discrete(source).model_dump(),
        **axis,
        "misfit": fit.misfit,
        "worst_db": fit.worst_db,
        "worst_deg": fit.worst_deg,
    }


def rate_response(model: RateModel, hertz: Array) -> Complex:
    """Return a discrete model's frequency response, the fraction of a sample in its delay taken as pure phase."""
    z = np.exp(2j * np.pi * hertz * model.sample_time_s)
    numerator = np.prod([z - zero for zero in model.all_zeros], axis=0) if model.all_zeros else np.ones(len(hertz))
    denominator = np.prod([z - pole for pole in model.all_poles], axis=0)
    return np.asarray(model.gain * numerator / denominator * z**-model.delay_samples)


def check_band(low: float, high: float, duration: float | None, step: float) -> None:
    """Raise InputError for a band or a duration from which no response can be estimated."""
    nyquist = 0.5 / step
    if high >= nyquist:
        raise InputError(f"to_hz {high:g}: must be below {nyquist:g} Hz, half the sample rate")
    if not 0.0 < low < high:
        raise InputError(f"from_hz {low:g}, to_hz {high:g}: the band must go from a lower to a higher frequency")
    if shortest_record(low) > MAX_SWEEP_S:
        raise InputError(f"from_hz {low:g}: must be at least {shortest_record(1.0) / MAX_SWEEP_S:.2g}")
    if duration is not None and not duration <= MAX_SWEEP_S:
        raise InputError(f"duration_s {duration:g}: must be at most {MAX_SWEEP_S:g} s")
    if duration is not None and duration < shortest_record(low):
        raise InputError(
            f"duration_s {duration:g}: too short for {low:g} Hz; it takes {shortest_record(low):.3g} s, "
            f"or from_hz {1.01 * shortest_record(low) * low / duration:.2g}"
            if duration > 0.0
            else f"duration_s {duration:g}: must be above 0"
        )


def suitable_duration(low: float, cycles: float = 20.0) -> float:
    """Return a sweep's duration, whole s, from ``low`` Hz.

    ``cycles``: of the lowest frequency, in a sweep of automatic duration.
    """
    return min(float(ceil(cycles / low)), MAX_SWEEP_S)


def need_coherence(response: FrequencyResponse, subject: str, amplitude: float, usable: float = 0.5) -> list[str]:
    """Return a note on points left out as incoherent.  Raises NotIdentifiedError if too many are.

    ``usable``: share of the points that must have coherence.
    """
    good = response.coherence >= MIN_COHERENCE
    if np.mean(good) < usable:
        raise NotIdentifiedError(
            f"{subject} does not answer the sweep: coherence is at least {MIN_COHERENCE:g} at {int(good.sum())} of "
            f"{len(good)} points (median {np.median(response.coherence):.2f}); "
            f"raise amplitude (now {amplitude:g}), sweep longer, or narrow the band"
        )
    if not good.all():
        first = response.hertz[~good]
        return [
            f"{int((~good).sum())} of {len(good)} points left out, coherence below {MIN_COHERENCE:g} "
            f"({first.min():.2g} to {first.max():.2g} Hz)"
        ]
    return []


def half_width(fit: Fit, name: str) -> float:
    """Return the distance of the farther 95 % bound of a free parameter from its value, in the parameter's unit."""
    low, high = fit.bounds[name]
    return max(high - fit.values[name], fit.values[name] - low)


def is_negligible_lag(fit: Fit, name: str, max_steps: float = 0.05) -> bool:
    """Return whether a free lag is too short to be seen in the samples: less than ``max_steps`` steps."""
    return name in fit.bounds and name.startswith("lag") and fit.values[name] < max_steps * fit.model.step


def is_determined(fit: Fit, name: str) -> bool:
    """Return whether the 95 % bound of a parameter is at most its value, of a delay at most a sample."""
    if name not in fit.bounds:
        return True
    least = KNOWN_DELAY_BOUND if name == "delay_samples" else 0.0
    return bool(half_width(fit, name) <= max(abs(fit.values[name]), least))


def is_total_delay_determined(fit: Fit) -> bool:
    """Return whether the 95 % bound of delay plus lags is at most their sum."""
    total = fit.model.delay_samples + sum(fit.model.lags) / fit.model.step
    return bool(fit.all_delay_half <= max(total, KNOWN_DELAY_BOUND))


def why_refused(fit: Fit, engine: bool) -> list[str]:
    """Return the reasons why a fit must not be used, each with a remedy; empty: usable.

    Refused are a misfit above ``MAX_MISFIT``, and a gain, lag, delay or time constant of an engine whose bound exceeds
    its value.  The slow pole of an axis may be anything near 0, and a negligible lag is accepted.
    """
    reasons = []
    if not fit.misfit <= MAX_MISFIT:
        reasons.append(
            f"the form is {100.0 * fit.misfit:.0f} % off the response, {100.0 * MAX_MISFIT:.0f} % at most: another "
            "lags, a narrower band (from_hz, to_hz) or another amplitude"
        )
    words = {"gain": "gain", "rate_1_s": "time constant", "delay_samples": "delay", "lag_s": "lag"}
    unknown = [
        words.get(name, "further lag")
        for name in fit.bounds
        if (engine or name != "rate_1_s") and not is_negligible_lag(fit, name) and not is_determined(fit, name)
    ]
    if unknown:
        few = "" if len(fit.model.lags) <= (0 if engine else 1) else "fewer lags, "
        reasons.append(
            f"not determined by this sweep, as the bounds exceed the value: {', '.join(unknown)}: {few}a wider band "
            "(from_hz, to_hz), more amplitude, or state what is known by hold"
        )
    return reasons


def agrees_with_ledger(fit: Fit, ledger_samples: float) -> bool:
    """Return whether the total delay of a fit agrees with the delay ledger's [samples]."""
    return abs(low_frequency_delay(fit) - ledger_samples) <= max(LEDGER_SHARE * ledger_samples, LEDGER_SAMPLES)


def note_off_ledger(fit: Fit, ledger_samples: float | None, from_hz: float) -> list[str]:
    """Return a note if a usable fit's total delay differs from the delay ledger's."""
    if ledger_samples is None or why_refused(fit, engine=False) or agrees_with_ledger(fit, ledger_samples):
        return []
    worth = fit.misfit / (2.0 * np.pi * from_hz * fit.model.step)
    return [
        f"all delay of the model is {low_frequency_delay(fit):.2f} samples, of the delay ledger {ledger_samples:.2f}: "
        f"they do not agree, and must not be mixed (the misfit is worth {worth:.1f} samples at {from_hz:g} Hz)"
    ]


_PARAMETER_TITLES = {  # titles of table rows
    "gain": "gain",
    "rate_1_s": "slow pole, 1/s",
    "lag_s": "lag, ms",
    "lag_2_s": "second lag, ms",
    "lag_3_s": "third lag, ms",
    "delay_samples": "delay, samples",
}


def fit_rows(identification: Identification) -> list[list[str]]:
    """Return a table of the fits side by side: one row per parameter, its name first."""
    rows = []
    for name in sorted({name for fit in identification.fits for name in fit.values}, key=list(_PARAMETER_TITLES).index):
        title, scale, invert = _PARAMETER_TITLES[name], 1e3 if name.startswith("lag") else 1.0, False
        if name == "gain":
            unit = "rad/s^2" if identification.output_unit == "rad/s" else f"{identification.output_unit}/s"
            title = f"gain, {unit} per {identification.command_unit}"
        if name == "rate_1_s" and identification.kind == "engine":
            title, scale, invert = "time constant, ms", 1e3, True
        rows.append([title, *(_format_with_bounds(fit, name, scale, invert) for fit in identification.fits)])
    if identification.kind == "engine":
        at_rest = [fit.model.gain / fit.model.rate if fit.model.rate else float("inf") for fit in identification.fits]
        rows.append(["gain at rest, N", *(f"{value:.4g} ({value / GRAVITY:.4g} kgf)" for value in at_rest)])
    if identification.kind == "axis":
        sums = [(f"{low_frequency_delay(fit):.2f}", is_total_delay_determined(fit)) for fit in identification.fits]
        rows.append(["all delay, samples", *(text if known else "not determined" for text, known in sums)])
    rows.append(["misfit, %", *(f"{100 * fit.misfit:.2g}" for fit in identification.fits)])
    rows.append(["worst, dB and deg", *(f"{fit.worst_db:.2g}, {fit.worst_deg:.2g}" for fit in identification.fits)])
    return rows


def _format_with_bounds(fit: Fit, name: str, scale: float, invert: bool, slow_pole: float = 20.0) -> str:
    if name not in fit.values:
        return ""

    def format_number(value: float) -> str:
        inverted = (1.0 / value if value else float("inf")) if invert else value
        return f"{scale * inverted:.4g}" if abs(inverted) > 1e-9 else "0"

    value = fit.values[name]
    if name in fit.fixed:
        return f"{format_number(value)} held"
    if is_negligible_lag(fit, name):
        return "none"
    low, high = fit.bounds[name]
    if not is_determined(fit, name):
        # For a slow pole near 0 only an upper bound is known.
        return f"below {high:.1g}" if name == "rate_1_s" and not invert and high < slow_pole else "not determined"
    if name == "delay_samples" and half_width(fit, name) > value:
        return f"below {high:.2g}"
    ends = (scale * (1.0 / end if invert and end else end) for end in (low, high))
    half = max(abs(end - scale * (1.0 / value if invert and value else value)) for end in ends)
    return f"{format_number(value)} ±{float(f'{half:.1g}'):g}"


def low_frequency_delay(fit: Fit) -> float:
    """Return the delay [samples] towards zero frequency: delay, lags and half a hold, without the slow pole."""
    return fit.model.delay_samples + sum(fit.model.lags) / fit.model.step + 0.5


def equation(model: RateModel, unit: float = 1.0) -> str:
    """Format the discrete form: ``gain (z - zero) / ((z - pole) (z - pole)) z^-delay``."""
    numerator = " ".join([f"{model.gain / unit:.4g}", *(_format_factor(zero) for zero in model.zeros)])
    factors = [_format_factor(pole) for pole in model.poles]
    denominator = factors[0] if len(factors) == 1 else f"({' '.join(factors)})"
    delay = f" z^-{model.delay_samples:.4g}" if model.delay_samples else ""
    return f"{numerator} / {denominator}{delay}"


def _format_factor(root: float) -> str:
    return f"(z {'-' if root >= 0.0 else '+'} {abs(root):.4f})"


def equations(identification: Identification) -> list[str]:
    """Format the chosen discrete model, for an engine also in kgf, as the paper does."""
    lines = [f"{equation(identification.model)}  [{identification.output_unit} per {identification.command_unit}]"]
    if identification.output_unit == "N":
        lines.append(f"{equation(identification.model, GRAVITY)}  [kgf per {identification.command_unit}]")
    return lines
