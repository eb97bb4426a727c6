"""Whether a form explains a bench log: what is left over, and what was not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.identify.bench.fit import Estimate, Part, Problem, fit

BLOCKS = 6  # of the residuals, in delay and lags together
PAST = 8  # blocks of the command's past that they are tested against
SIGNIFICANCE = 1e-3
LEAST_SHARE = 0.1  # of the power of what is left over, that may follow the command; chosen by us
LEAST_SIZE = 2e-3  # of the output's swing, that is worth a word
ROW_SIZE = 0.1  # and of the command's row over delay and lags: when within its row it moved is not known
ACTIVE = 3.0  # delay and lags, for which the output is on its way after a movement
LEAST_QUIET = 5.0  # blocks at rest that are as good as independent, to know the noise by
LEAST_ROWS = 10  # behind each end of a part that is held back


class Misfit(NamedTuple):
    """What of the residuals belongs to the command: of what they follow of its past, or of their growth as it moves."""

    p: float
    share: float  # of the residuals' power, slow parts alone
    size: float  # its root mean square over the output's swing
    least_size: float = LEAST_SIZE  # below which it is not worth a word

    @property
    def failed(self) -> bool:
        """Whether the form leaves something that it should have explained."""
        return self.p < SIGNIFICANCE and self.share > LEAST_SHARE and self.size > self.least_size

    @property
    def words(self) -> str:
        """What is to be said where it failed."""
        return (
            f"not explained: what is left over still follows the command, {100.0 * self.size:.2g} % of the output's "
            "swing (rms): an acceleration limit, or lag and gain that change with the level; the bounds do not cover "
            "that, and no engine is left"
        )


def test_residuals(parts: Sequence[Part], residual: Array, delay: float, total: float) -> Misfit:
    """Return whether the residuals of these logs, in blocks, belong to the command.

    ``delay`` and ``total``, the delay and all lags together, are the model's, in s.

    Two tests: whether they follow its past, its square, or the way in which it moved; and whether they are larger
    while the output is on its way than at rest.  The one that fails, or the first.
    """
    blocks, signals, moving, quiet = [], [], [], []
    begin = 0
    for part in parts:
        rows = slice(begin, begin + len(part.times))
        begin = rows.stop
        means, command, active = _blocks(part, residual[rows], delay, total)
        memory = _memory(means)
        if len(means) > PAST + 1:
            features = _features(command)
            blocks.append((means[1:] - memory * means[:-1])[PAST - 1 :])
            signals.append((features[1:] - memory * features[:-1])[PAST - 1 :])
        moving.append(means[active])
        quiet.append(means[~active])
    row = max(float(np.median(np.diff(part.command_times))) for part in parts)
    swing = output_swing(parts)
    least = max(LEAST_SIZE, ROW_SIZE * row / total)
    grown = _compare_noise(np.concatenate(moving), np.concatenate(quiet), swing)._replace(least_size=least)
    if grown.failed or not blocks:
        return grown
    return _regress(np.concatenate(blocks), np.concatenate(signals), swing, residual)._replace(least_size=least)


def _compare_noise(moving: Array, quiet: Array, swing: float) -> Misfit:
    """Return whether residuals are larger in the first blocks than in the others, by F with as many as are alone."""
    from scipy.special import fdtrc

    if min(len(moving), len(quiet)) < LEAST_QUIET:
        return Misfit(1.0, 0.0, 0.0)
    memory = _memory(quiet) ** 2
    alone = (1.0 - memory) / (1.0 + memory)
    large, small = float(np.mean(moving**2)), float(np.mean(quiet**2))
    if not small > 0.0 or alone * len(quiet) < LEAST_QUIET:
        return Misfit(1.0, 0.0, 0.0)
    p = float(fdtrc(max(alone * len(moving), 1.0), alone * len(quiet), large / small))
    return Misfit(p, max(1.0 - small / max(large, 1e-300), 0.0), float(np.sqrt(max(large - small, 0.0))) / swing)


def _blocks(part: Part, residual: Array, delay: float, total: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return means of the residual over blocks, the delayed command there, and whether it has moved of late."""
    width = max(part.step, total / BLOCKS)
    number = ((part.times - part.times[0]) / width).astype(np.int64)
    count = int(number[-1]) + 1
    filled = np.bincount(number, minlength=count)
    means = np.bincount(number, residual, minlength=count) / np.maximum(filled, 1)
    middle = part.times[0] + (np.arange(count) + 0.5) * width - delay
    delayed = part.command_times + delay
    moved = delayed[1:][np.diff(part.command) != 0.0]
    last = np.searchsorted(moved, middle + delay + 0.5 * width, side="right") - 1
    since = np.where(last >= 0, middle + delay - moved[np.maximum(last, 0)], np.inf)
    active = since < ACTIVE * total
    return means[filled > 0], part.piecewise(1.0).lagged(0.05 * width, middle)[filled > 0], active[filled > 0]


