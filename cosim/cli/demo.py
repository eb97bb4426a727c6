"""The first flight: ``roll-doublet`` without and with the Smith predictor, side by side."""

from __future__ import annotations

import sys
from pathlib import Path

from cosim import FlightError, InputError, Scenario, compare, fly
from cosim.cli.console import echo, show_result
from cosim.flight import new_folder


def main() -> int:
    """Fly both, print the comparison and say where the reports are."""
    folder = new_folder(Path("runs"), "demo")
    scenario = Scenario.load("roll-doublet")
    echo(f"{scenario.title}\n")
    runs = []
    for controller in ("baseline", "smith"):
        run = fly(scenario.replace(controller=controller), folder / controller)
        echo(f"{controller:9} {run.summary.ending} ({run.summary.realtime_factor:.0f} x real time)")
        runs.append(run)
    show_result(compare(*runs, out=folder))
    for run in runs:
        echo(f"{run.summary.controller:10}: {run.folder}/report.html")
    return 0 if runs[1].summary.expectations_met else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (InputError, FlightError) as error:
        sys.exit(f"demo: {error}")
