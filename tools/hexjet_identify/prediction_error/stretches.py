"""From two channels of a log to stretches on one clock: what is usable, when samples were taken, what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.arrays import Array
from cosim.base.errors import InputError
from hexjet_identify.fit.logs import Log
from hexjet_identify.fit.problem import Problem
from hexjet_identify.logs import Channel

# Faster samples are averaged to about this step, that of the shipped vehicles' controllers.
WORKING_STEP_S = 0.004
# A longer run of missing samples begins a new stretch.
MAX_MISSING = 12
# The output of a stretch is used from this long after the longest delay on: earlier commands are not known.
SETTLING_S = 0.3
# Minimum duration beyond that of a stretch, and of all together.
MIN_STRETCH_S = 3.0


class Clock(NamedTuple):
    """Sampling step [s], jitter and share of lost samples of a channel.

    ``jitter``: standard deviation around an even clock, in samples, NaN where there is no such clock;
    ``lost_fraction``: of the samples.
    """

    step: float
    jitter: float
    lost_fraction: float


@dataclass(frozen=True)
class Prepared:
    """The usable stretches of a log, with the clocks of command and output.

    ``late``: by how much the command may have moved before its row, s; 0 where rows come as controllers command.
    """

    stretches: tuple[Log, ...]
    working_step: float
    longest_delay: float
    command: Clock
    output: Clock
    late: float
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Duration of the output in all stretches, s."""
        return sum(float(log.times[-1] - log.times[0]) + log.step for log in self.stretches)

    def problem(self) -> Problem:
        """Return all stretches as one problem to fit."""
        return Problem(self.stretches, np.empty(0), self.longest_delay)


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
    command = _clean_channel(command, "the command", notes)
    output = _clean_channel(output, "the output", notes)
    low = max(command.times[0], output.times[0], -np.inf if begin is None else begin)
    high = min(command.times[-1], output.times[-1], np.inf if end is None else end)
    if not high - low > 0.0:
        raise InputError(
            f"command ({_format_span(command.times)}) and output ({_format_span(output.times)}) have no time in common"
            + ("" if begin is None and end is None else " with begin and end")
        )
    output = _select_between(output, low, high)
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
    lead = longest_delay + SETTLING_S
    spans = [
        span
        for span in _find_movement(command, _find_unbroken(output.times, command.times, clocks))
        if span[1] - span[0] > lead + MIN_STRETCH_S
    ]
    usable = sum(last - first - lead for first, last in spans)
    if usable < MIN_STRETCH_S:
        raise InputError(
            "no stretch that can be used: the command must move, without gaps, for "
            f"{lead + MIN_STRETCH_S:.3g} s or longer in flight; {_explain_unusable(command, output, longest_delay)}"
        )
    if len(spans) > 1:
        notes.append(f"{len(spans)} stretches, {usable:.1f} s of {high - low:.1f} s")
    filled = _interpolate_lost(command)
    stretches = tuple(_cut_stretch(filled, output, span, lead, sample, factor) for span in spans)
    late = _command_interval(command.times, sample)
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
    index, even = _index_on_clock(times)
    if even is None:
        return Clock(step, float("nan"), max(0.0, 1.0 - len(times) * step / (float(np.ptp(times)) + step)))
    fitted = float((even[-1] - even[0]) / max(index[-1] - index[0], 1))
    gaps = np.diff(index)
    # Longer gaps are breaks, and no lost samples.
    short = gaps[(gaps > 1) & (gaps <= MAX_MISSING)] - 1
    return Clock(fitted, float(np.std((times - even) / fitted)), float(short.sum() / (short.sum() + len(times))))


def _clean_channel(channel: Channel, signal: str, notes: list[str]) -> Channel:
    """Return a channel with finite values in order of time; of a clock that went back, the longest part."""
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
            f"{times[back[0] - 1] - times[back[0]]:.3g} s); the longest part alone is used, "
            f"{_format_span(times[first:last])}"
        )
        times, values = times[first:last], values[first:last]
    new = np.concatenate([[True], np.diff(times) > 0.0])
    if not new.all():
        notes.append(f"{signal}: {int((~new).sum())} values have the time of the one before; left out")
    if new.sum() < 2:
        raise InputError(f"{signal}: its time does not run")
    return Channel(times[new], values[new], channel.unit)


