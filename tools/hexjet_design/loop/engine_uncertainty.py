"""What an engine's ``[uncertainty]`` comes to in a loop: standard deviations of its gain and of its delay.

At a frequency ``w`` the engine's answer to a small change of throttle around the thrust of hover is ``G(jw)``.  Each
parameter is moved by a standard deviation either way, and the answers are compared: ``|G|`` is the gain, relative to
the mean of both, ``-arg G / w`` the delay, lags in it included.  Of parameters with the covariance ``D R D`` and a
spread ``s`` the two have, to first order, the covariance ``J D R D J' + J s^2 J'``: of one engine of the vehicle.  The
first part is that of all engines together, the second that of one beside the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import ceil, inf, log, pi
from typing import NamedTuple

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY
from cosim.base.errors import InputError
from cosim.engine import EngineSpec, find_source, load_engine
from cosim.engine.fmu.uncertainty import MAX_SIGMA, Uncertainty, cut_normal
from cosim.engine.fmu.variables import INTEGERS
from cosim.simulation.controllers.controller_file import Requirements
from cosim.simulation.engine_reference import measure_small_steps
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_design.loop.channel import Channel

MAX_TOLERANCES = {"gain_tolerance": 0.95, "delay_tolerance": 1.0}  # limits of the options


class LoopUncertainty(NamedTuple):
    """Standard deviation of an engine's relative gain, and of its delay, s, at a frequency."""

    gain: float
    delay_s: float


class EngineSensitivity:
    """Responses of an engine with each of its uncertain parameters moved either way."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec) -> None:
        """Load the engine once more for each.  ``spec`` states its uncertainty.  Raises InputError as a flight."""
        assert spec.uncertainty is not None
        self.table, self._step = spec.uncertainty, scenario.step_s
        self._thrust = vehicle.mass_kg * GRAVITY / len(vehicle.jets)
        self._perturb: list[tuple[float, EngineSpec, EngineSpec] | None] = []
        source = find_source(str(spec.mapping) if spec.mapping else spec.name)
        widths = zip(self.table.parameters, self.table.deviation, self.table.spreads, strict=True)
        for name, deviation, spread in widths:
            low, high = _perturb(spec, name, max(deviation, spread))
            ends = [
                load_engine(
                    source,
                    {**scenario.engine_parameters, name: value},
                    scenario.step_s,
                    unchecked=True,
                    air=spec.air,
                    isolated=spec.isolated,
                )
                for value in (low, high)
            ]
            self._perturb.append((high - low, ends[0], ends[1]) if high > low else None)

    def at(self, hertz: float) -> LoopUncertainty:
        """Return the standard deviations at a frequency.  Raises InputError where the engine does not answer."""
        common, single = self.covariances(hertz)
        gain, delay_s = np.sqrt(np.diag(common + single))
        return LoopUncertainty(float(gain), float(delay_s))

    def covariances(self, hertz: float) -> tuple[Array, Array]:
        """Return the 2 by 2 covariances of gain and delay: of all engines together, and between engines.

        Raises InputError where the engine does not answer.
        """
        derivatives = np.zeros((len(self._perturb), 2))
        for row, moved in enumerate(self._perturb):
            if moved is not None:
                width, low, high = moved
                ratio = self._response(high, hertz) / self._response(low, hertz)
                gain = 2.0 * (abs(ratio) - 1.0) / (abs(ratio) + 1.0)  # difference over mean
                delay = -float(np.angle(ratio)) / (2.0 * pi * hertz)
                derivatives[row] = np.array([gain, delay]) / width
        common = (derivatives.T * np.array(self.table.deviation)) @ np.array(self.table.factor)
        single = derivatives.T * np.array(self.table.spreads)
        return common @ common.T, single @ single.T

    def draw_ratios(self, hertz: Array, draws: int = 200) -> Complex:
        """Return the responses of ``draws`` engines over the nominal one's, a row each, at rising frequencies.

        Parameters are drawn as flights draw them, the same draws always; the logarithm of the answer goes straight with
        each of them.  Raises InputError where the engine does not answer.  ``draws``: of an engine, of which a margin's
        95 % range leaves out five at either end.
        """
        logs = np.zeros((len(self._perturb), len(hertz)), np.complex128)
        for row, moved in enumerate(self._perturb):
            if moved is not None:
                width, low, high = moved
                ratio = self._responses(high, hertz) / self._responses(low, hertz)
                logs[row] = (np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio))) / width
        from scipy.special import ndtr

        normal, nominal = np.random.default_rng(0).standard_normal((2, draws, len(logs))), np.zeros(draws)
        each = zip(
            self.table.quantiles(normal[0]), ndtr(normal[1].T), self.table.deviation, self.table.spreads, strict=True
        )
        deviations = [
            cut_normal(common, nominal, deviation) + cut_normal(single, nominal, spread)
            for common, single, deviation, spread in each
        ]
        return np.asarray(np.exp(np.column_stack(deviations) @ logs))

    def _response(self, spec: EngineSpec, hertz: float) -> complex:
        return complex(self._responses(spec, np.array([hertz]))[0])

    def _responses(self, spec: EngineSpec, hertz: Array, secant: float = 0.02) -> Complex:
        """Return the response [N per unit of throttle] at frequencies, with one control step less delay."""
        curve = spec.rising_curve
        throttle = float(np.interp(self._thrust, curve.thrust, curve.throttle))
        course = measure_small_steps(spec, throttle, self._step).response
        if not course:
            raise InputError(f"engine {spec.name}: does not answer a small step around throttle {throttle:.2f}")
        low, high = max(0.0, throttle - secant), min(1.0, throttle + secant)
        slope = (spec.thrust_at(high) - spec.thrust_at(low)) / (high - low)
        increments: Array = np.diff(np.array([0.0, *course]))
        turns = np.exp(-2j * pi * self._step * np.outer(hertz, np.arange(len(increments))))
        return np.asarray(slope * (turns * increments).sum(axis=1))


def _perturb(spec: EngineSpec, name: str, width: float) -> tuple[float, float]:
    """Return a parameter's values ``width`` below and above, within the FMU's limits; counts move by at least one."""
    variable = next(v for v in spec.archive.parameters if v.name == name)
    value = spec.parameters[name]
    least = -inf if variable.min is None else variable.min
    most = inf if variable.max is None else variable.max
    width = max(1.0, float(round(width))) if variable.type in INTEGERS and width else width
    return max(value - width, least), min(value + width, most)


class EngineTolerances(NamedTuple):
    """Design tolerances from an engine's uncertainty, and words on their origin."""

    need: Requirements
    words: str = ""  # empty: no tolerance is from there


