"""The smallest change that breaks a controller: of one key, of one key over another, and of several together.

One key is scanned from its value in the scenario outwards, both ways, and the first change is bisected: what is said is
between which two flown values it lies.  Several keys together are searched by direction: the distance at which it
breaks on a ray from the scenario's values is made small by differential evolution over the rays (scipy.optimize).  What
that finds has been flown and does break; that nothing smaller does, nobody knows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Any, Literal, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.search.line_search import Between, Scan, run_walks, scan_outward
from cosim.campaign.search.probe import BudgetSpentError, Point, Prober, count_needed
from cosim.campaign.search.span import Span
from cosim.campaign.study.engine_draw import default_draw
from cosim.campaign.study.key import Key, Value
from cosim.campaign.study.keys import with_values
from cosim.campaign.study.study import Study
from cosim.campaign.workers.flight_row import MARGIN_OF, Row
from cosim.results.metrics import check_expectations
from cosim.results.wording import metric
from cosim.simulation.controllers.external_controller import find_controller
from cosim.spec.controller_name import is_design
from cosim.spec.scenario import Scenario

Side = Literal["up", "down"]
SIDES: dict[int, Side] = {1: "up", -1: "down"}

RAY_STEP = 0.1  # spacing of the positions on a ray, as a fraction of the ranges; chosen by us
RAY_BATCH = 3  # positions of a ray evaluated at a time, outwards
COARSE_STEP = 0.02  # resolution of the bisection of every ray, as a fraction of the ranges
FINE_STEP = 0.005  # the same for the best ray
RANDOM_BATCH = 8  # directions tried at a time while nothing that breaks is known
FURTHEST_RATIO = 1.25  # a ray is not evaluated beyond this multiple of the nearest breaking distance


@dataclass(frozen=True)
class SecondKey:
    """A second key, and its values at which the first one is searched."""

    key: Key
    levels: tuple[Value, ...]


@dataclass(frozen=True)
class Plan:
    """What is searched: a study says how a flight is made and judged, this where."""

    spans: tuple[Span, ...]
    over: SecondKey | None = None
    seeds: tuple[int, ...] = (1,)
    share: float = 0.0  # fraction of the flights of a point that have to break; 0: any of them
    budget: int = 1000  # flights of a search of several keys together, for each controller
    draws_engine: bool = False  # by its uncertainty, in all flights of a point but the first

    def point(self, controller: str, changed: Mapping[str, Value], level: Value | None = None) -> Point:
        """Return the point where every key is at its start but the ``changed`` ones; ``level``: of the second key."""
        values = {span.key.path: span.value_at(0.0) for span in self.spans} | dict(changed)
        if self.over and level is not None:
            values[self.over.key.path] = level
        return Point.of(controller, values)

    def table(self) -> dict[str, Any]:
        """Return the plan as a table of TOML."""
        keys = [
            {"key": span.key.path, "unit": span.key.unit}
            | {name: getattr(span, name) for name in ("low", "high", "start", "points", "tolerance", "logarithmic")}
            for span in self.spans
        ]
        table: dict[str, Any] = {"seeds": list(self.seeds), "share": self.share, "budget": self.budget, "keys": keys}
        if self.draws_engine:
            table["draws_engine"] = True
        if self.over:
            table["over"] = {"key": self.over.key.path, "unit": self.over.key.unit, "levels": list(self.over.levels)}
        return table


@dataclass(frozen=True)
class Edge:
    """The smallest change of one key that breaks one controller, on one side of where the search starts."""

    controller: str
    key: str
    unit: str
    side: Side
    level: Value | None  # of the second key
    start: Value
    start_breaks: bool
    holds: Value | None  # the last before ``breaks``; of a start that breaks, the first further out
    breaks: Value | None  # the first value that breaks; None: none up to the end
    end: Value
    deviation: float | None  # deviation of ``breaks``, as a fraction of the way to the end
    bands: tuple[tuple[Value, Value, bool], ...]  # first and last value, and whether it breaks there
    flown: int
    broken: int  # number of flights that broke at the breaking point
    outcome: str
    reason: str  # reason of the first of them

    @property
    def comes_back(self) -> bool:
        """Whether it holds again further out than it breaks."""
        first = next((number for number, (_, _, breaks) in enumerate(self.bands) if breaks), len(self.bands))
        return any(not breaks for _, _, breaks in self.bands[first:])


@dataclass(frozen=True)
class JointResult:
    """The smallest deviation of several keys together that was found to break one controller.

    ``distance`` is the root of the sum of squares of the deviations, each a share of its range: an upper bound on the
    smallest.  None of it: nothing broke on any ray.
    """

    controller: str
    distance: float | None
    breaks: Mapping[str, Value]
    holds: Mapping[str, Value]  # the last that holds on the way there
    deviations: Mapping[str, float]
    alone: float | None  # the smallest distance of a single key that breaks
    rays: int  # tried
    flights: int
    spent: bool  # ended because no more flights were allowed
    outcome: str
    reason: str


@dataclass(frozen=True)
class SearchResult:
    """The result of a search."""

    study: Study
    plan: Plan
    edges: tuple[Edge, ...]
    joints: tuple[JointResult, ...]
    flights: int
    points: Sequence[tuple[Point, bool]] = ()  # every point that was flown, and whether it breaks

    @property
    def criterion(self) -> str:
        """The condition on which a point breaks, in words."""
        metrics = []
        for name, span in self.study.success.items():
            metrics += [f"{name} is below {span.min:g}"] if span.min is not None else []
            metrics += [f"{name} is above {span.max:g}"] if span.max is not None else []
        condition = " or ".join(["it does not end completed within its limits", *metrics])
        count = len(self.plan.seeds)
        if count == 1:
            return f"the flight breaks if {condition}"
        needed = count_needed(self.plan.share, count)
        some = "any" if needed == 1 else "all" if needed == count else f"at least {needed}"
        do = "does" if needed == 1 else "do"
        return f"a flight breaks if {condition}; a point if {some} of its {count} flights {do}"

    @property
    def engine_note(self) -> str:
        """Whether the engine is drawn by its uncertainty, in words; empty where it states none."""
        over = [] if self.plan.over is None else [self.plan.over.key.path]
        keys = [*(span.key.path for span in self.plan.spans), *over]
        draw, text = default_draw(self.study.base(), self.study.nominal_engine, keys)
        if draw is None:
            return text
        where = f"{draw.description} in all flights of a point but the first"
        if self.plan.draws_engine:
            return f"the engine is {where}; --nominal-engine flies it as it is stated"
        return f"the engine flies as it is stated; with --seeds N it is {where}"

    def smallest(self, controller: str) -> Edge | None:
        """Return the edge of a controller with the smallest deviation, over all keys, sides and levels."""
        broken = [e for e in self.edges if e.controller == controller and e.deviation is not None]
        return min(broken, key=lambda edge: abs(edge.deviation or 0.0), default=None)

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table of plain values, as ``search.json`` holds it."""
        base = self.study.base()
        return {
            "scenario": base.name,
            "aircraft": base.aircraft_name,
            "engine": base.engine,
            "controllers": self.study.controller_names,
            "controller_sha256": {name: _sha256(base, name) for name in self.study.controller_names},
            "criterion": self.criterion,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            **self.plan.table(),
            "flights": self.flights,
            "alone": [asdict(edge) | {"comes_back": edge.comes_back} for edge in self.edges],
            "together": [asdict(joint) for joint in self.joints],
        }


