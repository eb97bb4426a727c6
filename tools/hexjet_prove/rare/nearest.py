"""The nearest failure that a search finds, which an interval of a rare probability is compared with.

A failure at a distance of b standard deviations has all that lies beyond a plane through it behind it where failures go
on outwards: Phi(-b) of all draws.  An interval that ends below that has missed it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec

import numpy as np
from scipy.special import ndtr

from cosim.base.arrays import Array
from cosim.studies import NormalSpace, Value, flight_seed, row_margin
from hexjet_prove.rare.estimate import probability_text
from hexjet_prove.search.minimise import Ball, descend
from hexjet_prove.search.probe import Asking, Point, Prober, answer_by
from hexjet_prove.search.worst_case import LIKELY_REGION

# Flights of the search, taken from those left by the simulations, and seeds of noise and turbulence tried at the
# failure if they vary. Chosen by us: 500 flights converge in six dimensions.
MAX_SEARCHED, MIN_SEARCHED, SEEDS_TRIED = 500, 50, 10


@dataclass(frozen=True)
class NearestSearch:
    """Result of a search for the nearest failure; without ``distance`` none was found.

    ``share`` of the seeds of noise and turbulence that were tried there fail.
    """

    flights: int = 0
    distance: float | None = None
    share: float = 1.0
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def probability(self) -> float:
        """Probability beyond a plane through the failure; 0 without one."""
        return 0.0 if self.distance is None else self.share * float(ndtr(-self.distance))

    @property
    def says(self) -> str:
        """Sentence on the result of the search."""
        if not self.flights:
            return f"no search for the nearest failure was made: it takes {MIN_SEARCHED} flights, and the package cmaes"
        if self.distance is None:
            return f"{self.flights} flights that searched for the nearest failure found none"
        return f"the nearest failure that {self.flights} flights searched is {self.distance:.2f} sd from the middle"

    def contradict(self, high: float) -> str:
        """Describe how the failure contradicts an interval up to ``high``; an empty text if it does not."""
        if self.distance is None or self.probability <= high:
            return ""
        place = ", ".join(f"{name} = {value:.6g}" for name, value in self.values.items())
        return (
            f"contradicted: a search finds a failure {self.distance:.2f} standard deviations out ({place}), and "
            f"{probability_text(self.probability)} of all draws lie beyond a plane through it, more than the interval "
            "allows: do not use it; a larger budget gives each requirement more flights"
        )


def search_nearest(
    space: NormalSpace, controller: str, seed: int | None, left: int, prober: Prober
) -> Asking[NearestSearch]:
    """Search the failure nearest to the middle of the draws in ``left`` flights, and try other seeds there.

    All have the ``seed``, or that of the scenario where it varies.  Without enough flights, or without the package that
    searches, none is made.  Raises FlightError if flights cannot be flown.
    """
    budget = min(left - (SEEDS_TRIED if seed is None else 0), MAX_SEARCHED)
    if budget < MIN_SEARCHED or find_spec("cmaes") is None:
        return NearestSearch()
    study, requested = prober.study, set[tuple[Point, int]]()
    own_seed = study.base().seed if seed is None else seed

    def fly_margins(places: Array, seeds: Sequence[int] = (own_seed,)) -> Asking[Array]:
        points = [Point.of(controller, values) for values in space.values(places)]
        asked = [(point, each) for point in points for each in seeds]
        requested.update(asked)
        yield from prober.fly(asked)
        rows = [prober.rows[key] for key in asked]
        # A flight that cannot be flown is not a failure that a search may find.
        return np.array([np.nan if row["outcome"] == "failed" else row_margin(row, study) for row in rows])

    steps = descend(Ball(LIKELY_REGION), space.dimension, budget, study.seed, nearest=True)
    found = yield from answer_by(steps, fly_margins)
    if not found.fails:
        return NearestSearch(len(requested))
    place = found.point[None, :]
    share = 1.0
    if seed is None:
        tried = yield from fly_margins(place, [flight_seed(study.seed, number) for number in range(SEEDS_TRIED)])
        share = float(np.mean(tried < 0.0))
    return NearestSearch(len(requested), found.distance, share, space.values(place)[0])
