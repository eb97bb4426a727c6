"""A stopping rule for a study: fly until a probability of success is shown, refuted, or the flights are used up.

A fixed-sample interval that is looked at after each flight, until it says what one hopes for, holds far less than it
states.  The test here counts every look.  Its boundaries are such that a study whose probability of success is exactly
the claimed p ends as "shown" with probability 1 - confidence at most, and as "refuted" likewise; at every lower p
"shown" is rarer still, at every higher p "refuted".  The probabilities are summed over all courses that a study may
take, flight by flight, without approximation.

How the error 1 - confidence = a is spent: "shown" with k failures may take what is left of a (k + 1) / (k + 2),
"refuted" at the k-th failure what is left of a k / (k + 1), and the last flight of the study, whose number is fixed
before the first, what is left of all of a.  Half of it is for studies without a failure: 99.9 % at 95 % is shown by
3,688 flights without one, and by 2,995 where the study has no more than these.

Sources: the spending of an error over looks, K. K. G. Lan and D. L. DeMets, Biometrika 70 (1983) 659-663; intervals by
the order in which a study may end, D. Siegmund, Biometrika 65 (1978) 341-349.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import ceil, log
from typing import Literal, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError

Decision = Literal["shown", "refuted", "open"]
MAX_TESTED = 1_000_000  # flights; their sums take seconds


class Claim(NamedTuple):
    """Claim to be tested: a success rate of each controller, or that the first beats the second.

    ``pair`` has the two controllers; what is claimed then is that of the draws which only one of them flies with
    success more than half are the first's.
    """

    probability: float
    confidence: float
    pair: tuple[str, str] | None = None

    @property
    def error(self) -> float:
        """Probability that the test decides wrongly, one-sided."""
        return 1.0 - self.confidence

    @property
    def fewest(self) -> int:
        """Smallest study that can prove the claim, without any failure."""
        return ceil(log(self.error) / log(self.probability))


def parse_claim(text: str, name: str = "until =") -> Claim:
    """Parse ``99.9%@95%``, or ``smith>baseline@95%`` for two controllers.  Raises InputError with ``name``."""
    match = re.fullmatch(r"\s*(?:([0-9.]+)\s*%|(.+?)\s*>\s*(.+?))\s*@\s*([0-9.]+)\s*%\s*", text)
    if match is None:
        raise InputError(
            f"{name} {text}: write it as PROBABILITY%@CONFIDENCE%, such as 99.9%@95%, "
            "or CONTROLLER>CONTROLLER@CONFIDENCE%"
        )
    # Two controllers that are alike each win half of the draws in which they differ.
    probability = 0.5 if match[1] is None else _parse_percentage(match[1], 1.0, f"{name} {text}")
    pair = None if match[1] is not None else (match[2], match[3])
    if pair is not None and pair[0] == pair[1]:
        raise InputError(f"{name} {text}: compares {pair[0]} with itself")
    return Claim(probability, _parse_percentage(match[4], 50.0, f"{name} {text}"), pair)


def default_runs(text: str) -> int:
    """Return the default number of draws for this claim.  Raises InputError as parse_claim does."""
    # A study that states no number may fly ten times the fewest flights that can prove its claim.
    return min(10 * parse_claim(text).fewest, MAX_TESTED)


def _parse_percentage(text: str, least: float, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not least <= value < 100.0:
        raise InputError(f"{where}: {text} % must be at least {least:g} and below 100")
    return value / 100.0


@dataclass(frozen=True)
class Verdict:
    """Result for a claim after ``flights``, of which ``failures`` were not successful.

    Of a pair ``flights`` counts the draws that only one of the two flew with success, and ``failures`` the second's.
    ``not_flown`` of the flights have no verdict and are no ``failures``.
    ``bound`` has the claim's confidence whichever way the study ended: of a claim that is shown or refuted it is the
    claimed probability itself, the least or the most; else the lower end of the probability of success, one-sided.  A
    bound beyond the claimed one, on the side that the flights chose, would be wrong twice as often as it says.
    ``interval`` has two sides and holds 95 %.
    """

    decision: Decision
    flights: int
    failures: int
    bound: float
    interval: tuple[float, float]
    not_flown: int = 0


class SequentialTest:
    """Sequential test of a claim, which counts successes and failures in the order of draws until it decides."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim
        self.decision: Decision = "open"
        self._crossed: Decision = "open"  # "open": flights ran out first
        self.flights = self.failures = 0
        self._failing = 1.0 - claim.probability
        # Probability of each number of failures, from ``_lowest`` on, of running studies, at ``_failing``.
        self._going = np.ones(1)
        self._lowest, self._refuted_from = 0, 1
        self._spent = {"shown": 0.0, "refuted": 0.0}
        self._ends: dict[Decision, list[tuple[int, int, float]]] = {"shown": [], "refuted": [], "open": []}

    def add(self, success: bool) -> Decision:
        """Count one more flight and return the decision; flights after a decision are ignored."""
        if self.decision != "open":
            return self.decision
        self._advance()
        self.failures += not success
        if self.failures < self._lowest:
            self.decision = self._crossed = "shown"
        elif self.failures >= self._refuted_from:
            self.decision = self._crossed = "refuted"
        return self.decision

    def close(self) -> None:
        """Decide with all of the allowed error, as the study has no more flights."""
        if self.decision == "open" and self.flights:
            if self._upper_failure_bound(self.claim.error) <= self._failing:
                self.decision = "shown"
            elif self._lower_failure_bound(self.claim.error) > self._failing:
                self.decision = "refuted"

    def lower_end(self) -> float:
        """Return the lower end of the probability of success, one-sided, at the claim's confidence."""
        return 1.0 - self._upper_failure_bound(self.claim.error)

    def interval(self) -> tuple[float, float]:
        """Return the two-sided interval of 95 % of the probability of success."""
        return 1.0 - self._upper_failure_bound(0.025), 1.0 - self._lower_failure_bound(0.025)

    def _advance(self) -> None:
        """Advance all possible courses of a study by one flight, and end those that crossed a boundary."""
        self.flights += 1
        going = np.zeros(self._going.size + 1)
        going[:-1] = self._going * (1.0 - self._failing)
        going[1:] += self._going * self._failing
        error, failures = self.claim.error, self._refuted_from
        if self._spent["refuted"] + going[-1] <= error * failures / (failures + 1):
            self._record_ending("refuted", failures, going[-1])
            going = going[:-1]
        else:
            self._refuted_from += 1
        while going.size and self._spent["shown"] + going[0] <= error * (self._lowest + 1) / (self._lowest + 2):
            self._record_ending("shown", self._lowest, going[0])
            self._lowest, going = self._lowest + 1, going[1:]
        self._going = going

    def _record_ending(self, decision: Decision, failures: int, probability: float) -> None:
        self._spent[decision] += probability
        self._ends[decision].append((self.flights, failures, probability))

    # Intervals order the endings from best to worst: shown (sooner is better), open (by failures), refuted (later is
    # better). At a bound this ending and all better, or all worse, ones have the probability ``error``.

    def _upper_failure_bound(self, error: float) -> float:
        """Return the largest failure probability at which an ending as good as this has the probability ``error``."""
        if self.failures == self.flights and self._crossed != "shown":
            return 1.0
        return self._find_root(lambda failing: self._probability_of_ending_as_good(failing) - error)

    def _lower_failure_bound(self, error: float) -> float:
        """Return the smallest failure probability at which an ending as bad as this has the probability ``error``."""
        if self.failures == 0:
            return 0.0
        return self._find_root(lambda failing: error - self._probability_of_ending_as_bad(failing))

    def _probability_of_ending_as_good(self, failing: float) -> float:
        shown = self._ends_probability(self._ends["shown"], failing)
        if self._crossed == "shown":
            return shown
        if self._crossed == "open":
            return shown + self._ends_probability(self._open_ends(range(self._lowest, self.failures + 1)), failing)
        return 1.0 - self._ends_probability(self._ends["refuted"][:-1], failing)

    def _probability_of_ending_as_bad(self, failing: float) -> float:
        refuted = self._ends_probability(self._ends["refuted"], failing)
        if self._crossed == "refuted":
            return refuted
        if self._crossed == "open":
            return refuted + self._ends_probability(self._open_ends(range(self.failures, self._refuted_from)), failing)
        return 1.0 - self._ends_probability([end for end in self._ends["shown"] if end[1] < self.failures], failing)

    def _open_ends(self, failures: range) -> list[tuple[int, int, float]]:
        return [(self.flights, count, float(self._going[count - self._lowest])) for count in failures]

    def _ends_probability(self, ends: list[tuple[int, int, float]], failing: float) -> float:
        """Return the probability of endings if flights fail with probability ``failing``, by likelihood ratios."""
        if not ends:
            return 0.0
        flights, failures, probability = (np.array(column) for column in zip(*ends, strict=True))
        exponents: Array = failures * log(failing / self._failing)
        exponents += (flights - failures) * log((1.0 - failing) / (1.0 - self._failing))
        return float(np.sum(np.exp(exponents + np.log(np.maximum(probability, np.finfo(float).tiny)))))

    @staticmethod
    def _find_root(function: Callable[[float], float]) -> float:
        from scipy.optimize import brentq  # importing scipy takes 0.3 s

        return float(brentq(function, 1e-12, 1.0 - 1e-12, xtol=1e-12))


