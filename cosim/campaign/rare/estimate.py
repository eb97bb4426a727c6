"""From the repeats of a subset simulation to a probability, with an interval that is honest about the method.

The usual interval of one subset simulation takes its chains for less correlated than they are, and is too narrow.  Here
the whole simulation is repeated, each repeat from its own random numbers, and how far the repeats lie apart is what the
method does not know.  Their probabilities are nearly lognormal, so the interval is Cox's of a lognormal mean with
Student's t: y + s^2 / 2 +- t sqrt(s^2 / K + s^4 / (2 (K + 1))) with mean y and variance s^2 of K logarithms (X. H. Zhou
and S. Gao, Statist. Med. 16 (1997) 783-790), the second term with K + 1 because it is unbiased so.  How often it holds
the truth is measured: docs/rare.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, log, log10, sqrt

import numpy as np

from cosim.base.errors import InputError
from cosim.campaign.analysis.statistics import LEVEL, proportion
from cosim.campaign.rare.subset import LEVEL_FRACTION, Repeat

REPEATS = 8  # chosen by us: t of 7 degrees of freedom, and levels that are not too small
CONFIDENCE = LEVEL
SEEDS_DECIDE = 0.5  # of seed_effect: below it noise decides; 0.4 to 0.1 where half of the margin's variance is its
SMALLEST_LEVEL = 50  # flights a level: five starts


@dataclass(frozen=True)
class Budget:
    """What a simulation may take: ``flights`` at most, for probabilities down to ``target``, in ``repeats``."""

    target: float
    flights: int
    repeats: int = REPEATS

    @property
    def most_levels(self) -> int:
        """The levels of a repeat at most: one more than the target needs."""
        return ceil(-log10(self.target) - 1e-9) + 1

    @property
    def size(self) -> int:
        """The flights of a level, in whole tens."""
        return int(self.flights / (self.repeats * (1.0 + (1.0 - LEVEL_FRACTION) * (self.most_levels - 1))) / 10) * 10

    def check(self) -> None:
        """Raise InputError where no level would have enough flights."""
        if self.size < SMALLEST_LEVEL:
            levels = 1.0 + (1.0 - LEVEL_FRACTION) * (self.most_levels - 1)
            raise InputError(
                f"--budget {self.flights}: {self.repeats} repeats of {self.most_levels} levels down to "
                f"{probability_text(self.target)} take at least "
                f"{ceil(self.repeats * levels * SMALLEST_LEVEL):,} flights"
            )


@dataclass(frozen=True)
class Estimate:
    """A probability of failure, and between which two it lies with ``CONFIDENCE``.

    ``probability`` is None where too few repeats met a failure: then ``high`` is an upper bound, at the same
    confidence, and ``low`` 0.  ``method`` says in words how it was made.
    """

    probability: float | None
    low: float
    high: float
    method: str

    @property
    def text(self) -> str:
        """The estimate in words: ``9.1e-6 (95 %: 4.2e-6 to 2.1e-5)``, or ``below 3.1e-7 (95 %)``."""
        if self.probability is None:
            return f"below {probability_text(self.high)} ({CONFIDENCE:.0%})".replace("%", " %")
        interval = f"{probability_text(self.low)} to {probability_text(self.high)}"
        return f"{probability_text(self.probability)} ({100.0 * CONFIDENCE:g} %: {interval})"


def estimate(repeats: Sequence[Repeat]) -> Estimate:
    """Return the probability of failure from the repeats of one simulation."""
    if all(len(repeat.levels) == 1 for repeat in repeats):
        return _counted(repeats)
    logs = [repeat.log_probability for repeat in repeats]
    missing = sum(value is None for value in logs)
    if 2 * missing > len(repeats):
        return _bound(repeats)
    filled = [
        value if value is not None else repeat.log_reached - log(repeat.levels[-1].margins.size)
        for value, repeat in zip(logs, repeats, strict=True)
    ]
    note = (
        f"; {missing} of them met none, and count as one of the flights of their last level, and no upper end is below "
        "what all of them reached"
        if missing
        else ""
    )
    low, high = lognormal_interval(filled)
    if missing:
        high = max(high, _reached_by_all(repeats, CONFIDENCE)[1])
    probability = float(np.mean(np.exp(filled)))
    return Estimate(
        probability,
        min(low, probability),
        min(max(high, probability), 1.0),
        f"{len(repeats)} subset simulations; the interval is that of their mean, by how far they lie apart{note}",
    )


def seed_effect(repeats: Sequence[Repeat]) -> float | None:
    """Return how often a candidate with a new seed is accepted, over how often one with the seed before it is.

    Near 1 where noise and turbulence do not decide.  None where no seed was drawn anew.
    """
    (new, of_new), (same, of_same) = (
        np.sum([getattr(repeat, name) for repeat in repeats], axis=0).tolist() for name in ("redrawn", "kept")
    )
    return (new / of_new) / (same / of_same) if of_new and same else None


def lognormal_interval(logs: Sequence[float], confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return Cox's two-sided interval, with Student's t, of the mean of lognormal numbers from their logarithms."""
    from scipy.special import stdtrit

    count = len(logs)
    mean, variance = float(np.mean(logs)), float(np.var(logs, ddof=1))
    reach = float(stdtrit(count - 1, 0.5 + confidence / 2.0))
    reach *= sqrt(variance / count + variance**2 / (2.0 * (count + 1)))
    return exp(mean + variance / 2.0 - reach), exp(min(mean + variance / 2.0 + reach, 0.0))


