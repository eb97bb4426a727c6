"""The least margin in a region, and the failure nearest to its middle: CMA-ES with restarts, in batches.

Nothing here knows of flights.  A point is a vector; its margin is a number, negative where it fails, and not a number
where there is no such point.  A descent is a generator: it yields the points it asks for, a row each, and is told their
margins.  Two questions are answered by one:

- *The worst case*: the region stays as it is, and the margin is made small in it.
- *The nearest failure*: whenever a point fails, the way from the middle to it is searched for where it fails first, and
  from then on the region is the ball that ends just before that point.  The descent goes on in the smaller ball, until
  the evaluations are used up.

The descent is the covariance matrix adaptation of Hansen and Ostermeier (2001), by the package cmaes; a point that
leaves the region is put back to its surface.  Where a descent has converged, stalls, or comes to where an earlier one
has ended, the next one begins at a random point of the region; after a nearer failure the next one begins there.  Where
a quarter of the evaluations allows all corners of a box, these are the first, and a descent begins at the worst of
them.  It needs a margin that says which way is worse: where it is the same everywhere but in the failure itself, this
is no better than random draws.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import product
from math import inf
from typing import Any, Protocol, TypeVar

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_prove.search.line_search import scan_outward

R = TypeVar("R")  # what a search returns
Steps = Generator[Array, Array, R]  # yields rows of points, is sent margins

DISTANCE_RESOLUTION = 0.01  # of a failure, standard deviations


class BudgetSpentError(Exception):
    """The budget of flights is used up."""


class Region(Protocol):
    """Region of allowed points around the origin."""

    @property
    def size(self) -> float:
        """Distance from the origin to the surface, along an axis."""

    def project(self, points: Array) -> Array:
        """Return the points with those outside put back to the surface."""

    def draw(self, random: np.random.Generator, dimension: int) -> Array:
        """Return a point anywhere in the region."""

    def corners(self, dimension: int, most: int) -> Array:
        """Return the corners of the region, one per row; none if there are more than ``most``."""


@dataclass(frozen=True)
class Ball:
    """All points at most ``size`` from the origin."""

    size: float

    def project(self, points: Array) -> Array:
        """Return the points with those outside put back to the surface, along the ray from the origin."""
        far = np.linalg.norm(points, axis=1, keepdims=True)
        return np.asarray(points * np.minimum(1.0, self.size / np.maximum(far, 1e-300)))

    def draw(self, random: np.random.Generator, dimension: int) -> Array:
        """Return a point of the ball, uniform in its volume."""
        turned = random.standard_normal(dimension)
        return np.asarray(turned / np.linalg.norm(turned) * self.size * random.random() ** (1.0 / dimension))

    def corners(self, dimension: int, most: int) -> Array:
        """Return none: a ball has no corners."""
        return np.zeros((0, dimension))


@dataclass(frozen=True)
class Box:
    """Points with all coordinates up to ``size`` in magnitude."""

    size: float = 1.0

    def project(self, points: Array) -> Array:
        """Return the points with coordinates beyond the box put back to its faces."""
        return np.clip(points, -self.size, self.size)

    def draw(self, random: np.random.Generator, dimension: int) -> Array:
        """Return a point of the box, uniform in its volume."""
        return random.uniform(-self.size, self.size, dimension)

    def corners(self, dimension: int, most: int) -> Array:
        """Return all corners, or none if there are more than ``most``."""
        if 2**dimension > most:
            return np.zeros((0, dimension))
        return self.size * np.array(list(product((-1.0, 1.0), repeat=dimension)))


@dataclass(frozen=True)
class DescentResult:
    """Result of the descents in a region.

    ``evaluations`` are all that were made, ``since`` those after
    the last that was better than all before, ``starts`` the descents that were begun.
    """

    point: Array
    margin: float
    evaluations: int = 0
    since: int = 0
    starts: int = 0

    @property
    def fails(self) -> bool:
        return self.margin < 0.0

    @property
    def distance(self) -> float:
        """The point's distance from the origin."""
        return float(np.linalg.norm(self.point))


def descend(region: Region, dimension: int, budget: int, seed: int = 1, nearest: bool = False) -> Steps[DescentResult]:
    """Return the point of least margin that ``budget`` evaluations find in a region, or the failure nearest to 0.

    The same seed gives the same points in the same batches, whatever evaluates them.

    Parameters
    ----------
    region
        Where points may lie; with ``nearest`` it becomes the ball that ends before the nearest failure.
    dimension
        Coordinates of a point.
    budget
        Evaluations that are allowed; all are made, unless the nearest failure is asked for and the middle fails.
    seed
        Of the descents.
    nearest
        Search the failure nearest to the origin in place of the least margin.
    """
    descent = _Descent(region, dimension, budget, nearest)
    starts = begun = 0
    # The corners of a box are evaluated first if they need no more than this part (1/4) of the budget.
    budget_over_corners = 4
    try:
        yield from descent.margins(np.zeros((1, dimension)))
        yield from descent.shrink()
        corners = region.corners(dimension, budget // budget_over_corners)
        if len(corners):
            yield from descent.margins(corners)
        while descent.region.size > 0.0:
            random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(starts,)))
            improved = descent.best_at > begun
            begun = descent.evaluations
            size = descent.region.size
            if starts == 0:
                start, sigma = np.zeros(dimension), size / 3.0
            elif (nearest and improved and descent.best.fails) or (len(corners) and starts == 1):
                start, sigma = descent.region.project(descent.best.point[None, :])[0], size / 10.0
            else:
                start, sigma = descent.region.draw(random, dimension), size / 5.0
            starts += 1
            yield from _run_descent(descent, _make_optimiser(start, sigma, int(random.integers(2**31))))
    except BudgetSpentError:
        pass
    best = descent.best
    return replace(best, evaluations=descent.evaluations, since=descent.evaluations - descent.best_at, starts=starts)


