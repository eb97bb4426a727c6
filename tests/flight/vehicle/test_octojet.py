"""aircraft/octojet: its README's sums, its design, and one engine out at every station."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from places import ROOT

from cosim.base.constants import GRAVITY
from cosim.flight import fly
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

VEHICLE, FOLDER = load_vehicle("octojet")
PAGE = " ".join((ROOT / "aircraft" / "octojet" / "README.md").read_text(encoding="utf-8").split())
ENGINE_KG = 1.08


def test_the_sums_of_its_readme() -> None:
    assert VEHICLE.mass_kg == pytest.approx(8 * 100.0 / 9.80665 * 5.525 / 12.0, abs=0.005)
    fuel = VEHICLE.fuel
    assert fuel is not None
    plate = VEHICLE.mass_kg - 8 * ENGINE_KG - fuel.mass_kg
    x, y, z = np.array([jet.position_m for jet in VEHICLE.jets]).T
    box, flat = fuel.mass_kg / 12.0 * (0.4**2 + 0.15**2), plate / 12.0
    parts = [
        flat + box + ENGINE_KG * np.sum(y * y + z * z),
        flat + box + ENGINE_KG * np.sum(x * x + z * z),
        2.0 * flat + fuel.mass_kg / 12.0 * 2.0 * 0.4**2 + ENGINE_KG * np.sum(x * x + y * y),
    ]
    assert VEHICLE.inertia_kg_m2 == pytest.approx(parts, rel=0.015)  # rounded there
    begins = VEHICLE.mass_kg * GRAVITY / 8 * 0.25 / VEHICLE.inertia_kg_m2[0]
    six, _ = load_vehicle("hexjet-100")
    theirs = six.mass_kg * GRAVITY / 6 * six.jets[0].position_m[1] / six.inertia_kg_m2[0]
    assert f"Roll begins at {begins:.1f} rad/s²" in PAGE
    assert f"it is {theirs:.0f} rad/s²" in PAGE


def test_its_gains_are_what_the_design_wrote() -> None:
    design = tomllib.loads((FOLDER / "design.toml").read_text(encoding="utf-8"))
    assert design["design"]["aircraft"] == "octojet"
    stated = tomllib.loads((FOLDER / "vehicle.toml").read_text(encoding="utf-8"))
    same(design["vehicle"], stated, "")


def same(wanted: object, stated: object, where: str) -> None:
    """Every number of the design is the vehicle's; that an axis has no lead is said by leaving it out."""
    if isinstance(wanted, dict):
        assert isinstance(stated, dict), where
        for key, value in wanted.items():
            if value is False and where.endswith(".lead"):
                assert key not in stated
            else:
                same(value, stated[key], f"{where}.{key}")
    else:
        assert wanted == stated, where


def lost(jet: int, shut_opposite: bool) -> tuple[str, float, float, float]:
    """How a flight without that engine ends: outcome, most lean [deg], most error of height [m], found after [s]."""
    scenario = Scenario.load("octojet-flame-out-corner")
    fault = [{"kind": "flame_out", "start_s": 1.0, "jet": jet}]
    monitor = {"control": {"monitor": {"shut_opposite": shut_opposite}}}
    run = fly(scenario.replace(expect=[], duration_s=8.0, fault=fault, vehicle=monitor))
    log, begin = run.log, round(1.0 / scenario.step_s)
    lean = np.degrees(np.hypot(log["roll_rad"], log["pitch_rad"]))
    found = np.flatnonzero(log[f"health_{jet}"][begin:] < 1.0)[0] * scenario.step_s
    return run.outcome, float(lean.max()), float(np.abs(log["altitude_m"] - 30.0).max()), float(found)


@pytest.mark.long
@pytest.mark.parametrize("jet", range(1, 9))
def test_it_stays_up_without_any_one(jet: int) -> None:
    """As the README's verdict says: found within 40 ms, leaned by less than 5°, 1.5 m of height."""
    outcome, lean, height, found = lost(jet, True)
    assert outcome == "completed"
    assert lean < 5.0
    assert height < 1.5
    assert found <= 0.04


@pytest.mark.long
def test_on_seven_engines_alone_it_is_lost_at_six_stations() -> None:
    assert [lost(jet, False)[0] for jet in range(1, 9)].count("completed") == 2
    assert "it is lost at six of the eight stations" in PAGE
