"""The constant data of a vehicle that its telemetry needs."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Literal

from cosim.base.geodesy import Geodesy
from cosim.base.signals import PerJet

Personality = Literal["px4", "ardupilot", "generic"]
PERSONALITIES: tuple[Personality, ...] = ("px4", "ardupilot", "generic")


@dataclass(frozen=True)
class VehicleConstants:
    """Constant data of a vehicle: identity, outputs, engines, and noise of its sensors."""

    geodesy: Geodesy
    jets: int
    name: str = "hexjet"
    version: str = "0.1.0"
    personality: Personality = "px4"
    system: int = 1
    tilt_range: float = nan  # rad to either side of the middle; NaN: the outputs are sent in rad
    servos: tuple[str, ...] = ("left", "right")  # names of the servos as faults state them
    # Least and greatest angle of each servo, where the servos are not two banks.
    ranges: tuple[tuple[float, float], ...] = ()
    full_thrust: PerJet = ()  # N, each engine at full throttle; empty: not known
    fuel_capacity: float = nan  # kg; NaN: no tank
    position_noise: float = nan  # m, standard deviation of the GNSS; NaN: not known
    velocity_noise: float = nan  # m/s
    height_noise: float = nan  # m, of the barometer
