"""Subset simulation of known truths: right on average, intervals that hold what they say, and bounds where none fails.

The seeds are fixed, and the bounds are the binomial distribution's at one in ten thousand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import exp, log, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import binom, norm

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.results.requirements import parse_formula
from hexjet_prove.rare.estimate import (
    MIN_SEED_EFFECT,
    Budget,
    Estimate,
    estimate,
    lognormal_interval,
    probability_text,
    seed_effect,
)
from hexjet_prove.rare.groups import Group, group_requirements, measure_distance
from hexjet_prove.rare.nearest import NearestSearch
from hexjet_prove.rare.repeats import Simulations, simulate_groups
from hexjet_prove.rare.subset import Candidates, Level, Repeat
from hexjet_prove.search.probe import answer_all

CURVATURE = 0.3
BAND_FURTHER = 0.42  # standard deviations between the limit of roll and the band of height
NOISE = sqrt(0.5)  # of the margin's standard deviation, from the seed


@dataclass(frozen=True)
class Truth:
    """A margin over standard normal coordinates whose probability of less than 0 is known."""

    name: str
    dimension: int
    margin: Callable[[Array, Array, float], Array]  # of points, seeds and the level; a column a requirement
    level: Callable[[float], float]  # at which it has a probability


def noise(seeds: Array) -> Array:
    """Return a standard normal number for each seed, by mixing its bits (splitmix64)."""
    with np.errstate(over="ignore"):
        bits = seeds.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):
            bits = (bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)
    return np.asarray(ndtri(((bits >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53))


@cache
def parabola_level(probability: float) -> float:
    """Return b at which P(u1 > b + CURVATURE u2^2) is a probability, by quadrature."""

    def excess(level: float) -> float:
        found, _ = quad(lambda x: norm.pdf(x) * ndtr(-level - CURVATURE * x * x), -9.0, 9.0, epsabs=1e-14)
        return float(log(found / probability))

    return float(brentq(excess, -3.0, 8.0))


def one_sided(probability: float) -> float:
    """Return b at which P(u > b) is a probability."""
    return -float(ndtri(probability))


def linear(dimension: int) -> Truth:
    """Return a plane at the distance b from the middle, turned away from every axis."""
    return Truth(
        f"a plane, {dimension} keys",
        dimension,
        lambda points, seeds, level: level - points.sum(axis=1) / sqrt(dimension),
        one_sided,
    )


@cache
def band_level(probability: float) -> float:
    """Return b at which |u1| > b or |u2| > b + BAND_FURTHER is a probability."""

    def excess(level: float) -> float:
        roll, height = 2.0 * ndtr(-level), 2.0 * ndtr(-level - BAND_FURTHER)
        return float(log((roll + height - roll * height) / probability))

    return float(brentq(excess, 0.0, 8.0))


TRUTHS = {
    "plane 2": linear(2),
    "plane 6": linear(6),
    "plane 20": linear(20),
    "key": Truth("a threshold on one key of four", 4, lambda points, seeds, level: level - points[:, 2], one_sided),
    "two": Truth(
        "two regions, opposite, 2 keys",
        2,
        lambda points, seeds, level: level - np.abs(points[:, 0]),
        lambda probability: one_sided(probability / 2.0),
    ),
    "parabola": Truth(
        "a parabola, 2 keys",
        2,
        lambda points, seeds, level: level + CURVATURE * points[:, 1] ** 2 - points[:, 0],
        parabola_level,
    ),
    "noise": Truth(
        "a plane, 2 keys, half of the variance from the seed",
        2,
        lambda points, seeds, level: (
            level - NOISE * points.sum(axis=1) / sqrt(2.0) - sqrt(1.0 - NOISE**2) * noise(seeds)
        ),
        one_sided,
    ),
    "band": Truth(
        "a limit of roll and a band of height, 2 keys",
        2,
        lambda points, seeds, level: np.stack(
            [(level - np.abs(points[:, 0])) / level, 0.01 * (level + BAND_FURTHER - np.abs(points[:, 1]))], axis=1
        ),
        band_level,
    ),
    "shallow": Truth(
        "a requirement that is always near and never broken, beside one that is, 2 keys",
        2,
        lambda points, seeds, level: np.stack(
            [0.02 + 0.2 * np.exp(-np.maximum(points[:, 1], -3.0)), level - points[:, 0]], axis=1
        ),
        one_sided,
    ),
}


def simulated(truth: Truth, probability: float, budget: Budget, seed: int) -> tuple[Estimate, Simulations]:
    """Return the estimate of one whole simulation of a known truth, and the simulations that it is from."""
    level = truth.level(probability)
    randoms = [np.random.default_rng([seed, repeat]) for repeat in range(budget.repeats)]
    made = answer_all(
        simulate_groups(truth.dimension, budget, randoms),
        lambda asked: {
            place: truth.margin(candidates.points, np.array(candidates.seeds), level).reshape(len(candidates.seeds), -1)
            for place, candidates in asked.items()
        },
    )
    return estimate(made.repeats), made


STUDIES = 40
LEAST_HELD = 0.93


@pytest.mark.parametrize(
    ("name", "probability"),
    [
        ("plane 2", 1e-2),
        ("key", 1e-4),
        ("two", 1e-2),
        pytest.param("plane 6", 1e-6, marks=pytest.mark.long),
        pytest.param("plane 20", 1e-4, marks=pytest.mark.long),
        pytest.param("parabola", 1e-4, marks=pytest.mark.long),
        pytest.param("two", 1e-6, marks=pytest.mark.long),
        pytest.param("parabola", 1e-6, marks=pytest.mark.long),
        pytest.param("noise", 1e-4, marks=pytest.mark.long),
        pytest.param("shallow", 1e-4, marks=pytest.mark.long),
    ],
)
def test_the_interval_holds_a_known_truth_as_often_as_it_says(name: str, probability: float) -> None:
    found = [simulated(TRUTHS[name], probability, Budget(1e-6, 5000), seed) for seed in range(STUDIES)]
    held = [each.low <= probability <= each.high for each, _ in found]
    assert sum(held) >= binom.ppf(1e-4, STUDIES, LEAST_HELD)
    assert all(made.flights <= 5000 for _, made in found)


@pytest.mark.long
@pytest.mark.parametrize("together", [True, False], ids=["smallest margin", "each its own"])
def test_a_height_band_beside_a_roll_limit_holds_its_truth(together: bool) -> None:
    """Each in its tolerance: a height of N(10, 0.1) m and a roll of N(0, 1) deg; most failures are roll's."""
    roll, height = (parse_formula(f"always({text})") for text in ("abs(roll_deg) < 4", "abs(altitude_m - 10) < 0.442"))

    def margins(points: Any, seeds: Any, level: float) -> Any:
        left = (4.0 - np.abs(points[:, 0])) / roll.tolerance, (0.442 - 0.1 * np.abs(points[:, 1])) / height.tolerance
        return np.minimum(*left) if together else np.stack(left, axis=1)

    sides = 2.0 * norm.sf(4.0), 2.0 * norm.sf(4.42)
    probability = float(sides[0] + sides[1] - sides[0] * sides[1])
    truth = Truth("height and roll", 2, margins, lambda probability: 0.0)
    found = [simulated(truth, probability, Budget(1e-6, 5000), seed) for seed in range(60)]
    assert sum(each.low <= probability <= each.high for each, _ in found) >= 54
    assert all(made.flights <= 5000 for _, made in found)


