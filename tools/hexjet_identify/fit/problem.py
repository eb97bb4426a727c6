"""Logs of one engine that are fitted together: the static line's levels, and noise that remembers itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from cosim.base.arrays import Array, Flags
from hexjet_identify.fit.answers import hats
from hexjet_identify.fit.logs import Log

# The correlation of noise from row to row is looked for up to this.
MAX_MEMORY = 0.999


@dataclass
class Problem:
    """Logs of one engine that are fitted together, with ``knots`` of the static line in shares of the command.

    ``drift``: columns at the rows of all logs, which take up a gain that drifts.
    """

    logs: Sequence[Log]
    knots: Array
    max_delay: float
    drift: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        self.logs = [log.without_repeats() for log in self.logs]
        self.drift = self.drift if self.drift.size else np.zeros((len(self.output), 0))

    @cached_property
    def spans(self) -> list[slice]:
        """Rows of each log in those of all."""
        ends = np.cumsum([0, *(len(log.times) for log in self.logs)])
        return [slice(int(begin), int(end)) for begin, end in pairwise(ends)]

    @cached_property
    def output(self) -> Array:
        """All logs' output, one behind the other."""
        return np.concatenate([log.output for log in self.logs])

    @cached_property
    def swing(self) -> float:
        """Range of the output."""
        return max(float(np.ptp(self.output)), 1e-300)

    @cached_property
    def step(self) -> float:
        """Shortest time between two rows, s."""
        return min(log.step for log in self.logs)

    @cached_property
    def hats(self) -> list[Array]:
        """Shares of the static levels in each log's commands."""
        return [hats(log.command, self.knots) for log in self.logs]

    @cached_property
    def binding(self) -> Array:
        """Rows that bind, very weakly, a level to those beside it: one that no row tells lies between them."""
        rows = np.zeros((max(len(self.knots) - 2, 0), len(self.knots)))
        for row, (low, mid, high) in enumerate(zip(self.knots, self.knots[1:], self.knots[2:], strict=False)):
            rows[row, row : row + 3] = (high - mid) / (high - low), -1.0, (mid - low) / (high - low)
        return np.asarray(rows * 1e-6 * np.sqrt(len(self.output)))

    def at(self, rows: Flags) -> Problem:
        """Return the problem with these rows alone."""
        logs = [log.at(rows[span]) for log, span in zip(self.logs, self.spans, strict=True)]
        return Problem(logs, self.knots, self.max_delay, self.drift[rows])

    def whiten(self, values: Array, memory: float) -> Array:
        """Return rows less what the row before says of them, all of one size; a gap makes that less."""
        if memory == 0.0:
            return values
        white = np.array(values, dtype=float)
        shape = (-1,) + (1,) * (white.ndim - 1)
        for log, span in zip(self.logs, self.spans, strict=True):
            kept, scale = _kept(log, memory)
            own = values[span]
            new = (own[1:] - kept.reshape(shape) * own[:-1]) / scale.reshape(shape)
            white[span] = np.concatenate([own[:1] * np.sqrt(1.0 - memory**2), new])
        return white

    def whitening_deviance(self, memory: float) -> float:
        """Return what the whitening adds to the deviance."""
        if memory == 0.0:
            return 0.0
        own = (2.0 * float(np.log(_kept(log, memory)[1]).sum()) for log in self.logs)
        return sum(own) - len(self.logs) * float(np.log(1.0 - memory**2))

    def memory_of(self, residual: Array) -> float:
        """Return the correlation of a residual with the row before, of rows that follow each other, not below 0."""
        above = below = 0.0
        for log, span in zip(self.logs, self.spans, strict=True):
            own, near = residual[span], np.diff(log.times) < 1.5 * log.step
            above += float((own[1:] * own[:-1])[near].sum())
            below += float((0.5 * (own[1:] ** 2 + own[:-1] ** 2))[near].sum())
        return float(np.clip(above / below, 0.0, MAX_MEMORY)) if below > 0.0 else 0.0


def _kept(log: Log, memory: float) -> tuple[Array, Array]:
    """Return what each row keeps of the noise of the one before, and the size of what is new in it, relative."""
    kept = memory ** (np.diff(log.times) / log.step)
    return kept, np.sqrt((1.0 - kept**2) / (1.0 - memory**2))
