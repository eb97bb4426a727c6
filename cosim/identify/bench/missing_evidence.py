"""What a bench log cannot tell, each with the test to run next that would tell it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cosim.identify.bench.fit import Estimate
from cosim.identify.bench.record import BenchRecord, find_levels
from cosim.identify.engine_file import DEVIATIONS_95

SETTLED = 3.0  # delay and lags, for which a hold has to last before its level is told
SUGGESTED = 5.0  # and which are asked for
FINE = 5.0  # rows that a lag should have
WIDE = 0.3  # of delay and lags together: bounds of the delay that are wider say little
NARROW = 0.6  # of the throttle's range: a log that stays within less says nothing of the rest
STEP = 0.2  # of the throttle's range, that a next test steps


def describe_missing_evidence(
    chosen: Estimate,
    records: Sequence[BenchRecord],
    limits: tuple[float, float],
    longest: float,
    straight: bool,
) -> list[str]:
    """Return a line for each thing that the logs do not tell, with the next test: which step, how long, which level."""
    total = chosen.total[0]
    hold = max(SUGGESTED * total, 2.0)
    low = min(float(record.command.min()) for record in records)
    high = max(float(record.command.max()) for record in records)
    step = f"a step from {low:.4g} to {high:.4g} and back, each held {hold:.2g} s"
    return [
        *_delay(chosen, records, longest, straight, step),
        *_lags(chosen, records, step),
        *_levels(records, limits, (low, high), hold, total),
    ]


def _delay(chosen: Estimate, records: Sequence[BenchRecord], longest: float, straight: bool, step: str) -> list[str]:
    row = max(record.step for record in records)
    command_row = max(float(np.median(np.diff(record.command_times))) for record in records)
    low, high = chosen.delay_bounds
    lines = []
    if high - low > max(row, WIDE * chosen.total[0]):
        why = "a command that moves this slowly does not tell delay from lag" if straight else "the noise hides it"
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
            f"when within its row of {1e3 * command_row:.3g} ms the command moved: the delay is at most that much "
            f"less. Next: the same logged every {1e3 * chosen.total[0] / 20.0:.2g} ms"
        )
    return lines


def _lags(chosen: Estimate, records: Sequence[BenchRecord], step: str) -> list[str]:
    row = max(record.step for record in records)
    lines = []
    if DEVIATIONS_95 * chosen.deviation(1) > WIDE * float(chosen.x[1]):
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
