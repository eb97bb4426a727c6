"""Which requirements are simulated together, and which flights of a failure each simulation counts.

The smallest of unlike margins leads astray: one that is always small, and hardly changes, hides another that falls to
failure in a few standard deviations.  So every requirement has a simulation of its own, from the same independent
flights, and their probabilities add up.  A flight that breaks several requirements is met by the simulation of each,
and counts in each by one over how many these are: the sum is the probability that any is broken, and no bound of it.

A simulation takes flights.  So a requirement that the independent flights show to be far from failure shares one, and
where the budget allows fewer simulations than requirements, those furthest away do.  Margins that share a simulation
are compared by how far failure is: each is divided by the spread that it has towards failure.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log

import numpy as np

from cosim.base.arrays import Array

QUANTILES, DEVIATIONS = (0.1, 0.01), (1.2816, 2.3263)  # of margins, of a standard normal


@dataclass(frozen=True)
class Group:
    """The requirements that share a simulation: their columns among the margins, and the spread of each."""

    columns: tuple[int, ...]
    spreads: tuple[float, ...]
    others: tuple[tuple[int, ...], ...] = ()  # columns of every other group

    def judge(self, margins: Array) -> tuple[Array, Array]:
        """Return the margin of each flight for this group, and the fraction by which it counts as a failure."""
        groups_broken = np.ones(len(margins))
        for columns in self.others:
            groups_broken += np.any(margins[:, columns] < 0.0, axis=1)
        return np.min(margins[:, self.columns] / self.spreads, axis=1), 1.0 / groups_broken


def group_requirements(margins: Array, most: int, far: float = 20.0) -> list[Group]:
    """Return at most so many groups of requirements from the ``margins`` of independent flights, a column each.

    Those ``far`` standard deviations from failure have none of their own: by default four times what one in a million
    is away.
    """
    count = margins.shape[1]
    if count == 1:
        return [Group((0,), (1.0,))]
    distances, spreads = zip(*(measure_distance(column) for column in margins.T), strict=True)
    order = sorted(range(count), key=lambda column: distances[column])
    alone = [[column] for column in order if distances[column] < far] or [order[:1]]
    groups = alone[: max(most, 1)]
    groups[-1 if len(alone) > most else 0] += [column for column in order if [column] not in groups]
    return [
        Group(
            tuple(group), tuple(spreads[at] for at in group), tuple(tuple(each) for each in groups if each is not group)
        )
        for group in groups
    ]


def measure_distance(margins: Array) -> tuple[float, float]:
    """Return the distance of failure in standard deviations, and the drop of the margin in one.

    The margin is taken to fall from its median by c z^a at z standard deviations, with the least ``a`` of 1: that goes
    through the fall at a tenth and at a hundredth of the flights.
    """
    median = float(np.median(margins))
    near, far = (median - float(np.quantile(margins, quantile)) for quantile in QUANTILES)
    spread = far / DEVIATIONS[1]
    if spread <= 0.0:
        return inf, max(abs(median), 1.0) * 1e-9
    power = max(1.0, log(far / near) / log(DEVIATIONS[1] / DEVIATIONS[0])) if near > 0.0 else inf
    return DEVIATIONS[1] * max(median / far, 0.0) ** (1.0 / power), spread
