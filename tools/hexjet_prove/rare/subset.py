"""Subset simulation: a rare failure as the last of a chain of events that are not rare.

Flights with a margin below a threshold are taken as starts of Markov chains that stay below it; of these, those below
the next threshold start the next chains, and so on until failures, margins below 0, are no longer rare.  The product of
the fractions is the probability (S. K. Au and J. L. Beck, Prob. Eng. Mech. 16 (2001) 263-277).  A threshold is a flight
of its level, and what starts the next is strictly below: so the product is right on average, ties among margins too
(C.-E. Brehier, T. Lelievre and M. Rousset, ESAIM: P&S 19 (2015) 361-394).

A chain's next candidate is one of two kinds, and either leaves the distribution as it is:

- v = sqrt(1 - s^2) u + s z with z standard normal, a correlated step; the sizes s follow the spread of the starts and a
  target of acceptances (I. Papaioannou et al., Prob. Eng. Mech. 41 (2015) 89-103);
- an independent draw of u given that a linear model of the margin, fitted to the level's flights, with normal
  residuals, is below the threshold; accepted by the ratio of what the model misjudges.  Where the margin is nearly
  linear such flights are nearly independent; where the model explains little there are none of these.

The seed of a flight's noise and turbulence is kept or, as often, drawn anew.

Nothing here knows of flights: a repeat is a generator that yields candidates and is sent their margins.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from math import exp, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.studies import draw_seed
from hexjet_prove.rare.groups import Group

Index = np.ndarray[Any, np.dtype[np.int64]]

LEVEL_FRACTION = 0.1  # of flights that start the next level
# Chosen by trials with known probabilities: fraction of candidates drawn by the linear model, and the agreement with
# the level's flights that this needs.
BY_MODEL, LEAST_AGREEMENT = 0.75, 0.3
COORDINATE_DIGITS = 9  # rounded, same on all machines


class Candidates(NamedTuple):
    """Candidates of shape (n, dimension) with their seeds, and their level, from 0."""

    points: Array
    seeds: list[int]
    level: int


@dataclass(frozen=True)
class Level:
    """Margins of a level's flights, all below the previous threshold; numbers as flown.

    ``threshold`` is where the next level begins, 0 in the last one, and ``below`` how many flights are below it: in the
    last one the sum of their ``shares``.
    """

    margins: Array
    numbers: Index  # flight of each state in the repeat
    threshold: float
    below: float
    shares: Array

    @property
    def fraction(self) -> float:
        """Fraction of the level's flights below its threshold."""
        return self.below / self.margins.size


@dataclass(frozen=True)
class Repeat:
    """One complete subset simulation: its levels and number of flights.

    ``redrawn`` and ``kept``: of the candidates with a new seed, and with the one before, those accepted and all.
    """

    levels: tuple[Level, ...]
    flights: int
    redrawn: tuple[int, int] = (0, 0)
    kept: tuple[int, int] = (0, 0)

    @property
    def log_probability(self) -> float | None:
        """Natural logarithm of the failure probability; None without failure."""
        if not self.levels[-1].below:
            return None
        return sum(log(level.fraction) for level in self.levels)

    @property
    def log_reached(self) -> float:
        """Logarithm of the probability to reach the last level."""
        return sum(log(level.fraction) for level in self.levels[:-1])

    def log_below(self, margin: float) -> float | None:
        """Return the log probability of a margin below this one; None if no flight has one."""
        reached = 0.0
        for level in self.levels:
            if level.threshold <= margin or level is self.levels[-1]:
                count = np.count_nonzero(level.margins < margin)
                return reached + log(count / level.margins.size) if count else None
            reached += log(level.fraction)
        return None


