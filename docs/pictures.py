"""Draws the pictures of the documentation from flights: ``make pictures``."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from cosim import Scenario, fly

mpl.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent / "pictures"
ORANGE, BLUE, GREY = "#e8891c", "#2a78d6", "#8a939b"


def roll_doublet() -> None:
    """The first flight: without and with the predictor."""
    scenario = Scenario.load("roll-doublet")
    baseline, smith = (fly(scenario.replace(controller=name)) for name in ("baseline", "smith"))
    figure, (roll, rate) = plt.subplots(2, 1, figsize=(9, 5.2), sharex=True, constrained_layout=True)
    t = smith.log["time_s"]
    roll.plot(t, np.degrees(smith.log["roll_setpoint_rad"]), "--", color=GREY, lw=1.2, label="set-point")
    roll.plot(baseline.log["time_s"], np.degrees(baseline.log["roll_rad"]), color=ORANGE, label="baseline")
    roll.plot(t, np.degrees(smith.log["roll_rad"]), color=BLUE, label="Smith predictor, same gains")
    roll.set(ylabel="roll [deg]", ylim=(-45, 45))
    roll.set_title("Scaled Hex-Jet, engines 0.1 s late: roll doublet of 10 deg", loc="left", fontsize=11)
    rate.plot(t, np.degrees(smith.log["rate_p_measured_rad_s"]), color=GREY, label="measured roll rate")
    rate.plot(t, np.degrees(smith.log["rate_p_predicted_rad_s"]), color=BLUE, label="predicted, fed to the controller")
    rate.set(xlabel="time [s]", ylabel="roll rate [deg/s]", xlim=(0, 12))
    for axes in (roll, rate):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper right", fontsize=8, framealpha=0.9)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(FOLDER / "roll-doublet.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    roll_doublet()
