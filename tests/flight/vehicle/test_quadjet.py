"""aircraft/quadjet: its README's sums and margins, and the loss of an engine, which it survives from high enough."""

from __future__ import annotations

from math import degrees

import numpy as np
import pytest
from places import ROOT

from cosim.flight import fly
from cosim.results.log.digest import log_digest
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

VEHICLE, _ = load_vehicle("quadjet")
PAGE = " ".join((ROOT / "aircraft" / "quadjet" / "README.md").read_text(encoding="utf-8").split())
ENGINE_KG, STEP_S = 1.08, 0.004


def margin(p: float, i: float) -> float:
    """Phase margin [deg] of the rate loop, in closed form over a grid."""
    w = np.logspace(-1.0, 2.0, 20000)
    s = 1j * w
    lag, gyro = VEHICLE.hinges[0].lag_s, VEHICLE.sensors.gyro.filter_s
    loop = (p + i / s) / s * np.exp(-2.0 * STEP_S * s) / ((1.0 + lag * s) * (1.0 + gyro * s))
    at = int(np.argmin(np.abs(np.log(np.abs(loop)))))
    return 180.0 + degrees(np.angle(loop[at]))


def test_without_an_engine_it_is_caught_by_its_nozzles() -> None:
    """It was lost within two seconds: late engines that were asked for attitude pumped the swing."""
    fault = [{"kind": "flame_out", "start_s": 1.0, "jet": 1}]
    high = {"altitude_m": 30.0}
    hover = Scenario.load("quadjet-hover").replace(fault=fault, expect=[], duration_s=5.0, initial=high)
    run = fly(hover)
    assert run.outcome == "completed"
    log = run.log
    fallen = 30.0 - float(log["altitude_m"].min())
    lean = degrees(max(float(np.abs(log[f"{axis}_rad"]).max()) for axis in ("roll", "pitch")))
    assert f"it falls {fallen:.1f} m before its scripted hover climbs back, and leans by up to {lean:.0f}°" in PAGE
    # by the nozzles and not by luck
    off = {"control": {"monitor": {"catch": False}}}
    assert fly(hover.replace(vehicle=off)).outcome == "diverged"


def test_engines_answer_as_before_until_one_is_lost() -> None:
    """The catch is of the loss alone: with all engines the flight is the same to the last bit."""
    hover = Scenario.load("quadjet-hover").replace(expect=[], duration_s=1.0)
    off = hover.replace(vehicle={"control": {"monitor": {"catch": False}}})
    assert log_digest(fly(hover).log) == log_digest(fly(off).log)


@pytest.mark.long
def test_the_figures_of_its_verdict() -> None:
    """Long."""
    turned = {}
    for name in ("quadjet", "octojet"):
        run = fly(Scenario.load(f"{name}-roll-doublet").replace(expect=[]))
        turned[name] = run.metrics["roll"].settling_time_s
    assert f"settles in {turned['quadjet']:.2f} s" in PAGE
    assert f"needs {turned['octojet']:.1f} s for roll" in PAGE
    held = fly(Scenario.load("quadjet-hover-in-wind").replace(expect=[])).summary.flat_metrics
    assert f"8 m/s of wind within {held['position.max_abs_error_m']:.1f} m" in PAGE
