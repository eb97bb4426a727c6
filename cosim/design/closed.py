"""A channel closed with attitude gain, rate PID and predictor: is it stable, how robust, how fast, how loud.

``G_y``, ``G_m``, ``G_phi``: command to measured rate, to measured angle, to the angle.  ``K`` the attitude gain.

    inner = 1 + (C_e + D) P_u,  outer = (C_e + D) P_y G_y + C_e K G_m,  L = outer / inner
    S = 1 / (1 + L)                                    sensitivity at the plant's input, both loops closed
    angle / set-point = C_e K G_phi / (inner + outer),  angle / load = G_phi S

A lead behind the PID multiplies ``C_e`` and ``D``; the predictor reads the command behind it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf, pi

import numpy as np

from cosim.control.lead import lead_polynomials
from cosim.design.channel import Channel, angles
from cosim.design.loop import Array, Complex, Pair, observer_response, pid_response, predictor_response, zeros_outside
from cosim.vehicle import EngineLead, PredictorTuning, RateGains, RateModel

LEFT = 1e-3  # of the largest response to a load: less at almost no frequency is nothing
CANDIDATES = ("baseline", "smith", "filtered-smith", "state-model", "state-disturbance")
TUNED = {
    "filtered-smith": "filter_s",
    "state-model": "model_observer_rad_s",
    "state-disturbance": "disturbance_observer_rad_s",
}  # what of the predictor's tuning a controller has of its own


@dataclass(frozen=True)
class Tuning:
    """A controller with everything that can be chosen about it on one channel."""

    controller: str
    angle_gain: float  # 1/s
    gains: RateGains
    predictor: PredictorTuning
    model: RateModel  # what the predictor believes
    lead: EngineLead | None = None

    def answer(self) -> Callable[[Complex], Pair]:
        """``P_y`` and ``P_u`` of the predictor."""
        if self.controller == "state-model":
            return observer_response(self.model, self.predictor.model_observer_rad_s, disturbance=False)
        if self.controller == "state-disturbance":
            return observer_response(self.model, self.predictor.disturbance_observer_rad_s, disturbance=True)
        return predictor_response(self.controller, self.model, self.predictor)


class Points:
    """Points of the unit circle with a channel's response there: close together, and even for the time response.

    ``z[:even]`` are evenly spaced up to ``pi / thin``: the response in time is had from them, every ``thin`` steps,
    over ``slowness`` times the channel's delay.
    """

    def __init__(self, channel: Channel, close: int = 500, even: int = 750, slowness: float = 50.0) -> None:
        self.channel = channel
        step = channel.step
        length = slowness * channel.slowness_s
        self.thin = max(1, round(length / (2 * even * step)))
        self.even = even + 1
        self.sample_s = self.thin * step
        evenly = np.arange(even + 1) * pi / (even * self.thin)
        evenly[0] = 1e-3 * evenly[1]  # instead of 0, where the integrators are
        lowest = min(1e-3 * step / channel.slowness_s, 1e-3)
        closely = np.union1d(np.geomspace(lowest, pi, close - close // 4), np.linspace(pi / close, pi, close // 4))
        self.z: Complex = np.exp(1j * np.concatenate([evenly, closely]))
        self.closely = slice(even + 1, None)
        self.theta: Array = angles(self.z)
        self.rate, self.measured_angle, self.angle = channel.responses(self.z)
        self.measuring = channel.measuring(self.z) if channel.identified is None else np.ones_like(self.z)

    def in_time(self, response: Complex) -> Array:
        """The samples, every ``thin`` steps, of a signal that ends within the window."""
        even = response[: self.even].copy()
        even[0] = even[0].real
        even[-1] = even[-1].real
        return np.asarray(np.fft.irfft(even)) / self.thin


class Closed:
    """A channel closed with a tuning, at the points."""

    def __init__(self, points: Points, tuning: Tuning, answer: Pair | None = None) -> None:
        self.points, self.tuning = points, tuning
        z, channel = points.z, points.channel
        self._of_rate, of_command = answer or tuning.answer()(z)
        self._error, slope = pid_response(tuning.gains, channel.step, z)
        self._begin = tuning.gains.p + tuning.gains.i * channel.step
        if tuning.lead is not None:
            over, under = lead_polynomials(tuning.lead, channel.step)
            lead = np.polyval(over, z) / np.polyval(under, z)
            self._error, slope = self._error * lead, slope * lead
            self._begin *= over[0]
        self._both = self._error + slope
        self.inner: Complex = 1.0 + self._both * of_command
        self.outer: Complex = (
            self._both * self._of_rate * points.rate + self._error * tuning.angle_gain * points.measured_angle
        )
        self.characteristic: Complex = self.inner + self.outer

    @cached_property
    def unstable_poles(self) -> int:
        """Closed-loop poles outside the unit circle."""
        z = self.points.z[self.points.closely]
        gains, channel = self.tuning.gains, self.points.channel
        at_one = (1 if gains.i else 0) + (1 if self.tuning.angle_gain else 0)
        at_one += 1 if channel.identified is None and channel.damping_1_s == 0.0 else 0
        return zeros_outside((1.0 - 1.0 / z) ** at_one * self.characteristic[self.points.closely])

    @property
    def open_loop(self) -> Complex:
        """``L``, broken at the plant's input."""
        return np.asarray(self.outer / self.inner)

    @property
    def peak_sensitivity(self) -> float:
        """``max |S|``."""
        return float(np.max(np.abs(self.inner / self.characteristic)))

    def tolerated(self, delay: float, gain: float) -> float:
        """By which factor the tolerances could grow until a gain and a delay inside them make a pole on the circle.

        ``delay`` in samples, ``gain`` relative, either way.  ``1 + g e^(-j theta tau) L`` is 0 only where
        ``g = |1 / L|`` and ``tau = -arg(-1 / L) / theta``: every frequency has one pair that matters, and the
        loop keeps its number of unstable poles for all pairs in the box while none of these is inside.  Above 1 with
        a stable nominal loop: stable for every gain and delay in the box, the fractions between samples included.
        """
        critical = -self.inner / self.outer
        x = (np.abs(critical) - 1.0) / max(gain, 1e-9)
        y = -np.angle(critical) / self.points.theta / max(delay, 1e-9)
        parts = (slice(1, self.points.even), self.points.closely)
        return min(_nearest(x[part], y[part], np.angle(critical[part])) for part in parts)

    @property
    def angle_response(self) -> Complex:
        """Set-point to angle."""
        return np.asarray(self._error * self.tuning.angle_gain * self.points.angle / self.characteristic)

    @property
    def overshoot(self) -> float:
        """Share of a step by which the angle goes beyond it."""
        return max(0.0, -float(self.error_in_time.min()))

    @cached_property
    def error_in_time(self) -> Array:
        """Error after a unit step of the set-point, rad per rad, every ``points.sample_s``."""
        return self.points.in_time((1.0 - self.angle_response) / (1.0 - 1.0 / self.points.z))

    def load_in_time(self) -> Array:
        """Angle after a unit step of load at the plant's input, rad per unit of the command."""
        left = self.load_left
        change = self._load_response - left if left else self._load_response
        return self.points.in_time(change / (1.0 - 1.0 / self.points.z)) + left

    @property
    def load_left(self) -> float:
        """Angle that a unit of load leaves for ever, rad per unit of the command; 0 where an integral removes it.

        A state predictor whose observer knows of no disturbance takes one for a rate, and no integral removes that.
        """
        response = self._load_response[: self.points.even]
        left = float(response[0].real)
        return left if abs(left) > LEFT * np.abs(response).max() else 0.0

    @cached_property
    def _load_response(self) -> Complex:
        return np.asarray(self.points.angle * self.inner / self.characteristic)

    @property
    def step_peak(self) -> float:
        """Largest command that a unit step of the set-point asks for, the first one exactly."""
        response = self._error * self.tuning.angle_gain / self.characteristic
        later = float(np.abs(self.points.in_time(response / (1.0 - 1.0 / self.points.z))).max())
        return max(self._begin * self.tuning.angle_gain, later)

    @property
    def noise(self) -> float:
        """Standard deviation of the command that the sensors' noise makes, in its unit."""
        channel, points = self.points.channel, self.points
        of_rate = self._both * self._of_rate * points.measuring / self.characteristic
        of_angle = self._error * self.tuning.angle_gain / self.characteristic
        power = channel.rate_hold * (channel.rate_noise * np.abs(of_rate)) ** 2
        power += (channel.angle_noise * np.abs(of_angle)) ** 2
        part = self.points.closely
        return float(np.sqrt(np.trapezoid(power[part], points.theta[part]) / pi))

    @property
    def bandwidth(self) -> float:
        """Hz, up to which the angle follows within 3 dB."""
        part = self.points.closely
        size = np.abs(self.angle_response[part])
        below = np.flatnonzero(size < 10.0 ** (-3.0 / 20.0))
        if not len(below) or below[0] == 0:
            return 0.0 if len(below) else inf
        k = int(below[0])
        theta = self.points.theta[part]
        share = (10.0 ** (-3.0 / 20.0) - size[k - 1]) / (size[k] - size[k - 1])
        at = np.log(theta[k - 1]) + share * np.log(theta[k] / theta[k - 1])
        return float(np.exp(at) / (2.0 * pi * self.points.channel.step))


def _nearest(x: Array, y: Array, angle: Array) -> float:
    """Least ``max(|x|, |y|)`` along the straight lines between points that follow each other.

    Where the angle behind ``y`` jumps by a turn there is no line.
    """
    dx, dy = np.diff(x), np.diff(y)
    joined = np.abs(np.diff(angle)) < pi
    # where it can be least: at the ends, where one of the two is 0, and where they are equal
    pairs = ((-x[:-1], dx), (-y[:-1], dy), (y[:-1] - x[:-1], dx - dy), (-(x[:-1] + y[:-1]), dx + dy))
    least = float(np.min(np.maximum(np.abs(x), np.abs(y))))
    for over, under in pairs:
        at = np.clip(over / np.where(under == 0.0, 1.0, under), 0.0, 1.0)
        along = np.maximum(np.abs(x[:-1] + at * dx), np.abs(y[:-1] + at * dy))
        least = min(least, float(np.min(along[joined], initial=least)))
    return least
