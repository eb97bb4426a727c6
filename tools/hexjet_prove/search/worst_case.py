"""The worst case and the most likely failure of a study: a search over all of its varied keys at once.

What a study varies are independent standard normal coordinates (:mod:`cosim.campaign.study.normal_space`), so that the
distance of a flight from the middle of everything is a number of standard deviations.  The worst case is the flight of
least margin within so many of them, or anywhere in the ranges; the most likely failure is the one nearest to the
middle, which first-order reliability calls the design point.  Both have been flown.  That nothing is worse, or nearer,
nobody knows: what is said is in how many flights no such was found.

Noise and turbulence are no coordinate of it: every point is flown with the same seeds, and the smallest margin counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isnan, nan
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.simulation.build import build
from cosim.spec.controller_name import short_name
from cosim.studies import MAX_SIGMA, NOT_FLOWN, NormalSpace, Row, Study, Value, row_margin, scenario_of
from hexjet_prove.search.minimise import Ball, Box, DescentResult, descend
from hexjet_prove.search.probe import Asking, Point, Prober, answer_by
from hexjet_prove.search.search import describe_flight

DEFAULT_WORST_REGION = 3.0  # standard deviations
LIKELY_REGION = 6.0  # beyond: 1e-9 of draws, on each side


@dataclass(frozen=True)
class WorstPlan:
    """Options of a search for the worst case or the most likely failure: region, and number of flights.

    ``within`` is a number of standard deviations; None: the whole range of every key.
    """

    likely: bool = False
    within: float | None = DEFAULT_WORST_REGION
    seeds: tuple[int, ...] = (1,)
    budget: int = 1000  # flights per controller
    seed: int = 1  # seed of the search itself

    def table(self) -> dict[str, Any]:
        return {
            "search": "likely" if self.likely else "worst",
            "within": "ranges" if self.within is None else self.within,
            "seeds": list(self.seeds),
            "budget": self.budget,
            "search_seed": self.seed,
        }

    @property
    def where(self) -> str:
        """Description of the searched region."""
        if self.within is None:
            return "the ranges of all keys"
        return f"{self.within:g} standard deviations of the middle of all keys"


@dataclass(frozen=True)
class KeyEffect:
    """One coordinate of a found point, and its effect.

    ``share`` of the squared distance; ``without``: the margin with this coordinate put back to its middle and all
    others kept; ``alone``: the margin with all others put back.
    """

    name: str
    value: Value | None  # None: of an uncertain engine
    middle: Value | None  # at the middle of its distribution
    place: float  # from nominal: deviations, half ranges
    share: float
    without: float | None  # None: no such flight was made
    alone: float | None


@dataclass(frozen=True)
class WorstCase:
    """Flight found for one controller.

    ``distance`` from the middle in standard deviations; None where the ranges alone were asked for, which have no
    likelihood.
    """

    controller: str
    margin: float
    middle_margin: float | None  # all keys at the middle, if flown
    distance: float | None
    values: Mapping[str, Value]
    seed: int  # seed with the smallest margin there
    flight: int  # its number in the folder
    outcome: str
    reason: str
    effects: tuple[KeyEffect, ...]
    flights: int  # flights of the search
    since: int  # flights since the last improvement
    starts: int  # descents started
    flat: float  # fraction with the most common margin
    impossible: int = 0  # points that no vehicle or scenario has
    impossible_reason: str = ""  # reason of the first of these

    @property
    def fails(self) -> bool:
        """Whether the flight is a failure."""
        return self.margin < 0.0


@dataclass(frozen=True)
class WorstSearch:
    """The result of a search for the worst case or the most likely failure, for every controller."""

    study: Study
    plan: WorstPlan
    cases: tuple[WorstCase, ...]
    flights: int

    def lines(self) -> list[str]:
        """Return what was found, in a sentence or two for each controller."""
        return [_describe_case(self.plan, case) for case in self.cases]

    @property
    def notes(self) -> list[str]:
        """Notes on the evidence, one sentence each."""
        seeds = self.plan.seeds
        many = len(seeds) > 1
        lines = [
            f"noise and turbulence are of the seed{'s' if many else ''} {', '.join(map(str, seeds))} in every flight"
            f"{', and the smallest margin counts' if many else ''}: they are not searched"
        ]
        lines += [self.study.engine_note] if self.study.engine_note else []
        # If more than this fraction of the flights has the same margin, the result says that the search learnt little.
        max_flat = 0.5
        for case in self.cases:
            if case.impossible:
                lines.append(
                    f"{short_name(case.controller)}: {case.impossible} points were left out, the first because: "
                    f"{case.impossible_reason}; {NOT_FLOWN}"
                )
            if case.flat > max_flat:
                lines.append(
                    f"{short_name(case.controller)}: {100.0 * case.flat:.0f} % of the flights have the same margin, "
                    "which says nothing of where it is worse: there the search is no better than random draws; a "
                    "requirement, or success METRIC<=X, gives a flight that completes a margin"
                )
        return lines

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table of plain values for ``search.json``."""
        base = self.study.base()
        return {
            "scenario": base.name,
            "aircraft": base.aircraft_name,
            "engine": base.engine,
            "success": {name: span.model_dump(exclude_none=True) for name, span in self.study.success.items()},
            "vary": [vary.text for vary in self.study.vary],
            **self.plan.table(),
            "flights": self.flights,
            "found": [asdict(case) | {"fails": case.fails} for case in self.cases],
            "lines": self.lines(),
            "notes": self.notes,
        }


