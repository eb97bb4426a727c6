"""One stretch of a log on its own clock, and the exact answer of a pole to its command."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array

_CACHE_SIZE = 8  # answers that are remembered

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Stretch:
    """One stretch of a log without a break; times in s from its beginning.

    ``command[k]`` acts over ``[k step, (k + 1) step)``.  Sample ``i`` of the output was taken at ``times[i]`` and
    counts to number ``block[i]`` of ``blocks`` working samples, each the mean of its samples.
    """

    start: float  # in the time of the log
    step: float
    command: Array
    times: Array
    output: Array
    block: Ints
    blocks: int

    @property
    def seconds(self) -> float:
        """Duration of the stretch, s."""
        return len(self.command) * self.step

    @cached_property
    def _counts(self) -> Array:
        return np.bincount(self.block, minlength=self.blocks).astype(np.float64)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Which working samples have values."""
        return self._counts > 0.0

    def commanded(self, times: Array) -> Array:
        """Return the command that acts at these times, s."""
        return self.command[self._cell(times)]

    def _cell(self, times: Array) -> Ints:
        return np.clip((times / self.step).astype(np.int64), 0, len(self.command) - 1)

    def averaged(self, values: Array) -> Array:
        """Return the mean over each working sample, 0 for a sample without values."""
        return np.bincount(self.block, values, minlength=self.blocks) / np.maximum(self._counts, 1.0)

    def answer(self, pole: float, delay: float) -> Array:
        """Return the answer of ``1 / (s + pole)`` to the delayed command at ``times``, from rest at the first value."""
        states = self._states(pole)
        cell, within, begun = self._late(delay)
        fade = np.exp(-pole * within)
        input_gain = (1.0 - fade) / pole if pole > 1e-6 else within
        return np.asarray((states[cell] * fade + input_gain * self.command[cell]) * begun)

    @cached_property
    def _caches(self) -> tuple[dict[float, Array], dict[float, tuple[Ints, Array, Array]]]:
        """Cache of recent results: a derivative changes one parameter at a time."""
        return {}, {}

    def _states(self, pole: float) -> Array:
        from scipy.signal import lfilter

        cache = self._caches[0]
        if pole not in cache:
            if len(cache) >= _CACHE_SIZE:
                cache.pop(next(iter(cache)))
            states = lfilter([float(hold_response(pole, self.step))], [1.0, -exp(-pole * self.step)], self.command)
            cache[pole] = np.concatenate([[0.0], states])
        return cache[pole]

    def _late(self, delay: float) -> tuple[Ints, Array, Array]:
        """Return the cell of each delayed sample, the time within it, s, and 0 before the stretch or else 1."""
        cache = self._caches[1]
        if delay not in cache:
            if len(cache) >= _CACHE_SIZE:
                cache.pop(next(iter(cache)))
            late = self.times - delay
            cell = self._cell(late)
            cache[delay] = cell, late - cell * self.step, (late > 0.0).astype(np.float64)
        return cache[delay]


def hold_response(pole: float, seconds: float | Array) -> Array:
    """Return the answer of ``1 / (s + pole)`` to a command of 1 after so many seconds."""
    return np.asarray(-np.expm1(-pole * seconds) / pole if pole > 1e-6 else seconds)
