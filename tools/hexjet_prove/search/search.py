"""The smallest change of one key that breaks a controller, alone or over another key.

A key is scanned from its value in the scenario outwards, both ways, and the first change is bisected: what is said is
between which two flown values it lies.  Several keys together are what the search of the most likely failure is for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from cosim.simulation.controllers.external_controller import find_controller
from cosim.spec.controller_name import is_design
from cosim.spec.scenario import Scenario
from cosim.studies import (
    MARGIN_OF,
    Key,
    Row,
    Study,
    Value,
    check_expectations,
    default_draw,
    engine_draw,
    metric,
    with_values,
)
from hexjet_prove.search.line_search import Scan, run_together, scan_outward
from hexjet_prove.search.probe import Asking, Point, Prober, answer_by, count_needed
from hexjet_prove.search.span import Span

Side = Literal["up", "down"]
SIDES: dict[int, Side] = {1: "up", -1: "down"}  # name of a search's direction


@dataclass(frozen=True)
class SecondKey:
    """A second key, and its values for which the first one is searched."""

    key: Key
    levels: tuple[Value, ...]


@dataclass(frozen=True)
class Plan:
    """Options of a search; the study defines how flights are made and judged."""

    spans: tuple[Span, ...]
    over: SecondKey | None = None
    seeds: tuple[int, ...] = (1,)
    share: float = 0.0  # of a point's flights; 0: one is enough
    draws_engine: bool = False  # True: engines drawn in further flights

    def point(self, controller: str, changed: Mapping[str, Value], level: Value | None = None) -> Point:
        """Return the point with all keys at the start but the ``changed`` ones; ``level`` is of the second key."""
        values = {span.key.path: span.value_at(0.0) for span in self.spans} | dict(changed)
        if self.over and level is not None:
            values[self.over.key.path] = level
        return Point.of(controller, values)

    def table(self) -> dict[str, Any]:
        keys = [
            {"key": span.key.path, "unit": span.key.unit}
            | {name: getattr(span, name) for name in ("low", "high", "start", "points", "tolerance", "logarithmic")}
            for span in self.spans
        ]
        table: dict[str, Any] = {"seeds": list(self.seeds), "share": self.share, "keys": keys}
        if self.draws_engine:
            table["draws_engine"] = True
        if self.over:
            table["over"] = {"key": self.over.key.path, "unit": self.over.key.unit, "levels": list(self.over.levels)}
        return table


@dataclass(frozen=True)
class Edge:
    """Smallest change of one key that makes one controller fail, on one side of the start."""

    controller: str
    key: str
    unit: str
    side: Side
    level: Value | None  # value of the second key
    start: Value
    start_breaks: bool
    holds: Value | None  # last value before breaks, or None
    breaks: Value | None  # first value that breaks; None: none
    end: Value
    deviation: float | None  # of breaks, as a share of the range
    bands: tuple[tuple[Value, Value, bool], ...]  # first and last value, whether it breaks
    flown: int
    broken: int  # flights that broke at the breaking point
    outcome: str
    reason: str  # reason of the first that broke

    @property
    def comes_back(self) -> bool:
        """Whether the vehicle passes again beyond the failure."""
        first = next((number for number, (_, _, breaks) in enumerate(self.bands) if breaks), len(self.bands))
        return any(not breaks for _, _, breaks in self.bands[first:])


@dataclass(frozen=True)
class SearchResult:
    """The result of a search."""

    study: Study
    plan: Plan
    edges: tuple[Edge, ...]
    flights: int
    prober: Prober

    @property
    def criterion(self) -> str:
        """Condition under which a point fails, in words."""
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
        """Sentence on whether the engine's uncertainty is drawn; empty without one."""
        over = [] if self.plan.over is None else [self.plan.over.key.path]
        keys = [*(span.key.path for span in self.plan.spans), *over]
        draw, text = default_draw(self.study.base(), self.study.nominal_engine, keys)
        if draw is None:
            return text
        where = f"{draw.description} in all flights of a point but the first"
        if self.plan.draws_engine:
            return f"the engine is {where}; nominal_engine flies it as it is stated"
        return f"the engine flies as it is stated; with seeds N it is {where}"

    def to_json(self) -> dict[str, Any]:
        """Return the result as a table of plain values for ``search.json``."""
        base = self.study.base()
        return {
            "scenario": base.name,
            "aircraft": base.aircraft_name,
            "engine": base.engine,
            "controllers": self.study.controller_names,
            "controller_sha256": {name: _hash_controller(base, name) for name in self.study.controller_names},
            "criterion": self.criterion,
            **({"engine_note": self.engine_note} if self.engine_note else {}),
            **self.plan.table(),
            "flights": self.flights,
            "alone": [asdict(edge) | {"comes_back": edge.comes_back} for edge in self.edges],
        }


