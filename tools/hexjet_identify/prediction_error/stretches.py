"""From two channels of a log to stretches on one clock: what is usable, when samples were taken, what is missing.

A stretch gives the exact answer of a pole to its command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.logs import Channel

WORKING_STEP_S = 0.004  # of the house's control steps; samples that come faster are averaged to about this
MOST_MISSING = 12  # samples that may be missing in a row; after more a new stretch begins
SETTLE_S = 0.3  # beside the longest delay, before the first output that counts: what was commanded before is not known
SHORTEST_S = 3.0  # that a stretch must have beyond that, and all of them together
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


class Clock(NamedTuple):
    """Step, jitter and loss of a channel's times."""

    step: float  # s
    jitter: float  # standard deviation around an even clock, in samples; NaN where there is no such clock
    lost_fraction: float  # of the samples


@dataclass(frozen=True)
class Prepared:
    """The stretches of a log, and what was found of its clocks."""

    stretches: tuple[Stretch, ...]
    working_step: float
    longest_delay: float
    command: Clock
    output: Clock
    late: float  # s, by which the command may have moved before its row; 0: rows come as controllers command
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Duration of the output in all stretches, s."""
        return self.working_step * sum(stretch.blocks for stretch in self.stretches)


def prepare(
    command: Channel,
    output: Channel,
    longest_delay: float,
    step: float | None = None,
    begin: float | None = None,
    end: float | None = None,
) -> Prepared:
    """Find the stretches of ``output`` in which ``command`` moved, from ``begin`` to ``end`` [s] of the log.

    ``step`` is that of the working samples.  Raises InputError where nothing is usable, which says why.
    """
    notes: list[str] = []
    command = _clean(command, "the command", notes)
    output = _clean(output, "the output", notes)
    low = max(command.times[0], output.times[0], -np.inf if begin is None else begin)
    high = min(command.times[-1], output.times[-1], np.inf if end is None else end)
    if not high - low > 0.0:
        raise InputError(
            f"command ({_span(command.times)}) and output ({_span(output.times)}) have no time in common"
            + ("" if begin is None and end is None else " with begin and end")
        )
    output = _within(output, low, high)
    clocks = clock_of(command.times), clock_of(output.times)
    sample = clocks[1].step
    for channel, clock in zip(("command", "output"), clocks, strict=True):
        if clock.step > longest_delay:
            raise InputError(
                f"the {channel} has a sample every {clock.step:.3g} s, and a delay of at most {longest_delay:g} s is "
                "looked for (longest_delay_s): no log of so fast a thing, or of another unit of time"
            )
    factor = max(1, round((WORKING_STEP_S if step is None else step) / sample))
    if step is None and clocks[1].lost_fraction > 0.005:
        # An equation needs all its predecessors, so that two rows of a log with losses are averaged.
        factor = max(factor, 2)
    working = factor * sample
    lead = longest_delay + SETTLE_S
    spans = [
        span
        for span in _find_movement(command, _find_unbroken(output.times, command.times, clocks))
        if span[1] - span[0] > lead + SHORTEST_S
    ]
    usable = sum(last - first - lead for first, last in spans)
    if usable < SHORTEST_S:
        raise InputError(
            "no stretch that can be used: the command must move, without gaps, for "
            f"{lead + SHORTEST_S:.3g} s or longer in flight; {_why(command, output, longest_delay)}"
        )
    if len(spans) > 1:
        notes.append(f"{len(spans)} stretches, {usable:.1f} s of {high - low:.1f} s")
    uneven = max(np.nan_to_num(clock.jitter) for clock in clocks) > 0.02
    filled = _interpolate_lost(command)
    shared = 1 if clocks[0].step >= 0.99 * sample and not uneven else 2
    cells = sample / shared
    stretches = tuple(_stretch(filled, output, span, lead, cells, sample, factor) for span in spans)
    late = _late(command.times, sample)
    if late:
        notes.append(
            f"the command has a row every {1e3 * late:.3g} ms and is taken to hold between them: if what flew "
            "commanded oftener, delay and lags are longer by up to that, by half of it in the mean; their bounds "
            "allow for it"
        )
    return Prepared(stretches, working, longest_delay, *clocks, late, tuple(notes))


def clock_of(times: Array) -> Clock:
    """Return step, jitter and loss of a channel's times."""
    step = float(np.median(np.diff(times)))
    index, even = _index(times)
    if even is None:
        return Clock(step, float("nan"), max(0.0, 1.0 - len(times) * step / (float(np.ptp(times)) + step)))
    fitted = float((even[-1] - even[0]) / max(index[-1] - index[0], 1))
    gaps = np.diff(index)
    short = gaps[(gaps > 1) & (gaps <= MOST_MISSING)] - 1  # longer ones are breaks, and not lost samples
    return Clock(fitted, float(np.std((times - even) / fitted)), float(short.sum() / (short.sum() + len(times))))


