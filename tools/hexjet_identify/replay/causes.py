"""What of a model is wrong: a table of its numbers, each with the value that explains the flight best.

One flight of the windows with a number a little larger gives its sensitivity, and so its value, its bounds and the
share of the misfit that it removes.  Flights at the value confirm those that promise something.  Cases are flown as
they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.signals import AXES, Vector3
from hexjet_identify.replay.candidates import INERTIA, Candidate, Number, list_candidates
from hexjet_identify.replay.flown import Change, Model
from hexjet_identify.replay.measures import MIN_EXCITATION, MIN_TIME_WITHIN
from hexjet_identify.replay.misfit import COST_CHANNELS, MOMENT, Misfit, Point, Slopes, Step
from hexjet_identify.replay.windows import CHANNELS, CutFlight

# A channel is off above this mean square, in squares of its noise.
MAX_OVER_NOISE: Final = 1.3
# Minimum share of the misfit that a named cause removes.
MIN_REMOVED: Final = 0.5
# Minimum difference over the windows, in standard errors, that is more than chance.
MIN_STANDARD_ERRORS: Final = 3.0


class FittedNumber(NamedTuple):
    """A number as fitted to a flight: stated and best value, and half of its 95 % interval."""

    name: str
    unit: str
    stated: float
    value: float
    bound: float
    off: float

    @property
    def is_told(self) -> bool:
        """Whether the bound is narrow enough to show an error of the size ``off``."""
        return 2.0 * self.bound <= self.off

    @property
    def texts(self) -> tuple[str, str, str]:
        """Stated value, best value and bounds as texts with unit, to the digits that tell the bounds apart."""
        size, unit = _UNITS.get(self.unit, (1.0, f" {self.unit}"))
        value, half = size * self.value, size * self.bound
        digits = max(1 - int(np.floor(np.log10(max(half, 1e-6)))), 0) if isfinite(half) else 2
        ends = f"{value - half:.{digits}f} to {value + half:.{digits}f}"
        return f"{size * self.stated:.4g}{unit}", f"{value:.{digits}f}{unit}", ends

    @property
    def text(self) -> str:
        """The number with its value and bounds."""
        _, value, bounds = self.texts
        return f"{self.name}: {value} (95 %: {bounds})"

    def to_dict(self) -> dict[str, Any]:
        """Return the number for JSON."""
        bound = self.bound if isfinite(self.bound) else None
        return {
            "name": self.name, "unit": self.unit, "stated": self.stated, "value": self.value, "bound_95": bound,
        }  # fmt: skip


# By unit: the factor and the label with which it is shown.
_UNITS: Final = {"": (1.0, " times as stated"), "s": (1e3, " ms"), "m": (1e3, " mm")}


@dataclass(frozen=True)
class CauseRow:
    """A tried cause: a number, numbers fitted together, or a case (no parts), with the misfit that it removes.

    ``windows`` (w,): the misfit of each window; ``over_noise``: of the channel that is left worst, in squares of its
    noise, of one that was not off in what it was; ``fits``: what is left lies in the envelope.
    """

    name: str
    parts: tuple[FittedNumber, ...]
    removed: float
    windows: Array
    over_noise: float
    fits: bool
    changes: float
    at_limit: bool = False

    @property
    def value(self) -> float | None:
        """The best value of a cause with a single number."""
        return self.parts[0].value if len(self.parts) == 1 else None

    @property
    def bound(self) -> float | None:
        """Half of the 95 % interval of that number."""
        return self.parts[0].bound if len(self.parts) == 1 else None

    @property
    def text(self) -> str:
        """The cause with values and bounds, as text."""
        return ", ".join(part.text for part in self.parts) or self.name

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the windows, for JSON."""
        alone = self.parts[0].to_dict() if len(self.parts) == 1 else {"unit": "", "value": None, "bound_95": None}
        return {**alone, "name": self.name, "parts": [part.to_dict() for part in self.parts], "removed": self.removed}


@dataclass(frozen=True)
class Causes:
    """Misfit in squares of the noise, the named causes, all tried ones by what they remove, and why none is named."""

    misfit: float
    named: tuple[CauseRow, ...]
    tried: tuple[CauseRow, ...]
    reason: str
    is_off: bool = False

    @property
    def tells_inertia(self) -> bool:
        """Whether the moment of inertia about one axis is told."""
        return any(row.name.startswith(INERTIA) and row.parts[0].is_told for row in self.tried)

    @property
    def reach(self) -> tuple[list[FittedNumber], list[str]]:
        """Numbers whose error the log would show, and the names of those whose error it would not."""
        parts = [part for row in self.tried for part in row.parts]
        hidden = [part.name for part in parts if not part.is_told]
        hidden += [row.name for row in self.tried if not row.parts and row.changes < MAX_OVER_NOISE - 1.0]
        return [part for part in parts if part.is_told], hidden

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {
            "misfit_over_noise_squared": self.misfit,
            "named": [row.to_dict() for row in self.named],
            "tried": [row.to_dict() for row in self.tried],
            "reason": self.reason,
        }


