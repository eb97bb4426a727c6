"""What drives a result, from flights that were drawn for another purpose: pure functions of arrays.

Two measures of each key, neither of which needs a flight of its own:

- The *first-order index*: the share of the result's variance that goes away once the key is known, S = Var(E[y | x]) /
  Var(y) (I. M. Sobol, Math. Comput. Simul. 55 (2001) 271-280).  It is found in classes of the key (K. Pearson's
  correlation ratio), sees effects of any shape, and holds for choices as well as for numbers.
- *Spearman's rank correlation*, and the *partial* one with the other keys' ranks held: the direction of an effect that
  has one.

A key that acts only together with others has an index of 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import atanh, sqrt, tanh

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.analysis.statistics import Counts, Interval, Z, assign_classes


@dataclass(frozen=True)
class KeyEffect:
    """Sensitivity of one result to one varied key."""

    key: str
    index: float  # first-order index, corrected for chance
    interval: Interval
    real: bool  # True: index exceeds the noise floor
    rank: float | None  # Spearman's rank correlation, if numeric
    rank_interval: Interval | None
    partial: float | None  # partial correlation; None for choices


@dataclass(frozen=True)
class Ranking:
    """The keys in the order of their first-order indices."""

    flights: int
    floor: float  # index that chance exceeds in 1 of 20
    effects: list[KeyEffect]

    @property
    def explained(self) -> float:
        """Variance explained by single effects; the rest is joint effects and noise."""
        return min(1.0, sum(effect.index for effect in self.effects if effect.real))


def rank_effects(keys: Mapping[str, Array], choices: Sequence[str], result: Array) -> Ranking | None:
    """Return the effect of each key on ``result``; the keys in ``choices`` are codes without an order.

    None if there are too few flights, or if they all came out alike.
    """
    n = result.size
    # With fewer flights, chance alone gives first-order indices of a quarter.
    min_flights = 30
    if n < min_flights or not keys or np.ptp(result) == 0.0:
        return None
    classed = {key: assign_classes(values, max_classes(n)) for key, values in keys.items()}
    floor = noise_floor(list(classed.values()), result)
    numbers = [key for key in keys if key not in choices]
    ranks = rank_correlations([keys[key] for key in numbers], result)
    directions = dict(zip(numbers, ranks, strict=True))
    effects = [_estimate_effect(key, numbered, result, floor, directions.get(key)) for key, numbered in classed.items()]
    return Ranking(n, floor, sorted(effects, key=lambda effect: -effect.index))


def _estimate_effect(
    key: str, numbered: Counts, result: Array, floor: float, direction: tuple[float, float] | None
) -> KeyEffect:
    index, deviation = first_order(numbered, result)
    interval = (max(0.0, index - Z * deviation), min(1.0, max(0.0, index + Z * deviation)))
    rank, partial = direction or (None, None)
    bounds = None if rank is None else rank_interval(rank, result.size)
    return KeyEffect(key, index, interval, index > floor, rank, bounds, partial)


def max_classes(flights: int) -> int:
    """Return the largest number of classes of a key: enough to follow a curve, each large enough for a mean.

    Of its index a straight line loses 1 / classes^2 to the classes and a wave of m periods (1.8 m / classes)^2; chance
    adds (classes - 1) / flights, of which only the mean can be taken off again.
    """
    return int(np.clip(round(2.0 * flights ** (1.0 / 3.0)), 4, 64))


def first_order(numbered: Counts, result: Array) -> tuple[float, float]:
    """Return the first-order index of a key in classes, and its standard deviation.

    With the variance W within classes and V in all, the index is 1 - W / V, each without bias: T. L. Kelley's epsilon
    squared.  The deviation is that of the index's influence function ((1 - S) t^2 - r^2) / V, t a result's distance
    from the mean and r from its class's; joined by that of the classes' own noise, 2 (classes - 1) (1 - S)^2 / n^2,
    which is all there is where S is 0.
    """
    n = result.size
    counts = np.bincount(numbered)
    within = result - (np.bincount(numbered, result) / counts)[numbered]
    total = result - result.mean()
    variance = float(np.mean(total**2))
    degrees = n - counts.size
    if degrees <= 0 or variance <= 0.0:
        return 0.0, 1.0
    rest = min(1.0, float(np.mean(within**2)) / variance)
    influence = (rest * total**2 - within**2) / variance
    noise = 2.0 * (counts.size - 1) * rest**2 / n**2
    return 1.0 - rest * (n - 1) / degrees, sqrt(float(np.var(influence)) / n + noise)


def noise_floor(classed: Sequence[Counts], result: Array) -> float:
    """Return the first-order index that no key exceeds by chance alone, in 19 of 20 cases.

    The results are shuffled over the draws, which breaks every link to the keys and nothing else, and the largest index
    of all keys is noted, 200 times.
    """
    generator = np.random.default_rng(1)
    n = result.size
    centred = result - result.mean()
    total = float(centred @ centred)
    counts = [np.bincount(numbered) for numbered in classed]
    shuffles = 200
    largest = np.full(shuffles, -np.inf)
    for shuffle in range(shuffles):
        shuffled = generator.permutation(centred)
        for numbered, count in zip(classed, counts, strict=True):
            if n > count.size:
                sums = np.bincount(numbered, shuffled)
                rest = 1.0 - float(np.sum(sums**2 / count)) / total
                largest[shuffle] = max(largest[shuffle], 1.0 - rest * (n - 1) / (n - count.size))
    quantile = 0.95  # quantile of chance's largest index
    return max(0.0, float(np.quantile(largest, quantile, method="higher")))


def joint(first: Array, second: Array, result: Array) -> float:
    """Return the fraction of the variance of ``result`` that two keys explain together, corrected for chance."""
    count = max(2, int(sqrt(max_classes(result.size))) + 1)
    of_first, of_second = assign_classes(first, count), assign_classes(second, count)
    _, numbered = np.unique(of_first * (of_second.max() + 1) + of_second, return_inverse=True)
    return first_order(numbered.astype(np.intp), result)[0]


def rank_correlations(numbers: Sequence[Array], result: Array) -> list[tuple[float, float]]:
    """Return Spearman's rank correlation of each key with the result, and the partial one.

    The partial one follows from the inverse P of the matrix of rank correlations: -P_xy / sqrt(P_xx P_yy).  A key that
    has one value only has neither: 0.
    """
    if not numbers:
        return []
    ranks = np.array([mean_ranks(values) for values in (*numbers, result)])
    ranks -= ranks.mean(axis=1, keepdims=True)
    sizes = np.linalg.norm(ranks, axis=1, keepdims=True)
    ranks /= np.where(sizes > 0.0, sizes, 1.0)
    correlation = ranks @ ranks.T
    np.fill_diagonal(correlation, 1.0)
    inverse = np.linalg.pinv(correlation, hermitian=True)
    scale = np.sqrt(np.clip(np.diag(inverse), 1e-12, None))
    partial = -inverse[:-1, -1] / (scale[:-1] * scale[-1])
    return [
        (float(rank), float(np.clip(value, -1.0, 1.0)))
        for rank, value in zip(correlation[:-1, -1], partial, strict=True)
    ]


def mean_ranks(values: Array) -> Array:
    """Return the ranks of values from 1 on; equal values have the mean of theirs."""
    _, numbers, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = (np.cumsum(counts) - 0.5 * (counts - 1))[numbers]
    return ranks


def rank_interval(rank: float, flights: int) -> Interval:
    """Return the 95 % interval of a rank correlation.

    Source: D. G. Bonett and T. A. Wright, Psychometrika 65 (2000) 23-28: atanh(rank) deviates by
    sqrt((1 + rank^2 / 2) / (n - 3)).
    """
    if abs(rank) >= 1.0:
        return rank, rank
    half = Z * sqrt((1.0 + rank**2 / 2.0) / (flights - 3))
    return tanh(atanh(rank) - half), tanh(atanh(rank) + half)
