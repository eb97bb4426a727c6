"""From a data sheet to the parameters of turbine.c: python engines/size_turbine.py

A data sheet states thrust, fuel flow and exhaust temperature at full speed and at idle.  With the pressure ratio and
the air flow at full speed, and an efficiency of the compressor and a pressure loss of the combustor taken from
experience, these six numbers fix six parameters: nozzle area, turbine efficiency, combustion efficiency at both
speeds, how the air flow droops with the speed, and the windage of the rotor.  turbine-220/README.md has the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

from scipy.optimize import brentq

R = 287.0  # J/(kg K)
CP_AIR, CP_GAS = 3.5 * R, 4.0 * R  # gamma 7/5 and 4/3
P0, T0 = 101325.0, 288.15  # Pa, K: standard day
T_REF = 298.15  # K, where the heating value is stated
HEATING_VALUE = 43.1e6  # J/kg, Jet A-1
RPM = pi / 30.0


@dataclass(frozen=True)
class Sheet:
    """What a data sheet says, SI but for the speeds, and what it does not say (the last two)."""

    speed: float  # rpm
    thrust: float
    fuel: float
    egt: float
    air: float
    pressure_ratio: float
    idle_speed: float
    idle_thrust: float
    idle_fuel: float
    idle_egt: float
    compressor_efficiency: float
    pressure_loss: float


SHEETS = {
    "turbine-20": Sheet(245e3, 24.0, 0.075 / 60, 993.15, 0.055, 2.8, 60e3, 0.3, 0.012 / 60, 763.15, 0.70, 0.05),
    "turbine-100": Sheet(154e3, 100.0, 0.312 / 60, 993.15, 0.23, 2.9, 44e3, 2.0, 0.064 / 60, 763.15, 0.74, 0.05),
    "turbine-220": Sheet(117e3, 220.0, 0.580 / 60, 993.15, 0.45, 3.8, 35e3, 9.0, 0.104 / 60, 763.15, 0.76, 0.05),
}


def _turbine(sheet: Sheet, windage: float) -> dict[str, float]:
    """The parameters for a windage power [W] at full speed; "idle_windage" is what idle then leaves for it."""
    gas = sheet.air + sheet.fuel
    jet = sheet.thrust / gas
    T8 = sheet.egt - jet**2 / (2.0 * CP_GAS)
    area = gas * R * T8 / (P0 * jet)
    rise = (sheet.pressure_ratio ** (2.0 / 7.0) - 1.0) / sheet.compressor_efficiency
    power = sheet.air * CP_AIR * T0 * rise + windage
    T4 = sheet.egt + power / (gas * CP_GAS)
    p4, p5 = sheet.pressure_ratio * (1.0 - sheet.pressure_loss), (sheet.egt / T8) ** 4  # over ambient
    efficiency = (1.0 - sheet.egt / T4) / (1.0 - (p5 / p4) ** 0.25)

    def burnt(air: float, fuel: float, T3: float, T4: float) -> float:
        heat = (air + fuel) * CP_GAS * (T4 - T_REF) - air * CP_AIR * (T3 - T_REF)
        return heat / (fuel * HEATING_VALUE)

    n = sheet.idle_speed / sheet.speed
    q = sheet.idle_thrust * R / (P0 * area)
    idle_jet = sqrt(q * sheet.idle_egt / (1.0 + q / (2.0 * CP_GAS)))
    idle_gas = sheet.idle_thrust / idle_jet
    idle_air = idle_gas - sheet.idle_fuel
    flow = idle_air / sheet.air
    idle_T8 = sheet.idle_egt - idle_jet**2 / (2.0 * CP_GAS)
    idle_p5 = (sheet.idle_egt / idle_T8) ** 4
    idle_p4 = (1.0 + sheet.compressor_efficiency * rise * n**2) ** 3.5 * (1.0 - sheet.pressure_loss * flow**2)
    idle_T4 = sheet.idle_egt / (1.0 - efficiency * (1.0 - (idle_p5 / idle_p4) ** 0.25))
    left = idle_gas * CP_GAS * (idle_T4 - sheet.idle_egt) - idle_air * CP_AIR * T0 * rise * n**2
    return {
        "nozzle_area": area,
        "turbine_efficiency": efficiency,
        "combustion_efficiency": burnt(sheet.air, sheet.fuel, T0 * (1.0 + rise), T4),
        "idle_combustion_efficiency": burnt(idle_air, sheet.idle_fuel, T0 * (1.0 + rise * n**2), idle_T4),
        "flow_droop": (1.0 - flow / n) / (1.0 - n),
        "idle_windage": left / n**2,  # as at full speed: it grows with the square of the speed
    }


def size(sheet: Sheet) -> dict[str, float]:
    """The six parameters, by their names in turbine.c."""

    def gap(windage: float) -> float:
        return _turbine(sheet, windage)["idle_windage"] - windage

    windage = brentq(gap, 0.0, 0.5 * sheet.air * CP_AIR * T0, xtol=1e-9)
    found = _turbine(sheet, windage)
    del found["idle_windage"]
    return found | {"windage_power": windage}


def rotor(sheet: Sheet) -> tuple[float, float]:
    """Tip radius of the compressor [m] and inertia of the rotor [kg m^2], estimated.

    Tip speed U from the compressor's work, 0.68 U^2 (a radial wheel with blades swept back).  The compressor is as
    heavy as a disc of aluminium 0.25 r thick and has 0.3 m r^2; the turbine is one of nickel alloy, 0.14 r and
    0.4 m r^2.
    """
    rise = (sheet.pressure_ratio ** (2.0 / 7.0) - 1.0) / sheet.compressor_efficiency
    r = sqrt(CP_AIR * T0 * rise / 0.68) / (sheet.speed * RPM)
    return r, (0.3 * 0.25 * 2700.0 + 0.4 * 0.14 * 8200.0) * pi * r**5


if __name__ == "__main__":
    for name, sheet in SHEETS.items():
        print(f"[{name}]")
        radius, inertia = rotor(sheet)
        print(f"tip radius {radius:.4g} m, inertia {inertia:.3g} kg m^2")
        for key, value in size(sheet).items():
            print(f"{key} = {value:.6g}")
