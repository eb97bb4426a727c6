"""Whether a form explains a bench log: what is left over, and what was not fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import inf, isinf, isnan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from hexjet_identify.bench.fit import Estimate, Part, Problem, fit

BLOCKS = 6  # of the residuals, in delay and lags together
PAST = 8  # blocks of the command's past that they are tested against
SIGNIFICANCE = 1e-3
LEAST_SHARE = 0.1  # of the power of what is left over, that may follow the command; chosen by us
LEAST_SIZE = 2e-3  # of the output's swing, that is worth a word
ROW_SIZE = 0.1  # and of the command's row over delay and lags: when within its row it moved is not known
ACTIVE = 3.0  # delay and lags, for which the output is on its way after a movement
LEAST_QUIET = 5.0  # blocks at rest that are as good as independent, to know the noise by
LARGE = 0.1  # of the output's swing, that noise which remembers itself as long as delay and lags take may have (rms)
LEAST_ROWS = 10  # behind each end of a part that is held back, and of a movement
LEAST_MOVEMENTS = 4  # from which on every second one is held back, and not the second half of them
REST = 2.0  # delay and lags, for which a command stands before what counts as another movement
SHARES = (0.1, 0.5, 0.9)  # of the way, whose times are compared
LEAST_WAY = 0.1  # of the output's range, that a movement goes whose times are compared
END = 0.1  # of a movement's rows, whose mean is where it ends
NEAR_TIME = 0.1  # of a measured time, within which a foretold one is near
UNDER_WAY = 0.05  # of the model's quickest rate, above which a row is on its way
LEAST_GROUP = 0.15  # of the power of what is left over, that is worth a word
MOST_GROUPS = 3
LOPSIDED = 0.3  # mean over rms, above which rows are off to one side


class Misfit(NamedTuple):
    """What of the residuals belongs to the command: of what they follow of its past, or of their growth as it moves."""

    p: float
    share: float  # of the residuals' power, slow parts alone
    size: float  # its root mean square over the output's swing
    least_size: float = LEAST_SIZE  # below which it is not worth a word
    cause: str = ""  # what else than the command it follows

    @property
    def is_significant(self) -> bool:
        """Whether the form leaves more than chance does of what it should have explained, however small a share."""
        return self.p < SIGNIFICANCE and self.size > self.least_size

    @property
    def failed(self) -> bool:
        """Whether the form leaves something that it should have explained."""
        return self.is_significant and self.share > LEAST_SHARE

    @property
    def words(self) -> str:
        """What is to be said where it failed."""
        if self.cause:
            return (
                f"not explained: what is left over, {100.0 * self.size:.2g} % of the output's swing (rms), "
                f"{self.cause}; the bounds do not cover that, and no engine is left"
            )
        return (
            f"not explained: what is left over still follows the command, {100.0 * self.size:.2g} % of the output's "
            "swing (rms): an acceleration limit, or lag and gain that change with the level; the bounds do not cover "
            "that, and no engine is left"
        )


def test_residuals(parts: Sequence[Part], residual: Array, delay: float, total: float) -> Misfit:
    """Return whether the residuals of these logs, in blocks, belong to the command.

    ``delay`` and ``total``, the delay and all lags together, are the model's, in s.

    Three tests: whether they are large and remember themselves as long as the answer takes; whether they follow the
    command's past, its square, or the way in which it moved; and whether they are larger while the output is on its way
    than at rest.  The one that fails, or the last.
    """
    strange = _find_no_noise(parts, residual, total)
    if strange is not None:
        return strange
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
    unknown = max(map(_unknown_time, parts))
    swing = output_swing(parts)
    least = max(LEAST_SIZE, unknown / total)
    grown = _compare_noise(np.concatenate(moving), np.concatenate(quiet), swing)._replace(least_size=least)
    if grown.failed or not blocks:
        return grown
    return _regress(np.concatenate(blocks), np.concatenate(signals), swing, residual)._replace(least_size=least)


def _unknown_time(part: Part) -> float:
    """Return by how much a command's movements may be earlier or later than they are taken for, s (rms).

    A part of a row, and half of the rows that are lost where it moves, in whose middle a held one is taken to move.
    """
    rows = np.diff(part.command_times)
    row = float(np.median(rows))
    lost = np.maximum(rows[np.diff(part.command) != 0.0] - row, 0.0)
    return float(np.hypot(ROW_SIZE * row, 0.0 if part.straight else _rms(lost)))


def _find_no_noise(parts: Sequence[Part], residual: Array, total: float) -> Misfit | None:
    """Return what is left over where it is no noise, whatever it follows; else None."""
    size = _rms(residual) / output_swing(parts)
    memory = Problem(parts, 0.0).memory_of(residual)
    seconds = min(part.step for part in parts) / max(-float(np.log(max(memory, 1e-300))), 1e-12)
    if size > LARGE and seconds > total:
        why = "moves as slowly as the answer: a clock that wobbles, another engine, a zero that wanders"
        return Misfit(0.0, 1.0, size, cause=why)
    return None


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


class Foretold(NamedTuple):
    """One movement of a command, foretold by the model as fitted to others."""

    log: int  # counted from 0
    begin: float  # s, in the log's time
    first: float  # output before it, in its unit
    last: float  # and at its end
    rms: float  # by which it is off, in the output's unit
    measured: tuple[float, ...] = ()  # s to 10, 50, 90 % of the way; none of a movement that goes nowhere
    model: tuple[float, ...] = ()

    @property
    def off(self) -> tuple[float, ...]:
        """By how much each time is off, as a share of the measured one; infinite where the model never gets there."""
        return tuple(inf if isnan(b) else b / a - 1.0 for a, b in zip(self.measured, self.model, strict=True))


class HeldBack(NamedTuple):
    """How far a model is off that was fitted to a part of the movements, rms in the output's unit."""

    fitted: float  # where it was fitted
    others: float  # in the others
    movements: tuple[Foretold, ...] = ()  # each foretold, where every second one was held back

    def to_dict(self) -> dict[str, object]:
        """Return it for JSON."""
        movements = [
            one._asdict() | {"model": [None if isnan(time) else time for time in one.model]} for one in self.movements
        ]
        return {"fitted_rms": self.fitted, "others_rms": self.others, "movements": movements}


