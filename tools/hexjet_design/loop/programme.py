"""The convex programme of a limit of performance: the least error after a load within bounds.

:mod:`hexjet_design.loop.limit` has it for a channel of a vehicle, :mod:`hexjet_design.load_limit` for a fraction.  This
module knows neither.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from importlib.util import find_spec
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import qr, solve_triangular
from scipy.signal import lfilter

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError

KNOTS_PER_DELAY = 3.25  # spline knots within the plant's delay
UNIFORM_DELAYS = 24  # delays with uniform knots
KNOT_GROWTH, MAX_KNOT_RATIO = 1.08, 8.0  # ratio of knot distances; its limit
FREQUENCY_COUNT = 620  # of the sensitivity's grid
MAX_PEAK_FACTOR = 2.0  # factor on the peak if delay is off


class Bounds(NamedTuple):
    """Bounds on a controller, for example those of another loop."""

    peak_sensitivity: float
    noise: float  # standard deviation of the command
    step_error: float  # integrated |error| after a unit step
    delay_error: float = 0.0  # samples, either way; 0: not required


def need_solver() -> None:
    """Raise InputError where Clarabel is not installed."""
    if find_spec("clarabel") is None:
        raise InputError("the limit of performance needs Clarabel, which is not installed: pip install clarabel")


class InvertedPlant(ABC):
    """A plant ``q^late kept inverted / denominator``, and the length of its time responses."""

    name: str
    step: float
    samples: int
    length: int  # samples of the response t
    late: int
    rate_late: int = 0
    kept: Array  # zeros that cannot be inverted, 1 at rest
    inverted: Array
    denominator: Array
    is_double: bool  # True: integrates a load twice

    @abstractmethod
    def angle_of_load(self, acts: Array, late: int = 0) -> Array:
        """Return the angle after a unit step of load through the response ``acts``, ``late`` samples late."""

    def angle_of_setpoint(self, y: Array) -> Array:
        """Return the angle after a unit step of the set-point."""
        raise NotImplementedError

    @abstractmethod
    def noise_responses(self, t: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return the command's responses to scaled impulses of noise: gyro by ``t``, gyro by ``y``, and angle."""

    def keep(self, basis: Array) -> Array:
        """Return a basis filtered by the zeros that cannot be inverted, cut to the length of responses."""
        missing = self.length - len(basis)
        return np.asarray(lfilter(self.kept, [1.0], np.pad(basis, ((0, missing), (0, 0))), axis=0))

    def to_command(self, response: Array) -> Array:
        """Return ``a / b`` of columns of responses."""
        return np.asarray(lfilter(self.denominator, self.inverted, response, axis=0))

    def delayed(self, response: Array, samples: int) -> Array:
        """Return a response delayed by ``samples``, cut at the end of the window."""
        late = np.zeros((self.samples, *response.shape[1:]))
        inside = response[: max(self.samples - samples, 0)]
        late[samples : samples + len(inside)] = inside
        return late


class Cone(NamedTuple):
    """Rows ``b - A x`` of a programme that lie in a cone: ``zero``, ``nonnegative`` or ``second-order``."""

    kind: str
    matrix: Any  # a sparse matrix
    offset: Array


