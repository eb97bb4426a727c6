"""Linear model predictive control: the delay as states, the command within what the throttles can give.

    least  sum_j=1..N (y_k+n+j - r)^2 + lambda sum (change of u)^2   within   -room <= u <= room

over the next commands, the first that still can be chosen; those on their way are in the prediction.  Commands are
kept for ever longer blocks of steps, the horizon ``N`` is twice ``theta``.  State and disturbance come from the Kalman
filter of :mod:`hexjet_laws.lqg`.  While the unconstrained optimum is within the limits it is the optimum, and
the law is linear; else OSQP solves the quadratic programme.

``lambda = k^2 / (w^4 T^2)``: on an integrator it puts the loop's poles at ``w``.

Sources: Maciejowski, "Predictive Control with Constraints" (2002), chapters 2 and 3; Pannocchia and Rawlings,
"Disturbance models for offset-free model-predictive control", AIChE Journal 49 (2003); Stellato et al., "OSQP: an
operator splitting solver for quadratic programs", Mathematical Programming Computation 12 (2020).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cosim import FlightError, InputError
from cosim.laws import Array, Axis, AxisLaw, RateLaw, attitude_gain_parameter, positive_parameter
from hexjet_laws.lqg import discrete_model, kalman_filter

BLOCK_STEPS = (1, 1, 1, 2, 2, 3, 4, 6, 8, 12)  # steps that each planned command lasts


def osqp() -> Any:
    """Return the module of the solver OSQP.  Raises InputError if it is not installed."""
    try:
        import osqp
    except ImportError:
        raise InputError("mpc needs the package osqp: pip install osqp") from None
    return osqp


class MpcAxis:
    """MPC of one axis, whose command is limited to ``-room`` and ``room``."""

    def __init__(self, axis: Axis, speed: float, observer: float, room: float) -> None:
        A, B, C, samples = discrete_model(axis)
        self._filter, self._room, self._samples = kalman_filter(axis, observer), room, samples
        horizon, moves, n = round(2.0 * axis.delay / axis.step), len(BLOCK_STEPS), len(A)
        weight = axis.gain**2 / (speed**4 * axis.step**2)
        # These predict the state at which the next command acts, from the present state and the commands in transport.
        powers = [np.eye(n)]
        for _ in range(max(samples, horizon)):
            powers.append(A @ powers[-1])
        self._of_state = powers[samples]
        self._of_sent = np.stack([powers[samples - 1 - i] @ B for i in range(samples)], axis=1)
        # These are the responses of y to a unit command, step by step.
        responses = np.array([C @ power @ B for power in powers[:horizon]])
        block = np.minimum(np.searchsorted(np.cumsum(BLOCK_STEPS), np.arange(horizon), side="right"), moves - 1)
        forced_response = np.zeros((horizon, moves))
        for j in range(horizon):
            for m in range(j + 1):
                forced_response[j, block[m]] += responses[j - m]
        free_response = np.stack([C @ power for power in powers[1 : horizon + 1]])
        change = np.eye(moves) - np.eye(moves, k=-1)
        self.hessian: Array = forced_response.T @ forced_response + weight * change.T @ change
        last = weight * change.T @ np.eye(moves)[:, 0]
        # The cost's gradient is of_arrival arrival - of_setpoint r - of_last u_k-1, with these factors.
        self._gradient = (forced_response.T @ free_response, forced_response.T @ np.ones(horizon), last)
        self._solution = -np.linalg.inv(self.hessian)
        self._osqp = osqp()
        self.reset()

    def reset(self) -> None:
        self._filter.reset()
        self._sent: Array = np.zeros(self._samples + 1)  # commands in transport, oldest first
        self._solver: Any = None  # anew: it starts at its last solution

    def update(self, setpoint: float, measured: float, applied: float) -> float:
        sent = self._sent
        sent[:-1] = sent[1:]
        sent[-1] = applied
        state = self._filter.update(measured, float(sent[0]))
        disturbance = float(state[-1])
        arrival = self._of_state @ state[:-1] + self._of_sent @ (sent[1:] + disturbance)
        of_arrival, of_setpoint, of_last = self._gradient
        gradient = of_arrival @ arrival - of_setpoint * setpoint - of_last * (applied + disturbance)
        plan = self._solution @ gradient  # commands, disturbance included
        if np.abs(plan - disturbance).max() > self._room:
            plan = self.solve_bounded(gradient, disturbance)
        return float(plan[0]) - disturbance

    def solve_bounded(self, gradient: Array, disturbance: float) -> Array:
        """Return the planned commands within the limits.  Raises FlightError if the solver finds none."""
        from scipy.sparse import csc_matrix

        moves = len(gradient)
        low, high = np.full(moves, disturbance - self._room), np.full(moves, disturbance + self._room)
        # The programme is scaled by its largest curvature, which is 1e-3 or less otherwise.
        size = float(np.abs(self.hessian).max())
        if self._solver is None:
            self._solver = self._osqp.OSQP()
            # OSQP would adapt its step lengths by the clock, which makes flights irreproducible.
            self._solver.setup(
                csc_matrix(np.triu(self.hessian / size)), gradient / size, csc_matrix(np.eye(moves)), low, high,
                eps_abs=1e-9, eps_rel=1e-9, adaptive_rho=False, rho=1.0, max_iter=20000,
                polishing=True, verbose=False,
            )  # fmt: skip
        else:
            self._solver.update(q=gradient / size, l=low, u=high)
        solution = self._solver.solve(raise_error=False)
        if solution.info.status not in ("solved", "solved inaccurate"):
            raise FlightError(f"OSQP: {solution.info.status} after {solution.info.iter} rounds")
        plan: Array = np.clip(solution.x, low, high)
        return plan


class Mpc(RateLaw):
    """Model predictive control on every axis that engines answer."""

    parameters = (
        attitude_gain_parameter(0.3438),
        positive_parameter("speed", 32.12, "bandwidth that the weight on changes comes to [rad/s], times theta"),
        positive_parameter("observer", 0.3262, "bandwidth of the Kalman filter [rad/s] times theta"),
    )

    def make_axis_law(self, axis: Axis, values: Mapping[str, float]) -> AxisLaw:
        """Return the law of one axis; its range is what hover leaves of the throttles."""
        theta, limits, hover = axis.delay, axis.belief.vehicle.control.allocation, axis.belief.hover
        room = min(hover - limits.throttle_min, limits.throttle_max - hover)
        return MpcAxis(axis, values["speed"] / theta, values["observer"] / theta, room)
