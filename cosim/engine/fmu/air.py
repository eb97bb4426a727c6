"""The air around an engine, in the words of engine decks."""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple

from cosim.base.constants import GRAVITY

DERIVED = ("altitude", "mach", "density", "total_pressure", "total_temperature")  # of pressure, temperature, speed

# Dry air and the standard atmosphere: ISO 2533:1975.
GAMMA = 1.4
GAS = 287.05287  # J/(kg K)
PRESSURE_0, TEMPERATURE_0, LAPSE = 101325.0, 288.15, 0.0065  # Pa, K, K/m
TROPOPAUSE, STRATOSPHERE = 11000.0, 216.65  # m, K


class Air(NamedTuple):
    """The air around one engine."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    speed: float  # m/s, into the intake

    def derived(self) -> dict[str, float]:
        """The same air in other words, as the C loop computes them: :data:`DERIVED`, SI units.

        ``altitude`` is the geopotential pressure altitude of ISO 2533, which engine decks mean; density that of dry
        air as an ideal gas; total values isentropic, with a ratio of specific heats of 1.4.
        """
        share = (self.pressure / PRESSURE_0) ** (GAS * LAPSE / GRAVITY)
        altitude = TEMPERATURE_0 / LAPSE * (1.0 - share)
        if altitude > TROPOPAUSE:
            there = (STRATOSPHERE / TEMPERATURE_0) ** (GRAVITY / (GAS * LAPSE)) * PRESSURE_0
            altitude = TROPOPAUSE + GAS * STRATOSPHERE / GRAVITY * log(there / self.pressure)
        mach = self.speed / sqrt(GAMMA * GAS * self.temperature)
        ram = 1.0 + 0.5 * (GAMMA - 1.0) * mach * mach
        density = self.pressure / (GAS * self.temperature)
        total = self.pressure * ram ** (GAMMA / (GAMMA - 1.0))
        return dict(zip(DERIVED, (altitude, mach, density, total, self.temperature * ram), strict=True))


STANDARD_AIR = Air(101325.0, 288.15, 0.0)  # the standard atmosphere's at sea level, at rest
