"""Whether measured margins are enough to fly: each beside its limit, as ``docs/judging.md`` has them, and the worst.

A number is judged by the worse end of its 95 % bounds.  Gain and phase have the limits that the two limits of the peak
sensitivity guarantee upwards, ``|S| / (|S| - 1)`` and ``2 asin(1 / (2 |S|))``; six decibels are those of MIL-F-9490D
too, which has them either way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import asin, degrees, inf, isfinite, log10
from typing import Any, NamedTuple

from cosim.simulation.controllers.controller_file import Requirements
from hexjet_design.measured.axis_margins import AxisMargins
from hexjet_design.measured.estimate import Bounded

# Bands of a margin. Narrow: only for a well-known engine; not told: the margin is outside the measured band.
ENOUGH, NARROW, NOT_MEASURED, TOO_LITTLE = BANDS = ("enough", "narrow", "not told", "too little")
VERDICTS = {  # sentence of each verdict
    ENOUGH: "every margin is enough",
    NARROW: "fly it only with a well-known engine",
    NOT_MEASURED: "the margins are not told",
    TOO_LITTLE: "do not fly on it",
}
MAX_PEAK, MAX_PEAK_KNOWN_ENGINE = 2.0, 2.5  # limits of |S|: usual, well-known engine
CROSSOVER = "crossover_hz"  # judged only if there is none
UNSTABLE_ENGINES = "unstable_engines"  # count among the drawn engines
# Name, unit on a screen, factor to it, and digits of each quantity.
JUDGED = {
    "gain_db": ("gain up", "dB", 1.0, 1),
    "gain_down_db": ("gain down", "dB", 1.0, 1),
    "phase_deg": ("phase, lag", "deg", 1.0, 1),
    "phase_lead_deg": ("phase, lead", "deg", 1.0, 1),
    "delay_s": ("delay, more", "ms", 1e3, 0),
    "delay_less_s": ("delay, less", "ms", 1e3, 0),
    "peak_sensitivity": ("peak |S|", "", 1.0, 2),
    UNSTABLE_ENGINES: ("unstable draws", "", 1.0, 0),
    CROSSOVER: ("crossover", "Hz", 1.0, 3),
}
JUDGED_BY_MAXIMUM = ("peak_sensitivity", UNSTABLE_ENGINES)  # others by a minimum
COLUMNS = ("axis", "margin", "at worst", "limit (narrow)", "judgement", "from")  # heads of the table of judgements


def guaranteed_gain_db(peak: float) -> float:
    """Return the gain margin upwards, dB, that a peak sensitivity guarantees."""
    return 20.0 * log10(peak / (peak - 1.0))


def guaranteed_phase_deg(peak: float) -> float:
    """Return the phase margin, deg, that a peak sensitivity guarantees."""
    return degrees(2.0 * asin(0.5 / peak))


class JudgedMargin(NamedTuple):
    """One margin compared with its limit."""

    axis: str
    margin: str  # one of JUDGED
    value: float | None  # measured; None: not in the band
    worst: float | None  # worse end of its 95 % interval
    limit: float | None  # None: no requirement is known
    known_limit: float | None  # for a well-known engine; None: the same
    band: str | None  # one of BANDS; None: no limit
    source: str  # origin of the limit, or why none

    @property
    def severity(self) -> tuple[int, float]:
        """Order of severity: the band, then limit over value."""
        if self.band is None or self.limit is None or self.worst is None:
            return -1 if self.band is None else BANDS.index(self.band), 0.0
        larger, smaller = abs(self.limit), abs(self.worst)
        if self.margin in JUDGED_BY_MAXIMUM:
            larger, smaller = smaller, larger
        return BANDS.index(self.band), larger / smaller if smaller else inf * larger if larger else 0.0

    def describe(self) -> str:
        """Return name, value and limit: ``roll peak |S| 3.79, limit 2.00 (2.50 with a well-known engine)``."""
        known = "" if self.known_limit is None else f" ({self.format(self.known_limit)} with a well-known engine)"
        limit = "" if self.limit is None else f", limit {self.format(self.limit)}{known}"
        end = self.format(self.worst)
        bound = "" if end == self.format(self.value) else f", by its bounds {end}"
        return f"{self.axis} {JUDGED[self.margin][0]} {self.format(self.value)}{bound}{limit}"

    def format(self, value: float | None) -> str:
        """Return a value as text, in the displayed unit."""
        if value is None:
            return "none"
        _, unit, factor, digits = JUDGED[self.margin]
        return f"{factor * value:.{digits}f} {unit}".strip()

    def cells(self) -> list[str]:
        """Return the margin as a row of texts, under the headings :data:`COLUMNS`."""
        limit = "-" if self.limit is None else self.format(self.limit)
        limit += "" if self.known_limit is None else f" ({self.format(self.known_limit).partition(' ')[0]})"
        name = JUDGED[self.margin][0]
        return [self.axis, name, self.format(self.worst), limit, self.band or "not judged", self.source]

    def to_dict(self) -> dict[str, Any]:
        """Return the margin and its judgement for JSON, in SI, but dB and deg."""
        return {name: value for name, value in self._asdict().items() if name != "axis"}


def judge_axis(measured: AxisMargins) -> list[JudgedMargin]:
    """Return the margins of an axis, judged by their limits."""
    found = measured.response.margins
    rows = []
    if CROSSOVER not in found:
        rows.append(JudgedMargin(measured.axis, CROSSOVER, None, None, None, None, NOT_MEASURED, "widen the band"))
    for name in JUDGED:
        if name in found and name != CROSSOVER:
            rows.append(_judge_margin(measured, name, found[name].value, _worse_end(name, found[name])))
    over = measured.over_engine
    return rows if over is None else [*rows, _judge_margin(measured, UNSTABLE_ENGINES, over.unstable, over.unstable)]


def find_worst(rows: Iterable[JudgedMargin]) -> JudgedMargin:
    """Return the margin that decides the judgement; peak sensitivity is always among them."""
    return max(rows, key=lambda row: row.severity)


def falls_below(rows: Iterable[JudgedMargin], band: str) -> bool:
    """Return whether a margin is worse than a band."""
    return BANDS.index(find_worst(rows).band or ENOUGH) > BANDS.index(band)


def judgement_line(rows: Sequence[JudgedMargin]) -> str:
    """Return a sentence on the worst margin, and how many others are as bad."""
    worst = find_worst(rows)
    others = sum(row.band == worst.band for row in rows) - 1
    more = "" if worst.band in (None, ENOUGH) or not others else f", and {others} more {worst.band}"
    return f"judgement: {VERDICTS[worst.band or ENOUGH]}; worst: {worst.describe()}{more}: docs/judging.md"


def _worse_end(name: str, bounded: Bounded) -> float:
    """Return the worse end of a margin's interval, or its value; beyond 0 there is no margin."""
    if name == "peak_sensitivity":
        end = bounded.high
    else:
        end = min(bounded.high, 0.0) if name == "gain_down_db" else max(bounded.low, 0.0)
    return end if isfinite(bounded.low) else bounded.value


