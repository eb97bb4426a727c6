"""The autopilot's estimates of its own motion, and how reliable they are."""

from __future__ import annotations

from math import nan, radians
from typing import NamedTuple

from cosim.base.frames import to_euler
from cosim.base.signals import Measured, Vector3
from cosim.control.autopilot.estimation.dead_reckoning import DeadReckoning
from cosim.control.autopilot.estimation.position import Estimator
from cosim.control.autopilot.estimation.senses import Senses
from cosim.spec.vehicle import PositionGains, Sensors

# Chosen by us, with the reason.
_BLIND_S = 1.0  # s without a fix: the lean alone is off by half a metre by then for a degree that it is wrong
SPEED_SURE = 1.0  # m/s, one deviation: a speed that is less sure is not told as valid; as PX4's COM_VEL_FS_EVH
LEAN_SURE = radians(5.0)  # one deviation: a twelfth of the weight pushes sideways unseen


class EstimateQuality(NamedTuple):
    """How reliable the autopilot's estimates are.

    ``position`` and ``height`` are valid where a sensor measures them; ``speed``, ``climb`` and ``attitude`` where
    their standard deviation is below 1 m/s and 5 degrees, measured or predicted.  ``gyro`` to ``attitude_sensor``
    are the trusted sensors.  The rest are the standard deviations: m and m/s per axis, m, m/s, rad.
    """

    position: bool = True
    speed: bool = True
    height: bool = True
    climb: bool = True
    attitude: bool = True
    gyro: bool = True
    accelerometer: bool = True
    barometer: bool = True
    gnss: bool = True
    attitude_sensor: bool = True
    position_m: float = nan
    speed_m_s: float = nan
    height_m: float = nan
    climb_m_s: float = nan
    attitude_rad: float = nan


class Estimates:
    """The autopilot's estimates of its own motion.

    Attitude, rates, height and climb rate are from :class:`Senses`, position and velocity from :class:`Estimator`.

    ``gain``: of the attitude loop, 1/s, the slowest of roll and pitch.  ``noisy``: the sensors have their noise, by
    which a receiver that has stopped is told from one that stands.
    """

    def __init__(self, sensors: Sensors, gains: PositionGains, step: float, gain: float, noisy: bool) -> None:
        gnss = sensors.gnss
        noisy = noisy and max(gnss.position_noise_m, gnss.velocity_noise_m_s) > 0.0
        self.senses = Senses(sensors, step, gain)
        self._position = Estimator(gains, gnss, step, noisy, DeadReckoning(sensors, step))
        self.reset(None)

    def reset(self, measured: Measured | None) -> None:
        """Start as if the vehicle had been at rest as ``measured``; None: there is no measurement yet."""
        self.measured = measured  # what the loops are to fly with; None before the first measurement
        self.senses.reset(measured)
        if measured is not None:
            self._position.reset((measured.position[0], measured.position[1]))
        self.euler: Vector3 = (0.0, 0.0, 0.0) if measured is None else to_euler(measured.attitude)
        self.fix = self._position.fix

    def update(
        self, k: int, measured: Measured, still: bool, is_grounded: bool, is_pushed: bool, has_contact: bool
    ) -> None:
        """Update all estimates at step ``k``; ``still``: the vehicle stands; ``is_grounded``: or has not lifted off.

        ``has_contact``: its legs touch the ground.  ``is_pushed``: see
        :meth:`cosim.control.autopilot.estimation.position.Estimator.update`.
        """
        self.measured = measured = self.senses.update(k, measured, still, has_contact)
        self.euler = to_euler(measured.attitude)
        inertial = self.senses.inertial
        lean = 0.0 if inertial.has_attitude else inertial.deviation
        self.fix = self._position.update(k, measured, is_grounded, lean, is_pushed)

    @property
    def now(self) -> Measured:
        """The measurements, sensed or estimated, that the loops fly with."""
        assert self.measured is not None
        return self.measured

    @property
    def altitude(self) -> float:
        """The height above the origin, m."""
        return self.measured.altitude if self.measured is not None else 0.0

    @property
    def altitude_deviation(self) -> float:
        """The standard deviation of the height, m."""
        return self.senses.vertical.deviation[0]

    @property
    def has_position(self) -> bool:
        """Whether GNSS fixes arrive."""
        return self._position.silent <= _BLIND_S

    @property
    def trust(self) -> EstimateQuality:
        """How reliable the estimates are."""
        has_position, inertial, vertical = self.has_position, self.senses.inertial, self.senses.vertical
        (position_deviation, speed), (height, climb) = self._position.deviation, vertical.deviation
        lean = inertial.deviation
        return EstimateQuality(
            has_position,
            has_position or speed < SPEED_SURE,
            vertical.has_height or vertical.has_fix,
            climb < SPEED_SURE,
            inertial.has_attitude or lean < LEAN_SURE,
            inertial.has_rate and not inertial.is_biased,
            vertical.has_force,
            vertical.has_height,
            has_position,
            inertial.has_attitude,
            position_deviation,
            speed,
            height,
            climb,
            lean,
        )