class Programme:
    """The convex programme: coefficients of ``t`` and ``y``, and bounds on the absolute errors in time.

    No basis of ``y`` leaves the answer to a set-point out.

    minimise sum w e  subject to  |angle after load| <= e,  |1 - angle after a step| <= f,  sum w f <= step error,
    |noise| <= bound,  |1 - T_i| <= M at every frequency, or the same with a tolerance of the delay.
    """

    def __init__(
        self,
        plant: InvertedPlant,
        bounds: Bounds,
        basis: tuple[Array, Array | None] | None = None,
        frequencies: int = FREQUENCY_COUNT,
    ) -> None:
        self.plant, self.bounds, self.frequencies = plant, bounds, frequencies
        if plant.late * plant.step >= bounds.step_error:
            raise InputError(f"{plant.name}: no controller has a step error below the delay itself")
        of_t, of_y = basis or (splines(plant),) * 2
        self.of_t = plant.keep(of_t)
        self.of_y = self.of_t[:, :0] if of_y is None else self.of_t if of_y is of_t else plant.keep(of_y)
        step = max(1, plant.late // 6)
        near = np.arange(plant.late, min(10 * plant.late, plant.samples), max(1, step // 2))
        self.times = np.r_[near, np.arange(near[-1] + step, plant.samples, step)]
        self.weights = np.gradient(self.times.astype(float)) * plant.step
        self.tolerant = bounds.delay_error > 0.0

    @cached_property
    def _theta_grid(self) -> Array:
        return np.geomspace(2e-3, pi, self.frequencies)

    def _rows(self, t: Any = None, y: Any = None, load: Any = None, step: Any = None, sizes: Any = None) -> Any:
        """Return rows of the matrix from the blocks that they have; ``sizes`` are bounds on |S| and |T_i|, if any."""
        blocks = [t, y, load, step, *([sizes] if self.tolerant else [])]
        steps = len(self.times) if self.of_y.size else 0
        widths = [self.of_t.shape[1], self.of_y.shape[1], len(self.times), steps, 2 * self.frequencies]
        height = next(block.shape[0] for block in blocks if block is not None)
        return sparse.hstack(
            [
                sparse.csr_matrix((height, width)) if block is None else sparse.csr_matrix(block)
                for block, width in zip(blocks, widths, strict=False)
            ]
        )

    def solve(self, exact: float = 1e-6) -> tuple[Array, Array]:
        """Return the optimal responses ``t`` and ``y``.  Raises InputError if infeasible or not solved.

        ``exact``: share of the least within which it is shown to be it; rounding allows 1e-7 for slow poles.
        """
        import clarabel

        cones = [*self._rest_cones(), *self._error_cones(), self._noise_cone(), *self._sensitivity_cones()]
        kinds = {
            "zero": clarabel.ZeroConeT,
            "nonnegative": clarabel.NonnegativeConeT,
            "second-order": clarabel.SecondOrderConeT,
        }
        count, first = self.of_t.shape[1], self.of_t.shape[1] + self.of_y.shape[1]
        columns = sparse.vstack([cone.matrix for cone in cones]).tocsc()
        offset = np.concatenate([cone.offset for cone in cones])
        of_t, offset, to_t = _orthonormalise(columns[:, :count].toarray(), offset)
        of_y, offset, to_y = _orthonormalise(columns[:, count:first].toarray(), offset)
        matrix = sparse.hstack([of_t, of_y, columns[:, first:]]).tocsc()
        width = matrix.shape[1]
        cost = np.zeros(width)
        cost[first : first + len(self.times)] = self.weights
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = exact
        solution = clarabel.DefaultSolver(
            sparse.csc_matrix((width, width)), cost, matrix, offset,
            [kinds[cone.kind](len(cone.offset)) for cone in cones], settings,
        ).solve()  # fmt: skip
        if str(solution.status) != "Solved":
            raise InputError(f"{self.plant.name}: {_explain_no_optimum(self.bounds, str(solution.status))}")
        x = np.array(solution.x)
        return self.of_t @ to_t(x[:count]), self.of_y @ to_y(x[count:first])

    def _rest_cones(self) -> list[Cone]:
        """Return the constraint at rest: ``t`` and ``y`` are 1; with a rate pole at 1, ``T_i`` has zero slope."""
        cones = [Cone("zero", self._rows(t=self.of_t.sum(0)[None]), np.ones(1))]
        if self.of_y.size:
            cones.append(Cone("zero", self._rows(y=self.of_y.sum(0)[None]), np.ones(1)))
        if self.plant.is_double:
            late = self.plant.late + self.plant.rate_late
            moments = ((np.arange(len(self.of_t)) + late) @ self.of_t)[None]
            cones.append(Cone("zero", self._rows(t=moments / late), np.zeros(1)))
        return cones

    def _error_cones(self) -> list[Cone]:
        plant, identity = self.plant, -sparse.identity(len(self.times), format="csr")
        free, load = plant.angle_of_load(np.ones(1)), plant.angle_of_load(self.of_t, plant.late + plant.rate_late)
        # The response to a load before any control can act.
        scale = abs(float(free[2 * plant.late + 1]))
        load, free = load[self.times] / scale, free[self.times] / scale
        cones = [
            Cone("nonnegative", self._rows(t=-load, load=identity), -free),
            Cone("nonnegative", self._rows(t=load, load=identity), free),
        ]
        if not self.of_y.size:
            return cones
        step = plant.angle_of_setpoint(self.of_y)[self.times]
        before = plant.late * plant.step
        return [
            *cones,
            Cone("nonnegative", self._rows(y=-step, step=identity), -np.ones(len(self.times))),
            Cone("nonnegative", self._rows(y=step, step=identity), np.ones(len(self.times))),
            Cone("nonnegative", self._rows(step=self.weights[None]), np.array([self.bounds.step_error - before])),
        ]

    def _noise_cone(self) -> Cone:
        by_t, by_y, of_angle = self.plant.noise_responses(self.of_t, self.of_y)
        stacked = np.vstack([np.hstack([by_t, by_y]), np.hstack([np.zeros((len(of_angle), by_t.shape[1])), of_angle])])
        root: Array = np.asarray(np.linalg.qr(stacked, mode="r")) / self.bounds.noise
        rows = np.vstack([np.zeros(root.shape[1]), -root])
        return Cone(
            "second-order", self._rows(t=rows[:, : by_t.shape[1]], y=rows[:, by_t.shape[1] :]), np.eye(len(rows))[0]
        )

    def _sensitivity_cones(self) -> list[Cone]:
        late = self.plant.late + self.plant.rate_late
        responses: Complex = np.exp(-1j * np.outer(self._theta_grid, np.arange(len(self.of_t)) + late)) @ self.of_t
        peak = self.bounds.peak_sensitivity
        if not self.tolerant:
            return [
                Cone("second-order", self._rows(t=_plane(response)), np.array([peak, 1.0, 0.0]))
                for response in responses
            ]
        count = self.frequencies
        identity, ones = sparse.identity(count, format="csr"), np.ones(count)
        turned = 2.0 * np.sin(0.5 * np.minimum(self._theta_grid * self.bounds.delay_error, pi))
        nothing = sparse.csr_matrix((count, count))
        both = sparse.hstack([identity, sparse.diags(MAX_PEAK_FACTOR * peak * turned)])
        cones = [
            Cone("nonnegative", self._rows(sizes=sparse.hstack([identity, nothing])), peak * ones),
            Cone("nonnegative", self._rows(sizes=both), MAX_PEAK_FACTOR * peak * ones),
        ]
        for k, response in enumerate(responses):
            for offset, index in ((1.0, k), (0.0, count + k)):
                size = sparse.csr_matrix(([-1.0], ([0], [index])), shape=(3, 2 * count))
                cones.append(
                    Cone("second-order", self._rows(t=_plane(response), sizes=size), np.array([0.0, offset, 0.0]))
                )
        return cones


def _explain_no_optimum(bounds: Bounds, status: str) -> str:
    """Return why a programme has no solution, by the status of the solver: infeasible, or not solved."""
    kept = f"a peak sensitivity of at most {bounds.peak_sensitivity:.3g}"
    kept += f", noise {bounds.noise:.3g}" if bounds.noise < inf else ""
    kept += f" and step error {bounds.step_error:.3g}" if bounds.step_error < inf else ""
    if "Infeasible" in status:
        return f"no linear controller was found with {kept}"
    return f"the limit with {kept} is not known: the solver stopped before it was found: {status}"


def _orthonormalise(columns: Array, offset: Array) -> tuple[Any, Array, Callable[[Array], Array]]:
    """Return orthonormal columns (QR), the offset outside them, and a function that maps solutions back.

    Splines behind two integrals have errors of 1e7 that cancel, with which the solver stops too early.
    """
    orthonormal, root = np.linalg.qr(columns)
    nearest = orthonormal.T @ offset
    return (
        sparse.csc_matrix(np.where(np.any(columns, axis=1, keepdims=True), orthonormal, 0.0)),
        offset - orthonormal @ nearest,
        lambda x: np.asarray(solve_triangular(root, nearest + x)),
    )


def _plane(response: Complex) -> Array:
    """Return three rows: zeros, the real part and the imaginary part of a response."""
    return np.vstack([np.zeros(len(response)), response.real, response.imag])


def splines(plant: InvertedPlant) -> Array:
    """Return cubic splines over samples, a column each: close to each other at the start, wider apart later."""
    samples, late = plant.length - len(plant.kept) + 1, plant.late
    distance = max(1.0, round(late / KNOTS_PER_DELAY))
    knots = [*np.arange(0.0, min(samples, UNIFORM_DELAYS * late) + 1.0, distance)]
    apart = distance
    while knots[-1] < samples:
        apart = min(apart * KNOT_GROWTH, MAX_KNOT_RATIO * distance)
        knots.append(min(float(samples), knots[-1] + apart))
    degree = 3  # degree of the splines
    clamped = np.r_[[0.0] * degree, knots, [knots[-1]] * degree]
    found = np.asarray(BSpline.design_matrix(np.arange(samples, dtype=float), clamped, degree).toarray())
    # With a knot in every sample some splines are sums of others there.
    root, order = qr(found, mode="r", pivoting=True)
    own = np.abs(np.diagonal(root)) > 1e-3 * abs(root[0, 0])
    return np.asarray(found[:, np.sort(order[: len(own)][own])])
