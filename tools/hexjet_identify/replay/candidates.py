"""What may be wrong with a vehicle: its numbers, and cases such as two engines exchanged or an axis reversed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from math import exp, inf, log
from typing import Final, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.signals import AXES
from hexjet_identify.replay.flown import Change, Model
from hexjet_identify.replay.recorded import RecordedFlight

# Names of the candidates: parts of the vehicle's model that may be wrong.
CENTRE: Final = "centre of gravity"
INERTIA: Final = "moment of inertia about"
MASS, THRUST = "mass", "thrust of all engines"
SENSORS: Final = ("gyro", "accelerometer", "attitude")  # sensors whose delay may be wrong


class Number(NamedTuple):
    """A number of the vehicle to fit: unit ("" for a factor), stated value, limits, probe step, and its Change.

    ``deviation`` is how far it may be off at a guess, for numbers that are fitted together; ``off`` an error that a
    log should show.  ``inverse``: the motion goes with one over it.
    """

    name: str
    unit: str
    stated: float
    low: float
    high: float
    probe: float
    change: Callable[[float], Change]
    inverse: bool = False
    deviation: float = inf
    off: float = 0.3


@dataclass(frozen=True)
class Candidate:
    """A possible cause: numbers that are fitted together, mostly one, or a case without numbers."""

    name: str
    numbers: tuple[Number, ...] = ()
    case: Change = field(default_factory=Change)
    sense: tuple[int, ...] = (1,) * 9

    def change(self, values: Array) -> Change:
        """Return the vehicle's change with these values."""
        if len(values) > 1:
            x, y = values.tolist()
            return Change(centre=(x, y, 0.0))
        return self.numbers[0].change(float(values[0])) if self.numbers else self.case


def list_candidates(model: Model, flight: RecordedFlight) -> Iterator[Candidate]:
    """Yield all possible causes, numbers first."""
    yield from (Candidate(number.name, (number,)) for number in _list_numbers(model, flight))
    x, y, z = _list_centre_of_gravity(model)
    yield Candidate(CENTRE, (x, y))
    yield Candidate(z.name, (z,))
    yield from _list_exchanges(len(model.vehicle.jets), flight.throttle)
    for axis, name in enumerate(AXES):
        signs = [-1 if channel == axis else 1 for channel in range(9)]
        yield Candidate(f"{name} rate reversed", sense=tuple(signs))
        if flight.has_angles:
            signs[6 + axis] = -1
            yield Candidate(f"{name} rate and {name} angle reversed", sense=tuple(signs))


def _list_exchanges(jets: int, throttle: Array, most_jets: int = 10) -> Iterator[Candidate]:
    """Yield exchanges of two engines, but for pairs whose commands are always equal.

    Vehicles with more than ``most_jets`` have too many pairs.
    """
    for a, b in combinations(range(jets if jets <= most_jets else 0), 2):
        if not np.array_equal(throttle[:, a], throttle[:, b]):
            order = list(range(jets))
            order[a], order[b] = b, a
            yield Candidate(f"engines {a + 1} and {b + 1} swapped", case=Change(order=tuple(order)))


def _list_numbers(model: Model, flight: RecordedFlight) -> Iterator[Number]:
    for axis, letter in enumerate("xyz"):
        yield _make_factor(f"{INERTIA} {letter}", partial(_change_inertia, axis), inverse=True)
    yield _make_factor(MASS, lambda v: Change(mass=v), inverse=True)
    yield _make_factor(THRUST, lambda v: Change(thrust=v))
    for jet in range(len(model.vehicle.jets)):
        yield _make_factor(f"thrust of engine {jet + 1}", partial(_change_thrust, jet))
    step = model.scenario.step_s
    yield _make_delay("further delay of the engines", 0.2 * step, lambda v: Change(engines_s=v))
    yield from _list_lags(model)
    if model.vehicle.ranges:
        yield _make_delay("further delay of the servos", step, lambda v: Change(servos_s=v))
        yield _make_delay("further lag of the servos", step, lambda v: Change(servo_lag_s=v))
    for sensor, (name, here) in enumerate(zip(SENSORS, (True, flight.has_force, flight.has_angles), strict=True)):
        if here:
            yield _make_delay(f"further delay of the {name}", step, partial(_delay_sensor, sensor))


def _list_centre_of_gravity(model: Model) -> list[Number]:
    span = model.vehicle.aero.span_m
    known, probe, most = 0.05 * span, 1e-5 * span, 0.5 * span
    return [
        Number(f"{CENTRE} {letter}", "m", 0.0, -most, most, probe, _move_along_z, deviation=known, off=known)
        for letter in "xyz"
    ]


def _list_lags(model: Model) -> Iterator[Number]:
    """Yield the lag of the engines, if they have a parameter for it."""
    engine = model.engine
    if engine is None:
        return
    if engine.pole is not None and engine.internal_step is not None and 0.0 < engine.pole < 1.0:
        step, pole, gain = engine.internal_step, engine.pole, engine.parameters.get("gain")
        pole_name = next((name for name, value in engine.parameters.items() if value == pole), None)
        if pole_name is None or gain is None:
            return

        def with_lag(lag: float) -> Change:
            # The static gain, gain / (1 - pole), stays as it is.
            other = exp(-step / lag)
            return Change(parameters={pole_name: other, "gain": gain * (1.0 - other) / (1.0 - pole)})

        yield _make_lag(-step / log(pole), with_lag)
    elif engine.parameters.get("lag", 0.0) > 0.0:
        yield _make_lag(engine.parameters["lag"], lambda v: Change(parameters={"lag": v}))


def _make_lag(value: float, change: Callable[[float], Change]) -> Number:
    return Number("lag of the engines", "s", value, 0.1 * value, 10.0 * value, 1e-3 * value, change, off=0.02)


def _make_delay(name: str, step: float, change: Callable[[float], Change]) -> Number:
    return Number(name, "s", 0.0, -0.2, 0.3, step, change, off=0.02)


def _make_factor(name: str, change: Callable[[float], Change], inverse: bool = False) -> Number:
    return Number(name, "", 1.0, 0.2, 5.0, 1e-4, change, inverse)


def _move_along_z(value: float) -> Change:
    return Change(centre=(0.0, 0.0, value))


def _change_inertia(axis: int, value: float) -> Change:
    x, y, z = (value if n == axis else 1.0 for n in range(3))
    return Change(inertia=(x, y, z))


def _delay_sensor(sensor: int, value: float) -> Change:
    gyro, accelerometer, attitude = (value if n == sensor else 0.0 for n in range(3))
    return Change(sensors_s=(gyro, accelerometer, attitude))


def _change_thrust(jet: int, value: float) -> Change:
    return Change(jets={jet: value})
