"""What of a model is wrong: one change after the other is fitted to what the replay does not explain.

Each cause is one number (a factor, a delay) or one of a few exchanges (two engines, the sense of an axis).  Its number
is fitted alone, by Gauss and Newton with differences of whole replays.  The bounds are those of that one number, by
what the windows, each taken for one observation, disagree on (White, 1982).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from math import exp, isfinite, log
from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array, Flags
from cosim.base.errors import EngineError, FlightError, InputError
from cosim.base.signals import AXES, Vector3
from cosim.identify.replay.flown import Change, Flown, Model
from cosim.identify.replay.measures import EXCITED
from cosim.identify.replay.windows import Flying, accelerometer_zero, without_start

MISFIT: Final = 1.3  # times the noise's square, from where on there is anything to explain
LITTLE: Final = 0.2  # weight of a channel that is not off, or does not move
MOST: Final = 0.5  # of the misfit that a cause removes which is named
MOST_REST: Final = 0.5  # of a channel's movement that it leaves at most
SURE: Final = 3.0  # standard errors by which it does so, window by window
APART: Final = 2.0  # standard errors by which it beats another that is not named,
NEAR: Final = 0.05  # and share of the misfit
TELLING: Final = 0.2  # of the mean misfit of a window, from where on it says something
LEAST_TELLING: Final = 2  # windows with a misfit, for a name
REFINED: Final = 6  # causes that are fitted; the others would remove less
PROMISING: Final = 0.1  # of the misfit that is removed after a round, at least, by what is fitted further
ROUNDS: Final = 4  # of Gauss and Newton
MOST_WINDOWS: Final = 20  # that move most: with so many a cause is looked for
ONE_AXIS, ALL_AXES = "moment of inertia about", "all moments of inertia"
MOST_SWAPS_OF: Final = 10  # engines: of more no pairs are tried


class Cause(NamedTuple):
    """A number that a model may have wrong: what it is, its unit, where it begins, and its bounds."""

    name: str
    unit: str  # "": a factor
    begin: float
    low: float
    high: float
    probe: float  # by how much it is changed to see what it does
    change: Callable[[float], Change]


@dataclass(frozen=True)
class Fitted:
    """A cause with its number; ``removed`` is the share that it takes of the misfit above the noise."""

    name: str
    unit: str
    value: float | None  # None: an exchange has none
    bound: float | None  # half of the 95 % interval
    removed: float
    windows: Array  # squared error of each window
    sure: float  # standard errors by which it is better than the model as stated
    rest: float  # of the movement in the channel that it explains worst
    at_limit: bool = False  # the number is at the end of what was tried

    @property
    def is_likely(self) -> bool:
        """Whether it removes most of the misfit, and what is left is not most of what moved."""
        return self.removed >= MOST and self.rest <= MOST_REST and not self.at_limit

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the windows, for JSON."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "bound_95": self.bound,
            "removed": self.removed,
            "standard_errors": self.sure,
            "rest_of_movement": self.rest,
        }

    @property
    def text(self) -> str:
        """The cause with its value and bounds."""
        if self.value is None:
            return self.name
        size, unit = (1e3, " ms") if self.unit == "s" else (1.0, f" {self.unit}" if self.unit else " times as stated")
        value, half = size * self.value, size * (self.bound or 0.0)
        bounds = f" (95 %: {value - half:.4g} to {value + half:.4g})" if half else ""
        return f"{self.name}: {value:.4g}{unit}{bounds}"


@dataclass(frozen=True)
class Causes:
    """What was tried: the misfit in squares of the noise, the named ones first, and why none is named."""

    misfit: float
    named: tuple[Fitted, ...]
    tried: tuple[Fitted, ...]
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {
            "misfit_over_noise_squared": self.misfit if isfinite(self.misfit) else None,
            "named": [fitted.to_dict() for fitted in self.named],
            "tried": [fitted.to_dict() for fitted in self.tried],
            "reason": self.reason,
        }


class Residuals:
    """What a replay leaves, in units of the noise: (w, n, c), by the channels that the log has."""

    def __init__(self, model: Model, flying: Flying, wind: Vector3) -> None:
        self._model, self._wind = model, wind
        moved = np.nanstd(flying.measured()[:, :, :3] / flying.scale[:3], axis=1).sum(axis=1)
        chosen = np.sort(np.argsort(-moved, kind="stable")[:MOST_WINDOWS])
        self.flying = flying.only(chosen.tolist())
        self.has_force = flying.flight.has_force
        self._weights = np.ones(6 if self.has_force else 3)

    def balance(self, nominal: Array) -> tuple[Array, Array]:
        """Let channels with a misfit count alike from here on, others little.

        Return the model's own residuals so, and which channels are to be explained, (c,): those that move and are off.
        """
        off, moves = np.mean(nominal**2, axis=(0, 1)), np.mean(self.movement() ** 2, axis=(0, 1))
        told = (off > MISFIT) & (moves > EXCITED**2)
        self._weights = np.where(told, 1.0, LITTLE) / np.maximum(1.0, np.sqrt(off))
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

    def of(self, change: Change, sense: tuple[int, int, int] = (1, 1, 1)) -> Array:
        """Return the residuals of a change; ``sense``: -1 for an axis that the log has reversed."""
        flying = self.flying
        measured = flying.measured()
        starts = flying.starts
        if sense != (1, 1, 1):
            turned = np.array(sense, float)
            measured = measured * np.concatenate([turned, np.ones(3), turned])
            starts = starts._replace(rate=starts.rate * turned, moment=starts.moment * turned)
        flown = self._model.fly(flying.flight, flying.windows, starts, change, self._wind)
        return self._weigh(measured, flown)

    def _weigh(self, measured: Array, flown: Flown) -> Array:
        flying = self.flying
        error = measured[:, :, :6] - flying.modelled(flown)[:, :, :6]
        rates = without_start(error[:, :, :3], flying.flight.step)
        if not self.has_force:
            return np.asarray(self._weights * rates / flying.noise.rate)
        force = error[:, :, 3:].copy()
        force -= accelerometer_zero(force, self._model.vehicle)
        return np.asarray(
            self._weights * np.concatenate([rates / flying.noise.rate, force / flying.noise.force], axis=2)
        )


def find_causes(model: Model, flying: Flying, wind: Vector3) -> Causes:
    """Fit each cause alone to a replay, and name the one that removes most of what it leaves, where the log tells."""
    residuals = Residuals(model, flying, wind)
    nominal = residuals.of(Change())
    misfit = float(np.mean(nominal**2))
    if misfit < MISFIT:
        return Causes(misfit, (), (), "what is left is as large as the noise: there is nothing to explain")
    nominal, told = residuals.balance(nominal)
    if not told.any():
        return Causes(misfit, (), (), "no channel that moves is off")
    judge = _Judge(nominal, told, residuals)
    fitted = [*_exchanges(model, residuals, judge), *_numbers(model, residuals, nominal, judge)]
    tried = tuple(sorted(fitted, key=lambda one: -one.removed))
    named, reason = judge.name(tried)
    return Causes(misfit, named, tried[:8], reason)


class _Judge:
    """What the windows say of a cause beside the model as stated, and beside another cause."""

    def __init__(self, nominal: Array, told: Array, residuals: Residuals) -> None:
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

    def fitted(self, cause: tuple[str, str], value: float | None, bound: float | None, left: Array) -> Fitted:
        """Return a cause with what it leaves."""
        windows = self._misfits(left)
        over = np.sum(left**2, axis=(0, 1)) - len(left) * self._floor
        rest = float(np.sqrt(np.max(np.maximum(over, 0.0) / self._movement)))
        return Fitted(*cause, value, bound, self.removed(left), windows, self._gain(self._windows, windows), rest)

    def name(self, tried: tuple[Fitted, ...]) -> tuple[tuple[Fitted, ...], str]:
        """Return the causes that are named, more than one where they cannot be told apart, and why none is."""
        if not tried:
            return (), "nothing that was tried removes any of it"
        likely = [one for one in tried if one.is_likely]
        if not likely:
            return (), _why_unlikely(tried[0])
        best, *others = likely
        if best.sure < SURE:
            return (), (
                f"{best.text} would remove most of it, but the windows do not agree ({best.sure:.1f} standard errors)"
            )
        together = (best, *(one for one in others if not self._is_apart(one.windows, best.windows)))
        if any(one.name.startswith(ONE_AXIS) for one in together):  # all axes are that one and others that did not turn
            together = tuple(one for one in together if one.name != ALL_AXES)
        return together, ""

    def _gain(self, before: Array, after: Array) -> float:
        """Return by how much windows with a misfit gain, as a share of it, in standard errors of that."""
        return _mean_over_spread(*self._gains(before, after, np.maximum(before, after)))

    def _is_apart(self, worse: Array, better: Array) -> bool:
        """Return whether the windows say that one cause is better than another: by some of the misfit as stated."""
        gains, telling = self._gains(worse, better, self._windows)
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
            f"no single cause removes half of it, {best.text} {100.0 * max(best.removed, 0.0):.0f} %: several at "
            "once, or something else (wind, a form that the model has not)"
        )
    if best.at_limit:
        return f"{best.text} is at the end of what was tried: something else"
    return (
        f"{best.text} removes {100.0 * best.removed:.0f} %, but leaves {100.0 * best.rest:.0f} % of a movement that "
        "was measured: it explains nothing"
    )


def _exchanges(model: Model, residuals: Residuals, judge: _Judge) -> Iterator[Fitted]:
    """Try engines that are swapped in pairs, and axes that are reversed."""
    jets = len(model.vehicle.jets)
    throttle = residuals.flying.flight.throttle
    for a, b in combinations(range(jets if jets <= MOST_SWAPS_OF else 0), 2):
        if np.array_equal(throttle[:, a], throttle[:, b]):
            continue  # the same command: an exchange that no log tells
        order = list(range(jets))
        order[a], order[b] = b, a
        left = residuals.of(Change(order=tuple(order)))
        yield judge.fitted((f"engines {a + 1} and {b + 1} swapped", ""), None, None, left)
    for axis, name in enumerate(AXES):
        sense = (-1 if axis == 0 else 1, -1 if axis == 1 else 1, -1 if axis == 2 else 1)
        yield judge.fitted((f"{name} rate reversed", ""), None, None, residuals.of(Change(), sense))


def _numbers(model: Model, residuals: Residuals, nominal: Array, judge: _Judge) -> Iterator[Fitted]:
    """Fit the causes that are one number, those whose slope promises most."""
    promising = []
    for cause in _causes(model):
        slope = (_try(residuals, cause, cause.begin + cause.probe) - nominal) / cause.probe
        power = float(np.sum(slope**2))
        if power > 0.0:
            promising.append((float(np.sum(slope * nominal)) ** 2 / power, cause))
    promising.sort(key=lambda pair: -pair[0])
    for _, cause in promising[:REFINED]:
        yield _fit(residuals, cause, nominal, judge)


def _try(residuals: Residuals, cause: Cause, value: float) -> Array:
    try:
        return residuals.of(cause.change(value))
    except (FlightError, EngineError, InputError):  # an engine that does not take the number
        return np.full((len(residuals.flying.windows), 1, 1), np.inf)


def _fit(residuals: Residuals, cause: Cause, nominal: Array, judge: _Judge) -> Fitted:
    value, left = cause.begin, nominal
    slope = np.zeros_like(nominal)
    for _ in range(ROUNDS):
        probe = cause.probe if value + cause.probe <= cause.high else -cause.probe
        slope = (_try(residuals, cause, value + probe) - left) / probe
        power = float(np.sum(slope**2))
        if not (0.0 < power < np.inf):
            break
        move = -float(np.sum(slope * left)) / power
        better = None
        for part in (1.0, 0.5, 0.25):
            candidate = float(np.clip(value + part * move, cause.low, cause.high))
            after = _try(residuals, cause, candidate)
            if float(np.sum(after**2)) < float(np.sum(left**2)):
                better = candidate, after
                break
        if better is None:
            break
        moved, (value, left) = abs(better[0] - value), better
        if moved < 0.05 * abs(cause.probe) or judge.removed(left) < PROMISING:
            break
    fitted = judge.fitted((cause.name, cause.unit), value, _bound(slope, left), left)
    return replace(fitted, at_limit=value in (cause.low, cause.high) and value != cause.begin)


def _bound(slope: Array, left: Array) -> float | None:
    """Return half of the 95 % interval of a number, each window taken for one observation."""
    from scipy.stats import t

    scores, power = np.sum(slope * left, axis=(1, 2)), float(np.sum(slope**2))
    count = len(scores)
    if count < 2 or not power > 0.0:
        return None
    spread = np.sqrt(float(np.sum(scores**2)) * count / (count - 1.0)) / power
    return float(t.ppf(0.975, count - 1) * spread)


def _causes(model: Model) -> Iterator[Cause]:
    for axis, letter in enumerate("xyz"):
        yield _factor(f"{ONE_AXIS} {letter}", _inertia_change(axis))
    yield _factor(ALL_AXES, lambda v: Change(inertia=(v, v, v)))
    yield _factor("mass", lambda v: Change(mass=v))
    yield _factor("thrust of all engines", lambda v: Change(thrust=v))
    for jet in range(min(len(model.vehicle.jets), 6)):
        yield _factor(f"thrust of engine {jet + 1}", _jet_change(jet))
    yield Cause(
        "all engines and servos later by", "s", 0.0, -0.2, 0.5, model.scenario.step_s, lambda v: Change(delay_s=v)
    )
    if model.vehicle.model is None:
        yield Cause("further damping of roll and pitch", "1/s", 0.0, 0.0, 50.0, 0.5, lambda v: Change(damping=v))
    yield from _lags(model)


def _lags(model: Model) -> Iterator[Cause]:
    """Return the lag of the engines, where they have a parameter for it."""
    engine = model.engine
    if engine is None:
        return
    if engine.pole is not None and engine.internal_step is not None and 0.0 < engine.pole < 1.0:
        step, pole, gain = engine.internal_step, engine.pole, engine.parameters.get("gain")
        pole_name = next((name for name, value in engine.parameters.items() if value == pole), None)
        if pole_name is None or gain is None:
            return

        def with_lag(lag: float) -> Change:  # at rest it gives as much as before: gain over 1 less pole
            other = exp(-step / lag)
            return Change(parameters={pole_name: other, "gain": gain * (1.0 - other) / (1.0 - pole)})

        yield _lag("lag of the engines", -step / log(pole), with_lag)
    elif engine.parameters.get("lag", 0.0) > 0.0:
        yield _lag("lag of the engines", engine.parameters["lag"], lambda v: Change(parameters={"lag": v}))


def _lag(name: str, value: float, change: Callable[[float], Change]) -> Cause:
    return Cause(name, "s", value, 0.1 * value, 10.0 * value, 0.1 * value, change)


def _factor(name: str, change: Callable[[float], Change]) -> Cause:
    return Cause(name, "", 1.0, 0.2, 5.0, 0.05, change)


def _inertia_change(axis: int) -> Callable[[float], Change]:
    def change(value: float) -> Change:
        x, y, z = (value if n == axis else 1.0 for n in range(3))
        return Change(inertia=(x, y, z))

    return change


def _jet_change(jet: int) -> Callable[[float], Change]:
    return lambda value: Change(jets={jet: value})


def without_windows(causes: Causes) -> Causes:
    """Return the causes without what each window says, which is large."""
    empty = np.zeros(0)
    return replace(
        causes,
        named=tuple(replace(one, windows=empty) for one in causes.named),
        tried=tuple(replace(one, windows=empty) for one in causes.tried),
    )
