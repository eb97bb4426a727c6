"""Logs of one engine as a fit takes them: a command as a share of its range, and rows of the output."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array, Flags


@dataclass(frozen=True)
class Log:
    """A command from each of ``command_times`` on, and rows of the output at ``times`` [s].

    ``is_straight``: the command goes straight between its rows instead of standing still.  ``width`` [s]: each row of
    the output is a mean over so long.  ``index``: number of each row on an even clock, where rows may be lost.
    """

    command_times: Array
    command: Array
    times: Array
    output: Array
    step: float
    is_straight: bool = False
    width: float = 0.0
    index: NDArray[np.int64] | None = None

    @property
    def command_row(self) -> float:
        """Time between two rows of the command, s."""
        return float(np.median(np.diff(self.command_times)))

    def at(self, rows: Flags) -> Log:
        """Return the log with these rows of the output alone."""
        index = None if self.index is None else self.index[rows]
        return replace(self, times=self.times[rows], output=self.output[rows], index=index)

    def averaged(self, seconds: float) -> Log:
        """Return the log with rows averaged over at most ``seconds``; rows beside a gap are left out."""
        many = int(seconds / self.step)
        if many < 2:
            return self
        count = len(self.times) // many * many
        times = self.times[:count].reshape(-1, many)
        whole = np.ptp(times, axis=1) < 1.5 * many * self.step
        output = self.output[:count].reshape(-1, many).mean(axis=1)
        log = replace(self, times=times.mean(axis=1)[whole], output=output[whole], step=many * self.step)
        return replace(log, width=log.step).with_fewer_commands(seconds)

    def with_fewer_commands(self, seconds: float) -> Log:
        """Return the log with a moving command averaged over half of ``seconds``, which does not shift it in time."""
        many = int(0.5 * seconds / self.command_row)
        rows = len(self.command)
        if many < 2 or rows < 2 * many or np.count_nonzero(np.diff(self.command)) < 0.5 * rows:
            return self
        count = rows // many * many
        times, command = (values[:count].reshape(-1, many) for values in (self.command_times, self.command))
        begins = times.mean(axis=1) if self.is_straight else times[:, 0]
        return replace(self, command_times=begins, command=command.mean(axis=1))

    def with_more_commands(self, seconds: float, most: int = 8) -> Log:
        """Return the log with a straight command resampled on a spline every ``seconds``, ``most`` points a row."""
        from scipy.interpolate import CubicSpline

        parts = min(int(np.ceil(self.command_row / seconds)), most)
        if not self.is_straight or parts < 2:
            return self
        rows = np.arange(len(self.command))
        times = np.interp(np.arange(rows[-1] * parts + 1) / parts, rows, self.command_times)
        return replace(self, command_times=times, command=CubicSpline(self.command_times, self.command)(times))

    def without_repeats(self) -> Log:
        """Return the log without the rows of a held command that change nothing."""
        if self.is_straight:
            return self
        changed = np.concatenate([[True], np.diff(self.command) != 0.0])
        return replace(self, command_times=self.command_times[changed], command=self.command[changed])

    def moves_within(self, seconds: float) -> Flags:
        """Return which rows of the output lie within ``seconds`` after the command last moved."""
        moved = self.command_times[1:][np.diff(self.command) != 0.0]
        last = np.concatenate([[-np.inf], moved])[np.searchsorted(moved, self.times, "right")]
        return np.asarray(self.times - last <= seconds)

    def find_movements(self, rest: float) -> list[tuple[float, float]]:
        """Return begin and end [s] of each movement of the command before which it stands for ``rest`` s.

        A movement ends where the next begins.
        """
        changed = np.flatnonzero(np.diff(self.command)) + 1
        moved = self.command_times[changed]
        begins = self.command_times[changed - 1] if self.is_straight else moved
        begins = begins[begins - np.concatenate([[-np.inf], moved[:-1]]) > rest]
        begins = begins[(begins >= self.times[0]) & (begins < self.times[-1])]
        return list(pairwise([*begins.tolist(), float(np.nextafter(self.times[-1], np.inf))]))


def smooth(times: Array, values: Array, seconds: float) -> Array:
    """Return the moving average of values over ``seconds``, symmetric about each row."""
    count = len(values)
    rows: NDArray[np.int64] = np.arange(count)
    half = np.minimum.reduce(
        [
            rows - np.searchsorted(times, times - 0.5 * seconds),
            np.searchsorted(times, times + 0.5 * seconds, "right") - 1 - rows,
            rows,
            count - 1 - rows,
        ]
    )
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((sums[rows + half + 1] - sums[rows - half]) / (2 * half + 1))
