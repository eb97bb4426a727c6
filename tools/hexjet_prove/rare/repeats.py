"""All simulations of a rare failure side by side: a first level for all requirements, then levels for each group."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.arrays import Array
from hexjet_prove.rare.estimate import Budget
from hexjet_prove.rare.groups import Group, group_requirements
from hexjet_prove.rare.subset import Candidates, Repeat, first_level, subset_simulation
from hexjet_prove.search.line_search import run_together

Place = tuple[int, int]  # repeat and group (first level: 0)


@dataclass(frozen=True)
class Simulations:
    """The groups of requirements, and the repeats of each group's simulation in the same order."""

    groups: tuple[Group, ...]
    repeats: tuple[tuple[Repeat, ...], ...]

    @property
    def counted(self) -> bool:
        """Whether only the first level was flown, whose flights are independent and are counted."""
        return all(len(repeat.levels) == 1 for repeats in self.repeats for repeat in repeats)

    @property
    def flights(self) -> int:
        """Number of flights of the simulations; the first level is shared by all groups."""
        first = sum(repeat.levels[0].margins.size for repeat in self.repeats[0])
        later = sum(repeat.flights for repeats in self.repeats for repeat in repeats) - first * len(self.groups)
        return first + later


def simulate_groups(
    dimension: int,
    budget: Budget,
    randoms: Sequence[np.random.Generator],
    seed: int | None = None,
) -> Generator[dict[Place, Candidates], Mapping[Place, Array], Simulations]:
    """Return the simulations of a budget, a repeat for each of ``randoms``.

    Yields candidates and is told their margins, a row a flight and a column a requirement.  All flights have this
    ``seed``, or one each.
    """
    first = {(at, 0): first_level(dimension, budget.size, random, seed) for at, random in enumerate(randoms)}
    flown = yield first
    groups = group_requirements(np.concatenate([flown[place] for place in first]), budget.most_groups)
    size = budget.size_of(len(groups))
    generators = {
        (at, number): subset_simulation(first[at, 0], flown[at, 0], group, size, budget.most_levels, own_random, seed)
        for at, random in enumerate(randoms)
        for number, (group, own_random) in enumerate(zip(groups, [random, *random.spawn(len(groups) - 1)], strict=True))
    }
    ended = yield from run_together(generators)
    return Simulations(
        tuple(groups),
        tuple(tuple(ended[at, number] for at in range(len(randoms))) for number in range(len(groups))),
    )
