"""What a study varies as independent standard normal coordinates: u, the space that reliability methods work in.

Each varied key has one coordinate, in the order of the study, and an engine that is drawn by its uncertainty has its
own behind them.  A point is mapped to values key by key: correlated keys first get their correlation (u -> L u with the
Cholesky factor of the copula of :mod:`cosim.campaign.study.draws`), then each coordinate goes through the standard
normal distribution function and the inverse one of what its key is drawn from.  So a standard normal u has the very
distribution that the study states, and |u| is a distance in standard deviations (M. Rosenblatt, Ann. Math. Statist. 23
(1952) 470-472; A. Nataf, C. R. Acad. Sci. 225 (1962) 42-43).

Noise and turbulence are made from a seed, which has no distance from another one: it is no coordinate, and is drawn
anew whole or kept.  Every seed is equally likely, so that either is a step that leaves the distribution as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from cosim.campaign.study.draws import Draw, inverse
from cosim.campaign.study.engine_draw import MIN_QUANTILE, EngineDraw
from cosim.campaign.study.key import Value
from cosim.campaign.study.study import Study

# Larger coordinates are clipped to it: 1 - 6e-16 is the last quantile below 1.
MAX_SIGMA = 8.0


class NormalSpace:
    """The varied keys of ``study`` as ``dimension`` independent standard normal coordinates, called ``names``.

    A coordinate has the name of its key; those of an uncertain engine are the keys that it is drawn by.
    Raises InputError for a grid, which states levels and no distribution.
    """

    def __init__(self, study: Study) -> None:
        if study.design == "grid":
            raise InputError(
                f"study {study.name}: a grid states levels and no probability; give each key a range, values or a "
                "distribution under design = 'random'"
            )
        engine = study.engine_draw()
        varied = [index for index, vary in enumerate(study.vary) if not vary.uncertainty]
        self.names = [study.vary[index].key for index in varied]
        if engine is not None:
            self.names += engine.names
        self.dimension = len(self.names)
        self._keys = study.drawn
        self._lower = np.eye(self.dimension)
        self._lower[: len(varied), : len(varied)] = np.linalg.cholesky(study.correlations()[np.ix_(varied, varied)])
        self._maps: list[Callable[[Array], list[list[Value]]]] = []
        side = iter(range(len(varied)))
        for vary in study.vary:
            if vary.uncertainty and engine is not None:
                self._maps.append(partial(_invert_engine, engine, len(varied)))
            else:
                self._maps.append(partial(_invert_key, inverse(vary, study.key(vary.key)), next(side)))

    def values(self, points: Array) -> list[dict[str, Value]]:
        """Return the values of the varied keys at each of ``points``, an array of shape (n, dimension).

        Values are absolute, by dotted key, as a flight of the study has them.
        """
        from scipy.special import ndtr

        # Summed in a fixed order: a matrix product's order of additions depends on the machine.
        correlated = sum(np.outer(points[:, side], self._lower[:, side]) for side in range(self.dimension))
        quantiles = np.clip(ndtr(np.clip(correlated, -MAX_SIGMA, MAX_SIGMA)), MIN_QUANTILE, 1.0 - MIN_QUANTILE * 2.0)
        columns = [column for transform in self._maps for column in transform(quantiles)]
        return [dict(zip(self._keys, row, strict=True)) for row in zip(*columns, strict=True)]

    def draw(self, point: Array, seed: int, number: int = 0) -> Draw:
        """Return the draw at one point (shape (dimension,)) with the seed of its noise and turbulence."""
        return Draw(number, seed, self.values(np.atleast_2d(point))[0])


def _invert_key(inverse: Callable[[Array], list[Value]], side: int, quantiles: Array) -> list[list[Value]]:
    return [inverse(quantiles[:, side])]


def _invert_engine(engine: EngineDraw, first: int, quantiles: Array) -> list[list[Value]]:
    return engine.values(quantiles[:, first:])


def draw_seed(random: np.random.Generator) -> int:
    """Return a new seed of a flight's noise and turbulence: all of its 53 bits are equally likely."""
    # An integer of 53 bits survives every reader, also those that read numbers as doubles.
    return int(random.integers(2**53))
