"""What a search found, with the flights that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosim.campaign.search.probe import Point
from cosim.campaign.search.search import Plan, SearchResult
from cosim.campaign.study.key import Value
from cosim.campaign.study.keys import with_values
from cosim.simulation.controllers.external_controller import find_controller
from cosim.spec.controller_name import is_design
from cosim.spec.scenario import Scenario


@dataclass(frozen=True)
class Case:
    """A flight of the result, flown again from its own scenario file."""

    name: str  # name of its folder in cases/
    controller: str
    breaks: bool
    values: Mapping[str, Value]
    seed: int
    outcome: str
    reason: str  # in words
    same: bool  # whether the flight is as in the search, bit for bit


@dataclass(frozen=True)
class SavedSearch:
    """A finished search and its folder."""

    folder: Path
    result: SearchResult
    cases: tuple[Case, ...]
    points: list[tuple[Point, bool]]  # every point that was flown, and whether it breaks

    @property
    def confirmed(self) -> bool:
        """Whether every case came out as it had in the search."""
        return all(case.same for case in self.cases)

    def to_dict(self) -> dict[str, Any]:
        """Return the table that ``search.json`` holds."""
        result, base = self.result, self.result.study.base()
        return {
            "folder": str(self.folder),
            "scenario": base.name,
            "aircraft": base.aircraft_name,
            "engine": base.engine,
            "controllers": result.study.controller_names,
            "controller_sha256": {name: _sha256(base, name) for name in result.study.controller_names},
            "criterion": result.criterion,
            **({"engine_note": result.engine_note} if result.engine_note else {}),
            **plan_table(result.plan),
            "flights": result.flights,
            "alone": [asdict(edge) | {"comes_back": edge.comes_back} for edge in result.edges],
            "together": [asdict(joint) for joint in result.joints],
            "cases": [asdict(case) for case in self.cases],
            "confirmed": self.confirmed,
        }


def _sha256(base: Scenario, controller: str) -> str | None:
    """Return the hash of a user-supplied controller."""
    if is_design(controller):
        return None
    source = find_controller(with_values(base, {"controller": controller}))
    return None if source is None else source.sha256


def plan_table(plan: Plan) -> dict[str, Any]:
    """Return a plan as a table."""
    table: dict[str, Any] = {
        "seeds": list(plan.seeds),
        "share": plan.share,
        "budget": plan.budget,
        "keys": [
            {
                "key": span.key.path,
                "unit": span.key.unit,
                "low": span.low,
                "high": span.high,
                "start": span.start,
                "points": span.points,
                "tolerance": span.tolerance,
                "logarithmic": span.logarithmic,
            }
            for span in plan.spans
        ],
    }
    if plan.draws_engine:
        table["draws_engine"] = True
    if plan.over:
        table["over"] = {"key": plan.over.key.path, "unit": plan.over.key.unit, "levels": list(plan.over.levels)}
    return table
