"""The standard atmosphere, against the standard's own tables and against JSBSim."""

from __future__ import annotations

from contextlib import closing

import pytest

from cosim.base.signals import ZERO3
from cosim.spec.scenario import Environment, Initial
from cosim.spec.vehicle import load_vehicle
from cosim.vehicle.airframe import Airframe
from cosim.vehicle.atmosphere import standard_air

EARTH_RADIUS = 6356766.0  # m, of the standard


# U.S. Standard Atmosphere, 1976, table I: geopotential height [m], temperature [K], pressure [Pa]
@pytest.mark.parametrize(
    ("geopotential", "temperature", "pressure"),
    [
        (0.0, 288.15, 101325.0),
        (5000.0, 255.65, 54019.9),
        (11000.0, 216.65, 22632.0),
        (15000.0, 216.65, 12044.5),
        (20000.0, 216.65, 5474.88),
        (25000.0, 221.65, 2511.02),
    ],
)
def test_the_standards_table(geopotential: float, temperature: float, pressure: float) -> None:
    """To its printed digits and to what JSBSim's sea level and molar mass differ by: at most 2e-5."""
    height = EARTH_RADIUS * geopotential / (EARTH_RADIUS - geopotential)
    assert standard_air(height) == pytest.approx((pressure, temperature), rel=2e-5)


@pytest.mark.parametrize("height", [-399.5, 0.5, 1000.0, 2000.0, 5000.0, 15000.0, 22000.0])
def test_it_is_the_air_of_the_airframe(height: float) -> None:
    """On the equator: elsewhere JSBSim's height above its ellipsoid is some millimetres another one."""
    vehicle, folder = load_vehicle("hexjet")
    ground = min(height - 0.5, 5000.0)
    with closing(Airframe(vehicle, folder, Environment(latitude_deg=0.0, ground_m=ground), 0.004, 4, 1)) as frame:
        frame.reset(Initial(altitude_m=height - ground), [ZERO3] * 6, ZERO3)
        assert standard_air(height) == pytest.approx(frame.air(), rel=1e-6)
