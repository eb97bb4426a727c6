"""The same margins of a built-in controller from its gains, its predictor's model and the engine as it is swept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.arrays import Array, Complex
from cosim.base.errors import InputError
from cosim.control.predictors.registry import BASELINE, PREDICTORS
from cosim.engine import EngineSpec
from cosim.loops import LoopMargins
from cosim.simulation.controllers.controller_file import LAW
from cosim.spec.scenario import Scenario
from cosim.spec.vehicle import Vehicle
from hexjet_design.assessment import shipped_tuning
from hexjet_design.design import identify_hover, make_dynamics
from hexjet_design.levels import THRUST_AXES, tunings_at
from hexjet_design.loop.actuator import Actuator
from hexjet_design.loop.channel import Channel, channels, hover_fraction
from hexjet_design.loop.closed_loop import ClosedLoop, FrequencyGrid
from hexjet_design.loop.criteria import FINE_POINTS
from hexjet_design.loop.limit import AxisLimit, axis_limit
from hexjet_design.loop.optimal import Optimal
from hexjet_design.loop.tuning import Tuning


@dataclass(frozen=True)
class Computed:
    """Computed loop, broken at the input of the plant."""

    margins: LoopMargins
    hertz: Array
    loop: Complex
    limit: AxisLimit | str | None = None  # limit; or why none; None: not requested


@dataclass(frozen=True)
class Plants:
    """Channels of a vehicle in hover, with its engine as swept there."""

    channels: Mapping[str, Channel]
    spec: EngineSpec
    thrust_fraction: float  # in the engines' range, at hover


def make_plants(scenario: Scenario, vehicle: Vehicle, spec: EngineSpec) -> Plants | str:
    """Return the channels of a vehicle with its initial fuel, or why they cannot be made."""
    if scenario.controller not in (*PREDICTORS, LAW):
        return "a controller from outside: there is nothing to compute from"
    if scenario.stations:
        return "the engines are not all the same"
    fuel = scenario.initial.fuel
    there = vehicle if fuel == 1.0 else vehicle.with_fuel(fuel)
    try:
        engine = Actuator.of(spec.name, make_dynamics(identify_hover(scenario, there, spec, None)))
        return Plants(channels(scenario, there, spec, engine), spec, hover_fraction(there, spec))
    except InputError as error:
        return str(error)


def find_tunings(plants: Plants, scenario: Scenario, vehicle: Vehicle, axes: Sequence[str]) -> dict[str, Tuning]:
    """Return the flown tunings of the axes, with scheduled gains if there is a schedule."""
    tunings = {axis: _tuning(plants.channels[axis], scenario, vehicle, plants.spec) for axis in (*THRUST_AXES, *axes)}
    plan = vehicle.control.schedule
    if plan:
        levelled = {axis: tunings[axis] for axis in THRUST_AXES}
        tunings |= tunings_at(plan, levelled, plants.thrust_fraction, scenario.step_s)
    return tunings


def compute_margins(
    scenario: Scenario, vehicle: Vehicle, spec: EngineSpec, axes: list[str], limit: bool = False
) -> dict[str, Computed] | str:
    """Compute the margins by axis, without the scenario's mismatch, or say why they cannot be computed.

    The engine is swept around the thrust that the vehicle hovers with.  ``limit``: with the limit of performance.
    """
    chosen = PREDICTORS.get(scenario.controller)
    if chosen is not None and chosen.response is None:
        return f"controller {chosen.name} states no frequency response"
    plants = make_plants(scenario, vehicle, spec)
    if isinstance(plants, str):
        return plants
    tunings, step = find_tunings(plants, scenario, vehicle, axes), scenario.step_s
    margins = {}
    for axis in axes:
        closed = ClosedLoop(FrequencyGrid(plants.channels[axis], close=FINE_POINTS), tunings[axis])
        if closed.unstable_poles:
            return f"{axis}: the linear loop is not stable"
        hertz = closed.points.theta / (2.0 * np.pi * step)
        margins[axis] = Computed(closed.margins, hertz, closed.open_loop, find_loop_limit(closed) if limit else None)
    return margins


def find_loop_limit(closed: ClosedLoop) -> AxisLimit | str:
    """Compare a loop with the limit of performance, or return why there is none."""
    try:
        return axis_limit(closed, closed.load_error)
    except InputError as error:
        return str(error)


def _tuning(channel: Channel, scenario: Scenario, vehicle: Vehicle, spec: EngineSpec) -> Tuning:
    """Return the tuning that flies on a channel, with a predictor of :func:`.controllers.models.make_predictors`."""
    tuning = shipped_tuning(channel, vehicle, spec)
    if channel.name == "altitude":
        return tuning
    modelled = tuning.controller != BASELINE.name
    if scenario.controller == LAW:
        if not modelled:
            return tuning
        stated = {parameter.name: parameter.default for parameter in Optimal.parameters}
        return Tuning.of_law(stated | scenario.controller_parameters, tuning.model, tuning)
    chosen = PREDICTORS[scenario.controller]
    predicted = modelled if chosen.needs_model else channel.name == "roll" or vehicle.allocation == "rotors"
    name = scenario.controller if predicted else BASELINE.name
    return Tuning(name, tuning.angle_gain, tuning.gains, tuning.predictor, tuning.model, tuning.lead)
