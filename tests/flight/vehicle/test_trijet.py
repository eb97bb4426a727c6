"""aircraft/trijet: its hover, the air its fan swallows, and the loss of an engine."""

from __future__ import annotations

from math import atan2, cos, pi, sqrt

import numpy as np
import pytest
from loads import acted

from cosim import fly
from cosim.base.constants import GRAVITY
from cosim.base.signals import ZERO3
from cosim.control.allocation.effectiveness import EffectivenessAllocator
from cosim.identify.sweep import identify_axis
from cosim.simulation.axis_chain import compute_axis_fractions
from cosim.simulation.build import build
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.effects.intakes import IntakeDrag

VEHICLE, _ = load_vehicle("trijet")
TURBOJET_N, FAN_N = 24.0, 9.80665 * 0.2554 / (1.0 - 0.8748)


def test_the_air_that_its_engines_swallow() -> None:
    fan, jet = VEHICLE.jets[2].airflow, VEHICLE.airflow
    assert fan is not None
    assert jet is not None
    assert fan.kg_s == pytest.approx(sqrt(1.225 * pi / 4.0 * (0.07**2 - 0.03**2) * 20.0), abs=0.001)
    # turbine.c: flow = n (1 - droop (1 - n)) of the full one, at three of its speeds and thrusts
    for newton, rpm in ((6.57, 176464.0), (11.97, 207861.0), (17.65, 228830.0)):
        n = rpm / 245000.0
        own = np.log(n * (1.0 - 0.666979 * (1.0 - n))) / np.log(newton / 24.0)
        assert own == pytest.approx(jet.exponent, rel=0.1)
    assert round(fan.kg_s / jet.kg_s) == 5


def test_each_kind_of_engine_swallows_its_own_air() -> None:
    """Upright and still in 8 m/s from the left: m v across, each at its own flow and intake."""
    fan, jet = VEHICLE.jets[2].airflow, VEHICLE.airflow
    assert fan is not None
    assert jet is not None
    thrust = (12.0, 0.0, 9.0)
    pushes = [8.0 * jet.kg_s * 0.5**jet.exponent, 0.0, 8.0 * fan.kg_s * 0.45**fan.exponent]
    drag = IntakeDrag(jet, VEHICLE.jets, VEHICLE.hinges)
    forces, moment = acted(drag, [ZERO3] * 3, (0.0,) * 4, thrust, wind=(0.0, 8.0, 0.0))
    assert [y for _, y, _ in forces] == pytest.approx(pushes, rel=1e-12)
    assert moment == pytest.approx((jet.intake_m * pushes[0] + fan.intake_m * pushes[2], 0.0, 0.0), rel=1e-12)
    alone = IntakeDrag(None, VEHICLE.jets, VEHICLE.hinges)  # the fan states its own
    forces, _ = acted(alone, [ZERO3] * 3, (0.0,) * 4, thrust, wind=(0.0, 8.0, 0.0))
    assert alone.is_active
    assert [y for _, y, _ in forces] == pytest.approx([0.0, 0.0, pushes[2]], rel=1e-12)


def test_it_hovers_with_its_hinges_at_rest_and_all_engines_at_the_same_share() -> None:
    allocator = build(Scenario.load("trijet-hover")).controller.allocator
    assert isinstance(allocator, EffectivenessAllocator)
    found, missing = allocator.solve_hover((0.0, 0.0, 0.0))
    assert found[3:] == pytest.approx([0.0] * 4, abs=1e-9)
    assert missing == pytest.approx([0.0] * 6, abs=1e-9)
    assert found[0] / TURBOJET_N == pytest.approx(found[2] / FAN_N, rel=0.001)
    assert sum(found[:3]) == pytest.approx(VEHICLE.mass_kg * GRAVITY, rel=1e-9)
    shares = [round(100.0 * sum(compute_axis_fractions(VEHICLE, allocator, axis).thrusts)) for axis in range(3)]
    assert shares == [4, 11, 0]


def test_nothing_balances_it_without_an_engine() -> None:
    """In closed form: where the thrusts that are left would have to point, and where they can."""
    x, y, z = VEHICLE.jets[1].position_m
    low = VEHICLE.hinges[0].position_m[2]
    tilt, vane = (VEHICLE.hinges[k].angle_limits[1] for k in (0, 2))
    needed = atan2(y * cos(tilt), low + (z - low) * cos(tilt))  # it falls with the tilt
    assert needed < atan2(y, z)
    assert needed > vane
    assert FAN_N / (VEHICLE.mass_kg * GRAVITY) == pytest.approx(0.64, abs=0.005)
    both = atan2(-x, low)  # a tilted turbojet pushes along a line through the axis of its hinge
    assert both > tilt


@pytest.mark.parametrize("jet", [1, 3])
def test_without_an_engine_it_is_lost(jet: int) -> None:
    fault = [{"kind": "flame_out", "start_s": 0.5, "jet": jet}]
    run = fly(Scenario.load("trijet-hover").replace(fault=fault, expect=[], duration_s=3.0))
    assert run.outcome in ("diverged", "crashed")
    assert run.log["time_s"][-1] < 0.5 + 0.5


def test_an_axis_on_hinges_is_identified_in_angular_acceleration() -> None:
    """Yaw is allocated to the tilt alone: 1 / s behind the servo's lag and the gyro's filter, and nothing else.

    To 10 % and 10 deg, a quarter of what the lags do to the phase at the sweep's end.
    """
    found = identify_axis("yaw", "trijet", from_hz=1.6, to_hz=4.0, duration=10.0, amplitude=0.3)
    assert (found.command_unit, len(found.response.hertz) > 3) == ("rad/s^2", True)
    s = 2j * np.pi * found.response.hertz
    exact = 1.0 / (s * (1.0 + VEHICLE.hinges[0].lag_s * s) * (1.0 + VEHICLE.sensors.gyro.filter_s * s))
    ratio = found.response.value / exact
    assert np.abs(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.degrees(np.angle(ratio)) == pytest.approx(0.0, abs=10.0)
