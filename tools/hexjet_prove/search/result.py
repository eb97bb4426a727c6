"""What a search found, with the flights that show it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cosim.studies import Value
from hexjet_prove.search.question import Answered
from hexjet_prove.search.search import SearchResult


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


class SavedSearch(Answered[SearchResult, Case]):
    """A finished search and its folder."""
