"""What JSBSim by itself does when a part of a body comes off: ``python -m benchmarks.accuracy.bare_jsbsim``.

Nothing of ours but a model file: ``body.xml``, 1 kg with 1 kg more fixed to it, 10 N on it, no air.
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("JSBSIM_DEBUG", "0")  # else JSBSim prints a banner

import jsbsim
import numpy as np

RUN_S, RUNS = 0.001, 100  # length of a run, runs on either side
POUND, FOOT, INCH = 4.4482216, 0.3048, 0.0254
RECTANGULAR, ADAMS_BASHFORTH_2 = 1, 3
LOAD = "inertia/pointmass-weight-lbs"


def start(position: tuple[float, float, float], rate: float, method: int, newtons: float) -> jsbsim.FGFDMExec:
    """Return JSBSim with the part on board at ``position`` [m, structural], turning about z at ``rate`` [rad/s]."""
    fdm = jsbsim.FGFDMExec(str(Path(__file__).parent), None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(".")
    fdm.load_model("body", add_model_to_path=False)
    fdm.set_dt(RUN_S)
    for kind in ("rotational", "translational"):
        fdm[f"simulation/integrator/rate/{kind}"] = method
    fdm["ic/h-sl-ft"], fdm["ic/r-rad_sec"] = 1000.0, rate
    fdm[LOAD] = 1.0 / 0.45359237
    for axis, metres in zip("XYZ", position, strict=True):
        fdm[f"inertia/pointmass-location-{axis}-inches"] = metres / INCH
    fdm["external_reactions/jet1/magnitude"] = newtons / POUND
    fdm.run_ic()
    for _ in range(RUNS):
        fdm.run()
    return fdm


def velocity_late(method: int, anew: bool = False) -> float:
    """Return how many runs the acceleration of the lighter body is late, from its velocity.

    ``anew``: accelerations are evaluated with the new mass, integration suspended, and taken alone by the first run.
    """
    ends = []
    for newtons in (10.0, 0.0):  # the difference leaves out gravity
        fdm = start((0.0, 0.0, 0.0), 0.0, method, newtons)
        before = fdm["velocities/v-down-fps"]
        fdm[LOAD] = 0.0
        if anew:
            fdm.suspend_integration()
            fdm.run()
            fdm.resume_integration()
            fdm["simulation/integrator/rate/translational"] = RECTANGULAR
            fdm.run()
            fdm["simulation/integrator/rate/translational"] = method
        for _ in range(RUNS - anew):
            fdm.run()
        ends.append((fdm["velocities/v-down-fps"] - before) * FOOT)
    heavy, light = -10.0 / 2.0, -10.0 / 1.0
    return round((light * RUNS * RUN_S - (ends[0] - ends[1])) / ((light - heavy) * RUN_S), 3) + 0.0


def origin(fdm: jsbsim.FGFDMExec) -> np.ndarray:
    """Return the Earth-fixed position [m] of the structural frame's origin."""
    x, y, z = np.asarray(fdm.get_mass_balance().get_xyz_cg()).ravel() * INCH
    centre = np.array([fdm[f"position/ecef-{axis}-ft"] for axis in "xyz"]) * FOOT
    to_earth = np.asarray(fdm.get_propagate().get_Tec2b()).T
    return np.array(centre + to_earth @ np.array([x, -y, z]))


def structure_jumps(position: tuple[float, float, float], rate: float) -> tuple[float, float]:
    """Return the jumps of the structure's position [m] and velocity [m/s] in the run in which the part comes off."""
    fdm = start(position, rate, ADAMS_BASHFORTH_2, 0.0)
    origins = [origin(fdm)]
    for k in range(4):
        if k == 2:
            fdm[LOAD] = 0.0
        fdm.run()
        origins.append(origin(fdm))
    moved = np.diff(origins, axis=0)
    change = moved[1] - moved[0]  # a run's own, by gravity and turning
    position_jump, velocity_jump = moved[2] - moved[1] - change, moved[3] - moved[1] - 2.0 * change
    return float(np.linalg.norm(position_jump)), float(np.linalg.norm(velocity_jump)) / RUN_S


def measure() -> list[list[str]]:
    """Return the rows of the table in docs/accuracy.md: each quantity and its measured value."""
    position, velocity = structure_jumps((0.2, 0.0, 0.0), 3.0)
    return [
        ["a new mass is late by, rectangular rule", f"{velocity_late(RECTANGULAR):.3f} runs"],
        ["a new mass is late by, Adams-Bashforth 2", f"{velocity_late(ADAMS_BASHFORTH_2):.3f} runs"],
        ["the same, evaluated before its run", f"{velocity_late(ADAMS_BASHFORTH_2, anew=True):.3f} runs"],
        ["the structure jumps, as the centre of gravity moves by 100 mm, by", f"{1e3 * position:.1f} mm"],
        ["its velocity jumps, at 3 rad/s, by", f"{1e3 * velocity:.1f} mm/s"],
    ]


if __name__ == "__main__":
    for quantity, measured in measure():
        print(f"{quantity} {measured}")
