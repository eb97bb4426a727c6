"""Fly {name} with the predictor and without, and lay both flights over each other on a page: python compare.py."""

from pathlib import Path

from cosim import Scenario, compare, fly
from cosim.files import new_folder

here = Path(__file__).parent
runs = [fly(Scenario.load(here / "flight.toml"), controller=controller) for controller in ("smith", "baseline")]
for run in runs:
    print(f"{run.summary.controller}: {run.outcome}, rad of roll error {run.metrics['roll'].max_abs_error_rad:.3f}")
print(f"look at {compare(*runs, out=new_folder(here / 'runs', 'compared')).report}")
