"""aircraft/quadjet: its README's sums and margins, and the loss of an engine, which it does not survive."""

from __future__ import annotations

from math import degrees

import numpy as np
import pytest
from places import ROOT

from cosim.flight import fly
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

VEHICLE, _ = load_vehicle("quadjet")
PAGE = " ".join((ROOT / "aircraft" / "quadjet" / "README.md").read_text(encoding="utf-8").split())
ENGINE_KG, STEP_S = 1.08, 0.004


def test_the_sums_of_its_readme() -> None:
    assert VEHICLE.mass_kg == pytest.approx(4 * 100.0 / 9.80665 * 5.525 / 12.0, abs=0.005)
    fuel = VEHICLE.fuel
    assert fuel is not None
    flat = (VEHICLE.mass_kg - 4 * ENGINE_KG - fuel.mass_kg) * 0.8**2 / 12.0
    box, points = fuel.mass_kg / 6.0 * 0.3**2, 4 * ENGINE_KG * 0.2**2
    across, up = flat + box + points, 2.0 * flat + box + 2.0 * points
    assert VEHICLE.inertia_kg_m2 == pytest.approx((across, across, up), rel=0.05)


def margin(p: float, i: float) -> float:
    """Phase margin [deg] of the rate loop, in closed form over a grid."""
    w = np.logspace(-1.0, 2.0, 20000)
    s = 1j * w
    lag, gyro = VEHICLE.hinges[0].lag_s, VEHICLE.sensors.gyro.filter_s
    loop = (p + i / s) / s * np.exp(-2.0 * STEP_S * s) / ((1.0 + lag * s) * (1.0 + gyro * s))
    at = int(np.argmin(np.abs(np.log(np.abs(loop)))))
    return 180.0 + degrees(np.angle(loop[at]))


def test_the_margins_of_its_readme() -> None:
    rate = VEHICLE.control.rate
    assert f"have a phase margin of {margin(rate.roll.p, rate.roll.i):.0f}°" in PAGE
    assert f"that of yaw {margin(rate.yaw.p, rate.yaw.i):.0f}°" in PAGE
    assert (rate.roll.p, rate.roll.i) == (rate.pitch.p, rate.pitch.i)


def test_without_an_engine_it_is_lost() -> None:
    fault = [{"kind": "flame_out", "start_s": 1.0, "jet": 1}]
    run = fly(Scenario.load("quadjet-hover").replace(fault=fault, expect=[]))
    assert run.outcome in ("diverged", "crashed")
    assert run.log["time_s"][-1] < 1.0 + 2.0
    assert "It does not survive the loss of an engine." in PAGE


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
