"""What a bench log cannot tell, each with the test to run next that would tell it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from hexjet_identify.bench.evidence import REST, find_movements
from hexjet_identify.bench.fit import Estimate, Part
from hexjet_identify.bench.record import BenchRecord, find_levels
from hexjet_identify.engine_file import DEVIATIONS_95

SETTLED = 3.0  # delay and lags, for which a hold has to last before its level is told
SUGGESTED = 5.0  # and which are asked for
FINE = 5.0  # rows that a lag should have
WIDE = 0.3  # of delay and lags together: bounds of the delay that are wider say little
NARROW = 0.6  # of the throttle's range: a log that stays within less says nothing of the rest
STEP = 0.2  # of the throttle's range, that a next test steps

# of small movements
SMALL = 0.03  # of the command's range, by which a next test steps to either side
LARGE = 0.15  # of it: movements above that do not tell what small ones do
STANDING_ROWS = 2  # from one row that moves to the next, above which the command stood between them
HOLDS_S = (0.25, 0.5, 1.0, 2.0, 4.0)  # of a next test's steps
FEWEST_ROWS = 5  # in each of them
STEPS = 40  # of a next test, at least
CYCLES = 4  # that are simulated, the last of which counts
TOLD = 6.0  # standard deviations of the noise, by which two engines have to differ
LONGEST_S = 600.0
LEAST_QUIET = 50  # rows at rest that tell the noise
MOST_MEMORY = 0.98  # of it, from one row to the next

Answer = Callable[[Part], tuple[Array, Array]]  # of two engines that the logs do not tell apart


def describe_missing_evidence(
    chosen: Estimate,
    records: Sequence[BenchRecord],
    limits: tuple[float, float],
    longest: float,
    straight: bool,
    is_explained: bool,
) -> list[str]:
    """Return a line for each thing that the logs do not tell, with the next test: which step, how long, which level.

    Bounds of the lag of a form that does not explain the logs are none: no further step would narrow them.
    """
    total = chosen.total[0]
    hold = max(SUGGESTED * total, 2.0)
    low = min(float(record.command.min()) for record in records)
    high = max(float(record.command.max()) for record in records)
    step = f"a step from {low:.4g} to {high:.4g} and back, each held {hold:.2g} s"
    return [
        *_delay(chosen, records, longest, (straight, is_explained), step),
        *_lags(chosen, records, step, is_explained),
        *_levels(records, limits, (low, high), hold, total),
    ]


def _delay(
    chosen: Estimate, records: Sequence[BenchRecord], longest: float, is_so: tuple[bool, bool], step: str
) -> list[str]:
    straight, is_explained = is_so
    row = max(record.step for record in records)
    command_row = max(float(np.median(np.diff(record.command_times))) for record in records)
    low, high = chosen.delay_bounds
    lines = []
    if high - low > max(row, WIDE * chosen.total[0]):
        why = "a command that moves this slowly does not tell delay from lag" if straight else "the noise hides it"
        if not is_explained:
            why = "lags do not explain the log"
        if max(record.clock_deviation for record in records) > 0.5 * row:
            why, step = "two clocks tell it no better", "command and output on one clock"
        lines.append(
            f"the delay: anything from {1e3 * low:.0f} to {1e3 * high:.0f} ms fits, delay and lags together are "
            f"{1e3 * chosen.total[0]:.0f} ±{1e3 * DEVIATIONS_95 * chosen.total[1]:.0f} ms; {why}. Next: {step}"
        )
    if high >= longest - row:
        lines.append(f"whether the delay is longer than {longest:g} s, the end of the search. Next: --longest-delay")
    if not straight and command_row > 0.1 * chosen.total[0]:
        lines.append(
            f"when within its row of {1e3 * command_row:.3g} ms the command moved: the delay is up to that much "
            f"longer. Next: the same logged every {1e3 * chosen.total[0] / 20.0:.2g} ms"
        )
    return lines


def _lags(chosen: Estimate, records: Sequence[BenchRecord], step: str, is_explained: bool) -> list[str]:
    row = max(record.step for record in records)
    lines = []
    if is_explained and DEVIATIONS_95 * chosen.deviation(1) > WIDE * float(chosen.x[1]):
        lines.append(
            f"the lag: {chosen.x[1]:.3g} s, its bounds are ±{DEVIATIONS_95 * chosen.deviation(1):.2g} s. Next: {step}"
        )
    if chosen.lags[0] < FINE * row:
        faster = chosen.lags[0] / 10.0
        lines.append(
            f"whether it is one lag or several: a lag of {1e3 * chosen.lags[0]:.3g} ms is {chosen.lags[0] / row:.1f} "
            f"rows long. Next: the same logged every {1e3 * faster:.2g} ms"
        )
    return lines


def _levels(
    records: Sequence[BenchRecord], limits: tuple[float, float], ends: tuple[float, float], hold: float, total: float
) -> list[str]:
    held = [seconds for record in records for seconds in find_levels(record).values()]
    settled = {
        level for record in records for level, seconds in find_levels(record).items() if seconds > SETTLED * total
    }
    span = limits[1] - limits[0]
    stairs = ", ".join(f"{limits[0] + part * span:.4g}" for part in (0.2, 0.4, 0.6, 0.8, 1.0))
    lines = []
    if max(held, default=0.0) < SETTLED * total:
        lines.append(
            f"where the output comes to rest: no level is held {SETTLED * total:.2g} s, three times delay and lags. "
            f"Next: a staircase {stairs}, {hold:.2g} s each"
        )
    elif len(settled) < 3:
        lines.append(
            "whether gain and lag are the same at all levels, and the static curve: "
            f"{len(settled)} levels are held to rest. Next: a staircase {stairs} and down again, {hold:.2g} s each"
        )
    moves = np.concatenate([np.diff(record.command) for record in records])
    if not (moves > 0.0).any() or not (moves < 0.0).any():
        other = "down" if (moves > 0.0).any() else "up"
        lines.append(f"whether it is as quick {other}. Next: a step {other}, held {hold:.2g} s")
    if ends[1] - ends[0] < NARROW * span:
        lines.append(
            f"anything outside {ends[0]:.4g} to {ends[1]:.4g}: the model goes on straight there. "
            f"Next: steps at {limits[0] + 0.1 * span:.4g} and {limits[1]:.4g}"
        )
    return lines


class SmallTest(NamedTuple):
    """Steps to both sides of a level, and by how much two engines differ there, in the output's unit and by noise."""

    hold_s: float
    seconds: float
    apart: float
    deviations: float