def check_region(study: Study, plan: WorstPlan) -> None:
    """Raise InputError for keys that have no range to search: unbounded, correlated, or of an uncertain engine."""
    if plan.within is not None:
        return
    if study.correlate:
        raise InputError("within ranges: correlated keys have no ranges of their own; give standard deviations")
    for vary in study.vary:
        if vary.uncertainty:
            raise InputError(
                "within ranges: an engine's [uncertainty] has no range; give standard deviations, or nominal_engine"
            )
        if vary.values is None and not np.all(np.isfinite(vary.support)):
            raise InputError(f"within ranges: {vary.text} has no bounds; state them, or give standard deviations")


def search_worst(plan: WorstPlan, study: Study) -> Asking[WorstSearch]:
    """Search the worst case, or the most likely failure, of every controller of the study.

    Raises InputError if the study states no distributions; FlightError if flights cannot be flown.
    """
    check_region(study, plan)
    prober, space = Prober(study, plan.seeds), NormalSpace(study)
    cases = []
    for controller in study.controller_names:
        cases.append((yield from _search_controller(plan, prober, space, controller)))
    return WorstSearch(study, plan, tuple(cases), prober.flights)


def worst_row(prober: Prober, point: Point) -> tuple[float, Row]:
    """Return the smallest margin of a point's flights, and the row that has it."""
    rows = [prober.rows[point, seed] for seed in prober.seeds]
    margins = [row_margin(row, prober.study) for row in rows]
    smallest = margins.index(min(margins))
    return margins[smallest], rows[smallest]


class PlaceMargins:
    """Margins at points of the region by flights; nan if a point is no valid vehicle or scenario."""

    def __init__(self, plan: WorstPlan, prober: Prober, space: NormalSpace, controller: str) -> None:
        self._plan, self._prober, self._space, self._controller = plan, prober, space, controller
        self.counts: Counter[float] = Counter()
        self.impossible: dict[Point, str] = {}

    def points(self, places: Array) -> list[Point]:
        """Return the points of places: standard deviations, or half ranges from -1 to 1."""
        normal = places
        if self._plan.within is None:
            from scipy.special import ndtri

            normal = np.clip(ndtri(0.5 + 0.5 * places), -MAX_SIGMA, MAX_SIGMA)
        return [Point.of(self._controller, values) for values in self._space.values(normal)]

    def evaluate(self, places: Array) -> Asking[Array]:
        """Return the margins at these places."""
        points = self.points(places)
        yield from self._prober.evaluate(points)
        margins = np.array([self._margin_or_nan(point) for point in points])
        self.counts.update(margins[~np.isnan(margins)].tolist())
        return margins

    def _margin_or_nan(self, point: Point) -> float:
        margin, row = worst_row(self._prober, point)
        if row["outcome"] != "failed" or row["steps"]:
            return margin
        if point not in self.impossible and (reason := self._why_impossible(point)):
            self.impossible[point] = reason
        return nan if point in self.impossible else margin

    def _why_impossible(self, point: Point) -> str:
        """Return why a point has no flight; an empty text if it has one."""
        study = self._prober.study
        if study.autopilot is not None:
            return ""
        try:
            build(scenario_of(study, self._prober.flight(point, self._prober.seeds[0]))).close()
        except InputError as error:
            return str(error)
        return ""


