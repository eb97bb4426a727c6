"""What of a model is wrong: one change after the other is fitted to what the replay does not explain, then two at once.

Each cause is one number (a factor, a delay) or one of a few exchanges (two engines, the sense of an axis).  Numbers
are fitted by Gauss and Newton with differences of whole replays.  Their bounds are by what the windows, each taken for
one observation, disagree on (White, 1982).  Two causes are named where what the best one leaves is more than noise, and
windows that are held back say so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import isfinite
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.signals import Vector3
from hexjet_identify.replay.candidates import Cause, Exchange, Hypothesis, list_exchanges, list_numbers
from hexjet_identify.replay.flown import Model
from hexjet_identify.replay.misfit import MISFIT, MOST, Fitted, Judge, Part, Residuals
from hexjet_identify.replay.windows import Flying

REFINED: Final = 6  # causes that are fitted; the others would remove less
REFINED_PAIRS: Final = 3  # of two numbers, and of an exchange with a number
PROMISING: Final = 0.1  # of the misfit that is removed after two rounds, at least, by what is fitted further
ROUNDS: Final = 4  # of Gauss and Newton
SAME: Final = 0.95  # correlation of two slopes from where on two numbers are one
KNOWN: Final = 1e-3  # of a number's curvature that windows have together, without which the others do not tell it


@dataclass(frozen=True)
class Causes:
    """What was tried: the misfit in squares of the noise, the named ones first, and why none is named."""

    misfit: float
    named: tuple[Fitted, ...]
    tried: tuple[Fitted, ...]
    reason: str
    pairs: tuple[Fitted, ...] = ()  # two at once, where one leaves more than noise

    @property
    def finds_nothing(self) -> bool:
        """Whether no rate or force that moves is off by more than noise."""
        return isfinite(self.misfit) and not self.tried

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {
            "misfit_over_noise_squared": self.misfit if isfinite(self.misfit) else None,
            "named": [fitted.to_dict() for fitted in self.named],
            "tried": [fitted.to_dict() for fitted in self.tried],
            "pairs": [fitted.to_dict() for fitted in self.pairs],
            "reason": self.reason,
        }


class _Slope(NamedTuple):
    """What a number does to the residuals, as differences have it; ``promise`` is what it would remove of them."""

    cause: Cause
    values: Array  # (w, n, c) a unit of the number
    promise: float


def find_causes(model: Model, flying: Flying, wind: Vector3) -> Causes:
    """Fit causes to what a replay leaves, and name the one, or the two, that remove most of it, where the log tells."""
    residuals = Residuals(model, flying, wind)
    nominal = residuals.nominal
    misfit = float(np.mean(nominal**2))
    nominal, told = residuals.balance(nominal)
    if not told.any():
        left = "what is left is as large as the noise" if misfit < MISFIT else "no channel that moves is off"
        return Causes(misfit, (), (), f"{left}: there is nothing to explain")
    exchanges = tuple(list_exchanges(model, flying.flight.throttle))
    return search_causes(residuals, nominal, told, tuple(list_numbers(model)), exchanges, misfit)


def search_causes(
    residuals: Residuals,
    nominal: Array,
    told: Flags,
    numbers: Sequence[Cause],
    exchanges: Sequence[Exchange],
    misfit: float,
) -> Causes:
    """Fit each cause alone, then two at once where the best leaves more than noise, and name what windows bear out.

    ``nominal``: the residuals of the vehicle as stated, (w, n, c); ``told``: the channels that are to be explained.
    """
    search = _Search(residuals, Judge(nominal, told, residuals), numbers)
    slopes = search.slopes(Hypothesis(), nominal)
    singles = [(one, search.fit(one)) for one in (Hypothesis((), each) for each in exchanges)]
    singles += [(one, search.fit(one, nominal)) for one in (Hypothesis((slope.cause,)) for slope in slopes[:REFINED])]
    singles = [(one, fitted) for one, fitted in singles if isfinite(fitted.removed)]
    singles.sort(key=lambda pair: -pair[1].removed)
    tried = tuple(fitted for _, fitted in singles)
    exchanged = next((pair for pair in singles if pair[0].exchange), None)
    found: list[Fitted] = []
    if tried and tried[0].over_noise > MISFIT:
        found = [search.fit(pair) for pair in search.list_pairs(slopes, nominal)]
    if exchanged and exchanged[1].over_noise > MISFIT and exchanged[1].removed > (PROMISING if found else MOST):
        found += [search.fit(pair) for pair in search.list_beside(exchanged[0])]
    pairs = tuple(sorted((one for one in found if isfinite(one.removed)), key=lambda one: -one.removed))
    named, reason = search.judge.name(tried, pairs)
    return Causes(misfit, named, tried[:8], reason, pairs)


class _Search:
    """Fits hypotheses to the residuals of a replay."""

    def __init__(self, residuals: Residuals, judge: Judge, numbers: Sequence[Cause]) -> None:
        self._residuals, self.judge, self._numbers = residuals, judge, numbers

    def slopes(self, base: Hypothesis, left: Array) -> list[_Slope]:
        """Return what each number beside ``base`` does to what that leaves, the most promising first."""
        found = []
        for cause in self._numbers:
            moved = self._residuals.of(replace(base, numbers=(cause,)), (cause.begin + cause.probe,))
            slope = (moved - left) / cause.probe
            power = float(np.sum(slope**2))
            if 0.0 < power < np.inf:
                found.append(_Slope(cause, slope, float(np.sum(slope * left)) ** 2 / power))
        return sorted(found, key=lambda slope: -slope.promise)

    def list_pairs(self, slopes: Sequence[_Slope], nominal: Array) -> Iterator[Hypothesis]:
        """Yield the pairs of numbers that promise most."""
        promises = []
        for one, other in combinations(slopes, 2):
            if abs(_correlation(one.values, other.values)) < SAME:
                stack = np.stack([one.values.ravel(), other.values.ravel()], axis=1)
                solution = np.linalg.lstsq(stack, nominal.ravel(), rcond=None)[0]
                promises.append((float(nominal.ravel() @ (stack @ solution)), (one.cause, other.cause)))
        promises.sort(key=lambda promise: -promise[0])
        yield from (Hypothesis(causes) for _, causes in promises[:REFINED_PAIRS])

    def list_beside(self, exchanged: Hypothesis) -> Iterator[Hypothesis]:
        """Yield an exchange with the numbers that promise most behind it."""
        for slope in self.slopes(exchanged, self._residuals.of(exchanged))[:REFINED_PAIRS]:
            yield replace(exchanged, numbers=(slope.cause,))

    def fit(self, hypothesis: Hypothesis, left: Array | None = None) -> Fitted:
        """Fit the numbers of a hypothesis, from the stated ones on; ``left`` is what these leave, if known."""
        values = np.array(hypothesis.begin)
        left = self._residuals.of(hypothesis, values.tolist()) if left is None else left
        slopes: Array = np.zeros((*left.shape, len(values)))
        for done in range(ROUNDS if hypothesis.numbers else 0):
            slopes = self._slopes_at(hypothesis, values, left)
            normal = np.einsum("wnci,wncj->ij", slopes, slopes)
            if not np.isfinite(normal).all() or np.linalg.matrix_rank(normal) != len(values):
                break
            better = self._step(hypothesis, values, left, -np.linalg.solve(normal, _scores(slopes, left).sum(axis=0)))
            if better is None:
                break
            moved, (values, left) = np.abs(better[0] - values), better
            probes = np.array([cause.probe for cause in hypothesis.numbers])
            if np.all(moved < 0.05 * probes) or (done and self.judge.removed(left) < PROMISING):
                break
        return self._fitted(hypothesis, values, left, slopes)

    def _slopes_at(self, hypothesis: Hypothesis, values: Array, left: Array) -> Array:
        slopes = []
        for n, cause in enumerate(hypothesis.numbers):
            probe = cause.probe if values[n] + cause.probe <= cause.high else -cause.probe
            moved = values.copy()
            moved[n] += probe
            slopes.append((self._residuals.of(hypothesis, moved.tolist()) - left) / probe)
        return np.stack(slopes, axis=-1)

    def _step(self, hypothesis: Hypothesis, values: Array, left: Array, move: Array) -> tuple[Array, Array] | None:
        """Return better numbers and what they leave, by the whole move or a part of it; None where no part is."""
        for part in (1.0, 0.5, 0.25):
            steps = zip(hypothesis.numbers, values.tolist(), (part * move).tolist(), strict=True)
            candidate: Array = np.array([cause.moved(value, by) for cause, value, by in steps])
            after = self._residuals.of(hypothesis, candidate.tolist())
            if float(np.sum(after**2)) < float(np.sum(left**2)):
                return candidate, after
        return None

    def _fitted(self, hypothesis: Hypothesis, values: Array, left: Array, slopes: Array) -> Fitted:
        halves, held_back = bounds(slopes, left), _foretold(slopes, left)
        parts = [Part(hypothesis.exchange.name, "")] if hypothesis.exchange else []
        at_limit = False
        for cause, value, half in zip(hypothesis.numbers, values.tolist(), halves, strict=True):
            parts.append(Part(cause.name, cause.unit, value, half, cause.begin))
            at_limit |= value in (cause.low, cause.high) and value != cause.begin
        return self.judge.fitted(tuple(parts), left, held_back, at_limit)


def _scores(slopes: Array, left: Array) -> Array:
    """Return slopes times residuals of each window, (w, numbers)."""
    return np.asarray(np.einsum("wnci,wnc->wi", slopes, left))


def bounds(slopes: Array, left: Array) -> list[float | None]:
    """Return half of the 95 % interval of each number, each window taken for one observation."""
    from scipy.stats import t

    count, size = len(slopes), slopes.shape[-1]
    normal = np.einsum("wnci,wncj->ij", slopes, slopes)
    if count < 2 or not np.isfinite(normal).all() or np.linalg.matrix_rank(normal) < size:
        return [None] * size
    scores, inverse = _scores(slopes, left), np.linalg.inv(normal)
    spread = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * count / (count - 1.0))
    return [float(t.ppf(0.975, count - 1) * half) for half in spread]


def _foretold(slopes: Array, left: Array) -> Array:
    """Return what is left of each window (w, n, c) with the numbers that the others give: a Newton step from all's.

    A number that the others do not tell foretells nothing; the window counts twice what all together leave of it.
    """
    if not slopes.shape[-1] or not np.isfinite(slopes).all():
        return left
    normals, scores = np.einsum("wnci,wncj->wij", slopes, slopes), _scores(slopes, left)
    whole, total = normals.sum(axis=0), scores.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    held_back = left.copy()
    for window, (normal, score) in enumerate(zip(normals, scores, strict=True)):
        others = (whole - normal) / np.outer(scale, scale)
        if np.linalg.eigvalsh(others)[0] < KNOWN:
            held_back[window] *= np.sqrt(2.0)
            continue
        move = -np.linalg.solve(others, (total - score) / scale) / scale
        held_back[window] += slopes[window] @ move
    return held_back


def _correlation(one: Array, other: Array) -> float:
    return float(np.sum(one * other) / np.sqrt(np.sum(one**2) * np.sum(other**2)))


def without_windows(causes: Causes) -> Causes:
    """Return the causes without what each window says, which is large."""
    empty = np.zeros(0)

    def small(ones: Sequence[Fitted]) -> tuple[Fitted, ...]:
        return tuple(replace(one, windows=empty, held_back=empty) for one in ones)

    return replace(causes, named=small(causes.named), tried=small(causes.tried), pairs=small(causes.pairs))
