"""What a campaign shows of the claim at which its study stops."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any, NamedTuple

from cosim.campaign.analysis.statistics import widen
from cosim.campaign.study.plan import stopping_rule
from cosim.campaign.study.sequential import Claim, Verdict
from cosim.campaign.workers.flight_row import verdict_of
from cosim.spec.controller_name import short_name

if TYPE_CHECKING:
    from cosim.campaign.store import Campaign

DECISION_WORDS = {"shown": "shown", "refuted": "refuted", "open": "not decided"}  # words on a page for each decision


class ClaimResult(NamedTuple):
    """Result of testing a claim; ``verdicts`` are by controller, or by the compared pair."""

    claim: Claim
    text: str
    is_finished: bool  # False: some flights are still missing
    verdicts: dict[str, Verdict]

    def to_dict(self) -> dict[str, Any]:
        """Return the result for JSON; bounds and interval are null if not known yet."""
        return {
            "claim": self.text,
            "finished": self.is_finished,
            "tests": {
                name: {
                    "decision": verdict.decision, "flights": verdict.flights, "failures": verdict.failures,
                    "not_flown": verdict.not_flown,
                    "bound": verdict.bound if self.is_finished else None,
                    "bound_is": "at most" if verdict.decision == "refuted" else "at least",
                    "confidence": self.claim.confidence,
                    "interval_95": list(verdict.interval) if self.is_finished else None,
                }
                for name, verdict in self.verdicts.items()
            },
        }  # fmt: skip

    def lines(self) -> Iterator[str]:
        """Yield one sentence per controller, or one for the pair."""
        for name, verdict in self.verdicts.items():
            yield f"{name}: {self._describe_verdict(verdict)}"

    def _describe_verdict(self, verdict: Verdict) -> str:
        counted = self._describe_counts(verdict)
        if not self.is_finished and verdict.decision == "open":
            return f"{self.text} is not decided yet: {counted} so far"
        probability = "probability of success" if self.claim.pair is None else "share of these"
        low, high = verdict.interval
        return (
            f"{self.text} is {DECISION_WORDS[verdict.decision]} by {counted}; {probability} {format_bound(verdict)} "
            f"with {100.0 * self.claim.confidence:g} % confidence; the two-sided interval of 95 % confidence is "
            f"{format_percent(low, up=False)} to {format_percent(high, up=True)}"
        )

    def _describe_counts(self, verdict: Verdict) -> str:
        if self.claim.pair is not None:
            won = verdict.flights - verdict.failures - verdict.not_flown
            told = f"{verdict.flights:,} draws that one of the two alone succeeds in, {won:,} of them the first"
        else:
            flights = f"{verdict.flights:,} flight{'s' if verdict.flights != 1 else ''}"
            told = f"{flights} with {verdict.failures:,} failure{'s' if verdict.failures != 1 else ''}"
        return f"{told} and {verdict.not_flown:,} without a verdict" if verdict.not_flown else told


def judge_claim(campaign: Campaign) -> ClaimResult | None:
    """Return the result of testing a campaign's claim on its flights; None if its study has no claim."""
    rule = stopping_rule(campaign.study)
    if rule is None:
        return None
    columns = [campaign.columns.get(name, []) for name in ("flight", "outcome", "success")]
    for number, outcome, success in zip(*columns, strict=True):
        rule.add(int(number or 0), verdict_of(outcome, success))
    verdicts = {short_name(name): test.verdict() for name, test in rule.tests.items() if test.flights}
    for name, (down, up) in campaign.referee.get("rates", {}).items():
        if (verdict := verdicts.get(name)) is not None and (down or up):  # wrong verdicts leave the claim open
            bound, interval = max(0.0, verdict.bound - down), widen(verdict.interval, down, up)
            verdicts[name] = replace(verdict, decision="open", bound=bound, interval=interval)
    return ClaimResult(rule.claim, str(campaign.study.until), rule.is_finished, verdicts)


def format_bound(verdict: Verdict) -> str:
    """Return a verdict's bound of the success probability as text; of an undecided claim, rounded down."""
    if verdict.decision == "open":
        return f"at least {format_percent(verdict.bound, up=False)}"
    return f"at {'most' if verdict.decision == 'refuted' else 'least'} {100.0 * verdict.bound:.12g} %"


def format_interval(ends: Sequence[float]) -> str:
    """Format an interval of a probability: ``99.9996 % to 100.0 %``."""
    return f"{format_percent(ends[0], up=False)} to {format_percent(ends[1], up=True)}"


def format_percent(probability: float, up: bool) -> str:
    """Format a bound of a probability in %, rounded outwards, with two digits of its distance to 0 or 1."""
    rest = min(probability, 1.0 - probability)
    digits = 1 if rest <= 0.0 else max(1, 1 - floor(log10(100.0 * rest)))
    scale = 10.0 ** (digits + 2)
    return f"{(ceil if up else floor)(probability * scale) / scale * 100.0:.{digits}f} %"
