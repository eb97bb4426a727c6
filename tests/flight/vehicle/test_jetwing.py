"""aircraft/jetwing: its file of aerodynamics, its README's sums, trim against JSBSim alone, and flights on its wing."""

from __future__ import annotations

import importlib.util
from math import degrees, radians
from typing import Any

import numpy as np
import pytest
from places import ROOT

from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.control.wing import WingTable
from cosim.flight import fly
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle

VEHICLE, FOLDER = load_vehicle("jetwing")
PAGE = " ".join((ROOT / "aircraft" / "jetwing" / "README.md").read_text(encoding="utf-8").split())
POUND_FORCE, FOOT = 4.4482216152605, 0.3048


def generator() -> Any:
    spec = importlib.util.spec_from_file_location("aerodynamics", FOLDER / "aerodynamics.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_model_is_what_its_program_writes() -> None:
    made = generator()
    assert (FOLDER / "jetwing.xml").read_text(encoding="utf-8") == made.document()
    # Helmbold's slope lies between that of a slender wing and that of a section, and stall ends the straight line
    assert np.pi * made.ASPECT / 2.0 > made.WING > 0.5 * 2.0 * np.pi
    lifts = [made.coefficients(radians(a))[0] for a in range(-90, 91)]
    assert 1.0 < max(lifts) < 1.4
    assert made.coefficients(radians(90.0))[0] == pytest.approx(0.0, abs=1e-6)


def test_the_sums_of_its_readme() -> None:
    assert VEHICLE.mass_kg == pytest.approx(4 * 24.0 / GRAVITY * 5.525 / 12.0, abs=0.005)
    rest, up = VEHICLE.mass_kg - 1.4, 1.4 * 0.12 / (VEHICLE.mass_kg - 1.4)
    assert up == pytest.approx(0.054, abs=5e-4)
    x = 0.7 * (0.22**2 + 0.24**2) + 0.7 * 0.22**2 + 0.6 * 1.27**2 / 12.0 + 1.9 * 0.08**2 / 2.0 + rest * up**2
    y = 0.7 * (0.3**2 + 0.24**2) + 0.7 * 0.3**2 + 1.9 * 1.2**2 / 12.0 + rest * up**2
    z = 1.4 * (0.3**2 + 0.22**2) + 0.6 * 1.27**2 / 12.0 + 1.9 * 1.2**2 / 12.0
    assert VEHICLE.inertia_kg_m2 == pytest.approx((x, y, z), rel=0.02)
    assert VEHICLE.products_kg_m2[1] == pytest.approx(0.7 * 0.3 * 0.24, abs=1e-6)


def test_the_law_counts_on_what_the_model_says() -> None:
    simulation = build(Scenario.load("jetwing-transition"))
    wing = simulation.cascade._wing
    assert wing is not None
    made = generator()
    for alpha in (-0.05, 0.0, 0.05, 0.14):
        lift, drag, moment = (value / made.AREA for value in wing._table.at(alpha))
        assert (lift, drag, moment / made.CHORD) == pytest.approx(made.coefficients(alpha), abs=2e-3)
    simulation.close()


def test_the_angle_that_carries() -> None:
    table = WingTable((-0.1, 0.0, 0.2), (-0.1, 0.2, 1.2), (0.0,) * 3, (0.0,) * 3)
    assert table.carrying(0.7) == pytest.approx(0.1)
    assert table.carrying(-5.0) == -0.1
    assert table.carrying(5.0) == 0.2
    assert table.at(table.carrying(0.33))[0] == pytest.approx(0.33)


def test_it_gains_speed_on_its_jets_at_one_height() -> None:
    log = fly(Scenario.load("jetwing-transition").replace(
        initial={"altitude_m": 30.0, "on_ground": False}, duration_s=3.0, expect=[],
        command=[{"kind": "step", "signal": "ahead_m_s", "start_s": 0.0, "amplitude": 25.0}],
    )).log  # fmt: skip
    assert log["velocity_north_m_s"][-1] == pytest.approx(1.5 * 3.0, abs=0.6)
    assert np.abs(log["altitude_m"] - 30.0).max() < 0.3
    assert np.abs(log["roll_rad"]).max() < 0.02


def test_the_figures_of_its_verdict() -> None:
    """Long."""
    log = fly(Scenario.load("jetwing-transition")).log
    t, off = log["time_s"], np.abs(log["altitude_m"] - log["altitude_setpoint_m"])
    assert f"within {off.max():.1f} m of the height" in PAGE
    assert degrees(np.abs(log["yaw_rad"]).max()) < 1.0
    assert log["velocity_north_m_s"].max() == pytest.approx(25.0, abs=0.5)
    assert abs(log["velocity_north_m_s"][-1]) < 0.3
    carried = (t > 40.0) & (t < 48.0)
    assert all((log[f"tilt_{name}_rad"][carried] > 1.2).all() for name in ("front_left", "rear_left"))
    cruise = fly(Scenario.load("jetwing-cruise")).log
    upset, below = cruise["altitude_m"].max() - 60.0, 60.0 - cruise["altitude_m"].min()
    assert f"an upset of {upset:.1f} m it comes back through {below:.1f} m below" in PAGE


def test_without_an_engine_it_turns_and_falls() -> None:
    fault = [{"kind": "flame_out", "start_s": 0.5, "jet": 1}]
    log = fly(Scenario.load("jetwing-hover").replace(fault=fault, expect=[], duration_s=3.0)).log
    assert degrees(np.abs(log["yaw_rad"]).max()) > 90.0
    assert log["altitude_m"][-1] < 12.0
    assert "turns through 90° of heading within 3 s and falls" in PAGE


def test_turbulence_may_meet_a_flight_that_is_under_way() -> None:
    log = fly(Scenario.load("jetwing-cruise").replace(expect=[], duration_s=0.1)).log
    assert np.isfinite(log["altitude_m"]).all()
    assert np.abs(log["wind_down_m_s"]).max() > 0.0


def test_a_vehicle_without_a_wing_says_so() -> None:
    command = [{"kind": "step", "signal": "ahead_m_s", "start_s": 0.0, "amplitude": 5.0}]
    with pytest.raises(InputError, match=r"trijet has no \[control.wing\] to fly ahead with"):
        build(Scenario.load("trijet-hover").replace(command=command))
