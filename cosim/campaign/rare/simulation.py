"""The flights of subset simulations: from coordinates to rows by any workers, and from rows to a result.

What is flown depends on the study and its seed alone, never on who flies it, in what order, or how often it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.analysis.margin import row_margin
from cosim.campaign.rare.estimate import SEEDS_DECIDE, Budget, Estimate, estimate, probability_text, seed_effect
from cosim.campaign.rare.subset import Candidates, Repeat, subset_simulation
from cosim.campaign.search.line_search import run_together
from cosim.campaign.search.probe import FlownRows, Journal, Point
from cosim.campaign.search.question import Answered
from cosim.campaign.study.draws import flight_seed
from cosim.campaign.study.normal_space import NormalSpace
from cosim.campaign.study.plan import Flight, only_controller
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import Row, describe_not_flown
from cosim.campaign.workers.protocol import Workers
from cosim.spec.controller_name import short_name

ASKED = "a rare failure"
REPEAT_STREAMS = 2  # index of the repeats' random streams of a study's seed, beside those of its draws


@dataclass(frozen=True)
class Plan:
    """What is asked: how rare, in how many flights, and whether the seed of noise and turbulence varies too."""

    budget: Budget
    seeds_vary: bool = True

    def table(self) -> dict[str, Any]:
        """Return the plan as a table."""
        return {**asdict(self.budget), "seeds_vary": self.seeds_vary}


@dataclass(frozen=True)
class Failure:
    """A flight that failed: its number, where it lies in standard deviations, and its part of the probability."""

    number: int
    point: Array
    weight: float

    @property
    def distance(self) -> float:
        """How many standard deviations it lies from the middle of all draws: |u|."""
        return float(np.sqrt(np.sum(self.point**2)))


@dataclass(frozen=True)
class KeyShift:
    """Where one coordinate is in the failures, in standard deviations: mean and spread; 0 and 1 in all flights."""

    name: str
    mean: float
    spread: float


@dataclass(frozen=True)
class RareResult:
    """The result of subset simulations of one controller.

    ``rows`` are all flights in the order in which they were asked for, ``repeat`` and ``level`` of each beside them.
    """

    study: Study
    plan: Plan
    controller: str
    estimate: Estimate
    repeats: tuple[Repeat, ...]
    failures: tuple[Failure, ...]
    rows: tuple[Row, ...]
    names: tuple[str, ...]

    @property
    def flights(self) -> int:
        """How many flights it took."""
        return len(self.rows)

    @property
    def not_flown(self) -> list[str]:
        """Why flights could not be flown at all, which count as failures, a reason each."""
        return [str(row["reason"]) for row in self.rows if row["outcome"] == "failed" and not row.get("steps")]

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
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
        """A warning where noise and turbulence decide, which no chain can lead to failure; empty elsewhere."""
        effect = seed_effect(self.repeats)
        if effect is None or effect >= SEEDS_DECIDE:
            return ""
        return (
            f"a flight with another seed stays as near to failure {effect:.2f} times as often as with the same one: "
            "wind and noise decide, no chain leads there, and the interval is wide (docs/rare.md)"
        )

    @property
    def shifts(self) -> list[KeyShift]:
        """Where the failures lie, the coordinate that they are furthest out in first; nothing without a failure."""
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
        """The requirements that failures break furthest, each with its part of the failures, the largest first."""
        parts: dict[str, float] = {}
        for failure in self.failures:
            name = str(self.rows[failure.number].get("decided_by") or "")
            parts[name] = parts.get(name, 0.0) + failure.weight
        parts.pop("", None)  # of flights that could not be flown
        return dict(sorted(parts.items(), key=lambda part: (-part[1], part[0])))

    @property
    def nearest(self) -> Failure | None:
        """The failure that is most likely of those met: with the smallest |u|."""
        return min(self.failures, key=lambda failure: failure.distance, default=None)

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table: what is asked, what came of it, and each repeat's levels."""
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
            "seed_effect": seed_effect(self.repeats),
            "failures": len(self.failures),
            "deciders": self.deciders,
            "shifts": [asdict(shift) for shift in self.shifts],
            "nearest": None if nearest is None else self._flight_table(nearest),
            "simulations": [
                {
                    "flights": repeat.flights,
                    "probability": None if (log := repeat.log_probability) is None else float(np.exp(log)),
                    "levels": [
                        {"threshold": level.threshold, "below": level.below, "flights": level.margins.size}
                        for level in repeat.levels
                    ],
                }
                for repeat in self.repeats
            ],
        }

    def _flight_table(self, failure: Failure) -> dict[str, Any]:
        row = self.rows[failure.number]
        return {
            "flight": failure.number,
            "seed": row["seed"],
            "values": {name: row[name] for name in self.study.drawn},
            "outcome": row["outcome"],
            "reason": row["reason"],
            "distance": failure.distance,
        }