class ClaimTest:
    """Test of a claim with flights that have no verdict, which count against either decision.

    Such a flight is a failure in the course that may show the claim, and a success in the one that may refute it.
    """

    def __init__(self, claim: Claim) -> None:
        # Both are one test until the first flight without a verdict.
        self._worst = self._best = SequentialTest(claim)
        self.flights = self.failures = self.not_flown = 0

    @property
    def decision(self) -> Decision:
        """Decision on the claim: shown if the worst course shows it, refuted if the best course refutes it."""
        return "shown" if self._worst.decision == "shown" else "refuted" if self._best.decision == "refuted" else "open"

    @property
    def is_finished(self) -> bool:
        """Whether further flights are irrelevant: decided, or neither decision can be reached any more."""
        return self.decision != "open" or "open" not in (self._worst.decision, self._best.decision)

    def add(self, worst: bool | None, best: bool | None) -> None:
        """Count one more flight in the worst and the best course as success or failure; None: not at all."""
        if self.is_finished or worst is best is None:
            return
        if worst is not best and self._best is self._worst:
            self._best = deepcopy(self._worst)
        self.flights += 1
        self.failures += worst is best is False
        self.not_flown += worst is not best
        for course, success in {id(self._worst): (self._worst, worst), id(self._best): (self._best, best)}.values():
            if success is not None:
                course.add(success)

    def close(self) -> None:
        """Decide with all of the allowed error, as the study has no more flights."""
        for course in (self._worst, self._best):
            course.close()

    def verdict(self) -> Verdict:
        bound = self._worst.lower_end() if self.decision == "open" else self._worst.claim.probability
        interval = (self._worst.interval()[0], self._best.interval()[1])
        return Verdict(self.decision, self.flights, self.failures, bound, interval, self.not_flown)


