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
from dataclasses import dataclass
from math import ceil, log
from typing import Literal, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError

Decision = Literal["shown", "refuted", "open"]
TIMES_FEWEST = 10  # flights of a study that states no number, by the fewest that can show its claim
MAX_TESTED = 1_000_000  # flights: summing over all courses takes seconds then
_EVEN = 0.5  # probability that a draw which two controllers fly differently goes to the first, where they are alike
_SPAN = 1e-12  # smallest and, from 1, largest probability that an interval is looked for between


class Claim(NamedTuple):
    """What is to be shown: a probability of success of each controller, or that the first does better than the second.

    ``pair`` has the two controllers; what is claimed then is that of the draws which only one of them flies with
    success more than half are the first's.
    """

    probability: float
    confidence: float
    pair: tuple[str, str] | None = None

    @property
    def error(self) -> float:
        """The probability that the test says what is not true, one-sided."""
        return 1.0 - self.confidence

    @property
    def fewest(self) -> int:
        """The smallest study that can show the claim: as many flights, and none of them fails."""
        return ceil(log(self.error) / log(self.probability))


def parse_claim(text: str, name: str = "until =") -> Claim:
    """Read ``99.9%@95%``, or ``smith>baseline@95%`` for two controllers.  Raises InputError: one line with ``name``."""
    match = re.fullmatch(r"\s*(?:([0-9.]+)\s*%|(.+?)\s*>\s*(.+?))\s*@\s*([0-9.]+)\s*%\s*", text)
    if match is None:
        raise InputError(
            f"{name} {text}: write it as PROBABILITY%@CONFIDENCE%, such as 99.9%@95%, "
            "or CONTROLLER>CONTROLLER@CONFIDENCE%"
        )
    probability = _EVEN if match[1] is None else _percentage(match[1], 1.0, f"{name} {text}")
    pair = None if match[1] is not None else (match[2], match[3])
    if pair is not None and pair[0] == pair[1]:
        raise InputError(f"{name} {text}: compares {pair[0]} with itself")
    return Claim(probability, _percentage(match[4], 50.0, f"{name} {text}"), pair)


def default_runs(text: str) -> int:
    """Return how many draws a study with this claim has where nobody says it.  Raises InputError as parse_claim."""
    return min(TIMES_FEWEST * parse_claim(text).fewest, MAX_TESTED)


