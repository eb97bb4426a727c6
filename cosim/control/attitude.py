"""Attitude loop: a proportional law on the quaternion error."""

from __future__ import annotations

from math import sqrt

from cosim.base.frames import from_euler
from cosim.base.limits import clamp
from cosim.base.signals import Command, Measured, Vector3
from cosim.control.bumpless import Fade
from cosim.spec.vehicle import AttitudeGains


class AttitudeController:
    """Rate set-point = gain x attitude error, limited per axis.

    The error is ``q_e = conj(q) q_sp``, taken the short way round (``w >= 0``); ``2 (x, y, z)`` of it is the error
    about the body axes, which is the error angle for small errors and does not wind past half a turn.
    """

    def __init__(self, gains: AttitudeGains) -> None:
        self._gain = gains.gain_1_s
        self._limit = gains.rate_limit_rad_s
        self._nominal = gains.gain_1_s
        self._roll_factor = 1.0
        self._euler: Vector3 = (0.0, 0.0, 0.0)
        self._setpoint = from_euler(0.0, 0.0, 0.0)
        self.reset()

    def reset(self) -> None:
        """End the fading of a gain change, and discard the cached quaternion of the set-point."""
        self._old_law: tuple[Vector3, Vector3] | None = None
        self._fades: tuple[Fade, ...] = ()

    def retune(self, gains: AttitudeGains, step: float) -> None:
        """Change the gains at the next update without a jump: the difference fades; ``step`` s between updates."""
        if self._old_law is None:
            self._old_law = (self._gain, self._limit)
        self._nominal, self._limit = gains.gain_1_s, gains.rate_limit_rad_s
        self.scale_gains(self._roll_factor)
        self._fades = self._fades or (Fade(step), Fade(step), Fade(step))

    def scale_gains(self, roll: float) -> None:
        """Scale the gain of roll from the next update on; see :mod:`cosim.control.schedule`."""
        self._roll_factor = roll
        x, y, z = self._nominal
        self._gain = (roll * x, y, z)

    def update(self, command: Command, measured: Measured) -> Vector3:
        """Return the body rate set-point, rad/s."""
        if command.rate is not None:
            return command.rate
        return self._rates_for(self.error(command, measured))

    def update_tilt_first(
        self, command: Command, measured: Measured, lean: tuple[float, float], max_lean: float = 0.25
    ) -> Vector3:
        """Return the body rate set-point [rad/s] of a vehicle that holds no heading: zero about the body's z axis.

        The lean that is asked for is kept within ``max_lean`` [rad]: without an engine a vehicle has little thrust to
        spare, and one that leans more as it touches tips over.  ``lean`` [rad], roll and pitch, is added to it.

        The error is taken apart, ``q_e = q_l q_z``, into the least turn that brings the body's z axis to where it is
        asked for, ``q_l`` about an axis in the body's xy plane, and a turn about z from there, which is left: with
        ``n = sqrt(w^2 + z^2)`` of ``q_e``, ``q_z = (w, 0, 0, z) / n``.  Taken together the heading's error would turn
        the lean's half as far: a vehicle that faces the other way would lean across.
        """
        if command.rate is not None:
            return command.rate
        roll, pitch, yaw = command.attitude
        size = sqrt(roll * roll + pitch * pitch)
        if size > max_lean:
            scale = max_lean / size
            command = command._replace(attitude=(scale * roll, scale * pitch, yaw))
        ex, ey, ez = self.error(command, measured)
        n = sqrt(max(0.0, 1.0 - 0.25 * (ex * ex + ey * ey)))
        if n > 0.0:
            # The attitude error is 2 (x, y, z) of the error quaternion with w >= 0.
            sine = 0.5 * ez / n
            cosine = sqrt(max(0.0, 1.0 - sine * sine))
            ex, ey = ex * cosine - ey * sine, ey * cosine + ex * sine
        return self._rates_for((ex + lean[0], ey + lean[1], 0.0))

    def _rates_for(self, error: Vector3) -> Vector3:
        """Return the body rate set-point [rad/s] for an attitude error [rad]."""
        ex, ey, ez = error
        kx, ky, kz = self._gain
        lx, ly, lz = self._limit
        p, q, r = kx * ex, ky * ey, kz * ez
        rates = (
            clamp(p, lx),
            clamp(q, ly),
            clamp(r, lz),
        )
        return self._fade(error, rates) if self._fades else rates

    def direction(self, command: Command, measured: Measured) -> Vector3:
        """Return the commanded direction of the body's z axis, in body axes; the heading has no part in it."""
        x, y, z = self.error(command, measured)
        half = 0.25 * (x * x + y * y + z * z)
        # The attitude error is 2 (x, y, z) of a quaternion with w >= 0; this is its matrix' third column.
        w = sqrt(max(0.0, 1.0 - half))
        return (0.5 * x * z + w * y, 0.5 * y * z - w * x, 1.0 - 0.5 * (x * x + y * y))

    def error(self, command: Command, measured: Measured) -> Vector3:
        """Return the attitude error, from the attitude to its set-point, about the body axes, rad."""
        if command.attitude != self._euler:
            self._euler = command.attitude
            self._setpoint = from_euler(*self._euler)
        aw, ax, ay, az = measured.attitude
        bw, bx, by, bz = self._setpoint
        double = 2.0 if aw * bw + ax * bx + ay * by + az * bz >= 0.0 else -2.0
        ex = double * (aw * bx - ax * bw - ay * bz + az * by)
        ey = double * (aw * by + ax * bz - ay * bw - az * bx)
        ez = double * (aw * bz - ax * by + ay * bx - az * bw)
        return (ex, ey, ez)

    def _fade(self, error: Vector3, new: Vector3) -> Vector3:
        """Return the rate set-point of the new gains plus the fading difference from the old ones."""
        x, y, z = (fade.update() for fade in self._fades)
        if self._old_law is None:
            return (new[0] + x, new[1] + y, new[2] + z)
        gain, limit = self._old_law
        self._old_law = None
        terms = zip(gain, limit, error, (x, y, z), strict=True)
        old = [max(-most, min(most, k * e)) + fade for k, most, e, fade in terms]
        for fade, before, after in zip(self._fades, old, new, strict=True):
            fade.begin(before - after)
        return (old[0], old[1], old[2])
