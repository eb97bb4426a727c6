"""A finished simulation of rare failures, its folder, and the failures that were flown again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from cosim.campaign.rare.simulation import RareResult
from cosim.campaign.search.question import Answered


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
