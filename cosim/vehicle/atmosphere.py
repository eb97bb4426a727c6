"""The standard atmosphere, for what must be known of the air before there is an airframe to ask."""

from __future__ import annotations

from math import exp

from cosim.base.constants import GRAVITY

# U.S. Standard Atmosphere, 1976 (NOAA-S/T 76-1562), with two numbers of JSBSim's FGStandardAtmosphere (the standard has
# 101325 Pa and 28.9644 kg/kmol), so that an engine is measured in the air in which it will fly.
_MOLAR_MASS = 28.9645  # kg/kmol
_GAS_CONSTANT = 8314.32  # J/(kmol K)
_WEIGHT_OVER_GAS_CONSTANT = GRAVITY * _MOLAR_MASS / _GAS_CONSTANT  # K/m
# Layers: geopotential height [m] at which each begins, temperature [K] there, temperature gradient [K/m].
_LAYERS = ((0.0, 288.15, -0.0065), (11000.0, 216.65, 0.0), (20000.0, 216.65, 0.001))


def standard_density(height: float) -> float:
    """Return the density [kg/m^3] of the standard atmosphere at a geometric height above the sea [m], up to 32 km."""
    pressure, temperature = standard_air(height)
    return pressure * _MOLAR_MASS / (_GAS_CONSTANT * temperature)


def standard_air(height: float) -> tuple[float, float]:
    """Return pressure [Pa] and temperature [K] at a geometric height above the sea [m], up to 32 km."""
    radius = 6356766.0  # m, radius of the Earth
    geopotential = radius * height / (radius + height)
    # JSBSim's 2116.228 lbf/ft^2 at sea level: 101325.5 Pa.
    pressure, temperature = 2116.228 * 4.4482216152605 / 0.3048**2, _LAYERS[0][1]
    for (base, start, lapse), top in zip(_LAYERS, [layer[0] for layer in _LAYERS[1:]] + [32000.0], strict=True):
        height_in_layer = min(geopotential, top) - base
        temperature = start + lapse * height_in_layer
        # Hydrostatics: dp / p = -g M / R dh / T.
        if lapse:
            pressure *= (start / temperature) ** (_WEIGHT_OVER_GAS_CONSTANT / lapse)
        else:
            pressure *= exp(-_WEIGHT_OVER_GAS_CONSTANT * height_in_layer / start)
        if geopotential <= top:
            break
    return pressure, temperature
