"""Sweeping one axis of the flying vehicle: torque command in, measured rate out, with the loop closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import InputError, NotIdentifiedError
from cosim.base.signals import AXES, Sample
from cosim.base.storage.toml import parse_setting, set_path
from cosim.control.predictors.registry import BASELINE
from cosim.engine import EngineSpec, load_engine
from cosim.identify.sweep.engine import estimate_response, settling_lag
from cosim.identify.sweep.fit import Fit, fit
from cosim.identify.sweep.response import FrequencyResponse, Record
from cosim.identify.sweep.result import (
    Identification,
    Sweep,
    check_band,
    note_off_ledger,
    suitable_duration,
    why_refused,
)
from cosim.simulation.axis_chain import is_turned_by_throttle, list_hinged_parts
from cosim.simulation.build import build
from cosim.simulation.controllers.allocators import make_effectiveness
from cosim.simulation.delay_ledger import explain_unknown, sum_samples
from cosim.simulation.ending import Ending
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle, aircraft_seen_from, engine_of, file_seen_from, load_vehicle

# Largest amplitude by unit of the command; no vehicle can follow a larger one.
MAX_AMPLITUDE = {"throttle": 1.0, "rad": 1.5707963267948966, "rad/s^2": 200.0}


class SweepTuning(NamedTuple):
    """Settings of automatic sweeps and their repetitions."""

    lead_s: float = 1.0
    rest_s: float = 6.0  # s for the loop to come to rest
    # Limits of the automatic band: no loop flown here is faster than max_hz; below min_hz a sweep lasts so long that
    # fuel and position change. ``span`` is the end of the band over its start, ``corners`` its end over the engine's
    # corner frequency, above which an engine hardly responds.
    max_hz: float = 6.0
    min_hz: float = 0.1
    span: float = 20.0
    corners: float = 4.0
    # If engines give at least this fraction of an axis's torque, their lag limits the band.
    min_share: float = 0.05
    # First amplitude, in the unit of the axis; reduced while the command saturates.
    amplitude: float = 0.02
    tries: int = 6
    # Factor on the amplitude if noise hides the response, and the largest number of such repetitions.
    louder: float = 3.0
    louder_tries: int = 3
    # Factor on the amplitude after the vehicle crashed or diverged.
    after_loss: float = 0.3
    # Factor on the largest unsaturated amplitude; later tries take its cube, as noise alone exceeds limits slightly.
    margin: float = 0.8
    margin_tries: int = 4


TUNING = SweepTuning()  # settings of automatic sweeps


UNITS = {"roll": "throttle", "pitch": "rad", "yaw": "rad"}  # unit of each axis's command
# First amplitude of angular accelerations: half of what ``TUNING.amplitude`` of throttle gives the Hex-Jet, which has
# 433 rad/s^2 at full throttle.
ACCELERATION, ACCELERATION_UNIT = 4.0, "rad/s^2"


def identify_axis(
    axis: str,
    aircraft: str = "hexjet",
    engine: str | None = None,
    controller: str | None = None,
    *,
    substeps: int | None = None,
    seed: int | None = None,
    settings: Sequence[str] = (),
    amplitude: float | None = None,
    from_hz: float | None = None,
    to_hz: float | None = None,
    duration: float | None = None,
    lags: int = 1,
    hold: Mapping[str, float] | None = None,
) -> Identification:
    """Identify the rate response of an axis as a slow pole, ``lags`` lags and a delay.

    A chirp is added to the rate controller's output while the vehicle holds still; the command is what was applied in
    the end.  ``settings`` are ``KEY=VALUE`` over the scenario.  Beside the chosen form come the one with the engine's
    own delay held, and one with a lag more.  Raises InputError for a band, an amplitude or a loop that does not serve.
    """
    if axis not in AXES:
        raise InputError(f"unknown axis {axis!r}; allowed: {', '.join(AXES)}")
    if amplitude is not None and not amplitude > 0.0:
        raise InputError(f"amplitude {amplitude:g}: must be above 0")
    base = _make_scenario(axis, aircraft, engine, controller, substeps, seed, settings)
    vehicle = base.resolved_vehicle()[0]
    accelerates = vehicle.allocation == "effectiveness"
    usual, unit = (ACCELERATION, ACCELERATION_UNIT) if accelerates else (TUNING.amplitude, UNITS[axis])
    if unit == "rad" and is_turned_by_throttle(vehicle, AXES.index(axis)):
        unit = UNITS["roll"]
    size = usual if amplitude is None else amplitude
    if size > MAX_AMPLITUDE[unit]:
        raise InputError(f"amplitude {size:g}: at most {MAX_AMPLITUDE[unit]:.4g} {unit}, more than any vehicle follows")
    low, high = _choose_band(base, vehicle, axis, from_hz, to_hz)
    check_band(low, high, duration, base.step_s)
    seconds = suitable_duration(low) if duration is None else duration
    requested, subject = Sweep(low, high, size, seconds), f"{base.aircraft_name} {axis}"
    flight, response, notes = _fly_until_coherent(base, axis, requested, amplitude is None, subject, lags)
    sweep, family = flight.sweep, flight.engine.family
    # Pitch and yaw turn the jets and do not throttle them; an axis shared by hinges and engines has no single delay.
    own_delay = flight.engine.transport_delay if axis == "roll" and not accelerates else None
    fits = _fit_forms(response, lags, hold, None if own_delay is None else own_delay / base.step_s)
    return Identification(
        kind="axis",
        subject=base.aircraft_name,
        engine=family,
        channel=axis,
        command_unit=unit,
        output_unit="rad/s",
        sweep=sweep,
        response=response,
        fits=fits,
        source=f"swept {low:g} to {high:g} Hz in flight, amplitude {sweep.amplitude:.3g}, "
        f"{base.aircraft_name} with {family}; {fits[0].label}",
        ledger_samples=flight.ledger_samples,
        no_ledger=flight.no_ledger,
        engine_sha256=flight.engine.fingerprint,
        reference=flight.vehicle.identified.get(family, {}).get(axis),  # type: ignore[call-overload]
        notes=(*notes, *note_off_ledger(fits[0], flight.ledger_samples, low)),
    )


def _choose_band(
    base: Scenario, vehicle: Vehicle, axis: str, from_hz: float | None, to_hz: float | None
) -> tuple[float, float]:
    """Return the band [Hz], by default from the lag of the engines if they turn the axis.

    From the engine's answer to a step about hover: above ``TUNING.corners`` times its corner it hardly answers.
    """
    high = TUNING.max_hz
    if from_hz is None or to_hz is None:
        parameters, unchecked = base.engine_parameters, base.engine_unchecked
        engine = load_engine(base.engine, parameters, base.step_s, unchecked=unchecked, isolated=base.engine_isolated)
        if _is_turned_by_engines(base, vehicle, engine, AXES.index(axis)):
            high = min(TUNING.max_hz, TUNING.corners / (2.0 * np.pi * settling_lag(engine, base.step_s)))
    high = high if to_hz is None else to_hz
    low = min(max(high / TUNING.span, TUNING.min_hz), 0.5 * high) if from_hz is None else from_hz
    return _round_value(low) if from_hz is None else low, _round_value(high) if to_hz is None else high


def _is_turned_by_engines(base: Scenario, vehicle: Vehicle, engine: EngineSpec, index: int) -> bool:
    if vehicle.allocation != "effectiveness":
        return is_turned_by_throttle(vehicle, index)
    hinged = list_hinged_parts(vehicle, make_effectiveness(base, vehicle, engine), index, engine, base.step_s)
    return abs(hinged[0].fraction) > TUNING.min_share


def _fly_until_coherent(
    base: Scenario, axis: str, sweep: Sweep, automatic: bool, subject: str, lags: int
) -> tuple[_Signals, FrequencyResponse, list[str]]:
    """Fly the sweep and estimate the response; repeat with larger automatic amplitudes while noise hides points.

    Raises NotIdentifiedError if noise hides the response at every amplitude.
    """
    flight = _fly_unsaturated(base, axis, sweep, automatic)
    best: tuple[_Signals, FrequencyResponse, list[str]] | None = None
    refusal: NotIdentifiedError | None = None
    for _ in range(TUNING.louder_tries if automatic else 1):
        try:
            best = (flight, *estimate_response(flight.record(), flight.sweep, subject, lags))
        except NotIdentifiedError as error:
            refusal = error
        if not automatic or (best and not best[2] and not why_refused(fit(best[1], lags, "first"), engine=False)):
            break
        flight = _fly_sweep(base, axis, replace(sweep, amplitude=_round_value(TUNING.louder * flight.sweep.amplitude)))
        if not flight.is_usable:
            break
    if best is None:
        assert refusal is not None
        raise refusal
    return best


@dataclass(frozen=True)
class _Signals:
    """Signals and ending of a flown sweep."""

    sweep: Sweep
    ending: Ending
    vehicle: Vehicle
    engine: EngineSpec
    step: float
    injected: Array
    command: Array  # as applied: delayed, disturbed, limited
    rate: Array  # as the gyro measures it
    ledger_samples: float | None  # command to rate; None: see no_ledger
    no_ledger: str
    fitting_fraction: float  # of the amplitude, without saturation

    @property
    def is_usable(self) -> bool:
        return self.ending.outcome == "completed" and self.fitting_fraction == 1.0

    def record(self) -> Record:
        return Record(self.injected, self.command, self.rate, self.step)


class _SignalRecorder:
    """Observer that records the signals needed for identification."""

    def __init__(self, axis: int) -> None:
        self._axis = axis
        self.rows: list[tuple[float, float, float, float, float]] = []

    def observe(self, sample: Sample) -> None:
        axis, unallocated = self._axis, sample.actuation.unallocated
        self.rows.append(
            (
                sample.control.torque[axis],
                sample.disturbance.torque_command[axis],
                unallocated[axis],
                unallocated.collective if axis == 0 else 0.0,
                sample.measured.rate[axis],
            )
        )


def _make_scenario(
    axis: str,
    aircraft: str,
    engine: str | None,
    controller: str | None,
    substeps: int | None,
    seed: int | None,
    settings: Sequence[str],
) -> Scenario:
    """Return a hover scenario, with the baseline controller if the engine has no identified model."""
    data: dict[str, Any] = {"name": f"identify-{axis}", "duration_s": 1.0}
    data["aircraft"] = aircraft_seen_from(aircraft, Path())
    given = {"controller": controller, "substeps": substeps, "seed": seed}
    given["engine"] = engine_of(data["aircraft"]) if engine is None else file_seen_from(engine, Path())
    data |= {key: value for key, value in given.items() if value is not None}
    for text in settings:
        key, value = parse_setting(text)
        set_path(data, key, value, f"identify {axis}: settings")
    scenario = Scenario.from_table(data, Path(), f"identify {axis}")
    vehicle, _ = load_vehicle(scenario.aircraft, scenario.vehicle, f"identify {axis}: vehicle")
    changes: dict[str, Any] = {}
    if "controller" not in data and Path(scenario.engine).name.removesuffix("-fmi2") not in vehicle.identified:
        changes["controller"] = BASELINE.name
    return scenario.replace(**changes) if changes else scenario


def _fly_unsaturated(base: Scenario, axis: str, sweep: Sweep, automatic: bool) -> _Signals:
    """Fly the sweep, with smaller amplitudes while the command saturates.

    Raises InputError if a stated amplitude saturates, with one that fits, or if the loop itself is not stable.
    """
    flight = _fly_sweep(base, axis, sweep)
    if flight.is_usable:
        return flight
    where = f"{base.aircraft_name} {axis} with {flight.engine.name}, controller {base.controller}"
    smaller = flight
    for tries in range(TUNING.tries):
        is_lost = smaller.ending.outcome != "completed"
        margin = TUNING.margin if tries < TUNING.margin_tries else TUNING.margin**3
        factor = TUNING.after_loss if is_lost else max(TUNING.after_loss, margin * smaller.fitting_fraction)
        smaller = _fly_sweep(base, axis, replace(sweep, amplitude=_round_value(factor * smaller.sweep.amplitude)))
        if smaller.is_usable or smaller.ending.outcome == "failed":
            break
    if smaller.ending.outcome == "failed":
        raise InputError(f"{where}: {smaller.ending.reason}")
    if not smaller.is_usable:
        is_lost = smaller.ending.outcome != "completed"
        how = smaller.ending.reason if is_lost else "it swings between its limits"
        raise InputError(
            f"{where}: the loop is not stable ({how}, swept with {smaller.sweep.amplitude:g}); choose another "
            f"controller or less gain: vehicle.control.rate.{axis}.p, vehicle.control.attitude.gain_1_s"
        )
    if automatic:
        return smaller
    is_lost = flight.ending.outcome != "completed"
    trouble = f"loses the vehicle ({flight.ending.reason})" if is_lost else "saturates"
    raise InputError(f"{where}: amplitude {sweep.amplitude:g} {trouble}; {smaller.sweep.amplitude:g} fits")


def _round_value(value: float) -> float:
    return float(f"{value:.2g}")


def _fly_sweep(base: Scenario, axis: str, sweep: Sweep) -> _Signals:
    step = base.step_s
    low, high = sweep.chirp_hz(step)
    length = round(sweep.duration_s / step)
    lead, settling = round(TUNING.lead_s / step), round(TUNING.rest_s / step)
    table = {
        "kind": "torque_command",
        "axis": axis,
        "shape": "sweep",
        "start_s": lead * step,
        "duration_s": length * step,
        "amplitude": sweep.amplitude,
        "from_hz": low,
        "to_hz": high,
    }
    before = [entry.model_dump(mode="json", exclude_none=True) for entry in base.disturbance]
    scenario = base.replace(duration_s=(lead + length + settling) * step, disturbance=[*before, table])
    index = AXES.index(axis)
    watch = _SignalRecorder(index)
    with build(scenario) as simulation:
        ending = simulation.run([watch])
        vehicle, engine = simulation.vehicle, simulation.engine
        ledger, no_ledger = sum_samples(simulation.ledger, axis), explain_unknown(simulation.ledger, axis)
    requested, injected, refused, cut, rate = (np.array(column) for column in zip(*watch.rows, strict=True))
    late = scenario.added_delay_samples if index == 0 else 0
    if late:
        requested = np.concatenate([np.zeros(late), requested[:-late]])[: len(requested)]
    command = requested + injected
    if ledger is not None:
        ledger -= late
    granted = _granted_fraction(command, refused, cut)
    return _Signals(sweep, ending, vehicle, engine, step, injected, command - refused, rate, ledger, no_ledger, granted)


def _granted_fraction(command: Array, refused: Array, cut: Array) -> float:
    """Return the least fraction of the command that was allocated; collective given up for roll counts as refused."""
    short = np.maximum(np.abs(refused), np.abs(cut))
    hit = short > 0.0
    if not hit.any():
        return 1.0
    return float(np.clip(1.0 - short[hit] / np.maximum(np.abs(command[hit]), short[hit]), 0.0, 0.999).min())


def _fit_forms(
    response: FrequencyResponse, lags: int, hold: Mapping[str, float] | None, delay: float | None
) -> tuple[Fit, ...]:
    """Fit the form with ``lags`` lags first, then other forms for comparison."""
    fixed = dict(hold or {})
    name = "1 lag" if lags == 1 else f"{lags} lags"
    fits = [fit(response, lags, ", ".join([name, *(f"{held} held" for held in fixed)]), fixed)]
    if not fixed and delay is not None:
        fits.append(fit(response, lags, f"{name}, engine's delay", {"delay_samples": delay}))
    if not fixed:
        fits.append(fit(response, lags + 1, f"{lags + 1} lags"))
    return tuple(fits)
