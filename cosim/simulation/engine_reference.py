"""The reference model of the engine monitor, measured on the engine itself."""

from __future__ import annotations

from itertools import pairwise, zip_longest
from math import exp
from typing import NamedTuple

from cosim.base.protocols import Engines
from cosim.base.storage.cache import RecentCache
from cosim.control.allocation.engine_monitor import EngineReference
from cosim.engine import EngineSpec, make_bank

_EXTREME_STEPS = ((0.6, 0.4), (0.0, 0.2), (0.2, 0.0), (0.0, 1.0), (1.0, 0.0))  # throttle steps where lags may differ
# Duration [s] after which a step response has settled; fraction of a change that counts as none.
_MAX_RESPONSE_S, _NO_CHANGE = 20.0, 1e-6


class SmallStepResponse(NamedTuple):
    """Response of an engine to small throttle changes around a constant throttle."""

    delay: float | None  # control steps at low frequency, or None
    speed: float  # rad/s; 0: has no speed port
    speed_per_n: float  # rad/s per N of steady thrust
    # Thrust change at the end of each step over the final change, mean of steps up and down; (): no response.
    response: tuple[float, ...] = ()


_references: RecentCache[EngineReference] = RecentCache(64)
_flows: RecentCache[float] = RecentCache(64)
_around: RecentCache[SmallStepResponse] = RecentCache(64)


def make_engine_reference(spec: EngineSpec, step: float) -> EngineReference:
    """Return the reference of a healthy engine: static curves, lag and delay, stated or measured by stepping it.

    An engine that states no lag is no linear one: its lag is measured up and down, from idle and over its whole range.
    Raises EngineError if the engine fails.
    """
    key = (*spec.behaviour_key, spec.curve, spec.lag, spec.transport_delay, step)
    return _references.get(key, lambda: _measure_reference(spec, step))


def measure_fuel_flow(spec: EngineSpec, throttle: float, step: float) -> float | None:
    """Return the steady fuel flow [kg/s] at a throttle; None if not reported.  Raises EngineError."""
    if not spec.has_port("fuel_flow"):
        return None
    return _flows.get((*spec.behaviour_key, throttle, step), lambda: _measure_fuel_flow(spec, throttle, step))


def measure_small_steps(
    spec: EngineSpec, throttle: float, step: float, sizes: tuple[float, ...] = (0.001, 0.05)
) -> SmallStepResponse:
    """Return the mean response of an engine to small throttle steps up and down, from rest at ``throttle``.

    ``sizes``: of the steps, of throttle; the first that the engine sees is taken: there are ECUs that miss the first.
    The delay is the mean over both ways of ``sum (y_end - y_k) / (y_end - y_0)`` over the steps ``k`` after the move.
    Raises EngineError if the engine fails.
    """
    return _around.get(
        (*spec.behaviour_key, throttle, step, sizes), lambda: _measure_both_ways(spec, throttle, step, sizes)
    )


def _measure_both_ways(spec: EngineSpec, throttle: float, step: float, sizes: tuple[float, ...]) -> SmallStepResponse:
    with make_bank([spec], step) as bank:
        for by in sizes:
            low, high = max(0.0, throttle - by), min(1.0, throttle + by)
            ends = []
            for end in (low, high):
                output = bank.reset(end)
                ends.append((output.thrust[0], output.spool_speed[0] if spec.has_port("spool_speed") else 0.0))
            (less, slow), (more, fast) = ends
            expected = spec.thrust_at(high) - spec.thrust_at(low)
            # The change counts as visible from half of that of the static curve on.
            if abs(more - less) < 0.5 * abs(expected) or more == less:
                continue
            answers = [_remaining_change(bank, throttle, end, step) for end in (low, high) if end != throttle]
            late = [sum(remaining_fraction) for remaining_fraction in answers]
            per_newton = (fast - slow) / (more - less)
            course = [1.0 - sum(remaining) / len(answers) for remaining in zip_longest(*answers, fillvalue=0.0)]
            return SmallStepResponse(sum(late) / len(late), 0.5 * (slow + fast), per_newton, tuple(course))
        speed = bank.reset(throttle).spool_speed[0] if spec.has_port("spool_speed") else 0.0
        return SmallStepResponse(None, speed, 0.0)


def _remaining_change(bank: Engines, first: float, then: float, step: float) -> list[float]:
    """Return the remaining fraction of a thrust change after each control step, until it is small for a second."""
    after = bank.reset(then).thrust[0]
    change = after - bank.reset(first).thrust[0]
    course, quiet = [], 0
    for k in range(round(_MAX_RESPONSE_S / step)):
        remaining_fraction = (after - bank.step(k, (then,)).thrust[0]) / change
        course.append(remaining_fraction)
        quiet = quiet + 1 if abs(remaining_fraction) < _NO_CHANGE else 0
        if quiet * step >= 1.0:
            break
    return course


def _measure_fuel_flow(spec: EngineSpec, throttle: float, step: float) -> float:
    with make_bank([spec], step) as bank:
        return bank.reset(throttle).fuel_flow[0]


def _measure_reference(spec: EngineSpec, step: float) -> EngineReference:
    lag, delay = spec.lag, spec.transport_delay
    lags = (lag, lag)
    speed: list[float] | None = None
    with make_bank([spec], step) as bank:
        if spec.has_port("spool_speed"):
            speed = [bank.reset(throttle).spool_speed[0] for throttle in spec.curve.throttle]
            if not all(b > a for a, b in pairwise(speed)):
                speed = None
        if lag is None or delay is None:
            # A step around hover, wide enough to measure the lag but not to reach the limits.
            measured, begins = _measure_response(bank, 0.4, 0.6, step)
            delay = begins if delay is None else delay
            if lag is None:
                # The time to 63 % counts from the throttle step, so the lag fits the delay that is used.
                lag = max(step, measured + begins - delay)
                others = [sum(_measure_response(bank, *point, step)) - delay for point in _EXTREME_STEPS]
                lags = max(step, min(lag, *others)), max(lag, *others)
    shortest, longest = lags
    assert shortest is not None
    assert longest is not None
    return EngineReference(spec.curve.throttle, spec.curve.thrust, speed, lag, delay, shortest, longest)


def _measure_response(bank: Engines, first: float, then: float, step: float) -> tuple[float, float]:
    """Return lag and delay [s] of a step of the throttle: the time without motion, and then to 63 % of the change."""
    after = bank.reset(then).thrust[0]
    before = bank.reset(first).thrust[0]
    begin = None
    for k in range(round(_MAX_RESPONSE_S / step)):
        fraction = (bank.step(k, (then,)).thrust[0] - before) / (after - before)
        if begin is None and abs(fraction) > _NO_CHANGE:
            begin = k
        if begin is not None and fraction >= 1.0 - exp(-1.0):
            return (k + 1 - begin) * step, begin * step
    return _MAX_RESPONSE_S, 0.0