def _sha256(base: Scenario, controller: str) -> str | None:
    """Return the hash of a user-supplied controller."""
    if is_design(controller):
        return None
    source = find_controller(with_values(base, {"controller": controller}))
    return None if source is None else source.sha256


def search(plan: Plan, prober: Prober) -> SearchResult:
    """Search every controller of the study.  Raises FlightError if flights cannot be flown."""
    study = prober.study
    edges = search_singly(plan, prober, study.controller_names)
    joints: tuple[JointResult, ...] = ()
    if len(plan.spans) > 1:
        joints = tuple(search_jointly(plan, prober, controller, edges) for controller in study.controller_names)
    points = [(point, prober.result(point).breaks) for point in prober.points]
    return SearchResult(study, plan, tuple(edges), joints, prober.flights, points)


def describe_flight(study: Study, row: Row) -> str:
    """Describe how a flight ended, and for a completed one which metrics were out of range."""
    if row["outcome"] == "failed" and not row.get("steps"):
        return f"not flown: {row['reason']}"
    metrics = {name: row.get(name) for name in study.success}
    above = [f"beyond its limit of {metric(name).label}" for name in str(row.get("beyond") or "").split()]
    required = [entry.name for entry in study.base().require] if row["outcome"] == "completed" else []
    margins = {name: row.get(MARGIN_OF + name) for name in required}
    above += [f"requirement {name} broken" for name, margin in margins.items() if margin is None or not margin >= 0.0]  # type: ignore[operator]
    missed = check_expectations(metrics, study.success) if row["outcome"] == "completed" else []  # type: ignore[arg-type]
    return f"{row['outcome']}, {'; '.join([*above, *missed]) or row['reason']}"


# ---- one key


