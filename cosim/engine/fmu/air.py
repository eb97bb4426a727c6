"""Air state at an engine's intake, in the quantities that engine decks use."""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple

from cosim.base.constants import GRAVITY

DERIVED = ("altitude", "mach", "density", "total_pressure", "total_temperature")  # computed from the fields of Air

# Dry air in the standard atmosphere, ISO 2533:1975: Pa, K, K/m at sea level.
PRESSURE_0, TEMPERATURE_0, LAPSE = 101325.0, 288.15, 0.0065  # Pa, K, K/m
TROPOPAUSE, STRATOSPHERE = 11000.0, 216.65  # m, and K above it


class Air(NamedTuple):
    """The air around one engine."""

    pressure: float  # Pa, static
    temperature: float  # K, static
    speed: float  # m/s, into the intake

    def derive(self, gamma: float = 1.4, gas_constant: float = 287.05287) -> dict[str, float]:
        """Return the quantities :data:`DERIVED` by name in SI units, computed as the C loop does.

        ``altitude`` is the geopotential pressure altitude of ISO 2533, which engine decks mean; density that of dry air
        as an ideal gas; total values isentropic, with a ratio of specific heats of 1.4.  ``gamma``: ratio of specific
        heats.  ``gas_constant``: J/(kg K).
        """
        temperature_ratio = (self.pressure / PRESSURE_0) ** (gas_constant * LAPSE / GRAVITY)
        altitude = TEMPERATURE_0 / LAPSE * (1.0 - temperature_ratio)
        if altitude > TROPOPAUSE:
            tropopause_pressure = (STRATOSPHERE / TEMPERATURE_0) ** (GRAVITY / (gas_constant * LAPSE)) * PRESSURE_0
            altitude = TROPOPAUSE + gas_constant * STRATOSPHERE / GRAVITY * log(tropopause_pressure / self.pressure)
        mach = self.speed / sqrt(gamma * gas_constant * self.temperature)
        ram = 1.0 + 0.5 * (gamma - 1.0) * mach * mach
        density = self.pressure / (gas_constant * self.temperature)
        total = self.pressure * ram ** (gamma / (gamma - 1.0))
        return dict(zip(DERIVED, (altitude, mach, density, total, self.temperature * ram), strict=True))


STANDARD_AIR = Air(101325.0, 288.15, 0.0)  # at sea level, at rest (ISO 2533)
