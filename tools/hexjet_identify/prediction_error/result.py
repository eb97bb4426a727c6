"""What an identification from a log leaves in a folder, and what is said of it in a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim.api.call import FolderResult, Table, note_lines
from cosim.base.storage.toml import toml_text
from cosim.files import data_folder
from cosim.identify.page import WITH_BOUNDS, Signals, draw_signals, judged_page
from cosim.pages import Card, Page
from cosim.results.report.plot import BLUE, GREEN, HOVER, panels, trace
from hexjet_identify.engine_file import (
    DEVIATIONS_95,
    FITTED,
    FITTED_STEP_S,
    engine_readme,
    round_delay,
    uncertainty_table,
    write_with_engine,
)
from hexjet_identify.fit.estimate import Estimate
from hexjet_identify.prediction_error.identify_log import LogIdentification, information

BOUNDS_TEXT = (
    "The first model is the one that is written. The bounds of the delay are those of its profile likelihood; the "
    "others are 1.96 standard deviations of the linearised problem, noise model included. They hold where the form "
    "fits, which the tests beside tell as far as they can."
)
ALONE_TEXT = (
    "The model answers the command alone, from the beginning of each stretch: what wind and noise did is not in it."
)
COHERENCE_TEXT = (
    "Above, how much of the output follows the command. Below, how much a command of each frequency would tell of the "
    "delay in this noise: fly there."
)


class LogIdentifyResult(FolderResult):
    """A model identified from the log of a flight.

    ``write`` leaves ``identification.json``, ``report.html`` and, of an axis, ``model.toml``, of a thrust an engine.

    Attributes
    ----------
    identification : LogIdentification
        Everything.
    """

    def __init__(self, identification: LogIdentification, step_s: float, family: str) -> None:
        self.identification = identification
        self.files = {}
        self._step_s, self._family = step_s, family

    def _write(self, folder: Path) -> dict[str, Path]:
        found, texts, archive = self.identification, {}, None
        if not found.engine:
            table = {"identified": {self._family: {found.what: found.rate_model(self._step_s).model_dump()}}}
            texts = {"model": toml_text(table)}
        elif not why_no_engine(found):
            texts = {"engine": toml_text(engine_table(found)), "readme": readme(found)}
            archive = data_folder("fmus") / f"{FITTED}.fmu"
        return write_with_engine(folder, self.to_dict(), page(found), texts, archive)

    def to_dict(self) -> dict[str, Any]:
        return self.identification.to_dict(self._step_s)

    def lines(self) -> list[str]:
        """Return what was compared, and notes."""
        found = self.identification
        reason = why_no_engine(found) if found.engine else ""
        return [summary(found), *note_lines(found.notes), *([f"no engine: {reason}"] if reason else [])]

    def tables(self) -> list[Table]:
        """Return the parameters of each form with their bounds."""
        found = self.identification
        return [Table("", (WITH_BOUNDS, *(estimate.form.label for estimate in found.estimates)), rows(found))]

    def _figures(self) -> Mapping[str, Any]:
        return page(self.identification).figures


def page(result: LogIdentification) -> Page:
    """Return the page of an identification."""
    tests = [(check.name, f"{check.p:.2g}", f"{100.0 * check.share:.2g} %") for check in result.checks]
    columns = [WITH_BOUNDS, *(estimate.form.label for estimate in result.estimates)]
    cards = [
        Card("Measured and modelled", text=ALONE_TEXT, figure="signals"),
        Card("Models", columns, rows(result), BOUNDS_TEXT),
        Card("Tests of what is left over", ("test", "p", "share of the power"), tests),
        Card("What the log told", text=COHERENCE_TEXT, figure="tells"),
    ]
    units = result.signals.command_unit, result.signals.output_unit
    figures = {
        "signals": draw_signals(_make_signals(result), units, "residuals, made white"),
        "tells": _draw_information(result),
    }
    heading = f"{result.path.name}: {result.what}"
    reason = why_no_engine(result) if result.engine else ""
    refused = [f"no engine: {reason}"] if reason else []
    shown = Page(
        "identification from a log",
        heading,
        cards,
        figures,
        summary=[summary(result)],
        problems=refused,
        notes=result.notes,
        source=str(result.path),
    )
    return judged_page(result.judgement, shown)


def why_no_engine(result: LogIdentification, throttle: tuple[float, float] = (-0.01, 1.05)) -> str:
    """Return why no engine file is written from an engine's log, or an empty string if one is.

    ``throttle``: what a log's command may be, to be taken for an engine's.
    """
    unit, (low, high) = result.signals.output_unit, _command_range(result)
    if unit != "N":
        return f"the output is in {unit or 'no unit'}, and an engine's is a thrust in N"
    if low < throttle[0] or high > throttle[1]:
        return (
            f"{result.signals.command} goes from {low:.4g} to {high:.4g}, and an engine's throttle from 0 to 1: "
            "hexjet engine from-bench --throttle-range LOW HIGH"
        )
    return "" if result.chosen.gain[0] > 0.0 else "the thrust falls where the throttle rises"


def _command_range(result: LogIdentification) -> tuple[float, float]:
    commands = [log.command for log in result.problem.logs]
    return min(float(each.min()) for each in commands), max(float(each.max()) for each in commands)


def engine_table(result: LogIdentification) -> dict[str, object]:
    """Return ``engine.toml`` of the library's engine ``fitted`` as a table, with ``[uncertainty]``.

    Its internal step is 4 ms, which the delay is rounded to; lags beyond the two slowest are added to the delay, which
    is what low frequencies see of them.  The delay's deviation is that of its bounds and of whole steps.
    """
    chosen, size = result.chosen, len(result.chosen.covariance)
    count, lags = len(chosen.x), [1.0 / float(chosen.x[1]), *chosen.x[2:].tolist()]
    by_parameter = np.eye(size)
    slopes = [by_parameter[1] * -(lags[0] ** 2), *by_parameter[2:count]]
    order = np.argsort(lags)[::-1]
    delay = chosen.delay + sum(lags[n] for n in order[2:])
    # The output at throttle 0 is the mean of the stretches' offsets, weighted by rows; a decay stands behind each.
    rows_of = np.array([len(log.times) for log in result.problem.logs])
    level = np.zeros(size)
    level[count + 1 : count + 1 + 2 * len(rows_of) : 2] = rows_of / rows_of.sum()
    offset = float(level[count : count + len(chosen.linear)] @ chosen.linear)
    values = {
        "delay_samples": (delay, sum((slopes[n] for n in order[2:]), by_parameter[0])),
        **{name: (lags[n], slopes[n]) for name, n in zip(("lag", "lag_2"), order, strict=False)},
        "gain": (chosen.gain[0], by_parameter[count]),
        "offset": (offset, level),
    }
    matrix = np.array([slope for _, slope in values.values()])
    matrix[0] /= FITTED_STEP_S
    covariance = matrix @ chosen.covariance @ matrix.T
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    low, high = result.delay_bounds
    if np.isfinite(low):
        deviation[0] = max(deviation[0], (high - low) / (2.0 * DEVIATIONS_95) / FITTED_STEP_S)
    samples, deviation[0] = round_delay(delay / FITTED_STEP_S, deviation[0])
    known = uncertainty_table(summary(result), list(values), covariance, deviation)
    return {
        "fmu": "engine.fmu",
        "title": f"Engine identified from {result.path.name}",
        "parameters": {name: value for name, (value, _) in values.items()} | {"delay_samples": samples},
        **({"uncertainty": known} if deviation.any() else {}),
    }


def readme(result: LogIdentification) -> str:
    """Return the page of the engine in Markdown."""
    low, high = _command_range(result)
    rms = float(np.sqrt(result.chosen.loss / result.chosen.rows))
    return engine_readme(
        "log",
        rows(result),
        f"{summary(result)}. `hexjet identify log`",
        f"{result.signals.command} from {low:.4g} to {high:.4g}",
        f"{rms:.3g} {result.signals.output_unit} (rms, made white).",
        (),
        result.notes,
    )


def summary(result: LogIdentification) -> str:
    """Describe the log and what of it was used, in a line."""
    output, prepared = result.prepared.output, result.prepared
    clock = f"{1.0 / output.step:.4g} Hz"
    if np.isfinite(output.jitter) and output.jitter > 0.005:
        clock += f", jitter {100.0 * output.jitter:.0f} % of a sample"
    if output.lost_fraction > 0.0:
        clock += f", {100.0 * output.lost_fraction:.2g} % lost"
    return (
        f"{result.path.name} ({result.kind}): {result.signals.command} to {result.signals.output}; "
        f"{prepared.seconds:.1f} s used, output at {clock}; working step {1e3 * prepared.working_step:.3g} ms"
    )


def rows(result: LogIdentification) -> list[list[str]]:
    """Return the table of the forms side by side, one row a quantity, each with its 95 % bounds."""
    lines: list[list[str]] = []
    unit = f"{result.signals.output_unit} per {result.signals.command_unit}"
    gain = (
        f"gain at rest, {unit}"
        if result.engine
        else f"gain, {result.signals.output_unit}/s per {result.signals.command_unit}"
    )
    lines.append([gain, *(_format_value(*estimate.gain) for estimate in result.estimates)])
    titles = {"rate_1_s": "time constant, ms" if result.engine else "slow pole, 1/s", "lag_s": "lag, ms"}
    if result.engine:
        titles["lag_s"] = "second lag, ms"
    richest = max(result.estimates, key=lambda each: len(each.x))
    for name in list(richest.form.natural(richest.x))[1:]:
        cells = [_format_parameter(estimate, name, result.engine) for estimate in result.estimates]
        lines.append([titles.get(name, "further lag, ms"), *cells])
    lines.append(["delay, ms", *(_format_delay(estimate) for estimate in result.estimates)])
    low, high = result.delay_bounds
    if len(result.estimates) > 1:
        allowing = f"{1e3 * low:.4g} to {1e3 * high:.4g}"
        lines.append(["its bounds, by the richest form, ms", allowing, *[""] * (len(result.estimates) - 1)])
    lines.append(
        [
            "delay and lags together, ms",
            *(_format_value(1e3 * v, 1e3 * s) for v, s in (each.total for each in result.estimates)),
        ]
    )
    best = min(estimate.aic for estimate in result.estimates)
    lines.append(
        ["Akaike's criterion, above the best", *(f"{estimate.aic - best:.1f}" for estimate in result.estimates)]
    )
    lines.append(["order of the noise", *(f"{len(estimate.noise)}" for estimate in result.estimates)])
    return lines


def _format_parameter(estimate: Estimate, name: str, is_engine: bool) -> str:
    """Format a pole or a lag with its bound; an engine's pole as its time constant, times in ms."""
    names = list(estimate.form.natural(estimate.x))
    if name not in names:
        return ""
    index = names.index(name)
    value, deviation = float(estimate.x[index]), estimate.deviation(index)
    if name != "rate_1_s":
        value, deviation = 1e3 * value, 1e3 * deviation
    elif is_engine:
        value, deviation = 1e3 / value, 1e3 * deviation / value**2
    if index in estimate.held:
        return f"{value:.4g} held"
    return (
        _format_slow_pole(value, deviation) if name == "rate_1_s" and not is_engine else _format_value(value, deviation)
    )


