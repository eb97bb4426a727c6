"""aircraft/octojet: its design, and one engine out at every station."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from cosim import fly
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

_, FOLDER = load_vehicle("octojet")


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
    """Found within 40 ms, leaned by less than 5°, 1.5 m of height."""
    outcome, lean, height, found = lost(jet, True)
    assert outcome == "completed"
    assert lean < 5.0
    assert height < 1.5
    assert found <= 0.04


@pytest.mark.long
def test_on_seven_engines_alone_it_is_lost_at_six_stations() -> None:
    assert [lost(jet, False)[0] for jet in range(1, 9)].count("completed") == 2
