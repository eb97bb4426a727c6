"""Gains of the estimate of horizontal position and velocity, from the sensors' stated noise, epoch by epoch."""

from __future__ import annotations

from functools import lru_cache
from math import sqrt

import numpy as np

from cosim.spec.vehicle import PositionGains, PositionSensor


@lru_cache
def settling_gains(
    gains: PositionGains,
    sensor: PositionSensor,
    step: float,
    least_noise: tuple[float, float] = (0.01, 0.001),
    epochs: int = 600,
) -> tuple[list[list[list[float]]], list[tuple[float, float]]]:
    """Return the Kalman gains (3 x 2) of each GNSS epoch, and the standard deviations of the estimate after each.

    Gains are of position, velocity and disturbance by position and velocity, deviations of position and velocity.  The
    last gains stay.  They vary from the first fix on, so that the noise of position is averaged away while the vehicle
    stands, instead of staying for the half minute that the settled filter needs; after so many ``epochs``, a minute at
    10 Hz, they have settled.  ``least_noise``: m, m/s; a receiver stated as perfect is not trusted beyond it.
    """
    T = sensor.period_samples * step
    F = np.array([[1.0, T, 0.5 * T * T], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    qa, qb = gains.acceleration_noise_m_s15**2, gains.disturbance_walk_m_s25**2
    # Integrals of the two white noises over the time between fixes.
    Q = qa * np.array([[T**3 / 3, T**2 / 2, 0.0], [T**2 / 2, T, 0.0], [0.0, 0.0, 0.0]])
    Q += qb * np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
    H = np.eye(2, 3)
    stated = (sensor.position_noise_m, sensor.velocity_noise_m_s)
    noise = [max(each, least) ** 2 for each, least in zip(stated, least_noise, strict=True)]
    R = np.diag(noise)
    P = np.diag([noise[0], noise[1], 0.0])
    gains_by_epoch, deviations = [], [(sqrt(noise[0]), sqrt(noise[1]))]
    for _ in range(epochs):
        P = F @ P @ F.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        P = (np.eye(3) - K @ H) @ P
        gains_by_epoch.append([[float(x) for x in row] for row in K])
        deviations.append((float(sqrt(P[0, 0])), float(sqrt(P[1, 1]))))
    return gains_by_epoch, deviations
