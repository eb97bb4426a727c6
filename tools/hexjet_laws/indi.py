"""Incremental nonlinear dynamic inversion with an actuator model and a predictor.

The angular acceleration is measured, and only its increment is asked of the model: from where the actuators were when
it was measured, ``u_f``, to where they must be,

    u = u_f + (v - a_f) / k,   v = w (r - y_p),
    a_f = H(s) s y,  u_f = H(s) A(z) u,  H = w_f^2 / (s^2 + 1.1 w_f s + w_f^2)

with ``A`` the actuators (:class:`cosim.laws.Actuators`), so that both sides are late alike.  The rate that
``v`` corrects is predicted over the delay by the same increments: ``y_p = y + T sum_j (a_f + k (x_j - u_f))``, with
``x_j`` the actuators j steps ahead, which the commands on their way decide.

Sources: Smeur, Chu and de Croon, "Adaptive incremental nonlinear dynamic inversion for attitude control of micro air
vehicles", Journal of Guidance, Control, and Dynamics 39 (2016) (the law, ``H`` with its damping of 0.55, the filtered
actuator model).  The prediction by increments is ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, exp, sin, sqrt

from cosim.laws import Actuators, Axis, AxisLaw, RateLaw, attitude_gain_parameter, positive_parameter

DAMPING = 0.55  # damping ratio of the filter H


class SecondOrder:
    """Exact discretisation of the filter ``H`` with held input: its value and slope."""

    def __init__(self, natural: float, step: float) -> None:
        decay, turn = DAMPING * natural, natural * sqrt(1.0 - DAMPING * DAMPING)
        e, c, s = exp(-decay * step), cos(turn * step), sin(turn * step)
        # With x = (value - input, slope) the filter is x_k+1 = A x_k; these are the rows of A.
        self._a = (e * (c + decay / turn * s), e * s / turn)
        self._b = (-e * natural * natural / turn * s, e * (c - decay / turn * s))
        self.reset()

    def reset(self) -> None:
        self.value = self.slope = 0.0

    def update(self, value: float) -> None:
        error, slope = self.value - value, self.slope
        self.value = value + self._a[0] * error + self._a[1] * slope
        self.slope = self._b[0] * error + self._b[1] * slope


class IndiAxis:
    """INDI of one axis: ``gain`` in rad/s^2 per command, bandwidths in rad/s."""

    def __init__(self, gain: float, actuators: Actuators, speed: float, filter_speed: float, step: float) -> None:
        self._gain, self._actuators, self._speed, self._step = gain, actuators, speed, step
        self._of_rate, self._of_actuator = SecondOrder(filter_speed, step), SecondOrder(filter_speed, step)
        self.reset()

    def reset(self) -> None:
        self.predicted = 0.0
        for part in (self._actuators, self._of_rate, self._of_actuator):
            part.reset()

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        actuators, gain = self._actuators, self._gain
        self._of_rate.update(measured)
        self._of_actuator.update(actuators.update(applied))
        acceleration, actuator = self._of_rate.slope, self._of_actuator.value
        increment = actuators.samples * (acceleration - gain * actuator) + gain * actuators.upcoming_sum
        self.predicted = measured + self._step * increment
        demand = self._speed * (setpoint - self.predicted)
        return actuator + (demand - acceleration) / gain


class Indi(RateLaw):
    """INDI on every axis that engines answer."""

    parameters = (
        attitude_gain_parameter(0.2361),
        positive_parameter("speed", 0.5133, "gain of the rate's error [1/s] times theta"),
        positive_parameter("filter", 66.73, "natural frequency of the filter H [rad/s] times theta"),
    )

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis with its parameters in units of the axis."""
        theta = axis.delay
        return IndiAxis(
            axis.gain, Actuators.from_axis(axis), values["speed"] / theta, values["filter"] / theta, axis.step
        )
