"""What a replay leaves, what of it is more than noise, and what windows say of a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.signals import Vector3
from hexjet_identify.replay.candidates import AS_STATED, LARGER, Hypothesis, Sense
from hexjet_identify.replay.flown import Change, Flown, Model
from hexjet_identify.replay.measures import EXCITED
from hexjet_identify.replay.windows import Flying, accelerometer_zero, without_start

MISFIT: Final = 1.3  # times the noise's square, from where on there is anything to explain
LITTLE: Final = 0.2  # weight of a channel that is not off, or does not move
MOST: Final = 0.5  # of the misfit that a cause removes which is named
MOST_REST: Final = 0.5  # of a channel's movement that it leaves at most
SURE: Final = 3.0  # standard errors by which it does so, window by window
APART: Final = 2.0  # standard errors by which it beats another that is not named,
NEAR: Final = 0.05  # and share of the misfit
PAIR_REST: Final = 0.5  # of what the best single cause leaves of windows held back, that a pair leaves at most
TELLING: Final = 0.2  # of the mean misfit of a window, from where on it says something
LEAST_TELLING: Final = 2  # windows with a misfit, for a name
AIR_M_S: Final = 5.0  # by which a wind may be off, and not cost anything to speak of
MOST_WINDOWS: Final = 20  # that move most: with so many a cause is looked for


class Part(NamedTuple):
    """One of the causes that are there at once, with its number."""

    name: str
    unit: str  # "": a factor
    value: float | None = None  # None: an exchange has none
    bound: float | None = None  # half of the 95 % interval
    begin: float | None = None  # the number as the vehicle states it

    @property
    def is_apart(self) -> bool:
        """Whether the 95 % interval is free of the stated number."""
        if self.value is None or self.begin is None:
            return True
        return self.bound is not None and abs(self.value - self.begin) > self.bound

    @property
    def text(self) -> str:
        """The cause with its value and bounds."""
        if self.value is None:
            return self.name
        size, unit = (1e3, " ms") if self.unit == "s" else (1.0, f" {self.unit}" if self.unit else " times as stated")
        value, half = size * self.value, size * (self.bound or 0.0)
        bounds = f" (95 %: {value - half:.4g} to {value + half:.4g})" if half else ""
        return f"{self.name}: {value:.4g}{unit}{bounds}"

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"name": self.name, "unit": self.unit, "value": self.value, "bound_95": self.bound}


@dataclass(frozen=True)
class Fitted:
    """A cause with its number, or two; ``removed`` is the share that it takes of the misfit above the noise."""

    parts: tuple[Part, ...]
    removed: float
    windows: Array  # squared error of each window
    held_back: Array  # the same, each window foretold by the numbers that the others give
    sure: float  # standard errors by which it is better than the model as stated
    rest: float  # of the movement in the channel that it explains worst
    at_limit: bool = False  # a number is at the end of what was tried
    over_noise: float = 1.0  # what is left of the channels that are to be explained, in squares of the noise

    @property
    def name(self) -> str:
        """What it is called."""
        return " and ".join(part.name for part in self.parts)

    @property
    def value(self) -> float | None:
        """The number of a single cause; None for an exchange, and for two causes."""
        return self.parts[0].value if len(self.parts) == 1 else None

    @property
    def bound(self) -> float | None:
        """Half of its 95 % interval."""
        return self.parts[0].bound if len(self.parts) == 1 else None

    @property
    def is_likely(self) -> bool:
        """Whether it removes most of the misfit, and what is left is not most of what moved."""
        return self.removed >= MOST and self.rest <= MOST_REST and not self.at_limit

    @property
    def has_exchange(self) -> bool:
        """Whether engines or an axis are exchanged."""
        return any(part.value is None for part in self.parts)

    @property
    def are_apart(self) -> bool:
        """Whether each number differs from the stated one."""
        return all(part.is_apart for part in self.parts)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the windows, for JSON."""
        return {
            "name": self.name,
            "unit": self.parts[0].unit if len(self.parts) == 1 else "",
            "value": self.value,
            "bound_95": self.bound,
            "parts": [part.to_dict() for part in self.parts],
            "removed": self.removed,
            "standard_errors": self.sure,
            "rest_of_movement": self.rest,
        }

    @property
    def text(self) -> str:
        """The cause with its value and bounds, or both."""
        return ", and ".join(part.text for part in self.parts)