def _search_controller(plan: WorstPlan, prober: Prober, space: NormalSpace, controller: str) -> Asking[WorstCase]:
    study, before = prober.study, prober.flights
    margins = PlaceMargins(plan, prober, space, controller)
    region = Box() if plan.within is None else Ball(plan.within)
    budget = max(1, plan.budget // len(plan.seeds))  # number of points
    steps = descend(region, space.dimension, budget, plan.seed, plan.likely)
    found = yield from answer_by(steps, margins.evaluate)
    flights, flat = prober.flights - before, max(margins.counts.values(), default=0) / max(margins.counts.total(), 1)
    if not margins.counts:
        raise InputError(
            f"study {study.name}: none of {flights} flights exists: {next(iter(margins.impossible.values()))}"
        )
    impossible = margins.impossible.copy()
    (point,) = margins.points(found.point[None, :])
    margin, row = worst_row(prober, point)
    (middle,) = yield from margins.evaluate(np.zeros((1, space.dimension)))
    effects = yield from _compute_effects(margins, space, found, dict(point.values))
    return WorstCase(
        controller=controller,
        margin=margin,
        middle_margin=_number_or_none(middle),
        distance=None if plan.within is None else found.distance,
        values=dict(point.values),
        seed=int(row["seed"] or 0),
        flight=int(row["flight"] or 0),
        outcome=str(row["outcome"]),
        reason=describe_flight(prober.study, row),
        effects=effects,
        flights=flights,
        since=min(flights, found.since * len(plan.seeds)),
        starts=found.starts,
        flat=flat,
        impossible=len(impossible),
        impossible_reason=next(iter(impossible.values()), ""),
    )


def _compute_effects(
    margins: PlaceMargins, space: NormalSpace, found: DescentResult, values: Mapping[str, Value]
) -> Asking[tuple[KeyEffect, ...]]:
    """Return the effect of each coordinate: the margin with it reset, and with it alone."""
    place, count = found.point, space.dimension
    without, alone = np.where(np.eye(count, dtype=bool), 0.0, place), np.diag(place)
    flown = yield from margins.evaluate(np.vstack([without, alone]))
    middle = dict(margins.points(np.zeros((1, count)))[0].values)
    squares = place**2 / max(float(place @ place), 1e-300)
    return tuple(
        KeyEffect(
            name=name,
            value=values.get(name),
            middle=middle.get(name),
            place=float(place[side]),
            share=float(squares[side]),
            without=_number_or_none(flown[side]),
            alone=_number_or_none(flown[count + side]),
        )
        for side, name in enumerate(space.names)
    )


def _number_or_none(margin: float) -> float | None:
    return None if isnan(margin) else float(margin)


def _describe_case(plan: WorstPlan, case: WorstCase) -> str:
    name = short_name(case.controller)
    effort = f"{case.flights} flights in {case.starts} descent{'s' if case.starts != 1 else ''}"
    if not case.fails:
        what = "no failure found" if plan.likely else "the worst case found keeps"
        where = "" if case.distance is None else f" at {case.distance:.2f} standard deviations"
        return (
            f"{name}: {what} within {plan.where}: least margin {case.margin:.3g}{where}, {effort}; that does not show "
            "that there is no failure"
        )
    last = f"it is the last of {effort}: more may find another"
    if plan.likely and case.distance == 0.0:
        return f"{name}: fails in the middle of everything already: {case.reason}"
    if plan.likely:
        after = f"no nearer failure found in the {case.since} flights after it, of {effort}; there may be"
        return (
            f"{name}: the most likely failure found is {case.distance:.2f} standard deviations from the middle: "
            f"{case.reason}; {after if case.since else last}"
        )
    after = f"nothing worse in the {case.since} flights after it, of {effort}; there may be" if case.since else last
    where = "in" if case.distance is None else f"at {case.distance:.2f} standard deviations, within"
    return f"{name}: the worst case found fails {where} {plan.where}: margin {case.margin:.3g}, {case.reason}; {after}"


def important(effects: Sequence[KeyEffect]) -> list[KeyEffect]:
    """Return the coordinates that differ from the middle, the largest share of the distance first."""
    return sorted((effect for effect in effects if effect.share > 0.0), key=lambda effect: -effect.share)