def engine_tolerances(
    need: Requirements, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, plants: Iterable[Channel],
    inertia: float = 0.15,
) -> EngineTolerances:  # fmt: skip
    """Return the requirements with the tolerances that they do not state taken from the engine's uncertainty.

    They are :data:`~cosim.engine.fmu.uncertainty.MAX_SIGMA` deviations at 1 / ``time_scale_s`` of each channel, the
    largest of the channels that thrust turns: the box around the ellipsoid of gain and delay.  Without a table, or with
    all stated, the requirements are as they were.  ``inertia``: the least of the gain, which is thrust over inertia;
    three deviations of 5 % of the second, as in a replay, of which no engine log tells.  Raises InputError as a flight.
    """
    unstated = [name for name in MAX_TOLERANCES if name not in need.model_fields_set]
    acting = [plant for plant in plants if not plant.is_by_servo]
    if spec.uncertainty is None or not unstated or not acting:
        return EngineTolerances(need)
    sensitivity = EngineSensitivity(scenario, vehicle, spec)
    found = [(plant, *sensitivity.covariances(1.0 / (2.0 * pi * plant.time_scale_s))) for plant in acting]
    of_one = [
        (plant, MAX_SIGMA * np.sqrt(np.diag(common + single)), common + single) for plant, common, single in found
    ]
    gain, delay_s = np.max([deviations for _, deviations, _ in of_one], axis=0)
    relative = max(both[1] / (max(1.0, plant.transport_samples) * plant.step) for plant, both, _ in of_one)
    values = {"gain_tolerance": max(float(gain), inertia), "delay_tolerance": float(relative)}
    said = {"gain_tolerance": f"gain {100.0 * gain:.3g} %", "delay_tolerance": f"delay {1e3 * delay_s:.3g} ms"}
    parts = [
        said[name] + (f", of which {100.0 * most:.0f} % are taken" if values[name] > most else "")
        for name, most in MAX_TOLERANCES.items()
        if name in unstated
    ]
    if len(parts) > 1:
        both = of_one[0][2]
        parts.append(
            f"the box around their ellipsoid of correlation {both[0, 1] / np.sqrt(both[0, 0] * both[1, 1]):.2g}"
        )
    taken = {name: min(ceil(1e4 * values[name]) * 1e-4, MAX_TOLERANCES[name]) for name in unstated}
    floor = f"; {100.0 * inertia:g} % of gain are kept for the inertia, which no log of an engine tells"
    floor = floor if gain < inertia and "gain_tolerance" in unstated else ""
    spread, uneven = _engine_spread(need, spec.uncertainty, found)
    words = (
        f"tolerances from the engine's uncertainty, {MAX_SIGMA:g} standard deviations of its parameters: "
        f"{', '.join(parts)}; source: {spec.uncertainty.source or 'not stated'}; {' and '.join(unstated)} would state "
        f"others{floor}{uneven}"
    )
    return EngineTolerances(need.model_copy(update=taken | spread), words)


def _engine_spread(
    need: Requirements, table: Uncertainty, found: Sequence[tuple[Channel, Array, Array]], unknown_spread: float = 0.3
) -> tuple[dict[str, float], str]:
    """Return the deviation of one engine in the proof if not stated, and words on its origin.

    It is the table's spread, in gain or in delay over the channel's time scale; a table without one was made of one
    engine, which says nothing of six.  ``unknown_spread``: of gain and lag between engines of which one alone was
    measured, as without a table.
    """
    if "engine_spread" in need.model_fields_set or "gain_tolerance" in need.model_fields_set:
        return {}, ""
    if not any(table.spreads):
        return {"engine_spread": unknown_spread}, (
            "; it gives no engine-to-engine spread, so the proof assumes "
            f"{100.0 * unknown_spread:.0f} % of gain and lag (engine_spread)"
        )
    ends = [MAX_SIGMA * np.sqrt(np.diag(single)) / (1.0, plant.time_scale_s) for plant, _, single in found]
    spread = min(ceil(1e4 * float(np.max(ends))) * 1e-4, MAX_TOLERANCES["gain_tolerance"])
    return {"engine_spread": spread}, f"; by its spread one engine is off by {100.0 * spread:.3g} % in the proof"


def gain_deviations(deviation: LoopUncertainty, gain_db: float | None) -> float | None:
    """Return a gain margin, as ``ln`` of its factor, in standard deviations of the gain; None without either."""
    return None if gain_db is None or not deviation.gain else abs(gain_db) * log(10.0) / 20.0 / deviation.gain


def delay_deviations(deviation: LoopUncertainty, delay_s: float | None) -> float | None:
    """Return a delay margin in standard deviations of the delay; None without either."""
    return None if delay_s is None or not deviation.delay_s else delay_s / deviation.delay_s
