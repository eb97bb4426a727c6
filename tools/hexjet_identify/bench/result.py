"""What an identification from a bench leaves in a folder: numbers, page, engine; and what a terminal is told."""

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
from cosim.results.report.plot import BLUE, HOVER, panels, trace
from hexjet_identify.bench.engine_table import engine_table, own_engine_table, why_no_engine
from hexjet_identify.bench.identification import Identification
from hexjet_identify.engine_file import DEVIATIONS_95, FITTED, engine_readme, write_with_engine
from hexjet_identify.fit.estimate import Estimate
from hexjet_identify.fit.evidence import MOVEMENT_COLUMNS, describe_movements

BOUNDS_TEXT = (
    "The first model is the one that is written. The delay's bounds are those of its profile likelihood with two lags, "
    "or 1.96 standard deviations like the others; they hold where the model explains the log."
)
# Label of a parameter on the page, and the factor to its unit there.
PARAMETER_LABELS = {
    "delay_s": ("delay, ms", 1e3),
    "lag_s": ("lag, ms", 1e3),
    "second_lag_s": ("second lag, ms", 1e3),
    "rise": ("fastest rise", 1.0),
    "fall": ("fastest fall", 1.0),
}


class BenchIdentifyResult(FolderResult):
    """An engine from its bench logs.

    ``write`` leaves ``identification.json``, ``report.html`` and, where there is one, an engine with its uncertainty.

    Attributes
    ----------
    identification : Identification
        Everything.
    """

    def __init__(self, identification: Identification) -> None:
        self.identification = identification
        self.files = {}

    @property
    def found(self) -> bool:
        """Whether the logs tell a model that explains them."""
        return not self.identification.refused

    def _write(self, folder: Path) -> dict[str, Path]:
        found, texts, archive = self.identification, {}, None
        if not why_no_engine(found):
            own = found.engine
            table = engine_table(found) if own is None else own_engine_table(found, own)
            texts = {"engine": toml_text(table), "readme": readme(found)}
            archive = data_folder("fmus") / f"{FITTED}.fmu" if own is None else own.spec.archive.path
        return write_with_engine(folder, found.to_dict(), page(found), texts, archive)

    def to_dict(self) -> dict[str, Any]:
        return self.identification.to_dict()

    def lines(self, most: int = 3) -> list[str]:
        """Return the verdict and the ``most`` weighty notes, among them one on what is not told."""
        found, reason = self.identification, why_no_engine(self.identification)
        notes, untold = note_lines(found.notes), [f"not told: {line}" for line in found.untold]
        shown = [*notes[: most - len(untold[:1])], *untold[:1]]
        more = len(notes) + len(untold) - len(shown)
        said = [found.verdict.words, *([f"no engine: {reason}"] if reason else []), *shown]
        return [*said, *([f"{more} more on the page"] if more > 0 else [])]

    def tables(self) -> list[Table]:
        """Return the numbers with their bounds."""
        found = self.identification
        return [Table("", (WITH_BOUNDS, found.chosen.form.label), rows(found))]

    def _figures(self) -> Mapping[str, Any]:
        return page(self.identification).figures


def page(found: Identification) -> Page:
    """Return the page of an identification."""
    first, held_back = found.records[0], found.held_back
    units = first.command_unit or first.command_name, found.unit
    columns = [WITH_BOUNDS, *(estimate.form.label for estimate in found.estimates)]
    movements = describe_movements(held_back, found.unit, found.problem.swing)
    text = "Each by the model as fitted to every second movement, not to this one; times since the command moves."
    cards = [
        Card("Measured and modelled", figure="signals"),
        Card("Models", columns, rows(found, every=True), BOUNDS_TEXT),
        Card("Not told by the log, and the next test", lines=found.untold or ("It tells everything that was asked.",)),
        *([Card("Movements, predicted", MOVEMENT_COLUMNS, movements, text)] if held_back else []),
        *([Card("Static line", figure="curve")] if len(found.chosen.levels(found.problem)) else []),
    ]
    figures = {"signals": draw_signals(_make_signals(found), units)}
    if len(found.chosen.levels(found.problem)):
        figures["curve"] = _draw_levels(found)
    reason = why_no_engine(found)
    shown = Page(
        "identification from a bench",
        ", ".join(record.path.name for record in found.records),
        cards,
        figures,
        summary=[summary(found)],
        problems=[f"no engine: {reason}"] if reason else [],
        notes=found.notes,
        source=" ".join(str(record.path) for record in found.records),
    )
    return judged_page(found.judgement, shown)


