"""What a proof came to, the one sentence of it that a review board reads first, and what belongs to that."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosim.studies import ClaimResult, Decision, Verdict, format_bound
from hexjet_design.loop.limit import AxisLimit
from hexjet_prove.proof.credibility import Factor

FORMAT = 1  # version of proof.json
LEAST, NEAREST = "among the smallest margins", "fails nearest to the middle of the draws"  # why a flight is shown


@dataclass(frozen=True)
class ProvenRequirement:
    """One requirement on all flights, and the smallest margin."""

    label: str  # R1, R2, ...
    says: str
    broken: int  # flights that missed it
    told: int
    margin: float | None  # smallest, in unit; below 0: missed
    unit: str
    flight: int | None  # flight with the smallest margin


@dataclass(frozen=True)
class WorstFlight:
    """A flight of the campaign that was flown again, recorded in full."""

    flight: int
    why: str  # why this flight is shown
    outcome: str
    reason: str
    margin: float  # margin of the row; below 0: failed
    values: Mapping[str, Any]  # values of the drawn keys
    run: str  # folder of the run; empty: not flown
    is_same: bool  # True: same result as in the campaign
    again: str  # sentence on the repetition


@dataclass(frozen=True)
class Part:
    """A part of a proof by another method: its result, or why it was not done."""

    result: Mapping[str, Any] | None
    says: str  # result in words, or why not done


@dataclass(frozen=True)
class Proof:
    """Proof of a claim.  ``folder`` has proof.json, proof.html, the campaign and the runs."""

    folder: Path
    study: Mapping[str, Any]  # name, scenario, vehicle and seed
    claim: ClaimResult
    referee: Mapping[str, Any]  # JSBSim's check of flights on arrays
    requirements: Sequence[ProvenRequirement]
    uncertainty: Sequence[Mapping[str, Any]]  # key, drawn, nominal, flown, unit, source
    over: str  # population of the probability, in words
    worst: Sequence[WorstFlight]
    likely: Part  # search for the most likely failure
    worst_case: Part  # search for the worst case
    rare: Part  # failure probability by subset simulation
    limits: Mapping[str, AxisLimit | str]  # limit by axis; or why there is none
    axis: str  # axis whose limit the sentence states
    not_varied: Sequence[str]  # kinds of numbers that were never varied
    not_covered: Sequence[str]
    credibility: Sequence[Factor]
    repeat: Mapping[str, Any]  # command, rows_sha256, versions

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the claim; None if no flight was counted."""
        return next(iter(self.claim.verdicts.values()), None)

    @property
    def decision(self) -> Decision:
        """Whether the claim is shown, refuted, or open."""
        return self.verdict.decision if self.verdict is not None and self.claim.is_finished else "open"

    @property
    def sentence(self) -> str:
        """Result in one sentence: who meets what, with which probability, by how many flights."""
        fixed = f"; not varied: {', '.join(self.not_varied)}" if self.not_varied else ""
        return f"{self._claim_clause()}{fixed}."

    @property
    def facts(self) -> dict[str, str]:
        """Additional facts by subject: draws, failures, and the controller compared with the best."""
        return {
            "probability over": self.over,
            **({"rare failures": self.rare.says} if self.rare.result else {}),
            "most likely failure": self._failure_clause(),
            "controller": self._limit_clause(),
        }

    def _claim_clause(self) -> str:
        study = self.study
        who = f"the vehicle {study['aircraft']} with controller {study['controller']} and engine {study['engine']}"
        labels = [one.label for one in self.requirements]
        what = labels[0] if len(labels) == 1 else f"{labels[0]} to {labels[-1]}"
        verdict, confidence = self.verdict, 100.0 * self.claim.claim.confidence
        if verdict is None or not self.claim.is_finished:
            so_far = 0 if verdict is None else verdict.flights
            return f"Nothing can be said yet of whether {who} keeps {what}: {so_far:,} flights are counted"
        all_flown = verdict.flights == study["most_flights"]
        stopped = "all that it was given" if verdict.decision == "open" and all_flown else "stopped by rule"
        flights = (
            f"{verdict.flights:,} flight{'s' if verdict.flights != 1 else ''}, {verdict.failures:,} of them failed"
        )
        if verdict.not_flown:
            flights += f" and {verdict.not_flown:,} not flown to a verdict"
        counted = f"{confidence:g} % confidence, {flights}, {stopped}"
        text = f"{who} keeps {what} with probability {format_bound(verdict)} ({counted})"
        if verdict.decision == "shown":
            return text[0].upper() + text[1:]
        claimed = f"{100.0 * self.claim.claim.probability:g} %"
        begin = f"{claimed} is refuted" if verdict.decision == "refuted" else f"{claimed} is neither shown nor refuted"
        return f"{begin}: {text}"

    def _failure_clause(self) -> str:
        if self.likely.result is not None:
            return self.likely.says
        failed = [one for one in self.worst if one.why.endswith(NEAREST)]
        for one in [*failed, *self.worst]:
            what = "the failed flight nearest to the middle of the draws" if failed else "the flight nearest to failing"
            return f"{what} is {one.run or f'flight {one.flight}'}, and {self.likely.says}"
        return self.likely.says

    def _limit_clause(self) -> str:
        limit = self.limits[self.axis]
        if isinstance(limit, str):
            return f"how far its controller is from the best is not known: {limit}"
        tolerant = limit.times_tolerant
        more = "" if tolerant is None else f", and {tolerant:.2g} times with its tolerance of the delay kept"
        return (
            f"its {self.axis} error after a load is {limit.times:.2g} times the least that any linear controller "
            f"leaves with the same peak sensitivity, noise and step error{more}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the proof as a table for JSON."""
        return {
            "format": FORMAT,
            "sentence": self.sentence,
            "facts": self.facts,
            "decision": self.decision,
            "study": dict(self.study),
            "claim": self.claim.to_dict(),
            "says": list(self.claim.lines()),
            "requirements": [asdict(one) for one in self.requirements],
            "uncertainty": [dict(one) for one in self.uncertainty],
            "over": self.over,
            "worst": [asdict(one) for one in self.worst],
            "most_likely_failure": _part_to_dict(self.likely),
            "worst_case": _part_to_dict(self.worst_case),
            "rare": _part_to_dict(self.rare),
            "limit": {
                axis: {"done": False, "says": limit} if isinstance(limit, str) else {"done": True, **limit.to_dict()}
                for axis, limit in self.limits.items()
            },
            "not_varied": list(self.not_varied),
            "not_covered": list(self.not_covered),
            "credibility": [factor._asdict() for factor in self.credibility],
            "repeat": dict(self.repeat),
        }

    def requirement_rows(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield requirements as texts: label, sentence, flights that missed it, smallest margin."""
        for one in self.requirements:
            margin = (
                "" if one.margin is None else f"{one.margin:.3g} {one.unit} (flight {one.flight})".replace("  ", " ")
            )
            yield one.label, one.says, f"{one.broken} of {one.told}", margin


def _part_to_dict(part: Part) -> dict[str, Any]:
    return {**(part.result or {}), "done": part.result is not None, "says": part.says}