def _judge_margin(measured: AxisMargins, name: str, value: float, worst: float) -> JudgedMargin:
    limit, known, source = _find_limit(name, measured)
    band = None
    if limit is not None:
        sign = -1.0 if name in JUDGED_BY_MAXIMUM else 1.0
        is_kept = [sign * (abs(worst) - abs(each)) >= 0.0 for each in (limit, limit if known is None else known)]
        band = ENOUGH if is_kept[0] else NARROW if is_kept[1] else TOO_LITTLE
    return JudgedMargin(measured.axis, name, value, worst, limit, known, band, source)


def _find_limit(name: str, measured: AxisMargins, deviations: float = 3.0) -> tuple[float | None, float | None, str]:
    """Return the limit, the one for a well-known engine if different, and their origin."""
    if name == "peak_sensitivity":
        return MAX_PEAK, MAX_PEAK_KNOWN_ENGINE, "usual"
    if name in ("gain_db", "gain_down_db"):
        sign = -1.0 if name == "gain_down_db" else 1.0
        limits = [sign * round(guaranteed_gain_db(peak), 1) for peak in (MAX_PEAK, MAX_PEAK_KNOWN_ENGINE)]
        return limits[0], limits[1], "MIL-F-9490D"
    if name in ("phase_deg", "phase_lead_deg"):
        return guaranteed_phase_deg(MAX_PEAK), guaranteed_phase_deg(MAX_PEAK_KNOWN_ENGINE), f"max |S| {MAX_PEAK}"
    if name == UNSTABLE_ENGINES:
        assert measured.over_engine is not None
        return 0.0, None, f"of {measured.over_engine.draws} engines"
    if measured.uncertainty is not None:
        return deviations * measured.uncertainty.delay_s, None, "3 deviations"
    if measured.transport_s is None:
        return None, None, "delay not known"
    need = Requirements()
    step = measured.sine.step
    late = need.delay_samples(measured.transport_s / step) * step
    part = f"{100.0 * need.delay_tolerance:.0f} % of {1e3 * measured.transport_s:.0f} ms"
    return late, None, part if late > step else "a control step"