@pytest.mark.long
def test_a_shallow_requirement_beside_a_steep_one_that_decides_hides_nothing() -> None:
    """One is near failure everywhere and broken beyond six deviations, the other falls to failure at three and a half.

    The smallest of the two margins holds the truth in some of 60 studies.
    """
    truth = Truth(
        "shallow and steep",
        2,
        lambda points, seeds, level: np.stack([0.01 - points[:, 1] / 600.0, 3.5 - points[:, 0]], axis=1),
        lambda probability: 0.0,
    )
    probability = float(1.0 - norm.cdf(3.5) * norm.cdf(6.0))
    found = [simulated(truth, probability, Budget(1e-6, 5000), seed) for seed in range(60)]
    assert sum(each.low <= probability <= each.high for each, _ in found) >= 54
    assert all(made.flights <= 5000 and len(made.groups) == 2 for _, made in found)


def test_one_in_a_hundred_thousand_is_within_a_factor_of_two() -> None:
    found = [simulated(TRUTHS["plane 6"], 1e-5, Budget(1e-5, 5000), seed) for seed in range(STUDIES)]
    near = sum(abs(log((each.probability or 0.0) / 1e-5)) < log(2.0) for each, _ in found)
    assert near >= binom.ppf(1e-4, STUDIES, 0.95)
    assert sum(each.low <= 1e-5 <= each.high for each, _ in found) >= binom.ppf(1e-4, STUDIES, LEAST_HELD)
    assert all(made.flights <= 5000 for _, made in found)