def _run_descent(descent: _Descent, optimiser: Any) -> Steps[None]:
    """Run one descent until it converges or approaches an earlier end."""
    begun, stalled, lowest, slope = descent.evaluations, 0, inf, 0.0
    # A generation whose spread is below this fraction of the region has converged, if it is the best so far.
    narrow_if_best = 0.02
    narrow_otherwise = 0.08  # of the region, for other generations
    max_stalled = 12  # generations without improvement
    min_improvement = 0.001  # of a generation's range of margins
    while descent.region.size > 0.0 and not optimiser.should_stop():
        size = descent.region.size
        points = descent.region.project(np.array([optimiser.ask() for _ in range(optimiser.population_size)]))
        found = yield from descent.margins(points)
        known = found[~np.isnan(found)]
        margins = np.where(np.isnan(found), np.max(known, initial=0.0) + 1.0, found)  # missing margins rank last
        optimiser.tell(list(zip(points, margins.tolist(), strict=True)))
        yield from descent.shrink()
        least = int(np.argmin(margins))
        slope = max(slope, float(np.ptp(known)) if len(known) else 0.0)
        if margins[least] < lowest - min_improvement * slope or descent.region.size < size:
            stalled, lowest = 0, float(margins[least])
        else:
            stalled += 1
        improves = descent.best_at > begun
        is_known = not improves and descent.is_known(points[least], float(margins[least]))
        is_narrow = float(np.max(np.std(points, axis=0))) < (narrow_if_best if improves else narrow_otherwise) * size
        if stalled >= max_stalled or is_known or is_narrow:
            descent.ends.append((points[least], float(margins[least])))
            return


def need_optimiser() -> None:
    """Raise InputError where cmaes is not installed."""
    if find_spec("cmaes") is None:
        raise InputError("a search needs the package cmaes, which is not installed: pip install cmaes")


def _make_optimiser(start: Array, sigma: float, seed: int) -> Any:
    from cmaes import CMA

    return CMA(mean=start, sigma=sigma, seed=seed)


class _Descent:
    """State of a search: evaluations, best point, and remaining region."""

    def __init__(self, region: Region, dimension: int, budget: int, nearest: bool) -> None:
        self.region = region
        self.left = budget
        self._nearest = nearest
        self.evaluations = self.best_at = 0
        self.best = DescentResult(np.zeros(dimension), inf)
        self.ends: list[tuple[Array, float]] = []  # where descents ended

    def margins(self, points: Array) -> Steps[Array]:
        """Return the margins of points, and keep the best.

        Raises BudgetSpentError if that is more than is allowed, after those that are.
        """
        allowed = points[: self.left]
        if not len(allowed):
            raise BudgetSpentError
        found = yield allowed
        self.left -= len(allowed)
        self.evaluations += len(allowed)
        for point, margin in zip(allowed, found, strict=True):
            if self._is_better(point, float(margin)):
                self.best, self.best_at = DescentResult(point.copy(), float(margin)), self.evaluations
        if len(allowed) < len(points):
            raise BudgetSpentError
        return found

    def _is_better(self, point: Array, margin: float) -> bool:
        if self._nearest and self.best.fails:
            return margin < 0.0 and float(np.linalg.norm(point)) < self.best.distance
        return margin < self.best.margin

    def is_known(self, point: Array, margin: float) -> bool:
        """Return whether an earlier descent has ended near a point, with a margin that is no larger."""
        # A descent that comes this close (of the region's size) to the end of an earlier one is ended.
        max_distance = 0.8
        near = max_distance * self.region.size
        return any(low <= margin and float(np.linalg.norm(point - end)) < near for end, low in self.ends)

    def shrink(self) -> Steps[None]:
        """Find the failure closest to the origin on the way to the nearest one, and shrink the region to it."""
        if not self._nearest or not self.best.fails or self.best.distance > self.region.size:
            return
        end, reach = self.best.point, self.best.distance
        if reach <= DISTANCE_RESOLUTION:
            self.region = Ball(0.0)
            return

        def bisect(a: float, b: float) -> float | None:
            return None if (b - a) * reach <= DISTANCE_RESOLUTION * (1.0 + 1e-9) else 0.5 * (a + b)

        count = 4  # points per step towards a failure
        way = scan_outward([step / count for step in range(count + 1)], bisect)
        try:
            asked = next(way)
            while True:
                places = np.array([place for place in asked if place < 1.0])  # the end point is known already
                margins = (yield from self.margins(places[:, None] * end)) if len(places) else ()
                asked = way.send(
                    [*(bool(margin < 0.0) for margin in margins), *(True for place in asked if place >= 1.0)]
                )
        except StopIteration:
            pass
        finally:
            self.region = Ball(max(self.best.distance - DISTANCE_RESOLUTION, 0.0))
