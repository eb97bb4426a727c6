"""The files and pages of a survey of faults."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from cosim.base.errors import FlightError, InputError
from cosim.base.storage.files import write_records
from cosim.campaign.analysis.worst_cases import write_flight
from cosim.campaign.surveys.faults import SCANS, STARTS, Cell, Limit, Moments, Row, Survival, summary
from cosim.control.predictors.registry import PREDICTORS
from cosim.results.report.marks import table, write_marks
from cosim.results.report.page import render
from cosim.results.resolved_scenario import copy_controller
from cosim.spec.controller_name import is_design, label

TEMPLATE = Path(__file__).parent / "templates" / "survival.html"


def write(result: Survival, folder: Path) -> dict[str, Path]:
    """Write ``survival.csv`` and ``survival.html``, the files of controllers, and in ``cases/`` every flight.

    Raises InputError if they cannot be written.
    """
    paths = {"table": folder / "survival.csv", "report": folder / "survival.html"}
    digits = len(str(len(result.rows)))
    try:
        rows = [
            replace(row, case=write_flight(scenario, folder, _case_name(f"{n:0{digits}d}", row)))
            for n, (row, scenario) in enumerate(zip(result.rows, result.scenarios, strict=False), 1)
        ]
        result = replace(result, rows=rows + result.rows[len(rows) :])
        write_records(paths["table"], Row, result.rows)
        controllers, lines = summary(result)
        named = [label(name) for name in controllers]
        render(TEMPLATE, paths["report"], {}, result=result, controllers=named, table=lines, where=folder.name)
        copies: dict[str, Path | bytes] = {}
        for source in result.custom_controllers:
            copy_controller(source, copies)
        copies |= {Path(name).name: Path(name) for name in controllers if is_design(name)}
        for name, path in copies.items():
            assert isinstance(path, Path)
            shutil.copyfile(path, folder / name)
    except FlightError as error:
        raise InputError(str(error)) from error
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from error
    return paths


def _case_name(prefix: str, row: Row) -> str:
    return "-".join([prefix, *re.findall(r"\w+", f"{row.kind} {row.place} {row.start}")])


MARKS = ("faults", "faults-attainable", "faults-moments", "faults-limits")  # the marks of docs/faults.md


def write_page(result: Survival, path: Path) -> None:
    """Write the tables, and what explains them, between the marks of a page; see :mod:`cosim.results.report.marks`."""
    write_marks(path, page_parts(result))


def page_parts(result: Survival) -> dict[str, str]:
    """Return what :func:`write_page` writes, by mark."""
    controllers, outcomes = summary(result)
    lines = [
        (kind, start, *map(_cell_text, cells), _times(_select_predicting(controllers, cells)))
        for kind, start, cells in outcomes
    ]
    scan_titles = ("what grows", "controller", *(f"from {start}" for start in STARTS))
    return {
        "faults": table(("fault", "from", *controllers, "detected after"), lines, left=2),
        "faults-attainable": table(
            ("lost jets", "thrust over weight", "roll moment left in hover"), _authority_lines(result)
        ),
        "faults-moments": "" if result.moments is None else f"{_moments_in_words(result.moments)}\n",
        "faults-limits": table(scan_titles, _scan_lines(result), 4),
    }


def _moments_in_words(moments: Moments) -> str:
    thrust, moment, acceleration = moments.thrust, moments.moment, moments.acceleration
    return (
        f"One jet in hover is {thrust:.2f} N, {moment / thrust:.2f} m off the centre: {moment:.2f} N m on "
        f"{moment / acceleration:.4f} kg m², {acceleration:.1f} rad/s². What the other five are told acts after "
        f"{moments.late:.2f} s (confirmation and delay): {moments.rate:.1f} rad/s and {moments.angle:.2f} rad by then, "
        "had it gone out at once."
    )


def _scan_lines(result: Survival) -> Iterator[tuple[str, ...]]:
    """Yield the line of every scan of :data:`SCANS` with a controller."""
    described = {(limit.quantity, limit.controller, limit.start): _describe_limits(limit) for limit in result.limits}
    for quantity, controller in dict.fromkeys((limit.quantity, limit.controller) for limit in result.limits):
        yield quantity, controller, *(described.get((quantity, controller, start), "-") for start in STARTS)


def _describe_limits(limit: Limit) -> str:
    """Describe where it is held, where no more than airborne, and the first point where it is lost."""
    grid = SCANS[limit.quantity]
    spans = [
        f"{what} {_format_spans(values, grid)}"
        for what, values in (("held", limit.held), ("airborne", limit.airborne))
        if values
    ]
    return ", ".join([*spans, "lost nowhere" if limit.lost_at is None else f"lost at {limit.lost_at:g}"])


def _format_spans(values: Sequence[float], grid: Sequence[float]) -> str:
    """Describe points of a grid, those beside each other as first and last."""
    spans: list[list[int]] = []
    for place in (grid.index(value) for value in values):
        if spans and spans[-1][-1] == place - 1:
            spans[-1].append(place)
        else:
            spans.append([place])
    return " and ".join(f"{grid[s[0]]:g}" + (f" to {grid[s[-1]]:g}" if len(s) > 1 else "") for s in spans)


def _cell_text(cell: Cell) -> str:
    airborne = f", {cell.airborne} airborne" if cell.airborne else ""
    return f"{cell.held} of {cell.flights}{airborne}; {cell.lean_deg:.0f}°, {cell.lost_m:.1f} m"


def _select_predicting(controllers: Sequence[str], cells: Sequence[Cell]) -> Sequence[Cell]:
    """Return the cells of the controllers that predict, as one from outside is taken to; all where none does."""
    unaware = {name for name, spec in PREDICTORS.items() if not spec.needs_model}
    return [cell for name, cell in zip(controllers, cells, strict=True) if name not in unaware] or cells


def _times(cells: Sequence[Cell]) -> str:
    """Return the first and the last detection."""
    times = [1e3 * time for cell in cells if cell.detected_s for time in cell.detected_s]
    if not times:
        return "-"
    return f"{min(times):.0f} ms" if max(times) - min(times) < 0.5 else f"{min(times):.0f} to {max(times):.0f} ms"


def _authority_lines(result: Survival) -> Iterator[tuple[str, ...]]:
    """Yield the lines of the attainable sets, those that come to the same on one."""
    alike: dict[tuple[str, str], list[str]] = {}
    for attainable in result.attainable:
        roll = "cannot hover" if attainable.roll is None else f"{100.0 * attainable.roll:.0f} %"
        lost = " and ".join(map(str, attainable.lost)) or "none"
        alike.setdefault((f"{attainable.thrust:.2f}", roll), []).append(lost)
    return (("; ".join(lost), *numbers) for numbers, lost in alike.items())