def _index_on_clock(
    times: Array, lost_steps: float = 1.75, most_jitter: float = 0.35, run: int = 4
) -> tuple[NDArray[np.int64], Array | None]:
    """Return the number of the clock tick nearest to each time, and the ticks' times, None if there is no even clock.

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
        # A sample that jitter brings nearer to another tick stands alone; after a lost one all stand a tick further.
        further = median_filter(np.rint((times - even) / slope), 2 * run + 1, mode="nearest")
        if not further.any():
            break
        index = ticks + np.maximum.accumulate(index + further.astype(np.int64) - ticks)
    return (index, even) if slope > 0.0 and np.std(times - even) < most_jitter * slope else (index, None)


def _select_between(channel: Channel, low: float, high: float) -> Channel:
    use = (channel.times >= low) & (channel.times <= high)
    if use.sum() < 2:
        raise InputError(f"the output has no two samples from {low:.3f} to {high:.3f} s")
    return Channel(channel.times[use], channel.values[use], channel.unit)


def _find_unbroken(output: Array, command: Array, clocks: tuple[Clock, Clock]) -> list[tuple[float, float]]:
    """Return the spans [s] in which neither output nor command has a gap."""
    edges = []
    for times, clock in ((output, clocks[1]), (command, clocks[0])):
        wide = np.flatnonzero(np.diff(times) > MAX_MISSING * clock.step * 1.05)
        if clock is clocks[0] and not np.isfinite(clock.jitter):
            # A command without a clock is logged when it changes.
            continue
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
        windows = zip(*(np.searchsorted(command.times, ends) for ends in (edges, edges + idle_s)), strict=True)
        moving = [low < high and float(np.ptp(command.values[low:high])) > 1e-3 * size for low, high in windows]
        # A pause of pause_s at most between movement is none.
        rows = np.flatnonzero(moving)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > round(pause_s / idle_s) + 1) + 1) if rows.size else ():
            first, after = int(run[0]), int(run[-1]) + 1
            low = edges[first] + (edge_s if first > 0 else 0.0)
            high = min(edges[after - 1] + idle_s - edge_s, end) if after < len(edges) else end
            stretches.append((float(low), float(high)))
    return stretches


def _interpolate_lost(command: Channel) -> Channel:
    """Interpolate lost samples of a command on an even clock; holding the last value would delay it."""
    index, even = _index_on_clock(command.times)
    if even is None:
        return command
    gaps = np.diff(index)
    gap_rows = [np.arange(1, gap) + index[n] for n, gap in enumerate(gaps) if 1 < gap <= MAX_MISSING]
    if not gap_rows:
        return command
    missing = np.concatenate(gap_rows)
    times = np.interp(missing, index, command.times)
    values = np.interp(missing, index, command.values)
    order = np.argsort(np.concatenate([command.times, times]), kind="stable")
    return Channel(
        np.concatenate([command.times, times])[order], np.concatenate([command.values, values])[order], command.unit
    )


def _cut_stretch(
    command: Channel, output: Channel, span: tuple[float, float], lead: float, sample: float, factor: int
) -> Log:
    """Return a stretch as a log: its output from ``lead`` s on, each row the mean of ``factor`` samples."""
    begin, end = span
    part = slice(
        max(int(np.searchsorted(command.times, begin, "right")) - 1, 0), np.searchsorted(command.times, end, "right")
    )
    use = (output.times >= begin + lead) & (output.times <= end)
    times = output.times[use]
    index, even = _index_on_clock(times)
    if even is None:
        index = np.rint((times - times[0]) / sample).astype(np.int64)
    rows, row = np.unique((index - index[0]) // factor, return_inverse=True)
    means = [np.bincount(row, values) / np.bincount(row) for values in (times - begin, output.values[use])]
    step = factor * sample
    width = step if factor > 1 else 0.0
    return Log(
        np.maximum(command.times[part], begin), command.values[part], begin + means[0], means[1], step,
        width=width, index=rows,
    )  # fmt: skip


def _format_span(times: Array) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f} s"


def _command_interval(
    command: Array, sample: float, slow_s: float = 0.011, slow: float = 1.5, steady: float = 0.8
) -> float:
    """Return the interval [s] of a command that is logged more seldom than it changes; 0 for any other.

    ``command``: times of its rows; ``sample``: of the output, both in s.  Controllers command oftener than each
    ``slow_s`` and each ``slow`` samples; a share of ``steady`` of the rows is as far apart as usual, or it is logged
    when it changes.
    """
    apart = np.diff(command)
    row = float(np.median(apart))
    is_slow = row > min(slow_s, slow * sample)
    return row if is_slow and float(np.mean(np.abs(apart / row - 1.0) < 0.5)) > steady else 0.0


def _explain_unusable(command: Channel, output: Channel, longest_delay: float) -> str:
    if not np.ptp(command.values) > 0.0:
        return "the command never changes"
    seconds = min(command.times[-1], output.times[-1]) - max(command.times[0], output.times[0])
    if seconds < longest_delay + SETTLING_S + MIN_STRETCH_S:
        return f"the log has {seconds:.3g} s; a smaller longest_delay_s ({longest_delay:g} s) asks for less"
    return "there are gaps, or it stands still between"
