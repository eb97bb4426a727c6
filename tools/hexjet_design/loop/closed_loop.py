"""A channel closed with attitude gain, rate PID and predictor: stability, robustness, speed, noise.

``G_y``, ``G_m``, ``G_phi``: command to measured rate, to measured angle, to the angle.  ``K`` the attitude gain.

    inner = 1 + (C_e + D) P_u,  outer = (C_e + D) P_y G_y + C_e K G_m,  L = outer / inner
    S = 1 / (1 + L), T = L / (1 + L)                   sensitivity at the plant's input, both loops closed
    angle / set-point = C_e K G_phi / (inner + outer),  angle / load = G_phi S

Where the actuator's model misfits by up to ``w`` (:attr:`hexjet_design.loop.dynamics.Dynamics.unsure`), the loop is any
``L (1 + x)`` with ``|x| <= w``: it stays stable for all of them while ``w |T| < 1``, and the largest sensitivity among
them is ``|S| / (1 - w |T|)`` (Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., section 7.5).

A lead behind the PID multiplies ``C_e`` and ``D``; the predictor reads the command behind it.  Another autopilot's loop
(:mod:`hexjet_design.loop.firmware`) states ``C_e`` and ``C_e + D`` itself.
"""

from __future__ import annotations

from functools import cached_property
from math import ceil, inf, log2, nan, pi

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.control.lead import lead_polynomials
from cosim.loops import LoopMargins, loop_margins, pid_response, zeros_outside
from hexjet_design.loop.channel import Channel, angles
from hexjet_design.loop.state_space import Space, Steps
from hexjet_design.loop.tuning import Tuning

WINDOW_TIME_SCALES = 50.0  # length of time responses in time scales
# Length of time responses in time constants of the slowest response, of which 5 % then remains.
WINDOW_RESPONSES = 3.0
# Largest fraction of a response that remains one period later and wraps around: as small as rounding.
MAX_WRAPPED = 1e-10


