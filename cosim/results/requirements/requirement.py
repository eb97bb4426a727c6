"""Requirements on a flight: what each asks for, what a flight comes to, and the list of all that a flight has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import isfinite, nan
from typing import TYPE_CHECKING, Literal, NamedTuple

from cosim.base.arrays import Array
from cosim.base.signals import AXES
from cosim.results.limits import SETTLING_TIME
from cosim.results.metrics import Record
from cosim.results.requirements.grammar import ParsedFormula, parse_formula
from cosim.results.requirements.signals import FlightSignals

if TYPE_CHECKING:
    from cosim.spec.scenario import Range

Source = Literal["require", "limits", "expect", "success"]
# Scaled margins: a flight that failed at its planned end has -LOST, at its start -2 LOST; a requirement that was not
# evaluated is missed by UNKNOWN.
LOST, UNKNOWN = 1.0, 1.0
FLOWN = "flown"  # requirement: flown to the planned end
# Metrics that are the maximum of a signal, which is evaluated row by row instead.
_SIGNALS = {
    **{f"{axis}.max_abs_error_rad": f"abs({axis}_error_rad)" for axis in AXES},
    "altitude.max_abs_error_m": "abs(altitude_error_m)",
    "position.max_abs_error_m": "place_error_m",
    "position.drift_m": "drift_m",
    "speed.max_m_s": "speed_m_s",
}


class FailedFlight(NamedTuple):
    """Time at which a flight failed, and its planned duration [s]."""

    end_s: float
    planned_s: float

    @property
    def scales(self) -> float:
        """Magnitude of the scaled margins: LOST if it failed at its planned end, twice that at the start."""
        share = self.end_s / self.planned_s if self.planned_s > 0.0 else 0.0
        return LOST * (2.0 - min(max(share, 0.0), 1.0))


@dataclass(frozen=True, eq=False)
class Assessment:
    """Result of one requirement on one flight.

    Attributes
    ----------
    margin : float or None
        In the unit of the requirement: positive kept, negative broken; None: the flight does not say.
    kept : bool
        Whether it is kept; what was never tested is not, nor is anything of a flight that was lost.
    decided_at_s : float or None
        The time of the row that the margin comes from; None without a margin, and for metrics of the whole flight.
    decided_by : str
        The comparison that it comes from, as written.
    note : str
        Why there is no margin, or why it is that of a lost flight.
    margin_over_time : Array or None
        The margin of that comparison in every row.
    """

    requirement: Requirement
    margin: float | None
    kept: bool
    decided_at_s: float | None = None
    decided_by: str = ""
    note: str = ""
    margin_over_time: Array | None = None


class Requirement(Record):
    """Requirement on a flight: a formula over its signals."""

    name: str
    formula: str
    source: Source = "require"  # table of the file that states it
    scale: float | None = None  # divides the margin; None: tolerance
    reason: str = ""
    need: bool = True  # False: kept if signals are missing

    @property
    def parsed(self) -> ParsedFormula:
        return parse_formula(self.formula)

    @property
    def names(self) -> list[str]:
        """Names of the signals in the formula, as written."""
        return list(_names_of(self.formula))

    @property
    def unit(self) -> str:
        """Unit of the margin; 1 if the formula mixes units, with each comparison divided by its tolerance."""
        return self.parsed.unit

    @property
    def divisor(self) -> float:
        """Scale by which the margin is divided, in the margin's unit."""
        return self.scale or self.parsed.tolerance or 1.0

    def assess(self, flight: FlightSignals, lost: FailedFlight | None = None) -> Assessment:
        """Assess a flight; if it failed, none of the user's requirements is met."""
        formula = self.parsed.formula
        # A formula of metrics alone, which are equal in all rows.
        whole = flight.metrics.keys() >= _names_of(self.formula).keys() and not any(formula.events)
        flight = flight.one_row() if whole else flight
        value = float(formula.margins(flight)[0]) if flight.rows else nan
        end, latest = flight.rows * flight.step_s, formula.last_relevant_time_s([0.0], flight.times_s)
        if not whole and value >= 0.0 and latest > end + 0.5 * flight.step_s:
            note = f"the flight ends at {end:g} s, before {latest:g} s"
            assessment = Assessment(self, None, kept=False, note=note)
        elif isfinite(value):
            comparison, row, sign = formula.find_decisive_comparison(flight, 0)
            assessment = Assessment(
                self,
                value,
                kept=value >= 0.0,
                decided_at_s=None if whole else row * flight.step_s,
                decided_by=comparison.text,
                margin_over_time=None if whole else sign * comparison.margins(flight),
            )
        else:
            kept = value > 0.0 or not self.need
            note = "" if kept else "the flight has none" if whole else "never tested in this flight"
            assessment = Assessment(self, None, kept, note=note)
        flight.forget()
        if lost is None or self.source not in ("require", "success"):
            return assessment
        return self._assess_failed(assessment, lost)

    def _assess_failed(self, assessment: Assessment, lost: FailedFlight) -> Assessment:
        """Return the assessment of a failed flight: not met, with a lower margin the earlier it failed."""
        most = -lost.scales * self.divisor
        if assessment.margin is not None and assessment.margin < most:
            return assessment
        note = f"lost at {lost.end_s:.2f} s of {lost.planned_s:g} s"
        return replace(assessment, margin=most, kept=False, decided_at_s=lost.end_s, note=note)


