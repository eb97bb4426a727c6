"""Velocity and position control on top of the attitude loop: the acceleration that the vehicle leans for."""

from __future__ import annotations

from math import tan

from cosim.base.constants import GRAVITY
from cosim.control.autopilot.estimation.position import Fix
from cosim.control.autopilot.geometry import Pair, limit_length
from cosim.control.autopilot.guidance.tracker import Track
from cosim.control.bumpless import Fade
from cosim.spec.vehicle import PositionGains


class PositionController:
    """Position loop: P on position and P on velocity, less the estimated disturbance, give an acceleration [m/s^2 NED].

    ``a = a_track + K_v (v_track + K_p (p_track - p) - v) - b``.  ``b`` is the integral action: it comes from what the
    vehicle did with the lean that it had, so it cannot wind up at a limit.  ``K_p`` times the error is limited, and
    so is the whole, in length, to what ``lean`` gives.
    """

    def __init__(self, gains: PositionGains, step: float) -> None:
        self._step = step
        self._catch_up = gains.catch_up_m_s
        self._law = (gains.position_1_s, gains.velocity_1_s, gains.lean_rad)
        self.reset()

    def reset(self) -> None:
        """End the fading of a gain change."""
        self._left: tuple[float, float, float] | None = None
        self._fades: tuple[Fade, ...] = ()

    def retune(self, position: float, velocity: float, lean: float) -> None:
        """Change the gains at the next update without a jump: the difference in acceleration fades."""
        if self._left is None:
            self._left = self._law
        self._law = (position, velocity, lean)
        self._fades = self._fades or (Fade(self._step), Fade(self._step))

    def update(self, track: Track, fix: Fix) -> Pair:
        """Return the commanded horizontal acceleration, m/s^2 NED."""
        answer = self._commanded_acceleration(self._law, track, fix)
        if not self._fades:
            return answer
        n, e = (fade.update() for fade in self._fades)
        if self._left is not None:
            old = self._commanded_acceleration(self._left, track, fix)
            self._left = None
            n, e = old[0] + n - answer[0], old[1] + e - answer[1]
            for fade, value in zip(self._fades, (n, e), strict=True):
                fade.begin(value)
        return answer[0] + n, answer[1] + e

    def _commanded_acceleration(self, law: tuple[float, float, float], track: Track, fix: Fix) -> Pair:
        """Return the horizontal acceleration [m/s^2, NED] by the two gains and the largest lean in ``law``."""
        kp, kv, lean = law
        (tp, tv, ta), (p, v, b) = track, fix
        cn, ce = limit_length(kp * (tp[0] - p[0]), kp * (tp[1] - p[1]), self._catch_up)
        return limit_length(
            ta[0] + kv * (tv[0] + cn - v[0]) - b[0],
            ta[1] + kv * (tv[1] + ce - v[1]) - b[1],
            GRAVITY * tan(lean),
        )