@dataclass(frozen=True)
class _Line:
    """One walk: which controller, which key, which way, at which level of the second key."""

    controller: str
    span: int
    side: int
    level: int

    def point(self, plan: Plan, position: float) -> Point:
        span = plan.spans[self.span]
        level = plan.over.levels[self.level] if plan.over else None
        return plan.point(self.controller, {span.key.path: span.value_at(self.side * position)}, level)


def search_singly(plan: Plan, prober: Prober, controllers: Sequence[str]) -> list[Edge]:
    """Search every key by itself, for every controller, side and level, all side by side."""
    lines = [
        _Line(controller, number, side, level)
        for controller in controllers
        for number, span in enumerate(plan.spans)
        for side in span.sides
        for level in range(len(plan.over.levels) if plan.over else 1)
    ]
    walks = {
        line: scan_outward(plan.spans[line.span].positions(line.side), plan.spans[line.span].bisector(line.side))
        for line in lines
    }
    scans = run_walks(
        walks, lambda requests: prober.evaluate([line.point(plan, position) for line, position in requests])
    )
    return [_edge(plan, prober, line, scan) for line, scan in scans.items()]


def _edge(plan: Plan, prober: Prober, line: _Line, scan: Scan) -> Edge:
    span, side = plan.spans[line.span], line.side
    near, far = scan.change or (None, None)
    broken, holds = (0.0, far) if scan.start_breaks else (far, near)

    def at(position: float | None) -> Value | None:
        return None if position is None else span.value_at(side * position)

    flown = prober.result(line.point(plan, scan.positions[-1] if broken is None else broken))
    value = at(broken)
    return Edge(
        controller=line.controller,
        key=span.key.path,
        unit=span.key.unit,
        side=SIDES[side],
        level=plan.over.levels[line.level] if plan.over else None,
        start=span.value_at(0.0),
        start_breaks=scan.start_breaks,
        holds=at(holds),
        breaks=value,
        end=span.end_value(side),
        deviation=None if value is None else span.deviation(float(value)),
        bands=tuple((span.value_at(side * a), span.value_at(side * b), breaks) for a, b, breaks in scan.bands),
        flown=flown.flights,
        broken=flown.broken,
        outcome=str(flown.worst["outcome"]),
        reason=describe_flight(prober.study, flown.worst),
    )


# ---- several keys together


class _Ray:
    """The way from the start in one direction, to where the first key is at the end of its range; positions 0 to 1."""

    def __init__(self, plan: Plan, controller: str, direction: Array) -> None:
        unit = direction / np.linalg.norm(direction)
        self._plan, self._controller = plan, controller
        self.reach = float(1.0 / np.max(np.abs(unit)))
        self._to_end = unit * self.reach

    def values(self, position: float) -> dict[str, Value]:
        return {
            span.key.path: span.value_at(position * float(part))
            for span, part in zip(self._plan.spans, self._to_end, strict=True)
        }

    def point(self, position: float) -> Point:
        return self._plan.point(self._controller, self.values(position))

    def positions(self, ring: float, limit: float) -> list[float]:
        """Return every ``ring``, up to the first at ``limit`` or beyond it."""
        count = int(np.ceil(min(self.reach, limit) / ring - 1e-9))
        return [min(1.0, number * ring / self.reach) for number in range(count + 1)]

    def bisector(self, gap: float) -> Between:
        def middle(near: float, far: float) -> float | None:
            if (far - near) * self.reach <= gap * (1.0 + 1e-9):
                return None
            position = 0.5 * (near + far)
            # whole numbers: there may be no other point between
            return None if self.point(position) in (self.point(near), self.point(far)) else position

        return middle


class _BreakPoint(NamedTuple):
    """The point at which a ray breaks."""

    distance: float
    direction: Array
    breaks: dict[str, Value]
    holds: dict[str, Value]


