"""What is to be said of bench logs: doubts of a model, and what is not told, with the test to run next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hexjet_identify.bench.engine_table import engine_parameters
from hexjet_identify.bench.identification import Identification
from hexjet_identify.bench.record import BenchRecord, describe_next_step, find_levels
from hexjet_identify.bench.running import RPM_PER_UNIT


def describe_doubts(found: Identification, apart: float = 3.29, largest_miss: float = 0.02) -> list[str]:
    """Return doubts about a model of lags or limits, a sentence each, the weightiest first.

    ``apart``: deviations by which a zero is below 0; ``largest_miss``: share of the range that the power law may miss.
    """
    record, chosen, limits = found.records[0], found.chosen, found.limits
    told, doubts = engine_parameters(found), []
    gain, offset, deviation = told.find("gain")[0], *told.find("offset")
    explained = 1.0 - float(np.var(chosen.residual)) / max(float(np.var(found.problem.output)), 1e-300)
    if explained < 0.5:
        doubts.append(
            f"the output hardly shows the command, which explains {100.0 * max(explained, 0.0):.0f} % of its variance; "
            "step it farther, or look at other columns"
        )
    elif gain < 0.0:
        doubts.append(
            f"{record.output_name} falls where {record.command_name} rises; if the load cell's sign is the other one: "
            f"output -{record.output_name}"
        )
    if not found.is_explained and record.command_unit in RPM_PER_UNIT and record.output_unit in RPM_PER_UNIT:
        doubts.append(
            "a speed that follows its set-point is a turbine's under an ECU: try engine jetcat-p300 "
            "with fit fuel_integral and fuel_fall"
        )
    if found.is_told and chosen.delay_bounds[0] == 0.0:
        doubts.append(
            "no delay at all is within the bounds: an engine without one, or an output that moves before its command, "
            "as where columns are swapped or clocks are apart"
        )
    if record.newtons is not None and gain > 0.0 and offset < -apart * deviation:
        crossing = min(-offset / gain, 1.0) ** (1.0 / (told.find("exponent")[0] or 1.0))
        zero = limits[0] + (limits[1] - limits[0]) * crossing
        doubts.append(
            f"the static curve is below 0 up to {record.command_name} {zero:.2g} ({offset / record.newtons:.3g} "
            f"{record.output_unit} at {limits[0]:g}), where an engine that is left gives no thrust: is it the load "
            "cell's zero? then take it out of the column first"
        )
    if record.newtons is not None and told.miss > largest_miss:
        doubts.append(
            f"the engine's static curve, a power law, misses the levels by up to {100.0 * told.miss:.2g} % of the range"
        )
    return doubts


def describe_untold(found: Identification, wide: float = 0.3) -> Iterator[str]:
    """Yield a sentence for each quantity that the logs do not determine, with the test that would.

    Bounds ``wide`` beside delay and lags together, or beside the lag, say little.
    """
    chosen, records, (total, deviation) = found.chosen, found.records, found.chosen.total
    row = max(record.step for record in records)
    step = describe_next_step(records, total)
    begin, end = chosen.delay_bounds
    if not found.is_told:
        yield f"delay and lag: so slow a command shows the static line alone. Next: {step}"
        return
    if end - begin > max(row, wide * total):
        why = "the noise hides it, or when within its row it moved"
        if found.problem.logs[0].is_straight:
            why = "a command that moves this slowly does not tell delay from lag"
        yield (
            f"the delay: anything from {1e3 * begin:.0f} to {1e3 * end:.0f} ms fits, delay and lags together are "
            f"{1e3 * total:.0f} ±{1960.0 * deviation:.0f} ms; {why if found.is_explained else 'no form explains it'}. "
            f"Next: {step}"
        )
    if end >= found.problem.max_delay:
        yield f"whether the delay is longer than {found.problem.max_delay:g} s, the end of the search"
    lag, off = chosen.numbers["lag_s"]
    if found.is_explained and "lag_s" not in found.unknown and 1.96 * off > wide * lag:
        yield f"the lag: {lag:.3g} s, its bounds are ±{1.96 * off:.2g} s. Next: {step}"
    if lag < 5.0 * row:
        yield (
            f"whether it is one lag or several: a lag of {1e3 * lag:.3g} ms is {lag / row:.1f} rows long. "
            f"Next: the same logged every {100.0 * lag:.2g} ms"
        )
    yield from _describe_levels(records, found.limits, total)


def _describe_levels(records: Sequence[BenchRecord], limits: tuple[float, float], total: float) -> Iterator[str]:
    """Yield which command levels are missing; one that is held for three times ``total`` s counts."""
    commands = np.concatenate([record.command for record in records])
    ends, hold, settled = (float(commands.min()), float(commands.max())), max(5.0 * total, 2.0), 3.0 * total
    levels = {level for record in records for level, seconds in find_levels(record).items() if seconds > settled}
    span = limits[1] - limits[0]
    stairs = ", ".join(f"{limits[0] + part * span:.4g}" for part in (0.2, 0.4, 0.6, 0.8, 1.0))
    if len(levels) < 3:
        yield (
            f"whether gain and lag are the same at all levels: {len(levels)} levels are held at least {settled:.2g} s, "
            f"three times delay and lags. Next: a staircase {stairs} and down again, {hold:.2g} s each"
        )
    moves = np.concatenate([np.diff(record.command) for record in records])
    if not (moves > 0.0).any() or not (moves < 0.0).any():
        other = "down" if (moves > 0.0).any() else "up"
        yield f"whether it is as quick {other}. Next: a step {other}, held {hold:.2g} s"
    if ends[1] - ends[0] < 0.6 * span:
        yield (
            f"anything outside {ends[0]:.4g} to {ends[1]:.4g}: the model goes on straight there. "
            f"Next: steps at {limits[0] + 0.1 * span:.4g} and {limits[1]:.4g}"
        )


def describe_small_movements(
    records: Sequence[BenchRecord], total: float, large: float = 0.15, small: float = 0.03
) -> list[str]:
    """Return the next test if all movements exceed a ``large`` share of the range: ``small`` ones.

    A movement is rows that move on the same way; of steps an engine with limits answers small ones otherwise.
    """
    commands = np.concatenate([record.command for record in records])
    span, sizes = float(np.ptp(commands)), list[float]()
    for record in records:
        steps = np.diff(record.command)
        moved = np.flatnonzero(steps)
        signs = np.sign(steps[moved])
        # A single repeated row, as of a frame that was received twice, does not end a movement.
        first = moved[(np.diff(moved, prepend=-len(steps)) > 2) | (np.diff(signs, prepend=0.0) != 0.0)]
        sizes += np.abs(np.add.reduceat(steps, first)).tolist() if first.size else []
    if not sizes or min(sizes) <= large * span:
        return []
    unit = f" {records[0].command_unit}".rstrip()
    held = {one: seconds for record in records for one, seconds in find_levels(record).items()}
    stood = [one for one, seconds in held.items() if seconds > 2.0 * total] or list(held)
    level = min(stood, key=lambda one: abs(one - 0.5 * float(commands.min() + commands.max())))
    return [
        f"how small, quick commands are answered: no movement of {records[0].command_name} is smaller than "
        f"{float(f'{min(sizes):.2g}'):g}{unit} ({100.0 * min(sizes) / span:.0f} % of its range). Next: "
        f"{float(f'{small * span:.0e}'):g}{unit} up and down about {level:g}, or about where it hovers, each held "
        f"{max(0.5 * total, 0.25):.2g} s, 40 times"
    ]
