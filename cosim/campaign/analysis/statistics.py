"""Shares, pairs and medians of flights, with intervals: pure functions of counts and arrays.

Intervals are two-sided and hold 95 %.  ``scipy.stats``, whose import takes half a second, is imported by what compares
controllers alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, ndtri

from cosim.base.arrays import Array

Counts = NDArray[np.intp]
Interval = tuple[float, float]

LEVEL = 0.95  # confidence of all intervals
Z = float(ndtri(0.5 + LEVEL / 2.0))  # normal quantile for two-sided LEVEL


class Proportion(NamedTuple):
    """A fraction of flights, with the intervals of the probability behind it."""

    hits: int
    of: int
    # Wilson's interval: covers 95 % on average over the probability, not at least.
    wilson: Interval
    exact: Interval  # Clopper-Pearson's: covers at least 95 %

    @property
    def value(self) -> float | None:
        """The fraction, 0 to 1; None without flights."""
        return self.hits / self.of if self.of else None


def proportion(hits: int, of: int) -> Proportion:
    """Return a fraction with both intervals, which are 0 to 1 without flights."""
    if not of:
        return Proportion(hits, of, (0.0, 1.0), (0.0, 1.0))
    low = betaincinv(hits, of - hits + 1, 0.5 - LEVEL / 2.0) if hits else 0.0
    high = betaincinv(hits + 1, of - hits, 0.5 + LEVEL / 2.0) if hits < of else 1.0
    bounds = wilson(np.array([hits]), np.array([of]))
    return Proportion(hits, of, (float(bounds[0][0]), float(bounds[1][0])), (float(low), float(high)))


def widen(interval: Interval, down: float, up: float) -> Interval:
    """Return a probability's interval with its lower end lowered by ``down`` and its upper end raised by ``up``."""
    return max(0.0, interval[0] - down), min(1.0, interval[1] + up)


def wilson(hits: NDArray[np.generic], of: NDArray[np.generic]) -> tuple[Array, Array]:
    """Return the lower and upper ends of the score interval of many fractions at once, 0 to 1 where ``of`` is 0.

    Source: E. B. Wilson, J. Amer. Stat. Assoc. 22 (1927) 209-212: all p with (k/n - p)^2 <= z^2 p (1 - p) / n.
    """
    n = np.maximum(np.asarray(of, dtype=np.float64), 1.0)
    p = np.asarray(hits, dtype=np.float64) / n
    middle = (p + Z**2 / (2.0 * n)) / (1.0 + Z**2 / n)
    half = Z / (1.0 + Z**2 / n) * np.sqrt(p * (1.0 - p) / n + Z**2 / (4.0 * n**2))
    some = np.asarray(of) > 0
    # At 0 and at 1 the ends of the interval are known exactly, and rounding would miss them.
    low = np.where(some & (p > 0.0), np.maximum(middle - half, 0.0), 0.0)
    high = np.where(some & (p < 1.0), np.minimum(middle + half, 1.0), 1.0)
    return low, high


class Pairs(NamedTuple):
    """Outcomes of the same draws under two controllers: how often both, one or neither succeeded."""

    both: int
    first: int  # draws where only the first succeeds
    second: int  # draws where only the second succeeds
    neither: int

    @property
    def draws(self) -> int:
        """Draws that both have flown."""
        return sum(self)

    @property
    def difference(self) -> float | None:
        """The second's fraction of successes less the first's."""
        return (self.second - self.first) / self.draws if self.draws else None


def count_pairs(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Pairs:
    """Count the outcomes of draws, given as one element per draw."""
    counts = np.bincount(2 * first.astype(np.intp) + second, minlength=4)
    return Pairs(int(counts[3]), int(counts[2]), int(counts[1]), int(counts[0]))


def mcnemar(pairs: Pairs) -> float:
    """Return the exact p-value for two controllers that succeed equally often.

    Only draws that they fly differently tell: under the hypothesis each of these is the toss of a coin.
    Source: Q. McNemar, Psychometrika 12 (1947) 153-157, with the binomial distribution itself.
    """
    from scipy import stats

    unlike = pairs.first + pairs.second
    return float(stats.binomtest(pairs.first, unlike).pvalue) if unlike else 1.0


def newcombe(pairs: Pairs) -> Interval | None:
    """Return the interval of the difference of success, second less first, of paired draws; None without draws.

    Both controllers' Wilson limits, put together with the correlation phi of their outcomes, which is lessened towards
    0 where it is positive.  Source: R. G. Newcombe, Statistics in Medicine 17 (1998) 2635-2650, method 10.
    """
    n = pairs.draws
    difference = pairs.difference
    if difference is None:
        return None
    hits = np.array([pairs.both + pairs.second, pairs.both + pairs.first])
    (low, other_low), (high, other_high) = wilson(hits, np.array([n, n]))
    value, other = hits / n
    phi = _phi_coefficient(pairs)
    below, above = value - low, other_high - other
    reach = sqrt(max(below**2 - 2.0 * phi * below * above + above**2, 0.0))
    further, nearer = high - value, other - other_low
    rise = sqrt(max(further**2 - 2.0 * phi * further * nearer + nearer**2, 0.0))
    return max(difference - reach, -1.0), min(difference + rise, 1.0)


def _phi_coefficient(pairs: Pairs) -> float:
    both, first, second, neither = map(float, pairs)
    product = both * neither - first * second
    if product > 0.0:
        product = max(product - pairs.draws / 2.0, 0.0)
    margins = (both + first) * (second + neither) * (both + second) * (first + neither)
    return product / sqrt(margins) if margins else 0.0


def holm(values: Sequence[float]) -> list[float]:
    """Return p-values of several comparisons, corrected for their number (S. Holm, Scand. J. Stat. 6 (1979) 65-70)."""
    adjusted, largest = [1.0] * len(values), 0.0
    for rank, index in enumerate(np.argsort(values, kind="stable")):
        largest = max(largest, min(1.0, (len(values) - rank) * values[index]))
        adjusted[index] = largest
    return adjusted


class MedianDifference(NamedTuple):
    """The difference of a metric of the same draws between two controllers, second less first."""

    draws: int  # draws with the metric under both
    median: float
    interval: Interval | None  # None: with fewer than six draws
    p: float  # Wilcoxon's signed-rank test


def median_difference(differences: Array) -> MedianDifference | None:
    """Return the median of paired differences with interval and p-value; None without differences.

    Its interval is bounded by order statistics, which hold 95 % whatever the distribution is: no resampling needed.
    """
    if not differences.size:
        return None
    from scipy import stats

    confidence = stats.quantile_test(differences, q=0.0, p=0.5).confidence_interval(LEVEL)
    interval = (
        (float(confidence.low), float(confidence.high))
        if np.isfinite([confidence.low, confidence.high]).all()
        else None
    )
    # Where all differences are 0 there is nothing to rank.
    p = float(stats.wilcoxon(differences).pvalue) if np.any(differences) else 1.0
    return MedianDifference(differences.size, float(np.median(differences)), interval, p)


def assign_classes(values: Array, count: int) -> Counts:
    """Return the class of each value, numbered from 0 in order: one per level, or at most ``count`` of equal size."""
    levels, numbers = np.unique(values, return_inverse=True)
    if levels.size > count:
        inner = np.quantile(values, np.linspace(0.0, 1.0, count + 1)[1:-1])
        _, numbers = np.unique(np.searchsorted(inner, values, side="right"), return_inverse=True)
    return numbers.astype(np.intp)