def describe_held_back(held_back: HeldBack, unit: str, swing: float) -> str:
    """Describe how far a model fitted on a part of the movements is off in the others, and where it was fitted.

    ``swing``: the output's range, beyond which it does not matter by how much.
    """

    def far(value: float) -> str:
        if not value < swing:
            return "more than the output's whole range"
        return f"{value:.3g} {unit}".strip() + f" ({100.0 * value / swing:.2g} % of its range)"

    part, rest = (
        ("every second movement", "others") if held_back.movements else ("the first half of the movements", "second")
    )
    words = (
        f"fitted on {part} it is off by {far(held_back.others)} in the {rest}, and by {far(held_back.fitted)} where it "
        "was fitted"
    )
    off = [(abs(far), share, one) for one in held_back.movements for far, share in zip(one.off, SHARES, strict=False)]
    if not off:
        return words
    worst, share, one = max(off, key=lambda each: each[0])
    near = sum(far <= NEAR_TIME for far, _, _ in off)
    by = "is never reached" if isinf(worst) else f"is off by {100.0 * worst:.2g} %"
    return (
        f"{words}; of {len(off)} times to 10, 50 and 90 % of the way {near} are foretold within "
        f"{100.0 * NEAR_TIME:g} %, the worst, to {100.0 * share:g} % of the movement at {one.begin:.5g} s, {by}"
    )


def movement_rows(held_back: HeldBack, unit: str, swing: float) -> list[list[str]]:
    """Return a row of a table for each movement that was foretold; :data:`MOVEMENT_COLUMNS` has its head."""
    several = any(one.log for one in held_back.movements)
    return [
        [
            f"{f'log {one.log + 1}, ' if several else ''}{one.begin:.5g} s",
            f"{one.first:.4g} to {one.last:.4g} {unit}".strip(),
            f"{100.0 * one.rms / swing:.2g} %",
            *(
                f"{time:.3g} s ({'never' if isinf(off) else f'{100.0 * off:+.0f} %'})"
                for time, off in zip(one.measured, one.off, strict=True)
            ),
            *([""] * (len(SHARES) - len(one.measured))),
        ]
        for one in held_back.movements
    ]


MOVEMENT_COLUMNS = ("movement", "output", "off, of the range", "measured to 10 %", "50 %", "90 %")


def describe_lack(parts: Sequence[Part], residual: Array) -> str:
    """Describe where a model fails that does not explain its logs: up or down, at which levels, and which way.

    Of the rows on their way, by direction and half of the output's range, and of those at rest: the groups with most of
    the squared residual, and by how much the engine is ahead of the model or behind it.
    """
    output = np.concatenate([part.output for part in parts])
    low, swing = float(output.min()), float(np.ptp(output))
    begin, rates = 0, []
    for part in parts:
        rows = slice(begin, begin + len(part.times))
        begin = rows.stop
        rates.append(np.gradient(part.output - residual[rows], part.times))
    rate = np.concatenate(rates)
    moving = np.abs(rate) > UNDER_WAY * float(np.percentile(np.abs(rate), 99.0))
    upper = output - residual > low + 0.5 * swing
    power, said = max(float(residual @ residual), 1e-300), []

    def add(rows: NDArray[np.bool_], sign: float, words: str) -> None:
        off = residual[rows]
        share = float(off @ off) / power
        if share >= LEAST_GROUP:
            mean, rms = (100.0 * value / swing for value in (sign * off.mean(), np.sqrt(np.mean(off**2))))
            side = "ahead of" if mean > 0.0 else "behind"
            by = f"{side} the model by {abs(mean):.2g} % of the range in the mean, {rms:.2g} % rms"
            by = by if abs(mean) > LOPSIDED * rms else f"off by {rms:.2g} % of the range, rms"
            said.append((share, f"{words} the engine is {by} ({100.0 * share:.0f} %)"))

    for way, sign in (("up", 1.0), ("down", -1.0)):
        for half in ("lower", "upper"):
            rows_there = moving & (rate * sign > 0.0) & (upper == (half == "upper"))
            add(rows_there, sign, f"on the way {way} in the {half} half of the range")
    add(~moving, 0.0, "while the model stands still")
    groups = "; ".join(words for _, words in sorted(said, reverse=True)[:MOST_GROUPS])
    return (
        f"what the model lacks, with its part of the power of what is left over: {groups or 'nothing that stands out'}"
    )