# ---- pieces


def _clean(channel: Channel, signal: str, notes: list[str]) -> Channel:
    """Return a channel without what is no number, in the order of time; of a clock that went back, the longest part."""
    times, values = channel.times, channel.values
    good = np.isfinite(times) & np.isfinite(values)
    if good.sum() < 2:
        raise InputError(f"{signal} has {int(good.sum())} values that are numbers; at least two are needed")
    if not good.all():
        notes.append(f"{signal}: {int((~good).sum())} of {len(good)} values are no numbers; left out")
        times, values = times[good], values[good]
    back = np.flatnonzero(np.diff(times) < 0.0) + 1
    if back.size:
        pieces = list(zip([0, *back], [*back, len(times)], strict=True))
        first, last = max(pieces, key=lambda part: times[part[1] - 1] - times[part[0]])
        notes.append(
            f"{signal}: its clock goes back {back.size} times (first after {times[back[0] - 1]:.3f} s, by "
            f"{times[back[0] - 1] - times[back[0]]:.3g} s); the longest part alone is used, {_span(times[first:last])}"
        )
        times, values = times[first:last], values[first:last]
    new = np.concatenate([[True], np.diff(times) > 0.0])
    if not new.all():
        notes.append(f"{signal}: {int((~new).sum())} values have the time of the one before; left out")
    if new.sum() < 2:
        raise InputError(f"{signal}: its time does not run")
    return Channel(times[new], values[new], channel.unit)


def _index(
    times: Array, lost_steps: float = 1.75, most_jitter: float = 0.35, run: int = 4
) -> tuple[NDArray[np.int64], Array | None]:
    """Return which tick of an even clock each time is nearest to, and the ticks' times, None without such a clock.

    Rows more than ``lost_steps`` apart have lost some between them; times that scatter by more than ``most_jitter`` of
    a step have no clock; jitter may bring ``run`` rows behind each other nearer to another tick.
    """
    from scipy.ndimage import median_filter

    step, ticks = float(np.median(np.diff(times))), np.arange(len(times))
    apart = np.diff(times) / step
    missing = np.concatenate([[0.0], np.cumsum(np.where(apart > lost_steps, np.rint(apart) - 1.0, 0.0))])
    index = ticks + missing.astype(np.int64)
    even = times
    for _ in range(5):
        slope, offset = np.polyfit(index, times - times[0], 1)
        even = times[0] + offset + slope * index
        # a sample that jitter brings nearer to another tick stands alone; after a lost one all stand a tick further
        further = median_filter(np.rint((times - even) / slope), 2 * run + 1, mode="nearest")
        if not further.any():
            break
        index = ticks + np.maximum.accumulate(index + further.astype(np.int64) - ticks)
    return (index, even) if slope > 0.0 and np.std(times - even) < most_jitter * slope else (index, None)


def _within(channel: Channel, low: float, high: float) -> Channel:
    use = (channel.times >= low) & (channel.times <= high)
    if use.sum() < 2:
        raise InputError(f"the output has no two samples from {low:.3f} to {high:.3f} s")
    return Channel(channel.times[use], channel.values[use], channel.unit)


def _find_unbroken(output: Array, command: Array, clocks: tuple[Clock, Clock]) -> list[tuple[float, float]]:
    """Return the spans, s, from where to where neither output nor command has a gap."""
    edges = []
    for times, clock in ((output, clocks[1]), (command, clocks[0])):
        wide = np.flatnonzero(np.diff(times) > MOST_MISSING * clock.step * 1.05)
        if clock is clocks[0] and not np.isfinite(clock.jitter):
            continue  # a command without a clock is written down when it changes
        edges += [(times[i], times[i + 1]) for i in wide]
    spans, at = [], float(max(output[0], command[0]))
    for begin, end in sorted(edges):
        if begin > at:
            spans.append((at, float(begin)))
        at = max(at, float(end))
    last = float(min(output[-1], command[-1]))
    if last > at:
        spans.append((at, last))
    return spans


def _find_movement(
    command: Channel,
    spans: Sequence[tuple[float, float]],
    idle_s: float = 0.5,
    pause_s: float = 2.0,
    edge_s: float = 1.0,
) -> list[tuple[float, float]]:
    """Return the parts of the spans in which the command moves, less the edges towards rest.

    It is looked at in windows of ``idle_s`` and may stand still in flight for ``pause_s``; ``edge_s`` are cut off where
    it begins or ceases to move, because a vehicle on the ground answers otherwise.
    """
    size = float(np.std(command.values))
    stretches = []
    if not size > 0.0:
        return []
    for begin, end in spans:
        edges = np.arange(begin, end, idle_s)
        moving = []
        for at in edges:
            part = command.values[(command.times >= at) & (command.times < at + idle_s)]
            moving.append(bool(part.size) and float(np.ptp(part)) > 1e-3 * size)
        rows = np.flatnonzero(moving)  # a pause of pause_s at most between movement is none
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > round(pause_s / idle_s) + 1) + 1) if rows.size else ():
            first, after = int(run[0]), int(run[-1]) + 1
            low = edges[first] + (edge_s if first > 0 else 0.0)
            high = min(edges[after - 1] + idle_s - edge_s, end) if after < len(edges) else end
            stretches.append((float(low), float(high)))
    return stretches


