"""What a replay leaves of a flight, beside all that nobody knows of it.

Nobody knows the state at the start of a window, the constant moment of the air on it, a drift of the attitude, the
accelerometer's zero and the rest of the wind.  They are estimated with every number of the vehicle, by Gauss and
Newton, and stand beside the channels with what they cost: a moment that is the same in all windows, or a zero beyond
what the sensor states, is something that a number has to explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.signals import Vector3
from hexjet_identify.replay.flown import Change, Flown, Model, Starts
from hexjet_identify.replay.windows import Flying

# Numbers of a window: rate, moment, angle and drift of the angle, about each axis.
RATE, MOMENT, ANGLE, DRIFT = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Numbers of the flight: the accelerometer's zero, and the wind beside the estimated one.
ZERO, WIND = slice(0, 3), slice(3, 5)
# Three moments of the window and three zeros of the flight are channels behind the sensors'.
COSTS: Final = 6


@dataclass(frozen=True)
class Point:
    """The windows flown once: how, and what is left over, ``left`` (w, n, c), in units of the noise.

    ``sense`` (9,): -1 for a channel that the log has the other way round.  ``own`` (w, 12) of the windows and
    ``shared`` (5,) of the flight are estimated beside, from the flight's starts on.
    """

    change: Change
    sense: Array
    own: Array
    shared: Array
    left: Array


class Step(NamedTuple):
    """A step of Gauss and Newton: of ``values`` with half of their 95 % intervals, of the windows and of the flight.

    ``squares`` (w, c + 6) are what it leaves of each window, by channels and costs; ``loss`` is their weighted sum.
    """

    values: Array
    bounds: Array
    own: Array
    shared: Array
    squares: Array
    left: Array
    loss: float


class Slopes(NamedTuple):
    """What a unit of each number beside those of the vehicle does: ``own`` (w, n, c, 12), ``shared`` (w, n, c, 5)."""

    own: Array
    shared: Array


class Misfit:
    """The windows of a flight as one problem of least squares.

    ``moment``: standard deviation of the windows' moments [N m]; without it moments cost nothing.  ``by_axis``: what a
    window's numbers do to another axis than theirs is left out, which is enough to begin with.
    """

    def __init__(
        self, model: Model, flying: Flying, wind: Vector3, moment: Array | None = None, by_axis: bool = False
    ) -> None:
        self._by_axis = by_axis
        self._model, self.flying, self._wind = model, flying, wind
        self.present: Flags = np.asarray(np.isfinite(flying.measured()).all(axis=(0, 1)))
        windows, rows = flying.rows.shape
        self._time = flying.flight.step * np.arange(1.0, rows + 1.0)
        self.weights = np.ones(int(self.present.sum()) + COSTS)
        sensor = model.vehicle.sensors.accelerometer
        along = max(float(np.hypot(sensor.bias_m_s2[2], sensor.bias_sigma_m_s2)), 1e-3)
        # Across the thrust the zero is also how straight the accelerometer stands, within some degrees.
        self._shared_deviation = np.array([0.5, 0.5, along, 5.0, 5.0])
        self._moment_deviation = np.full(3, np.inf) if moment is None else moment
        # Without an attitude in the log nothing tells the one at the start.
        self._held = np.diag(
            np.concatenate([np.full(6, 1e-9), np.where(self.present[6:], 1e-9, 1e12), np.full(3, 1e-9)])
        )
        self.nominal = self.fly(Change(), np.ones(9), np.zeros((windows, 12)), np.zeros(5))

    def fly(self, change: Change, sense: Array, own: Array, shared: Array) -> Point:
        """Fly the windows.  Raises FlightError and EngineError where the model cannot."""
        flying, (north, east, down) = self.flying, self._wind
        rate, angles, moment = flying.starts
        starts = Starts(
            sense[:3] * rate + own[:, RATE], sense[6:] * angles + own[:, ANGLE], sense[:3] * moment + own[:, MOMENT]
        )
        wind = (north + float(shared[WIND][0]), east + float(shared[WIND][1]), down)
        flown = self._model.fly(flying.flight, flying.windows, starts, change, wind)
        return Point(change, sense, own, shared, self._left(flown, change, sense, own, shared))

    def _left(self, flown: Flown, change: Change, sense: Array, own: Array, shared: Array) -> Array:
        flying = self.flying
        modelled = np.concatenate([flown.rate, flown.force, flown.angles], axis=1)[flying.rows]
        for number, late in enumerate(change.sensors_s):
            if late:
                part = slice(3 * number, 3 * number + 3)
                modelled[:, :, part] = _delayed(modelled[:, :, part], late / flying.flight.step)
        error = sense * flying.measured() - modelled
        error[:, :, 6:] -= 2.0 * np.pi * np.round(error[:, :, 6:] / (2.0 * np.pi))
        error[:, :, 3:6] -= shared[ZERO]
        error[:, :, 6:] -= self._time[None, :, None] * own[:, None, DRIFT]
        for number, late in enumerate(change.sensors_s):
            # What the model sensed before the window is not known.
            error[:, : max(0, ceil(late / flying.flight.step)), 3 * number : 3 * number + 3] = 0.0
        return np.asarray((error / flying.scale)[:, :, self.present])

    def linearise(self, point: Point) -> Slopes:
        """Return what the numbers of the windows and of the flight do around a point."""
        return Slopes(self.slopes_of_windows(point), self._slopes_of_flight(point))

    def slopes_of_windows(self, base: Point) -> Array:
        """Return what the numbers of the windows do around a point, (w, n, c, 12)."""
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
        """Return what a unit of a number does: ``change`` is the point's with the number ``by`` larger."""
        return (self.fly(change, point.sense, point.own, point.shared).left - point.left) / by

    def solve(self, point: Point, around: Slopes, slopes: Array | None = None, deviation: Array | None = None) -> Step:
        """Return the step from a point that leaves least; ``slopes`` (w, n, c, k) of the numbers that are free.

        ``around`` are those of the others.  ``deviation`` (k,): how far numbers are off in a vehicle, at a guess;
        infinite where nothing is taken for known.
        """
        slopes = np.zeros((*point.left.shape, 0)) if slopes is None else slopes
        windows, count = len(point.left), slopes.shape[-1]
        weights, costs = self.weights[:-COSTS], self.weights[-COSTS:]
        # Rows of all channels of a window stand in one column.
        left = (weights * point.left).reshape(windows, -1, 1)
        free = weights[:, None] * np.concatenate([slopes, around.shared], axis=-1)
        own, free = (weights[:, None] * around.own).reshape(windows, -1, 12), free.reshape(windows, left.shape[1], -1)
        known = np.concatenate([np.full(count, np.inf) if deviation is None else deviation, self._shared_deviation])
        priors = known**-2.0
        priors[count : count + 3] *= costs[3:] ** 2
        now = np.concatenate([np.zeros(count), point.shared])
        normal, cross = own.mT @ own + self._held, own.mT @ free
        by_free, by_left = np.linalg.solve(normal, cross), np.linalg.solve(normal, own.mT @ left)[..., 0]
        # A window's moment, as it follows from the numbers, is one observation more.
        size = costs[:3] / self._moment_deviation
        moments = point.sense[:3] * self.flying.starts.moment + point.own[:, MOMENT]
        moments = size * (moments - by_left[:, MOMENT])
        moved = -size[:, None] * by_free[:, MOMENT]
        hessian = np.sum(free.mT @ free - cross.mT @ by_free + moved.mT @ moved, axis=0) + np.diag(priors)
        score = np.sum((free.mT @ left - cross.mT @ by_left[..., None] + moved.mT @ moments[..., None])[..., 0], axis=0)
        score += priors * now
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
        inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        step = -inverse @ score
        own_step = -by_left - by_free @ step
        after = left[..., 0] + free @ step + (own @ own_step[..., None])[..., 0]
        of_priors = priors**2 * np.where(np.isfinite(known), known, 0.0) ** 2
        moments = moments + moved @ step
        rows = ((free - own @ by_free) * after[..., None]).reshape(*slopes.shape[:3], -1).sum(axis=2)
        after = after.reshape(point.left.shape)
        bounds = _bounds(rows, np.einsum("wai,wa->wi", moved, moments), inverse, of_priors)[:count]
        costly = [(moments / costs[:3]) ** 2]
        costly.append(np.tile((((now + step) / known)[count : count + 3]) ** 2 / windows, (windows, 1)))
        squares = np.concatenate([np.sum((after / weights) ** 2, axis=1), *costly], axis=1)
        wind = float(np.sum(((now + step) / known)[count + 3 :] ** 2))
        loss = float(np.sum(squares * self.weights**2)) + wind
        return Step(step[:count], bounds, own_step, step[count:], squares, after / weights, loss)

    def fit_windows(self, share: float = 1.0) -> Array:
        """Return the step of the windows' numbers alone (w, 12) that leaves least of their first part."""
        rows = max(round(share * len(self._time)), 8)
        windows = len(self.nominal.left)
        left = self.nominal.left[:, :rows].reshape(windows, -1, 1)
        own = self.slopes_of_windows(self.nominal)[:, :rows].reshape(windows, -1, 12)
        return np.asarray(-np.linalg.solve(own.mT @ own + self._held, own.mT @ left)[..., 0])

    def follow(self, point: Point, step: Step, change: Change | None = None) -> Point:
        """Fly the windows a step on."""
        return self.fly(change or point.change, point.sense, point.own + step.own, point.shared + step.shared)


