"""``python -m benchmarks.accuracy``: the airframe against NASA's check cases, and its error on our own flights.

    python -m benchmarks.accuracy --data FOLDER            both; FOLDER has NASA's trajectories, Atmos_02_sim_01.csv...
    python -m benchmarks.accuracy --only flights           this part alone; it needs no data, nor does "bare"
    python -m benchmarks.accuracy --only runs              by runs a step, every shipped flight: aircraft/substeps.toml
    python -m benchmarks.accuracy --data FOLDER --page docs/accuracy.md      and write the tables into the page

The status is 1 if a check case lies outside the spread of NASA's simulators.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.accuracy.bare_jsbsim import measure
from benchmarks.accuracy.check_cases import CASES, Compared, compare, fly_case, read_simulators
from benchmarks.accuracy.flights import CLOSED, FLOWN_RUNS, closed_loop
from benchmarks.accuracy.runs_a_step import RUNS as STEP_RUNS
from benchmarks.accuracy.runs_a_step import as_toml, measure_flight, shipped_flights, vehicle_rows
from cosim import InputError
from cosim.pages import check_marks, table, write_marks
from cosim.vehicle.executive import VERSION

STEP_ERRORS = Path(__file__).resolve().parents[2] / "aircraft" / "substeps.toml"
CASE_MARK, CLOSED_MARK, BARE_MARK, VEHICLE_MARK = "check cases", "closed loop", "bare JSBSim", "runs by vehicle"
MARKS_BY_PART = {
    "cases": [CASE_MARK],
    "flights": [CLOSED_MARK],
    "runs": [VEHICLE_MARK],
    "bare": [BARE_MARK],
}


def case_table(folder: Path) -> tuple[str, list[Compared]]:
    """Return the table of NASA's check cases, without what agrees to the last digit, and its rows as data."""
    comparisons = [
        row
        for number, case in CASES.items()
        for row in compare(number, fly_case(case), read_simulators(folder, number))
    ]
    notable = [row for row in comparisons if row.spread > 1e-9 or not row.inside]
    rows = [
        [
            f"{row.case} {CASES[row.case].title}",
            row.quantity,
            str(row.simulators),
            f"{row.spread:.1e}",
            f"{row.nearest:.1e}",
            f"{row.beyond:.1e}",
            "inside" if row.inside else "**outside**",
        ]
        for row in notable
    ]
    columns = ["case", "quantity", "simulators", "their spread", "ours from the nearest", "ours beyond all", ""]
    return table(columns, rows), comparisons


def whole_flight_table() -> str:
    """Return the table of whole flights with their controllers, at the flights' number of JSBSim runs."""
    rows = []
    for name in CLOSED:
        angle, position = closed_loop(name, FLOWN_RUNS)
        rows.append([name, f"{angle:.1e}", f"{position:.1e}"])
    return table(["flight, four runs against 64", "Euler angles, deg", "place, mm"], rows)


def runs_table() -> str:
    """Return the table of errors by vehicle and runs a step; write the file that ``substeps`` is resolved by."""
    flights = [measure_flight(scenario) for scenario in shipped_flights()]
    STEP_ERRORS.write_text(as_toml(flights), encoding="utf-8")
    heads = [f"{runs} run{'s' if runs > 1 else ''}" for runs in STEP_RUNS]
    return table(["vehicle", "flights", *heads], vehicle_rows(flights))


def main(arguments: list[str] | None = None) -> int:
    """Write the tables of the chosen parts and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy", description="How exact the airframe is.")
    parser.add_argument("--data", type=Path, help="folder with the trajectories of NASA's simulators")
    parser.add_argument("--only", choices=list(MARKS_BY_PART), help="this part alone")
    parser.add_argument("--page", type=Path, help="write the tables between the marks of this page")
    options = parser.parse_args(arguments)
    chosen = [options.only] if options.only else list(MARKS_BY_PART)
    if options.data is None and "cases" in chosen:
        parser.error("--data FOLDER is needed for the check cases; without it: --only flights")
    try:
        texts = {}
        if options.page:
            check_marks(options.page, [mark for part in chosen for mark in MARKS_BY_PART[part]])
        outside = 0
        if "cases" in chosen:
            texts[CASE_MARK], rows = case_table(options.data)
            outside = sum(not row.inside for row in rows)
        if "flights" in chosen:
            texts[CLOSED_MARK] = whole_flight_table()
        if "runs" in chosen:
            texts[VEHICLE_MARK] = runs_table()
        if "bare" in chosen:
            texts[BARE_MARK] = table([f"JSBSim {VERSION} alone", "comes to"], measure())
        if options.page:
            write_marks(options.page, texts)
    except InputError as problem:
        print(f"accuracy: {problem}", file=sys.stderr)
        return 2
    print("\n".join(texts.values()))
    if outside:
        print(f"{outside} quantities outside the spread of NASA's simulators", file=sys.stderr)
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
