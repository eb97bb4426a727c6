"""A loop broken in flight: a multisine added between a controller and its actuators, and what passes before and behind.

The break is at the plant's input, which every controller has, whatever it is made of: its throttles and tilts.  What
an axis is commanded is read from them as a number,

    roll    sum_i a_i s_i u_i,  a_i = -y_i / sum |y|      u_i throttle, s_i slope of the static thrust curve at hover
    pitch   half the sum of the tilts of the two servos      yaw   half their difference
    a multirotor: as roll, with the levers x_i about pitch and the reactions about yaw
    allocation by effectiveness: sum_i e_i u_i of throttles and hinges, e_i the angular acceleration that each gives

and the multisine is added to the same actuators, so that it is read as itself.  No controller is told of it, nor of
what it added to: what a controller takes for applied is its own answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.constants import GRAVITY
from cosim.base.errors import FlightError, InputError
from cosim.base.protocols import Controller, EngineState
from cosim.base.signals import AXES, Actuation, Command, Disturbance, Measured
from cosim.engine import EngineSpec
from cosim.simulation.axis_chain import is_turned_by_throttle, levers
from cosim.simulation.build import build
from cosim.simulation.controllers.allocators import make_effectiveness
from cosim.simulation.controllers.source import Source
from cosim.simulation.step import Simulation
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from cosim.vehicle.tank import Tank

THRUST_PEAK, TILT_PEAK = 0.03, 0.06  # default peaks: thrust fraction, rad


@dataclass(frozen=True)
class Multisine:
    """Sines of whole periods in ``period`` steps, at ``bins`` times the lowest frequency, ``wave`` their sum."""

    period: int
    step: float
    bins: Array
    wave: Array  # scaled to peak 1

    @property
    def hertz(self) -> Array:
        """The frequencies [Hz]."""
        return self.bins / (self.period * self.step)


def multisine(
    period_s: float, step: float, low: float, high: float, lines_per_decade: int = 36, draws: int = 64
) -> Multisine:
    """Make a multisine, even over the logarithm of Hz, with the lowest peak of :data:`draws` draws of random phases.

    Raises InputError for a band that the period or the step has no lines in.  ``lines_per_decade``: of a multisine in a
    decade: one is 7 % above the one before.  ``draws``: of phases, of which those with the lowest peak are taken.
    """
    period = round(period_s / step)
    first, last = ceil(low * period * step - 1e-9), floor(high * period * step + 1e-9)
    if low * period * step < 1.0 - 1e-9 or last - first < 10 or 2 * last > period:
        raise InputError(
            f"{low:g} to {high:g} Hz with a period of {period_s:g} s: the lowest must be at least {1.0 / period_s:.3g} "
            f"Hz, the highest at most {0.5 / step:g} Hz and {10.0 / period_s:.3g} Hz above it"
        )
    count = ceil(lines_per_decade * np.log10(last / first)) + 1
    bins = np.unique(np.round(np.geomspace(first, last, count))).astype(np.float64)
    # Exponent of 1 / f by which power grows towards the lowest decade, where noise would hide the lines.
    exponent = 0.5
    size = np.maximum(1.0, 10.0 * first / bins) ** exponent
    turn = 2.0 * np.pi * np.outer(np.arange(period), bins) / period
    cosines, sines = np.cos(turn) * size, np.sin(turn) * size
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (draws, len(bins)))
    if 2 * last == period:
        # At half the sampling rate a sine can only have phase 0 or pi.
        phases[:, -1] = np.pi * np.round(phases[:, -1] / (2.0 * np.pi))
    waves = cosines @ np.cos(phases.T) - sines @ np.sin(phases.T)
    peaks = np.abs(waves).max(axis=0)
    best = int(peaks.argmin())
    return Multisine(period, step, bins, np.asarray(waves[:, best] / peaks[best], np.float64))


class Tap:
    """Access to one axis of the output of a controller: how to read it, and how to add to it."""

    def __init__(self, axis: str, scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]) -> None:
        index = AXES.index(axis)
        self._moves: list[float] = []
        self._turns: list[float] = []
        self.tilts = not is_turned_by_throttle(vehicle, index)
        self.unit, self.usual = ("rad of tilt", TILT_PEAK) if self.tilts else ("share of thrust", THRUST_PEAK)
        if vehicle.allocation == "effectiveness":
            self._by_effectiveness(axis, scenario, vehicle, stations)
            return
        self._sides = (1.0, 1.0) if axis == "pitch" else (1.0, -1.0)
        arms = levers(vehicle, index)
        arm_sum = sum(abs(lever) for lever in arms)
        if not self.tilts and not arm_sum:
            raise InputError(f"{vehicle.name}: its engines give no {axis} moment")
        slopes = [_relative_slope(spec, vehicle.mass_kg * GRAVITY / len(vehicle.jets)) for spec in stations]
        if not self.tilts:
            self._weights = [lever * slope / arm_sum for lever, slope in zip(arms, slopes, strict=True)]
            self._adds = [float(np.sign(lever)) / slope for lever, slope in zip(arms, slopes, strict=True)]

    def _by_effectiveness(
        self, axis: str, scenario: Scenario, vehicle: Vehicle, stations: Sequence[EngineSpec]
    ) -> None:
        """Set the tap as the allocation splits a small angular acceleration in hover, with the effect of each part."""
        fractions, effects = make_effectiveness(scenario, vehicle, stations[0]).unit_changes(AXES.index(axis))
        jets, weight = len(vehicle.jets), vehicle.mass_kg * GRAVITY
        if not any(fractions):
            raise InputError(f"{vehicle.name}: its engines give no {axis} moment")
        spans = [spec.curve.thrust[-1] - spec.curve.thrust[0] for spec in stations]
        newtons = [_relative_slope(spec, weight / jets) * span for spec, span in zip(stations, spans, strict=True)]
        self.unit = "rad/s^2"
        self._weights = [effect * newton for effect, newton in zip(effects, newtons, strict=False)]
        self._adds = [fraction / newton for fraction, newton in zip(fractions, newtons, strict=False)]
        self._turns, self._moves = effects[jets:], fractions[jets:]
        limits = [abs(add) / THRUST_PEAK for add in self._adds] + [abs(move) / TILT_PEAK for move in self._moves]
        self.usual = float(f"{1.0 / max(limits):.2g}")

    @property
    def by_thrust(self) -> bool:
        """Whether thrust alone turns the axis, and nothing that tilts."""
        return not self.tilts and not any(self._moves)

    def read(self, actuation: Actuation) -> float:
        """Return the command of the axis: a fraction of thrust, rad of tilt, or rad/s^2."""
        if self.tilts:
            left, right = actuation.tilt
            return 0.5 * (self._sides[0] * left + self._sides[1] * right)
        turned = sum([turn * angle for turn, angle in zip(self._turns, actuation.tilt, strict=False)])
        return turned + sum([w * throttle for w, throttle in zip(self._weights, actuation.throttle, strict=True)])

    def add(self, actuation: Actuation, value: float) -> Actuation:
        """Return the actuation with ``value`` more on the axis, throttles limited to 0 to 1."""
        if self.tilts:
            left, right = actuation.tilt
            return actuation._replace(tilt=(left + self._sides[0] * value, right + self._sides[1] * value))
        throttle = [command + value * gain for command, gain in zip(actuation.throttle, self._adds, strict=True)]
        if self._moves:
            moved = [angle + value * move for angle, move in zip(actuation.tilt, self._moves, strict=True)]
            actuation = actuation._replace(tilt=tuple(moved))
        return actuation._replace(throttle=tuple([min(max(command, 0.0), 1.0) for command in throttle]))


def _relative_slope(spec: EngineSpec, thrust: float, secant: float = 0.02) -> float:
    """Return the slope of an engine's static curve at a thrust, N, over that of the curve's chord."""
    curve = spec.curve
    span = curve.thrust[-1] - curve.thrust[0]
    at = float(np.interp(thrust, curve.thrust, curve.throttle))
    low, high = max(0.0, at - secant), min(1.0, at + secant)
    below, above = np.interp([low, high], curve.throttle, curve.thrust)
    return float((above - below) / (high - low) / span)


class TappedController:
    """Controller with a signal added to its output; it records the output before and after."""

    def __init__(self, inner: Controller, tap: Tap, wave: Callable[[int], float]) -> None:
        self._inner, self._tap, self._wave = inner, tap, wave
        self.before: list[float] = []
        self.behind: list[float] = []
        self.refused = 0  # steps in which allocation gave less

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def update(self, command: Command, measured: Measured, injected: Disturbance, engines: EngineState) -> Actuation:
        """Return the controller's command and the multisine: see :class:`cosim.base.protocols.Controller`."""
        actuation = self._inner.update(command, measured, injected, engines)
        sent = self._tap.add(actuation, self._wave(len(self.before)))
        self.before.append(self._tap.read(actuation))
        self.behind.append(self._tap.read(sent))
        self.refused += any(actuation.unallocated)
        return sent


