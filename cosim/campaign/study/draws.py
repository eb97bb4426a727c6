"""The draws of a study: made from the study alone, the same on every machine, one block at a time.

A design spreads points over the unit cube, one side for each varied key: those of ``random`` are independent; a
``latin-hypercube`` of n runs has one in each nth of every side; those of ``sobol`` fill the cube evenly (scrambled).
Each side is then bent into what its key is drawn from by the inverse of the distribution.  Correlated keys are bent
together, through normal variables of that correlation (a Gaussian copula); in a Latin hypercube the points of a side
change places instead (Iman and Conover, 1982), so that it stays one.  An engine that is drawn by its uncertainty has
sides of its own behind those of the keys (:mod:`cosim.campaign.study.engine_draw`).

A longer ``random`` or ``sobol`` study begins with the draws of the shorter one.  A Latin hypercube of another size is
another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log, prod
from typing import Any, Protocol, TypeVar, overload

import numpy as np

from cosim.base.arrays import Array
from cosim.campaign.study.distributions import CASE, Vary
from cosim.campaign.study.engine_draw import MIN_QUANTILE, EngineDraw
from cosim.campaign.study.key import Key, Value
from cosim.campaign.study.study import Study
from cosim.campaign.study.values import absolute_support, levels, quantum, round_to_steps, whole_bounds

# Draws that are computed together: a power of 2, as Sobol's sequence needs.
BLOCK = 1024
POINTS, SEEDS = 0, 1  # indices of a seed's random streams


@dataclass(frozen=True)
class Draw:
    """Inputs of one draw, the same for each controller: absolute values by dotted key, and a seed."""

    number: int
    seed: int
    values: dict[str, Value]


T = TypeVar("T")  # type of the items


class LazySequence(Sequence[T]):
    """A sequence whose elements are computed on access, because there may be a million."""

    @overload
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice) -> list[T]: ...

    def __getitem__(self, index: int | slice) -> T | list[T]:
        # An index past the end raises IndexError, which also ends a for loop over this object.
        chosen = range(len(self))[index]
        return self._compute_item(chosen) if isinstance(chosen, int) else [self._compute_item(each) for each in chosen]

    def _compute_item(self, number: int) -> T:
        raise NotImplementedError


class Draws(LazySequence[Draw]):
    """The draws of a study by number, from 0, made in blocks on demand."""

    def __init__(self, study: Study) -> None:
        self._count = study.draws
        self._seed = study.seed
        self._names, self._case_seeds = study.drawn, study.case_seeds
        engine = study.engine_draw()
        sides = len(study.vary) + (0 if engine is None else engine.sides)
        self._points: Points = DESIGNS[study.design](study, sides)
        side = level if study.design == "grid" else inverse
        self._bend = [
            _map_engine_sides(engine, len(study.vary)) if vary.uncertainty and engine is not None
            else _map_side(index, side(vary, study.key(vary.key)))
            for index, vary in enumerate(study.vary)
        ]  # fmt: skip
        self._block: tuple[int, list[Draw]] = (-1, [])

    def __len__(self) -> int:
        return self._count

    def _compute_item(self, number: int) -> Draw:
        block, index = divmod(number, BLOCK)
        if self._block[0] != block:
            self._block = (block, list(self._compute_draws(block * BLOCK, min(self._count, (block + 1) * BLOCK))))
        return self._block[1][index]

    def _compute_draws(self, first: int, end: int) -> Iterator[Draw]:
        points = self._points(first, end)
        columns = [column for bend in self._bend for column in bend(points)]
        for number, row in enumerate(zip(*columns, strict=True), start=first):
            values = dict(zip(self._names, row, strict=True))
            seed = self._case_seeds.get(values.get(CASE, ""))
            yield Draw(number, flight_seed(self._seed, number) if seed is None else seed, values)


def draws(study: Study) -> Draws:
    return Draws(study)


def flight_seed(seed: int, number: int) -> int:
    """Return the seed of a draw's noise and turbulence, from the study's seed and the draw's number alone.

    53 bits, which every reader of the results takes without loss.
    """
    return int(np.random.SeedSequence(seed, spawn_key=(SEEDS, number)).generate_state(1, np.uint64)[0] >> 11)


def _map_side(index: int, values: Callable[[Array], list[Value]]) -> Callable[[Array], list[list[Value]]]:
    """Return a function from one coordinate of points to values of a key."""
    return lambda points: [values(points[:, index])]


def _map_engine_sides(engine: EngineDraw, first: int) -> Callable[[Array], list[list[Value]]]:
    """Return a function from an engine's coordinates, beginning at ``first``, to values of its keys."""
    return lambda points: engine.values(points[:, first : first + engine.sides])