def _counted(repeats: Sequence[Repeat]) -> Estimate:
    """Return what counting says where failures are not rare, or all margins the same: every flight is independent."""
    failed, flights = _first_level(repeats)
    if not failed:
        return _counted_bound(repeats)
    method = f"{failed:,} of {flights:,} independent flights failed, counted"
    return Estimate(failed / flights, *proportion(failed, flights).exact, method)


def _counted_bound(repeats: Sequence[Repeat]) -> Estimate:
    """Return the upper bound by counting alone, where margins lead no further."""
    from scipy.special import betaincinv

    failed, flights = _first_level(repeats)
    return Estimate(
        None,
        0.0,
        float(betaincinv(failed + 1, flights - failed, CONFIDENCE)),
        f"{failed:,} of {flights:,} independent flights failed, and their margins lead no further: where all "
        "are the same, nothing says which flight is nearer to failure; a [success] or a requirement with a margin "
        "would",
    )


def _first_level(repeats: Sequence[Repeat]) -> tuple[int, int]:
    """Return how many of the independent flights of all first levels failed, and how many there are."""
    margins = np.concatenate([repeat.levels[0].margins for repeat in repeats])
    return int(np.count_nonzero(margins < 0.0)), margins.size


def _bound(repeats: Sequence[Repeat]) -> Estimate:
    """Return an upper bound: the probability of a margin that every repeat has reached, which no failure exceeds."""
    without = [repeat for repeat in repeats if repeat.log_probability is None]
    if any(len(repeat.levels) == 1 for repeat in without):
        return _counted_bound(repeats)
    reached, high = _reached_by_all(repeats, 2.0 * CONFIDENCE - 1.0)  # whose upper end alone is of CONFIDENCE
    return Estimate(
        None,
        0.0,
        high,
        f"{len(without)} of {len(repeats)} subset simulations met no failure; what all of them reached is a margin of "
        f"{reached:.3g}, and a failure is rarer than that",
    )


def _reached_by_all(repeats: Sequence[Repeat], confidence: float) -> tuple[float, float]:
    """Return a margin that every repeat has reached, and the upper end of the interval of the probability of less."""
    reached = max(_reached(repeat) for repeat in repeats if repeat.log_probability is None)
    logs = [value for repeat in repeats if (value := repeat.log_below(reached)) is not None]
    return reached, lognormal_interval(logs, confidence)[1]


def _reached(repeat: Repeat) -> float:
    """Return the margin that the next level would have begun at, or else the last one did."""
    last = repeat.levels[-1].margins
    margin = float(np.sort(last)[round(LEVEL_FRACTION * last.size)])
    return repeat.levels[-2].threshold if repeat.log_below(margin) is None and len(repeat.levels) > 1 else margin


def probability_text(probability: float) -> str:
    """Format a probability in two digits: ``0.023``, ``9.1e-6``."""
    if probability >= 1e-3:
        return f"{probability:.2g}"
    mantissa, exponent = f"{probability:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"
