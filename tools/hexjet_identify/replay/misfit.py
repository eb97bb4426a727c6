"""What a replay leaves of a flight, beside all that nobody knows of it.

Nobody knows the state at the start of a window, the constant moment of the air on it, a drift of the attitude, the
accelerometer's zero and the rest of the wind.  They are estimated with every number of the vehicle, by Gauss and
Newton, and stand beside the channels with what they cost: a moment that is the same in all windows, or a zero beyond
what the sensor states, is something that a number has to explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.errors import FlightError
from cosim.base.signals import Vector3
from hexjet_identify.replay.flown import Change, Model, Starts, delay_rows
from hexjet_identify.replay.windows import CutFlight

# Columns of a window's own numbers: rate, moment, angle and drift of the angle, about each axis.
RATE, MOMENT, ANGLE, DRIFT = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Columns of the flight's numbers: the accelerometer's zero, and the change of the estimated wind.
ZERO, WIND = slice(0, 3), slice(3, 5)
# Channels behind the sensors': the costs of a window's three moments and the flight's three zeros.
COST_CHANNELS: Final = 6


@dataclass(frozen=True)
class Point:
    """The windows flown once: with what, and the residual ``left`` (w, n, c) in units of the noise.

    ``sense`` (9,): -1 for a channel that the log has the other way round.  ``own`` (w, 12) of the windows and
    ``shared`` (5,) of the flight are estimated beside, from the flight's starts on.  ``known`` (n, c): rows for which
    the window has what a sensor that is later or earlier shows.
    """

    change: Change
    sense: Array
    own: Array
    shared: Array
    left: Array
    known: Flags


class Scores(NamedTuple):
    """Scores from which bounds of k numbers follow; the inverse Hessian is ``root`` times its transpose.

    ``slopes`` (w, n, c, k) of what is ``left`` (w, n, c), ``moved`` (w, 3, k) of the ``moments`` (w, 3), all weighted
    and without what windows' own numbers make up for; ``noise`` (c + 6,) of each; ``priors`` (k, k) by what is known
    beforehand; ``information`` (w, k, k) that each window has.
    """

    root: Array
    slopes: Array
    left: Array
    moved: Array
    moments: Array
    noise: Array
    priors: Array
    information: Array

    def bounds(self) -> Array:
        """Return half of the 95 % intervals: the widest of three, each under another assumption on the noise.

        Noise that is white, and as large as what is left of each channel, beyond which no log tells; rows that are
        alike over a quarter of a window (Newey and West, 1987); and windows that are independent, each freed of its
        share in the fit (Bell and McCaffrey, 2002, with Student's t).
        """
        from scipy.stats import t

        root, moved, priors = self.root, self.moved @ self.root, self.priors @ self.root
        slopes = self.slopes @ root
        rows, windows = np.sum(slopes * self.left[..., None], axis=2), np.sum(moved * self.moments[..., None], axis=1)
        count, lags = len(rows), max(rows.shape[1] // 4, 1)
        noisy = (self.noise[:-COST_CHANNELS, None] * slopes).reshape(-1, root.shape[1])
        noisy = np.concatenate([noisy, (self.noise[-COST_CHANNELS:-3, None] * moved).reshape(-1, root.shape[1])])
        by_rows = np.sum(rows.mT @ rows, axis=0) + windows.T @ windows
        for lag in range(1, lags):
            late = np.sum(rows[:, lag:].mT @ rows[:, :-lag], axis=0)
            by_rows += (1.0 - lag / lags) * (late + late.T)
        shares, axes = np.linalg.eigh(root.T @ self.information @ root)
        whole = axes.mT @ (rows.sum(axis=1) + windows)[..., None]
        whole = (axes @ (whole / np.sqrt(np.maximum(1.0 - shares, 1e-6))[..., None]))[..., 0]

        def half_width(meat: Array, quantile: float) -> Array:
            variances = np.diag(root @ (meat + priors.T @ priors) @ root.T)
            return np.asarray(quantile * np.sqrt(np.maximum(variances, 0.0)))

        by_windows = half_width(whole.T @ whole, float(t.ppf(0.975, count - 1)))
        return np.asarray(np.maximum.reduce([half_width(noisy.T @ noisy, 1.96), half_width(by_rows, 1.96), by_windows]))


class Step(NamedTuple):
    """A Gauss-Newton step of ``values``, of the windows' and of the flight's numbers.

    ``squares`` (w, c + 6) are what it leaves of each window, by channels and costs; ``loss`` is their weighted sum.
    """

    values: Array
    own: Array
    shared: Array
    squares: Array
    left: Array
    loss: float
    scores: Scores

    @property
    def bounds(self) -> Array:
        """Half of the values' 95 % intervals."""
        return self.scores.bounds()[: len(self.values)]


class Slopes(NamedTuple):
    """Derivatives of the residual by the windows' numbers, ``own`` (w, n, c, 12), and the flight's (w, n, c, 5)."""

    own: Array
    shared: Array


class Misfit:
    """Least-squares problem of all windows of a flight.

    ``moment``: standard deviation of the windows' moments [N m]; without it moments cost nothing.  ``by_axis``: what a
    window's numbers do to another axis than theirs is left out, which is enough to begin with.
    """

    def __init__(
        self, model: Model, flying: CutFlight, wind: Vector3, moment: Array | None = None, by_axis: bool = False
    ) -> None:
        self._by_axis = by_axis
        self._model, self.flying, self._wind = model, flying, wind
        self.present: Flags = np.asarray(np.isfinite(flying.measured()).all(axis=(0, 1)))
        windows, rows = flying.rows.shape
        self._time = flying.flight.step * np.arange(1.0, rows + 1.0)
        # The sum of squares in a window that noise leaves; of three standard deviations in a zero nothing is made.
        self.floor = np.full(int(self.present.sum()) + COST_CHANNELS, float(rows))
        self.floor[-COST_CHANNELS:] = [2.0] * 3 + [9.0 / windows] * 3
        self.weights = np.ones(len(self.floor))
        sensor = model.vehicle.sensors.accelerometer
        along = max(float(np.hypot(sensor.bias_m_s2[2], sensor.bias_sigma_m_s2)), 1e-3)
        # Across the thrust the zero is also how straight the accelerometer stands, within some degrees.
        self._shared_deviation = np.array([0.5, 0.5, along, 5.0, 5.0])
        self._moment_deviation = np.full(3, np.inf) if moment is None else moment
        # Weights that hold start values: 1e12 fixes the angles at the start if the log has no attitude to tell them.
        self._held = np.diag(
            np.concatenate([np.full(6, 1e-9), np.where(self.present[6:], 1e-9, 1e12), np.full(3, 1e-9)])
        )
        self.nominal = self.fly(Change(), np.ones(9), np.zeros((windows, 12)), np.zeros(5))

    def fly(self, change: Change, sense: Array, own: Array, shared: Array) -> Point:
        """Fly the windows.  Raises FlightError and EngineError where the model cannot, or too little is compared."""
        flying, (north, east, down) = self.flying, self._wind
        rate, angles, moment = flying.starts
        starts = Starts(
            sense[:3] * rate + own[:, RATE], sense[6:] * angles + own[:, ANGLE], sense[:3] * moment + own[:, MOMENT]
        )
        wind = (north + float(shared[WIND][0]), east + float(shared[WIND][1]), down)
        flown = self._model.fly(flying.flight, flying.windows, starts, change, wind)
        modelled = np.concatenate([flown.rate, flown.force, flown.angles], axis=1)[flying.rows]
        rows = np.arange(modelled.shape[1])
        known = np.ones(modelled.shape[1:], bool)
        for number, late_s in enumerate(change.sensors_s):
            late, part = late_s / flying.flight.step, slice(3 * number, 3 * number + 3)
            modelled[:, :, part] = delay_rows(modelled[:, :, part], late, axis=1)
            known[:, part] &= ((rows >= late) & (rows < len(rows) + late))[:, None]
        if not known[len(rows) // 2].all():
            raise FlightError("a sensor is later than half a window, of which too little is left to compare")
        error = sense * flying.measured() - modelled
        error[:, :, 6:] -= 2.0 * np.pi * np.round(error[:, :, 6:] / (2.0 * np.pi))
        error[:, :, 3:6] -= shared[ZERO]
        error[:, :, 6:] -= self._time[None, :, None] * own[:, None, DRIFT]
        left = np.asarray((error / flying.scale)[:, :, self.present])
        return Point(change, sense, own, shared, left, known[:, self.present])

    def linearise(self, point: Point) -> Slopes:
        """Return derivatives by the windows' and the flight's numbers around a point."""
        return Slopes(self.slopes_of_windows(point), self._slopes_of_flight(point))

    def slopes_of_windows(self, base: Point) -> Array:
        """Return derivatives by the windows' numbers around a point, (w, n, c, 12)."""
        columns = np.zeros((*base.left.shape[:2], 9, 12))
        # So small that a moment, and a number that makes the same moment, do the same down to the noise.
        sizes = 1e-4 * np.concatenate([np.ones(3), np.array(self._model.vehicle.inertia_kg_m2), np.ones(3)])
        for numbers in np.arange(9).reshape((3, 3) if self._by_axis else (9, 1)).tolist():
            own = base.own.copy()
            own[:, numbers] += sizes[numbers]
            change = np.zeros((*base.left.shape[:2], 9))
            change[:, :, self.present] = self.fly(base.change, base.sense, own, base.shared).left - base.left
            for number in numbers:
                channels = [number % 3, 6 + number % 3] if self._by_axis else slice(None)
                columns[:, :, channels, number] = change[:, :, channels] / sizes[number]
        for axis in range(3):
            columns[:, :, 6 + axis, DRIFT.start + axis] = -self._time / self.flying.scale[6 + axis]
        return columns[:, :, self.present]

    def _slopes_of_flight(self, base: Point, by: float = 0.01) -> Array:
        columns = np.zeros((*base.left.shape[:2], 9, 5))
        for axis in range(3):
            columns[:, :, 3 + axis, axis] = -1.0 / self.flying.scale[3 + axis]
        columns = columns[:, :, self.present]
        for axis in range(2):
            shared = base.shared.copy()
            shared[WIND.start + axis] += by
            after = self.fly(base.change, base.sense, base.own, shared)
            columns[..., WIND.start + axis] = (after.left - base.left) / by
        return columns

    def slope(self, point: Point, change: Change, by: float) -> Array:
        """Return the derivative by a number; ``change`` is the point's with that number larger by ``by``."""
        return (self.fly(change, point.sense, point.own, point.shared).left - point.left) / by

    def weighted(self, weights: Array) -> Misfit:
        """Return the same problem with other weights of channels and costs, (c + 6,)."""
        other = copy(self)
        other.weights = weights
        return other

    def solve(
        self,
        point: Point,
        around: Slopes,
        slopes: Array | None = None,
        deviation: Array | None = None,
        known: Flags | None = None,
    ) -> Step:
        """Return the least-squares step from a point; ``slopes`` (w, n, c, k) are those of the free numbers.

        ``around`` are those of the others.  ``deviation`` (k,): how far numbers are off in a vehicle, at a guess;
        infinite where nothing is taken for known.  ``known`` (n, c): the rows that count, None for all that the point
        has; in ``squares`` they stand for all.
        """
        known = point.known if known is None else known
        slopes = np.zeros((*point.left.shape, 0)) if slopes is None else slopes
        windows, count = len(point.left), slopes.shape[-1]
        weights, costs = self.weights[:-COST_CHANNELS], self.weights[-COST_CHANNELS:]
        # Rows of all channels of a window stand in one column.
        left = (weights * known * point.left).reshape(windows, -1, 1)
        free = (weights * known)[..., None] * np.concatenate([slopes, around.shared], axis=-1)
        own = ((weights * known)[..., None] * around.own).reshape(windows, -1, 12)
        free = free.reshape(windows, left.shape[1], -1)
        spread = np.concatenate([np.full(count, np.inf) if deviation is None else deviation, self._shared_deviation])
        priors = spread**-2.0
        priors[count : count + 3] *= costs[3:] ** 2
        now = np.concatenate([np.zeros(count), point.shared])
        normal = own.mT @ own + self._held
        by_free, by_left = np.linalg.solve(normal, own.mT @ free), np.linalg.solve(normal, own.mT @ left)[..., 0]
        # A window's moment counts as one more observation.
        size = costs[:3] / self._moment_deviation
        moments = point.sense[:3] * self.flying.starts.moment + point.own[:, MOMENT]
        moments = size * (moments - by_left[:, MOMENT])
        moved = -size[:, None] * by_free[:, MOMENT]
        alone = free - own @ by_free
        information = alone.mT @ free + moved.mT @ moved
        score = np.sum((alone.mT @ left + moved.mT @ moments[..., None])[..., 0], axis=0) + priors * now
        root = _root_of_inverse(np.sum(information, axis=0) + np.diag(priors))
        step = -root @ (root.T @ score)
        own_step = -by_left - by_free @ step
        after = (left[..., 0] + free @ step + (own @ own_step[..., None])[..., 0]).reshape(point.left.shape)
        moments = moments + moved @ step
        costly = [(moments / costs[:3]) ** 2]
        costly.append(np.tile((((now + step) / spread)[count : count + 3]) ** 2 / windows, (windows, 1)))
        squares = np.sum((after / weights) ** 2, axis=1) * (len(known) / known.sum(axis=0))
        squares = np.concatenate([squares, *costly], axis=1)
        loss = float(np.sum(after**2) + np.sum(moments**2) + np.sum(priors * (now + step) ** 2))
        noise = self.weights * np.sqrt(np.maximum(squares.mean(axis=0) / self.floor, 1.0))
        known_before = np.diag(priors * np.where(np.isfinite(spread), spread, 0.0))
        alone = alone.reshape(*point.left.shape, -1)
        scores = Scores(root, alone, after, moved, moments, noise, known_before, information)
        return Step(step[:count], own_step, step[count:], squares, after / weights, loss, scores)

    def follow(self, point: Point, step: Step, change: Change | None = None, part: float = 1.0) -> Point:
        """Return the windows flown after a step, or a ``part`` of it."""
        own, shared = point.own + part * step.own, point.shared + part * step.shared
        return self.fly(change or point.change, point.sense, own, shared)


def settle_starts(
    model: Model, flying: CutFlight, wind: Vector3, shares: Sequence[float] = (0.15, 0.4, 1.0, 1.0)
) -> CutFlight:
    """Return the flight with starts and moments fitted for the vehicle as stated.

    The first of the ``shares`` of a window are looked at alone: a moment that the model lacks leads the whole of it far
    away at first.
    """
    for share in shares:
        misfit = Misfit(model, flying, wind, by_axis=True)
        point = misfit.nominal
        around = Slopes(misfit.slopes_of_windows(point), np.zeros((*point.left.shape, 5)))
        rows = max(round(share * len(point.known)), 8)
        own = misfit.solve(point, around, known=point.known & (np.arange(len(point.known)) < rows)[:, None]).own
        rate, angles, moment = flying.starts
        flying = replace(flying, starts=Starts(rate + own[:, RATE], angles + own[:, ANGLE], moment + own[:, MOMENT]))
    return flying


def _root_of_inverse(hessian: Array) -> Array:
    """Return R with R R^T the inverse of a matrix, without its undetermined directions."""
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    told = values > 1e-12 * values[-1]
    return np.asarray(vectors[:, told] / np.sqrt(values[told]) / scale[:, None])
