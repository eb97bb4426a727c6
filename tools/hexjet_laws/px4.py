"""PX4's multicopter loops: rate PID with feed-forward, and the reference model that feeds the attitude loop forward.

    u = P (r - y) + integral I f (r - y) - D a + FF r,   f = max(0, 1 - ((r - y) / 400 deg/s)^2)
    r = r_attitude + F(s) d/dt(attitude set-point),      F = w^2 / (s + w)^2

``a``: angular acceleration behind a low-pass of second order, 30 Hz (Butterworth), as PX4 ships it.  The integral stops
where the allocation is at its limit and the error asks for more.  Here the rate of the attitude set-point is made of
what a rate loop is told: the set-point ``r`` is ``K`` times the attitude's error, so it is ``d/dt(r / K) + y``.

Source: PX4 Autopilot (BSD-3-Clause), documented at docs.px4.io, "Controller Diagrams" and "Multicopter PID Tuning";
its classes RateControl, AttitudeControl and SecondOrderReferenceModel were read for the equations, not copied.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, exp, inf, pi, radians, sqrt, tan

from cosim.laws import Axis, AxisLaw, RateLaw, attitude_gain_parameter, clamp, positive_parameter

MAX_INTEGRATED_ERROR = radians(400.0)  # rad/s, without integration above it


class LowPass:
    """Second-order Butterworth low-pass by the bilinear transform, with its corner frequency kept."""

    def __init__(self, hertz: float, step: float) -> None:
        w = tan(pi * min(hertz * step, 0.45))
        denominator = 1.0 + 2.0 * cos(pi / 4.0) * w + w * w
        self._b = w * w / denominator
        self._a1 = 2.0 * (w * w - 1.0) / denominator
        self._a2 = (1.0 - sqrt(2.0) * w + w * w) / denominator
        self.reset()

    def reset(self) -> None:
        self._s1 = self._s2 = 0.0

    def update(self, value: float) -> float:
        s0 = value - self._a1 * self._s1 - self._a2 * self._s2
        answer = self._b * (s0 + 2.0 * self._s1 + self._s2)
        self._s2, self._s1 = self._s1, s0
        return answer


class Px4Axis:
    """PX4's rate controller of one axis with gains per step; ``reference`` [rad/s]; ``attitude``: outer gain [1/s]."""

    def __init__(
        self, p: float, i: float, d: float, forward: float, reference: float, attitude: float, limit: float, step: float
    ) -> None:
        self._p, self._i, self._d, self._forward = p, i * step, d / step, forward
        self._keep, self._per_step, self._limit = exp(-reference * step), 1.0 / (attitude * step), limit
        self._step, self._low_pass = step, LowPass(30.0, step)  # 30 Hz: default of IMU_DGYRO_CUTOFF
        self.reset()

    def reset(self) -> None:
        self._integral = self._command = self._once = self._twice = self._setpoint = 0.0
        self._rate: float | None = None
        self._low_pass.reset()

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        keep = self._keep
        turning = (setpoint - self._setpoint) * self._per_step + measured  # rate of the attitude set-point
        self._once = keep * self._once + (1.0 - keep) * turning
        self._twice = keep * self._twice + (1.0 - keep) * self._once
        self._setpoint = setpoint
        demand = setpoint + self._twice
        slope = self._low_pass.update(measured - (measured if self._rate is None else self._rate))
        self._rate = measured
        error, residual = demand - measured, self._command - applied
        self._command = self._p * error + self._integral - self._d * slope + self._forward * demand
        if residual * error <= 0.0:
            factor = max(0.0, 1.0 - (error / MAX_INTEGRATED_ERROR) ** 2)
            self._integral = clamp(self._integral + factor * self._i * error, self._limit)
        return self._command


class Px4(RateLaw):
    """PX4's rate controller on every axis that engines answer."""

    parameters = (
        attitude_gain_parameter(0.241),
        positive_parameter("p", 0.704, "MC_ROLLRATE_P times k theta"),
        positive_parameter("i", 0.1931, "MC_ROLLRATE_I over P [1/s], times theta", 0.0),
        positive_parameter("d", 0.4921, "MC_ROLLRATE_D over P [s], over theta", 0.0),
        positive_parameter("forward", 1.135e-4, "MC_ROLLRATE_FF times k theta", 0.0),
        positive_parameter("reference", 1.157e-3, "natural frequency of the reference model [rad/s] times theta"),
    )

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis with its parameters in units of the axis."""
        unit, theta = 1.0 / (axis.gain * axis.delay), axis.delay
        p = values["p"] * unit
        limit = getattr(axis.belief.vehicle.control.rate, axis.name).integral_limit
        return Px4Axis(
            p,
            p * values["i"] / theta,
            p * values["d"] * theta,
            values["forward"] * unit,
            values["reference"] / theta,
            values["angle"] / theta,
            limit if limit > 0.0 else inf,
            axis.step,
        )
