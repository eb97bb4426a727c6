"""What the stepping thread hands over: facts that never change, and an immutable record of the flight at an instant."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Literal, NamedTuple

from cosim.base.geodesy import Geodesy
from cosim.base.signals import (
    UNKNOWN3,
    PerJet,
    Sample,
    Vector3,
)
from cosim.control.autopilot.status import Status

Personality = Literal["px4", "ardupilot", "generic"]
PERSONALITIES: tuple[Personality, ...] = ("px4", "ardupilot", "generic")


class Predicting(NamedTuple):
    """A predictor's inside at one instant, roll, pitch, yaw; rad/s."""

    model: Vector3 = UNKNOWN3  # its model's rate without the delay
    delayed: Vector3 = UNKNOWN3  # the same with the delay: what the model thinks is measured now
    delay: Vector3 = UNKNOWN3  # s


class Snapshot(NamedTuple):
    """The flight at one instant."""

    sample: Sample  # of the last step
    status: Status  # the pilot's
    predicting: Predicting | None = None  # None: no predictor flies
    load: float = nan  # share of the time of a step that computing it takes
    missed: int = 0  # deadlines

    @property
    def time(self) -> float:
        """Simulation time, s."""
        return self.sample.time


@dataclass(frozen=True)
class About:
    """The vehicle as it was built."""

    geodesy: Geodesy
    jets: int
    name: str = "hexjet"
    version: str = "0.1.0"
    personality: Personality = "px4"
    system: int = 1
    component: int = 1
    tilt_range: float = nan  # rad, either way; NaN: the outputs are told in rad
    full_thrust: PerJet = ()  # N, each engine at full throttle; empty: not known
    fuel_capacity: float = nan  # kg; NaN: no tank
    position_noise: float = nan  # m, standard deviation of the GNSS; NaN: not known
    velocity_noise: float = nan  # m/s
    height_noise: float = nan  # m, of the barometer
    failures: bool = True  # INJECT_FAILURE is answered
