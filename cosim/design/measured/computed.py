"""The same margins of a built-in controller from its gains, its predictor's model and the engine as it is swept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.design.design import dynamics_of, identify_there, shipped
from cosim.design.levels import AXES as LEVELLED
from cosim.design.levels import at_share, lighter
from cosim.design.loop.channel import Actuator, Channel, channels, hover_share
from cosim.design.loop.closed_loop import ClosedLoop, FrequencyGrid
from cosim.design.loop.tuning import Tuning
from cosim.design.measured.estimate import LoopMargins, loop_margins
from cosim.design.tune import FINE
from cosim.engine import EngineSpec
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle


@dataclass(frozen=True)
class Computed:
    """A loop as computed, broken at the plant's input."""

    margins: LoopMargins
    hertz: Array
    loop: Complex


def computed(scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, axes: list[str]) -> dict[str, Computed] | str:
    """By axis; or why it cannot be computed.  What the scenario's mismatch changes is not in it.

    The engine is swept around the thrust that the vehicle hovers with.
    """
    if scenario.controller not in PREDICTORS:
        return "a controller from outside: there is nothing to compute from"
    if PREDICTORS[scenario.controller].response is None:
        return f"controller {scenario.controller} states no frequency response"
    if scenario.stations:
        return "the engines are not all the same"
    fuel = scenario.initial.fuel
    there = vehicle if vehicle.fuel is None or fuel == 1.0 else lighter(vehicle, fuel)
    try:
        engine = Actuator.of(spec.name, dynamics_of(identify_there(scenario, there, spec, None)))
        plants = channels(scenario, there, spec, engine)
    except InputError as error:
        return str(error)
    tunings = {axis: _tuning(plants[axis], scenario, vehicle, spec) for axis in (*LEVELLED, *axes)}
    plan, step = vehicle.control.schedule, scenario.step_s
    if plan:
        levelled = {axis: tunings[axis] for axis in LEVELLED}
        tunings |= at_share(plan, levelled, hover_share(there, spec), step)
    margins = {}
    for axis in axes:
        closed = ClosedLoop(FrequencyGrid(plants[axis], close=FINE), tunings[axis])
        if closed.unstable_poles:
            return f"{axis}: the linear loop is not stable"
        below = closed.points.theta < np.pi * (1.0 - 1e-9)
        hertz, loop = closed.points.theta[below] / (2.0 * np.pi * step), closed.open_loop[below]
        margins[axis] = Computed(loop_margins(loop, hertz), hertz, loop)
    return margins


def _tuning(channel: Channel, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec) -> Tuning:
    """What flies on a channel: as :func:`cosim.simulation.build.predictors` gives it a predictor."""
    own = shipped(channel, vehicle, spec)
    if channel.name == "altitude":
        return own
    chosen = PREDICTORS[scenario.controller]
    modelled = own.controller != BASELINE.name
    predicted = modelled if chosen.needs_model else channel.name == "roll" or vehicle.allocation == "rotors"
    name = scenario.controller if predicted else BASELINE.name
    return Tuning(name, own.angle_gain, own.gains, own.predictor, own.model, own.lead)