class Residuals:
    """What a replay leaves, in units of the noise: (w, n, c), by the channels that the log has.

    What another constant wind would make of it is taken out, for the estimated one is wrong where the model is.
    """

    def __init__(self, model: Model, flying: Flying, wind: Vector3) -> None:
        self._model, self._wind = model, wind
        moved = np.nanstd(flying.measured()[:, :, :3] / flying.scale[:3], axis=1).sum(axis=1)
        chosen = np.sort(np.argsort(-moved, kind="stable")[:MOST_WINDOWS])
        self.flying = flying.only(chosen.tolist())
        self.has_force = flying.flight.has_force
        self._weights = np.ones(6 if self.has_force else 3)
        self._winds: Array = np.zeros((0, 1, 1, 1))  # what AIR_M_S more, north and east, makes of the residuals
        still = self.of(Hypothesis())
        self._winds = np.stack([self._in_wind(AIR_M_S * axis) - still for axis in np.eye(2)])
        self.nominal = self._without_wind(still)  # of the model as it is

    def _in_wind(self, more: Array) -> Array:
        north, east, down = self._wind
        wind = (north + float(more[0]), east + float(more[1]), down)
        flown = self._model.fly(self.flying.flight, self.flying.windows, self.flying.starts, None, wind)
        return self._weigh(self.flying.measured(), flown)

    def _without_wind(self, left: Array) -> Array:
        """Return residuals without the winds that fit them best; one of AIR_M_S costs as much as the noise of a row."""
        if not len(self._winds):
            return left
        shapes = (self._weights * self._winds).reshape(len(self._winds), -1)
        fitted = np.linalg.solve(shapes @ shapes.T + np.eye(len(shapes)), shapes @ left.ravel())
        return left - np.asarray(fitted @ shapes).reshape(left.shape)

    def balance(self, nominal: Array) -> tuple[Array, Flags]:
        """Let each channel count by the root of its misfit from here on, those that are not off little.

        So the largest does not hide the others, and one that is hardly off has little to say.  Return the model's own
        residuals so, and which channels are to be explained, (c,): those that move and are off.
        """
        off, moves = np.mean(nominal**2, axis=(0, 1)), np.mean(self.movement() ** 2, axis=(0, 1))
        told = (off > MISFIT) & (moves > EXCITED**2)
        self._weights = np.where(told, 1.0, LITTLE) / np.maximum(1.0, off) ** 0.25
        return np.asarray(nominal * self._weights), told

    @property
    def floor(self) -> Array:
        """What noise alone would leave of a window in each channel, (c,)."""
        return np.asarray(self.flying.rows.shape[1] * self._weights**2)

    def movement(self) -> Array:
        """Return what was measured as residuals are, (w, n, c): what a model would leave that does not move."""
        flying = self.flying
        still = Flown(*(np.zeros_like(flying.flight.rate) for _ in Flown._fields))
        if self.has_force:  # across the thrust; along it a model without thrust would leave all of it
            still.force[:, :2] = np.nanmean(flying.measured()[:, :, 3:5], axis=(0, 1))
        return self._weigh(flying.measured(), still)

    def of(self, hypothesis: Hypothesis, values: Sequence[float] = ()) -> Array:
        """Return the residuals with causes at these numbers; infinite where an engine does not take one."""
        try:
            return self._of(hypothesis.change(values), hypothesis.sense)
        except (FlightError, EngineError, InputError):
            return np.full((len(self.flying.windows), 1, 1), np.inf)

    def _of(self, change: Change, sense: Sense) -> Array:
        flying = self.flying
        measured, starts, winds = flying.measured(), flying.starts, [self._wind]
        if sense != AS_STATED:
            turned = np.array(sense, float)
            measured = measured * np.concatenate([turned, np.ones(3), turned])
            starts = starts._replace(rate=starts.rate * turned, moment=starts.moment * turned)
            winds.append((0.0, 0.0, 0.0))  # the estimated one rests on the attitude that may be reversed
        left = [
            self._weigh(measured, self._model.fly(flying.flight, flying.windows, starts, change, wind))
            for wind in winds
        ]
        return min(left, key=lambda one: float(np.sum(one**2)))

    def _weigh(self, measured: Array, flown: Flown) -> Array:
        flying = self.flying
        error = measured[:, :, :6] - flying.modelled(flown)[:, :, :6]
        left = without_start(error[:, :, :3], flying.flight.step) / flying.noise.rate
        if self.has_force:
            force = error[:, :, 3:] - accelerometer_zero(error[:, :, 3:], self._model.vehicle)
            left = np.concatenate([left, force / flying.noise.force], axis=2)
        return self._without_wind(self._weights * left)