def _features(command: Array) -> Array:
    moved = np.diff(command, prepend=command[0])
    square = (command - command.mean()) ** 2
    columns = []
    for signal in (command, square, np.abs(moved), moved * np.abs(moved), command * moved):
        columns += [np.concatenate([np.full(n, signal[0]), signal[: len(signal) - n]]) for n in range(PAST)]
    return np.column_stack([*columns, np.ones(len(command))])


def _memory(values: Array) -> float:
    power = float(values @ values)
    return float(np.clip(values[1:] @ values[:-1] / power, 0.0, 0.98)) if power > 0.0 else 0.0


def _regress(values: Array, signals: Array, swing: float, residual: Array) -> Misfit:
    from scipy.special import fdtrc

    size = np.sqrt(np.einsum("ij,ij->j", signals, signals))
    size[size == 0.0] = 1.0
    solution, _, rank, _ = np.linalg.lstsq(signals / size, values, rcond=1e-6)
    power = float(values @ values)
    left = values - signals @ (solution / size)
    freedom = len(values) - int(rank)
    if not power > 0.0 or freedom < LEAST_ROWS:
        return Misfit(1.0, 0.0, 0.0)
    explained = max(power - float(left @ left), 0.0)
    by_chance = int(rank) * (power - explained) / freedom
    share = max(explained - by_chance, 0.0) / power
    p = float(fdtrc(int(rank), freedom, (explained / int(rank)) / max((power - explained) / freedom, 1e-300)))
    return Misfit(p, share, float(np.sqrt(share * np.mean(residual**2))) / swing)


def first_half(parts: Sequence[Part]) -> list[NDArray[np.bool_]] | None:
    """Return the rows of each log before half of the command's movements are done.

    None where there is nothing to hold back: a single movement, or too few rows.
    """
    early: list[NDArray[np.bool_]] = []
    for part in parts:
        moved = np.abs(np.diff(part.command))
        total = np.cumsum(moved)
        at = int(np.searchsorted(total, 0.5 * total[-1], side="right"))
        if np.count_nonzero(moved) < 2 or at >= len(moved):
            return None
        before = part.times < float(part.command_times[min(at + 1, len(moved))])
        if min(before.sum(), (~before).sum()) < 2 * LEAST_ROWS:
            return None
        early.append(before)
    return early


def output_swing(parts: Sequence[Part]) -> float:
    """Return the range of all logs' output, in its unit."""
    return float(np.ptp(np.concatenate([part.output for part in parts])))


def describe_held_back(held_back: tuple[float, float], unit: str, swing: float) -> str:
    """Describe how far a model fitted on the first half of the movements is off in the second, and in the first.

    ``swing``: the output's range, beyond which it does not matter by how much.
    """
    second = f"{held_back[1]:.3g} {unit}" if held_back[1] < swing else "more than the output's whole range"
    return (
        f"fitted on the first half of the movements it is off by {second} in the second, "
        f"and by {held_back[0]:.3g} {unit} where it was fitted"
    ).replace("  ", " ")


def predict_held_back(problem: Problem, estimate: Estimate) -> tuple[float, float] | None:
    """Return the rms in the first half of the command's movements, fitted alone, and in the second, foretold by it."""
    early = first_half(problem.parts)
    if early is None:
        return None
    parts = [part.chosen(use) for part, use in zip(problem.parts, early, strict=True)]
    half = Problem(parts, problem.longest_delay, problem.drift)
    fitted = fit(half, estimate.form, estimate)
    linear = half.shares(fitted.form, fitted.x, fitted.memory)[0]
    off: Array = np.asarray(problem.output - _columns_from(problem, early, fitted) @ linear)
    before = np.concatenate(early)
    return float(np.sqrt(np.mean(off[before] ** 2))), float(np.sqrt(np.mean(off[~before] ** 2)))


def _columns_from(problem: Problem, early: list[NDArray[np.bool_]], fitted: Estimate) -> Array:
    """Return the columns that were fitted for all rows: a drift counts from the middle of those that were fitted."""
    columns = problem.regressors(fitted.form, fitted.x)
    if problem.drift:
        count, begin = len(problem.parts), 0
        for n, (part, use) in enumerate(zip(problem.parts, early, strict=True)):
            rows = slice(begin, begin + len(part.times))
            columns[rows, 1 + 2 * count + n] = part.times - part.times[use].mean()
            begin = rows.stop
    return columns
