"""A campaign: how often does a flight succeed when mass and delay are not what the controller believes?"""

# %% The study: two numbers vary, every controller flies the same draws
from pathlib import Path

from cosim.campaign import fly_again, open_study, run_campaign
from cosim.campaign.analysis.statistics import wilson
from cosim.flight import new_folder

study = open_study(
    "roll-doublet",
    vary=["mismatch.mass_factor=0.9:1.1", "mismatch.delay_samples=0:10"],
    controllers=["smith", "baseline"],
    success=["roll.max_abs_error_rad<=0.4", "roll.oscillation_rad<=0.05"],
    settings=["duration_s=2.5"],
    runs=6,
    seed=1,
)

# %% Fly it in two processes; a folder that was interrupted goes on with resume=True
folder = new_folder(Path("runs"), "campaign")
campaign = run_campaign(study, folder, workers=2)

# %% One row a flight: what was drawn, what came of it
rows = campaign.columns
for controller in ("smith", "baseline"):
    won = [bool(each) for each, name in zip(rows["success"], rows["controller"], strict=True) if name == controller]
    low, high = wilson(sum(won), len(won))
    print(f"{controller:9} {sum(won)} of {len(won)} succeed: {low:.0%} to {high:.0%} of all such, with 95 % confidence")

# %% Any of them again, the same to the last bit, now with its log
worst = max(range(len(rows["flight"])), key=lambda n: rows["roll.max_abs_error_rad"][n] or 0.0)
again = fly_again(campaign, rows["flight"][worst])
print(f"flight {rows['flight'][worst]} with {rows['controller'][worst]}: {again.run.outcome}, {again.run.reason}")
print(
    f"mass factor {rows['mismatch.mass_factor'][worst]:.3f}, {rows['mismatch.delay_samples'][worst]} samples more delay"
)
print(f"the same log again, bit for bit: {again.same}; next: hexjet report {folder}")
