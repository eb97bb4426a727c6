"""A first flight: the roll doublet with the paper's predictor and without, side by side.

Run it as a program, or cell by cell in an editor that knows ``# %%``.
"""

# %% Fly
from pathlib import Path

from cosim import Scenario, fly, plot
from cosim.files import new_folder

doublet = Scenario.load("roll-doublet")
folder = new_folder(Path("runs"), "first-flight")
runs = {"smith": fly(doublet, folder), "baseline": fly(doublet, controller="baseline")}  # one into a run's folder

# %% Look: outcome, verdict, metrics
for name, run in runs.items():
    roll = run.metrics["roll"]
    print(f"{name:9} {run.outcome} ({run.reason}), greatest roll error {roll.max_abs_error_rad:.3f} rad")

# %% Every signal is a column of the log, an array with its unit in its name
log = runs["smith"].log
late = (abs(log["roll_rad"]) > 0.01).argmax() - (log["roll_setpoint_rad"] > 0.0).argmax()
print(f"{len(log.columns)} columns of {len(log)} steps; the roll is under way {late} steps after it was asked for")

# %% Draw both; the folder has the page of its run, and a scenario that flies again as it is
figure = plot(list(runs.values()), "roll_rad", "roll_setpoint_rad", "throttle_1")
figure.write_html(folder / "both.html")
print(
    f"look at {folder / 'both.html'} and {folder / 'report.html'}; hexjet fly {folder / 'scenario.toml'} flies it again"
)