class Points(Protocol):
    """Function that returns the points of draws ``first`` to ``end - 1`` of one block: a row a draw, a column a key."""

    def __call__(self, first: int, end: int) -> Array: ...


class Grid:
    """All combinations of the keys' levels, by index; the last key changes fastest, repeats start over.

    The sides of an uncertain engine are drawn for each point.
    """

    def __init__(self, study: Study, sides: int) -> None:
        self._sides = [1 if vary.uncertainty else len(levels(vary, study.key(vary.key))) for vary in study.vary]
        self._seed, self._drawn = study.seed, sides - len(self._sides)

    def __call__(self, first: int, end: int) -> Array:
        indices = np.unravel_index(np.arange(first, end) % prod(self._sides), self._sides)
        points = np.stack(indices, axis=1).astype(np.float64)
        return np.hstack([points, _independent_points(self._seed, first, end, self._drawn)]) if self._drawn else points


class Random:
    """Independent random points; each block has its own generator, so that it is made without those before."""

    def __init__(self, study: Study, sides: int) -> None:
        self._seed, self._sides = study.seed, sides
        self._correlate = _make_copula(study)

    def __call__(self, first: int, end: int) -> Array:
        return self._correlate(_independent_points(self._seed, first, end, self._sides))


class Sobol:
    """Sobol's sequence, scrambled."""

    def __init__(self, study: Study, sides: int) -> None:
        self._seed, self._sides = study.seed, sides
        self._correlate = _make_copula(study)
        self._engine, self._next = self._restart_sequence()

    def __call__(self, first: int, end: int) -> Array:
        if first < self._next:
            self._engine, self._next = self._restart_sequence()
        if first > self._next:
            self._engine.fast_forward(first - self._next)
        self._next = first + BLOCK
        # The first block is whole, because scipy warns of another length.
        points: Array = self._engine.random(BLOCK)[: end - first]
        # Points have 30 bits and 0 is one of them: take the middle of the cell.
        return self._correlate(points + 2.0**-31)

    def _restart_sequence(self) -> tuple[Any, int]:
        from scipy.stats import qmc

        return qmc.Sobol(self._sides, scramble=True, bits=30, rng=_make_generator(self._seed)), 0


class LatinHypercube:
    """Latin hypercube sampling, all points at once: 8 bytes of memory for each key of each draw."""

    def __init__(self, study: Study, sides: int) -> None:
        self._study, self._sides = study, sides
        self._points: Array | None = None

    def __call__(self, first: int, end: int) -> Array:
        if self._points is None:
            study = self._study
            points = latin_hypercube(_make_generator(study.seed), study.draws, self._sides)
            self._points = reorder_points(np.maximum(points, MIN_QUANTILE), study.correlations(self._sides))
        return self._points[first:end]


DESIGNS: dict[str, Callable[[Study, int], Points]] = {  # sampler of each sampling
    "grid": Grid,
    "latin-hypercube": LatinHypercube,
    "random": Random,
    "sobol": Sobol,
}


def latin_hypercube(generator: np.random.Generator, draws: int, sides: int) -> Array:
    """Return points with one in each of ``draws`` equal parts of each side: shape (draws, sides).

    They are those of ``scipy.stats.qmc.LatinHypercube`` with this generator, without half a second for its import.
    """
    random = generator.spawn(1)[0]
    within = random.uniform(size=(draws, sides))
    parts = np.tile(np.arange(1, draws + 1), (sides, 1))
    for part in parts:
        random.shuffle(part)
    points: Array = (parts.T - within) / draws
    return points


def _independent_points(seed: int, first: int, end: int, sides: int) -> Array:
    """Return independent points of the block that begins with the draw ``first``."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POINTS, first // BLOCK)))
    return np.maximum(random.random((end - first, sides)), MIN_QUANTILE)


def _make_generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(POINTS,)))


def _correlated_keys(matrix: Array) -> list[int]:
    """Return the indices of the keys that are correlated with any other."""
    return [index for index, row in enumerate(matrix) if np.count_nonzero(row) > 1]


def _make_copula(study: Study) -> Callable[[Array], Array]:
    """Return a function that imposes the study's correlations on independent uniform points (Gaussian copula)."""
    matrix = study.correlations()
    sides = _correlated_keys(matrix)
    lower = np.linalg.cholesky(matrix[np.ix_(sides, sides)])

    def impose_correlations(points: Array) -> Array:
        if not sides:
            return points
        from scipy.special import ndtr, ndtri

        normal = ndtri(points[:, sides])
        points = points.copy()
        for row, side in enumerate(sides):
            # Summed in a fixed order: a matrix product's order of additions depends on the machine.
            together = sum(lower[row, column] * normal[:, column] for column in range(row + 1))
            points[:, side] = np.clip(ndtr(together), MIN_QUANTILE, 1.0 - MIN_QUANTILE * 2.0)
        return points

    return impose_correlations