@dataclass(frozen=True)
class Record:
    """Whole periods of a multisine in flight, after the first, which is a transient."""

    sine: Multisine
    amplitude: float
    before: Array  # array of (periods, steps)
    behind: Array
    clipped: bool  # True: something saturated

    def sensitivity(self) -> Complex:
        """Return ``S = behind / added`` of each period and line, (periods, lines).

        What drifts over the periods, as a throttle does while something warms up, is taken off as a straight line.
        """
        added = self.behind - self.before
        return np.asarray(self._spectrum(_remove_drift(self.behind)) / self._spectrum(added))

    def _spectrum(self, values: Array) -> Complex:
        return np.asarray(np.fft.rfft(values, axis=1)[:, self.sine.bins.astype(int)])


def _remove_drift(values: Array) -> Array:
    """Return values by period and step without the straight line along which the periods' means drift."""
    periods, steps = values.shape
    slope = np.polyfit(np.arange(periods) * steps, values.mean(axis=1), 1)[0] if periods > 1 else 0.0
    return np.asarray(values - slope * np.arange(values.size).reshape(values.shape))


def still(scenario: Scenario) -> Scenario:
    """Return the scenario with the vehicle at rest in its air: without commands, faults and passing disturbances.

    Engines are not watched, since a monitor takes what is added for an engine's own.  Raises InputError for one that
    stands on the ground or is flown by the autopilot.
    """
    if scenario.requests is not None or scenario.initial.on_ground:
        raise InputError(
            f"scenario {scenario.name}: margins are measured in flight at a height that is held; take one that begins "
            "there and is not flown by the autopilot, such as hover"
        )
    for_ever = [
        entry.model_dump(mode="json", exclude_none=True)
        for entry in scenario.disturbance
        if entry.kind in ("force", "moment", "wind", "payload") and not entry.start_s and entry.duration_s is None
    ]
    return scenario.replace(
        command=[], fault=[], disturbance=for_ever, expect=[], monitor=False, limits={}, controller_limit_s=60.0
    )