def rows(found: Identification, every: bool = False) -> list[list[str]]:
    """Return the numbers of the chosen form, or of ``every`` one, a row a quantity, with 95 % bounds."""
    estimates = found.estimates if every else found.estimates[:1]
    names = list(dict.fromkeys(name for each in estimates for name in each.numbers))
    table = []
    for name in names:
        label, factor = PARAMETER_LABELS.get(name, (name, 1.0))
        label += f", {found.unit or '1'}/s" if name in ("rise", "fall") and found.engine is None else ""
        table.append([label, *(_format_number(each, name, factor) for each in estimates)])
    low, high = (found.limits[0] + (found.limits[1] - found.limits[0]) * found.problem.knots[[0, -1]]).tolist()
    if len(found.chosen.levels(found.problem)):
        ends = [[f"{each.levels(found.problem)[end]:.4g}" for each in estimates] for end in (0, -1)]
        table.append([f"output from {low:.4g} to {high:.4g}, {found.unit}".rstrip(", ")])
        table[-1] += [f"{a} to {b}" for a, b in zip(*ends, strict=True)]
    if every and len(estimates) > 1:
        table.append(["BIC, above the first", *(f"{each.bic - estimates[0].bic:.1f}" for each in estimates)])
    return table


def _format_number(estimate: Estimate, name: str, factor: float) -> str:
    if name not in estimate.numbers:
        return ""
    value, deviation = estimate.numbers[name]
    low, high = estimate.delay_bounds
    if name == "delay_s" and np.isfinite(low) and np.isfinite(deviation):
        return f"{factor * value:.4g} ({factor * low:.4g} to {factor * high:.4g})"
    half = DEVIATIONS_95 * deviation
    return f"{factor * value:.4g} ±{float(f'{factor * half:.2g}'):g}" if half <= abs(value) else "not told"


def summary(found: Identification) -> str:
    """Describe the logs in a line."""
    first, lost = found.records[0], max(record.lost_fraction for record in found.records)
    seconds = sum(float(record.times[-1] - record.times[0]) for record in found.records)
    missing = f", {100.0 * lost:.2g} % of the rows missing" if lost > 0.005 else ""
    names = ", ".join(record.path.name for record in found.records)
    engine = "" if found.engine is None else f", {found.engine.label}"
    return (
        f"{names}: {first.command_name} to {first.output_name}{engine}; {seconds:.4g} s, "
        f"{sum(len(record.times) for record in found.records)} rows, one each {1e3 * first.step:.4g} ms{missing}."
    )


def readme(found: Identification) -> str:
    """Return the page of the engine in Markdown: where it comes from, where it holds, what was left over."""
    first, (low, high) = found.records[0], found.limits
    commands = np.concatenate([record.command for record in found.records])
    validity = f"{first.command_name} from {commands.min():.4g} to {commands.max():.4g}"
    if found.engine is None:
        validity += f", with throttle 0 at {low:g} and 1 at {high:g}"
    own = () if found.engine is None else (f"`{found.engine.label}`, its other parameters as they were",)
    residuals = f"{found.residual_rms:.3g} {found.unit} (rms); {found.verdict.words}."
    source = f"{summary(found)} `hexjet engine from-bench`"
    return engine_readme("bench log", rows(found), source, validity, residuals, found.untold, found.notes, *own)


def _make_signals(found: Identification) -> Iterator[Signals]:
    """Yield the signals of each log, one log behind the other in time."""
    shift, (low, high), residual = 0.0, found.limits, found.chosen.residual
    for log, span in zip(found.problem.logs, found.problem.spans, strict=True):
        times, values = log.command_times, low + (high - low) * log.command
        if not log.is_straight:
            at = np.repeat(np.arange(len(times)), 2)
            times, values = np.append(times[at][1:], log.times[-1]), values[at]
        left = residual[span]
        yield Signals(times + shift, values, log.times + shift, log.output, log.output - left, left)
        shift += float(log.times[-1]) + 5.0


def _draw_levels(found: Identification) -> dict[str, Any]:
    """Draw the static line over the command."""
    first, (low, high) = found.records[0], found.limits
    levels = found.chosen.levels(found.problem)
    title = f"{first.command_name} {f'[{first.command_unit}]' if first.command_unit else ''}".strip()
    data = [trace("static line", BLUE, low + (high - low) * found.problem.knots, levels)]
    return {"data": data, "layout": panels(320, title, (found.unit,), log=False) | HOVER}
