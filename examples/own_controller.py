"""A controller of one's own: a predictor between gyro and rate loop, beside the paper's."""

# %% The class; what it shows becomes columns of the log, its parameters are reached by --set, studies and searches
from collections import deque
from math import prod
from pathlib import Path

from cosim import Scenario, fly
from cosim.base.protocols import Column, Parameter
from cosim.files import new_folder


class Ahead:
    """Predictor that adds what the commands in transport will still do, without the engines' lag."""

    level = "predictor"
    parameters = (Parameter("share", 1.0, "", "of the gain that is believed", 0.0, 2.0),)
    columns = (Column("ahead_rad_s", "rad/s", "body", "rate that is still to come"),)
    shown = (0.0,)

    def prepare(self, belief):
        """Read the identified model of this axis, torque to rate; called once before the flight."""
        model = belief.model
        self.delay = round(model.delay_samples)
        # Rate that a unit command adds per step: G(1) without the pole near 1, which integrates.
        _, *faster = sorted(model.poles, reverse=True)
        gained = model.gain * prod(1.0 - zero for zero in model.zeros) / prod(1.0 - pole for pole in faster)
        self.gain = belief.parameters["share"] * gained

    def reset(self):
        """Return to rest."""
        self.under_way = deque([0.0] * self.delay, maxlen=self.delay)

    def update(self, measured, applied):
        """Return the predicted rate [rad/s] from the measured one and the command applied in the step before."""
        self.under_way.append(applied)
        self.shown = (self.gain * sum(self.under_way),)
        return measured + self.shown[0]


# %% Fly it: by its class, with another value of its parameter, and beside ours
def main() -> None:
    doublet = Scenario.load("roll-doublet").replace(duration_s=6.0, expect=[])
    half = doublet.replace(controller=f"{__file__}:Ahead", controller_parameters={"share": 0.5})
    folder = new_folder(Path("runs"), "own-controller")
    for name, run in (
        ("Ahead", fly(doublet, folder, controller=Ahead)),
        ("Ahead, half believed", fly(half)),
        ("smith", fly(doublet, controller="smith")),
        ("baseline", fly(doublet, controller="baseline")),
    ):
        roll = run.metrics["roll"]
        error, swing = roll.max_abs_error_rad, roll.oscillation_rad
        print(f"{name:21} {run.outcome}, greatest roll error {error:.3f} rad, at the end swinging by {swing:.3f} rad")
    print(f"{folder} has the controller's file and hash: hexjet fly {folder / 'scenario.toml'} flies it again")


if __name__ == "__main__":
    main()
