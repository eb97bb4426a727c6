"""The limit of performance: the least error after a load that any stabilising linear controller leaves on a channel.

The controller measures rate and angle.  With ``q = 1 / z`` and ``H`` from command to rate, every loop that it can make
is stable and is made by two finite responses ``t`` and ``y`` (the affine parametrisation of D. C. Youla, H. A. Jabr and
J. J. Bongiorno, IEEE Trans. Automatic Control 21 (1976) 319-338, here for a plant that can be inverted behind its
delay of ``N`` steps):

    H = q^N b(q) / a(q),  G = H T/2 (1 + q) / (1 - q)          to the angle; T the step
    T_i = q^(N + l) t                                          complementary sensitivity at the plant's input
    angle / set-point = q^(N + s) (1 + q) / 2 y,  angle / load = G (1 - T_i)
    command / set-point = a / b (1 - q) / T y,  command / gyro noise = -a / b (t - q^(m + s - l) (1 + q) / 2 y)

``l`` and ``m`` are the steps by which rate and angle are measured late, ``s = max(l - m, 0)``; zeros of ``b`` on or
outside the unit circle stay in ``t`` and ``y``.  At rest both are 1, and where the rate has a pole at 1 the ramp that
``T_i`` follows is exact too.  The set-point enters where the angle is measured (one degree of freedom).

Errors in time, noise, and the sensitivity at each frequency are convex in ``t`` and ``y`` (S. Boyd and C. Barratt,
Linear Controller Design: Limits of Performance, 1991), which are cubic splines in time.  A coarser spline can only miss
the least from above.  So that the optimum is no fragile one, an error ``|e| <= E`` of the delay may be held too:

    |S| + 2 M w |T_i| <= 2 M,   w = max |1 - exp(-j theta e)|   sufficient for a peak below 2 M at every such delay

which is a little pessimistic: what it finds is then at most too high.  Clarabel solves it (Goulart and Chen, 2024).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from math import pi
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular
from scipy.signal import lfilter

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from hexjet_design.loop.channel import Channel
from hexjet_design.loop.closed_loop import ClosedLoop, window_s
from hexjet_design.loop.optimal import CIRCLE_TOLERANCE, polynomial

KNOTS_A_DELAY = 3.25  # spline knots within the plant's delay
EVEN_DELAYS = 24  # delays with even knots, then sparser
KNOT_GROWTH, FARTHEST = 1.08, 8.0  # ratio of knot distances; its limit
FREQUENCY_COUNT = 620  # of the sensitivity, evenly in log
PRICE_STEP = 0.1  # fraction by which a bound is relaxed
MAX_PEAK_FACTOR = 2.0  # on the peak with an error of the delay
PRICE_WORDS = {  # words for relaxing each bound
    "peak_sensitivity": "more peak sensitivity",
    "noise": "more noise",
    "step_error": "more step error",
    "delay_error": "less tolerance of the delay",
}
HINT = "pip install clarabel"  # how to install the solver


class Bounds(NamedTuple):
    """Bounds on a controller, for example those of another loop."""

    peak_sensitivity: float
    noise: float  # standard deviation of the command
    step_error: float  # integrated |error| after a unit step
    delay_error: float = 0.0  # samples, either way; 0: not required


@dataclass(frozen=True)
class Limit:
    """Smallest error after a load, and the closed loop that achieves it, computed exactly."""

    bounds: Bounds
    load_error: float  # rad s per unit of the command
    step_error: float
    noise: float
    peak_sensitivity: float
    complementary: Array  # impulse response of T, per sample
    setpoint: Array  # response to the set-point, per sample
    window_s: float  # s over which errors are integrated


@dataclass(frozen=True)
class AxisLimit:
    """A closed loop compared with the best linear controller within the same bounds."""

    load_error: float  # of the designed loop
    least: Limit
    tolerant: Limit | None  # limit with the loop's delay tolerance
    prices: Mapping[str, float] = field(default_factory=dict)  # of each bound; empty: not requested

    @property
    def times(self) -> float:
        """The loop's load error by the least."""
        return self.load_error / self.least.load_error

    @property
    def times_tolerant(self) -> float | None:
        """Ratio to the best loop with the same tolerance: at least this, because the condition is sufficient."""
        return None if self.tolerant is None else self.load_error / self.tolerant.load_error

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers, for JSON."""
        bounds = (self.tolerant or self.least).bounds
        return {
            "load_error": self.load_error,
            "least": self.least.load_error,
            "times": self.times,
            "least_as_tolerant": None if self.tolerant is None else self.tolerant.load_error,
            "times_as_tolerant": self.times_tolerant,
            "prices": dict(self.prices),
            "delay_error_samples": bounds.delay_error,
            "peak_sensitivity": bounds.peak_sensitivity,
            "noise": bounds.noise,
            "step_error": bounds.step_error,
        }

    def describe(self) -> str:
        """Return the comparison in words."""
        text = (
            f"its error after a load is {self.times:.2f} times the least that any linear controller leaves with the "
            "same peak sensitivity, noise and step error"
        )
        if self.tolerant is not None:
            text += (
                f", and {self.times_tolerant:.2f} times where its tolerance of the delay, "
                f"{self.tolerant.bounds.delay_error:g} samples either way, is kept too"
            )
        if not self.prices:
            return text
        parts = ", ".join(f"{PRICE_WORDS[name]} by {100.0 * price:.1f} %" for name, price in self.prices.items())
        return f"{text}; that least falls with {100.0 * PRICE_STEP:.0f} % {parts}"


def axis_limit(closed: ClosedLoop, load_error: float, priced: bool = False) -> AxisLimit:
    """Compare a closed loop of this load error with the limit; ``priced``: with the price of each bound.

    Raises InputError as :func:`find_limit`.
    """
    channel, bounds = closed.points.channel, loop_bounds(closed)
    least = find_limit(channel, bounds)
    error = _delay_error(closed)
    tolerant = find_limit(channel, bounds._replace(delay_error=error)) if error else None
    return AxisLimit(load_error, least, tolerant, bound_prices(channel, tolerant or least) if priced else {})


def bound_prices(channel: Channel, limit: Limit) -> dict[str, float]:
    """Return the relative drop of the smallest load error if one bound is relaxed by PRICE_STEP, by bound.

    A bound that costs nothing was not in the way; a tolerance of the delay is relaxed where there is less of it.
    """
    bounds = limit.bounds
    prices = {}
    for name in PRICE_WORDS:
        value = getattr(bounds, name)
        if value:
            relaxed = value * (1.0 - PRICE_STEP if name == "delay_error" else 1.0 + PRICE_STEP)
            found = find_limit(channel, bounds._replace(**{name: relaxed}), limit.window_s)
            prices[name] = max(0.0, 1.0 - found.load_error / limit.load_error)
    return prices


def loop_bounds(closed: ClosedLoop) -> Bounds:
    """Return the bounds that a closed loop of the nominal channel keeps, without its delay tolerance."""
    peak = float(np.max(np.abs(closed.inner / closed.characteristic)))
    return Bounds(peak, closed.noise, closed.step_error)


def _delay_error(closed: ClosedLoop) -> float:
    """Return the largest delay error, samples, with a peak below MAX_PEAK_FACTOR times the present one."""
    theta, open_loop = closed.points.theta, closed.open_loop
    allowed, most = MAX_PEAK_FACTOR * loop_bounds(closed).peak_sensitivity, closed.points.channel.transport_samples

    def peak_at(error: float) -> float:
        return float(np.abs(1.0 / (1.0 + open_loop * np.exp(-1j * theta * error))).max())

    more = tolerated_error(peak_at, allowed, most)
    return min(more, tolerated_error(lambda error: peak_at(-error), allowed, most))


def tolerated_error(peak_at: Callable[[float], float | None], allowed: float, most: float) -> float:
    """Return the largest error, in steps of a quarter and up to ``most``, up to which the peak is at most ``allowed``.

    ``peak_at`` gives the peak sensitivity with an error of the delay in samples; None where that is unstable.
    """
    error = 0.0
    resolution = 0.25  # samples: resolution of the tolerance
    while error + resolution <= most:
        peak = peak_at(error + resolution)
        if peak is None or peak > allowed:
            break
        error += resolution
    return error


def find_limit(channel: Channel, bounds: Bounds, window: float | None = None) -> Limit:
    """Return the least load error within ``bounds``, integrated over ``window`` s, by default that of a design.

    Raises InputError where Clarabel is not installed, the channel has no such limit (a delay of no whole steps,
    measurements that are held), or no linear controller keeps the bounds.
    """
    need_solver()
    plant = Plant(channel, round((window or window_s(channel)) / channel.step))
    solution = Programme(plant, bounds).solve()
    return plant.evaluate(bounds, *solution)


def need_solver() -> None:
    """Raise InputError where Clarabel is not installed."""
    if find_spec("clarabel") is None:
        raise InputError(f"the limit of performance is computed with Clarabel, which is not installed: {HINT}")


class Plant:
    """A channel as polynomials in ``q``, and its answers in time."""

    def __init__(self, channel: Channel, samples: int) -> None:
        self.channel, self.samples, self.step = channel, samples, channel.step
        if channel.rate_hold != 1:
            raise InputError(f"{channel.name}: no limit is computed where measurements are held")
        self.rate_late, self.angle_late = (
            (0, 0) if channel.identified else (channel.rate_latency, channel.angle_latency)
        )
        model = replace(channel, rate_filter_s=0.0, rate_latency=0).model("limit")
        if model.delay_samples != int(model.delay_samples):
            raise InputError(f"{channel.name}: a limit needs a delay of whole steps, not {model.delay_samples:g}")
        zeros = [*model.zeros, *_pairs(model.zero_pairs)]
        poles = [*model.poles, *_pairs(model.pole_pairs)]
        self.late = int(model.delay_samples) + channel.added_delay + len(poles) - len(zeros)
        self.denominator = polynomial(poles)
        kept = polynomial([zero for zero in zeros if abs(zero) > 1.0 - CIRCLE_TOLERANCE])
        self.kept = kept / kept.sum()
        inside = polynomial([zero for zero in zeros if abs(zero) <= 1.0 - CIRCLE_TOLERANCE])
        self.inverted = model.gain * float(kept.sum()) * inside
        self.is_double = any(abs(pole - 1.0) < CIRCLE_TOLERANCE for pole in poles)
        self.shift = max(self.rate_late - self.angle_late, 0)
        self.length = samples - self.late - max(self.rate_late, self.shift)
        if self.length < 8 * self.late:
            raise InputError(f"{channel.name}: {samples} samples are too few for a limit; its delay is {self.late}")

    def keep(self, basis: Array) -> Array:
        """Return a basis with the zeros that cannot be inverted, as long as responses are looked at."""
        missing = self.length - len(basis)
        return np.asarray(lfilter(self.kept, [1.0], np.pad(basis, ((0, missing), (0, 0))), axis=0))

    def to_command(self, response: Array) -> Array:
        """Return ``a / b`` of columns of responses."""
        return np.asarray(lfilter(self.denominator, self.inverted, response, axis=0))

    def angle_of_setpoint(self, y: Array) -> Array:
        """Return the angle after a unit step of the set-point."""
        return np.asarray(lfilter([0.5, 0.5], [1.0, -1.0], self._delayed(y, self.late + self.shift), axis=0))

    def angle_of_load(self, acts: Array, late: int = 0) -> Array:
        """Return the angle after a unit step of load that comes through the response ``acts``, ``late`` samples late.

        Both integrals are taken first and one by one: with the poles in one recursion rounding grows to 5 % in 20 s.
        """
        numerator = 0.5 * self.step * np.convolve(np.convolve(self.inverted, self.kept), [1.0, 1.0])
        integrals = self._delayed(acts, late + self.late).cumsum(0).cumsum(0)
        return np.asarray(lfilter(numerator, self.denominator, integrals, axis=0))

    def noise_of(self, t: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return the command after impulses of noise of its size: the gyro's by ``t`` and by ``y``, and the angle's."""
        t, y = (np.concatenate([each, np.zeros((EVEN_DELAYS * self.late, *each.shape[1:]))]) for each in (t, y))
        late = self.angle_late + self.shift - self.rate_late
        of_rate = self.channel.rate_noise
        by_y = self.to_command(lfilter(np.r_[np.zeros(late), 0.5, 0.5], [1.0], y, axis=0))
        of_angle = lfilter([1.0, -1.0], [1.0], self.to_command(y), axis=0) / self.step
        return of_rate * self.to_command(t), -of_rate * by_y, self.channel.angle_noise * np.asarray(of_angle)

    def evaluate(self, bounds: Bounds, t: Array, y: Array) -> Limit:
        """Return the loop that ``t`` and ``y`` make, from every sample and a fine grid of frequencies."""
        by_t, by_y, of_angle = self.noise_of(t, y)
        acts = self._delayed(np.ones(1), 0) - self._delayed(t, self.late + self.rate_late)
        load, sensitivity = self.angle_of_load(acts), np.fft.rfft(acts, 1 << 17)
        return Limit(
            bounds,
            float(np.abs(load).sum()) * self.step,
            float(np.abs(1.0 - self.angle_of_setpoint(y)).sum()) * self.step,
            float(np.sqrt(np.square(by_t + by_y).sum() + np.square(of_angle).sum())),
            float(np.abs(sensitivity).max()),
            t,
            y,
            self.samples * self.step,
        )

    def _delayed(self, response: Array, samples: int) -> Array:
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

    minimise sum w e  subject to  |angle after load| <= e,  |1 - angle after a step| <= f,  sum w f <= step error,
    |noise| <= bound,  |1 - T_i| <= M at every frequency, or the same with a tolerance of the delay.
    """

    def __init__(
        self,
        plant: Plant,
        bounds: Bounds,
        basis: tuple[Array, Array] | None = None,
        frequencies: int = FREQUENCY_COUNT,
    ) -> None:
        self.plant, self.bounds, self.frequencies = plant, bounds, frequencies
        if plant.late * plant.step >= bounds.step_error:
            raise InputError(f"{plant.channel.name}: no controller has a step error below the delay itself")
        self.of_t, self.of_y = (plant.keep(each) for each in basis or (self._splines(),) * 2)
        step = max(1, plant.late // 6)
        near = np.arange(plant.late, min(10 * plant.late, plant.samples), max(1, step // 2))
        self.times = np.r_[near, np.arange(near[-1] + step, plant.samples, step)]
        self.weights = np.gradient(self.times.astype(float)) * plant.step
        self.tolerant = bounds.delay_error > 0.0

    def _splines(self) -> Array:
        return _splines(self.plant.length - len(self.plant.kept) + 1, self.plant.late)

    @cached_property
    def _theta(self) -> Array:
        return np.geomspace(2e-3, pi, self.frequencies)

    def _rows(self, t: Any = None, y: Any = None, load: Any = None, step: Any = None, sizes: Any = None) -> Any:
        """Return rows of the matrix from the blocks that they have; ``sizes`` are bounds on |S| and |T_i|, if any."""
        blocks = [t, y, load, step, *([sizes] if self.tolerant else [])]
        widths = [self.of_t.shape[1], self.of_y.shape[1], len(self.times), len(self.times), 2 * self.frequencies]
        height = next(block.shape[0] for block in blocks if block is not None)
        return sparse.hstack(
            [
                sparse.csr_matrix((height, width)) if block is None else sparse.csr_matrix(block)
                for block, width in zip(blocks, widths, strict=False)
            ]
        )

    def solve(self, exact: float = 1e-6) -> tuple[Array, Array]:
        """Return ``t`` and ``y`` of the optimum.  Raises InputError if infeasible or not solved.

        ``exact``: share of the least within which it is shown to be it; rounding allows 1e-7 for slow poles.
        """
        import clarabel

        cones = [*self._at_rest(), *self._errors(), self._noise(), *self._sensitivity()]
        kinds = {
            "zero": clarabel.ZeroConeT,
            "nonnegative": clarabel.NonnegativeConeT,
            "second-order": clarabel.SecondOrderConeT,
        }
        count, first = self.of_t.shape[1], self.of_t.shape[1] + self.of_y.shape[1]
        columns = sparse.vstack([cone.matrix for cone in cones]).tocsc()
        offset = np.concatenate([cone.offset for cone in cones])
        of_t, offset, to_t = _condition(columns[:, :count].toarray(), offset)
        of_y, offset, to_y = _condition(columns[:, count:first].toarray(), offset)
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
            raise InputError(f"{self.plant.channel.name}: {_describe_none(self.bounds, str(solution.status))}")
        x = np.array(solution.x)
        return self.of_t @ to_t(x[:count]), self.of_y @ to_y(x[count:first])

    def _at_rest(self) -> list[Cone]:
        """Constraint at rest: ``t`` and ``y`` are 1; with a rate pole at 1, ``T_i`` has zero slope."""
        cones = [
            Cone("zero", self._rows(t=self.of_t.sum(0)[None]), np.ones(1)),
            Cone("zero", self._rows(y=self.of_y.sum(0)[None]), np.ones(1)),
        ]
        if self.plant.is_double:
            late = self.plant.late + self.plant.rate_late
            moments = ((np.arange(len(self.of_t)) + late) @ self.of_t)[None]
            cones.append(Cone("zero", self._rows(t=moments / late), np.zeros(1)))
        return cones

    def _errors(self) -> list[Cone]:
        plant, identity = self.plant, -sparse.identity(len(self.times), format="csr")
        free, load = plant.angle_of_load(np.ones(1)), plant.angle_of_load(self.of_t, plant.late + plant.rate_late)
        # The response to a load before any control can act.
        scale = abs(float(free[2 * plant.late + 1]))
        load, free = load[self.times] / scale, free[self.times] / scale
        step = plant.angle_of_setpoint(self.of_y)[self.times]
        before = plant.late * plant.step
        return [
            Cone("nonnegative", self._rows(t=-load, load=identity), -free),
            Cone("nonnegative", self._rows(t=load, load=identity), free),
            Cone("nonnegative", self._rows(y=-step, step=identity), -np.ones(len(self.times))),
            Cone("nonnegative", self._rows(y=step, step=identity), np.ones(len(self.times))),
            Cone("nonnegative", self._rows(step=self.weights[None]), np.array([self.bounds.step_error - before])),
        ]

    def _noise(self) -> Cone:
        by_t, by_y, of_angle = self.plant.noise_of(self.of_t, self.of_y)
        stacked = np.vstack([np.hstack([by_t, by_y]), np.hstack([np.zeros((len(of_angle), by_t.shape[1])), of_angle])])
        root: Array = np.asarray(np.linalg.qr(stacked, mode="r")) / self.bounds.noise
        rows = np.vstack([np.zeros(root.shape[1]), -root])
        return Cone(
            "second-order", self._rows(t=rows[:, : by_t.shape[1]], y=rows[:, by_t.shape[1] :]), np.eye(len(rows))[0]
        )

    def _sensitivity(self) -> list[Cone]:
        late = self.plant.late + self.plant.rate_late
        responses: Complex = np.exp(-1j * np.outer(self._theta, np.arange(len(self.of_t)) + late)) @ self.of_t
        peak = self.bounds.peak_sensitivity
        if not self.tolerant:
            return [
                Cone("second-order", self._rows(t=_plane(response)), np.array([peak, 1.0, 0.0]))
                for response in responses
            ]
        count = self.frequencies
        identity, ones = sparse.identity(count, format="csr"), np.ones(count)
        turned = 2.0 * np.sin(0.5 * np.minimum(self._theta * self.bounds.delay_error, pi))
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


_WHY_STOPPED = {  # reason by Clarabel's status
    "NumericalError": "its arithmetic is not exact enough here",
    "InsufficientProgress": "its steps no longer came nearer",
    "AlmostSolved": "its steps came near, but not nearer than that",
    "MaxIterations": "it took its most steps",
}


def _describe_none(bounds: Bounds, status: str) -> str:
    """Return why a programme has no solution, by the solver's status: it is shown to have none, or was not solved."""
    kept = (
        f"a peak sensitivity of at most {bounds.peak_sensitivity:.3g}, noise {bounds.noise:.3g} and step error "
        f"{bounds.step_error:.3g}"
    )
    if "Infeasible" in status:
        return f"no linear controller was found with {kept}"
    why = _WHY_STOPPED.get(status, status)
    return f"the limit with {kept} is not known: the solver stopped before it was found: {why}"


def _condition(columns: Array, offset: Array) -> tuple[Any, Array, Callable[[Array], Array]]:
    """Return orthonormal columns, the offset that they leave, and the way back to the unknowns of ``columns``.

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
    """Return rows with nothing, the real and the imaginary part."""
    return np.vstack([np.zeros(len(response)), response.real, response.imag])


def _pairs(pairs: Sequence[tuple[float, float]]) -> list[complex]:
    return [complex(real, side * imaginary) for real, imaginary in pairs for side in (1.0, -1.0)]


def _splines(samples: int, late: int) -> Array:
    """Return cubic splines sample by sample, a column each: close together first, farther apart behind."""
    distance = max(1.0, round(late / KNOTS_A_DELAY))
    knots = [*np.arange(0.0, min(samples, EVEN_DELAYS * late) + 1.0, distance)]
    apart = distance
    while knots[-1] < samples:
        apart = min(apart * KNOT_GROWTH, FARTHEST * distance)
        knots.append(min(float(samples), knots[-1] + apart))
    degree = 3  # degree of the splines
    clamped = np.r_[[0.0] * degree, knots, [knots[-1]] * degree]
    return np.asarray(BSpline.design_matrix(np.arange(samples, dtype=float), clamped, degree).toarray())
