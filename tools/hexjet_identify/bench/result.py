"""What an identification from a bench leaves in a folder: numbers, page, engine; and what a terminal is told."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.arrays import Array
from cosim.base.storage.toml import toml_text
from cosim.files import data_folder
from cosim.identify.page import WITH_BOUNDS, Signals, draw_signals, judged_page
from cosim.pages import Card, Page
from cosim.results.report.plot import BLUE, GREY, HOVER, panels, trace
from hexjet_identify.bench.evidence import MOVEMENT_COLUMNS, HeldBack, describe_held_back, movement_rows, output_swing
from hexjet_identify.bench.fit import Estimate, Part
from hexjet_identify.bench.identify import BenchIdentification
from hexjet_identify.engine_file import (
    DEVIATIONS_95,
    FITTED,
    FITTED_STEP_S,
    LARGEST_SAMPLES,
    engine_readme,
    uncertainty_table,
    whole_delay,
    write_with_engine,
)

BOUNDS = (
    "The first model is the one that is written: the least of Schwarz' criterion. The delay's bounds are those of its "
    "profile likelihood with two lags, wider by the spread of its stretches; the others are 1.96 standard deviations. "
    "They hold where the model explains the log."
)
TOLD = "delay, lags, gain and curve within its range are told"
NO_LONGER = "they no longer follow the command"
NOT_TOLD = "delay and lags: none explains the log, and no further step would change that; the notes say what they lack"


def why_no_engine(result: BenchIdentification) -> str:
    """Return why no engine is left, or an empty string where one is."""
    record = result.records[0]
    if record.newtons is None:
        how = "" if record.output_unit else f": {record.output_name}_N or {record.output_name} [kN] in the head says so"
        return f"{record.output_name} is in {record.output_unit or 'no unit'}; an engine's output is a thrust in N{how}"
    if not result.limits_known:
        return "what throttle 0 and 1 are is not known: --throttle-range LOW HIGH"
    if not result.is_explained:
        return "the model does not explain the log"
    if not result.chosen.gain > 0.0:
        return "the thrust falls where the throttle rises"
    if result.chosen.delay > LARGEST_SAMPLES * FITTED_STEP_S:
        return f"its delay is longer than {LARGEST_SAMPLES * FITTED_STEP_S:g} s"
    return ""


def write(result: BenchIdentification, folder: Path) -> dict[str, Path]:
    """Write ``identification.json``, ``report.html`` and, where there is an engine, ``engine.toml``, ``.fmu``, README.

    Raises FlightError if a file cannot be written.
    """
    texts, archive = {}, None
    if not why_no_engine(result):
        texts = {"engine": toml_text(engine_table(result)), "readme": readme(result)}
        archive = data_folder("fmus") / f"{FITTED}.fmu"
    return write_with_engine(folder, result.to_dict(), page(result), texts, archive)


def page(result: BenchIdentification) -> Page:
    """Return the page of an identification."""
    held = describe_held(result) or "nothing could be held back to test it"
    size, share = result.judgement.evidence
    left_over = f"{size[0].upper()}{size[1:]}, {share}; {held}."
    columns = [WITH_BOUNDS, *(estimate.form.label for estimate in result.estimates)]
    untold = result.untold or (TOLD if result.is_explained else NOT_TOLD,)
    cards = [
        Card("Models", columns, rows(result), BOUNDS),
        Card("What the log does not tell, and the next test", text=left_over, lines=untold),
        *movement_cards(result.held_back, result.records[0].output_unit, output_swing(result.problem.parts)),
        Card("Measured and modelled", figure="signals"),
        Card("Static curve", figure="curve"),
    ]
    first, low, high = result.records[0], *result.limits
    signals = lay_behind(result.problem.parts, result.problem.residual(result.chosen), (low, high))
    units = first.command_unit or first.command_name, first.output_unit
    figures = {"signals": draw_signals(signals, units), "curve": draw_curve(result)}
    source = " ".join(str(record.path) for record in result.records)
    reason = why_no_engine(result)
    shown = Page(
        "identification from a bench",
        ", ".join(record.path.name for record in result.records),
        cards,
        figures,
        summary=[summary(result)],
        problems=[f"no engine: {reason}"] if reason else [],
        notes=result.notes,
        source=source,
    )
    return judged_page(result.judgement, shown)


def describe_held(result: BenchIdentification) -> str:
    """Describe how far the model is off where it was not fitted; empty where nothing could be held back."""
    if result.held_back is None:
        return ""
    return describe_held_back(result.held_back, result.records[0].output_unit, output_swing(result.problem.parts))


def movement_cards(held_back: HeldBack | None, unit: str, swing: float) -> list[Card]:
    """Return the card of the movements that were foretold, where there are any."""
    if held_back is None or not held_back.movements:
        return []
    text = "Each by the model as fitted to every second movement, not to this one; times since the command moves."
    return [Card("Movements, foretold", MOVEMENT_COLUMNS, movement_rows(held_back, unit, swing), text)]


def lay_behind(parts: Sequence[Part], left_over: Array, limits: tuple[float, float] = (0.0, 1.0)) -> Iterator[Signals]:
    """Yield logs behind each other in time; ``limits``: what command 0 and 1 are."""
    begin, shift, (low, high) = 0, 0.0, limits
    for part in parts:
        residual = left_over[begin : begin + len(part.times)]
        times, values = _corners(part.command_times, low + (high - low) * part.command, part.straight)
        yield Signals(times + shift, values, part.times + shift, part.output, part.output - residual, residual)
        begin, shift = begin + len(part.times), shift + float(part.times[-1]) + 5.0


def engine_table(result: BenchIdentification) -> dict[str, object]:
    """Return the mapping file's table: the library's engine ``fitted`` with the numbers found and ``[uncertainty]``."""
    chosen, unit = result.chosen, result.records[0].newtons or 1.0
    _, lag, ratio, exponent = chosen.form.split(chosen.x)
    parameters: dict[str, object] = {
        "gain": unit * chosen.gain,
        "offset": unit * result.offset,
        "lag": lag,
        "delay_samples": whole_delay(chosen.delay / FITTED_STEP_S, 0.0)[0],
    }
    parameters |= {"lag_2": ratio * lag} if chosen.form.lags == 2 else {}
    parameters |= {"exponent": exponent} if chosen.form.curve else {}
    return {
        "fmu": "engine.fmu",
        "title": f"Engine fitted to {', '.join(record.path.name for record in result.records)}",
        "parameters": parameters,
        "uncertainty": uncertainty(result),
    }


def uncertainty(result: BenchIdentification) -> dict[str, object]:
    """Return the parameters' standard deviations and correlation, and their spread between several logs.

    The delay's deviation is that of its bounds, of the row within which a held command moved, and of whole steps.
    """
    chosen, unit = result.chosen, result.records[0].newtons or 1.0
    names, slope = ["delay_samples", "lag"], [np.eye(1, len(chosen.covariance), 0)[0] / FITTED_STEP_S]
    slope.append(np.eye(1, len(chosen.covariance), 1)[0])
    if chosen.form.lags == 2:
        names.append("lag_2")
        second = np.zeros(len(chosen.covariance))
        second[1], second[2] = float(chosen.x[2]), float(chosen.x[1])
        slope.append(second)
    if chosen.form.curve:
        names.append("exponent")
        slope.append(np.eye(1, len(chosen.covariance), len(chosen.x) - 1)[0])
    names += ["gain", "offset"]
    count = len(result.records)
    slope.append(unit * np.eye(1, len(chosen.covariance), len(chosen.x))[0])
    slope.append(np.concatenate([np.zeros(len(chosen.x) + 1), np.full(count, unit / count)]))
    matrix = np.array(slope)
    covariance = matrix @ chosen.covariance @ matrix.T
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    deviation[0] = whole_delay(chosen.delay / FITTED_STEP_S, max(deviation[0], _delay_deviation(result)))[1]
    table = uncertainty_table(_describe_logs(result), names, covariance, deviation)
    if result.spread:
        table["spread"] = [_spread_of(result, name) for name in names]
    return table


def _delay_deviation(result: BenchIdentification) -> float:
    """Return the deviation of the delay in the engine's steps, of its bounds and of the command's row."""
    low, high = result.chosen.delay_bounds
    row = max(float(np.median(np.diff(record.command_times))) for record in result.records)
    return float(np.hypot((high - low) / (2.0 * DEVIATIONS_95), row / np.sqrt(12.0)) / FITTED_STEP_S)


def _spread_of(result: BenchIdentification, name: str) -> float:
    unit = result.records[0].newtons or 1.0
    known = result.spread
    lag, ratio = float(result.chosen.x[1]), result.chosen.form.split(result.chosen.x)[2]
    values = {
        "delay_samples": known["delay_s"] / FITTED_STEP_S,
        "lag": known["lag_s"],
        "lag_2": float(np.hypot(ratio * known["lag_s"], lag * known.get("ratio", 0.0))),
        "exponent": known.get("exponent", 0.0),
        "gain": unit * known["gain"],
        "offset": unit * float(np.std(result.chosen.offsets, ddof=1)),
    }
    return float(f"{values[name]:.6g}")


def _describe_logs(result: BenchIdentification) -> str:
    names = ", ".join(record.path.name for record in result.records)
    moves = sum(int(np.count_nonzero(np.diff(record.command))) for record in result.records)
    seconds = sum(float(record.times[-1] - record.times[0]) for record in result.records)
    return f"{names}: {seconds:.4g} s, {moves} rows in which the command moves, {result.chosen.form.label}"


def readme(result: BenchIdentification) -> str:
    """Return the page of the engine in Markdown: where it comes from, where it holds, what was left over."""
    first = result.records[0]
    low = min(float(record.command.min()) for record in result.records)
    high = max(float(record.command.max()) for record in result.records)
    return engine_readme(
        "bench log",
        rows(result),
        f"{summary(result)} `hexjet identify bench`",
        f"{first.command_name} from {low:.4g} to {high:.4g}, with throttle 0 at {result.limits[0]:g} and "
        f"1 at {result.limits[1]:g}",
        f"{result.residual_rms:.3g} {first.output_unit} (rms); {NO_LONGER}.",
        result.untold,
        result.notes,
    )


def summary(result: BenchIdentification) -> str:
    """Describe the logs in a line."""
    first = result.records[0]
    rows_, seconds = 0, 0.0
    for record in result.records:
        rows_, seconds = rows_ + len(record.times), seconds + float(record.times[-1] - record.times[0])
    lost = max(record.lost_fraction for record in result.records)
    missing = f", {100.0 * lost:.2g} % of the rows missing" if lost > 0.005 else ""
    names = ", ".join(record.path.name for record in result.records)
    return (
        f"{names}: {first.command_name} to {first.output_name}; {seconds:.4g} s, {rows_} rows, one each "
        f"{1e3 * first.step:.4g} ms{missing}; the command is {'straight' if result.straight else 'held'} between rows."
    )


def rows(result: BenchIdentification) -> list[list[str]]:
    """Return the table of the forms beside each other, a row a quantity, with 95 % bounds."""
    unit = result.records[0].output_unit
    low, high = result.limits
    estimates = result.estimates
    best = estimates[0].bic
    return [
        ["delay, ms", *(_delay(estimate) for estimate in estimates)],
        ["lag, ms", *(_about(1e3 * one.x[1], 1e3 * one.deviation(1)) for one in estimates)],
        ["second lag, ms", *(_second(one) for one in estimates)],
        ["delay and lags together, ms", *(_about(1e3 * v, 1e3 * s) for v, s in (one.total for one in estimates))],
        [
            f"gain, {unit} from {low:g} to {high:g}",
            *(_about(one.gain, one.deviation(len(one.x))) for one in estimates),
        ],
        [f"output at {low:g}, {unit}", *(f"{float(np.mean(one.offsets)):.4g}" for one in estimates)],
        ["exponent of the static curve", *(_exponent(one) for one in estimates)],
        ["Schwarz' criterion, above the best", *(f"{one.bic - best:.1f}" for one in estimates)],
    ]


def _delay(estimate: Estimate) -> str:
    low, high = estimate.delay_bounds
    bounds = f" ({1e3 * low:.4g} to {1e3 * high:.4g})" if np.isfinite(low) else ""
    return f"{1e3 * estimate.delay:.4g}{bounds}"


def _second(estimate: Estimate) -> str:
    if estimate.form.lags < 2:
        return ""
    lag, ratio = float(estimate.x[1]), float(estimate.x[2])
    slope = np.zeros(len(estimate.covariance))
    slope[1], slope[2] = ratio, lag
    return _about(1e3 * ratio * lag, 1e3 * float(np.sqrt(max(float(slope @ estimate.covariance @ slope), 0.0))))


def _exponent(estimate: Estimate) -> str:
    return _about(float(estimate.x[-1]), estimate.deviation(len(estimate.x) - 1)) if estimate.form.curve else ""


def _about(value: float, deviation: float) -> str:
    half = DEVIATIONS_95 * deviation
    if not half <= abs(value):
        return "not determined"
    return f"{value:.4g} ±{float(f'{half:.2g}'):g}"


def _corners(times: Array, values: Array, straight: bool) -> tuple[Array, Array]:
    """Return a command's corners for a drawing."""
    if straight:
        return times, values
    moved = np.flatnonzero(np.diff(values))
    at = np.concatenate([[0], np.column_stack([moved, moved + 1]).ravel(), [len(times) - 1]])
    when = times[at].copy()
    when[1:-1:2] = times[moved + 1]
    return when, values[at]


def draw_curve(result: BenchIdentification) -> dict[str, Any]:
    """Draw the static curve over the throttle's range."""
    chosen, first = result.chosen, result.records[0]
    exponent = chosen.form.split(chosen.x)[3]
    throttle = np.linspace(0.0, 1.0, 101)
    low, high = result.limits
    values = result.offset + chosen.gain * throttle**exponent
    seen = np.concatenate([part.command for part in result.problem.parts])
    inside = (throttle >= seen.min() - 1e-9) & (throttle <= seen.max() + 1e-9)
    at = low + (high - low) * throttle
    data = [
        trace("outside of what the log has", GREY, at, values),
        trace("as identified", BLUE, at[inside], values[inside]),
    ]
    title = f"{first.command_name} {f'[{first.command_unit}]' if first.command_unit else ''}".strip()
    return {"data": data, "layout": panels(320, title, (first.output_unit,), log=False) | HOVER}
