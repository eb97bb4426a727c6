"""The roll doublet without and with the Smith predictor, side by side: what ``make demo`` flies."""

import sys
from pathlib import Path

from cosim import Scenario, compare, fly
from cosim.commands import show_result
from cosim.files import new_folder

folder = new_folder(Path("runs"), "demo")
scenario = Scenario.load("roll-doublet")
print(f"{scenario.title}\n")
runs = []
for controller in ("baseline", "smith"):
    run = fly(scenario, folder / controller, controller=controller)
    print(f"{controller:9} {run.summary.ending} ({run.summary.realtime_factor:.0f} x real time)")
    runs.append(run)
show_result(compare(*runs, out=folder), verbose=True)
for run in runs:
    print(f"{run.summary.controller:10}: {run.folder}/report.html")
sys.exit(0 if runs[1].summary.expectations_met else 1)
