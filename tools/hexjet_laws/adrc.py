"""Active disturbance rejection with a predictor: what is not the nominal integrator is estimated, predicted, cancelled.

The axis is taken for ``y' = f + k x``, ``x = A u`` the actuators (:class:`cosim.laws.Actuators`).  An
extended observer is told where they are, late as they are, so that what it calls a disturbance is one; its state is run
ahead over the delay with the commands on their way:

    y^ = y^ + T (f^ + k x),  then both corrected by y - y^ at the same instant, poles at exp(-w_o T)
    y_p = y^ + T (n f^ + k sum_j=1..n x_j),  u = (w_c (r - y_p) - f^) / k

Sources: Gao, "Scaling and bandwidth-parameterization based controller tuning", ACC 2003 (linear ADRC); Zhao and Gao,
"Modified active disturbance rejection control for time-delay systems", ISA Transactions 53 (2014) (the observer told
the late command); Zheng and Gao, "Predictive active disturbance rejection control for processes with time delay", the
same volume (the predictor).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp

from cosim.laws import Actuators, Axis, AxisLaw, RateLaw, attitude_gain_parameter, positive_parameter


class AdrcAxis:
    """ADRC of one axis: ``gain`` in rad/s^2 per command, bandwidths of loop and observer in rad/s."""

    def __init__(self, gain: float, actuators: Actuators, speed: float, observer: float, step: float) -> None:
        self._gain, self._actuators, self._speed, self._step = gain, actuators, speed, step
        pole = exp(-observer * step)
        self.correct = (1.0 - pole * pole, (1.0 - pole) ** 2 / step)
        self.reset()

    def reset(self) -> None:
        self._actuators.reset()
        self.rate = self.disturbance = self.predicted = 0.0

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        actuators, gain, step = self._actuators, self._gain, self._step
        rate = self.rate + step * (self.disturbance + gain * actuators.update(applied))
        error = measured - rate
        of_rate, of_disturbance = self.correct
        self.rate = rate + of_rate * error
        self.disturbance += of_disturbance * error
        self.predicted = self.rate + step * (actuators.samples * self.disturbance + gain * actuators.upcoming_sum)
        return (self._speed * (setpoint - self.predicted) - self.disturbance) / gain


class Adrc(RateLaw):
    """Predictive linear ADRC on every axis that engines answer."""

    parameters = (
        attitude_gain_parameter(0.3636),
        positive_parameter("speed", 27.38, "bandwidth of the rate loop [rad/s] times theta"),
        positive_parameter("observer", 0.3056, "bandwidth of the observer [rad/s] times theta"),
    )

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis with its parameters in units of the axis."""
        theta = axis.delay
        return AdrcAxis(
            axis.gain, Actuators.from_axis(axis), values["speed"] / theta, values["observer"] / theta, axis.step
        )
