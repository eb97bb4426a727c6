"""What the autopilot and its loops fly with: the sensors where they work, estimates where they do not.

Faults are not reported to it: each estimator detects them in its sensors' readings.
"""

from __future__ import annotations

from cosim.base.constants import GRAVITY
from cosim.base.signals import Measured
from cosim.control.autopilot.estimation.inertial import InertialEstimator
from cosim.control.autopilot.estimation.vertical import VerticalEstimator
from cosim.spec.vehicle import Sensors


class Senses:
    """Attitude and rates, height and climb rate, each from the sensors that work.

    Where all sensors work, attitude and horizontal position are the sensors' own; rates are the gyro's less its bias;
    height and climb rate are always estimates.
    """

    def __init__(self, sensors: Sensors, step: float, gain: float) -> None:
        """``gain``: of the attitude loop, 1/s, the slowest of roll and pitch."""
        self.inertial = InertialEstimator(sensors, step, gain)
        self.vertical = VerticalEstimator(sensors, step)

    def reset(self, measured: Measured | None) -> None:
        """Start as if the vehicle had been at rest as ``measured``; None: as the first measurement says."""
        self._is_initialised = measured is not None
        self.inertial.reset(measured)
        if measured is None:
            self.vertical.reset(0.0, 0.0)
        else:
            self.vertical.reset(measured.altitude, -measured.velocity[2])

    def update(self, k: int, measured: Measured, still: bool, has_contact: bool = False) -> Measured:
        """Return the measurements that step ``k`` is flown with; ``still``: it stands, ``has_contact``: legs touch."""
        if not self._is_initialised:
            self.reset(measured)
        attitude, rate = self.inertial.update(measured, still)
        vertical = self.vertical
        vertical.update(k, measured, attitude, still, has_contact)
        north, east, _ = measured.velocity
        return Measured(
            rate, attitude, measured.position, (north, east, -vertical.rate), vertical.height, measured.specific_force
        )

    @property
    def failures(self) -> tuple[str, ...]:
        """What has failed, in words, the GNSS receiver aside."""
        inertial, vertical = self.inertial, self.vertical
        failures = []
        if not inertial.has_attitude:
            failures.append("attitude lost")
        if not inertial.has_rate:
            failures.append("gyro lost")
        elif inertial.is_biased:
            failures.append("gyro biased")
        if not vertical.has_height:
            failures.append("barometer lost")
        return tuple(failures)

    @property
    def lift(self) -> float | None:
        """Specific force upwards over gravity; None without an accelerometer."""
        vertical = self.vertical
        return (vertical.lift - vertical.bias) / GRAVITY if vertical.has_force else None
