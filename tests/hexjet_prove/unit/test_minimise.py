"""The least margin and the nearest failure, on functions whose answers are known."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest

from cosim.base.arrays import Array
from hexjet_prove.search.minimise import DISTANCE_RESOLUTION, Ball, Box, DescentResult, descend
from hexjet_prove.search.probe import answer_all

Margin = Callable[[Array], float]


def found(
    margin: Margin, region: Ball | Box, dimension: int, budget: int, seed: int = 1, nearest: bool = False
) -> DescentResult:
    steps = descend(region, dimension, budget, seed, nearest)
    return answer_all(steps, lambda points: np.array([margin(x) for x in points]))


def plane(distance: float, dimension: int) -> Margin:
    """Fails beyond a plane, in a direction that is no axis."""
    normal = np.arange(1.0, dimension + 1.0) * (-1.0) ** np.arange(dimension)
    normal /= np.linalg.norm(normal)
    return lambda x: distance - float(normal @ x)


def two_regions(x: Array) -> float:
    """The nearer failure, 3 away, is seen less well from the middle than the one that is 4.17 away."""
    return min(5.0 - 1.2 * float(x[0]), 3.0 * (3.0 - float(x[2] - x[1]) / sqrt(2.0)))


@pytest.mark.parametrize("dimension", [1, 2, 6])
@pytest.mark.parametrize("distance", [2.0, 4.5])
def test_the_nearest_failure_behind_a_plane(dimension: int, distance: float) -> None:
    """Known to DISTANCE_RESOLUTION along a ray, and a direction that is off by e adds 1 - cos e."""
    nearest = found(plane(distance, dimension), Ball(6.0), dimension, 800, nearest=True)
    assert nearest.fails
    assert distance <= nearest.distance < distance + 3.0 * DISTANCE_RESOLUTION


def test_the_nearest_failure_of_an_island() -> None:
    centre = np.array([1.5, -1.5, 1.0, 1.0, 0.0, 0.0])
    nearest = found(lambda x: float(np.linalg.norm(x - centre)) - 0.7, Ball(6.0), 6, 1000, nearest=True)
    assert nearest.distance == pytest.approx(float(np.linalg.norm(centre)) - 0.7, abs=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_the_nearer_of_two_failures(seed: int) -> None:
    nearest = found(two_regions, Ball(6.0), 6, 1500, seed, nearest=True)
    assert 3.0 <= nearest.distance < 3.1


def test_the_worst_of_a_ball_is_on_its_surface_or_inside() -> None:
    worst = found(plane(2.0, 6), Ball(3.0), 6, 600)
    assert worst.margin == pytest.approx(-1.0, abs=0.01)
    assert worst.distance == pytest.approx(3.0, abs=1e-9)
    inside = found(lambda x: float(np.sum((x - 0.5) ** 2)), Ball(3.0), 4, 600)
    assert inside.point == pytest.approx(np.full(4, 0.5), abs=0.1)


def test_the_worst_of_a_box_may_be_a_corner() -> None:
    worst = found(lambda x: float(np.sum(x * [1.0, -1.0, 2.0])), Box(), 3, 400)
    assert worst.point == pytest.approx([-1.0, 1.0, -1.0])
    assert worst.margin == pytest.approx(-4.0)


def test_a_box_is_never_better_than_its_corners() -> None:
    """A narrow dip in one of eight corners, where a slope from the middle leads to the one that lies opposite."""

    def margin(x: Array) -> float:
        return 1.0 + 0.1 * float(np.sum(x)) - 2.0 * float(np.all(x > 0.98))

    corner = found(margin, Box(), 3, 40)
    assert corner.margin == pytest.approx(-0.7)
    assert found(margin, Box(), 3, 24).margin > 0.5  # the corners would be more than a quarter


def test_where_the_middle_fails_there_is_nothing_nearer() -> None:
    nearest = found(lambda x: -1.0, Ball(6.0), 3, 100, nearest=True)
    assert (nearest.distance, nearest.evaluations, nearest.starts) == (0.0, 1, 0)


@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize("budget", [1, 7, 100, 333])
def test_the_budget_is_kept_and_used(budget: int, nearest: bool) -> None:
    asked = []

    def evaluate(points: Array) -> Array:
        asked.append(len(points))
        return np.array([two_regions(x) for x in points])

    result = answer_all(descend(Ball(6.0), 6, budget, nearest=nearest), evaluate)
    assert sum(asked) == result.evaluations == budget
    assert 0 <= result.since < budget


def test_the_same_seed_goes_the_same_way_and_another_one_another() -> None:
    once, again, other = (found(two_regions, Ball(6.0), 6, 300, seed, nearest=True) for seed in (1, 1, 2))
    assert once.point.tolist() == again.point.tolist()
    assert once.point.tolist() != other.point.tolist()


def test_every_point_is_in_the_region_that_is_left() -> None:
    looked: list[Array] = []

    def evaluate(points: Array) -> Array:
        looked.extend(points)
        return np.array([two_regions(x) for x in points])

    result = answer_all(descend(Ball(4.0), 6, 500, nearest=True), evaluate)
    far = np.linalg.norm(looked, axis=1)
    assert far.max() <= 4.0 + 1e-9
    assert far[-result.since :].max() <= result.distance + 1e-9  # nothing further than what is known already


def test_what_does_not_exist_neither_fails_nor_is_the_worst() -> None:
    """A ball is no place, and behind it is a plane that fails."""

    def margin(x: Array) -> float:
        return float("nan") if np.linalg.norm(x - 1.0) < 0.8 else 3.0 - float(np.sum(x)) / sqrt(3.0)

    nearest = found(margin, Ball(6.0), 3, 800, nearest=True)
    assert 3.0 <= nearest.distance < 3.0 + 3.0 * DISTANCE_RESOLUTION
    worst = found(margin, Ball(1.8), 3, 500)
    assert np.isfinite(worst.margin)
    assert np.linalg.norm(worst.point - 1.0) >= 0.8
    assert not found(lambda x: float("nan"), Ball(6.0), 3, 50).fails


def test_a_needle_in_a_haystack_is_not_found() -> None:
    """What docs/campaigns.md says: a margin that is the same everywhere else shows no way."""
    result = found(lambda x: -1.0 if np.all(abs(x - 0.7) < 0.1) else 1.0, Box(), 6, 1000)
    assert not result.fails
    assert result.starts > 5  # and no time is lost where nothing changes