@lru_cache(1024)
def _names_of(formula: str) -> dict[str, None]:
    """Return the names of the signals in a formula, in its order."""
    return dict.fromkeys(name for part in parse_formula(formula).formula.comparisons for name in part.names)


def limit_requirements(limits: Mapping[str, float], needed: Iterable[str] = ()) -> list[Requirement]:
    """Return a requirement for each limit of a metric; of those ``needed`` a flight must have a value."""
    wanted, items = set(needed), limits.items()
    return [_make_requirement(name, _limit_formula(name, most), "limits", name in wanted) for name, most in items]


def range_requirements(ranges: Mapping[str, Range], source: Source) -> list[Requirement]:
    """Return a requirement for each allowed range of a metric, of ``[[expect]]`` or of ``[success]``."""
    return [_make_requirement(name, _range_formula(name, allowed), source) for name, allowed in ranges.items()]


@lru_cache(1024)
def _make_requirement(name: str, formula: str, source: Source, need: bool = True) -> Requirement:
    return Requirement(name=name, formula=formula, source=source, need=need)


def _range_formula(name: str, allowed: Range) -> str:
    low, high = allowed.min, allowed.max
    if low is None:
        assert high is not None
        return _limit_formula(name, high)
    return f"{name} >= {low!r}" if high is None else f"{low!r} <= {name} <= {high!r}"


def _limit_formula(name: str, most: float) -> str:
    return f"always({_SIGNALS[name]} <= {most!r})" if name in _SIGNALS else f"{name} <= {most!r}"


class RequirementResult(Record):
    """Result of one requirement in a flight's summary."""

    name: str
    source: Source
    formula: str
    margin: float | None  # None: unknown
    unit: str
    kept: bool
    decided_at_s: float | None = None
    decided_by: str = ""
    note: str = ""
    scale: float  # by which the margin is divided
    reason: str = ""
    need: bool = True

    @classmethod
    def of(cls, assessment: Assessment) -> RequirementResult:
        requirement = assessment.requirement
        return cls(**vars(requirement) | vars(assessment) | {"unit": requirement.unit, "scale": requirement.divisor})

    @property
    def requirement(self) -> Requirement:
        return Requirement(**{name: getattr(self, name) for name in Requirement.model_fields})

    @property
    def scaled(self) -> float | None:
        """Margin divided by the scale; -UNKNOWN if missed without a margin."""
        if self.margin is None:
            return None if self.kept else -UNKNOWN
        return self.margin / self.scale

    def describe(self) -> str:
        """Describe the result: ``holds-roll: kept by 2.1 deg, at 4.51 s: always(abs(roll_deg) < 30)``."""
        if self.margin is None:
            state = self.note or "nothing to keep"
        else:
            unit = "" if self.unit == "1" else f" {self.unit}"
            state = f"{'kept' if self.kept else 'broken'} by {abs(self.margin):.4g}{unit}"
            state += f" ({self.note})" if self.note else ""
        at = "" if self.decided_at_s is None or self.note else f" at {self.decided_at_s:.2f} s"
        return f"{self.name}: {state}{at}: {self.formula}"


def flight_requirements(
    limits: Mapping[str, float], expected: Mapping[str, Range], stated: Sequence[Requirement]
) -> list[Requirement]:
    """Return all requirements of a flight: stated ones, expectations and limits."""
    never_settled = [name for name in limits if name.endswith(SETTLING_TIME)]
    return [*stated, *range_requirements(expected, "expect"), *limit_requirements(limits, never_settled)]


def smallest_margin(results: Sequence[RequirementResult], lost: FailedFlight | None) -> tuple[float | None, str]:
    """Return the smallest scaled margin and its requirement; a failed flight also breaks ``flown``.

    None where nothing has a margin.
    """
    scaled = [(result.scaled, result.name) for result in results if result.scaled is not None]
    return min([*scaled, *([] if lost is None else [(-lost.scales, FLOWN)])], default=(None, ""))