@dataclass(frozen=True)
class RareCase:
    """A failure flown again from its own scenario file: the folder's name, and whether it is the same bit for bit."""

    name: str
    flight: int
    distance: float  # standard deviations
    seed: int
    values: dict[str, Any]
    reason: str
    same: bool


SavedRare = Answered[RareResult, RareCase]


def simulate(
    study: Study,
    plan: Plan,
    workers: Workers,
    journal: Journal | None = None,
    progress: Callable[[int], None] = lambda flights: None,
) -> RareResult:
    """Fly a study's subset simulations.

    Flights that ``journal`` has are not flown again.  Raises InputError for a study with more controllers than one or
    a budget that is too small, FlightError if flights cannot be flown.
    """
    controller = only_controller(study, ASKED)
    plan.budget.check()
    space = NormalSpace(study)
    flyer = _Flyer(study, space, controller, workers, journal, progress)
    seed = None if plan.seeds_vary else flight_seed(study.seed, 0)
    generators = [
        subset_simulation(space.dimension, plan.budget.size, plan.budget.most_levels, random, seed)
        for random in map(np.random.default_rng, np.random.SeedSequence(study.seed, spawn_key=(REPEAT_STREAMS,)).spawn(
            plan.budget.repeats
        ))
    ]  # fmt: skip
    repeats = list(run_together(dict(enumerate(generators)), flyer.margins).values())
    return RareResult(
        study, plan, controller, estimate(repeats), tuple(repeats), tuple(flyer.failures(repeats)), tuple(flyer.rows),
        tuple(space.names),
    )  # fmt: skip


class _Flyer:
    """Flies candidates, each once, and numbers them in the order in which they were asked for."""

    def __init__(
        self,
        study: Study,
        space: NormalSpace,
        controller: str,
        workers: Workers,
        journal: Journal | None,
        progress: Callable[[int], None],
    ) -> None:
        self._study, self._space, self._controller = study, space, controller
        self._flown = FlownRows(study, workers, journal, progress)
        self.rows: list[Row] = []
        self._points: list[Array] = []
        self._numbers: dict[int, list[int]] = {}  # of each repeat's flights

    def margins(self, asked: Mapping[int, Candidates]) -> dict[int, Array]:
        """Return the margins of the candidates of each repeat.  Raises FlightError if flights cannot be flown."""
        requests: list[tuple[int, int, tuple[Point, int]]] = []  # repeat, level, what is flown
        for repeat, candidates in asked.items():
            self._points += list(candidates.points)
            for values, seed in zip(self._space.values(candidates.points), candidates.seeds, strict=True):
                requests.append((repeat, candidates.level, (Point.of(self._controller, values), seed)))
        self._flown.fly([key for *_, key in requests], _flight)
        margins: dict[int, list[float]] = {repeat: [] for repeat in asked}
        for repeat, level, key in requests:
            row = self._flown.rows[key]
            number = len(self.rows)
            margin = row_margin(row, self._study)
            self.rows.append(
                {**row, "flight": number, "draw": number, "repeat": repeat, "level": level, "margin": margin}
            )
            self._numbers.setdefault(repeat, []).append(number)
            margins[repeat].append(margin)
        return {repeat: np.array(values) for repeat, values in margins.items()}

    def failures(self, repeats: list[Repeat]) -> list[Failure]:
        """Return the failed flights of the last levels, each with its part of the probability."""
        weights: dict[int, float] = {}
        for repeat, numbers in enumerate(self._numbers.values()):
            last = repeats[repeat].levels[-1]
            each = float(np.exp(repeats[repeat].log_reached)) / last.margins.size
            for number in last.numbers[last.margins < 0.0].tolist():
                weights[numbers[number]] = weights.get(numbers[number], 0.0) + each
        total = sum(weights.values()) or 1.0
        return [Failure(number, self._points[number], weight / total) for number, weight in sorted(weights.items())]


def _flight(point: Point, seed: int, number: int) -> Flight:
    return Flight(number, number, point.controller, seed, dict(point.values))


def describe_plan(plan: Plan) -> str:
    """Return what is simulated, in words."""
    budget = plan.budget
    return (
        f"{budget.repeats} subset simulations of at most {budget.most_levels} levels with {budget.size} flights each, "
        f"for probabilities down to {probability_text(budget.target)}: {budget.flights:,} flights at most"
    )
