"""The flights of subset simulations: from coordinates to flights, and from their rows to a result.

What is flown depends on the study and its seed alone, never on who flies it, in what order, or how often it stopped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.spec.controller_name import short_name
from cosim.studies import NormalSpace, Row, Study, describe_not_flown, flight_seed, only_controller, requirement_margins
from hexjet_prove.rare.estimate import MIN_SEED_EFFECT, Budget, Estimate, estimate, probability_text, seed_effect
from hexjet_prove.rare.nearest import NearestSearch, search_nearest
from hexjet_prove.rare.repeats import Place, Simulations, simulate_groups
from hexjet_prove.rare.subset import Candidates
from hexjet_prove.search.probe import Asking, Point, Prober, answer_by

SUBJECT = "a rare failure"  # subject of messages


@dataclass(frozen=True)
class Plan:
    """Options of an estimate: smallest probability, flights, and whether the noise seed varies."""

    budget: Budget
    seeds_vary: bool = True

    def table(self) -> dict[str, Any]:
        return {**asdict(self.budget), "seeds_vary": self.seeds_vary}


@dataclass(frozen=True)
class Failure:
    """A failed flight: its row, coordinates in standard deviations, and share of the probability."""

    number: int
    point: Array
    weight: float

    @property
    def distance(self) -> float:
        """Distance |u| from the middle of the draws, in standard deviations."""
        return float(np.sqrt(np.sum(self.point**2)))


@dataclass(frozen=True)
class KeyShift:
    """Mean and spread of one coordinate in the failures, in standard deviations; 0 and 1 in all flights."""

    name: str
    mean: float
    spread: float


@dataclass(frozen=True)
class RareResult:
    """Result of subset simulations of one controller.

    ``rows`` are those of all candidates in the order in which they were asked for.  The flights of ``searched`` are no
    part of them.
    """

    study: Study
    plan: Plan
    controller: str
    estimate: Estimate
    simulations: Simulations
    searched: NearestSearch
    failures: tuple[Failure, ...]
    rows: tuple[Row, ...]
    names: tuple[str, ...]
    requirements: tuple[str, ...]

    @property
    def flights(self) -> int:
        """Number of flights, including those of the search for the nearest failure."""
        return len(self.rows) + self.searched.flights

    @property
    def groups(self) -> list[list[str]]:
        """Names of the requirements in each group, which share a simulation."""
        return [[self.requirements[column] for column in group.columns] for group in self.simulations.groups]

    @property
    def groups_note(self) -> str:
        """Sentence on requirements that share a simulation; empty with one requirement."""
        if len(self.requirements) == 1:
            return ""
        return f"simulated on its own: {'; '.join(' with '.join(names) for names in self.groups)}"

    @property
    def contradiction(self) -> str:
        """Contradiction between nearest failure and interval; empty if there is none."""
        return self.searched.contradict(self.estimate.high)

    @property
    def search_note(self) -> str:
        """Sentence on the search for the nearest failure; empty if failures were counted."""
        return "" if self.simulations.counted else self.searched.says

    @property
    def not_flown(self) -> list[str]:
        """Reasons of flights that could not be flown, which count as failures."""
        return [str(row["reason"]) for row in self.rows if row["outcome"] == "failed" and not row.get("steps")]

    @property
    def sentence(self) -> str:
        """Result in one sentence."""
        vary = "are" if self.plan.seeds_vary else "are not"
        reasons = self.not_flown
        not_flown = f"; {describe_not_flown(len(reasons), reasons[0])}" if reasons else ""
        return (
            f"{self.study.base().name} with {short_name(self.controller)} fails with a probability of "
            f"{self.estimate.text} after {self.flights:,} flights; seeds of wind and noise {vary} part of what varies"
            f"{not_flown}"
        )

    @property
    def seed_note(self) -> str:
        """Warning if noise and turbulence decide, which chains cannot follow; empty otherwise."""
        effect = seed_effect([repeat for repeats in self.simulations.repeats for repeat in repeats])
        if effect is None or effect >= MIN_SEED_EFFECT:
            return ""
        return (
            f"a flight with another seed stays as near to failure {effect:.2f} times as often as with the same one: "
            "wind and noise decide, no chain leads there, and the interval is wide (docs/campaigns.md)"
        )

    @property
    def shifts(self) -> list[KeyShift]:
        """Position of the failures by coordinate, furthest first; empty without failures."""
        if not self.failures:
            return []
        weights = np.array([failure.weight for failure in self.failures])
        points = np.array([failure.point for failure in self.failures])
        means = weights @ points / weights.sum()
        spreads = np.sqrt(weights @ (points - means) ** 2 / weights.sum())
        squares = means**2 + spreads**2
        return [
            KeyShift(self.names[i], float(means[i]), float(spreads[i])) for i in np.argsort(-squares, kind="stable")
        ]

    @property
    def deciders(self) -> dict[str, float]:
        """Requirements that failures break furthest, with their fractions of the failures, the largest first."""
        parts: dict[str, float] = {}
        for failure in self.failures:
            name = str(self.rows[failure.number].get("decided_by") or "")
            parts[name] = parts.get(name, 0.0) + failure.weight
        parts.pop("", None)  # "": flights that could not be flown
        return dict(sorted(parts.items(), key=lambda part: (-part[1], part[0])))

    @property
    def nearest(self) -> Failure | None:
        """Most likely failure found, of the smallest |u|."""
        return min(self.failures, key=lambda failure: failure.distance, default=None)

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table: options, result, and levels of each repeat."""
        base, nearest = self.study.base(), self.nearest
        return {
            "sentence": self.sentence,
            "study": self.study.name,
            "scenario": base.name,
            "aircraft": base.aircraft_name,
            "engine": base.engine,
            "controller": self.controller,
            "seed": self.study.seed,
            **self.plan.table(),
            **asdict(self.estimate),
            "flights": self.flights,
            "not_flown": len(self.not_flown),
            "seed_effect": seed_effect([repeat for repeats in self.simulations.repeats for repeat in repeats]),
            "failures": len(self.failures),
            "deciders": self.deciders,
            "shifts": [asdict(shift) for shift in self.shifts],
            "nearest": None if nearest is None else self._failure_table(nearest),
            "search": asdict(self.searched),
            "contradiction": self.contradiction,
            "simulations": [
                {
                    "requirements": names,
                    "flights": repeat.flights,
                    "probability": None if (log := repeat.log_probability) is None else float(np.exp(log)),
                    "levels": [
                        {"threshold": level.threshold, "below": level.below, "flights": level.margins.size}
                        for level in repeat.levels
                    ],
                }
                for names, repeats in zip(self.groups, self.simulations.repeats, strict=True)
                for repeat in repeats
            ],
        }

    def _failure_table(self, failure: Failure) -> dict[str, Any]:
        row = self.rows[failure.number]
        return {
            "flight": row["flight"],
            "seed": row["seed"],
            "values": {name: row[name] for name in self.study.drawn},
            "outcome": row["outcome"],
            "reason": row["reason"],
            "distance": failure.distance,
        }