class _States:
    """Markov chains' states or a level's flights: points, seeds, margins, shares and the flights' numbers."""

    def __init__(self, points: Array, seeds: Any, margins: Array, shares: Array, numbers: Index) -> None:
        self.points, self.seeds, self.numbers = points, np.array(seeds, dtype=object), numbers
        self.margins, self.shares = margins, shares

    def select(self, index: Index) -> _States:
        """Return a copy of the entries ``index``."""
        return _States(*(values[index] for values in self._columns()))

    def replace(self, index: Index, by: _States) -> None:
        """Replace states at ``index`` by those of another set."""
        for mine, theirs in zip(self._columns(), by._columns(), strict=True):
            mine[index] = theirs[index]

    def _columns(self) -> tuple[Any, ...]:
        return self.points, self.seeds, self.margins, self.shares, self.numbers

    @staticmethod
    def join_states(parts: list[_States]) -> _States:
        return _States(*map(np.concatenate, zip(*(part._columns() for part in parts), strict=True)))


def first_level(dimension: int, size: int, random: np.random.Generator, seed: int | None = None) -> Candidates:
    """Return the independent flights of the first level, with this ``seed`` or one each."""
    points = np.round(random.standard_normal((size, dimension)), COORDINATE_DIGITS)
    return Candidates(points, [draw_seed(random) if seed is None else seed for _ in range(size)], 0)


def subset_simulation(
    first: Candidates,
    flown: Array,
    group: Group,
    size: int,
    most_levels: int,
    random: np.random.Generator,
    seed: int | None = None,
) -> Generator[Candidates, Array, Repeat]:
    """Yield the candidates of one repeat, take their margins, and return its result.

    It goes on from the ``first`` level, whose margins are ``flown``, to failures of the ``group``, by at most
    ``most_levels`` levels in all, each other one with ``size`` flights.  Every candidate has this ``seed``, or its own.
    """
    count, dimension = first.points.shape
    states = _States(first.points, first.seeds, *group.judge(flown), np.arange(count))
    levels: list[Level] = []
    judgements: list[Array] = [np.zeros((0, 2))]  # columns: new seed, accepted
    flights, scale = count, 0.6  # relative spread (Papaioannou et al.)
    target_accepted = 0.44  # acceptance rate (Papaioannou et al.)
    redraw_probability = 0.5  # that a candidate draws a new seed
    while True:
        failed = states.margins < 0.0
        least = round(LEVEL_FRACTION * failed.size)
        threshold = _next_threshold(states.margins, least)
        if np.count_nonzero(failed) >= least or len(levels) + 1 == most_levels or threshold is None:
            below = float(np.sum(states.shares[failed]))
            levels.append(Level(states.margins, states.numbers, 0.0, below, states.shares))
            return Repeat(tuple(levels), flights, *_count_accepted(np.concatenate(judgements)))
        starting = np.flatnonzero(states.margins < threshold)
        levels.append(Level(states.margins, states.numbers, threshold, starting.size, states.shares))
        model = _LinearModel(states, threshold, starting)
        random.shuffle(starting)
        chains = states.select(starting)
        parts = [states.select(starting)]
        spread = np.minimum(1.0, np.std(chains.points, axis=0)) if starting.size > 1 else np.ones(dimension)
        left, steps = size - starting.size, 0
        while left:
            moving, steps = min(starting.size, left), steps + 1
            now = chains.select(np.arange(moving))
            step = np.minimum(1.0, scale * spread)
            normal = random.standard_normal((moving, dimension))
            by_model = random.random(moving) < model.fraction
            candidates: Array = np.where(
                by_model[:, None], model.draw(normal, random), np.sqrt(1.0 - step**2) * now.points + step * normal
            )
            candidates = np.round(candidates, COORDINATE_DIGITS)
            redrawn = random.random(moving) < (redraw_probability if seed is None else 0.0)
            seeds = [draw_seed(random) if new else old for new, old in zip(redrawn, now.seeds, strict=True)]
            margins, shares = group.judge((yield Candidates(candidates, seeds, len(levels))))
            ratio = np.where(by_model, model.log_weight(now.points) - model.log_weight(candidates), 0.0)
            accepted = (margins < threshold) & (np.log1p(-random.random(moving)) <= ratio)
            new = _States(candidates, seeds, margins, shares, flights + np.arange(moving))
            now.replace(np.flatnonzero(accepted), new)
            chains.replace(np.flatnonzero(accepted), new)
            judgements.append(np.stack([redrawn, accepted], axis=1))
            judged = ~redrawn & ~by_model
            if np.any(judged):
                scale = min(scale * exp((float(np.mean(accepted[judged])) - target_accepted) / sqrt(steps)), 10.0)
            parts.append(now)
            flights, left = flights + moving, left - moving
        states = _States.join_states(parts)


