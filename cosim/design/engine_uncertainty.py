"""What an engine's ``[uncertainty]`` comes to in a loop: standard deviations of its gain and of its delay.

At a frequency ``w`` the engine's answer to a small change of throttle around the thrust of hover is ``G(jw)``.  Each
parameter is moved by a standard deviation either way, and the answers are compared: ``|G|`` is the gain, relative to
the mean of both, ``-arg G / w`` the delay, lags in it included.  Of parameters with the covariance ``D R D`` and a
spread ``s`` the two have, to first order, the variances ``J D R D J' + J s^2 J'``: of one engine of the vehicle.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, inf, log, pi
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.design.loop.channel import Channel
from cosim.engine import EngineSpec, load_engine
from cosim.engine.fmu.uncertainty import CUT
from cosim.engine.fmu.variables import INTEGERS
from cosim.simulation.controllers.controller_file import Requirements
from cosim.simulation.engine_reference import measure_small_steps
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle

SECANT = 0.02  # of throttle, over which the static curve's slope is taken: a step of its measured points
MOST = {"gain_tolerance": 0.95, "delay_tolerance": 1.0}  # as the command line takes them


class LoopUncertainty(NamedTuple):
    """One standard deviation of an engine's gain, relative, and of its delay, s, at a frequency."""

    gain: float
    delay_s: float


class EngineSensitivity:
    """The answers of an engine with each of its uncertain parameters moved either way."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec) -> None:
        """Load the engine once more for each.  ``spec`` states its uncertainty.  Raises InputError as a flight."""
        assert spec.uncertainty is not None
        self.table, self._step = spec.uncertainty, scenario.step_s
        self._thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
        self._moved: list[tuple[float, EngineSpec, EngineSpec] | None] = []
        widths = zip(self.table.parameters, self.table.deviation, self.table.spreads, strict=True)
        for name, deviation, spread in widths:
            low, high = _moved(spec, name, max(deviation, spread))
            ends = [
                load_engine(
                    str(spec.mapping),
                    {**scenario.engine_parameters, name: value},
                    scenario.step_s,
                    unchecked=True,
                    air=spec.air,
                    isolated=spec.isolated,
                )
                for value in (low, high)
            ]
            self._moved.append((high - low, ends[0], ends[1]) if high > low else None)

    def at(self, hertz: float) -> LoopUncertainty:
        """Return the standard deviations at a frequency.  Raises InputError where the engine does not answer."""
        derivatives = np.zeros((len(self._moved), 2))
        for row, moved in enumerate(self._moved):
            if moved is not None:
                width, low, high = moved
                ratio = self._answer(high, hertz) / self._answer(low, hertz)
                gain = 2.0 * (abs(ratio) - 1.0) / (abs(ratio) + 1.0)  # the difference over the mean
                delay = -float(np.angle(ratio)) / (2.0 * pi * hertz)
                derivatives[row] = np.array([gain, delay]) / width
        common = (derivatives.T * np.array(self.table.deviation)) @ np.array(self.table.factor)
        single = derivatives.T * np.array(self.table.spreads)
        gain, delay_s = np.sqrt(np.sum(common**2, axis=1) + np.sum(single**2, axis=1))
        return LoopUncertainty(float(gain), float(delay_s))

    def _answer(self, spec: EngineSpec, hertz: float) -> complex:
        """Return N per throttle at a frequency, late by one control step less than it is."""
        curve = spec.rising_curve
        throttle = float(np.interp(self._thrust, curve.thrust, curve.throttle))
        course = measure_small_steps(spec, throttle, self._step).response
        if not course:
            raise InputError(f"engine {spec.name}: does not answer a small step around throttle {throttle:.2f}")
        low, high = max(0.0, throttle - SECANT), min(1.0, throttle + SECANT)
        slope = (spec.thrust_at(high) - spec.thrust_at(low)) / (high - low)
        increments: Array = np.diff(np.array([0.0, *course]))
        turns = np.exp(-2j * pi * hertz * self._step * np.arange(len(increments)))
        return complex(slope * np.sum(increments * turns))


def _moved(spec: EngineSpec, name: str, width: float) -> tuple[float, float]:
    """Return a parameter moved by ``width`` either way, within the FMU's limits; by one at least where it counts."""
    variable = next(v for v in spec.archive.parameters if v.name == name)
    value = spec.parameters[name]
    least = -inf if variable.min is None else variable.min
    most = inf if variable.max is None else variable.max
    width = max(1.0, float(round(width))) if variable.type in INTEGERS and width else width
    return max(value - width, least), min(value + width, most)


@dataclass(frozen=True)
class EngineTolerances:
    """Tolerances of a design that an engine's uncertainty gives, and the words for where they are from."""

    need: Requirements
    words: str = ""  # empty where none is from there


def engine_tolerances(
    need: Requirements, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, plants: Iterable[Channel]
) -> EngineTolerances:
    """Return the requirements with the tolerances that are not stated in them as the engine's uncertainty has them.

    They are :data:`~cosim.engine.fmu.uncertainty.CUT` standard deviations at the frequency of each channel's pace, the
    largest of the channels that thrust turns.  Without a table, or with both stated, the requirements are as they were.
    Raises InputError as a flight.
    """
    unstated = [name for name in MOST if name not in need.model_fields_set]
    acting = [plant for plant in plants if not plant.is_by_servo]
    if spec.uncertainty is None or not unstated or not acting:
        return EngineTolerances(need)
    sensitivity = EngineSensitivity(scenario, vehicle, spec)
    found = [(plant, sensitivity.at(1.0 / (2.0 * pi * plant.pace_s))) for plant in acting]
    gain = max(deviation.gain for _, deviation in found)
    delay_s = max(deviation.delay_s for _, deviation in found)
    relative = max(deviation.delay_s / (max(1.0, plant.transport_samples) * plant.step) for plant, deviation in found)
    values = {"gain_tolerance": CUT * gain, "delay_tolerance": CUT * relative}
    said = {
        "gain_tolerance": f"gain {100.0 * CUT * gain:.3g} %",
        "delay_tolerance": f"delay {1e3 * CUT * delay_s:.3g} ms",
    }
    parts = [
        said[name] + (f", of which {100.0 * most:.0f} % are taken" if values[name] > most else "")
        for name, most in MOST.items()
        if name in unstated
    ]
    options = " and ".join(f"--{name.replace('_', '-')}" for name in unstated)
    words = (
        f"tolerances from the engine's uncertainty, {CUT:g} standard deviations of its parameters: {', '.join(parts)}; "
        f"source: {spec.uncertainty.source or 'not stated'}; {options} would state others"
    )
    taken = {name: min(ceil(1e4 * values[name]) * 1e-4, MOST[name]) for name in unstated}
    return EngineTolerances(need.model_copy(update=taken), words)


def gain_deviations(deviation: LoopUncertainty, gain_db: float | None) -> float | None:
    """Return a gain margin, as ``ln`` of its factor, in standard deviations of the gain; None without either."""
    return None if gain_db is None or not deviation.gain else abs(gain_db) * log(10.0) / 20.0 / deviation.gain


def delay_deviations(deviation: LoopUncertainty, delay_s: float | None) -> float | None:
    """Return a delay margin in standard deviations of the delay; None without either."""
    return None if delay_s is None or not deviation.delay_s else delay_s / deviation.delay_s