def find_causes(
    model: Model, flying: CutFlight, wind: Vector3, margins: tuple[Array, Array], most_windows: int = 20
) -> Causes:
    """Fit every number to what a replay leaves, fly every case, and name what explains it.

    ``flying`` starts as suits the vehicle as stated; ``margins`` (w, n, 9) are the envelope's ends beside it.  The
    ``most_windows`` that move most are taken.
    """
    moved = np.nanstd(flying.measured()[:, :, :3] / flying.scale[:3], axis=1).sum(axis=1)
    chosen = np.sort(np.argsort(-moved, kind="stable")[:most_windows]).tolist()
    spread = np.std(flying.starts.moment, axis=0, ddof=1)
    misfit = Misfit(model, flying.only(chosen), wind, np.maximum(spread, 1e-9))
    table = _CauseTable(misfit, (margins[0][chosen], margins[1][chosen]))
    rows = [row for one in list_candidates(model, flying.flight) if (row := table.fit(one)) is not None]
    rows.sort(key=lambda row: -row.removed)
    if not table.told.any():
        return Causes(table.misfit, (), tuple(rows), "no channel that moves is off by more than noise")
    named, reason = name_rows(rows, table.windows)
    return Causes(table.misfit, named, tuple(rows), reason, table.is_off)


class _Trial(NamedTuple):
    """State of a candidate's fit: values, flown point, derivatives by other and its own numbers, and next step.

    ``is_anew``: the slopes are those at the point.
    """

    values: Array
    point: Point
    around: Slopes
    slopes: Array
    step: Step
    is_anew: bool


