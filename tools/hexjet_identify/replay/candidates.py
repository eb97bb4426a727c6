"""What may be wrong with a model: one number (a factor, a delay), or an exchange (two engines, an axis reversed)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import exp, log, prod
from typing import Final

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import AXES
from hexjet_identify.replay.flown import Change, Model

ONE_AXIS, ALL_AXES = "moment of inertia about", "all moments of inertia"
ALL_LATER, ENGINES_LATER = "all engines and servos later by", "engines alone later by"
LARGER: Final = ((ONE_AXIS, ALL_AXES), (ENGINES_LATER, ALL_LATER))  # the second is the first and what did not move
INERTIA, MASS, THRUST = "of inertia", "mass", "thrust of all engines"
MOST_SWAPS_OF: Final = 10  # engines: of more no pairs are tried
Sense = tuple[int, int, int]
AS_STATED: Final[Sense] = (1, 1, 1)


@dataclass(frozen=True)
class Cause:
    """A number that a model may have wrong: what it is, its unit, where it begins, and its bounds."""

    name: str
    unit: str  # "": a factor
    begin: float
    low: float
    high: float
    probe: float  # by how much it is changed to see what it does
    change: Callable[[float], Change]
    divides: bool = False  # what turns or lifts the vehicle: its inverse is what the motion is straight in

    def moved(self, value: float, by: float) -> float:
        """Return the number after a step of Gauss and Newton, within its bounds."""
        if self.divides:
            left = value - by
            by = value * value / left - value if left > 0.0 else self.high
        return min(max(value + by, self.low), self.high)


@dataclass(frozen=True)
class Exchange:
    """What the vehicle may have the other way round: the order of its engines, or the sense of an axis (-1)."""

    name: str
    change: Change = field(default_factory=Change)
    sense: Sense = AS_STATED


@dataclass(frozen=True)
class Hypothesis:
    """Causes that are there at once: one or two numbers, or an exchange with a number or without."""

    numbers: tuple[Cause, ...] = ()
    exchange: Exchange | None = None

    @property
    def begin(self) -> tuple[float, ...]:
        """The numbers as the vehicle states them."""
        return tuple(cause.begin for cause in self.numbers)

    @property
    def sense(self) -> Sense:
        """-1 for an axis that the log has reversed."""
        return self.exchange.sense if self.exchange else AS_STATED

    def change(self, values: Sequence[float]) -> Change:
        """Return the vehicle's change with these numbers."""
        changes = [cause.change(value) for cause, value in zip(self.numbers, values, strict=True)]
        return combine([*changes, *([self.exchange.change] if self.exchange else [])])


def combine(changes: Sequence[Change]) -> Change:
    """Return changes that are there at once: factors multiply, delays and dampings add, the last order holds."""
    x, y, z = (prod(change.inertia[axis] for change in changes) for axis in range(3))
    jets: dict[int, float] = {}
    for change in changes:
        for jet, factor in change.jets.items():
            jets[jet] = jets.get(jet, 1.0) * factor
    return Change(
        (x, y, z),
        prod(change.mass for change in changes),
        prod(change.thrust for change in changes),
        jets,
        sum(change.delay_s for change in changes),
        order=next((change.order for change in reversed(changes) if change.order), ()),
        parameters={name: value for change in changes for name, value in change.parameters.items()},
        damping=sum(change.damping for change in changes),
        engines_s=sum(change.engines_s for change in changes),
        servo_lag_s=sum(change.servo_lag_s for change in changes),
    )


def list_exchanges(model: Model, throttle: Array) -> Iterator[Exchange]:
    """Yield engines that are swapped in pairs, and axes that are reversed; ``throttle`` (n, jets) of the log.

    Engines with the same command all the while are left out: no log tells whether these are swapped.
    """
    jets = len(model.vehicle.jets)
    for a, b in combinations(range(jets if jets <= MOST_SWAPS_OF else 0), 2):
        if not np.array_equal(throttle[:, a], throttle[:, b]):
            order = list(range(jets))
            order[a], order[b] = b, a
            yield Exchange(f"engines {a + 1} and {b + 1} swapped", Change(order=tuple(order)))
    for axis, name in enumerate(AXES):
        x, y, z = (-1 if n == axis else 1 for n in range(3))
        yield Exchange(f"{name} rate reversed", sense=(x, y, z))


def list_numbers(model: Model) -> Iterator[Cause]:
    """Yield the causes that are one number."""
    for axis, letter in enumerate("xyz"):
        yield _factor(f"{ONE_AXIS} {letter}", _inertia_change(axis), divides=True)
    yield _factor(ALL_AXES, lambda v: Change(inertia=(v, v, v)), divides=True)
    yield _factor(MASS, lambda v: Change(mass=v), divides=True)
    yield _factor(THRUST, lambda v: Change(thrust=v))
    for jet in range(min(len(model.vehicle.jets), 6)):
        yield _factor(f"thrust of engine {jet + 1}", _jet_change(jet))
    probe = model.scenario.step_s
    yield Cause(ALL_LATER, "s", 0.0, -0.2, 0.5, probe, lambda v: Change(delay_s=v))
    if model.vehicle.ranges:
        yield Cause(ENGINES_LATER, "s", 0.0, -0.2, 0.5, probe, lambda v: Change(engines_s=v))
        yield Cause("lag of the servos more by", "s", 0.0, -0.1, 0.5, probe, lambda v: Change(servo_lag_s=v))
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


def _factor(name: str, change: Callable[[float], Change], divides: bool = False) -> Cause:
    return Cause(name, "", 1.0, 0.2, 5.0, 0.05, change, divides)


def _inertia_change(axis: int) -> Callable[[float], Change]:
    def change(value: float) -> Change:
        x, y, z = (value if n == axis else 1.0 for n in range(3))
        return Change(inertia=(x, y, z))

    return change


def _jet_change(jet: int) -> Callable[[float], Change]:
    return lambda value: Change(jets={jet: value})
