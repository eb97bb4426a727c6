"""What a fit of an engine's own parameters leaves in a folder: numbers, page, engine; and what a terminal is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cosim.base.arrays import Array
from cosim.base.storage.toml import read_toml, toml_text
from cosim.engine.fmu.uncertainty import Uncertainty
from cosim.identify.page import WITH_BOUNDS, draw_signals, judged_page
from cosim.pages import Card, Page
from hexjet_identify.bench.evidence import describe_held_back
from hexjet_identify.bench.grey_box import GreyIdentification
from hexjet_identify.bench.grey_model import STEP_S, output_unit
from hexjet_identify.bench.result import NO_LONGER, lay_behind, movement_cards
from hexjet_identify.engine_file import DEVIATIONS_95, engine_readme, uncertainty_table, whole_delay, write_with_engine

BOUNDS = (
    "The bounds are 1.96 standard deviations of the linearised problem. They hold where the engine explains the log."
)
FOLLOWS = "they still follow the command: the engine does not explain the log"
DELAY = "delay_samples"  # the parameter of an engine's delay, in its internal steps


def write(result: GreyIdentification, folder: Path) -> dict[str, Path]:
    """Write ``identification.json``, ``report.html`` and, where the engine explains the log, its folder's files.

    Raises FlightError if a file cannot be written.
    """
    texts = {"engine": toml_text(engine_table(result)), "readme": readme(result)} if result.leaves_engine else {}
    archive = result.spec.archive.path if result.leaves_engine else None
    return write_with_engine(folder, result.to_dict(), page(result), texts, archive)


def page(result: GreyIdentification) -> Page:
    """Return the page of a fit."""
    first = result.records[0]
    units = first.command_unit or first.command_name, output_unit(first)
    cards = [
        Card("Models", [WITH_BOUNDS, result.choices.engine], rows(result), BOUNDS),
        *([Card("What the log does not tell, and the next test", lines=result.untold)] if result.untold else []),
        *movement_cards(result.held_back, units[1], result.swing),
        Card("Measured and modelled", figure="signals"),
    ]
    shown = Page(
        "identification from a bench",
        f"{result.choices.engine}: {', '.join(result.names)}",
        cards,
        {"signals": draw_signals(lay_behind(result.parts, result.residual), units)},
        summary=[summary(result)],
        problems=[] if result.leaves_engine else ["no engine: with these parameters it does not explain the log"],
        notes=result.notes,
        source=" ".join(str(record.path) for record in result.records),
    )
    return judged_page(result.judgement, shown)


def engine_table(result: GreyIdentification) -> dict[str, object]:
    """Return the mapping file's table: the engine's own, with what was set and fitted, and ``[uncertainty]``."""
    from scipy.linalg import block_diag

    spec, step = result.spec, result.spec.internal_step or STEP_S
    table: dict[str, object] = dict(read_toml(spec.mapping)) if spec.mapping else {}
    known = table.get("parameters")
    parameters: dict[str, object] = dict(known) if isinstance(known, dict) else {}
    parameters |= dict(result.choices.settings)
    parameters |= dict(zip(result.choices.fitted, map(float, result.values[1:]), strict=True))
    names, deviations = list(result.choices.fitted), list(result.deviations[1:])
    keep = list(range(1, len(result.values)))
    if DELAY in spec.parameters:
        parameters[DELAY], off = whole_delay(float(result.values[0]) / step, result.deviations[0] / step)
        names, deviations, keep = [DELAY, *names], [off, *deviations], [0, *keep]
    kept, covariance = _keep_unfitted(spec.uncertainty, {*names, *result.choices.settings})
    covariance = block_diag(result.covariance[np.ix_(keep, keep)], covariance)
    deviations += np.sqrt(np.diag(covariance))[len(names) :].tolist()
    source = f"{', '.join(result.names)} of {result.choices.engine}"
    source += f"; not fitted, as that states them: {', '.join(kept)}" if kept else ""
    logs = ", ".join(record.path.name for record in result.records)
    return table | {
        "fmu": f"engine{spec.archive.path.suffix}",
        "title": f"{spec.title}, fitted to {logs}",
        "parameters": parameters,
        "uncertainty": uncertainty_table(f"{logs}: {source}", [*names, *kept], covariance, np.array(deviations)),
    }


def _keep_unfitted(stated: Uncertainty | None, taken: set[str]) -> tuple[list[str], Array]:
    """Return the parameters that an engine states to be uncertain and that are not ``taken``, and their covariance."""
    if stated is None:
        return [], np.empty((0, 0))
    rows = [row for row, name in enumerate(stated.parameters) if name not in taken]
    deviations, correlation = np.array(stated.deviation)[rows], np.array(stated.correlations)[np.ix_(rows, rows)]
    return [stated.parameters[row] for row in rows], np.outer(deviations, deviations) * correlation


def readme(result: GreyIdentification) -> str:
    """Return the page of the engine in Markdown: where it comes from, where it holds, what was left over."""
    first, engine = result.records[0], f"`{result.choices.engine}`, its other parameters as they were"
    commands = [record.command for record in result.records]
    low, high = min(float(each.min()) for each in commands), max(float(each.max()) for each in commands)
    return engine_readme(
        "bench log",
        rows(result),
        f"{summary(result)} `hexjet identify bench`",
        f"{first.command_name} from {low:.4g} to {high:.4g}",
        f"{result.residual_rms:.3g} {output_unit(first)} (rms); {FOLLOWS if result.misfit.failed else NO_LONGER}.",
        result.untold,
        result.notes,
        engine,
    )


def summary(result: GreyIdentification) -> str:
    """Describe in a line what was fitted to what, and what is left over."""
    first = result.records[0]
    names = ", ".join(record.path.name for record in result.records)
    unit, held = output_unit(first), ""
    if result.held_back is not None:
        held = f"; {describe_held_back(result.held_back, unit, result.swing)}"
    share = 100.0 * result.residual_rms / result.swing
    return (
        f"{names}: {first.command_name} to {first.output_name}, {result.choices.engine}; left over "
        f"{result.residual_rms:.3g} {unit} (rms), {share:.2g} % of its range{held}."
    )


def rows(result: GreyIdentification) -> list[list[str]]:
    """Return the table of what was fitted, with 95 % bounds."""
    return [
        [name, f"{value:.4g} ±{DEVIATIONS_95 * deviation:.2g}"]
        for name, value, deviation in zip(result.names, result.values, result.deviations, strict=True)
    ]