class _Rays:
    """The distances up to which it holds in many directions."""

    def __init__(self, plan: Plan, prober: Prober, controller: str, single: float | None) -> None:
        self._plan, self._prober, self._controller = plan, prober, controller
        self._single = single  # distance of the nearest key alone
        self.best: _BreakPoint | None = None
        self.tried = 0

    @property
    def nothing_breaks(self) -> bool:
        """Whether no point that breaks is known."""
        return self.best is None and self._single is None

    @property
    def limit(self) -> float:
        """The distance up to which a ray is searched."""
        distances = [self.best.distance] if self.best else []
        distances += [] if self._single is None else [self._single]
        return FURTHEST_RATIO * min(distances, default=sqrt(len(self._plan.spans)) / FURTHEST_RATIO)

    def distances(self, directions: Array, ring: float = RAY_STEP, gap: float = COARSE_STEP) -> Array:
        """Return the distance at which each direction (a column each) breaks first; the limit where it does not."""
        limit = self.limit
        rays = {
            number: _Ray(self._plan, self._controller, column)
            for number, column in enumerate(directions.T)
            if np.linalg.norm(column) > 1e-9
        }
        walks = {
            number: scan_outward(ray.positions(ring, limit), ray.bisector(gap), RAY_BATCH)
            for number, ray in rays.items()
        }
        scans = run_walks(
            walks,
            lambda requests: self._prober.evaluate([rays[number].point(position) for number, position in requests]),
        )
        distances = np.full(directions.shape[1], limit)
        for number, scan in scans.items():
            self.tried += 1
            if scan.change is not None:
                near, far = (rays[number].values(position) for position in scan.change)
                distances[number] = distance(self._plan, far)
                if self.best is None or distances[number] < self.best.distance:
                    self.best = _BreakPoint(float(distances[number]), directions[:, number].copy(), far, near)
        return distances

    def refine(self) -> None:
        """Bisect the best ray more finely."""
        if self.best is not None:
            self.distances(self.best.direction[:, None], RAY_STEP / 2.0, FINE_STEP)


def search_jointly(plan: Plan, prober: Prober, controller: str, edges: Sequence[Edge]) -> JointResult:
    """Return the smallest deviation of all keys together that is found within the flights allowed."""
    flights_before = prober.flights
    broken = [e for e in edges if e.controller == controller and e.breaks is not None]
    nearest = min(broken, key=lambda edge: abs(edge.deviation or 0.0), default=None)
    single = None if nearest is None else abs(nearest.deviation or 0.0)
    rays = _Rays(plan, prober, controller, single)
    spent = False
    if nearest is None or not nearest.start_breaks:
        prober.remaining = plan.budget
        try:
            _evolve(plan, rays)
        except BudgetSpentError:
            spent = True
        prober.remaining = None
    start = {span.key.path: span.value_at(0.0) for span in plan.spans}
    breaks: Mapping[str, Value] = {}
    holds: Mapping[str, Value] = {}
    if nearest is not None and nearest.breaks is not None:
        breaks = start | {nearest.key: nearest.breaks}
        holds = start | {nearest.key: nearest.holds} if nearest.holds is not None else {}
    rays.refine()
    if rays.best is not None and (single is None or rays.best.distance < single):
        breaks, holds = rays.best.breaks, rays.best.holds
    worst = prober.result(plan.point(controller, breaks)).worst if breaks else {}
    return JointResult(
        controller=controller,
        distance=distance(plan, breaks) if breaks else None,
        breaks=breaks,
        holds=holds,
        deviations={span.key.path: span.deviation(float(breaks[span.key.path])) for span in plan.spans if breaks},
        alone=single,
        rays=rays.tried,
        flights=prober.flights - flights_before,
        spent=spent,
        outcome=str(worst.get("outcome", "")),
        reason=describe_flight(prober.study, worst) if worst else "",
    )


def distance(plan: Plan, values: Mapping[str, Value]) -> float:
    """Return how far values are from where the search starts, in ranges."""
    return sqrt(sum(span.deviation(float(values[span.key.path])) ** 2 for span in plan.spans))


def _evolve(plan: Plan, rays: _Rays) -> None:
    """Run differential evolution over the directions: of each key alone, of the best so far, and random ones.

    Before anything that breaks is known, random directions alone: there would be nothing to evolve from.
    Deterministic; ends with the flights, or when the directions agree.
    """
    from scipy.optimize import differential_evolution

    bounds = [(-1.0 if -1 in span.sides else 0.0, 1.0 if 1 in span.sides else 0.0) for span in plan.spans]
    lower, upper = np.array(bounds).T
    random = np.random.default_rng(1)

    def anywhere(count: int) -> Array:
        """Return directions spread evenly over the sphere, as far as there is room."""
        turned = random.standard_normal((count, len(bounds)))
        side = np.where((turned < 0.0) & (lower == 0.0) | (turned > 0.0) & (upper == 0.0), -1.0, 1.0)
        return np.asarray(side * turned / np.linalg.norm(turned, axis=1)[:, None])

    while rays.nothing_breaks:
        rays.distances(anywhere(RANDOM_BATCH).T)
    axes = [side * row for row, span in zip(np.eye(len(bounds)), plan.spans, strict=True) for side in span.sides]
    known = [] if rays.best is None else [rays.best.direction / np.max(np.abs(rays.best.direction))]
    differential_evolution(
        rays.distances,
        bounds,
        init=np.array([*axes, *known, *anywhere(4 * len(bounds))]),
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.005,
        atol=COARSE_STEP / 4.0,
        maxiter=1000,
        rng=2,
    )
