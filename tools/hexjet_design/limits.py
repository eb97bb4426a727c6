"""What limits a design: its bandwidth without each limit, its tolerances checked, and what would allow a design."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import ceil, floor, isfinite

import numpy as np

from cosim.base.errors import InputError
from cosim.simulation.controllers.controller_file import Requirements
from cosim.spec.vehicle import EngineLead
from hexjet_design.assessment import Assessment, AxisDesign
from hexjet_design.loop.actuator import SERVO
from hexjet_design.loop.channel import Channel, engine_lead
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import excesses, fine_loop
from hexjet_design.loop.tuning import Tuning
from hexjet_design.tune import TuningResult, tune

GAIN_COUNT = 7  # gains tried within the tolerance
BISECTIONS = 5  # steps to find an allowance

Say = Callable[[str], None]  # receives the progress of the search


def bandwidths_without_limits(
    channel: Channel, after: Assessment, need: Requirements, lead: EngineLead | None
) -> dict[str, float]:
    """Compute the bandwidth, Hz, that the same controller would reach without each limit, by the limit's name."""
    free = need.model_copy(update={"min_bandwidth_hz": 0.0})
    chosen_lead = lead if after.tuning.lead else None
    cases: dict[str, tuple[Channel, Requirements]] = {"delay": (channel.with_delay(0.0), free)}
    if channel.identified is None:
        cases["lag"] = (channel.with_lags(0.0), free)
    cases["noise and saturation"] = (channel, free.model_copy(update={"noise_share": 1e6, "step_rad": 0.0}))
    limits = {}
    for limit, (changed, needed) in cases.items():
        led = None if limit == "lag" else chosen_lead
        tuned = tune(changed, after.controller, changed.model("without"), after.tuning, needed, lead=led)
        if isfinite(tuned.objective):
            limits[limit] = fine_loop(changed, tuned.tuning).bandwidth
    return limits


def tolerance_checks(channel: Channel, tuning: Tuning, need: Requirements) -> dict[str, bool]:
    """Check that a loop is stable for all tolerated whole samples of delay and gains, and lags 30 % off."""
    wide = need.delay_samples(channel.transport_samples)
    middle = channel.actuator_delay
    whole = map(float, range(max(0, ceil(middle - wide)), floor(middle + wide) + 1))
    delays = sorted({max(0.0, middle - wide), middle, middle + wide, *whole})
    gains = np.linspace(1.0 - need.gain_tolerance, 1.0 + need.gain_tolerance, GAIN_COUNT)
    checks = {}
    checks[f"gain {gains[0]:.2f} to {gains[-1]:.2f} times delay {delays[0]:g} to {delays[-1]:g} samples"] = all(
        _is_stable(replace(channel.with_delay(delay), gain=channel.gain * gain), tuning)
        for delay in delays
        for gain in (gains if channel.identified is None else gains[GAIN_COUNT // 2 : GAIN_COUNT // 2 + 1])
    )
    if channel.identified is None:
        actuator = SERVO if channel.is_by_servo else "engine"
        checks[f"lags of the {actuator} 0.7 and 1.3 times"] = all(
            _is_stable(channel.with_lags(factor), tuning) for factor in (0.7, 1.3)
        )
    return checks


def _is_stable(channel: Channel, tuning: Tuning) -> bool:
    return ClosedLoop(FrequencyGrid(channel, close=2000), tuning).unstable_poles == 0


def explain_failure(axes: Mapping[str, AxisDesign], need: Requirements) -> str:
    """Return why the first axis without a controller has none, in a line, or an empty string."""
    for axis, axis_design in axes.items():
        if axis_design.why_not:
            return f"{axis}: no controller at the limit keeps the requirements: {axis_design.why_not}"
        if axis_design.after is None:
            bandwidth = f", {need.min_bandwidth_hz:g} Hz included" if axis in ("roll", "pitch") else ""
            unsure = axis_design.channel.actuator.dynamics.unsure_words()
            misfit = f", for every engine that differs from the model by {unsure}" if unsure else ""
            if unsure and axis_design.channel.is_by_servo:
                left = unsure.removeprefix("what was measured, ")
                misfit = f", whatever others and what its hinges turn add to it, {left}"
            nearest = f"; {axis_design.nearest}" if axis_design.nearest else ""
            return f"{axis}: no gains keep the requirements{bandwidth}{misfit}{nearest}"
    return ""


def describe_nearest(channel: Channel, tried: Mapping[str, TuningResult], need: Requirements) -> str:
    """Return the candidate nearest to infeasible requirements, and by how much it misses which of them, or ""."""
    found = []
    for name, result in tried.items():
        with suppress(InputError, ValueError, ArithmeticError):
            # A predictor with an unstable response, for example, has no closed loop.
            closed = fine_loop(channel, result.tuning)
            if not closed.unstable_poles:
                missed = {what: part for what, part in excesses(closed, need).items() if part > 0.0}
                found.append((sum(missed.values()), name, missed))
    if not found:
        return ""
    _, name, missed = min(found, key=lambda each: each[0])
    words = " and ".join(f"{what} by {100.0 * part:.2g} %" for what, part in missed.items())
    return f"nearest comes {name}, which misses {words}"


def find_allowances(
    roll: AxisDesign, names: Sequence[str], need: Requirements, say: Say, with_lead: bool
) -> dict[str, float]:
    """Return the longest delay, s, and the largest factor of the lags with which roll could keep the requirements."""
    channel = roll.channel
    if roll.after is not None:
        return {}
    tried = dict.fromkeys((names[0], names[-1]))  # the cheapest and the most demanding
    allowances = {}
    delay = channel.actuator_delay

    def is_met(changed: Channel) -> bool:
        fixed = roll.before.tuning
        lead, model = engine_lead(changed) if with_lead else None, changed.model("trial")
        return any(isfinite(tune(changed, name, model, fixed, need, lead=lead).objective) for name in tried)

    say("which delay would allow one")
    if delay > 0.0 and (fraction := _largest(lambda part: is_met(channel.with_delay(round(part * delay))))) is not None:
        allowances["delay_s"] = round(fraction * delay) * channel.step
    if channel.identified is None:
        say("which lag would allow one")
        if (fraction := _largest(lambda part: is_met(channel.with_lags(part)))) is not None:
            allowances["lag_factor"] = fraction
    return allowances


def _largest(works: Callable[[float], bool]) -> float | None:
    """Return the largest feasible factor from 0 to 1, found by bisection; None if 0 is infeasible."""
    if not works(0.0):
        return None
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if works(middle) else (low, middle)
    return low