class _CauseTable:
    """Fits candidates and judges them by windows.  Channels: the sensors, then the costs of moments and zeros."""

    def __init__(self, misfit: Misfit, margins: tuple[Array, Array]) -> None:
        self._misfit, flying = misfit, misfit.flying
        self._margins = [ends[:, :, misfit.present] / flying.scale[misfit.present] for ends in margins]
        around = self._around = misfit.linearise(misfit.nominal)
        step = misfit.solve(misfit.nominal, around)
        off = step.squares.mean(axis=0) / misfit.floor
        measured = flying.measured()[:, :, misfit.present]
        movement = np.std(measured, axis=1) / flying.scale[misfit.present]
        self._moves: Flags = np.mean(movement**2, axis=0) > MIN_EXCITATION**2
        self.told: Flags = off > MAX_OVER_NOISE
        names = [name for (name, _), here in zip(CHANNELS, misfit.present, strict=True) if here]
        self.told[:-COST_CHANNELS] &= self._moves
        self.told[-COST_CHANNELS : -COST_CHANNELS + 3] &= _is_common(flying.starts.moment)
        self.misfit = float(np.mean(misfit.nominal.left**2))
        # If angles alone are off, the attitude is wrong, and not the vehicle.
        self.is_off = bool(self.told[[not name.endswith(AXES) for name in names] + [True] * COST_CHANNELS].any())
        if self.told.any():
            # Each channel counts by the root of its misfit, so that the largest does not hide the others.
            misfit.weights = np.where(self.told, 1.0, 0.2) / np.maximum(1.0, off) ** 0.25
            step = misfit.solve(misfit.nominal, around)
        self._nominal = step.squares
        # A channel that is not off may keep its misfit.
        self._limits = np.maximum(np.where(self.told, 0.0, self._nominal.mean(axis=0)), misfit.floor)
        self._start = misfit.follow(misfit.nominal, step) if self.told.any() else misfit.nominal
        self.windows = self._compute_misfits(misfit.solve(self._start, around).squares)

    def _compute_misfits(self, squares: Array) -> Array:
        """Return the misfit above the noise of each window; channels that are not off count where they get worse."""
        over = squares - np.maximum(np.where(self.told, 0.0, self._nominal), self._misfit.floor)
        return np.asarray(np.maximum(over * self._misfit.weights**2, 0.0).sum(axis=1))

    def _share_removed(self, squares: Array) -> float:
        before = float(np.mean(self.windows))
        return 1.0 - float(np.mean(self._compute_misfits(squares))) / before if before > 0.0 else 0.0

    def fit(self, one: Candidate) -> CauseRow | None:
        """Fit a candidate and return its row; None if it cannot be flown."""
        values = np.array([_to_linear(number, number.stated) for number in one.numbers])
        try:
            point = self._start if one.numbers else self._fly_case(one)
            fit = self._solve(self._misfit, one, values, point, self._around, self._differentiate(one, values, point))
            shift = (point.left - self._start.left)[:, :, self._moves]
            fit, last = self._refine(one, fit)
        except (FlightError, EngineError, InputError):
            return None
        parts, at_limit = [], False
        for number, value, bound in zip(one.numbers, fit.values.tolist(), fit.step.bounds.tolist(), strict=True):
            outward = _from_linear(number, value)
            at_limit |= outward in (number.low, number.high) and outward != number.stated
            half = bound * outward**2 if number.inverse else bound
            parts.append(FittedNumber(number.name, number.unit, number.stated, outward, half, number.off))
        changes = float(np.max(np.mean(shift**2, axis=(0, 1)), initial=0.0))
        worst = float(np.max(last.squares.mean(axis=0) / self._limits))
        return CauseRow(
            one.name, tuple(parts), self._share_removed(last.squares), self._compute_misfits(last.squares),
            worst, self._lies_in_envelope(last.left), changes, at_limit,
        )  # fmt: skip

    def _refine(
        self, one: Candidate, fit: _Trial, promising: float = 0.1, contends: float = 0.3
    ) -> tuple[_Trial, Step]:
        """Return a candidate's best fit, and the misfit there by the table's weights.

        What removes less than the share ``promising`` in a straight line is not flown, unless all is explained and it
        would be off by more than its bounds; what removes less than ``contends`` when it is flown, once.
        """
        misfit, step, is_off = self._misfit, fit.step, self.told.any()
        if not (self._share_removed(step.squares) > promising if is_off else np.any(np.abs(step.values) > step.bounds)):
            return fit._replace(values=fit.values + step.values), step
        fit = self._advance(misfit, one, fit) or fit
        last = misfit.solve(fit.point, fit.around)
        if one.numbers and (not is_off or self._share_removed(last.squares) >= contends):
            fit = self._iterate(misfit, one, fit)
            # Weights of the search hide channels that are told well, once what was off in them is explained.
            left = misfit.solve(fit.point, fit.around).squares
            weighted = misfit.weighted(np.maximum(left.mean(axis=0) / misfit.floor, 1.0) ** -0.5)
            fit = self._solve(weighted, one, fit.values, fit.point, fit.around, fit.slopes, fit.is_anew)
            fit = self._iterate(weighted, one, fit)
            if not fit.is_anew:
                fit = self._solve(weighted, one, fit.values, fit.point, misfit.linearise(fit.point), fit.slopes)
            last = misfit.solve(fit.point, fit.around)
        return fit, last

    def _solve(
        self,
        misfit: Misfit,
        one: Candidate,
        values: Array,
        point: Point,
        around: Slopes,
        slopes: Array,
        is_anew: bool = False,
    ) -> _Trial:
        deviation = np.array([number.deviation for number in one.numbers])
        return _Trial(values, point, around, slopes, misfit.solve(point, around, slopes, deviation), is_anew)

    def _iterate(self, misfit: Misfit, one: Candidate, fit: _Trial, rounds: int = 8) -> _Trial:
        """Iterate until a step is below a tenth of the bounds, or no part of it with new slopes reduces the misfit."""
        for _ in range(rounds):
            moved = self._advance(misfit, one, fit)
            fit = moved or fit
            if (moved is None and fit.is_anew) or np.all(np.abs(fit.step.values) < 0.1 * fit.step.bounds):
                break
            around, slopes = misfit.linearise(fit.point), self._differentiate(one, fit.values, fit.point)
            fit = self._solve(misfit, one, fit.values, fit.point, around, slopes, is_anew=True)
        return fit

    def _fly_case(self, one: Candidate) -> Point:
        """Fly a case, without the windows' moments that had compensated for it."""
        sense, own = np.array(one.sense, float), self._start.own.copy()
        own[:, MOMENT] = -sense[:3] * self._misfit.flying.starts.moment
        return self._misfit.fly(one.case, sense, own, self._start.shared)

    def _differentiate(self, one: Candidate, values: Array, point: Point) -> Array:
        slopes = []
        for n, number in enumerate(one.numbers):
            moved = values.copy()
            outward = _from_linear(number, values[n])
            moved[n] = _to_linear(number, outward + (number.probe if outward < number.high else -number.probe))
            slopes.append(self._misfit.slope(point, _make_change(one, moved), moved[n] - values[n]))
        return np.stack(slopes, axis=-1) if slopes else np.zeros((*point.left.shape, 0))

    def _advance(self, misfit: Misfit, one: Candidate, fit: _Trial) -> _Trial | None:
        """Return the fit after its step or a part of it, slopes unchanged; None if no part reduces the misfit."""
        for part in (1.0, 0.5, 0.25, 0.125):
            tried = (fit.values + part * fit.step.values).tolist()
            values = np.array([_to_linear(n, _from_linear(n, v)) for n, v in zip(one.numbers, tried, strict=True)])
            try:
                point = misfit.follow(fit.point, fit.step, _make_change(one, values), part)
            except (FlightError, EngineError, InputError):
                continue
            # Compare on the rows that both points have.
            known = fit.point.known & point.known
            before, after = (misfit.solve(at, fit.around, known=known).loss for at in (fit.point, point))
            if after < before:
                return self._solve(misfit, one, values, point, fit.around, fit.slopes)
        return None

    def _lies_in_envelope(self, left: Array) -> bool:
        low, high = self._margins
        within = np.mean((left >= low) & (left <= high), axis=(0, 1))
        return bool(np.all(within[self._moves] >= MIN_TIME_WITHIN))