@pytest.mark.parametrize("steps", [0, 4], ids=["continuous", "in steps"])
def test_the_product_is_right_on_average(steps: int) -> None:
    """With ties too: margins that a flight takes in quarters only, whose probability of less than 0 is the same."""
    truth = TRUTHS["plane 2"]
    stepped = replace(
        truth, margin=lambda points, seeds, level: np.floor(4.0 * truth.margin(points, seeds, level)) / 4.0
    )
    found = [simulated(stepped if steps else truth, 1e-3, Budget(1e-3, 3000), seed) for seed in range(30)]
    logs = [repeat.log_probability for _, made in found for repeat in made.repeats[0]]
    probabilities = np.array([0.0 if value is None else exp(value) for value in logs])
    error = np.std(probabilities) / np.sqrt(len(probabilities))
    assert abs(np.mean(probabilities) - 1e-3) < 4.0 * error
    assert error < 1e-4


def test_failures_that_are_not_rare_are_counted() -> None:
    """With Clopper and Pearson's interval: that of 20 of 100 is known from tables, 12.7 to 29.2 %."""
    level = Level(np.repeat([-1.0, 1.0], [10, 40]), np.arange(50), 0.0, 10, np.ones(50))
    counted = estimate([[Repeat((level,), 50)] * 2])
    assert counted.probability == 0.2
    assert (counted.low, counted.high) == pytest.approx((0.1267, 0.2918), abs=5e-5)


def test_without_a_failure_there_is_a_bound_alone() -> None:
    """The true probability is 1e-9, and the levels end at 1e-5: what all repeats reached is about as rare."""
    for seed in range(5):
        bound, made = simulated(TRUTHS["plane 6"], 1e-9, Budget(1e-4, 3000), seed)
        assert bound.probability is None
        assert (bound.low, bound.text) == (0.0, f"below {probability_text(bound.high)} (95 %)")
        assert 1e-5 < bound.high < 5e-4
        assert all(repeat.log_probability is None for repeat in made.repeats[0])


def test_margins_that_are_all_the_same_lead_nowhere() -> None:
    """Then 800 flights without a failure say 1 - 0.05^(1 / 800), as counting does."""
    bound = estimate([ended(lambda asked: np.ones(len(asked.points)))])
    assert bound.probability is None
    assert bound.high == pytest.approx(1.0 - 0.05 ** (1.0 / 800.0))
    assert "nothing says which flight is nearer to failure" in bound.method


def ended(margin: Callable[[Candidates], Any], seed: int | None = None) -> list[Repeat]:
    def fly(asked: Mapping[Any, Candidates]) -> dict[Any, Any]:
        return {place: np.reshape(margin(each), (-1, 1)) for place, each in asked.items()}

    randoms = [np.random.default_rng(repeat) for repeat in range(8)]
    return list(answer_all(simulate_groups(3, Budget(1e-3, 2960), randoms, seed), fly).repeats[0])


def test_candidates_keep_the_normal_distribution_and_their_seeds_all_values() -> None:
    """All chains of a level that nothing was taken from: coordinates with mean 0 and variance 1, and seeds far apart."""
    asked: list[Candidates] = []

    def above(candidates: Candidates) -> Any:
        asked.append(candidates)
        return 3.0 + candidates.points[:, 0]

    repeats = ended(above)
    last = repeats[0].levels[1]
    assert np.all(last.margins < repeats[0].levels[0].threshold)
    free = np.concatenate([each.points[:, 1:] for each in asked])
    assert abs(np.mean(free)) < 0.1
    assert np.var(free) == pytest.approx(1.0, abs=0.1)
    seeds = [seed for each in asked for seed in each.seeds]
    assert len(set(seeds)) > len(seeds) / 3
    fixed: list[int] = []
    ended(lambda each: fixed.extend(each.seeds) or each.points[:, 0] + 3.0, seed=7)  # type: ignore[func-returns-value]
    assert set(fixed) == {7}


def test_seeds_that_decide_are_told() -> None:
    """A new seed is accepted as often as an old one where it does nothing, and seldom where half of it is noise."""
    for name, least, most in (("plane 6", 0.8, 1.2), ("noise", 0.05, MIN_SEED_EFFECT)):
        _, made = simulated(TRUTHS[name], 1e-4, Budget(1e-4, 3000), 1)
        effect = seed_effect(made.repeats[0])
        assert effect is not None
        assert least < effect < most
    assert seed_effect([Repeat((), 50)]) is None