def _format_slow_pole(value: float, deviation: float) -> str:
    """Format a slow pole with its bound; one that may be 0 is bounded from above alone."""
    high = value + DEVIATIONS_95 * deviation
    return _format_value(value, deviation) if high < 2.0 * value else f"below {high:.2g}"


def _format_value(value: float, deviation: float) -> str:
    """Format a value with its bound: "none" for a lag at its limit, no number if the bound exceeds the value."""
    half = DEVIATIONS_95 * deviation
    if not half > 0.0:
        return "none"
    if not half <= abs(value):
        return "not determined"
    return f"{value:.4g} ±{float(f'{half:.2g}'):g}"


def _format_delay(estimate: Estimate) -> str:
    low, high = estimate.delay_bounds
    bounds = "held" if 0 in estimate.held else f"({1e3 * low:.4g} to {1e3 * high:.4g})"
    return f"{1e3 * estimate.delay:.4g} {bounds}"


def _make_signals(result: LogIdentification) -> Iterator[Signals]:
    """Yield the stretches, with the model's output from the command alone and the residuals."""
    for log, rows in zip(result.prepared.stretches, result.problem.spans, strict=True):
        model = log.output - result.chosen.residual[rows]
        yield Signals(log.command_times, log.command, log.times, log.output, model, result.white[rows])


def _draw_information(result: LogIdentification) -> dict[str, Any]:
    """Draw the coherence, and the information on the delay that a command of each frequency would give."""
    hertz, value = result.coherence
    grid = np.geomspace(0.05, 0.45 / result.problem.step, 300)
    density = information(result.chosen, grid, result.problem.step)
    data = [
        trace("coherence of command and output", GREEN, hertz, value),
        trace(
            "what a command tells of the delay, over its most", BLUE, grid, density / density.max(), 1, showlegend=True
        ),
    ]
    layout = panels(440, "frequency [Hz]", ("coherence", "of its most"), log=True, domains=((0.55, 1.0), (0.0, 0.45)))
    return {"data": data, "layout": layout | HOVER}