class FrequencyGrid:
    """Points of the unit circle with a channel's response, dense where a loop turns.

    Among them are those at which a misfit of the model is stated: it is straight between them, so no narrow mode is
    missed, however few the others are.
    """

    def __init__(self, channel: Channel, close: int = 600, z: Complex | None = None) -> None:
        self.channel = channel
        lowest = min(1e-3 * channel.step / channel.longest_s, 1e-3)
        closely = np.union1d(np.geomspace(lowest, pi, close - close // 4), np.linspace(pi / close, pi, close // 4))
        misfit = channel.actuator.dynamics.unsure if channel.identified is None else ()
        if misfit:
            at = 2.0 * pi * channel.step * np.array([hertz for hertz, _ in misfit])
            closely = np.union1d(closely, at[(at > lowest) & (at < pi)])
        self.z: Complex = np.exp(1j * closely) if z is None else z
        self.theta: Array = angles(self.z)
        self.rate, self.measured_angle, self.angle = channel.responses(self.z)
        self.measuring = channel.measurement_response(self.z) if channel.identified is None else np.ones_like(self.z)
        hertz = self.theta / (2.0 * pi * channel.step)
        self.unsure = channel.actuator.dynamics.uncertainty(hertz) if channel.identified is None else None


def window_s(channel: Channel) -> float:
    """Return the length of the time responses of a channel, s."""
    return max(WINDOW_TIME_SCALES * channel.time_scale_s, WINDOW_RESPONSES * channel.longest_s)


class ClosedLoop:
    """Closed loop of a channel and a tuning, at the points of a frequency grid."""

    def __init__(self, points: FrequencyGrid, tuning: Tuning) -> None:
        self.points, self.tuning = points, tuning
        z, channel = points.z, points.channel
        self._of_rate, of_command = tuning.answer()(z)
        if tuning.firmware is not None:
            self._error, self._both = tuning.firmware.responses(tuning.gains, channel.step, z)
            slope = self._both - self._error
        else:
            self._error, slope = pid_response(tuning.gains, channel.step, z)
        if tuning.lead is not None:
            numerator, denominator = lead_polynomials(tuning.lead, channel.step)
            lead = np.polyval(numerator, z) / np.polyval(denominator, z)
            self._error, slope = self._error * lead, slope * lead
        self._both = self._error + slope
        self.inner: Complex = 1.0 + self._both * of_command
        self.outer: Complex = (
            self._both * self._of_rate * points.rate + self._error * tuning.angle_gain * points.measured_angle
        )
        self.characteristic: Complex = self.inner + self.outer

    @cached_property
    def unstable_poles(self) -> int:
        """Closed-loop poles outside the unit circle."""
        z = self.points.z
        gains, channel = self.tuning.gains, self.points.channel
        at_one = (1 if gains.i else 0) + (1 if self.tuning.angle_gain else 0)
        at_one += 1 if channel.identified is None and channel.damping_1_s == 0.0 else 0
        return zeros_outside((1.0 - 1.0 / z) ** at_one * self.characteristic)

    @property
    def open_loop(self) -> Complex:
        """``L``, broken at the plant's input."""
        return np.asarray(self.outer / self.inner)

    @cached_property
    def margins(self) -> LoopMargins:
        """Gain, phase and delay margins, up to half the sampling rate."""
        channel = self.points.channel
        hertz = self.points.theta / (2.0 * pi * channel.step)
        return loop_margins(self.open_loop, hertz, channel.step, channel.transport_samples * channel.step)

    @property
    def peak_sensitivity(self) -> float:
        """``max |S|`` over the model's misfit; infinite if that allows instability."""
        if self.points.unsure is None:
            return float(np.max(np.abs(self.inner / self.characteristic)))
        return 1.0 / self.distance if self.distance > 0.0 else inf

    @cached_property
    def distance(self) -> float:
        """Smallest distance to the critical point over the model's misfit; negative if it is inside."""
        unsure = 0.0 if self.points.unsure is None else self.points.unsure
        characteristic = np.abs(self.characteristic) - unsure * np.abs(self.outer)
        return float(np.min(characteristic / np.abs(self.inner)))

    @property
    def beyond_stability(self) -> float:
        """``max w |T| - 1``: above 0 the model's misfit allows instability."""
        unsure = 0.0 if self.points.unsure is None else self.points.unsure
        return float(np.max(unsure * np.abs(self.outer / self.characteristic))) - 1.0

    def compute_tolerance(self, delay: float, gain: float) -> float:
        """Return by what factor the tolerances could grow until a gain and delay inside put a pole on the unit circle.

        ``delay`` in samples, ``gain`` relative, either way.  ``1 + g e^(-j theta tau) L`` is 0 only where
        ``g = |1 / L|`` and ``tau = -arg(-1 / L) / theta``: every frequency has one pair that matters, and the
        loop keeps its number of unstable poles for all pairs in the box while none of these is inside.  Above 1 with
        a stable nominal loop: stable for every gain and delay in the box, the fractions between samples included.
        A misfit ``w`` of the model widens the box by what ``1 + x`` does to gain and phase.
        """
        critical, unsure = -self.inner / self.outer, self.points.unsure
        if unsure is None:
            x = (np.abs(critical) - 1.0) / max(gain, 1e-9)
            y = -np.angle(critical) / self.points.theta / max(delay, 1e-9)
        else:
            turn = np.where(unsure < 1.0, np.arcsin(np.minimum(unsure, 1.0)), pi)
            x = (np.abs(critical) - 1.0) / np.maximum(gain + unsure * (1.0 + gain), 1e-9)
            y = -np.angle(critical) / np.maximum(delay * self.points.theta + turn, 1e-9)
        return _least_maximum(x, y, np.angle(critical))

    @property
    def angle_response(self) -> Complex:
        """Frequency response from set-point to angle."""
        return np.asarray(self._error * self.tuning.angle_gain * self.points.angle / self.characteristic)

    @cached_property
    def space(self) -> Space:
        """Closed loop in state space."""
        return Space(self.points.channel, self.tuning)

    @cached_property
    def steps(self) -> Steps:
        """Unit steps of set-point and load over :data:`WINDOW_TIME_SCALES` times the channel's time scale, exactly."""
        channel = self.points.channel
        samples = ceil(window_s(channel) / channel.step)
        if self.tuning.firmware is not None or not self.tuning.has_space:
            return steps_by_response(channel, self.tuning, samples)
        return self.space.steps(samples)

    @property
    def command_response(self) -> Complex:
        """Frequency response from set-point to command."""
        return np.asarray(self._error * self.tuning.angle_gain / self.characteristic)

    @property
    def overshoot(self) -> float:
        """Overshoot of the angle as a fraction of the step."""
        return max(0.0, float(self.steps.angle.max()) - 1.0)

    @property
    def settling_s(self) -> float:
        """Time until the angle stays within 5 % of a step, s; NaN if that is not reached."""
        outside = np.flatnonzero(np.abs(1.0 - self.steps.angle) > 0.05)
        if len(outside) and outside[-1] == len(self.steps.angle) - 1:
            return nan
        return float(outside[-1] + 1) * self.points.channel.step if len(outside) else 0.0

    @property
    def step_error(self) -> float:
        """Integrated absolute error after a unit step of the set-point, over the window, rad s per rad."""
        return float(np.abs(1.0 - self.steps.angle).sum()) * self.points.channel.step

    @property
    def load_error(self) -> float:
        """Integrated absolute error of the angle after a unit step of load, rad s per unit of the command."""
        return float(np.abs(self.steps.load).sum()) * self.points.channel.step

    @property
    def load_left(self) -> float:
        """Steady angle per unit of load, rad; 0 with an integral.

        A state predictor whose observer knows of no disturbance takes one for a rate, and no integral removes that.
        """
        at_rest = float(self.load_response[0].real)
        # A final value below this fraction of the largest response counts as zero.
        negligible = 1e-3
        return at_rest if abs(at_rest) > negligible * float(np.abs(self.load_response).max()) else 0.0

    @cached_property
    def load_response(self) -> Complex:
        """Frequency response from a load at the plant's input to angle."""
        return np.asarray(self.points.angle * self.inner / self.characteristic)

    @property
    def step_peak(self) -> float:
        """Largest command after a unit step of the set-point, in the command's unit."""
        return float(np.abs(self.steps.command).max())

    @property
    def noise(self) -> float:
        """Standard deviation of the command that the sensors' noise causes, in the command's unit."""
        channel, points = self.points.channel, self.points
        of_rate = self._both * self._of_rate * points.measuring / self.characteristic
        of_angle = self._error * self.tuning.angle_gain / self.characteristic
        power = channel.rate_hold * (channel.rate_noise * np.abs(of_rate)) ** 2
        power += (channel.angle_noise * np.abs(of_angle)) ** 2
        return float(np.sqrt(np.trapezoid(power, points.theta) / pi))

    @property
    def bandwidth(self) -> float:
        """Frequency up to which the angle follows within 3 dB, Hz."""
        size = np.abs(self.angle_response)
        below = np.flatnonzero(size < 10.0 ** (-3.0 / 20.0))
        if not len(below) or below[0] == 0:
            return 0.0 if len(below) else inf
        k = int(below[0])
        theta = self.points.theta
        fraction = (10.0 ** (-3.0 / 20.0) - size[k - 1]) / (size[k] - size[k - 1])
        at = np.log(theta[k - 1]) + fraction * np.log(theta[k] / theta[k - 1])
        return float(np.exp(at) / (2.0 * pi * self.points.channel.step))


def steps_by_response(channel: Channel, tuning: Tuning, samples: int) -> Steps:
    """Compute unit steps from the loop's frequency response alone, for a predictor without a state space.

    ``h_k = r^k IFFT(H(r e^(j theta)))`` on a circle outside the unit circle: the pole at 1 of a step lies within it,
    and of what comes a period later, which is at least four times ``samples``, only :data:`MAX_WRAPPED` is left.
    """
    period = 4 << ceil(log2(samples))
    radius = MAX_WRAPPED ** (-1.0 / period)
    z = radius * np.exp(2j * pi / period * np.arange(period // 2 + 1))
    closed = ClosedLoop(FrequencyGrid(channel, z=z), tuning)
    grown = radius ** np.arange(samples)

    def to_time(response: Complex) -> Array:
        return np.asarray(np.fft.irfft(response / (1.0 - 1.0 / z), period)[:samples] * grown)

    return Steps(to_time(closed.angle_response), to_time(closed.command_response), to_time(closed.load_response))


def _least_maximum(x: Array, y: Array, angle: Array) -> float:
    """Return the least ``max(|x|, |y|)`` along the straight lines between points that follow each other.

    Where the angle behind ``y`` jumps by a turn there is no line.
    """
    dx, dy = np.diff(x), np.diff(y)
    joined = np.abs(np.diff(angle)) < pi
    # Minima are at the ends, where one of the two is 0, or where both are equal.
    pairs = ((-x[:-1], dx), (-y[:-1], dy), (y[:-1] - x[:-1], dx - dy), (-(x[:-1] + y[:-1]), dx + dy))
    least = float(np.min(np.maximum(np.abs(x), np.abs(y))))
    for numerator, denominator in pairs:
        at = np.clip(numerator / np.where(denominator == 0.0, 1.0, denominator), 0.0, 1.0)
        along = np.maximum(np.abs(x[:-1] + at * dx), np.abs(y[:-1] + at * dy))
        least = min(least, float(np.min(along[joined], initial=least)))
    return least
