"""The stand in which a vehicle waits while an autopilot starts up, calibrates and is armed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cosim.base.frames import conjugate, rotate
from cosim.base.signals import ZERO3, Measured, State
from cosim.vehicle.sensors import SensorSuite

if TYPE_CHECKING:
    from cosim.spec.vehicle import Sensors


class StationarySensors:
    """The vehicle's own sensors while it is held still in the stand.

    They are those of the flight, with the same bias, filter, latency and size of noise: what an autopilot learns of
    them in the stand holds in the air, and nothing repeats, which it would take for a sensor that has died.  The noise
    is from a generator of its own, so that the flight's is as it is without.  ``state``: as the flight begins;
    ``gravity`` [m/s^2]: that of the place.  ``noisy``: as of the flight.
    """

    def __init__(self, sensors: Sensors, step: float, seed: int, noisy: bool, state: State, gravity: float) -> None:
        force = rotate(conjugate(state.attitude), (0.0, 0.0, -gravity))
        self._still = state._replace(rate=ZERO3, velocity=ZERO3, specific_force=force)
        noise_seed = int(np.random.SeedSequence(seed, spawn_key=(5,)).generate_state(1)[0])
        self._suite = SensorSuite(sensors, step, noise_seed, noisy)
        self._suite.reset(self._still)

    def sample(self) -> Measured:
        """Return the sensors' measurement at the end of the next step."""
        return self._suite.sample(self._still)
