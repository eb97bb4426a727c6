"""Models of a vehicle's sensors."""

from typing import Annotated

from pydantic import Field

from cosim.base.storage.toml import Model, NotNegative, Samples, Vector


class GyroSensor(Model):
    """Rate gyro: white noise, constant bias, quantisation, then a first-order low-pass, whole samples of latency.

    ``bias_sigma_rad_s`` is the standard deviation of a further constant bias that the flight's seed draws for each
    axis; ``resolution_rad_s`` the step of the values that it gives, 0: none.
    """

    filter_s: NotNegative
    noise_rad_s: NotNegative
    bias_rad_s: Vector
    latency_samples: Samples
    bias_sigma_rad_s: NotNegative = 0.0  # deviation of an added bias, by the seed
    resolution_rad_s: NotNegative = 0.0  # quantization step; 0: none


class AttitudeSensor(Model):
    """Attitude estimate: small-angle white noise and constant bias, whole samples of latency.

    ``ahrs_time_constant_s`` is that of a complementary filter, whose lean follows the direction of the specific force;
    0: the lean is the true one.
    """

    noise_rad: NotNegative
    bias_rad: Vector
    latency_samples: Samples
    ahrs_time_constant_s: NotNegative = 0.0


class PositionSensor(Model):
    """GNSS position and velocity, sampled and held at its own rate."""

    position_noise_m: NotNegative
    velocity_noise_m_s: NotNegative
    period_samples: Annotated[int, Field(ge=1, le=10000)]
    latency_samples: Samples


class AltitudeSensor(Model):
    """Barometric height above the starting ground."""

    noise_m: NotNegative
    bias_m: float
    latency_samples: Samples


class ForceSensor(Model):
    """Accelerometer at the centre of gravity: specific force with white noise and constant bias, body axes.

    The defaults are a small MEMS sensor's (TDK ICM-42688-P, data sheet DS-000347): 70 ug per root Hz make 0.008 m/s^2
    of noise in 125 Hz, to which the engines add; 0.05 m/s^2 with them is chosen by us.  Its zero moves by 0.15 mg/K,
    hence 0.03 m/s^2 at 20 K from where it was calibrated.  ``bias_sigma_m_s2`` and ``resolution_m_s2`` as the gyro's.
    """

    noise_m_s2: NotNegative = 0.05
    bias_m_s2: Vector = (0.03, 0.03, 0.03)
    latency_samples: Samples = 0
    bias_sigma_m_s2: NotNegative = 0.0  # deviation of an added bias, by the seed
    resolution_m_s2: NotNegative = 0.0  # quantization step; 0: none


class Sensors(Model):
    gyro: GyroSensor
    attitude: AttitudeSensor
    gnss: PositionSensor
    barometer: AltitudeSensor
    accelerometer: ForceSensor = Field(default_factory=ForceSensor)
