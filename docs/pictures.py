"""Draws the pictures of the documentation from flights: ``make pictures``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import matplotlib as mpl
import numpy as np

from cosim import Scenario, fly
from hexjet_paper.experiments import COMPARED
from hexjet_paper.extensions import MAX_SENSITIVITY
from hexjet_paper.report.figures import COLOURS, LABELS, NAMES
from hexjet_paper.report.result import Reproduction
from hexjet_paper.reproduce import reproduce

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

FOLDER = Path(__file__).parent / "pictures"
PAPER = Path(__file__).parents[1] / "runs" / "paper"
ORANGE, BLUE, GREY = "#e8891c", "#2a78d6", "#8a939b"


def roll_doublet() -> None:
    """Draw the first flight: roll without and with the predictor."""
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


def paper_steps(found: Reproduction) -> None:
    """Draw the paper's steps with three delays in both fidelities."""
    figure, axes = plt.subplots(2, 3, figsize=(11, 5), sharex=True, sharey=True, constrained_layout=True)
    fidelities = (("linear plant", found.linear.results), ("six degrees of freedom", found.flight_results))
    for row, (fidelity, results) in zip(axes, fidelities, strict=True):
        for panel, delay in zip(row, (5, 10, 25), strict=True):
            smith = results[f"step-{delay}.smith"]
            panel.plot(smith.time, np.degrees(smith.setpoint), "--", color=GREY, lw=1)
            for controller in COMPARED:
                if result := results.get(f"step-{delay}.{controller}"):
                    panel.plot(result.time, np.degrees(result.angle), color=COLOURS[controller], lw=1.4)
            panel.set_title(f"{delay} samples, {fidelity}", loc="left", fontsize=9)
            panel.set(xlim=(0, 2), ylim=(-30, 30))
        row[0].set_ylabel("roll [deg]")
    for panel in axes[1]:
        panel.set_xlabel("time [s]")
    handles = [Line2D([], [], color=COLOURS[c], label=NAMES[c]) for c in COMPARED]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    _save(figure, axes.flat, "paper-steps.png")


def paper_robustness(found: Reproduction) -> None:
    """Draw the robustness maps of the Hex-Jet."""
    maps = [each for each in found.linear.maps if each.vehicle == "hexjet"]
    figure, axes = plt.subplots(2, 3, figsize=(11, 5.6), sharex=True, sharey=True, constrained_layout=True)
    colours = mpl.colormaps["viridis_r"].with_extremes(bad="#c9a0a0")
    for panel, each in zip(axes.flat, maps, strict=True):
        cells = np.array(each.sensitivity, dtype=float)  # None becomes NaN
        mesh = panel.pcolormesh(each.delay_errors, each.gains, cells, cmap=colours, vmin=1, vmax=4, shading="nearest")
        panel.contour(each.delay_errors, each.gains, cells, levels=[MAX_SENSITIVITY], colors="k", linewidths=1.2)
        panel.plot(0, 1, "kx", ms=8, mew=2)
        panel.set(yscale="log", yticks=[0.25, 0.5, 1, 2, 4], yticklabels=["1/4", "1/2", "1", "2", "4"])
        panel.minorticks_off()
        panel.set_title(f"{LABELS[each.controller]}: {100 * each.stable_share:.0f} % stable", loc="left", fontsize=9)
    for panel in axes[1]:
        panel.set_xlabel("delay error [samples]")
    for panel in axes[:, 0]:
        panel.set_ylabel("gain error [times]")
    figure.colorbar(mesh, ax=axes, label="peak sensitivity", extend="max", shrink=0.7)
    _save(figure, axes.flat, "paper-robustness.png")


def paper_offset(found: Reproduction) -> None:
    """Draw flights with half a kilogram 1 cm off centre."""
    figure, axes = plt.subplots(figsize=(8, 3.4), constrained_layout=True)
    for each in found.offsets:
        dash = "--" if each.controller == "state-disturbance" else "-"  # coincides with the filtered Smith's
        colour, name = COLOURS[each.controller], NAMES[each.controller]
        axes.plot(each.time, np.degrees(each.roll), dash, color=colour, label=name)
    axes.set(xlabel="time after the load came on board [s]", ylabel="roll [deg]", xlim=(0, 25))
    axes.legend(fontsize=8, frameon=False)
    _save(figure, [axes], "paper-offset.png")


def _save(figure: Figure, all_axes: Iterable[Axes], name: str) -> None:
    for axes in all_axes:
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(FOLDER / name, dpi=90, metadata={"Software": None})


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    roll_doublet()
    reproduction = reproduce(PAPER)
    paper_steps(reproduction)
    paper_robustness(reproduction)
    paper_offset(reproduction)