def test_a_repeat_that_meets_none_counts_as_one_flight_of_its_last_level() -> None:
    first = Level(np.arange(1.0, 101.0), np.arange(100), 11.0, 10, np.ones(100))
    hit = Repeat((first, Level(np.array([-1.0, 1.0]), np.arange(2), 0.0, 1, np.ones(2))), 190)
    miss = Repeat((first, Level(np.ones(100), np.arange(100), 0.0, 0, np.ones(100))), 190)
    made = estimate([[hit, hit, miss]])
    assert made.probability == pytest.approx((0.05 + 0.05 + 0.001) / 3.0)
    assert "1 of them met none" in made.method
    assert made.high >= lognormal_interval([log(0.1)] * 3)[1]  # what all reached: the first threshold


def test_the_interval_of_a_lognormal_mean_holds_it() -> None:
    """Of 8 lognormal numbers as wide as repeats of 1e-6 are: 95 % of intervals, and of the upper ends 97.5 %."""
    random = np.random.default_rng(1)
    ends = [lognormal_interval(random.normal(-0.5, 1.0, 8).tolist()) for _ in range(2000)]
    held = sum(low <= 1.0 <= high for low, high in ends)
    assert binom.ppf(1e-4, 2000, 0.93) <= held <= binom.ppf(1.0 - 1e-4, 2000, 0.97)


def test_probabilities_are_written_with_two_digits() -> None:
    assert Estimate(9.1e-6, 4.2e-6, 2.14e-5, "").text == "9.1e-6 (95 %: 4.2e-6 to 2.1e-5)"
    assert Estimate(0.0231, 0.02, 0.03, "").text == "0.023 (95 %: 0.02 to 0.03)"
    assert probability_text(0.00999) == "0.01"


def test_a_budget_that_is_too_small_is_refused() -> None:
    assert (Budget(1e-6, 5000).size, Budget(1e-6, 5000).most_levels, Budget(1e-5, 5000).size) == (90, 7, 110)
    with pytest.raises(InputError, match=r"budget 1000: 8 repeats of 7 levels down to 1.0e-6 take at least 2,560"):
        Budget(1e-6, 1000).check()
    Budget(1e-6, 2560).check()


def test_a_flight_that_breaks_several_requirements_counts_once() -> None:
    """Twice the same requirement is that requirement; two that exclude each other add up."""
    plane = TRUTHS["plane 2"]
    for second, times in ((1.0, 1.0), (-1.0, 2.0)):
        truth = replace(
            plane,
            margin=lambda points, seeds, level, second=second: np.stack(
                [level - points[:, 0], 3.0 * (level - second * points[:, 0])], axis=1
            ),
        )
        found = [simulated(truth, 1e-3, Budget(1e-3, 4000), seed)[0].probability or 0.0 for seed in range(10)]
        error = np.std(found) / np.sqrt(len(found))
        assert abs(np.mean(found) - times * 1e-3) < 4.0 * error
        assert error < 2e-4


def test_requirements_far_from_failure_share_a_simulation() -> None:
    normal = np.random.default_rng(1).standard_normal((2000, 3))
    near, curved, far = 4.0 - normal[:, 0], 1.0 - normal[:, 1] ** 4 / 400.0, 5.0 + 0.01 * normal[:, 2]
    distances = [measure_distance(margins)[0] for margins in (near, curved, far, np.ones(2000))]
    assert distances[0] == pytest.approx(4.0, abs=0.3)
    assert 3.0 < distances[1] < 20.0 < distances[2] < distances[3]
    margins = np.stack([far, curved, near], axis=1)
    assert [group.columns for group in group_requirements(margins, 4)] == [(2, 0), (1,)]
    assert [group.columns for group in group_requirements(margins, 1)] == [(2, 1, 0)]
    assert group_requirements(near[:, None], 4) == [Group((0,), (1.0,))]


def test_a_nearer_failure_contradicts_the_interval() -> None:
    found = NearestSearch(500, 4.0, 1.0, {"vehicle.mass_kg": 5.5})
    assert found.contradict(3e-5).startswith(
        "contradicted: a search finds a failure 4.00 standard deviations out (vehicle.mass_kg = 5.5), and 3.2e-5 of"
    )
    assert (
        found.contradict(4e-5) == replace(found, share=0.5).contradict(3e-5) == NearestSearch(500).contradict(0.0) == ""
    )