def _interpolate_lost(command: Channel) -> Channel:
    """Interpolate the values that an even clock has lost: to hold the last one would be late."""
    index, even = _index(command.times)
    if even is None:
        return command
    gaps = np.diff(index)
    gap_rows = [np.arange(1, gap) + index[n] for n, gap in enumerate(gaps) if 1 < gap <= MOST_MISSING]
    if not gap_rows:
        return command
    missing = np.concatenate(gap_rows)
    times = np.interp(missing, index, command.times)
    values = np.interp(missing, index, command.values)
    order = np.argsort(np.concatenate([command.times, times]), kind="stable")
    return Channel(
        np.concatenate([command.times, times])[order], np.concatenate([command.values, values])[order], command.unit
    )


def _stretch(
    command: Channel,
    output: Channel,
    span: tuple[float, float],
    lead: float,
    cell: float,
    sample: float,
    factor: int,
) -> Stretch:
    """Cut a stretch out."""
    begin, end = span
    count = int((end - begin) / cell + 1e-6) + 1
    edges = begin + np.arange(count + 1) * cell
    cell_means = np.diff(_integral(command, np.asarray(edges, np.float64))) / cell
    use = (output.times >= begin + lead) & (output.times <= end)
    times, values = output.times[use], output.values[use]
    index, even = _index(times)
    if even is None:
        index = np.rint((times - times[0]) / sample).astype(np.int64)
    block = (index - index[0]) // factor
    return Stretch(begin, cell, cell_means, times - begin, values, block.astype(np.int64), int(block[-1]) + 1)


def _integral(command: Channel, at: Array) -> Array:
    """Return the integral, at these times, of a command that holds from each of its times to the next."""
    integral = np.concatenate([[0.0], np.cumsum(command.values[:-1] * np.diff(command.times))])
    row = np.clip(np.searchsorted(command.times, at, side="right") - 1, 0, None)
    return np.asarray(integral[row] + command.values[row] * (at - command.times[row]))


def _span(times: Array) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f} s"


def _late(command: Array, sample: float, slow_s: float = 0.011, slow: float = 1.5, steady: float = 0.8) -> float:
    """Return how far the rows of a command are apart [s] that are samples of what was commanded between them; else 0.

    ``command``: times of its rows; ``sample``: of the output, both in s.  Controllers command oftener than each
    ``slow_s`` and each ``slow`` samples; a share of ``steady`` of the rows is as far apart as usual, or it is logged
    when it changes.
    """
    apart = np.diff(command)
    row = float(np.median(apart))
    is_slow = row > min(slow_s, slow * sample)
    return row if is_slow and float(np.mean(np.abs(apart / row - 1.0) < 0.5)) > steady else 0.0


def _why(command: Channel, output: Channel, longest_delay: float) -> str:
    if not np.ptp(command.values) > 0.0:
        return "the command never changes"
    seconds = min(command.times[-1], output.times[-1]) - max(command.times[0], output.times[0])
    if seconds < longest_delay + SETTLE_S + SHORTEST_S:
        return f"the log has {seconds:.3g} s; a smaller longest_delay_s ({longest_delay:g} s) asks for less"
    return "there are gaps, or it stands still between"


def halves(stretches: Sequence[Stretch]) -> tuple[list[Stretch], list[Stretch]] | None:
    """Split the stretches into the first and the second half of the output; None where that leaves one empty."""
    total = sum(stretch.blocks for stretch in stretches)
    first: list[Stretch] = []
    second: list[Stretch] = []
    done = 0
    for stretch in stretches:
        cut = total // 2 - done
        done += stretch.blocks
        if cut >= stretch.blocks:
            first.append(stretch)
        elif cut <= 0:
            second.append(stretch)
        else:
            early = stretch.block < cut
            first.append(_part(stretch, early, 0, cut))
            second.append(_part(stretch, ~early, cut, stretch.blocks - cut))
    return (first, second) if first and second else None


def _part(stretch: Stretch, use: NDArray[np.bool_], first: int, blocks: int) -> Stretch:
    return replace(
        stretch,
        times=stretch.times[use],
        output=stretch.output[use],
        block=stretch.block[use] - first,
        blocks=blocks,
    )
