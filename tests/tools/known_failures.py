"""Margins of a known probability of failure, in the place of flights, and simulations of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import log, sqrt

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from cosim.base.arrays import Array
from hexjet_prove.rare.estimate import Budget, Estimate, estimate
from hexjet_prove.rare.repeats import Simulations, simulate_groups
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
