"""Flies the surveys of docs/faults.md and docs/tables/failsafes.md, and writes their tables between the marks.

python docs/surveys.py faults                        every single fault of the scaled Hex-Jet, some minutes
python docs/surveys.py failsafes [AIRCRAFT ...]      every failsafe of these vehicles; without any: of all
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

from cosim.control.predictors.registry import PREDICTORS
from cosim.results.report.marks import check_marks, table, write_marks
from hexjet_prove.surveys.failsafe_table import grid
from hexjet_prove.surveys.failsafes import HOVER_S, TABLED, Conditions, Failsafes, failsafes
from hexjet_prove.surveys.faults import SCANS, STARTS, Cell, Limit, Moments, Survival, summary, survival

DOCS = Path(__file__).parent
FAULT_MARKS = ("faults", "faults-attainable", "faults-moments", "faults-limits")


def fault_parts(result: Survival) -> dict[str, str]:
    """Return the tables of single faults, and what explains them, by mark."""
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


def mark(aircraft: str) -> str:
    """Return the name of the mark in a page between which a vehicle's table goes."""
    return f"failsafes after a take-off, {aircraft}"


def failsafe_part(result: Failsafes) -> str:
    """Return the part of a page for flights after a take-off: a line for each failsafe, a column for each start."""
    low, high = HOVER_S
    winds = ", ".join(f"{wind:g}" for wind in sorted({row.wind_m_s for row in result.rows}))
    limits = (
        f"Engine `{result.engine}`, controller `{result.controller}`; a leg that touches faster than "
        f"{result.limit_m_s:.2f} m/s counts as a crash, and what touches faster than {result.trip_m_s:.2f} m/s "
        f"sideways has slid. After a take-off and {low:g} to {high:g} s of hover, a moment drawn for each flight; "
        f"winds of {winds} m/s in turn."
    )
    head, *lines = grid(result)
    return f"{limits}\n\n" + table(head, lines)


def progress(part: str, finished: int, total: int) -> None:
    """Print what was flown."""
    print(f"{part} ({finished} of {total})", flush=True)


def main() -> None:
    """Fly one of the surveys, and write its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("survey", choices=("faults", "failsafes"))
    parser.add_argument("aircraft", nargs="*", default=TABLED)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    if asked.survey == "faults":
        check_marks(DOCS / "faults.md", FAULT_MARKS)
        write_marks(
            DOCS / "faults.md", fault_parts(survival("hexjet", limits=True, workers=asked.workers, progress=progress))
        )
        return
    page = DOCS / "tables" / "failsafes.md"
    check_marks(page, map(mark, asked.aircraft))
    flown = failsafes(asked.aircraft, None, None, [], Conditions(), asked.workers, progress)
    write_marks(page, {mark(each.aircraft): failsafe_part(each) for each in flown})


if __name__ == "__main__":
    main()
