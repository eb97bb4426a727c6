"""A finished simulation of rare failures, its folder, and the failures that were flown again."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cosim.campaign.rare.simulation import RareResult


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


@dataclass(frozen=True)
class SavedRare:
    """A finished simulation and its folder."""

    folder: Path
    result: RareResult
    cases: tuple[RareCase, ...]

    @property
    def confirmed(self) -> bool:
        """Whether every case came out as it had in the simulation."""
        return all(case.same for case in self.cases)

    def to_json(self) -> dict[str, Any]:
        """Return the table that ``rare.json`` holds."""
        cases = [asdict(case) for case in self.cases]
        return {"folder": str(self.folder), **self.result.to_json(), "cases": cases, "confirmed": self.confirmed}