def find_movements(part: Part, rest: float) -> list[tuple[float, float]]:
    """Return begin and end [s] of the movements of a log's command, before each of which it stands for ``rest`` s.

    A movement ends where the next begins; none where any has too few rows.
    """
    changed = np.flatnonzero(np.diff(part.command)) + 1
    at = part.command_times[changed]
    begins = part.command_times[changed - 1] if part.straight else at
    begins = begins[begins - np.concatenate([[-np.inf], at[:-1]]) > rest]
    begins = begins[(begins >= part.times[0]) & (begins < part.times[-1])]
    edges = [*begins.tolist(), float(np.nextafter(part.times[-1], np.inf))]
    spans = list(pairwise(edges))
    enough = all(np.count_nonzero((part.times >= a) & (part.times < b)) >= LEAST_ROWS for a, b in spans)
    return spans if enough else []


def hold_back(
    parts: Sequence[Part], total: float, foretell: Callable[[list[NDArray[np.bool_]]], Array]
) -> HeldBack | None:
    """Fit to a part of the movements and foretell the others; None where nothing can be held back.

    ``foretell`` fits the rows that it is told and returns the answer at all.  With four movements or more, each after a
    rest of two times ``total`` (delay and lags together, s), every second one is fitted, then the others; else the
    first half alone.
    """
    spans = [find_movements(part, REST * total) for part in parts]
    output = np.concatenate([part.output for part in parts])
    if sum(map(len, spans)) < LEAST_MOVEMENTS or min(map(len, spans)) < 2:
        early = first_half(parts)
        if early is None:
            return None
        off, before = output - foretell(early), np.concatenate(early)
        return HeldBack(_rms(off[before]), _rms(off[~before]))
    known = np.zeros(len(output))
    answer = np.zeros(len(output))
    for parity in (0, 1):
        fitted, count = [], parity
        for part, own in zip(parts, spans, strict=True):
            use = part.times < own[0][0]
            for number, (begin, end) in enumerate(own):
                if (count + number) % 2 == 0:
                    use |= (part.times >= begin) & (part.times < end)
            count += len(own)
            fitted.append(use)
        found, rows = foretell(fitted), np.concatenate(fitted)
        known[rows], answer[~rows] = (output - found)[rows], found[~rows]
    moved = np.concatenate([part.times >= own[0][0] for part, own in zip(parts, spans, strict=True)])
    movements, begin = [], 0
    for log, (part, own) in enumerate(zip(parts, spans, strict=True)):
        own_answer = answer[begin : begin + len(part.times)]
        begin += len(part.times)
        movements += [_foretold(log, part, span, own_answer, output) for span in own]
    return HeldBack(_rms(known[moved]), _rms((output - answer)[moved]), tuple(movements))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _foretold(log: int, part: Part, span: tuple[float, float], answer: Array, output: Array) -> Foretold:
    use = (part.times >= span[0]) & (part.times < span[1])
    times, measured, model = part.times[use] - span[0], part.output[use], answer[use]
    last = max(2, round(END * len(times)))
    before = part.output[part.times < span[0]][-last:]
    first, end = float((before if len(before) else measured[:1]).mean()), float(measured[-last:].mean())
    found = Foretold(log, span[0], first, end, _rms(measured - model))
    if abs(end - first) < LEAST_WAY * float(np.ptp(output)):
        return found
    real = _crossings(times, measured, first, end)
    if any(isnan(time) or not time > 0.0 for time in real):
        return found
    return found._replace(measured=real, model=_crossings(times, model, float(model[0]), float(model[-last:].mean())))


def _crossings(times: Array, values: Array, first: float, end: float) -> tuple[float, ...]:
    """Return when a part of the way is passed for the first time, s; nan where it never is."""
    way = (values - first) / (end - first if end != first else np.nan)
    found = []
    for share in SHARES:
        above = np.flatnonzero(way >= share)
        k = int(above[0]) if len(above) else 0
        found.append(float(np.interp(share, way[k - 1 : k + 1], times[k - 1 : k + 1])) if k else float("nan"))
    return tuple(found)


def predict_held_back(problem: Problem, estimate: Estimate) -> HeldBack | None:
    """Return how far a form is off, fitted to a part of the command's movements, there and in the others."""

    def foretell(use: list[NDArray[np.bool_]]) -> Array:
        parts = [part.chosen(rows) for part, rows in zip(problem.parts, use, strict=True)]
        half = Problem(parts, problem.longest_delay)
        fitted = fit(half, estimate.form, estimate)
        linear = half.shares(fitted.form, fitted.x, fitted.memory)[0]
        return np.asarray(problem.regressors(fitted.form, fitted.x) @ linear)

    return hold_back(problem.parts, estimate.total[0], foretell)
