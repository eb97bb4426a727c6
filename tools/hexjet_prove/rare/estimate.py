"""From the repeats of a subset simulation to a probability, with an interval that is honest about the method.

The usual interval of one subset simulation takes its chains for less correlated than they are, and is too narrow.  Here
the whole simulation is repeated, each repeat from its own random numbers, and how far the repeats lie apart is what the
method does not know.  Their probabilities are nearly lognormal, so the interval is Cox's of a lognormal mean with
Student's t: y + s^2 / 2 +- t sqrt(s^2 / K + s^4 / (2 (K + 1))) with mean y and variance s^2 of K logarithms (X. H. Zhou
and S. Gao, Statist. Med. 16 (1997) 783-790), the second term with K + 1 because it is unbiased so.  How often it holds
the truth is measured: docs/campaigns.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, log, log10, sqrt

import numpy as np

from cosim.base.errors import InputError
from cosim.studies import LEVEL, proportion
from hexjet_prove.rare.subset import LEVEL_FRACTION, Repeat

CONFIDENCE = LEVEL  # confidence of all intervals
# Below this seed_effect noise decides; if noise is half of the margin's variance it is 0.1 to 0.4.
MIN_SEED_EFFECT = 0.5
# Flights per level, with one group of requirements (five starts) and with several (docs/campaigns.md); fraction of all
# flights that several groups leave to the search for the nearest failure.
MIN_LEVEL_FLIGHTS, SMALLEST_OF_SEVERAL, SEARCHED = 50, 20, 0.05


@dataclass(frozen=True)
class Budget:
    """Limits of a simulation: ``flights``, smallest probability ``target``, and ``repeats``."""

    target: float
    flights: int
    repeats: int = 8

    @property
    def most_levels(self) -> int:
        """Largest number of levels of a repeat: one more than the target needs."""
        return ceil(-log10(self.target) - 1e-9) + 1

    @property
    def size(self) -> int:
        """Flights of the first level, in tens, and of each further one with one group."""
        return int(self.flights / (self.repeats * (1.0 + self._later_levels)) / 10) * 10

    def size_of(self, groups: int) -> int:
        """Return the number of flights in each level after the first, for so many groups of requirements."""
        left = (1.0 - SEARCHED) * self.flights - self.repeats * self.size
        return self.size if groups == 1 else int(left / (self.repeats * self._later_levels * groups))

    @property
    def most_groups(self) -> int:
        """Largest number of groups of requirements for which the flights suffice, with a simulation each."""
        enough = self.size_of(2) * 2 // SMALLEST_OF_SEVERAL
        return max(1, enough)

    @property
    def _later_levels(self) -> float:
        """Flights of all further levels, relative to one level."""
        return (1.0 - LEVEL_FRACTION) * (self.most_levels - 1)

    def check(self) -> None:
        """Raise InputError where no level would have enough flights."""
        if self.size < MIN_LEVEL_FLIGHTS:
            least = ceil(self.repeats * (1.0 + self._later_levels) * MIN_LEVEL_FLIGHTS)
            raise InputError(
                f"budget {self.flights}: {self.repeats} repeats of {self.most_levels} levels down to "
                f"{probability_text(self.target)} take at least {least:,} flights"
            )


@dataclass(frozen=True)
class Estimate:
    """A failure probability with its interval of ``CONFIDENCE``.

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


def estimate(simulations: Sequence[Sequence[Repeat]]) -> Estimate:
    """Return the probability of failure from the repeats of each group's simulation.

    A repeat's probability is the sum of those of all groups.  A group of which most repeats met no failure has a bound
    alone, which is added to the upper end.
    """
    if all(len(repeat.levels) == 1 for repeats in simulations for repeat in repeats):
        return _estimate_by_counting(simulations)
    led = [repeats for repeats in simulations if not _has_no_next_level(repeats)]
    met = [repeats for repeats in led if 2 * _missing(repeats) <= len(repeats)]
    if not met:
        return _bound_by_margins(led)
    filled = [[_log_probability(repeat) for repeat in repeats] for repeats in met]
    low, high = lognormal_interval([float(value) for value in np.log(np.sum(np.exp(filled), axis=0))])
    missing = sum(map(_missing, met))
    if missing:
        high = max(high, sum(_reached_by_all(repeats, CONFIDENCE)[1] for repeats in met if _missing(repeats)))
    high += sum(_reached_by_all(repeats, CONFIDENCE)[1] for repeats in led if 2 * _missing(repeats) > len(repeats))
    probability = float(np.mean(np.sum(np.exp(filled), axis=0)))
    return Estimate(
        probability, min(low, probability), min(max(high, probability), 1.0), _method(simulations, led, met, missing)
    )


