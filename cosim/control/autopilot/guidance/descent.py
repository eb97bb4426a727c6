"""The rate of descent allowed at a height: from it thrust and response time can stop the vehicle above the ground.

Two uses.  Where the height is controlled the set-point of height keeps within it.  Where the collective comes by stick
or set-point a floor under the collective keeps the vehicle within it: a pilot may fall from any height, and is caught.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from cosim.base.constants import GRAVITY
from cosim.base.limits import clamp
from cosim.control.altitude import MIN_UPRIGHT
from cosim.control.autopilot.guidance.shaper import BUILD_UP_TIME, COMMAND_FRACTION


class HeightLimits(NamedTuple):
    """Bounds of the height set-point [m/s^2, m/s^3], and the braking [m/s^2] and response time [s] of a descent."""

    acceleration: float
    jerk: float
    braking: float
    response_time: float


def height_limits(height: float, gain: float, speed: float, up: float, down: float) -> HeightLimits:
    """Return the bounds for gains K_h (height) and K (climb rate) [1/s] and accelerations of the thrust [m/s^2].

    As for the leans: ``A = min(K speed, (1/4) up, (1/4) down)`` and ``J = A K / 0.5``; braking is planned at ``3/4 A``,
    and the vehicle is later than its set-point by ``1/K_h + 1/K`` and half of the jerk's mean, ``0.25/K``.
    """
    k = max(gain, 0.1)
    a = min(k * speed, COMMAND_FRACTION * up, COMMAND_FRACTION * down)
    return HeightLimits(a, a * k / BUILD_UP_TIME, 0.75 * a, 1.0 / max(height, 0.1) + (1.0 + 0.5 * BUILD_UP_TIME) / k)


def thrust_margins(hover: float, idle: float, throttle_min: float, throttle_max: float) -> tuple[float, float]:
    """Return the accelerations [m/s^2] up and down that full and least throttle give in level hover.

    Thrust is as ``throttle + idle``: ``up = g ((throttle_max + idle) / (hover + idle) - 1)``, down alike.
    """
    weight = hover + idle
    return GRAVITY * (throttle_max - hover) / weight, GRAVITY * (hover - throttle_min) / weight


def descent_rate(height: float, braking: float, response_time: float, end: float = 0.0) -> float:
    """Return the rate of descent [m/s] from which the vehicle slows down to ``end`` [m/s] within ``height`` [m].

    It sinks on for ``response_time`` [s] before the thrust answers and then brakes with ``braking`` [m/s^2]:
    ``h = (v - v_e) t + (v^2 - v_e^2) / (2 a)``, so ``v = sqrt((a t + v_e)^2 + 2 a h) - a t``.
    """
    at = braking * response_time
    return sqrt((at + end) ** 2 + 2.0 * braking * max(0.0, height)) - at


class CollectiveFloor:
    """Lower limit of the collective that avoids a hard landing while height is not controlled.

    With ``v`` from :func:`descent_rate` at the present height (a = half of the thrust beyond the weight, t = four times
    the longest time in which engines and sensed climb rate answer), the vehicle sinking at ``s``, and ``k = 1/(2 T)``
    with T that time about hover, where the floor keeps the engines:

        acceleration upwards = s dv/dh + k (s - v) + (k/4) k integral(s - v)

    and the collective is what gives it, upright; it counts where it is more than the commanded one.  The integral
    learns, while the floor acts, by how much the weight differs from the nominal one: enough for a vehicle that is
    lighter to come down, not for one that is heavier to be caught by engines that take seconds.

    The output moves from least to most throttle in no less than ``answer``: engines that are all driven into the
    limit of their acceleration have none left between them to keep the vehicle level with.
    """

    # Fraction of the excess thrust planned for stopping a fall; the rest is for lean and errors.
    catch_fraction = 0.5
    # Largest correction [m/s^2] that the integral may learn for a wrong weight.
    max_trim = 0.4 * GRAVITY
    # Delay [s] of the GNSS climb rate, which is 0.1 s late and on average 0.05 s old.
    sensed_s = 0.15

    def __init__(
        self,
        hover: float,
        idle: float,
        throttle_min: float,
        throttle_max: float,
        near: float,
        answer: float,
        step: float,
    ) -> None:
        """Delay and lag [s] of the engines: ``near`` hover, and ``answer`` the longest anywhere in their range."""
        self._hover, self._idle = hover, idle
        self._least, self._most = throttle_min, throttle_max
        self._step = step
        margins = thrust_margins(hover, idle, throttle_min, throttle_max)
        self._braking, self._slowing = (self.catch_fraction * margin for margin in margins)
        self._late = 4.0 * (answer + self.sensed_s)
        self._k = 0.5 / (near + self.sensed_s)
        self._most_change = (throttle_max - throttle_min) * step / max(answer, step)
        self.reset()

    def reset(self) -> None:
        """Start on the ground, or under height control."""
        self._trim = 0.0
        self._last: float | None = None
        self.is_acting = False

    def restart_at(self, collective: float) -> None:
        """Restart at the collective of the height control, when that ends."""
        self.reset()
        self._last = collective

    def apply(self, collective: float, height: float, sink: float, end: float, upright: float, weight: float) -> float:
        """Return ``collective``, or the larger one that avoids a hard landing, without jumps.

        ``upright``: cosine of the lean; ``weight``: as a share of that at the start.
        """
        v = descent_rate(height, self._braking, self._late, end)
        slope = self._braking / (v + self._braking * self._late) if height > 0.0 else 0.0
        k = self._k
        up = max(0.0, sink) * slope + k * (sink - v) + self._trim
        least = self._collective_for_acceleration(up, upright, weight)
        self.is_acting = least > collective
        if self.is_acting:
            self._trim = clamp(self._trim + 0.25 * k * k * (sink - v) * self._step, self.max_trim)
        else:
            self._trim = 0.0
        return self.limit_rate(max(collective, least))

    def collective_for(self, up: float, upright: float, weight: float) -> float:
        """Return the collective for an upward acceleration [m/s^2], not below half of that of idle thrust."""
        return self._collective_for_acceleration(max(up, -self._slowing), upright, weight)

    def _collective_for_acceleration(self, up: float, upright: float, weight: float) -> float:
        """Return the collective, within its limits, for an upward acceleration [m/s^2]."""
        thrust = (self._hover + self._idle) * weight * (1.0 + up / GRAVITY) / max(upright, MIN_UPRIGHT)
        return min(max(thrust - self._idle, self._least), self._most)

    def limit_rate(self, collective: float) -> float:
        if self._last is not None:
            collective = min(max(collective, self._last - self._most_change), self._last + self._most_change)
        self._last = collective
        return collective