def _hash_controller(base: Scenario, controller: str) -> str | None:
    """Return the hash of a user-supplied controller."""
    if is_design(controller):
        return None
    source = find_controller(with_values(base, {"controller": controller}))
    return None if source is None else source.sha256


def search(plan: Plan, study: Study) -> Asking[SearchResult]:
    """Search every controller of the study.  Raises FlightError if flights cannot be flown."""
    prober = Prober(study, plan.seeds, plan.share, engine_draw(study.base()) if plan.draws_engine else None)
    edges = yield from _search_singly(plan, prober, study.controller_names)
    return SearchResult(study, plan, tuple(edges), prober.flights, prober)


def describe_flight(study: Study, row: Row) -> str:
    """Describe how a flight ended and which metrics were out of range."""
    if row["outcome"] == "failed" and not row.get("steps"):
        return f"not flown: {row['reason']}"
    metrics = {name: row.get(name) for name in study.success}
    above = [f"beyond its limit of {metric(name).label}" for name in str(row.get("beyond") or "").split()]
    required = [entry.name for entry in study.base().require] if row["outcome"] == "completed" else []
    margins = {name: row.get(MARGIN_OF + name) for name in required}
    above += [f"requirement {name} broken" for name, margin in margins.items() if margin is None or not margin >= 0.0]  # type: ignore[operator]
    missed = check_expectations(metrics, study.success) if row["outcome"] == "completed" else []  # type: ignore[arg-type]
    return f"{row['outcome']}, {'; '.join([*above, *missed]) or row['reason']}"


@dataclass(frozen=True)
class _LineSearch:
    """One line search: controller, key, direction, and level of the second key."""

    controller: str
    span: int
    side: int
    level: int

    def point(self, plan: Plan, position: float) -> Point:
        span = plan.spans[self.span]
        level = plan.over.levels[self.level] if plan.over else None
        return plan.point(self.controller, {span.key.path: span.value_at(self.side * position)}, level)


def _search_singly(plan: Plan, prober: Prober, controllers: Sequence[str]) -> Asking[list[Edge]]:
    """Search each key separately, for each controller, side and level, all in parallel."""
    lines = [
        _LineSearch(controller, number, side, level)
        for controller in controllers
        for number, span in enumerate(plan.spans)
        for side in span.sides
        for level in range(len(plan.over.levels) if plan.over else 1)
    ]
    walks = {
        line: scan_outward(plan.spans[line.span].positions(line.side), plan.spans[line.span].bisector(line.side))
        for line in lines
    }

    def evaluate(asked: Mapping[_LineSearch, Sequence[float]]) -> Asking[dict[_LineSearch, list[bool]]]:
        points = {line: [line.point(plan, position) for position in positions] for line, positions in asked.items()}
        yield from prober.evaluate([point for each in points.values() for point in each])
        return {line: [prober.result(point).breaks for point in each] for line, each in points.items()}

    scans = yield from answer_by(run_together(walks), evaluate)
    return [_make_edge(plan, prober, line, scan) for line, scan in scans.items()]


def _make_edge(plan: Plan, prober: Prober, line: _LineSearch, scan: Scan) -> Edge:
    span, side = plan.spans[line.span], line.side
    near, far = scan.change or (None, None)
    broken, holds = (0.0, far) if scan.start_breaks else (far, near)

    def value_at_position(position: float | None) -> Value | None:
        return None if position is None else span.value_at(side * position)

    flown = prober.result(line.point(plan, scan.positions[-1] if broken is None else broken))
    value = value_at_position(broken)
    return Edge(
        controller=line.controller,
        key=span.key.path,
        unit=span.key.unit,
        side=SIDES[side],
        level=plan.over.levels[line.level] if plan.over else None,
        start=span.value_at(0.0),
        start_breaks=scan.start_breaks,
        holds=value_at_position(holds),
        breaks=value,
        end=span.end_value(side),
        deviation=None if value is None else span.deviation(float(value)),
        bands=tuple((span.value_at(side * a), span.value_at(side * b), breaks) for a, b, breaks in scan.bands),
        flown=flown.flights,
        broken=flown.broken,
        outcome=str(flown.worst["outcome"]),
        reason=describe_flight(prober.study, flown.worst),
    )
