"""Air state at an engine's intake, in the quantities that engine decks use."""

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

    def derive(self) -> dict[str, float]:
        """Return the derived quantities :data:`DERIVED` in SI units, computed as the C loop does.

        ``altitude`` is the geopotential pressure altitude of ISO 2533, which engine decks mean; density that of dry
        air as an ideal gas; total values isentropic, with a ratio of specific heats of 1.4.
        """
        temperature_ratio = (self.pressure / PRESSURE_0) ** (GAS * LAPSE / GRAVITY)
        altitude = TEMPERATURE_0 / LAPSE * (1.0 - temperature_ratio)
        if altitude > TROPOPAUSE:
            tropopause_pressure = (STRATOSPHERE / TEMPERATURE_0) ** (GRAVITY / (GAS * LAPSE)) * PRESSURE_0
            altitude = TROPOPAUSE + GAS * STRATOSPHERE / GRAVITY * log(tropopause_pressure / self.pressure)
        mach = self.speed / sqrt(GAMMA * GAS * self.temperature)
        ram = 1.0 + 0.5 * (GAMMA - 1.0) * mach * mach
        density = self.pressure / (GAS * self.temperature)
        total = self.pressure * ram ** (GAMMA / (GAMMA - 1.0))
        return dict(zip(DERIVED, (altitude, mach, density, total, self.temperature * ram), strict=True))


STANDARD_AIR = Air(101325.0, 288.15, 0.0)  # the standard atmosphere's at sea level, at rest