def _method(simulations: Sequence[object], led: Sequence[object], met: Sequence[Sequence[Repeat]], missing: int) -> str:
    """Describe how an interval was computed."""
    repeats = len(met[0])
    if len(simulations) == 1:
        made = f"{repeats} subset simulations; the interval is that of their mean, by how far they lie apart"
    else:
        made = (
            f"{repeats} subset simulations for each of {len(simulations)} groups of requirements, a flight that breaks "
            "several counted once; the interval is that of the mean of their sums, by how far these lie apart"
        )
    if len(led) > len(met):
        made += f"; {len(led) - len(met)} of the groups met none in most, and their bounds are added to the upper end"
    if missing:
        made += (
            f"; {missing} of them met none, and count as one of the flights of their last level, and no upper end is "
            "below what all of them reached"
        )
    return made


def _has_no_next_level(repeats: Sequence[Repeat]) -> bool:
    """Return whether no flight of the first level failed, and none of its margins begins a next level."""
    return all(len(repeat.levels) == 1 and not repeat.levels[0].below for repeat in repeats)


def _missing(repeats: Sequence[Repeat]) -> int:
    """Return the number of repeats of a simulation in which no flight failed."""
    return sum(repeat.log_probability is None for repeat in repeats)


def _log_probability(repeat: Repeat) -> float:
    """Return the log probability of a repeat; without failures one flight of its last level counts."""
    known = repeat.log_probability
    return repeat.log_reached - log(repeat.levels[-1].margins.size) if known is None else known


def seed_effect(repeats: Sequence[Repeat]) -> float | None:
    """Return the acceptance rate of candidates with a new seed over that with the previous one.

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


def _estimate_by_counting(simulations: Sequence[Sequence[Repeat]]) -> Estimate:
    """Return the fraction of failures among independent flights, if there are many or all margins are equal."""
    failed, flights = _count_first_level(simulations)
    if not failed:
        return _bound_by_counting(simulations)
    method = f"{failed:,} of {flights:,} independent flights failed, counted"
    return Estimate(failed / flights, *proportion(failed, flights).exact, method)


def _bound_by_counting(simulations: Sequence[Sequence[Repeat]]) -> Estimate:
    """Return the upper bound from the number of failures among independent flights alone."""
    from scipy.special import betaincinv

    failed, flights = _count_first_level(simulations)
    return Estimate(
        None,
        0.0,
        float(betaincinv(failed + 1, flights - failed, CONFIDENCE)),
        f"{failed:,} of {flights:,} independent flights failed, and their margins lead no further: where all "
        "are the same, nothing says which flight is nearer to failure; a [success] or a requirement with a margin "
        "would",
    )


def _count_first_level(simulations: Sequence[Sequence[Repeat]]) -> tuple[int, int]:
    """Return the number of failures among the independent flights of all first levels, and of these flights."""
    firsts = [[repeat.levels[0] for repeat in repeats] for repeats in simulations]
    failed = sum(float(np.sum(level.shares[level.margins < 0.0])) for levels in firsts for level in levels)
    return round(failed), sum(level.margins.size for level in firsts[0])


def _bound_by_margins(simulations: Sequence[Sequence[Repeat]]) -> Estimate:
    """Return an upper bound: the probability of a margin that every repeat has reached, above that of failure."""
    if any(len(repeat.levels) == 1 for repeats in simulations for repeat in repeats if not repeat.levels[-1].below):
        return _bound_by_counting(simulations)
    # Upper bounds are added, so each has a smaller error probability, of which the sum is that of the whole.
    confidence = 1.0 - 2.0 * (1.0 - CONFIDENCE) / len(simulations)
    bounds = [_reached_by_all(repeats, confidence) for repeats in simulations]
    reached = ", ".join(f"{margin:.3g}" for margin, _ in bounds)
    several = f" for each of {len(bounds)} groups of requirements" if len(bounds) > 1 else ""
    return Estimate(
        None,
        0.0,
        min(sum(high for _, high in bounds), 1.0),
        f"{sum(map(_missing, simulations))} of {sum(map(len, simulations))} subset simulations{several} met no "
        f"failure; what all of them reached is a margin of {reached}, and a failure is rarer than that",
    )


def _reached_by_all(repeats: Sequence[Repeat], confidence: float) -> tuple[float, float]:
    """Return a margin that all repeats have reached, and the upper bound of the probability of a smaller one."""
    reached = max(_find_reached(repeat) for repeat in repeats if repeat.log_probability is None)
    logs = [value for repeat in repeats if (value := repeat.log_below(reached)) is not None]
    return reached, lognormal_interval(logs, confidence)[1]


def _find_reached(repeat: Repeat) -> float:
    """Return the margin at which the next level would have begun, or else that of the last level."""
    last = repeat.levels[-1].margins
    margin = float(np.sort(last)[round(LEVEL_FRACTION * last.size)])
    return repeat.levels[-2].threshold if repeat.log_below(margin) is None and len(repeat.levels) > 1 else margin


def probability_text(probability: float) -> str:
    """Format a probability in two digits: ``0.023``, ``9.1e-6``."""
    if probability >= 1e-3:
        return f"{probability:.2g}"
    mantissa, exponent = f"{probability:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"