class Judge:
    """What the windows say of a cause beside the model as stated, and beside another cause."""

    def __init__(self, nominal: Array, told: Flags, residuals: Residuals) -> None:
        self._told, self._floor, self._nominal = told, residuals.floor, np.sum(nominal**2, axis=1)
        self._windows = self._misfits(nominal)
        movement = np.sum(residuals.movement() ** 2, axis=(0, 1)) - len(nominal) * self._floor
        self._movement = np.where(told, movement, np.inf)  # of the channels that are to be explained

    def _misfits(self, left: Array) -> Array:
        """Return the misfit above the noise of each window; other channels count where they get worse."""
        channels = np.sum(left**2, axis=1)
        over = np.where(self._told, channels - self._floor, channels - self._nominal)
        return np.asarray(np.maximum(over, 0.0).sum(axis=1))

    def removed(self, left: Array) -> float:
        """Return the share of the misfit above the noise that is gone from these residuals."""
        before = float(np.mean(self._windows))
        return (before - float(np.mean(self._misfits(left)))) / before if before > 0.0 else 0.0

    def fitted(self, parts: tuple[Part, ...], left: Array, held_back: Array, at_limit: bool = False) -> Fitted:
        """Return causes with what they leave, and what of each window the numbers of the others leave (w, n, c)."""
        windows, channels = self._misfits(left), np.sum(left**2, axis=(0, 1))
        over = channels - len(left) * self._floor
        rest = float(np.sqrt(np.max(np.maximum(over, 0.0) / self._movement)))
        noise = float(np.max((channels / (len(left) * self._floor))[self._told]))
        sure = self._gain(self._windows, windows)
        return Fitted(parts, self.removed(left), windows, self._misfits(held_back), sure, rest, at_limit, noise)

    def name(self, tried: Sequence[Fitted], pairs: Sequence[Fitted]) -> tuple[tuple[Fitted, ...], str]:
        """Return the causes that are named, more than one where they cannot be told apart, and why none is.

        Both lists begin with what removes most.
        """
        if not tried:
            return (), "nothing that was tried removes any of it"
        both = [pair for pair in pairs if self._is_needed(pair, tried[0])]
        likely = both or [one for one in tried if one.is_likely]
        if not likely:
            return (), _why_unlikely(tried[0])
        best, *others = likely
        if not both:  # an exchange may hide in a number: two of six engines swapped look like an inertia of three times
            others += [one for one in pairs if one.has_exchange and one.is_likely and one.are_apart]
        if best.sure < SURE:
            return (), (
                f"{best.text} would remove most of it, but the windows do not agree ({best.sure:.1f} standard errors)"
            )
        together = [best, *(one for one in others if not self._is_apart(one, best))]
        for part, whole in LARGER:
            if any(part in one.name for one in together):
                together = [one for one in together if whole not in one.name]
        return tuple(together), ""

    def _is_needed(self, pair: Fitted, single: Fitted) -> bool:
        """Return whether two causes are there, and not one: both differ from the stated vehicle, and held back they do.

        Each window is foretold by the numbers that the others give, so that a second number that only fits does not
        count.
        """
        if not pair.is_likely or not pair.are_apart:
            return False
        enough = float(np.mean(pair.held_back)) <= PAIR_REST * float(np.mean(single.held_back))
        return enough and self._gain(single.held_back, pair.held_back) >= APART

    def _gain(self, before: Array, after: Array) -> float:
        """Return by how much windows with a misfit gain, as a share of it, in standard errors of that."""
        return _mean_over_spread(*self._gains(before, after, np.maximum(before, after)))

    def _is_apart(self, worse: Fitted, better: Fitted) -> bool:
        """Return whether the windows say that one cause is better than another: by some of the misfit as stated.

        What leaves more than noise is worse than what leaves no more.
        """
        if better.over_noise < MISFIT < worse.over_noise:
            return True
        gains, telling = self._gains(worse.windows, better.windows, self._windows)
        enough = bool(telling.any()) and float(np.mean(gains[telling])) > NEAR
        return enough and _mean_over_spread(gains, telling) >= APART

    def _gains(self, before: Array, after: Array, misfit: Array) -> tuple[Array, Flags]:
        """Return the shares of each window's misfit that are gained, and which windows have one worth the name."""
        telling = misfit > TELLING * float(np.mean(misfit))
        return np.where(telling, (before - after) / np.where(telling, misfit, 1.0), 0.0), telling


def _mean_over_spread(gains: Array, telling: Flags) -> float:
    """Return the mean of the gains of telling windows in its standard errors; 0 for too few of them."""
    gains = gains[telling]
    if len(gains) < LEAST_TELLING:
        return 0.0
    spread = max(float(np.std(gains, ddof=1)), 1e-3) / np.sqrt(len(gains))
    return float(np.mean(gains) / spread)


def _why_unlikely(best: Fitted) -> str:
    """Return why the cause that removes most is not named."""
    if best.removed < MOST:
        return (
            f"no cause alone removes half of it, {best.text} {100.0 * max(best.removed, 0.0):.0f} %, and no two that "
            "held-back windows bear out: more at once, or something else (wind, a form that the model has not)"
        )
    if best.at_limit:
        return f"{best.text} is at the end of what was tried: something else"
    return (
        f"{best.text} removes {100.0 * best.removed:.0f} %, but leaves {100.0 * best.rest:.0f} % of a movement that "
        "was measured: it explains nothing"
    )