def name_rows(rows: Sequence[CauseRow], misfit: Array) -> tuple[tuple[CauseRow, ...], str]:
    """Return the rows to name as causes, several if they cannot be told apart, and the reason if none is.

    ``rows`` begin with what removes most of the ``misfit`` of each window (w,).
    """
    likely = [row for row in rows if row.removed >= MIN_REMOVED and row.fits and not row.at_limit]
    if not likely:
        return (), _explain_none(rows)
    best = likely[0]
    if _compare_windows(misfit, best.windows, misfit)[1] < MIN_STANDARD_ERRORS:
        return (), f"{best.text} would remove most of it, but the windows do not agree"
    near = [row for row in rows if row is not best and row.removed >= max(MIN_REMOVED, best.removed - 0.15)]
    return (best, *(row for row in near if not _is_apart(row, best, misfit))), ""


def _is_apart(worse: CauseRow, better: CauseRow, misfit: Array) -> bool:
    """Return whether the windows tell the better cause from the worse.

    What leaves more than noise is worse than what leaves no more; else it has to be a twentieth of the misfit, by
    three standard errors.
    """
    if better.over_noise < MAX_OVER_NOISE < worse.over_noise:
        return True
    gain, sure = _compare_windows(worse.windows, better.windows, misfit)
    return gain > 0.05 and sure >= MIN_STANDARD_ERRORS


def _to_linear(number: Number, value: float) -> float:
    """Return a value within its limits, or its inverse, whichever the motion is linear in."""
    value = min(max(value, number.low), number.high)
    return 1.0 / value if number.inverse else value


def _from_linear(number: Number, inward: float) -> float:
    """Return the value within its limits from what the motion is linear in."""
    if number.inverse:
        return number.high if inward <= 1.0 / number.high else max(1.0 / inward, number.low)
    return min(max(inward, number.low), number.high)


def _make_change(one: Candidate, inward: Array) -> Change:
    return one.change(np.array([_from_linear(n, v) for n, v in zip(one.numbers, inward.tolist(), strict=True)]))


def _is_common(moments: Array) -> Flags:
    """Return for each axis whether the windows' moments (w, 3) have a mean beyond chance (p = 0.001)."""
    from scipy.stats import t

    count = len(moments)
    error = np.std(moments, axis=0, ddof=1) / np.sqrt(count)
    return np.asarray(np.abs(moments.mean(axis=0)) > float(t.ppf(0.9995, count - 1)) * error)


def _compare_windows(before: Array, after: Array, misfit: Array) -> tuple[float, float]:
    """Return the mean relative fall of the windows' misfit, and that fall over its standard error.

    Windows with less than a fifth of the mean misfit say nothing; less than two others say nothing either.
    """
    telling = misfit > 0.2 * float(np.mean(misfit))
    if telling.sum() < 2:
        return 0.0, 0.0
    gains = (before - after)[telling] / misfit[telling]
    error = max(float(np.std(gains, ddof=1)), 1e-3) / np.sqrt(len(gains))
    return float(np.mean(gains)), float(np.mean(gains) / error)


def _explain_none(rows: Sequence[CauseRow]) -> str:
    """Return why no cause is named."""
    if not rows:
        return "nothing that was tried can be flown"
    best = rows[0]
    share = f"{best.text} removes {100.0 * max(best.removed, 0.0):.0f} %"
    if best.removed < MIN_REMOVED:
        return f"nothing alone removes half of it, {share}: more at once, or something else"
    if best.at_limit:
        return f"{share}, at the end of what was tried: something else"
    return f"{share}, but what is left is not in the envelope: more at once, or something else"