def simulate(plan: Plan, study: Study) -> Asking[RareResult]:
    """Fly a study's subset simulations, and search the nearest failure.

    Raises InputError for a study with more controllers than one or a budget that is too small, FlightError if flights
    cannot be flown.
    """
    controller = only_controller(study, SUBJECT)
    plan.budget.check()
    space = NormalSpace(study)
    flyer = _Flyer(study, space, controller)
    seed = None if plan.seeds_vary else flight_seed(study.seed, 0)
    # Streams 0 and 1 of a study's seed are those of its draws.
    streams = np.random.SeedSequence(study.seed, spawn_key=(2,)).spawn(plan.budget.repeats)
    randoms = [np.random.default_rng(stream) for stream in streams]
    simulations = yield from answer_by(simulate_groups(space.dimension, plan.budget, randoms, seed), flyer.margins)
    left = 0 if simulations.counted else plan.budget.flights - len(flyer.rows)
    searched = yield from search_nearest(space, controller, seed, left, flyer.prober)
    return RareResult(
        study, plan, controller, estimate(simulations.repeats), simulations, searched,
        tuple(flyer.failures(simulations)), tuple(flyer.rows), tuple(space.names), tuple(flyer.requirements),
    )  # fmt: skip


class _Flyer:
    """Requests flights of candidates; ``rows`` are in request order and may repeat."""

    def __init__(self, study: Study, space: NormalSpace, controller: str) -> None:
        self._space, self._controller = space, controller
        self.prober = Prober(study, (0,))
        self.requirements, self._margins_of = requirement_margins(study)
        self.rows: list[Row] = []
        self._points: list[Array] = []
        self._numbers: dict[Place, list[int]] = {}  # row numbers of each simulation

    def margins(self, asked: Mapping[Place, Candidates]) -> Asking[dict[Place, Array]]:
        """Return the margins of candidates, a column a requirement.  Raises FlightError if flights cannot be flown."""
        keys = {
            place: [
                (Point.of(self._controller, values), seed)
                for values, seed in zip(self._space.values(each.points), each.seeds, strict=True)
            ]
            for place, each in asked.items()
        }
        yield from self.prober.fly([key for each in keys.values() for key in each])
        margins = {}
        for place, each in keys.items():
            rows = [self.prober.rows[key] for key in each]
            self._numbers.setdefault(place, []).extend(range(len(self.rows), len(self.rows) + len(rows)))
            self._points += list(asked[place].points)
            self.rows += rows
            margins[place] = np.array([self._margins_of(row) for row in rows])
        return margins

    def failures(self, simulations: Simulations) -> list[Failure]:
        """Return the failed flights of the last levels, each with its part of the probability."""
        weights: dict[int, float] = {}
        for group, repeats in enumerate(simulations.repeats):
            for at, repeat in enumerate(repeats):
                first, last = repeat.levels[0].margins.size, repeat.levels[-1]
                numbers = self._numbers[at, 0][:first] + self._numbers.get((at, group), [])[0 if group else first :]
                each = float(np.exp(repeat.log_reached)) / last.margins.size
                for state in np.flatnonzero(last.margins < 0.0):
                    number = numbers[last.numbers[state]]
                    weights[number] = weights.get(number, 0.0) + each * float(last.shares[state])
        total = sum(weights.values()) or 1.0
        return [Failure(number, self._points[number], weight / total) for number, weight in sorted(weights.items())]


def describe_plan(plan: Plan, groups: int) -> str:
    """Describe what is simulated for so many groups of requirements."""
    budget = plan.budget
    several = "" if groups == 1 else f"in the first, and {budget.size_of(groups)} in every other of each group"
    return (
        f"{budget.repeats} subset simulations of at most {budget.most_levels} levels with {budget.size} flights "
        f"{several or 'each'}, for probabilities down to {probability_text(budget.target)}: {budget.flights:,} flights "
        "at most"
    )