def _percentage(text: str, least: float, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not least <= value < 100.0:
        raise InputError(f"{where}: {text} % must be at least {least:g} and below 100")
    return value / 100.0


@dataclass(frozen=True)
class Verdict:
    """What a study shows of a claim after ``flights``, of which ``failures`` were no success.

    Of a pair ``flights`` counts the draws that only one of the two flew with success, and ``failures`` the second's.
    ``bound`` is one-sided, on the side of the decision and at the claim's confidence: the lower end of the probability
    of success, or the upper end where the claim is refuted; ``interval`` has two sides and holds 95 %.
    """

    decision: Decision
    flights: int
    failures: int
    bound: float
    interval: tuple[float, float]


class SequentialTest:
    """The course of one test: successes and failures are counted in the order of the draws, until it has decided."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim
        self.decision: Decision = "open"
        self._crossed: Decision = "open"  # the boundary that ended it; open: the flights were used up
        self.flights = self.failures = 0
        self._failing = 1.0 - claim.probability
        # of studies that have not ended, by their failures from ``_lowest``, if each flight fails with ``_failing``
        self._going = np.ones(1)
        self._lowest, self._refuted_from = 0, 1
        self._spent = {"shown": 0.0, "refuted": 0.0}
        self._ends: dict[Decision, list[tuple[int, int, float]]] = {"shown": [], "refuted": [], "open": []}

    def add(self, success: bool) -> Decision:
        """Count one more flight and return what is decided; flights after a decision are not counted."""
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
        """Decide by all of the error, now that the study has no more flights."""
        if self.decision == "open" and self.flights:
            if self._highest(self.claim.error) <= self._failing:
                self.decision = "shown"
            elif self._least(self.claim.error) > self._failing:
                self.decision = "refuted"

    def verdict(self) -> Verdict:
        """Return what can be said now."""
        error = self.claim.error
        failing = self._least(error) if self.decision == "refuted" else self._highest(error)
        interval = (1.0 - self._highest(0.025), 1.0 - self._least(0.025))
        return Verdict(self.decision, self.flights, self.failures, 1.0 - failing, interval)

    def _advance(self) -> None:
        """Put every course that a study may take one flight on, and end those that have crossed a boundary."""
        self.flights += 1
        going = np.zeros(self._going.size + 1)
        going[:-1] = self._going * (1.0 - self._failing)
        going[1:] += self._going * self._failing
        error, failures = self.claim.error, self._refuted_from
        if self._spent["refuted"] + going[-1] <= error * failures / (failures + 1):
            self._end("refuted", failures, going[-1])
            going = going[:-1]
        else:
            self._refuted_from += 1
        while going.size and self._spent["shown"] + going[0] <= error * (self._lowest + 1) / (self._lowest + 2):
            self._end("shown", self._lowest, going[0])
            self._lowest, going = self._lowest + 1, going[1:]
        self._going = going

    def _end(self, decision: Decision, failures: int, probability: float) -> None:
        self._spent[decision] += probability
        self._ends[decision].append((self.flights, failures, probability))

    # ---- intervals: studies may end in this order, the best first: shown (the sooner the better), open (by failures),
    # refuted (the later the better).  An end is judged by how probable it and all better or all worse ones are

    def _highest(self, error: float) -> float:
        """Return the highest probability of failure at which an end as good as this one still has ``error``."""
        if self.failures == self.flights and self._crossed != "shown":
            return 1.0
        return self._solve(lambda failing: self._at_most(failing) - error)

    def _least(self, error: float) -> float:
        """Return the least probability of failure at which an end as bad as this one still has ``error``."""
        if self.failures == 0:
            return 0.0
        return self._solve(lambda failing: error - self._at_least(failing))

    def _at_most(self, failing: float) -> float:
        shown = self._probability(self._ends["shown"], failing)
        if self._crossed == "shown":
            return shown
        if self._crossed == "open":
            return shown + self._probability(self._open(range(self._lowest, self.failures + 1)), failing)
        return 1.0 - self._probability(self._ends["refuted"][:-1], failing)

    def _at_least(self, failing: float) -> float:
        refuted = self._probability(self._ends["refuted"], failing)
        if self._crossed == "refuted":
            return refuted
        if self._crossed == "open":
            return refuted + self._probability(self._open(range(self.failures, self._refuted_from)), failing)
        return 1.0 - self._probability([end for end in self._ends["shown"] if end[1] < self.failures], failing)

    def _open(self, failures: range) -> list[tuple[int, int, float]]:
        return [(self.flights, count, float(self._going[count - self._lowest])) for count in failures]

    def _probability(self, ends: list[tuple[int, int, float]], failing: float) -> float:
        """Return how probable the ends are with another probability of failure: their likelihood ratio times theirs."""
        if not ends:
            return 0.0
        flights, failures, probability = (np.array(column) for column in zip(*ends, strict=True))
        exponents: Array = failures * log(failing / self._failing)
        exponents += (flights - failures) * log((1.0 - failing) / (1.0 - self._failing))
        return float(np.sum(np.exp(exponents + np.log(np.maximum(probability, np.finfo(float).tiny)))))

    @staticmethod
    def _solve(function: Callable[[float], float]) -> float:
        from scipy.optimize import brentq  # here: its import takes a third of a second

        return float(brentq(function, _SPAN, 1.0 - _SPAN, xtol=1e-12))


class StoppingRule:
    """Decides when a study may stop, from its flights in any order; only whole draws count, in their order.

    ``controllers`` are those of each draw, in the order of the flights' numbers, and ``draws`` how many the study has.
    With a claim of a probability each controller has its own test, and the study stops when all have decided.
    """

    def __init__(self, claim: Claim, controllers: list[str], draws: int) -> None:
        self.claim = claim
        self._controllers, self._draws = controllers, draws
        names = controllers if claim.pair is None else [" > ".join(claim.pair)]
        self.tests = {name: SequentialTest(claim) for name in names}
        self._counted = 0  # draws
        self._waiting: dict[int, bool] = {}  # success by the number of a flight whose draw is not counted yet

    @property
    def is_decided(self) -> bool:
        """Whether every test has decided, so that no more flights are needed."""
        return all(test.decision != "open" for test in self.tests.values())

    @property
    def is_finished(self) -> bool:
        """Whether no flight is left to count."""
        return self.is_decided or self._counted == self._draws

    def add(self, number: int, success: bool) -> bool:
        """Take in a flight by its number, and return whether the study may stop."""
        self._waiting[number] = success
        while not self.is_finished and (draw := self._next_draw()) is not None:
            self._count(draw)
            self._counted += 1
            if self._counted == self._draws:
                for test in self.tests.values():
                    test.close()
        return self.is_finished

    def _next_draw(self) -> dict[str, bool] | None:
        """Return the successes of the next draw by controller; None while one of its flights is missing."""
        first = self._counted * len(self._controllers)
        numbers = range(first, first + len(self._controllers))
        if any(number not in self._waiting for number in numbers):
            return None
        return {name: self._waiting.pop(number) for name, number in zip(self._controllers, numbers, strict=True)}

    def _count(self, successes: Mapping[str, bool]) -> None:
        """Count one draw."""
        if self.claim.pair is None:
            for name, success in successes.items():
                self.tests[name].add(success)
            return
        first, second = (successes[name] for name in self.claim.pair)
        if first != second:
            next(iter(self.tests.values())).add(first)
