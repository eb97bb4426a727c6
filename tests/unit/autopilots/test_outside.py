"""A rate loop of ours around an autopilot: what is heard is what was asked for, what flies is what the controller says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_tools import Hexjet

from cosim.autopilots.lockstep import ActuatorOutputs
from cosim.autopilots.run import make_external_rate_loop
from cosim.base.protocols import EngineState
from cosim.base.signals import ZERO3, Command, Disturbance, Measured, Vector3
from cosim.control.allocation.reallocation import command_to_torque
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario

GAIN: Vector3 = (0.02, 0.05, 0.03)  # throttle and rad (or throttle) per rad/s
DOUBLET = Scenario.load("roll-doublet").replace(expect=[], controller="smith")
FLOWN = {
    "hexjet": DOUBLET,
    "hexjet-p220": Scenario.load("full-scale-roll-doublet").replace(expect=[], controller="smith"),
    "a law": DOUBLET.replace(controller="optimal"),
    "quadrotor": DOUBLET.replace(aircraft="quadrotor", engine="motor", step_s=0.0025),
}


@pytest.mark.parametrize("has_gyro", [False, True])
@pytest.mark.parametrize("name", FLOWN)
def test_what_an_autopilot_asks_for_reaches_the_controller(name: str, has_gyro: bool) -> None:
    """By mixing of the test's own: P of a set-point on banks and tilts, or on rotors; within what the curves' table is
    coarse, which is a part of a step of 12 bits."""
    scenario = FLOWN[name]
    vehicle, _ = scenario.resolved_vehicle()
    rates = make_external_rate_loop(scenario, GAIN, has_gyro)
    draw = np.random.default_rng(3)
    assert rates.select_gyro((0.1, 0.2, 0.3)) == ((0.1, 0.2, 0.3) if has_gyro else ZERO3)
    with build(scenario) as simulation:
        cascade, jets = simulation.cascade, len(vehicle.jets)
        cascade.reset(False, 0.0)
        for _ in range(100):
            asked = 0.3 * draw.standard_normal(3)
            rate: Vector3 = tuple(map(float, 0.1 * draw.standard_normal(3)))  # type: ignore[assignment]
            share = float(draw.uniform(0.4, 0.7))
            mean = cascade.thrust_map.throttle((share,) * jets)[0]
            roll, pitch, yaw = (asked - np.array(rates.select_gyro(rate))) * GAIN
            if vehicle.servo is None:
                throttle = tuple(
                    mean - np.sign(jet.position_m[1]) * roll + np.sign(jet.position_m[0]) * pitch
                    + np.sign(jet.reaction_m) * yaw for jet in vehicle.jets
                )  # fmt: skip
                tilt = (0.0, 0.0)
            else:
                throttle = tuple(mean + (roll if jet.servo == "left" else -roll) for jet in vehicle.jets)
                forward = -1.0 if sum(jet.position_m[2] for jet in vehicle.jets) < 0.0 else 1.0
                tilt = (forward * pitch + yaw, forward * pitch - yaw)
            measured = Measured(rate, (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, 0.0)
            found = rates.compute_outputs(ActuatorOutputs(throttle, tilt, True), measured)
            wanted = cascade.update(
                Command(ZERO3, 0.0, tuple(map(float, asked)), share),  # type: ignore[arg-type]
                measured,
                Disturbance(),
                EngineState.FLY,
            )
            assert found.throttle == pytest.approx(wanted.throttle, abs=2e-5)
            assert found.tilt == pytest.approx(wanted.tilt, abs=2e-5)


def test_disarmed_its_answer_is_left_as_it_is() -> None:
    still = Measured(ZERO3, (1.0, 0.0, 0.0, 0.0), ZERO3, ZERO3, 0.0)
    asked = ActuatorOutputs((0.0,) * 6, (0.0, 0.0), False)
    assert make_external_rate_loop(DOUBLET, GAIN).compute_outputs(asked, still) is asked


def test_the_inverse_gives_back_what_the_allocation_was_told() -> None:
    class Banks:
        left, pitch_sign = (True, True, False, False), -1.0

    wanted = [[0.25, 0.25, -0.25, -0.25, 0.0, 0.0], [0.0] * 4 + [-0.5, -0.5], [0.0] * 4 + [0.5, -0.5]]
    assert command_to_torque(4, Banks()) == wanted


LEAN = """class Lean:
    level = "attitude"

    def reset(self):
        pass

    def update(self, command, measured):
        return (0.0, 0.0, 0.0)
"""


def test_a_controller_without_a_rate_loop_of_ours_is_refused(hexjet: Hexjet, tmp_path: Path) -> None:
    (tmp_path / "lean.py").write_text(LEAN)
    for given, said in (
        (
            ["betaflight", "--rates", f"{tmp_path}/lean.py:Lean", "--trust"],
            "is of level attitude; allowed are built-in",
        ),
        (["betaflight", "--rates", "nobody"], "nobody"),
        (["betaflight", "--rates", "baseline", "--aircraft", "trijet"], "torques are not those of banks or rotors"),
        (["px4", "--rates", "nobody"], "nobody"),
        (["px4", "--rates", "baseline", "--aircraft", "trijet"], "flown by effectiveness"),
        (["ardupilot", "--rates", "smith"], "--rates"),
    ):
        done = hexjet("sitl", *given, "--binary", "/bin/true")
        assert (done.status, said in done.err, "Traceback" in done.err) == (2, True, False), done.err