def reorder_points(points: Array, matrix: Array) -> Array:
    """Reorder the values of each side so that the points have (nearly) these correlations.

    Normal scores of the ranks are freed of the correlation that they have by chance, given the one wanted, and the
    numbers of each side are put into the order of the scores (Iman and Conover, 1982).
    """
    sides = _correlated_keys(matrix)
    if not sides:
        return points
    from scipy.special import ndtri

    ranks = np.argsort(np.argsort(points[:, sides], axis=0), axis=0)
    scores = ndtri((ranks + 0.5) / len(points))
    target = np.linalg.cholesky(matrix[np.ix_(sides, sides)])
    try:
        sampled = np.linalg.cholesky(np.corrcoef(scores, rowvar=False))
    except np.linalg.LinAlgError:  # a few points may be collinear
        sampled = np.eye(len(sides))
    scores = scores @ np.linalg.inv(sampled).T @ target.T
    order = np.argsort(np.argsort(scores, axis=0, kind="stable"), axis=0, kind="stable")
    points = points.copy()
    for column, side in enumerate(sides):
        points[:, side] = np.sort(points[:, side])[order[:, column]]
    return points


def level(vary: Vary, key: Key) -> Callable[[Array], list[Value]]:
    """Return a function from indices along a grid's axis to values of its key."""
    values = levels(vary, key)
    return lambda indices: [values[int(index)] for index in indices]


def inverse(vary: Vary, key: Key) -> Callable[[Array], list[Value]]:
    """Return a function from points between 0 and 1 to values of a key."""
    if vary.values is not None:
        ladder = levels(vary, key)
        return lambda quantiles: [ladder[min(int(quantile * len(ladder)), len(ladder) - 1)] for quantile in quantiles]
    bend = _inverse_distribution(vary, *_bounds_of_draws(vary, key))
    scale, shift = _affine_relation(vary, key)
    low, high = absolute_support(vary, key)
    stepped = quantum(key) is not None

    def map_quantiles(quantiles: Array) -> list[Value]:
        numbers = bend(quantiles) * scale + shift
        if stepped:
            return [key.fit(value) for value in round_to_steps(numbers.tolist(), vary, key)]
        # Rounding may pass the bounds by one bit.
        return list(np.clip(numbers, low, high).tolist())

    return map_quantiles


def _affine_relation(vary: Vary, key: Key) -> tuple[float, float]:
    """Return scale and shift of value = scale * drawn + shift."""
    nominal = float(key.nominal or 0.0)
    return {"": (1.0, 0.0), "factor": (nominal, 0.0), "offset": (1.0, nominal)}[vary.relative]


def _bounds_of_draws(vary: Vary, key: Key) -> tuple[float, float]:
    """Return the bounds of the drawn number, half a step wider if it is rounded to whole steps."""
    step = quantum(key)
    if step is None:
        return vary.support
    first, last = whole_bounds(*absolute_support(vary, key), step)
    scale, shift = _affine_relation(vary, key)
    ends = [((end + half) * step - shift) / scale for end, half in ((first, -0.5), (last, 0.5))]
    return min(ends), max(ends)


def _inverse_distribution(vary: Vary, low: float, high: float) -> Callable[[Array], Array]:
    """Return the inverse of the cumulative distribution within bounds."""
    if vary.range is not None:
        if vary.scale == "log":
            ratio = log(high / low)
            return lambda quantiles: low * np.exp(quantiles * ratio)
        return lambda quantiles: low + quantiles * (high - low)
    from scipy import stats

    if vary.triangular is not None:
        mode = (vary.triangular.mode - low) / (high - low)
        return lambda quantiles: np.asarray(stats.triang.ppf(quantiles, mode, loc=low, scale=high - low))
    form = vary.normal or vary.lognormal
    assert form is not None
    return lambda quantiles: form.values(stats.truncnorm.ppf(quantiles, form.score(low), form.score(high)))
