"""Flies what docs/sensors.md says: the flagship flights with the sensors as stated and with the profile ``measured``.

docs/full-scale.md gets a line of it, between its marks.

    python docs/sensors.py
"""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

from cosim import Run, Scenario, fly
from cosim.results.report.marks import table, write_marks

PAGE = Path(__file__).parent / "sensors.md"
MARK = "sensors in a line"
LINES = {  # pages with flights of the table in a line
    Path(__file__).parent / "full-scale.md": ("full-scale roll doublet", "full-scale gust"),
}
SEEDS = range(1, 6)
NO_LEAN_ERROR: dict[str, Any] = {"vehicle": {"sensors": {"attitude": {"ahrs_time_constant_s": 0.0}}}}
SENSORS: dict[str, dict[str, Any]] = {
    "as stated": {"sensors": "stated"},
    "measured, lean corrected": {"sensors": "measured", **NO_LEAN_ERROR},
    "measured": {"sensors": "measured"},
}
FLIGHTS: dict[str, tuple[str, dict[str, Any]]] = {
    "roll doublet, baseline": ("roll-doublet", {"controller": "baseline"}),
    "roll doublet, Smith": ("roll-doublet", {}),
    "full-scale roll doublet": ("full-scale-roll-doublet", {}),
    "full-scale gust": ("full-scale-gust", {}),
    "landing": ("climb-and-land", {}),
}


def numbers(runs: Sequence[Run], metric: str, form: str, scale: float = 1.0) -> str:
    """Return the smallest and the largest of a metric over the flights that have one, as words."""
    values = [value for run in runs if (value := run.summary.flat_metrics[metric]) is not None]
    texts = [form.format(scale * value) for value in (min(values), max(values))] if values else ["none"]
    return " to ".join(dict.fromkeys(texts))


def words(name: str, runs: Sequence[Run]) -> str:
    """Return a cell of the table: what became of the flights of one kind with one sort of sensors."""
    completed = [run for run in runs if run.outcome == "completed"]
    if not completed:
        return f"{len(runs)} of {len(runs)} lost"
    lost = f"{len(runs) - len(completed)} of {len(runs)} lost; " if len(completed) < len(runs) else ""
    if "doublet" in name:
        settled = [run for run in completed if run.summary.flat_metrics["roll.settling_time_s"] is not None]
        said = f"overshoot {numbers(completed, 'roll.overshoot_percent', '{:.1f}')} %, "
        said += f"{len(settled)} of {len(runs)} settle"
        said += f" in {numbers(settled, 'roll.settling_time_s', '{:.2f}')} s" if settled else ""
    elif "gust" in name:
        said = f"roll off by at most {numbers(completed, 'roll.max_abs_error_rad', '{:.1f}', degrees(1.0))} deg, "
        said += f"{numbers(completed, 'position.drift_m', '{:.0f}')} m away"
    else:
        said = f"touches down at {numbers(completed, 'touchdown_m_s', '{:.2f}')} m/s, "
        said += f"{numbers(completed, 'position.final_drift_m', '{:.1f}')} m away"
    return lost + said


def write(rows: Sequence[Sequence[str]]) -> None:
    """Write the table into its page, and a line of it into the others."""
    write_marks(PAGE, {"flights": table(("flight", *SENSORS), rows, left=1 + len(SENSORS))})
    for page, names in LINES.items():
        flights = "; ".join(f"{row[0]}: {row[-1]} (lean corrected: {row[-2]})" for row in rows if row[0] in names)
        write_marks(page, {MARK: f'With `sensors = "measured"`, {len(SEEDS)} seeds each: {flights}.\n'})


def main() -> None:
    """Fly all of them and write the pages."""
    rows = []
    for name, (scenario, changes) in FLIGHTS.items():
        flight = Scenario.load(scenario)
        cells = []
        for sensors in SENSORS.values():
            runs = [fly(flight.replace(expect=[], seed=seed, **changes, **sensors)) for seed in SEEDS]
            cells.append(words(name, runs))
        rows.append((name, *cells))
        print(rows[-1], flush=True)
    write(rows)


if __name__ == "__main__":
    main()