def _count_accepted(judgements: Array) -> tuple[tuple[int, int], tuple[int, int]]:
    """Count accepted candidates with a new seed and with the previous one, of how many."""
    redrawn, accepted = judgements.astype(bool).T
    return (
        (int(np.sum(accepted & redrawn)), int(np.sum(redrawn))),
        (int(np.sum(accepted & ~redrawn)), int(np.sum(~redrawn))),
    )


def _next_threshold(margins: Array, count: int) -> float | None:
    """Return the margin above 0 whose rank is closest to ``count``, as a ratio; None without one."""
    values = np.unique(margins)[1:]
    values = values[values > 0.0]
    if not values.size:
        return None
    below = np.searchsorted(np.sort(margins), values, side="left")
    return float(values[int(np.argmin(np.abs(np.log(below / count))))])


class _LinearModel:
    """The margin as c + w u + tau z, z standard normal, fitted to a level's flights by least squares.

    Draws u of the standard normal given that this is below ``threshold``, in closed form: with r^2 = |w|^2 + tau^2 the
    number t = (w u + tau z) / r is standard normal, and given t so is u about w t / r.
    """

    def __init__(self, states: _States, threshold: float, below: Index) -> None:
        points, margins = states.points, states.margins
        count, dimension = points.shape
        self.fraction = 0.0
        if count <= dimension + 1:
            return
        design = np.hstack([np.ones((count, 1)), points])
        ridge = 1e-6 * count * np.diag([0.0, *[1.0] * dimension])
        fitted = np.linalg.solve(design.T @ design + ridge, design.T @ margins)
        residual = margins - design @ fitted
        self._room = threshold - float(fitted[0])
        self._slopes = fitted[1:]
        deviation = sqrt(float(residual @ residual) / (count - dimension - 1))
        self._residual = max(deviation, 1e-3 * float(np.std(margins)))
        self._norm = sqrt(float(self._slopes @ self._slopes) + self._residual**2)
        weights = np.exp(self.log_weight(points))
        select = weights[below]
        # Fraction of the model's weight that is below the threshold, times how evenly it covers the points there.
        agreement = float(np.sum(select)) ** 3 / max(
            float(np.sum(weights)) * below.size * float(select @ select), 1e-300
        )
        self.fraction = BY_MODEL if agreement > LEAST_AGREEMENT else 0.0

    def log_weight(self, points: Array) -> Array:
        """Return the logarithm of the model's probability that the margin at each point is below the threshold."""
        if not hasattr(self, "_slopes"):
            return np.zeros(len(points))
        from scipy.special import log_ndtr

        return np.asarray(log_ndtr((self._room - points @ self._slopes) / self._residual))

    def draw(self, normal: Array, random: np.random.Generator) -> Array:
        """Return one draw per row of standard normal ``normal``, with additions from ``random``."""
        if not self.fraction:
            return normal
        from scipy.special import ndtr, ndtri

        quantiles = ndtr(self._room / self._norm) * (1.0 - random.random(len(normal)))
        along = np.maximum(ndtri(quantiles), -37.0)  # -37 is the last quantile above 0
        length = sqrt(float(self._slopes @ self._slopes))
        direction = self._slopes / (length or 1.0)
        beside = random.standard_normal(len(normal))
        shift = (length * along + self._residual * beside) / self._norm - normal @ direction
        drawn: Array = normal + shift[:, None] * direction
        return drawn
