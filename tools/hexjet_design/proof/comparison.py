"""The gains that ship and the designed ones on the same flights: what was measured, and what became worse.

Margins are those of linear loops.  What a pilot sees is a flight, and what an engineer pays for is the work of the
actuators, so both sets of gains fly hover with noise and the roll doublets of the proof, and where the designed ones
are worse beyond :data:`MEASURES` that is said right after the verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, inf

from cosim.results.run import Run


@dataclass(frozen=True)
class Measure:
    """A measured quantity of a flight, and the increase that counts as worse."""

    label: str
    unit: str
    digits: int  # decimal places
    factor: float  # worse: more than this factor and ...
    min_difference: float  # ... more than this difference, in unit

    def is_worse(self, before: float, after: float) -> bool:
        """Return whether a flight with ``after`` is worse than one with ``before``."""
        return after > self.factor * before and after - before > self.min_difference


# Chosen by us: with equal noise a change of 5 % is not by chance; twice the travel halves the life of actuators.
MEASURES = {
    "roll_rmse_deg": Measure("roll error, RMSE", "deg", 2, 1.05, 0.1),
    "pitch_rmse_deg": Measure("pitch error, RMSE", "deg", 2, 1.05, 0.1),
    "overshoot_percent": Measure("overshoot", "%", 1, 1.0, 5.0),
    "settling_s": Measure("settling, to 5 %", "s", 2, 1.05, 0.1),
    "throttle_activity_1_s": Measure("throttle activity", "1/s", 3, 2.0, 0.05),
    "tilt_activity_deg_s": Measure("tilt activity", "deg/s", 1, 2.0, 1.0),
    "height_error_m": Measure("height error, largest", "m", 2, 1.05, 0.1),
}
STEP_MEASURES = ("overshoot_percent", "settling_s")  # measures of flights with steps
WORSE = "WORSE as flown than what ships"  # mark of a worse flight
WORSE_ADVICE = "next: a lower noise_share (activity) or max_sensitivity (overshoot), or the gains that ship"
WORSE_WORDS = (  # note on what worse means
    "worse means: error, settling and height by more than 5 % (and 0.1 deg, 0.1 s, 0.1 m), overshoot by more than 5 % "
    "of the step, the activity of throttles and tilts more than twice (and 0.05 1/s, 1 deg/s)"
)


@dataclass(frozen=True)
class FlownMeasures:
    """Measured quantities of one flight.

    ``failure``: how a flight ended that was not completed, empty for one that was; ``steps``: whether it was asked for
    steps; ``values``: by the keys of :data:`MEASURES`, empty for a flight that was lost, None for what such a flight
    does not tell (of a step that did not settle the settling time).
    """

    failure: str
    steps: bool
    values: Mapping[str, float | None]

    def cell(self, key: str) -> str:
        """Return a measure as text, or why there is none."""
        if self.failure:
            return self.failure
        value = self.values.get(key)
        if value is not None:
            return f"{value:.{MEASURES[key].digits}f}"
        return "never" if key == "settling_s" and self.steps else "–"


@dataclass(frozen=True)
class FlownPair:
    """One flight with shipped and with designed gains."""

    flight: str
    shipped: FlownMeasures
    designed: FlownMeasures

    def worse(self) -> dict[str, float]:
        """Return the measures that are worse, by key, with the factor; infinite if the value was 0 before."""
        if self.shipped.failure or self.designed.failure:
            return {}
        factors = {}
        for key, measure in MEASURES.items():
            before, after = self.shipped.values.get(key), self.designed.values.get(key)
            if before is not None and after is not None and measure.is_worse(before, after):
                factors[key] = after / before if before else inf
        if self.shipped.values.get("settling_s") is not None and self.designed.cell("settling_s") == "never":
            factors["settling_s"] = inf
        return factors


def measure_flight(run: Run) -> FlownMeasures:
    """Measure a flight by :data:`MEASURES`."""
    roll, pitch = run.metrics["roll"], run.metrics["pitch"]
    if run.outcome != "completed":
        return FlownMeasures(f"lost at {run.summary.duration_s:.1f} s", roll.commanded, {})
    effort, height = run.summary.effort, run.summary.altitude.max_abs_error_m
    values = {
        "roll_rmse_deg": _degrees_or_none(roll.rmse_rad),
        "pitch_rmse_deg": _degrees_or_none(pitch.rmse_rad),
        "overshoot_percent": roll.overshoot_percent,
        "settling_s": roll.settling_time_s,
        "throttle_activity_1_s": effort.throttle_1_s,
        "tilt_activity_deg_s": _degrees_or_none(effort.tilt_rad_s),
        "height_error_m": height,
    }
    return FlownMeasures("", roll.commanded, values)


def _degrees_or_none(value: float | None) -> float | None:
    return None if value is None else degrees(value)


def worse_lines(pairs: Sequence[FlownPair]) -> list[str]:
    """Return a sentence for each flight that fails with designed gains only, and for each worse measure."""
    newly_lost = [pair for pair in pairs if pair.designed.failure and not pair.shipped.failure]
    lines = [f"{WORSE}: {pair.flight} {pair.designed.failure}, which the gains that ship fly" for pair in newly_lost]
    factors_of_pairs = [(pair, pair.worse()) for pair in pairs]
    for key, measure in MEASURES.items():
        hit = [(factors[key], pair) for pair, factors in factors_of_pairs if key in factors]
        if not hit:
            continue
        factor, worst = max(hit, key=lambda entry: entry[0])
        times = f" ({factor:.3g} times)" if factor != inf else ""
        others = [pair.flight for _, pair in hit if pair is not worst]
        also = f"; also in {', '.join(others)}" if others else ""
        lines.append(
            f"{WORSE}: {measure.label} {worst.shipped.cell(key)} -> {worst.designed.cell(key)} "
            f"{measure.unit}{times} in {worst.flight}{also}"
        )
    return lines


def comparison_lines(pairs: Sequence[FlownPair]) -> list[str]:
    """Return the main result of the comparison: which measures are worse, or that none is."""
    if not pairs:
        return []
    lost_flights = [f"{pair.flight} {pair.shipped.failure}" for pair in pairs if pair.shipped.failure]
    shipped_losses = [f"the gains that ship do not fly this engine: {', '.join(lost_flights)}"] if lost_flights else []
    worse = worse_lines(pairs)
    if worse or len(lost_flights) == len(pairs):
        return [*worse, *([WORSE_ADVICE] if worse else []), *shipped_losses]
    return [*shipped_losses, f"as flown nothing is worse than what ships: {', '.join(pair.flight for pair in pairs)}"]


def comparison_columns(pairs: Sequence[FlownPair]) -> list[str]:
    """Return the headings of the table of flights compared with shipped gains."""
    return ["as flown", *(f"{pair.flight}, {which}" for pair in pairs for which in ("shipped", "designed"))]


def comparison_rows(pairs: Sequence[FlownPair]) -> list[list[str]]:
    """Return one row of texts per measure, shipped and designed for each flight."""
    rows = []
    for key, measure in MEASURES.items():
        flights = [measures for pair in pairs for measures in (pair.shipped, pair.designed)]
        if any(measures.values.get(key) is not None for measures in flights):
            rows.append([f"{measure.label}, {measure.unit}", *(_format_measure(measures, key) for measures in flights)])
    return rows


def _format_measure(measures: FlownMeasures, key: str) -> str:
    return "–" if key in STEP_MEASURES and not measures.steps else measures.cell(key)
