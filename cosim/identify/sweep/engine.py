"""Sweeping one engine: throttle around an operating point, thrust out."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp, log, pi, sqrt

import numpy as np

from cosim.base.arrays import Array
from cosim.base.errors import EngineError, InputError
from cosim.engine import EngineSpec, load_engine, make_bank
from cosim.identify.sweep.fit import MAX_DELAY_ROUNDING, Fit, fit
from cosim.identify.sweep.response import FrequencyResponse, Record, estimate, shortest_record
from cosim.identify.sweep.result import (
    MAX_SWEEP_S,
    Identification,
    Sweep,
    check_band,
    need_coherence,
    suitable_duration,
)
from cosim.simulation.script.command_script import make_sweep as chirp

MAX_SETTLING_S = 60.0  # for the thrust to come to rest
SETTLING_BAND = exp(-pi / sqrt(3.0))  # overshoot of poles with damping 0.5
BAND_FACTORS = (0.1, 10.0)  # band's ends over the corner frequency


def identify_engine(
    name: str | EngineSpec,
    parameters: Mapping[str, float] | None = None,
    *,
    step: float = 0.004,
    throttle: float = 0.5,
    amplitude: float | None = None,
    from_hz: float | None = None,
    to_hz: float | None = None,
    duration: float | None = None,
    lags: int = 0,
    hold: Mapping[str, float] | None = None,
) -> Identification:
    """Identify an engine (name, FMU file or object) around ``throttle``: one pole, ``lags`` more, a delay.

    The delay counts as whole where it is within 0.05 samples of it.  An engine that breathes does so in the standard
    atmosphere at sea level.  Raises InputError for an engine, a band or an
    amplitude that does not serve, or an FMU that fails on the way.

    >>> found = identify_engine("edf")
    >>> [f"{pole:.3f}" for pole in found.chosen.model.poles], found.refused
    (['0.875'], [])
    """
    engine = name if isinstance(name, EngineSpec) else load_engine(name, parameters or {}, step)
    room = min(throttle, 1.0 - throttle)
    if room <= 0.0:
        raise InputError(f"throttle {throttle:g}: must be between 0 and 1, so that it can be swept both ways")
    size = 0.4 * room if amplitude is None else amplitude
    if not 0.0 < size <= room:
        raise InputError(f"amplitude {size:g}: at throttle {throttle:g} it saturates; above 0 and at most {room:g}")
    try:
        low, high = _choose_band(engine, throttle, size, step, from_hz, to_hz)
        check_band(low, high, duration, step)
        sweep = Sweep(low, high, size, suitable_duration(low) if duration is None else duration)
        record = fly_sweep(engine, throttle, sweep, step)
    except EngineError as error:
        raise InputError(f"sweep of {engine.name}: {error}") from error
    response, notes = estimate_response(record, sweep, f"engine {engine.name}: its thrust", lags, hold)
    fits = _fit_forms(response, lags, hold)
    return Identification(
        kind="engine",
        subject=engine.name,
        engine=engine.family,
        channel="throttle to thrust",
        command_unit="throttle",
        output_unit="N",
        sweep=sweep,
        response=response,
        fits=fits,
        source=f"swept {low:.3g} to {high:.3g} Hz around throttle {throttle:g}, amplitude {size:.3g}",
        ledger_samples=None,
        reference=None,
        notes=tuple(notes),
    )


def estimate_response(
    record: Record, sweep: Sweep, subject: str, lags: int, hold: Mapping[str, float] | None = None
) -> tuple[FrequencyResponse, list[str]]:
    """Estimate the response twice, the second time with a model fitted to the first; return it with notes."""
    response = estimate(record, sweep.from_hz, sweep.to_hz)
    need_coherence(response, subject, sweep.amplitude)
    first = fit(response, lags, "first", hold).model
    response = estimate(record, sweep.from_hz, sweep.to_hz, first.response)
    return response, need_coherence(response, subject, sweep.amplitude)


def _fit_forms(response: FrequencyResponse, lags: int, hold: Mapping[str, float] | None) -> tuple[Fit, ...]:
    """Fit the form, first with a whole delay in samples if the free delay is nearly whole, then with a free delay."""
    free = fit(response, lags, "all free" if not hold else ", ".join(hold) + " held", hold)
    delay = round(free.model.delay_samples)
    if "delay_samples" in free.fixed or abs(free.model.delay_samples - delay) > MAX_DELAY_ROUNDING:
        return (free,)
    return (fit(response, lags, "whole delay", {**(hold or {}), "delay_samples": float(delay)}), free)


def _choose_band(
    engine: EngineSpec, throttle: float, size: float, step: float, low: float | None, high: float | None
) -> tuple[float, float]:
    """Return the band [Hz], by default a decade around the corner frequencies seen in a throttle step."""
    if low is not None and high is not None:
        return low, high
    quick, slow = (1.0 / (2.0 * np.pi * lag) for lag in _measure_lags(engine, throttle, size, step))
    # The band starts slightly above the lowest frequency that the longest sweep can measure.
    least = 1.01 * (shortest_record(1.0) / MAX_SWEEP_S)
    start = max(BAND_FACTORS[0] * slow, least) if low is None else low
    end = min(BAND_FACTORS[1] * quick, 0.4 / step) if high is None else high
    return float(start), float(end)


def settling_lag(engine: EngineSpec, step: float) -> float:
    """Return the settling lag [s] of thrust after a small step.  Raises InputError if the engine does not respond."""
    throttle = 0.5
    return _measure_lags(engine, throttle, 0.02, step)[1]


def _measure_lags(engine: EngineSpec, throttle: float, size: float, step: float) -> tuple[float, float]:
    """Return two lags [s] of a step response: of its rise and of its settling.

    The first is the time from 10 to 90 % over ln 9, the time constant of a single lag.  The second takes the time until
    the thrust stays within :data:`SETTLING_BAND` of its end, if that is later, as after a large overshoot, but not
    with two poles of damping 0.5.
    """
    with make_bank([engine], step) as bank:
        before = bank.reset(throttle).thrust[0]
        course: list[float] = []
        window = engine.settling_window
        while len(course) * step < MAX_SETTLING_S:
            course += [bank.step(len(course) + i, (throttle + size,)).thrust[0] for i in range(window)]
            swing = np.abs(np.array(course) - before).max()
            if swing > 0.0 and np.ptp(course[-window:]) <= 1e-6 * swing:
                break
    moved = np.abs(np.array(course) - before)
    if moved[-1] <= 1e-9 * max(1.0, abs(before)):
        more = f"; raise amplitude (now {size:g})" if size < min(throttle, 1.0 - throttle) else ""
        raise InputError(f"engine {engine.name}: its thrust does not answer the throttle around {throttle:g}{more}")
    first = int(np.argmax(moved >= 0.1 * moved[-1]))
    rise = int(np.argmax(moved >= 0.9 * moved[-1])) - first
    outside = np.flatnonzero(np.abs(np.array(course) - course[-1]) > SETTLING_BAND * moved[-1])
    settled = int(outside[-1]) + 1 - first if len(outside) else rise
    return max(rise, 1) * step / log(9.0), max(rise, settled, 1) * step / log(9.0)


def fly_sweep(
    engine: EngineSpec, throttle: float, sweep: Sweep, step: float, lead_steps: int = 10, still: float = 1e-9
) -> Record:
    """Run an engine from rest through the sweep to rest; record the deviations of throttle and thrust, N.

    ``still``: of the thrust's swing: what is left of the sweep when the record ends.
    """
    low, high = sweep.chirp_hz(step)
    length = round(sweep.duration_s / step)
    wave = chirp(step, lead_steps, length, sweep.amplitude, low, high)
    with make_bank([engine], step) as bank:
        start = bank.reset(throttle).thrust[0]
        thrust = [start]
        command: list[float] = []
        end = lead_steps + length
        window = engine.settling_window
        swing = 0.0
        while True:
            k = len(command)
            command.append(wave(k))
            thrust.append(bank.step(k, (throttle + command[-1],)).thrust[0])
            if k == end:
                swing = float(np.ptp(thrust))
            if k > end and (k - end) % window == 0:
                tail = np.abs(np.array(thrust[-window:]) - start).max()
                if tail <= still * swing or (k - end) * step > MAX_SETTLING_S:
                    break
    injected: Array = np.array(command)
    return Record(injected, injected, np.array(thrust[:-1]) - start, step)