def describe_small_movements(
    records: Sequence[BenchRecord], parts: Sequence[Part], residual: Array, rest: float, answer: Answer, unit: str
) -> list[str]:
    """Return a line where the logs have large movements alone, with the test that tells how small ones are answered.

    ``residual`` of all parts is what a model leaves over, whose part at rest is the noise; ``rest`` s is about delay
    and lags together, ``unit`` that of ``answer``.
    """
    spans = [find_movements(part, REST * rest) for part in parts]
    user, own = (np.concatenate([one.command for one in many]) for many in (records, parts))
    scale = float(np.ptp(user) / max(np.ptp(own), 1e-300))
    begins, sizes = zip(*(_runs(part) for part in parts), strict=True)
    size, span = scale * min((each.min() for each in sizes if each.size), default=0.0), float(np.ptp(user))
    if not all(spans) or not size > LARGE * span:
        return []
    soonest = min((float(np.diff(each).min()) for each in begins if each.size > 1), default=np.inf)
    middle = 0.5 * float(user.min() + user.max())
    held = {one: seconds for record in records for one, seconds in find_levels(record).items()}
    stood = [one for one, seconds in held.items() if seconds > REST * rest] or list(held)
    level = min(stood, key=lambda one: abs(one - middle))
    step = float(f"{SMALL * span:.0e}")
    first, unit_of_command = records[0], f" {records[0].command_unit}" if records[0].command_unit else ""
    offset = float(own[0]) - float(user[0]) / scale
    test = find_small_test(parts[0], offset + level / scale, step / scale, _quiet(parts, residual, rest), answer)
    often = f" or sooner than {soonest:.3g} s after another" if np.isfinite(soonest) else ""
    line = (
        f"how small, quick commands are answered: no movement of {first.command_name} is smaller than "
        f"{float(f'{size:.2g}'):g}{unit_of_command} ({100.0 * size / span:.0f} % of its range){often}. "
        f"Next: {step:g}{unit_of_command} up and down about {level:g}, or about where it hovers, "
    )
    if test is None:
        return [
            f"{line}over and over, farther where the noise hides it: engines at the ends of these bounds differ little"
        ]
    return [
        f"{line}each held {test.hold_s:g} s, for {test.seconds:.0f} s, logged every {1e3 * parts[0].step:.0f} ms: two "
        f"engines at the ends of these bounds are {test.apart:.2g} {unit} apart there (rms), {test.deviations:.0f} "
        "standard deviations of the noise"
    ]


