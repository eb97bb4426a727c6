"""Attitude loop: a proportional law on the quaternion error."""

from __future__ import annotations

from cosim.frames import from_euler
from cosim.signals import Command, Measured, Vector3
from cosim.vehicle import AttitudeGains


class AttitudeController:
    """Rate set-point = gain x attitude error, limited per axis.

    The error is ``q_e = conj(q) q_sp``, taken the short way round (``w >= 0``); ``2 (x, y, z)`` of it is the error
    about the body axes, which is the error angle for small errors and does not wind past half a turn.
    """

    def __init__(self, gains: AttitudeGains) -> None:
        self._gain = gains.gain_1_s
        self._limit = gains.rate_limit_rad_s
        self._euler: Vector3 = (0.0, 0.0, 0.0)
        self._setpoint = from_euler(0.0, 0.0, 0.0)

    def reset(self) -> None:
        """Nothing is remembered between steps but the last set-point's quaternion."""

    def update(self, command: Command, measured: Measured) -> Vector3:
        """Body rate set-point, rad/s."""
        if command.rate is not None:
            return command.rate
        if command.attitude != self._euler:
            self._euler = command.attitude
            self._setpoint = from_euler(*self._euler)
        aw, ax, ay, az = measured.attitude
        bw, bx, by, bz = self._setpoint
        double = 2.0 if aw * bw + ax * bx + ay * by + az * bz >= 0.0 else -2.0
        kx, ky, kz = self._gain
        lx, ly, lz = self._limit
        p = kx * double * (aw * bx - ax * bw - ay * bz + az * by)
        q = ky * double * (aw * by + ax * bz - ay * bw - az * bx)
        r = kz * double * (aw * bz - ax * by + ay * bx - az * bw)
        return (
            lx if p > lx else (-lx if p < -lx else p),
            ly if q > ly else (-ly if q < -ly else q),
            lz if r > lz else (-lz if r < -lz else r),
        )
