"""A campaign: how often does a flight succeed when mass and delay are not what the controller believes?"""

# %% Two numbers vary, every controller flies the same draws, in two processes; resume=True goes on with a folder
from pathlib import Path

from cosim import sweep
from cosim.files import new_folder

folder = new_folder(Path("runs"), "campaign")
swept = sweep(
    "roll-doublet",
    vary={"mismatch.mass_factor": "0.9:1.1", "mismatch.delay_samples": "0:10"},
    controllers=["smith", "baseline"],
    success=["roll.max_abs_error_rad<=0.4", "roll.oscillation_rad<=0.05"],
    settings={"duration_s": 2.5},
    runs=6,
    seed=1,
    workers=2,
    out=folder,
)

# %% How often each succeeds, as the command prints it with --json; a notebook shows `swept` as tables
for controller, counted in swept.to_dict()["controllers"].items():
    won, (low, high) = round(counted["success"] * counted["flights"]), counted["wilson_95"]
    print(f"{controller:9} {won} of 6 succeed: {low:.0%} to {high:.0%} of all such, with 95 % confidence")

# %% One row a flight: what was drawn, what came of it; any of them again, the same to the last bit, now with its log
rows = swept.columns
worst = max(range(len(rows["flight"])), key=lambda n: rows["roll.max_abs_error_rad"][n] or 0.0)
again = swept.fly_again(rows["flight"][worst])
print(f"flight {rows['flight'][worst]} with {rows['controller'][worst]}: {again.run.outcome}, {again.run.reason}")
print(
    f"mass factor {rows['mismatch.mass_factor'][worst]:.3f}, {rows['mismatch.delay_samples'][worst]} samples more delay"
)
print(f"the same log again, bit for bit: {again.same}; next: hexjet show {folder} --page")