class StoppingRule:
    """Decides when a study may stop, from its flights in any order; only whole draws count, in their order.

    ``controllers`` are those of each draw, in the order of the flights' numbers, and ``draws`` how many the study has.
    With a claim of a probability each controller has its own test, and the study stops when all have decided.
    """

    def __init__(self, claim: Claim, controllers: list[str], draws: int) -> None:
        self.claim = claim
        self._controllers, self._draws = controllers, draws
        names = controllers if claim.pair is None else [" > ".join(claim.pair)]
        self.tests = {name: ClaimTest(claim) for name in names}
        self._counted = 0  # draws counted so far
        # Success by flight number, of flights whose draw is not yet complete; None: without a verdict.
        self._waiting: dict[int, bool | None] = {}

    @property
    def is_decided(self) -> bool:
        """Whether every test has decided, so that no more flights are needed."""
        return all(test.is_finished for test in self.tests.values())

    @property
    def is_finished(self) -> bool:
        """Whether no flight is left to count."""
        return self.is_decided or self._counted == self._draws

    def add(self, number: int, success: bool | None) -> bool:
        """Count a flight by number, None: without a verdict, and return whether the study may stop."""
        self._waiting[number] = success
        while not self.is_finished and (draw := self._next_draw()) is not None:
            self._count(draw)
            self._counted += 1
            if self._counted == self._draws:
                for test in self.tests.values():
                    test.close()
        return self.is_finished

    def _next_draw(self) -> dict[str, bool | None] | None:
        """Return the successes of the next draw by controller; None while one of its flights is missing."""
        first = self._counted * len(self._controllers)
        numbers = range(first, first + len(self._controllers))
        if any(number not in self._waiting for number in numbers):
            return None
        return {name: self._waiting.pop(number) for name, number in zip(self._controllers, numbers, strict=True)}

    def _count(self, successes: Mapping[str, bool | None]) -> None:
        if self.claim.pair is None:
            for name, success in successes.items():
                self.tests[name].add(success is True, success is not False)
            return
        first, second = (successes[name] for name in self.claim.pair)
        worst, best = (first is True, second is not False), (first is not False, second is True)
        ends = [None if one == other else one for one, other in (worst, best)]
        next(iter(self.tests.values())).add(*ends)