def fly_excitation(
    scenario: Scenario, axis: str, sine: Multisine, amplitude: float, periods: int, source: Source | None = None
) -> Record:
    """Fly one transient period and ``periods`` that are kept, without burning fuel.

    Raises FlightError where the flight ends before.
    """
    steps = sine.period * (periods + 1)
    flight = scenario.replace(duration_s=steps * scenario.step_s)
    with build(flight, source) as simulation:
        tapped = _tap_loop(simulation, axis, sine, amplitude)
        ending = simulation.run()
    if ending.outcome != "completed":
        raise FlightError(ending.reason)
    before, behind = (np.array(rows).reshape(periods + 1, sine.period)[1:] for rows in (tapped.before, tapped.behind))
    excitation = amplitude * sine.wave
    off = float(np.abs(behind - before - excitation).max())
    return Record(sine, amplitude, before, behind, off > 1e-9 * amplitude + 1e-12 or tapped.refused > 0)


def _tap_loop(simulation: Simulation, axis: str, sine: Multisine, amplitude: float) -> TappedController:
    wave = (amplitude * sine.wave).tolist()
    period = sine.period
    tap = Tap(axis, simulation.scenario, simulation.vehicle, simulation.stations)
    tapped = TappedController(simulation.controller, tap, lambda k: wave[k % period])
    fuel = simulation.vehicle.fuel
    if fuel is not None:
        # The tank has its fuel at the start; with a step of 0 nothing is burnt.
        simulation.propulsion.tank = Tank(fuel.mass_kg, 0.0, simulation.scenario.initial.fuel)
    simulation.controller = tapped
    simulation.reset()
    tapped.before.clear()
    return tapped