def settle(model: Model, flying: Flying, wind: Vector3, shares: Sequence[float] = (0.15, 0.4, 1.0, 1.0)) -> Flying:
    """Return the flight with the starts and moments that suit the vehicle as stated.

    The first of the ``shares`` of a window are looked at alone: a moment that the model lacks leads the whole of it far
    away at first.
    """
    for share in shares:
        misfit = Misfit(model, flying, wind, by_axis=True)
        own = misfit.fit_windows(share)
        rate, angles, moment = flying.starts
        flying = replace(flying, starts=Starts(rate + own[:, RATE], angles + own[:, ANGLE], moment + own[:, MOMENT]))
    return flying


def _bounds(rows: Array, windows: Array, inverse: Array, of_priors: Array) -> Array:
    """Return half of the 95 % intervals, by scores of rows (w, n, k) and of windows (w, k), whichever is more.

    Rows are taken for alike over a quarter of a window (Newey and West, 1987), windows for independent (Student's t).
    """
    from scipy.stats import t

    count, lags = len(rows), max(rows.shape[1] // 4, 1)
    by_rows = np.sum(rows.mT @ rows, axis=0) + windows.T @ windows
    for lag in range(1, lags):
        late = np.sum(rows[:, lag:].mT @ rows[:, :-lag], axis=0)
        by_rows += (1.0 - lag / lags) * (late + late.T)
    whole = rows.sum(axis=1) + windows
    by_windows = whole.T @ whole * count / (count - 1.0)

    def half(scores: Array, quantile: float) -> Array:
        return quantile * np.sqrt(np.maximum(np.diag(inverse @ (scores + np.diag(of_priors)) @ inverse), 0.0))

    return np.maximum(half(by_rows, 1.96), half(by_windows, float(t.ppf(0.975, count - 1))))


def _delayed(values: Array, rows: float) -> Array:
    """Return signals (w, n, c) later by so many rows, in a straight line between them and beyond the ends."""
    count = values.shape[1]
    at = np.arange(count) - rows
    before = np.clip(np.floor(at).astype(int), 0, count - 2)
    part = (at - before)[None, :, None]
    return np.asarray((1.0 - part) * values[:, before] + part * values[:, before + 1])