def find_small_test(
    part: Part, level: float, step: float, noise: tuple[float, float], answer: Answer
) -> SmallTest | None:
    """Return the shortest test of small steps that tells two engines apart, None where none does in :data:`LONGEST_S`.

    ``noise``: how much of it a row keeps of the row before, and the standard deviation of what is new.
    """
    memory, deviation = noise
    tests = []
    for hold in HOLDS_S:
        if hold < FEWEST_ROWS * part.step:
            continue
        begins = hold * np.arange(2 * CYCLES)
        command = np.concatenate([[level], level + step * np.resize([1.0, -1.0], len(begins)), [level]])
        times = np.arange(0.0, begins[-1] + hold, part.step)
        command_times = np.concatenate([[-hold], begins, [begins[-1] + hold]])
        own = replace(part, command_times=command_times, command=command, times=times, output=times, straight=False)
        one, other = answer(own)
        last = (one - other)[times >= begins[-2]]
        new = last[1:] - memory * last[:-1]
        a_second = float(np.sum(new**2)) / deviation**2 / (2.0 * hold)
        seconds = max(STEPS * hold, TOLD**2 / max(a_second, 1e-300))
        if seconds <= LONGEST_S:
            tests.append(SmallTest(hold, seconds, float(np.std(last)), float(np.sqrt(a_second * seconds))))
    return max(tests, key=lambda test: test.deviations**2 / test.seconds, default=None)


def _runs(part: Part) -> tuple[Array, Array]:
    """Return when each movement of a log's command begins, s, and its size: rows that move on the same way.

    A single row at which it stands, as where a frame came twice, does not end a movement.
    """
    steps = np.diff(part.command)
    moved = np.flatnonzero(steps)
    signs = np.sign(steps[moved])
    first = moved[(np.diff(moved, prepend=-len(steps)) > STANDING_ROWS) | (np.diff(signs, prepend=0.0) != 0.0)]
    sizes = np.abs(np.add.reduceat(steps, first)) if first.size else np.empty(0)
    return part.command_times[first], sizes


def _quiet(parts: Sequence[Part], residual: Array, rest: float) -> tuple[float, float]:
    """Return the noise where the command has long stood, else of all rows: its memory, and what is new in a row."""
    before, after, quiet = [], [], []
    rows = np.split(residual, np.cumsum([len(part.times) for part in parts])[:-1])
    for part, left in zip(parts, rows, strict=True):
        moved = np.append(-np.inf, part.command_times[1:][np.diff(part.command) != 0.0])
        since = part.times - moved[np.searchsorted(moved, part.times, side="right") - 1]
        near = np.diff(part.times) < 1.5 * part.step
        quiet.append((since[:-1] > 2.0 * REST * rest)[near])
        before.append(left[:-1][near])
        after.append(left[1:][near])
    old, new, use = np.concatenate(before), np.concatenate(after), np.concatenate(quiet)
    if np.count_nonzero(use) >= LEAST_QUIET:
        old, new = old[use], new[use]
    power = 0.5 * float(old @ old + new @ new)
    memory = float(np.clip(old @ new / power, 0.0, MOST_MEMORY)) if power > 0.0 else 0.0
    return memory, max(float(np.std(new - memory * old)), 1e-12 * float(np.ptp(new) + 1.0))
