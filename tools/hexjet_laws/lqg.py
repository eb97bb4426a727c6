"""LQG with the delay in the model: a regulator of all states, commands on their way among them, and a Kalman filter.

    xi = (x, u_k-n, ..., u_k-1),  x' = A x + B (u_k-n + d),  y = C x
    u = -K xi + N r - d^,         K least sum (y - r)^2 + rho u^2,   N so that y = r at rest

``d`` is a disturbance of the input, a random walk; the filter estimates it with ``x`` and the regulator takes it off.
The commands on their way are known, so the filter has ``x`` and ``d`` alone.  Both gains are steady-state solutions of
Riccati's equation.  Weights are stated by what they come to on an integrator, ``y' = k u``: the regulator's pole is at
``k / sqrt(rho)``, the filter's poles at ``(k^2 q / r)^(1/4)`` with ``q`` and ``r`` the intensities of walk and noise.

Sources: Astrom and Wittenmark, "Computer-Controlled Systems", 3rd edition (1997), chapters 3 (a delay as states) and 11
(LQG); Franklin, Powell and Workman, "Digital Control of Dynamic Systems" (disturbance estimated and taken off).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cosim.laws import Array, Axis, AxisLaw, RateLaw, RateModel, attitude_gain_parameter, cascade, positive_parameter


def add_delay(A: Array, B: Array, samples: int) -> tuple[Array, Array]:
    """Return a model with ``samples`` commands in transport as further states, the oldest first."""
    n = len(A)
    augmented = np.zeros((n + samples, n + samples))
    augmented[:n, :n] = A
    if not samples:
        return augmented, B.copy()
    augmented[:n, n] = B
    augmented[n:-1, n + 1 :] = np.eye(samples - 1)
    return augmented, np.eye(n + samples)[:, -1]


def regulator(A: Array, B: Array, C: Array, rho: float) -> tuple[Array, float]:
    """Return gain ``K``, which minimises ``sum y^2 + rho u^2``, and ``N``, which makes ``y`` the set-point at rest."""
    from scipy.linalg import solve_discrete_are

    b = B[:, None]
    P = solve_discrete_are(A, b, np.outer(C, C), np.array([[rho]]))
    K = np.linalg.solve(b.T @ P @ b + rho, b.T @ P @ A)[0]
    return K, float(1.0 / (C @ np.linalg.solve(np.eye(len(A)) - A + np.outer(B, K), B)))


class KalmanFilter:
    """Steady-state Kalman filter of a model with a random walk ``d`` as disturbance of its input.

    ``walk``: the walk's variance over that of the noise."""

    def __init__(self, A: Array, B: Array, C: Array, walk: float) -> None:
        from scipy.linalg import solve_discrete_are

        n = len(A)
        F = np.eye(n + 1)
        F[:n, :n], F[:n, n] = A, B
        H = np.append(C, 0.0)
        Q = np.zeros((n + 1, n + 1))
        Q[n, n] = walk
        P = solve_discrete_are(F.T, H[:, None], Q, np.array([[1.0]]))
        self.gain: Array = P @ H / (H @ P @ H + 1.0)
        self.F, self.H, self._B = F, H, np.append(B, 0.0)
        self.reset()

    def reset(self) -> None:
        self.state: Array = np.zeros(len(self.F))

    def update(self, measured: float, arrives: float) -> Array:
        """Return the estimated states and disturbance, given a measurement and the command that acted before it."""
        predicted = self.F @ self.state + self._B * arrives
        self.state = predicted + self.gain * (measured - self.H @ predicted)
        return self.state


def discrete_model(axis: Axis) -> tuple[Array, Array, Array, int]:
    """Return the discrete model of an axis, and its delay rounded to whole steps."""
    model: RateModel = axis.model
    return *cascade(model), round(model.delay_samples)


def kalman_filter(axis: Axis, observer: float) -> KalmanFilter:
    """Return the Kalman filter of an axis whose bandwidth is ``observer`` [rad/s]."""
    A, B, C, _ = discrete_model(axis)
    return KalmanFilter(A, B, C, (observer**4 * axis.step**2) / axis.gain**2)


class LqgAxis:
    """LQG of one axis: ``speed`` and ``observer`` are the bandwidths of regulator and filter [rad/s]."""

    def __init__(self, axis: Axis, speed: float, observer: float) -> None:
        A, B, C, samples = discrete_model(axis)
        self._filter = kalman_filter(axis, observer)
        self.gain, self.forward = regulator(*add_delay(A, B, samples), np.append(C, np.zeros(samples)),
                                            (axis.gain / speed) ** 2)  # fmt: skip
        self._of_state, self._of_sent = self.gain[: len(A)], self.gain[len(A) :]
        self._of_disturbance = 1.0 + float(self._of_sent.sum())
        self._samples = samples
        self.reset()

    def reset(self) -> None:
        self._filter.reset()
        self._sent: Array = np.zeros(self._samples + 1)  # commands in transport, oldest first

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        sent = self._sent
        sent[:-1] = sent[1:]
        sent[-1] = applied
        state = self._filter.update(measured, float(sent[0]))
        answer = self.forward * setpoint - self._of_state @ state[:-1] - self._of_sent @ sent[1:]
        return float(answer - self._of_disturbance * state[-1])


class Lqg(RateLaw):
    """LQG on every axis that engines answer."""

    parameters = (
        attitude_gain_parameter(0.348),
        positive_parameter("speed", 34.13, "bandwidth of the regulator k / sqrt(rho) [rad/s] times theta"),
        positive_parameter("observer", 0.3128, "bandwidth of the Kalman filter [rad/s] times theta"),
    )

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis with its parameters in units of the axis."""
        theta = axis.delay
        return LqgAxis(axis, values["speed"] / theta, values["observer"] / theta)
